"""Bundle adjustment: all cameras, all poses, one least-squares problem (paper, Section III-A).

    minimise over Φ_i, A_i, Θ_i, Θ_k   Σ |x - A_i(Π(M(Θ_i ⋆ Θ_k) X; Φ_i))|²

for the corners x that camera i observes of the board points X in capture k. A single camera is the
same problem with one Θ_i, the identity. The unknowns: see `params`.

The derivatives that `BundleProblem.jacobian` puts together. For a point (X, Y, Z) in the frame of
its camera let n = √(X² + Y²) and p = (X, Y) / n. Its radius r solves g = f(r) n + r Z = 0, with
f(r) = s Σ α_k (r/s)^k, so whatever changes by a little, r changes by -∂g / g', g' = f'(r) n + Z:

    ∂r/∂n = -f / g'        ∂r/∂Z = -r / g'        ∂r/∂α_k = -n s (r/s)^k / g'

The point m = r p of the lens moves outwards as r grows, and across as p turns:

    ∂m/∂(X, Y) = ∂r/∂n p pᵀ + (r/n) (I - p pᵀ)        ∂m/∂Z = ∂r/∂Z p

and the pixel is A m + (u0, v0). A rotation turns y = R(ω) x by dy = -[y]ₓ J(ω) dω, where J is the
left Jacobian of the rotation (Barfoot 2017, Section 7.1.5).
"""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import LinearOperator
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_limits

from omnistereo_lib.geometry.pose import Floats
from omnistereo_rigs.boards.params import (
    NUM_AFFINE,
    CalibrationParams,
    Ints,
    Observations,
    powers_of,
)

# quadratic from the observed radius, which is a few pixels off at first and less later
_NEWTON_STEPS = 8


class _UnpackedParams:
    """Rotations and their derivatives, translations at x, stacked for indexing by corner."""

    def __init__(self, initial: CalibrationParams, x: Floats) -> None:
        cameras, rig = len(initial.intrinsics), initial.num_rig_params
        width = len(initial.intrinsics[0].vector)
        self.intrinsics = x[: cameras * width].reshape(cameras, width)
        moving = np.concatenate([np.zeros((1, 6)), x[cameras * width : rig].reshape(-1, 6)])
        boards = x[rig:].reshape(-1, 6)
        self.R_cam, self.J_cam, self.t_cam = *rotations(moving[:, :3]), moving[:, 3:]
        self.R_board, self.J_board, self.t_board = *rotations(boards[:, :3]), boards[:, 3:]


