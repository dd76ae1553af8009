"""OCamCalib text files and OmniMVS config.yaml: conventions, variants, broken files."""

import logging

import cv2
import numpy as np
import pytest
import yaml
from numpy.polynomial import Polynomial
from rigs.formats.rig_file_samples import (
    AFFINE,
    CAMERA,
    CENTER,
    INVERSE,
    N_INVERSE,
    OCAM_TXT,
    POLY,
    POSES_TXT,
    SIZE,
    dump,
    ocam_folder,
    omnimvs,
    same_camera,
    stereographic,
    write,
)
from scene import refused

from omnistereo_lib import Pose, Rig, load_rig, save_rig
from omnistereo_lib.ocam_text import write_ocam_txt
from omnistereo_lib.rig_file import write_ocam_folder
from omnistereo_rigs.formats.read import read_any_camera, read_any_rig
from omnistereo_rigs.formats.write import export_rig

C, D, E = AFFINE


def test_ocam_file_is_row_and_column_low_to_high(tmp_path):
    """The whole chain by hand, in the file's own axes."""
    camera = read_any_camera(write(tmp_path / "ocam1.txt", OCAM_TXT), 220)
    assert camera.image_size == SIZE and camera.center == CENTER and camera.max_fov_deg == 220
    X, Y, Z = 0.5, 0.3, -0.05
    t = np.arctan2(-Z, np.hypot(X, Y))
    rho = sum(b * t**k for k, b in enumerate(CAMERA.inv_poly))
    # x runs along the rows' index, y along the columns'
    x, y = rho * Y / np.hypot(X, Y), rho * X / np.hypot(X, Y)
    row, column = C * x + D * y + CENTER[1], E * x + y + CENTER[0]
    uv, valid = camera.project([X, Y, Z])
    assert valid
    np.testing.assert_allclose(uv, [column, row], atol=1e-9)


def test_ocam_file_round_trip_is_exact(tmp_path):
    write_ocam_txt(CAMERA, tmp_path / "camera.txt")
    back = read_any_camera(tmp_path / "camera.txt", max_fov_deg=220)
    np.testing.assert_array_equal(back.poly, CAMERA.poly)
    np.testing.assert_array_equal(back.inv_poly, CAMERA.inv_poly)
    for name in ("center", "affine", "image_size"):
        assert getattr(back, name) == getattr(CAMERA, name)
    assert [path.name for path in tmp_path.iterdir()] == ["camera.txt"]


@pytest.mark.parametrize(
    "text",
    [
        OCAM_TXT + "\n\n#mask\n1 2 3 4\nsome words\n",
        OCAM_TXT.replace("\n3 -", "\n3.0 -").replace(
            f"{N_INVERSE} {INVERSE}", f"{N_INVERSE}.0 {INVERSE}"
        ),
        OCAM_TXT.replace("\n\n", "\n"),
        OCAM_TXT.replace("\n", "\r\n"),
        OCAM_TXT.replace(f"{SIZE[1]} {SIZE[0]}", f"{SIZE[1]}.0 {SIZE[0]}.0  # trailing"),
    ],
    ids=["trailing data", "float counts", "no blank lines", "windows", "float size"],
)
def test_ocam_file_variants(tmp_path, text):
    same_camera(read_any_camera(write(tmp_path / "ocam.txt", text), 220), CAMERA)


def inverse_of(turn, step=1):
    """Return the file with its inverse polynomial in another convention."""
    b = Polynomial(CAMERA.inv_poly)(turn(Polynomial([0, 1]))).coef[::step]
    return OCAM_TXT.replace(f"{N_INVERSE} {INVERSE}", f"{len(b)} {' '.join(map(repr, b.tolist()))}")


