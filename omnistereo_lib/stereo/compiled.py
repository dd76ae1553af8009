"""Numba's compiler, storing what it compiles where it can."""

from collections.abc import Callable
from typing import Any

import numba


def compiled(**options: Any) -> Callable:
    """Return `numba.njit` with a cache on disk, or without where neither the package nor the home is writable."""

    def compile_(function: Callable) -> Callable:
        try:
            return numba.njit(cache=True, **options)(function)
        except RuntimeError:  # numba finds no folder for its cache
            return numba.njit(**options)(function)

    return compile_
