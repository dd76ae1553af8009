"""The cost volume C(p, n): matching costs of all rays and all spheres (paper, Eq. 2)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import combinations
from typing import Literal, Protocol

import numpy as np
import psutil
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_lib.stereo.zncc import ZNCC

Pairs = Literal["ring", "all"] | Sequence[tuple[int, int]]


class Cost(Protocol):
    """A matching cost: images on a block of spheres → mean cost over the pairs."""

    def __call__(
        self,
        spherical: Tensor,
        pairs: Sequence[tuple[int, int]],
        columns: Sequence[tuple[int, int]] | None = None,
    ) -> Tensor:
        """Do what `ZNCC.__call__` states."""
        ...


def camera_pairs(pairs: Pairs, rig: Rig) -> list[tuple[int, int]]:
    """Return the camera pairs that are compared.

    Parameters
    ----------
    pairs : "ring" | "all" | sequence of (int, int)
        "ring": each camera with its neighbour to the right, by where the cameras look. For the paper's
        rig these are the authors' released (0, 1), (1, 2), (2, 3), (3, 0). "all": every unordered pair, as
        the paper's text says.
    rig : Rig

    Raises
    ------
    OmnistereoError
        If a pair names a camera that does not exist, or one camera twice.
    """
    if pairs == "ring":
        return _neighbours(rig)
    if pairs == "all":
        return list(combinations(range(len(rig)), 2))
    if isinstance(pairs, str):
        raise OmnistereoError(f'pairs must be "ring", "all" or a list of camera pairs, got {pairs!r}')
    chosen = [(int(i), int(j)) for i, j in pairs]
    for i, j in chosen:
        if i == j or not (0 <= i < len(rig) and 0 <= j < len(rig)):
            raise OmnistereoError(f"pair {(i, j)} does not name two different cameras of 0 … {len(rig) - 1}")
    if not chosen:
        raise OmnistereoError("the list of camera pairs is empty, expected at least one pair")
    return chosen


def _neighbours(rig: Rig) -> list[tuple[int, int]]:
    """Return the ring of cameras in the order of the azimuth θ of their optical axes, from camera 0 on."""
    axes = np.stack([pose.R[:, 2] for pose in rig.T_rig_cam])
    azimuth = np.arctan2(axes[:, 0], axes[:, 2])
    around = np.argsort((azimuth - azimuth[0] + 1e-6) % (2 * np.pi), kind="stable").tolist()
    if len(around) == 2:
        return [(0, 1)]
    return list(zip(around, around[1:] + around[:1], strict=True))


def cost_volume(
    sweep: SphereSweep,
    images: Sequence[ArrayLike],
    cost: Cost | None = None,
    pairs: Pairs = "ring",
    progress: Callable[[Iterable], Iterable] = iter,
) -> Tensor:
    """Compare the images on every sphere: C(p, n), the mean cost over camera pairs (Eq. 2).

    Parameters
    ----------
    sweep : SphereSweep
    images : one array per camera, (height, width) or (height, width, 3)
    cost : Cost
        ZNCC(window=9) unless given.
    pairs : "ring" | "all" | sequence of (int, int)
        See `camera_pairs`.
    progress : callable
        Wraps the sequence of sphere blocks, such as tqdm.

    Returns
    -------
    float32 tensor, shape (H, W, N), on the sweep's device
        Cost in [0, 1], 0 = match; NaN where no pair sees the ray at that depth.

    Raises
    ------
    OmnistereoError
        If the images do not fit the rig, no pair of cameras shares a view, or memory cannot hold the volume.
    """
    cost = ZNCC() if cost is None else cost
    pairs = camera_pairs(pairs, sweep.rig)
    prepared = sweep.prepare(images)
    H, W = sweep.grid.shape
    if sweep.device.type == "cpu":
        check_memory(sweep.rig, sweep.grid)
    volume = torch.empty(H, W, sweep.grid.num_spheres, device=sweep.device)
    buffer = torch.empty(len(sweep.rig), len(sweep.blocks()[0]), H, W, device=sweep.device)
    for spheres in progress(sweep.blocks()):
        columns = [sweep.visible_columns(camera, spheres) for camera in range(len(sweep.rig))]
        block = sweep.warp_block(prepared, spheres, buffer)
        volume[:, :, spheres.start : spheres.stop] = cost(block, pairs, columns)
    if volume.isnan().all():
        raise OmnistereoError(
            f"no ray is seen by both cameras of any pair {pairs}: nothing can be matched. Check the poses "
            f"(camera → rig, metres), the field of view, the masks and phi_deg = {sweep.grid.phi_deg}"
        )
    return volume


def check_memory(rig: Rig, grid: SphereGrid) -> None:
    """Refuse a panorama that the memory cannot hold, before hours are spent on it.

    Raises
    ------
    OmnistereoError
        With the figures.
    """
    H, W = grid.shape
    # Measured bytes a ray: a block of spheres on its way through sweep and cost, and the volume with its aggregated
    # copy. A quarter of what is free is left to the sweep's tables.
    need = H * W * (400 + 225 * len(rig) + 9 * grid.num_spheres)
    free = 0.75 * psutil.virtual_memory().available
    if need > free:
        raise OmnistereoError(
            f"a panorama of {W} × {H} with {grid.num_spheres} spheres needs {need / 2**30:.1f} GiB, "
            f"{free / 2**30:.1f} GiB are free for it: choose fewer spheres or a smaller panorama"
        )
