"""Correlation of the features of all cameras in every cell of a coarse sweep volume; see `volumenet`."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.compiled import compiled
from omnistereo_lib.stereo.threads import map_threads

CHANNELS, GROUPS = 32, 8
_SIZE = CHANNELS // GROUPS
COARSE = 160, 32  # columns and spheres of the volume on which the shipped network was trained
FINER = 320, 48  # and of the finer volume, at most
_CELLS = 1 << 14  # cells correlated at a time: so few that their features stay in the cache of a core


def volume_sizes(grid: SphereGrid, rig: Rig | None = None) -> list[tuple[int, int, int]]:
    """Return width, height and spheres of the volumes of a grid, coarse to fine, in multiples of 8 for the U-net.

    The U-net sees a fixed number of cells around each: the coarser they are, the more of the scene, and the finer, the
    more detail. So there are two, whose logits are averaged: that of the training, and a finer one, at most three
    quarters as wide as the grid and, given a rig, no wider than suits its images; see `pixels_per_degree`. One no
    wider than the first is finer in depth alone, and left out for grids of few spheres.
    """
    columns = min(0.75 * grid.width, FINER[0])
    if rig is not None:
        columns = min(columns, 360 / 4 * min(camera.image_size[0] / camera.max_fov_deg for camera in rig.cameras))
    columns = max(80 * int(columns / 80), COARSE[0])  # in steps: one that is hardly finer does not pay
    finer = columns > COARSE[0] or grid.num_spheres >= 2 * FINER[1]
    cells = [COARSE, (columns, FINER[1])] if finer else [COARSE]
    return [(w, 8 * math.ceil(w * grid.height / grid.width / 8), n) for w, n in cells]


def pixels_per_degree(size: tuple[int, int, int]) -> float:
    """Return the image resolution that suits a volume: features, at half of it, are twice as fine as its cells."""
    return 4 * size[0] / 360


def feature_coordinates(
    rig: Rig, grid: SphereGrid, size: tuple[int, int, int], device: torch.device | str = "cpu"
) -> list[Tensor]:
    """Return where the cells of a volume land on the feature maps of every camera (Eq. 1).

    Args:
        rig: With its origin at the sweep centre.
        size: Of the volume: (W', H', N'). See `volume_sizes`.

    Returns:
        list of float32 tensors, shape (W', H', N', 2): Feature pixels, NaN where the cell is not visible to the camera.
    """
    rays, inverse_depth = volume_cells(grid, size)
    return project_cells(rig, rays.to(device), inverse_depth.to(device))


def volume_cells(grid: SphereGrid, size: tuple[int, int, int]) -> tuple[Tensor, Tensor]:
    """Return rays (W', H', 3) and inverse depths (N', 1) in 1/m of the cells of a volume of a size."""
    width, height, spheres = size
    rays = torch.from_numpy(replace(grid, width=width, height=height).rays()).float().transpose(0, 1)
    index = (np.arange(spheres) + 0.5) * grid.num_spheres / spheres - 0.5
    return rays, torch.from_numpy(grid.index_to_inverse_depth(index)).float()[:, None]


def project_cells(rig: Rig, rays: Tensor, inverse_depth: Tensor) -> list[Tensor]:
    """Return what `feature_coordinates` does for the cells of `volume_cells`."""
    coordinates = []
    for camera, pose in zip(rig.cameras, rig.T_rig_cam, strict=True):
        T_cam_rig = pose.inverse()
        R, t = (torch.tensor(a, dtype=torch.float32, device=rays.device) for a in (T_cam_rig.R, T_cam_rig.t))
        uv, visible = camera.project((rays @ R.T)[:, :, None] + inverse_depth * t)
        coordinates.append(torch.where(visible[..., None], uv / 2, torch.nan))  # maps have every second pixel
    return coordinates


class _CellCorrelation(torch.autograd.Function):
    """The correlation by loops over the cells: they pass over the cameras to which a cell is not visible.

    No warped map is kept for the gradient.
    """

    @staticmethod
    def forward(ctx: Any, uv: Tensor, *maps: Tensor) -> Tensor:
        """Return the cells (cells, 9) of `correlate`, given features (h, w, 32) and places (cameras, cells, 2)."""
        table = torch.cat([one.detach().reshape(-1, CHANNELS) for one in maps]).numpy()
        sizes = np.array([one.shape[:2] for one in maps])
        volume = torch.empty(uv.shape[1], GROUPS + 1, dtype=torch.float32)
        totals = torch.empty(uv.shape[1] if any(ctx.needs_input_grad) else 0, CHANNELS, dtype=torch.float32)

        def correlate_part(start: int) -> None:
            cells = slice(start, start + _CELLS)
            _correlate_cells(table, sizes, uv[:, cells].numpy(), volume[cells].numpy(), totals[cells].numpy())

        list(map_threads(correlate_part, range(0, uv.shape[1], _CELLS)))
        ctx.save_for_backward(uv, totals, volume, *maps)
        return volume

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        """Return the gradients of the features: ∂/∂f_i = 2 (Σ_j f_j - f_i), scattered back by the warp."""
        uv, totals, volume, *maps = ctx.saved_tensors
        grads = [torch.zeros(one.shape, dtype=torch.float32) for one in maps]
        k = 4 * volume[:, GROUPS:]
        of_products = (grad[:, :GROUPS] / (k * (k - 1)).clamp(min=1)).contiguous()

        def scatter(camera: int) -> None:
            arrays = maps[camera].detach(), uv[camera], totals, of_products, grads[camera]
            _scatter_gradient(*(array.numpy() for array in arrays))

        list(map_threads(scatter, range(len(maps))))
        return None, *grads


# Not nnan: a test for NaN says where a cell is visible.
_loop = compiled(nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})


@_loop
def _corner(x: float, y: float, height: int, width: int) -> tuple[int, int, Any, Any]:
    """Return column and row of the pixel up and left of a position, and how far the position is beyond it."""
    column, row = min(max(int(x), 0), width - 2), min(max(int(y), 0), height - 2)
    fx, fy = np.float32(x - column), np.float32(y - row)
    return column, row, min(max(fx, np.float32(0)), np.float32(1)), min(max(fy, np.float32(0)), np.float32(1))


@_loop
def _correlate_cells(table: Any, sizes: Any, uv: Any, volume: Any, totals: Any) -> None:
    """Write cells of `correlate` (cells, 9), and Σ f_i (cells, 32) if asked for; one table holds all features."""
    total, square = np.zeros(CHANNELS, np.float32), np.zeros(CHANNELS, np.float32)
    for cell in range(uv.shape[1]):
        total[:] = 0
        square[:] = 0
        first = count = 0
        for camera in range(len(sizes)):
            height, width = sizes[camera]
            x, y = uv[camera, cell]
            if x == x:
                count += 1
                column, row, fx, fy = _corner(x, y, height, width)
                r, one = first + row * width + column, np.float32(1)
                a, b, c, d = (one - fx) * (one - fy), fx * (one - fy), (one - fx) * fy, fx * fy
                for k in range(CHANNELS):
                    f = a * table[r, k] + b * table[r + 1, k] + c * table[r + width, k] + d * table[r + width + 1, k]
                    total[k] += f
                    square[k] += f * f
            first += height * width
        for group in range(GROUPS):
            summed = np.float32(0)
            for k in range(group * _SIZE, (group + 1) * _SIZE):
                summed += total[k] * total[k] - square[k]
            volume[cell, group] = summed / np.float32(_SIZE * max(count * (count - 1), 1))
        volume[cell, GROUPS] = np.float32(0.25) * count
        if len(totals):
            totals[cell] = total


@_loop
def _scatter_gradient(maps: Any, uv: Any, totals: Any, grad: Any, out: Any) -> None:
    """Add ∂/∂f_i = 2 (Σ_j f_j - f_i), times the gradient of the group means, to the pixels from which f_i was read."""
    height, width, _ = maps.shape
    table, out = maps.reshape(-1, CHANNELS), out.reshape(-1, CHANNELS)
    g = np.zeros(CHANNELS, np.float32)
    for cell in range(len(uv)):
        x, y = uv[cell]
        if x == x:
            column, row, fx, fy = _corner(x, y, height, width)
            r, one = row * width + column, np.float32(1)
            a, b, c, d = (one - fx) * (one - fy), fx * (one - fy), (one - fx) * fy, fx * fy
            for group in range(GROUPS):
                for k in range(group * _SIZE, (group + 1) * _SIZE):
                    g[k] = grad[cell, group] * np.float32(2 / _SIZE)
            for k in range(CHANNELS):
                f = a * table[r, k] + b * table[r + 1, k] + c * table[r + width, k] + d * table[r + width + 1, k]
                g[k] *= totals[cell, k] - f
            for k in range(CHANNELS):
                out[r, k] += a * g[k]
                out[r + 1, k] += b * g[k]
                out[r + width, k] += c * g[k]
                out[r + width + 1, k] += d * g[k]


def correlate(features: Sequence[Tensor], coordinates: Sequence[Tensor]) -> Tensor:
    """Correlate the features of all cameras to which a cell is visible, in groups of channels.

    The mean of f_i f_j over all pairs i ≠ j needs no pairs: it is ((Σ f)² - Σ f²) / (k (k - 1)), where k is the number
    of cameras to which the cell is visible. So any number of cameras will do, in any order.

    Args:
        features: one tensor per camera, shape (32, h, w)
        coordinates (one tensor per camera, shape (W, H, N, 2)): See `feature_coordinates`.

    Returns:
        tensor, shape (9, W, H, N): Eight correlations, 0 where k < 2, and k / 4.
    """
    if features[0].device.type != "cpu":
        return correlate_by_tensors(features, coordinates)
    maps = [one.permute(1, 2, 0).contiguous() for one in features]
    volume = _CellCorrelation.apply(torch.stack([uv.reshape(-1, 2) for uv in coordinates]), *maps)
    return volume.view(*coordinates[0].shape[:3], -1).permute(3, 0, 1, 2)


def correlate_by_tensors(features: Sequence[Tensor], coordinates: Sequence[Tensor]) -> Tensor:
    """Return what `correlate` does, by operations that every device and ONNX have."""
    total, squares, k = (torch.zeros((), device=features[0].device) for _ in range(3))
    for maps, uv in zip(features, coordinates, strict=True):
        last = torch.tensor([maps.shape[2] - 1.0, maps.shape[1] - 1.0], device=maps.device)
        seen = ~uv[..., 0].isnan()
        at = (2 * uv.nan_to_num() / last - 1).flatten(0, 1)[None]
        sampled = grid_sample(maps[None], at, padding_mode="border", align_corners=True)[0].unflatten(1, uv.shape[:2])
        warped = sampled * seen
        total, squares, k = total + warped, squares + warped.square(), k + seen
    groups = (total.square() - squares).unflatten(0, (GROUPS, -1)).mean(1) / (k * (k - 1)).clamp(min=1)
    return torch.cat([groups, k[None] / 4])
