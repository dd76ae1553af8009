"""From images to depth in one call (paper, Fig. 4)."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import torch
from numpy.typing import ArrayLike

from omnistereo_lib.errors import OmnistereoError, checked
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.depth import Depth
from omnistereo_lib.stereo.methods import Method
from omnistereo_lib.stereo.sweep import SphereSweep, select_device
from omnistereo_lib.stereo.volume import Cost, check_memory, cost_volume


@checked
def estimate_depth(
    rig: Rig,
    images: Sequence[ArrayLike],
    grid: SphereGrid,
    method: str | Method = "zncc+sgm",
    cost: Cost | None = None,
    subindex: bool = True,
    device: torch.device | str = "cpu",
    progress: Callable[[Iterable], Iterable] = iter,
) -> Depth:
    """Estimate the depth panorama of one frame. For many frames of one rig, make a sweep and use `sweep_depth`.

    Args:
        images: one array per camera, (height, width) or (height, width, 3), uint8 or float
        method, cost, subindex, progress: See `sweep_depth`.

    Raises:
        OmnistereoError: If the inputs do not fit together, no method has that name, there is not enough memory or no
            such device.
    """
    method = Method.parse(method)
    grid = replace(grid, num_spheres=method.num_spheres or grid.num_spheres)
    device = select_device(device)
    check_memory(rig, grid, device)
    sweep = SphereSweep(rig, grid, device=device)
    return sweep_depth(sweep, images, method, cost, subindex, progress)


@checked
def sweep_depth(
    sweep: SphereSweep,
    images: Sequence[ArrayLike],
    method: str | Method = "zncc+sgm",
    cost: Cost | None = None,
    subindex: bool = True,
    progress: Callable[[Iterable], Iterable] = iter,
) -> Depth:
    """Estimate the depth panorama of one frame with a sweep that keeps its lookup tables from frame to frame.

    Args:
        images: one array per camera
        method: Such as "zncc", "volumenet" or "sweepnet+sgm,p1=0.2"; see `Method`.
        cost: An object of your own, called like `ZNCC`, in place of the cost that the method names; see `Cost`.
        subindex: Refine the index between spheres. False: as the method says, which is integer indices in the paper.
        progress: Wraps the sequence of sphere blocks, such as tqdm.
    """
    method = Method.parse(method)
    if method.num_spheres not in (0, N := sweep.grid.num_spheres):
        raise OmnistereoError(f"{method.name} has {method.num_spheres} spheres and the sweep {N}; make one of as many")
    volume = cost_volume(sweep, images, method.load_cost() if cost is None else cost, method.pairs, progress)
    index, confidence = method.read_out(method.smooth(volume), subindex)
    return Depth(index.cpu().numpy(), confidence.cpu().numpy(), sweep)
