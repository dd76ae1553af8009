"""Poses alone, of cameras whose intrinsics are given, and boards of which a part is seen."""

from dataclasses import replace

import boards
import numpy as np
import pytest
from boards import BOARD, CENTER, SIZE
from printed_boards import APRIL, APRIL_FILE, CHARUCO, F, photograph, print_april, print_charuco
from scene import refused

import omnistereo_lib as osl
from omnistereo_lib.geometry.camera import fit_inverse_polynomial
from omnistereo_rigs import calibrate_camera, calibrate_rig
from omnistereo_rigs.boards.captures import load_board, load_corners, save_corners
from omnistereo_rigs.boards.checkerboard import Checkerboard
from omnistereo_rigs.boards.detect import find_corners
from omnistereo_rigs.boards.marker_boards import AprilGrid, CharucoBoard
from omnistereo_rigs.boards.params import Intrinsics
from omnistereo_tools import cli


def given(roll_deg=0.0):
    """Return the lens of `boards` as a camera whose affine map rolls it, and that roll."""
    theta = np.linspace(1e-3, np.radians(108), 400)
    powers = np.array([0, *range(2, 15)])
    r = F * theta
    fit = np.linalg.lstsq((r[:, None] / r[-1]) ** powers, -r / np.tan(theta), rcond=None)[0]
    fit /= r[-1] ** powers
    poly = np.zeros(15)
    poly[powers] = fit
    a = np.radians(roll_deg)
    # A of a rolled equidistant lens is a rotation; files scale it to A[0, 0] = 1, and the radius by
    # the inverse.
    affine, scale = (1.0, np.tan(a), -np.tan(a)), np.cos(a)
    poly = poly * scale ** (1.0 - np.arange(15))
    inverse = fit_inverse_polynomial(poly, 210, 3 * max(SIZE), 1e-3)
    camera = osl.OcamCamera(poly, inverse, tuple(CENTER), affine, SIZE, 210)
    rotation = np.array([[np.cos(a), np.sin(a), 0], [-np.sin(a), np.cos(a), 0], [0, 0, 1]])
    return camera, osl.Pose(rotation, np.zeros(3))  # T_camera_lens


@pytest.mark.parametrize("roll_deg", [0.0, 25.0])
def test_the_optimiser_sees_the_same_camera(roll_deg):
    camera, T_camera_lens = given(roll_deg)
    points = np.random.default_rng(0).normal(size=(500, 3))
    expected, inside = boards.project(points)
    uv, valid = camera.project(points @ T_camera_lens.R.T)
    np.testing.assert_allclose(uv[valid & inside], expected[valid & inside], atol=5e-3)
    intrinsics, roll = Intrinsics.of_camera(camera)
    rays = intrinsics.rays(uv[valid])
    ours = points[valid] @ T_camera_lens.R.T @ roll.R.T
    np.testing.assert_allclose(rays, ours / np.linalg.norm(ours, axis=-1, keepdims=True), atol=1e-4)


@pytest.fixture(scope="module")
def seen():
    return boards.captures(np.random.default_rng(8), alone=2, shared=4, noise=0.05)


def test_poses_of_given_cameras_are_found(seen):
    """With few shared captures, too few for intrinsics, and affine maps that roll cameras."""
    cameras, rolls = zip(*(given(roll) for roll in (0, 25, 0, -40)), strict=True)
    rig, report = calibrate_rig(seen, BOARD, [SIZE] * 4, cameras=cameras)
    assert rig.cameras == cameras
    truth = [pose @ roll.inverse() for pose, roll in zip(boards.rig_poses(), rolls, strict=True)]
    for pose, there in zip(rig.T_rig_cam, truth, strict=True):
        angle, shift = ((truth[0].inverse() @ there).inverse() @ pose).magnitude()
        assert angle < 0.05 and shift < 1e-3
    assert report.rms_px == pytest.approx(0.05, abs=0.005)
    assert "4 cameras" in report.text()


