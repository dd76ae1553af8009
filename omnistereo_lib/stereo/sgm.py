"""Semi-global matching of a cost volume, across the ±180° seam of the panorama (H. Hirschmüller, TPAMI 2008).

A cost volume states how badly each sphere n fits each ray p, independently of the other rays. Neighbouring rays
mostly see the same surface, so SGM follows straight paths r over the panorama, and every pixel passes on the costs
that were collected along the path (paper, Section III-B and IV)::

    L_r(p, n) = C(p, n) + min(L_r(p−r, n), L_r(p−r, n±1) + P1, min_k L_r(p−r, k) + P2) − min_k L_r(p−r, k)
    S(p, n)   = Σ_r L_r(p, n)

P1 is the price of one step in n (a slanted surface), P2 that of any jump (an edge). The code writes the right-hand
side as C(p, n) + M(n), where M is the *message* from p−r: 0 at the best sphere, at most P2. A path starts with M = 0.

An unknown cell (NaN) has no data term. In the recurrence it takes the mean cost of the known cells of its ray: it is
then neither better nor worse than the other spheres, and the messages decide. A ray without known cells is like one
of constant cost. Unknown cells are NaN in S and so never the best sphere.

Implementation: rows first, each with its two paths. Then one pass from the top follows ↓ ↘ ↙ and one from the bottom
↑ ↗ ↖; no L_r is stored whole. A message belongs to a scanline, not to a pixel: each vertical or diagonal line has its
slot, (x − y) mod W for ↘, which the next row updates in place (6 W N floats for both passes, 5.5 MB at 1200×300×192).

Threads never write to the same memory at the same time. The two passes start at opposite ends and run at once, one
band of rows each. A band is cut into strips of columns. Because a path moves by at most one column per row, the part
of a strip that narrows by one column per row on either side needs nothing from the neighbouring strips: first all
these trapezoids run, then the triangles between them. The tiles also keep the data of a thread in its cache.
"""

import math
from collections.abc import Iterator
from importlib.util import find_spec
from itertools import pairwise
from numbers import Real
from typing import Any

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import pad

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.stereo.compiled import compiled, minimum
from omnistereo_lib.stereo.threads import map_threads
from omnistereo_lib.stereo.volume import as_volume

MAX_LAPS = 64
INFINITY = np.float32(np.inf)
LARGEST = np.float32(1e30)  # sums of costs and penalties below it are finite
_STRIP = 128  # columns
_Tile = tuple[bool, int, int, int, int, int]  # up, top, bottom, first, last, slope


def sgm(volume: Tensor | np.ndarray, p1: float = 0.1, p2: float = 12.0, paths: int = 8, wrap: bool = True) -> Tensor:
    """Aggregate a cost volume by semi-global matching: S = Σ_r L_r (paper, Section III-B; see the module).

    Args:
        volume (shape (H, W, N)): Matching cost C, lower is better; NaN is unknown. Computed in float32.
        p1, p2: Penalties for a step of one sphere and for any larger jump, in units of the cost, 0 ≤ p1 ≤ p2.
        paths: 4 (along rows and columns) or 8 (diagonals as well).
        wrap: True: column 0 follows column W−1, for diagonals as well. A row then has no first pixel. It runs in laps
            around the panorama, starting at column 0 (leftward: W−1) with M = 0, each lap with the last message of the
            lap before, until a lap changes nothing. Images take two or three laps, of which the later ones end early.
            The laps stop after ``MAX_LAPS``: a row with hardly any texture may take P2 / (gap between the best and the
            next cost) of them, and a row of a few pixels may alternate for ever. False: the flat image of the textbook.

    Returns:
        (H, W, N) float32 tensor on the device of the volume: S, with C ≤ L_r ≤ C + P2 for each path, not divided by the
            number of paths; NaN where the volume is NaN.

    Note:
        The CPU version uses ``torch.get_num_threads()`` threads; results do not depend on their number. It needs one
        more volume of memory. A GPU needs two more, or three
        where Triton is not installed.

    Raises:
        OmnistereoError: If the volume is not 3-D, has fewer than 2 spheres or infinite costs, or p1, p2 or paths is out
            of range.

    >>> volume = np.ones((5, 8, 6), np.float32)
    >>> volume[..., 3] = 0  # every ray at sphere 3,
    >>> volume[2, 4, 3], volume[2, 4, 0] = 0.5, 0.4  # but for noise at one
    >>> int(volume[2, 4].argmin()), int(osl.sgm(volume, p1=0.1, p2=1.0)[2, 4].argmin())
    (0, 3)
    """
    volume = as_volume(volume).to(torch.float32).contiguous()
    if paths not in (4, 8):
        raise OmnistereoError(f"sgm: paths is {paths!r}; expected 4 or 8")
    if not (isinstance(p1, Real) and isinstance(p2, Real) and 0 <= p1 <= p2 < LARGEST):
        raise OmnistereoError(f"sgm: penalties are p1 = {p1!r}, p2 = {p2!r}; expected finite numbers, 0 ≤ p1 ≤ p2")
    if volume.device.type != "cpu":
        too_large = bool((volume.abs() >= LARGEST).any())  # false for NaN
        total = volume if too_large else sgm_gpu(volume, p1, p2, paths, wrap)
    else:
        total, too_large = _sgm_numba(volume.numpy(), np.float32(p1), np.float32(p2), paths == 8, wrap)
    if too_large:
        raise OmnistereoError(f"sgm: a cost is infinite, or {LARGEST:g} or more. Set unknown cells to NaN.")
    return total


