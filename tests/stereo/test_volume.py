from dataclasses import replace

import numpy as np
import pytest
import scene
import torch

import omnistereo_lib as osl
from omnistereo_lib.geometry.rig import camera_pairs

GRID = osl.SphereGrid(160, 40, (-40, 40), 24, 0.6)


@pytest.fixture(scope="module")
def world():
    rig = scene.rig()
    return rig, scene.images(rig)


def test_pairs():
    assert camera_pairs("ring", scene.rig(cameras=4)) == [(0, 1), (1, 2), (2, 3), (3, 0)]
    assert camera_pairs("ring", scene.rig(cameras=2)) == [(0, 1)]
    assert camera_pairs("all", scene.rig(cameras=3)) == [(0, 1), (0, 2), (1, 2)]
    assert camera_pairs([(2, 0)], scene.rig(cameras=3)) == [(2, 0)]


def test_the_ring_goes_by_where_the_cameras_look_not_by_their_numbers():
    rig = scene.rig(cameras=4)
    order = [0, 2, 3, 1]  # front, back, left, right
    shuffled = osl.Rig([rig.cameras[i] for i in order], [rig.T_rig_cam[i] for i in order])
    assert camera_pairs("ring", shuffled) == [(0, 3), (3, 1), (1, 2), (2, 0)]


@pytest.mark.parametrize(
    "pairs, message",
    [("star", "pairs is 'star'"), ([(0, 4)], r"pairs has \(0, 4\)"), ([(1, 1)], r"pairs has \(1, 1\)"), ([], "empty")],
)
def test_bad_pairs(pairs, message):
    with pytest.raises(osl.OmnistereoError, match=message):
        camera_pairs(pairs, scene.rig())


def test_volume_is_the_mean_over_the_pairs_that_see_the_ray(world):
    """Eq. 2, assembled from the volumes of single pairs."""
    rig, images = world
    sweep = osl.SphereSweep(rig, GRID)
    singles = [osl.cost_volume(sweep, images, pairs=[pair]) for pair in camera_pairs("all", rig)]
    expected = torch.stack(singles).nanmean(0)
    volume = osl.cost_volume(sweep, images, pairs="all")
    torch.testing.assert_close(volume, expected, atol=1e-6, rtol=0, equal_nan=True)
    assert volume.shape == (40, 160, 24)
    assert volume[~volume.isnan()].min() >= 0 and volume[~volume.isnan()].max() <= 1


@pytest.mark.parametrize("cameras", [2, 3, 5])
def test_the_winner_finds_the_walls_with_any_number_of_cameras(cameras):
    rig = scene.rig(cameras=cameras)
    images = scene.images(rig)
    sweep = osl.SphereSweep(rig, GRID)
    index = osl.winner_takes_all(osl.cost_volume(sweep, images), subindex=True).numpy()
    seen = np.isfinite(index)
    assert seen.mean() > {2: 0.05, 3: 0.8, 5: 0.95}[cameras]  # 220° each leave gaps between three
    error = np.abs(index - scene.true_index(rig, GRID))[seen]
    assert np.median(error) < 0.5  # of a sphere


def test_a_rig_that_shares_no_view_is_refused():
    away = scene.rig(cameras=2, max_fov_deg=80)
    images = scene.images(away)
    with pytest.raises(osl.OmnistereoError, match="no ray is visible to both cameras"):
        osl.cost_volume(osl.SphereSweep(away, GRID), images)


def test_a_volume_beyond_the_memory_is_refused_with_the_figure(world):
    rig, images = world
    sweep = osl.SphereSweep(rig, GRID)
    sweep.grid = replace(GRID, num_spheres=10**9)
    with pytest.raises(osl.OmnistereoError, match=r"160 × 40 with 1000000000 spheres needs \d+\.\d GiB"):
        osl.cost_volume(sweep, images)


def test_progress_sees_every_block(world):
    rig, images = world
    seen = []

    def progress(blocks):
        for spheres in blocks:
            seen.extend(spheres)
            yield spheres

    osl.cost_volume(osl.SphereSweep(rig, GRID), images, progress=progress)
    assert seen == list(range(24))
