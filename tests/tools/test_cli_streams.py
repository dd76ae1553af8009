"""The command line on a bad day: Ctrl-C, a reader that leaves, little memory, ASCII."""

import io
import os
import re
import signal
import subprocess
import sys
from functools import wraps
from pathlib import Path

import cv2
import numpy as np
import pytest

import omnistereo_lib
from omnistereo_tools import cli
from omnistereo_tools.commands.options import SAMPLE
from omnistereo_tools.progress import progress_bar

ROOT = Path(omnistereo_lib.__file__).parents[1]


@pytest.fixture
def stdout(monkeypatch):
    """Replace the output by any stream."""
    return lambda stream: monkeypatch.setattr(sys, "stdout", stream) or stream


def stopped(*_):
    """What a command does that gets Ctrl-C."""
    signal.raise_signal(signal.SIGINT)


def test_a_command_is_stopped(monkeypatch, capsys):
    doctor = cli.doctor_command
    monkeypatch.setattr(doctor, "run", wraps(doctor.run)(stopped))
    assert cli.main(["doctor"]) == 130
    assert capsys.readouterr().err == "interrupted\n"


@pytest.mark.parametrize("name", ["train", "evaluate"])
def test_what_resumes_is_told_so(monkeypatch, capsys, name):
    module = cli.COMMANDS[name]
    monkeypatch.setattr(module, "run", wraps(module.run)(stopped))
    assert cli.main([name, *(["volumenet"] if name == "train" else [])]) == 130
    assert capsys.readouterr().err == "interrupted; run the same command to resume\n"


def test_what_is_said_does_not_stand_behind_a_bar_nor_above_it(monkeypatch, capsys):
    bar = progress_bar()

    @wraps(cli.doctor_command.run)
    def run(options):
        bar(0, 2, "sweep")
        raise omnistereo_lib.OmnistereoError("no room")

    monkeypatch.setattr(cli.doctor_command, "run", run)
    assert cli.main(["doctor"]) == 2
    assert re.search(r"sweep: +0%.*\r +\rerror: no room\n$", capsys.readouterr().err)


@pytest.mark.parametrize("arguments", [["doctor"], ["--help"]], ids=" ".join)
def test_a_reader_that_leaves(stdout, capsys, arguments):
    reader, writer = os.pipe()
    os.close(reader)
    with stdout(open(writer, "w")):
        assert cli.main(arguments) == 141
    assert capsys.readouterr().err == ""


def test_an_ascii_terminal(stdout):
    stream = stdout(io.TextIOWrapper(io.BytesIO(), encoding="ascii"))
    assert cli.main(["doctor", "--rig", str(SAMPLE / "config.yaml")]) == 0
    assert b"4 cameras, 0.841 to 1.2 m apart" in stream.buffer.getvalue()
    assert b"640 ? 320" in stream.buffer.getvalue()


DEPTH = """
import scene
import omnistereo_lib as osl
rig = scene.rig(width=50, height=48)
grid = osl.SphereGrid(24, 12, num_spheres=4, min_depth=0.6)
index = osl.estimate_depth(osl.Frame.of(rig, scene.images(rig, finest=0.5)), grid, "zncc+sgm").index
"""


def test_without_a_compiler_depth_is_the_same(tmp_path):
    here, path = {}, os.pathsep.join([str(ROOT), str(ROOT / "tests")])
    exec(DEPTH, here)
    environment = {**os.environ, "PYTHONPATH": path, "NUMBA_DISABLE_JIT": "1"}
    command = [sys.executable, "-c", f"{DEPTH}\nimport numpy as np\nnp.save('index.npy', index)"]
    subprocess.run(command, cwd=tmp_path, env=environment, check=True)
    np.testing.assert_allclose(np.load(tmp_path / "index.npy"), here["index"], atol=1e-4)


@pytest.mark.parametrize(
    "error",
    [
        MemoryError("Unable to allocate 9 GiB"),
        RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried to allocate 9 bytes"),
        RuntimeError("CUDA error: the device is gone\nCompile with TORCH_USE_CUDA_DSA" + 900 * "."),
        cv2.error(
            "OpenCV(5.0.0) alloc.cpp:73: error: (-4:Insufficient memory) Failed to allocate 9 bytes"
        ),
    ],
    ids=str,
)
def test_what_the_machine_has_too_little_of(monkeypatch, capsys, error):
    @wraps(cli.doctor_command.run)
    def run(options):
        raise error

    monkeypatch.setattr(cli.doctor_command, "run", run)
    assert cli.main(["doctor"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: the machine has too little memory")
    assert said.count("\n") == 1
    assert len(said) <= 501


def test_a_defect_says_so_below_its_traceback(monkeypatch, capsys):
    @wraps(cli.doctor_command.run)
    def run(options):
        raise ZeroDivisionError("division by zero")

    monkeypatch.setattr(cli.doctor_command, "run", run)
    assert cli.main(["doctor"]) == 1
    said = capsys.readouterr().err
    assert "ZeroDivisionError: division by zero" in said
    assert said.endswith(
        "error: this is a defect of the program: please report what stands above\n"
    )
