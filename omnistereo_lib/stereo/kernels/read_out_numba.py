"""From VolumeNet's logits to costs, and from these to depth, ray by ray; see `volumenet`."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from omnistereo_lib.stereo.kernels.compiled import compiled, minimum
from omnistereo_lib.stereo.threads import PART, map_threads

# Not nnan: NaN is what no camera sees.
_loop = compiled(nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
# 2^f for |f| ≤ ½ by its series, to the last bit of float32: exp alone keeps Numba from vectorising.
_SERIES = tuple(np.float32(math.log(2) ** k / math.factorial(k)) for k in range(7))
_BITS = np.float32(127)  # float32's exponent is stored with this much added, 23 bits up


class Costs:
    """1 - softmax of the sum of logits, resized to the rays, (H, W, N): by rows, where it is read.

    Args:
        levels: (w, h, N) each, float32, of coarser rays, circular in the first.
        hidden: bool, (H, W), where the result is NaN.
    """

    def __init__(self, levels: Sequence[Tensor], hidden: Tensor) -> None:
        # One cell a row in one table; a ray lies between two columns and two rows of each level.
        H, W = hidden.shape
        self.shape = H, W, levels[0].shape[-1]
        self._hidden = hidden.numpy()
        self._table = torch.cat([one.reshape(-1, one.shape[-1]) for one in levels]).numpy()
        first = np.cumsum([0, *(one.shape[0] * one.shape[1] for one in levels)])
        columns, rows = [], []
        for start, (width, height, _) in zip(first, (one.shape for one in levels), strict=False):
            low, high, share = _between(width, W, circular=True)
            columns.append((start + low * height, start + high * height, share))
            rows.append(_between(height, H, circular=False))
        (self._across, self._s), (self._down, self._t) = (
            (np.array([one[:2] for one in side]), np.array([one[2] for one in side], np.float32))
            for side in (columns, rows)
        )

    def __getitem__(self, rows: slice) -> Tensor:
        """Compute some rows."""
        down, t, hidden = self._down[..., rows], self._t[:, rows], self._hidden[rows]
        costs = np.empty((*hidden.shape, self.shape[2]), np.float32)

        def fill(part: slice) -> None:
            own = down[..., part], t[:, part], hidden[part]
            _fill_rows(self._table, self._across, self._s, *own, costs[part])

        each = max(1, PART // costs[0].size)
        list(map_threads(fill, [slice(y, y + each) for y in range(0, len(costs), each)]))
        return torch.from_numpy(costs)


def _between(size: int, full: int, circular: bool) -> tuple[NDArray[Any], NDArray[Any], Any]:
    """Return the two cells of `size` around each of `full` centres, and the share of the second."""
    position = (np.arange(full) + 0.5) * (size / full) - 0.5
    position = position if circular else position.clip(0, size - 1)
    low = np.floor(position).astype(np.int64)
    return low % size, (low + 1) % size, position - low


@_loop
def _fill_rows(
    table: Any, columns: Any, across: Any, rows: Any, down: Any, hidden: Any, out: Any
) -> None:
    """Write `costs` of some rows of rays to out (rows, W, N).

    Args:
        columns, rows: (levels, 2, W or rows), that add up to rows of the table.
        across, down: Shares of the second, (levels, W or rows).
    """
    N, one = table.shape[1], np.float32(1)
    ray, exponents = np.empty(N, np.float32), np.empty(N, np.int32)
    powers = exponents.view(np.float32)
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            if hidden[y, x]:
                out[y, x] = np.nan
                continue
            # Of each level the four cells around, in powers of 2, with the sign turned.
            for k in range(len(columns)):
                a, b = columns[k, 0, x], columns[k, 1, x]
                top, below = rows[k, 0, y], rows[k, 1, y]
                s, t = across[k, x], np.float32(-1 / math.log(2)) * down[k, y]
                rest = np.float32(-1 / math.log(2)) - t
                p, q, r, u = (one - s) * rest, (one - s) * t, s * rest, s * t
                a, c, b, d = a + top, a + below, b + top, b + below
                for n in range(N):
                    f = p * table[a, n] + q * table[c, n] + r * table[b, n] + u * table[d, n]
                    ray[n] = f + (ray[n] if k > 0 else np.float32(0))
            least = ray[0]
            for n in range(1, N):
                least = minimum(least, ray[n])
            for n in range(N):
                f = _BITS - minimum(ray[n] - least, _BITS - one)
                whole = np.int32(f + np.float32(0.5))
                f -= np.float32(whole)
                exponents[n] = whole << 23
                ray[n] = _SERIES[0] + f * (
                    _SERIES[1]
                    + f
                    * (
                        _SERIES[2]
                        + f * (_SERIES[3] + f * (_SERIES[4] + f * (_SERIES[5] + f * _SERIES[6])))
                    )
                )
            total = np.float32(0)
            for n in range(N):
                ray[n] *= powers[n]
                total += ray[n]
            scale = one / total
            for n in range(N):
                out[y, x, n] = one - ray[n] * scale


def local_mean(volume: Tensor, cells: int) -> tuple[Tensor, Tensor]:
    """Return `reference.local_mean` of costs (…, N), in float32."""
    N = volume.shape[-1]
    rays = volume.detach().float().reshape(-1, N).contiguous().numpy()
    out = np.empty((2, len(rays)), np.float32)

    def read(part: slice) -> None:
        _read_rays(rays[part], np.float32(max(1.0, N / cells)), out[:, part])

    each = max(1, PART // N)
    list(map_threads(read, [slice(k, k + each) for k in range(0, len(rays), each)]))
    index, mass = torch.from_numpy(out).view(2, *volume.shape[:-1])
    return index, mass


@_loop
def _read_rays(rays: Any, radius: Any, out: Any) -> None:
    """Write index and mass of rays (M, N) to out (2, M)."""
    N, reach, one = rays.shape[1], math.ceil(radius) + 1, np.float32(1)
    for m in range(len(rays)):
        cost, least, best = rays[m], np.float32(np.inf), 0
        # a NaN has no nearest integer, and each processor makes another one of it
        if np.isnan(cost[0]):
            out[:, m] = np.nan
            continue
        for n in range(N):
            least = minimum(least, cost[n])
        while best < N - 1 and cost[best] != least:
            best += 1
        index = np.float32(best)
        total = np.float32(0)
        for _ in range(3):
            middle, moment, total = int(index + np.float32(0.5)), np.float32(0), np.float32(0)
            for n in range(max(middle - reach, 0), min(middle + reach + 1, N)):
                share = radius + one - abs(np.float32(n) - index)
                mass = (one - cost[n]) * min(max(share, np.float32(0)), one)
                total += mass
                moment += mass * np.float32(n)
            index = moment / total
        out[0, m], out[1, m] = index, total