NO_INVERSE = r"\(inv_poly\) is not the inverse of poly.*leave inv_poly out"
BROKEN = [
    ("", "found 0 records; expected 5"),
    (OCAM_TXT[: OCAM_TXT.index("#affine")], "found 3 records.*complete"),
    (
        OCAM_TXT.replace("\n3 ", "\n4 "),
        "direct polynomial has 4 numbers .*expected the number of coef.*complete",
    ),
    (OCAM_TXT.replace(f"\n{N_INVERSE} ", "\n-1 "), "inverse polynomial has .* expected the number"),
    (OCAM_TXT.replace(f"{C} {D} {E}", f"{C} {D}"), "affine map c d e must be 3 numbers, found 2"),
    (
        OCAM_TXT.replace(f"{C} {D} {E}", f"{C} {D} five"),
        "affine map c d e must be numbers, found .*five",
    ),
    (OCAM_TXT.replace(f"{SIZE[1]} {SIZE[0]}", "768.5 800"), "expected an integer of 2 to 100000"),
    (
        OCAM_TXT.replace(f"{N_INVERSE} {INVERSE}", "3 400 -20 -3"),
        "inv_poly. is not the inverse of poly",
    ),
    (inverse_of(lambda t: t - np.pi / 2), NO_INVERSE),
    (inverse_of(lambda t: -t), NO_INVERSE),
    (inverse_of(lambda t: t * (np.pi / 180)), NO_INVERSE),
    (inverse_of(lambda t: t, step=-1), "inv_poly. is not the inverse of poly"),
    (
        OCAM_TXT.replace(f"\n3 {POLY}", "\n4 -205 1.9e-3 -1.1e-6 2.3e-9"),
        "a0 a2 a3 a4, put the missing 0",
    ),
    ("\x00\xff\x89PNG\n" * 9, "must be numbers"),
]


@pytest.mark.parametrize(("text", "message"), BROKEN)
def test_broken_ocam_files(tmp_path, text, message):
    with refused(rf"(?s)ocam.txt: .*{message}"):
        read_any_camera(write(tmp_path / "ocam.txt", text), 220)


@pytest.mark.parametrize(("unit", "scale"), [("mm", 1e-3), ("cm", 1e-2), ("m", 1.0)])
def test_ocam_folder(tmp_path, unit, scale, caplog):
    with caplog.at_level(logging.INFO, "omnistereo_lib"):
        rig = read_any_rig(ocam_folder(tmp_path), unit)
    assert len(rig) == 4 and f"OCamCalib text files in {unit}, 4 cameras" in caplog.text
    np.testing.assert_allclose(
        rig.centers, scale * np.array([[0, 0, 0], [20, 0, -20], [0, 0, -40], [-20, 0, -20]])
    )
    assert rig.cameras[0].max_fov_deg == 220
    assert read_any_rig(tmp_path, unit, max_fov_deg=190).cameras[3].max_fov_deg == 190
    # Camera -> rig: the second camera looks along the rig's +x.
    np.testing.assert_allclose(rig.T_rig_cam[1].R @ [0, 0, 1], [1, 0, 0], atol=1e-6)


def test_the_unit_is_not_guessed(tmp_path):
    with refused(r"(?s)not state its unit.*mm.*0.02828 to 0.04 m.*cm.*0.2828 to 0.4"):
        read_any_rig(ocam_folder(tmp_path))
    with refused(r"unit is 'inch'; expected one of \['mm', 'cm', 'm'\]"):
        read_any_rig(tmp_path, "inch")
    with refused("max_fov_deg is 0; expected a number of 10"):
        read_any_rig(tmp_path, "cm", max_fov_deg=0)


def test_ten_cameras_are_in_the_order_of_their_numbers(tmp_path):
    ocam_folder(tmp_path, cameras=11, poses="".join(f"0 0 0 {i} 0 0\n" for i in range(11)))
    write(tmp_path / "ocam10.txt", OCAM_TXT.replace(f"{CENTER[1]} {CENTER[0]}", "300 300"))
    rig = read_any_rig(tmp_path, "m")
    assert [camera.center == (300, 300) for camera in rig.cameras].index(True) == 9


