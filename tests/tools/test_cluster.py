"""Frames on two processes, one of which is killed: the files are those of a local run."""

import os
import shutil
import signal
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
import scene
from scene import refused

import omnistereo_lib as osl
from omnistereo_learn.evaluate import SCALES
from omnistereo_tools import cli
from omnistereo_tools.record.cluster import on_cluster

FRAMES = 6


@pytest.fixture(scope="module")
def distributed():
    return pytest.importorskip(
        "dask.distributed", reason="Dask is not installed: environment-dev.txt has it"
    )


@pytest.fixture(scope="module")
def cluster(distributed):
    """Two workers, forked by a process that has imported the library, as is the replacement."""
    import dask

    options = {"n_workers": 2, "threads_per_worker": 1, "processes": True} | {
        "dashboard_address": None
    }
    with dask.config.set({"distributed.worker.multiprocessing-method": "forkserver"}):
        distributed.utils.get_mp_context().set_forkserver_preload(
            ["distributed", "omnistereo_lib.stereo.pipeline"]
        )
        with distributed.LocalCluster(host="127.0.0.1", **options) as cluster:
            yield cluster


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return scene.write_drive(tmp_path_factory.mktemp("recorded"), FRAMES, step=0.03)


def run(*arguments):
    return cli.main([str(argument) for argument in arguments])


def record(recorded, method):
    views = [recorded / f"view{k}" for k in (1, 2, 3, 4)]
    small = ["--grid", "96x24x16", "--method", method]
    return ["record", "--rig", recorded / "rig.yaml", "--images", *views, *small]


def test_a_recording_with_a_worker_that_dies(distributed, cluster, recorded, tmp_path):
    command = record(recorded, "zncc+sgm")
    assert run(*command, "--out", tmp_path / "local") == 0
    with distributed.Client(cluster.scheduler_address) as client:
        pids = list(client.run(os.getpid).values())
    folder, killed = tmp_path / "cluster" / "depth_estimate_96", []

    def kill_one():
        while not killed:
            if len(list(folder.glob("0*.tiff"))) >= 2:
                os.kill(pids[0], signal.SIGKILL)
                killed.append(pids[0])
            time.sleep(0.002)

    killer = threading.Thread(target=kill_one)
    killer.start()
    assert run(*command, "--out", tmp_path / "cluster", "--cluster", cluster.scheduler_address) == 0
    killer.join(60)
    assert killed
    frames = osl.load_dataset(tmp_path / "cluster")
    assert len(frames) == FRAMES
    for path in sorted((tmp_path / "local").rglob("*.tiff")):
        other = tmp_path / "cluster" / path.relative_to(tmp_path / "local")
        assert path.read_bytes() == other.read_bytes()


@pytest.mark.slow
def test_a_worker_does_not_keep_the_rig_of_an_earlier_recording(cluster, recorded, tmp_path):
    """Two rigs, one after the other, in one folder, and a recording that has grown."""
    rig, out, command = (
        osl.load_rig(recorded / "rig.yaml"),
        tmp_path / "out",
        record(recorded, "zncc"),
    )
    turned = rig.T_rig_cam[1] @ osl.Pose.from_vector([0, 0.07, 0, 0, 0, 0])
    osl.save_rig(
        rig.with_poses([rig.T_rig_cam[0], turned, *rig.T_rig_cam[2:]]), tmp_path / "rig.yaml"
    )
    other = [*command, "--rig", tmp_path / "rig.yaml"]
    assert run(*other, "--out", tmp_path / "local") == 0
    for asked in (command, [*other, "--frames", ":3"], other):
        if asked is not other:
            shutil.rmtree(out, ignore_errors=True)
        assert run(*asked, "--out", out, "--cluster", cluster.scheduler_address) == 0
    for path in (tmp_path / "local").rglob("*.tiff"):
        assert path.read_bytes() == (out / path.relative_to(tmp_path / "local")).read_bytes()


def test_an_evaluation(cluster, tmp_path, monkeypatch):
    grid = osl.SphereGrid(96, 24, num_spheres=16, min_depth=0.6)
    monkeypatch.setitem(
        SCALES, "teaching", replace(SCALES["teaching"], width=96, height=24, num_spheres=16)
    )
    scene.write_set(tmp_path / "box", scene.rig(width=100, height=96), grid, np.eye(3)[:2] / 10)
    command = ["evaluate", "--sets", tmp_path / "box", "--methods", "zncc"]
    assert run(*command, "--out", tmp_path / "local") == 0
    assert run(*command, "--out", tmp_path / "cluster", "--cluster", cluster.scheduler_address) == 0
    local, of_cluster = (
        (tmp_path / name / "results.json").read_bytes() for name in ("local", "cluster")
    )
    assert local == of_cluster


def ten(number):
    return 10 * number


def test_a_scheduler_that_ends(distributed):
    with distributed.LocalCluster(n_workers=1, processes=False, dashboard_address=None) as own:
        results = on_cluster(own.scheduler_address, ten, [1, 2])
        assert next(results) in (10, 20)
    with refused(r"the scheduler at .* has ended"):
        list(results)


def test_a_scheduler_that_is_not_there(distributed, recorded, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("omnistereo_tools.record.cluster._PATIENCE_S", 0.5)
    assert (
        run(*record(recorded, "zncc"), "--out", tmp_path / "out", "--cluster", "tcp://127.0.0.1:1")
        == 2
    )
    assert "no Dask scheduler answers at tcp://127.0.0.1:1" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_what_a_cluster_without_workers_waits_for_is_told(distributed, capsys):
    with distributed.LocalCluster(n_workers=0, processes=False, dashboard_address=None) as own:
        came = threading.Timer(2, own.scale, [1])
        came.start()
        assert sorted(on_cluster(own.scheduler_address, ten, [1, 2])) == [10, 20]
        came.join()
    assert f"waiting for a worker. Start one: dask worker {own.scheduler_address}" in "".join(
        capsys.readouterr()
    )
