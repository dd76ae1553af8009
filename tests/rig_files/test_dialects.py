"""Every dialect of rig file, written by hand or by another library, with its traps and its broken forms."""

import json
import logging
import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from test_camera import AFFINE, CENTER, SIZE, F, stereographic

from omnistereo_lib import OcamCamera, OmnistereoError, Pose, Rig
from omnistereo_lib.rig_files.camera_models import double_sphere, kannala_brandt, omni
from omnistereo_lib.rig_files.dialects import load_rig, read_ocam_txt, save_rig, write_ocam_txt

CAMERA = stereographic()
POLY, INVERSE = " ".join(map(repr, CAMERA.poly.tolist())), " ".join(map(repr, CAMERA.inv_poly.tolist()))
N_INVERSE = len(CAMERA.inv_poly)
C, D, E = AFFINE
OCAM_TXT = f"""#polynomial coefficients for the DIRECT mapping function

3 {POLY}

#polynomial coefficients for the inverse mapping function

{N_INVERSE} {INVERSE}

#center: "row" and "column", starting from 0 (C convention)

{CENTER[1]} {CENTER[0]}

#affine parameters "c", "d", "e"

{C} {D} {E}

#image size: "height" and "width"

{SIZE[1]} {SIZE[0]}
"""
# The published rig: four cameras on a square, looking outwards, in centimetres, the first is the frame.
POSES_TXT = "0 0 0 0 0 0\n0 1.570796 0 20 0 -20\n0 3.141593 0 0 0 -40\n0 -1.570796 0 -20 0 -20\n"
DOUBLE_SPHERE = {"fx": 225.0, "fy": 222.6, "cx": 400.0, "cy": 380.0, "xi": -0.28, "alpha": 0.57}
RAYS = np.random.default_rng(3).normal(size=(300, 3))


def write(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content)
    return path


def ocam_folder(folder, cameras=4, poses=POSES_TXT):
    for i in range(cameras):
        write(folder / f"ocam{i + 1}.txt", OCAM_TXT)
    write(folder / "poses.txt", poses)
    return folder


def same_camera(a, b):
    for exact in (False, True):
        ours, valid = a.project(RAYS, exact=exact)
        theirs, valid_too = b.project(RAYS, exact=exact)
        np.testing.assert_allclose(ours[valid], theirs[valid], atol=1e-9)
        assert (valid == valid_too).all()


# --- OCamCalib text files ---


def test_ocam_file_is_row_and_column_low_to_high(tmp_path):
    """The whole chain by hand, in the file's own axes."""
    camera = read_ocam_txt(write(tmp_path / "ocam1.txt", OCAM_TXT), 220)
    assert camera.image_size == SIZE and camera.center == CENTER and camera.max_fov_deg == 220
    X, Y, Z = 0.5, 0.3, -0.05
    t = np.arctan2(-Z, np.hypot(X, Y))
    rho = sum(b * t**k for k, b in enumerate(CAMERA.inv_poly))
    x, y = rho * Y / np.hypot(X, Y), rho * X / np.hypot(X, Y)  # x runs along the rows' index, y along the columns'
    row, column = C * x + D * y + CENTER[1], E * x + y + CENTER[0]
    uv, valid = camera.project([X, Y, Z])
    assert valid
    np.testing.assert_allclose(uv, [column, row], atol=1e-9)


def test_ocam_file_round_trip_is_exact(tmp_path):
    write_ocam_txt(CAMERA, tmp_path / "camera.txt")
    back = OcamCamera.load(tmp_path / "camera.txt", max_fov_deg=220)
    np.testing.assert_array_equal(back.poly, CAMERA.poly)
    np.testing.assert_array_equal(back.inv_poly, CAMERA.inv_poly)
    assert (back.center, back.affine, back.image_size) == (CAMERA.center, CAMERA.affine, CAMERA.image_size)
    assert [path.name for path in tmp_path.iterdir()] == ["camera.txt"]


@pytest.mark.parametrize(
    "text",
    [
        OCAM_TXT + "\n\n#mask\n1 2 3 4\nsome words\n",
        OCAM_TXT.replace("\n3 -", "\n3.0 -").replace(f"{N_INVERSE} {INVERSE}", f"{N_INVERSE}.0 {INVERSE}"),
        OCAM_TXT.replace("\n\n", "\n"),
        OCAM_TXT.replace("\n", "\r\n"),
        OCAM_TXT.replace(f"{SIZE[1]} {SIZE[0]}", f"{SIZE[1]}.0 {SIZE[0]}.0  # trailing"),
    ],
    ids=["trailing data", "float counts", "no blank lines", "windows", "float size"],
)
def test_ocam_file_variants(tmp_path, text):
    same_camera(read_ocam_txt(write(tmp_path / "ocam.txt", text), 220), CAMERA)


