"""Recordings: for each camera a folder of pictures or a video, matched frame by frame."""

from __future__ import annotations

import json
import os
import re
import warnings
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.consumer_images import split_image
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import checksum
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.pictures import (
    check_image,
    check_size,
    find_pictures,
    read_image,
    remark_turned,
)

_PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
_VIDEOS = (".mp4", ".avi", ".mkv", ".mov", ".webm", ".m4v", ".mpg", ".mpeg", ".ts", ".insv")
# Quiet: what cannot be read is told by an error.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
_NOT_FRAMES = ("mask",)  # file names without suffix
_FIRST_TIME = 10**9  # smallest number that is a time stamp: seconds since 1970, or ms, µs or ns
Key = int | str  # of a frame: a number, or the name of a picture
Time = TypeVar("Time", int, float)


def of_recordings(paths: Sequence[Path]) -> list[Path]:
    """Return the paths that are folders or videos, not pictures."""
    return [path for path in paths if path.is_dir() or path.suffix.lower() in _VIDEOS]


def _number(name: str) -> int | None:
    """Return the number at the end of a name, of decimal seconds since 1970 their nanoseconds; None
    without one.
    """
    if seconds := re.search(r"(?<![0-9])([1-9][0-9]{9})\.([0-9]{1,9})$", name):
        return int(seconds[1] + seconds[2].ljust(9, "0"))
    number = re.search(r"[0-9]+$", name)
    return int(number[0]) if number else None


class Pictures:
    """The pictures of one camera in a folder, by frame: the number at the end of their names, else
    the name.
    """

    fps: float | None = None

    def __init__(self, folder: Path) -> None:
        self.path = folder
        named = {
            name: path
            for name, path in find_pictures(folder, _PICTURES).items()
            if name not in _NOT_FRAMES
        }
        if not named:
            raise OmnistereoError(
                f"{folder} holds no pictures; expected one per frame, {', '.join(_PICTURES)}"
            )
        self.files: dict[Key, Path] = dict(named.items())
        self._numbers = {
            number: named[name] for name in named if (number := _number(name)) is not None
        }
        self.numbered = len(self._numbers) == len(named)

    def use_numbers(self) -> None:
        """Call the frames by the numbers at the end of their names."""
        self.files = dict(sorted(self._numbers.items()))

    def check(self, keys: Sequence[Key], image_size: tuple[int, int] | None) -> None:
        """Raise an `OmnistereoError` if a picture is not of the size of the camera, or damaged
        where it shows.
        """
        for key in keys:
            check_image(self.files[key], image_size)

    def read(
        self, keys: Sequence[Key], image_size: tuple[int, int] | None
    ) -> Iterator[NDArray[np.uint8]]:
        """Yield the pictures of some frames; width and height must be those of the camera, unless
        they are None.
        """
        for key in keys:
            yield read_image(self.files[key], image_size)

    def unreadable(self, keys: Sequence[Key], image_size: tuple[int, int] | None) -> dict[Key, str]:
        """Decode some frames; return those that cannot be read, and why."""
        bad = {}
        for key in keys:
            try:
                read_image(self.files[key], image_size)
            except OmnistereoError as error:
                bad[key] = str(error)
        return bad


def open_video(path: Path, image_size: tuple[int, int] | None = None) -> cv2.VideoCapture:
    """Open a video file whose frames are given as they are stored, whatever rotation it states for
    players.

    Raises an `OmnistereoError` if it is none, or not of the size (width, height) of its camera.
    """
    # a pipe would wait for its other end
    video = cv2.VideoCapture(str(path)) if path.is_file() else None
    if video is None or not video.isOpened():
        raise OmnistereoError(
            f"{path} is not a video that OpenCV can read. Check the path, or convert it."
        )
    video.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    if turned := video.get(cv2.CAP_PROP_ORIENTATION_META):
        remark_turned(path, f"by {turned:.0f}°")
    found = int(video.get(cv2.CAP_PROP_FRAME_WIDTH)), int(video.get(cv2.CAP_PROP_FRAME_HEIGHT))
    check_size(path, found, image_size)
    return video


