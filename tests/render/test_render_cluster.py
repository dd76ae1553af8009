"""Frames rendered by a cluster of two processes, one of which is killed: the files are those of a local run."""

import os
import signal
import sys
import threading
import time
from dataclasses import replace

import pytest

import render
from render import SETS, main

distributed = pytest.importorskip("dask.distributed", reason="Dask is not installed: environment-dev.txt has it")

NUMBERS = range(706, 711)

# In place of Blender's interpreter: the same program, with noise in place of pictures. Each process that renders a
# frame leaves the
# number of its parent, the worker, and its own in a folder, renamed when the pictures are there; one frame fails.
STAND_IN = """#!{python}
import os, sys, time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace as Module

import numpy as np

sys.path.insert(0, os.getcwd())
import render
from render.city.layout import plan_district


def render_frame(images, rig, T_world_rig, exposure, seed):
    if seed[1] == 999:
        raise MemoryError("a city too large")
    note = Path(f"{notes}/{{os.getppid()}}_{{os.getpid()}}")
    note.touch()
    time.sleep(2)
    note.rename(note.with_suffix(".rendered"))
    rng = np.random.default_rng(seed)
    pictures = [rng.integers(0, 255, (*images.size[::-1], 3), np.uint8) for _ in rig.cameras]
    return pictures, [rng.random(size[::-1]) for size in images.truths]


render.image_sets._render_frame = render_frame
render.SETS["sunny/test"] = replace(render.SETS["sunny/test"], size=(25, 24), truths=((16, 4),))
sys.modules["bpy"] = Module(__spec__="there")
sys.modules["render.blender"] = Module(empty_scene=lambda: None)
traffic = Module(show=lambda *_: None)
sys.modules["render.city.district"] = Module(build_city=lambda seed: (plan_district(seed), traffic))
sys.modules["render.surfaces.lights"] = Module(add_light=lambda name: Module(exposure=1.0))
kind, code, *sys.argv[1:] = sys.argv[1:]
raise SystemExit(render.main() if kind == "-m" else exec(code))
"""


class UseStandIn(distributed.WorkerPlugin):
    """Gives the interpreter to every worker, those started again included."""

    def __init__(self, python):
        self.python = python

    def setup(self, worker):
        render._BLENDER_PYTHON = self.python


@pytest.fixture
def notes(tmp_path):
    (tmp_path / "notes").mkdir()
    return tmp_path / "notes"


@pytest.fixture
def cluster(tmp_path, notes, monkeypatch):
    python = tmp_path / "environment" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text(STAND_IN.format(python=sys.executable, notes=notes))
    python.chmod(0o755)
    monkeypatch.setattr(render, "_BLENDER_PYTHON", python)
    monkeypatch.setitem(SETS, "sunny/test", replace(SETS["sunny/test"], truths=((16, 4),)))
    options = {"n_workers": 2, "threads_per_worker": 1, "processes": True, "dashboard_address": None}
    with (
        distributed.LocalCluster(host="127.0.0.1", **options) as cluster,
        distributed.Client(cluster.scheduler_address) as client,
    ):
        client.register_plugin(UseStandIn(python))
        yield client


def contents(out):
    return {path.relative_to(out): path.read_bytes() for path in out.rglob("*") if path.is_file()}


def test_a_worker_that_dies_costs_its_frame_only(cluster, notes, tmp_path):
    def kill_one():
        while len(list(notes.iterdir())) < 3:
            time.sleep(0.005)
        newest = max(notes.iterdir(), key=lambda note: note.stat().st_mtime_ns)
        os.kill(int(newest.name.split("_")[0]), signal.SIGKILL)

    frames = ["--frames", *map(str, NUMBERS)]
    killer = threading.Thread(target=kill_one)
    killer.start()
    assert main(["--out", str(tmp_path / "cluster"), *frames, "--cluster", cluster.scheduler.address]) == 0
    killer.join()
    ended = [note.suffix for note in notes.iterdir()]
    assert sorted(ended) == ["", *[".rendered"] * len(NUMBERS)]  # one frame was begun again, its first process is gone
    assert main(["--out", str(tmp_path / "local"), *frames]) == 0
    assert contents(tmp_path / "cluster") == contents(tmp_path / "local")


def test_what_fails_in_blender_is_told(cluster, tmp_path, capsys):
    address = cluster.scheduler.address
    assert main(["--out", str(tmp_path / "out"), "--frames", "999", "--cluster", address]) == 2
    error = capsys.readouterr().err
    assert (
        "error: sunny/test 999 failed in Blender's environment: " in error and "MemoryError: a city too large" in error
    )
