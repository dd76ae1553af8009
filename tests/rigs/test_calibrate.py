"""Calibration: cameras from corners, against lenses and poses that are known."""

from dataclasses import replace

import boards
import numpy as np
import pytest
from boards import BOARD, LENSES, SIZE
from scene import refused

from course.figures.uncertainty import ray_uncertainty_deg
from omnistereo_lib.geometry.pose import Pose
from omnistereo_rigs import calibrate_camera, calibrate_rig
from omnistereo_rigs.boards.bundle import BundleProblem, bundle_adjust, estimate_covariance
from omnistereo_rigs.boards.init import solve_planar_pose
from omnistereo_rigs.boards.params import CalibrationParams, Intrinsics, collect_observations
from omnistereo_rigs.boards.report import ReprojectionErrors

GOOD_DEG = 0.02  # what a rig of this size has to reach


@pytest.fixture(scope="module")
def views():
    return boards.views(np.random.default_rng(0))


@pytest.fixture(scope="module")
def fitted(views):
    return calibrate_camera(views[0], BOARD, image_size=SIZE)


def estimate(cameras=2, captures=3, degree=5):
    """Some unknowns, nothing in them zero."""
    rng = np.random.default_rng(4)
    alpha = np.array([-0.5, 0.3, 0.1, -0.05, 0.02])[:degree]
    intrinsics = [
        Intrinsics(np.array([390.0 + i, 380.0, 1.01, 0.002, *alpha]), SIZE) for i in range(cameras)
    ]
    poses = [Pose.identity()] + [
        Pose.from_vector([*rng.normal(0, 0.3, 3), 0.1, 0.0, 0.1]) for _ in range(cameras - 1)
    ]
    there = [
        Pose.from_vector([*rng.normal(0, 0.4, 3), *rng.normal(0, 0.2, 2), 0.8])
        for _ in range(captures)
    ]
    return CalibrationParams(tuple(intrinsics), tuple(poses), tuple(there))


# --- Bundle


def test_the_jacobian_is_the_derivative_of_the_residuals():
    truth = estimate()
    # The observed pixels say which root of the polynomial is meant: they have to be about right.
    pixels = [
        [
            i.camera(175).project((T_cam @ T_board) @ BOARD.points, use_direct_poly=True)[0] + 1.0
            for T_board in truth.T_rig_board
        ]
        for i, T_cam in zip(truth.intrinsics, truth.T_cam_rig, strict=True)
    ]
    bundle, x = BundleProblem(truth, collect_observations(pixels, BOARD.points)), truth.to_vector()
    J, step = bundle.jacobian(x).toarray(), 1e-6
    numeric = np.stack(
        [
            (bundle.residuals(x + e) - bundle.residuals(x - e)) / (2 * step)
            for e in step * np.eye(len(x))
        ]
    )
    assert J.shape == (2 * 2 * 3 * 120, truth.num_params) and truth.num_params == len(x)
    assert np.abs(J - numeric.T).max() < 1e-6 * np.abs(J).max()


def test_the_residuals_are_those_of_the_camera_class():
    truth = estimate(cameras=1, captures=1)
    uv = (
        truth.intrinsics[0]
        .camera(180)
        .project(truth.T_rig_board[0] @ BOARD.points, use_direct_poly=True)[0]
    )
    bundle = BundleProblem(truth, collect_observations([[uv]], BOARD.points))
    assert np.abs(bundle.residuals(truth.to_vector())).max() < 1e-9


def test_a_point_on_the_axis_has_finite_derivatives():
    on_axis = CalibrationParams(
        estimate(1).intrinsics, (Pose.identity(),), (Pose(np.eye(3), [0, 0, 1.0]),)
    )
    seen = collect_observations([[np.array([[390.0, 380.0]])]], np.zeros((1, 3)))
    J = BundleProblem(on_axis, seen).jacobian(on_axis.to_vector()).toarray()
    a0 = on_axis.intrinsics[0].poly[0]
    assert np.isfinite(J).all()
    # ∂u/∂x = focal length / depth
    assert J[0, -3] == pytest.approx(-a0) and J[1, -2] == pytest.approx(-a0 * 1.01)


