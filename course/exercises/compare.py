"""What a checker does: call a function on several cases, and put differences into words."""

from __future__ import annotations

import copy
import inspect
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from course.exercises import kinds
from course.exercises.kinds import form, same
from omnistereo_lib.geometry.pose import Pose

Answer = Callable[..., Any]
Array = NDArray[np.float64]
Rng = np.random.Generator

CASES = 10
RIGHT, NOT_WRITTEN = "right", "nothing returned yet"
SHOWN = 12  # numbers of an array
SECONDS = 3.0  # for making an example smaller


class Failure(NamedTuple):
    """A case on which a function differs from the answer."""

    inputs: tuple
    found: Array
    right: Array


def diagnose(
    function: Answer,
    answer: Answer,
    slips: Iterable[tuple[Answer, str]],
    cases: Iterable[tuple],
    whole: Sequence[str] = (),
    within: float = 1e-6,
    order: Callable[[Array], Array] | None = None,
) -> str:
    """Call a function on all cases and put into words how its values compare.

    Args:
        function: What the student wrote. It gets copies of the inputs.
        answer: The right function.
        slips: Functions that make a usual mistake, each with the hint that names it.
        cases: The inputs of each case.
        whole: Names of arguments of which an example shows all.
        within: By how much a right value may differ, beside four digits: what the method allows.
        order: Sorts what may come in any order.

    Returns:
        str: "right", or what is wrong: the slip that most failing cases or the first show, or the
            smallest example.
    """
    if not callable(function):
        return "hand over the function itself: its name, without brackets behind it"
    failures, notes, whole_numbers = [], [], True
    for inputs in cases:
        given = copy.deepcopy(inputs)
        try:
            value = function(*given)
        # whatever a student's code raises is a finding; Ctrl-C is not
        except (Exception, SystemExit) as error:
            return _stopped(error, len(inputs))
        if value is None or value is Ellipsis:
            return f"{NOT_WRITTEN}: replace the ... and return your result"
        expected = answer(*copy.deepcopy(inputs))
        found, right = (_in_order(numbers(one), order) for one in (value, expected))
        if found is None:
            return _not_numbers(value, right)
        whole_numbers &= np.asarray(_plain(expected)).dtype.kind == "i"
        if not same(found, right, within):
            failures.append(Failure(inputs, found, right))
        elif (
            whole_numbers
            and within < 0.5
            and (plain := np.asarray(_plain(value))).size
            and plain.dtype.kind == "f"
        ):
            notes.append("it counts something: return whole numbers, int")
        elif getattr(expected, "requires_grad", False) and not getattr(
            value, "requires_grad", False
        ):
            notes.append(
                "PyTorch cannot differentiate it: stay with tensors, without .item(), .detach() and"
                " NumPy"
            )
        elif (number := _overwritten(given, inputs)) is not None:
            notes.append(
                f"your function overwrites its argument number {number}, which its caller may still"
                " need. Write into a copy"
            )
    if not failures:
        return f"not yet: the value is right, but {notes[0]}" if notes else RIGHT
    with quiet():
        said = _named(failures, slips, order) or _recognised(failures, answer)
        return f"not yet: {said or _example(function, answer, failures, whole, within, order)}"


@contextmanager
def quiet() -> Iterator[None]:
    """Let NumPy divide by zero without a word: mistakes do."""
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def numbers(found: Any) -> Array | None:
    """Return what a function returned as float64, or None if it is not made of real numbers."""
    try:
        values = np.asarray(_plain(found))
    except Exception:  # parts of unequal shape, an object's own error
        return None
    # no text, truth values, complex numbers
    return values.astype(np.float64) if values.dtype.kind in "iuf" else None


def _in_order(values: Array | None, order: Callable[[Array], Array] | None) -> Array | None:
    return values if values is None or order is None else order(values)


