"""Picking values out of parsed files such that whatever is wrong with them is named."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError

UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}


@contextmanager
def naming(source: str | Path) -> Iterator[None]:
    """Put the name of a file, or of a camera in it, in front of every error raised inside."""
    try:
        yield
    except OmnistereoError as error:
        raise OmnistereoError(f"{source}: {error}") from None


def entry(mapping: Any, key: str) -> Any:
    """Return a value of a parsed file's mapping; raises `OmnistereoError` naming what is there instead."""
    if not isinstance(mapping, dict):
        raise OmnistereoError(f"found {_short(mapping)} where entries such as {key!r} were expected")
    if key not in mapping:
        raise OmnistereoError(f"entry {key!r} is missing, found {sorted(map(str, mapping))}")
    return mapping[key]


def entries(mapping: Any, key: str) -> list[Any]:
    """Return a list that is a value of a parsed file's mapping."""
    value = entry(mapping, key)
    if not isinstance(value, list):
        raise OmnistereoError(f"{key!r} must be a list, found {_short(value)}")
    return value


def numbers(values: Any, what: str, count: int | None = None) -> NDArray[np.float64]:
    """Return values of a parsed file as a flat float64 array of finite numbers.

    Numbers may come as text: YAML takes "1e-3" for a word.

    Raises
    ------
    OmnistereoError
        If something is not a finite number, or there are not `count` of them.
    """
    try:
        array = np.asarray(values, np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        raise OmnistereoError(f"{what} must be numbers, found {_short(values)}") from None
    if not np.isfinite(array).all():
        raise OmnistereoError(f"{what} must be finite numbers, found {_short(values)}")
    if count is not None and len(array) != count:
        raise OmnistereoError(f"{what} must be {count} numbers, found {len(array)}: {_short(values)}")
    return array


def whole_numbers(values: Any, what: str, count: int) -> tuple[int, ...]:
    """Return values of a parsed file as integers; 768.0 is one, 768.5 is none."""
    array = numbers(values, what, count)
    if (array != np.round(array)).any():
        raise OmnistereoError(f"{what} must be whole numbers, found {_short(values)}")
    return tuple(int(value) for value in array)


def metres_per_unit(unit: str | None, positions: NDArray[np.float64]) -> float:
    """Return the scale of a file that does not state its unit.

    Parameters
    ----------
    unit : "mm" | "cm" | "m" or None
        What the caller says.
    positions : array, shape (cameras, 3)
        Camera centres as the file has them, to show what each unit would mean.

    Raises
    ------
    OmnistereoError
        If the unit is None: nothing is guessed.
    """
    if unit is not None:
        return UNITS[unit]
    distances = np.linalg.norm(positions[:, None] - positions, axis=-1)[np.triu_indices(len(positions), 1)]
    low, high = distances.min(initial=np.inf), distances.max(initial=0.0)
    meanings = ", ".join(f'unit="{name}": {low * scale:.4g} … {high * scale:.4g} m' for name, scale in UNITS.items())
    raise OmnistereoError(
        f"the file does not state its unit; say it. The distances between cameras would be {meanings}"
    )


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
