"""Rendered files without Blender: a frame is there whole or not at all; the command line."""

import hashlib
import itertools
import json
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from render_stand_in import TINY, contents, replace_blender

import omnistereo_lib as osl
from workshop import render
from workshop.render import image_sets as frames_module
from workshop.render import main
from workshop.render.camera.render_rig import make_rig
from workshop.render.image_sets import (
    SEED,
    SETS,
    forget_partial,
    is_complete,
    render_set,
    renew_manifest,
    select_shard,
    write_manifest,
)


@pytest.fixture
def no_blender(monkeypatch):
    replace_blender(monkeypatch.setitem, monkeypatch.setattr)


def test_rendered_set_is_a_data_set(no_blender, tmp_path):
    assert list(render_set(tmp_path, TINY, (706, 731), SEED)) == [706, 731]
    data = osl.load_dataset(tmp_path)
    assert [frame.number for frame in data] == [706, 731]
    assert all(image.shape == (24, 25, 3) for frame in data for image in frame.images)
    assert [osl.load_dataset(tmp_path, gt_width=w)[0].inverse_depth.shape for w in (16, 24)] == [
        (4, 16),
        (6, 24),
    ]
    assert list(render_set(tmp_path, TINY, (706, 731), SEED)) == []


@pytest.mark.parametrize("renames", [0, 3, 5])
def test_killed_and_started_again_the_set_is_the_same(renames, no_blender, tmp_path, monkeypatch):
    killed, numbers = tmp_path / "killed", (706, 731)
    replacing, count = Path.replace, itertools.count()

    def kill(path, target):
        if "0731" in str(target) and next(count) == renames:
            raise KeyboardInterrupt
        return replacing(path, target)

    monkeypatch.setattr(Path, "replace", kill)
    with pytest.raises(KeyboardInterrupt):
        list(render_set(killed, TINY, numbers, SEED))
    monkeypatch.setattr(Path, "replace", replacing)
    assert is_complete(killed, TINY, 706) and not is_complete(killed, TINY, 731)
    finished = {path: content for path, content in contents(killed).items() if "706" in path.name}

    left = forget_partial(killed, TINY, numbers)
    assert len(left) == 6  # four pictures and two truths, renamed or not
    others = {
        Path(name): (killed / name).read_bytes() for name in ("config.yaml", "trajectory.txt")
    }
    assert contents(killed) == finished | others
    assert list(render_set(killed, TINY, numbers, SEED)) == [731]
    list(render_set(tmp_path / "whole", TINY, numbers, SEED))
    assert contents(killed) == contents(tmp_path / "whole")


def test_steps_of_the_first_release_and_another_sets_truth(no_blender, tmp_path):
    train = replace(TINY, truth_suffix=".png")
    list(render_set(tmp_path / "train", train, (706,), SEED))
    list(render_set(tmp_path / "whole", TINY, (706,), SEED))
    steps, exact = (
        osl.load_dataset(tmp_path / name)[0].inverse_depth for name in ("train", "whole")
    )
    min_depth = osl.load_dataset(tmp_path / "train").rig.min_depth
    limited = np.minimum(exact, 1 / min_depth)  # what is nearer does not occur
    assert (np.abs(steps - limited) <= 2.5 / 65500 / min_depth + 2**-15 * exact).all()
    cloudy = replace(TINY, truths=(), truth_of="whole")
    list(render_set(tmp_path / "cloudy" / "test", cloudy, (706,), SEED))
    assert np.array_equal(osl.load_dataset(tmp_path / "cloudy" / "test")[0].inverse_depth, exact)


def test_room_and_its_rig_come_from_the_set(no_blender, tmp_path, monkeypatch):
    poses = [osl.Pose.from_vector([0, 0, 0, x, 0, 0]) for x in (1.0, 2.0)]
    room = SimpleNamespace(build_room=lambda light, seed: 1.0, room_pose=lambda index: poses[index])
    monkeypatch.setitem(sys.modules, "workshop.render.indoor.living_room", room)
    images = replace(SETS["indoor/test"], size=(25, 24), truths=((16, 4),))
    assert list(render_set(tmp_path, images, images.shipped, SEED)) == [1, 2]
    data = osl.load_dataset(tmp_path)
    assert data.rig.min_depth == make_rig(SEED, "handheld").min_depth
    # the stand-in's noise follows the pose; JPEG keeps most of it
    for frame, pose in zip(data, poses, strict=True):
        rng = np.random.default_rng((pose.t * 1e6).astype(int))
        pictures = [rng.integers(0, 255, (24, 25, 3), np.uint8) for _ in range(4)]
        assert (
            np.corrcoef(pictures[3].mean(-1).ravel(), frame.images[3].mean(-1).ravel())[0, 1] > 0.5
        )


