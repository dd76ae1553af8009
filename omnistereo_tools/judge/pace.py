"""How long a command takes, said before it begins."""

import time
from collections.abc import Sequence

import torch
from numpy.typing import ArrayLike

from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.depth import Depth
from omnistereo_lib.stereo.device import select_device
from omnistereo_lib.stereo.learned import Precision, choose_precision
from omnistereo_lib.stereo.methods import FRAME_METHOD, VIDEO_METHOD, Method
from omnistereo_lib.stereo.pipeline import sweep_depth
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_tools.progress import say

# Seconds for each cell of the cost volume, rays × spheres, of a first frame with four cameras on
# two cores.
_SECONDS = {"zncc": 2.3e-7, "mccnn": 1e-5, "sweepnet": 3e-5, "volumenet": 7e-8}
_WRITING_S, _CORES = 4.0, 2
# Peak memory of `depth`: GiB at least, for the U-net, whose volumes do not grow; and GiB, bytes for
# each ray, and bytes for each cell of the cost volume, of which VolumeNet holds some rows. Of
# VolumeNet fitted to four cameras at 640 and 2400 columns; the book says how well they are kept.
_MEMORY = {"volumenet": (0.87, 0.64, 500.0, 0.0), "zncc+sgm": (0.0, 0.84, 0.0, 8.0)}
_FEW_FRAMES, _SOON_S = 10, 60.0  # are soon done: no other method is timed
_LIVE_S = 1 / 1.5  # of a frame that is watched
_PACE_S = 2.0  # of a frame; the public drives have 1000 frames, half an hour


def say_frame(method: str, grid: SphereGrid, device: str) -> None:
    """Say how long a frame will take on the processor, and how much memory.

    On another device, and by a method that was not measured, say only by which method; the memory
    of those that are not in `_MEMORY` is not said.
    """
    seconds = _SECONDS.get(Method.parse(method).cost)
    kind = select_device(device).type if device == "auto" else device
    if seconds is None or kind != "cpu":
        say(f"method: {method} on {kind}")
        return
    rays = grid.width * grid.height
    cells = rays * grid.num_spheres
    total = _WRITING_S + cells * seconds * _CORES / torch.get_num_threads()
    precision = f" in {choose_precision('auto', kind)}" if Method.parse(method).has_weights else ""
    memory = ""
    if fitted := _MEMORY.get(Method.parse(method).base):
        least, constant, of_ray, of_cell = fitted
        peak = max(least, constant + (of_ray * rays + of_cell * cells) / 2**30)
        memory = f" and {peak:.1f} GiB"
    say(f"{method} takes about {in_words(total)}{memory}{precision}")


def say_recording(
    sweep: SphereSweep,
    first: Sequence[Sequence[ArrayLike]],
    frames: int,
    method: str | None,
    precision: Precision,
) -> tuple[str, list[Depth]]:
    """Say how long the frames of a recording will take, as its first ones do, and by the other
    methods, if that is more than a minute; return the method, and what it has found by then.

    Args:
        first: Images of the first two frames.
        method: None: the one with the lowest errors, if frames are few or it keeps `_PACE_S` here;
            else the fast one.
    """
    chosen, found = method or FRAME_METHOD, dict[str, list[Depth]]()
    seconds: dict[str, float] = {}
    if frames >= _FEW_FRAMES:
        say("timing the methods on two frames: a few seconds")
        for name in dict.fromkeys([chosen, VIDEO_METHOD, FRAME_METHOD]):
            seconds[name], found[name] = _measure(sweep, first, name, precision)
            if seconds[name] <= min(_PACE_S, _SOON_S / frames):
                break
    if method is None:
        keeps = seconds.get(FRAME_METHOD, 0.0) <= _PACE_S
        chosen = FRAME_METHOD if keeps else VIDEO_METHOD
        say(f"method: {chosen}, {_why(keeps)}")
    for name in sorted(seconds, key=chosen.__ne__):
        words = f"about {in_words(frames * seconds[name])} by {name}"
        say(f"{frames} frames: {words}" if name == chosen else f"{words} (--method {name})")
    return chosen, found.get(chosen, [])


def live_method(sweep: SphereSweep, images: Sequence[ArrayLike]) -> str:
    """Return the method with the lowest errors if it keeps `_LIVE_S` here, else the fast one."""
    keeps = _measure(sweep, [images, images], FRAME_METHOD)[0] <= _LIVE_S
    chosen = FRAME_METHOD if keeps else VIDEO_METHOD
    say(f"method: {chosen}, {_why(keeps)} (--method chooses another)")
    return chosen


def _why(keeps: bool) -> str:
    return "the lowest errors" if keeps else f"faster than {FRAME_METHOD}, but more is doubtful"


def _measure(
    sweep: SphereSweep,
    frames: Sequence[Sequence[ArrayLike]],
    method: str,
    precision: Precision = "auto",
) -> tuple[float, list[Depth]]:
    """Return how many seconds the last of some frames takes, once tables and network are there, and
    the depth of all.
    """
    depths = []
    for images in frames:
        start = time.perf_counter()
        depths.append(sweep_depth(sweep, images, method, precision=precision))
    return time.perf_counter() - start, depths


def in_words(seconds: float) -> str:
    """Return a duration with one or two digits: "8 s", "40 s", "3 min", "2 h"."""
    if seconds < 90:
        return (
            f"{max(1, round(seconds)):.0f} s"
            if seconds < 10
            else f"{10 * round(seconds / 10):.0f} s"
        )
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.0f} h"
