"""The blended panorama of a box whose colours are known, with cameras of different exposure."""

from dataclasses import replace

import numpy as np
import pytest
import scene

import omnistereo_lib as osl
from omnistereo_tools.output.blend import blended_panorama, estimate_gains, finer_index

GRID = osl.SphereGrid(320, 80, num_spheres=64, min_depth=0.6)
EXPOSURE = np.array([1.0, 0.8, 1.1, 0.9])


@pytest.fixture(scope="module")
def box():
    rig = scene.rig(width=400, height=384)
    return scene.true_depth(rig, GRID, scene.images(rig, finest=0.25))


def test_gains_undo_exposures_and_white_balance(box):
    dark = [image * k for image, k in zip(box.images, EXPOSURE, strict=True)]
    gains = estimate_gains(replace(box, frame=dark))
    np.testing.assert_allclose(gains[:, 0] * EXPOSURE, np.exp(np.log(EXPOSURE).mean()), rtol=0.01)
    balance = np.stack([EXPOSURE, np.ones(4), EXPOSURE[::-1]], -1)
    colored = [image[..., None] * k for image, k in zip(box.images, balance, strict=True)]
    gains = estimate_gains(replace(box, frame=colored))
    np.testing.assert_allclose(
        gains * balance, np.exp(np.log(balance).mean(0))[None].repeat(4, 0), rtol=0.01
    )


def test_no_edge_shows_where_a_camera_ends(box):
    """Each camera is darker towards its rim: `Depth.panorama` has steps there, the blend none."""
    center = box.sweep.rig.cameras[0].center
    v, u = np.indices(box.images[0].shape)
    falloff = 1 - 0.4 * (np.hypot(u - center[0], v - center[1]) / 190).clip(0, 1) ** 2
    flat = [np.full(image.shape, 150.0) * falloff for image in box.images]
    flat = replace(box, frame=flat)
    steps = [
        np.abs(np.diff(picture, axis=1)).max()
        for picture in (flat.panorama(), blended_panorama(flat))
    ]
    assert steps[0] > 10 > 4 > steps[1]


def test_the_blend_of_equal_cameras_is_the_scene(box):
    blended, mean = blended_panorama(box), box.panorama()
    assert blended.shape == mean.shape == GRID.shape and np.isfinite(blended).all()
    assert np.median(np.abs(blended - mean)) < 2
    few = scene.true_depth(box.sweep.rig, replace(GRID, height=2, phi_deg=(-2, 2)), box.images)
    assert np.median(np.abs(blended_panorama(few) - few.panorama())) < 2


def test_a_finer_panorama_keeps_planes_and_has_no_teeth_at_an_edge(box):
    """Of a depth with a diagonal edge between planes in index; one ray is unknown."""
    rows, columns = np.indices(GRID.shape)
    near = columns - rows > 100
    index = np.where(near, 40 + 0.1 * rows, 10 + 0.1 * rows).astype(np.float32)
    index[10, -1] = np.nan
    fine, _ = finer_index(replace(box, index=index), 4)
    rows, columns = ((side + 0.5) / 4 - 0.5 for side in np.indices(fine.shape))
    unknown = np.isnan(fine)
    assert unknown.sum() >= 4 and np.hypot(rows - 10, columns - 319)[unknown].max() < 0.8
    # The edge is halfway between the last rays of both sides.
    inside = (rows > 0) & (rows < 79) & (columns > 1) & (columns < 318)
    expected = np.where(columns - rows > 100.5, 40, 10) + 0.1 * rows
    off = np.abs(fine - expected)[inside & (np.abs(columns - rows - 100.5) > 0.2)]
    assert off.max() < 0.06
