"""The kernel for GPUs, run by Triton's interpreter on the CPU; skipped where Triton is not
installed."""

import os
import subprocess
import sys
from importlib.util import find_spec
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import torch

from omnistereo_lib.stereo.sgm import sgm, sgm_gpu


def main():
    volume = np.random.default_rng(0).random((4, 7, 6), np.float32)
    volume[1, 2, :4] = volume[2, 5] = np.nan
    for paths, wrap in product((4, 8), (True, False)):
        found = sgm_gpu(torch.from_numpy(volume), 0.1, 0.7, paths, wrap)
        torch.testing.assert_close(
            found, sgm(volume, 0.1, 0.7, paths, wrap), atol=1e-5, rtol=0, equal_nan=True
        )


@pytest.mark.skipif(find_spec("triton") is None, reason="Triton comes with torch for CUDA on Linux")
def test_the_kernel_equals_the_cpu():
    root = str(Path(__file__).parents[3])
    paths = os.pathsep.join([root, os.environ.get("PYTHONPATH", "")])
    # read when Triton is imported
    environment = {**os.environ, "PYTHONPATH": paths, "TRITON_INTERPRET": "1"}
    done = subprocess.run(
        [sys.executable, __file__], env=environment, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stderr[-2000:]


if __name__ == "__main__":
    main()
