"""What a rig tells about itself and how it moves."""

import numpy as np
import pytest
from test_camera import equidistant

from omnistereo_lib import OmnistereoError, Pose, Rig


def ring(radius=0.2):
    """Four cameras looking outwards, as in the paper; camera 1 looks along +z and is the first."""
    places = radius * np.array([[0, 0, 1], [1, 0, 0], [0, 0, -1], [-1, 0, 0]]) + [0.5, 0, 0]
    poses = [Pose.from_vector([0, k * np.pi / 2, 0, *place]) for k, place in enumerate(places)]
    return Rig([equidistant() for _ in poses], poses, min_depth=0.55)


def test_poses_take_camera_coordinates_to_the_rig():
    """Camera 2 looks along +x: what is a metre in front of it is at +x in the rig."""
    rig = ring()
    np.testing.assert_allclose(rig.T_rig_cam[1] @ [0, 0, 1.0], [0.5 + 0.2 + 1.0, 0, 0], atol=1e-15)
    np.testing.assert_allclose(rig.centers[2], [0.5, 0, -0.2], atol=1e-15)


def test_baselines():
    d = 0.2 * np.sqrt(2)
    np.testing.assert_allclose(ring().baselines, [d, 0.4, d, d, 0.4, d], atol=1e-12)
    assert len(ring()) == 4


def test_centering_moves_without_turning():
    rig = ring().recentered()
    np.testing.assert_allclose(rig.centers.mean(0), 0, atol=1e-15)
    np.testing.assert_allclose(rig.T_rig_cam[1].R, ring().T_rig_cam[1].R)
    np.testing.assert_allclose(ring().recentered([0.7, 0, 0]).centers[1], 0, atol=1e-15)
    assert rig.min_depth == 0.55


def test_moving_the_frame_moves_nothing_in_the_world():
    T = Pose.from_vector([0.1, 0.2, 0.3, 1, 2, 3])
    point = np.array([1.0, 0.4, 2.0])
    for before, after in zip(ring().T_rig_cam, ring().transformed(T).T_rig_cam, strict=True):
        np.testing.assert_allclose(after.inverse() @ (T @ point), before.inverse() @ point, atol=1e-14)


def test_other_poses_for_the_same_cameras():
    rig = ring()
    inverted = rig.with_poses([pose.inverse() for pose in rig.T_rig_cam])
    assert inverted.cameras == rig.cameras and inverted.min_depth == rig.min_depth
    np.testing.assert_allclose(inverted.T_rig_cam[0].t, [-0.5, 0, -0.2])


def test_too_few_cameras_or_poses():
    with pytest.raises(OmnistereoError, match="at least 2 cameras"):
        Rig([equidistant()], [Pose.identity()])
    with pytest.raises(OmnistereoError, match="2 cameras and 1 poses"):
        Rig([equidistant()] * 2, [Pose.identity()])
