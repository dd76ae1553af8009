"""Error bars: the compiled distribution against the plain one, and how many errors they hold."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scene import refused

import omnistereo_lib as osl
from omnistereo_lib.geometry.rig import Deviation
from omnistereo_lib.geometry.sensitivity import calibration_deviation, inverse_depth_shifts
from omnistereo_lib.stereo.error_bars import WITHIN, distribution, distribution_by_torch
from omnistereo_lib.stereo.kernels.distribution_numba import exp_of_minus

GRID = osl.SphereGrid(160, 40, num_spheres=96, min_depth=1.65)


@pytest.mark.parametrize(("temperature", "spheres"), [(0.0, 48), (2.0, 96), (2.0, 20)])
def test_the_compiled_distribution_is_the_plain_one(temperature, spheres):
    rng = torch.Generator().manual_seed(0)
    cells = torch.rand(12, 30, spheres, generator=rng)
    volume = cells**0.1 if temperature == 0 else 30 * cells
    volume[torch.rand(volume.shape, generator=rng) < 0.1] = torch.nan
    index = torch.rand(12, 30, generator=rng) * (spheres - 1)
    index[0, 0] = torch.nan
    found = distribution(volume, index, temperature).numpy()
    plain = distribution_by_torch(volume, index, temperature, max(1.0, spheres / 32)).numpy()
    known = np.isfinite(index.numpy())
    np.testing.assert_allclose(found[:, known], plain[:, known], rtol=1e-4, atol=1e-4)
    assert np.isnan(found[:, ~known]).all()


def test_the_exponential_is_that_of_numpy():
    x = np.linspace(0, 15, 30_001, dtype=np.float32)
    found = np.array([exp_of_minus(one) for one in x])
    np.testing.assert_allclose(found, np.exp(-x.astype(float)), rtol=1.1e-5)


def test_a_distribution_of_two_spikes():
    volume = torch.ones(1, 1, 64)
    volume[..., 20], volume[..., 50] = 0.25, 0.75  # three quarters at 20, a quarter at 50
    spread, mass, inside, second, at = distribution(volume, torch.tensor([[20.0]]), 0.0)[:, 0, 0]
    assert (mass, inside, second, at) == pytest.approx((0.75, 0, 0.25, 50))
    assert spread == pytest.approx(30 * 0.25**0.5)


@pytest.mark.parametrize("method", ["volumenet", "zncc+sgm"])
def test_the_bars_hold_as_many_errors_as_they_say(method):
    """On one frame, of which the share varies from frame to frame by a tenth and more."""
    frame = osl.load_dataset("data_samples/sunny", split="test").frame(831)
    depth = osl.estimate_depth(frame, GRID, method)
    off = np.abs(depth.inverse_depth - frame.inverse_depth_along(GRID.rays()))
    known = np.isfinite(off)
    assert (np.isfinite(depth.sigma) == depth.valid).all() and (depth.bound >= depth.sigma).all()
    shares = [np.mean(off[known] <= width[known]) for width in (depth.sigma, depth.bound)]
    assert WITHIN[0] - 0.15 < shares[0] < WITHIN[0] + 0.2 and WITHIN[1] - 0.06 < shares[1]


def test_a_method_that_was_not_measured_has_none():
    frame = osl.load_dataset("data_samples/sunny", split="test")[0]
    depth = osl.estimate_depth(
        frame, osl.SphereGrid(64, 16, num_spheres=16, min_depth=1.65), "zncc"
    )
    assert depth.sigma.shape == depth.index.shape and np.isnan(depth.sigma).all()


def test_a_rotated_camera_moves_the_depth_by_the_angle_over_the_baseline():
    ahead = np.array([0.0, 0, 1])
    for baseline, depth in ((0.2, 10.0), (1.0, 30.0)):
        centers = np.array([[-baseline / 2, 0, 0], [baseline / 2, 0, 0], [0, 9, 0]])
        seen = np.array([True, True, False])
        shifts = inverse_depth_shifts(ahead, np.array(1 / depth), centers, seen)
        assert shifts == pytest.approx([1 / baseline, 1 / baseline, 0], rel=0.01)
    assert np.isnan(inverse_depth_shifts(ahead, np.array(0.1), centers, seen & False)).all()


def test_the_calibration_widens_the_bars_by_what_it_does_to_the_depth():
    """Against the depth of a point found by rig after rig, each drawn from the deviations."""
    rig = osl.load_rig("data_samples/sunny/test").recentered()
    one = Deviation(np.radians(0.1), 0.003)
    stated = replace(rig, deviations=(one,) * 4)
    ray, inverse = np.array([0.6, 0.0, 0.8]), 0.1
    seen = np.array([True, True, False, True])
    rng, found = np.random.default_rng(0), []
    for _ in range(400):
        centers = rig.centers[seen] + rng.normal(0, one.center / 3**0.5, (3, 3))
        found.append(_fitted(ray, inverse, rig.centers[seen], centers, one.rotation, rng))
    expected = calibration_deviation(stated, ray, np.array(inverse), seen)
    assert np.std(found) == pytest.approx(float(expected), rel=0.15)


def _fitted(ray, inverse, centers, moved, angle, rng):
    """The inverse depth at which the directions, each rotated at random, fit best: closed form."""
    step = 1e-6

    def directions(q, places):
        towards = ray - q * places
        return towards / np.linalg.norm(towards, axis=-1, keepdims=True)

    slopes = (directions(inverse + step, centers) - directions(inverse, centers)) / step
    turns = rng.normal(0, angle / 3**0.5, (len(centers), 3))
    off = directions(inverse, moved) + np.cross(turns, directions(inverse, centers))
    off -= directions(inverse, centers)
    a, b = ((x - x.mean(0)).ravel() for x in (slopes, off))
    return a @ b / (a @ a)


def test_a_rig_that_states_its_deviations_has_wider_bars_and_keeps_them_on_file(tmp_path):
    frame = osl.load_dataset("data_samples/sunny", split="test")[1]
    stated = replace(frame.rig, deviations=[Deviation(0.02, 0.01, 0.001)] * 4)
    grid = osl.SphereGrid(64, 16, num_spheres=16, min_depth=1.65)
    depths = [
        osl.estimate_depth(osl.Frame.of(rig, frame.images), grid, "zncc+sgm")
        for rig in (frame.rig, stated)
    ]
    assert (depths[1].index == depths[0].index).all()
    assert (depths[1].sigma >= depths[0].sigma).all()
    assert (depths[1].sigma > 1.01 * depths[0].sigma).any()
    osl.save_rig(stated, tmp_path / "rig.yaml")
    again = osl.load_rig(tmp_path / "rig.yaml")
    assert again.deviations == tuple(stated.deviations) == again.recentered().deviations
    assert osl.load_rig("data_samples/sunny/test").deviations == ()


def test_deviations_that_cannot_be_are_refused():
    rig = osl.load_rig("data_samples/sunny/test")
    with refused("4 cameras and 1 deviations"):
        replace(rig, deviations=[Deviation()])
    with refused("rotation deviation of camera 1"):
        replace(rig, deviations=[Deviation(-1.0)] * 4)
