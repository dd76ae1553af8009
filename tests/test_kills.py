"""Commands killed at random moments and given again: the same files as of a run that was left
alone.

KILLS=50 python -m pytest tests/test_kills.py kills each command that often, at other moments.
"""

import csv
import io
import json
import os
import random
import shutil
import signal
import time
from contextlib import suppress

import boards
import numpy as np
import pytest
import scene
from learn.tiny import MCCNN
from served_commands import Server

import omnistereo_lib as osl
from omnistereo_rigs.boards.captures import save_corners

KILLS = int(os.environ.get("KILLS", "1"))
SMALL = ["--grid", "96x24x16", "--method", "zncc+sgm"]
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(
        not hasattr(os, "fork"), reason="Windows has neither fork nor these signals"
    ),
]


class Killer(Server):
    """A server that sends signals to what it has started."""

    rng = random.Random(KILLS)

    def kill(self, number):
        """Send a signal, if the process still runs, and return its exit status."""
        with suppress(ProcessLookupError):
            os.kill(number, self.rng.choice(SIGNALS))
        return self.wait(number)


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    server = Killer(tmp_path_factory.mktemp("server"), env={**os.environ, "OMNISTEREO_TINY": "1"})
    yield server
    server.close()


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Three frames of a rig that moves through the box, with ground truth."""
    grid = osl.SphereGrid(96, 24, (-45, 45), 12, 0.6)
    places = [(0.2 * number - 0.5, 0, 0.15 * number) for number in (1, 2, 3)]
    folder = tmp_path_factory.mktemp("data") / "box"
    return scene.write_set(folder, scene.rig(width=100, height=96), grid, places)


@pytest.fixture(scope="module")
def corners(tmp_path_factory):
    folder = tmp_path_factory.mktemp("corners")
    rows = boards.captures(np.random.default_rng(2), alone=3, shared=3, noise=0.05)
    for i, row in enumerate(rows[:2], start=1):
        views = {f"{k:04d}": view for k, view in enumerate(row)}
        save_corners(folder / f"corners_cam{i}.yaml", views, boards.BOARD, boards.SIZE)
    return folder


@pytest.fixture(scope="module")
def record(data):
    """Return the command line that makes a recording in a folder."""
    views = [data / f"cam{k}" for k in (1, 2, 3, 4)]
    return ["record", "--rig", data / "config.yaml", "--images", *views, *SMALL, "--out"]


@pytest.fixture(scope="module")
def recording(server, record, tmp_path_factory):
    out = tmp_path_factory.mktemp("recording") / "drive"
    assert server.run(*record, out) == 0, server.log()[-3000:]
    return out


@pytest.fixture
def command(request, data, corners, record):
    """Return the command line that writes into a folder."""
    calibrate = ["calibrate", corners, "--board", "12x10", "--square", 0.06]
    methods = ("zncc", "zncc,window=3", "zncc+sgm")
    lines = {
        "depth": ["depth", "--rig", data, *SMALL, "--out"],
        "recording": record,
        "calibrate": [*calibrate, "--out"],
        "evaluate": ["evaluate", "--sets", data, "--methods", *methods, "--out"],
        "render": ["render", "sunny/test", "--frames", *range(701, 741), "--out"],
    }
    recipe = {k: v for k, v in MCCNN.as_dict().items() if k != "network"}
    train = ["recipe", data, json.dumps(recipe)]
    if request.param == "world":
        whole = request.getfixturevalue("recording")
        # It writes into the recording.
        return lambda out: [
            "world",
            out if out.exists() else shutil.copytree(whole, out, symlinks=True),
            *("--voxel", 0.3),
        ]
    return lambda out: [*(train if request.param == "train" else lines[request.param]), out]


def contents(folder):
    """Return the content of all files; of a log without seconds and what a kill left halfway."""
    files = [path for path in folder.rglob("[!.]*") if path.is_file()]
    return {
        str(path.relative_to(folder)): without_seconds(path)
        if path.name == "log.csv"
        else path.read_bytes()
        for path in files
    }


def hidden(folder):
    """Return what a kill has left half-written."""
    return sorted(folder.rglob(".*"))


def without_seconds(path):
    rows = list(csv.DictReader(io.StringIO(path.read_text())))
    return [{name: cell for name, cell in row.items() if name != "seconds"} for row in rows]


def differing(found, expected):
    return sorted(
        name for name in found.keys() | expected.keys() if found.get(name) != expected.get(name)
    )


@pytest.fixture(scope="module")
def undisturbed(server, tmp_path_factory):
    """Return a function: command line, its name → files of an undisturbed run, and its seconds."""
    known = {}

    def once(command, name):
        if name not in known:
            began, out = time.perf_counter(), tmp_path_factory.mktemp("whole") / name
            assert server.run(*command(out)) == 0, server.log()[-3000:]
            known[name] = contents(out), time.perf_counter() - began
        return known[name]

    return once


@pytest.mark.parametrize(
    "command",
    ["depth", "recording", "world", "calibrate", "train", "evaluate", "render"],
    indirect=True,
)
def test_killed_and_given_again_the_files_are_the_same(
    server, command, undisturbed, tmp_path, request
):
    expected, duration = undisturbed(command, request.node.callspec.params["command"])
    for attempt in range(KILLS):
        out = tmp_path / f"killed{attempt}"
        for _ in range(1 + attempt % 2):  # a second one meets what the first has left
            number = server.start(*command(out))
            time.sleep(server.rng.uniform(0.05, 0.95) * duration)
            status = server.kill(number)
            assert status in (0, 130, *(-sign for sign in SIGNALS)), server.log()[-3000:]
            # else it puts away what it began
            assert status < 0 or hidden(out) == [] or command(out)[0] == "render"
            for path in hidden(out):
                os.utime(path, (0, 0))  # as if the kill were long ago
        found = contents(out) if out.exists() else {}
        assert all(found.values()), "a file is empty"
        assert server.run(*command(out)) == 0, server.log()[-3000:]
        assert differing(contents(out), expected) == [] and hidden(out) == []
    assert server.tracebacks() == [], server.log()[-3000:]


@pytest.mark.parametrize("command", ["train", "evaluate"], indirect=True)
def test_two_at_once_in_one_folder_do_not_harm_each_other(
    server, command, undisturbed, tmp_path, request
):
    expected, _ = undisturbed(command, request.node.callspec.params["command"])
    numbers = [server.start(*command(tmp_path / "both")) for _ in range(2)]
    assert [server.wait(number) for number in numbers] == [0, 0], server.log()[-3000:]
    assert differing(contents(tmp_path / "both"), expected) == []
