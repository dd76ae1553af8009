"""The cost volume C(p, n): matching costs of all rays on all spheres (paper, Section III-B and Eq. 2)."""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from omnistereo_lib.errors import OmnistereoError, shortened
from omnistereo_lib.geometry.rig import Pairs, camera_pairs
from omnistereo_lib.stereo.cost import Cost, Progress
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_lib.stereo.zncc import ZNCC


def cost_volume(
    sweep: SphereSweep,
    images: Sequence[ArrayLike],
    cost: Cost | None = None,
    pairs: Pairs = "ring",
    progress: Progress = iter,
) -> Tensor:
    """Compute the cost volume C(p, n), the mean cost over camera pairs (Eq. 2).

    Args:
        images: one array per camera, (height, width) or (height, width, 3)
        cost: A `Cost`: `ZNCC`, a network such as `SweepNet`, or your own `BlockCost`. Default: ZNCC(window=9).
        pairs: See `camera_pairs`. `VolumeNet` compares all cameras, whatever they are.
        progress: Wraps the sequence of sphere blocks, such as tqdm.

    Returns:
        float32 tensor, shape (H, W, N), on the device of the sweep: Cost in [0, 1], 0 = match; NaN where the point is
            not visible to both cameras of any pair.

    Raises:
        OmnistereoError: If the images do not fit the rig, or the cameras of no pair share a view.

    >>> frame = osl.load_dataset("data_samples/sunny", split="test")[0]
    >>> sweep = osl.SphereSweep(frame.rig, osl.SphereGrid(64, 16, num_spheres=16, min_depth=1.65))
    >>> osl.cost_volume(sweep, frame.images, osl.ZNCC(window=5)).shape
    torch.Size([16, 64, 16])
    """
    cost = ZNCC() if cost is None else cost
    if not hasattr(cost, "volume"):
        raise OmnistereoError(f"cost is {shortened(cost)}; expected an object with a method `volume`, such as ZNCC()")
    pairs = camera_pairs(pairs, sweep.rig)
    volume = cost.volume(sweep, images, pairs, progress)
    if all(row.isnan().all() for row in volume):
        raise OmnistereoError(
            f"no ray is visible to both cameras of any pair {pairs}. Check the poses (camera → rig, metres), the field "
            f"of view, the masks and phi_deg = {sweep.grid.phi_deg}."
        )
    return volume


def as_volume(volume: ArrayLike | Tensor) -> Tensor:
    """Return a cost volume (H, W, N), N ≥ 2, as a tensor of real numbers, from an array of any memory layout."""
    if not isinstance(volume, Tensor):
        volume = np.asarray(volume)
        if volume.dtype.kind not in "fiub":
            raise OmnistereoError(f"the cost volume holds {volume.dtype}; expected real numbers")
        volume = torch.from_numpy(np.ascontiguousarray(volume, volume.dtype.newbyteorder("=")))
    if volume.is_complex() or volume.ndim != 3 or 0 in volume.shape or volume.shape[2] < 2:
        found = f"shape {tuple(volume.shape)} and type {volume.dtype}"
        raise OmnistereoError(f"the cost volume has {found}; expected (H, W, N) with N ≥ 2, real")
    return volume.detach()
