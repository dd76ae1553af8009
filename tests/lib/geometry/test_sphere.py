"""Rays and spheres against formulas written out by hand."""

from math import cos, pi, radians, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from omnistereo_lib import SphereGrid

W, H = 64, 20

# θ of a column and φ of a row (down positive, half height 45°), as the three published codes have
# them.
BY_HAND = {
    "center": (
        lambda x: (x + 0.5 - W / 2) / (W / 2) * pi,
        lambda y: (y + 0.5 - H / 2) / (H / 2) * radians(45),
    ),
    "sweepnet": (
        lambda x: (x + 1 - W / 2) / (W / 2) * pi,
        lambda y: (y + 1 - H / 2) / (H / 2) * radians(45),
    ),
    "omnimvs": (
        lambda x: (x - W / 2) / (W / 2) * pi,
        lambda y: (y - (H - 1) / 2) / ((H - 1) / 2) * radians(45),
    ),
}


@pytest.mark.parametrize("sampling", BY_HAND)
def test_rays_follow_the_published_half_pixel_rules(sampling):
    grid = SphereGrid(W, H, sampling=sampling)
    rays = grid.rays()
    assert rays.shape == (H, W, 3)
    theta_of, phi_of = BY_HAND[sampling]
    for row in (0, 1, 7, H - 1):
        for column in (0, 5, W // 2, W - 1):
            theta, phi = theta_of(column), phi_of(row)
            by_hand = cos(phi) * sin(theta), sin(phi), cos(phi) * cos(theta)
            np.testing.assert_allclose(rays[row, column], by_hand, atol=1e-14)


@pytest.mark.parametrize("sampling", BY_HAND)
@pytest.mark.parametrize("phi_deg", [(-45, 45), (-90, 90), (-10, 60)])
def test_pixels_of_rays_come_back(sampling, phi_deg):
    grid = SphereGrid(W, H, phi_deg=phi_deg, sampling=sampling)
    pixels, valid = grid.project(3.7 * grid.rays())
    column, row = np.meshgrid(np.arange(W), np.arange(H))
    # every column is the same ray there
    poles = np.hypot(grid.rays()[..., 0], grid.rays()[..., 2]) < 1e-9
    assert valid.all()
    np.testing.assert_allclose(pixels[..., 1], row, atol=1e-9)
    turns = (pixels[..., 0] - column)[~poles] / W
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-10)


def test_directions_above_and_below_are_not_in_the_panorama():
    valid = SphereGrid(W, H).project([[0, 5, 1], [0, -5, 1], [0, 0.9, 1], [0, 0, -1]])[1]
    assert valid.tolist() == [False, False, True, True]


def test_inverse_depths_are_the_papers():
    grid = SphereGrid(W, H, num_spheres=192, min_depth=0.55)
    np.testing.assert_allclose(
        grid.inverse_depths(), [n / (0.55 * 191) for n in range(192)], atol=1e-15
    )
    assert grid.index_to_depth(0) == np.inf and grid.index_to_depth(191) == pytest.approx(0.55)
    assert grid.depth_to_index(np.inf) == 0
    assert grid.depth_to_index(0.4) > 191


def test_a_finite_far_end():
    grid = SphereGrid(W, H, num_spheres=5, min_depth=0.5, max_depth=10)
    np.testing.assert_allclose(1 / grid.inverse_depths(), [10, 1 / 0.575, 1 / 1.05, 1 / 1.525, 0.5])
    assert grid.depth_to_index(10) == pytest.approx(0)


@settings(deadline=None)
@given(st.integers(2, 400), st.floats(0.01, 100), st.floats(1.01, 1e6), st.floats(0, 1))
def test_index_and_depth_are_inverse(num_spheres, min_depth, ratio, part):
    for far in (np.inf, min_depth * ratio):
        grid = SphereGrid(W, H, num_spheres=num_spheres, min_depth=min_depth, max_depth=far)
        index = part * (num_spheres - 1)
        back = grid.depth_to_index(grid.index_to_depth(index))
        assert back == pytest.approx(index, abs=1e-6)
        assert grid.inverse_depth_to_index(grid.index_to_inverse_depth(index)) == pytest.approx(
            index, abs=1e-6
        )


def test_a_grid_can_be_a_key():
    assert hash(SphereGrid(W, H, [-45, 45])) == hash(SphereGrid(W, H, (-45, 45)))
