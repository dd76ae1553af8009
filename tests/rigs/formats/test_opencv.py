"""OpenCV and ROS files as people write them: keys, layouts, models, printed numbers."""

import json
import re
import warnings
from functools import partial
from math import cos, radians, sin

import cv2
import numpy as np
import pytest
import yaml
from rigs.formats.rig_file_samples import (
    AHEAD,
    D4,
    K4,
    OCAM_TXT,
    R2,
    RAYS,
    SIZE,
    T2,
    K,
    brown,
    ds,
    dump,
    eucm,
    follows,
    fov,
    kb4,
    mei,
    ocam_folder,
    omnimvs,
    read,
    ros,
    theta_d,
    write,
)
from scene import refused
from scipy.spatial.transform import Rotation

from omnistereo_lib import Pose
from omnistereo_rigs.formats.read import read_any_camera, read_any_rig, read_rig

POSE = {"R": R2.tolist(), "T": T2.tolist()}
LENS = {"K": K.tolist(), "D": K4, "image_size": list(SIZE), "distortion_model": "fisheye"}
FOCAL = dict(zip(("fx", "fy", "cx", "cy"), (200.0, 199.0, 400.0, 380.0), strict=True))
COEFFICIENTS = dict(zip(("k1", "k2", "k3", "k4"), K4, strict=True))


def renamed(**names):
    """Return the lens with other keys."""
    return {names.get(key, key): value for key, value in LENS.items()}


def without(*keys, **more):
    return {key: value for key, value in LENS.items() if key not in keys} | more


def numbered(key):
    """Return the rig with all keys at the top, written by `key(name, number)`."""
    cams = ((1, LENS), (2, LENS | POSE))
    found = {key(name, n): x for n, cam in cams for name, x in cam.items() if name in "KDRT"}
    return found | {"image_size": list(SIZE), "distortion_model": "fisheye"}


