"""Semi-global matching of a cost volume, around the seam of the panorama (H. Hirschmüller, TPAMI 2008).

A cost volume says how badly each sphere n fits each ray p, ray by ray. Neighbouring rays mostly look at
the same surface, so SGM walks over the panorama along straight paths r and lets every pixel pass on what
it and those before it have found::

    L_r(p, n) = C(p, n) + min(L_r(p−r, n), L_r(p−r, n±1) + P1, min_k L_r(p−r, k) + P2) − min_k L_r(p−r, k)
    S(p, n)   = Σ_r L_r(p, n)

P1 is the price of one step in n (a slanted surface), P2 that of any jump (an edge). We write the right-hand
side as C(p, n) + M(n), where M is the *message* from p−r: 0 at the best sphere, never above P2. A path starts
with M = 0, "nothing known".

Rows are run first, each with its two paths. Then one pass from the top takes ↓ ↘ ↙ and one from the bottom
↑ ↗ ↖; no L_r is ever stored whole. A message belongs to a scanline, not to a pixel: each vertical or diagonal
line has its slot, (x − y) mod W for ↘, which the next row updates in place (6 W N floats for both passes, 5.5 MB
at 1200×300×192).

Threads share that work without ever touching the same number at the same time. The two passes start from
opposite ends and run at once, a band of rows each. A band is cut into strips of columns, and because a path
moves by at most one column per row, the part of a strip that narrows by one column on either side from row to
row needs nothing from its neighbours: first all these trapezoids, then the triangles left between them. They
also keep what a thread works on in its cache.
"""

import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import numba
import numpy as np
import torch
from numba import njit
from numba.extending import intrinsic
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import pad

from omnistereo_lib.errors import OmnistereoError

MAX_LAPS = 64
INFINITY = np.float32(np.inf)
STRIP = 128  # columns


def sgm(volume: Tensor | np.ndarray, p1: float = 0.1, p2: float = 12.0, paths: int = 8, wrap: bool = True) -> Tensor:
    """Smooth a cost volume by semi-global matching: S = Σ_r L_r (see the module's head).

    Parameters
    ----------
    volume : (H, W, N)
        Matching cost C, lower is better; NaN where nothing is known. Computed in float32.
    p1, p2 : float
        Penalties for a step of one sphere and for any larger jump, in units of the cost, 0 ≤ p1 ≤ p2.
    paths : int
        4 (along rows and columns) or 8 (diagonals too).
    wrap : bool
        True: column 0 follows column W−1. Diagonals go on across the seam. A row then has no first pixel: it
        is run in laps, from column 0 (leftward: W−1) with M = 0, each lap from the message that the one before
        it ended with, until a lap changes nothing. Images take two or three laps, and the later ones end early.
        The laps stop after ``MAX_LAPS``: a row with hardly any texture may take P2 / (gap between the best and
        the next cost) of them, and one of a few pixels may alternate for ever, when the best way to close the
        circle is to run round it twice. False: the textbook's flat image.

    Returns
    -------
    (H, W, N) float32 tensor on the volume's device
        S, with C ≤ L_r ≤ C + P2 for each path. The paper divides by nothing, nor do we.

    Notes
    -----
    A NaN cell counts as infinitely expensive: it is never the best, and its message is the worst that P1 and
    P2 allow. (Any value of at least max C + 2 P2 would do the same; this is Pandora's rule.) A ray of NaN
    alone has no opinion and counts as one of constant cost: messages cross it. NaN cells are NaN again in S.

    The CPU runs as many threads as ``torch.get_num_threads()``; results do not depend on their number. Other
    devices run plain torch operations, one row or column at a time, in the memory of about eight volumes.

    Raises
    ------
    OmnistereoError
        If the volume is not 3-D, has fewer than two spheres or infinite costs, or for other penalties or
        numbers of paths than the above.
    """
    volume = torch.as_tensor(volume).detach().to(torch.float32).contiguous()
    _check(volume, p1, p2, paths)
    if volume.device.type != "cpu":
        infinite = bool(volume.isinf().any())
        total = volume if infinite else sgm_torch(volume, p1, p2, paths, wrap)
    else:
        total, infinite = _sgm_numba(volume.numpy(), np.float32(p1), np.float32(p2), paths == 8, wrap)
    if infinite:
        raise OmnistereoError("sgm: the volume has infinite costs; mark cells that nothing sees with NaN")
    return total


