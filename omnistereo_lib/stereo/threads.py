"""Threads that are kept from frame to frame: starting them costs more than a small frame."""

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, TypeVar

import torch

# Cells of a volume that a thread reads at a time: 2 MB in float32.
PART = 1 << 19

_Result = TypeVar("_Result")


def map_threads(function: Callable[..., _Result], *arguments: Iterable[Any]) -> Iterator[_Result]:
    """Yield what `map` does, computed in `torch.get_num_threads()` threads.

    The function must not call this itself.
    """
    return _pool(torch.get_num_threads()).map(function, *arguments)


_pool = cache(ThreadPoolExecutor)


def _after_fork() -> None:
    """Do without the parent's threads, which a forked process lacks: torch would wait for ever."""
    _pool.cache_clear()
    torch.set_num_threads(1)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