def test_given_cameras_must_fit(seen):
    camera, _ = given()
    with refused("there are 1 given cameras for views of 4"):
        calibrate_rig(seen, BOARD, [SIZE] * 4, cameras=[camera])
    other = replace(camera, image_size=(640, 480), center=(320, 240))
    said = r"the images are 800 × 768 px, the given camera 640 × 480\. .* --size 800x768"
    with refused(f"camera 1: {said}"):
        calibrate_rig(seen, BOARD, [SIZE] * 4, cameras=[other] * 4)


AHEAD = osl.Pose.from_vector([0.2, 0.15, 0.1, -0.3, -0.25, 0.35])


@pytest.mark.parametrize(("border", "turn"), [(2, 0.0), (1, 2.0)])
def test_tags_are_found_where_they_are(border, turn):
    middle = osl.Pose(np.eye(3), APRIL.points.mean(axis=0))
    pose = AHEAD @ middle @ osl.Pose.from_vector([0, 0, turn, 0, 0, 0]) @ middle.inverse()
    corners = find_corners(photograph(*print_april(border), pose), APRIL)
    expected, inside = boards.project(pose @ APRIL.points)
    known = np.isfinite(corners[:, 0])
    assert known.sum() > 0.6 * inside.sum() > 40
    error = np.linalg.norm(corners - expected, axis=1)[known & inside]
    assert np.median(error) < 0.15 and np.quantile(error, 0.95) < 0.6


def test_tags_are_counted_from_the_first_of_the_board():
    board = replace(APRIL, start=16)
    corners = find_corners(photograph(*print_april(2, start=16), AHEAD), board)
    expected, inside = boards.project(AHEAD @ board.points)
    known = np.isfinite(corners[:, 0])
    assert known.sum() > 0.6 * inside.sum()
    assert np.median(np.linalg.norm(corners - expected, axis=1)[known]) < 0.15


def test_chessboard_corners_between_markers():
    corners = find_corners(photograph(*print_charuco(), AHEAD), CHARUCO)
    expected, _ = boards.project(AHEAD @ CHARUCO.points)
    known = np.isfinite(corners[:, 0])
    assert known.mean() > 0.6
    assert np.median(np.linalg.norm(corners - expected, axis=1)[known]) < 0.15


def test_a_part_of_a_board_counts():
    """Half of the board is beyond the rim of the lens."""
    page, margin = print_april(2)
    turn = osl.Pose.from_vector([0, np.radians(88), 0, 0, 0, 0])
    pose = turn @ osl.Pose.from_vector([0, 0, 0, -0.35, -0.3, 0.35])
    corners = find_corners(photograph(page, margin, pose), APRIL)
    known = np.isfinite(corners[:, 0])
    assert 8 <= known.sum() < len(known)
    expected, _ = boards.project(pose @ APRIL.points)
    assert np.median(np.linalg.norm(corners - expected, axis=1)[known]) < 0.3
    assert find_corners(photograph(*print_charuco(), pose), APRIL) is None


