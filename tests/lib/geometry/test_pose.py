"""Poses against SciPy's rotations and OpenCV's Rodrigues."""

import warnings

import cv2
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scene import refused
from scipy.spatial.transform import Rotation

from omnistereo_lib import Pose
from omnistereo_lib.geometry.pose import axis_angle_from_rotation, rotation_from_axis_angle

unit_vectors = (
    st.tuples(*[st.floats(-1, 1)] * 3).map(np.array).filter(lambda v: np.linalg.norm(v) > 0.1)
)
axes = unit_vectors.map(lambda v: v / np.linalg.norm(v))
angles = st.one_of(
    st.floats(0, np.pi),
    st.floats(0, 1e-6),
    st.floats(0, 1e-6).map(lambda small: np.pi - small),
    st.sampled_from([0.0, 1e-12, 1e-9, np.pi / 2, np.pi - 1e-12, np.pi]),
)


@given(axes, angles)
def test_rodrigues_agrees_with_scipy_and_opencv(axis, angle):
    R = rotation_from_axis_angle(axis * angle)
    np.testing.assert_allclose(R, Rotation.from_rotvec(axis * angle).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(R, cv2.Rodrigues(axis * angle)[0], atol=1e-9)


@given(axes, angles)
@example(np.array([0.0, 0.0, -1.0]), np.pi)
@example(np.array([0.0, 1.0, 0.0]), np.pi)
def test_axis_angle_agrees_with_scipy(axis, angle):
    R = Rotation.from_rotvec(axis * angle)
    ours = Rotation.from_rotvec(axis_angle_from_rotation(R.as_matrix()))
    assert (ours.inv() * R).magnitude() < 1e-14


vectors = st.tuples(*[st.floats(-3, 3)] * 6)


@given(vectors, vectors)
def test_group_laws(a, b):
    A, B = Pose.from_vector(a), Pose.from_vector(b)
    points = np.random.default_rng(0).normal(size=(2, 5, 3))
    np.testing.assert_allclose((A @ B) @ points, A @ (B @ points), atol=1e-12)
    np.testing.assert_allclose(A.inverse() @ (A @ points), points, atol=1e-12)
    identity = A @ A.inverse()
    np.testing.assert_allclose(identity.R, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(identity.t, 0, atol=1e-13)


def test_points_move_as_the_homogeneous_matrix_says():
    pose = Pose.from_vector([0.3, -1.2, 0.7, 0.1, 0.2, -0.5])
    M = np.eye(4)
    M[:3, :3], M[:3, 3] = Rotation.from_rotvec([0.3, -1.2, 0.7]).as_matrix(), [0.1, 0.2, -0.5]
    np.testing.assert_allclose(pose @ [1.0, 2.0, 3.0], (M @ [1, 2, 3, 1])[:3], atol=1e-14)
    np.testing.assert_allclose(pose.inverse().R, np.linalg.inv(M)[:3, :3], atol=1e-14)
    np.testing.assert_allclose(pose.inverse().t, np.linalg.inv(M)[:3, 3], atol=1e-14)
    np.testing.assert_allclose(pose.as_vector(), [0.3, -1.2, 0.7, 0.1, 0.2, -0.5], atol=1e-14)


def test_identity_and_magnitude():
    np.testing.assert_array_equal(Pose.identity() @ [[1.0, 2.0, 3.0]], [[1.0, 2.0, 3.0]])
    degrees, metres = Pose.from_vector([0, np.pi / 3, 0, 3, 0, 4]).magnitude()
    assert degrees == pytest.approx(60) and metres == pytest.approx(5)
    assert "60" in repr(Pose.from_vector([0, np.pi / 3, 0, 3, 0, 4]))


def test_a_printed_rotation_becomes_the_nearest_one():
    exact = Rotation.from_rotvec([0.3, -1.2, 0.7]).as_matrix()
    pose = Pose(np.round(exact, 6), np.zeros(3))
    np.testing.assert_allclose(pose.R @ pose.R.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(pose.R, exact, atol=2e-6)


def test_a_huge_matrix_is_refused_without_a_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with refused("not a rotation"):
            Pose(np.full((3, 3), 1e200) * np.eye(3), np.zeros(3))
