import time

import boards
import numpy as np
import pytest

from course import bench
from course.bench import Row, bench_sgm, bench_sweepnet, bench_training, best_of, opencv_fisheye, table
from omnistereo_lib.calibrate.camera import calibrate_camera


def test_sgm_is_compared_on_the_same_job():
    (row,) = bench_sgm(width=160, height=20, num=32, repeats=1)
    assert min(row.ours_s, row.theirs_s) > 0
    assert "100.00% of 800 rays" in row.note


def test_sweepnet_is_compared_on_the_same_job():
    exact, *half = bench_sweepnet(width=112, height=16, num=16, spheres=range(7, 9))
    assert "2 of 16 spheres, float32" in exact.name
    assert min(exact.ours_s, exact.theirs_s) > 0
    assert float(exact.note.split()[-1]) < 1e-5
    assert all(1e-5 < float(row.note.split()[-1]) < 2e-2 for row in half)


def test_training_is_compared_on_the_same_step():
    (row,) = bench_training(width=96, height=24, num=16, repeats=1)
    assert min(row.ours_s, row.theirs_s) > 0
    assert float(row.note.split()[-4]) < 1e-3


def test_best_of_alternates_and_does_not_count_the_first_round():
    calls = []
    times, results = best_of(2, lambda: calls.append("ours"), lambda: calls.append("theirs") or len(calls))
    assert calls == ["ours", "theirs"] * 3 and results == [None, 6] and 0 <= min(times) <= max(times) < 1
    assert best_of(0, lambda: time.sleep(0.01))[0][0] >= 0.01


def test_a_long_call_is_not_repeated(monkeypatch):
    monkeypatch.setattr(bench, "_LONG", 0.02)
    calls = []
    times, _ = best_of(2, lambda: calls.append("ours"), lambda: calls.append("theirs") or time.sleep(0.03))
    assert calls == ["ours", "theirs", "ours", "ours"] and times[1] >= 0.03


def test_table_shows_the_ratio():
    text = table([Row("a", 0.010, 0.020, "note"), Row("longer", 1.0, 0.5)])
    assert [line.split() for line in text.splitlines()[1:]] == [
        ["a", "10.0", "20.0", "0.50", "note"],
        ["longer", "1000.0", "500.0", "2.00"],
    ]


def test_opencv_gets_a_fair_chance():
    """From our focal length it finds an equidistant camera and the rays of that camera."""
    corners, _ = boards.views(np.random.default_rng(0), 20)
    inside = [view for view in corners if np.linalg.norm(view - boards.CENTER, axis=1).max() < 200 * np.radians(80)]
    start, _ = calibrate_camera(corners, boards.BOARD, boards.SIZE)
    fit = opencv_fisheye(inside, boards.BOARD, boards.SIZE, start)
    assert fit.rms_px == pytest.approx(0.05 * np.sqrt(2), rel=0.1)
    offset = np.array([[100.0, 0], [0, -150], [-180, 60]])
    pixels = boards.CENTER + offset
    r = np.linalg.norm(offset, axis=1, keepdims=True)
    rays = np.hstack([offset / r * np.sin(r / 200), np.cos(r / 200)])
    np.testing.assert_allclose(fit.rays(pixels), rays, atol=2e-3)


def test_opencv_that_fails_has_infinite_error():
    views = [np.full((120, 2), np.nan) for _ in range(3)]
    assert opencv_fisheye(views, boards.BOARD, boards.SIZE).rms_px == np.inf
