"""What a checker does with an answer: call it, compare, and put the difference into words."""

from __future__ import annotations

import copy
import traceback
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.geometry.pose import Pose

Answer = Callable[..., Any]
Array = NDArray[np.float64]
Mistakes = Sequence[tuple[ArrayLike, str]]

_FACTORS = (
    (-1.0, "that is the right value with the other sign"),
    (2.0, "that is twice the right value: look for a 2"),
    (0.5, "that is half the right value: look for a 2"),
    (100.0, "that is 100 times the right value: is something in centimetres, or in percent?"),
    (0.01, "that is a hundredth of the right value: is something in centimetres, or in percent?"),
    (180 / np.pi, "that is 180/π times the right value: are there degrees in place of radians?"),
    (np.pi / 180, "that is π/180 times the right value: are there radians in place of degrees?"),
)


def diagnose(answer: Answer, inputs: tuple, right: ArrayLike, mistakes: Mistakes) -> str:
    """Call an answer and put into words how its value compares.

    Args:
        answer: What the student wrote. It gets copies of the inputs, so it may change them.
        inputs: Its arguments.
        right: What it should return, finite.
        mistakes: What a mistake gives instead, of any shape, and the hint that names it.

    Returns:
        str: "right", or what is wrong and the next thing to try.
    """
    if not callable(answer):
        return "hand over the function itself: its name, without brackets behind it"
    try:
        found = answer(*copy.deepcopy(inputs))
    except (Exception, SystemExit) as error:  # whatever a student's code raises is a finding; Ctrl-C is not
        return _stopped(error, len(inputs))
    if found is None or found is Ellipsis:
        return "nothing returned yet: replace the ... and return your result"
    right, values = np.asarray(right, np.float64), _numbers(found)
    return _not_numbers(found, right) if values is None else _compare(values, right, mistakes)


def first_finding(verdicts: Iterable[str]) -> str:
    """Return the first verdict of several inputs that is not "right", or "right"."""
    return next((verdict for verdict in verdicts if verdict != "right"), "right")


def _ray(theta: float, phi: float) -> Array:
    return np.array([np.cos(phi) * np.sin(theta), np.sin(phi), np.cos(phi) * np.cos(theta)])


def _stopped(error: BaseException, arguments: int) -> str:
    if isinstance(error, TypeError) and error.__traceback__.tb_next is None:  # the call itself, nothing inside
        return f"your function is called with {arguments} arguments: keep its first line as it was ({error})"
    message = "".join(traceback.format_exception_only(error)).strip()
    return f"your function stopped with {message}. Call it with numbers of your own: Python then shows the line"


def _numbers(found: Any) -> Array | None:
    try:
        values = np.asarray(found.as_vector() if isinstance(found, Pose) else found)
    except Exception:  # parts of unequal shape, a tensor with a gradient, an object's own error
        return None
    return values.astype(np.float64) if values.dtype.kind in "iuf" else None  # no text, truth values, complex numbers


def _not_numbers(found: Any, right: Array) -> str:
    first = _numbers(found[0]) if isinstance(found, tuple) and found else None
    if first is not None and _same(first, right):
        return "not yet: the first thing that you return is right, return it alone"
    kind = type(found).__name__
    if isinstance(found, np.ndarray):
        kind = f"an array of {found.dtype}"
    elif isinstance(found, list | tuple):  # they are welcome, with numbers in them
        kind = f"a {kind} that is no array of numbers"
    return f"not yet: expected {_form(right)}, got {kind}. Return real numbers, and nothing beside them"


def _compare(found: Array, right: Array, mistakes: Mistakes) -> str:
    if _same(found, right):
        return "right"
    for value, hint in mistakes:
        if _same(found, value):
            return f"not yet: {hint}"
    if found.shape != right.shape:
        return f"not yet: expected {_form(right)}, got {_form(found)}. Look at the axes that you sum or stack over"
    if not np.isfinite(found).all():
        return "not yet: there are NaN or infinite values. Look for a division by zero, or NaN that is not left out"
    for factor, hint in _FACTORS:
        if _same(found, factor * right):
            return f"not yet: {hint}"
    worst = np.abs(found - right).max()
    return (
        f"not yet: off by up to {worst:.3g}, and no usual mistake explains it. Work out one value by hand and compare"
    )


def _same(found: Array, value: ArrayLike) -> bool:
    return found.shape == np.shape(value) and np.allclose(found, value, rtol=1e-4, atol=1e-6, equal_nan=True)


def _form(values: Array) -> str:
    return f"numbers of shape {values.shape}" if values.ndim else "one number"
