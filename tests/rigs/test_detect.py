"""Corners of boards drawn by casting rays through lenses with closed-form projections."""

import re

import boards
import cv2
import numpy as np
import pytest
from boards import BOARD, CENTER, LENSES, SIZE
from scene import refused

from omnistereo_lib.geometry.pose import Pose
from omnistereo_rigs.boards import checkerboard
from omnistereo_rigs.boards.captures import load_corners, save_corners
from omnistereo_rigs.boards.checkerboard import (
    Checkerboard,
    edge_width,
    refine_corners,
    suggest_board,
)
from omnistereo_rigs.boards.detect import detect_views, find_corners

ODD_EVEN = Checkerboard((9, 6), 0.06)
SAMPLES = 4  # a side, rays through each pixel


def rays_of(uv, lens, center=CENTER):
    """Unit rays (..., 3) of pixels, NaN beyond the lens's reach: its closed form inverted."""
    radius, reach_deg = LENSES[lens]
    theta = np.linspace(0, np.radians(reach_deg), 20001)
    offset = uv - center
    r = np.linalg.norm(offset, axis=-1)
    angle = np.interp(r, radius(theta), theta, right=np.nan)
    return np.concatenate(
        [(np.sin(angle) / np.maximum(r, 1e-12))[..., None] * offset, np.cos(angle)[..., None]], -1
    )


def draw(pose, board=BOARD, lens="equidistant 210", seed=0, blur=0.5, noise=2.0):
    """A picture of the board at T_cam_board, uneven background, blurred and noisy."""
    width, height = SIZE
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    picture = 110 + 30 * np.sin(u / 90 + 1) * np.cos(v / 70) + 25 * u / width
    seen, _ = boards.project(pose @ around(board), lens)
    low = np.clip(np.floor(seen.min(axis=0)) - 3, 0, np.array(SIZE) - 1).astype(int)
    high = np.clip(np.ceil(seen.max(axis=0)) + 4, 1, SIZE).astype(int)
    patch = np.s_[low[1] : high[1], low[0] : high[0]]
    within = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
    total = np.zeros_like(picture[patch])
    for du in within:
        for dv in within:
            rays = rays_of(np.stack([u[patch] + du, v[patch] + dv], axis=-1), lens)
            total += shade(pose, board, rays, picture[patch])
    picture[patch] = total / SAMPLES**2
    picture = cv2.GaussianBlur(picture, None, blur) + np.random.default_rng(seed).normal(
        0, noise, picture.shape
    )
    return np.clip(np.round(picture), 0, 255).astype(np.uint8)