def test_boards_of_files(tmp_path):
    target = tmp_path / "april.yaml"
    target.write_text(APRIL_FILE)
    assert load_board(target) == APRIL
    target.write_text(
        "target_type: 'checkerboard'\ntargetCols: 12\ntargetRows: 10\nrowSpacingMeters:"
        " 0.06\ncolSpacingMeters: 0.06\n"
    )
    assert load_board(target) == BOARD
    target.write_text(APRIL_FILE + "startId: 16\ntagFamily: t36h11\n")
    assert load_board(target) == replace(APRIL, start=16)
    unread = {
        "rowSpacingMeters is 0.06 and colSpacingMeters 0.0612": (
            "target_type: checkerboard\ntargetCols: 12\ntargetRows: 10\nrowSpacingMeters: 0.06\n"
            "colSpacingMeters: 0.0612\n"
        ),
        "tagFamily is 25h9; expected 36h11": APRIL_FILE + "tagFamily: 25h9\n",
        "firstTag: no such property": APRIL_FILE + "firstTag: 3\n",
        "startId is 16.5; expected an integer": APRIL_FILE + "startId: 16.5\n",
    }
    for message, text in unread.items():
        target.write_text(text)
        with refused(f"april.yaml: .*{message}"):
            load_board(target)
    target.write_text("target_type: 'circlegrid'\n")
    with refused(r"april.yaml: target_type is circlegrid; expected aprilgrid"):
        load_board(target)
    for board in (BOARD, APRIL, CHARUCO):
        corners = np.full((len(board.points), 2), np.nan)
        corners[:7] = 50.25
        saved = {"a": corners, 'a "quoted": name.jpg': corners + 1, "b": None}
        save_corners(tmp_path / "corners.yaml", saved, board, SIZE)
        views, read, size = load_corners(tmp_path / "corners.yaml")
        assert read == board and size == SIZE and list(views) == list(saved) and views["b"] is None
        for name in list(saved)[:2]:
            np.testing.assert_array_equal(views[name], saved[name])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: AprilGrid((0, 5), 0.08, 0.3), "the tags of an AprilGrid is 0"),
        (
            lambda: AprilGrid((6, 5), 88, 0.3),
            "the edge of a tag in metres is 88. For 88 mm pass 0.088, for 88 cm 0.88",
        ),
        (
            lambda: AprilGrid((6, 5), 0.088, 0.0264),
            "is 0.0264; expected .* 0.1 to 2. If it is in metres, pass 0.3",
        ),
        (lambda: Checkerboard((12, 10), 60), "metres. is 60. For 60 mm pass 0.06, for 60 cm 0.6"),
        (lambda: CharucoBoard((9, 7), 0.06, 0.07), "the marker"),
        (lambda: CharucoBoard((9, 7), 0.06, 0.045, "DICT_9X9"), "dictionary is 'DICT_9X9'"),
    ],
)
def test_boards_that_cannot_be(make, message):
    with refused(message):
        make()


def test_the_command_keeps_given_cameras(seen, tmp_path, capsys, monkeypatch):
    # which takes the longest
    monkeypatch.setattr("omnistereo_tools.outputs.save_figure", lambda *_, **__: None)
    names = [f"{k:03}" for k in range(len(seen[0]))]
    for i, row in enumerate(seen[:2], 1):
        save_corners(
            tmp_path / f"corners_cam{i}.yaml", dict(zip(names, row, strict=True)), BOARD, SIZE
        )
    camera, _ = given()
    # poses that are not used
    anywhere = [osl.Pose.from_vector([0, 0, 0, i, 0, 0]) for i in range(2)]
    osl.save_rig(osl.Rig((camera,) * 2, anywhere), tmp_path / "lenses.yaml")
    board = ["--board", "12x10", "--square", "0.06"]
    command = ["calibrate", str(tmp_path), "--out", str(tmp_path / "out")]
    assert cli.main([*command, *board, "--rig", str(tmp_path / "lenses.yaml")]) == 0
    rig = osl.load_rig(tmp_path / "out" / "config.yaml")
    np.testing.assert_array_equal(rig.cameras[1].inv_poly, camera.inv_poly)
    _, shift = (rig.T_rig_cam[0].inverse() @ rig.T_rig_cam[1]).magnitude()
    truth = boards.rig_poses()
    assert shift == pytest.approx((truth[0].inverse() @ truth[1]).magnitude()[1], abs=1e-3)
    assert cli.main([*command, "--board", "12x10"]) == 2
    assert (
        "found --board 12x10; expected columns x rows such as --board 12x10 --square 0.06"
        in capsys.readouterr().err
    )


def test_corners_beyond_the_field_of_view_are_told():
    views, _ = boards.views(np.random.default_rng(2), count=12)
    _, report = calibrate_camera(views, BOARD, SIZE, degree=4, max_fov_deg=150)
    assert any("the rim is cut off. Pass max_fov_deg = " in warning for warning in report.warnings)
