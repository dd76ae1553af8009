"""Numba's compiler, storing what it compiles where it can, and a minimum that it vectorises."""

from collections.abc import Callable
from typing import Any, TypeVar

import numba
from numba.core.compiler_lock import global_compiler_lock
from numba.extending import intrinsic

from omnistereo_lib.lazy import hold_at_fork

hold_at_fork(global_compiler_lock)
_Function = TypeVar("_Function", bound=Callable[..., Any])


def compiled(**options: Any) -> Callable[[_Function], _Function]:
    """Return `numba.njit`, with a cache on disk where the package or the home is writable."""

    def compile_(function: _Function) -> _Function:
        try:
            return numba.njit(cache=True, **options)(function)
        except RuntimeError:  # numba finds no folder for its cache
            return numba.njit(**options)(function)

    return compile_


def _minimum(context: Any, a: Any, b: Any) -> Any:
    """Return the smaller of two float32 that are not NaN.

    Python's min keeps Numba from vectorising a reduction.
    """

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        flags = ("nnan", "nsz")
        return builder.select(builder.fcmp_ordered("<", *args, flags=flags), *args, flags=flags)

    return numba.float32(numba.float32, numba.float32), build


# Any: called in compiled code, with a and b alone; by Python under NUMBA_DISABLE_JIT.
_is_plain: bool = numba.config.DISABLE_JIT  # type: ignore[attr-defined]
minimum: Any = min if _is_plain else intrinsic(_minimum)
