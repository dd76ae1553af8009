"""The paths of SGM on a CPU: all threads at once, and no L_r of a whole volume is ever stored.

Rows first, each with its two paths. Then one pass from the top follows ↓ ↘ ↙ and one from the
bottom ↑ ↗ ↖. A message belongs to a scanline, not to a pixel: each vertical or diagonal line has
its slot, (x − y) mod W for ↘, which the next row updates in place (6 W N floats for both passes,
5.5 MB at 1200×300×192).

Threads never write to the same memory at the same time. The two passes start at opposite ends and
run at once, one band of rows each. A band is cut into strips of columns. Because a path moves by at
most one column per row, the part of a strip that narrows by one column per row on either side needs
nothing from the neighbouring strips: first all these trapezoids run, then the triangles between
them. The tiles also keep the data of a thread in its cache.
"""

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

from omnistereo_lib.reference import MAX_LAPS
from omnistereo_lib.stereo.compiled import compiled, minimum
from omnistereo_lib.stereo.threads import map_threads

INFINITY = np.float32(np.inf)
# Sums of costs and penalties below it are finite.
LARGEST = np.float32(1e30)
# The width of a strip in columns.
_STRIP = 128
# A tile: up, top, bottom, first, last, slope.
_Tile = tuple[bool, int, int, int, int, int]


def sum_paths(
    cost: NDArray[Any], p1: float, p2: float, paths: int, wrap: bool
) -> tuple[Tensor, bool]:
    """Return Σ_r L_r of costs (H, W, N), and whether a cost is too large, as in `sgm`."""
    H, W, N = cost.shape
    # (H, W, N); NumPy asks the system for huge pages, torch does not.
    total = np.empty_like(cost)
    # The data term of the unknown cells of each ray.
    fill = np.empty((H, W), np.float32)
    # One message per scanline, of the passes down and up: straight on, to the right, to the left.
    messages = np.zeros((2, 3, W, N), np.float32)

    # Along the rows, four at a time in a thread; this also fills the unknown cells.
    def rows(y: int) -> bool:
        return _scan_rows(cost[y : y + 4], fill[y : y + 4], total[y : y + 4], wrap, p1, p2)

    too_large = any(list(map_threads(rows, range(0, H, 4))))

    # Across the rows, tile by tile.
    def advance(tile: _Tile) -> None:
        _advance(cost, fill, total, messages, tile, paths == 8, wrap, p1, p2)

    for tiles in _tiles(H, W):
        list(map_threads(advance, tiles))
    return torch.from_numpy(total), too_large


