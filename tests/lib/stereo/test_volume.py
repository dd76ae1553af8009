from types import SimpleNamespace

import psutil
import pytest
import scene
import torch
from scene import refused

import omnistereo_lib as osl
from omnistereo_lib.geometry.rig import camera_pairs
from omnistereo_lib.stereo import cost as cost_module
from omnistereo_lib.stereo.device import bytes_of_ray, check_memory

GRID = osl.SphereGrid(160, 40, (-40, 40), 24, 0.6)


@pytest.fixture(scope="module")
def world():
    rig = scene.rig()
    return rig, scene.images(rig)


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


@pytest.mark.parametrize("full, other", [("cpu", "cuda"), ("cuda", "cpu")])
def test_the_memory_of_the_device_is_checked(monkeypatch, full, other):
    free = {full: 10**6, other: 10**12}
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=free["cpu"]))
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda _: (free["cuda"], 10**12))
    check_memory(4, GRID, torch.device(other))
    with refused(rf"160 × 40 with 24 spheres needs \d+\.\d GiB of {full} memory"):
        check_memory(4, GRID, torch.device(full))


def test_memory_is_checked_once_for_a_sweep(monkeypatch, world):
    looks, sweep = [], osl.SphereSweep(world[0], GRID)
    monkeypatch.setattr(cost_module, "check_memory", lambda *arguments: looks.append(arguments))
    for _ in range(2):
        osl.cost_volume(sweep, world[1])
    assert len(looks) == 1


def test_a_volume_that_is_never_whole_needs_no_memory_for_it(monkeypatch, world):
    free = SimpleNamespace(available=1.4 * 160 * 40 * bytes_of_ray(4, GRID, False))
    monkeypatch.setattr(psutil, "virtual_memory", lambda: free)
    frame = osl.Frame.of(*world)
    assert osl.estimate_depth(frame, GRID, "volumenet").valid.all()
    with refused("needs 0.0 GiB of cpu memory"):
        osl.estimate_depth(frame, GRID, "zncc")


def test_progress_counts_the_blocks(world):
    calls = []
    osl.cost_volume(
        osl.SphereSweep(world[0], GRID), world[1], progress=lambda *call: calls.append(call)
    )
    assert calls == [(0, 2, "sweep"), (1, 2, "sweep"), (2, 2, "")]
