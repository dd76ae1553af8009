"""Every bad input is answered: the table in `bad_inputs`, row by row."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import bad_inputs
import numpy as np
import pytest
import scene

import omnistereo_lib as osl
from omnistereo_tools import cli

ROOT = Path(osl.__file__).resolve().parents[1]


def by_wrong(rows):
    return pytest.mark.parametrize("row", rows, ids=[row.wrong for row in rows])


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    grid = osl.SphereGrid(96, 24, (-45, 45), 16, 0.6)
    return scene.write_set(tmp_path_factory.mktemp("bad") / "data", bad_inputs.RIG, grid, [(0, 0, 0)])


@pytest.fixture
def data(original, tmp_path):
    shutil.copytree(original, tmp_path / "data")
    (tmp_path / "data" / "boards").mkdir()
    return tmp_path / "data"


def words(row, data):
    images = " ".join(str(bad_inputs.first(data, camera)) for camera in (1, 2, 3, 4))
    places = {
        "DATA": data,
        "RIG": data / "config.yaml",
        "IMAGES": images,
        "OUT": data.parent / "out",
        "BOARDS": data / "boards",
        "LONG": data / (300 * "n"),
    }
    return re.sub("|".join(places), lambda word: str(places[word[0]]), row.command).split()


def run(row, data):
    """Spoil the data and run the command; return the exit status and what stood in the folder before."""
    row.spoil(data)
    command, before = words(row, data), sorted(data.rglob("*"))
    try:
        return cli.main(command), before
    except SystemExit as stop:  # of argparse
        return stop.code, before


@by_wrong(bad_inputs.COMMANDS)
def test_a_command_is_answered_in_one_line(row, data, capsys):
    code, before = run(row, data)
    err = capsys.readouterr().err
    _, _, answer = err.partition("error: ")
    lines = answer.rstrip().splitlines()
    assert code == row.code and "Traceback" not in err
    assert re.search(row.said, answer), err
    assert len(lines) == 1 and len(answer) <= 501
    assert "error: " not in answer and answer.count("cannot be read") < 2  # nothing is said twice
    assert sorted(data.rglob("*")) == before
    assert [path.name for path in data.parent.iterdir()] == ["data"]


@by_wrong(bad_inputs.DOUBTFUL)
def test_a_command_warns(row, data, capsys):
    assert run(row, data)[0] == row.code
    warned = [line for line in capsys.readouterr().err.splitlines() if line.startswith("warning: ")]
    assert [line for line in warned if re.search(row.said, line)], warned


LIMITED = """
import resource, sys
import cv2, numpy, yaml, omnistereo_lib as osl
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + 2**30,) * 2)
resource.setrlimit(resource.RLIMIT_CPU, (int(resource.getrusage(resource.RUSAGE_SELF).ru_utime) + 5,) * 2)
function, *paths = sys.argv[1:]
calls = {
    "load_rig": lambda: osl.load_rig(paths[0]),
    "load_images": lambda: osl.load_images(paths),
    "images": lambda: osl.load_dataset(paths[0])[0].images,
    "weights": lambda: osl.MCCNN.from_file(f"{paths[0]}/weights.safetensors"),
    "ground_truth": lambda: osl.load_dataset(paths[0])[0].inverse_depth,
}
try:
    calls[function]()
except osl.OmnistereoError as error:
    sys.exit(str(error))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory are Linux's")
@by_wrong(bad_inputs.BOMBS)
def test_a_bomb_is_refused_with_five_seconds_and_a_gigabyte(row, data):
    row.spoil(data)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-c", LIMITED, *words(row, data)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 1 and "Traceback" not in done.stderr, done.stderr[-2000:]
    assert re.search(row.said, done.stderr)


@by_wrong(bad_inputs.CALLS)
def test_a_call_raises_our_error(row, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(osl.OmnistereoError, match=row.said):
        row.call()


def test_right_input_is_not_doubted(data, capsys):
    assert run(bad_inputs.Row("nothing", bad_inputs.DEPTH, ""), data)[0] == 0
    assert "warning: " not in capsys.readouterr().err


def test_gray_and_colour_pictures_mixed(data):
    pictures = osl.load_images([bad_inputs.first(data, camera) for camera in (1, 2, 3, 4)])
    mixed = [np.stack([pictures[0]] * 3, -1), *pictures[1:]]
    panorama = bad_inputs.depth(mixed).panorama()
    assert panorama.shape == (24, 96, 3)
    np.testing.assert_allclose(panorama[..., 0], bad_inputs.depth(pictures).panorama(), atol=1e-3)
