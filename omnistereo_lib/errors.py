"""The one error that the library raises for bad input, and the check of a number."""

from numbers import Real
from typing import Any


class OmnistereoError(ValueError):
    """Bad input, said so that a person can act on it.

    The message names what was given (the file, where there is one), what was found in it, what was expected and what
    to do. The command line prints it as one plain line; everything else that escapes is a bug.
    """


def check_number(value: Any, what: str, low: float, high: float, whole: bool = False) -> float:
    """Return a number of low … high as float, a whole one as int; else the `OmnistereoError` says `what` it is."""
    valid = isinstance(value, Real) and not isinstance(value, bool) and low <= value <= high
    if not valid or (whole and value != int(value)):
        kind = "an integer" if whole else "a number"
        raise OmnistereoError(f"{what} is {shortened(value)}; expected {kind} of {low} to {high}")
    return int(value) if whole else float(value)


def shortened(value: Any) -> str:
    """Return a value as a message shows it, in at most 80 characters."""
    try:
        text = str(value) if isinstance(value, Real) else repr(value)
    except ValueError:  # an integer of thousands of digits
        text = "a number of thousands of digits"
    return text if len(text) <= 80 else f"{text[:77]}..."
