"""Rules of rig files: what another program means by them, or a refusal, but nothing silently wrong."""

import json
import warnings
from math import atan2, cos, hypot, pi, radians, sin, tan
from pathlib import Path

import cv2
import numpy as np
import pytest
from rigs.formats.rig_file_samples import D4, FOCAL, K4, RAYS, SIZE, K, dump, kalibr, matrix, write
from rigs.formats.test_more_formats import AHEAD, angle, follows, kb4, theta_d
from rigs.formats.test_reconstructions import CAMERAS, WORLD, fisheye, quaternion, transforms
from scipy.spatial.transform import Rotation

from omnistereo_lib import OmnistereoError, Pose, load_camera, load_rig
from omnistereo_rigs.formats.read import read_any_camera, read_any_rig, read_rig
from omnistereo_rigs.formats.write import export_rig
from omnistereo_tools.commands.options import FrameOptions, read_frame

LENS = {"fx": 200.0, "fy": 199.0, "cx": 400.0, "cy": 380.0, "image_size": list(SIZE)}
OTHER = {"R": Rotation.from_rotvec([0.1, 1.4, 0]).as_matrix().tolist(), "T": [12.0, 0.5, -3.0]}
COLMAP_LENS = f"OPENCV_FISHEYE {SIZE[0]} {SIZE[1]} 200 199 400.5 380.5 {' '.join(map(str, K4))}\n"