LISTS = {"Ks": [K.tolist()] * 2, "distortions": [K4] * 2, "is_fisheye": [1, 1]}
LISTS |= {"Rs": [np.eye(3).tolist(), POSE["R"]], "Ts": [[[0], [0], [0]], POSE["T"]]}
CAMERAS = {
    **{key: renamed(D=key) for key in ("dist", "d", "distCoeffs", "distortion_coeffs")},
    **{key: renamed(K=key) for key in ("mtx", "camera_matrix", "cameraMatrix", "k")},
    **{key: renamed(image_size=key) for key in ("dim", "DIM", "imageSize", "resolution")},
    "width and height": without("image_size", width=SIZE[0], height=SIZE[1]),
    "fisheye: true": without("distortion_model", fisheye=True),
    "is_fisheye: 1": without("distortion_model", is_fisheye=1),
    "fisheye_model: 1": without("distortion_model", fisheye_model=1),
    "lens_type": without("D", "distortion_model", lens_type="fisheye") | COEFFICIENTS,
    "pinhole-equidistant": LENS | {"camera_model": "pinhole", "distortion_model": "equidistant"},
    "Kannala-Brandt": LENS | {"distortion_model": "Kannala-Brandt"},
    "focal lengths": without("K", **FOCAL),
    "blocks": without("K", intrinsics=FOCAL),
    "notes": LENS | {"camera_name": "left", "rms": 0.2, "P": [0] * 12, "roi": {"width": 0}},
}
TOP = numbered(lambda name, n: f"{name}{n}")
STEREO = {key: value for key, value in TOP.items() if key not in ("R2", "T2")}
STEREO |= {"R1": np.eye(3).tolist(), "R2": np.eye(3).tolist()}
LAYOUTS = {
    **{name: {"cameras": [cam, cam | POSE]} for name, cam in CAMERAS.items()},
    "a list": [LENS, LENS | POSE],
    "by position": {"front": LENS, "rear": LENS | POSE},
    "in a wrapper": {"rig": {"cam1": LENS, "cam2": LENS | POSE}, "version": 1},
    "numbers": TOP,
    "numbers from 0": numbered(lambda name, n: f"{name}_{n - 1}"),
    "stereoCalibrate": STEREO | POSE,
    "lists": LISTS | {"image_sizes": [list(SIZE)] * 2},
    "lists of one size": LISTS | {"image_size": list(SIZE)},
    "ros": ros(),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_is_the_same_rig(tmp_path, layout):
    rig, said = read(tmp_path / "rig.json", LAYOUTS[layout], "cm")
    follows(rig.cameras[1], kb4)
    np.testing.assert_allclose(rig.T_rig_cam[1].inverse().R, R2, atol=1e-12)
    np.testing.assert_allclose(rig.T_rig_cam[1].inverse().t, T2 / 100, atol=1e-12)
    assert not said


# What a lens states beside fx 200, fy 199 and the centre, and its projection.
SPHERES = partial(ds, xi=-0.2, alpha=0.6, f=(200, 199), c=(400, 380))
OMNI = partial(mei, xi=1.2, f=(500, 498), k1=-0.1, k2=0.02)
SHORT = {"fx": 350.0, "fy": 350.0}
BY_PARAMETERS = [
    ({"camera_model": "ds", "params_ds": {"alpha": 0.6, "Xi": -0.2}}, SPHERES),
    ({"camera_model": "double_sphere", "xi": -0.2, "alpha": 0.6}, SPHERES),
    ({"model": "eucm", "alpha": 0.6, "beta": 1.1}, eucm),
    ({"model": "fov", "omega": 0.9} | SHORT, partial(fov, f=(350, 350))),
    ({"model": "omni", "xi": 1.2, "D": [-0.1, 0.02, 0, 0], "fx": 500, "fy": 498}, OMNI),
    ({"D": [-0.1, 0.01, 0, 0, 0], "fx": 400, "fy": 398}, partial(brown, p=(0, 0))),
    ({"model": "none", "fx": 400, "fy": 398}, partial(brown, k=(0, 0), p=(0, 0))),
]


@pytest.mark.parametrize(("stated", "pixel"), BY_PARAMETERS)
def test_a_lens_is_that_of_its_parameters(tmp_path, stated, pixel):
    cams = [FOCAL | {"image_size": list(SIZE)} | stated] * 2
    rig, said = read(tmp_path / "rig.json", {"cameras": [cams[0], cams[1] | POSE]}, "cm")
    follows(rig.cameras[1], pixel)
    assert not said


@pytest.mark.parametrize(
    "D",
    [
        [-0.31, 0.115, 0.0, 0.0],
        [-0.31, 0.115, 0.0, 0.0, 0.0],
        [0.3, 0.02, 0.0, 0.0, 0.001, 0.5, 0.06, 0.003],
    ],
)
def test_a_pinhole_is_opencvs(tmp_path, D):
    matrix = np.array([[400.0, 0, 400], [0, 399, 380], [0, 0, 1]])

    def pixel(x, y, z):
        at = np.array([[[x, y, z]]])
        return cv2.projectPoints(at, np.zeros(3), np.zeros(3), matrix, np.array(D))[0].ravel()

    lens = LENS | {"K": matrix.tolist(), "D": D, "distortion_model": "plumb_bob"}
    rig, _ = read(tmp_path / "rig.json", {"cameras": [lens, lens | POSE]}, "cm")
    follows(rig.cameras[0], pixel)
    assert 90 < rig.cameras[0].max_fov_deg <= 120


def test_skew(tmp_path):
    lens = LENS | {"K": [200.0, 1.5, 400, 0, 199.0, 380, 0, 0, 1]}
    rig, _ = read(tmp_path / "rig.json", {"cameras": [lens, lens | POSE]}, "cm")
    follows(rig.cameras[0], partial(kb4, skew=1.5))


def opencv_file(path, **values):
    """Written by OpenCV itself."""
    values = {"K1": K, "D1": D4, "K2": K, "D2": D4, "R": R2, "T": T2.reshape(3, 1)} | values
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    sides = {"image_width": SIZE[0], "image_height": SIZE[1], "fisheye": 1}
    for name, value in (sides | values).items():
        file.write(name, value)
    file.release()
    return path


@pytest.mark.parametrize("suffix", [".json", ".xml", ".yaml"])
def test_file_storage_in_each_of_its_formats(tmp_path, suffix):
    path = opencv_file(tmp_path / f"fisheye{suffix}")
    found = read_rig(path, "cm", keep_frame=True)
    assert found.found.name == "OpenCV, ROS" and not found.found.unit
    rig, point = found.rig, np.array([0.1, 0.2, 0.7])  # in the first camera, metres
    np.testing.assert_allclose(rig.T_rig_cam[1] @ (R2 @ point + T2 / 100), point, atol=1e-12)
    np.testing.assert_allclose(rig.T_rig_cam[0] @ point, point)
    theirs, _ = cv2.fisheye.projectPoints(AHEAD[:, None], np.zeros(3), np.zeros(3), K, D4)
    uv, valid = rig.cameras[1].project(AHEAD)
    assert valid.mean() > 0.8
    np.testing.assert_allclose(uv[valid], theirs.reshape(-1, 2)[valid], atol=0.02)


def test_cameras_are_in_the_order_of_their_numbers(tmp_path):
    """Images are given in this order."""
    lenses = {f"cam{n}": LENS | POSE | {"K": (K + [[0, 0, n]] * 1).tolist()} for n in (1, 10, 2)}
    for cam in lenses.values():
        cam["K"] = [200, 0, cam["K"][0][2], 0, 199, 380, 0, 0, 1]
    for data in (lenses, {"cameras": lenses}):
        rig, _ = read(tmp_path / "rig.json", data, "cm")
        assert [camera.center[0] for camera in rig.cameras] == pytest.approx([401, 402, 410])


def test_npz(tmp_path):
    lists = LISTS | {"image_sizes": [list(SIZE)] * 2, "Ts": [[0, 0, 0], POSE["T"]]}
    np.savez(tmp_path / "rig.npz", **lists)
    follows(read(tmp_path / "rig.npz", unit="cm")[0].cameras[1], kb4)


def test_what_is_not_read_is_named(tmp_path):
    data = {"cameras": [LENS | {"warp": [0.1, 0.2], "unit": "mm", "f": 5}, LENS | POSE]}
    _, said = read(tmp_path / "rig.json", data, "cm")
    assert len(said) == 1
    assert re.search(r"rig.json, in camera 1: not read: warp, unit, f. Rename", said[0])


NO_MODEL = "camera 1: no model is stated, and .* has {} numbers. Add distortion_model: fisheye"
REFUSED = [
    (without("distortion_model"), NO_MODEL.format(4)),
    (without("distortion_model", "D"), NO_MODEL.format(0)),
    (without("distortion_model", D=[0.1, 0.2, 0.3]), NO_MODEL.format(3)),
    (without("distortion_model", "D", dist_coef=K4), NO_MODEL.format(0)),
    (LENS | {"distortion_model": "thin_prism"}, "model is thin_prism; exp.* one of fisheye"),
    (LENS | {"distortion_model": "mei"}, "camera 1: key 'xi' is missing"),
    (without("distortion_model", "D", xi=-0.2, alpha=0.6), NO_MODEL.format(0)),
    (LENS | {"distortion_model": "none"}, "camera 1: D has 4 numbers; expected 0"),
    (LENS | {"xi": 0.5}, "'xi' is a parameter of a lens that is not the one"),
    (LENS | {"k5": 0.1}, "'k5' is a parameter of a lens"),
    (LENS | {"lambda": 2.0}, "'lambda' is a parameter of a lens"),
    (LENS | {"coeffs": K4}, "'coeffs' is a parameter of a lens"),
    (LENS | {"fisheye": True, "distortion_model": "plumb_bob"}, "stated, plumb_bob and fisheye"),
    (LENS | {"D": [*K4, 0.1]}, "camera 1: D has 5 numbers; expected 4: k1 k2 k3 k4"),
    (LENS | {"rvec": [0.0, 1.0, 0.0]}, "R and rvec state one thing with different values"),
    (LENS | {"camera_matrix": np.eye(3).tolist()}, "K and camera_matrix state one thing"),
    (LENS | {"T": None, "tvec": [1.0, 2.0]}, "camera 1: tvec must be 3 numbers, found 2"),
    (LENS | {"K": None, "cameraMatrix": [1, 2]}, "cameraMatrix must be 9 numbers, found 2"),
    (LENS | {"K": K.T.tolist()}, "camera 1: K is .*expected fx skew cx"),
    (LENS | {"R": np.eye(2).tolist()}, "camera 1: R has 4 numbers; expected a 3 × 3 matrix"),
    (LENS | {"R": [0.0, 0.0, 0.0, 1.0]}, "camera 1: R has 4 numbers; expected a 3 × 3 matrix"),
    (LENS | {"T": [float("nan"), 0, 0]}, "camera 1: T must be finite numbers"),
    (LENS | {"binning_x": 2}, "binning_x is 2; expected 1. Calibrate the images at their own"),
    (LENS | {"R": None}, "camera 2: no pose; .*expected R"),
    (LENS | {"D": {"rows": 1, "cols": 5, "data": K4}}, "D must be 5 numbers, found 4"),
    (LENS | {"D": {"rows": 1, "cols": 1e300, "data": K4}}, "cols of D is 1e.300; exp.* integer"),
    (LENS | {"header": {"frame_id": "a"}, "P": [1.0] * 12}, "camera_info has no pose: R there"),
    (LENS | {"T": None, "P": [1.0] * 12}, "camera_info has no pose: R there is the rect"),
]


@pytest.mark.parametrize(("camera", "message"), REFUSED)
def test_what_is_refused(tmp_path, camera, message):
    with refused(f"rig.json: .*{message}"):
        read(tmp_path / "rig.json", {"cameras": [POSE | camera] * 2}, "cm")


def test_lists_of_different_lengths_are_refused(tmp_path):
    data = LISTS | {"image_sizes": [list(SIZE)]}
    with refused("have different lengths; expected 2"):
        read(tmp_path / "rig.json", data, "cm")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (
            numbered(lambda name, n: f"{name}{n}") | {"K02": K.tolist()},
            "K02: camera 2 has another K",
        ),
        ({"cameras": {"cam2": LENS, "cam02": LENS | POSE}}, "two of cam2, cam02 have one number"),
    ],
)
def test_two_cameras_of_one_number_are_refused(tmp_path, data, message):
    with refused(message):
        read(tmp_path / "rig.json", data, "cm")


