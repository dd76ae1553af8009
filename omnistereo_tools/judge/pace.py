"""How long a command takes, said before it begins."""

import time
from collections.abc import Sequence
from contextlib import nullcontext, suppress
from math import inf, prod

import torch
from numpy.typing import ArrayLike

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.frame import Frame
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.correlation import pixels_per_degree, volume_sizes
from omnistereo_lib.stereo.depth import Depth
from omnistereo_lib.stereo.device import bytes_of_ray, select_device
from omnistereo_lib.stereo.learned import Precision, choose_precision
from omnistereo_lib.stereo.methods import FRAME_METHOD, VIDEO_METHOD, Method
from omnistereo_lib.stereo.pipeline import sweep_depth
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_tools.progress import say

_Frames = Sequence[Sequence[ArrayLike]]  # images of each
# Seconds for each cell of the cost volume, rays × spheres, of a first frame with four cameras on
# two cores.
_SECONDS = {"zncc": 2.3e-7, "mccnn": 1e-5, "sweepnet": 3e-5, "volumenet": 7e-8}
_WRITING_S, _CORES = 4.0, 2
# Peak memory of `depth`, measured on two cores with glibc: GiB of libraries, with the network; and
# bytes for each pixel of the images, in colour, in gray, with masks, normalised.
_MEMORY = {"volumenet": (0.46, 16), "zncc+sgm": (0.43, 20)}
# Bytes for each pixel at the resolution that VolumeNet sees, 32 features of a quarter of them,
# twice; and for each cell of its finer volume: nine correlations, and the levels of the U-net.
_SEEN, _CELL = 64, {"bfloat16": 60, "float32": 170}
_FEW_FRAMES, _SOON_S = 10, 60.0  # are soon done: no other method is timed
_LIVE_S = 1 / 1.5  # of a frame that is watched
_PACE_S = 2.0  # of a frame; the public drives have 1000 frames, half an hour


def say_frame(method: str, frame: Frame, grid: SphereGrid, device: str) -> None:
    """Say how long a frame will take on the processor, and how much memory.

    On another device, and by a method that was not measured, say only by which method; the memory
    of those that are not in `_MEMORY` is not said.
    """
    seconds = _SECONDS.get(Method.parse(method).cost)
    kind = select_device(device).type if device == "auto" else device
    if seconds is None or kind != "cpu":
        say(f"method: {method} on {kind}")
        return
    cells = grid.width * grid.height * grid.num_spheres
    total = _WRITING_S + cells * seconds * _CORES / torch.get_num_threads()
    precision = f" in {choose_precision('auto', kind)}" if Method.parse(method).has_weights else ""
    base = Method.parse(method).base
    memory = f" and {_peak(base, frame, grid):.2f} GiB" if base in _MEMORY else ""
    say(f"{method} takes about {in_words(total)}{memory}{precision}")


def _peak(method: str, frame: Frame, grid: SphereGrid) -> float:
    """Return the peak memory of `depth` in GiB: what is held while the costs are computed, or while
    all is written, whichever is more.
    """
    libraries, of_pixel = _MEMORY[method]
    cameras, rays = frame.rig.cameras, grid.width * grid.height
    writing = rays * bytes_of_ray(len(cameras), grid, volume=False)
    if method == "volumenet":
        size = volume_sizes(grid, frame.rig)[-1]
        seen = frame.reduced(pixels_per_degree(size)).rig.cameras
        matching = _SEEN * _pixels(seen) + _CELL[choose_precision("auto", "cpu")] * prod(size)
    else:
        matching = rays * bytes_of_ray(len(cameras), grid, volume=True)
    return libraries + (of_pixel * _pixels(cameras) + max(matching, writing)) / 2**30


def _pixels(cameras: Sequence[OcamCamera]) -> int:
    return sum(prod(camera.image_size) for camera in cameras)


def say_recording(
    sweep: SphereSweep, first: _Frames, frames: int, method: str | None, precision: Precision
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
            # Another method may need more memory than there is, and is not proposed then.
            with suppress(OmnistereoError) if name != chosen else nullcontext():
                seconds[name], found[name] = _measure(sweep, first, name, precision)
            if seconds.get(name, inf) <= min(_PACE_S, _SOON_S / frames):
                break
    if method is None:
        keeps = VIDEO_METHOD not in seconds or seconds[FRAME_METHOD] <= _PACE_S
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
    sweep: SphereSweep, frames: _Frames, method: str, precision: Precision = "auto"
) -> tuple[float, list[Depth]]:
    """Return the seconds of the last frame, once tables and network are there; the depth of all."""
    depths = []
    for images in frames:
        start = time.perf_counter()
        depths.append(sweep_depth(sweep, images, method, precision=precision))
    return time.perf_counter() - start, depths


def in_words(seconds: float) -> str:
    """Return a duration with one or two digits: "8 s", "40 s", "3 min", "2 h"."""
    if seconds < 90:
        rounded = max(1, round(seconds)) if seconds < 10 else 10 * round(seconds / 10)
        return f"{rounded:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.0f} h"
