"""Threads that are kept from frame to frame: a small frame has no time to start them anew."""

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import torch


def map_threads(function: Callable, *arguments: Iterable) -> Iterator:
    """Yield what `map` does, computed in `torch.get_num_threads()` threads. The function must not call this itself."""
    return _pool(torch.get_num_threads()).map(function, *arguments)


_pool = cache(ThreadPoolExecutor)


def _after_fork() -> None:
    """Do without the threads of the parent, which a forked process has not: torch would wait for them for ever."""
    _pool.cache_clear()
    torch.set_num_threads(1)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