@pytest.mark.parametrize("empty", ["", "0"])
def test_a_missing_inverse_polynomial_is_fitted(tmp_path, empty):
    text = OCAM_TXT.replace(f"{N_INVERSE} {INVERSE}", empty)
    camera = read_ocam_txt(write(tmp_path / "ocam.txt", text), 220)
    theta = np.radians(np.linspace(0, 110, 50))
    uv, _ = camera.project(np.stack([np.sin(theta), 0 * theta, np.cos(theta)], -1))
    np.testing.assert_allclose(uv[:, 0], 2 * F * np.tan(theta / 2) + CENTER[0], atol=0.02)


def test_polynomials_that_disagree_are_told(tmp_path):
    worse = OCAM_TXT.replace(repr(CAMERA.inv_poly[0].item()), repr(CAMERA.inv_poly[0].item() + 1.5))
    with pytest.warns(UserWarning, match=r"ocam7.txt: .* disagree by up to 1.50 px.*uses inv_poly"):
        camera = read_ocam_txt(write(tmp_path / "ocam7.txt", worse), 220)
    straight = np.array([1.0, 0, 0])
    assert camera.project(straight)[0][0] - CAMERA.project(straight)[0][0] == pytest.approx(1.5)
    close = OCAM_TXT.replace(repr(CAMERA.inv_poly[0].item()), repr(CAMERA.inv_poly[0].item() + 0.09))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_ocam_txt(write(tmp_path / "ocam8.txt", close), 220)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "found 0 records, expected 5"),
        (OCAM_TXT[: OCAM_TXT.index("#affine")], "found 3 records.*cut short"),
        (OCAM_TXT.replace("\n3 ", "\n4 "), "direct polynomial must be its number of coefficients.*cut short"),
        (OCAM_TXT.replace(f"\n{N_INVERSE} ", "\n-1 "), "inverse polynomial must be its number"),
        (OCAM_TXT.replace(f"{C} {D} {E}", f"{C} {D}"), "affine map c d e must be 3 numbers, found 2"),
        (OCAM_TXT.replace(f"{C} {D} {E}", f"{C} {D} five"), "affine map c d e must be numbers, found .*five"),
        (OCAM_TXT.replace(f"{C} {D} {E}", f"{C} {D} nan"), "finite"),
        (OCAM_TXT.replace(f"{SIZE[1]} {SIZE[0]}", "768.5 800"), "whole numbers"),
        (OCAM_TXT.replace(f"{SIZE[1]} {SIZE[0]}", f"{SIZE[1]} 80"), "lies outside the image.*cut short"),
        (OCAM_TXT.replace("\n3 -", "\n3 "), "must start below 0"),
        (OCAM_TXT.replace(f"{N_INVERSE} {INVERSE}", "3 400 -20 -3"), "inverse polynomial must grow.*Lower max_fov_deg"),
        (OCAM_TXT.replace(f"3 {POLY}", "3 -140 0 -0.001"), "reaches only"),
        ("\x00\xff\x89PNG\n" * 9, "must be numbers"),
    ],
)
def test_broken_ocam_files(tmp_path, text, message):
    with pytest.raises(OmnistereoError, match=rf"(?s)ocam.txt: .*{message}"):
        read_ocam_txt(write(tmp_path / "ocam.txt", text), 220)


def test_a_missing_file_and_a_folder_instead(tmp_path):
    with pytest.raises(OmnistereoError, match=r"none.txt cannot be read: No such file"):
        read_ocam_txt(tmp_path / "none.txt", 220)
    with pytest.raises(OmnistereoError, match="cannot be read: Is a directory"):
        read_ocam_txt(tmp_path, 220)


def only_our_error(read, path, content):
    """Read a damaged file: either it is refused by the library's own error, or what comes out works."""
    path.write_bytes(content)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # polynomials that disagree
        try:
            loaded = read(path)
        except OmnistereoError as error:
            assert path.name in str(error) and len(str(error)) < 2000
            return
    for camera in loaded.cameras if isinstance(loaded, Rig) else [loaded]:
        uv, valid = camera.project(RAYS)
        assert np.isfinite(uv[valid]).all()
        assert np.isfinite(camera.unproject(uv)[0]).all()