@pytest.mark.parametrize(
    ("poses", "message"),
    [
        (
            POSES_TXT.replace("20 0 -20", "20 0"),
            "poses.txt: line 2, camera 2: .*6 numbers, found 5",
        ),
        (POSES_TXT.replace("0 3.141593 0", "0 nan 0"), "camera 3: .*finite"),
        (POSES_TXT.replace("0 3.141593 0", "0 180 0"), "camera 3: .*exceeds 2π; expected radians"),
        ("0 0 0 0 0 0\n", r"found 1 poses and 4 camera files \(ocam1.txt, "),
    ],
)
def test_broken_poses_name_the_camera(tmp_path, poses, message):
    with refused(message):
        read_any_rig(ocam_folder(tmp_path, poses=poses), "cm")


def test_one_camera_is_no_rig(tmp_path):
    with refused("at least 2 cameras"):
        read_any_rig(ocam_folder(tmp_path, cameras=1, poses="0 0 0 0 0 0"), "cm")
    with refused(r"ocam1.txt: .*Pass the folder of a rig"):
        read_any_rig(tmp_path / "ocam1.txt", "cm")
    (tmp_path / "poses.txt").unlink()
    with refused(r"poses.txt is missing"):
        read_any_rig(tmp_path, "cm")


def test_omnimvs_config(tmp_path, caplog):
    mask = np.zeros(SIZE[::-1], np.uint8)
    mask[:, :300] = 1  # the released code writes 0 and 1
    cv2.imwrite(str(tmp_path / "mask2.png"), mask)
    with refused(r"the masks mask1.png, mask3.png are named, but missing"):
        read_any_rig(dump(tmp_path / "config.yaml", omnimvs()))
    for name in ("mask1.png", "mask3.png"):
        cv2.imwrite(str(tmp_path / name), 0 * mask)
    with caplog.at_level(logging.INFO, "omnistereo_lib"):
        rig = read_any_rig(dump(tmp_path / "config.yaml", omnimvs()))
    assert "OmniMVS config.yaml, 3 cameras" in caplog.text
    assert rig.min_depth == 1.65 and rig.cameras[0].max_fov_deg == 200
    np.testing.assert_allclose(rig.centers, [[0, 0, 0.6], [0.6, 0, 0], [0, 0, -0.6]], atol=1e-15)
    same_camera(rig.cameras[0], stereographic(max_fov_deg=200))
    assert rig.cameras[0].mask.all()
    np.testing.assert_array_equal(rig.cameras[1].mask, mask == 0)  # true is outside
    assert read_any_rig(tmp_path).min_depth == 1.65
    assert read_any_rig(tmp_path, unit="m", max_fov_deg=150).cameras[0].max_fov_deg == 150
    with refused(r"their unit by definition\. Omit unit='cm'"):
        read_any_rig(tmp_path, unit="cm")


@pytest.mark.parametrize(("first", "second"), [("ocam2", "ocam02"), ("ocam1", "ocam01")])
def test_two_files_of_one_camera_are_refused(tmp_path, first, second):
    ocam_folder(tmp_path, 3, POSES_TXT)
    (tmp_path / f"{second}.txt").write_text((tmp_path / f"{first}.txt").read_text())
    for function in (load_rig, read_any_rig):
        with refused(f"{second}.txt and {first}.txt are of one camera"):
            function(tmp_path, "m")


def test_a_folder_with_both_formats(tmp_path):
    """The published folders have both, and their metric scales differ by three."""
    dump(ocam_folder(tmp_path) / "config.yaml", omnimvs())
    assert len(read_any_rig(tmp_path)) == 3
    assert len(read_any_rig(tmp_path, "cm")) == 4


def test_masks_that_do_not_fit(tmp_path):
    path = dump(tmp_path / "config.yaml", omnimvs())
    cv2.imwrite(str(tmp_path / "mask1.png"), np.zeros((30, 40), np.uint8))
    with refused(r"mask1.png is 40 × 30 px; the camera has 800 × 760 px"):
        read_any_rig(path)