class Video:
    """A video of one camera; its frames are counted from 0, or called by those of another one, see
    `_match_videos`.
    """

    numbered = True

    def __init__(self, path: Path) -> None:
        self.path = path
        video = open_video(path)
        self.fps = video.get(cv2.CAP_PROP_FPS) or None
        stated, most = video.get(cv2.CAP_PROP_FRAME_COUNT), path.stat().st_size
        if not 0 < stated <= most:
            found = (
                f"{path} has no frames that OpenCV can read (it states {stated:.0f} in {most}"
                " bytes)"
            )
            raise OmnistereoError(f"{found}. Convert it, such as with ffmpeg.")
        self.files: dict[Key, int] = {number: number for number in range(int(stated))}

    def use_numbers(self) -> None:
        """Call the frames by their numbers, as they are."""

    def times(self) -> list[float]:
        """Read the time stamps of all frames, milliseconds from the first; raises an
        `OmnistereoError` without any.
        """
        video, times = open_video(self.path), list[float]()
        while video.grab():
            times.append(video.get(cv2.CAP_PROP_POS_MSEC))
        if any(b <= a for a, b in pairwise(times)):
            raise OmnistereoError(
                f"{self.path} has another frame rate than the other videos, and no time stamps by"
                " which its frames could be matched. Convert all to one rate, such as with ffmpeg"
                " -vf fps"
            )
        return [time - times[0] for time in times]

    def check(self, keys: Sequence[Key], image_size: tuple[int, int] | None) -> None:
        """Raise an `OmnistereoError` if the frames are not of the size of the camera; how many
        there are is stated.
        """
        open_video(self.path, image_size)

    def read(
        self, keys: Sequence[Key], image_size: tuple[int, int] | None
    ) -> Iterator[NDArray[np.uint8]]:
        """Yield some frames, in ascending order; those between are skipped, because seeking is not
        exact.
        """
        video, position = open_video(self.path, image_size), 0
        for key in keys:
            frame = self.files.get(key, len(self.files))
            while position < frame and video.grab():
                position += 1
            read, picture = video.read()
            if not read or position < frame:
                raise OmnistereoError(
                    f"{self.path} ends before frame {key}. Pass --stop {key}, or copy it again."
                )
            position += 1
            yield np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), np.uint8)

    def unreadable(self, keys: Sequence[Key], image_size: tuple[int, int] | None) -> dict[Key, str]:
        """Decode some frames, in ascending order; return those after its end, which may be earlier
        than stated.
        """
        count = 0
        try:
            for _ in self.read(keys, image_size):
                count += 1
        except OmnistereoError as error:
            return dict.fromkeys(keys[count:], str(error))
        return {}


def _match_times(times: Sequence[Sequence[Time]]) -> tuple[list[dict[Time, Time]], float, float]:
    """Pair each frame of a camera with that of the first which is nearest in time, and the reverse.

    Returns for each camera time → time in the first, where they differ by at most half of the time
    between frames; the largest difference; and the time between frames.
    """
    between = min(
        (median(b - a for a, b in pairwise(camera)) for camera in times if len(camera) > 1),
        default=0,
    )
    matched, most = [], 0.0
    for camera in times:
        near: list[tuple[float, Time, Time]] = []
        for time in camera:
            k = bisect_left(times[0], time)
            near.append(
                min((abs(other - time), time, other) for other in times[0][max(k - 1, 0) : k + 1])
            )
        # A frame of the first camera that is nearest to several goes to the nearest of them, the
        # last one here.
        of_first: dict[Time, tuple[float, Time]] = {
            other: (apart, time)
            for apart, time, other in sorted(near, reverse=True)
            if 2 * apart <= between
        }
        matched.append({time: other for other, (_, time) in of_first.items()})
        most = max([most, *(apart for apart, _ in of_first.values())])
    return matched, most, between


def _match_names(sources: Sequence[Pictures]) -> None:
    """Call frames whose names are time stamps by those of the first camera that are nearest."""
    times = [[key for key in source.files if isinstance(key, int)] for source in sources]
    if min(map(min, times)) < _FIRST_TIME:
        return
    matched, most, between = _match_times(times)
    if most:
        warnings.warn(
            f"the time stamps of a frame differ by up to {most:.0f}; frames are {between:.0f}"
            " apart",
            stacklevel=3,
        )
    for source, name, own in zip(sources, matched, times, strict=True):
        source.files = {name.get(time, time): source.files[time] for time in own}


def _match_videos(videos: Sequence[Video]) -> None:
    """Call the frames of videos whose rates differ by those of the first video that are nearest in
    time.

    Time is counted from the beginning of each. Warns by how much frames of one number would be
    apart at the end.
    """
    rates = [video.fps for video in videos if video.fps]
    last = min(len(video.files) for video in videos)
    drift = last / min(rates, default=1) - last / max(rates, default=1)
    if len(rates) < len(videos) or 2 * drift * max(rates) <= 1:
        return
    print(f"reading the times of {sum(len(video.files) for video in videos)} frames", flush=True)
    numbers = [{time: number for number, time in enumerate(video.times())} for video in videos]
    matched, most, between = _match_times([list(times) for times in numbers])
    found = ", ".join(
        f"{video.path} has {len(video.files)} frames, {video.fps:.5g} a second" for video in videos
    )
    warnings.warn(
        f"{found}: frames of one number would be up to {drift:.2g} s apart. They are matched by"
        f" time instead, to {most:.0f} ms; frames are {between:.0f} ms apart. All videos must begin"
        " at one moment",
        stacklevel=3,
    )
    for video, own, pairs in zip(videos, numbers, matched, strict=True):
        video.files = {numbers[0][other]: own[time] for time, other in pairs.items()}