def test_all_unknowns_are_determined(views):
    """The smallest singular value of the scaled Jacobian is far from the 1e-8 of a free d - e."""
    report = calibrate_camera(views[0], BOARD, SIZE, degree=4)[1]
    state = CalibrationParams(
        (report.intrinsics,), (Pose.identity(),), tuple(report.T_cam_board.values())
    )
    J = (
        BundleProblem(state, collect_observations([views[0]], BOARD.points))
        .jacobian(state.to_vector())
        .toarray()
    )
    assert np.linalg.svd(J / np.linalg.norm(J, axis=0), compute_uv=False)[-1] > 1e-4


# --- Start


def test_the_pose_of_a_plane_from_rays_behind_the_camera():
    pose = Pose.from_vector([0.2, 1.9, 0.3, 1.0, 0.1, -0.5])
    points = pose @ BOARD.points
    assert (points[:, 2] < 0).all()  # more than 90° from the axis
    found, misfit = solve_planar_pose(
        points / np.linalg.norm(points, axis=1, keepdims=True), BOARD.points
    )
    assert misfit < 1e-7
    assert np.abs(found.R - pose.R).max() < 1e-6 and np.abs(found.t - pose.t).max() < 1e-6


# --- One camera


def test_one_camera_is_recovered(fitted, views):
    camera, report = fitted
    assert boards.ray_error_deg(report.intrinsics, reach_deg=report.max_corner_angle_deg) < GOOD_DEG
    assert report.views_used == tuple(range(24)) and report.rejected == {} and report.outliers == ()
    assert report.rms_px == pytest.approx(0.05, abs=0.002)
    assert report.sigma_px == pytest.approx(0.05, abs=0.002)
    # of a Rayleigh distribution
    assert report.mean_px == pytest.approx(0.05 * np.sqrt(np.pi / 2), abs=0.003)
    assert camera.max_fov_deg == pytest.approx(2 * report.max_corner_angle_deg)
    assert camera.inverse_poly_error_px() < 0.01
    for pose, truth in zip(report.T_cam_board.values(), views[1], strict=True):
        angle, shift = (pose.inverse() @ truth).magnitude()
        assert angle < 0.1 and shift < 2e-3


@pytest.mark.parametrize("lens", [lens for lens in LENSES if lens != "equidistant 210"])
def test_every_kind_of_lens_is_recovered(lens):
    corners, _ = boards.views(np.random.default_rng(17), lens=lens)
    report = calibrate_camera(corners, BOARD, SIZE, degree=8)[1]
    reach = 0.95 * report.max_corner_angle_deg
    expected = ray_uncertainty_deg(report, np.linspace(1, reach, 10)).max()
    assert boards.ray_error_deg(report.intrinsics, lens, reach_deg=reach) < 2.5 * expected < 0.1


def test_corners_may_be_missing(views):
    rng = np.random.default_rng(6)
    holes = [np.where(rng.random((120, 1)) < 0.2, np.nan, view) for view in views[0]]
    report = calibrate_camera([*holes, None], BOARD, SIZE, degree=6)[1]
    reach = report.max_corner_angle_deg
    assert boards.ray_error_deg(report.intrinsics, reach_deg=reach) < 1.5 * GOOD_DEG
    assert len(report.inlier_residuals()) == sum(np.isfinite(view[:, 0]).sum() for view in holes)


def test_wrong_corners_are_named_and_change_nothing(fitted, views):
    rng = np.random.default_rng(7)
    corners = [view.copy() for view in views[0]]
    which, where = rng.integers(0, 24, 100), rng.integers(0, 120, 100)
    wrong = {(int(v), int(k)) for v, k in zip(which, where, strict=True)}
    for view, corner in wrong:
        angle = rng.uniform(0, 2 * np.pi)
        corners[view][corner] += rng.uniform(3, 20) * np.array([np.cos(angle), np.sin(angle)])
    report = calibrate_camera(corners, BOARD, SIZE, degree=fitted[1].degree)[1]
    assert {(view, corner) for view, corner, _ in report.outliers} == wrong
    difference = report.intrinsics.vector - fitted[1].intrinsics.vector
    assert (np.abs(difference) < 2 * np.sqrt(np.diag(fitted[1].covariance))).all()