@pytest.fixture(scope="module")
def scratch(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz")


fuzz = settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
damages = st.lists(st.tuples(st.floats(0, 1), st.binary(min_size=1, max_size=4)), max_size=4)


def damaged(content, keep, damage):
    content = bytearray(content[: int(keep * len(content))])
    for where, what in damage:
        at = int(where * len(content))
        content[at : at + len(what)] = what
    return bytes(content)


@settings(fuzz, max_examples=len(OCAM_TXT))
@given(st.integers(0, len(OCAM_TXT)))
def test_an_ocam_file_cut_anywhere(scratch, end):
    only_our_error(lambda path: read_ocam_txt(path, 220), scratch / "cut.txt", OCAM_TXT[:end].encode())


@settings(fuzz, max_examples=400)
@given(st.floats(0.5, 1), damages, st.sampled_from([60.0, 220.0, 360.0]))
def test_an_ocam_file_with_any_damage(scratch, keep, damage, fov):
    content = damaged(OCAM_TXT.encode(), keep, damage)
    only_our_error(lambda path: read_ocam_txt(path, fov), scratch / "damaged.txt", content)


@settings(fuzz, max_examples=200)
@given(st.lists(st.lists(st.floats() | st.integers() | st.text(max_size=5), max_size=8), max_size=7))
def test_an_ocam_file_of_any_numbers(scratch, records):
    text = "\n".join(" ".join(map(str, [len(record), *record])) for record in records)
    only_our_error(lambda path: read_ocam_txt(path, 220), scratch / "any.txt", text.encode())


# --- folder of text files ---


@pytest.mark.parametrize(("unit", "scale"), [("mm", 1e-3), ("cm", 1e-2), ("m", 1.0)])
def test_ocam_folder(tmp_path, unit, scale, caplog):
    with caplog.at_level(logging.INFO, "omnistereo_lib"):
        rig = Rig.load(ocam_folder(tmp_path), unit)
    assert len(rig) == 4 and f"OCamCalib text files in {unit}, 4 cameras" in caplog.text
    np.testing.assert_allclose(rig.centers, scale * np.array([[0, 0, 0], [20, 0, -20], [0, 0, -40], [-20, 0, -20]]))
    assert rig.cameras[0].max_fov_deg == 220
    assert Rig.load(tmp_path, unit, max_fov_deg=190).cameras[3].max_fov_deg == 190
    # Camera -> rig: the second camera looks along the rig's +x.
    np.testing.assert_allclose(rig.T_rig_cam[1].R @ [0, 0, 1], [1, 0, 0], atol=1e-6)


def test_the_unit_is_not_guessed(tmp_path):
    with pytest.raises(
        OmnistereoError, match=r"(?s)poses.txt: .*not state its unit.*mm.*0.02828 … 0.04 m.*cm.*0.2828 … 0.4"
    ):
        Rig.load(ocam_folder(tmp_path))
    with pytest.raises(OmnistereoError, match=r"unit must be one of \['mm', 'cm', 'm'\], got 'inch'"):
        Rig.load(tmp_path, "inch")
    with pytest.raises(OmnistereoError, match="max_fov_deg must be in"):
        Rig.load(tmp_path, "cm", max_fov_deg=0)


def test_ten_cameras_are_in_the_order_of_their_numbers(tmp_path):
    ocam_folder(tmp_path, cameras=11, poses="".join(f"0 0 0 {i} 0 0\n" for i in range(11)))
    write(tmp_path / "ocam10.txt", OCAM_TXT.replace(f"{CENTER[1]} {CENTER[0]}", "300 300"))
    rig = Rig.load(tmp_path, "m")
    assert [camera.center == (300, 300) for camera in rig.cameras].index(True) == 9


@pytest.mark.parametrize(
    ("poses", "message"),
    [
        (POSES_TXT.replace("20 0 -20", "20 0"), "poses.txt: camera 2: .*6 numbers, found 5"),
        (POSES_TXT.replace("0 3.141593 0", "0 nan 0"), "camera 3: .*finite"),
        (POSES_TXT.replace("0 3.141593 0", "0 180 0"), "camera 3: .*more than a turn: radians"),
        (POSES_TXT.replace("20 0 -20", "20 0 x"), "camera 2: .*must be numbers"),
        ("0 0 0 0 0 0\n", r"found 1 poses and 4 camera files \(ocam1.txt, "),
        ("", "found 0 poses"),
    ],
)
def test_broken_poses_name_the_camera(tmp_path, poses, message):
    with pytest.raises(OmnistereoError, match=message):
        Rig.load(ocam_folder(tmp_path, poses=poses), "cm")


def test_one_camera_is_no_rig(tmp_path):
    with pytest.raises(OmnistereoError, match="two or more cameras"):
        Rig.load(ocam_folder(tmp_path, cameras=1, poses="0 0 0 0 0 0"), "cm")
    with pytest.raises(OmnistereoError, match=r"ocam1.txt: .*give its folder"):
        Rig.load(tmp_path / "ocam1.txt", "cm")
    (tmp_path / "poses.txt").unlink()
    with pytest.raises(OmnistereoError, match=r"poses.txt cannot be read"):
        Rig.load(tmp_path, "cm")


# --- config.yaml (OmniMVS) ---


def omnimvs(**changes):
    """As the dialect's files look: counts that are floats, numbers that YAML takes for words."""
    camera = {
        "cam_id": 1,
        "model": "ocam",
        "poly": [3.0, *CAMERA.poly.tolist()],
        "inv_poly": [N_INVERSE, *CAMERA.inv_poly.tolist()],
        "center": [CENTER[1], CENTER[0]],
        "affine": [C, D, str(E)],
        "image_size": [SIZE[1], SIZE[0]],
        "invalid_mask": "mask1.png",
        "max_fov": 200.0,
    }
    poses = [[0, 0, 0, 0, 0, 0.6], [0, np.pi / 2, 0, 0.6, 0, 0], [0, np.pi, 0, 0, 0, -0.6]]
    cameras = [camera | {"pose": pose, "invalid_mask": f"mask{i + 1}.png"} for i, pose in enumerate(poses)]
    return {"config": {"omnimvs_sweep_min_depth": 1.65}, "dataset": {"start": 1}, "cameras": cameras} | changes


def dump(path, data):
    return write(path, json.dumps(data) if path.suffix == ".json" else yaml.safe_dump(data))


def test_omnimvs_config(tmp_path, caplog):
    mask = np.zeros(SIZE[::-1], np.uint8)
    mask[:, :300] = 1  # the released code writes 0 and 1
    cv2.imwrite(str(tmp_path / "mask2.png"), mask)
    with caplog.at_level(logging.INFO, "omnistereo_lib"):
        rig = Rig.load(dump(tmp_path / "config.yaml", omnimvs()))
    assert "OmniMVS config.yaml, 3 cameras" in caplog.text
    assert rig.min_depth == 1.65 and rig.cameras[0].max_fov_deg == 200
    np.testing.assert_allclose(rig.centers, [[0, 0, 0.6], [0.6, 0, 0], [0, 0, -0.6]], atol=1e-15)
    same_camera(rig.cameras[0], stereographic(max_fov_deg=200))
    assert rig.cameras[0].mask is None
    np.testing.assert_array_equal(rig.cameras[1].mask, mask == 0)  # true is outside
    assert Rig.load(tmp_path).min_depth == 1.65
    assert Rig.load(tmp_path, unit="m", max_fov_deg=150).cameras[0].max_fov_deg == 150
    with pytest.raises(OmnistereoError, match="in metres by definition; leave out unit='cm'"):
        Rig.load(tmp_path, unit="cm")


def test_a_folder_with_both_dialects(tmp_path):
    """The published folders have both, and their metric scales differ by three."""
    dump(ocam_folder(tmp_path) / "config.yaml", omnimvs())
    assert len(Rig.load(tmp_path)) == 3
    assert len(Rig.load(tmp_path, "cm")) == 4


def broken_omnimvs(key, value):
    data = omnimvs()
    data["cameras"][1][key] = value
    return data


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (broken_omnimvs("poly", [7, 1, 2]), "config.yaml: camera 2: the direct polynomial must be its number"),
        (broken_omnimvs("center", [1]), r"camera 2: the centre \(row, column\) must be 2 numbers"),
        (broken_omnimvs("center", {"row": 1}), r"camera 2: the centre .* must be numbers, found \{'row': 1\}"),
        (broken_omnimvs("pose", [0, 0, 0, float("nan"), 0, 0]), "camera 2: .*finite"),
        (broken_omnimvs("pose", None), "camera 2"),
        (broken_omnimvs("max_fov", "wide"), "camera 2: max_fov must be numbers, found 'wide'"),
        (broken_omnimvs("max_fov", 500), r"camera 2: .*max_fov_deg"),
        (broken_omnimvs("image_size", [10**400, 3]), "camera 2: the image size .*numbers"),
        (omnimvs(cameras=[omnimvs()["cameras"][0]]), "config.yaml: a rig needs two or more"),
        (omnimvs(cameras=[*omnimvs()["cameras"], 5]), "camera 4: found 5 where entries such as 'poly'"),
        (omnimvs(cameras=[{"poly": [1, 2]}, {}]), r"camera 1: entry 'inv_poly' is missing, found \['poly'\]"),
        (omnimvs(config={"omnimvs_sweep_min_depth": "near"}), "omnimvs_sweep_min_depth must be numbers"),
    ],
)
def test_broken_omnimvs_configs(tmp_path, data, message):
    with pytest.raises(OmnistereoError, match=message):
        Rig.load(dump(tmp_path / "config.yaml", data))


