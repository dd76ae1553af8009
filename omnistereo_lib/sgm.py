"""Semi-global matching of a cost volume, around the seam of the panorama (H. Hirschmüller, TPAMI 2008).

A cost volume says how badly each sphere n fits each ray p, ray by ray. Neighbouring rays mostly look at
the same surface, so SGM walks over the panorama along straight paths r and lets every pixel pass on what
it and those before it have found:

    L_r(p, n) = C(p, n) + min(L_r(p−r, n), L_r(p−r, n±1) + P1, min_k L_r(p−r, k) + P2) − min_k L_r(p−r, k)
    S(p, n)   = Σ_r L_r(p, n)

P1 is the price of one step in n (a slanted surface), P2 that of any jump (an edge). We write the right-hand
side as C(p, n) + M(n), where M is the *message* from p−r: 0 at the best sphere, never above P2. A path starts
with M = 0, "nothing known".

One pass from the top takes the paths → ↓ ↘ ↙ together, one from the bottom ← ↑ ↖ ↗, so C is read twice and
no L_r is ever stored whole. A message belongs to a scanline, not to a pixel: each vertical or diagonal line
has its slot, (x − y) mod W for ↘, which the next row updates in place. The slots of one row's pixels are all
different, which is why threads may share out its columns. Besides C and S that takes 3 W N floats, and W N
for each thread (2.8 and 0.9 MB at 1200×300×192).
"""

import math
import threading
from typing import Any

import numba
import numpy as np
import torch
from numba import njit, prange
from numba.extending import intrinsic
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import pad

from omnistereo_lib.errors import OmnistereoError

MAX_LAPS = 64
INFINITY = np.float32(np.inf)
_LOCK = threading.Lock()  # Numba's built-in thread pool ends the process when two Python threads enter it


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
        True: column 0 follows column W−1. Diagonals go on across the seam; a row, which then has no first
        pixel, is run in laps from column 0 (leftward: W−1), each from the message that the lap before it
        ended with, until a lap changes nothing. Images take 2 or 3 laps, the later ones mostly short; rows
        with hardly any texture may need about P2 / (gap between best and second best cost), and stop after
        ``MAX_LAPS``. False: the textbook's flat image.

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
        total = volume if infinite else _sgm_torch(volume, p1, p2, paths, wrap)
    else:
        threads = min(torch.get_num_threads(), numba.config.NUMBA_NUM_THREADS)
        result = np.empty(volume.shape, np.float32)  # NumPy asks for huge pages, torch does not
        with _LOCK:
            infinite = _sgm_numba(volume.numpy(), result, np.float32(p1), np.float32(p2), paths == 8, wrap, threads)
        total = torch.from_numpy(result)
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
    for n in range(path.size):
        changed |= path[n] != kept[n]
        kept[n] = path[n]
    return changed


@njit
def _scan_row(cost: NDArray, kept: NDArray, backward: bool, wrap: bool, p1: float, p2: float) -> None:
    """Horizontal path along one row, into kept (W, N + 2), in laps until nothing changes."""
    W, N = cost.shape
    message = np.zeros(N, np.float32)
    path = np.full(N + 2, INFINITY)
    for lap in range(MAX_LAPS if wrap else 1):
        for i in range(W):
            x = W - 1 - i if backward else i
            lowest = _extend(cost[x], message, path)
            if not _replace(path, kept[x]) and lap > 0:
                return  # so is all that follows
            _send(path, lowest, p1, p2, message)


@njit
def _add_up(cost: NDArray, row: NDArray, paths: NDArray, total: NDArray, first: bool) -> None:
    """Add one pixel's four paths to S."""
    for n in range(total.size):
        before = cost[n] - cost[n] if first else total[n]  # 0, but NaN where C is, and that stays
        total[n] = before + (row[n + 1] + paths[0, n + 1]) + (paths[1, n + 1] + paths[2, n + 1])


@njit
def _advance(
    cost: NDArray,
    row: NDArray,
    messages: NDArray,
    total: NDArray,
    columns: tuple[int, int],
    step: int,
    first: bool,
    diagonals: bool,
    wrap: bool,
    p1: float,
    p2: float,
) -> None:
    """Take the vertical and diagonal paths into a row, the step-th of its pass, for some of its columns."""
    W, N = cost.shape
    paths = np.zeros((3, N + 2), np.float32)
    for k in range(3):
        paths[k, 0] = paths[k, N + 1] = INFINITY
    for x in range(columns[0], columns[1]):
        for k in range(3 if diagonals else 1):  # k = 0: straight on, 1: rightward, 2: leftward
            line = (x + (0, -step, step)[k]) % W
            message = messages[k, line]
            if not wrap and ((k == 1 and x == 0) or (k == 2 and x == W - 1)):
                message.fill(0)
            lowest = _extend(cost[x], message, paths[k])
            _send(paths[k], lowest, p1, p2, message)
        _add_up(cost[x], row[x], paths, total[x], first)


@njit
def _has_infinity(cost: NDArray) -> bool:
    found = False
    for x in range(cost.shape[0]):
        for n in range(cost.shape[1]):
            found |= abs(cost[x, n]) == INFINITY
    return found


@njit(parallel=True, cache=True)
def _sgm_numba(
    volume: NDArray, total: NDArray, p1: float, p2: float, diagonals: bool, wrap: bool, threads: int
) -> bool:
    """Write S to total; return whether a cost is infinite. Each thread scans a row, then a part of all these rows."""
    H, W, N = volume.shape
    infinite = np.zeros(H, np.bool_)
    rows = np.full((threads, W, N + 2), INFINITY)
    for up in range(2):
        messages = np.zeros((3, W, N), np.float32)
        for start in range(0, H, threads):
            count = min(threads, H - start)
            for k in prange(count):
                y = H - 1 - start - k if up else start + k
                if not up:
                    infinite[y] = _has_infinity(volume[y])
                _scan_row(volume[y], rows[k], up, wrap, p1, p2)
            for k in range(count):
                step = start + k
                y = H - 1 - step if up else step
                for t in prange(threads):
                    columns = (W * t // threads, W * (t + 1) // threads)
                    _advance(volume[y], rows[k], messages, total[y], columns, step, not up, diagonals, wrap, p1, p2)
    return infinite.any()


# ---- Any device: whole rows and columns at once, the panorama and its half turn side by side.


def _sgm_torch(volume: Tensor, p1: float, p2: float, paths: int, wrap: bool) -> Tensor:
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
