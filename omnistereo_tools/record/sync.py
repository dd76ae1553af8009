"""Whether the cameras of a recording show one moment in each frame: measured from its images."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from omnistereo_learn.provenance import read_facts
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.frame import Frame, to_gray
from omnistereo_lib.geometry.rig import Rig
from omnistereo_rigs.images.late import FRAMES, LateCameras, Lateness
from omnistereo_rigs.images.moments import SECOND, in_words, median_step
from omnistereo_rigs.images.sound import heard_late
from omnistereo_tools.input.sources import Film, Recording
from omnistereo_tools.progress import say
from omnistereo_tools.record.recordings import SETTINGS

_Moment = list[NDArray[np.uint8]]  # of each camera
QUICK = 4  # frames of a first look, one frame to either side
_PX_PER_DEG = 1.0  # of a first look
_FIRST = 300  # frames of a video within which it looks: those before are decoded, too
_PLACES = 3  # where --sync looks: cameras may lose frames on the way
_SMALL = 48  # px, sides of the pictures that tell where most moves
# Scored by workshop/results/late_table.py.
_GAIN, _CLEAR = 1.2, 2.0
_ON_TIME = 1.25  # clear by as much, cameras that come out on time are: 10 cm a frame give 1.1
_FEW = 15.0  # matches a pair: with fewer, chance makes one shift clear
_CLEAR_FINE, _FEW_FINE = 1.5, 6.0  # the same between frames
_LEFT = 0.3  # of a frame, by which cameras are apart after all: more is told
_TOLD = 0.25  # of a frame: less is not told


def check_moments(
    paths: Sequence[Path], rig: Rig, late: Sequence[int]
) -> tuple[str | None, str | None]:
    """Look at a handful of frames; return which cameras are late, and why that cannot be told.

    Args:
        paths, late: Of the recording, see `Recording.open`.
    """
    with suppress(OmnistereoError):  # what cannot be read is told when its turn comes
        return _check(Recording.open(paths, late=late), rig)
    return None, None


def _check(recording: Recording, rig: Rig) -> tuple[str | None, str | None]:
    start = _places(recording, 1)
    if len(recording.sources) < 2 or not start:
        return None, None
    if is_on_time(LateCameras(*small(rig, _images(recording, rig, start[0], QUICK))).find(reach=1)):
        return None, None
    images = _images(recording, rig, start[0], FRAMES)
    if len(images) < FRAMES:
        return None, None
    if (late := _measure(rig, images)) is None:
        return None, (
            "whether a camera is late cannot be told from the images: the rig moves too little "
            "between frames (about 10 cm is needed), or the rig file is off"
        )
    return _sentence(recording, late) or None, None


def small(rig: Rig, images: Sequence[_Moment]) -> tuple[Rig, list[_Moment]]:
    """Return a rig and its images with few pixels: a first look takes a third of the time.

    On the bundled drives all 240 clips without late cameras are on time so, none of 720 others.
    """
    frames = [Frame.of(rig, moment).reduced(_PX_PER_DEG) for moment in images]
    return frames[0].rig, [list(one.images) for one in frames]


def measure_late(paths: Sequence[Path], rig: Rig, late: Sequence[int]) -> list[int]:
    """Return by how much each camera's times are late, ns, measured from the images, or, where they
    do not show it, from the sound of videos; say it.

    Args:
        paths: Of the recording, see `Recording.open`.
        late: What is stated already, ns.

    Raises:
        OmnistereoError: If it cannot be told, or is not the same all along.
    """
    recording = Recording.open(paths, late=late)
    found = list[tuple[int, Sequence[float]]]()
    for start in _places(recording, _PLACES):
        if (late_here := _measure(rig, _images(recording, rig, start, FRAMES))) is not None:
            found.append((start, late_here))
    heard = _heard(recording)
    if not found and heard:
        say("the images do not show how late the cameras are; their sound does")
        say(_sentence(recording, [own / recording.step for own in heard]) or "no camera is late")
        return heard
    if not found:
        raise OmnistereoError(
            "how late the cameras are cannot be measured: it takes four frames or more between "
            "which the rig moves by 10 cm or more, and images with texture, or videos with the "
            "same sound. Leave out --sync"
        )
    frames = np.array([one for _, one in found])
    apart = np.ptp(frames, axis=0)
    if apart.max() > 0.5:
        camera = int(apart.argmax())
        told = ", ".join(
            f"{value:.1f} at frame {start}"
            for start, value in zip((start for start, _ in found), frames[:, camera], strict=True)
        )
        raise OmnistereoError(
            f"camera {camera + 1} is not late by the same all along: {told}. It has lost frames "
            "that its time stamps do not show. Cut the recording there: --frames"
        )
    mean = frames.mean(axis=0)
    say(_sentence(recording, mean) or "no camera is late")
    left = float(np.ptp(mean - mean.round()))
    if left > _LEFT:
        say(
            f"no frames are of one moment: the nearest are {left:.1f} frames apart, and near "
            "things have wrong depth where the rig moves. Start the cameras together"
        )
    step = recording.step or _step_of_numbers(recording)
    stated = list(late) or [0] * len(mean)
    # Pictures that are only counted can be moved by whole numbers alone.
    moved = mean if recording.step else mean.round()
    measured = [round(known + step * value) for known, value in zip(stated, moved, strict=True)]
    if heard and np.ptp(np.subtract(heard, measured)) > step / 2:
        by_sound = _sentence(recording, [own / step for own in heard]) or "no camera is late"
        say(f"by their sound, {by_sound}; matched by the images")
    return measured


def _heard(recording: Recording) -> list[int] | None:
    """Return by how much each camera's times are late by the sound of videos whose clocks are their
    own, ns; None where there is no such sound.
    """
    films = [source.video for source in recording.sources if isinstance(source, Film)]
    if len(films) < len(recording.sources) or recording.shared or not recording.step:
        return None
    return heard_late(films)


def _measure(rig: Rig, images: Sequence[_Moment]) -> Sequence[float] | None:
    """Return how late each camera is, frames, in fractions where these show, too."""
    look = LateCameras(rig, images)
    whole = look.find()
    if not is_sure(whole):
        # Between two frames, neither of them fits.
        fine = look.find(fine=True)
        return fine.frames if is_sure(fine, fine=True) else None
    late = [round(value) for value in whole.frames]
    if max(late) - min(late) > len(images) - QUICK:
        return whole.frames
    fine = look.moved(late).find(reach=1, fine=True)
    is_fine = fine.clear >= _ON_TIME and max(map(abs, fine.frames)) < 1
    return [a + b for a, b in zip(late, fine.frames, strict=True)] if is_fine else whole.frames


def _step_of_numbers(recording: Recording) -> int:
    return SECOND * max(median_step(sorted(recording.frames)), 1)


def is_on_time(found: Lateness) -> bool:
    """Return whether a first look shows beyond doubt that no camera is late."""
    return not any(found.frames) and found.clear >= _CLEAR and found.matches >= _FEW


def is_sure(found: Lateness, fine: bool = False) -> bool:
    """Return whether the images show how late the cameras are, or that none is.

    Args:
        fine: Found between frames, where fewer matches are left to judge by.
    """
    if not fine and max(map(abs, found.frames)) < 0.5:
        return found.clear >= _ON_TIME and found.matches >= _FEW
    clear, few = (_CLEAR_FINE, _FEW_FINE) if fine else (_CLEAR, _FEW)
    return found.clear >= clear and found.gain >= _GAIN and found.matches >= few


def _sentence(recording: Recording, frames: Sequence[float]) -> str:
    """Return which cameras are late or early, and by how much."""
    parts = []
    for camera, value in enumerate(frames, 1):
        if abs(value) < _TOLD:
            continue
        count = f"{abs(value):.2g}"
        count = {"1": "one frame"}.get(count, f"{count} frames")
        time = f" ({in_words(abs(value) * recording.step)})" if recording.step else ""
        parts.append(f"camera {camera} is {count} {'late' if value > 0 else 'early'}{time}")
    return ", ".join(parts)


def _places(recording: Recording, count: int) -> list[int]:
    """Return frames after which most changes, each in its part of the recording."""
    numbers = sorted(recording.frames)
    if count == 1 and any(isinstance(source, Film) for source in recording.sources):
        numbers = numbers[:_FIRST]
    if len(numbers) < 3:
        return []
    found = []
    for part in np.array_split(np.arange(max(len(numbers) - QUICK, 1)), count):
        if len(part) == 0:
            continue
        tried = np.unique(part[np.linspace(0, len(part) - 1, 4).astype(int)]).tolist()
        looked_at = sorted({numbers[k + d] for k in tried for d in (0, 1)})
        first = recording.sources[0].read([recording.frames[n] for n in looked_at], None)
        small = {
            n: cv2.resize(to_gray(image), (_SMALL, _SMALL), interpolation=cv2.INTER_AREA)
            for n, image in zip(looked_at, first, strict=True)
        }
        changes = {
            numbers[k]: float(np.abs(small[numbers[k + 1]] - small[numbers[k]]).mean())
            for k in tried
        }
        found.append(max(changes, key=changes.__getitem__))
    return found


def _images(recording: Recording, rig: Rig, start: int, count: int) -> list[_Moment]:
    """Read frames in a row from `start` on, or back from the end; as many as follow evenly."""
    numbers = sorted(recording.frames)
    first = max(0, min(numbers.index(start), len(numbers) - count))
    row = numbers[first : first + count]
    step = min((b - a for a, b in pairwise(row)), default=0)
    while len(row) > 1 and row[-1] - row[0] > 1.5 * step * (len(row) - 1):
        row.pop()
    return list(recording.read(row, rig))


def stored_late(out: Path) -> list[int]:
    """Return by how much each camera of a stored recording was measured to be late, ns."""
    found = read_facts(out / SETTINGS).get("late_s")
    return [round(float(value) * SECOND) for value in found] if isinstance(found, list) else []
