"""The paths of SGM on a CPU: all threads at once, and no L_r of a whole volume is ever stored.

Rows first, each with its two paths. Then one pass from the top follows ↓ ↘ ↙ and one from the
bottom ↑ ↗ ↖. The last L of a path is kept in a slot of its scanline, which is (x − y) mod W for ↘,
and the next one written over it (6 W N floats for both passes, 6 MB at 1200×300×192): one loop over
n does all, message, cost, sum and minimum, and keeps the L(n − 1) that it has overwritten.

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
from omnistereo_lib.stereo.kernels.compiled import compiled, minimum
from omnistereo_lib.stereo.threads import map_threads

INFINITY: Any = np.float32(np.inf)
# Sums of costs and penalties below it are finite.
LARGEST = np.float32(1e30)
# The width of a strip in columns.
_STRIP = 128
# Floats of a cache line. In a slot L starts at the second one, with infinity behind it; the first
# begins with min L.
_LINE = 16
# A tile: up, top, bottom, first, last, slope.
_Tile = tuple[bool, int, int, int, int, int]


def sum_paths(
    cost: NDArray[Any], p1: float, p2: float, paths: int, wrap: bool
) -> tuple[Tensor, bool]:
    """Return Σ_r L_r of costs (H, W, N), and whether a cost is too large, as in `sgm`."""
    H, W, N = cost.shape
    # (H, W, N); NumPy asks the system for huge pages, torch does not.
    total = _aligned(cost.shape)
    # The data term of the unknown cells of each ray.
    fill = np.empty((H, W), np.float32)
    # Of the passes down and up: straight on, to the right, to the left.
    empty = _empty_slot(N)
    slots = _aligned((2, 3, W, len(empty)))
    slots[:] = empty

    # Along the rows, four at a time in a thread; this also fills the unknown cells.
    def rows(y: int) -> bool:
        return _scan_rows(cost[y : y + 4], fill[y : y + 4], total[y : y + 4], empty, wrap, p1, p2)

    too_large = any(list(map_threads(rows, range(0, H, 4))))

    # Across the rows, tile by tile.
    def advance(tile: _Tile) -> None:
        _advance(cost, fill, total, slots, empty, tile, paths == 8, wrap, p1, p2)

    for tiles in _tiles(H, W):
        list(map_threads(advance, tiles))
    return torch.from_numpy(total), too_large


def _empty_slot(N: int) -> NDArray[np.float32]:
    """Return the slot of a path that begins: its message is 0."""
    slot = np.zeros(_LINE * (2 + math.ceil(N / _LINE)), np.float32)
    slot[_LINE + N] = INFINITY
    return slot


def _aligned(shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return an array that begins with a cache line: vectors then stay within one."""
    size = math.prod(shape)
    floats = np.empty(size + _LINE, np.float32)
    first = -(floats.ctypes.data // floats.itemsize) % _LINE
    return floats[first : first + size].reshape(shape)


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


# Inlined by force: a call hands over each array as seven numbers, which takes as long as the loop.


@njit(forceinline=True)
def _known(cost: float, fill: float) -> Any:
    return cost if cost == cost else fill


@njit(forceinline=True)
def _message(before: float, at: float, after: float, p1: float, lowest: float, p2: float) -> Any:
    """Return the message M(n) to the next pixel of a path, given L(n - 1), L(n), L(n + 1), min L.

    M(n) = min(L(n), L(n ± 1) + P1, min L + P2) - min L: the neighbouring spheres cost P1, any other
    P2, and subtracting the minimum keeps the sums bounded (Hirschmüller 2008).
    """
    return minimum(minimum(at, minimum(before, after) + p1), lowest + p2) - lowest


@njit(forceinline=True)
def _scan_row(
    cost: NDArray[Any],
    fill: NDArray[Any],
    path: NDArray[Any],
    slot: NDArray[Any],
    leftward: bool,
    wrap: bool,
    p1: float,
    p2: float,
) -> None:
    """Write the L of one path along one row to path (W, N), in laps until nothing changes."""
    W, N = cost.shape
    # Around the panorama a path has no beginning. The first lap starts from nothing, each other one
    # from the end of the last, until a pixel's costs repeat: so would all after it.
    for lap in range(MAX_LAPS if wrap else 1):
        for i in range(W):
            x = W - 1 - i if leftward else i
            c, f, row = cost[x], fill[x], path[x]
            lowest, least, before, changed = slot[0], INFINITY, INFINITY, lap == 0
            for n in range(N):
                k = n + _LINE
                at = slot[k]
                L = _known(c[n], f) + _message(before, at, slot[k + 1], p1, lowest, p2)
                changed |= row[n] != L
                slot[k] = row[n] = L
                least, before = minimum(least, L), at
            if not changed:
                return  # converged: the rest of the row cannot change
            slot[0] = least


@compiled(nogil=True)
def _scan_rows(
    cost: NDArray[Any],
    fill: NDArray[Any],
    total: NDArray[Any],
    empty: NDArray[Any],
    wrap: bool,
    p1: float,
    p2: float,
) -> bool:
    """Write the sum of the two paths along rows, and fill; return whether a cost is too large."""
    H, W, N = cost.shape
    too_large = False
    leftward, slot = np.empty((W, N), np.float32), np.empty_like(empty)
    for y in range(H):
        for x in range(W):
            fill[y, x] = _fill_value(cost[y, x])
            too_large |= fill[y, x] == INFINITY
        for back, path in ((False, total[y]), (True, leftward)):
            slot[:] = empty
            _scan_row(cost[y], fill[y], path, slot, back, wrap, p1, p2)
        for x in range(W):
            for n in range(N):
                c = cost[y, x, n]
                # C - C is 0, or NaN where C is NaN: an unknown cell stays unknown.
                total[y, x, n] += leftward[x, n] + (c - c)
    return too_large


@njit(forceinline=True)
def _extend_one(
    cost: NDArray[Any],
    fill: NDArray[Any],
    slots: NDArray[Any],
    p1: float,
    p2: float,
    total: NDArray[Any],
) -> None:
    """Extend one path by a pixel in each column, and add it."""
    columns, N = cost.shape
    for x in range(columns):
        lowest, least, before = slots[x, 0], INFINITY, INFINITY
        for n in range(N):
            k = n + _LINE
            at = slots[x, k]
            L = _known(cost[x, n], fill[x]) + _message(before, at, slots[x, k + 1], p1, lowest, p2)
            slots[x, k] = L
            total[x, n] += L
            least, before = minimum(least, L), at
        slots[x, 0] = least


@njit(forceinline=True)
def _extend_three(
    cost: NDArray[Any],
    fill: NDArray[Any],
    slots_a: NDArray[Any],
    slots_b: NDArray[Any],
    slots_c: NDArray[Any],
    p1: float,
    p2: float,
    total: NDArray[Any],
) -> None:
    """Extend three paths by a pixel in each column, and add them."""
    columns, N = cost.shape
    for x in range(columns):
        low_a, low_b, low_c, f = slots_a[x, 0], slots_b[x, 0], slots_c[x, 0], fill[x]
        least_a = least_b = least_c = before_a = before_b = before_c = INFINITY
        for n in range(N):
            k, c = n + _LINE, _known(cost[x, n], f)
            at_a, at_b, at_c = slots_a[x, k], slots_b[x, k], slots_c[x, k]
            a = c + _message(before_a, at_a, slots_a[x, k + 1], p1, low_a, p2)
            b = c + _message(before_b, at_b, slots_b[x, k + 1], p1, low_b, p2)
            d = c + _message(before_c, at_c, slots_c[x, k + 1], p1, low_c, p2)
            slots_a[x, k], slots_b[x, k], slots_c[x, k] = a, b, d
            total[x, n] += a + b + d
            least_a, before_a = minimum(least_a, a), at_a
            least_b, before_b = minimum(least_b, b), at_b
            least_c, before_c = minimum(least_c, d), at_c
        slots_a[x, 0], slots_b[x, 0], slots_c[x, 0] = least_a, least_b, least_c


@compiled(nogil=True)
def _advance(
    cost: NDArray[Any],
    fill: NDArray[Any],
    total: NDArray[Any],
    slots: NDArray[Any],
    empty: NDArray[Any],
    tile: _Tile,
    diagonals: bool,
    wrap: bool,
    p1: float,
    p2: float,
) -> None:
    """Add the paths of a pass in columns [first + slope j, last − slope j) of row j of a band."""
    up, top, bottom, first, last, slope = tile
    H, W, _N = cost.shape
    for j in range(bottom - top):
        # `step` rows after the first of the pass, a diagonal has moved by as many columns.
        y = bottom - 1 - j if up else top + j
        step = H - 1 - y if up else y
        line, column, stop = slots[int(up)], first + slope * j, last - slope * j
        while column < stop:
            # The scanlines that cross column x here began at columns x, a = x - step, b = x + step.
            x, a, b = column % W, (column - step) % W, (column + step) % W
            size = min(stop - column, W - max(x, a, b))
            # Without wrapping, a diagonal that comes in from the side starts anew.
            if not wrap and x == 0:
                line[1, a] = empty
            if not wrap and x + size == W:
                line[2, b + size - 1] = empty
            of_x, of_a, of_b = slice(x, x + size), slice(a, a + size), slice(b, b + size)
            c, f, s = cost[y, of_x], fill[y, of_x], total[y, of_x]
            if diagonals:
                _extend_three(c, f, line[0, of_x], line[1, of_a], line[2, of_b], p1, p2, s)
            else:
                _extend_one(c, f, line[0, of_x], p1, p2, s)
            column += size
