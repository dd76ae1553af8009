"""Values of rig files: what is missing, misspelt or no number is an error that names the key."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError, check_number, error_context, shortened
from omnistereo_lib.geometry.camera import MAX_SIDE, OcamCamera
from omnistereo_lib.geometry.pose import Floats, Pose

METRES_PER_UNIT = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
MIN_FOV_DEG = 10.0  # a lens as narrow sees no depth around a rig; less is radians or a tangent
_SAME_M, _SAME_DEG = 2e-3, 0.2  # poses that a file states twice; rounding is less, another calibration is more
_SHORT = 4  # letters; shorter keys, such as K and P, are one edit from each other without being misspelt
_SHOWN = 8  # keys in a message


class RigFile(NamedTuple):
    """What a reader finds in a file; of one camera, if it has no poses."""

    cameras: list[OcamCamera]
    T_rig_cam: list[Pose]  #: camera → rig, in the unit of the file
    min_depth: float | None = None  #: metres
    T_rig_file: Pose | None = None  #: see `Rig`


class Section:
    """A mapping of a rig file that knows which of its keys were asked for, so that none is dropped in silence."""

    def __init__(self, values: Any, name: str = "") -> None:
        if not isinstance(values, dict):
            raise OmnistereoError(f"found {shortened(values)}; expected keys with values")
        self.values = {str(key): value for key, value in values.items()}
        self.name = name
        self._asked: set[str] = set()
        self._inner: dict[str, Section] = {}

    def get(self, *names: str, default: Any = None) -> Any:
        """Return the value of a key under whichever of its names the file has."""
        self._asked |= set(names)
        found = [name for name in names if self.values.get(name) is not None]
        if any(self.values[name] != self.values[found[0]] for name in found):
            raise OmnistereoError(f"{' and '.join(found)} state one thing with different values. Delete the wrong one")
        return self.values[found[0]] if found else default

    def require(self, *names: str) -> Any:
        """Return the value of a key; an `OmnistereoError` lists the keys that there are instead, similar ones first."""
        value = self.get(*names)
        if value is None:
            similar = get_close_matches(names[0], self.values, _SHOWN, 0.5)
            keys = similar + sorted(set(self.values) - set(similar))
            more = f" and {len(keys) - _SHOWN} more" if len(keys) > _SHOWN else ""
            raise OmnistereoError(f"key {' or '.join(map(repr, names))} is missing; found {keys[:_SHOWN]}{more}")
        return value

    def floats(self, *names: str, count: int | None = None) -> Floats:
        """Return the numbers of a key, see `parse_floats`."""
        return parse_floats(self.require(*names), names[0], count)

    def number(self, *names: str) -> float:
        """Return the one number of a key."""
        return float(self.floats(*names, count=1)[0])

    def numbers(self) -> dict[str, float]:
        """Return every key with its number."""
        return {name: self.number(name) for name in self.values}

    def word(self, *names: str, default: str = "") -> str:
        """Return the value of a key that names something, in lower case."""
        return str(self.get(*names, default=default)).strip().lower()

    def section(self, name: str) -> Section:
        """Return the mapping of a key."""
        return self._add(name, self.require(name))

    def sections(self, name: str) -> dict[str, Section]:
        """Return the mappings of a key that holds a list, counted from 1, or names."""
        value = self.require(name)
        items = enumerate(value, 1) if isinstance(value, list) else self.section(name).values.items()
        return {str(key): self._add(str(key), item, f"{name} {key}") for key, item in items}

    def _add(self, name: str, value: Any, path: str | None = None) -> Section:
        with error_context(path or name):
            return self._inner.setdefault(path or name, Section(value, name))

    def unread(self) -> Iterator[str]:
        """Yield the keys that nobody asked for, those of inner sections included.

        Raises an `OmnistereoError` for one that is a letter away from a key with a meaning.
        """
        for key in self.values:
            if key in self._asked:
                continue
            meant = next((name for name in sorted(self._asked) if _is_misspelt(key, name)), None)
            if meant is not None:
                where = f"{self.name}: " if self.name else ""
                raise OmnistereoError(f"{where}key {key!r} has no meaning; is {meant!r} meant? Correct or delete it")
            yield key
        for inner in self._inner.values():
            yield from inner.unread()


def _is_misspelt(key: str, name: str) -> bool:
    """Return whether a key is one letter added, missing, changed or swapped away from a name, or its case changed."""
    if min(len(key), len(name)) < _SHORT:
        return False
    a, b = key.lower(), name.lower()
    start = next((k for k, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b)))
    a, b = a[start:], b[start:]
    if re.fullmatch("[0-9]+", a[:1] + b[:1]):  # camera_matrix_1 and camera_matrix_2
        return False
    return a[1:] == b[1:] or a[1:] == b or a == b[1:] or (a[1::-1] == b[:2] and a[2:] == b[2:])


def parse_floats(values: Any, name: str, count: int | None = None, may_be_nan: bool = False) -> NDArray[np.float64]:
    """Return a value as a flat float64 array of `count` finite numbers.

    "1e-3", which is text in YAML, is accepted, and so are the matrices of OpenCV and ROS, {rows, cols, data}.
    """
    if isinstance(values, dict) and "data" in values:
        stated = {f"{side} of {name}": values[side] for side in ("rows", "cols") if side in values}
        sides = [check_number(parse_floats(n, side, 1)[0], side, 0, 1000, whole=True) for side, n in stated.items()]
        values, count = values["data"], int(np.prod(sides)) if count is None and len(sides) == 2 else count
    try:
        array = np.asarray(values, np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        raise OmnistereoError(f"{name} must be numbers, found {shortened(values)}") from None
    if not (np.isfinite(array) | (np.isnan(array) & may_be_nan)).all():
        raise OmnistereoError(f"{name} must be finite numbers, found {shortened(values)}")
    if count is not None and len(array) != count:
        raise OmnistereoError(f"{name} must be {count} numbers, found {len(array)}: {shortened(values)}")
    return array


def parse_size(values: Any, name: str) -> tuple[int, int]:
    """Return a value as the size of an image, two integers; 768.0 is accepted, 768.5 is not."""
    first, second = (
        int(check_number(side, name, 2, MAX_SIDE, whole=True)) for side in parse_floats(values, name, 2).tolist()
    )
    return first, second


def parse_axis_angle(values: Any, name: str) -> NDArray[np.float64]:
    """Return a rotation as an axis-angle of three numbers in radians; degrees are refused."""
    r = parse_floats(values, name, 3)
    if not np.abs(r).max() <= 2 * np.pi:
        raise OmnistereoError(f"{name} {r.tolist()} exceeds 2π; expected radians")
    return r


def parse_matrix(values: Any, name: str) -> Pose:
    """Return the pose of a 4 × 4 matrix."""
    matrix = parse_floats(values, f"the 4 × 4 pose {name}", 16).reshape(4, 4)
    if not np.allclose(matrix[3], [0, 0, 0, 1], atol=1e-9):
        raise OmnistereoError(f"the last row of the pose {name} is {matrix[3].tolist()}; expected 0 0 0 1")
    return Pose(matrix[:3, :3], matrix[:3, 3])


def metres_per_unit(unit: str | None, positions: NDArray[np.float64]) -> float:
    """Return the scale of a file that does not state its unit.

    The unit is never guessed: if it is None, OmnistereoError shows what each unit would mean for the camera centres
    `positions`, shape (cameras, 3).
    """
    if unit is not None:
        return METRES_PER_UNIT[unit]
    distances = np.linalg.norm(positions[:, None] - positions, axis=-1)[np.triu_indices(len(positions), 1)]
    low, high = distances.min(initial=np.inf), distances.max(initial=0.0)
    meanings = ", ".join(f'unit="{name}": {low * m:.4g} to {high * m:.4g} m' for name, m in METRES_PER_UNIT.items())
    raise OmnistereoError(
        f"the file does not state its unit. Pass it (--unit); the distances between the cameras would be {meanings}"
    )


def check_fov(value: float, name: str) -> float:
    """Return a full field of view in degrees; what can only be radians or a tangent is refused with that guess."""
    if 0 < value < MIN_FOV_DEG:
        guesses = {
            "radians": np.degrees(value),
            "the tangent of half of it": 2 * np.degrees(np.arctan(value)),
            "the radians beyond 90° from the axis": 180 + 2 * np.degrees(value),
        }
        likely = " or ".join(f"{what} ({fov:.1f}°)" for what, fov in guesses.items() if 60 < fov <= 300)
        raise OmnistereoError(
            f"{name} is {value:g}; expected the full field of view in degrees, {MIN_FOV_DEG:g} to 360. "
            f"It looks like {likely or 'another unit'}. Write degrees"
        )
    return check_number(value, name, MIN_FOV_DEG, 360)


def warn_if_different(
    used: Sequence[Pose], other: Sequence[Pose], used_key: str, other_key: str, source: Path | str
) -> None:
    """Warn if a file states the poses of its cameras twice and differently."""
    differences = [(a.inverse() @ b).magnitude() for a, b in zip(used, other, strict=True)]
    degrees, metres = np.max(differences, axis=0)
    if metres > _SAME_M or degrees > _SAME_DEG:
        worst = int(np.argmax([d / _SAME_DEG + m / _SAME_M for d, m in differences]))
        warnings.warn(
            f"{source}: {used_key} and {other_key} contradict each other, most for camera {worst + 1}: its poses are "
            f"{100 * differences[worst][1]:.1f} cm and {differences[worst][0]:.1f}° apart. {used_key} is used. Delete "
            "the wrong one; `omnistereo doctor` with images says which fits",
            UserWarning,
            stacklevel=2,
        )