def shade(pose, board, rays, background):
    """Gray levels where rays meet the board: black between the first corners, a white margin."""
    columns, rows = board.corners
    front = rays @ pose.R[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (pose.t @ pose.R[:, 2]) / front
        x, y, _ = np.moveaxis(((rays * depth[..., None] - pose.t) @ pose.R) / board.square, -1, 0)
        black = (np.floor(x) + np.floor(y)) % 2 == 0
    black &= (x > -1) & (x < columns) & (y > -1) & (y < rows)
    sheet = (
        (x > -1.7) & (x < columns + 0.7) & (y > -1.7) & (y < rows + 0.7) & (front > 0) & (depth > 0)
    )
    light = 1 + 0.1 * np.tanh((x - y) / 10)
    return np.where(sheet, np.where(black, 35, 190) * light, background)


def around(board):
    """Points along the edge of the sheet, its margin included, in the board frame."""
    s = np.linspace(0, 1, 50)
    low, high = np.array([-1.7, -1.7]), np.array(board.corners) + 0.7
    x, y = np.concatenate([[s, 0 * s], [s, 0 * s + 1], [0 * s, s], [0 * s + 1, s]], axis=1)
    return board.square * np.column_stack(
        [low[0] + x * (high - low)[0], low[1] + y * (high - low)[1], 0 * x]
    )


def place(angle_deg, azimuth_deg=20.0, distance=0.8, board=BOARD, tilt=(0.2, -0.15, 0.1)):
    """T_cam_board with its middle so far from the axis, facing the camera but for a tilt."""
    there = Pose.from_vector([0, 0, np.radians(azimuth_deg), 0, 0, 0]) @ Pose.from_vector(
        [0, np.radians(angle_deg), 0, 0, 0, 0]
    )
    back = Pose.from_vector([0, 0, -np.radians(azimuth_deg), 0, 0, 0])
    facing = Pose.from_vector([*tilt, 0, 0, 0]) @ Pose(np.eye(3), -board.points.mean(axis=0))
    return there @ Pose(np.eye(3), [0, 0, distance]) @ back @ facing


def truth(pose, board=BOARD, lens="equidistant 210"):
    return boards.project(pose @ board.points, lens)[0]


def rms(found, expected, board=BOARD):
    """Root mean square distance in px, in the reading of the board that fits best."""
    off = [np.sum((found - expected[order]) ** 2, axis=1) for order in board.symmetries]
    return min(np.sqrt(np.mean(off, axis=1)))


@pytest.fixture(scope="module")
def picture():
    return draw(place(40))


@pytest.fixture(scope="module")
def corners(picture):
    return find_corners(picture, BOARD)


# --- The board


@pytest.mark.parametrize(
    ("size", "count"), [((12, 10), 2), ((9, 7), 2), ((9, 6), 1), ((6, 6), 4), ((7, 7), 2)]
)
def test_readings_are_turns_that_keep_the_colours(size, count):
    board = Checkerboard(size, 0.1)
    assert len(board.symmetries) == count
    assert (board.symmetries[0] == np.arange(size[0] * size[1])).all()
    for reading in board.symmetries:
        turn = board.symmetry_pose(reading)
        assert np.abs(turn @ board.points - board.points[reading]).max() < 1e-12
        # squares; an even sum is black
        middles = (turn @ (board.points + np.array([0.05, 0.05, 0])))[:, :2] / 0.1
        assert (
            np.floor(middles).sum(axis=1) % 2
            == np.floor(board.points[:, :2] / 0.1 + 0.5).sum(axis=1) % 2
        ).all()


# --- Corners


@pytest.mark.parametrize("angle_deg", [5, 45, 78])
def test_corners_are_found_to_a_few_hundredths_of_a_pixel(angle_deg):
    pose = place(angle_deg, azimuth_deg=10 * angle_deg)
    found = find_corners(draw(pose), BOARD)
    assert rms(found, truth(pose)) < 0.05 * np.sqrt(2)  # in u and v
    outwards = found - CENTER
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    error = min(
        (found - truth(pose)[order] for order in BOARD.symmetries), key=lambda e: np.mean(e**2)
    )
    # bent edges pull a little to the rim
    assert abs(np.mean(np.sum(error * outwards, axis=1))) < 0.04


@pytest.mark.parametrize(("angle_deg", "distance"), [(5, 0.5), (70, 1.0)])
def test_corners_in_noise_and_blur(angle_deg, distance):
    pose = place(angle_deg, distance=distance)
    found = find_corners(draw(pose, blur=1.2, noise=6.0), BOARD)
    assert rms(found, truth(pose)) < 0.1 * np.sqrt(2)


def test_corners_of_large_blurred_squares():
    """A window of a few pixels would hold nothing but the blur."""
    board = Checkerboard((6, 5), 0.06)
    pose = place(25, azimuth_deg=30, distance=0.35, board=board)
    found = find_corners(draw(pose, board, blur=1.5, noise=4.0), board)
    assert rms(found, truth(pose, board), board) < 0.1


def test_wrong_corners_of_the_detector_are_corrected_or_dropped(picture, corners):
    """By a whole square, as the detector errs, and by a little more than its window repairs."""
    rng = np.random.default_rng(0)
    start = corners + rng.normal(0, 0.3, corners.shape)
    wrong = rng.permutation(120)[:6]
    start[wrong[:3]] = corners[wrong[:3] - np.where(wrong[:3] % 12 == 0, -1, 1)]
    start[wrong[3:]] += 5.0
    found = refine_corners(picture, start, BOARD)
    assert np.nanmax(np.abs(found - corners)) < 0.3 and np.isfinite(found[:, 0]).sum() >= 118


def test_corners_are_right_handed_from_the_top_left(picture, corners):
    for image in (picture, picture[:, ::-1], picture[::-1, ::-1]):
        grid = find_corners(np.ascontiguousarray(image), BOARD).reshape(10, 12, 2)
        right, down = grid[0, 1] - grid[0, 0], grid[1, 0] - grid[0, 0]
        assert right[0] * down[1] - right[1] * down[0] > 0
        assert grid[0, 0].sum() < grid[-1, -1].sum()


def test_a_board_with_one_end_is_read_from_that_end():
    pose = place(30, board=ODD_EVEN)
    picture = draw(pose, ODD_EVEN)
    found = find_corners(picture, ODD_EVEN)
    assert rms(found, truth(pose, ODD_EVEN), ODD_EVEN) < 0.1
    turned = find_corners(np.ascontiguousarray(picture[::-1, ::-1]), ODD_EVEN)
    assert np.abs((np.array(SIZE) - 1 - turned) - found).max() < 0.1


def test_float_and_colour_images(picture, corners):
    for image in (picture.astype(float), np.dstack([picture] * 3), np.dstack([picture] * 4)):
        assert np.abs(find_corners(image, BOARD) - corners).max() < 1e-6


def test_where_no_whole_board_is():
    assert find_corners(draw(place(40), Checkerboard((9, 6), 0.06)), BOARD) is None
    cut = draw(place(40))
    cut[:, : int(find_corners(cut, BOARD)[:, 0].mean())] = 120
    assert find_corners(cut, BOARD) is None
    assert find_corners(np.full(SIZE[::-1], 128, np.uint8), BOARD) is None


def test_a_stain_moves_no_corner_far(picture, corners):
    for k in (0, 65, 119):
        stained = cv2.circle(picture.copy(), corners[k].round().astype(int).tolist(), 4, 90, -1)
        found = find_corners(stained, BOARD)
        if found is not None:  # OpenCV may refuse the board
            others = np.arange(120) != k
            assert np.nanmax(np.abs(found - corners)[others]) < 1.0


@pytest.mark.parametrize("blur", [0.5, 2.5])
def test_edges_are_as_wide_as_the_blur(blur):
    """A step through a Gaussian is σ √2π wide, contrast over slope; the pixel adds a little."""
    picture = draw(place(20, distance=0.6), blur=blur, noise=1.0)
    # variances of the pixel's square and of the difference over one pixel between pixels
    pixel = 1 / 12 + 2 / 12
    expected = np.sqrt(2 * np.pi * (blur**2 + pixel))
    assert edge_width(picture, find_corners(picture, BOARD), BOARD) == pytest.approx(
        expected, rel=0.15
    )


@pytest.mark.parametrize("kernel", [(9, 1), (1, 9)])
def test_a_motion_along_one_direction_is_seen(picture, corners, kernel):
    sharp = edge_width(picture, corners, BOARD)
    assert sharp < 2.6
    missing = np.where(np.arange(len(corners))[:, None] % 11 == 5, np.nan, corners)
    assert edge_width(picture, missing, BOARD) == pytest.approx(sharp, rel=0.05)
    assert edge_width(cv2.blur(picture, kernel), corners, BOARD) > 1.5 * sharp


@pytest.mark.parametrize(
    ("image", "said"),
    [
        (np.zeros((400, 400, 2)), "shape"),
        (np.zeros(400), "shape"),
        (np.zeros((8, 400)), "16 px"),
        (np.full((400, 400), np.nan), "not finite"),
    ],
)
def test_what_is_no_image(image, said):
    with refused(said):
        find_corners(image, BOARD)


# --- Many views


def test_a_view_that_is_no_image_is_named(picture):
    with refused("view 2: the image has values that are not finite"):
        detect_views([picture, None, np.full((768, 800), np.nan)], BOARD)


def test_images_of_different_sizes(picture):
    with refused(r"views 0 and 2 have different image sizes, \(800, 768\) and \(700, 768\)"):
        detect_views([picture, None, picture[:, :700]], BOARD)


def test_the_size_that_would_fit_is_said(picture, corners):
    left, top = corners.min(axis=0).astype(int) - 50
    right, bottom = corners.max(axis=0).astype(int) + 50
    # no more than the board: many sizes are tried
    picture = np.ascontiguousarray(picture[top:bottom, left:right])
    with refused(r"Pass 12 x 10 inner corners .* found in 1"):
        detect_views([picture], Checkerboard((11, 8), 0.06))
    with refused("counts inner corners"):
        detect_views([np.full_like(picture, 128)], BOARD)
    assert suggest_board([picture], Checkerboard((11, 8), 0.06), only_larger=True) == ((12, 10), 1)
    assert suggest_board([picture], Checkerboard((13, 10), 0.06), only_larger=True) is None


def test_squares_counted_for_corners_are_found_out_before_all_images_are_searched(
    monkeypatch, picture
):
    """Each would take seconds."""
    monkeypatch.setattr(Checkerboard, "find_corners", lambda *_: pytest.fail("searched"))
    with refused(r"found in 3 images. Pass 12 x 10 inner corners .* found in 2 of the first"):
        detect_views([np.full_like(picture, 128), picture, picture], Checkerboard((13, 11), 0.06))
    with pytest.raises(pytest.fail.Exception):  # what may be the board is looked for
        detect_views([picture, picture], BOARD)


@pytest.mark.parametrize(
    ("count", "said"),
    [(2, "in 2 of the first 8 images, .* Count the"), (4, "^Pass 10 x 8 .* in 4")],
)
def test_a_size_that_few_images_show_is_no_advice_to_pass_it(monkeypatch, count, said):
    monkeypatch.setattr(checkerboard, "suggest_board", lambda *_: ((10, 8), count))
    picture = np.zeros((8, 8), np.uint8)
    assert re.search(said, Checkerboard((9, 6), 0.025).advice([picture] * 20))


# --- Files


def test_a_view_with_too_few_corners_is_named(tmp_path, corners):
    path = tmp_path / "short.yaml"
    save_corners(path, {"0001": corners, "0002": None}, BOARD, SIZE)
    lines = path.read_text().splitlines()
    del lines[10]
    path.write_text("\n".join(lines))
    with refused(r"short.yaml: view 0001 must be 240 numbers, found 238"):
        load_corners(path)