def _plain(found: Any) -> Any:
    """Return poses as vectors, tensors without gradients, also in lists; the rest as it is."""
    if isinstance(found, list | tuple):
        return [_plain(one) for one in found]
    if isinstance(found, Pose):
        return found.as_vector()
    if np.ma.isMaskedArray(found) and found.dtype.kind == "f":
        return found.filled(np.nan)  # what is masked is unknown
    return (
        found.detach()
        if "torch" in sys.modules and isinstance(found, sys.modules["torch"].Tensor)
        else found
    )


# --- What stands in the way of a comparison


def _stopped(error: BaseException, arguments: int) -> str:
    # the call itself, nothing inside
    if isinstance(error, TypeError) and error.__traceback__.tb_next is None:
        return (
            f"your function is called with {arguments} arguments: keep its first line as it was"
            f" ({error})"
        )
    message = "".join(traceback.format_exception_only(error)).strip()
    return f"your function stopped with {message}{where(error)}"


def where(error: BaseException) -> str:
    """Return the line of the student's code at which it stopped: the last in its file."""
    _, *frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if frame.filename == frames[0].filename]
    if not own or Path(own[0].filename).is_relative_to(Path(__file__).parents[1]):
        return ""
    return f", in line {own[-1].lineno} of its cell" + (
        f": `{own[-1].line}`" if own[-1].line else ""
    )


def _not_numbers(found: Any, right: Array) -> str:
    first = numbers(found[0]) if isinstance(found, tuple) and found else None
    if first is not None and same(first, right):
        return "not yet: the first thing that you return is right, return it alone"
    kind = type(found).__name__
    if isinstance(found, np.ndarray):
        kind = f"an array of {found.dtype}"
    elif isinstance(found, list | tuple):  # they are welcome, with numbers in them
        kind = f"a {kind} that is no array of numbers"
    return (
        f"not yet: expected {form(right)}, got {kind}. Return real numbers, and nothing beside them"
    )


def _overwritten(given: tuple, inputs: tuple) -> int | None:
    for number, (now, before) in enumerate(zip(given, inputs, strict=True), start=1):
        before, now = numbers(before), numbers(now)
        if before is not None and (now is None or not np.array_equal(now, before, equal_nan=True)):
            return number
    return None


# --- The difference in words


def _named(
    failures: list[Failure],
    slips: Iterable[tuple[Answer, str]],
    order: Callable[[Array], Array] | None,
) -> str:
    """Return the hint of the slip that gives most failing values, if the first or half of them."""
    return _elected(
        [[hint for slip, hint in slips if _gives(slip, failure, order)] for failure in failures]
    )


def _gives(slip: Answer, failure: Failure, order: Callable[[Array], Array] | None) -> bool:
    try:
        value = _in_order(numbers(slip(*copy.deepcopy(failure.inputs))), order)
    except Exception:  # it need not know every case
        return False
    return value is not None and same(failure.found, value)


def _recognised(failures: list[Failure], answer: Answer) -> str:
    """Return the kind of slip that the values show."""
    if words := _elected([list(kinds.of_values(f.found, f.right)) for f in failures]):
        _, found, right = failures[0]
        return (
            words
            if found.shape == right.shape
            else f"{words}; expected {form(right)}, got {form(found)}"
        )
    if len(failures) == 1 or len({failure.found.tobytes() for failure in failures}) > 1:
        of_arguments = [
            list(kinds.of_arguments(answer, f.inputs, f.found, numbers)) for f in failures[:3]
        ]
        if words := _elected(of_arguments):
            return words
    return _elected(
        [list(kinds.of_part(failure.found, failure.right)) for failure in failures], by_first=False
    )


def _elected(words: list[list[str]], by_first: bool = True) -> str:
    """Return what is said of the most cases, if it is said of most of them, or of the first."""
    count = Counter(word for of_case in words for word in dict.fromkeys(of_case))
    for word, times in count.most_common(1):
        return word if 2 * times > len(words) or (by_first and word in words[0]) else ""
    return ""


