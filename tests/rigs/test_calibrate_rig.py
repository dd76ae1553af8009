"""Calibration of rigs from corners, against poses that are known."""

import re
from dataclasses import replace

import boards
import numpy as np
import pytest
from boards import BOARD, SIZE
from scene import refused

from course.figures.uncertainty import standard_deviation
from omnistereo_lib.geometry.pose import Pose
from omnistereo_rigs import calibrate_rig
from omnistereo_rigs.boards.bundle import BundleProblem, estimate_covariance
from omnistereo_rigs.boards.joint import _rig_warnings
from omnistereo_rigs.boards.params import Intrinsics, collect_observations

GOOD_DEG, GOOD_M = 0.02, 0.5e-3  # what a rig of this size has to reach
DEGREE = 6  # of the polynomials: their choice, which `test_calibrate` tests, takes most of the time
ALONE, SHARED = 6, 6  # captures before each camera, and between two neighbours
BETWEEN = range(4 * ALONE, 4 * (ALONE + SHARED))


@pytest.fixture(scope="module")
def seen_by_four():
    return boards.captures(np.random.default_rng(3), ALONE, SHARED, noise=0.05)


@pytest.fixture(scope="module")
def rigged(seen_by_four):
    return calibrate_rig(seen_by_four, BOARD, [SIZE] * 4, degree=DEGREE)


def errors_of(rig):
    """Degrees and metres by which each camera is off, against camera 1."""
    truth = boards.rig_poses()
    return [
        ((truth[0].inverse() @ there).inverse() @ pose).magnitude()
        for there, pose in zip(truth, rig.T_rig_cam, strict=False)
    ]


def test_a_rig_is_recovered_whatever_end_the_boards_are_read_from(rigged):
    rig, report = rigged
    assert rig.T_rig_cam[0].magnitude() == (0, 0)
    for (angle, shift), (sigma_deg, sigma_m) in zip(
        errors_of(rig)[1:], report.pose_uncertainty()[1:], strict=True
    ):
        assert angle < min(GOOD_DEG, 3 * sigma_deg) and shift < min(GOOD_M, 3 * sigma_m)
    for camera in report.joint:
        reach = camera.max_corner_angle_deg
        assert boards.ray_error_deg(camera.intrinsics, reach_deg=reach) < GOOD_DEG
    assert report.rejected == {} and report.rms_px == pytest.approx(0.05, abs=0.002)
    assert set(report.shared) == {(0, 1), (0, 3), (1, 2), (2, 3)}
    assert min(report.shared.values()) >= 5
    assert "4 cameras" in report.text() and "camera 4:" in report.text()
    places = np.stack([pose.t for pose in boards.rig_poses()])
    apart = dict(
        re.findall(
            r"(\d-\d): (\d\.\d{3})", report.text().split("distances in metres")[1].split("\n")[0]
        )
    )
    assert len(apart) == 6
    for pair, metres in apart.items():
        i, j = (int(number) - 1 for number in pair.split("-"))
        assert float(metres) == pytest.approx(np.linalg.norm(places[i] - places[j]), abs=2 * GOOD_M)


@pytest.mark.parametrize(("degrees", "metres"), [(1.0, 0.005), (20.0, 0.2)])
def test_a_capture_whose_board_moved_is_named_and_changes_nothing(
    seen_by_four, rigged, degrees, metres
):
    both = next(
        k for k in BETWEEN if seen_by_four[0][k] is not None and seen_by_four[1][k] is not None
    )
    moved = Pose.from_vector([np.radians(degrees), 0, 0, 0, metres, 0])
    T_cam_board = rigged[1].joint[1].T_cam_board[both] @ moved
    views = [list(row) for row in seen_by_four[:2]]
    views[1][both] = boards.project(T_cam_board @ BOARD.points)[0]
    rig, report = calibrate_rig(views, BOARD, [SIZE] * 2, degree=DEGREE)
    assert set(report.rejected) == {both} and "moved" in report.rejected[both]
    (angle, shift), (sigma_deg, sigma_m) = errors_of(rig)[1], report.pose_uncertainty()[1]
    assert angle < 3 * sigma_deg and shift < 3 * sigma_m


def test_cameras_that_share_few_captures_are_named_in_one_warning(rigged):
    shared = dict.fromkeys(rigged[1].shared, 4) | {(0, 1): 6}
    (warning,) = _rig_warnings(replace(rigged[1], shared=shared))
    assert warning.startswith("cameras 3, 4 share at most 4 captures with any other. Hold the")


def test_cameras_that_share_no_capture(seen_by_four):
    with refused(r"cameras 1 / 2 are not connected: .* Hold it 5 times or more"):
        calibrate_rig(seen_by_four[::2], BOARD, [SIZE] * 2, degree=DEGREE)


def test_one_shared_capture_of_a_symmetric_board_does_not_show_a_pose(seen_by_four):
    """Read from the other end it is as good: camera 2 came out turned by 180°, "known to 0.08°"."""
    one, two = seen_by_four[:2]
    both = [k for k in range(len(one)) if one[k] is not None and two[k] is not None]
    kept = [None if k in both[1:] else view for k, view in enumerate(two)]
    assert len(BOARD.symmetries) > 1
    with refused("cameras 1 and 2 share one capture, and the board"):
        calibrate_rig([one, kept], BOARD, [SIZE] * 2, degree=DEGREE)


