from dataclasses import replace

import numpy as np
import pytest
import scene
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import omnistereo_lib as osl
from omnistereo_lib import reference
from omnistereo_lib.stereo.sweep import blur, blur_px

GRID = osl.SphereGrid(64, 20, (-40, 35), 20, 0.6)


@pytest.fixture(scope="module")
def world():
    rig = scene.rig()
    return rig, scene.images(rig)


@given(
    cameras=st.integers(2, 4),
    max_fov_deg=st.floats(60, 220),
    masked=st.booleans(),
    phi=st.tuples(st.integers(-90, -1), st.integers(1, 90)),
    n=st.integers(0, 19),
    index=st.floats(0, 19),
)
@settings(max_examples=8)
def test_warped_images_are_those_of_the_definition(cameras, max_fov_deg, masked, phi, n, index):
    """To a thousandth of a gray level on an image with soft edges.

    The lookup tables are float32: at 400 px they are rounded by up to 1.5e-5 px, and an edge of 60
    gray levels per pixel would turn that into a thousandth."""
    rig = scene.rig(cameras=cameras, max_fov_deg=max_fov_deg)
    images = scene.images(rig, finest=0.5)
    if masked:
        mask = np.hypot(*np.indices((384, 400))) > 300
        rig = osl.Rig([replace(camera, mask=mask) for camera in rig.cameras], rig.T_rig_cam)
    grid = osl.SphereGrid(64, 20, phi, 20, 0.6)
    sweep = osl.SphereSweep(rig, grid)
    block = next(spheres for spheres in sweep.blocks() if n in spheres)
    by_table = sweep.warp_block([torch.from_numpy(image) for image in images], block)[
        :, n - block.start
    ]
    for camera, (lens, pose, image) in enumerate(
        zip(rig.cameras, sweep.rig.T_rig_cam, images, strict=True)
    ):
        for warped, number in ((by_table[camera], n), (sweep.warp(images, index)[camera], index)):
            inverse_depth = torch.tensor(grid.index_to_inverse_depth(number))
            rays = reference.rays(grid.width, grid.height, grid.phi_deg)
            expected = reference.warp(
                torch.from_numpy(image).double(), lens, pose, rays, inverse_depth
            )
            # gray levels of 0 … 255
            np.testing.assert_allclose(warped, expected, rtol=0, atol=1e-3)


def test_a_wall_is_sharp_on_its_own_sphere(world):
    """A map of true indices aligns the cameras."""
    rig, images = world
    sweep = osl.SphereSweep(rig, GRID)
    aligned = np.stack(sweep.warp(images, scene.true_index(rig, GRID)))
    elsewhere = np.stack(sweep.warp(images, 12.0))
    common = np.isfinite(aligned).sum(0) >= 2
    assert common.mean() > 0.95
    assert np.nanstd(aligned[:, common], 0).mean() < 3
    assert np.nanstd(elsewhere[:, common], 0).mean() > 20


def test_lookup_tables_are_kept_or_computed_once_per_frame(world, monkeypatch):
    rig, images = world
    kept, computed = osl.SphereSweep(rig, GRID), []
    streamed = osl.SphereSweep(rig, GRID, keep_tables=False)
    compute = streamed._compute_lut
    monkeypatch.setattr(
        streamed, "_compute_lut", lambda *key: computed.append(key) or compute(*key)
    )
    torch.testing.assert_close(
        osl.cost_volume(kept, images),
        osl.cost_volume(streamed, images),
        rtol=0,
        atol=0,
        equal_nan=True,
    )
    assert len(computed) == len(set(computed)) == len(rig) * len(streamed.blocks())
    assert streamed.lut_bytes == 0
    full = 8 * 64 * 20 * 20 * 4
    assert 0.4 * full < kept.lut_bytes < 0.75 * full  # 220° of 360°, less nearby


@pytest.mark.parametrize("n", [0, 7, 19])
def test_a_gpu_computes_the_same_tables(world, n):
    """In torch, here on the CPU: where NumPy has the pixels."""
    sweep = osl.SphereSweep(world[0], GRID)
    for camera in range(len(sweep.rig)):
        (uv, valid) = sweep.project_sphere(camera, n)
        (found, found_valid) = sweep._project_by_torch(camera, n)
        assert (found_valid.numpy() == valid).all() and valid.any() and not valid.all()
        assert np.abs(found.numpy() - uv)[valid].max() < 1e-9


