"""The command line on a bad day: Ctrl-C, a reader that leaves, a full disk, an ASCII terminal.
Never a traceback."""

import io
import json
import os
import re
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import wraps
from pathlib import Path

import cv2
import numba
import numpy as np
import pytest

import omnistereo_lib
from omnistereo_lib.stereo.compiled import compiled
from omnistereo_tools import cli
from omnistereo_tools.commands.options import SAMPLE
from omnistereo_tools.progress import progress_bar

ROOT = Path(omnistereo_lib.__file__).parents[1]


@pytest.fixture
def stdout(monkeypatch):
    """Replace the output by any stream."""
    return lambda stream: monkeypatch.setattr(sys, "stdout", stream) or stream


def stopped_by(number, in_c=False):
    """Return what a command does that gets a signal, perhaps within a library in C."""

    def run(options):
        try:
            signal.raise_signal(number)
        except KeyboardInterrupt as stop:
            if in_c:
                raise SystemError(
                    "a function in C returned a result with an exception set"
                ) from stop
            raise

    return run


@pytest.mark.parametrize(
    ("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)], ids=["Ctrl-C", "kill"]
)
@pytest.mark.parametrize("in_c", [False, True])
def test_a_command_is_stopped(monkeypatch, capsys, number, status, in_c):
    before = signal.getsignal(signal.SIGTERM)
    doctor = cli.doctor_command
    monkeypatch.setattr(doctor, "run", wraps(doctor.run)(stopped_by(number, in_c)))
    assert cli.main(["doctor"]) == status
    assert capsys.readouterr().err == "interrupted\n"
    assert signal.getsignal(signal.SIGTERM) == before


@pytest.mark.parametrize("name", ["train", "evaluate"])
def test_what_resumes_is_told_so(monkeypatch, capsys, name):
    module = cli.COMMANDS[name]
    monkeypatch.setattr(module, "run", wraps(module.run)(stopped_by(signal.SIGINT)))
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


def test_other_errors_in_c_are_bugs(monkeypatch):
    @wraps(cli.doctor_command.run)
    def run(options):
        raise SystemError("a function in C returned NULL without setting an exception")

    monkeypatch.setattr(cli.doctor_command, "run", run)
    with pytest.raises(SystemError):
        cli.main(["doctor"])


def test_a_command_in_a_thread():
    """Signals belong to the main thread."""
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(cli.main, ["xyz"]).exception().code == 2


@pytest.mark.parametrize("arguments", [["doctor"], ["--help"]], ids=" ".join)
def test_a_reader_that_leaves(stdout, capsys, arguments):
    reader, writer = os.pipe()
    os.close(reader)
    with stdout(open(writer, "w")):
        assert cli.main(arguments) == 141
    assert capsys.readouterr().err == ""


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
def test_a_full_disk(stdout, capsys):
    with stdout(open("/dev/full", "w")):
        assert cli.main(["doctor"]) == 2
    assert (
        capsys.readouterr().err
        == "error: the output cannot be read or written: No space left on device\n"
    )


def test_an_ascii_terminal(stdout):
    stream = stdout(io.TextIOWrapper(io.BytesIO(), encoding="ascii"))
    assert cli.main(["doctor", "--rig", str(SAMPLE / "config.yaml")]) == 0
    assert (
        b"4 cameras, 0.841 to 1.2 m apart" in stream.buffer.getvalue()
        and b"640 ? 320" in stream.buffer.getvalue()
    )


COVERAGE = f"doctor --rig {SAMPLE / 'config.yaml'} --coverage out.png"


@pytest.mark.skipif(os.name != "posix", reason="the shell is of Unix")
@pytest.mark.parametrize(
    ("variables", "arguments", "status"),
    [
        ("MPLBACKEND=nonsense MATPLOTLIBRC=.", f"{COVERAGE} 0<&- 1>&- 2>&-", 0),
        # the line has nowhere to go, and is not put into a file
        ("PYTHONOPTIMIZE=2", "doctor --rig none 2>&-", 2),
    ],
)
def test_streams_that_are_closed_and_variables_that_are_set_otherwise(
    tmp_path, variables, arguments, status
):
    (tmp_path / "matplotlibrc").write_text("text.usetex: True\n")
    command = f"PYTHONPATH={ROOT} {variables} exec {sys.executable} -m omnistereo_tools {arguments}"
    done = subprocess.run(command, shell=True, cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (status, "")
    assert (tmp_path / "out.png").exists() is (status == 0)


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
    ("name", "value"),
    [
        ("RANK", "x"),
        ("RANK", "1_0"),
        ("WORLD_SIZE", "9" * 5000),
    ],
)
def test_a_number_of_the_environment_that_is_none(monkeypatch, capsys, tmp_path, name, value):
    monkeypatch.setenv(name, value)
    assert cli.main(["train", "sweepnet", "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.startswith(f"error: {name} in the environment is ")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("rank", ["0", "3"])
def test_an_error_under_torchrun_is_one_line_and_the_reason_it_gives(
    monkeypatch, capsys, tmp_path, rank
):
    for name, value in {
        "WORLD_SIZE": "4",
        "RANK": rank,
        "TORCHELASTIC_ERROR_FILE": str(tmp_path / "error"),
    }.items():
        monkeypatch.setenv(name, value)
    assert (
        cli.main(["train", "sweepnet", "--preset", "shipped", "--out", str(tmp_path / "out")]) == 2
    )
    line = json.loads((tmp_path / "error").read_text())["message"]["message"]
    assert "is not divisible by 4 processes; expected 1 or 2 of them" in line
    assert capsys.readouterr().err == (f"{line}\n" if rank == "0" else "")


@pytest.mark.parametrize(
    "error",
    [
        MemoryError("Unable to allocate 9 GiB"),
        RuntimeError("can't start new thread"),
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
    assert (
        said.startswith("error: the machine has too little memory")
        and said.count("\n") == 1
        and len(said) <= 501
    )


def test_too_little_address_space(monkeypatch, capsys):
    """OpenBLAS would ask for more for ever."""
    resource = pytest.importorskip("resource")
    monkeypatch.setattr(resource, "getrlimit", lambda which: (1_500_000_000, -1))
    assert cli.main(["doctor"]) == 2
    assert "the address space is limited to 1.4 GiB" in capsys.readouterr().err


def test_an_argument_of_thousands_of_digits(capsys):
    with pytest.raises(SystemExit, match="2"):
        cli.main(["depth", "--width", "9" * 6000])
    assert len(capsys.readouterr().err.splitlines()[-1]) < 540


def test_numba_without_a_folder_for_its_cache(monkeypatch):
    def increment(x):
        return x + 1

    monkeypatch.setattr(numba.core.caching.CompileResultCacheImpl, "_locator_classes", [])
    assert compiled(nogil=True)(increment)(1) == 2


@pytest.mark.parametrize("value", ["0", "x", "-1", ""])
def test_a_number_of_threads_that_is_none(monkeypatch, capsys, value):
    monkeypatch.setenv("NUMBA_NUM_THREADS", value)
    assert cli.main(["doctor"]) == 2
    assert (
        f"error: NUMBA_NUM_THREADS in the environment is {value!r}; expected 1 to 9999"
        in capsys.readouterr().err
    )


@pytest.mark.skipif(os.name != "posix", reason="Windows keeps the folder in which a process works")
def test_a_working_folder_that_is_gone(monkeypatch, capsys, tmp_path):
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert cli.main(["doctor"]) == 2
    assert (
        capsys.readouterr().err
        == "error: the working folder is not there any more. Change to another one\n"
    )


LOADING = """
import os, signal, sys
class Finder:
    def find_spec(self, name, *_):
        if name == "{module}":
            os.kill(os.getpid(), signal.{name})
sys.meta_path.insert(0, Finder())
sys.argv = ["omnistereo", "doctor", "--rig", "none"]
from omnistereo_tools.__main__ import start
sys.exit(start())
"""


@pytest.mark.skipif(os.name != "posix", reason="Windows has other signals")
@pytest.mark.parametrize(
    ("module", "name", "status"),
    [
        ("omnistereo_tools.cli", "SIGINT", 130),
        ("omnistereo_tools.outputs", "SIGTERM", 143),
        ("omnistereo_rigs.formats", "SIGINT", 130),
    ],
)
def test_stopped_while_modules_load(module, name, status):
    """The last one is loaded by the command itself."""
    command = [sys.executable, "-c", LOADING.format(module=module, name=name)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (status, "interrupted\n")
