"""How long depth takes, said before it begins."""

from __future__ import annotations

import time
from collections.abc import Sequence

import torch
from numpy.typing import ArrayLike

from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.learned import choose_precision
from omnistereo_lib.stereo.methods import Method
from omnistereo_lib.stereo.pipeline import sweep_depth
from omnistereo_lib.stereo.sweep import SphereSweep

# Seconds for each cell of the cost volume, rays × spheres, of a first frame with four cameras on two cores.
_SECONDS = {"zncc": 2.3e-7, "mccnn": 1e-5, "sweepnet": 3e-5, "volumenet": 7e-8}
_WRITING_S, _CORES = 4.0, 2
_FEW_FRAMES = 10  # are soon done


def say_frame(method: str, grid: SphereGrid, device: str) -> None:
    """Say how long a frame will take on the processor, before it begins; elsewhere only by which method."""
    seconds = _SECONDS.get(Method.parse(method).cost)
    if seconds is None or device != "cpu":
        print(f"method: {method}", flush=True)
        return
    cells = grid.width * grid.height * grid.num_spheres
    total = _WRITING_S + cells * seconds * _CORES / torch.get_num_threads()
    precision = f" in {choose_precision('auto', device)}" if Method.parse(method).has_weights else ""
    print(f"{method} takes about {in_words(total)}{precision}", flush=True)


def say_recording(
    sweep: SphereSweep, images: Sequence[ArrayLike], frames: int, method: str, others: Sequence[str]
) -> None:
    """Say how long the frames of a recording will take, by the method chosen and by others, as its first frame does."""
    if frames < _FEW_FRAMES:
        return
    print("timing the methods on one frame: a few seconds", flush=True)
    took = {name: in_words(frames * _measure(sweep, images, name)) for name in dict.fromkeys([method, *others])}
    print(f"{frames} frames: about {took.pop(method)} by {method}", flush=True)
    for other, words in took.items():
        print(f"about {words} by {other} (--method {other})", flush=True)


def _measure(sweep: SphereSweep, images: Sequence[ArrayLike], method: str) -> float:
    """Return how many seconds a frame takes, once the tables of the sweep and the network are there."""
    sweep_depth(sweep, images, method)
    start = time.perf_counter()
    sweep_depth(sweep, images, method)
    return time.perf_counter() - start


def in_words(seconds: float) -> str:
    """Return a duration with one or two digits: "8 s", "40 s", "3 min", "2 h"."""
    if seconds < 90:
        return f"{max(1, round(seconds)):.0f} s" if seconds < 10 else f"{10 * round(seconds / 10):.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.0f} h"
