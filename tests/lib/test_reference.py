"""The definition against closed forms, NumPy, SciPy, libsgm and a box of known depth."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
import scene
import torch
from c_libsgm import sgm_api
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates

import omnistereo_lib as osl
from omnistereo_lib import reference
from omnistereo_lib.geometry.rig import camera_pairs
from omnistereo_lib.stereo.pipeline import sweep_depth

GRID = osl.SphereGrid(160, 40, (-40, 35), 24, 0.6)
# in the order that libsgm needs
DIRECTIONS = [(0, 1), (1, 0), (1, 1), (1, -1), (0, -1), (-1, 0), (-1, -1), (-1, 1)]
STRAIGHT = (0, 1, 4, 5)


def test_rays_are_those_of_the_grid():
    """Which `tests/geometry` compares with the published formulas."""
    rays = reference.rays(GRID.width, GRID.height, GRID.phi_deg)
    np.testing.assert_allclose(rays, GRID.rays(), rtol=0, atol=1e-15)


def test_an_equidistant_lens_in_closed_form():
    """r = f θ, up to 110° from the axis, then the affine map of the files' documentation."""
    c, d, e = 1.002, -0.003, 0.004
    camera = replace(
        scene.camera(), affine=(c, d, e), inv_poly=[150 * np.pi / 2, 150], image_size=(640, 640)
    )
    angle, azimuth = np.radians(np.arange(0.5, 120, 2))[:, None], np.radians(np.arange(0, 360, 7.0))
    x, y = np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth)
    points = np.stack(np.broadcast_arrays(x, y, np.cos(angle)), -1)
    row, column = 150 * angle * np.sin(azimuth), 150 * angle * np.cos(azimuth)
    expected = np.stack(
        [e * row + column + camera.center[0], c * row + d * column + camera.center[1]], -1
    )
    inside = ((expected >= 0) & (expected <= 639)).all(-1) & (angle < np.radians(110))
    found = reference.project(torch.from_numpy(points), camera)
    np.testing.assert_allclose(found, np.where(inside[..., None], expected, np.nan), atol=1e-9)
    ahead = reference.project(torch.tensor([0.0, 0.0, 2.0], dtype=torch.float64), camera)
    np.testing.assert_allclose(ahead, camera.center)


@given(st.integers(0, 2**32 - 1), st.floats(60, 300), st.booleans())
def test_the_camera_class_does_the_same(seed, max_fov_deg, masked):
    rng = np.random.default_rng(seed)
    mask = rng.random((384, 400)) < 0.5 if masked else None
    camera = replace(scene.camera(), affine=(1.01, 0.02, -0.03), max_fov_deg=max_fov_deg, mask=mask)
    points = rng.normal(size=(200, 3))
    uv, valid = camera.project(points)
    found = reference.project(torch.from_numpy(points), camera)
    np.testing.assert_allclose(found, np.where(valid[:, None], uv, np.nan), atol=1e-9)


def test_samples_lie_between_the_pixels():
    rng = np.random.default_rng(0)
    maps, pixels = rng.normal(size=(3, 5, 7)), rng.uniform([0, 0], [6, 4], (8, 9, 2))
    pixels[2, 3] = np.nan
    found = reference.sample(torch.from_numpy(maps), torch.from_numpy(pixels))
    expected = [
        map_coordinates(one, np.moveaxis(pixels[..., ::-1], -1, 0), order=1, cval=np.nan)
        for one in maps
    ]
    np.testing.assert_allclose(
        found, np.where(np.isnan(pixels[..., 0]), np.nan, expected), atol=1e-12
    )


def test_a_warped_image_shows_the_walls():
    """At the depth of the wall, each ray has the gray value of the point that it hits."""
    rig = scene.rig().recentered()
    at = np.mean([pose.t for pose in scene.rig().T_rig_cam], 0)
    depth = scene.distance(at, GRID.rays())
    walls = scene.texture(at + depth[..., None] * GRID.rays(), finest=0.5)
    rays = reference.rays(GRID.width, GRID.height, GRID.phi_deg)
    for lens, pose, image in zip(
        rig.cameras, rig.T_rig_cam, scene.images(scene.rig(), finest=0.5), strict=True
    ):
        warped = reference.warp(
            torch.from_numpy(image).double(), lens, pose, rays, torch.from_numpy(1 / depth)
        )
        error = np.abs(warped.numpy() - walls)
        error = error[np.isfinite(error)]
        assert error.size > 0.5 * walls.size  # 220° of 360°
        # gray levels; the rest lies at oblique walls
        assert np.median(error) < 0.3 and np.quantile(error, 0.99) < 3