@dataclass(frozen=True, eq=False)
class Recording:
    """The frames that all cameras have, in order."""

    sources: tuple[Pictures | Video, ...]
    frames: dict[int, Key]  #: number of a frame → its name in the sources
    missing: dict[Path, list[Key]]  #: source → frames that others have and it does not
    #: of the paths of the sources and of the names that all frames have in them, chosen or not
    checksum: str

    @classmethod
    def open(
        cls, paths: Sequence[Path], start: int = 0, stop: int | None = None, step: int = 1
    ) -> Recording:
        """Match the frames of folders and videos: by number where every name ends in one, else by
        name.

        Numbers that are time stamps are matched by nearest time, within half of the time between
        frames, and so are videos whose rates differ.

        Args:
            paths: One folder or video per camera, in the order of the rig.
            start, stop, step: Frame numbers from `start` up to, without, `stop`; of these every
                `step`-th. Frames that are matched by name are counted from 0.

        Raises:
            OmnistereoError: If a path is neither, holds no frames, the cameras have none in common,
                or no frame is left.
        """
        sources = tuple(Pictures(path) if path.is_dir() else Video(path) for path in paths)
        pictures = [source for source in sources if isinstance(source, Pictures)]
        videos = [source for source in sources if isinstance(source, Video)]
        by_number = all(source.numbered for source in sources)
        if by_number:
            for source in sources:
                source.use_numbers()
            if not videos:
                _match_names(pictures)
            if not pictures:
                _match_videos(videos)
        every = sorted(
            set[Key]().union(*(source.files for source in sources)),
            key=lambda key: (isinstance(key, str), key),
        )
        missing = {
            s.path: gone for s in sources if (gone := [key for key in every if key not in s.files])
        }
        common = [key for key in every if all(key in source.files for source in sources)]
        if not common:
            raise OmnistereoError(
                f"{' and '.join(str(source.path) for source in sources)} have no frame in common;"
                " expected equal numbers at the end of the names, or equal names. Rename the"
                " files."
            )
        frames = {
            key if by_number and isinstance(key, int) else k: key for k, key in enumerate(common)
        }
        chosen = [n for n in frames if n >= start and (stop is None or n < stop)][::step]
        if not chosen:
            raise OmnistereoError(
                f"no frame is left of {min(frames)} … {max(frames)}. Change --start or --stop"
            )
        # a recording by number may grow, and its frames keep their numbers
        named = {} if by_number else frames
        content = json.dumps([[str(source.path.resolve()) for source in sources], named])
        return cls(
            sources,
            {number: frames[number] for number in chosen},
            missing,
            checksum(content.encode())[:16],
        )

    @property
    def fps(self) -> float | None:
        """Frames per second of the first video, if there is one."""
        return next((source.fps for source in self.sources if source.fps), None)

    def check(self, numbers: Sequence[int], rig: Rig) -> None:
        """Raise an `OmnistereoError` if some frames cannot be read, as far as can be seen without
        decoding them.
        """
        for source, size in zip(self.sources, self._sizes(rig), strict=True):
            source.check([self.frames[number] for number in numbers], size)

    def unreadable(self, rig: Rig) -> dict[int, str]:
        """Decode every frame; return the numbers of those that cannot be read, and why."""
        keys, bad = list(self.frames.values()), dict[Key, str]()
        for source, size in zip(self.sources, self._sizes(rig), strict=True):
            bad |= source.unreadable(keys, size)
        return {number: bad[key] for number, key in self.frames.items() if key in bad}

    def _sizes(self, rig: Rig) -> Sequence[tuple[int, int] | None]:
        return [None] if len(self.sources) == 1 else rig.image_sizes(len(self.sources))

    def read(self, numbers: Sequence[int], rig: Rig) -> Iterator[list[NDArray[np.uint8]]]:
        """Yield the images of all cameras of a rig for some frames, in ascending order.

        A single source holds all cameras in each of its pictures, see `split_image`.
        """
        keys = [self.frames[number] for number in numbers]
        if len(self.sources) == 1:
            for image in self.sources[0].read(keys, None):
                yield split_image(image, rig, self.sources[0].path)
            return
        read = (
            source.read(keys, size)
            for source, size in zip(self.sources, self._sizes(rig), strict=True)
        )
        for images in zip(*read, strict=True):
            yield list(images)
