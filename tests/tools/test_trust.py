"""Trust: how often a depth with such error bars is right, and none without evidence."""

from dataclasses import replace

import numpy as np
import pytest
import scene

import omnistereo_lib as osl
from omnistereo_learn.evaluate.run import DATA
from omnistereo_lib.stereo.error_bars import WITHIN
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_tools.judge.trust import DOUBTFUL, likely, may_be_nearer, trust

GRID = osl.SphereGrid(160, 40, num_spheres=192, min_depth=0.9)  # all of which two cameras see


@pytest.fixture(scope="module")
def box():
    rig = scene.rig(width=200, height=192)
    return rig, scene.true_index(rig, GRID).astype(np.float32), scene.images(rig, finest=0.25)


@pytest.mark.parametrize("index", [150, 60, 20])
def test_it_is_how_often_such_a_depth_is_right(box, index):
    """Of errors with a long tail, drawn at random, with the bars of that tail."""
    rig, _, images = box
    off = np.random.default_rng(0).laplace(0, 0.06 * index, 200_000) / 1.5
    sigma, bound = np.quantile(np.abs(off), WITHIN) * GRID.step
    values = (np.full(GRID.shape, value) for value in (index, 1.0, sigma, bound))
    at, confidence, *bars = values
    depth = osl.Depth(at, confidence, SphereSweep(rig, GRID), images, *bars)
    right = np.mean(np.abs(off) <= max(2, 0.1 * index))
    assert float(trust(depth).max()) == pytest.approx(right, abs=0.03)


def test_the_curve_goes_through_both_bars():
    found = likely([0.0, 1.0, 3.0, 1e9], 1.0, 3.0)
    np.testing.assert_allclose(found, [0, *WITHIN, 1], atol=1e-3)
    assert np.isnan(likely(1.0, np.nan, np.nan))


def test_a_depth_of_unknown_confidence_is_not_trusted(box):
    rig, index, images = box
    depth = osl.Depth(index, np.full_like(index, np.nan), SphereSweep(rig, GRID), images)
    assert not trust(depth).any()


def test_on_the_last_spheres_it_may_be_nearer(box):
    rig, _, images = box
    index = np.full(GRID.shape, 190, np.float32)
    assert not trust(osl.Depth(index, np.ones_like(index), SphereSweep(rig, GRID), images)).any()


def test_where_a_nearer_thing_would_be_seen_by_one_camera_only_it_is_doubtful():
    """Two cameras 0.6 m apart that look along +z, of 150°: each sees a cone of 75°."""
    lens = scene.camera(200, 192, 150)
    rig = osl.Rig([lens] * 2, [osl.Pose.from_vector([0, 0, 0, x, 0, 0]) for x in (-0.3, 0.3)])
    grid = osl.SphereGrid(160, 40, num_spheres=64, min_depth=0.5)
    found = 4.0  # metres
    images = [np.full((192, 200), 128.0)] * 2
    index = np.full(grid.shape, grid.depth_to_index(found))
    depth = osl.Depth(index, np.ones(grid.shape), SphereSweep(rig, grid), images)
    rays, counts = grid.rays(), []
    for d in np.linspace(grid.min_depth, found, 100):
        points = [d * rays - [x, 0, 0] for x in (-0.3, 0.3)]
        counts.append(
            sum(p[..., 2] / np.linalg.norm(p, axis=-1) > np.cos(np.radians(75)) for p in points)
        )
    hidden = np.min(counts, axis=0) < 2
    seen = counts[-1] == 2  # at the depth found
    assert (may_be_nearer(depth) == hidden)[seen].mean() > 0.97 and 0.02 < hidden[seen].mean() < 0.5
    trusted = trust(depth)
    assert trusted[may_be_nearer(depth)].max() == DOUBTFUL
    assert (trusted[seen & ~may_be_nearer(depth)] == 1).mean() > 0.95


def test_black_and_white_are_no_evidence(box):
    rig, index, images = box
    depth = osl.Depth(index, np.ones_like(index), SphereSweep(rig, GRID), images)
    assert (trust(depth)[:, 5:-5] == 1).mean() > 0.99
    # the left half of each
    blown = [np.where(np.indices(image.shape)[1] < 100, 255, image) for image in images]
    unlit = trust(replace(depth, frame=blown)) == 0
    seen = np.stack(depth.sweep.warp(blown, index))
    few = (np.isfinite(seen) & (seen < 250)).sum(0) < 2
    assert few.mean() > 0.2 and (unlit == few).mean() > 0.97  # but for the median at their borders
    dark = replace(depth, frame=[np.zeros_like(image) for image in images])
    assert not trust(dark).any()


def test_small_things_in_mid_air_of_little_trust_are_doubtful(box):
    rig, index, images = box
    sweep, rays = SphereSweep(rig, GRID), np.s_[15:20, [158, 159, 0, 1, 2]]  # across the seam

    def doubtful(index, confidence):
        return trust(osl.Depth(index, confidence, sweep, images)) < DOUBTFUL

    near, weak = index.copy(), np.ones_like(index)
    near[rays], weak[rays] = 1.5 * index[rays].max(), 0.6
    assert doubtful(near, weak)[rays].all() and not doubtful(near, np.ones_like(index))[rays].any()
    larger, of_larger = index.copy(), np.ones_like(index)
    larger[5:35, 40:80], of_larger[5:35, 40:80] = 1.5 * index.max(), 0.6  # a fifth of the panorama
    behind, of_behind = 1.5 * index, np.ones_like(index)
    behind[rays], of_behind[rays] = index[rays], 0.6
    for changed, confidence in ((larger, of_larger), (behind, of_behind)):
        assert doubtful(changed, confidence)[confidence < 1].mean() < 0.1


def test_on_a_frame_it_was_not_fitted_on_doubtful_depths_are_worse_at_every_range():
    frame = osl.load_dataset(DATA / "sunny", split="test")[1]
    grid = osl.SphereGrid(480, 120, num_spheres=192, min_depth=frame.rig.min_depth)
    depth = osl.estimate_depth(frame, grid, "zncc+sgm")
    truth = frame.gt_index(grid)
    with np.errstate(invalid="ignore"):  # infinity, found and true
        off = np.abs(depth.depth / grid.index_to_depth(truth) - 1) > 0.1
    wrong, doubtful = off & (np.abs(depth.index - truth) > 2), trust(depth) < DOUBTFUL
    for nearest, farthest in ((60, 192), (20, 60), (1, 20)):  # spheres, numbered from infinity
        rays = np.isfinite(truth) & (depth.index >= nearest) & (depth.index < farthest)
        assert wrong[rays & doubtful].mean() > 1.5 * wrong[rays & ~doubtful].mean() > 0
