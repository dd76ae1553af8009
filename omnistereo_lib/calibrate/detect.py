"""Checkerboard corners in strongly distorted pictures, to a few hundredths of a pixel.

OpenCV finds the board, its classic detector first: on bent boards it finds more than the newer one. Then each
corner is refined in a window of half the distance to its neighbours, a quarter where squares are large: near the
rim they are several times smaller than in the middle, and a window of fixed size would see the next corner.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import combinations
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.calibrate.board import Checkerboard
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import atomic_write, read_bytes
from omnistereo_lib.geometry.camera import OcamCamera

Floats = NDArray[np.float64]
Gray = NDArray[np.uint8]
Progress = Callable[[Iterable], Iterable]

_CLASSIC = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
_SMALL = 640  # px: the longer side of the copy on which thresholds are tried one by one
# px, half sizes of windows: the least that cornerSubPix can use, and what is enough for small squares. A larger
# window averages more noise, but where squares are slanted or bent it reaches other edges and is biased by them.
_LEAST_WINDOW, _SMALL_WINDOW = 2, 5
_STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-4)
_SIZE_SEARCH = 3  # a wrong board size is looked for this many corners around the one given
_MOST_LOST = 0.1  # of the corners; where more run away, nothing is right
_SAME = 2.0  # mean gray levels between two pictures of one scene that are one picture


def find_corners(image: ArrayLike, board: Checkerboard) -> Floats | None:
    """Find all inner corners of the board.

    Parameters
    ----------
    image : array, shape (H, W) or (H, W, 3)
        uint8, or float in 0 … 255; colour in any order.
    board : Checkerboard

    Returns
    -------
    array, shape (K, 2), or None
        Pixels in the order of `board.points`, right-handed: the board is seen from its front. Of the readings that
        the black and white squares leave open the one whose first corner is nearest to the top left. A picture
        that is mirrored looks like another picture of the board: nobody can tell from one image. None where not
        every corner is in sight.
    """
    gray = _gray(image)
    for attempt in _attempts(gray, board):
        if attempt is not None:
            corners = refine_corners(gray, attempt, board)
            if corners is not None:
                return _in_order(corners, gray, board)
    return None


def _attempts(gray: Gray, board: Checkerboard) -> Iterator[Floats | None]:
    """Yield what each way to look finds, from the one that mostly succeeds to those that are slow."""
    yield _classic(gray, board)
    smaller = _SMALL / max(gray.shape)
    if smaller < 0.75:
        yield _classic(gray, board, smaller)
    else:
        yield _classic(gray, board, 1.5)
    yield _classic(cv2.createCLAHE(3.0, (8, 8)).apply(gray), board)
    yield _sector_based(gray, board)
    small = cv2.resize(gray, None, fx=min(smaller, 1.0), fy=min(smaller, 1.0), interpolation=cv2.INTER_AREA)
    for block in (21, 41, 81, 161):
        for offset in (0, 8):
            black = cv2.adaptiveThreshold(small, 255, cv2.ADAPTIVE_THRESH_GAUSSIAN_C, cv2.THRESH_BINARY, block, offset)
            found = _classic(black, board)
            yield None if found is None else (found + 0.5) / min(smaller, 1.0) - 0.5


def _classic(gray: Gray, board: Checkerboard, scale: float = 1.0) -> Floats | None:
    if scale != 1.0:
        how = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
        gray = cv2.resize(gray, None, fx=scale, fy=scale, interpolation=how)
    found, corners = cv2.findChessboardCorners(gray, board.corners, flags=_CLASSIC)
    return (corners.reshape(-1, 2).astype(np.float64) + 0.5) / scale - 0.5 if found else None


def _sector_based(gray: Gray, board: Checkerboard) -> Floats | None:
    found, corners = cv2.findChessboardCornersSB(gray, board.corners, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    return corners.reshape(-1, 2).astype(np.float64) if found else None


def refine_corners(image: ArrayLike, corners: Floats, board: Checkerboard) -> Floats | None:
    """Refine corners to a fraction of a pixel.

    Parameters
    ----------
    image : array
        As for `find_corners`.
    corners : array, shape (K, 2), px
        Good to a third of the distance between neighbours.
    board : Checkerboard

    Returns
    -------
    array, shape (K, 2), px, or None
        NaN where a corner ran away, as it does next to a stain or the board's edge. None where many did or squares
        are folded: what was found is no board.
    """
    gray = _gray(image)
    spacing = _spacing(corners, board)
    # The detector itself puts a corner into a neighbour's place now and then.
    expected = _smoothed(corners, board)
    astray = np.linalg.norm(corners - expected, axis=1) > spacing / 4
    start = np.where(astray[:, None], expected, corners).astype(np.float32)
    refined = _sub_pixel(gray, start, np.clip(spacing / 2, _LEAST_WINDOW, np.maximum(_SMALL_WINDOW, spacing / 4)))
    # OpenCV returns a corner that leaves its window as it came.
    lost = (refined == start).all(axis=1)
    lost |= np.linalg.norm(refined - _smoothed(refined, board), axis=1) > spacing / 4
    refined[lost] = np.nan
    return refined if lost.mean() < _MOST_LOST and _is_lattice(refined, board) else None


def edge_width(image: ArrayLike, corners: Floats, board: Checkerboard) -> float:
    """Return how many pixels the edges between squares take from black to white, where they are most blurred.

    Parameters
    ----------
    image : array
        As for `find_corners`.
    corners : array, shape (K, 2), px
        As found in it.
    board : Checkerboard

    Returns
    -------
    float
        Contrast of neighbouring squares by the steepest step of one pixel between them: the median over all edges
        along rows or along columns, whichever is larger, as a motion blurs across itself only. A sharp picture has
        about 2, at whatever distance.
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


