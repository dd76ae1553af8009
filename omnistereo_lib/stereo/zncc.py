"""ZNCC, the local matching cost that needs no training (paper, Section III-B and IV)."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numba
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import avg_pool2d, pad

from omnistereo_lib.errors import OmnistereoError

# Images have unit variance. A patch whose deviation is below a thousandth of that carries no texture,
# only the rounding of its interpolation: its correlation is noise and counts as 0.
_FLAT_VARIANCE = 1e-6


@dataclass(frozen=True)
class ZNCC:
    """Zero-mean normalised cross-correlation of square patches, as a cost (1 - ZNCC)/2 in [0, 1].

    A patch holds the pixels of the window that both cameras see; it wraps around the panorama's seam.
    A patch without texture has the cost 0.5: it says neither match nor mismatch.

    Parameters
    ----------
    window : int
        Side of the window in pixels, odd; the paper's is 9.

    Raises
    ------
    OmnistereoError
        If the window is not an odd number of at least 3.
    """

    window: int = 9

    def __post_init__(self) -> None:
        if self.window < 3 or self.window % 2 == 0:
            raise OmnistereoError(f"the ZNCC window must be an odd number of at least 3, got {self.window}")

    def __call__(
        self,
        spherical: Tensor,
        pairs: Sequence[tuple[int, int]],
        columns: Sequence[tuple[int, int]] | None = None,
    ) -> Tensor:
        """Return the mean cost over camera pairs (Eq. 2) for a block of spheres.

        Parameters
        ----------
        spherical : float32 tensor, shape (cameras, B, H, W)
            Images warped onto B spheres, NaN where a camera does not see the ray.
        pairs : sequence of (int, int)
        columns : sequence of (start, width), optional
            Columns that each camera sees, around the seam, to skip the rest. Default: all.

        Returns
        -------
        float32 tensor, shape (H, W, B)
            Cost in [0, 1], NaN where no pair sees the ray.
        """
        if self.window > min(spherical.shape[-2:]):
            H, W = spherical.shape[-2:]
            raise OmnistereoError(f"a window of {self.window} does not fit a panorama of {W} × {H} pixels")
        if spherical.device.type != "cpu":
            return _zncc_torch(spherical, pairs, self.window)
        W = spherical.shape[-1]
        columns = columns if columns is not None else [(0, W)] * len(spherical)
        strips = [(i, j, *strip) for i, j in pairs for strip in common_columns(columns[i], columns[j], W)]
        strips = np.array(strips, np.int64).reshape(-1, 4)
        images = spherical.numpy()
        costs = np.zeros((images.shape[1], *images.shape[2:]), np.float32)

        def fill(k: int) -> None:
            _zncc_sphere(images[:, k], strips, self.window // 2, costs[k])

        with ThreadPoolExecutor(torch.get_num_threads()) as pool:  # the kernel releases the interpreter lock
            list(pool.map(fill, range(len(costs))))
        return torch.from_numpy(costs).permute(1, 2, 0)


def common_columns(a: tuple[int, int], b: tuple[int, int], W: int) -> list[tuple[int, int]]:
    """Return the (start, width) strips, around the seam, that two circular spans of columns share."""
    common = np.zeros(W, bool)
    common[(a[0] + np.arange(a[1])) % W] = True
    other = np.zeros(W, bool)
    other[(b[0] + np.arange(b[1])) % W] = True
    common &= other
    if common.all():
        return [(0, W)]
    starts = np.flatnonzero(common & ~np.roll(common, 1))
    ends = np.flatnonzero(common & ~np.roll(common, -1))
    return [(int(s), int((ends[(ends - s) % W == ((ends - s) % W).min()][0] - s) % W + 1)) for s in starts]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _zncc_sphere(images: NDArray, strips: NDArray, radius: int, cost: NDArray) -> None:
    """Fill cost (H, W), zero before, with mean costs; strips are rows of (camera, camera, start column, width)."""
    H, W = cost.shape
    count = np.zeros((H, W), np.float32)
    for s in range(len(strips)):
        i, j, start, width = strips[s]
        columns = (start - radius + np.arange(width + 2 * radius)) % W
        a, b, seen = _common_pixels(images[i], images[j], columns)
        _add_costs(a, b, seen, columns, radius, cost, count)
    for y in range(H):
        for x in range(W):
            cost[y, x] /= count[y, x]  # 0/0 = NaN where no pair sees the ray


@numba.njit
def _common_pixels(a: NDArray, b: NDArray, columns: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Copy the given columns of two images, with 0 where not both are seen, and 1 or 0 for whether they are."""
    H, width = len(a), len(columns)
    left, right = np.zeros((H, width), np.float32), np.zeros((H, width), np.float32)
    seen = np.zeros((H, width), np.float32)
    for y in range(H):
        for t in range(width):
            p, q = a[y, columns[t]], b[y, columns[t]]
            if p == p and q == q:  # neither is NaN
                left[y, t], right[y, t], seen[y, t] = p, q, 1.0
    return left, right, seen


