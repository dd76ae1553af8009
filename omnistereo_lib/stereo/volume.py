"""The cost volume C(p, n): matching costs of all rays on all spheres (paper, Section III-B and Eq. 2)."""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Protocol

import numpy as np
import psutil
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from omnistereo_lib.errors import OmnistereoError, checked, shortened
from omnistereo_lib.geometry.rig import Pair, Pairs, Rig, camera_pairs
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.learned import LearnedCost, PairNetwork
from omnistereo_lib.stereo.sweep import BLOCK, SphereSweep
from omnistereo_lib.stereo.threads import map_threads
from omnistereo_lib.stereo.zncc import ZNCC


class Cost(Protocol):
    """A matching cost: spherical images of a block of spheres → mean cost over the pairs.

    A cost may instead have a method `whole_volume(sweep, images, progress)`, as `VolumeNet` has.
    """

    def __call__(
        self, spherical_images: Tensor, pairs: Sequence[Pair], columns: Sequence[tuple[int, int]] | None = None
    ) -> Tensor:
        """Return the costs as `ZNCC.__call__` does."""


@checked
def cost_volume(
    sweep: SphereSweep,
    images: Sequence[ArrayLike],
    cost: Cost | None = None,
    pairs: Pairs = "ring",
    progress: Callable[[Iterable], Iterable] = iter,
) -> Tensor:
    """Compute the cost volume C(p, n), the mean cost over camera pairs (Eq. 2).

    Args:
        images: one array per camera, (height, width) or (height, width, 3)
        cost: A `Cost`, or a network such as `SweepNet`. Default: ZNCC(window=9).
        pairs: See `camera_pairs`.
        progress: Wraps the sequence of sphere blocks, such as tqdm.

    Returns:
        float32 tensor, shape (H, W, N), on the device of the sweep: Cost in [0, 1], 0 = match; NaN where the point is
            not visible to both cameras of any pair.

    Raises:
        OmnistereoError: If the images do not fit the rig, the cameras of no pair share a view, or memory cannot hold
            the volume.
    """
    cost = ZNCC() if cost is None else LearnedCost(cost) if isinstance(cost, PairNetwork) else cost
    whole = getattr(cost, "whole_volume", None)
    if not callable(whole or cost):
        raise OmnistereoError(f"cost is {cost!r}; expected a matching cost, which is called like ZNCC")
    pairs = camera_pairs(pairs, sweep.rig)
    volume = whole(sweep, images, progress) if whole else _by_blocks(sweep, images, cost, pairs, progress)
    if all(row.isnan().all() for row in volume):
        raise OmnistereoError(
            f"no ray is visible to both cameras of any pair {pairs}. Check the poses (camera → rig, metres), the field "
            f"of view, the masks and phi_deg = {sweep.grid.phi_deg}."
        )
    return volume


def _by_blocks(
    sweep: SphereSweep, images: Sequence[ArrayLike], cost: Cost, pairs: Sequence, progress: Callable
) -> Tensor:
    """Compute the volume one block of spheres at a time."""
    normalized = sweep.normalize_images(images)
    H, W = sweep.grid.shape
    check_memory(sweep.rig, sweep.grid, sweep.device)
    as_out = {"dtype": torch.float32, "device": sweep.device}
    volume = torch.empty(H, W, sweep.grid.num_spheres, **as_out)
    blocks, on_cpu = sweep.blocks(), sweep.device.type == "cpu"
    # ZNCC runs in one thread, so it gets one for each block; a network has threads of its own.
    threads = min(torch.get_num_threads(), len(blocks)) if on_cpu and isinstance(cost, ZNCC) else 1
    buffers = [torch.empty(len(sweep.rig), H, W, len(blocks[0]), **as_out) for _ in range(threads)]

    def fill(spheres: range) -> None:
        buffer = buffers.pop()
        out = buffer if len(spheres) == buffer.shape[-1] else None  # the last block may be smaller
        block = sweep.warp_block(normalized, spheres, out)  # first: it computes what visible_columns looks up
        columns = [sweep.visible_columns(camera, spheres) for camera in range(len(sweep.rig))]
        costs, target = torch.as_tensor(cost(block, pairs, columns)), volume[:, :, spheres.start : spheres.stop]
        if costs.shape != target.shape:
            found = f"costs of shape {tuple(costs.shape)}"
            raise OmnistereoError(f"{shortened(cost)} gives {found}; expected (H, W, spheres) = {tuple(target.shape)}")
        if on_cpu:  # by NumPy: torch has threads of its own, which spin after each operation and slow these down
            target.numpy()[:] = costs.detach().float().numpy()
        else:
            target.copy_(costs)
        buffers.append(buffer)

    done = (map_threads if threads > 1 else map)(fill, blocks)
    for _ in zip(progress(blocks), done, strict=True):
        pass
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


def check_memory(rig: Rig, grid: SphereGrid, device: torch.device | str = "cpu") -> None:
    """Refuse a panorama that does not fit the available memory of the device.

    Raises:
        OmnistereoError: With the size needed and the size available.
    """
    device = torch.device(device)
    H, W = grid.shape
    # Bytes per ray, measured: a block of spheres in sweep and cost, then the volume and the copies that SGM makes.
    if device.type == "cpu":
        more_blocks = min(torch.get_num_threads(), math.ceil(grid.num_spheres / BLOCK)) - 1  # at once; see `_by_blocks`
        need = H * W * (400 + 225 * len(rig) + 9 * grid.num_spheres + more_blocks * (250 + 64 * len(rig)))
    else:
        need = H * W * (1800 + 64 * len(rig) + 18 * grid.num_spheres)
    require_memory(need, grid, device)


def require_memory(need: float, grid: SphereGrid, device: torch.device) -> None:
    """Refuse a panorama that needs more than three quarters of the available memory; the rest is for lookup tables."""
    free = 0.75 * _available_memory(device)
    if need > free:
        raise OmnistereoError(
            f"a panorama of {grid.width} × {grid.height} with {grid.num_spheres} spheres needs {need / 2**30:.1f} GiB "
            f"of {device} memory; {free / 2**30:.1f} GiB are available. Use fewer spheres or a smaller panorama."
        )


def _available_memory(device: torch.device) -> int:
    """Return the bytes that can be allocated on a device; the host memory unless it is a CUDA GPU."""
    if device.type != "cuda":
        return psutil.virtual_memory().available
    cached = torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
    return torch.cuda.mem_get_info(device)[0] + cached
