"""Depth in other processes, after the parent has started its threads: it must end."""

import multiprocessing
import os
import subprocess
import sys
import threading
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import scene
from torch.utils.data import DataLoader, Dataset

import omnistereo_lib as osl
from omnistereo_lib.lazy import lazy_property
from omnistereo_lib.stereo import correlation

METHODS = ["zncc+sgm", "mccnn", "sweepnet", "volumenet"]
RIG = scene.rig(width=60, height=56)
GRID = osl.SphereGrid(48, 16, num_spheres=8, min_depth=0.6)
IMAGES = [np.random.default_rng(k).integers(0, 255, (56, 60), np.uint8) for k in range(4)]


def index(method):
    return osl.estimate_depth(osl.Frame.of(RIG, IMAGES), GRID, method).index


class Frames(Dataset):
    """One estimate per method, as a training asks for that prepares depth in its workers."""

    def __len__(self):
        return len(METHODS)

    def __getitem__(self, k):
        return index(METHODS[k])


def main():
    """Estimate here, then in forked and spawned processes, by Python's and torch's ways."""
    expected = [index(method) for method in METHODS]
    results = {}
    with multiprocessing.get_context("spawn").Pool(1) as pool:  # it imports torch again
        results["spawn"] = pool.map(index, METHODS)
    with ProcessPoolExecutor(2, multiprocessing.get_context("fork")) as executor:
        results["executor"] = list(executor.map(index, METHODS))
    loader = DataLoader(Frames(), batch_size=None, num_workers=2, multiprocessing_context="fork")
    results["loader"] = [item.numpy() for item in loader]
    for name, found in results.items():
        for method, a, b in zip(METHODS, found, expected, strict=True):
            # fewer threads, other sums in bfloat16
            close = np.isclose(a, b, atol=0.05, equal_nan=True)
            assert close.mean() > 0.95, (name, method, close.mean())


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
def test_depth_in_other_processes():
    here = Path(__file__)
    command = [sys.executable, str(here)]
    environment = {**os.environ, "PYTHONPATH": f"{here.parents[3]}:{here.parents[2]}"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="Windows does not fork")
def test_what_a_thread_computes_at_the_fork_does_not_block_the_child():
    """`functools.cached_property` of Python 3.11 would: one lock serves all objects."""
    begun, go_on = threading.Event(), threading.Event()

    class Slow:
        @lazy_property
        def value(self):
            if threading.current_thread() is not threading.main_thread():
                begun.set()
                go_on.wait(60)
            return 1

    thread = threading.Thread(target=lambda: Slow().value)
    thread.start()
    begun.wait(60)
    child = multiprocessing.get_context("fork").Process(target=lambda: sys.exit(Slow().value + 6))
    child.start()
    child.join(60)
    status = child.exitcode
    child.kill()
    go_on.set()
    thread.join()
    assert status == 7


if __name__ in ("__main__", "__mp_main__"):  # in processes of its own
    # Not 8: where one sphere is left, oneDNN (torch 2.13.0) makes noise of bfloat16.
    correlation.COARSE = (32, 16)
if __name__ == "__main__":
    main()


def test_what_is_compiled_is_read_without_the_compiler(tmp_path):
    code = (
        "import sys, torch; from omnistereo_lib.stereo.kernels.winner_numba import *;"
        "winner_and_confidence(torch.rand(1, 2, 4), True); print('numba.np.linalg' in sys.modules)"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    run = [sys.executable, "-c", code]
    said = [subprocess.check_output(run, env=environment, text=True) for _ in range(2)]
    assert said == ["True\n", "False\n"]
