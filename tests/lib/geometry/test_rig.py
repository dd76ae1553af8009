"""Rigs: frames, baselines, changes of frame, and the camera pairs to match."""

import numpy as np
import scene
from test_camera import equidistant

from omnistereo_lib import Pose, Rig
from omnistereo_lib.geometry.rig import camera_pairs


def ring(radius=0.2):
    """Four cameras looking outwards, as in the paper; camera 1 looks along +z and is the first."""
    places = radius * np.array([[0, 0, 1], [1, 0, 0], [0, 0, -1], [-1, 0, 0]]) + [0.5, 0, 0]
    poses = [Pose.from_vector([0, k * np.pi / 2, 0, *place]) for k, place in enumerate(places)]
    return Rig([equidistant() for _ in poses], poses, min_depth=0.55)


def test_poses_map_camera_coordinates_to_the_rig():
    """Camera 2 looks along +x: a point one metre in front of it is at +x in the rig."""
    rig = ring()
    np.testing.assert_allclose(rig.T_rig_cam[1] @ [0, 0, 1.0], [0.5 + 0.2 + 1.0, 0, 0], atol=1e-15)
    d = 0.2 * np.sqrt(2)
    np.testing.assert_allclose(rig.baselines, [d, 0.4, d, d, 0.4, d], atol=1e-12)


def test_recentering_keeps_the_axes():
    rig = ring().recentered()
    np.testing.assert_allclose(rig.centers.mean(0), 0, atol=1e-15)
    np.testing.assert_allclose(rig.T_rig_cam[1].R, ring().T_rig_cam[1].R)
    np.testing.assert_allclose(ring().recentered([0.7, 0, 0]).centers[1], 0, atol=1e-15)
    assert rig.min_depth == 0.55 and rig.cameras[0].max_fov_deg == ring().cameras[0].max_fov_deg


def test_another_frame_leaves_points_in_the_cameras_unchanged():
    T = Pose.from_vector([0.1, 0.2, 0.3, 1, 2, 3])
    point = np.array([1.0, 0.4, 2.0])
    for before, after in zip(ring().T_rig_cam, ring().transformed(T).T_rig_cam, strict=True):
        np.testing.assert_allclose(
            after.inverse() @ (T @ point), before.inverse() @ point, atol=1e-14
        )


def test_pairs():
    assert camera_pairs("ring", scene.rig(cameras=4)) == [(0, 1), (1, 2), (2, 3), (3, 0)]
    assert camera_pairs("ring", scene.rig(cameras=2)) == [(0, 1)]
    assert camera_pairs("all", scene.rig(cameras=3)) == [(0, 1), (0, 2), (1, 2)]
    assert camera_pairs([(2, 0)], scene.rig(cameras=3)) == [(2, 0)]
    assert camera_pairs(np.array([[0, 1], [1, 2]]), scene.rig()) == [(0, 1), (1, 2)]


def test_the_ring_is_sorted_by_azimuth_not_by_number():
    rig = scene.rig(cameras=4)
    order = [0, 2, 3, 1]  # front, back, left, right
    shuffled = Rig([rig.cameras[i] for i in order], [rig.T_rig_cam[i] for i in order])
    assert camera_pairs("ring", shuffled) == [(0, 3), (3, 1), (1, 2), (2, 0)]
