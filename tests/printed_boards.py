"""Boards of markers as printed, and as the equidistant lens of `boards` sees them."""

import boards
import cv2
import numpy as np
from boards import CENTER, SIZE

import omnistereo_lib as osl
from omnistereo_rigs.boards.marker_boards import AprilGrid, CharucoBoard

F = 200.0  # px, of "equidistant 210"
APRIL_FILE = "target_type: 'aprilgrid'\ntagCols: 6\ntagRows: 5\ntagSize: 0.1\ntagSpacing: 0.3\n"
APRIL = AprilGrid((6, 5), 0.1, 0.3)
CHARUCO = CharucoBoard((9, 7), 0.06, 0.045)
PX_PER_M = 2000


def print_april(border, start=0):
    """Draw the board as Kalibr does: tags from the bottom left, black squares at crossings."""
    columns, rows = APRIL.tags
    tag, gap = round(APRIL.size * PX_PER_M), round(APRIL.size * APRIL.spacing * PX_PER_M)
    pitch, margin = tag + gap, 2 * gap
    page = np.full(
        (rows * pitch - gap + 2 * margin, columns * pitch - gap + 2 * margin), 255, np.uint8
    )
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    for number in range(columns * rows):
        row, column = rows - 1 - number // columns, number % columns
        y, x = margin + row * pitch, margin + column * pitch
        page[y : y + tag, x : x + tag] = cv2.aruco.generateImageMarker(
            dictionary, start + number, tag, borderBits=border
        )
    for row in range(rows + 1):
        for column in range(columns + 1):
            y, x = margin + row * pitch - gap, margin + column * pitch - gap
            page[y : y + gap, x : x + gap] = 0
    return page, margin


def print_charuco():
    columns, rows = CHARUCO.squares
    square = round(CHARUCO.square * PX_PER_M)
    page = CHARUCO._board(False).generateImage((columns * square, rows * square), marginSize=0)
    return np.pad(page, 40, constant_values=255), 40


def photograph(page, margin, pose, blur=0.7):
    """Return what the equidistant lens sees of a printed page at a pose of the board, by rays."""
    u, v = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    offset = np.stack([u, v], -1) - CENTER
    r = np.linalg.norm(offset, axis=-1)
    theta = r / F
    across = offset / np.maximum(r, 1e-9)[..., None] * np.sin(theta)[..., None]
    rays = np.concatenate([across, np.cos(theta)[..., None]], -1)
    normal = pose.R[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (pose.t @ normal) / (rays @ normal)
    hit = (depth > 0) & (theta < np.radians(105))
    on_board = pose.inverse() @ np.where(hit[..., None], rays * depth[..., None], 1e6)
    at = (on_board[..., :2] * PX_PER_M + margin - 0.5).astype(np.float32)
    image = cv2.remap(
        cv2.GaussianBlur(page, (0, 0), 3), at, None, cv2.INTER_LINEAR, borderValue=128
    )
    return cv2.GaussianBlur(image, (0, 0), blur)


def april_pictures(count):
    """Yield pictures of the AprilGrid, anywhere within the field of view."""
    page = print_april(2)
    rng = np.random.default_rng(0)
    middle = osl.Pose(np.eye(3), -APRIL.points.mean(axis=0))
    for k in range(count):
        ahead = boards.somewhere(rng, 105, 80 * (k + 1) / count) @ osl.Pose(
            np.eye(3), boards.BOARD.points.mean(axis=0)
        )
        yield photograph(*page, ahead @ middle)