@pytest.mark.parametrize("decimals", [2, 4, 5])
def test_printed_rotations(tmp_path, decimals):
    R = Pose.from_vector([0.3, 0.7, 0.2, 0, 0, 0]).R
    data = {"cameras": [LENS, LENS | POSE | {"R": np.round(R, decimals).tolist()}]}
    if decimals == 2:
        with refused(r"camera 2: R is not a rotation: .* its axes by 0\.\d+°"):
            read(tmp_path / "rig.json", data, "cm")
        return
    rig, said = read(tmp_path / "rig.json", data, "cm")
    error = Pose(rig.T_rig_cam[1].inverse().R @ R.T, np.zeros(3)).magnitude()[0]
    assert error < np.degrees(2 * 10.0**-decimals)
    assert [bool(re.search("in camera 2: R is rounded", text)) for text in said] == [True] * (
        decimals < 5
    )


def test_rectifications_are_not_poses(tmp_path):
    """R1 and R2 of cv2.stereoRectify beside the R of cv2.fisheye.stereoCalibrate."""
    turn = Rotation.from_rotvec([0, 0.1, 0]).as_matrix()
    path = opencv_file(tmp_path / "stereo.yaml", R1=turn, R2=turn)
    rig, _ = read(path, unit="cm")
    np.testing.assert_allclose(rig.T_rig_cam[1].R, R2.T, atol=1e-12)


