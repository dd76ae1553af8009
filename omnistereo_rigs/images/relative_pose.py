"""Relative pose of two cameras from matched rays, without any prior: the essential matrix.

    yᵀ E x = 0,  E = [t]× R,  for the unit rays x and y of one point, y ∝ R x + t / depth

The equation is linear in E and holds for rays of any direction, also behind the camera.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from omnistereo_lib.geometry.pose import Floats, Pose, rotation_from_axis_angle
from omnistereo_rigs.boards.bundle import cross

# An inlier of RANSAC is this near to its epipolar plane. Lenses of real files are off by about as
# much.
_TOLERANCE = np.radians(0.3)
# RANSAC draws this many samples at a time, and at most this many times.
_BATCH, _ROUNDS = 250, 24
# A pose is believed if at least 40 matches, and three in ten, agree on it: see `believable`.
_MIN_INLIERS, _MIN_SHARE = 40, 0.3
# The scale of the robust cost in `_refine`: beyond it a residual counts less and less.
_NOISE = np.radians(0.05)


@dataclass(frozen=True, eq=False)
class RelativePose:
    """Pose of camera a in the frame of camera b, up to scale."""

    T_b_a: Pose  # |t| = 1
    inliers: int
    matches: int

    @property
    def believable(self) -> bool:
        """Whether so many of the matches agree that it is not chance."""
        return self.inliers >= max(_MIN_INLIERS, _MIN_SHARE * self.matches)


def epipolar_residuals(E: Floats, x: Floats, y: Floats) -> Floats:
    """Return the sine of the angle between y and the epipolar plane of x, or the reverse if larger.

    Args:
        E: essential matrices (..., 3, 3)
        x, y: unit rays (M, 3) of the first and of the second camera

    Returns:
        array, shape (..., M), with sign
    """
    # E x is normal to the plane through both centres and x, as seen from b; Eᵀ y is that of y, from
    # a. Divided by the length of the normal, yᵀ E x is the sine of the angle to the plane; the
    # shorter of the two normals gives the larger sine.
    planes_b = np.einsum("...ij,mj->...mi", E, x)
    planes_a = np.einsum("...ji,mj->...mi", E, y)
    products = np.einsum("...mi,mi->...m", planes_b, y)
    shorter = np.minimum(np.linalg.norm(planes_a, axis=-1), np.linalg.norm(planes_b, axis=-1))
    return products / np.maximum(shorter, 1e-9)


def eight_point(x: Floats, y: Floats) -> Floats:
    """Return essential matrices (..., 3, 3) of 8 or more pairs of unit rays (..., M, 3)."""
    # Each match gives one equation Σ y_i x_j E_ij = 0. The nine numbers that solve all of them best
    # are the last singular vector (Longuet-Higgins 1981; Hartley and Zisserman 2004, Section 11.1).
    equations = (y[..., :, None] * x[..., None, :]).reshape(*x.shape[:-1], 9)
    E = np.linalg.svd(np.swapaxes(equations, -1, -2) @ equations)[2][..., -1, :].reshape(
        *x.shape[:-2], 3, 3
    )
    # The nearest matrix [t]ₓ R: two singular values are equal, the third is 0.
    U, _, Vt = np.linalg.svd(E)
    return U @ np.diag([1.0, 1.0, 0.0]) @ Vt


def decompositions(E: Floats) -> list[Pose]:
    """Return the four poses T_b_a, |t| = 1, that an essential matrix may be of."""
    U, _, Vt = np.linalg.svd(E)
    # E = U diag(1, 1, 0) Vᵀ is of four poses: R = U W Vᵀ or U Wᵀ Vᵀ, and t along the last column of
    # U or against it (Hartley and Zisserman 2004, Section 9.6.2). Both U and V are made rotations
    # first.
    U, Vt = U * np.sign(np.linalg.det(U)), Vt * np.sign(np.linalg.det(Vt))
    W = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return [Pose(U @ turn @ Vt, sign * U[:, 2]) for turn in (W, W.T) for sign in (1, -1)]


def depths(T_b_a: Pose, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return the distances (M,) along x and y at which the rays are nearest to each other."""
    # Minimise |α x' + t - β y|² with x' = R x and c = x' · y. Both derivatives are 0 at
    #     α = (c (y · t) - x' · t) / (1 - c²),    β = (y · t - c (x' · t)) / (1 - c²)
    there = x @ T_b_a.R.T
    cosine = np.einsum("mi,mi->m", there, y)
    sine2 = np.maximum(1 - cosine**2, 1e-12)
    along_x, along_y = there @ T_b_a.t, y @ T_b_a.t
    return (cosine * along_y - along_x) / sine2, (along_y - cosine * along_x) / sine2


