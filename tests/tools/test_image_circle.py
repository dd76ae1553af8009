"""The image circle, measured from drawn and rendered images, and what it changes about a rig."""

from dataclasses import replace

import numpy as np
import pytest
import scene

import omnistereo_lib as osl
from omnistereo_learn.evaluate.run import DATA
from omnistereo_tools.input.masks import measure_circle, seen_fov_deg, with_circles


@pytest.fixture(scope="module")
def world():
    rig = scene.rig(width=400, height=384)
    return rig, [image.clip(0, 255).astype(np.uint8) for image in scene.images(rig, finest=0.25)]


def darkened(rig, images, fov_deg, noise=3):
    """Return the images black beyond a field of view: a circle around the centre."""
    random, dark = np.random.default_rng(0), []
    for camera, image in zip(rig.cameras, images, strict=True):
        v, u = np.indices(image.shape[:2])
        radius = np.hypot(u - camera.center[0], v - camera.center[1])
        kept = radius <= camera.max_radius * fov_deg / camera.max_fov_deg
        dark.append(
            np.where(kept, image, random.integers(0, noise + 1, image.shape)).astype(np.uint8)
        )
    return dark


@pytest.mark.parametrize("fov_deg", [190, 120])
def test_the_measured_field_is_the_one_that_was_drawn(world, fov_deg):
    rig, images = world
    for camera, image in zip(rig.cameras, darkened(rig, images, fov_deg), strict=True):
        circle = measure_circle([image], camera.center)
        assert np.hypot(*np.subtract(circle.center, camera.center)) < 2
        assert seen_fov_deg(camera, circle) == pytest.approx(fov_deg, abs=2)


def test_a_circle_that_is_not_where_the_calibration_says(world):
    rig, images = world
    shifted = np.roll(darkened(rig, images, 150)[0], (20, -12), axis=(0, 1))
    circle = measure_circle([shifted], rig.cameras[0].center)
    expected = np.add(rig.cameras[0].center, (-12, 20))
    np.testing.assert_allclose(circle.center, expected, atol=2)
    mask = circle.mask((400, 384))
    v, u = np.indices(mask.shape)
    inside = np.hypot(u - expected[0], v - expected[1])
    assert mask[inside < 0.97 * circle.radius].all() and not mask[inside > circle.radius + 2].any()


def test_images_that_show_no_circle(world):
    rig, images = world
    narrow = scene.camera(200, 192, 60)
    lit = np.random.default_rng(1).integers(60, 200, (192, 200)).astype(np.uint8)
    assert measure_circle([lit], narrow.center) is None  # lit to its corners
    assert measure_circle([np.zeros((192, 200), np.uint8)], narrow.center) is None
    dark_floor = images[0].copy()
    dark_floor[250:] = 2  # a straight edge, not a round one
    circle = measure_circle([dark_floor], rig.cameras[0].center)
    assert circle is None or seen_fov_deg(rig.cameras[0], circle) > 214


def test_frames_together_show_what_one_does_not(world):
    rig, images = world
    whole = darkened(rig, images, 180)[0]
    frames = [whole.copy(), whole.copy()]
    frames[0][:190], frames[1][190:] = 0, 0
    camera = rig.cameras[0]
    assert seen_fov_deg(camera, measure_circle(frames, camera.center)) == pytest.approx(180, abs=2)


def test_rigs_with_a_rim_are_masked_and_told(world):
    rig, images = world
    masked, said = with_circles(rig, [darkened(rig, images, 170)])
    before, after = rig.cameras[0].visible_pixels().sum(), masked.cameras[0].visible_pixels().sum()
    assert after / before == pytest.approx((170 / 220) ** 2, rel=0.05)
    assert "black beyond 1" in said and "of the 220° stated: two cameras see " in said
    proposed = float(said.split("--max-fov ")[1].split("`")[0])
    assert 166 <= proposed <= 171
    assert masked.T_rig_cam == rig.T_rig_cam


def test_right_rigs_are_left_alone(world):
    rig, images = world
    assert with_circles(rig, [images]) == (rig, None)
    own = replace(rig.cameras[0], mask=np.ones((384, 400), bool))
    given = replace(rig, cameras=(own, *rig.cameras[1:]))
    masked, said = with_circles(given, [darkened(rig, images, 170)])
    assert masked.cameras[0] is own and "camera 2, 3, 4" in said  # its mask is the user's


@pytest.mark.parametrize("name", ["sunny", "indoor", "aerial"])
def test_no_false_alarm_on_rendered_sets(name):
    frame = osl.load_dataset(DATA / name / "test")[0]
    assert with_circles(frame.rig, [frame.images])[1] is None