def test_a_wrong_corner_at_the_rim_widens_nothing(fitted, views):
    corners = [view.copy() for view in views[0]]
    corners[3][0] = 2.0  # in the black corner of the picture
    camera, report = calibrate_camera(corners, BOARD, SIZE)
    assert [outlier[:2] for outlier in report.outliers] == [(3, 0)]
    assert camera.max_fov_deg == pytest.approx(fitted[0].max_fov_deg, abs=1.0)
    assert report.cv_error_px == pytest.approx(fitted[1].cv_error_px, rel=0.05)


def test_a_view_that_does_not_fit_is_named(fitted, views):
    corners = [view.copy() for view in views[0]]
    corners[4] += np.random.default_rng(8).normal(0, 2.0, corners[4].shape)  # blurred
    report = calibrate_camera(corners, BOARD, SIZE, degree=6)[1]
    assert set(report.rejected) == {4} and 4 not in report.views_used
    assert "reprojection error" in report.rejected[4]
    assert "view 4 rejected" in report.text()
    assert "view 0005 rejected" in report.text([f"{k:04d}" for k in range(1, 25)])


def test_a_second_board_that_stands_still_is_left_out(views):
    """A board in the hand never comes back to the same pixels."""
    rng = np.random.default_rng(18)
    # flat, as no fisheye sees it
    second = boards.CENTER + 9 * (BOARD.points[:, :2] / BOARD.square - [5.5, 4.5])
    corners = list(views[0])
    for k in (2, 7, 8, 15):
        corners[k] = second + rng.normal(0, 0.05, second.shape)
    report = calibrate_camera(corners, BOARD, SIZE, degree=6)[1]
    assert set(report.rejected) == {2, 7, 8, 15} and "a second board" in report.text()
    reach = report.max_corner_angle_deg
    assert boards.ray_error_deg(report.intrinsics, reach_deg=reach) < 1.5 * GOOD_DEG
    # held still; a picture given twice
    for still in ([views[0][0]] * 3 + views[0], [views[0][0], *views[0]]):
        assert calibrate_camera(still, BOARD, SIZE, degree=4)[1].rejected == {}
    with refused("2 of 5 views show the board; 3 show a second board"):
        calibrate_camera([second, views[0][0], second, views[0][1], second], BOARD, SIZE)


def test_the_degree_is_what_held_back_views_ask_for():
    truth = estimate(1, degree=3).intrinsics[0].with_degree(4)  # f of degree 3
    cam = truth.camera(170)
    rng = np.random.default_rng(9)
    corners = []
    while len(corners) < 12:
        uv, seen = cam.project(boards.somewhere(rng, 70) @ BOARD.points, use_direct_poly=True)
        if seen.all():
            corners.append(uv + rng.normal(0, 0.05, uv.shape))
    assert calibrate_camera(corners, BOARD, SIZE)[1].degree == 4
    steep, _ = boards.views(rng, 14, "equisolid 210")
    report = calibrate_camera(steep, BOARD, SIZE)[1]
    assert report.degree > 4 and report.cv_error_px[4] > 1.2 * report.cv_error_px[report.degree]


def test_errors_lie_within_the_predicted_covariance():
    """χ² of the rays' parameters over repeated noise: as large as the covariance says."""
    rng = np.random.default_rng(10)
    truth = estimate(1, degree=4).intrinsics[0]
    cam, exact, poses = truth.camera(170), [], []
    while len(exact) < 10:
        pose = boards.somewhere(rng, 70)
        uv, seen = cam.project(pose @ BOARD.points, use_direct_poly=True)
        if seen.all():
            exact.append(uv)
            poses.append(pose)
    state = CalibrationParams((truth,), (Pose.identity(),), tuple(poses))
    size, runs, noise = state.num_rig_params, 25, 0.1
    seen = collect_observations([exact], BOARD.points)
    inverse = np.linalg.inv(estimate_covariance(BundleProblem(state, seen), state, noise))
    squares = []
    for _ in range(runs):
        noisy = collect_observations(
            [[uv + rng.normal(0, noise, uv.shape) for uv in exact]], BOARD.points
        )
        error = bundle_adjust(state, noisy)[0].to_vector()[:size] - state.to_vector()[:size]
        squares.append(error @ inverse @ error)
    # The mean of 25 χ² values with 8 degrees of freedom is within 8 ± 4 · sqrt(16 / 25).
    assert abs(np.mean(squares) - size) < 4 * np.sqrt(2 * size / runs)


