"""Commands killed at random moments and given again: the same files as of a run that was left alone.

KILLS=50 python -m pytest tests/test_kills.py kills each command that often, at other moments.
"""

import csv
import io
import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import boards
import numpy as np
import pytest
import scene

import omnistereo_lib as osl
from omnistereo_lib.calibrate.captures import save_corners

KILLS = int(os.environ.get("KILLS", "1"))
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
RECIPE = {"width": 96, "height": 24, "num_spheres": 12, "steps": 8, "validate_every": 3, "validation_groups": 2,
          "warmup": 2, "rays_per_frame": 16}  # fmt: skip

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="Windows has neither fork nor these signals")


class Server:
    """Starts commands, each in a process of its own; see `command_server`."""

    def __init__(self, folder):
        self.folder, self.waiting = folder, []
        command = [sys.executable, str(Path(__file__).with_name("command_server.py"))]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def start(self, *arguments):
        line = json.dumps([[str(word) for word in arguments], str(self.folder / "log.txt")])
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()
        return self._answer("started")[0]

    def wait(self):
        """Return the exit status of the next process that ends; below 0 the signal that ended it."""
        return int(self._answer("")[1])

    def _answer(self, kind):
        """Return the first answer of a kind; others wait."""
        for k, answer in enumerate(self.waiting):
            if (answer[1] == "started") == (kind == "started"):
                return self.waiting.pop(k)
        number, said = self.process.stdout.readline().split()
        self.waiting.append((int(number), said))
        return self._answer(kind)

    def run(self, *arguments):
        self.start(*arguments)
        return self.wait()

    def log(self):
        return (self.folder / "log.txt").read_text(errors="replace")


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    server = Server(tmp_path_factory.mktemp("server"))
    yield server
    server.process.stdin.close()
    server.process.wait()


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Three frames of a rig that moves through the box, with ground truth."""
    grid = osl.SphereGrid(96, 24, (-45, 45), 12, 0.6)
    places = [(0.2 * number - 0.5, 0, 0.15 * number) for number in (1, 2, 3)]
    folder = tmp_path_factory.mktemp("data") / "box"
    return scene.write_set(folder, scene.rig(width=200, height=192), grid, places)


@pytest.fixture(scope="module")
def corners(tmp_path_factory):
    folder = tmp_path_factory.mktemp("corners")
    rows = boards.captures(np.random.default_rng(2), alone=5, shared=4, noise=0.05)
    for i, row in enumerate(rows[:2], start=1):
        views = {f"{k:04d}": view for k, view in enumerate(row)}
        save_corners(folder / f"corners_cam{i}.yaml", views, boards.BOARD, boards.SIZE)
    return folder


@pytest.fixture
def command(request, data, corners):
    """Return the command line that writes into a folder."""
    small = ["--width", 96, "--height", 24, "--spheres", 16, "--method", "zncc+sgm"]
    calibrate = ["calibrate", corners, "--corners", corners, "--board", "12x10", "--square", 0.06, "--degree", 4]
    lines = {
        "depth": ["depth", "--rig", data, *small, "--out"],
        "calibrate": [*calibrate, "--out"],
        "evaluate": ["evaluate", "--sets", data, "--methods", "zncc", "zncc+sgm", "--out"],
    }
    train = ["train", data, json.dumps(RECIPE)]
    return lambda out: [*(train if request.param == "train" else lines[request.param]), out]


def contents(folder):
    """Return the content of all files; of a log without the seconds, and without what a kill left half-written."""
    files = [path for path in folder.rglob("[!.]*") if path.is_file()]
    return {
        str(path.relative_to(folder)): without_seconds(path) if path.name == "log.csv" else path.read_bytes()
        for path in files
    }


def without_seconds(path):
    rows = list(csv.DictReader(io.StringIO(path.read_text())))
    return [{name: cell for name, cell in row.items() if name != "seconds"} for row in rows]


def differing(found, expected):
    return sorted(name for name in found.keys() | expected.keys() if found.get(name) != expected.get(name))


@pytest.mark.parametrize("command", ["depth", "calibrate", "train", "evaluate"], indirect=True)
def test_killed_and_given_again_the_files_are_the_same(server, command, tmp_path, request):
    began = time.perf_counter()
    assert server.run(*command(tmp_path / "whole")) == 0, server.log()[-3000:]
    duration = time.perf_counter() - began
    expected = contents(tmp_path / "whole")
    rng = random.Random(f"{request.node.name} {KILLS}")
    for attempt in range(KILLS):
        out = tmp_path / f"killed{attempt}"
        number = server.start(*command(out))
        time.sleep(rng.uniform(0.05, 0.95) * duration)
        if rng.random() < 0.5:  # a second one meets what the first has left
            os.kill(number, rng.choice(SIGNALS))
            status = server.wait()
            number = server.start(*command(out))
            time.sleep(rng.uniform(0.05, 0.95) * duration)
        os.kill(number, rng.choice(SIGNALS))
        status = server.wait()
        assert status in (0, 130, *(-sign for sign in SIGNALS)), server.log()[-3000:]
        for name, content in contents(out).items() if out.exists() else ():
            assert content or name.endswith(".txt"), f"{name} is empty"
        assert server.run(*command(out)) == 0, server.log()[-3000:]
        assert differing(contents(out), expected) == []
    assert "Traceback" not in server.log()


@pytest.mark.parametrize("command", ["train", "evaluate"], indirect=True)
def test_two_at_once_in_one_folder_do_not_harm_each_other(server, command, tmp_path):
    assert server.run(*command(tmp_path / "whole")) == 0
    for _ in range(2):
        server.start(*command(tmp_path / "both"))
    assert (server.wait(), server.wait()) == (0, 0), server.log()[-3000:]
    assert differing(contents(tmp_path / "both"), contents(tmp_path / "whole")) == []
