"""The benchmarks: both sides do the same job, and a line has both times and their ratio."""

import re

import boards
import numpy as np
import pytest
import torch

from omnistereo_lib.stereo import correlation
from omnistereo_lib.stereo.volumenet import VolumeNet
from omnistereo_rigs.boards.single_camera import calibrate_camera
from workshop.results import bench, pairs


@pytest.fixture(autouse=True)
def once(monkeypatch):
    monkeypatch.setattr(bench, "_SECONDS", 0.0)
    monkeypatch.setattr(correlation, "COARSE", (32, 8))


def test_a_line_has_all_times_and_their_ratios(capsys, monkeypatch):
    monkeypatch.setattr(bench, "machine", lambda: (1e9, 1e9))
    x = torch.zeros(10, 100)
    bench.compare("product, twice", lambda: x @ x.T, lambda: sum(range(100_000)))
    *name, ours, _, _, theirs, ratio = capsys.readouterr().out.split()
    assert name == ["product,", "twice"]
    assert 0 <= float(ours) < float(theirs) and float(ratio) < 1
    assert bench.operations(lambda: x @ x.T) == 2 * 10 * 100 * 10
    bench.compare("copy", lambda: x.clone(), None, 2e6)
    assert capsys.readouterr().out.split()[2] == "2.0"  # milliseconds: 2 MB at 1 GB/s


def test_the_fused_convolutions_of_volumenet_count():
    features, visible = VolumeNet().features, torch.ones(12, 16, dtype=torch.bool)
    # one of 5 × 5 from one channel, seven of 3 × 3 from 32, at half the size
    wanted = 2 * (6 * 8) * 32 * (5 * 5 + 7 * 3 * 3 * 32)
    with torch.no_grad():
        assert bench.operations(lambda: features(visible.float(), visible)) == wanted


@pytest.mark.parametrize(("name", "lines"), [("kernels", 6), ("sgm", 1), ("volumenet", 4)])
def test_a_comparison_runs(name, lines, capsys):
    getattr(bench, f"bench_{name}")(96, 24, 16)
    rows = [re.findall(r"  +([0-9.]+)", line) for line in capsys.readouterr().out.splitlines()]
    assert len(rows) == lines and all(len(row) >= 2 for row in rows)


def test_opencv_gets_a_fair_chance():
    """From our focal length it finds an equidistant camera and the rays of that camera."""
    corners, _ = boards.views(np.random.default_rng(0), 20)
    inside = [
        view
        for view in corners
        if np.linalg.norm(view - boards.CENTER, axis=1).max() < 200 * np.radians(80)
    ]
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


def test_two_builds_run_by_turns_and_the_least_counts(capsys):
    values = iter([[3.0, 2.0], [4.0, 8.0], [1.0, 9.0], [5.0, 4.0]])
    order = []
    least = pairs._least(lambda clone: order.append(clone) or next(values), ["new", "old"], 2)
    assert order == ["new", "old"] * 2 and least == [[1.0, 2.0], [4.0, 4.0]]
    pairs._print_pair("depth", (0.5,), least)
    assert re.findall("= ([0-9.]+)", capsys.readouterr().out) == ["0.25", "0.50"]


def test_a_frame_of_more_cameras_is_timed_in_a_process_of_its_own():
    wall, cpu, peak = pairs._frame(pairs.ROOT, "zncc", (64, 16, 16, 6, 1))
    assert 0 < wall < 60 and cpu > 0 and 0.1 < peak < 4