def quiet(path, unit="m", **options):
    """Return the rig of a file that is read without a warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return read_any_rig(path, unit, **options)


def relative(rig):
    return [rig.T_rig_cam[0].inverse() @ pose for pose in rig.T_rig_cam]


def same(rig, poses):
    for ours, true in zip(relative(rig), poses, strict=True):
        np.testing.assert_allclose(ours.R, (poses[0].inverse() @ true).R, atol=1e-9)
        np.testing.assert_allclose(ours.t, (poses[0].inverse() @ true).t, atol=1e-9)


# --- Lenses that state no model, or another convention


def ds(x, y, z, xi=-0.2, alpha=0.6):
    d1 = hypot(x, y, z)
    d2 = hypot(x, y, xi * d1 + z)
    depth = alpha * d2 + (1 - alpha) * (xi * d1 + z)
    return 200 * x / depth + 400, 199 * y / depth + 380


def eucm(x, y, z, alpha=0.6, beta=1.1):
    depth = alpha * (beta * (x * x + y * y) + z * z) ** 0.5 + (1 - alpha) * z
    return 200 * x / depth + 400, 199 * y / depth + 380


def fov(x, y, z, w=0.9):
    around = angle(x, y, z)[1]
    r = atan2(2 * hypot(x, y) * tan(w / 2), z) / w
    return 350 * r * cos(around) + 400, 350 * r * sin(around) + 380


@pytest.mark.parametrize(
    ("stated", "pixel"),
    [
        ({"xi": -0.2, "alpha": 0.6}, ds),
        ({"Xi": -0.2, "Alpha": 0.6}, ds),
        ({"alpha": 0.6, "beta": 1.1}, eucm),
        ({"omega": 0.9, "fx": 350.0, "fy": 350.0}, fov),
        (
            {
                "params_ds": {k: LENS[k] for k in ("fx", "fy", "cx", "cy")}
                | {"alpha": 0.6, "Xi": -0.2}
            },
            ds,
        ),
        ({"w": 0.9, "fx": 350.0, "fy": 350.0}, fov),
        ({"camera_model": "double_sphere", "xi": -0.2, "alpha": 0.6}, ds),
    ],
)
def test_a_lens_is_that_of_its_parameters(tmp_path, stated, pixel):
    cams = [LENS | stated, LENS | stated | OTHER]
    follows(quiet(dump(tmp_path / "rig.json", {"cameras": cams}), "cm").cameras[1], pixel)


@pytest.mark.parametrize(
    "stated", [{"beta": 1.1}, {"D": K4, "distortion_model": "fisheye", "k5": 0.1}, {"lambda": 2.0}]
)
def test_a_parameter_of_another_lens_is_refused(tmp_path, stated):
    with pytest.raises(OmnistereoError, match=r"is a parameter of a lens that is not the one"):
        read_any_rig(dump(tmp_path / "rig.json", {"cameras": [LENS | stated, LENS | OTHER]}), "m")


def test_a_block_with_another_lens_is_refused(tmp_path):
    lens = {"camera_model": "pinhole", "distortion_model": "plumb_bob", "D": [0.0] * 5, "xi": 0.5}
    with pytest.raises(OmnistereoError, match="the camera model is plumb_bob with xi"):
        read_any_rig(dump(tmp_path / "rig.json", {"cameras": [LENS | lens] * 2}), "m")


OCAM = "{poly}\n{inverse}\n380 400\n1 0 0\n760 800\n"
RADII = np.linspace(1, 400, 300)
INVERSE = np.polynomial.Polynomial.fit(
    2 * np.arctan(RADII / 280) - pi / 2, RADII, 12, domain=(-pi, pi), window=(-pi, pi)
)


@pytest.mark.parametrize(
    ("inverse", "message"),
    [
        (lambda t: INVERSE(t), None),
        (lambda t: INVERSE(t - pi / 2), "its angle counts from the axis, with r.0. = 0"),
        (lambda t: INVERSE(-t), "its angle has the other sign"),
        (lambda t: INVERSE(t * (pi / 180)), "its angle is in degrees"),
        (lambda t: INVERSE(t * (pi / 180) - pi / 2), "counts from the axis, in degrees"),
        (None, "its coefficients run from high to low"),
    ],
)
def test_conventions_of_an_inverse_polynomial(tmp_path, inverse, message):
    """Of a stereographic lens, r = 280 tan(θ / 2): the direct polynomial is -140 + r²/560."""
    t = np.polynomial.Polynomial([0, 1])
    b = (inverse or INVERSE)(t).coef
    b = b[::-1] if inverse is None else b
    text = OCAM.format(
        poly=f"3 -140 0 {1 / 560}", inverse=f"{len(b)} {' '.join(map(repr, map(float, b)))}"
    )
    path = write(tmp_path / "ocam1.txt", text)
    if message is None:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert load_camera(path).center == (400, 380)
        return
    with pytest.raises(OmnistereoError, match=rf"inv_poly\) is not the inverse.*{message}"):
        load_camera(path)


def test_ocam_has_no_linear_term(tmp_path):
    text = OCAM.format(poly="4 -205 1.9e-3 -1.1e-6 2.3e-9", inverse="0")
    with pytest.raises(OmnistereoError, match=r"a0 a2 a3 a4, put the missing 0"):
        load_camera(write(tmp_path / "ocam1.txt", text))


def test_angle_x_is_a_pinholes(tmp_path):
    data = transforms(fl_x=None, fl_y=None, camera_angle_x=2.9)
    with pytest.raises(
        OmnistereoError, match=r"frame 1: camera_angle_x = 2.9 does not state .* Write fl_x"
    ):
        read_any_rig(dump(tmp_path / "transforms.json", data), "m")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"camera_model": "PINHOLE"}, "camera_angle_x = 2.9 does not state"),
        ({"camera_model": "OPENCV", "is_fisheye": True}, "camera_model is OPENCV and is_fisheye"),
    ],
)
def test_a_pinhole_that_is_none(tmp_path, changes, message):
    data = transforms(fl_x=None, fl_y=None, camera_angle_x=2.9, **changes)
    with pytest.raises(OmnistereoError, match=message):
        read_any_rig(dump(tmp_path / "transforms.json", data), "m")


# --- How far a lens was measured


@pytest.mark.parametrize(("limit", "field"), [(None, 180.0), (200.0, 200.0)])
def test_opencv_cannot_have_measured_beyond_90_degrees(tmp_path, limit, field):
    lens = LENS | {"D": K4, "distortion_model": "fisheye"}
    path = dump(tmp_path / "rig.json", {"cameras": [lens, lens | OTHER]})
    read = read_rig(path, "cm", limit)
    assert [camera.max_fov_deg for camera in read.rig.cameras] == [field, field]
    assert read.limited() == ([1, 2] if limit is None else [])
    uv, valid = read.rig.cameras[0].project(RAYS[RAYS[:, 2] > 0.05])
    theirs = cv2.fisheye.projectPoints(
        RAYS[RAYS[:, 2] > 0.05].reshape(-1, 1, 3), np.zeros(3), np.zeros(3), K, D4
    )[0].reshape(-1, 2)
    np.testing.assert_allclose(uv[valid], theirs[valid], atol=0.02)


# --- Cameras and moments


def named(*names, shared=True):
    """Return images.txt with two cameras at two moments, one lens for both or one for each."""
    lines = []
    for n, name in enumerate(names):
        moment, k = divmod(n, 2)
        pose = (WORLD @ Pose.from_vector([0, 0.1 * moment, 0, moment, 0, 0]) @ CAMERAS[k]).inverse()
        numbers = " ".join(map(str, [*quaternion(pose.R), *pose.t]))
        lines.append(f"{n + 1} {numbers} {1 if shared else k + 1} {name}\n\n")
    return "".join(lines)


NAMES = {
    "folders": ("left/1.png", "right/1.png", "left/2.png", "right/2.png"),
    "prefixes": ("left_0001.png", "right_0001.png", "left_0002.png", "right_0002.png"),
    "one moment": ("left.png", "right.png"),
    "cameras in one folder": ("a/left_7.png", "a/right_7.png", "a/left_8.png", "a/right_8.png"),
}


@pytest.mark.parametrize("names", NAMES.values(), ids=NAMES)
@pytest.mark.parametrize("shared", [True, False])
def test_cameras_of_colmap_are_those_of_the_images(tmp_path, names, shared):
    write(tmp_path / "cameras.txt", f"1 {COLMAP_LENS}" + ("" if shared else f"2 {COLMAP_LENS}"))
    write(tmp_path / "images.txt", named(*names, shared=shared))
    rig = quiet(tmp_path)
    same(rig, CAMERAS)
    follows(rig.cameras[1], fisheye, AHEAD)


def test_cameras_are_in_the_order_of_their_numbers(tmp_path):
    write(tmp_path / "cameras.txt", f"1 {COLMAP_LENS}")
    text = named("cam1/a.png", "cam10/a.png", "cam1/b.png", "cam10/b.png")
    first, second, *others = text.split("\n\n")
    write(tmp_path / "images.txt", "\n\n".join([second, first, *others]))
    same(quiet(tmp_path), CAMERAS)


def test_moments_of_one_camera_are_no_rig(tmp_path):
    write(tmp_path / "cameras.txt", f"1 {COLMAP_LENS}")
    names = [f"frame_{n:04}.png" for n in range(4)]
    write(tmp_path / "images.txt", named(*names))
    with pytest.raises(OmnistereoError, match="moments of one camera, or cameras"):
        read_any_rig(tmp_path, "m")
    frames = transforms()["frames"] * 6
    many = [frame | {"file_path": f"images/{n:04}.png"} for n, frame in enumerate(frames)]
    with pytest.raises(OmnistereoError, match="moments of one camera, or cameras"):
        read_any_rig(dump(tmp_path / "transforms.json", transforms() | {"frames": many}), "m")


def test_the_rig_of_rigs_txt(tmp_path):
    write(tmp_path / "cameras.txt", f"1 {COLMAP_LENS}2 {COLMAP_LENS}")
    write(tmp_path / "images.txt", named("0001.png", "0002.png", shared=False))
    pose = CAMERAS[1].inverse()
    numbers = " ".join(map(str, [*quaternion(pose.R), *pose.t]))
    write(tmp_path / "rigs.txt", f"# RIG_ID, …\n1 2 CAMERA 1 CAMERA 2 1 {numbers}\n")
    same(quiet(tmp_path), CAMERAS)
    write(tmp_path / "rigs.txt", "1 2 CAMERA 1 CAMERA 2 0\n")
    with pytest.raises(OmnistereoError, match="camera 2 has no pose in the"):
        read_any_rig(tmp_path, "m")


def test_frames_of_several_moments_are_one_rig(tmp_path):
    frames, then = [], Pose.from_vector([0, 0.1, 0, 1, 0, 0])
    for moment, world in enumerate((Pose.identity(), then, then @ then)):
        for k, frame in enumerate(transforms()["frames"]):
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = world.R, world.t
            turned = {"transform_matrix": (pose @ np.array(frame["transform_matrix"])).tolist()}
            frames.append(frame | turned | {"file_path": f"images/cam{k}/{moment:04}.png"})
    same(quiet(dump(tmp_path / "t.json", transforms() | {"frames": frames})), CAMERAS)


def test_binary_models_and_folders_of_cameras_say_what_to_do(tmp_path):
    write(tmp_path / "sparse" / "cameras.bin", "")
    with pytest.raises(OmnistereoError, match=r"colmap model_converter .* --output_type TXT"):
        read_any_rig(tmp_path / "sparse", "m")
    for n in (1, 2):
        dump(tmp_path / "cams" / f"cam{n}.json", LENS | {"D": K4, "distortion_model": "fisheye"})
    with pytest.raises(OmnistereoError, match=r"poses.txt is missing beside cam1.json, cam2.json"):
        read_any_rig(tmp_path / "cams", "m")


def test_euroc_folders(tmp_path):
    body = [matrix([0, 0, 0.1], [0.1, 0, 0]), matrix([0, 1.5, 0], [0, 0.2, 0])]
    lens = kalibr()["cam0"] | {"rate_hz": 20, "sensor_type": "camera"}
    for n, T in enumerate(body):
        stated = lens | {"T_BS": {"rows": 4, "cols": 4, "data": T.ravel().tolist()}}
        dump(tmp_path / "mav0" / f"cam{n}" / "sensor.yaml", stated)
    for folder in (tmp_path, tmp_path / "mav0"):
        same(quiet(folder, None), [Pose(T[:3, :3], T[:3, 3]) for T in body])


# --- Other programs


def test_lists_of_calibrate_multiview(tmp_path):
    second = [OTHER["R"], OTHER["T"]]
    lists = {"Ks": [K.tolist()] * 2, "distortions": [K4] * 2, "is_fisheye": [1, 1]}
    lists |= {"Rs": [np.eye(3).tolist(), second[0]], "Ts": [[0, 0, 0], second[1]]}
    lists |= {"image_sizes": [list(SIZE)] * 2}
    np.savez(tmp_path / "rig.npz", **lists)
    shared = lists | {"image_sizes": None, "image_size": list(SIZE)}
    files = dump(tmp_path / "rig.json", lists), dump(tmp_path / "shared.json", shared)
    for path in (*files, tmp_path / "rig.npz"):
        rig = quiet(path, "cm")
        np.testing.assert_allclose(rig.T_rig_cam[1].inverse().t, np.array(second[1]) / 100)
        follows(rig.cameras[1], kb4)


def test_depthai_leads_from_socket_to_socket(tmp_path):
    to_next = Pose.from_vector([0, 0.3, 0.1, 7.5, 0.2, -1.0])  # camera → the next one, centimetres
    cams = []
    for socket, parent in ((0, 1), (1, 2), (2, -1)):
        pose = to_next if parent >= 0 else Pose.identity()
        t = dict(zip("xyz", pose.t.tolist(), strict=True))
        extrinsics = {"rotationMatrix": pose.R.tolist(), "translation": t, "toCameraSocket": parent}
        lens = {"intrinsicMatrix": K.tolist(), "distortionCoeff": [*K4, *[0.0] * 10]}
        lens |= {"cameraType": 1, "width": SIZE[0], "height": SIZE[1], "extrinsics": extrinsics}
        cams.append([socket, lens])
    with pytest.warns(UserWarning, match="the zeros after the first 4 are dropped"):
        rig = read_any_rig(dump(tmp_path / "oak.json", {"cameraData": cams}))
    step = Pose(to_next.R, to_next.t / 100)
    same(rig, [step @ step, step, Pose.identity()])
    follows(rig.cameras[0], kb4)
    cams[2][1]["extrinsics"]["toCameraSocket"] = 0
    with pytest.raises(OmnistereoError, match="lead in a circle"):
        read_any_rig(dump(tmp_path / "oak.json", {"cameraData": cams}))


def fisheye624(x, y, z, k=(0.01, -0.02, 0.003, 0, 0, 1e-4), p=(1e-4, -2e-4), s=(2e-4, 0, -1e-4, 0)):
    theta, around = angle(x, y, z)
    r = theta + sum(value * theta ** (2 * n + 3) for n, value in enumerate(k))
    x, y = r * cos(around), r * sin(around)
    r2 = x * x + y * y
    u = x + 2 * x * (p[0] * x + p[1] * y) + p[0] * r2 + s[0] * r2 + s[1] * r2**2
    v = y + 2 * y * (p[0] * x + p[1] * y) + p[1] * r2 + s[2] * r2 + s[3] * r2**2
    return 240 * u + 400, 240 * v + 380


@pytest.mark.filterwarnings("ignore:.*no tangential distortion")
def test_cameras_of_aria(tmp_path):
    k, p, s = (0.01, -0.02, 0.003, 0, 0, 1e-4), (1e-4, -2e-4), (2e-4, 0, -1e-4, 0)
    cams = []
    for n, pose in enumerate(CAMERAS):
        w, *xyz = quaternion(pose.R)
        lens = {"Name": "FisheyeRadTanThinPrism", "Params": [240, 400, 380, *k, *p, *s]}
        place = {"UnitQuaternion": [w, xyz], "Translation": pose.t.tolist()}
        cams.append({"Label": f"camera-{n}", "Projection": lens, "T_Device_Camera": place})
        cams[-1]["ImageSize"] = list(SIZE)
    rig = read_any_rig(dump(tmp_path / "aria.json", {"CameraCalibrations": cams}))
    same(rig, CAMERAS)
    follows(rig.cameras[1], fisheye624, atol=0.3)
    del cams[0]["ImageSize"]
    with pytest.raises(OmnistereoError, match=r"'ImageSize' or .* is missing"):
        read_any_rig(dump(tmp_path / "aria.json", {"CameraCalibrations": cams}))


@pytest.mark.parametrize("kind", ["pixeldistance-to-angle", "angle-to-pixeldistance"])
@pytest.mark.filterwarnings("ignore:.*DriveWorks documents")
def test_f_theta_rigs(tmp_path, kind):
    """θ = 4e-3 r + 2e-9 r³, and r = 240 θ - 5 θ³."""
    terms = {"pixeldistance-to-angle": "0 4e-3 0 2e-9", "angle-to-pixeldistance": "0 240 0 -5"}
    sensors = []
    for yaw, t in ((0, [2, 0, 1]), (90, [1, 1, 1])):
        lens = {"Model": "ftheta", "width": "800", "height": "760", "cx": "400.5", "cy": "380"}
        lens |= {"polynomial": terms[kind], "polynomial-type": kind}
        place = {"roll-pitch-yaw": [0, 0, yaw], "t": t}
        name = {"name": f"camera:{yaw}", "nominalSensor2Rig_FLU": place, "properties": lens}
        sensors.append(name)
    rig = read_any_rig(dump(tmp_path / "rig.json", {"rig": {"sensors": sensors}}))

    def pixel(x, y, z):
        theta, around = angle(x, y, z)
        roots = np.roots([2e-9, 0, 4e-3, -theta])
        r = float(roots[abs(roots.imag) < 1e-9].real.min()) if kind[0] == "p" else 0
        r = r or 240 * theta - 5 * theta**3
        return 400.5 + r * cos(around), 380 + r * sin(around)

    follows(rig.cameras[0], pixel)
    sensors[0]["correction_sensor_R_FLU"] = {"roll-pitch-yaw": [0, 0.5, 0]}
    with pytest.raises(OmnistereoError, match="correction_sensor_R_FLU is not read"):
        read_any_rig(dump(tmp_path / "rig.json", {"rig": {"sensors": sensors}}))
    # The second camera looks to the left of the first, stands 1 m behind it and 1 m to its left.
    there = relative(rig)[1]
    np.testing.assert_allclose(there.t, [-1, 0, -1], atol=1e-9)
    np.testing.assert_allclose(there.R[:, 2], [-1, 0, 0], atol=1e-9)


def test_hugin_projects_of_several_lenses(tmp_path):
    first = 'i w800 h760 f3 v180 Ra0 a0.01 b-0.02 c0.005 d2.5 e-1.5 g0 t0 r0 p0 y0 n"a0.jpg"\n'
    for second, same_lens in (
        ("v=0 a=0 b=0 c=0 d=0 e=0", True),
        ("v170 a0.01 b-0.02 c0.005", False),
    ):
        path = write(tmp_path / "two.pto", f'{first}i w800 h760 f3 {second} r0 y90 n"b0.jpg"\n')
        if same_lens:
            assert read_any_camera(path).image_size == (800, 760)
        else:
            with pytest.raises(OmnistereoError, match="several lenses: image 2"):
                read_any_camera(path)


def test_a_data_set_with_a_rig_of_another_program(tmp_path, capsys):
    source = Path("data_samples/sunny/test")
    export_rig(load_rig(source), tmp_path / "out")
    (tmp_path / "set").mkdir()
    (tmp_path / "out" / "kalibr.yaml").rename(tmp_path / "set" / "calibration.yaml")
    for n in (1, 2, 3, 4):
        (tmp_path / "set" / f"cam{n}").symlink_to((source / f"cam{n}").resolve())
    frame = read_frame(FrameOptions(rig=tmp_path / "set"))
    assert len(frame.rig) == 4 and frame.images[0].shape[:2] == (768, 800)
    assert "`omnistereo rig " in capsys.readouterr().err


def test_clocks_that_differ_are_said(tmp_path):
    chain = kalibr(np.eye(4), np.eye(4))
    for n, shift in enumerate((0.0012, 0.0011, 0.0678)):
        chain[f"cam{n}"]["timeshift_cam_imu"] = shift
    with pytest.warns(UserWarning, match=r"camera 3 differs by 67 ms"):
        read = read_rig(dump(tmp_path / "chain.yaml", chain))
    assert read.clock_offsets_s == (0.0012, 0.0011, 0.0678)
    del chain["cam1"]["timeshift_cam_imu"]
    assert read_rig(dump(tmp_path / "chain.yaml", chain)).clock_offsets_s is None


# --- Numbers and limits


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
    path = write(tmp_path / "rig.yaml", text)
    if value is None:
        with pytest.raises(OmnistereoError, match="K must be numbers, found"):
            read_any_rig(path, "m")
        return
    theta = radians(30)
    uv, _ = read_any_rig(path, "m").cameras[0].project([sin(theta), 0, cos(theta)])
    assert uv[0] == pytest.approx(320 + value * theta_d(theta, K4), abs=0.02)


MANY = {
    "kalibr": {f"cam{n}": kalibr()["cam0"] for n in range(65)},
    "opencv": {"cameras": [LENS | OTHER] * 65},
    "numbered": {f"K{n}": K.tolist() for n in range(65)},
    "lists": {"Ks": [K.tolist()] * 65},
    "nerfstudio": transforms()
    | {"frames": [transforms()["frames"][0] | {"file_path": f"cam{n}/a.png"} for n in range(65)]},
}


@pytest.mark.parametrize("data", MANY.values(), ids=MANY)
def test_a_rig_has_at_most_64_cameras(tmp_path, data):
    with pytest.raises(OmnistereoError, match="found 65 cameras; expected at most 64"):
        read_any_rig(write(tmp_path / "rig.json", json.dumps(data)), "m")


def test_what_a_folder_or_a_rig_names_is_counted_before_it_is_read(tmp_path):
    for n in range(65):
        write(tmp_path / "euroc" / f"cam{n}" / "sensor.yaml", "a: [")
        write(tmp_path / "lenses" / f"cam{n}.json", "{")
        write(tmp_path / "ocam" / f"ocam{n}.txt", "")
    for folder in ("lenses", "ocam"):
        write(tmp_path / folder / "poses.txt", "0 0 0 0 0 0\n" * 65)
    vins = {f"body_T_cam{n}": np.eye(4).tolist() for n in range(65)}
    vins |= {f"cam{n}_calib": "a.yaml" for n in range(65)}
    for path in ("euroc", "lenses", "ocam", dump(tmp_path / "vins.yaml", vins)):
        with pytest.raises(OmnistereoError, match="found 65 cameras; expected at most 64"):
            read_any_rig(tmp_path / path, "m")


def test_lists_and_objects_of_other_programs_are_named(tmp_path):
    sensors = [{"token": "t", "rotation": [1, 0, 0, 0], "camera_intrinsic": K.tolist()}] * 2
    with pytest.raises(OmnistereoError, match=r"a list of 2 items with the keys \['camera_intr"):
        read_any_rig(write(tmp_path / "rig.json", json.dumps(sensors)), "m")
    cams = {"a": {"intrinsics": FOCAL, "extrinsics": np.eye(4).tolist()}}
    with pytest.raises(OmnistereoError, match="whether extrinsics are camera → rig"):
        read_any_rig(write(tmp_path / "rig.json", json.dumps(cams | {"b": cams["a"]})), "m")
    numpy = "cam1: {D: !!python/object/apply:numpy.core.multiarray._reconstruct {args: []}}\n"
    with pytest.raises(OmnistereoError, match=r"holds Python objects.*\.tolist"):
        read_any_rig(write(tmp_path / "rig.yaml", numpy), "m")
    with pytest.raises(OmnistereoError, match="not valid TOML"):
        read_any_rig(write(tmp_path / "rig.toml", "[cam_0\n"), "m")