# ---- CPU: one pixel at a time; the compiler vectorises the loops over n.


def _sgm_numba(cost: NDArray[Any], p1: float, p2: float, diagonals: bool, wrap: bool) -> tuple[Tensor, bool]:
    """Return S, and whether a cost is too large."""
    H, W, N = cost.shape
    total = np.empty_like(cost)  # (H, W, N); NumPy asks for huge pages, torch does not
    fill = np.empty((H, W), np.float32)  # the data term of a ray's unknown cells
    messages = np.zeros((2, 3, W, N), np.float32)  # of the passes down and up: straight on, to the right, to the left

    def rows(y: int) -> bool:
        return _scan_rows(cost[y : y + 4], fill[y : y + 4], total[y : y + 4], wrap, p1, p2)

    too_large = any(list(map_threads(rows, range(0, H, 4))))

    def advance(tile: _Tile) -> None:
        _advance(cost, fill, total, messages, tile, diagonals, wrap, p1, p2)

    for tiles in _tiles(H, W):
        list(map_threads(advance, tiles))
    return torch.from_numpy(total), too_large


def _tiles(H: int, W: int) -> Iterator[list[_Tile]]:
    """Yield lists of tiles that can run at the same time."""
    strips = max(1, W // _STRIP)
    columns = [W * i // strips for i in range(strips + 1)]
    depth = max(1, W // strips // 2)  # rows until a trapezoid that narrows on both sides ends
    bands = 2 * math.ceil(H / depth / 2)  # even, so that the passes meet between two bands
    rows = list(pairwise(H * i // bands for i in range(bands + 1)))
    for down, up in zip(rows, reversed(rows), strict=True):
        yield [(*band, first, last, 1) for band in ((False, *down), (True, *up)) for first, last in pairwise(columns)]
        yield [(*band, last, last, -1) for band in ((False, *down), (True, *up)) for last in columns[1:]]


@njit
def _fill_value(cost: NDArray[Any]) -> np.float32:
    """Return the data term of the unknown cells of a ray: the mean of its known costs, infinite if one is too large."""
    regular = True
    for n in range(cost.size):
        regular &= abs(cost[n]) < LARGEST  # false for NaN
    if regular:
        return np.float32(0)  # not used
    total, known = 0.0, 0
    for n in range(cost.size):
        if cost[n] == cost[n]:
            if not abs(cost[n]) < LARGEST:
                return INFINITY
            total += cost[n]
            known += 1
    return np.float32(total / max(known, 1))


@njit
def _add_cost(cost: NDArray[Any], fill: float, message: NDArray[Any], path: NDArray[Any]) -> np.float32:
    """Extend a path by one pixel, L = C + M; return the lowest L. path is (N + 2,), its ends stay infinite."""
    lowest = INFINITY
    for n in range(cost.size):
        c = cost[n] if cost[n] == cost[n] else fill
        path[n + 1] = c + message[n]
        lowest = minimum(lowest, path[n + 1])
    return lowest


@njit
def _update_message(path: NDArray[Any], lowest: float, p1: float, p2: float, message: NDArray[Any]) -> None:
    """Write the message M to the next pixel of the path."""
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
    cost: NDArray[Any], fill: NDArray[Any], path_costs: NDArray[Any], leftward: bool, wrap: bool, p1: float, p2: float
) -> None:
    """Write the L of one path along one row to path_costs (W, N), in laps until nothing changes."""
    W, N = cost.shape
    message = np.zeros(N, np.float32)
    path = np.full(N + 2, INFINITY)
    for lap in range(MAX_LAPS if wrap else 1):
        for i in range(W):
            x = W - 1 - i if leftward else i
            lowest = _add_cost(cost[x], fill[x], message, path)
            if not _copy_if_changed(path, path_costs[x]) and lap > 0:
                return  # converged: the rest of the row cannot change
            _update_message(path, lowest, p1, p2, message)


@compiled(nogil=True)
def _scan_rows(cost: NDArray[Any], fill: NDArray[Any], total: NDArray[Any], wrap: bool, p1: float, p2: float) -> bool:
    """Write the sum of the two paths along rows to total, and fill; return whether a cost is too large."""
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
                total[y, x, n] += leftward[x, n] + (c - c)  # NaN where C is, which stays
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
    """Add the three paths of a pass to total, in the columns [first + slope j, last − slope j) of row j of a band."""
    up, top, bottom, first, last, slope = tile
    H, W, N = cost.shape
    paths = np.zeros((3, N + 2), np.float32)
    for k in range(3):
        paths[k, 0] = paths[k, N + 1] = INFINITY
    for j in range(bottom - top):
        y = bottom - 1 - j if up else top + j
        step = H - 1 - y if up else y
        for column in range(first + slope * j, last - slope * j):
            x = column % W
            for k in range(3 if diagonals else 1):  # 0: straight on, 1: to the right, 2: to the left
                line = (x + (0, -step, step)[k]) % W
                message = messages[int(up), k, line]
                if not wrap and ((k == 1 and x == 0) or (k == 2 and x == W - 1)):
                    message.fill(0)
                lowest = _add_cost(cost[y, x], fill[y, x], message, paths[k])
                _update_message(paths[k], lowest, p1, p2, message)
            _add_paths(paths, total[y, x])


@njit
def _add_paths(paths: NDArray[Any], total: NDArray[Any]) -> None:
    for n in range(total.size):
        total[n] += paths[0, n + 1] + paths[1, n + 1] + paths[2, n + 1]


# ---- GPU: by Triton where it is installed, as with torch for CUDA on Linux; else by torch.


def sgm_gpu(volume: Tensor, p1: float, p2: float, paths: int, wrap: bool) -> Tensor:
    """Return S of a volume on a GPU without infinite costs; arguments as in `sgm`."""
    if find_spec("triton") is None:
        return sgm_torch(volume, p1, p2, paths, wrap)
    from omnistereo_lib.stereo.sgm_triton import sum_paths

    total = sum_paths(_fill_unknown(volume), p1, p2, paths, wrap, MAX_LAPS)
    return total.masked_fill_(volume.isnan(), math.nan)


def _fill_unknown(volume: Tensor) -> Tensor:
    """Return a copy of a volume whose unknown cells have the mean cost of their ray, 0 where no cell is known."""
    cost = volume.clone()
    for rows in cost.split(16):  # some rows at a time: no further copy of the volume
        rows.copy_(torch.where(rows.isnan(), rows.nanmean(-1, keepdim=True).nan_to_num(0.0), rows))
    return cost


# ---- Any device: whole rows and columns at once, both directions of a path side by side.


def sgm_torch(volume: Tensor, p1: float, p2: float, paths: int, wrap: bool) -> Tensor:
    """Return S of a volume without infinite costs, in the precision of the volume."""
    cost = _fill_unknown(volume)
    total = _scan_columns(cost, p1, p2, MAX_LAPS if wrap else 1)
    H, W, N = volume.shape
    messages = cost.new_zeros(3 if paths == 8 else 1, 2, W, N)
    for y in range(H):
        path = torch.stack((cost[y], cost[H - 1 - y])) + messages  # ↓ ↘ ↙ and ↑ ↗ ↖
        total[y] += path[:, 0].sum(0)
        total[H - 1 - y] += path[:, 1].sum(0)
        messages = _next_messages(path, p1, p2)
        for k, shift in ((1, 1), (2, -1)) if paths == 8 else ():
            messages[k] = messages[k].roll(shift, -2)
            if not wrap:
                messages[k, :, 0 if shift > 0 else -1] = 0
    return total.masked_fill_(volume.isnan(), math.nan)


def _scan_columns(cost: Tensor, p1: float, p2: float, laps: int) -> Tensor:
    """Return the sum of the L of the paths → and ←."""
    right, left = torch.empty_like(cost), torch.empty_like(cost)
    H, W, N = cost.shape
    message = cost.new_zeros(2, H, N)
    for _ in range(laps):
        before = message
        for x in range(W):
            path = torch.stack((cost[:, x], cost[:, W - 1 - x])) + message
            right[:, x], left[:, W - 1 - x] = path
            message = _next_messages(path, p1, p2)
        if torch.equal(message, before):
            break
    return right.add_(left)


def _next_messages(path: Tensor, p1: float, p2: float) -> Tensor:
    lowest = path.amin(-1, keepdim=True)
    padded = pad(path, (1, 1), value=math.inf)
    step = torch.minimum(padded[..., :-2], padded[..., 2:]) + p1
    return torch.minimum(torch.minimum(path, step), lowest + p2) - lowest