def test_saved_rigs_come_back(tmp_path):
    mask = np.random.default_rng(0).random(SIZE[::-1]) > 0.2
    poses = [Pose.from_vector(theta) for theta in np.random.default_rng(1).normal(size=(3, 6))]
    rig = Rig(
        [CAMERA, stereographic(mask=mask), stereographic(max_fov_deg=123.4)], poses, min_depth=1 / 3
    )
    save_rig(rig, tmp_path / "rig.yaml")
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "rig.yaml",
        "rig_mask1.png",
        "rig_mask2.png",
        "rig_mask3.png",
    ]
    back = read_any_rig(tmp_path / "rig.yaml", keep_frame=True)
    assert back.min_depth == rig.min_depth
    for ours, theirs, T, T_too in zip(
        back.cameras, rig.cameras, back.T_rig_cam, poses, strict=True
    ):
        np.testing.assert_array_equal(ours.poly, theirs.poly)
        np.testing.assert_array_equal(ours.inv_poly, theirs.inv_poly)
        for name in ("center", "affine", "image_size", "max_fov_deg"):
            assert getattr(ours, name) == getattr(theirs, name)
        np.testing.assert_allclose(T.R, T_too.R, atol=1e-15)
        np.testing.assert_array_equal(T.t, T_too.t)
    assert back.cameras[0].mask.all()
    np.testing.assert_array_equal(back.cameras[1].mask, mask)
    save_rig(rig.with_poses(poses), tmp_path / "rig.yaml")  # over itself
    save_rig(Rig([CAMERA, CAMERA], poses[:2]), tmp_path / "rig.yaml")
    assert (
        read_any_rig(tmp_path / "rig.yaml").cameras[1].mask is None
    )  # not the mask of the rig before


def test_saved_rigs_have_what_the_public_codes_read(tmp_path):
    """Released loaders take these entries by name and position."""
    save_rig(Rig([CAMERA] * 4, [Pose.identity()] * 4, 0.55), tmp_path / "config.yaml")
    data = yaml.safe_load((tmp_path / "config.yaml").read_text())
    assert data["config"] == {"omnimvs_sweep_min_depth": 0.55} and "img_fmt" in data["dataset"]
    for i, camera in enumerate(data["cameras"], 1):
        assert camera["cam_id"] == i and camera["model"] == "ocam"
        assert camera["poly"][0] == len(camera["poly"]) - 1
        assert camera["inv_poly"][0] == len(camera["inv_poly"]) - 1
        assert camera["center"] == [CENTER[1], CENTER[0]]
        assert camera["image_size"] == [SIZE[1], SIZE[0]]
        assert len(camera["pose"]) == 6
        assert camera["max_fov"] == 220
        assert camera["invalid_mask"].endswith(".png")


def test_numpy_numbers_are_written_as_plain_numbers(tmp_path):
    camera = stereographic(
        center=tuple(np.float64(CENTER)),
        affine=tuple(np.float64([1, 0, 0])),
        image_size=tuple(np.int64(SIZE)),
        max_fov_deg=np.float64(200),
    )
    rig = Rig([camera] * 2, [Pose.identity()] * 2)
    write_ocam_folder(rig, tmp_path)
    save_rig(rig, tmp_path / "config.yaml")
    export_rig(rig, tmp_path)
    files = [path for path in tmp_path.rglob("*.*") if path.suffix != ".png"]
    written = {path.name: path.read_text() for path in files}
    assert len(written) == 11
    assert not [name for name, text in written.items() if "np." in text or "numpy" in text]


def test_a_copy_of_a_rig_without_masks_is_read_without_a_warning(tmp_path, recwarn):
    poses = Pose.identity(), Pose.from_vector([0, 1, 0, 0.2, 0, 0])
    save_rig(Rig([CAMERA] * 2, poses), tmp_path / "config.yaml")
    read_any_rig((tmp_path / "config.yaml").rename(tmp_path / "mine.yaml"))
    assert [str(warning.message) for warning in recwarn] == []
