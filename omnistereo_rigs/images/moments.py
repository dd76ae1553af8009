"""When each picture was taken, from its name, and which ones of several cameras belong together.

Times are integers of nanoseconds: a float is 256 ns wrong for a time since 1970.
"""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from itertools import pairwise
from statistics import median

SECOND = 10**9  # ns
_YEARS = 10**9, 42 * 10**8  # seconds since 1970 that are taken for a time: 2001 to 2103
_EVEN = 0.2  # of the median step, within which a step counts as even
_UNITS = {10: SECOND, 13: 10**6, 16: 1000, 19: 1}  # digits of a time since 1970 → ns
_DATE = (
    r"(?<!\d)((?:19|20)\d\d)[-_.]?(\d\d)[-_.]?(\d\d)(?:[-_.T ]{0,3}| at )"
    r"(\d\d)[-_.:h]?(\d\d)[-_.:m]?(\d\d)"
)
_DAY = 24 * 3600  # seconds
COPY = re.compile(r" ?\((\d+)\)$")  # what browsers and file managers append to a name that is taken


@dataclass(frozen=True)
class Moments:
    """What one camera states about its pictures, in their order."""

    numbers: tuple[int, ...]  #: what each is called
    times: tuple[int, ...] | None  #: when it was taken, ns; None: only counted
    shared: bool = True  #: whether the clock is that of the other cameras, as far as is known
    read: str = ""  #: an example of what was read, where a name has several numbers

    @property
    def step(self) -> int:
        """The usual time between two pictures, ns; 0 if that cannot be told."""
        return median_step(self.times or ())


def median_step(times: Sequence[int]) -> int:
    """Return the median difference of rising times; 0 for fewer than two."""
    return round(median(b - a for a, b in pairwise(times))) if len(times) > 1 else 0


def read_names(cameras: Sequence[Sequence[str]]) -> list[tuple[Moments, list[str]]] | None:
    """Read times or numbers from the names of pictures, by one rule for all cameras.

    A time is a date with the time of day, seconds with a fraction or with a second number of
    milliseconds, microseconds or nanoseconds, or one of these counted since 1970. Otherwise the
    last number that tells the pictures of a camera apart counts; of several, the one that cameras
    have in common.

    Args:
        cameras: The names of each camera's pictures, without ending.

    Returns:
        For each camera its moments, and its names in the same order. None if not all cameras
        have numbers that tell their pictures apart.
    """
    stamped = [_read_times(names) for names in cameras]
    found = [one for one in stamped if one]
    if len(found) < len(cameras):
        found = _read_ticks(cameras)
    if len(found) < len(cameras):
        counted = [_read_counters(names) for names in cameras]
        if not all(counted):
            return None
        found = _most_in_common(counted)
    result = []
    for one, names in zip(found, cameras, strict=True):
        order = sorted(range(len(names)), key=one.values.__getitem__)
        numbers = tuple(one.values[k] for k in order)
        times = tuple(number * one.unit for number in numbers) if one.unit else None
        moments = Moments(numbers, times, read=one.said(names))
        result.append((moments, [names[k] for k in order]))
    return result


@dataclass(frozen=True)
class _Reading:
    """One way to read the names of a camera."""

    values: list[int]
    unit: int  # ns; 0: a counter
    spans: tuple[tuple[int, int], ...]  # where in each name

    def said(self, names: Sequence[str]) -> str:
        """Return what was read of the last name if it has other numbers that vary."""
        rest = [name[:a] + "#" + name[b:] for name, (a, b) in zip(names, self.spans, strict=True)]
        numbers = [re.findall(r"\d+", one) for one in rest]
        if len({tuple(one) for one in numbers}) < 2:
            return ""
        a, b = self.spans[-1]
        kind = "the time" if self.unit else "the number"
        return f"of names such as {names[-1]} {kind} {names[-1][a:b]} is read"


