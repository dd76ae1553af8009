"""Rigid poses Θ = (r, t), their matrix M(Θ), composition ⋆ and inverse (paper, Section III-A)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.arrays import as_array
from omnistereo_lib.errors import OmnistereoError

Floats = NDArray[np.float64]

# In metres, or in millimetres before a file's unit is known.
_FAR = 1e9
# Files print rotations with 6 digits or more.
_ROTATION_TOLERANCE = 1e-5


@dataclass(frozen=True, eq=False)
class Pose:
    """A rigid transform T_ab: coordinates in frame b become coordinates in frame a.

    Raises an `OmnistereoError` if R or t has the wrong shape, is not finite, or R no rotation.

    >>> T_ab = osl.Pose.from_vector([0, np.pi / 2, 0, 0.5, 0, 0])  # 90° about y, then 0.5 m along x
    >>> (T_ab @ [0, 0, 1]).round(3)
    array([1.5, 0. , 0. ])
    >>> (T_ab @ T_ab.inverse()).magnitude()
    (0.0, 0.0)
    """

    R: Floats  #: rotation matrix (3, 3); rounding as in printed files, up to 1e-5, is corrected
    t: Floats  #: translation (3,) in metres: the origin of frame b in frame a

    def __post_init__(self) -> None:
        R, t = as_array(self.R, "R").copy(), as_array(self.t, "t").copy()
        if R.shape != (3, 3) or t.shape != (3,):
            raise OmnistereoError(
                f"R has shape {R.shape} and t {t.shape}; expected (3, 3) and (3,)"
            )
        if not (np.isfinite(R).all() and np.abs(t).max() < _FAR):  # false for NaN
            raise OmnistereoError(
                f"the pose is R = {R.tolist()}, t = {t.tolist()}; expected finite numbers, t below"
                f" {_FAR:g}"
            )
        U, _, Vt = np.linalg.svd(R)
        nearest = U @ Vt
        error = np.abs(nearest - R).max()
        with np.errstate(over="ignore"):  # R may be anything
            determinant = np.linalg.det(R)
        if error > _ROTATION_TOLERANCE or determinant < 0:
            raise OmnistereoError(
                f"R is not a rotation: it differs by {error:.2g} from the nearest orthogonal matrix"
                f" and has determinant {determinant:.4g}; expected 0 and +1. Check that R is not"
                " scaled or mirrored."
            )
        # Keep exact rotations unchanged: the projection would add a rounding error.
        R = nearest if error > 1e-12 else R
        for name, array in (("R", R), ("t", t)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @classmethod
    def identity(cls) -> Pose:
        """Return the transform that changes nothing."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_vector(cls, theta: ArrayLike) -> Pose:
        """Return M(Θ), Θ = (r, t): axis-angle in radians, then metres (paper, Section III-A)."""
        theta = as_array(theta, "the pose vector")
        if theta.shape != (6,):
            raise OmnistereoError(
                f"the pose vector has shape {theta.shape}; expected 6 numbers (rx ry rz tx ty tz)"
            )
        return cls(rotation_from_axis_angle(theta[:3]), theta[3:])

    def as_vector(self) -> Floats:
        """Return Θ = (r, t), shape (6,): axis-angle in radians with |r| ≤ π, then metres."""
        return np.concatenate([axis_angle_from_rotation(self.R), self.t])

    def inverse(self) -> Pose:
        """Return the inverse transform T_ba (paper, Section III-A)."""
        # x_a = R x_b + t gives x_b = Rᵀ x_a - Rᵀ t.
        return Pose(self.R.T, -self.R.T @ self.t)

    @overload
    def __matmul__(self, other: Pose) -> Pose: ...
    @overload
    def __matmul__(self, other: ArrayLike) -> Floats: ...
    def __matmul__(self, other: Pose | ArrayLike) -> Pose | Floats:
        """Compose poses (T_ab @ T_bc = T_ac, ⋆ of Section III-A), or take points (..., 3) to a."""
        if isinstance(other, Pose):
            return Pose(self.R @ other.R, self.R @ other.t + self.t)
        points = as_array(other, "points")
        if points.shape[-1:] != (3,):
            raise OmnistereoError(f"the points have shape {points.shape}; expected (..., 3)")
        return points @ self.R.T + self.t

    def magnitude(self) -> tuple[float, float]:
        """Return the rotation angle in degrees and the length of the translation in metres."""
        angle = np.linalg.norm(axis_angle_from_rotation(self.R))
        return float(np.degrees(angle)), float(np.linalg.norm(self.t))

    def __repr__(self) -> str:
        r, t = self.as_vector()[:3], self.t
        return f"Pose(axis-angle {np.degrees(r).round(3).tolist()} deg, t {t.round(4).tolist()} m)"