def test_masks_that_do_not_fit(tmp_path):
    path = dump(tmp_path / "config.yaml", omnimvs())
    cv2.imwrite(str(tmp_path / "mask1.png"), np.zeros((30, 40), np.uint8))
    with pytest.raises(OmnistereoError, match=r"mask1.png is 40 × 30 px, the camera 800 × 760 px"):
        Rig.load(path)
    (tmp_path / "mask1.png").write_bytes(b"no picture")
    with pytest.raises(OmnistereoError, match=r"mask1.png is not an image"):
        Rig.load(path)


def test_saved_rigs_come_back(tmp_path):
    mask = np.random.default_rng(0).random(SIZE[::-1]) > 0.2
    poses = [Pose.from_vector(theta) for theta in np.random.default_rng(1).normal(size=(3, 6))]
    rig = Rig([CAMERA, stereographic(mask=mask), stereographic(max_fov_deg=123.4)], poses, min_depth=1 / 3)
    rig.save(tmp_path / "rig.yaml")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["rig.yaml", "rig_mask2.png"]
    back = Rig.load(tmp_path / "rig.yaml")
    assert back.min_depth == rig.min_depth
    for ours, theirs, T, T_too in zip(back.cameras, rig.cameras, back.T_rig_cam, poses, strict=True):
        np.testing.assert_array_equal(ours.poly, theirs.poly)
        np.testing.assert_array_equal(ours.inv_poly, theirs.inv_poly)
        for name in ("center", "affine", "image_size", "max_fov_deg"):
            assert getattr(ours, name) == getattr(theirs, name)
        np.testing.assert_allclose(T.R, T_too.R, atol=1e-15)
        np.testing.assert_array_equal(T.t, T_too.t)
    assert back.cameras[0].mask is None
    np.testing.assert_array_equal(back.cameras[1].mask, mask)
    rig.with_poses(poses).save(tmp_path / "rig.yaml")  # over itself
    Rig([CAMERA, CAMERA], poses[:2]).save(tmp_path / "rig.yaml")
    assert Rig.load(tmp_path / "rig.yaml").cameras[1].mask is None  # not the mask of the rig before


