"""Checkerboard corners in strongly distorted images, to a few hundredths of a pixel.

OpenCV finds the board, its classic detector first: on bent boards it finds more than the newer one. Then each
corner is refined in a window of half the distance to its neighbours, a quarter where squares are large: near the
rim they are several times smaller than in the middle, and a window of fixed size would see the next corner.
"""

import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import combinations
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.calibrate.board import Board, Checkerboard
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.pose import Floats

Gray = NDArray[Any]  # uint8, (H, W); OpenCV's stubs do not say which integers it returns
Progress = Callable[[Iterable[Any]], Iterable[Any]]

_CLASSIC = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
_SMALL = 640  # px: the longer side of the copies on which thresholds are tried one by one
_LARGE = 1000  # px: the longer side of an image that is not enlarged
# px, half sizes of windows: the least that cornerSubPix can use, and what is enough for small squares. A larger
# window averages more noise, but where squares are slanted or bent it reaches other edges and is biased by them.
_LEAST_WINDOW, _SMALL_WINDOW = 2, 5
_STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-4)
_SIZE_SEARCH = 3  # a wrong board size is looked for this many corners around the one given
_MOST_LOST = 0.1  # of the corners; if more are lost, the detection is wrong
_SAME = 2.0  # mean difference in gray levels below which two views are the same image


def find_corners(image: ArrayLike, board: Board) -> Floats | None:
    """Find all inner corners of a checkerboard, or what is visible of a board of markers.

    Args:
        image (array, shape (H, W) or (H, W, 3)): uint8, or float in 0 to 255; colour in any order.

    Returns:
        array, shape (K, 2), or None: Pixels in the order of `board.points`, right-handed: the board is seen from its
            front; NaN for single corners that could not be refined. Of the symmetries of the board the one whose first
            corner is nearest to the top left. A mirrored image is not recognised. None if not every corner is visible.
    """
    gray = _gray(image)
    if not isinstance(board, Checkerboard):
        return board.find_corners(gray)
    for attempt in _attempts(gray, board):
        if attempt is not None:
            # First the order: refinement may lose one of the corners that decide it.
            corners = refine_corners(gray, _in_order(attempt, gray, board), board)
            if corners is not None:
                return corners
    return None


