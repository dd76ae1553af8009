"""Correlation of the cameras' features in every cell of a coarse volume; see `volumenet`."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from omnistereo_lib import reference
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.device import takes_loops
from omnistereo_lib.stereo.kernels import correlation_numba
from omnistereo_lib.stereo.kernels.correlation_numba import GROUPS
from omnistereo_lib.stereo.threads import map_threads

# Columns and spheres of the volume on which the shipped network was trained.
COARSE = 160, 32
# Columns and spheres of the finer volume, at most.
FINER = 320, 48
# Columns that a thread projects at a time: so few that torch divides them no further.
_COLUMNS = 2


def volume_sizes(grid: SphereGrid, rig: Rig | None = None) -> list[tuple[int, int, int]]:
    """Return the sizes (width, height, spheres) of the volumes of a grid, coarse to fine.

    The U-net sees a fixed number of cells around each: the coarser they are, the more of the scene,
    and the finer, the more detail. So there are two, whose logits are averaged: that of the
    training, and a finer one, at most three quarters as wide as the grid and, given a rig, no wider
    than suits its images; see `pixels_per_degree`. One no wider than the first is finer in depth
    alone, and left out for grids of few spheres.
    """
    # Neither finer than three quarters of the grid, nor than the images are: `pixels_per_degree`
    # asks for 4 w / 360 of them, so w is 360 / 4 times what the coarsest camera has.
    columns = min(0.75 * grid.width, FINER[0])
    if rig is not None:
        columns = min(
            columns,
            360 / 4 * min(camera.image_size[0] / camera.max_fov_deg for camera in rig.cameras),
        )
    # In steps of 80 columns: a volume that is hardly finer than the first does not pay.
    columns = max(80 * int(columns / 80), COARSE[0])
    finer = columns > COARSE[0] or grid.num_spheres >= 2 * FINER[1]
    cells = [COARSE, (columns, FINER[1])] if finer else [COARSE]
    return [(w, 8 * math.ceil(w * grid.height / grid.width / 8), n) for w, n in cells]


def pixels_per_degree(size: tuple[int, int, int]) -> float:
    """Return the image resolution that suits a volume: features twice as fine as its cells."""
    return 4 * size[0] / 360


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Where the cells of a volume land on the feature map of a camera, by columns, (W, H, N, 2)."""

    camera: OcamCamera
    T_cam_rig: Pose
    rays: Tensor  # (W, H, 3)
    inverse_depth: Tensor  # (N, 1), or one for each ray

    @property
    def shape(self) -> tuple[int, ...]:
        """Of all columns."""
        return *self.rays.shape[:2], len(self.inverse_depth), 2

    def __getitem__(self, columns: Any) -> Tensor:
        """Compute some columns: feature pixels, NaN where unseen."""
        rays = self.rays[columns]
        R, t = (
            torch.tensor(a, dtype=torch.float32, device=rays.device)
            for a in (self.T_cam_rig.R, self.T_cam_rig.t)
        )
        # R ρ + d t has the direction of the point ρ/d in the camera's frame, as in the sweep. The
        # axes come first, (3, W, H, N): torch is slow across three numbers.
        turned = (rays @ R.T).permute(2, 0, 1).contiguous()
        points = turned[..., None] + t[:, None, None, None] * self.inverse_depth[..., 0]
        if takes_loops(rays):
            return correlation_numba.project(self.camera, points)
        uv, visible = self.camera.project(points.permute(1, 2, 3, 0))
        # A feature map has every second pixel of its image.
        return torch.where(visible[..., None], uv / 2, torch.nan)


def feature_coordinates(
    rig: Rig, grid: SphereGrid, size: tuple[int, int, int], device: torch.device | str = "cpu"
) -> list[Tensor]:
    """Return where the cells of a volume land on the feature maps of every camera (Eq. 1).

    Args:
        rig: With its origin at the sweep centre.
        size: Of the volume: (W', H', N'). See `volume_sizes`.

    Returns:
        list of float32 tensors, shape (W', H', N', 2): Feature pixels, NaN where unseen.
    """
    rays, inverse_depth = (cells.to(device) for cells in volume_cells(grid, size))
    coordinates = coordinates_of(rig, rays, inverse_depth)
    tables = [torch.empty(*size, 2, dtype=rays.dtype, device=device) for _ in coordinates]

    def fill(columns: Tensor) -> None:
        for table, of_camera in zip(tables, coordinates, strict=True):
            table[columns] = of_camera[columns]

    list(map_threads(fill, torch.arange(size[0]).split(_COLUMNS)))
    return tables


def volume_cells(grid: SphereGrid, size: tuple[int, int, int]) -> tuple[Tensor, Tensor]:
    """Return rays (W', H', 3) and inverse depths (N', 1), 1/m, of the cells of a volume."""
    width, height, spheres = size
    rays = (
        torch.from_numpy(replace(grid, width=width, height=height).rays()).float().transpose(0, 1)
    )
    # The centres of n cells along a ray, as sphere indices of the full grid: (k + ½) N / n - ½.
    index = (np.arange(spheres) + 0.5) * grid.num_spheres / spheres - 0.5
    return rays, torch.from_numpy(grid.index_to_inverse_depth(index)).float()[:, None]


def coordinates_of(rig: Rig, rays: Tensor, inverse_depth: Tensor) -> list[Coordinates]:
    """Return the coordinates of the cells of `volume_cells`, for each camera."""
    poses = (pose.inverse() for pose in rig.T_rig_cam)
    pairs = zip(rig.cameras, poses, strict=True)
    return [Coordinates(camera, pose, rays, inverse_depth) for camera, pose in pairs]


def project_cells(rig: Rig, rays: Tensor, inverse_depth: Tensor) -> list[Tensor]:
    """Return all columns of `coordinates_of`."""
    return [of_camera[:] for of_camera in coordinates_of(rig, rays, inverse_depth)]


def correlate(
    features: Sequence[Tensor], coordinates: Sequence[Tensor] | Sequence[Coordinates]
) -> Tensor:
    """Correlate the features of the cameras that see a cell, in groups of channels: `reference`.

    Args:
        features: one tensor per camera, shape (32, h, w)
        coordinates (one per camera, shape (W, H, N, 2)): See `feature_coordinates`.

    Returns:
        tensor, shape (9, W, H, N): Eight correlations, 0 where k < 2, and k / 4, where k is the
            number of cameras to which the cell is visible.
    """
    if features[0].device.type != "cpu":
        return reference.correlate(features, [uv[:] for uv in coordinates], GROUPS)
    return correlation_numba.correlate(features, coordinates)