class BundleProblem:
    """The least-squares problem: residuals and their analytic sparse Jacobian.

    It is made once for some observations, whatever is adjusted to them.

    Args:
        initial: Its sizes are those of the problem.
    """

    def __init__(self, initial: CalibrationParams, observations: Observations) -> None:
        self.initial, self.observations = initial, observations
        self.board_points = observations.points
        self.powers = powers_of(initial.intrinsics[0].degree)
        self.scale = np.array([i.scale for i in initial.intrinsics])[observations.camera]
        self._columns, self._indptr = self._pattern()

    def distances(self, params: CalibrationParams) -> Floats:
        """Return the reprojection error of each corner, shape (M,), px."""
        return np.linalg.norm(self.residuals(params.to_vector()).reshape(-1, 2), axis=-1)

    def residuals(self, x: Floats) -> Floats:
        """Return predicted minus observed pixels, shape (2 M,): u and v of each corner."""
        state = _UnpackedParams(self.initial, x)
        return (self._project(state, self._points(state)[1])[0] - self.observations.pixels).ravel()

    def _points(self, state: _UnpackedParams) -> tuple[Floats, Floats]:
        """Return the corners rotated into the rig frame, and in the camera frame, (M, 3) each."""
        camera, capture = self.observations.camera, self.observations.capture
        rotated = np.einsum("mij,mj->mi", state.R_board[capture], self.board_points)
        in_rig = rotated + state.t_board[capture]
        return rotated, np.einsum("mij,mj->mi", state.R_cam[camera], in_rig) + state.t_cam[camera]

    def _project(self, state: _UnpackedParams, points: Floats) -> tuple[Floats, tuple[Floats, ...]]:
        """Return pixels (M, 2) of points (M, 3) in the cameras, and what `_derivatives` uses."""
        u0, v0, c, d = state.intrinsics[self.observations.camera, :NUM_AFFINE].T
        alpha = state.intrinsics[self.observations.camera, NUM_AFFINE:]
        X, Y, Z = points.T
        n = np.hypot(X, Y)
        off_axis = n > 1e-12  # a point on the axis lies in any direction, at radius 0
        px = np.where(off_axis, X, 1.0) / np.where(off_axis, n, 1.0)
        py = np.where(off_axis, Y, 0.0) / np.where(off_axis, n, 1.0)
        r = self._radius(alpha, n, Z, np.stack([u0, v0], -1))
        mx, my = r * px, r * py
        pixels = np.stack([mx + d * my + u0, d * mx + c * my + v0], -1)
        return pixels, (c, d, alpha, n, Z, px, py, r)

    def _radius(self, alpha: Floats, n: Floats, Z: Floats, center: Floats) -> Floats:
        """Solve f(r) n + r Z = 0 by Newton's method from the observed radius, near the root."""
        r = np.linalg.norm(self.observations.pixels - center, axis=-1)
        limit = 1.5 * r + 0.1 * self.scale
        for _ in range(_NEWTON_STEPS):
            f, slope, _ = self._polynomial(alpha, r)
            r = np.clip(r - (f * n + r * Z) / (slope * n + Z), 0.0, limit)
        return r

    def _polynomial(self, alpha: Floats, r: Floats) -> tuple[Floats, Floats, Floats]:
        """Return f(r), f'(r) and ∂f/∂α_k = s (r/s)^k, shapes (M,), (M,), (M, degree)."""
        ratio = (r / self.scale)[:, None]
        basis = ratio**self.powers
        slope = (alpha[:, 1:] * self.powers[1:] * ratio ** (self.powers[1:] - 1)).sum(axis=1)
        return self.scale * (alpha * basis).sum(axis=1), slope, self.scale[:, None] * basis

    def jacobian(self, x: Floats) -> csr_matrix:
        """Return the derivatives of `residuals`, shape (2 M, unknowns), sparse."""
        state, seen = _UnpackedParams(self.initial, x), self.observations
        turned_board, in_camera = self._points(state)
        turned_rig = in_camera - state.t_cam[seen.camera]
        # By the lens, and by the point in the camera's frame.
        d_intrinsics, d_point = self._derivatives(*self._project(state, in_camera)[1])
        # By the pose of the capture, whose rotation turns the board's point in the rig's frame.
        d_in_rig = d_point @ state.R_cam[seen.camera]
        d_rotation = -d_in_rig @ cross(turned_board) @ state.J_board[seen.capture]
        d_capture = np.concatenate([d_rotation, d_in_rig], -1)
        # By the pose of the camera, whose rotation turns the rig's point.
        d_rotation = -d_point @ cross(turned_rig) @ state.J_cam[seen.camera]
        d_camera = np.concatenate([d_rotation, d_point], -1)
        # All entries of a row, (M, 2, entries), of which camera 1 has no pose.
        entries = np.concatenate([d_intrinsics, d_camera, d_capture], axis=-1)
        entries = entries.reshape(-1, entries.shape[-1])[self._used]
        return csr_matrix(
            (entries, self._columns, self._indptr),
            shape=(2 * len(self.scale), self.initial.num_params),
        )

    def _pattern(self) -> tuple[Ints, Ints]:
        """Return columns and row pointers of the Jacobian; the pose of camera 1 has no columns."""
        cameras, width = len(self.initial.intrinsics), NUM_AFFINE + len(self.powers)
        first_pose = cameras * width
        first_capture = first_pose + 6 * (cameras - 1)
        intrinsics = self.observations.camera[:, None] * width + np.arange(width)
        camera = first_pose + 6 * (self.observations.camera[:, None] - 1) + np.arange(6)
        camera[self.observations.camera == 0] = -1
        capture = first_capture + 6 * self.observations.capture[:, None] + np.arange(6)
        columns = np.repeat(np.concatenate([intrinsics, camera, capture], axis=1), 2, axis=0)
        self._used = columns >= 0
        return columns[self._used], np.concatenate([[0], np.cumsum(self._used.sum(axis=1))])

    def _derivatives(
        self,
        c: Floats,
        d: Floats,
        alpha: Floats,
        n: Floats,
        Z: Floats,
        px: Floats,
        py: Floats,
        r: Floats,
    ) -> tuple[Floats, Floats]:
        """Return the derivatives of pixels by intrinsics (M, 2, 4 + degree), point (M, 2, 3)."""
        f, slope, powers = self._polynomial(alpha, r)
        steep = slope * n + Z
        r_n, r_Z = -f / steep, -r / steep
        # r / n; on the axis, where both are 0, it is -f / Z, since f n + r Z = 0.
        across = np.where(n > 1e-9, r / np.maximum(n, 1e-9), -f / np.where(Z == 0, 1.0, Z))
        mixed = (r_n - across) * px * py
        d_m = _matrices(
            [r_n * px * px + across * py * py, mixed, r_Z * px],
            [mixed, r_n * py * py + across * px * px, r_Z * py],
        )
        one, zero = np.ones_like(c), np.zeros_like(c)
        A = _matrices([one, d], [d, c])
        d_affine = _matrices([one, zero, zero, r * py], [zero, one, r * py, r * px])
        r_alpha = -powers * (n / steep)[:, None]
        d_alpha = (A @ np.stack([px, py], -1)[:, :, None]) * r_alpha[:, None, :]
        return np.concatenate([d_affine, d_alpha], axis=-1), A @ d_m

    # Its factorisations are small: on a busy machine two BLAS threads take four times as long.
    @threadpool_limits.wrap(limits=1, user_api="blas")
    def adjust(
        self,
        initial: CalibrationParams,
        inliers: NDArray[np.bool_] | None = None,
        loss: Literal["linear", "soft_l1"] = "linear",
        fixed: Literal["nothing", "rig"] = "nothing",
        degree: int | None = None,
        steps: int = 50,
        tolerance: float = 1e-9,
    ) -> CalibrationParams:
        """Minimise the reprojection error from initial values that are near enough.

        Args:
            inliers: Corners that count, shape (M,). None: all.
            loss: Squares, or robust beyond one pixel.
            fixed: "rig": only the poses of the captures are adjusted.
            degree: Higher coefficients of the polynomials stay as they are. None: all are adjusted.
            steps: Maximum number of evaluations.
            tolerance: Relative decrease of the cost at which to stop.
        """
        rows = slice(None) if inliers is None else np.flatnonzero(np.repeat(inliers, 2))
        x0 = initial.to_vector()
        first = initial.num_rig_params if fixed == "rig" else initial.num_fixed
        free = np.arange(first, len(x0))
        if degree is not None:
            width, lenses = len(initial.intrinsics[0].vector), initial.num_intrinsics
            free = free[(free >= lenses) | (free % width < NUM_AFFINE + degree)]
        # In whitened unknowns y the columns of the Jacobian are orthonormal initially, and SciPy's
        # iterative solver is done in ten products instead of several hundred.
        P = _whitening(self.jacobian(x0)[rows][:, free])

        def product(A: Floats, v: Floats) -> Floats:
            # not @: on arrays this small BLAS threading costs more than it saves
            return np.einsum("ij,j->i", A, v.ravel())

        def unknowns(y: Floats) -> Floats:
            x = x0.copy()
            x[free] += product(P, y)
            return x

        def jacobian(y: Floats) -> LinearOperator:
            J = self.jacobian(unknowns(y))[rows][:, free]
            return LinearOperator(
                J.shape, matvec=lambda v: J @ product(P, v), rmatvec=lambda u: product(P.T, J.T @ u)
            )

        solution = least_squares(
            lambda y: self.residuals(unknowns(y))[rows],
            np.zeros(len(P)),
            jac=jacobian,
            # a first step that may take away all of the error
            x_scale=np.linalg.norm(self.residuals(x0)[rows]) + 1e-12,
            loss=loss,
            tr_solver="lsmr",
            # SciPy's loose default takes ten times as many steps
            tr_options={"atol": 1e-9, "btol": 1e-9},
            xtol=0.1 * tolerance,
            ftol=tolerance,
            max_nfev=steps,
        )
        return initial.from_vector(unknowns(solution.x))