def test_saved_rigs_have_what_the_public_codes_read(tmp_path):
    """Released loaders take these entries by name and position."""
    Rig([CAMERA] * 4, [Pose.identity()] * 4, 0.55).save(tmp_path / "config.yaml")
    data = yaml.safe_load((tmp_path / "config.yaml").read_text())
    assert data["config"] == {"omnimvs_sweep_min_depth": 0.55} and "img_fmt" in data["dataset"]
    for i, camera in enumerate(data["cameras"], 1):
        assert camera["cam_id"] == i and camera["model"] == "ocam"
        assert camera["poly"][0] == len(camera["poly"]) - 1 and camera["inv_poly"][0] == len(camera["inv_poly"]) - 1
        assert camera["center"] == [CENTER[1], CENTER[0]] and camera["image_size"] == [SIZE[1], SIZE[0]]
        assert len(camera["pose"]) == 6 and camera["max_fov"] == 220 and camera["invalid_mask"].endswith(".png")


def test_saving_where_nothing_can_be_written(tmp_path):
    rig = Rig([CAMERA] * 2, [Pose.identity()] * 2)
    with pytest.raises(OmnistereoError, match=r"rig.yaml cannot be written: No such file"):
        save_rig(rig, tmp_path / "missing" / "rig.yaml")
    (tmp_path / "taken").mkdir()
    with pytest.raises(OmnistereoError, match="taken cannot be written"):
        save_rig(rig, tmp_path / "taken")
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]  # no half-written file stays


# --- basalt ---


def basalt(**changes):
    poses = [[0, 0, 0], [0, np.pi, 0.1]]
    T_imu_cam = [
        dict(zip(("qx", "qy", "qz", "qw"), Rotation.from_rotvec(r).as_quat().tolist(), strict=True))
        | {"px": 0.1 * i, "py": 0.0, "pz": -0.06 * i}
        for i, r in enumerate(poses)
    ]
    lens = {"camera_type": "ds", "intrinsics": DOUBLE_SPHERE}
    value = {"T_imu_cam": T_imu_cam, "intrinsics": [lens, lens], "resolution": [list(SIZE)] * 2}
    return {"value0": value | changes}


