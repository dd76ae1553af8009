"""The best sphere and confidence of every ray, on a CPU, while its costs are in the cache."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from omnistereo_lib.stereo.kernels.compiled import compiled, minimum


def winner_and_confidence(volume: Tensor, subindex: bool) -> Tensor:
    """Return `reference.winner` and `confidence` of float32 costs (H, W, N): (2, H, W)."""
    out = np.empty((2, *volume.shape[:2]), np.float32)
    _read_rays(volume.contiguous().numpy(), subindex, out)
    return torch.from_numpy(out)


@compiled(nogil=True, error_model="numpy")
def _read_rays(volume: NDArray[Any], subindex: bool, out: NDArray[Any]) -> None:
    """Write index and confidence of the rays of (H, W, N) costs to out (2, H, W)."""
    H, W, N = volume.shape
    infinity, one, two = np.float32(np.inf), np.float32(1), np.float32(2)
    ray = np.empty(N, np.float32)
    for y in range(H):
        for x in range(W):
            cost, first, second = volume[y, x], infinity, infinity
            # The lowest cost, and the first sphere that has it.
            for n in range(N):
                ray[n] = cost[n] if cost[n] == cost[n] else infinity
                first = minimum(first, ray[n])
            best = 0
            while ray[best] != first:
                best += 1
            # The lowest cost of the others, without the two neighbours.
            for n in range(max(best - 1, 0), min(best + 2, N)):
                ray[n] = infinity
            for n in range(N):
                second = minimum(second, ray[n])
            if first == infinity:
                out[0, y, x] = out[1, y, x] = np.nan
                continue
            out[0, y, x] = best
            out[1, y, x] = one - first / second if second > 0 else 0
            # The vertex of the parabola; beside a NaN `bend` is NaN, which is not > 0.
            if subindex and 0 < best < N - 1:
                # It lies (left - right) / (2 (left - 2 first + right)) beside the best sphere.
                left, right = cost[best - 1], cost[best + 1]
                bend = left - two * first + right
                if bend > 0 and bend < infinity:
                    out[0, y, x] = np.float32(best) + (left - right) / (two * bend)