def rotation_from_axis_angle(r: ArrayLike) -> Floats:
    """Return the rotation matrix R(r), (3, 3), by Rodrigues' formula; r in radians, (3,)."""
    r = np.asarray(r, np.float64)
    angle = np.linalg.norm(r)
    K = np.array([[0.0, -r[2], r[1]], [r[2], 0.0, -r[0]], [-r[1], r[0], 0.0]])
    # sin(a)/a and (1 - cos a)/a²; np.sinc keeps both exact down to a = 0.
    return np.eye(3) + np.sinc(angle / np.pi) * K + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * K @ K


def nearest_rotation(M: Floats) -> Floats:
    """Return the rotation nearest to a matrix (..., 3, 3): of a sum of rotations, their mean."""
    # With M = U S Vᵀ it is U diag(1, 1, ±1) Vᵀ, with a determinant of 1 (Kabsch 1976).
    U, _, Vt = np.linalg.svd(M)
    U[..., 2] *= np.linalg.det(U @ Vt)[..., None]
    return np.asarray(U @ Vt, np.float64)


def quaternion_pose(q: Floats, t: Floats) -> Pose:
    """Return the pose of a unit quaternion (w, x, y, z), and a translation."""
    from scipy.spatial.transform import Rotation

    # the largest first: squares can overflow
    if not np.abs(q).max() < 2 or abs(np.linalg.norm(q) - 1) > 1e-3:
        length = np.linalg.norm(q.clip(-1e9, 1e9))
        raise OmnistereoError(
            f"the quaternion {q.tolist()} (w x y z) has length {length:.4g}; expected 1"
        )
    return Pose(Rotation.from_quat(q[[1, 2, 3, 0]]).as_matrix(), t)


def quaternion_from_rotation(R: Floats) -> Floats:
    """Return the unit quaternion (x, y, z, w) of a rotation matrix, w ≥ 0."""
    # Shepperd's method: each row of this symmetric matrix is the quaternion times 4 × one of its
    # components; the row with the largest diagonal entry avoids dividing by a small number.
    xx, yy, zz = np.diag(R)
    sums, differences = R + R.T, R - R.T
    x, y, z = differences[2, 1], differences[0, 2], differences[1, 0]
    Q = np.array(
        [
            [1 + xx - yy - zz, sums[0, 1], sums[0, 2], x],
            [sums[0, 1], 1 - xx + yy - zz, sums[1, 2], y],
            [sums[0, 2], sums[1, 2], 1 - xx - yy + zz, z],
            [x, y, z, 1 + xx + yy + zz],
        ]
    )
    q = Q[np.argmax(np.diag(Q))]
    q = q / np.linalg.norm(q)
    return -q if q[3] < 0 else q


def axis_angle_from_rotation(R: Floats) -> Floats:
    """Return r in radians, shape (3,), with R(r) = R and |r| ≤ π, stable at 0 and at π."""
    q = quaternion_from_rotation(R)
    # q = (sin(a/2) axis, cos(a/2)). The arctangent of both is exact at either end, unlike arccos.
    sine = np.linalg.norm(q[:3])
    if sine < 1e-12:
        return 2.0 * q[:3]
    return q[:3] / sine * 2.0 * np.arctan2(sine, q[3])
