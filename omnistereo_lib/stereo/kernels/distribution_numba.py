"""How the evidence of each ray is spread over the spheres; see `error_bars.distribution`."""

from typing import Any

import numba
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from omnistereo_lib.stereo.kernels.compiled import compiled, minimum

# exp(-15) of the largest is nothing.
_LEAST = np.float32(15)
# Powers 5 to 0 of t = -x / 16 in exp(t), x up to there: the least relative error, 5e-7.
_EXP = tuple(
    np.array([5.17409e-3, 0.03848439, 0.16510566, 0.49964195, 0.99996895, 0.9999995], "f4")
)


def distribution(volume: Tensor, index: Tensor, temperature: float, radius: float) -> Tensor:
    """Return `error_bars.distribution_by_torch` of float32 costs (H, W, N): (5, H, W)."""
    out = np.empty((5, *volume.shape[:2]), np.float32)
    T, reach = np.float32(temperature), np.float32(radius)
    _read_rays(volume.contiguous().numpy(), index.numpy(), T, reach, out)
    return torch.from_numpy(out)


# The compiler vectorises the loops over n: in float32, without branches or calls.
_FAST = {"contract", "reassoc", "nsz", "arcp"}


@numba.njit(fastmath=_FAST)
def exp_of_minus(x: float) -> Any:
    """Return exp(-x) of float32, 0 ≤ x ≤ 15, to 1.1e-5 of it: exp(-x / 16) to the 16th."""
    t, y = x * np.float32(-1 / 16), np.float32(0)
    for c in _EXP:
        y = y * t + c
    for _ in range(4):
        y *= y
    return y


@compiled(nogil=True, error_model="numpy", fastmath=_FAST)
def _read_rays(
    volume: NDArray[Any],
    index: NDArray[Any],
    temperature: np.float32,
    radius: np.float32,
    out: NDArray[Any],
) -> None:
    """Write spread, mass, spread inside, second mass and second index of rays to out (5, H, W)."""
    H, W, N = volume.shape
    zero, one, infinity = np.float32(0), np.float32(1), np.float32(np.inf)
    half, spheres = int(radius), np.arange(N).astype(np.float32)
    # What the window leaves, with zeros beyond both ends, and its sums, negative.
    padded, sums = np.zeros(N + 2 * half, np.float32), np.empty(N, np.float32)
    rest = padded[half : half + N]
    for y in range(H):
        for x in range(W):
            cost, at, least = volume[y, x], index[y, x], infinity
            if np.isnan(at):
                out[:, y, x] = np.nan
                continue
            for n in range(N):
                least = minimum(least, cost[n] if cost[n] < infinity else infinity)
            # The probability of each sphere, their sum, and what lies within the window.
            total = spread = mass = inside = zero
            for n in range(N):
                if temperature > 0:
                    off = (cost[n] - least) / temperature
                    p = exp_of_minus(off) if off < _LEAST else zero
                else:
                    p = one - cost[n] if cost[n] < one else zero
                away = abs(spheres[n] - at)
                share = minimum(radius + one - away, one)
                share = p * share if share > zero else zero
                square = away * away
                total, spread = total + p, spread + p * square
                mass, inside = mass + share, inside + share * square
                rest[n] = p if away > radius + one else zero
            # The heaviest other window of whole spheres, and its mean sphere, Σ n p / Σ p.
            sums[:] = 0
            for k in range(2 * half + 1):
                shifted = padded[k : k + N]
                for n in range(N):
                    sums[n] -= shifted[n]
            second, middle, moment = zero, 0, zero
            for n in range(N):
                second = minimum(second, sums[n])
            while sums[middle] != second:
                middle += 1
            for k in range(2 * half + 1):
                moment += (middle + k - half) * padded[middle + k]
            out[0, y, x], out[1, y, x] = np.sqrt(spread / total), mass / total
            out[2, y, x] = np.sqrt(inside / mass) if mass > 0 else 0
            out[3, y, x] = -second / total
            out[4, y, x] = -moment / second if second < 0 else np.nan
