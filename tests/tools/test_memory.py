"""Freed memory is used again: the second large array meets no fresh page."""

import os
import platform
import subprocess
import sys

import pytest

SCRIPT = """
import resource, sys
import numpy as np
from omnistereo_tools.memory import keep_memory
if sys.argv[1] == "kept":
    keep_memory()
for _ in range(2):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    np.ones(100 << 20, np.uint8)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library")
def test_the_memory_of_a_freed_array_is_used_again():
    # `make test` sets some
    env = {name: value for name, value in os.environ.items() if not name.startswith("MALLOC_")}
    fresh, kept = (
        int(
            subprocess.run(
                [sys.executable, "-c", SCRIPT, how], env=env, capture_output=True, check=True
            ).stdout
        )
        for how in ("fresh", "kept")
    )
    assert kept < fresh / 4
