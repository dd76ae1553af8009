"""From images to depth in one call (paper, Fig. 4)."""

from collections.abc import Sequence

import torch
from numpy.typing import ArrayLike

from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.progress import Progress, silent
from omnistereo_lib.stereo.depth import Depth
from omnistereo_lib.stereo.methods import FRAME_METHOD, VIDEO_METHOD, Method
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_lib.stereo.volume import cost_volume


def estimate_depth(
    rig: Rig,
    images: Sequence[ArrayLike],
    grid: SphereGrid,
    method: str | Method = FRAME_METHOD,
    subindex: bool = True,
    device: torch.device | str = "cpu",
    progress: Progress = silent,
) -> Depth:
    """Estimate the depth panorama of one frame. For many frames of one rig, make a sweep and use `sweep_depth`.

    Args:
        images: one array per camera, (height, width) or (height, width, 3), uint8 or float
        method: Such as "zncc", "volumenet" or "sweepnet+sgm,p1=0.2"; see `Method`. A cost of your own gets a name in
            `COSTS`.
        subindex: Refine the index between spheres, unless the name of the method says, as in "zncc,subindex=false".
            False: integer indices, as in the paper.
        progress: Called as `progress(done, total, what)`: parts done, parts in all, and the next part.

    Raises:
        OmnistereoError: If the inputs do not fit together, no method has that name, there is not enough memory or no
            such device.

    >>> frame = osl.load_dataset("data_samples/sunny", split="test")[0]
    >>> grid = osl.SphereGrid(64, 16, num_spheres=16, min_depth=1.65)
    >>> osl.estimate_depth(frame.rig, frame.images, grid, "zncc").depth.shape  # metres along each ray
    (16, 64)
    """
    method = Method.parse(method)
    return sweep_depth(SphereSweep(rig, grid, device=device), images, method, subindex, progress)


def sweep_depth(
    sweep: SphereSweep,
    images: Sequence[ArrayLike],
    method: str | Method = VIDEO_METHOD,
    subindex: bool = True,
    progress: Progress = silent,
) -> Depth:
    """Estimate the depth panorama of one frame with a sweep that keeps its tables and networks from frame to frame.

    Arguments and errors as in `estimate_depth`, but for the default method: the fastest that is smooth.
    """
    method = Method.parse(method)
    volume = cost_volume(sweep, images, method.cost_of(sweep), method.pairs, progress)  # (H, W, N)
    index, confidence = method.read_out(method.smooth(volume), subindex)  # (H, W) each
    return Depth(index.cpu().numpy(), confidence.cpu().numpy(), sweep)