def test_dumps_of_camera_info(tmp_path):
    """ROS 1 writes K, D, R, P, ROS 2 in lower case and with a line of dashes behind."""
    info = {"height": SIZE[1], "width": SIZE[0], "distortion_model": "equidistant", "D": K4}
    info |= {"K": K.ravel().tolist(), "R": np.eye(3).ravel().tolist(), "P": [1.0] * 12}
    info |= {"binning_x": 0, "header": {"frame_id": "a"}}
    lower = {key if len(key) > 1 else key.lower(): value for key, value in info.items()}
    ros2 = yaml.safe_dump(lower) + "---\n"
    for name, text in {"cam1.json": json.dumps(info), "cam2.yaml": ros2}.items():
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            follows(read_any_camera(write(tmp_path / name, text)), kb4)
    write(tmp_path / "poses.txt", "0 0 0 0 0 0\n0 1 0 10 0 0\n")
    assert read_any_rig(tmp_path, "cm").baselines[0] == pytest.approx(0.1)


def test_text_as_people_type_it(tmp_path):
    text = yaml.safe_dump(ros(), default_flow_style=None).replace("data: [", "data:\n    [")
    text = re.sub(r"\n\s+\[", "[", text)
    assert "data:[" in text
    follows(read_any_rig(write(tmp_path / "rig.yaml", text), "cm").cameras[1], kb4)
    for comment in ("%", "//"):
        camera = read_any_camera(write(tmp_path / "ocam1.txt", OCAM_TXT.replace("#", comment)), 220)
        assert camera.image_size == SIZE


