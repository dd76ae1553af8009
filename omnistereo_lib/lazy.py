"""What is computed on first use and kept, and locks, where processes fork while threads compute."""

import functools
import os
from collections.abc import Callable
from contextlib import nullcontext
from typing import Any, TypeVar

_Value = TypeVar("_Value")


class lazy_property(functools.cached_property[_Value]):  # noqa: N801 (used as a decorator)
    """`functools.cached_property` without the lock of Python 3.11, which all instances share.

    A process that is forked while another thread holds it would wait for ever.
    """

    def __init__(self, function: Callable[[Any], _Value]) -> None:
        super().__init__(function)
        self.lock = nullcontext()


def hold_at_fork(lock: Any) -> None:
    """Let a fork wait until nobody holds a lock, so that the new process finds it free."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(
            before=lock.acquire, after_in_parent=lock.release, after_in_child=lock.release
        )