def _check(volume: Tensor, p1: float, p2: float, paths: int) -> None:
    if volume.ndim != 3 or 0 in volume.shape or volume.shape[2] < 2:
        raise OmnistereoError(
            f"sgm: volume has shape {tuple(volume.shape)}; expected (height, width, spheres) with two or more spheres"
        )
    if paths not in (4, 8):
        raise OmnistereoError(f"sgm: paths is {paths!r}; expected 4 or 8")
    if not (math.isfinite(p1) and math.isfinite(p2) and 0 <= p1 <= p2):
        raise OmnistereoError(f"sgm: penalties are p1 = {p1}, p2 = {p2}; expected finite numbers, 0 <= p1 <= p2")


# ---- CPU. One pixel at a time; the loops over n are the ones that the compiler turns into vector code.


def _sgm_numba(cost: NDArray, p1: float, p2: float, diagonals: bool, wrap: bool) -> tuple[Tensor, bool]:
    """Return S, and whether a cost is infinite."""
    H, W, N = cost.shape
    total = np.empty_like(cost)  # NumPy asks for huge pages, torch does not
    messages = np.zeros((2, 3, W, N), np.float32)
    with ThreadPoolExecutor(torch.get_num_threads()) as pool:

        def rows(y: int) -> bool:
            return _scan_rows(cost[y : y + 4], total[y : y + 4], wrap, p1, p2)

        infinite = any(list(pool.map(rows, range(0, H, 4))))

        def tile(area: tuple) -> None:
            _advance(cost, total, messages, *area, diagonals, wrap, p1, p2)

        for areas in _tiles(H, W):
            list(pool.map(tile, areas))
    return torch.from_numpy(total), infinite