def test_a_view_with_another_number_of_corners_is_named(views):
    with refused("view 2: 108 corners; expected 120, those of a board of 12 x 10"):
        calibrate_camera([None, views[0][0], views[0][1][:-12]], BOARD, image_size=SIZE)
    with refused(r"camera 1: view c\.png: 108 corners"):
        calibrate_rig(
            [[views[0][0], None, views[0][1][:-12]]] * 2,
            BOARD,
            [SIZE] * 2,
            names=["a", "b", "c.png"],
        )


def test_an_image_size_that_is_not_that_of_the_corners(views):
    with refused(r"px from the middle of an image of \(64, 48\); check the image size"):
        calibrate_camera(views[0], BOARD, image_size=(64, 48))


def test_a_part_of_the_board_is_not_the_board(monkeypatch):
    """A few views show a part as large as the board given: these are accidents."""
    from omnistereo_rigs.boards import single_camera

    monkeypatch.setattr(
        single_camera, "suggest_board", lambda images, board, only_larger: ((13, 10), 5)
    )
    corners = [*boards.views(np.random.default_rng(0), count=3)[0], *[None] * 7]
    with refused(r"3 of 10 views show .* 13 x 10 inner corners is found in 5"):
        single_camera.calibrate_corners(corners, SIZE, [np.zeros(SIZE[::-1], np.uint8)] * 10, BOARD)


def test_parallel_boards():
    rng = np.random.default_rng(11)
    places = [Pose(np.eye(3), [*rng.uniform(-0.6, 0.2, 2), z]) for z in rng.uniform(0.6, 1.2, 8)]
    corners = [boards.project(pose @ BOARD.points)[0] for pose in places]
    with refused(r"parallel to within .* Tilt the board"):
        calibrate_camera(corners, BOARD, image_size=SIZE)


def test_a_field_of_view_that_no_corner_reached(views):
    rng = np.random.default_rng(12)
    middle = []
    while len(middle) < 12:
        uv, seen = boards.project(boards.somewhere(rng, 45) @ BOARD.points)
        if seen.all():
            middle.append(uv + rng.normal(0, 0.1, uv.shape))
    _, report = calibrate_camera(middle, BOARD, SIZE, degree=4, max_fov_deg=180)
    assert any("no corner beyond" in warning and "90°" in warning for warning in report.warnings)
    _, report = calibrate_camera(views[0][:8], BOARD, SIZE, degree=4)
    assert any("only 8 views" in warning for warning in report.warnings)
    assert "Check the board size" not in report.text()
    accident = replace(report, rejected=dict.fromkeys(range(8, 40), "no board found"), warnings=())
    assert "Check the board size" in accident.build_camera(180)[1].text()


def test_cropped_and_stretched_pictures_are_noticed(views):
    cropped = [view - [200, 0] for view in views[0][:14] if (view[:, 0] > 200).all()]
    assert "a crop is fine" in calibrate_camera(cropped, BOARD, (600, 768), degree=4)[1].text()
    stretched = [view * [1.0, 1.1] for view in views[0][:14]]
    assert "different factors" in calibrate_camera(stretched, BOARD, (800, 845), degree=4)[1].text()


# --- Report


def test_three_definitions_of_error():
    errors = ReprojectionErrors.from_residuals(np.array([[3.0, 4.0], [0.0, 0.0], [np.nan, np.nan]]))
    assert (errors.rms_px, errors.rms_distance_px, errors.mean_px) == pytest.approx(
        (2.5, np.sqrt(12.5), 2.5)
    )
    assert np.isnan(ReprojectionErrors.from_residuals(np.full((2, 2), np.nan)).rms_px)


def test_the_report_accounts_for_every_corner(fitted):
    report = fitted[1]
    assert sum(count for _, count, _ in report.errors_by_angle()) == 24 * 120
    assert set(report.residuals_used()) == set(range(24))
    assert f"{report.rms_px:.3f} px rms in u and v" in report.text()
