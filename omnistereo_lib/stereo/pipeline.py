"""The whole way from images to depth, in one call (paper, Fig. 4)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Literal

import torch
from numpy.typing import ArrayLike

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.depth import Depth
from omnistereo_lib.stereo.learned import LearnedCost
from omnistereo_lib.stereo.mccnn import MCCNN
from omnistereo_lib.stereo.sgm import sgm
from omnistereo_lib.stereo.sweep import SphereSweep, find_device
from omnistereo_lib.stereo.sweepnet import SweepNet
from omnistereo_lib.stereo.volume import Cost, Pairs, check_memory, cost_volume
from omnistereo_lib.stereo.zncc import ZNCC

_NETWORKS = {"mccnn": MCCNN, "sweepnet": SweepNet}


def estimate_depth(
    rig: Rig,
    images: Sequence[ArrayLike],
    grid: SphereGrid,
    cost: str | Cost = "zncc",
    aggregate: Literal["sgm", "none"] = "sgm",
    pairs: Pairs = "ring",
    device: torch.device | str = "cpu",
    progress: Callable[[Iterable], Iterable] = iter,
) -> Depth:
    """Estimate the depth panorama of one frame. For many frames of one rig make a sweep and use `sweep_depth`.

    Parameters
    ----------
    rig : Rig
    images : one array per camera, (height, width) or (height, width, 3), uint8 or float
    grid : SphereGrid
    cost, aggregate, pairs, progress
        See `sweep_depth`.
    device : torch device

    Returns
    -------
    Depth

    Raises
    ------
    OmnistereoError
        If the input does not fit together, no method has that name, the memory does not suffice or there is
        no such device.
    """
    check_memory(rig, grid)
    sweep = SphereSweep(rig, grid, device=find_device(device))
    return sweep_depth(sweep, images, cost, aggregate, pairs, progress=progress)


def sweep_depth(
    sweep: SphereSweep,
    images: Sequence[ArrayLike],
    cost: str | Cost = "zncc",
    aggregate: Literal["sgm", "none"] = "sgm",
    pairs: Pairs = "ring",
    p1: float = 0.1,
    p2: float = 12.0,
    wrap: bool = True,
    subindex: bool = True,
    progress: Callable[[Iterable], Iterable] = iter,
) -> Depth:
    """Estimate the depth panorama of one frame with a sweep whose tables may be there from the last one.

    Parameters
    ----------
    sweep : SphereSweep
    images : one array per camera
    cost : "zncc" | "mccnn" | "sweepnet" | an object such as ZNCC(window=5)
        The networks by name are the shipped ones.
    aggregate : "sgm" | "none"
        Semi-global matching before the winner is taken, or the raw cost volume.
    pairs : "ring" | "all" | sequence of (int, int)
    p1, p2, wrap
        Of `sgm`; the defaults are the paper's.
    subindex : bool
        See `winner_takes_all`; the paper's results are whole indices.
    progress : callable
        Wraps the sequence of sphere blocks, such as tqdm.
    """
    if isinstance(cost, str):
        if cost not in ("zncc", *_NETWORKS):
            raise OmnistereoError(f"no cost is called {cost!r}: choose one of zncc, {', '.join(_NETWORKS)}")
        cost = ZNCC() if cost == "zncc" else LearnedCost(_NETWORKS[cost].pretrained())
    if aggregate not in ("sgm", "none"):
        raise OmnistereoError(f'aggregate must be "sgm" or "none", got {aggregate!r}')
    volume = cost_volume(sweep, images, cost, pairs, progress)
    if aggregate == "sgm":
        volume = sgm(volume, p1, p2, wrap=wrap)
    return Depth.from_volume(volume, sweep, subindex)
