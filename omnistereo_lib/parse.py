"""Values of files: what is missing, misspelt or not a number is an error that names the key."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError, check_number, error_context, shortened
from omnistereo_lib.files import read_text
from omnistereo_lib.geometry.camera import MAX_SIDE
from omnistereo_lib.geometry.pose import Floats, Pose, nearest_rotation

METRES_PER_UNIT = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
# A lens as narrow as this sees no depth around a rig; less is radians or a tangent.
MIN_FOV_DEG = 10.0
# Poses that a file states twice; rounding is less, another calibration is more.
_SAME_M, SAME_DEG = 2e-3, 0.2
# Each camera is fitted: 64 different lenses take 1.5 s.
MAX_CAMERAS = 64
# Of a rotation printed with three decimals; with four it is 0.002° from the nearest.
_ROUNDED = 1e-3
# Of a rotation printed with five decimals; `Pose` corrects it.
_EXACT = 1e-5
# In letters: shorter keys, such as K and P, are one edit from each other.
_SHORT = 4
# So many keys are named in a message.
_SHOWN = 8
# Keys without a meaning here, in lower case without "_", "-" and a number behind, by the reason.
_IRRELEVANT = {
    "names, dates and places of data": "name label id camid camname cameraname cameraid index "
    "serial serialnumber vendor brand camerabrand lensmodel date time calibrationtime "
    "calibrationdate stamp timestamp note notes comment author version header frameid rostopic "
    "topic imgdir dataset lutfmt imgfmt typeid nbcamera numcameras metadata port token "
    "description calibrated",
    "how well and from what it was calibrated": "rms rmserror rmse error avgreprojectionerror "
    "reprojectionerror nframes perviewreprojectionerrors nrofframes boardwidth boardheight "
    "squaresize aspectratio fixaspectratio flags flagvalue extrinsicparameters imagepoints "
    "gridpoints gridcount rotationcount adjusted",
    "rectification, which follows": "rectificationmatrix projectionmatrix validpixroi",
    "time and inertial sensors": "camoverlaps timeshiftcamimu camtimeoffsetns ratehz sensortype "
    "fps calibaccelbias calibgyrobias imuupdaterate accelnoisestd gyronoisestd accelbiasstd "
    "gyrobiasstd timimumarker timumarker tmocapworld mocaptimeoffsetns mocaptoimuoffsetns",
    "brightness and noise": "vignette gamma exposure exposuregain readnoise shotnoise falloff "
    "fitresidualpx",
}
# Projections, and matrices of two views; p1 and f are others.
_RECTIFIED = re.compile("[PQEF][0-9]?")
_WITHOUT_MEANING = frozenset(" ".join(_IRRELEVANT.values()).split())
# What lens models have: a camera that states one that is not read has another lens.
_OF_A_LENS = re.compile(
    "alpha|beta|xi|omega|lambda|epsilon|chi|[kps][0-9]|(linear_?)[cde]|gamma[12]|"
    "(radial|tangential)_?(distortion|coef\\w*)|thin_?prism\\w*|(lens_?)?dist\\w*|coef\\w*|skew",
    re.IGNORECASE,
)


class Section:
    """A mapping of a file that knows which of its keys were asked for: none is lost unsaid.

    A place is a key, or keys of inner mappings joined by dots; alternatives of the last one are
    separated by "|".
    """

    def __init__(
        self, values: Any, name: str = "", notes: dict[str, list[str]] | None = None
    ) -> None:
        if not isinstance(values, Mapping):
            raise OmnistereoError(f"found {shortened(values)}; expected keys with values")
        self.values = {str(key): value for key, value in values.items()}
        self.name = name
        self.notes = {} if notes is None else notes  #: text → sections; of the whole file
        self._asked: dict[str, None] = {}  # in the order of asking
        self._inner: dict[str, Section] = {}

    def note(self, text: str) -> None:
        """Keep what the user must know about the way in which the section was read."""
        self.notes.setdefault(text, []).append(self.name)

    def ignore(self, *keys: str) -> None:
        """Count keys as read."""
        self._asked |= dict.fromkeys(keys)

    def at(self, place: str) -> tuple[Section, str]:
        """Return the section of a place, and its key's name in the file, else the first one."""
        first, _, rest = place.partition(".")
        if rest:
            return self.section(first).at(rest)
        keys = first.split("|")
        self.ignore(*keys)
        found = [key for key in keys if self.values.get(key) is not None]
        if any(self.values[key] != self.values[found[0]] for key in found):
            raise OmnistereoError(
                f"{' and '.join(found)} state one thing with different values. Delete the wrong one"
            )
        return self, (found or keys)[0]

    def get(self, place: str, default: Any = None) -> Any:
        """Return the value of a place under whichever of its names the file has."""
        at, key = self.at(place)
        value = at.values.get(key)
        return default if value is None else value

    def require(self, place: str) -> Any:
        """Return the value of a place; an `OmnistereoError` lists the keys that there are."""
        at, key = self.at(place)
        value = at.values.get(key)
        if value is None:
            similar = get_close_matches(key, at.values, _SHOWN, 0.5)
            keys = similar + sorted(set(at.values) - set(similar))
            more = f" and {len(keys) - _SHOWN} more" if len(keys) > _SHOWN else ""
            path, _, last = place.rpartition(".")
            inside = f"{path}: " if path else ""
            missing = " or ".join(map(repr, last.split("|")[:_SHOWN]))
            raise OmnistereoError(f"{inside}key {missing} is missing; found {keys[:_SHOWN]}{more}")
        return value

    def floats(self, place: str, count: int | None = None) -> Floats:
        """Return the numbers of a place, see `parse_floats`."""
        return parse_floats(self.require(place), self.at(place)[1], count)

    def number(self, place: str, default: float | None = None) -> float:
        """Return the one number of a place."""
        if default is not None and self.get(place) is None:
            return default
        return float(self.floats(place, count=1)[0])

    def rotation(self, key: str, values: Floats) -> Floats:
        """Return a rotation matrix (3, 3); of one with few decimals the nearest, with a note."""
        R = np.clip(values, -1e9, 1e9).reshape(3, 3)
        nearest = nearest_rotation(R)
        error = np.abs(nearest - R).max()
        if error <= _EXACT:
            return R
        if error > _ROUNDED:
            lengths = np.maximum(np.linalg.norm(R, axis=0), 1e-300)
            degrees = np.degrees(np.arccos(np.clip((R / lengths * nearest).sum(0), -1, 1)).max())
            raise OmnistereoError(
                f"{key} is not a rotation: the nearest one differs by {error:.2g}, its axes by "
                f"{degrees:.2g}°; expected at most {_ROUNDED:g}. Check that {key} is not scaled, "
                "mirrored or cut"
            )
        self.note(f"{key} is rounded to few decimals; the nearest rotation is used")
        return nearest

    def pose(self, place: str) -> Pose:
        """Return the pose of a 4 × 4 matrix, or of its first three rows."""
        key = self.at(place)[1]
        matrix = parse_floats(self.require(place), f"the 4 × 4 pose {key}")
        if matrix.size not in (12, 16):
            raise OmnistereoError(f"the 4 × 4 pose {key} must be 16 numbers, found {matrix.size}")
        if matrix.size == 16 and not np.allclose(matrix[12:], [0, 0, 0, 1], atol=1e-9):
            last = matrix[12:].tolist()
            raise OmnistereoError(f"the last row of the pose {key} is {last}; expected 0 0 0 1")
        rows = matrix[:12].reshape(3, 4)
        return Pose(self.rotation(key, rows[:, :3]), rows[:, 3])

    def word(self, place: str, default: str = "") -> str:
        """Return the value of a place that names something, in lower case."""
        return str(self.get(place, default)).strip().lower()

    def section(self, key: str) -> Section:
        """Return the mapping of a key."""
        return self.add(key, self.require(key))

    def sections(self, key: str) -> dict[str, Section]:
        """Return the mappings, at most 64, of a key that holds a list, counted from 1, or names."""
        value = self.require(key)
        with error_context(key):
            listed = isinstance(value, list)
            items = dict(enumerate(value, 1)) if listed else Section(value).values
            check_count(len(items))
        return {
            str(name): self.add(str(name), item, f"{key} {name}") for name, item in items.items()
        }

    def add(self, name: str, value: Any, path: str | None = None) -> Section:
        """Return a section that messages call `name`, whose keys count as those of this one."""
        with error_context(path or name):
            return self._inner.setdefault(path or name, Section(value, name, self.notes))

    def unread(self) -> Iterator[tuple[Section, str]]:
        """Yield the keys that nobody asked for and that may mean something, inner ones included.

        Raises an `OmnistereoError` for one that is a letter away from a key with a meaning, or
        that is a parameter of a lens.
        """
        where = f"{self.name}: " if self.name else ""
        for key, value in self.values.items():
            if key in self._asked or is_irrelevant(key, value):
                continue
            meant = next((name for name in sorted(self._asked) if _is_misspelt(key, name)), None)
            if meant is not None:
                raise OmnistereoError(
                    f"{where}key {key!r} has no meaning; is {meant!r} meant? Correct or delete it"
                )
            if _OF_A_LENS.fullmatch(key):
                raise OmnistereoError(
                    f"{where}{key!r} is a parameter of a lens that is not the one stated. Name the "
                    "lens by its model, rename the key, or delete it"
                )
            yield self, key
        for inner in self._inner.values():
            yield from inner.unread()

    def warn(self, source: Path, settings: bool = False) -> list[str]:
        """Warn of notes and of keys that are not read; return those that are `settings`."""
        unread: dict[Section, list[str]] = {}
        for section, key in self.unread():
            unread.setdefault(section, []).append(key)
        skipped = unread.pop(self, []) if settings else []
        for section, keys in unread.items():
            section.note(f"not read: {', '.join(keys)}. Rename what has a meaning, delete the rest")
        for text, names in self.notes.items():
            sections = [*dict.fromkeys(filter(None, names))]
            more = f" and {len(sections) - _SHOWN} more" if len(sections) > _SHOWN else ""
            cameras = ", ".join(sections[:_SHOWN]) + more
            where = f", in {cameras}" if cameras else ""
            warnings.warn(f"{source}{where}: {text}", UserWarning, stacklevel=2)
        return sorted(skipped)