def bundle_adjust(
    initial: CalibrationParams, observations: Observations, **options: Any
) -> tuple[CalibrationParams, Floats]:
    """Return what `BundleProblem.adjust` finds, and the reprojection error of each corner, px."""
    problem = BundleProblem(initial, observations)
    params = problem.adjust(initial, **options)
    return params, problem.distances(params)


def _whitening(J: csr_matrix) -> Floats:
    """Return P with PᵀJᵀJP = I, by the Cholesky factor of the normal matrix with unit columns."""
    scale = _column_norms(J)
    normal = (J.T @ J).toarray() / np.outer(scale, scale)
    factor = np.linalg.cholesky(normal + 1e-12 * np.eye(len(normal)))
    return np.linalg.inv(factor).T / scale[:, None]


def _column_norms(J: csr_matrix) -> Floats:
    norms = np.sqrt(np.asarray(J.multiply(J).sum(axis=0)).ravel())
    return np.where(norms > 0, norms, 1.0)


@threadpool_limits.wrap(limits=1, user_api="blas")
def estimate_covariance(
    problem: BundleProblem,
    params: CalibrationParams,
    sigma: float,
    inliers: NDArray[np.bool_] | None = None,
) -> Floats:
    """Return the covariance of the rig's unknowns for corner noise `sigma` (px), square.

    The inverse of JᵀJ / σ², without the rows and columns of the board poses; 0 for given
    intrinsics. JᵀJ itself is never formed: it squares the condition number, and the best known
    combinations of unknowns, which rays consist of, would be lost in rounding. Capture by capture,
    an orthogonal projection removes what the board pose can explain, and the rest updates the
    triangle R of a QR factorisation.

    Raises:
        numpy.linalg.LinAlgError: If the corners do not determine all unknowns.
    """
    capture = problem.observations.capture
    kept = np.ones(len(capture), bool) if inliers is None else inliers
    J, capture = problem.jacobian(params.to_vector())[np.repeat(kept, 2)], capture[kept]
    given, rig = params.num_fixed, params.num_rig_params
    covariance = np.zeros((rig, rig))
    if given == rig:
        return covariance
    # unit columns, so that metres and pixels meet in equal numbers
    scale = _column_norms(J)[given:rig]
    R: Any = np.zeros((0, rig - given))  # NumPy's stubs expect Q and R from each mode of qr
    for k in range(len(params.T_rig_board)):
        rows = J[np.repeat(capture == k, 2)]
        of_rig, pose = (
            rows[:, given:rig].toarray() / scale,
            rows[:, rig + 6 * k : rig + 6 * (k + 1)].toarray(),
        )
        Q = np.linalg.qr(pose)[0]
        R = np.linalg.qr(np.concatenate([R, of_rig - Q @ (Q.T @ of_rig)]), mode="r")
    root = np.linalg.inv(R) / scale[:, None]
    covariance[given:, given:] = sigma**2 * root @ root.T
    return covariance


def rotations(r: Floats) -> tuple[Floats, Floats]:
    """Return R(r) and the left Jacobian J with R(r + δ) ≈ (I + [J δ]×) R(r), each (n, 3, 3).

    J = I + (1 - cos a)/a² K + (a - sin a)/a³ K², with a = |r| and K = [r]×.
    """
    K = cross(r)
    angle = np.linalg.norm(r, axis=-1)[:, None, None]
    a = np.maximum(angle, 1e-6)
    small = angle < 1e-6  # the first terms of the series
    first = np.where(small, 0.5, (1 - np.cos(a)) / a**2)
    second = np.where(small, 1 / 6, (a - np.sin(a)) / a**3)
    return Rotation.from_rotvec(r).as_matrix(), np.eye(3) + first * K + second * K @ K


def cross(v: Floats) -> Floats:
    """Return the matrices [v]× of vectors (n, 3), shape (n, 3, 3)."""
    x, y, z = v.T
    zero = np.zeros_like(x)
    return _matrices([zero, -z, y], [z, zero, -x], [-y, x, zero])


def _matrices(*rows: list[Floats]) -> Floats:
    """Stack entries of shape (n,) to matrices (n, rows, columns)."""
    return np.moveaxis(np.array(rows), -1, 0)