def _tiles(H: int, W: int) -> Iterator[list[tuple]]:
    """Yield lists of tiles that may be worked on at the same time, as (up, top, bottom, first, last, slope)."""
    strips = max(1, W // STRIP)
    columns = [W * i // strips for i in range(strips + 1)]
    depth = max(1, W // strips // 2)  # a trapezoid that narrows from both sides ends there
    bands = 2 * math.ceil(H / depth / 2)  # even, so that the passes meet between two bands
    rows = list(pairwise(H * i // bands for i in range(bands + 1)))
    for down, up in zip(rows, reversed(rows), strict=True):
        yield [(*band, first, last, 1) for band in ((False, *down), (True, *up)) for first, last in pairwise(columns)]
        yield [(*band, last, last, -1) for band in ((False, *down), (True, *up)) for last in columns[1:]]


@intrinsic
def _min(context: Any, a: Any, b: Any) -> Any:
    """min(a, b) of float32 that are not NaN. Python's min, in Numba, keeps a reduction from vectorising."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        flags = ("nnan", "nsz")
        return builder.select(builder.fcmp_ordered("<", *args, flags=flags), *args, flags=flags)

    return numba.float32(numba.float32, numba.float32), build


@njit
def _extend(cost: NDArray, message: NDArray, path: NDArray) -> float:
    """Take a path one pixel on, L = C + M; return the lowest L. path is (N + 2,), its ends stay infinite."""
    lowest = INFINITY
    for n in range(cost.size):
        seen = cost[n] if cost[n] < INFINITY else INFINITY  # false for NaN
        path[n + 1] = seen + message[n]
        lowest = _min(lowest, path[n + 1])
    if lowest == INFINITY:  # nothing is known of this ray: any constant C, here 0, lets messages through
        for n in range(cost.size):
            path[n + 1] = message[n]
        return np.float32(0)
    return lowest


@njit
def _send(path: NDArray, lowest: float, p1: float, p2: float, message: NDArray) -> None:
    """Write the message M to the next pixel of the path."""
    jump = lowest + p2
    for n in range(message.size):
        step = _min(path[n], path[n + 2]) + p1
        message[n] = _min(_min(path[n + 1], step), jump) - lowest


@njit
def _replace(path: NDArray, kept: NDArray) -> bool:
    """Copy path to kept; return whether that changed anything."""
    changed = False
    for n in range(kept.size):
        changed |= path[n + 1] != kept[n]
        kept[n] = path[n + 1]
    return changed


@njit
def _scan_row(cost: NDArray, kept: NDArray, leftward: bool, wrap: bool, p1: float, p2: float) -> None:
    """Write the L of one path along one row to kept (W, N), in laps until nothing changes."""
    W, N = cost.shape
    message = np.zeros(N, np.float32)
    path = np.full(N + 2, INFINITY)
    for lap in range(MAX_LAPS if wrap else 1):
        for i in range(W):
            x = W - 1 - i if leftward else i
            lowest = _extend(cost[x], message, path)
            if not _replace(path, kept[x]) and lap > 0:
                return  # so is all that follows
            _send(path, lowest, p1, p2, message)


@njit(nogil=True, cache=True)
def _scan_rows(cost: NDArray, total: NDArray, wrap: bool, p1: float, p2: float) -> bool:
    """Write the sum of the two paths along rows to total; return whether a cost is infinite."""
    infinite = False
    leftward = np.empty(cost.shape[1:], np.float32)
    for y in range(len(cost)):
        _scan_row(cost[y], total[y], False, wrap, p1, p2)
        _scan_row(cost[y], leftward, True, wrap, p1, p2)
        for x in range(len(leftward)):
            for n in range(leftward.shape[1]):
                c = cost[y, x, n]
                infinite |= abs(c) == INFINITY
                total[y, x, n] += leftward[x, n] + (c - c)  # NaN where C is, and that stays
    return infinite


@njit(nogil=True, cache=True)
def _advance(
    cost: NDArray,
    total: NDArray,
    messages: NDArray,
    up: bool,
    top: int,
    bottom: int,
    first: int,
    last: int,
    slope: int,
    diagonals: bool,
    wrap: bool,
    p1: float,
    p2: float,
) -> None:
    """Add the three paths of a pass to total, in the columns first + slope j ... last − slope j of a band's row j."""
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
                lowest = _extend(cost[y, x], message, paths[k])
                _send(paths[k], lowest, p1, p2, message)
            _add(paths, total[y, x])


@njit
def _add(paths: NDArray, total: NDArray) -> None:
    for n in range(total.size):
        total[n] += paths[0, n + 1] + paths[1, n + 1] + paths[2, n + 1]


# ---- Any device: whole rows and columns at once, the panorama and its half turn side by side.


def sgm_torch(volume: Tensor, p1: float, p2: float, paths: int, wrap: bool) -> Tensor:
    """Return S of a volume without infinite costs, in the volume's own precision."""
    unknown = volume.isnan()
    cost = torch.where(unknown, math.inf, volume)
    cost[unknown.all(-1)] = 0  # nothing is known of these rays: any constant lets messages through
    cost = torch.stack((cost, cost.flip(0, 1)))  # after half a turn, ← ↑ ↖ ↗ are → ↓ ↘ ↙
    total = _scan_columns(cost, p1, p2, MAX_LAPS if wrap else 1)
    H, W, N = volume.shape
    messages = cost.new_zeros(3 if paths == 8 else 1, 2, W, N)
    for y in range(H):
        path = cost[:, y] + messages
        total[:, y] += path.sum(0)
        messages = _messages(path, p1, p2)
        for k, shift in ((1, 1), (2, -1)) if paths == 8 else ():
            messages[k] = messages[k].roll(shift, -2)
            if not wrap:
                messages[k, :, 0 if shift > 0 else -1] = 0
    return (total[0] + total[1].flip(0, 1)).masked_fill(unknown, math.nan)


def _scan_columns(cost: Tensor, p1: float, p2: float, laps: int) -> Tensor:
    """Return L of the paths from left to right."""
    path = torch.empty_like(cost)
    message = torch.zeros_like(cost[:, :, 0])
    for _ in range(laps):
        before = message
        for x in range(cost.shape[2]):
            path[:, :, x] = cost[:, :, x] + message
            message = _messages(path[:, :, x], p1, p2)
        if torch.equal(message, before):
            break
    return path


def _messages(path: Tensor, p1: float, p2: float) -> Tensor:
    lowest = path.amin(-1, keepdim=True)
    padded = pad(path, (1, 1), value=math.inf)
    step = torch.minimum(padded[..., :-2], padded[..., 2:]) + p1
    return torch.minimum(torch.minimum(path, step), lowest + p2) - lowest
