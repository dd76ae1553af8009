"""The checkerboard, and its corners in strongly distorted images, to a few hundredths of a pixel.

OpenCV finds the board, its classic detector first: on bent boards it finds more than the newer one.
Then each corner is refined in a window of half the distance to its neighbours, a quarter where
squares are large: near the rim they are several times smaller than in the middle, and a window of
fixed size would see the next corner.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.pose import Floats, Pose
from omnistereo_lib.lazy import lazy_property
from omnistereo_rigs.boards.board import Board, Gray, as_gray, check_edge

_CLASSIC = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
# In pixels: the longer side of the copies on which thresholds are tried one by one.
_SMALL = 640
# Half sizes of windows in pixels: the least that cornerSubPix can use, and what is enough for small
# squares. A larger window averages more noise, but where squares are slanted or bent it reaches
# other edges and is biased by them.
LEAST_WINDOW, SMALL_WINDOW = 2, 5
_STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-4)
# So many images are searched for a board of another size.
_SEARCHED = 8
# A wrong board size is looked for this many corners around the one given.
_SIZE_SEARCH = 3
# If a larger share of the corners is lost, the detection is wrong.
_MOST_LOST = 0.1


@dataclass(frozen=True)
class Checkerboard(Board):
    """A flat checkerboard.

    Board frame, seen from the front: origin at the first corner, x right, y down, z into the board.

    Raises:
        OmnistereoError: If a count is not an integer of 3 to 200, or the square is not 0.1 mm to 1
            m long.

    >>> from omnistereo_rigs import Checkerboard
    >>> board = Checkerboard((8, 6), square=0.05)
    >>> board.points[[1, 8]]  # the second corner of the first row, the first of the second
    array([[0.05, 0.  , 0.  ],
           [0.  , 0.05, 0.  ]])
    """

    #: Inner corners, columns and rows: where four squares meet. A board of 13 x 11 squares has 12 x
    #: 10.
    corners: tuple[int, int]
    square: float  #: edge of a square, metres

    def __post_init__(self) -> None:
        counts = list(self.corners) if isinstance(self.corners, Sequence) else []
        if len(counts) != 2 or not all(
            isinstance(n, Real) and 3 <= n <= 200 and n % 1 == 0 for n in counts
        ):
            raise OmnistereoError(
                f"board corners are {self.corners}; expected two integers of 3 to 200, inner"
                " columns and rows"
            )
        object.__setattr__(self, "corners", (int(counts[0]), int(counts[1])))
        square = check_edge(self.square, "the square (its edge in metres)")
        object.__setattr__(self, "square", square)

    def __str__(self) -> str:
        columns, rows = self.corners
        return f"of {columns} x {rows} inner corners, squares of {1000 * self.square:g} mm"

    @lazy_property
    def points(self) -> Floats:
        """Corners in the board frame, shape (K, 3), metres, row by row, columns fastest."""
        x, y = np.meshgrid(np.arange(self.corners[0]), np.arange(self.corners[1]))
        counted = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
        return counted.astype(np.float64) * self.square

    @lazy_property
    def symmetries(self) -> tuple[NDArray[np.int64], ...]:
        """Corner permutations that leave the pattern unchanged, each of shape (K,); identity first.

        Boards with both counts even or both odd look the same after 180°, square ones perhaps after
        90°.
        """
        columns, rows = self.corners
        order = np.arange(columns * rows).reshape(rows, columns)
        rotated = [np.rot90(order, k) for k in (range(4) if columns == rows else (0, 2))]
        # Keep only rotations that map black squares to black squares.
        parity = [sum(divmod(int(grid[:2, :2].min()), columns)) % 2 for grid in rotated]
        return tuple(grid.ravel() for grid, odd in zip(rotated, parity, strict=True) if odd == 0)

    def symmetry_pose(self, symmetry: NDArray[np.int64]) -> Pose:
        """Return the pose T with `T @ points[k] == points[symmetry[k]]`."""
        points = self.points[symmetry]
        x = (points[1] - points[0]) / self.square
        y = (points[self.corners[0]] - points[0]) / self.square
        return Pose(np.column_stack([x, y, np.cross(x, y)]), points[0])

    def find_corners(self, gray: Gray) -> Floats | None:
        """Find all inner corners, NaN where not refined; None if not every one is visible.

        Right-handed: the board is seen from its front, a mirrored image is not recognised. Of the
        symmetries of the board the one whose first corner is nearest to the top left.
        """
        for attempt in _attempts(gray, self):
            if attempt is not None:
                # First the order: refinement may lose one of the corners that decide it.
                corners = refine_corners(gray, _in_order(attempt, gray, self), self)
                if corners is not None:
                    return corners
        return None

    def another(self, grays: Sequence[Gray]) -> str | None:
        """Return which board, of a row or a column more or less, half of the first images show."""
        if any(_is_seen(gray, self) for gray in grays):
            return None
        size, count = suggest_board(grays, self, reach=1) or (self.corners, 0)
        return _pass_it(size, count) if 1 < count >= min(len(grays), _SEARCHED) / 2 else None

    def advice(self, grays: Sequence[Gray]) -> str:
        """Return what to do if no image shows the board: the size to pass, if one near it fits."""
        suggestion = suggest_board(grays, self)
        if suggestion is None:
            return (
                "Check that the board size counts inner corners and that all of them are visible,"
                " sharp and evenly lit"
            )
        (columns, rows), count = suggestion
        searched = min(len(grays), _SEARCHED)
        if searched > 2 and 2 * count < searched:
            return (
                f"A board of {columns} x {rows} inner corners is found in {count} of the first "
                f"{searched} images, by chance or as a part of a larger one. Count the inner "
                "corners of the board"
            )
        return _pass_it((columns, rows), count)


def _pass_it(size: tuple[int, int], count: int) -> str:
    return (
        f"Pass {size[0]} x {size[1]} inner corners as board size: such a board is found in {count}"
        " of the first images"
    )


def _attempts(gray: Gray, board: Checkerboard) -> Iterator[Floats | None]:
    """Yield the corners that each detector finds, in the order that is fastest on the whole.

    Of the 209 boards found in the pictures of data_samples/calibration they find 195, 7, 4 and 3;
    an enlarged picture and CLAHE found none more.
    """
    yield from _on_thresholds(gray, board, offset=8)
    yield _classic(gray, board)
    found, corners = cv2.findChessboardCornersSB(
        gray, board.corners, flags=cv2.CALIB_CB_NORMALIZE_IMAGE
    )
    yield corners.reshape(-1, 2).astype(np.float64) if found else None
    yield from _on_thresholds(gray, board, offset=0)


def _on_thresholds(gray: Gray, board: Checkerboard, offset: float) -> Iterator[Floats | None]:
    """Yield what is found in small black and white copies, in a fraction of the time."""
    scale = min(_SMALL / max(gray.shape), 1.0)
    small = cv2.resize(gray, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    for block in (41, 21, 81, 161):
        black = cv2.adaptiveThreshold(
            small, 255, cv2.ADAPTIVE_THRESH_GAUSSIAN_C, cv2.THRESH_BINARY, block, offset
        )
        yield _classic(black, board, scale, flags=0)


def _is_seen(gray: Gray, board: Checkerboard) -> bool:
    """Return whether the quickest detector finds the board."""
    return any(corners is not None for corners in _on_thresholds(gray, board, offset=8))


def _classic(
    gray: Gray, board: Checkerboard, scale: float = 1.0, flags: int = _CLASSIC
) -> Floats | None:
    """Return what the classic detector finds in a copy of `scale` times the size, image pixels."""
    found, corners = cv2.findChessboardCorners(gray, board.corners, flags=flags)
    return (corners.reshape(-1, 2).astype(np.float64) + 0.5) / scale - 0.5 if found else None


def refine_corners(image: ArrayLike, corners: Floats, board: Checkerboard) -> Floats | None:
    """Refine corners to a fraction of a pixel.

    Args:
        image: uint8, (H, W), or what `as_gray` reads.
        corners (array, shape (K, 2), px): Good to a quarter of the distance between neighbours.

    Returns:
        array, shape (K, 2), px, or None: NaN where a corner is lost, as beside a stain or the edge
            of the board. None if many are lost or squares are folded: then it is not a board.
    """
    gray = as_gray(image)
    spacing = _spacing(corners, board)
    # The detector itself sometimes returns a neighbour of the corner.
    expected = _smoothed(corners, board)
    astray = np.linalg.norm(corners - expected, axis=1) > spacing / 4
    start = np.where(astray[:, None], expected, corners).astype(np.float32)
    refined = _sub_pixel(
        gray, start, np.clip(spacing / 2, LEAST_WINDOW, np.maximum(SMALL_WINDOW, spacing / 4))
    )
    # OpenCV returns the start if a corner leaves its window.
    lost = (refined == start).all(axis=1)
    lost |= np.linalg.norm(refined - _smoothed(refined, board), axis=1) > spacing / 4
    refined[lost] = np.nan
    return refined if lost.mean() < _MOST_LOST and _is_lattice(refined, board) else None


def edge_width(image: ArrayLike, corners: Floats, board: Checkerboard) -> float:
    """Return how many pixels an edge takes from black to white, where most blurred.

    Args:
        image: uint8, (H, W), or what `as_gray` reads.
        corners (array, shape (K, 2), px): As found in it.

    Returns:
        float: Contrast of neighbouring squares by the steepest step of one pixel between them: the
            median over all edges along rows or along columns, whichever is larger, as a motion
            blurs across itself only. A sharp picture has about 2, at whatever distance.
    """
    gray = as_gray(image).astype(np.float32)
    grid = corners.reshape(board.corners[1], board.corners[0], 2)
    widths = []
    for start, end in ((grid[:, :-1], grid[:, 1:]), (grid[:-1], grid[1:])):
        # The edge between two squares runs from corner to corner. Look across it, every half pixel
        # around its middle, and into the two squares beside it.
        middle, along = ((start + end) / 2).reshape(-1, 1, 2), (end - start).reshape(-1, 1, 2)
        whole = np.isfinite(along).all(axis=(1, 2))
        middle, across = middle[whole], along[whole, :, ::-1] * (-1, 1)
        pixels = (
            np.arange(-2.5, 2.6, 0.5)[:, None]
            * across
            / np.linalg.norm(across, axis=-1, keepdims=True)
        )
        profile, sides = (
            _look(gray, middle + pixels),
            _look(gray, middle + np.array([[-0.35], [0.35]]) * across),
        )
        # Profile values two samples apart are one pixel apart. Contrast over the steepest such step
        # is a width in pixels.
        steepest = np.abs(profile[:, 2:] - profile[:, :-2]).max(axis=1)
        widths.append(np.median(np.abs(np.diff(sides, axis=1))[:, 0] / np.maximum(steepest, 1.0)))
    return float(max(widths))


def _look(gray: NDArray[Any], pixels: Floats) -> NDArray[Any]:
    """Interpolate linearly at pixels (..., ..., 2)."""
    u, v = np.moveaxis(pixels.astype(np.float32), -1, 0)
    return cv2.remap(gray, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _smoothed(corners: Floats, board: Checkerboard) -> Floats:
    """Return the corners (K, 2) px of polynomials of column and row, fitted robustly."""
    # The highest degree up to 4 that leaves three corners for each of its coefficients, (d + 1)(d +
    # 2) / 2.
    degree = max(d for d in (1, 2, 3, 4) if (d + 1) * (d + 2) / 2 <= len(corners) / 3)
    x, y = (2 * board.points[:, :2] / board.square / (np.array(board.corners) - 1) - 1).T
    i, j = np.indices((degree + 1, degree + 1)).reshape(2, -1)
    basis = np.polynomial.polynomial.polyvander2d(x, y, (degree, degree))[:, i + j <= degree]
    inliers = np.ones(len(corners), bool)
    for _ in range(3):
        smooth = basis @ np.linalg.lstsq(basis[inliers], corners[inliers], rcond=None)[0]
        distance = np.linalg.norm(corners - smooth, axis=1)
        # Corners far from the surface are left out of the next fit.
        inliers = distance <= max(4 * np.median(distance), 0.1)
    return smooth


def _sub_pixel(gray: Gray, corners: NDArray[np.float32], half: Floats) -> Floats:
    """Refine each corner in a window of its own half size, px."""
    refined = corners.astype(np.float64)
    for size in np.unique(half.astype(int)):
        group = half.astype(int) == size
        start = corners[group].reshape(-1, 1, 2)
        refined[group] = cv2.cornerSubPix(
            gray, start, (int(size), int(size)), (-1, -1), _STOP
        ).reshape(-1, 2)
    return refined


def _spacing(corners: Floats, board: Checkerboard) -> Floats:
    """Return the distance of each corner to its nearest neighbour on the board, shape (K,), px."""
    grid = np.pad(
        corners.reshape(board.corners[1], board.corners[0], 2),
        ((1, 1), (1, 1), (0, 0)),
        constant_values=np.inf,
    )
    # Beyond the edge of the board the neighbours are at infinity, so they are never the nearest.
    here = grid[1:-1, 1:-1]
    neighbors = np.stack([grid[1:-1, 2:], grid[1:-1, :-2], grid[2:, 1:-1], grid[:-2, 1:-1]])
    return np.linalg.norm(neighbors - here, axis=-1).min(axis=0).ravel()


def _is_lattice(corners: Floats, board: Checkerboard) -> bool:
    """Check that no square is folded: both triangles of each have one sign."""
    grid = corners.reshape(board.corners[1], board.corners[0], 2)
    right, down = np.diff(grid, axis=1), np.diff(grid, axis=0)
    areas = np.stack([_cross2d(right[:-1], down[:, :-1]), _cross2d(right[1:], down[:, 1:])])
    areas = areas[np.isfinite(areas)]
    return bool((areas > 0).all() or (areas < 0).all())


def _cross2d(a: Floats, b: Floats) -> Floats:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _in_order(corners: Floats, gray: Gray, board: Checkerboard) -> Floats:
    """Return the corners right-handed, a black square first, from nearest to the top left."""
    columns, rows = board.corners
    grid = corners.reshape(rows, columns, 2)
    # The right and the down neighbour of a corner turn clockwise in an image; otherwise each row is
    # reversed.
    if np.median(_cross2d(np.diff(grid, axis=1)[:-1], np.diff(grid, axis=0)[:, :-1])) < 0:
        grid = grid[:, ::-1]
    rotated = [np.rot90(grid, quarter) for quarter in (range(4) if columns == rows else (0, 2))]
    black = [order for order in rotated if _first_is_black(order, gray)]
    return min(black or rotated, key=lambda order: order[0, 0].sum()).reshape(-1, 2).copy()


def _first_is_black(grid: Floats, gray: Gray) -> bool:
    """Compare the square within the first four corners with the two beside it."""
    first, right, below = (
        grid[i : i + 2, j : j + 2].reshape(4, 2).mean(axis=0) for i, j in ((0, 0), (0, 1), (1, 0))
    )
    inside, *beside = _look(gray, np.array([[first, right, below]])).ravel().astype(float)
    return bool(inside < np.mean(beside))


def suggest_board(
    images: Sequence[ArrayLike],
    board: Checkerboard,
    only_larger: bool = False,
    reach: int = _SIZE_SEARCH,
) -> tuple[tuple[int, int], int] | None:
    """Find the board that the images show: ((columns, rows), number of images), or None.

    Sizes near the given one are searched, the largest first: a part of a board looks like a smaller
    board. The number of images decides. Only the first images are searched; with `only_larger`,
    only for boards of which the one given could be a part.
    """
    grays = [as_gray(image) for image in images[:_SEARCHED]]
    columns, rows = max(board.corners), min(board.corners)
    near = range(0 if only_larger else -reach, reach + 1)
    sizes = {
        (max(c, r), min(c, r))
        for c in (columns + d for d in near)
        for r in (rows + d for d in near)
    }
    best: tuple[tuple[int, int], int] | None = None
    for size in sorted(sizes, key=lambda size: -size[0] * size[1]):
        if min(size) < 3 or (only_larger and size == (columns, rows)):
            continue
        fits = sum(_is_seen(gray, Checkerboard(size, 1.0)) for gray in grays)
        if fits > (best[1] if best else 0):
            best = size, fits
        if 2 * fits >= len(grays):
            break
    return best