def _look(gray: NDArray[np.float32], pixels: Floats) -> NDArray[np.float32]:
    u, v = np.moveaxis(pixels.astype(np.float32), -1, 0)
    return cv2.remap(gray, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _smoothed(corners: Floats, board: Checkerboard) -> Floats:
    """Return polynomials of column and row fitted to the corners, wrong ones left out, at all corners, (K, 2) px."""
    degree = max(d for d in (1, 2, 3, 4) if (d + 1) * (d + 2) / 2 <= len(corners) / 3)
    x, y = (2 * board.points[:, :2] / board.square / (np.array(board.corners) - 1) - 1).T
    i, j = np.indices((degree + 1, degree + 1)).reshape(2, -1)
    basis = np.polynomial.polynomial.polyvander2d(x, y, (degree, degree))[:, i + j <= degree]
    kept = np.ones(len(corners), bool)
    for _ in range(3):
        smooth = basis @ np.linalg.lstsq(basis[kept], corners[kept], rcond=None)[0]
        distance = np.linalg.norm(corners - smooth, axis=1)
        kept = distance <= max(4 * np.median(distance), 0.1)
    return smooth


def _sub_pixel(gray: Gray, corners: NDArray[np.float32], half: Floats) -> Floats:
    """Return corners moved to where the gradients around them point, in windows of half their own size."""
    refined = corners.astype(np.float64)
    for size in np.unique(half.astype(int)):
        group = half.astype(int) == size
        start = corners[group].reshape(-1, 1, 2)
        refined[group] = cv2.cornerSubPix(gray, start, (int(size), int(size)), (-1, -1), _STOP).reshape(-1, 2)
    return refined


def _spacing(corners: Floats, board: Checkerboard) -> Floats:
    """Return each corner's distance to its nearest neighbour on the board, shape (K,), px."""
    grid = corners.reshape(board.corners[1], board.corners[0], 2)
    spacing = np.full(grid.shape[:2], np.inf)
    across, down = (np.linalg.norm(np.diff(grid, axis=axis), axis=-1) for axis in (1, 0))
    spacing[:, :-1], spacing[:, 1:] = np.minimum(spacing[:, :-1], across), np.minimum(spacing[:, 1:], across)
    spacing[:-1], spacing[1:] = np.minimum(spacing[:-1], down), np.minimum(spacing[1:], down)
    return spacing.ravel()


def _is_lattice(corners: Floats, board: Checkerboard) -> bool:
    """All squares turn the same way, and none is folded: both triangles of each have the same sign."""
    grid = corners.reshape(board.corners[1], board.corners[0], 2)
    right, down = np.diff(grid, axis=1), np.diff(grid, axis=0)
    upper, lower = _turn(right[:-1], down[:, :-1]), _turn(right[1:], down[:, 1:])
    turns = np.stack([upper, lower])
    turns = turns[np.isfinite(turns)]
    return bool((turns > 0).all() or (turns < 0).all())


def _turn(a: Floats, b: Floats) -> Floats:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _in_order(corners: Floats, gray: Gray, board: Checkerboard) -> Floats:
    """Return the corners right-handed, read so that the first four enclose a black square, from the top left."""
    columns, rows = board.corners
    grid = corners.reshape(rows, columns, 2)
    if np.nanmedian(_turn(np.diff(grid, axis=1)[:-1], np.diff(grid, axis=0)[:, :-1])) < 0:
        grid = grid[:, ::-1]
    quarters = range(4) if columns == rows else (0, 2)
    turned = [np.rot90(grid, quarter) for quarter in quarters]
    black = [reading for reading in turned if _first_is_black(reading, gray)]
    return min(black or turned, key=lambda reading: reading[0, 0].sum()).reshape(-1, 2).copy()


def _first_is_black(grid: Floats, gray: Gray) -> bool:
    """Compare the square within the first four corners with the two beside it."""
    first, right, below = (grid[i : i + 2, j : j + 2].reshape(4, 2).mean(axis=0) for i, j in ((0, 0), (0, 1), (1, 0)))
    values = cv2.remap(gray, np.float32([[first, right, below]]), None, cv2.INTER_LINEAR).ravel().astype(float)
    return bool(values[0] < (values[1] + values[2]) / 2)


def _gray(image: ArrayLike) -> Gray:
    image = np.asarray(image)
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] not in (3, 4)) or min(image.shape[:2]) < 16:
        raise OmnistereoError(f"an image has shape (H, W) or (H, W, 3), at least 16 px a side; got {image.shape}")
    if image.dtype != np.uint8:
        if not np.isfinite(image).all():
            raise OmnistereoError("the image has values that are not finite")
        image = np.clip(np.round(image), 0, 255).astype(np.uint8)
    return image if image.ndim == 2 else image[..., :3].mean(axis=2).round().astype(np.uint8)


