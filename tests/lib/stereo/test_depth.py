import subprocess
import sys
from pathlib import Path
from unittest import mock

import cv2
import numpy as np
import pytest
import scene
import torch
from hypothesis import given
from hypothesis import strategies as st

import omnistereo_lib as osl
from omnistereo_lib import reference
from omnistereo_lib.stereo import depth, threads


@given(
    st.integers(0, 2**32 - 1), st.integers(2, 40), st.sampled_from([0.0, 0.3, 0.9]), st.booleans()
)
def test_index_and_confidence_are_those_of_the_definition(seed, num_spheres, unknown, subindex):
    rng = np.random.default_rng(seed)
    volume = rng.integers(0, 9, (5, 6, num_spheres)).astype(np.float32)  # many costs are equal
    volume[rng.random(volume.shape) < unknown] = np.nan
    with mock.patch.object(threads, "PART", 2 * 6 * num_spheres):  # two rows at a time
        found = depth.index_and_confidence(volume, subindex)
    exact = torch.from_numpy(volume).double()
    for ours, expected in zip(
        found, (reference.winner(exact, subindex), reference.confidence(exact)), strict=True
    ):
        torch.testing.assert_close(ours.double(), expected, rtol=0, atol=1e-5, equal_nan=True)
    # a device without a kernel, which as a volume of a user is refused
    with mock.patch.object(depth, "as_volume", lambda volume: volume):
        assert depth.index_and_confidence(exact.to("meta"))[0].shape == (5, 6)


def test_nan_cells_do_not_compete():
    volume = torch.tensor([[[0.1, 0.5, 0.3], [torch.nan, 0.5, 0.3], [torch.nan] * 3]])
    index = osl.winner_takes_all(volume)
    assert index[0, :2].tolist() == [0, 2] and index[0, 2].isnan()
    assert osl.winner_takes_all(volume, subindex=True)[0, :2].tolist() == [0, 2]
    assert osl.winner_takes_all([[[np.inf, 1.0, 2.0, 3.0]]], subindex=True).tolist() == [[1]]


def test_subindex_stays_at_the_ends():
    rising = torch.arange(5.0)[None, None]
    assert osl.winner_takes_all(
        torch.cat([rising, rising.flip(-1)]), subindex=True
    ).flatten().tolist() == [0, 4]


def test_confidence_compares_with_the_best_rival_that_is_no_neighbour():
    rays = [[0.3, 0.1, 0.15, 0.4], [0.2, 0.2, 0.2, 0.2], [0.0, 0.5, 0.5, 0.5]]
    costs = torch.tensor([[*rays, [0.1, 0.2, torch.nan, 0.0]]])
    expected = [1 - 0.1 / 0.4, 0.0, 1.0, 1.0]
    assert osl.confidence(costs)[0].tolist() == pytest.approx(expected)
    assert osl.confidence(torch.full((1, 1, 4), torch.nan)).isnan().all()


@pytest.fixture(scope="module")
def estimate():
    rig = scene.rig()
    grid = osl.SphereGrid(160, 40, (-40, 40), 24, 0.6)
    images = scene.images(rig)
    return rig, grid, images, osl.estimate_depth(osl.Frame.of(rig, images), grid, "zncc+sgm")


def test_confidence_orders_errors_better_than_chance(estimate):
    rig, grid, images, found = estimate
    volume = osl.cost_volume(found.sweep, images)
    error = np.abs(osl.winner_takes_all(volume).numpy() - scene.true_index(rig, grid))
    sure = osl.confidence(volume).numpy() > np.nanmedian(osl.confidence(volume))
    assert np.nanmean(error[sure]) < 0.8 * np.nanmean(error)


def test_panorama_shows_the_texture_of_the_walls(estimate):
    rig, grid, _, depth = estimate
    center = depth.sweep.rig  # at the sweep centre
    origin = np.mean([pose.t for pose in rig.T_rig_cam], 0)
    assert np.allclose(center.centers.mean(0), 0)
    rays = grid.rays()
    expected = scene.texture(origin + rays * scene.distance(origin, rays)[..., None])
    assert np.nanmedian(np.abs(depth.panorama() - expected)) < 8