@numba.njit(error_model="numpy")
def _add_costs(
    a: NDArray, b: NDArray, seen: NDArray, columns: NDArray, radius: int, total: NDArray, count: NDArray
) -> None:
    """Add the costs of one pair, whose columns carry a margin of `radius`, to total and count (H, W).

    Box sums run down the rows and are then added over the columns of the window. They are float64: in
    float32 the variance of a bright, flat patch is nothing but rounding error.
    """
    H, padded = a.shape
    width = padded - 2 * radius
    sums = np.zeros((6, padded))  # over the window's rows: 1, a, b, a², b², ab
    box = np.empty((6, width))
    cost = np.empty(width, np.float32)
    for y in range(-radius, H):
        if y + radius < H:
            _slide(sums, a[y + radius], b[y + radius], seen[y + radius], 1.0)
        if y - radius > 0:
            _slide(sums, a[y - radius - 1], b[y - radius - 1], seen[y - radius - 1], -1.0)
        if y < 0:
            continue
        for q in range(6):
            box[q] = sums[q, :width]
            for shift in range(1, 2 * radius + 1):
                for t in range(width):
                    box[q, t] += sums[q, t + shift]
        _correlate(box, cost)
        for t in range(width):
            x, weight = columns[t + radius], seen[y, t + radius]
            total[y, x] += weight * cost[t]
            count[y, x] += weight


@numba.njit
def _slide(sums: NDArray, a: NDArray, b: NDArray, seen: NDArray, sign: float) -> None:
    """Let one row of pixels enter (sign 1) or leave (sign -1) the running sums."""
    for t in range(len(a)):
        p, q = np.float64(a[t]), np.float64(b[t])
        sums[0, t] += sign * seen[t]
        sums[1, t] += sign * p
        sums[2, t] += sign * q
        sums[3, t] += sign * p * p
        sums[4, t] += sign * q * q
        sums[5, t] += sign * p * q


@numba.njit(error_model="numpy")
def _correlate(box: NDArray, cost: NDArray) -> None:
    """Turn box sums into the cost (1 - ZNCC)/2, 0.5 where a patch is flat."""
    for t in range(len(cost)):
        scale = 1.0 / max(box[0, t], 1.0)
        mean_a, mean_b = box[1, t] * scale, box[2, t] * scale
        variance_a = box[3, t] * scale - mean_a * mean_a
        variance_b = box[4, t] * scale - mean_b * mean_b
        covariance = box[5, t] * scale - mean_a * mean_b
        textured = variance_a > _FLAT_VARIANCE and variance_b > _FLAT_VARIANCE
        zncc = covariance / np.sqrt(variance_a * variance_b) if textured else 0.0
        cost[t] = 0.5 - 0.5 * min(max(zncc, -1.0), 1.0)


def _zncc_torch(spherical: Tensor, pairs: Sequence[tuple[int, int]], window: int) -> Tensor:
    """Compute the same in plain torch, for tensors on other devices than the CPU."""

    def box(x: Tensor) -> Tensor:
        r = window // 2
        x = pad(x, (r, r, 0, 0), mode="circular")
        return avg_pool2d(x, window, stride=1, padding=(r, 0))

    total = torch.zeros(spherical.shape[1:], device=spherical.device)
    count = torch.zeros_like(total)
    for i, j in pairs:
        a, b = spherical[i].double(), spherical[j].double()
        seen = ~(a.isnan() | b.isnan())
        a, b = a.where(seen, 0.0), b.where(seen, 0.0)
        n = box(seen.double()).clamp_min(1e-12)
        mean_a, mean_b = box(a) / n, box(b) / n
        variance_a, variance_b = box(a * a) / n - mean_a**2, box(b * b) / n - mean_b**2
        zncc = (box(a * b) / n - mean_a * mean_b) / (variance_a * variance_b).clamp_min(1e-30).sqrt()
        zncc = zncc.where((variance_a > _FLAT_VARIANCE) & (variance_b > _FLAT_VARIANCE), 0.0)
        total += ((0.5 - 0.5 * zncc.clamp(-1, 1)) * seen).float()
        count += seen
    return (total / count).permute(1, 2, 0)
