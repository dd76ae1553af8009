"""The process's memory: enough of it, and kept from one frame to the next."""

import ctypes
import sys
from contextlib import suppress

from omnistereo_lib.errors import OmnistereoError

_MMAP_MAX, _TRIM_THRESHOLD = -4, -1  # of mallopt(3)
_KEPT_BYTES = 1 << 30
_LEAST_BYTES = 3 << 30  # libraries, their threads and a small panorama


def check_address_space() -> None:
    """Refuse to begin where the system allows so little address space that OpenBLAS would ask for
    more for ever.
    """
    if sys.platform != "linux":
        return
    import resource

    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if 0 <= limit < _LEAST_BYTES:  # below 0: no limit
        found = f"the address space is limited to {limit / 2**30:.2g} GiB (ulimit -v)"
        raise OmnistereoError(
            f"{found}; expected at least {_LEAST_BYTES >> 30} GiB. Raise the limit."
        )


def keep_memory() -> None:
    """Let glibc keep up to 1 GiB that the process has freed, for the arrays of the next frame.

    Otherwise it gives every large array back to the system, which clears pages for the next one. It
    changes the whole process, so only the command line calls it; without glibc it has no effect.
    """
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):  # another C library
            libc = ctypes.CDLL(None)
            libc.mallopt(_MMAP_MAX, 0)
            libc.mallopt(_TRIM_THRESHOLD, _KEPT_BYTES)
