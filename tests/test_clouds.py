"""Clouds painted onto training frames: at infinity for every camera, in the sky alone, drawn from the seed."""

import cv2
import numpy as np
import pytest
import scene

import omnistereo_lib as osl
from omnistereo_lib.train.clouds import Clouds

GRID = osl.SphereGrid(96, 24, (-45, 45), 12, 0.6)
HORIZON = np.radians(-5)


@pytest.fixture(scope="module")
def clouds():
    return Clouds(scene.rig(width=200, height=192).centered(), GRID)


@pytest.fixture(scope="module")
def gray(clouds):
    return [np.full(camera.image_size[::-1], 100, np.float32) for camera in clouds.rig.cameras]


@pytest.fixture(scope="module")
def index():
    """Sky above the horizon, a wall below it."""
    return np.where(GRID.phis()[:, None] < HORIZON, 0, 5) * np.ones(GRID.width, np.float32)


def elevation(directions):
    return np.arctan2(directions[..., 1], np.hypot(directions[..., 0], directions[..., 2]))


def test_every_camera_sees_the_same_clouds_in_the_same_direction(clouds, gray, index):
    painted = clouds.paint(gray, index, np.random.default_rng(0))
    high = elevation(clouds.directions[0]) < np.radians(-30)
    turn = clouds.rig.T_rig_cam[1].R.T  # at infinity nothing but the rotation counts
    uv, seen = clouds.rig.cameras[1].project(clouds.directions[0] @ turn.T)
    other = cv2.remap(painted[1], uv.astype(np.float32), None, cv2.INTER_LINEAR)
    inside = np.all((uv >= 1) & (uv <= np.array(gray[1].shape[::-1]) - 2), axis=-1)
    _, own = clouds.rig.cameras[0].unproject(np.stack(np.meshgrid(np.arange(200), np.arange(192)), -1))
    both = high & seen & inside & own
    assert both.sum() > 300 and painted[0][both].std() > 0.5
    assert np.abs(painted[0] - other)[both].mean() < 0.15 * painted[0][both].std()


def test_only_the_sky_gets_clouds(clouds, gray, index):
    painted = clouds.paint(gray, index, np.random.default_rng(1))
    for before, after, directions in zip(gray, painted, clouds.directions, strict=True):
        below = elevation(directions) >= HORIZON
        np.testing.assert_array_equal(after[below], before[below])
        assert (after != before).any() and after.min() >= 0 and after.max() <= 255
    street = clouds.paint(gray, np.full(GRID.shape, 5, np.float32), np.random.default_rng(1))
    np.testing.assert_array_equal(street, gray)


def test_the_seed_decides(clouds, gray, index):
    first, again, other = (clouds.paint(gray, index, np.random.default_rng(seed)) for seed in (2, 2, 3))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_a_sky_all_around_has_no_seam(clouds, gray, monkeypatch):
    monkeypatch.setattr("omnistereo_lib.train.clouds._ripples", lambda directions, *waves: np.zeros(len(directions)))
    for image in clouds.paint(gray, np.zeros(GRID.shape, np.float32), np.random.default_rng(4)):
        assert image[0, 0] != 100
        np.testing.assert_allclose(image, image[0, 0], rtol=1e-5)
