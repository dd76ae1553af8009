"""Does a rig fit its images? Every usual mistake, made on purpose in the closed-form world, is named."""

import dataclasses

import numpy as np
import pytest
import scene

import omnistereo_lib as osl
from omnistereo_lib.rig_check import Reading, _shrunk, check_rig, inverted, scaled, verdict

GRID = osl.SphereGrid(96, 24, (-45, 45), 16, 0.5)


@pytest.fixture(scope="module")
def world():
    rig = scene.rig(width=200, height=192)
    return rig, scene.images(rig, finest=0.25)


@pytest.fixture(scope="module")
def right(world):
    return check_rig(*world, GRID)


def test_a_right_rig_is_found_right(right):
    fits, sentence = verdict(right)
    assert fits and sentence.startswith(f"the rig fits the images: the median matching cost is {right[0].cost:.3f}")
    assert right[0].name == "as given" and right[0].cost < 0.1
    assert [r.cost for r in right[1:]] == sorted(r.cost for r in right[1:])
    assert len(right) == 1 + 1 + 6 + 23  # as given, inverted, three units either way, every other order


@pytest.mark.parametrize(
    ("mistake", "name"),
    [
        (inverted, "the poses look inverted"),
        (lambda rig: scaled(rig, 1000), "the translations look 1000 times too long (mm read as m?)"),
        (lambda rig: scaled(rig, 100), "the translations look 100 times too long (cm read as m?)"),
        (lambda rig: scaled(rig, 0.01), "the translations look 100 times too short (m read as cm?)"),
        (lambda rig: scaled(rig, 0.001), "the translations look 1000 times too short (m read as mm?)"),
    ],
    ids=["inverted", "mm as m", "cm as m", "m as cm", "m as mm"],
)
def test_wrong_poses_are_named_and_cost_three_times_as_much(world, right, mistake, name):
    rig, images = world
    readings = check_rig(mistake(rig), images, GRID)
    fits, sentence = verdict(readings)
    assert not fits and sentence.startswith(name)
    assert f"would fall from {readings[0].cost:.3f} to {right[0].cost:.3f}" in sentence
    assert readings[0].cost > 3 * right[0].cost


def test_a_swapped_order_is_named_with_the_order_that_mends_it(world, right):
    rig, images = world
    readings = check_rig(rig, [images[i] for i in (1, 3, 2, 0)], GRID)
    fits, sentence = verdict(readings)
    assert not fits and sentence.startswith("the images look swapped (give them in the order 4 1 3 2)")
    assert readings[1].cost == right[0].cost and readings[0].cost > 3 * right[0].cost


def test_cameras_that_differ_a_little_in_their_field_of_view_may_be_swapped(world):
    """Their images must be shrunk alike, or no order but the given one would fit."""
    rig, images = world
    fields = (214, 216, 214, 216)  # 200 px over these are 3.50 and 3.47 pixels for each of the panorama's
    cameras = [dataclasses.replace(camera, max_fov_deg=fov) for camera, fov in zip(rig.cameras, fields, strict=True)]
    readings = check_rig(osl.Rig(cameras, rig.T_rig_cam), [images[i] for i in (1, 0, 2, 3)], GRID)
    assert verdict(readings)[1].startswith("the images look swapped (give them in the order 2 1 3 4)")


def test_cameras_that_share_no_view_as_given():
    """Two narrow lenses, one turned away on file: the cost of knowing nothing, not an error."""
    poses = [osl.Pose.from_vector([0, 0, 0, 0, 0, 0]), osl.Pose.from_vector([0, 0.3, 0, 0.3, 0, 0])]
    rig = osl.Rig([scene.camera(200, 192, 100)] * 2, poses)
    turned = rig.moved(osl.Pose.from_vector([0, np.pi, 0, 0, 0, 0]))
    apart = osl.Rig(rig.cameras, [rig.T_rig_cam[0], turned.T_rig_cam[1]])
    images = scene.images(rig, finest=0.25)
    readings = check_rig(apart, images, GRID)
    assert readings[0].cost == 0.5 and not verdict(readings)[0]
    assert check_rig(rig, images, GRID)[0].cost < 0.1


def test_images_that_have_nothing_to_do_with_the_rig(world):
    rig, _ = world
    noise = np.random.default_rng(0).uniform(0, 255, (4, 192, 200)).astype(np.float32)
    fits, sentence = verdict(check_rig(rig, list(noise), GRID))
    assert not fits and sentence.startswith("neither the rig as given nor any usual mistake explains the images")


def test_a_little_better_is_no_mistake():
    assert verdict([Reading("as given", 0.02), Reading("other", 0.012)])[0]
    assert not verdict([Reading("as given", 0.2), Reading("other", 0.1)])[0]
    assert not verdict([Reading("as given", 0.3), Reading("other", 0.28)])[0]


def test_images_of_different_sizes_are_not_swapped_for_each_other(world):
    rig, images = world
    cameras = [scene.camera(100, 96), *rig.cameras[1:]]
    mixed = osl.Rig(cameras, rig.T_rig_cam)
    readings = check_rig(mixed, [scene.images(mixed, 0.25)[0], *images[1:]], GRID)
    assert verdict(readings)[0] and len(readings) == 1 + 1 + 6 + 5  # the other three cameras' orders


def test_more_than_four_cameras_are_tried_in_pairs():
    rig = scene.rig(cameras=5, width=100, height=96)
    readings = check_rig(rig, scene.images(rig, 0.5), osl.SphereGrid(64, 16, (-45, 45), 12, 0.5))
    assert len(readings) == 1 + 1 + 6 + 10


def test_images_that_do_not_fit_are_refused(world):
    rig, images = world
    with pytest.raises(osl.OmnistereoError, match="the rig has 4 cameras, got 3 images"):
        check_rig(rig, images[:3], GRID)


def test_smaller_cameras_see_the_same(world):
    """The shrunk camera projects to the middle of the squares that were averaged, its mask to those wholly good."""
    rig, images = world
    mask = np.ones((192, 200), bool)
    mask[50, 60] = False
    masked = osl.Rig([dataclasses.replace(rig.cameras[0], mask=mask), *rig.cameras[1:]], rig.T_rig_cam)
    grid = osl.SphereGrid(80, 20)
    small, pictures = _shrunk(masked, images, grid)
    assert small.cameras[0].image_size == (50, 48) and pictures[0].shape == (48, 50)
    points = np.random.default_rng(0).normal(size=(500, 3))
    for camera, shrunk in zip(rig.cameras, small.cameras, strict=True):
        for exact in (False, True):
            uv, valid = camera.project(points, exact)
            small_uv, small_valid = shrunk.project(points, exact)
            both = valid & small_valid
            assert both.sum() > 300
            np.testing.assert_allclose(small_uv[both], ((uv + 0.5) / 4 - 0.5)[both], atol=1e-9)
    np.testing.assert_allclose(pictures[1], images[1].reshape(48, 4, 50, 4).mean((1, 3)), rtol=1e-5)
    assert np.argwhere(~small.cameras[0].mask).tolist() == [[12, 15]]
    assert small.cameras[1].mask is None