@given(st.integers(0, 2**32 - 1), st.sampled_from([3, 5, 9]), st.sampled_from([0.0, 0.3]))
@settings(max_examples=20)
def test_zncc_is_the_correlation_of_the_pixels_that_both_see(seed, window, unseen):
    rng, r = np.random.default_rng(seed), window // 2
    a, b = rng.normal(size=(2, 12, 17))
    a[rng.random(a.shape) < unseen] = b[rng.random(a.shape) < unseen] = np.nan
    a[3:6, 14:], b[3:6, 14:] = 0.5, 0.7  # no texture
    found = reference.zncc(torch.from_numpy(a)[None], torch.from_numpy(b)[None], window)[0].numpy()
    np.testing.assert_array_equal(np.isnan(found), np.isnan(a + b))
    for y, x in rng.integers([12, 17], size=(20, 2)):
        patches = [
            image[max(y - r, 0) : y + r + 1].take(range(x - r, x + r + 1), 1, mode="wrap")
            for image in (a, b)
        ]
        common = np.isfinite(patches[0] + patches[1])
        one, other = (patch[common] for patch in patches)
        flat = common.sum() < 2 or min(one.std(), other.std()) < 1e-6
        expected = 0.5 if flat else (1 - np.corrcoef(one, other)[0, 1]) / 2
        assert np.isnan(a[y, x] + b[y, x]) or found[y, x] == pytest.approx(expected, abs=1e-9)


def test_the_correlation_is_the_mean_over_all_pairs_of_cameras_that_see_the_cell():
    rng = np.random.default_rng(0)
    maps, uv = rng.normal(size=(4, 32, 7, 9)), rng.uniform([0, 0], [8, 6], (4, 3, 2, 2, 2))
    for k, one in enumerate(uv):
        one[k % 3, :, k % 2] = np.nan
    found = reference.correlate([*torch.from_numpy(maps)], [*torch.from_numpy(uv)], groups=8)
    for cell in np.ndindex(3, 2, 2):
        seen = [
            np.array(
                [map_coordinates(channel, at[cell][::-1, None], order=1)[0] for channel in features]
            )
            for features, at in zip(maps, uv, strict=True)
            if np.isfinite(at[cell]).all()
        ]
        products = np.mean([a * b for a, b in permutations(seen, 2)], 0)
        np.testing.assert_allclose(
            found[(slice(8), *cell)], products.reshape(8, 4).mean(1), atol=1e-12
        )
        assert found[(8, *cell)] == len(seen) / 4


def libsgm(volume, p1, p2, paths):
    """Semi-global matching of a flat image by another library.

    It always takes eight paths; without penalties C.
    """
    used = np.float32([paths == 8 or k in STRAIGHT for k in range(8)])
    penalty = np.broadcast_to(used, (*volume.shape[:2], 8))
    segment = np.ones(volume.shape[:2], np.float32)
    found = sgm_api(volume, p1 * penalty, p2 * penalty, np.int32(DIRECTIONS), 1e9, segment)["cv"]
    return found - (8 - paths) * volume


@pytest.mark.parametrize("paths", [4, 8])
@pytest.mark.parametrize(("p1", "p2"), [(0.1, 12.0), (0.1, 1.0), (0.05, 0.05)])
def test_sgm_agrees_with_libsgm(paths, p1, p2):
    volume = np.random.default_rng(0).random((40, 53, 37), np.float32)
    found = reference.sgm(torch.from_numpy(volume).double(), p1, p2, paths, wrap=False)
    np.testing.assert_allclose(found, libsgm(volume, p1, p2, paths), rtol=0, atol=1e-5)


@pytest.mark.parametrize("paths", [4, 8])
def test_sgm_around_the_seam_is_a_row_of_equal_panoramas(paths):
    """In the middle of them every path has come from far, as on a ring."""
    volume = np.random.default_rng(0).random((30, 60, 12), np.float32)
    in_a_row = libsgm(np.tile(volume, (1, 5, 1)), 0.1, 1.0, paths)[:, 120:180]
    found = reference.sgm(torch.from_numpy(volume).double(), 0.1, 1.0, paths)
    np.testing.assert_allclose(found, in_a_row, rtol=0, atol=1e-5)


@given(vertex=st.floats(0.6, 8.4), bend=st.floats(0.01, 10))
def test_the_winner_is_the_vertex_of_a_parabola(vertex, bend):
    costs = torch.from_numpy(0.1 + bend * (np.arange(10) - vertex) ** 2)[None, None]
    assert abs(float(reference.winner(costs, subindex=True)) - vertex) < 1e-9
    assert int(reference.winner(costs, subindex=False)) == int(costs.argmin())


def test_the_whole_method_finds_the_box():
    """And `sweep_depth` finds the same spheres."""
    rig = scene.rig()
    sweep = osl.SphereSweep(rig, GRID)
    images, pairs = scene.images(rig), camera_pairs("ring", rig)
    normalized = [image.double() for image in sweep.normalize_images(images)]
    index = reference.estimate(normalized, rig, GRID, pairs, window=9, p1=0.1, p2=1.0).numpy()
    error = np.abs(index - scene.true_index(rig, GRID))
    assert np.isfinite(index).mean() > 0.97 and np.nanmedian(error) < 0.3  # spheres
    fast = sweep_depth(sweep, images, "zncc+sgm,window=9,p1=0.1,p2=1").index
    close = np.isclose(fast, index, rtol=0, atol=1e-3, equal_nan=True)
    # float32 decides otherwise between two spheres that are equally good
    assert close.mean() > 0.995