def test_seam_is_no_border(world):
    """Rotating the rig by whole columns rolls every warped image, wherever the seam falls."""
    rig, images = world
    rotated = rig.transformed(osl.Pose.from_vector([0, 2 * np.pi * 10 / 64, 0, 0, 0, 0]))
    a = osl.SphereSweep(rig, GRID).warp_block([torch.from_numpy(i) for i in images], range(16))
    b = osl.SphereSweep(rotated, GRID).warp_block([torch.from_numpy(i) for i in images], range(16))
    difference = (a.roll(10, -1) - b).abs()
    # rounding at the rim of the lens
    assert (a.roll(10, -1).isnan() == b.isnan()).float().mean() > 0.999
    assert difference[~difference.isnan()].max() < 0.02


def test_colour_is_warped_channel_by_channel(world):
    rig, images = world
    sweep = osl.SphereSweep(rig, GRID)
    colour = [np.stack([image, 255 - image, image / 2], -1) for image in images]
    warped, gray = sweep.warp(colour, 5)[1], sweep.warp(images, 5)[1]
    np.testing.assert_allclose(warped[..., 0], gray, atol=1e-3)
    np.testing.assert_allclose(warped[..., 1], 255 - gray, atol=1e-3)


def test_normalized_images_have_zero_mean_and_unit_variance_over_the_image_circle(world):
    rig, images = world
    bright = [image * 0.5 + 100 for image in images]
    for normalized, camera in zip(
        osl.SphereSweep(rig, GRID).normalize_images(bright), rig.cameras, strict=True
    ):
        width, height = camera.image_size
        _, valid = camera.unproject(np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1))
        assert abs(normalized.numpy()[valid].mean()) < 1e-4
        assert abs(normalized.numpy()[valid].std() - 1) < 1e-4


# ---- without aliases


@pytest.mark.parametrize("spacing", [1.5, 2.0, 4.0])
def test_the_blur_is_half_the_spacing_of_the_samples(spacing):
    """Variances of the impulse and of a pixel, 0.5², are (spacing / 2)² together."""
    impulse = np.zeros((41, 41), np.float32)
    impulse[20, 20] = 1
    blurred = blur(impulse, blur_px(spacing)).astype(float)
    variance = (blurred.sum(0) * (np.arange(41) - 20.0) ** 2).sum()
    assert blurred.sum() == pytest.approx(1, abs=1e-5)
    assert variance + 0.25 == pytest.approx(spacing**2 / 4, rel=0.05)


def test_detail_finer_than_the_panorama_does_not_reach_it(world):
    """Stripes of two pixels would show as a pattern at four pixels a column."""
    rig, images = world
    stripes = [image + 80 * (-1.0) ** np.indices(image.shape).sum(0) for image in images]
    assert rig.cameras[0].pixels_per_degree * 360 / GRID.width > 4
    sweep = osl.SphereSweep(rig, GRID)
    clean, striped = (sweep.normalize_images(some) for some in (images, stripes))
    for camera in range(len(rig)):
        inside = rig.cameras[camera].visible_pixels()
        assert (clean[camera] - striped[camera]).numpy()[inside].std() < 0.02  # of unit variance
    fine = osl.SphereSweep(rig, osl.SphereGrid(1440, 20, (-40, 35), 20, 0.6))
    # a fine panorama takes the pixels as they are
    gray = images[0][rig.cameras[0].visible_pixels()]
    normalized = fine.normalize_images(images)[0].numpy()[rig.cameras[0].visible_pixels()]
    np.testing.assert_allclose(normalized, (gray - gray.mean()) / gray.std(), atol=1e-4)


def test_what_lies_outside_of_the_image_circle_stays_out(world):
    rig, images = world
    outside = [~camera.visible_pixels() for camera in rig.cameras]
    black, white = (
        osl.SphereSweep(rig, GRID).normalize_images(
            [np.where(o, value, i) for i, o in zip(images, outside, strict=True)]
        )
        for value in (np.float32(0), np.float32(255))
    )
    for one, other, out in zip(black, white, outside, strict=True):
        np.testing.assert_array_equal(one.numpy()[~out], other.numpy()[~out])


def test_a_camera_that_is_rotated_costs_its_own_tables_alone(world):
    rig, images = world
    sweep = osl.SphereSweep(rig, GRID)
    osl.cost_volume(sweep, images)
    rotated = rig.with_poses(
        [rig.T_rig_cam[0] @ osl.Pose.from_vector([0, 0.1, 0, 0, 0, 0]), *rig.T_rig_cam[1:]]
    )
    other, computed = sweep.with_poses(rotated.T_rig_cam), []
    compute = other._compute_lut
    other._compute_lut = lambda *key: computed.append(key) or compute(*key)
    expected = osl.cost_volume(osl.SphereSweep(rotated, GRID), images)
    torch.testing.assert_close(
        osl.cost_volume(other, images), expected, rtol=0, atol=0, equal_nan=True
    )
    assert {camera for camera, _ in computed} == {0}