def _tiles(H: int, W: int) -> Iterator[list[_Tile]]:
    """Yield lists of tiles that can run at the same time."""
    strips = max(1, W // _STRIP)
    columns = [W * i // strips for i in range(strips + 1)]
    # A trapezoid loses a column on both sides with each row: after so many rows it ends.
    depth = max(1, W // strips // 2)
    # An even number, so that the two passes meet between two bands and never share a row.
    bands = 2 * math.ceil(H / depth / 2)
    rows = list(pairwise(H * i // bands for i in range(bands + 1)))
    # First the trapezoids of both passes, all at once; then the triangles that fill the gaps
    # between them, which open from a point at the border of two strips.
    for down, up in zip(rows, reversed(rows), strict=True):
        yield [
            (*band, first, last, 1)
            for band in ((False, *down), (True, *up))
            for first, last in pairwise(columns)
        ]
        yield [
            (*band, last, last, -1)
            for band in ((False, *down), (True, *up))
            for last in columns[1:]
        ]


# One pixel at a time; the compiler vectorises the loops over n.


@njit
def _fill_value(cost: NDArray[Any]) -> np.float32:
    """Return the cost of unknown cells of a ray: the mean of the others, infinite if too large."""
    regular = True
    for n in range(cost.size):
        # The comparison is false for NaN.
        regular &= abs(cost[n]) < LARGEST
    if regular:
        # Every cost is known, so the value is not used.
        return np.float32(0)
    total, known = 0.0, 0
    for n in range(cost.size):
        if cost[n] == cost[n]:
            if not abs(cost[n]) < LARGEST:
                return INFINITY
            total += cost[n]
            known += 1
    return np.float32(total / max(known, 1))


@njit
def _add_cost(
    cost: NDArray[Any], fill: float, message: NDArray[Any], path: NDArray[Any]
) -> np.float32:
    """Extend a path by one pixel, L = C + M; return min L. path is (N + 2,), its ends infinite."""
    lowest = INFINITY
    for n in range(cost.size):
        # L_r(p, n) = C(p, n) + M(n), M from the pixel before (Hirschmüller 2008).
        c = cost[n] if cost[n] == cost[n] else fill
        path[n + 1] = c + message[n]
        lowest = minimum(lowest, path[n + 1])
    return lowest


@njit
def _update_message(
    path: NDArray[Any], lowest: float, p1: float, p2: float, message: NDArray[Any]
) -> None:
    """Write the message M to the next pixel of the path."""
    # M(n) = min(L(n), L(n-1) + P1, L(n+1) + P1, min L + P2) - min L: the neighbouring spheres cost
    # P1, any other P2, and subtracting the minimum keeps the sums bounded. The infinite ends of
    # `path` stand for the spheres before the first and after the last.
    jump = lowest + p2
    for n in range(message.size):
        step = minimum(path[n], path[n + 2]) + p1
        message[n] = minimum(minimum(path[n + 1], step), jump) - lowest


@njit
def _copy_if_changed(path: NDArray[Any], path_costs: NDArray[Any]) -> bool:
    """Copy path to path_costs; return whether a value changed."""
    changed = False
    for n in range(path_costs.size):
        changed |= path[n + 1] != path_costs[n]
        path_costs[n] = path[n + 1]
    return changed


@njit
def _scan_row(
    cost: NDArray[Any],
    fill: NDArray[Any],
    path_costs: NDArray[Any],
    leftward: bool,
    wrap: bool,
    p1: float,
    p2: float,
) -> None:
    """Write the L of one path along one row to path_costs (W, N), in laps until nothing changes."""
    W, N = cost.shape
    message = np.zeros(N, np.float32)
    path = np.full(N + 2, INFINITY)
    # Around the panorama a path has no beginning. The first lap starts from nothing, each other one
    # from the end of the last, until a pixel's costs repeat: so would all after it.
    for lap in range(MAX_LAPS if wrap else 1):
        for i in range(W):
            x = W - 1 - i if leftward else i
            lowest = _add_cost(cost[x], fill[x], message, path)
            if not _copy_if_changed(path, path_costs[x]) and lap > 0:
                return  # converged: the rest of the row cannot change
            _update_message(path, lowest, p1, p2, message)


@compiled(nogil=True)
def _scan_rows(
    cost: NDArray[Any], fill: NDArray[Any], total: NDArray[Any], wrap: bool, p1: float, p2: float
) -> bool:
    """Write the sum of the two paths along rows, and fill; return whether a cost is too large."""
    H, W, N = cost.shape
    too_large = False
    leftward = np.empty((W, N), np.float32)
    for y in range(H):
        for x in range(W):
            fill[y, x] = _fill_value(cost[y, x])
            too_large |= fill[y, x] == INFINITY
        _scan_row(cost[y], fill[y], total[y], False, wrap, p1, p2)
        _scan_row(cost[y], fill[y], leftward, True, wrap, p1, p2)
        for x in range(W):
            for n in range(N):
                c = cost[y, x, n]
                # C - C is 0, or NaN where C is NaN: an unknown cell stays unknown.
                total[y, x, n] += leftward[x, n] + (c - c)
    return too_large


@compiled(nogil=True)
def _advance(
    cost: NDArray[Any],
    fill: NDArray[Any],
    total: NDArray[Any],
    messages: NDArray[Any],
    tile: _Tile,
    diagonals: bool,
    wrap: bool,
    p1: float,
    p2: float,
) -> None:
    """Add the paths of a pass in columns [first + slope j, last − slope j) of row j of a band."""
    up, top, bottom, first, last, slope = tile
    H, W, N = cost.shape
    paths = np.zeros((3, N + 2), np.float32)
    for k in range(3):
        paths[k, 0] = paths[k, N + 1] = INFINITY
    for j in range(bottom - top):
        # `step` rows after the first of the pass, a diagonal has moved by as many columns.
        y = bottom - 1 - j if up else top + j
        step = H - 1 - y if up else y
        for column in range(first + slope * j, last - slope * j):
            x = column % W
            # 0: straight on, 1: to the right, 2: to the left
            for k in range(3 if diagonals else 1):
                # The scanline that crosses column x here began at column x, x - step or x + step.
                line = (x + (0, -step, step)[k]) % W
                message = messages[int(up), k, line]
                if not wrap and ((k == 1 and x == 0) or (k == 2 and x == W - 1)):
                    # Without wrapping, a diagonal that comes in from the side starts anew.
                    message.fill(0)
                lowest = _add_cost(cost[y, x], fill[y, x], message, paths[k])
                _update_message(paths[k], lowest, p1, p2, message)
            _add_paths(paths, total[y, x])


@njit
def _add_paths(paths: NDArray[Any], total: NDArray[Any]) -> None:
    for n in range(total.size):
        total[n] += paths[0, n + 1] + paths[1, n + 1] + paths[2, n + 1]