def test_basalt(tmp_path, caplog):
    mask = np.zeros(SIZE[::-1], np.uint8)
    cv2.circle(mask, (400, 380), 300, 255, -1)
    (tmp_path / "cam1").mkdir()
    cv2.imwrite(str(tmp_path / "cam1" / "mask.png"), mask)
    with caplog.at_level(logging.INFO, "omnistereo_lib"):
        rig = Rig.load(dump(tmp_path / "calibration.json", basalt()))
    assert "basalt JSON, 2 cameras" in caplog.text and "camera 1: ds fitted by OCam" in caplog.text
    T = rig.T_rig_cam[1]  # camera -> rig as stored: nothing is inverted
    np.testing.assert_allclose(T.R, Rotation.from_rotvec([0, np.pi, 0.1]).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(T.t, [0.1, 0, -0.06])
    np.testing.assert_array_equal(rig.cameras[1].mask, mask == 255)  # bright is inside
    assert rig.cameras[0].mask is None
    uv, valid = rig.cameras[0].project(RAYS)
    assert valid.any()
    np.testing.assert_allclose(uv[valid], double_sphere(RAYS, **DOUBLE_SPHERE)[0][valid], atol=0.02)
    assert Rig.load(tmp_path).baselines[0] == pytest.approx(np.hypot(0.1, 0.06))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"intrinsics": [{"camera_type": "fov", "intrinsics": {}}] * 2}, "camera 0: no lens model 'fov'.*known are"),
        ({"intrinsics": [{"camera_type": "ds", "intrinsics": {"fx": 1.0}}] * 2}, "camera 0: .*needs the parameters"),
        ({"intrinsics": [{"camera_type": "ds", "intrinsics": DOUBLE_SPHERE | {"xi": "a"}}] * 2}, "xi must be numbers"),
        ({"intrinsics": [{"camera_type": "ds", "intrinsics": 3}] * 2}, "needs the parameters"),
        ({"resolution": [list(SIZE)]}, "found 2 poses, 2 intrinsics and 1 resolutions"),
        ({"resolution": [[0, 0]] * 2}, "camera 0"),
        ({"T_imu_cam": [{"qx": 0}] * 2}, "camera 0: entry 'qy' is missing"),
        ({"T_imu_cam": [dict.fromkeys(("px", "py", "pz", "qx", "qy", "qz", "qw"), 0)] * 2}, "length 0, expected 1"),
        ({"T_imu_cam": 7}, "'T_imu_cam' must be a list, found 7"),
    ],
)
def test_broken_basalt_files(tmp_path, changes, message):
    with pytest.raises(OmnistereoError, match=f"(?s)calibration.json: .*{message}"):
        Rig.load(dump(tmp_path / "calibration.json", basalt(**changes)))


# --- Kalibr ---

FOCAL = [300.0, 299.0, 400.0, 380.0]


def kalibr(*chain, **first):
    """A chain of double sphere cameras; `chain` holds T_cn_cnm1, `first` replaces entries of cam0."""
    lens = {"camera_model": "ds", "intrinsics": [-0.28, 0.57, *FOCAL], "distortion_model": "none"}
    lens |= {"distortion_coeffs": [], "resolution": list(SIZE), "rostopic": "/cam"}
    cameras = {f"cam{n}": lens | {"T_cn_cnm1": T.tolist()} for n, T in enumerate(chain, 1)}
    return {"cam0": lens | first} | cameras


def matrix(rotvec, t):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(rotvec).as_matrix(), t
    return T


def test_kalibr_chain_is_inverted(tmp_path, caplog):
    T10, T21 = matrix([0, 1.5, 0.1], [0.1, 0, 0.2]), matrix([0.2, -1, 0], [-0.3, 0.1, 0])
    with caplog.at_level(logging.INFO, "omnistereo_lib"):
        rig = Rig.load(dump(tmp_path / "camchain.yaml", kalibr(T10, T21)))
    assert "Kalibr camchain, 3 cameras" in caplog.text
    point = np.array([0.3, -0.2, 2.0, 1.0])  # in camera 0, which is the rig's frame
    for pose, T in zip(rig.T_rig_cam, (np.eye(4), T10, T21 @ T10), strict=True):
        np.testing.assert_allclose(pose @ (T @ point)[:3], point[:3], atol=1e-12)


@pytest.mark.parametrize(
    ("entries", "project"),
    [
        ({}, lambda X: double_sphere(X, *FOCAL, xi=-0.28, alpha=0.57)),
        (
            {"camera_model": "pinhole", "intrinsics": FOCAL, "distortion_model": "equidistant"}
            | {"distortion_coeffs": [-0.01, 0.003, -0.002, 0.0001]},
            lambda X: kannala_brandt(X, *FOCAL, -0.01, 0.003, -0.002, 0.0001),
        ),
        (
            {"camera_model": "omni", "intrinsics": [1.5, *FOCAL], "distortion_model": "radtan"}
            | {"distortion_coeffs": [-0.01, 0.002, 1e-5, -1e-5]},
            lambda X: omni(X, *FOCAL, 1.5, -0.01, 0.002, 1e-5, -1e-5),
        ),
        ({"camera_model": "omni", "intrinsics": [1.5, *FOCAL]}, lambda X: omni(X, *FOCAL, xi=1.5)),
    ],
    ids=["ds", "pinhole-equidistant", "omni-radtan", "omni-none"],
)
def test_kalibr_models(tmp_path, entries, project):
    rig = Rig.load(dump(tmp_path / "camchain.yaml", kalibr(np.eye(4), **entries)))
    uv, valid = rig.cameras[0].project(RAYS)
    assert valid.mean() > 0.2
    np.testing.assert_allclose(uv[valid], project(RAYS)[0][valid], atol=0.05)