def test_forgetting_leaves_other_machines_and_files_alone(no_blender, tmp_path):
    list(render_set(tmp_path, TINY, (706,), SEED))
    (tmp_path / "cam1" / "0731.jpg").write_bytes(b"of a killed run")
    (tmp_path / "cam1" / ".0732.jpg").write_bytes(b"another machine is at it")
    (tmp_path / "cam1" / "notes.jpg").write_bytes(b"of somebody")
    before = contents(tmp_path)
    assert forget_partial(tmp_path, TINY, (706, 731)) == [tmp_path / "cam1" / "0731.jpg"]
    del before[Path("cam1/0731.jpg")]
    assert contents(tmp_path) == before


@given(st.lists(st.integers(1, 1000), unique=True, max_size=40), st.integers(1, 12))
@settings(deadline=None)
def test_shards_share_all_frames_out(numbers, parts):
    shards = [select_shard(tuple(numbers), f"{part}/{parts}") for part in range(1, parts + 1)]
    assert sorted(itertools.chain(*shards)) == sorted(numbers)
    assert max(map(len, shards)) - min(map(len, shards)) <= 1


@given(st.lists(st.floats(1e-9, 1e3), min_size=1))
@settings(deadline=None)
def test_truth_is_rounded_by_little(values):
    rounded = frames_module._rounded(np.array(values))
    assert rounded.dtype == np.float32
    np.testing.assert_allclose(rounded, values, rtol=2**-15)
    assert frames_module._rounded(np.zeros(1)) == 0


def test_manifest_lists_every_file_but_itself(tmp_path):
    (tmp_path / "set" / "cam1").mkdir(parents=True)
    (tmp_path / "set" / "cam1" / "0001.jpg").write_bytes(b"picture")
    (tmp_path / "set" / "cam1" / ".0002.jpg").write_bytes(b"half a picture")
    (tmp_path / "set" / ".0003").mkdir()
    (tmp_path / "set" / ".0003" / "0003.jpg").write_bytes(b"of half a frame")
    for _ in range(2):  # the second time there is one already
        write_manifest(tmp_path, 5, "python -m workshop.render")
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert manifest["seed"] == 5 and manifest["command"] == "python -m workshop.render"
    assert manifest["files"] == {"set/cam1/0001.jpg": hashlib.sha256(b"picture").hexdigest()}
    (tmp_path / "weights").write_bytes(b"trained")
    renew_manifest(tmp_path)
    renewed = json.loads((tmp_path / "manifest.json").read_text())
    assert renewed == manifest | {
        "files": {**manifest["files"], "weights": hashlib.sha256(b"trained").hexdigest()}
    }


# The command line


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["moon/test"], ["moon/test", "sunny/train"]),
        (["sunny/test", "--frames", "700"], ["701 to 1000", "700"]),
        (["sunny/train", "--frames", "3", "701"], ["1 to 700", "701"]),
        (["rooms/train", "--frames", "141"], ["1 to 140", "141"]),
        (["--shard", "0/4"], ["i/n", "0/4"]),
        (["--shard", "half"], ["i/n", "half"]),
        (["--seed", "-1"], ["seed", "-1"]),
    ],
)
def test_bad_arguments_are_said_in_one_line(arguments, words, capsys):
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1
    assert all(word in error for word in words)


@pytest.mark.parametrize(
    "environment", [Path(".venv-render"), Path(sys.prefix)], ids=["missing", "without Blender"]
)
def test_an_unfinished_environment_says_how_to_make_it(environment, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(
        render, "_BLENDER_PYTHON", tmp_path / environment / "bin" / Path(sys.executable).name
    )
    monkeypatch.setattr(render.importlib.util, "find_spec", lambda name: None)
    assert main(["--out", str(tmp_path)]) == 2
    assert "missing or unfinished" in (said := capsys.readouterr().err)
    assert "run make render" in said


def test_blender_environment_gets_the_same_job(monkeypatch, tmp_path):
    python = tmp_path / ".venv-render" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.touch()
    calls = []
    monkeypatch.setattr(render, "_BLENDER_PYTHON", python)
    monkeypatch.setattr(render.importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(
        render.subprocess,
        "run",
        lambda command, **_: calls.append(command) or SimpleNamespace(returncode=7),
    )
    monkeypatch.chdir(tmp_path)
    job = ["sunny/test", "--frames", "706", "831", "--shard", "2/2", "--seed", "3"]
    assert main([*job, "--out", "here"]) == 7  # the exit status is the renderer's
    command = [python, "-m", "workshop.render", *job, "--out", tmp_path / "here"]
    assert list(map(str, calls[0])) == list(map(str, command))