# --- With a first model -----------------------------------------------------------------------------------

_TILT_STEP = np.radians(30.0)  # between the directions of the virtual cameras
_HALF_VIEW = np.radians(55.0)  # of a virtual camera: a board near the rim straightens within it


def find_with_model(image: ArrayLike, board: Checkerboard, camera: OcamCamera) -> Floats | None:
    """Find a board that was missed, in views of a virtual pinhole camera that looks all around.

    Near the rim squares are bent and squeezed; seen through a first model of the lens by a pinhole camera that
    looks there, they are squares again. The corners found go back through the model and are refined in the picture
    itself, so that the model's errors do not enter.

    Parameters
    ----------
    image, board
        As for `find_corners`, as is the value returned.
    camera : OcamCamera
        A first calibration from other views.
    """
    gray = _gray(image)
    for R in _directions(np.radians(camera.max_fov_deg / 2)):
        size = max(gray.shape) // 2
        focal = (size - 1) / 2 / np.tan(_HALF_VIEW)
        u, v = np.meshgrid(np.arange(size), np.arange(size))
        rays = np.stack([u - (size - 1) / 2, v - (size - 1) / 2, np.full(u.shape, focal)], axis=-1) @ R.T
        uv, seen = camera.project(rays)
        uv[~seen] = -1e4
        straight = cv2.remap(gray, uv.astype(np.float32), None, cv2.INTER_LINEAR, borderValue=128)
        found = _classic(straight, board)
        if found is not None:
            rays = np.column_stack([found - (size - 1) / 2, np.full(len(found), focal)]) @ R.T
            corners, seen = camera.project(rays)
            corners = refine_corners(gray, corners, board) if seen.all() else None
            if corners is not None:
                return _in_order(corners, gray, board)
    return None


def _directions(reach: float) -> Iterator[Floats]:
    """Yield rotations whose z axes cover a cone around the optical axis, from the rim inwards."""
    for angle in np.arange(reach - _TILT_STEP / 2, 0, -_TILT_STEP):
        around = max(4, round(2 * np.pi * np.sin(angle) / _TILT_STEP))
        for azimuth in np.arange(around) * 2 * np.pi / around:
            axis = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
            yield cv2.Rodrigues(angle * axis)[0]
    yield np.eye(3)


# --- Many views -------------------------------------------------------------------------------------------


