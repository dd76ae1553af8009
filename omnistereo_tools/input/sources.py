"""Recordings: for each camera a folder of pictures or a video, matched moment by moment."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.consumer_images import split_image
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import checksum
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.pictures import check_image, check_size, find_pictures, read_image
from omnistereo_rigs.images.moments import (
    COPY,
    Matched,
    Moments,
    in_words,
    match_moments,
    read_names,
)
from omnistereo_rigs.images.videos import VIDEOS, Video, moments_of_videos, open_videos

_PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
# Quiet: what cannot be read is told by an error.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
_NOT_FRAMES = ("mask",)  # file names without suffix
_FAR = 0.1  # of the time between frames: times of one moment that differ by more are told
Key = int | str  # of a frame: its number or time, or the name of a picture


def of_recordings(paths: Sequence[Path]) -> list[Path]:
    """Return the paths that are folders or videos, not pictures."""
    return [path for path in paths if path.is_dir() or path.suffix.lower() in VIDEOS]


class Pictures:
    """The pictures of one camera in a folder; `files` calls them as the first camera's are."""

    fps: float | None = None

    def __init__(self, folder: Path, named: dict[str, Path]) -> None:
        self.path, self.named = folder, named
        marks = [COPY.sub("", name) for name in named]
        unique = len(set(marks)) == len(named)
        self.files: dict[Key, Path] = dict(
            zip(marks if unique else named, named.values(), strict=True)
        )

    def check(self, keys: Sequence[Key], image_size: tuple[int, int] | None) -> None:
        """Raise an `OmnistereoError` if a picture is damaged, or not of the size of its camera."""
        for key in keys:
            check_image(self.files[key], image_size)

    def read(
        self, keys: Sequence[Key], image_size: tuple[int, int] | None
    ) -> Iterator[NDArray[np.uint8]]:
        """Yield the pictures of some frames, of the size of the camera unless that is None."""
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


class Film:
    """The video of one camera; `files` calls its frames as those of the first camera are."""

    def __init__(self, video: Video) -> None:
        self.video, self.path, self.fps = video, video.path, video.rate
        self.files: dict[Key, int] = {number: number for number in range(len(video.stamps))}

    def check(self, keys: Sequence[Key], image_size: tuple[int, int] | None) -> None:
        """Raise an `OmnistereoError` if the frames have another size than the camera."""
        check_size(self.path, self.video.size, image_size)

    def read(
        self, keys: Sequence[Key], image_size: tuple[int, int] | None
    ) -> Iterator[NDArray[np.uint8]]:
        """Yield some frames, in ascending order; those between are decoded, too."""
        return self.video.read([self.files[key] for key in keys], image_size)

    def unreadable(self, keys: Sequence[Key], image_size: tuple[int, int] | None) -> dict[Key, str]:
        """Decode some frames, in ascending order; return those that cannot be read, and why."""
        bad, left = dict[Key, str](), list(keys)
        while left:
            try:
                for _ in self.read(list(left), image_size):
                    left.pop(0)
            except OmnistereoError as error:
                bad[left.pop(0)] = str(error)
        return bad


def open_sources(paths: Sequence[Path]) -> list[Pictures | Film]:
    """Open a folder of pictures or a video per camera, or one file with a stream for each lens.

    A folder may hold one video in place of pictures.

    Raises an `OmnistereoError` if a path is neither or holds no frames.
    """
    sources: list[Pictures | Film] = []
    for path in paths:
        if not path.is_dir():
            videos = open_videos(path)
            sources += [Film(video) for video in (videos if len(paths) == 1 else videos[:1])]
            continue
        named = find_pictures(path, _PICTURES)
        named = {name: file for name, file in named.items() if name not in _NOT_FRAMES}
        films = [] if named else sorted(f for f in path.iterdir() if f.suffix.lower() in VIDEOS)
        if films:
            sources.append(_film_of(path, films))
        elif named:
            sources.append(Pictures(path, named))
        else:
            expected = f"expected one per frame, {', '.join(_PICTURES)}"
            raise OmnistereoError(f"{path} holds no images; {expected}")
    return sources


def _film_of(folder: Path, films: Sequence[Path]) -> Film:
    """Return the one video in a folder, with its chapters."""
    video = open_videos(films[0])[0]
    if len(films) > len(video.chapters):
        names = ", ".join(film.name for film in films[:4])
        raise OmnistereoError(f"{folder} holds {len(films)} videos: {names}. Pass one of them")
    return Film(video)


def match_sources(
    sources: Sequence[Pictures | Film], late: Sequence[int] = ()
) -> tuple[Matched | None, list[str]]:
    """Find out which frames are of one moment; return that, and in words what it is based on.

    None: by the names of the pictures, which have no numbers.
    """
    pictures = [source for source in sources if isinstance(source, Pictures)]
    films = [source for source in sources if isinstance(source, Film)]
    named = read_names([list(source.named) for source in pictures])
    if named is None:
        return None, []
    filmed, said = moments_of_videos([film.video for film in films])
    if pictures and films:
        # The clock of names is none that videos state.
        filmed = [replace(one, shared=False) for one in filmed]
    of_pictures = dict(zip(pictures, named, strict=True))
    of_films = dict(zip(films, filmed, strict=True))
    moments: list[Moments] = []
    for source in sources:
        if isinstance(source, Film):
            moments.append(of_films[source])
            continue
        one, names = of_pictures[source]
        moments.append(one)
        source.files = {n: source.named[name] for n, name in zip(one.numbers, names, strict=True)}
        said += [f"{source.path}: {one.read}"] * bool(one.read)
    matched = match_moments(moments, late)
    if matched.spread > _FAR * matched.step:
        warnings.warn(
            f"the time stamps of a frame differ by up to {in_words(matched.spread)}; frames are "
            f"{in_words(matched.step)} apart",
            stacklevel=4,
        )
    return matched, said


