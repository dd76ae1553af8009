"""Endless worlds: frames by number alone, finite, of many kinds; the images agree with the
depth.
"""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from tiny import SWEEPNET

import omnistereo_lib as osl
from omnistereo_learn.endless import worlds as endless
from omnistereo_learn.endless.worlds import EndlessFrame, EndlessWorlds, draw_frame
from omnistereo_learn.recipes import VolumeNetRecipe
from omnistereo_learn.samples.spheres import SphereSamples
from omnistereo_learn.samples.volumes import VolumeSamples
from omnistereo_lib.stereo import correlation

TINY = VolumeNetRecipe(
    worlds="endless",
    width=64,
    height=16,
    num_spheres=16,
    steps=3,
    validate_every=3,
    validation_groups=1,
    warmup=2,
)


@pytest.fixture(scope="module")
def frames():
    return [draw_frame(7, number) for number in range(6)]


@pytest.fixture(autouse=True)
def small(monkeypatch):
    monkeypatch.setattr(correlation, "COARSE", (32, 8))
    monkeypatch.setattr(endless, "_AHEAD", 1)


def test_a_frame_is_its_seed_and_number(frames):
    again = EndlessWorlds(7, workers=1).frame(3)  # drawn by another process
    assert all(np.array_equal(a, b) for a, b in zip(frames[3].images, again.images, strict=True))
    assert frames[3].rig.min_depth == again.rig.min_depth
    assert np.array_equal(frames[3].scene.primitives, again.scene.primitives)
    assert not np.array_equal(draw_frame(8, 3).images[0], frames[3].images[0])


def test_frames_are_finite_and_of_many_kinds(frames):
    grid = osl.SphereGrid(64, 16, min_depth=1.0)
    for frame in frames:
        radiance = frame.scene.image(frame.rig.cameras[0], frame.rig.T_rig_cam[0])
        visible = frame.rig.cameras[0].visible_pixels()
        assert (
            np.isfinite(radiance[visible]).all()
            and (radiance[visible] >= 0).all()
            and radiance[visible].std() > 0
        )
        index = frame.gt_index(grid)
        assert np.isfinite(index).all() and (index >= 0).all()
        nearest = 1 / frame.scene.inverse_depth_along(osl.SphereGrid(160, 40).rays()).max()
        assert 0.19 < frame.rig.min_depth / min(nearest, 100) < 0.71
        for center in frame.rig.centers:  # no camera stands in something
            assert 1 / frame.scene.inverse_depth_along(grid.rays(), center).max() > 0.02
    assert {len(frame.rig) for frame in frames} > {3, 4}
    fields = [camera.max_fov_deg for frame in frames for camera in frame.rig.cameras]
    baselines = [frame.rig.baselines.max() for frame in frames]
    assert min(fields) < 185 and max(fields) > 215 and max(baselines) > 4 * min(baselines)


def test_cameras_agree_at_the_true_depth(frames):
    """The gray values of a point in the cameras that see it differ less than those of points at
    wrong depths."""
    rays = osl.SphereGrid(128, 32).rays()
    better = []
    for frame in frames[:4]:
        seen = [
            frame.scene.image(*view)
            for view in zip(frame.rig.cameras, frame.rig.T_rig_cam, strict=True)
        ]
        inverse = frame.inverse_depth_along(rays)
        points = [rays / np.maximum(scale * inverse, 1e-3)[..., None] for scale in (1, 2.5)]
        right, wrong = (_spread(frame.rig, seen, at) for at in points)
        better.append(right < 0.8 * wrong)
    assert sum(better) >= 3  # walls without texture agree at any depth


def _spread(rig, seen, points):
    values = []
    for camera, pose, gray in zip(rig.cameras, rig.T_rig_cam, seen, strict=True):
        uv, valid = camera.project(pose.inverse() @ points)
        column, row = np.rint(uv).astype(int).transpose(2, 0, 1)
        height, width = gray.shape
        values.append(
            np.where(valid, gray[row.clip(0, height - 1), column.clip(0, width - 1)], np.nan)
        )
    shared = np.isfinite(values).sum(0) > 1
    return np.median(np.nanstd(np.array(values)[:, shared], 0))


@pytest.fixture
def undrawn(monkeypatch):
    """Endless frames without pictures, which would take a second each; their seed lies where the
    rig would."""
    monkeypatch.setattr(
        "omnistereo_learn.samples.frames.EndlessWorlds", partial(EndlessWorlds, workers=0)
    )
    monkeypatch.setattr(
        endless, "draw_frame", lambda seed, number: EndlessFrame(number, seed, [], None)
    )


def test_folders_and_endless_worlds_are_mixed_by_weight(data, undrawn):
    samples = VolumeSamples(TINY, ["endless", data, "endless"])
    kinds = [samples._split(number) for number in range(6)]
    assert kinds == [(False, 0), (True, 0), (True, 1), (False, 1), (True, 2), (True, 3)]
    assert (
        samples.training_frame(0) in samples.training
        and samples.validation_frame(0) in samples.validation
    )
    training, validation = samples.training_frame(2), samples.validation_frame(1)
    assert (training.number, validation.number) == (
        1,
        0,
    ) and training.rig == TINY.seed != validation.rig
    assert samples.metadata["folder"].startswith("endless, ") and samples.metadata["frames"] == 4


def test_a_frame_serves_the_micro_batches_that_follow(undrawn, monkeypatch):
    samples, seen = VolumeSamples(replace(TINY, batch_frames=3), ["endless"]), []
    monkeypatch.setattr(samples, "_sample", lambda frame, rng: seen.append(frame.number))
    samples.micro_batch(samples.training_frame(5), np.random.default_rng(0), augment=True)
    assert seen == [5, 6, 7]


def test_a_network_of_pairs_trains_in_endless_worlds():
    samples = SphereSamples(replace(SWEEPNET, worlds="endless", width=96, height=24), ["endless"])
    samples.endless = EndlessWorlds(0, workers=0)
    batch = samples.micro_batch(samples.training_frame(1), np.random.default_rng(0), augment=True)
    loss, error = samples.objective(batch)
    assert torch.isfinite(loss) and 0 <= error <= 1