def test_cameras_whose_shared_captures_are_blurred(seen_by_four):
    rng = np.random.default_rng(2)
    views = [list(row) for row in seen_by_four[:3]]  # the first and the third share none
    for k, (b, c) in enumerate(zip(*views[1:], strict=True)):
        if b is not None and c is not None:
            views[2][k] = c + rng.normal(0, 5, c.shape) if k in BETWEEN else None
    reason = r"\d+ views .* were rejected, such as camera 3, \d+: reproj"
    with refused(f"cameras 1 and 2 / 3 are not connected: .* {reason}"):
        calibrate_rig(views, BOARD, [SIZE] * 3, degree=DEGREE)


def test_captures_that_are_shuffled_contradict_each_other(seen_by_four):
    views = [seen_by_four[0], seen_by_four[1][::-1]]
    with refused(r"inconsistent relative poses|not connected"):
        calibrate_rig(views, BOARD, [SIZE] * 2, degree=DEGREE)


def test_what_a_rig_needs(seen_by_four):
    with refused("at least two cameras"):
        calibrate_rig(seen_by_four[:1], BOARD, [SIZE])
    with refused("image_sizes has 1 entries; expected one for each of 4 cameras"):
        calibrate_rig(seen_by_four, BOARD, [SIZE])
    with refused("equally many captures"):
        calibrate_rig([seen_by_four[0], seen_by_four[1][:-1]], BOARD, [SIZE] * 2)
    with refused(r"camera 2: (0 of 0 views|there are no views)"):
        calibrate_rig(
            [seen_by_four[0], [None] * len(seen_by_four[0])], BOARD, [SIZE] * 2, degree=DEGREE
        )


def test_one_camera_given_twice(seen_by_four):
    with refused(r"cameras 1 and 2 have the same corners in all .* captures"):
        calibrate_rig([seen_by_four[0]] * 2, BOARD, [SIZE] * 2, degree=DEGREE)


def test_cameras_that_move_and_one_that_is_unlike_the_others(seen_by_four):
    rng = np.random.default_rng(16)
    views = [list(row) for row in seen_by_four]
    views[0] = [None if v is None else v + rng.normal(0, 0.5, v.shape) for v in views[0]]
    for k in BETWEEN:  # between the exposures each board moves a little
        if views[2][k] is not None:
            azimuth = rng.uniform(0, 2 * np.pi)
            views[2][k] = views[2][k] + 3.0 * np.array([np.cos(azimuth), np.sin(azimuth)])
    text = calibrate_rig(views, BOARD, [SIZE] * 4, degree=DEGREE)[1].text()
    assert "taken at the same time" in text
    # Half of the distances of Gaussian noise are below 1.18 σ.
    error, times = map(
        float,
        re.findall(r"camera 1 has a median error of (\S+) px by itself, (\d+) times", text)[0],
    )
    assert error == pytest.approx(1.18 * 0.5, rel=0.1) and times == pytest.approx(10, abs=1)
    assert text.count("has a median error of") == 1


def test_the_uncertainty_of_a_pose_is_that_of_poses_drawn_from_the_covariance(rigged):
    """Also of camera 3, which looks back: axis-angle vectors are no rotations that one may add."""
    report, rng = rigged[1], np.random.default_rng(5)
    poses = report.params.T_cam_rig[1:]
    noise = rng.multivariate_normal(
        np.zeros(6 * len(poses)), report.covariance[-6 * len(poses) :, -6 * len(poses) :], 600
    )
    for k, (pose, expected) in enumerate(zip(poses, report.pose_uncertainty()[1:], strict=True)):
        drawn = [Pose.from_vector(pose.as_vector() + row[6 * k : 6 * k + 6]) for row in noise]
        moved = np.array([(pose @ other.inverse()).magnitude() for other in drawn])
        np.testing.assert_allclose(np.sqrt((moved**2).mean(0)), expected, rtol=0.08)


def test_the_covariance_keeps_what_is_known_best(rigged, seen_by_four):
    """Rays are known far better than coefficients: no covariance may lose them in rounding."""
    report = rigged[1]
    state = report.params.with_degree(8)
    seen = collect_observations(
        [[row[k] for k in report.captures_used] for row in seen_by_four], BOARD.points
    )
    first = state.intrinsics[0]
    width = len(first.vector)
    pixels = boards.CENTER + 200 * np.radians([[10.0], [50.0], [85.0], [100.0]]) * [0.8, 0.6]

    problem = BundleProblem(state, seen)
    J = problem.jacobian(state.to_vector()).toarray()
    scale = np.linalg.norm(J, axis=0)
    _, s, Vt = np.linalg.svd(J / scale, full_matrices=False)
    # what moves by one standard deviation, each for itself
    steps = (Vt / s[:, None] / scale)[:, :width]
    moved = [Intrinsics(first.vector + step, SIZE).rays(pixels) for step in steps]
    back = [Intrinsics(first.vector - step, SIZE).rays(pixels) for step in steps]
    expected = np.sqrt(sum(np.square((a - b) / 2) for a, b in zip(moved, back, strict=True)))

    spread = estimate_covariance(problem, state, 1.0)[:width, :width]
    found = standard_deviation(lambda v: Intrinsics(v, SIZE).rays(pixels), first.vector, spread)
    np.testing.assert_allclose(found, expected, rtol=1e-3)
