"""How the evidence of each ray is spread over the spheres; see `error_bars.distribution`."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from omnistereo_lib.stereo.kernels.compiled import compiled

# exp(-15) of the largest is nothing: most costs after SGM are skipped.
_LEAST = 15.0


def distribution(volume: Tensor, index: Tensor, temperature: float, radius: float) -> Tensor:
    """Return `error_bars.distribution_by_torch` of float32 costs (H, W, N): (5, H, W)."""
    out = np.empty((5, *volume.shape[:2]), np.float32)
    _read_rays(volume.contiguous().numpy(), index.numpy(), temperature, radius, out)
    return torch.from_numpy(out)


@compiled(nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})
def _read_rays(
    volume: NDArray[Any], index: NDArray[Any], temperature: float, radius: float, out: NDArray[Any]
) -> None:
    """Write spread, mass, spread inside, second mass and second index of rays to out (5, H, W)."""
    H, W, N = volume.shape
    p, half = np.empty(N, np.float32), int(radius)
    for y in range(H):
        for x in range(W):
            cost, at = volume[y, x], index[y, x]
            if np.isnan(at):
                out[:, y, x] = np.nan
                continue
            # The probability of each sphere, and its sum.
            total, least = np.float32(0), np.float32(np.inf)
            if temperature > 0:
                for n in range(N):
                    least = min(least, cost[n]) if cost[n] == cost[n] else least
            for n in range(N):
                if temperature > 0:
                    off = (cost[n] - least) / np.float32(temperature)
                    p[n] = np.exp(-off) if off < _LEAST else 0
                else:
                    p[n] = 1 - cost[n] if cost[n] < 1 else 0
                total += p[n]
            # Around the estimate, and within the window, which its mass leaves.
            spread = mass = inside = 0.0
            for n in range(N):
                if p[n] == 0:
                    continue
                square = p[n] / total * (n - at) ** 2
                share = min(max(radius + 1 - abs(n - at), 0.0), 1.0)
                spread += square
                inside += share * square
                mass += share * p[n] / total
                if abs(n - at) <= radius + 1:
                    p[n] = 0
            # The heaviest other window of whole spheres.
            run = second = 0.0
            middle = 0
            for n in range(N + half):
                run += (p[n] if n < N else 0) - (p[n - 2 * half - 1] if n > 2 * half else 0)
                if run > second:
                    second, middle = run, n - half
            # The mean sphere of that window, Σ n p / Σ p.
            moment = 0.0
            for n in range(max(middle - half, 0), min(middle + half + 1, N)):
                moment += n * p[n]
            out[0, y, x], out[1, y, x] = np.sqrt(spread), mass
            out[2, y, x] = np.sqrt(inside / mass) if mass > 0 else 0
            out[3, y, x] = second / total
            out[4, y, x] = moment / second if second > 0 else np.nan
