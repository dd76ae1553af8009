"""The one error that the library raises for bad input, and the checks of numbers and types."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from numbers import Real
from pathlib import Path
from typing import Any

EXIT_STATUS = (
    "exit status: 0 done, 1 a check failed or the program has a defect, 2 bad input, 130"
    " interrupted"
)


class OmnistereoError(ValueError):
    """Bad input, said so that a person can act on it.

    The message names what was given (the file, where there is one), what was found in it, what was
    expected and what to do. The command line prints it as a plain line; all else is a bug.

    >>> osl.SphereGrid(640, 160, min_depth=-1)
    Traceback (most recent call last):
    omnistereo_lib.errors.OmnistereoError: min_depth is -1 and max_depth inf; expected metres ...
    """

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


def one_line(text: str) -> str:
    """Return a text as one line of at most 500 characters, without its middle if it is longer."""
    # control characters move a terminal's cursor
    text = re.sub(r"\s*[\x00-\x1f\x7f-\x9f\u2028\u2029]+\s*", " ", text)
    return text if len(text) <= 500 else f"{text[:330]} … {text[-167:]}"


@contextmanager
def error_context(source: str | Path) -> Iterator[None]:
    """Prefix every `OmnistereoError` raised inside with a file name, or a camera in it."""
    try:
        yield
    except OmnistereoError as error:
        named = str(error).startswith(str(source))
        raise OmnistereoError(str(error) if named else f"{source}: {error}") from None


def check_number(value: Any, what: str, low: float, high: float, whole: bool = False) -> float:
    """Return a number of low … high as float, or int if `whole`; an error says what `what` is."""
    valid = _is_number(value) and low <= value <= high
    if not valid or (whole and value != int(value)):
        kind = "an integer" if whole else "a number"
        # what has no natural least
        small = 0 < low <= 1e-6 and _is_number(value) and value <= 0
        span = "above 0" if small else f"of {low} to {high}"
        raise OmnistereoError(f"{what} is {shortened(value)}; expected {kind} {span}")
    return int(value) if whole else float(value)


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def check_type(value: object, kind: type, name: str) -> None:
    """Raise an `OmnistereoError` if an argument is not of a class, or of one registered for it."""
    if not isinstance(value, kind):
        raise OmnistereoError(f"{name} is {shortened(value)}; expected {kind.__name__}")


def shortened(value: Any) -> str:
    """Return a value as a message shows it, in at most 80 characters."""
    try:
        text = str(value) if isinstance(value, Real) else repr(value)
    except (ValueError, RecursionError):  # an integer of thousands of digits
        text = f"of type {type(value).__name__}"
    return text if len(text) <= 80 else f"{text[:77]}..."