def check_count(cameras: int) -> None:
    """Raise an `OmnistereoError` for more cameras than a rig has."""
    if cameras > MAX_CAMERAS:
        raise OmnistereoError(
            f"found {cameras} cameras; expected at most {MAX_CAMERAS}. Split the rig, or, where "
            "these are the moments of a recording, keep one"
        )


def is_irrelevant(key: str, value: Any) -> bool:
    """Return whether a key has no meaning here, or its value (false, zero) states nothing."""
    is_list = isinstance(value, list)
    inner = value.values() if isinstance(value, Mapping) else value if is_list else None
    empty = not value if inner is None else all(is_irrelevant("", each) for each in inner)
    letters = re.sub(r"[\W_]|\d+$", "", str(key)).lower()
    return empty or bool(_RECTIFIED.fullmatch(str(key))) or letters in _WITHOUT_MEANING


def _is_misspelt(key: str, name: str) -> bool:
    """Return whether a key is a name but for its case, or one letter too many, few or wrong."""
    if min(len(key), len(name)) < _SHORT:
        return False
    a, b = key.lower(), name.lower()
    pairs = enumerate(zip(a, b, strict=False))
    start = next((k for k, (x, y) in pairs if x != y), min(len(a), len(b)))
    a, b = a[start:], b[start:]
    if re.fullmatch("[0-9]+", a[:1] + b[:1]):  # camera_matrix_1 and camera_matrix_2
        return False
    swapped = a[1::-1] == b[:2] and a[2:] == b[2:]
    return a[1:] == b[1:] or a[1:] == b or a == b[1:] or swapped


