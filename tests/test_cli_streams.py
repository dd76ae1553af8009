"""The command line on a bad day: Ctrl-C, a reader that leaves, a full disk, an ASCII terminal. Never a traceback."""

import io
import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numba
import pytest

from omnistereo_lib.stereo.compiled import compiled
from omnistereo_tools import cli
from omnistereo_tools.commands.options import SAMPLE


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
                raise SystemError("a function in C returned a result with an exception set") from stop
            raise

    return run


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)], ids=["Ctrl-C", "kill"])
@pytest.mark.parametrize("in_c", [False, True])
def test_a_command_is_stopped(monkeypatch, capsys, number, status, in_c):
    before = signal.getsignal(signal.SIGTERM)
    monkeypatch.setattr(cli.doctor_command, "run", stopped_by(number, in_c))
    assert cli.main(["doctor"]) == status
    assert capsys.readouterr().err == "interrupted; run the same command to resume\n"
    assert signal.getsignal(signal.SIGTERM) == before


def test_other_errors_in_c_are_bugs(monkeypatch):
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
    assert capsys.readouterr().err == "error: the output cannot be read or written: No space left on device\n"


def test_an_ascii_terminal(stdout):
    stream = stdout(io.TextIOWrapper(io.BytesIO(), encoding="ascii"))
    assert cli.main(["doctor", "--rig", str(SAMPLE / "config.yaml")]) == 0
    assert b"4 cameras, 0.841 to 1.2 m apart" in stream.buffer.getvalue() and b"320 ? 80" in stream.buffer.getvalue()


def test_the_module_answers_in_one_line(tmp_path):
    command = [sys.executable, "-m", "omnistereo_tools", "depth", "--rig", str(tmp_path / "none")]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.startswith("error: ") and done.stderr.count("\n") == 1


def test_numba_without_a_folder_for_its_cache(monkeypatch):
    def increment(x):
        return x + 1

    monkeypatch.setattr(numba.core.caching.CompileResultCacheImpl, "_locator_classes", [])
    assert compiled(nogil=True)(increment)(1) == 2