def detect_views(
    images: Sequence[ArrayLike | None],
    board: Checkerboard,
    progress: Progress = iter,
    names: Sequence[str] | None = None,
) -> list[Floats | None]:
    """Find the board in each image of one camera, on all cores; None where there is no image or no board.

    Messages call views by `names`, or else by index. Warns of images that are given twice.

    Raises
    ------
    OmnistereoError
        If an array is not an image, the images differ in size, or none shows the board; then it says which size of
        board would fit, if one does.
    """
    names = range(len(images)) if names is None else names
    grays = {}
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
        raise OmnistereoError(_nothing_found(list(grays.values()), board))
    for a, b in _duplicates(grays, found):
        warnings.warn(f"views {names[a]} and {names[b]} are the same image: it counts twice", stacklevel=2)
    return [found.get(k) for k in range(len(images))]


def _nothing_found(grays: list[Gray], board: Checkerboard) -> str:
    said = f"no board {board} found in {len(grays)} images. "
    fits = suggest_board(grays, board)
    if fits is not None:
        (columns, rows), count = fits
        return said + f"One of {columns} x {rows} inner corners would fit {count} of them"
    return said + "Count its inner corners (columns x rows); all of them have to be in sight, sharp and evenly lit"


def suggest_board(
    images: Sequence[ArrayLike], board: Checkerboard, most: int = 8, only_larger: bool = False
) -> tuple[tuple[int, int], int] | None:
    """Look for boards of a size near the one given: ((columns, rows), in how many images), the largest that fits.

    Parameters
    ----------
    images : sequence of arrays
    board : Checkerboard
        Whose size was not found.
    most : int
        At most so many images are looked at.
    only_larger : bool
        Only boards of which the one given could be a part.
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
    for a, b in combinations([k for k, corners in found.items() if corners is not None], 2):
        close = np.nanmax(np.abs(found[a] - found[b])) < 0.5
        if close and np.abs(grays[a].astype(float) - grays[b]).mean() < _SAME:
            yield a, b


# --- Files ------------------------------------------------------------------------------------------------


def save_corners(
    path: str | Path, views: dict[str, Floats | None], board: Checkerboard, image_size: tuple[int, int]
) -> None:
    """Write detections as YAML that a person can edit: a line for each corner, null for views without a board.

    Parameters
    ----------
    path : path
    views : dict
        Name of each picture → corners (K, 2) px, NaN where one is missing, or None.
    board : Checkerboard
    image_size : (int, int)
        Width and height of the pictures.
    """
    lines = [
        f"board: {{corners: [{board.corners[0]}, {board.corners[1]}], square: {board.square!r}}}  # inner, metres",
        f"image_size: [{image_size[0]}, {image_size[1]}]  # width, height",
        "views:  # pixels (u, v), row by row; [.nan, .nan] leaves a corner out, null a view",
    ]
    for name, corners in views.items():
        lines.append(f"  {_quoted(name)}:{' null' if corners is None else ''}")
        lines += [f"  - [{_number(u)}, {_number(v)}]" for u, v in ([] if corners is None else corners)]
    with atomic_write(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def load_corners(path: str | Path) -> tuple[dict[str, Floats | None], Checkerboard, tuple[int, int]]:
    """Read what `save_corners` wrote: views, board, image size.

    Raises
    ------
    OmnistereoError
        If the file is missing, not YAML, or lacks something; it names the view.
    """
    import yaml

    path = Path(path)
    try:
        content = yaml.safe_load(read_bytes(path).decode("utf-8"))
        board = Checkerboard(tuple(content["board"]["corners"]), float(content["board"]["square"]))
        width, height = (int(side) for side in content["image_size"])
        views = {str(name): _corners_of(value, name, board) for name, value in content["views"].items()}
    except OmnistereoError as error:
        raise OmnistereoError(f"{path}: {error}") from error
    except (yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise OmnistereoError(
            f"{path}: not a file of corners ({type(error).__name__}: {error}); expected board, image_size and views"
        ) from error
    return views, board, (width, height)


def _corners_of(value: Any, name: str, board: Checkerboard) -> Floats | None:
    if value is None:
        return None
    corners = np.array(value, np.float64)
    if corners.shape != board.points[:, :2].shape:
        raise OmnistereoError(
            f"view {name}: corners of shape {corners.shape}, expected {len(board.points)} pairs of u and v"
        )
    return corners


def _number(value: float) -> str:
    return f"{value:.4f}" if np.isfinite(value) else ".nan"


def _quoted(name: str) -> str:
    return '"' + name.replace("\\", "\\\\").replace('"', '\\"') + '"'