def _example(
    function: Answer,
    answer: Answer,
    failures: list[Failure],
    whole: Sequence[str],
    within: float,
    order: Callable[[Array], Array] | None,
) -> str:
    """Show the smallest input on which the two differ, with what was given and what is right."""
    first = next((f for f in failures if f.found.shape != f.right.shape), None)
    if first:
        return (
            f"expected {form(first.right)}, got {form(first.found)}. Look at the axes that you sum"
            " or stack over"
        )
    names = list(inspect.signature(answer).parameters)
    begin = min(failures, key=lambda failure: failure.right.size)
    inputs, found, right = smallest(
        function, answer, begin, [names.index(name) for name in whole], within, order
    )
    given = [f"{key} = {text}" for key, x in zip(names, inputs, strict=True) if (text := _text(x))]
    if right.size > SHOWN:  # it cannot be made smaller
        place = tuple(
            np.argwhere(~np.isclose(found, right, rtol=1e-4, atol=1e-6, equal_nan=True))[0]
        )
        given.append(f"at {[int(k) for k in place]}")
        found, right = found[place], right[place]
    lines = ", ".join(given), f"yours: {_text(found)}", f"right: {_text(right)}"
    return "\n    ".join(["the smallest example that differs:", *lines]) + "\n"


def _text(x: Any) -> str:
    """Return an argument in short: its numbers, or their shape if there are many."""
    if (values := numbers(x)) is None:
        return f"those of {list(x)}" if isinstance(x, dict) else ""
    if values.size > SHOWN:
        return form(values)
    return np.array2string(
        np.asarray(_plain(x)), precision=4, separator=", ", max_line_width=10_000
    ).replace("\n", "")


def smallest(
    function: Answer,
    answer: Answer,
    failure: Failure,
    whole: Sequence[int],
    within: float = 1e-6,
    order: Callable[[Array], Array] | None = None,
) -> Failure:
    """Cut an example down while the function differs: halves, single slices of its arrays."""
    until = time.monotonic() + SECONDS
    axes = [() if k in whole else _axes(x) for k, x in enumerate(failure.inputs)]
    smaller: Failure | None = failure
    while smaller:
        failure = smaller
        tried = (
            _differs(function, answer, cut, within, order)
            for cut in _cuts(failure.inputs, axes)
            if time.monotonic() < until
        )
        smaller = next(filter(None, islice(tried, 60)), None)
    return failure


def _differs(
    function: Answer,
    answer: Answer,
    inputs: tuple,
    within: float,
    order: Callable[[Array], Array] | None,
) -> Failure | None:
    """Return how the two differ on some inputs, if both give arrays of one shape."""
    try:
        found = numbers(function(*copy.deepcopy(inputs)))
        right = numbers(answer(*copy.deepcopy(inputs)))
    except Exception:
        return None
    if found is None or right is None or found.shape != right.shape or same(found, right, within):
        return None
    return Failure(inputs, found, right)


def _axes(x: Any) -> Sequence[int]:
    """Return the axes of an argument that may be cut: not the last of coordinates or colours."""
    shape = (len(x),) if isinstance(x, list) else tuple(getattr(x, "shape", ()))
    return [axis for axis, size in enumerate(shape) if size > 3 or axis < len(shape) - 1]


def _cuts(inputs: tuple, axes: list[Sequence[int]]) -> Iterator[tuple]:
    """Yield the inputs with one size reduced, in all axes that have it."""
    shapes = [(len(x),) if isinstance(x, list) else tuple(getattr(x, "shape", ())) for x in inputs]
    sizes = {shape[axis] for shape, own in zip(shapes, axes, strict=True) for axis in own}
    for size in sorted(sizes - {0, 1}, reverse=True):
        half = size // 2
        for part in (slice(0, half), slice(half, size), slice(1, size), slice(0, size - 1)):
            yield tuple(
                _cut(x, [axis for axis in own if shape[axis] == size], part)
                for x, shape, own in zip(inputs, shapes, axes, strict=True)
            )


def _cut(x: Any, axes: list[int], part: slice) -> Any:
    if not axes or isinstance(x, list):
        return x[part] if axes else x
    smaller = x[tuple(part if axis in axes else slice(None) for axis in range(x.ndim))]
    return smaller.detach().requires_grad_(x.requires_grad) if hasattr(x, "detach") else smaller
