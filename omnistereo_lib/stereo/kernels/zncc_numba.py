"""ZNCC on a CPU: sums over a window slide, so its size costs nothing, 16 spheres at once."""

from collections.abc import Sequence
from typing import Any

import numba
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import pad

from omnistereo_lib.geometry.rig import Pair
from omnistereo_lib.reference import FLAT_VARIANCE
from omnistereo_lib.stereo.columns import common_columns
from omnistereo_lib.stereo.kernels.compiled import compiled

# Spheres side by side, as many as a block of the sweep has.
_LANES = 16
# Columns at a time: the sums over their windows stay in the cache of a core.
_PIECE = 256


def mean_costs(
    spherical_images: Tensor,
    pairs: Sequence[Pair],
    window: int,
    columns: Sequence[tuple[int, int]] | None,
) -> Tensor:
    """Return the mean cost over pairs, (H, W, B), of images (cameras, B, H, W); see `ZNCC`."""
    H, W = spherical_images.shape[-2:]
    # Only the columns that both cameras of a pair see, in pieces.
    columns = columns if columns is not None else [(0, W)] * len(spherical_images)
    strips = [
        (i, j, *strip) for i, j in pairs for strip in common_columns(columns[i], columns[j], W)
    ]
    rows = [
        (i, j, s + k, min(_PIECE, width - k))
        for i, j, s, width in strips
        for k in range(0, width, _PIECE)
    ]
    pieces = np.array(rows, np.int64).reshape(-1, 4)
    # 16 spheres at a time, the last of which may be empty.
    costs = []
    for images in spherical_images.permute(0, 2, 3, 1).split(_LANES, -1):
        B = images.shape[-1]
        if B < _LANES:
            images = pad(images, (0, _LANES - B), value=torch.nan)
        cost = np.empty((H, W * _LANES), np.float32)
        _mean_costs(images.contiguous().flatten(2).numpy(), pieces, window // 2, cost)
        costs.append(torch.from_numpy(cost).view(H, W, _LANES)[..., :B])
    return costs[0] if len(costs) == 1 else torch.cat(costs, -1)


# One row at a time; the compiler vectorises flat loops, a pixel's spheres side by side.


@compiled(nogil=True, error_model="numpy")
def _mean_costs(
    images: NDArray[Any], pieces: NDArray[Any], radius: int, cost: NDArray[Any]
) -> None:
    """Write the mean costs over the pairs to cost (H, W · lanes).

    Args:
        images: shape (cameras, H, W · lanes)
        pieces: rows of (camera, camera, start, width), at most `_PIECE` columns each
    """
    count = np.zeros(cost.shape, np.float32)
    cost[:] = 0
    for i, j, start, width in pieces:
        _add_costs(images[i], images[j], start, width, radius, cost, count)
    for y in range(len(cost)):
        for t in range(cost.shape[1]):
            # 0/0 is NaN, where no pair sees the ray.
            cost[y, t] /= count[y, t]


@numba.njit
def _add_costs(
    a: NDArray[Any],
    b: NDArray[Any],
    start: int,
    width: int,
    radius: int,
    total: NDArray[Any],
    count: NDArray[Any],
) -> None:
    """Add the costs of columns [start, start + width) of a pair to total and count (H, W · lanes).

    The sums over the rows of the window slide down the image, the sums over its columns then slide
    along the row. They are float64: in float32 the variance of a bright, flat patch would be
    rounding error.
    """
    W, window, padded = a.shape[1] // _LANES, 2 * radius + 1, (width + 2 * radius) * _LANES
    # The rows of the window and the one before it, each with its weights, a and b.
    ring = np.zeros((window + 1, 3, padded), np.float32)
    # Sums over the window's rows, of 1, a, b, a², b² and ab; `box` has them over columns, too.
    sums = np.zeros((6, padded))
    box = np.empty((6, width * _LANES))
    # A row of weights and of weighted costs.
    pair = np.empty((2, width * _LANES), np.float32)
    first = (start - radius) % W * _LANES
    # Row y needs the rows up to y + radius: windows fill before the first row is written.
    for y in range(-2 * radius, len(total)):
        # Slide down: the new row comes in, the one above the window goes out.
        row = y + radius
        new, old = ring[row % (window + 1)], ring[(row + 1) % (window + 1)]
        new[:] = 0
        if 0 <= row < len(a):
            _common_pixels(a[row], b[row], first, new)
        _slide(sums, new, old)
        # Slide along the row, and compare.
        if y >= 0:
            _add_columns(sums, window, box)
            _correlate(box, ring[y % (window + 1)][0][radius * _LANES :], pair)
            _add_wrapped(pair[0], start % W * _LANES, count[y])
            _add_wrapped(pair[1], start % W * _LANES, total[y])


@numba.njit
def _common_pixels(a: NDArray[Any], b: NDArray[Any], first: int, pixels: NDArray[Any]) -> None:
    """Copy two rows of pixels, from `first` around the seam, to (3, padded): weight, a, b.

    The weight is 1 where both are visible; elsewhere all three are 0.
    """
    # Around the seam: first up to the end of the row, then on from its beginning.
    t = 0
    while t < pixels.shape[1]:
        n = min(len(a) - first, pixels.shape[1] - t)
        left, right, visible = a[first : first + n], b[first : first + n], pixels[0][t : t + n]
        for k in range(n):
            both = left[k] + right[k]
            # NaN is not equal to itself, and a sum with NaN is NaN: only here both cameras see.
            visible[k] = 1.0 if both == both else 0.0
        for source, row in ((left, pixels[1]), (right, pixels[2])):
            target = row[t : t + n]
            for k in range(n):
                target[k] = source[k] if visible[k] != 0 else np.float32(0)
        t, first = t + n, 0


@numba.njit(fastmath={"contract"})
def _slide(sums: NDArray[Any], new: NDArray[Any], old: NDArray[Any]) -> None:
    """Add a row of pixels, (weight, a, b), to the sums and remove another."""
    f8 = np.float64
    for q in range(3):
        total, p, p_old = sums[q], new[q], old[q]
        for t in range(len(total)):
            total[t] += f8(p[t]) - f8(p_old[t])
    # a², b² and ab; all are 0 where the weight is.
    for q, i, j in ((3, 1, 1), (4, 2, 2), (5, 1, 2)):
        total, p, r, p_old, r_old = sums[q], new[i], new[j], old[i], old[j]
        for t in range(len(total)):
            total[t] += f8(p[t]) * f8(r[t]) - f8(p_old[t]) * f8(r_old[t])


@numba.njit
def _add_columns(sums: NDArray[Any], window: int, box: NDArray[Any]) -> None:
    """Write the six sums over the columns of the window to box."""
    for q in range(6):
        # The first window is summed in full; each other gains the column ahead, loses the one
        # behind. In one array: so the compiler sees that a read is 16 lanes behind the writes.
        for k in range(_LANES):
            box[q, k] = 0
        for x in range(window):
            for k in range(_LANES):
                box[q, k] += sums[q, x * _LANES + k]
        for t in range(box.shape[1] - _LANES):
            ahead, behind = sums[q, t + window * _LANES], sums[q, t]
            box[q, t + _LANES] = box[q, t] + (ahead - behind)


@numba.njit(error_model="numpy", fastmath={"contract"})
def _correlate(box: NDArray[Any], weight: NDArray[Any], pair: NDArray[Any]) -> None:
    """Compute weight and weighted cost (1 - ZNCC)/2; 0.5 where flat (paper, Section IV)."""
    half, one = np.float32(0.5), np.float32(1)
    for t in range(box.shape[1]):
        n = box[0, t]
        # Times n²: n² var a = n Σa² - (Σa)², n² cov = n Σab - Σa Σb, so nothing is divided by n.
        variance_a = n * box[3, t] - box[1, t] * box[1, t]
        variance_b = n * box[4, t] - box[2, t] * box[2, t]
        covariance = n * box[5, t] - box[1, t] * box[2, t]
        zncc = np.float32(covariance) / np.sqrt(np.float32(variance_a) * np.float32(variance_b))
        # Both variances were multiplied by n², so the limit is, too.
        textured = min(variance_a, variance_b) > FLAT_VARIANCE * n * n
        pair[0, t] = weight[t]
        pair[1, t] = weight[t] * (
            half - half * min(max(zncc if textured else np.float32(0), -one), one)
        )


@numba.njit
def _add_wrapped(values: NDArray[Any], first: int, row: NDArray[Any]) -> None:
    """Add values to a row, from `first` on around the seam."""
    n = min(len(row) - first, len(values))
    target, start = row[first : first + n], values[n:]
    for t in range(n):
        target[t] += values[t]
    for t in range(len(start)):
        row[t] += start[t]