def test_what_a_polynomial_cannot_follow_is_told(tmp_path):
    lens = {"camera_model": "omni", "intrinsics": [1.5, *FOCAL], "distortion_model": "radtan"}
    lens |= {"distortion_coeffs": [0.0, 0.0, 2e-3, 0.0]}
    with pytest.warns(UserWarning, match=r"camchain.yaml, cam0: .* px away from the file's omni lens.*Tangential"):
        Rig.load(dump(tmp_path / "camchain.yaml", kalibr(np.eye(4), **lens)))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (
            kalibr(np.eye(4), distortion_model="radtan"),
            r"cam0: camera_model \+ distortion_model ds \+ radtan is not read",
        ),
        (kalibr(np.eye(4), intrinsics=[1, 2]), "cam0: intrinsics must be 6 numbers, found 2"),
        (kalibr(2 * np.eye(4)), "cam1: the pose's last row"),
        (kalibr(np.diag([2.0, 2, 2, 1])), "cam1: R is not a rotation"),
        (kalibr(np.full((4, 4), np.nan)), "cam1: .*finite"),
        (kalibr(np.eye(3)), "cam1: the 4 × 4 pose must be 16 numbers, found 9"),
        ({**kalibr(), "cam1": kalibr()["cam0"]}, "cam1: entry 'T_cn_cnm1' is missing"),
        ({**kalibr(), "cam2": kalibr()["cam0"]}, "cam2: expected cam1 here"),
        (kalibr(), "two or more cameras"),
    ],
)
def test_broken_kalibr_files(tmp_path, data, message):
    with pytest.raises(OmnistereoError, match=f"camchain.yaml: .*{message}"):
        Rig.load(dump(tmp_path / "camchain.yaml", data))


# --- OpenCV fisheye ---

K = np.array([[200.0, 0, 400], [0, 199, 380], [0, 0, 1]])
D4 = np.array([-0.011, 0.004, -0.0021, 0.0003])
R2, T2 = Rotation.from_rotvec([0.1, 1.4, 0]).as_matrix(), np.array([12.0, 0.5, -3.0])  # rig -> camera, centimetres


def opencv_file(path, **values):
    """Written by OpenCV itself; a dictionary becomes a mapping, a tuple a sequence."""
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        if isinstance(value, dict):
            file.startWriteStruct(name, cv2.FileNode_MAP)
            for key, inner in value.items():
                file.write(key, inner)
            file.endWriteStruct()
        elif isinstance(value, tuple):
            file.startWriteStruct(name, cv2.FileNode_SEQ | cv2.FileNode_FLOW)
            for inner in value:
                file.write("", inner)
            file.endWriteStruct()
        else:
            file.write(name, value)
    file.release()
    return path


LAYOUTS = {
    "stereo pair": {"image_size": SIZE, "K1": K, "D1": D4, "K2": K, "D2": D4, "R": R2, "T": T2.reshape(3, 1)},
    "numbered": {
        **{"image_width": SIZE[0], "image_height": SIZE[1], "camera_matrix_0": K, "dist_coeffs_0": D4},
        **{"camera_matrix_1": K, "dist_coeffs_1": D4, "rvec_1": cv2.Rodrigues(R2)[0], "tvec_1": T2},
    },
    "one mapping each": {
        "left": {"cameraMatrix": K, "distCoeffs": D4, "image_width": SIZE[0], "image_height": SIZE[1]},
        "right": {"K": K, "D": D4, "R": R2, "t": T2, "image_width": SIZE[0], "image_height": SIZE[1]},
    },
}


@pytest.mark.parametrize("header", ["%YAML 1.2", "%YAML:1.0"])  # of OpenCV 5, and of those before: no YAML
@pytest.mark.parametrize("layout", LAYOUTS)
def test_opencv_layouts(tmp_path, layout, header, caplog):
    path = opencv_file(tmp_path / "fisheye.yaml", **LAYOUTS[layout])
    path.write_text("\n".join([header, *path.read_text().splitlines()[1:]]))
    with caplog.at_level(logging.INFO, "omnistereo_lib"):
        rig = Rig.load(path, "cm")
    assert "OpenCV fisheye, 2 cameras" in caplog.text
    point = np.array([0.1, 0.2, 0.7])  # in the first camera, metres
    np.testing.assert_allclose(rig.T_rig_cam[1] @ (R2 @ point + T2 / 100), point, atol=1e-12)
    np.testing.assert_allclose(rig.T_rig_cam[0] @ point, point)
    ahead = RAYS[RAYS[:, 2] > 0.3]
    theirs, _ = cv2.fisheye.projectPoints(ahead.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), K, D4)
    uv, valid = rig.cameras[1].project(ahead)
    assert valid.mean() > 0.8
    np.testing.assert_allclose(uv[valid], theirs.reshape(-1, 2)[valid], atol=0.02)


