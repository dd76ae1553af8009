"""The process's memory, kept from one frame to the next."""

import ctypes
import sys
from contextlib import suppress

_MMAP_MAX, _TRIM_THRESHOLD, _ARENA_MAX = -4, -1, -8  # of mallopt(3)
_KEPT_BYTES = 1 << 30


def keep_memory() -> None:
    """Let glibc keep up to 1 GiB that the process has freed, for the arrays of the next frame.

    Otherwise it gives every large array back to the system, which clears pages for the next one:
    1.1 s of the 12 s of the processor that `depth` takes (two cores, least of three). It changes
    the whole process, so only the command line calls it; without glibc it has no effect.
    """
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):  # another C library
            libc = ctypes.CDLL(None)
            libc.mallopt(_MMAP_MAX, 0)
            libc.mallopt(_TRIM_THRESHOLD, _KEPT_BYTES)
            libc.mallopt(_ARENA_MAX, 1)  # what one thread has freed, another one takes
