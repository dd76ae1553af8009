"""Numba's compiler, storing what it compiles where it can, and a minimum that it vectorises."""

from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar

import numba
from numba.core.caching import FunctionCache
from numba.core.compiler_lock import global_compiler_lock
from numba.core.runtime.nrt import rtsys
from numba.extending import intrinsic

from omnistereo_lib.lazy import hold_at_fork

hold_at_fork(global_compiler_lock)
_Function = TypeVar("_Function", bound=Callable[..., Any])
_is_plain: bool = numba.config.DISABLE_JIT  # type: ignore[attr-defined]


def compiled(**options: Any) -> Callable[[_Function], _Function]:
    """Return `numba.njit`, with a cache on disk where the package or the home is writable."""

    def compile_(function: _Function) -> _Function:
        dispatcher = numba.njit(**options)(function)
        if not _is_plain:
            with suppress(RuntimeError):  # numba finds no folder for its cache
                dispatcher._cache = _Cache(function)
        return dispatcher

    return compile_


class _Cache(FunctionCache):
    """Numba's cache, which reads what is compiled without loading the compiler.

    Numba loads all that it can compile first, 214 modules: 0.3 s and 60 MB (0.68.1).
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return a compiled function, or None: then Numba loads the rest, and compiles."""
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)


def _minimum(context: Any, a: Any, b: Any) -> Any:
    """Return the smaller of two float32 that are not NaN.

    Python's min keeps Numba from vectorising a reduction.
    """

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        flags = ("nnan", "nsz")
        return builder.select(builder.fcmp_ordered("<", *args, flags=flags), *args, flags=flags)

    return numba.float32(numba.float32, numba.float32), build


# Any: called in compiled code, with a and b alone; by Python under NUMBA_DISABLE_JIT.
minimum: Any = min if _is_plain else intrinsic(_minimum)