def test_opencv_files_as_plain_yaml_lists(tmp_path):
    camera = {"K": K.tolist(), "D": D4.tolist(), "resolution": list(SIZE), "R": R2.tolist(), "T": T2.tolist()}
    rig = Rig.load(dump(tmp_path / "rig.yaml", {"cameras": [camera, camera, camera]}), "m")
    np.testing.assert_allclose(rig.centers, [-R2.T @ T2] * 3, atol=1e-12)


def test_opencv_files_need_a_unit(tmp_path):
    path = opencv_file(tmp_path / "fisheye.yaml", **LAYOUTS["stereo pair"])
    distance = np.linalg.norm(T2)
    with pytest.raises(OmnistereoError, match=rf"fisheye.yaml: .*not state its unit.*cm.*{distance / 100:.4g}"):
        Rig.load(path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"D2": np.zeros(5)}, "camera 2: D .* must be 4 numbers, found 5"),
        ({"K2": np.eye(2)}, "camera 2: K must be 9 numbers, found 4"),
        ({"K1": K.T}, "camera 1: K must be fx 0 cx"),
        ({"R": 1.1 * R2}, "camera 2: R is not a rotation"),
        ({"R": np.eye(2)}, "camera 2: R must be a 3 × 3 matrix or an axis-angle"),
        ({"T": np.full(3, np.nan)}, r"camera 2: T must be numbers, found \['.Nan'"),
        ({"image_size": (0, 0)}, "camera 1"),
        ({"K3": K}, "camera 2: entry 'R' is missing"),
    ],
)
def test_broken_opencv_files(tmp_path, changes, message):
    path = opencv_file(tmp_path / "fisheye.yaml", **LAYOUTS["stereo pair"] | changes)
    with pytest.raises(OmnistereoError, match=f"fisheye.yaml: .*{message}"):
        Rig.load(path, "cm")


# --- anything else ---


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("rig.yaml", "hello: 5", r"no known dialect, found the entries \['hello'\]; known are"),
        ("rig.yaml", "", "no known dialect"),
        ("rig.yaml", "- 1\n- 2", "no known dialect"),
        ("rig.yaml", "a: [1, 2", "neither sound JSON nor sound YAML"),
        ("rig.yaml", "!!python/object/apply:os.getcwd []", "neither sound JSON nor sound YAML"),
        ("rig.yaml", "[" * 20000, "neither sound JSON nor sound YAML"),
        ("rig.yaml", "when: 2020-99-99", "neither sound JSON nor sound YAML"),
        ("rig.json", "{'single': 1}", "neither sound JSON nor sound YAML"),
        ("rig.yaml", "cam0: 3", "no known dialect"),
        ("rig.yaml", "cameras: {}", "no known dialect"),
    ],
)
def test_unknown_files_list_what_is_known(tmp_path, name, text, message):
    with pytest.raises(OmnistereoError, match=rf"(?s){name}: {message}.*basalt JSON.*Kalibr.*OpenCV"):
        Rig.load(write(tmp_path / name, text))


def test_missing_files_and_empty_folders(tmp_path):
    with pytest.raises(OmnistereoError, match=r"nothing.yaml cannot be read"):
        Rig.load(tmp_path / "nothing.yaml")
    write(tmp_path / "notes.md", "")
    with pytest.raises(OmnistereoError, match=r"(?s)without ocam.*found \['notes.md'\]; known are"):
        Rig.load(tmp_path)


DIALECT_FILES = {
    "config.yaml": yaml.safe_dump(omnimvs()).encode(),
    "calibration.json": json.dumps(basalt()).encode(),
    "camchain.yaml": yaml.safe_dump(kalibr(matrix([0, 1, 0], [1, 0, 0]))).encode(),
    "opencv.yaml": yaml.safe_dump(
        {"K1": K.tolist(), "D1": D4.tolist(), "K2": K.tolist(), "D2": D4.tolist(), "R": R2.tolist(), "T": T2.tolist()}
        | {"image_size": list(SIZE)}
    ).encode(),
}


@settings(fuzz, max_examples=150)
@given(st.sampled_from(sorted(DIALECT_FILES)), st.floats(0.3, 1) | st.just(1.0), damages)
@example("calibration.json", 1.0, [])
def test_rig_files_with_any_damage(scratch, name, keep, damage):
    unit = "m" if name != "opencv.yaml" else "cm"
    content = damaged(DIALECT_FILES[name], keep, damage)
    only_our_error(lambda path: load_rig(path, unit), scratch / name, content)


def test_paths_may_be_text(tmp_path):
    dump(tmp_path / "config.yaml", omnimvs())
    assert len(load_rig(str(tmp_path / "config.yaml"))) == len(load_rig(Path(tmp_path)))
