"""Correlation on a CPU, cell by cell: unseen cells cost nothing, no warped map is stored."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from omnistereo_lib.geometry.camera import EDGE, OcamCamera
from omnistereo_lib.stereo.kernels.compiled import compiled
from omnistereo_lib.stereo.threads import map_threads

CHANNELS, GROUPS = 32, 8
_SIZE = CHANNELS // GROUPS
# Cells correlated at a time, so few that their features stay in the cache of a core.
_CELLS = 1 << 14
_ROUNDED = 1 << 11


def project(camera: OcamCamera, points: Tensor) -> Tensor:
    """Return where points (3, ...), float32, land on a feature map, (..., 2), NaN where unseen: the
    numbers of `OcamCamera.project` to the bit, by three loops in place of sixty passes.
    """
    shape, points = points.shape[1:], points.flatten(1).contiguous()
    x, y, z = points
    n = torch.sqrt(x * x + y * y)
    # By torch: another library's arctangent has other last bits.
    uv = torch.stack([n, torch.arctan2(-z, n)])
    _project(
        points.numpy(),
        uv.numpy(),
        np.float32(np.radians(camera.max_fov_deg / 2) - np.pi / 2),
        camera.inv_poly[::-1].astype(np.float32),
        np.array([*camera.affine, *camera.center], np.float32),
        np.array([-EDGE, *np.add(camera.image_size, EDGE - 1)], np.float32),
        np.empty((0, 0), np.bool_) if camera.mask is None else camera.mask,
    )
    return uv.T.reshape(*shape, 2)


def normalize(maps: Tensor, visible: Tensor) -> Tensor:
    """Return feature maps (32, h, w), normalised over visible pixels in their own memory; see
    `FeatureNet`.
    """
    rows = maps.permute(1, 2, 0).reshape(-1, CHANNELS).contiguous().numpy()
    seen = visible.reshape(-1).numpy()
    parts = [slice(k, k + _CELLS) for k in range(0, len(rows), _CELLS)]
    sums = np.zeros((len(parts), 2, CHANNELS))
    list(map_threads(lambda part, own: _sum(rows[part], seen[part], own), parts, sums))
    mean, square = sums.sum(0) / max(np.count_nonzero(seen), 1)
    power = (square - mean**2).reshape(GROUPS, -1).mean(1)
    scale = np.repeat(1 / np.sqrt(power.clip(0) + 1e-5), _SIZE)
    share = scale.astype(np.float32), (mean * scale).astype(np.float32)
    list(map_threads(lambda part: _scale(rows[part], seen[part], *share), parts))
    return torch.from_numpy(rows).view(*maps.shape[1:], -1).permute(2, 0, 1)


def correlate(features: Sequence[Tensor], coordinates: Sequence[Any]) -> Tensor:
    """Return `reference.correlate` of features (32, h, w), in eight groups, with its gradient."""
    # Channels last: the 32 features of a pixel are read together.
    maps = [one.permute(1, 2, 0).contiguous() for one in features]
    return _CellCorrelation.apply(coordinates, *maps).permute(3, 0, 1, 2)


class _CellCorrelation(torch.autograd.Function):
    """The loops over the cells, as an operation that has a gradient."""

    @staticmethod
    def forward(ctx: Any, uv: Sequence[Any], *maps: Tensor) -> Tensor:
        """Return the cells (W, H, N, 9), given features (h, w, 32) and places (W, H, N, 2)."""
        # All feature maps in one table, one pixel a row; Σ f_i is kept for a gradient alone.
        table = torch.cat([one.detach().reshape(-1, CHANNELS) for one in maps]).numpy()
        sizes = np.array([one.shape[:2] for one in maps])
        size, trains = uv[0].shape[:3], any(ctx.needs_input_grad)
        # At once in the precision of the products that follow: half the memory.
        half = torch.is_autocast_enabled("cpu") and not trains
        kind = torch.get_autocast_dtype("cpu") if half else torch.float32
        volume = torch.empty(*size, GROUPS + 1, dtype=kind)
        totals = torch.empty(*(size if trains else (0, 0, 0)), CHANNELS, dtype=torch.float32)

        def correlate_part(columns: slice) -> None:
            places = np.stack([of_camera[columns].reshape(-1, 2).numpy() for of_camera in uv])
            out, sums = (one[columns].view(-1, one.shape[-1]) for one in (volume, totals))
            cells = out.float()  # `out` itself, or a copy
            _correlate_cells(table, sizes, places, cells.numpy(), sums.numpy())
            # so few at a time that torch starts no threads of its own
            for k in range(0, len(out) if half else 0, _ROUNDED):
                out[k : k + _ROUNDED] = cells[k : k + _ROUNDED]

        each = max(1, _CELLS // max(1, size[1] * size[2]))
        list(map_threads(correlate_part, [slice(x, x + each) for x in range(0, size[0], each)]))
        ctx.uv = uv
        ctx.save_for_backward(totals, volume, *maps)
        return volume

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        """Return the gradients of the features: ∂/∂f_i = 2 (Σ_j f_j - f_i), scattered back."""
        totals, volume, *maps = ctx.saved_tensors
        totals, volume, grad = (one.reshape(-1, one.shape[-1]) for one in (totals, volume, grad))
        grads = [torch.zeros(one.shape, dtype=torch.float32) for one in maps]
        # The last number of a cell is k / 4, and the others were divided by k (k - 1).
        k = 4 * volume[:, GROUPS:]
        of_products = (grad[:, :GROUPS] / (k * (k - 1)).clamp(min=1)).contiguous()

        def scatter(camera: int) -> None:
            uv = ctx.uv[camera].reshape(-1, 2)
            arrays = maps[camera].detach(), uv, totals, of_products, grads[camera]
            _scatter_gradient(*(array.numpy() for array in arrays))

        list(map_threads(scatter, range(len(maps))))
        return None, *grads


# Not nnan: a test for NaN says where a cell is visible. Not reassoc: the sums are written in the
# order in which they are added, each product and sum as one fused operation.
_loop = compiled(nogil=True, error_model="numpy", fastmath={"contract", "nsz"})


# No fastmath: as in `OcamCamera.project`, each product and each sum is rounded.
@compiled(nogil=True, error_model="numpy")
def _project(points: Any, uv: Any, max_t: Any, poly: Any, lens: Any, edges: Any, mask: Any) -> None:
    """Replace the distances of points (3, M) from the axis, and their angles below the xy-plane, in
    uv (2, M), by half pixels, NaN where unseen.
    """
    x, y, z, n, t = points[0], points[1], points[2], uv[0], uv[1]
    (c, d, e, u0, v0), (low, right, bottom) = lens, edges
    r = np.full(len(t), poly[0])
    zero, half, one = np.float32(0), np.float32(0.5), np.float32(1)
    inf, nan = np.float32(np.inf), np.float32(np.nan)
    for k in range(len(r)):
        undefined = (n[k] == inf) | (abs(z[k]) == inf) | ((n[k] == zero) & (z[k] == zero))
        t[k] = nan if undefined | (t[k] > max_t) else t[k]
    for coefficient in poly[1:]:
        for k in range(len(r)):
            r[k] = r[k] * t[k] + coefficient
    # Points on the axis project to the centre.
    for k in range(len(r)):
        off_axis = n[k] > zero
        distance = n[k] if off_axis else one
        right_of = (x[k] if off_axis else zero) / distance * r[k]
        below = (y[k] if off_axis else zero) / distance * r[k]
        u, v = right_of + e * below + u0, d * right_of + c * below + v0
        seen = (low <= u) & (u <= right) & (low <= v) & (v <= bottom)
        n[k], t[k] = half * u if seen else nan, half * v if seen else nan
    for k in range(len(n) if len(mask) else 0):
        if n[k] == n[k] and not mask[int(np.rint(2 * t[k])), int(np.rint(2 * n[k]))]:
            n[k] = t[k] = nan


@_loop
def _sum(rows: Any, seen: Any, sums: Any) -> None:
    """Add Σ f and Σ f² of the seen rows (pixels, 32) to sums (2, 32), in float64."""
    for m in range(len(rows)):
        if seen[m]:
            for k in range(CHANNELS):
                f = np.float64(rows[m, k])
                sums[0, k] += f
                sums[1, k] += f * f


@_loop
def _scale(rows: Any, seen: Any, scale: Any, shift: Any) -> None:
    """Replace the seen rows f by scale f - shift, and the others by 0."""
    for m in range(len(rows)):
        for k in range(CHANNELS):
            rows[m, k] = scale[k] * rows[m, k] - shift[k] if seen[m] else np.float32(0)


@_loop
def _corner(x: float, y: float, height: int, width: int) -> tuple[int, int, Any, Any]:
    """Return column and row of the pixel up and left of a position, and how far it is beyond."""
    # Beyond the last pixel centres the nearest value is read: the shares are kept within 0 and 1.
    column, row = min(max(int(x), 0), width - 2), min(max(int(y), 0), height - 2)
    fx, fy = np.float32(x - column), np.float32(y - row)
    return (
        column,
        row,
        min(max(fx, np.float32(0)), np.float32(1)),
        min(max(fy, np.float32(0)), np.float32(1)),
    )


@_loop
def _correlate_cells(table: Any, sizes: Any, uv: Any, volume: Any, totals: Any) -> None:
    """Write cells of `correlate` (cells, 9), and Σ f_i (cells, 32) if asked for."""
    total, square = np.zeros(CHANNELS, np.float32), np.zeros(CHANNELS, np.float32)
    # Of each camera that sees a cell: rows of the table, and the shares of the four pixels around.
    rows, shares = np.empty((len(sizes), 2), np.int64), np.empty((len(sizes), 4), np.float32)
    one, zero = np.float32(1), np.float32(0)
    for cell in range(uv.shape[1]):
        # First all places, then all features, and each number by its index: in turns, or with
        # rows of arrays unpacked, it takes twice as long.
        first = count = 0
        for camera in range(len(sizes)):
            height, width = sizes[camera]
            x, y = uv[camera, cell, 0], uv[camera, cell, 1]
            # NaN says that the camera does not see the cell.
            if x == x:
                column, row, fx, fy = _corner(x, y, height, width)
                upper = first + row * width + column
                rows[count, 0], rows[count, 1] = upper, upper + width
                shares[count, 0], shares[count, 1] = (one - fx) * (one - fy), fx * (one - fy)
                shares[count, 2], shares[count, 3] = (one - fx) * fy, fx * fy
                count += 1
            first += height * width
        # Σ f and Σ f² over these cameras, of the feature between the four pixels.
        if count == 0:
            total[:] = square[:] = 0
        for i in range(count):
            r, s = rows[i, 0], rows[i, 1]
            a, b, c, d = shares[i, 0], shares[i, 1], shares[i, 2], shares[i, 3]
            for k in range(CHANNELS):
                f = d * table[s + 1, k] + c * table[s, k]
                f = b * table[r + 1, k] + (a * table[r, k] + f)
                total[k] = f + (total[k] if i > 0 else zero)
                square[k] = f * f + (square[k] if i > 0 else zero)
        # ((Σ f)² − Σ f²) / (k (k − 1)), the mean over a group of channels.
        scale = one / np.float32(_SIZE * max(count * (count - 1), 1))
        for group in range(GROUPS):
            k = group * _SIZE
            summed = total[k + 2] ** 2 + (total[k] ** 2 + total[k + 1] ** 2)
            summed -= square[k] + square[k + 1] + square[k + 2] + square[k + 3]
            volume[cell, group] = (total[k + 3] ** 2 + summed) * scale
        volume[cell, GROUPS] = np.float32(0.25) * count
        if len(totals):
            totals[cell] = total


@_loop
def _scatter_gradient(maps: Any, uv: Any, totals: Any, grad: Any, out: Any) -> None:
    """Add ∂/∂f_i = 2 (Σ_j f_j - f_i), times the gradient of the group means, to f_i's pixels."""
    height, width, _ = maps.shape
    table, out = maps.reshape(-1, CHANNELS), out.reshape(-1, CHANNELS)
    g = np.zeros(CHANNELS, np.float32)
    for cell in range(len(uv)):
        x, y = uv[cell, 0], uv[cell, 1]
        if x == x:
            column, row, fx, fy = _corner(x, y, height, width)
            r, one = row * width + column, np.float32(1)
            a, b, c, d = (one - fx) * (one - fy), fx * (one - fy), (one - fx) * fy, fx * fy
            # The gradient of the features: 2 (Σ_j f_j − f_i) times that of their group.
            for group in range(GROUPS):
                for k in range(group * _SIZE, (group + 1) * _SIZE):
                    g[k] = grad[cell, group] * np.float32(2 / _SIZE)
            for k in range(CHANNELS):
                f = (
                    a * table[r, k]
                    + b * table[r + 1, k]
                    + c * table[r + width, k]
                    + d * table[r + width + 1, k]
                )
                g[k] *= totals[cell, k] - f
            # Back to the four pixels from which f_i was interpolated.
            for k in range(CHANNELS):
                out[r, k] += a * g[k]
                out[r + 1, k] += b * g[k]
                out[r + width, k] += c * g[k]
                out[r + width + 1, k] += d * g[k]
