"""A rig looked at while its depth is computed: see `omnistereo_rigs.images.watch`.

OUT/
  watch.json                        the rig as each look has it, to go on with
  watch.png                         by how much each camera has turned
  rig_00410.yaml                    the rig from a frame on, of which a warning spoke
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import read_data, write_text
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.lazy import lazy_property
from omnistereo_lib.rig_file import save_rig
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_tools.outputs import save_figure
from omnistereo_tools.progress import say

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from omnistereo_rigs.images.watch import Look, Watch

_Frames = Sequence[tuple[int, Sequence[NDArray[np.uint8]]]]  # number and images of each
WATCH = "watch.json"
_FRAMES = 2  # of a look
_SHARE = 0.05  # of the time
_FIRST_S = 20.0  # until the first look begins, whose frames are half of that apart


class Watching:
    """Looks at a rig in a thread of its own, for a twentieth of the time, and says if a camera has
    turned.

    Args:
        sweep: Of the rig.
        follow: Compute depth with the turned camera's new pose from then on.
        folder: Where looks are kept, so that a recording can go on; None: nowhere.
    """

    def __init__(
        self, rig: Rig, sweep: SphereSweep, follow: bool = False, folder: Path | None = None
    ) -> None:
        self.rig, self.follow, self.folder = rig, follow, folder
        self._sweeps = [(0, sweep)]  # each from a frame on, in order
        self._looking: Future[Look | None] | None = None
        self._frames: list[tuple[int, Sequence[NDArray[np.uint8]]]] = []
        self._rest_s, self._next = _FIRST_S, time.monotonic()
        if folder is not None and (folder / WATCH).exists():
            for look in _stored(folder / WATCH, len(rig)):
                if self.watch.add(look) is not None:
                    self._turn_sweep(look.frame)

    @lazy_property
    def watch(self) -> Watch:
        """What the looks have shown so far."""
        # SciPy, which a short recording does not need
        from omnistereo_rigs.images.watch import Watch

        return Watch(self.rig)

    def sweep_of(self, frame: int, images: Sequence[NDArray[np.uint8]]) -> SphereSweep:
        """Take a frame, and return the sweep that its depth is to be computed with."""
        if self._looking is not None and self._looking.done():
            self._say(self._looking.result())
        if self._looking is None and time.monotonic() >= self._next:
            self._frames.append((frame, images))
            self._next = time.monotonic() + self._rest_s / _FRAMES
        if len(self._frames) == _FRAMES:
            self._looking = Future()
            # A daemon: who leaves does not wait for it.
            Thread(target=self._fill, args=(self._looking, self._frames), daemon=True).start()
            self._frames = []
        return self.sweep_at(frame)

    def sweep_at(self, frame: int) -> SphereSweep:
        """Return the sweep of the rig as it was in a frame, as far as looks have shown by now."""
        return next(sweep for first, sweep in reversed(self._sweeps) if frame >= first)

    def close(self, wait: bool = True) -> None:
        """Wait for the last look, unless told not to, and draw all."""
        if self._looking is not None and (wait or self._looking.done()):
            self._say(self._looking.result())
        if self.folder is not None and (self.folder / WATCH).exists() and self.watch.can_compare:
            save_figure(self.folder / "watch.png", _figure(self.watch))

    def _fill(self, looking: Future[Look | None], frames: _Frames) -> None:
        """Look at frames, and keep what comes of it in a future."""
        try:
            looking.set_result(self._look(frames))
        except BaseException as error:
            looking.set_exception(error)

    def _look(self, frames: Sequence[tuple[int, Sequence[NDArray[np.uint8]]]]) -> Look | None:
        from omnistereo_rigs.images.watch import look_at

        start = time.monotonic()
        look = look_at(self.rig, frames[0][0], [images for _, images in frames])
        self._rest_s = (time.monotonic() - start) / _SHARE
        return look

    def _say(self, look: Look | None) -> None:
        """Add a look, keep it, and print the warning if there is one."""
        self._looking, self._next = None, time.monotonic() + self._rest_s / _FRAMES
        if look is None:
            return
        warning = self.watch.add(look)
        if self.folder is not None:
            _store(self.folder / WATCH, self.watch.looks)
        if warning is None:
            return
        say(warning)
        if self.folder is not None:
            path = self.folder / f"rig_{look.frame:05}.yaml"
            save_rig(self.watch.rig_now(), path)
            say(f"written to {path}: the rig with that camera turned")
        self._turn_sweep(look.frame)

    def _turn_sweep(self, frame: int) -> None:
        """Follow the camera that a look has found turned, from the frame of that look on."""
        if self.follow:
            last = self._sweeps[-1][1]
            self._sweeps.append((frame, last.with_poses(self.watch.rig_now().T_rig_cam)))


def _store(path: Path, looks: Sequence[Look]) -> None:
    rows = [[one.frame, one.differences.tolist(), one.covariance.tolist()] for one in looks]
    write_text(path, json.dumps(rows) + "\n")


def _stored(path: Path, cameras: int) -> list[Look]:
    """Return the looks of an earlier run, as far as they can be read."""
    from omnistereo_rigs.images.watch import Look

    looks = []
    with suppress(OmnistereoError, TypeError, ValueError, OverflowError):
        for frame, *arrays in read_data(path):
            differences, covariance = (np.array(values, float) for values in arrays)
            shapes = (cameras, 6), (6 * cameras, 6 * cameras)
            finite = np.isfinite(differences).all() and np.isfinite(covariance).all()
            spread = min(covariance.diagonal()) if covariance.ndim == 2 else 0
            if (differences.shape, covariance.shape) == shapes and finite and spread > 0:
                looks.append(Look(int(frame), differences, covariance))
    return looks


def _figure(watch: Watch) -> Figure:
    """Return a figure of each camera's turn against the first looks, with its deviation."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4), layout="constrained")
    axes = figure.subplots()
    frames = [look.frame for look in watch.looks]
    turns = np.array([watch.turns(look) for look in watch.looks])  # (looks, cameras, 2)
    for camera in range(len(watch.rig)):
        (angle, deviation), name = turns[:, camera].T, f"camera {camera + 1}"
        color = f"C{camera}"
        axes.errorbar(frames, angle, deviation, marker=".", capsize=2, color=color, label=name)
    axes.set(xlabel="frame", ylabel="turn in degrees, ± one standard deviation", ylim=(0, None))
    axes.set_title("How each camera has turned against the recording's first looks")
    axes.legend()
    return figure
