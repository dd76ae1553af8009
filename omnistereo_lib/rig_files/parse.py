"""Values of rig files, and errors that name the file, the camera and the key."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError, check_number, shortened
from omnistereo_lib.geometry.camera import MAX_SIDE

METRES_PER_UNIT = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}


@contextmanager
def error_context(source: str | Path) -> Iterator[None]:
    """Prefix every `OmnistereoError` raised inside with a file name, or with a camera in the file."""
    try:
        yield
    except OmnistereoError as error:
        named = str(error).startswith(str(source))
        raise OmnistereoError(str(error) if named else f"{source}: {error}") from None


def to_yaml(data: dict[str, Any]) -> str:
    """Return YAML text with every number in full and lists of numbers on one line."""
    import yaml

    return yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=100)


def require_key(mapping: Any, key: str) -> Any:
    """Return the value of a key; `OmnistereoError` lists the keys that were found instead."""
    if not isinstance(mapping, dict):
        raise OmnistereoError(f"found {shortened(mapping)}; expected keys such as {key!r}")
    if key not in mapping:
        raise OmnistereoError(f"key {key!r} is missing; found {shortened(sorted(map(str, mapping)))}")
    return mapping[key]


def require_list(mapping: Any, key: str) -> list[Any]:
    """Return the value of a key that must be a list."""
    value = require_key(mapping, key)
    if not isinstance(value, list):
        raise OmnistereoError(f"{key!r} is {shortened(value)}; expected a list")
    return value


def parse_floats(values: Any, name: str, count: int | None = None, may_be_nan: bool = False) -> NDArray[np.float64]:
    """Return a value as a flat float64 array of `count` finite numbers; "1e-3", which is text in YAML, is accepted."""
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
    sides = parse_floats(values, name, 2).tolist()
    return tuple(check_number(side, name, 2, MAX_SIDE, whole=True) for side in sides)


def parse_axis_angle(values: Any, name: str) -> NDArray[np.float64]:
    """Return a rotation as an axis-angle of three numbers in radians; degrees are refused."""
    r = parse_floats(values, name, 3)
    if not np.abs(r).max() <= 2 * np.pi:
        raise OmnistereoError(f"{name} {r.tolist()} exceeds 2π; expected radians")
    return r


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
        f"the file does not state its unit. Pass it; the distances between the cameras would be {meanings}"
    )
