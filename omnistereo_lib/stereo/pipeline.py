"""From images to depth in one call (paper, Fig. 4)."""

from collections.abc import Sequence

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from omnistereo_lib.errors import OmnistereoError, shortened
from omnistereo_lib.frame import Frame
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.progress import Progress, silent
from omnistereo_lib.stereo.depth import Depth
from omnistereo_lib.stereo.error_bars import error_bars, evidence_of
from omnistereo_lib.stereo.learned import Precision
from omnistereo_lib.stereo.methods import FRAME_METHOD, VIDEO_METHOD, Method
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_lib.stereo.threads import map_rows
from omnistereo_lib.stereo.volume import costs_by_rows


def estimate_depth(
    frame: Frame,
    grid: SphereGrid,
    method: str | Method = FRAME_METHOD,
    subindex: bool = True,
    device: torch.device | str = "cpu",
    progress: Progress = silent,
) -> Depth:
    """Estimate the depth panorama of one frame; for many, make a sweep and use `sweep_depth`.

    Args:
        frame: A rig and its images: of a data set, or `Frame.of(rig, images)`.
        method: Such as "zncc", "volumenet" or "sweepnet+sgm,p1=0.2"; see `Method`. A cost of your
            own gets a name in `COSTS`.
        subindex: Refine the index between spheres, unless the name of the method says, as in
            "zncc,subindex=false".
            False: integer indices, as in the paper.
        progress: Called as `progress(done, total, what)`: parts done, in all, and the next.

    Raises:
        OmnistereoError: If the inputs do not fit together, no method has that name, there is not
            enough memory or no such device.

    >>> frame = osl.load_dataset("data_samples/sunny", split="test")[0]
    >>> grid = osl.SphereGrid(64, 16, num_spheres=16, min_depth=1.65)
    >>> osl.estimate_depth(frame, grid, "zncc").depth.shape  # metres along each ray
    (16, 64)
    """
    if not isinstance(frame, Frame):
        raise OmnistereoError(
            f"frame is {shortened(frame)}; expected a Frame. Make one: Frame.of(rig, images)"
        )
    method = Method.parse(method)
    sweep = SphereSweep(frame.rig, grid, device=device, keep_tables=False)
    return sweep_depth(sweep, frame, method, subindex, progress)


def sweep_depth(
    sweep: SphereSweep,
    images: Frame | Sequence[ArrayLike],
    method: str | Method = VIDEO_METHOD,
    subindex: bool = True,
    progress: Progress = silent,
    precision: Precision = "auto",
) -> Depth:
    """Estimate the depth panorama of one frame with a sweep that keeps its tables and networks.

    Args:
        images: A frame, or one array per camera, (height, width) or (height, width, 3).
        method: Default: the fastest that is smooth. The rest is as in `estimate_depth`.
        precision: Of networks; see `choose_precision`.
    """
    method, frame = Method.parse(method), Frame.of(sweep.rig, images)
    # (H, W, N) each, as it is and smooth; that of VolumeNet is never whole.
    costs = costs_by_rows(sweep, frame, method.cost_of(sweep, precision), method.pairs, progress)
    volumes = [costs] if (smooth := method.smooth(costs)) is costs else [costs, smooth]

    def read(*rows: Tensor) -> Tensor:  # (h, W, N) each → (2 and more, h, W)
        index, confidence = method.read_out(rows[-1], subindex)
        return torch.stack([index, confidence, *evidence_of(method, rows, index)])

    found = map_rows(read, *volumes).cpu().numpy()
    del costs, volumes, smooth
    index, confidence = found[:2].copy()  # (H, W) each
    bars = error_bars(method, sweep, index, confidence, found[2:])
    return Depth(index, confidence, sweep, frame, *(bars or ()))