def _read_times(names: Sequence[str]) -> _Reading | None:
    """Return the times in the names of a camera: the first kind that all have, each another."""
    kinds: list[tuple[str, Callable[[list[re.Match[str]]], list[int] | None]]] = [
        (_DATE + r"([-_.,: ]?)(\d{1,9})(?!\d)", _of_dates),
        (_DATE + r"(?!\d)", _of_dates),
        (r"(?<!\d)([1-4]\d{9})([._,-])(\d{1,9})(?!\d)", _of_seconds),
        (r"(?<!\d)([1-9]\d{9}(?:\d{3}){0,3})(?!\d)", _of_epochs),
        (r"(?<![\d.])(\d{1,9})(\.)(\d{1,9})(?![\d.])", _of_running_seconds),
        (r"(?<!\d)(\d{1,9})(_)(\d{9})(?!\d)", _of_running_seconds),
        (r"(?<!\d)(\d\d?)[-_.:h](\d\d)[-_.:m](\d\d)(?!\d)", _of_day),
    ]
    for pattern, read in kinds:
        found = [match for name in names if (match := re.search(pattern, name))]
        if len(found) < len(names) or (values := read(found)) is None:
            continue
        if len(set(values)) == len(names):
            spans = tuple((match.start(), match.end()) for match in found)
            # A time that one number states keeps its unit, so that frames are called as they are.
            whole = {len(match.group()) for match in found if match.group().isdecimal()}
            unit = _UNITS.get(whole.pop(), 1) if read is _of_epochs and len(whole) == 1 else 1
            return _Reading([value // unit for value in values], unit, spans)
    return None


def _of_dates(found: list[re.Match[str]]) -> list[int] | None:
    """Return the times of dates as if they were of UTC; None if one is no date."""
    seconds = []
    for match in found:
        try:
            year, month, day, hour, minute, second = map(int, match.groups()[:6])
            moment = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
        except ValueError:
            return None
        seconds.append(int(moment.timestamp()))
    if found[0].re.groups == 6:
        return [second * SECOND for second in seconds]
    return _with_fractions(seconds, [match[8] for match in found], found[0][7])


def _of_seconds(found: list[re.Match[str]]) -> list[int] | None:
    seconds = [int(match[1]) for match in found]
    if not all(_YEARS[0] <= second < _YEARS[1] for second in seconds):
        return None
    return _with_fractions(seconds, [match[3] for match in found], found[0][2])


def _of_epochs(found: list[re.Match[str]]) -> list[int] | None:
    """Return the times of integers whose digits say in which unit they count since 1970."""
    values = [int(match[1]) * _UNITS[len(match[1])] for match in found]
    return values if all(_YEARS[0] <= v // SECOND < _YEARS[1] for v in values) else None


def _of_day(found: list[re.Match[str]]) -> list[int] | None:
    """Return the times of hours, minutes and seconds, which may pass midnight.

    None if only the last number counts on: the others may tell the camera.
    """
    parts = [tuple(map(int, match.groups())) for match in found]
    if any(h > 23 or m > 59 or s > 59 for h, m, s in parts) or len({p[:2] for p in parts}) == 1:
        return None
    seconds = [3600 * h + 60 * m + s for h, m, s in parts]
    passes = max(seconds) - min(seconds) > _DAY // 2
    return [SECOND * (time + _DAY * (passes and time < _DAY // 2)) for time in seconds]


def _of_running_seconds(found: list[re.Match[str]]) -> list[int] | None:
    """Return the times of seconds from some beginning."""
    seconds = [int(match[1]) for match in found]
    return _with_fractions(seconds, [match[3] for match in found], found[0][2])


def _with_fractions(seconds: list[int], fractions: list[str], mark: str) -> list[int] | None:
    """Return times from seconds and the digits behind them; None if these are a counter.

    They are a decimal fraction, or whole milli-, micro- or nanoseconds without leading zeros.
    Where both are possible, the one counts whose steps are more even.
    """
    widths, values = set(map(len, fractions)), set(map(int, fractions))
    is_constant = mark != "." and len(values) == 1
    is_short = mark in ("_", "-") and max(widths) < 3 and len(set(seconds)) == len(seconds)
    is_counter = len(values) == len(fractions) == max(values) - min(values) + 1
    if len(fractions) > 1 and (is_constant or is_short or is_counter):
        return None
    unit = next(10 ** (9 - digits) for digits in (3, 6, 9) if max(widths) <= digits)
    decimal = [s * SECOND + int(f.ljust(9, "0")) for s, f in zip(seconds, fractions, strict=True)]
    whole = [s * SECOND + int(f) * unit for s, f in zip(seconds, fractions, strict=True)]
    if widths in ({3}, {6}, {9}):
        return whole
    first, second = (decimal, whole) if mark in (".", ",") or len(widths) == 1 else (whole, decimal)
    return second if _evenness(second) > _evenness(first) else first


def _evenness(times: Iterable[int]) -> float:
    """Return the share of steps between times that are about the median one."""
    rising = sorted(times)
    middle = median_step(rising)
    steps = [abs(b - a - middle) <= _EVEN * middle for a, b in pairwise(rising)]
    return sum(steps) / max(len(steps), 1)


def _read_ticks(cameras: Sequence[Sequence[str]]) -> list[_Reading]:
    """Return times of a clock that is not known: of ten digits or more, whose steps tell the unit.

    Of fewer cameras than there are if not all have such numbers.
    """
    readings = list[_Reading]()
    for names in cameras:
        found = [m for name in names if (m := re.search(r"(?<!\d)[1-9]\d{9,18}(?!\d)", name))]
        values = [int(match.group()) for match in found]
        if len(found) == len(names) == len(set(values)):
            readings.append(_Reading(values, 1, tuple(match.span() for match in found)))
    # A period lies between a millisecond and a second.
    step = min((s for one in readings if (s := median_step(sorted(one.values)))), default=0)
    unit = next((unit for unit in (1, 1000, 10**6) if step * unit >= 10**6), 1)
    return [replace(one, unit=unit) for one in readings]


def _read_counters(names: Sequence[str]) -> list[_Reading]:
    """Return the numbers that tell the names of a camera apart, the last one first."""
    numbers = [[*re.finditer(r"\d+", name)] for name in names]
    readings, copies = list[_Reading](), list[_Reading]()
    for place in range(1, min(map(len, numbers)) + 1):
        found = [row[-place] for row in numbers]
        values = [int(match.group()) for match in found]
        if len(set(values)) == len(values):
            marks = place == 1 and all(COPY.search(name) for name in names)
            reading = _Reading(values, 0, tuple(match.span() for match in found))
            (copies if marks else readings).append(reading)
    return readings + copies


def _most_in_common(counted: Sequence[list[_Reading]]) -> list[_Reading]:
    """Return for each camera the numbers of which most are those of the first camera, too."""

    def choose(first: _Reading) -> tuple[int, list[_Reading]]:
        known, chosen, shared = set(first.values), [first], 0
        for readings in counted[1:]:
            counts = [len(known.intersection(one.values)) for one in readings]
            chosen.append(readings[counts.index(max(counts))])
            shared += max(counts)
        return shared, chosen

    return max(map(choose, counted[0]), key=lambda one: one[0])[1]


@dataclass(frozen=True)
class Matched:
    """Which pictures of several cameras are of one moment."""

    pairs: list[dict[int, int]]  #: for each camera: number in the first camera → its own number
    spread: int = 0  #: by how much the times of one moment differ at most, ns
    step: int = 0  #: the time between pictures of the fastest camera, ns
    shared: bool = False  #: whether all state times by one clock
    #: number in the first camera → when it was taken, ns; none where they are only counted
    times: dict[int, int] = field(default_factory=dict)


def match_moments(cameras: Sequence[Moments], late: Sequence[int] = ()) -> Matched:
    """Match the pictures of cameras: by time, within half of the time between them, or by number.

    Where a clock is not shared, all begin at their first pictures.

    Args:
        cameras: What each states; by number unless all state times.
        late: By how much the times of each camera are late, ns; a number counts as a second.
    """
    late = late or [0] * len(cameras)
    if any(one.times is None for one in cameras):
        by_number = [
            {n - round(own / SECOND): n for n in one.numbers}
            for one, own in zip(cameras, late, strict=True)
        ]
        first = [n - round(late[0] / SECOND) for n in cameras[0].numbers]
        names = dict(zip(first, cameras[0].numbers, strict=True))
        return Matched([{names[n]: own[n] for n in first if n in own} for own in by_number])
    times = [_from_zero(one, own, cameras) for one, own in zip(cameras, late, strict=True)]
    step = min((one.step for one in cameras if one.step), default=0)
    near = [match_times(times[0], own, step / 2) for own in times]
    moments = [
        [own[found[k]] for own, found in zip(times, near, strict=True)]
        for k in set.intersection(*(set(found) for found in near))
    ]
    pairs = [
        {cameras[0].numbers[a]: one.numbers[b] for a, b in found.items()}
        for one, found in zip(cameras, near, strict=True)
    ]
    spread = max((max(one) - min(one) for one in moments), default=0)
    taken = dict(zip(cameras[0].numbers, cameras[0].times or (), strict=True))
    return Matched(pairs, spread, step, all(one.shared for one in cameras), taken)


def _from_zero(one: Moments, late: int, cameras: Sequence[Moments]) -> list[int]:
    """Return the times of a camera by the clock of all, or from its first picture on."""
    assert one.times is not None
    begin = 0 if all(other.shared for other in cameras) else one.times[0]
    return [time - begin - late for time in one.times]


def match_times(first: Sequence[int], other: Sequence[int], limit: float) -> dict[int, int]:
    """Return pairs of indices into two rising lists of times that are nearest to each other.

    Each has at most one partner, at most `limit` apart.
    """
    pairs: dict[int, tuple[int, int]] = {}
    for b, time in enumerate(other if first else ()):
        k = bisect_left(first, time)
        near = range(max(k - 1, 0), min(k + 1, len(first)))
        apart, a = min((abs(first[a] - time), a) for a in near)
        if apart <= limit and (a not in pairs or apart < pairs[a][0]):
            pairs[a] = apart, b
    return {a: b for a, (_, b) in sorted(pairs.items())}


def in_words(nanoseconds: float) -> str:
    """Return a duration in the unit that suits it."""
    for unit, name in ((SECOND, "s"), (10**6, "ms"), (1000, "µs")):
        if abs(nanoseconds) >= unit:
            return f"{nanoseconds / unit:.3g} {name}"
    return f"{nanoseconds:.0f} ns"
