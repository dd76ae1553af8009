"""ZNCC, the matching cost without training (paper, Section III-B and IV)."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from numbers import Integral

import numba
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import avg_pool2d, pad

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.stereo.compiled import compiled

_FLAT_VARIANCE = 1e-6  # of unit-variance images; flatter patches hold only the rounding of the interpolation


@dataclass(frozen=True)
class ZNCC:
    """Zero-mean normalised cross-correlation of square patches as a cost (1 - ZNCC)/2 in [0, 1] (paper, Section IV).

    A patch holds the pixels of the window that are visible to both cameras; it continues across the ±180° seam.
    A patch without texture costs 0.5: neither match nor mismatch.

    Raises:
        OmnistereoError: If the window is not an odd number of at least 3.
    """

    window: int = 9  #: side of the window in pixels, odd; 9 in the paper

    def __post_init__(self) -> None:
        if not isinstance(self.window, Integral) or self.window < 3 or self.window % 2 == 0:
            raise OmnistereoError(f"the ZNCC window is {self.window!r}; expected an odd number of at least 3")

    def __call__(
        self,
        spherical_images: Tensor,
        pairs: Sequence[tuple[int, int]],
        columns: Sequence[tuple[int, int]] | None = None,
    ) -> Tensor:
        """Return the mean cost over camera pairs (Eq. 2) for a block of spheres.

        Args:
            spherical_images (float32 tensor, shape (cameras, B, H, W)): Images warped onto B spheres, NaN where the ray
                is not visible to the camera.
            columns: Visible columns of each camera, around the seam; all others are skipped. Default: all columns.

        Returns:
            float32 tensor, shape (H, W, B): Cost in [0, 1], NaN where the ray is not visible to both cameras of any
                pair.

        Raises:
            OmnistereoError: If the window is larger than the panorama.
        """
        H, W = spherical_images.shape[-2:]
        if self.window > min(H, W):
            raise OmnistereoError(
                f"the ZNCC window is {self.window}; expected at most the panorama size {W} × {H}. Use a smaller window."
            )
        if spherical_images.device.type != "cpu":
            return _zncc_torch(spherical_images, pairs, self.window)
        columns = columns if columns is not None else [(0, W)] * len(spherical_images)
        strips = [(i, j, *strip) for i, j in pairs for strip in common_columns(columns[i], columns[j], W)]
        strips = np.array(strips, np.int64).reshape(-1, 4)
        images = spherical_images.numpy()
        costs = np.zeros(images.shape[1:], np.float32)

        def fill(k: int) -> None:
            _zncc_sphere(images[:, k], strips, self.window // 2, costs[k])

        with ThreadPoolExecutor(torch.get_num_threads()) as pool:  # the kernel releases the interpreter lock
            list(pool.map(fill, range(len(costs))))
        return torch.from_numpy(costs).permute(1, 2, 0)


def common_columns(a: tuple[int, int], b: tuple[int, int], W: int) -> list[tuple[int, int]]:
    """Return the (start, width) strips, around the seam, in the intersection of two circular spans of columns."""
    column = np.arange(W)
    common = ((column - a[0]) % W < a[1]) & ((column - b[0]) % W < b[1])
    if common.all():
        return [(0, W)]
    starts = np.flatnonzero(common & ~np.roll(common, 1))
    ends = np.flatnonzero(common & ~np.roll(common, -1))
    return [(int(s), int((ends[(ends - s) % W == ((ends - s) % W).min()][0] - s) % W + 1)) for s in starts]


@compiled(nogil=True, error_model="numpy")
def _zncc_sphere(images: NDArray, strips: NDArray, radius: int, cost: NDArray) -> None:
    """Write the mean costs to cost (H, W), which holds zeros; strips are rows of (camera, camera, start, width)."""
    H, W = cost.shape
    count = np.zeros((H, W), np.float32)
    for s in range(len(strips)):
        i, j, start, width = strips[s]
        columns = (start - radius + np.arange(width + 2 * radius)) % W
        a, b, visible = _common_pixels(images[i], images[j], columns)
        _add_costs(a, b, visible, columns, radius, cost, count)
    for y in range(H):
        for x in range(W):
            cost[y, x] /= count[y, x]  # 0/0 = NaN where no pair is visible


@numba.njit
def _common_pixels(a: NDArray, b: NDArray, columns: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Copy the given columns of two images, 0 unless visible in both, with weights 1 for visible and 0."""
    H, width = len(a), len(columns)
    left, right = np.zeros((H, width), np.float32), np.zeros((H, width), np.float32)
    visible = np.zeros((H, width), np.float32)
    for y in range(H):
        for t in range(width):
            p, q = a[y, columns[t]], b[y, columns[t]]
            if p == p and q == q:  # neither is NaN
                left[y, t], right[y, t], visible[y, t] = p, q, 1.0
    return left, right, visible


