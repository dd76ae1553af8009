"""Videos: when their frames were taken, by the stamps of their packets, and the frames themselves.

PyAV reads both: the sorted stamps of packets are right, but for a constant, in all containers but
MPEG program streams, without decoding; what OpenCV states of frames, times and beginnings is not.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.pictures import check_size, remark_turned
from omnistereo_rigs.images.moments import SECOND, Moments, in_words, median_step

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.stream import VideoStream

VIDEOS = (".mp4", ".avi", ".mkv", ".mov", ".webm", ".m4v", ".mpg", ".mpeg", ".ts", ".insv", ".flv")
_TIMECODE = re.compile(r"(\d+):(\d+):(\d+)([:;.])(\d+)")
_CHAPTER = re.compile(r"G([HXLP])(\d\d)(\d{4})|GOPR(\d{4})", re.IGNORECASE)  # of GoPro cameras
_DAY = 24 * 3600 * SECOND


@dataclass(frozen=True)
class Video:
    """The video of one camera: a stream of a file, or of the chapters of one recording in a row."""

    path: Path
    stream: int  #: of the video streams of each file
    stamps: tuple[int, ...]  #: of its frames, ns, rising
    size: tuple[int, int]  #: width and height, px
    rate: float  #: frames per second, on the mean
    beginnings: Mapping[str, int] = field(default_factory=dict)  #: what states one → ns
    layout: str = ""  #: what wrote it: starts of equal ones can be compared
    chapters: tuple[tuple[Path, int], ...] = ()  #: file → number of its frames
    guessed: bool = False  #: the stamps do not rise: the times are those of a constant rate
    damaged: int = 0  #: packets that the container marks as such

    def read(
        self, numbers: Sequence[int], image_size: tuple[int, int] | None = None
    ) -> Iterator[NDArray[np.uint8]]:
        """Yield some frames, numbers rising from 0, RGB (height, width, 3), as they are stored.

        Raises an `OmnistereoError` if one cannot be decoded or is not of the size of its camera.
        """
        check_size(self.path, self.size, image_size)
        wanted, first = list(numbers), 0
        for path, count in self.chapters:
            own = [number - first for number in wanted if number < first + count]
            if own:
                stamps = self.stamps[first : first + count]
                yield from _decode(path, self.stream, stamps, own, image_size)
            wanted, first = wanted[len(own) :], first + count
        if wanted:
            raise OmnistereoError(f"{self.path} has {first} frames, none of number {wanted[0]}")


def open_videos(path: Path) -> list[Video]:
    """Return the videos of a file, one per stream, each with its chapters, if it is the first one.

    Raises an `OmnistereoError` if it is none, or a chapter is missing or differs.
    """
    videos = _streams(path)
    for chapter in _chapters_after(path):
        more = _streams(chapter)
        if [one.size for one in more] != [one.size for one in videos]:
            raise OmnistereoError(
                f"{chapter} is not of the size of {path}, whose next chapter it should be by its "
                "name. Rename one of them"
            )
        videos = [_joined(one, next_one) for one, next_one in zip(videos, more, strict=True)]
    return videos


def _streams(path: Path) -> list[Video]:
    """Read the packets of a file, which are not decoded; return each video stream in it."""
    if not path.is_file():  # a pipe would wait for its other end
        raise OmnistereoError(f"{path} is not a video file. Check the path.")
    import av

    try:
        with av.open(str(path)) as container:
            streams = [s for s in container.streams.video if not _is_picture(s)]
            packets: dict[int, list[tuple[int | None, bool]]] = {s.index: [] for s in streams}
            for packet in container.demux(streams) if streams else ():
                if packet.size and not packet.is_discard:
                    stamp = packet.dts if packet.pts is None else packet.pts
                    packets[packet.stream.index].append((stamp, packet.is_corrupt))
            videos = [
                _video(path, container, k, stream, packets[stream.index])
                for k, stream in enumerate(streams)
                if packets[stream.index]
            ]
    except (av.error.FFmpegError, OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        reason = f"{path} is not a video that can be read: {why}. Convert it."
        raise OmnistereoError(reason) from None
    if not videos:
        raise OmnistereoError(f"{path} has no frames. Copy it again, or convert it.")
    return videos


def _is_picture(stream: VideoStream) -> bool:
    """Return whether a stream is a cover picture."""
    import av

    return bool(stream.disposition & av.stream.Disposition.attached_pic)


def _video(
    path: Path,
    container: InputContainer,
    number: int,
    stream: VideoStream,
    packets: Sequence[tuple[int | None, bool]],
) -> Video:
    stamps = [stamp for stamp, _ in packets]
    known = sorted(stamp for stamp in stamps if stamp is not None)
    tick = Fraction(stream.time_base or 1) * SECOND
    rate = Fraction(stream.average_rate or stream.guessed_rate or 25)
    # Program streams lack stamps, or state some twice.
    guessed = len(known) < len(stamps) or any(a == b for a, b in pairwise(known))
    times = (
        tuple(round(k * SECOND / rate) for k in range(len(stamps)))
        if guessed
        else tuple(round(stamp * tick) for stamp in known)
    )
    step = median_step(times)
    shown = float(SECOND / step) if step else float(rate)
    kind = (container.format.name, container.metadata.get("compatible_brands"))
    tools = container.metadata.get("encoder") or container.metadata.get("ENCODER")
    layout = f"{kind} {tools} {[s.type for s in container.streams]}"
    beginnings = _beginnings(container, stream, rate) | ({} if guessed else {"start": times[0]})
    size = (stream.codec_context.width, stream.codec_context.height)
    chapters, damaged = ((path, len(times)),), sum(is_damaged for _, is_damaged in packets)
    return Video(path, number, times, size, shown, beginnings, layout, chapters, guessed, damaged)


def _beginnings(container: InputContainer, stream: VideoStream, rate: Fraction) -> dict[str, int]:
    """Return when a file states that it begins, ns: by a time code, or a time with a fraction."""
    stated = [container.metadata, stream.metadata, *(s.metadata for s in container.streams)]
    found: dict[str, int] = {}
    for name, parse in (("timecode", _of_timecode), ("creation_time", _of_creation)):
        texts = [text for data in stated for key, text in data.items() if key.lower() == name]
        times = [time for text in texts if (time := parse(text, rate)) is not None]
        if times:
            found[name] = max(times, key=lambda time: time % SECOND != 0)
    return found


def _of_timecode(text: str, rate: Fraction) -> int | None:
    """Return the time of day of a time code, ns: it counts at the nominal rate, `;` skips."""
    if not (match := _TIMECODE.fullmatch(text.strip())):
        return None
    hours, minutes, seconds, frame = (int(match[k]) for k in (1, 2, 3, 5))
    nominal, minutes = round(rate), 60 * hours + minutes
    frames = (60 * minutes + seconds) * nominal + frame
    if match[4] != ":":
        frames -= round(nominal / 15) * (minutes - minutes // 10)
    return round(frames * SECOND / rate)


def _of_creation(text: str, rate: Fraction) -> int | None:
    """Return a stated time, ns since 1970."""
    try:
        moment = datetime.fromisoformat(text.strip())
    except ValueError:
        return None
    moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    since = moment - datetime(1970, 1, 1, tzinfo=UTC)
    return (since.days * 86400 + since.seconds) * SECOND + since.microseconds * 1000


def _chapters_after(path: Path) -> list[Path]:
    """Return the chapters that follow the first one of a GoPro recording, which lie beside it."""
    match = _CHAPTER.fullmatch(path.stem)
    if match is None or (match[2] not in (None, "01")) or (match[1] or "").upper() == "P":
        return []
    name = match[3] or match[4]
    found: dict[int, Path] = {}
    for other in sorted(path.parent.iterdir()):
        next_one = _CHAPTER.fullmatch(other.stem)
        same = next_one and next_one[3] == name and other.suffix.lower() == path.suffix.lower()
        if same and next_one and next_one[1].upper() == (match[1] or "P").upper():
            found[int(next_one[2])] = other
    first = 1 if match[4] else 2
    numbers = sorted(number for number in found if number >= first)
    if numbers != list(range(first, first + len(numbers))):
        lost = next(n for n in range(first, numbers[-1]) if n not in found)
        raise OmnistereoError(
            f"{found[numbers[-1]]} is a chapter of the recording of {path}, whose chapter {lost} "
            "is missing. Copy it, too, or move the later ones away"
        )
    return [found[number] for number in numbers]


def _joined(video: Video, more: Video) -> Video:
    """Return a video with its next chapter, which begins one frame after its end."""
    begin = video.stamps[-1] + (median_step(video.stamps) or round(SECOND / video.rate))
    stamps = (*video.stamps, *(begin + time - more.stamps[0] for time in more.stamps))
    chapters = (*video.chapters, (more.path, len(more.stamps)))
    return replace(
        video,
        stamps=stamps,
        chapters=chapters,
        guessed=video.guessed or more.guessed,
        damaged=video.damaged + more.damaged,
    )


def _decode(
    path: Path,
    number: int,
    stamps: Sequence[int],
    wanted: Sequence[int],
    image_size: tuple[int, int] | None,
) -> Iterator[NDArray[np.uint8]]:
    """Yield some frames of a file: the n-th that is decoded has the n-th stamp.

    Where frames tell their own stamps, what a damaged file leaves out is noticed.
    """
    import av

    left = list(wanted)
    try:
        with av.open(str(path)) as container:
            stream = [s for s in container.streams.video if not _is_picture(s)][number]
            stream.thread_type = "AUTO"
            places = {stamp: k for k, stamp in enumerate(stamps)}
            tick = Fraction(stream.time_base or 1) * SECOND
            in_order = container.format.name in ("avi", "mpeg")  # whose frames tell others
            for count, frame in enumerate(container.decode(stream)):
                place = count
                if not in_order and frame.pts is not None:
                    place = places.get(round(frame.pts * tick), count)
                if count == 0 and frame.rotation:
                    remark_turned(path, f"by {-frame.rotation % 360:.0f}°")
                if place > left[0]:
                    break
                if place == left[0]:
                    check_size(path, (frame.width, frame.height), image_size)
                    yield np.asarray(frame.to_ndarray(format="rgb24"), np.uint8)
                    left.pop(0)
                    if not left:
                        return
    except av.error.FFmpegError as error:
        why = getattr(error, "strerror", None) or error
        raise OmnistereoError(f"{path}: frame {left[0]} cannot be read: {why}") from None
    raise OmnistereoError(
        f"{path}: frame {left[0]} cannot be decoded, though {len(stamps)} are stored. Copy the "
        "file again, or leave such frames out: --skip-bad"
    )


def moments_of_videos(videos: Sequence[Video]) -> tuple[list[Moments], list[str]]:
    """Return when the frames of videos were taken, and in words what states their beginnings.

    A time code in all counts first, then a creation time with a fraction of a second in all, then
    what files of one kind state as their start. Without any, all begin at one moment.

    Raises an `OmnistereoError` if two statements contradict each other.
    """
    words = list[str]()
    if not videos:
        return [], words
    for video in videos:
        if video.guessed:
            words.append(
                f"{video.path} states no time stamps that rise: its frames are taken for even, "
                f"{video.rate:.5g} a second. What it lacks is not noticed"
            )
        if video.damaged:
            words.append(
                f"{video.path} has {video.damaged} damaged packets: frames from there to the next "
                "key frame may be of another moment. Copy it again"
            )
    step = min((s for video in videos if (s := median_step(video.stamps))), default=SECOND)
    statements = _statements(videos)
    lags = {name: _lags(times, name) for name, times in statements.items()}
    for (name, one), (other, two) in pairwise(lags.items()):
        if max(abs(a - b) for a, b in zip(one, two, strict=True)) > max(step, SECOND // 20):
            raise OmnistereoError(
                f"the videos contradict themselves: by {_WORDS[name]} "
                f"{_in_list(videos, one)}, by {_WORDS[other]} {_in_list(videos, two)}. Write "
                "them without: ffmpeg -i IN -c copy -map_metadata -1 -write_tmcd 0 OUT"
            )
    name = next(iter(lags), "")
    begun = lags.get(name, [0] * len(videos))
    if any(2 * abs(lag) > step for lag in begun):
        words.append(
            f"by {_WORDS[name]} {_in_list(videos, begun)} than {videos[0].path}: frames are "
            "matched by that"
        )
    elif created := _created_apart(videos):
        words.append(created)
    moments = [
        Moments(
            tuple(range(len(video.stamps))),
            tuple(lag + stamp - video.stamps[0] for stamp in video.stamps),
            bool(name),
        )
        for video, lag in zip(videos, begun, strict=True)
    ]
    return moments, words


_WORDS = {
    "timecode": "their time codes",
    "creation_time": "their creation times",
    "start": "the starts that their containers state",
}


def _statements(videos: Sequence[Video]) -> dict[str, list[int]]:
    """Return what states the beginning of all videos, and when, in the order of weight."""
    found: dict[str, list[int]] = {}
    for name in ("timecode", "creation_time"):
        times = [video.beginnings[name] for video in videos if name in video.beginnings]
        whole = name == "creation_time" and any(time % SECOND == 0 for time in times)
        if len(times) == len(videos) and not whole:
            found[name] = times
    starts = [video.beginnings["start"] for video in videos if "start" in video.beginnings]
    alike = len({video.layout for video in videos}) == 1 or len({v.path for v in videos}) == 1
    # Equal starts state nothing, and with sound a start is that of the sound.
    alike = alike and "audio" not in videos[0].layout
    if not found and alike and len(starts) == len(videos) and len(set(starts)) > 1:
        found["start"] = starts
    return found


def _lags(times: Sequence[int], name: str) -> list[int]:
    """Return by how much each begins after the first; a time code begins anew at midnight."""
    lags = [time - times[0] for time in times]
    if name == "timecode":
        return [(lag + _DAY // 2) % _DAY - _DAY // 2 for lag in lags]
    return lags


def _created_apart(videos: Sequence[Video]) -> str | None:
    """Return a remark on whole seconds of creation that differ: too coarse to match by."""
    created = [video.beginnings.get("creation_time") for video in videos]
    known = [time for time in created if time is not None]
    if len(known) < len(videos) or max(known) - min(known) <= 1 * SECOND:
        return None
    return (
        f"the videos were created up to {in_words(max(known) - min(known))} apart by whole "
        "seconds, which is too coarse to match by: all are taken to begin at one moment. If they "
        "do not, cut them alike"
    )


def _in_list(videos: Sequence[Video], lags: Sequence[int]) -> str:
    """Return in words which videos begin before or after the first."""
    found = [
        f"{video.path} begins {in_words(abs(lag))} {'later' if lag > 0 else 'earlier'}"
        for video, lag in zip(videos, lags, strict=True)
        if lag
    ]
    return ", ".join(found or ["all begin together"])
