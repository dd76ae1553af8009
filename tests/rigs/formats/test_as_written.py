"""Rig files as people write them: spellings, wrappers, printed numbers, models that are not stated,
two sources."""

import json
import re
import warnings

import numpy as np
import pytest
import yaml
from rig_file_samples import (
    EXAMPLES,
    K4,
    OCAM_TXT,
    PAGE,
    R2,
    SIZE,
    T2,
    dump,
    kalibr,
    matrix,
    ocam_folder,
    omnimvs,
    ros,
    write,
)
from test_more_formats import follows, kb4

from omnistereo_lib import OmnistereoError, Pose
from omnistereo_rigs.formats.read import READERS, formats_table, read_any_camera, read_any_rig

K = [[200.0, 0, 400], [0, 199.0, 380], [0, 0, 1]]
POSE = {"R": R2.tolist(), "T": T2.tolist()}
LENS = {"K": K, "D": K4, "image_size": list(SIZE), "distortion_model": "fisheye"}
SINGLE = dict(zip(("fx", "fy", "cx", "cy"), (200.0, 199.0, 400.0, 380.0), strict=True))
COEFFICIENTS = dict(zip(("k1", "k2", "k3", "k4"), K4, strict=True))


def loaded(path, data, **options):
    """Return the rig of a file, centimetres, and what was said about it."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        rig = read_any_rig(dump(path, data), keep_frame=True, **{"unit": "cm"} | options)
    return rig, [str(each.message) for each in said]


def renamed(**names):
    """Return the lens with other keys."""
    return {names.get(key, key): value for key, value in LENS.items()}


def without(*keys, **more):
    return {key: value for key, value in LENS.items() if key not in keys} | more


def numbered(*keys):
    """Return the rig with all keys at the top, written by `key(name, number)`."""
    return {
        key(name, n): value
        for key in keys
        for n, cam in ((1, LENS), (2, LENS | POSE))
        for name, value in cam.items()
    }


SPELLINGS = {
    **{key: renamed(D=key) for key in ("dist", "d", "DistCoeffs")},
    **{key: renamed(K=key) for key in ("mtx", "CAMERA-MATRIX", "k")},
    **{key: renamed(image_size=key) for key in ("dim", "imageSize")},
    "width and height": without("image_size", width=SIZE[0], height=SIZE[1]),
    "fisheye: true": without("distortion_model", fisheye=True),
    "fisheye_model: 1": without("distortion_model", fisheye_model=1),
    "lens_type": without("D", "distortion_model", lens_type="fisheye", **COEFFICIENTS),
    "pinhole-equidistant": LENS | {"camera_model": "pinhole", "distortion_model": "equidistant"},
    "Kannala-Brandt": LENS | {"distortion_model": "Kannala-Brandt"},
    "single numbers": without("K", "D", **SINGLE, **COEFFICIENTS),
    "blocks": without(
        "K", "D", intrinsics=SINGLE, distortion={"model": "equidistant", **COEFFICIENTS}
    ),
    "Gyroflow's block": without("distortion_model", "D", RMS_error=0.6, distortion_coeffs=K4),
    "notes": LENS
    | {"camera_name": "left", "rms": 0.2, "serial_number": 7, "P": [0] * 12, "roi": {"width": 0}},
}


@pytest.mark.parametrize("spelling", SPELLINGS)
def test_every_spelling_is_the_same_camera(tmp_path, spelling):
    rig, said = loaded(
        tmp_path / "rig.json", {"cameras": [SPELLINGS[spelling], SPELLINGS[spelling] | POSE]}
    )
    follows(rig.cameras[1], kb4)
    np.testing.assert_allclose(rig.T_rig_cam[1].inverse().t, T2 / 100, atol=1e-12)
    assert not said


LAYOUTS = {
    "a list": [LENS, LENS | POSE],
    "by position": {"front": LENS, "rear": LENS | POSE},
    "in a wrapper": {"rig": {"cam1": LENS, "cam2": LENS | POSE}, "version": 1},
    "numbers behind": numbered(lambda name, n: f"{name}{n}"),
    "sides behind": numbered(lambda name, n: f"{name}_{('left', 'right')[n - 1]}"),
    "sides before": numbered(lambda name, n: f"{('left', 'right')[n - 1]}_{name}"),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_is_the_same_rig(tmp_path, layout):
    rig, said = loaded(tmp_path / "rig.json", LAYOUTS[layout])
    follows(rig.cameras[1], kb4)
    np.testing.assert_allclose(rig.T_rig_cam[1].inverse().R, R2, atol=1e-12)
    assert not said


CHAIN = kalibr(matrix([0, 1.5, 0.1], [0.1, 0, 0.2]), matrix([0.2, -1, 0], [-0.3, 0.1, 0]))


@pytest.mark.parametrize(
    "data",
    [
        {"cameras": [*CHAIN.values()]},
        [*CHAIN.values()],
        dict(zip(("front", "right", "back"), CHAIN.values(), strict=True)),
    ],
    ids=["wrapped list", "list", "by position"],
)
def test_chains_in_every_wrapper(tmp_path, data):
    rig, plain = (loaded(tmp_path / "rig.json", each, unit=None)[0] for each in (data, CHAIN))
    np.testing.assert_array_equal(
        [pose.as_vector() for pose in rig.T_rig_cam], [p.as_vector() for p in plain.T_rig_cam]
    )


def test_what_is_not_read_is_named(tmp_path):
    data = {"cameras": [LENS | {"warp": [0.1, 0.2], "unit": "mm", "f": 5}, LENS | POSE]}
    _, said = loaded(tmp_path / "rig.json", data)
    assert len(said) == 1 and re.search(
        r"rig.json, in 1: not read: warp, unit, f; what is read: .*K, camera_matrix", said[0]
    )


# What one camera with D of n numbers and no model is, by its focal length: an image of 800 × 760
# px.
@pytest.mark.parametrize(
    ("f", "D", "message"),
    [
        (200.0, K4, r"D has 4 numbers and no model is stated: read as a fisheye .*\d+°.*plumb_bob"),
        (
            520.0,
            [-0.28, 0.07, 2e-4, 2e-5],
            "camera 1: .*fisheye .* and a pinhole .* are possible. Add distortion_model",
        ),
        (200.0, [-0.01, 0.004, -4e-4, 3e-4], "camera 1: .* are possible. Add distortion_model"),
        (
            520.0,
            [-0.28, 0.07, 2e-4, 2e-5, 0.0],
            r"D has 5 numbers .* read as a pinhole \(plumb_bob\)",
        ),
        (520.0, [], "no distortion and no model is stated: read as a pinhole without distortion"),
        (520.0, [0.1, 0.2, 0.3], r"D has 3 numbers; expected 4 \(fisheye\), 5 or 8"),
    ],
)
def test_a_model_that_is_not_stated_is_said(tmp_path, f, D, message):
    lens = without("distortion_model") | {"D": D, "K": [[f, 0, 400], [0, f, 380], [0, 0, 1]]}
    try:
        _, said = loaded(tmp_path / "rig.json", {"cameras": [lens, lens | POSE]})
    except OmnistereoError as error:
        said = [str(error)]
    assert len([text for text in said if re.search(message, text)]) == 1, said


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"distortion_model": "plumb_bob", "D": [-0.007, 0.044, -0.042, 0.008, 0.0]},
            "p1 and p2 .*distortion_model: equi",
        ),
        (
            {"fisheye": True, "distortion_model": "plumb_bob"},
            "two camera models are stated, plumb_bob and fisheye",
        ),
        ({"D": [*K4, 0.0]}, "D has 5 numbers; the zeros after the first 4 are dropped"),
        ({"D": [*K4, 0.1]}, "camera 1: D has 5 numbers; expected 4: k1 k2 k3 k4"),
        ({"rvec": [0.0, 1.0, 0.0]}, "R and rvec state different rotations"),
        ({"T": None, "tvec": [1.0, 2.0]}, "camera 1: tvec must be 3 numbers, found 2"),
        ({"K": None, "cameraMatrix": [1, 2]}, "camera 1: cameraMatrix must be 9 numbers, found 2"),
        ({"binning_x": 2}, "the images are binned"),
    ],
)
def test_labels_and_numbers_that_contradict(tmp_path, changes, message):
    try:
        _, said = loaded(tmp_path / "rig.json", {"cameras": [LENS | POSE | changes] * 2})
    except OmnistereoError as error:
        said = [str(error)]
    assert re.search(message, " ".join(said)), said


def test_the_share_of_pixels_beyond_a_model_is_said(tmp_path):
    """θ - 0.3 θ³ grows up to θ = 1.054, where a circle of 200 · 0.703 px around the principal point
    ends."""
    lens = LENS | {"K": [[200.0, 0, 399.5], [0, 200.0, 379.5], [0, 0, 1]], "D": [-0.3, 0, 0, 0]}
    rig, said = loaded(tmp_path / "rig.json", {"cameras": [lens, lens | POSE]})
    share = 100 - 100 * np.pi * (200 * 0.7027) ** 2 / (SIZE[0] * SIZE[1])
    assert len(said) == 2 and re.search(
        rf"within 12[01]° .*: {share:.0f} % of the pixels", said[0]
    ), said
    assert rig.cameras[0].max_fov_deg == pytest.approx(2 * np.degrees(1.054), abs=1)


@pytest.mark.parametrize("decimals", [2, 4, 5])
def test_printed_rotations(tmp_path, decimals):
    R = Pose.from_vector([0.3, 0.7, 0.2, 0, 0, 0]).R
    data = {"cameras": [LENS, LENS | POSE | {"R": np.round(R, decimals).tolist()}]}
    if decimals == 2:
        with pytest.raises(
            OmnistereoError, match=r"camera 2: R is not a rotation: .* its axes by 0\.\d+°"
        ):
            loaded(tmp_path / "rig.json", data)
        return
    rig, said = loaded(tmp_path / "rig.json", data)
    error = Pose(rig.T_rig_cam[1].inverse().R @ R.T, np.zeros(3)).magnitude()[0]
    assert error < np.degrees(2 * 10.0**-decimals)
    assert [bool(re.search("in 2: R is rounded", text)) for text in said] == [True] * (decimals < 5)


def test_dumps_of_camera_info(tmp_path):
    """ROS 1 writes K, D, R, P, ROS 2 in lower case and with a line of dashes behind."""
    info = {
        "height": SIZE[1],
        "width": SIZE[0],
        "distortion_model": "equidistant",
        "D": K4,
        "K": np.ravel(K).tolist(),
    }
    info |= {
        "R": np.eye(3).ravel().tolist(),
        "P": [1.0] * 12,
        "binning_x": 0,
        "header": {"frame_id": "a"},
    }
    ros2 = (
        yaml.safe_dump({key if len(key) > 1 else key.lower(): value for key, value in info.items()})
        + "---\n"
    )
    for name, text in {"cam1.json": json.dumps(info), "cam2.yaml": ros2}.items():
        follows(read_any_camera(write(tmp_path / name, text)), kb4)
    write(tmp_path / "poses.txt", "0 0 0 0 0 0\n0 1 0 10 0 0\n")
    assert read_any_rig(tmp_path, "cm").baselines[0] == pytest.approx(0.1)
    for more in ({}, {"T": [1, 2, 3]}):
        with pytest.raises(
            OmnistereoError, match="camera_info has no pose: R there is the rectification"
        ):
            loaded(tmp_path / "rig.json", {"cam1": info | more, "cam2": info | more})


def test_text_as_people_type_it(tmp_path):
    text = yaml.safe_dump(ros(), default_flow_style=None).replace("data: [", "data:\n    [")
    text = re.sub(r"\n\s+\[", "[", text)
    assert "data:[" in text
    follows(read_any_rig(write(tmp_path / "rig.yaml", text), "cm").cameras[1], kb4)
    for comment in ("%", "//"):
        camera = read_any_camera(write(tmp_path / "ocam1.txt", OCAM_TXT.replace("#", comment)), 220)
        assert camera.image_size == SIZE


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
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            read_any_rig(tmp_path)
        assert [bool(re.search(expected or "", str(each.message))) for each in said] == [
            True
        ] * bool(expected)


def test_the_formats_in_the_book_are_those_of_the_readers():
    """Make the table with python -c 'from omnistereo_rigs.formats.read import *;
    print(formats_table())'."""
    assert formats_table() in PAGE
    assert set(EXAMPLES) == {form.name for form in READERS} | {
        "OmniMVS config.yaml",
        "a folder",
        "COLMAP model",
        "images.txt",
    }