def relative_pose(x: Floats, y: Floats, ratio: Floats) -> RelativePose | None:
    """Find the relative pose on which most matches agree; None if there are fewer than 20 matches.

    Args:
        x, y: unit rays (M, 3) of the first and of the second camera
        ratio: (M,), low is sure: samples are drawn from sure matches first
    """
    if len(x) < 20:
        return None
    # RANSAC over samples of eight matches, sure ones first (as PROSAC does; Chum and Matas 2005).
    order = np.argsort(ratio, kind="stable")
    x, y = x[order], y[order]
    rng = np.random.default_rng(0)
    best, most = np.eye(3), -1
    for k in range(_ROUNDS):
        # The pool grows from a quarter of the matches to all of them.
        pool = max(16, int(len(x) * min(1.0, 0.25 + k / _ROUNDS)))
        sample = rng.integers(0, pool, (_BATCH, 8))
        E = eight_point(x[sample], y[sample])
        counts = (np.abs(epipolar_residuals(E, x, y)) < _TOLERANCE).sum(axis=1)
        if counts.max() > most:
            best, most = E[counts.argmax()], int(counts.max())
        # A sample of eight has no outlier with probability (inliers / matches)⁸. Stop once eight
        # such samples are expected among those drawn.
        if (k + 1) * _BATCH * (most / len(x)) ** 8 > 8:
            break
    # Too few agree on anything: return a pose that nobody believes.
    if most < 12:
        return RelativePose(Pose(np.eye(3), np.array([1.0, 0.0, 0.0])), 0, len(x))
    # From the best sample to all of its inliers, which change a little each time.
    for _ in range(3):
        inlier = np.abs(epipolar_residuals(best, x, y)) < _TOLERANCE
        if inlier.sum() >= 12:
            best = eight_point(x[inlier], y[inlier])
    inlier = np.abs(epipolar_residuals(best, x, y)) < _TOLERANCE
    # Of the four poses take the one that has most points in front of both cameras, then refine it.
    in_front = [
        sum((depth > 0).sum() for depth in depths(T, x[inlier], y[inlier]))
        for T in decompositions(best)
    ]
    T = _refine(decompositions(best)[int(np.argmax(in_front))], x[inlier], y[inlier])
    agree = np.abs(epipolar_residuals(cross(T.t[None])[0] @ T.R, x, y)) < _TOLERANCE
    return RelativePose(T, int(agree.sum()), len(x))


def _refine(T: Pose, x: Floats, y: Floats) -> Pose:
    """Minimise the angles to the epipolar planes over rotation and direction, robustly."""
    # Only the direction of t can be seen: it moves along two tangents, so there are five unknowns.
    basis = np.linalg.svd(T.t[None])[2][1:]

    def moved(p: Floats) -> Pose:
        t = T.t + p[3:] @ basis
        return Pose(rotation_from_axis_angle(p[:3]) @ T.R, t / np.linalg.norm(t))

    def residuals(p: Floats) -> Floats:
        now = moved(p)
        return epipolar_residuals(cross(now.t[None])[0] @ now.R, x, y) / _NOISE

    return moved(least_squares(residuals, np.zeros(5), loss="cauchy").x)
