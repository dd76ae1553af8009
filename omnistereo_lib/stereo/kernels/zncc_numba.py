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
from omnistereo_lib.stereo.columns import common_columns, split_at_seam
from omnistereo_lib.stereo.kernels.compiled import compiled

# Spheres side by side, as many as a block of the sweep has.
_LANES = 16
# Columns at a time: the sums over their windows stay in the cache of a core.
_TILE = 256
# Sums of a pixel over the rows of its window, of 1, a, b, a², b² and ab, on all spheres.
_SUMS = 6 * _LANES


def mean_costs(
    spherical_images: Tensor,
    pairs: Sequence[Pair],
    window: int,
    columns: Sequence[tuple[int, int]] | None,
) -> Tensor:
    """Return the mean cost over pairs, (H, W, B), of images (cameras, B, H, W); see `ZNCC`."""
    H, W = spherical_images.shape[-2:]
    # Only the columns that both cameras of a pair see.
    columns = columns if columns is not None else [(0, W)] * len(spherical_images)
    rows = [
        (i, j, first, stop)
        for i, j in pairs
        for strip in common_columns(columns[i], columns[j], W)
        for first, stop in split_at_seam(*strip, W)
    ]
    strips = np.array(rows, np.int64).reshape(-1, 4)
    # 16 spheres at a time, the last of which may be empty.
    costs = []
    for images in spherical_images.permute(0, 2, 3, 1).split(_LANES, -1):
        B = images.shape[-1]
        if B < _LANES:
            images = pad(images, (0, _LANES - B), value=torch.nan)
        cost = np.empty((H, W * _LANES), np.float32)
        _mean_costs(images.contiguous().flatten(2).numpy(), strips, window // 2, cost)
        costs.append(torch.from_numpy(cost).view(H, W, _LANES)[..., :B])
    return costs[0] if len(costs) == 1 else torch.cat(costs, -1)


@compiled(nogil=True, error_model="numpy")
def _mean_costs(
    images: NDArray[Any], strips: NDArray[Any], radius: int, cost: NDArray[Any]
) -> None:
    """Write the mean costs over the pairs to cost (H, W · lanes).

    The sums over the rows of a window slide down the image, the sums over its columns along the
    row. They are float64: in float32 the variance of a bright, flat patch would be rounding error.

    Args:
        images: shape (cameras, H, W · lanes)
        strips: rows of (camera, camera, first, stop), columns that both see
    """
    H, W, window = images.shape[1], images.shape[2] // _LANES, 2 * radius + 1
    nothing, box = np.full(W * _LANES, np.nan, np.float32), np.empty(_SUMS)
    total, count = np.empty((2, _TILE * _LANES), np.float32)
    # Of each strip, for the columns of its windows, behind one of zeros.
    sums = np.empty((len(strips), (_TILE + window) * _SUMS))
    for tile in range(0, W, _TILE):
        sums[:] = 0
        # Row y needs the rows up to y + radius: windows fill before the first row is written.
        for y in range(-radius, H):
            total[:] = count[:] = 0
            for s in range(len(strips)):
                i, j, first, stop = strips[s]
                first, width = max(first, tile), min(stop, tile + _TILE) - max(first, tile)
                if width <= 0:
                    continue
                # Slide down: the new row comes in, the one above the window goes out.
                a, b, new, old = images[i], images[j], y + radius, y - radius - 1
                a_new, b_new = (a[new], b[new]) if new < H else (nothing, nothing)
                a_old, b_old = (a[old], b[old]) if old >= 0 else (nothing, nothing)
                column = (first - radius) % W
                _slide(a_new, b_new, a_old, b_old, column, width + 2 * radius, sums[s, _SUMS:])
                # Slide along the row, and compare.
                if y >= 0:
                    k, t = first * _LANES, (first - tile) * _LANES
                    _add_costs(
                        a[y, k:], b[y, k:], sums[s], width, window, box, total[t:], count[t:]
                    )
            if y >= 0:
                row = cost[y, tile * _LANES : (tile + _TILE) * _LANES]
                for t in range(len(row)):
                    # 0/0 is NaN, where no pair sees the ray.
                    row[t] = total[t] / count[t]


# The compiler vectorises the loops over k, the spheres of a pixel. Inlined by force: only then is
# what runs where it was compiled the same as what is read from Numba's cache.


@numba.njit(forceinline=True, fastmath={"contract"})
def _slide(
    a: NDArray[Any],
    b: NDArray[Any],
    a_old: NDArray[Any],
    b_old: NDArray[Any],
    column: int,
    width: int,
    sums: NDArray[Any],
) -> None:
    """Add a row of pixels to the sums of `width` columns, around the seam, and remove another."""
    f8, one, zero = np.float64, np.float32(1), np.float32(0)
    for x in range(width):
        first, stop = column * _LANES, (column + 1) * _LANES
        p, q, p_old, q_old = a[first:stop], b[first:stop], a_old[first:stop], b_old[first:stop]
        sum_ = sums[x * _SUMS : (x + 1) * _SUMS]
        for k in range(_LANES):
            # NaN is not equal to itself, and a sum with NaN is NaN: only here both cameras see.
            new, old = p[k] + q[k], p_old[k] + q_old[k]
            n, n_old = f8(one if new == new else zero), f8(one if old == old else zero)
            u, u_old = f8(p[k] if new == new else zero), f8(p_old[k] if old == old else zero)
            v, v_old = f8(q[k] if new == new else zero), f8(q_old[k] if old == old else zero)
            sum_[k] += n - n_old
            sum_[_LANES + k] += u - u_old
            sum_[2 * _LANES + k] += v - v_old
            sum_[3 * _LANES + k] += u * u - u_old * u_old
            sum_[4 * _LANES + k] += v * v - v_old * v_old
            sum_[5 * _LANES + k] += u * v - u_old * v_old
        column = column + 1 if column + 1 < len(a) // _LANES else 0


@numba.njit(forceinline=True, error_model="numpy", fastmath={"contract"})
def _add_costs(
    a: NDArray[Any],
    b: NDArray[Any],
    sums: NDArray[Any],
    width: int,
    window: int,
    box: NDArray[Any],
    total: NDArray[Any],
    count: NDArray[Any],
) -> None:
    """Add (1 - ZNCC)/2 of `width` columns to total, 0.5 where flat (paper, Section IV), 1 to count.

    Args:
        a, b: pixels from the first column on; NaN in one: neither is added
        sums: from the column before the first window on, which is 0
    """
    half, one, zero = np.float32(0.5), np.float32(1), np.float32(0)
    # The first window is summed in full; each other gains the column ahead, loses the one behind.
    box[:] = 0
    for x in range(1, window):
        ahead = sums[x * _SUMS : (x + 1) * _SUMS]
        for k in range(_SUMS):
            box[k] += ahead[k]
    for x in range(width):
        first, stop = x * _LANES, (x + 1) * _LANES
        p, q, cost, weight = a[first:stop], b[first:stop], total[first:stop], count[first:stop]
        behind = sums[x * _SUMS : (x + 1) * _SUMS]
        ahead = sums[(x + window) * _SUMS : (x + window + 1) * _SUMS]
        for k in range(_SUMS):
            box[k] += ahead[k] - behind[k]
        for k in range(_LANES):
            n, s, t = box[k], box[_LANES + k], box[2 * _LANES + k]
            # Times n²: n² var a = n Σa² - (Σa)², n² cov = n Σab - Σa Σb: nothing is divided by n.
            variance_a, variance_b = (
                n * box[3 * _LANES + k] - s * s,
                n * box[4 * _LANES + k] - t * t,
            )
            covariance = n * box[5 * _LANES + k] - s * t
            zncc = np.float32(covariance) / np.sqrt(np.float32(variance_a) * np.float32(variance_b))
            # Both variances were multiplied by n², so the limit is, too.
            textured = min(variance_a, variance_b) > FLAT_VARIANCE * n * n
            both = p[k] + q[k]
            seen = one if both == both else zero
            cost[k] += seen * (half - half * min(max(zncc if textured else zero, -one), one))
            weight[k] += seen
