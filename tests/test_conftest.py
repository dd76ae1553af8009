"""The test processes share the machine: together they start no more threads than it has cores."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
THREADS = """
import os, numba, torch
def test_threads():
    assert [torch.get_num_threads(), numba.get_num_threads()] == {expected}
"""


@pytest.mark.parametrize("asked", [None, "1"])
def test_every_process_has_its_share_of_the_cores(tmp_path, asked):
    expected = [max(1, os.cpu_count() // 2), max(2, os.cpu_count() // 2)] if asked is None else [1, 1]
    (tmp_path / "test_threads.py").write_text(THREADS.format(expected=expected))
    ours = ("PYTEST_", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS")
    env = {name: value for name, value in os.environ.items() if not name.startswith(ours)}
    env |= {} if asked is None else {"OMP_NUM_THREADS": asked, "NUMBA_NUM_THREADS": asked}
    command = [sys.executable, "-m", "pytest", "-n", "2", "-p", "conftest", "-p", "no:cacheprovider", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
