"""The test processes share the machine: together they start no more threads than it has cores."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
NAMES = ["OMP_NUM_THREADS", "NUMBA_NUM_THREADS"]  # which torch and Numba read when they are imported
SCRIPT = f"import os, conftest; print(*(os.environ.get(name) for name in {NAMES}))"


@pytest.mark.parametrize("asked", [None, "1"])
def test_every_process_has_its_share_of_the_cores(asked):
    share = os.cpu_count() // 2
    expected = [str(max(1, share)), str(max(2, share))] if asked is None else [asked, asked]
    env = {name: value for name, value in os.environ.items() if name not in NAMES}
    env |= {"PYTEST_XDIST_WORKER_COUNT": "2"} | ({} if asked is None else dict.fromkeys(NAMES, asked))
    found = subprocess.run([sys.executable, "-c", SCRIPT], cwd=ROOT, env=env, capture_output=True, check=True)
    assert found.stdout.split() == [word.encode() for word in expected]
