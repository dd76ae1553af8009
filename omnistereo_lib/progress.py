"""How a long call says how far it is: it calls `progress(done, total, what)`."""

from collections.abc import Callable
from itertools import count

# parts that are done, parts in all, the part that is next; "" at the end
Progress = Callable[[int, int, str], object]


def silent(done: int, total: int, what: str) -> None:
    """Say nothing: the default."""


def counted(progress: Progress, total: int) -> Callable[[str], object]:
    """Return what is called with the name of each part before it begins, and with "" at the end."""
    numbers = count()
    return lambda what: progress(next(numbers), total, what)