@numba.njit(error_model="numpy")
def _add_costs(
    a: NDArray, b: NDArray, visible: NDArray, columns: NDArray, radius: int, total: NDArray, count: NDArray
) -> None:
    """Add the costs of one pair to total and count (H, W); a, b and visible have `radius` more columns at both ends.

    Sums over the rows of the window slide down the image and are then added over the columns of the window. They are
    float64: in float32 the variance of a bright, flat patch would be rounding error.
    """
    H, padded = a.shape
    width = padded - 2 * radius
    sums = np.zeros((6, padded))  # over the rows of the window: 1, a, b, a², b², ab
    box = np.empty((6, width))
    cost = np.empty(width, np.float32)
    for y in range(-radius, H):
        if y + radius < H:
            _slide(sums, a[y + radius], b[y + radius], visible[y + radius], 1.0)
        if y - radius > 0:
            _slide(sums, a[y - radius - 1], b[y - radius - 1], visible[y - radius - 1], -1.0)
        if y < 0:
            continue
        for q in range(6):
            box[q] = sums[q, :width]
            for shift in range(1, 2 * radius + 1):
                for t in range(width):
                    box[q, t] += sums[q, t + shift]
        _correlate(box, cost)
        for t in range(width):
            x, weight = columns[t + radius], visible[y, t + radius]
            total[y, x] += weight * cost[t]
            count[y, x] += weight


@numba.njit
def _slide(sums: NDArray, a: NDArray, b: NDArray, visible: NDArray, sign: float) -> None:
    """Add (sign 1) or remove (sign -1) one row of pixels to or from the running sums."""
    for t in range(len(a)):
        p, q = np.float64(a[t]), np.float64(b[t])
        sums[0, t] += sign * visible[t]
        sums[1, t] += sign * p
        sums[2, t] += sign * q
        sums[3, t] += sign * p * p
        sums[4, t] += sign * q * q
        sums[5, t] += sign * p * q


@numba.njit(error_model="numpy")
def _correlate(box: NDArray, cost: NDArray) -> None:
    """Compute the cost (1 - ZNCC)/2 from box sums; 0.5 where a patch is flat (paper, Section IV)."""
    for t in range(len(cost)):
        scale = 1.0 / max(box[0, t], 1.0)
        mean_a, mean_b = box[1, t] * scale, box[2, t] * scale
        variance_a = box[3, t] * scale - mean_a * mean_a
        variance_b = box[4, t] * scale - mean_b * mean_b
        covariance = box[5, t] * scale - mean_a * mean_b
        textured = variance_a > _FLAT_VARIANCE and variance_b > _FLAT_VARIANCE
        zncc = covariance / np.sqrt(variance_a * variance_b) if textured else 0.0
        cost[t] = 0.5 - 0.5 * min(max(zncc, -1.0), 1.0)


def _zncc_torch(spherical_images: Tensor, pairs: Sequence[tuple[int, int]], window: int) -> Tensor:
    """Compute the same in plain torch, for devices other than the CPU."""

    def box(x: Tensor) -> Tensor:
        r = window // 2
        x = pad(x, (r, r, 0, 0), mode="circular")
        return avg_pool2d(x, window, stride=1, padding=(r, 0))

    total = torch.zeros(spherical_images.shape[1:], device=spherical_images.device)
    count = torch.zeros_like(total)
    for i, j in pairs:
        a, b = spherical_images[i].double(), spherical_images[j].double()
        visible = ~(a.isnan() | b.isnan())
        a, b = a.where(visible, 0.0), b.where(visible, 0.0)
        n = box(visible.double()).clamp_min(1e-12)
        mean_a, mean_b = box(a) / n, box(b) / n
        variance_a, variance_b = box(a * a) / n - mean_a**2, box(b * b) / n - mean_b**2
        zncc = (box(a * b) / n - mean_a * mean_b) / (variance_a * variance_b).clamp_min(1e-30).sqrt()
        zncc = zncc.where((variance_a > _FLAT_VARIANCE) & (variance_b > _FLAT_VARIANCE), 0.0)
        total += ((0.5 - 0.5 * zncc.clamp(-1, 1)) * visible).float()
        count += visible
    return (total / count).permute(1, 2, 0)