@pytest.mark.parametrize(
    ("number", "value"),
    [
        ("0200", 200.0),
        ("2e2", 200.0),
        ("3:20", None),
        ("0b11", None),
        ("yes", None),
        ("true", None),
    ],
)
def test_numbers_are_pythons(tmp_path, number, value):
    text = f"""cam1: {{K: [{number}, 0, 320, 0, 200, 240, 0, 0, 1], D: {K4},
  distortion_model: fisheye, image_size: [640, 480]}}
cam2: {{K: [200, 0, 320, 0, 200, 240, 0, 0, 1], D: {K4}, distortion_model: fisheye,
  image_size: [640, 480], R: [-1, 0, 0, 0, 1, 0, 0, 0, -1], T: [0.2, 0, 0]}}
"""
    if value is None:
        with refused("K must be numbers, found"):
            read(tmp_path / "rig.yaml", text, "m")
        return
    theta = radians(30)
    uv, _ = (
        read(tmp_path / "rig.yaml", text, "m")[0].cameras[0].project([sin(theta), 0, cos(theta)])
    )
    assert uv[0] == pytest.approx(320 + value * theta_d(theta, K4), abs=0.02)


def test_two_sources_of_poses(tmp_path):
    """The published folders have both files; those of one rig agree in one of the units."""
    rig = omnimvs()
    for cam in rig["cameras"]:
        cam.pop("invalid_mask")
    dump(tmp_path / "config.yaml", rig)
    poses = [Pose.from_vector(cam["pose"]) for cam in rig["cameras"]]
    # centimetres
    lines = [" ".join(map(str, [*pose.as_vector()[:3], *(100 * pose.t)])) for pose in poses]
    for text, expected in (
        (lines, None),
        ([*lines[:2], "0 3 0 0 0 -60"], "contradict"),
        (lines[:2], "poses.txt has 2 cameras"),
    ):
        ocam_folder(tmp_path, cameras=len(text), poses="\n".join(text))
        said = read(tmp_path)[1]
        assert [bool(re.search(expected or "", each)) for each in said] == [True] * bool(expected)


def test_a_fisheye_of_opencv_goes_on_beyond_180_degrees_only_by_option(tmp_path):
    path = dump(tmp_path / "rig.json", {"cameras": [LENS, LENS | POSE]})
    assert read_rig(path, "cm").limited() == [1, 2]
    wide = read_rig(path, "cm", 200.0)
    assert not wide.limited() and wide.rig.cameras[0].max_fov_deg == 200
    follows(wide.rig.cameras[0], kb4, RAYS[RAYS[:, 2] > -0.1], least=0.4)
