"""The benchmarks: both sides do the same job, and a line has both times and their ratio."""

import boards
import numpy as np
import pytest
import torch

from course.experiments import bench
from omnistereo_lib.calibrate.single_camera import calibrate_camera
from omnistereo_lib.geometry.rig import camera_pairs
from omnistereo_lib.stereo.learned import LearnedCost
from omnistereo_lib.stereo.sweepnet import SweepNet


@pytest.fixture(autouse=True)
def once(monkeypatch):
    monkeypatch.setattr(bench, "_SECONDS", 0.0)


def test_a_line_has_both_times_and_their_ratio(capsys):
    bench.compare("SGM, twice", lambda: None, lambda: sum(range(100_000)), "{:.0f} s".format)
    *name, ours, theirs, ratio, note, unit = capsys.readouterr().out.split()
    assert (name, note, unit) == (["SGM,", "twice"], "0", "s")
    assert 0 <= float(ours) < float(theirs) and float(ratio) < 1


@pytest.mark.parametrize(("name", "lines"), [("kernels", 6), ("sgm", 1), ("volumenet", 1), ("training", 1)])
def test_a_comparison_runs(name, lines, capsys):
    getattr(bench, f"bench_{name}")(96, 24, 16)
    ratios = [float(line.split("  ")[-2].split()[-1]) for line in capsys.readouterr().out.splitlines()]
    assert len(ratios) == lines and min(ratios) >= 0


def test_the_plain_sweepnet_has_the_same_costs():
    """But for the columns that see across the seam: the plain one has a seam in all layers but the first."""
    sweep, images = bench._rig_and_images(112, 16, 16)
    spheres, pairs, network = range(7, 9), camera_pairs("ring", sweep.rig), SweepNet.pretrained()
    warped = sweep.warp_block(sweep.normalize_images(images), spheres)
    plain = bench.plain_sweepnet(network, warped, pairs)
    ours = LearnedCost(network, "float32")(warped, pairs)
    seam = 42  # half the receptive field of 81, and the stride
    torch.testing.assert_close(ours[:, seam:-seam], plain[:, seam:-seam], atol=1e-5, rtol=0, equal_nan=True)


def test_opencv_gets_a_fair_chance():
    """From our focal length it finds an equidistant camera and the rays of that camera."""
    corners, _ = boards.views(np.random.default_rng(0), 20)
    inside = [view for view in corners if np.linalg.norm(view - boards.CENTER, axis=1).max() < 200 * np.radians(80)]
    start, _ = calibrate_camera(corners, boards.BOARD, boards.SIZE)
    fit = bench.opencv_fisheye(inside, boards.BOARD, boards.SIZE, start)
    assert fit.rms_px == pytest.approx(0.05 * np.sqrt(2), rel=0.1)
    offset = np.array([[100.0, 0], [0, -150], [-180, 60]])
    pixels = boards.CENTER + offset
    r = np.linalg.norm(offset, axis=1, keepdims=True)
    rays = np.hstack([offset / r * np.sin(r / 200), np.cos(r / 200)])
    np.testing.assert_allclose(fit.rays(pixels), rays, atol=2e-3)


def test_opencv_that_fails_has_infinite_error():
    views = [np.full((120, 2), np.nan) for _ in range(3)]
    assert bench.opencv_fisheye(views, boards.BOARD, boards.SIZE).rms_px == np.inf