def test_point_cloud_lies_on_the_walls(estimate):
    depth = estimate[3]
    points, colors = depth.point_cloud()
    origin = estimate[0].centers.mean(0)
    to_wall = np.abs(np.abs(points + origin - scene.CENTER) - scene.HALF_SIZE).min(-1)
    assert np.median(to_wall) < 0.1  # one sphere is 0.65 m there
    assert colors.shape == points.shape and colors.dtype == np.uint8
    near, _ = depth.point_cloud(max_depth=2.6)
    assert np.linalg.norm(near, axis=-1).max() <= 2.6


def test_cameras_agree_where_the_depth_is_right(estimate):
    rig, grid, images, found = estimate
    truth = scene.true_index(rig, grid).astype(np.float32)
    shares = []
    for index in (truth, truth / 2, np.zeros_like(truth)):
        agreement = osl.Depth(index, found.confidence, found.sweep, images).agreement()
        assert agreement.shape == grid.shape and np.nanmax(np.abs(agreement)) <= 1
        shares.append(np.mean(agreement > 0.5))
    assert shares[0] > 0.9 and max(shares[1:]) < 0.6


def test_agreement_of_one_ray_by_hand(estimate):
    _, grid, images, found = estimate
    sweep, (row, column) = found.sweep, (20, 35)
    rows, columns = np.mgrid[row - 4 : row + 5, column - 4 : column + 5]
    points = grid.rays()[rows, columns] * grid.index_to_depth(found.index[rows, columns])[..., None]
    seen = []
    for pose, camera, image in zip(
        sweep.rig.T_rig_cam, sweep.rig.cameras, sweep.normalize_images(images), strict=True
    ):
        inside = (points - pose.t) @ pose.R
        uv, valid = camera.project(inside)
        angle = np.arccos(inside[..., 2] / np.linalg.norm(inside, axis=-1))
        gray = cv2.remap(image.numpy(), uv.astype(np.float32), None, cv2.INTER_LINEAR)
        seen.append((np.where(valid, angle, np.inf), gray))
    angles, grays = (np.stack(part) for part in zip(*seen, strict=True))
    best = np.sort(np.argsort(angles, axis=0)[:2], axis=0)
    assert (np.isfinite(angles).sum(0) > 2).any()  # or there would be nothing to choose
    left, right = np.take_along_axis(grays, best, axis=0)
    assert found.agreement()[row, column] == pytest.approx(
        np.corrcoef(left.ravel(), right.ravel())[0, 1], abs=1e-3
    )


def test_agreement_needs_two_cameras_and_a_depth(estimate):
    _, grid, images, found = estimate
    unknown = osl.Depth(
        np.full(grid.shape, np.nan, np.float32), found.confidence, found.sweep, images
    )
    assert np.isnan(unknown.agreement()).all()
    narrow = osl.SphereSweep(scene.rig(max_fov_deg=80), grid)
    alone = osl.Depth(np.ones(grid.shape, np.float32), found.confidence, narrow, images)
    assert np.isnan(alone.agreement()).any()


@pytest.mark.skipif(
    not Path("/proc/self/status").exists(), reason="reads the memory of a process as Linux shows it"
)
def test_from_volume_to_depth_in_little_memory():
    """At 600 × 150 × 192: the volume, its aggregated copy and a fifth of one more."""
    peak = """
import torch, omnistereo_lib as osl
def depth(volume):
    smooth = osl.sgm(volume)
    return osl.winner_takes_all(smooth, subindex=True), osl.confidence(smooth)
depth(torch.rand(20, 40, 192))  # compiles
def memory(key):
    lines = open("/proc/self/status")
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(key))
before = memory("VmRSS")
depth(torch.rand(150, 600, 192))
print((memory("VmHWM") - before) / (4 * 150 * 600 * 192))
"""
    result = subprocess.run(
        [sys.executable, "-c", peak], capture_output=True, text=True, check=True
    )
    assert float(result.stdout) < 2.25  # 2.2, and what the allocator keeps on a busy machine
