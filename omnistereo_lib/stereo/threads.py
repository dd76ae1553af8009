"""Threads that are kept from frame to frame: starting them costs more than a small frame."""

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from threading import local
from typing import Any, TypeVar

import torch
from torch import Tensor

# Cells of a volume that a thread reads at a time: 2 MB in float32.
PART = 1 << 19

_Result = TypeVar("_Result")
_thread = local()


def map_threads(function: Callable[..., _Result], *arguments: Iterable[Any]) -> Iterator[_Result]:
    """Yield what `map` does, computed in `torch.get_num_threads()` threads.

    Called in one of these, it is `map`: a thread that waits for others would keep them from work.
    """
    if hasattr(_thread, "is_ours"):
        return map(function, *arguments)
    if torch.is_inference_mode_enabled():
        # The mode is of this thread alone, and only in it may what was made in it be written to.
        function = torch.inference_mode()(function)
    return _pool(torch.get_num_threads()).map(function, *arguments)


def map_rows(function: Callable[..., Tensor], *volumes: Any) -> Tensor:
    """Return function(some rows of each volume), (K, rows, W), of all rows of (H, W, N): (K, H, W).

    A volume is a tensor, or anything with its shape whose slices of rows are tensors.
    """
    height, width, cells = volumes[0].shape
    each = max(1, PART // (width * cells))
    parts = [slice(y, y + each) for y in range(0, height, each)]
    return torch.cat(
        list(map_threads(lambda part: function(*(one[part].detach() for one in volumes)), parts)), 1
    )


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, initializer=lambda: setattr(_thread, "is_ours", True))


def _after_fork() -> None:
    """Do without the parent's threads, which a forked process lacks: torch would wait for ever."""
    _pool.cache_clear()
    torch.set_num_threads(1)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