def _attempts(gray: Gray, board: Checkerboard) -> Iterator[Floats | None]:
    """Yield the corners that each detector finds, in the order that is fastest on the whole."""
    yield from _on_thresholds(gray, board, offset=8)
    yield _classic(gray, board)
    found, corners = cv2.findChessboardCornersSB(gray, board.corners, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    yield corners.reshape(-1, 2).astype(np.float64) if found else None
    yield from _on_thresholds(gray, board, offset=0)
    if max(gray.shape) <= _LARGE:
        yield _classic(cv2.resize(gray, None, fx=1.5, fy=1.5, interpolation=cv2.INTER_CUBIC), board, scale=1.5)
    yield _classic(cv2.createCLAHE(3.0, (8, 8)).apply(gray), board)


def _on_thresholds(gray: Gray, board: Checkerboard, offset: float) -> Iterator[Floats | None]:
    """Yield what is found in small black and white copies, which are searched in a fraction of the time."""
    scale = min(_SMALL / max(gray.shape), 1.0)
    small = cv2.resize(gray, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    for block in (41, 21, 81, 161):
        black = cv2.adaptiveThreshold(small, 255, cv2.ADAPTIVE_THRESH_GAUSSIAN_C, cv2.THRESH_BINARY, block, offset)
        yield _classic(black, board, scale, flags=0)


def _classic(gray: Gray, board: Checkerboard, scale: float = 1.0, flags: int = _CLASSIC) -> Floats | None:
    """Return what OpenCV's classic detector finds, in pixels of the image of which `gray` is `scale` times the size."""
    found, corners = cv2.findChessboardCorners(gray, board.corners, flags=flags)
    return (corners.reshape(-1, 2).astype(np.float64) + 0.5) / scale - 0.5 if found else None


def refine_corners(image: ArrayLike, corners: Floats, board: Checkerboard) -> Floats | None:
    """Refine corners to a fraction of a pixel.

    Args:
        image: As for `find_corners`.
        corners (array, shape (K, 2), px): Good to a quarter of the distance between neighbours.

    Returns:
        array, shape (K, 2), px, or None: NaN where a corner is lost, as beside a stain or the edge of the board. None
            if many are lost or squares are folded: then it is not a board.
    """
    gray = _gray(image)
    spacing = _spacing(corners, board)
    # The detector itself sometimes returns a neighbour of the corner.
    expected = _smoothed(corners, board)
    astray = np.linalg.norm(corners - expected, axis=1) > spacing / 4
    start = np.where(astray[:, None], expected, corners).astype(np.float32)
    refined = _sub_pixel(gray, start, np.clip(spacing / 2, _LEAST_WINDOW, np.maximum(_SMALL_WINDOW, spacing / 4)))
    # OpenCV returns the start if a corner leaves its window.
    lost = (refined == start).all(axis=1)
    lost |= np.linalg.norm(refined - _smoothed(refined, board), axis=1) > spacing / 4
    refined[lost] = np.nan
    return refined if lost.mean() < _MOST_LOST and _is_lattice(refined, board) else None


def edge_width(image: ArrayLike, corners: Floats, board: Checkerboard) -> float:
    """Return how many pixels the edges between squares take from black to white, where they are most blurred.

    Args:
        image: As for `find_corners`.
        corners (array, shape (K, 2), px): As found in it.

    Returns:
        float: Contrast of neighbouring squares by the steepest step of one pixel between them: the median over all
            edges along rows or along columns, whichever is larger, as a motion blurs across itself only. A sharp
            picture has about 2, at whatever distance.
    """
    gray = _gray(image).astype(np.float32)
    grid = corners.reshape(board.corners[1], board.corners[0], 2)
    widths = []
    for start, end in ((grid[:, :-1], grid[:, 1:]), (grid[:-1], grid[1:])):
        middle, along = ((start + end) / 2).reshape(-1, 1, 2), (end - start).reshape(-1, 1, 2)
        whole = np.isfinite(along).all(axis=(1, 2))
        middle, across = middle[whole], along[whole, :, ::-1] * (-1, 1)
        pixels = np.arange(-2.5, 2.6, 0.5)[:, None] * across / np.linalg.norm(across, axis=-1, keepdims=True)
        profile, sides = _look(gray, middle + pixels), _look(gray, middle + np.array([[-0.35], [0.35]]) * across)
        steepest = np.abs(profile[:, 2:] - profile[:, :-2]).max(axis=1)
        widths.append(np.median(np.abs(np.diff(sides, axis=1))[:, 0] / np.maximum(steepest, 1.0)))
    return float(max(widths))


def _look(gray: NDArray[Any], pixels: Floats) -> NDArray[Any]:
    """Interpolate linearly at pixels (..., ..., 2)."""
    u, v = np.moveaxis(pixels.astype(np.float32), -1, 0)
    return cv2.remap(gray, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _smoothed(corners: Floats, board: Checkerboard) -> Floats:
    """Fit polynomials of column and row to the corners, robustly; return their values at all corners, (K, 2) px."""
    degree = max(d for d in (1, 2, 3, 4) if (d + 1) * (d + 2) / 2 <= len(corners) / 3)
    x, y = (2 * board.points[:, :2] / board.square / (np.array(board.corners) - 1) - 1).T
    i, j = np.indices((degree + 1, degree + 1)).reshape(2, -1)
    basis = np.polynomial.polynomial.polyvander2d(x, y, (degree, degree))[:, i + j <= degree]
    inliers = np.ones(len(corners), bool)
    for _ in range(3):
        smooth = basis @ np.linalg.lstsq(basis[inliers], corners[inliers], rcond=None)[0]
        distance = np.linalg.norm(corners - smooth, axis=1)
        inliers = distance <= max(4 * np.median(distance), 0.1)
    return smooth


def _sub_pixel(gray: Gray, corners: NDArray[np.float32], half: Floats) -> Floats:
    """Refine each corner in a window of its own half size, px."""
    refined = corners.astype(np.float64)
    for size in np.unique(half.astype(int)):
        group = half.astype(int) == size
        start = corners[group].reshape(-1, 1, 2)
        refined[group] = cv2.cornerSubPix(gray, start, (int(size), int(size)), (-1, -1), _STOP).reshape(-1, 2)
    return refined


def _spacing(corners: Floats, board: Checkerboard) -> Floats:
    """Return the distance of each corner to its nearest neighbour on the board, shape (K,), px."""
    grid = np.pad(
        corners.reshape(board.corners[1], board.corners[0], 2), ((1, 1), (1, 1), (0, 0)), constant_values=np.inf
    )
    here = grid[1:-1, 1:-1]
    neighbors = np.stack([grid[1:-1, 2:], grid[1:-1, :-2], grid[2:, 1:-1], grid[:-2, 1:-1]])
    return np.linalg.norm(neighbors - here, axis=-1).min(axis=0).ravel()


def _is_lattice(corners: Floats, board: Checkerboard) -> bool:
    """Check that all squares have one orientation and none is folded: both triangles of each have the same sign."""
    grid = corners.reshape(board.corners[1], board.corners[0], 2)
    right, down = np.diff(grid, axis=1), np.diff(grid, axis=0)
    areas = np.stack([_cross2d(right[:-1], down[:, :-1]), _cross2d(right[1:], down[:, 1:])])
    areas = areas[np.isfinite(areas)]
    return bool((areas > 0).all() or (areas < 0).all())


def _cross2d(a: Floats, b: Floats) -> Floats:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _in_order(corners: Floats, gray: Gray, board: Checkerboard) -> Floats:
    """Return the corners right-handed, the first four around a black square, starting nearest to the top left."""
    columns, rows = board.corners
    grid = corners.reshape(rows, columns, 2)
    if np.median(_cross2d(np.diff(grid, axis=1)[:-1], np.diff(grid, axis=0)[:, :-1])) < 0:
        grid = grid[:, ::-1]
    rotated = [np.rot90(grid, quarter) for quarter in (range(4) if columns == rows else (0, 2))]
    black = [order for order in rotated if _first_is_black(order, gray)]
    return min(black or rotated, key=lambda order: order[0, 0].sum()).reshape(-1, 2).copy()


def _first_is_black(grid: Floats, gray: Gray) -> bool:
    """Compare the square within the first four corners with the two beside it."""
    first, right, below = (grid[i : i + 2, j : j + 2].reshape(4, 2).mean(axis=0) for i, j in ((0, 0), (0, 1), (1, 0)))
    inside, *beside = _look(gray, np.array([[first, right, below]])).ravel().astype(float)
    return bool(inside < np.mean(beside))


def _gray(image: ArrayLike) -> Gray:
    image = np.asarray(image)
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] not in (3, 4)) or min(image.shape[:2]) < 16:
        raise OmnistereoError(f"an image has shape (H, W) or (H, W, 3), at least 16 px a side; got {image.shape}")
    if image.dtype != np.uint8:
        if not np.isfinite(image).all():
            raise OmnistereoError("the image has values that are not finite")
        image = np.clip(np.round(image), 0, 255).astype(np.uint8)
    return image if image.ndim == 2 else image[..., :3].mean(axis=2).round().astype(np.uint8)


def detect_views(
    images: Sequence[ArrayLike | None],
    board: Board,
    progress: Progress = iter,
    names: Sequence[str] | None = None,
) -> list[Floats | None]:
    """Find the board in each image of one camera, on all cores; None where there is no image or no board.

    Messages call views by `names`, or else by index. Warns of images that are given twice.

    Raises:
        OmnistereoError: If an array is not an image, the images differ in size, or none shows the board; then it says
            which size of board would fit, if one does.
    """
    names = [str(k) for k in range(len(images))] if names is None else names
    grays: dict[int, Gray] = {}
    for k, image in enumerate(images):
        try:
            grays |= {} if image is None else {k: _gray(image)}
        except OmnistereoError as error:
            raise OmnistereoError(f"view {names[k]}: {error}") from error
    sizes = {gray.shape[::-1]: names[k] for k, gray in reversed(grays.items())}
    if len(sizes) > 1:
        (second, b), (first, a) = list(sizes.items())[-2:]
        raise OmnistereoError(
            f"views {a} and {b} have different image sizes, {first} and {second} px; expected one size per camera. "
            "Pass the images as captured: not cropped, resized or rotated"
        )
    with ThreadPoolExecutor() as pool:
        corners = progress(pool.map(lambda gray: find_corners(gray, board), grays.values()))
        found = dict(zip(grays, corners, strict=True))
    if all(corners is None for corners in found.values()):
        raise OmnistereoError(f"no board {board} found in {len(grays)} images. {_advice(list(grays.values()), board)}")
    for j, k in _duplicates(grays, found):
        warnings.warn(f"views {names[j]} and {names[k]} are the same image: it counts twice", stacklevel=2)
    return [found.get(k) for k in range(len(images))]


def _advice(grays: list[Gray], board: Board) -> str:
    if not isinstance(board, Checkerboard):
        return "Check columns, rows and dictionary, and that the images are sharp and evenly lit"
    suggestion = suggest_board(grays, board)
    if suggestion is None:
        return "Check that the board size counts inner corners and that all of them are visible, sharp and evenly lit"
    (columns, rows), count = suggestion
    return f"Pass {columns} x {rows} inner corners as board size: such a board is found in {count} of the first images"


def suggest_board(
    images: Sequence[ArrayLike], board: Checkerboard, most: int = 8, only_larger: bool = False
) -> tuple[tuple[int, int], int] | None:
    """Find the largest board of a size near the one given: ((columns, rows), number of images), or None.

    Only the first images are searched, at `most` so many; with `only_larger`, only for boards of which the one given
    could be a part.
    """
    grays = [_gray(image) for image in images[:most]]
    columns, rows = sorted(board.corners, reverse=True)
    near = range(0 if only_larger else -_SIZE_SEARCH, _SIZE_SEARCH + 1)
    sizes = {
        (max(c, r), min(c, r)) for c in (columns + d for d in near) for r in (rows + d for d in near) if min(c, r) >= 3
    }
    sizes -= {(columns, rows)} if only_larger else set()
    # Larger boards first: a part of a board looks like a smaller board.
    for size in sorted(sizes, key=lambda size: -size[0] * size[1]):
        fits = sum(_classic(gray, Checkerboard(size, 1.0)) is not None for gray in grays)
        if fits:
            return size, fits
    return None


def _duplicates(grays: dict[int, Gray], found: dict[int, Floats | None]) -> Iterator[tuple[int, int]]:
    boards = {k: corners for k, corners in found.items() if corners is not None}
    for a, b in combinations(boards, 2):
        apart = np.abs(boards[a] - boards[b])
        both = np.isfinite(apart)
        if both.any() and apart[both].max() < 0.5 and np.abs(grays[a].astype(float) - grays[b]).mean() < _SAME:
            yield a, b
