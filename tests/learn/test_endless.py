"""Endless worlds: frames by number, of many kinds; images agree with the depth."""

from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import pytest
import torch
from tiny import SWEEPNET

import omnistereo_lib as osl
from omnistereo_learn.endless import worlds as endless
from omnistereo_learn.endless.caster import ELLIPSOID, LIGHT, PRIMITIVE
from omnistereo_learn.endless.worlds import (
    EndlessFrame,
    EndlessWorlds,
    Scene,
    draw_frame,
    misstated,
    turned,
    with_glare,
)
from omnistereo_learn.recipes import VolumeNetRecipe
from omnistereo_learn.samples.spheres import SphereSamples
from omnistereo_learn.samples.volumes import VolumeSamples
from omnistereo_lib import reference
from omnistereo_lib.geometry.pose import Pose
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
        assert np.isfinite(radiance[visible]).all()
        assert (radiance[visible] >= 0).all()
        assert radiance[visible].std() > 0
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
    """A point's gray values in the cameras differ less than those of points at wrong depths."""
    rays = osl.SphereGrid(128, 32).rays()
    better = []
    for frame in frames[:4]:
        seen = list(map(frame.scene.image, frame.rig.cameras, frame.rig.T_rig_cam))
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


def test_faults_change_images_and_the_rig_file_alone(frames):
    frame = draw_frame(7, 3, faults=True)
    assert np.array_equal(frame.scene.primitives, frames[3].scene.primitives)
    assert frame.rig.min_depth == frames[3].rig.min_depth
    assert np.allclose(frame.rig.centers, frames[3].rig.centers)
    assert not np.array_equal(frame.images[0], frames[3].images[0])
    again = EndlessWorlds(7, workers=1, faults=True).frame(3)
    assert all(np.array_equal(a, b) for a, b in zip(frame.images, again.images, strict=True))


def test_the_images_show_by_how_much_a_rig_file_is_off(frames):
    """Corners followed from the picture of the true camera to that of the stated one: the turn
    between their directions, found by Kabsch's method, is the error of the orientation."""
    for frame in (frames[1], frames[4]):
        camera, true = frame.rig.cameras[0], frame.rig.T_rig_cam[0]
        stated = misstated(frame.rig, np.random.default_rng(3), 1.0, 0.0).T_rig_cam[0]
        pictures = [
            (200 * np.nan_to_num(frame.scene.image(camera, pose)).clip(0, 1)).astype(np.uint8)
            for pose in (true, stated)
        ]
        # Not at the rim, which does not move.
        inner = cv2.erode(camera.visible_pixels().astype(np.uint8), np.ones((41, 41)))
        corners = cv2.goodFeaturesToTrack(pictures[0], 200, 0.01, 8, mask=inner)
        moved, found, _ = cv2.calcOpticalFlowPyrLK(*pictures, corners, None)
        a, b = (camera.unproject(uv[found == 1])[0] for uv in (corners, moved))
        for _ in range(5):  # each time without the tenth that fits least
            U, _, Vt = np.linalg.svd(a.T @ b)
            rest = np.linalg.norm(a @ U @ Vt - b, axis=1)
            fits = rest <= np.quantile(rest, 0.9)
            a, b = a[fits], b[fits]
        off = stated.inverse() @ true
        unexplained = Pose(U @ Vt, np.zeros(3)) @ off
        assert np.linalg.norm(off.as_vector()[:3]) > np.radians(3)
        assert np.linalg.norm(unexplained.as_vector()[:3]) < np.radians(0.1)


def test_a_rig_file_is_off_by_twentieths_of_a_degree_and_thirds_of_a_pixel(frames):
    rng, rig = np.random.default_rng(0), frames[0].rig
    stated = [misstated(rig, rng) for _ in range(200)]
    turns = [(one.T_rig_cam[0].inverse() @ rig.T_rig_cam[0]).as_vector()[:3] for one in stated]
    shifts = [np.subtract(one.cameras[0].center, rig.cameras[0].center) for one in stated]
    assert np.allclose(np.degrees(np.std(turns, axis=0)), 0.05, rtol=0.15)
    assert np.allclose(np.std(shifts, axis=0), 0.3, rtol=0.15)


def test_a_turn_about_the_axis_blurs_a_star_by_the_sinc(frames):
    """The mean of cos 6α over a turn of ω is cos 6α times sin(3 ω) / (3 ω); a mean stays."""
    camera, turn = replace(frames[0].rig.cameras[0], affine=(1, 0, 0)), np.radians(20)
    height, width = camera.image_size[::-1]
    y, x = np.mgrid[:height, :width].astype(float)
    x, y = x - camera.center[0], y - camera.center[1]
    ring = np.abs(np.hypot(x, y) / camera.max_radius - 0.5) < 0.2
    star = np.cos(6 * np.arctan2(y, x))
    gray = np.where(camera.visible_pixels(), 2 + star, np.nan).astype(np.float32)
    blurred = turned(gray, camera, np.array([0, 0, turn]))
    assert np.array_equal(np.isnan(blurred), np.isnan(gray))
    assert blurred[ring].mean() == pytest.approx(gray[ring].mean(), abs=1e-3)
    strength = np.mean((blurred[ring] - 2) * star[ring]) / np.mean(star[ring] ** 2)
    assert strength == pytest.approx(np.sin(3 * turn) / (3 * turn), abs=0.01)


def test_glare_is_where_the_sun_is_unless_something_hides_it():
    light, ball = np.zeros(1, LIGHT)[0], np.zeros(1, PRIMITIVE)
    light["sun"], light["to_sun"] = 1, (0.6, 0, 0.8)
    ball["shape"], ball["half"], ball["rotation"], ball["roundness"] = ELLIPSOID, 0.5, np.eye(3), 1
    rig = osl.load_rig("data_samples/sunny/test")
    camera, pose = rig.cameras[0], Pose.from_vector([0.1, 0.2, 0, 0, 0, 0])
    gray = np.where(camera.visible_pixels(), 1, np.nan).astype(np.float32)
    for centre, dazzled in (((0, 5, 0), True), ((3, 0, 4), False)):
        ball["center"] = centre
        veil = with_glare(gray, camera, pose, Scene(ball, light), 0.5) - 1
        assert (np.nanmax(veil) > 0) == dazzled
        if dazzled:
            uv = reference.project(torch.tensor(pose.R.T @ light["to_sun"]), camera)
            brightest = np.unravel_index(np.nanargmax(veil), veil.shape)
            assert np.abs(uv.numpy() - brightest[::-1]).max() <= 0.5
            assert np.nanmax(veil) == pytest.approx(0.5, abs=1e-3)


@pytest.fixture
def undrawn(monkeypatch):
    """Endless frames without pictures; their seed lies where the rig would."""
    monkeypatch.setattr(
        "omnistereo_learn.samples.frames.EndlessWorlds", partial(EndlessWorlds, workers=0)
    )
    monkeypatch.setattr(
        endless, "draw_frame", lambda seed, number, **_: EndlessFrame(number, seed, [], None)
    )


def test_folders_and_endless_worlds_are_mixed_by_weight(data, undrawn):
    samples = VolumeSamples(TINY, ["endless", data, "endless"])
    kinds = [samples._split(number) for number in range(6)]
    assert kinds == [(False, 0), (True, 0), (True, 1), (False, 1), (True, 2), (True, 3)]
    assert samples.training_frame(0) in samples.training
    assert samples.validation_frame(0) in samples.validation
    training, validation = samples.training_frame(2), samples.validation_frame(1)
    assert (training.number, validation.number) == (1, 0)
    assert training.rig == TINY.seed != validation.rig
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