def parse_floats(
    values: Any, name: str, count: int | None = None, may_be_nan: bool = False
) -> NDArray[np.float64]:
    """Return a value as a flat float64 array of `count` finite numbers.

    Numbers are Python's: "1e-3", which is text in YAML, and 0200 are accepted, true is not. So are
    the matrices of OpenCV and ROS, {rows, cols, data}.
    """
    if isinstance(values, Mapping) and "data" in values:
        stated = {f"{side} of {name}": values[side] for side in ("rows", "cols") if side in values}
        sides = [
            check_number(parse_floats(n, side, 1)[0], side, 0, 1000, whole=True)
            for side, n in stated.items()
        ]
        values = values["data"]
        count = int(np.prod(sides)) if count is None and len(sides) == 2 else count
    try:
        if _has_truth(values):
            raise TypeError
        array = np.asarray(values, np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        raise OmnistereoError(f"{name} must be numbers, found {shortened(values)}") from None
    if not (np.isfinite(array) | (np.isnan(array) & may_be_nan)).all():
        raise OmnistereoError(f"{name} must be finite numbers, found {shortened(values)}")
    if count is not None and len(array) != count:
        found = f"{len(array)}: {shortened(values)}"
        raise OmnistereoError(f"{name} must be {count} numbers, found {found}")
    return array


def _has_truth(values: Any) -> bool:
    """Return whether a value, or one in a list, is true or false, which NumPy takes for 1 and 0."""
    if isinstance(values, list | tuple):
        return any(map(_has_truth, values))
    return isinstance(values, bool)


def parse_size(values: Any, name: str) -> tuple[int, int]:
    """Return a value as the size of an image, two integers; 768.0 is accepted, 768.5 is not."""
    width, height = (
        int(check_number(side, name, 2, MAX_SIDE, whole=True))
        for side in parse_floats(values, name, 2).tolist()
    )
    return width, height


def parse_axis_angle(values: Any, name: str) -> NDArray[np.float64]:
    """Return a rotation as an axis-angle of three numbers in radians; degrees are refused."""
    r = parse_floats(values, name, 3)
    if not np.abs(r).max() <= 2 * np.pi:
        raise OmnistereoError(f"{name} {r.tolist()} exceeds 2π; expected radians")
    return r


def numbered_lines(path: str | Path, empty: bool = False) -> list[tuple[int, list[str]]]:
    """Return number and words of every line without comments (#, %, //); empty ones if asked."""
    lines = enumerate(read_text(path).splitlines(), 1)
    words = [(n, re.sub(r"(^|\s)(#|%|//).*", "", line).split(), line) for n, line in lines]
    return [(n, found) for n, found, line in words if found or (empty and not line.strip())]


def metres_per_unit(unit: str | None, positions: NDArray[np.float64]) -> float:
    """Return the scale of a file that does not state its unit.

    The unit is never guessed: if it is None, OmnistereoError shows what each unit would mean for
    the camera centres `positions`, shape (cameras, 3).
    """
    if unit is not None:
        return METRES_PER_UNIT[unit]
    distances = np.linalg.norm(positions[:, None] - positions, axis=-1)[
        np.triu_indices(len(positions), 1)
    ]
    low, high = distances.min(initial=np.inf), distances.max(initial=0.0)
    meanings = ", ".join(
        f'unit="{name}": {low * m:.4g} to {high * m:.4g} m' for name, m in METRES_PER_UNIT.items()
    )
    raise OmnistereoError(
        "the file does not state its unit. Pass it (`omnistereo rig --unit`); the distances "
        f"between the cameras would be {meanings}"
    )


def check_fov(value: float, name: str) -> float:
    """Return a full field of view in degrees; refuse what can only be radians."""
    if 0 < value < MIN_FOV_DEG:
        raise OmnistereoError(
            f"{name} is {value:g}; expected the full field of view in degrees, {MIN_FOV_DEG:g} to "
            f"360. It looks like radians ({np.degrees(value):.1f}°). Write degrees"
        )
    return check_number(value, name, MIN_FOV_DEG, 360)


def warn_if_different(
    used: Sequence[Pose],
    other: Sequence[Pose],
    used_key: str,
    other_key: str,
    source: Path | str,
    size: float | None = None,
) -> bool:
    """Warn if the poses of the cameras are stated twice and differently, and return whether they
    are.

    size: That of the rig, where its unit is arbitrary; differences are then relative to it.
    """
    differences = [(a.inverse() @ b).magnitude() for a, b in zip(used, other, strict=True)]
    weights = [
        degrees / SAME_DEG + metres / (size or 1) / _SAME_M for degrees, metres in differences
    ]
    worst = int(np.argmax(weights))
    degrees, metres = differences[worst]
    if different := max(metres / (size or 1) / _SAME_M, degrees / SAME_DEG) > 1:
        apart = (
            f"{100 * metres:.1f} cm"
            if size is None
            else f"{100 * metres / size:.1f} % of the size of the rig"
        )
        warnings.warn(
            f"{source}: {used_key} and {other_key} contradict each other, most for camera "
            f"{worst + 1}: its poses are {apart} and {degrees:.1f}° apart. {used_key} is used. "
            "Delete the wrong one; `omnistereo doctor` with images says which fits",
            UserWarning,
            stacklevel=2,
        )
    return different
