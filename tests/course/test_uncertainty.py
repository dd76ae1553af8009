"""What an error of the calibration does to depth: by geometry, by the sweep, and from a report."""

import boards
import numpy as np
import pytest
import scene

import omnistereo_lib as osl
from course.exercises.nb02 import sphere_shift
from course.figures.uncertainty import index_shift, index_uncertainty
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.rig import camera_pairs
from omnistereo_rigs import calibrate_rig


def test_index_shift_of_a_rotated_camera_by_geometry():
    """Side by side, one rotated by α: parallax and inverse depth are off by α everywhere."""
    camera = scene.camera()
    rig = osl.Rig([camera, camera], [Pose(np.eye(3), [-0.1, 0, 0]), Pose(np.eye(3), [0.1, 0, 0])])
    alpha = np.radians(0.1)
    wrong = rig.with_poses(
        [rig.T_rig_cam[0], rig.T_rig_cam[1] @ Pose.from_vector([0, alpha, 0, 0, 0, 0])]
    )
    grid = osl.SphereGrid(72, 3, (-3, 3), 192, 0.5)
    shift = index_shift(rig, wrong, grid, index=20, pairs=[(0, 1)])
    middle = shift[1, 36]  # straight ahead: the ray meets the baseline at a right angle
    depth = grid.index_to_depth(20)
    # Rotated to the right, camera 2 takes things to be further right: the rays meet further away.
    parallax = 2 * np.arctan(0.1 / depth)
    apparent = 0.2 / (2 * np.tan((parallax - alpha) / 2))
    assert middle == pytest.approx(grid.depth_to_index(apparent) - 20, rel=0.03)
    assert np.nanmax(np.abs(index_shift(rig, rig, grid, 20))) < 1e-9


def test_index_shift_is_what_the_sweep_finds():
    """In the box of known depth: median over the rays that are predicted to move."""
    rig, grid = scene.rig(), osl.SphereGrid(160, 40, (-30, 30), 64, 1.0)
    images = scene.images(rig)
    wrong = rig.with_poses(
        [rig.T_rig_cam[0] @ Pose.from_vector([0, np.radians(0.8), 0, 0, 0, 0]), *rig.T_rig_cam[1:]]
    )
    before, after = (
        osl.estimate_depth(osl.Frame.of(which, images), grid, "zncc+sgm").index
        for which in (rig, wrong)
    )
    predicted = index_shift(
        rig.recentered(), wrong.recentered(rig.centers.mean(0)), grid, np.nanmedian(before)
    )
    strong = np.abs(predicted) > 0.7 * np.nanmax(np.abs(predicted))
    moved = np.nanmedian((after - before)[strong] * np.sign(predicted[strong]))
    assert moved > 0.4 * np.median(np.abs(predicted[strong]))


def test_a_students_shift_is_that_of_the_derivatives():
    rig, grid = scene.rig().recentered(), osl.SphereGrid(40, 10, (-30, 30), 64, 1.0)
    error = Pose.from_vector([0, 1e-4, 5e-5, 1e-4, 0, 1e-4])
    wrong = rig.with_poses([rig.T_rig_cam[0] @ error, *rig.T_rig_cam[1:]])
    pairs = camera_pairs("ring", rig)
    mine = sphere_shift(rig, wrong, grid, np.full(grid.shape, 20.0), pairs)
    theirs = index_shift(rig, wrong, grid, 20)
    assert np.array_equal(np.isnan(mine), np.isnan(theirs))
    assert np.nanmax(np.abs(mine - theirs)) < 0.1 * np.nanmax(np.abs(theirs))


def test_index_uncertainty_of_a_calibrated_rig():
    rows = boards.captures(np.random.default_rng(2), alone=3, shared=4, noise=0.05)[:2]
    _, report = calibrate_rig(rows, boards.BOARD, [boards.SIZE] * 2, degree=4)
    spread = index_uncertainty(report, osl.SphereGrid(16, 4, (-30, 30), 192, 0.55), 50)
    assert np.nanmin(spread) > 1e-3 and np.nanmax(spread) < 0.3
