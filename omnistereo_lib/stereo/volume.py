"""The cost volume C(p, n): costs of all rays on all spheres (paper, Section III-B and Eq. 2)."""

from collections.abc import Callable, Sequence

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor, nn

from omnistereo_lib.arrays import as_array
from omnistereo_lib.errors import OmnistereoError, check_type, shortened
from omnistereo_lib.frame import Frame
from omnistereo_lib.geometry.rig import Pairs, camera_pairs
from omnistereo_lib.progress import Progress, silent
from omnistereo_lib.stereo.cost import Cost, Volume
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_lib.stereo.zncc import ZNCC


def cost_volume(
    sweep: SphereSweep,
    images: Frame | Sequence[ArrayLike],
    cost: Cost | None = None,
    pairs: Pairs = "ring",
    progress: Progress = silent,
) -> Tensor:
    """Compute the cost volume C(p, n), the mean cost over camera pairs (Eq. 2).

    It is whole; `sweep_depth` reads that of `VolumeNet` by rows, and holds a few of them.

    Args:
        images: A frame, or one array per camera, (height, width) or (height, width, 3).
        cost: A `Cost`: `ZNCC`, a network such as `SweepNet`, or your own. Default: `ZNCC`.
        pairs: See `camera_pairs`. `VolumeNet` compares all cameras, whatever they are.
        progress: Called as `progress(done, total, what)`: parts done, in all, and the next.

    Returns:
        float32 tensor, shape (H, W, N), on the device of the sweep: Cost in [0, 1], 0 = match; NaN
            where the point is not visible to both cameras of any pair.

    Raises:
        OmnistereoError: If the images do not fit the rig, or the cameras of no pair share a view.

    >>> frame = osl.load_dataset("data_samples/sunny", split="test")[0]
    >>> sweep = osl.SphereSweep(frame.rig, osl.SphereGrid(64, 16, num_spheres=16, min_depth=1.65))
    >>> osl.cost_volume(sweep, frame.images, osl.ZNCC(window=5)).shape
    torch.Size([16, 64, 16])
    """
    return costs_by_rows(sweep, images, cost, pairs, progress)[:]


def costs_by_rows(
    sweep: SphereSweep,
    images: Frame | Sequence[ArrayLike],
    cost: Cost | None = None,
    pairs: Pairs = "ring",
    progress: Progress = silent,
) -> Volume:
    """Return the volume of `cost_volume` as the cost gives it, whole or by rows."""
    # Check the cost, which may be the user's own, before it runs and what it returns.
    cost = ZNCC() if cost is None else cost
    if not hasattr(cost, "volume") or isinstance(cost, type):
        raise OmnistereoError(
            f"cost is {shortened(cost)}; expected an object with a method `volume`, such as ZNCC()"
        )
    check_type(progress, Callable, "progress")  # type: ignore[arg-type]  # an abstract class
    _check_network(getattr(cost, "network", cost))
    pairs, shape = camera_pairs(pairs, sweep.rig), (*sweep.grid.shape, sweep.grid.num_spheres)
    volume = cost.volume(sweep, Frame.of(sweep.rig, images), pairs, progress)
    fits = getattr(volume, "shape", ()) == shape and hasattr(volume, "__getitem__")
    rows = volume[:1] if fits else None
    if not (isinstance(rows, Tensor) and rows.is_floating_point()):
        kind = (
            f"{volume.dtype} of shape {tuple(volume.shape)}"
            if isinstance(volume, Tensor)
            else shortened(volume)
        )
        raise OmnistereoError(
            f"the cost {shortened(cost)} returns {kind}; expected a float tensor of shape {shape}"
        )
    if all(volume[y : y + 1].isnan().all() for y in range(shape[0])):
        raise OmnistereoError(
            f"no ray is visible to both cameras of any pair {pairs}. Check the poses (camera → rig,"
            f" metres), the field of view, the masks and phi_deg = {sweep.grid.phi_deg}."
        )
    return volume


def _check_network(cost: object) -> None:
    """Refuse a network that has no numbers, or not those that the sums are meant for."""
    for weight in cost.parameters() if isinstance(cost, nn.Module) else ():
        if weight.is_meta or weight.dtype != torch.float32:
            kind = (
                "no weights (device meta)" if weight.is_meta else f"weights of type {weight.dtype}"
            )
            raise OmnistereoError(
                f"the network has {kind}; expected float32. Convert it: network.float()"
            )


def as_volume(volume: ArrayLike | Tensor) -> Tensor:
    """Return a cost volume (H, W, N), N ≥ 2, as a tensor of real numbers, from any array."""
    if not isinstance(volume, Tensor):
        volume = torch.from_numpy(np.ascontiguousarray(as_array(volume, "the cost volume", None)))
    if volume.layout != torch.strided or volume.is_quantized or volume.device.type == "meta":
        raise OmnistereoError("the cost volume is sparse, quantised or meta; expected numbers")
    if volume.is_complex() or volume.ndim != 3 or 0 in volume.shape or volume.shape[2] < 2:
        found = f"shape {tuple(volume.shape)} and type {volume.dtype}"
        raise OmnistereoError(f"the cost volume has {found}; expected (H, W, N) with N ≥ 2, real")
    return volume.detach()
