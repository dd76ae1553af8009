"""Correlation of the features of all cameras in every cell of a coarse sweep volume; see `volumenet`."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import embedding_bag

from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.learned import full_precision

CHANNELS, GROUPS = 32, 8
LEAST = 160, 32  # columns and spheres of the volumes on which the shipped network was trained
_CELLS = 1 << 14  # cells correlated at a time: so few that their features stay in the cache of a core


def volume_sizes(grid: SphereGrid) -> list[tuple[int, int, int]]:
    """Return width, height and spheres of the volumes of a grid, coarse to fine, in multiples of 8 for the U-net.

    The U-net sees a fixed number of cells around each: the coarser they are, the more of the scene, and the finer, the
    more detail. So a fine grid has two, whose logits are averaged: that of the training, and one of half its own size
    or less. A grid no finer than the training's has the first alone.
    """
    coarser, deeper = 2 * max(1, round(grid.width / 640)), 2 * max(1, round(grid.num_spheres / 96))
    fine = max(grid.width / coarser, LEAST[0]), max(grid.num_spheres / deeper, LEAST[1])

    def size_of(width: float, spheres: float) -> tuple[int, int, int]:
        height = grid.height * width / grid.width
        return 8 * math.ceil(width / 8), 8 * math.ceil(height / 8), 8 * math.ceil(spheres / 8)

    return list(dict.fromkeys([size_of(*LEAST), size_of(*fine)]))


def pixels_per_degree(size: tuple[int, int, int]) -> float:
    """Return the image resolution that suits a volume: features, at half of it, are twice as fine as its cells."""
    return 4 * size[0] / 360


def feature_coordinates(rig: Rig, grid: SphereGrid, size: tuple[int, int, int]) -> list[Tensor]:
    """Return where the cells of a volume land on the feature maps of every camera (Eq. 1).

    Args:
        rig: With its origin at the sweep centre.
        size: Of the volume: (W', H', N'). See `volume_sizes`.

    Returns:
        list of float32 tensors, shape (W', H', N', 2): Feature pixels, NaN where the cell is not visible to the camera.
    """
    return project_cells(rig, *volume_cells(grid, size))


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
        R, t = (torch.from_numpy(a).float() for a in (T_cam_rig.R, T_cam_rig.t))
        uv, visible = camera.project((rays @ R.T)[:, :, None] + inverse_depth * t)
        coordinates.append(torch.where(visible[..., None], uv / 2, torch.nan))  # maps have every second pixel
    return coordinates


class _PairProducts(torch.autograd.Function):
    """Σ over pairs of cameras i ≠ j of the group means of f_i f_j, without keeping a warped map for the gradient."""

    @staticmethod
    def forward(ctx: Any, parts: Iterable[Sequence[tuple[Tensor, Tensor]]], *tables: Tensor) -> Tensor:
        """Return the sums (cells, 8) of features (h · w, 32), part by part, at `bilinear` cells of each camera."""
        products, kept, totals = [], [], []
        for cells in parts:
            total = _sample(tables[0], *cells[0])
            squares = total.square()
            for table, at in zip(tables[1:], cells[1:], strict=True):
                warped = _sample(table, *at)
                squares.addcmul_(warped, warped)
                total += warped
            with full_precision(total):
                products.append((total.square() - squares) @ _group_means(total))
            if any(ctx.needs_input_grad):
                kept.append(cells)
                totals.append(total)
        ctx.save_for_backward(*tables, *totals)
        ctx.parts = kept
        return torch.cat(products)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        """Return the gradients of the features: ∂/∂f_i = 2 (Σ_j f_j - f_i), scattered back by the warp."""
        count = len(ctx.parts[0])
        tables, totals = ctx.saved_tensors[:count], ctx.saved_tensors[count:]
        grads = [torch.zeros_like(table) for table in tables]
        rows = grad.split([len(total) for total in totals])
        for cells, total, row in zip(ctx.parts, totals, rows, strict=True):
            of_products = 2 * row @ _group_means(total).T
            for table, of_table, (index, weight) in zip(tables, grads, cells, strict=True):
                of_cells = (total - _sample(table, index, weight)).mul_(of_products)
                for corner in range(4):
                    of_table.index_add_(0, index[:, corner], of_cells * weight[:, corner, None])
        return None, *grads


def _sample(table: Tensor, index: Tensor, weight: Tensor) -> Tensor:
    """Return weighted sums of rows of a table (rows, C): (cells, C) for indices and weights (cells, 4)."""
    return embedding_bag(index, table, mode="sum", per_sample_weights=weight)


def _group_means(like: Tensor) -> Tensor:
    """Return the matrix (32, 8) that averages the channels of each group."""
    size = CHANNELS // GROUPS
    return torch.eye(GROUPS, dtype=like.dtype, device=like.device).repeat_interleave(size, 0) / size


def bilinear(uv: Tensor, size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Return the four pixels around feature coordinates and their bilinear weights.

    Args:
        uv (tensor, shape (..., 2)): Feature pixels, NaN where the cell is not visible to the camera.
        size: Width and height of the feature maps.

    Returns:
        index: int32 tensor, shape (cells, 4), row · width + column
        weight: float32 tensor, shape (cells, 4), 0 where the cell is not visible to the camera
    """
    w, h = size
    x, y = uv.reshape(-1, 2).nan_to_num().unbind(-1)
    column, row = x.floor().clamp(0, w - 2), y.floor().clamp(0, h - 2)
    x, y = (x - column).clamp(0, 1), (y - row).clamp(0, 1)
    index = (row * w + column).int()
    weight = torch.stack([(1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y], -1)
    weight = weight.masked_fill(uv.reshape(-1, 2)[:, :1].isnan(), 0.0)
    return torch.stack([index, index + 1, index + w, index + w + 1], -1), weight


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
    shape = coordinates[0].shape[:3]  # W, H, N
    tables = [maps.permute(1, 2, 0).reshape(-1, CHANNELS) for maps in features]
    columns = max(1, _CELLS // shape[1:].numel())
    split = zip(*(uv.split(columns) for uv in coordinates), strict=True)
    sizes = [(maps.shape[2], maps.shape[1]) for maps in features]
    parts = ([bilinear(uv, size) for uv, size in zip(uvs, sizes, strict=True)] for uvs in split)
    k = torch.stack([(~uv[..., 0].isnan()).flatten() for uv in coordinates], -1).float().sum(-1, keepdim=True)
    products = _PairProducts.apply(parts, *tables)
    return torch.cat([products / (k * (k - 1)).clamp(min=1), k / 4], 1).view(*shape, -1).permute(3, 0, 1, 2)