@dataclass(frozen=True, eq=False)
class Recording:
    """The frames that all cameras have, in order."""

    sources: tuple[Pictures | Film, ...]
    frames: dict[int, Key]  #: number of a frame → its name in the sources
    missing: dict[Path, list[Key]]  #: source → frames that others have and it does not
    checksum: str  #: of the paths of the sources and of the names that all frames have in them
    paths: tuple[Path, ...] = ()  #: as they were given
    said: tuple[str, ...] = ()  #: by what the frames were matched, where that is not plain
    step: int = 0  #: the time between two frames, ns; 0 where they are only counted
    late: tuple[int, ...] = ()  #: by how much the times of each camera are late, ns
    shared: bool = False  #: whether all cameras state times by one clock
    times: dict[int, int] = field(default_factory=dict)  #: of frames, ns, of the first camera

    @classmethod
    def open(
        cls,
        paths: Sequence[Path],
        start: int = 0,
        stop: int | None = None,
        step: int = 1,
        late: Sequence[int] = (),
    ) -> Recording:
        """Match the frames of folders and videos by the moments that they state.

        See `read_names` and `moments_of_videos`; pictures without numbers are matched by name.

        Args:
            paths: One folder or video per camera, in the order of the rig.
            start, stop, step: Frame numbers from `start` up to, without, `stop`; of these every
                `step`-th. Frames that are matched by name are counted from 0.
            late: By how much the times of each camera are late, ns; a number counts as a second.

        Raises:
            OmnistereoError: If a path is neither, holds no frames, the cameras have none in common,
                or no frame is left.
        """
        sources = open_sources(paths)
        late = tuple(late) if len(late) == len(sources) else ()
        matched, said = match_sources(sources, late)
        missing = _missing_names(sources) if matched is None else _use_numbers(sources, matched)
        common = [key for key in sources[0].files if all(key in s.files for s in sources)]
        if not common:
            raise _nothing_in_common(sources)
        by_number = matched is not None
        frames = {
            key if by_number and isinstance(key, int) else k: key for k, key in enumerate(common)
        }
        chosen = [n for n in frames if n >= start and (stop is None or n < stop)][::step]
        if not chosen:
            found = f"{min(frames)} … {max(frames)}"
            raise OmnistereoError(f"no frame is left of {found}. Change --frames")
        # A recording by number may grow, and its frames keep their numbers.
        named = {} if by_number else frames
        content = json.dumps([[str(source.path.resolve()) for source in sources], named])
        chosen_frames = {number: frames[number] for number in chosen}
        identity = checksum(content.encode())[:16]
        apart = matched.step if matched else 0
        shared = matched is not None and matched.shared
        times = {n: matched.times[n] for n in chosen} if matched and matched.times else {}
        matching = tuple(said), apart, late, shared, times
        return cls(tuple(sources), chosen_frames, missing, identity, tuple(paths), *matching)

    @property
    def fps(self) -> float | None:
        """Frames per second of the first video, if there is one."""
        return next((source.fps for source in self.sources if source.fps), None)

    def check(self, numbers: Sequence[int], rig: Rig) -> None:
        """Raise an `OmnistereoError` if frames cannot be read, as far as is seen undecoded."""
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


def _missing_names(sources: Sequence[Pictures | Film]) -> dict[Path, list[Key]]:
    """Sort the first source, all of whose names count; return which names a source lacks."""
    first = sources[0]
    if isinstance(first, Pictures):
        first.files = dict(sorted(first.files.items(), key=lambda item: str(item[0])))
    every: list[Key] = sorted({str(key) for source in sources for key in source.files})
    lost = {s.path: [key for key in every if key not in s.files] for s in sources}
    return {path: keys for path, keys in lost.items() if keys}


def _use_numbers(sources: Sequence[Pictures | Film], matched: Matched) -> dict[Path, list[Key]]:
    """Call the frames of all sources as those of the first; return which a source lacks."""
    every, missing, of_others = list(sources[0].files), dict[Path, list[Key]](), list[Key]()
    for source, pairs in zip(sources, matched.pairs, strict=True):
        known = set(pairs.values())
        of_others = max(of_others, [key for key in source.files if key not in known], key=len)
        files: Any = {number: source.files[own] for number, own in pairs.items()}
        source.files = files
        if gone := [key for key in every if key not in files]:
            missing[source.path] = gone
    return ({sources[0].path: of_others} if of_others else {}) | missing


def _nothing_in_common(sources: Sequence[Pictures | Film]) -> OmnistereoError:
    """Return an error that says what each source has."""
    found = []
    for source in sources:
        names = list(source.named) if isinstance(source, Pictures) else []
        some = f" ({names[0]} … {names[-1]})" if names else ""
        found.append(f"{source.path}{some}")
    return OmnistereoError(
        f"{' and '.join(found)} have no frame in common; expected equal numbers, equal names, or "
        "times within half of the time between frames. Rename the files, or check the clocks."
    )
