"""What a checker does with an answer: call it on several cases, compare, and put the difference into words."""

from __future__ import annotations

import copy
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.geometry.pose import Pose

Answer = Callable[..., Any]
Array = NDArray[np.float64]
Rng = np.random.Generator
Case = tuple[tuple, ArrayLike, Sequence[tuple[ArrayLike, str]]]  # inputs, right value, mistakes: value and hint

CASES = 10
RIGHT, NOT_WRITTEN = "right", "nothing returned yet"

_FACTORS = (
    (-1.0, "that is the right value with the other sign"),
    (2.0, "that is twice the right value: look for a 2"),
    (0.5, "that is half the right value: look for a 2"),
    (100.0, "that is 100 times the right value: is something in centimetres, or in percent?"),
    (0.01, "that is a hundredth of the right value: is something in centimetres, or in percent?"),
    (180 / np.pi, "that is 180/π times the right value: are there degrees in place of radians?"),
    (np.pi / 180, "that is π/180 times the right value: are there radians in place of degrees?"),
)


def by(inputs: tuple, right: Answer, wrong: Sequence[tuple[Answer, str]]) -> Case:
    """Return the case of a right function and of wrong ones, each with the hint that names its mistake."""
    return inputs, _numbers(right(*inputs)), [(_numbers(mistake(*inputs)), hint) for mistake, hint in wrong]


def diagnose(answer: Answer, cases: Iterable[Case]) -> str:
    """Call an answer on all cases and put into words how its values compare.

    A hint is given if the answer makes its mistake in every case.

    Args:
        answer: What the student wrote. It gets copies of the inputs.
        cases: Inputs, right value, and what the mistakes give instead, of any shape, with their hints.

    Returns:
        str: "right", or what is wrong and the next thing to try.
    """
    if not callable(answer):
        return "hand over the function itself: its name, without brackets behind it"
    found, tried, overwritten = [], [], None
    for case in cases:
        inputs, right, _ = case
        given = copy.deepcopy(inputs)
        try:
            value = answer(*given)
        except (Exception, SystemExit) as error:  # whatever a student's code raises is a finding; Ctrl-C is not
            return _stopped(error, len(inputs))
        if value is None or value is Ellipsis:
            return f"{NOT_WRITTEN}: replace the ... and return your result"
        values = _numbers(value)
        if values is None:
            return _not_numbers(value, np.asarray(right, np.float64))
        found.append(values)
        tried.append(case)
        overwritten = overwritten or next(_overwritten(given, inputs), None)
    said = _compare(found, tried)
    if said == RIGHT and overwritten:
        return (
            f"not yet: the value is right, but your function overwrites its argument number {overwritten}, which its "
            "caller may still need. Write into a copy"
        )
    return said


def _stopped(error: BaseException, arguments: int) -> str:
    if isinstance(error, TypeError) and error.__traceback__.tb_next is None:  # the call itself, nothing inside
        return f"your function is called with {arguments} arguments: keep its first line as it was ({error})"
    message = "".join(traceback.format_exception_only(error)).strip()
    return f"your function stopped with {message}. Call it with numbers of your own: Python then shows the line"


def _numbers(found: Any) -> Array | None:
    try:
        values = np.asarray(_vectors(found))
    except Exception:  # parts of unequal shape, a tensor with a gradient, an object's own error
        return None
    return values.astype(np.float64) if values.dtype.kind in "iuf" else None  # no text, truth values, complex numbers


def _vectors(found: Any) -> Any:
    """Return a pose, and every pose of a list, as a vector; anything else as it is."""
    if isinstance(found, list):
        return [_vectors(one) for one in found]
    return found.as_vector() if isinstance(found, Pose) else found


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


def _overwritten(given: tuple, inputs: tuple) -> Iterator[int]:
    for number, (now, before) in enumerate(zip(given, inputs, strict=True), start=1):
        if isinstance(before, np.ndarray) and not np.array_equal(now, before, equal_nan=before.dtype.kind == "f"):
            yield number


def _compare(found: list[Array], cases: Sequence[Case]) -> str:
    rights = [np.asarray(right, np.float64) for _, right, _ in cases]
    differ = [not _same(*pair) for pair in zip(found, rights, strict=True)]
    if not any(differ):
        return RIGHT
    for mistake in zip(*(mistakes for _, _, mistakes in cases), strict=True):  # the same one in all cases
        if all(_same(values, value) for values, (value, _) in zip(found, mistake, strict=True)):
            return f"not yet: {mistake[0][1]}"
    first = differ.index(True)
    if found[first].shape != rights[first].shape:
        expected, got = _form(rights[first]), _form(found[first])
        return f"not yet: expected {expected}, got {got}. Look at the axes that you sum or stack over"
    for factor, hint in _FACTORS:
        if all(_same(values, factor * right) for values, right in zip(found, rights, strict=True)):
            return f"not yet: {hint}"
    return _difference(found[first], rights[first])


def _difference(found: Array, right: Array) -> str:
    """Say where two arrays of the same shape differ first, and by how much."""
    if (np.isfinite(right) & ~np.isfinite(found)).any():
        return "not yet: there are NaN or infinite values. Look for a division by zero, or NaN that is not left out"
    place = tuple(np.argwhere(~np.isclose(found, right, rtol=1e-4, atol=1e-6, equal_nan=True))[0])
    where = f" at {[int(i) for i in place]}" if place else ""
    worst = np.nanmax(np.abs(found - right), initial=0)
    return (
        f"not yet: {found[place]:.6g}{where} where {right[place]:.6g} is right, and off by up to {worst:.3g} in all; "
        "no usual mistake explains it. Work out one value by hand and compare"
    )


def _same(found: Array, value: ArrayLike) -> bool:
    return found.shape == np.shape(value) and np.allclose(found, value, rtol=1e-4, atol=1e-6, equal_nan=True)


def _form(values: Array) -> str:
    return f"numbers of shape {values.shape}" if values.ndim else "one number"
