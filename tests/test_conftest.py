"""The test processes share the machine: together they start no more threads than it has cores."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
NAMES = ["OMP_NUM_THREADS", "NUMBA_NUM_THREADS"]  # which torch and Numba read when they are imported
THREADS = """
import os
def test_threads():
    assert [os.environ[name] for name in {names}] == {expected}
"""


@pytest.mark.parametrize("asked", [None, "1"])
def test_every_process_has_its_share_of_the_cores(tmp_path, asked):
    share = os.cpu_count() // 2
    expected = [str(max(1, share)), str(max(2, share))] if asked is None else [asked, asked]
    (tmp_path / "test_threads.py").write_text(THREADS.format(names=NAMES, expected=expected))
    env = {name: value for name, value in os.environ.items() if not name.startswith(("PYTEST_", *NAMES))}
    env |= {} if asked is None else dict.fromkeys(NAMES, asked)
    command = [sys.executable, "-m", "pytest", "-n", "2", "-p", "conftest", "-p", "no:cacheprovider", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