@pytest.mark.parametrize("form", READERS, ids=lambda form: form.name)
def test_each_example_is_read(tmp_path, form, recwarn):
    for name in {form.name, "camodocal camera", "COLMAP model"}:
        write(tmp_path / EXAMPLES[name][0], EXAMPLES[name][1])
    path = tmp_path / EXAMPLES[form.name][0]
    if not form.unit:
        assert read_any_camera(path).image_size == (640, 480)
    else:
        assert (
            0.19 < read_any_rig(path, "m" if "unit" in form.unit else None).baselines[0] < 0.21
            or form.name == "MC-Calib"
        )
    assert not [
        str(each.message)
        for each in recwarn
        if "poses" not in str(each.message) and "DriveWorks" not in str(each.message)
    ]


def test_each_example_of_a_folder_is_read(tmp_path):
    for name in ("Metashape lens", "a folder"):
        write(tmp_path / EXAMPLES[name][0], EXAMPLES[name][1])
    write(tmp_path / "cam2.xml", EXAMPLES["Metashape lens"][1])
    assert read_any_rig(tmp_path, "m").baselines[0] == pytest.approx(0.2)
    for name in ("COLMAP model", "images.txt"):
        write(tmp_path / "model" / EXAMPLES[name][0], EXAMPLES[name][1])
    assert read_any_rig(tmp_path / "model", "m").baselines[0] == pytest.approx(0.2)
