"""Bundle adjustment: all cameras, all poses, one least-squares problem (paper, Section III-A).

    minimise over Φ_i, A_i, Θ_i, Θ_k   Σ |x - A_i(Π(M(Θ_i ⋆ Θ_k) X; Φ_i))|²

for the corners x that camera i sees of the board's points X in capture k. One camera by itself is the same
problem with a single Θ_i, which stays the identity.

The parameters of a camera are u0, v0, c, d, α0, α2, …, αM. Three of the model's freedoms are no freedoms:

- The polynomial is written f(r) = s (α0 + α2 (r/s)² + …), s half the image's larger side, so that all numbers
  are of the order of one. Released files have a_k = α_k s^(1-k). There is no a1: f is smooth across the axis.
- e = d. A camera that turns about its axis and a matrix A that turns back give the same pixels, so A is kept
  symmetric: all the turning is in the pose.
- Camera 1 is the rig's frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import LinearOperator

from omnistereo_lib.geometry.camera import OcamCamera, fit_inverse_polynomial
from omnistereo_lib.geometry.pose import Pose

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_NEWTON_STEPS = 8  # quadratic from the observed radius, which is a few pixels off at the start and less later
_SHAPE = 4  # u0, v0, c, d: what a camera has besides its polynomial


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """One camera's Φ and A as the optimiser sees them.

    Parameters
    ----------
    vector : array, shape (4 + M,)
        u0, v0 (pixels), c, d = e, then α0, α2, …, αM (M numbers for a polynomial of degree M).
    image_size : (int, int)
        Width and height, pixels.
    """

    vector: Floats
    image_size: tuple[int, int]

    @property
    def degree(self) -> int:
        """Degree M of the polynomial."""
        return len(self.vector) - _SHAPE

    @property
    def scale(self) -> float:
        """The polynomial's unit of length s, pixels."""
        return max(self.image_size) / 2

    @property
    def poly(self) -> Floats:
        """The direct polynomial a0, 0, a2, …, aM of the files, pixels, low to high."""
        powers = _powers(self.degree)
        poly = np.zeros(self.degree + 1)
        poly[powers] = self.vector[_SHAPE:] * self.scale ** (1.0 - powers)
        return poly

    def raised(self, degree: int) -> Intrinsics:
        """Return the same camera with a polynomial of a higher degree, the new coefficients 0."""
        more = np.zeros(degree - self.degree)
        return Intrinsics(np.concatenate([self.vector, more]), self.image_size)

    def rays(self, pixels: Floats) -> Floats:
        """Return the unit rays of pixels (..., 2) by the direct polynomial, shape (..., 3), camera frame."""
        u0, v0, c, d = self.vector[:_SHAPE]
        xy = (pixels - [u0, v0]) @ np.linalg.inv([[1.0, d], [d, c]]).T
        depth = -np.polynomial.polynomial.polyval(np.linalg.norm(xy, axis=-1), self.poly)
        rays = np.concatenate([xy, depth[..., None]], axis=-1)
        return rays / np.linalg.norm(rays, axis=-1, keepdims=True)

    def camera(self, max_fov_deg: float) -> OcamCamera:
        """Return the camera, its inverse polynomial fitted to better than 0.01 px.

        Raises
        ------
        OmnistereoError
            If the polynomial turns back before the field of view ends.
        """
        u0, v0, c, d = (float(value) for value in self.vector[:_SHAPE])
        inv_poly = fit_inverse_polynomial(self.poly, max_fov_deg, 3.0 * max(self.image_size))
        return OcamCamera(self.poly, inv_poly, (u0, v0), (c, d, d), self.image_size, max_fov_deg)


@dataclass(frozen=True, eq=False)
class Observations:
    """M corners seen: which camera saw which point of the board in which capture, and where.

    Parameters
    ----------
    camera, capture, corner : int arrays, shape (M,)
        Indices from 0.
    points : array, shape (M, 3)
        On the board, metres.
    pixels : array, shape (M, 2)
    """

    camera: Ints
    capture: Ints
    corner: Ints
    points: Floats
    pixels: Floats

    def where(self, kept: NDArray[np.bool_]) -> Observations:
        """Return some of the corners."""
        columns = (self.camera, self.capture, self.corner, self.points, self.pixels)
        return Observations(*(column[kept] for column in columns))


@dataclass(frozen=True, eq=False)
class Estimate:
    """All unknowns at once.

    Parameters
    ----------
    intrinsics : tuple of Intrinsics
        One for each camera.
    T_cam_rig : tuple of Pose
        The paper's Θ_i: rig → camera. The first is the identity.
    T_rig_board : tuple of Pose
        The paper's Θ_k: board → rig, one for each capture.
    """

    intrinsics: tuple[Intrinsics, ...]
    T_cam_rig: tuple[Pose, ...]
    T_rig_board: tuple[Pose, ...]

    def vector(self) -> Floats:
        """Return all unknowns in a row: each camera's, the poses of cameras 2 …, the poses of the captures."""
        poses = [*self.T_cam_rig[1:], *self.T_rig_board]
        return np.concatenate([*(i.vector for i in self.intrinsics), *(pose.as_vector() for pose in poses)])

    def with_vector(self, x: Floats) -> Estimate:
        """Return the estimate that such a row of unknowns stands for."""
        ends = np.cumsum([len(i.vector) for i in self.intrinsics])
        parts, rest = np.split(x[: ends[-1]], ends[:-1]), x[ends[-1] :].reshape(-1, 6)
        intrinsics = [Intrinsics(part, i.image_size) for part, i in zip(parts, self.intrinsics, strict=True)]
        poses = [Pose.from_vector(theta) for theta in rest]
        moving = len(self.T_cam_rig) - 1
        return Estimate(tuple(intrinsics), (Pose.identity(), *poses[:moving]), tuple(poses[moving:]))

    @property
    def size(self) -> int:
        """How many unknowns there are."""
        return sum(len(i.vector) for i in self.intrinsics) + 6 * (len(self.T_cam_rig) - 1 + len(self.T_rig_board))

    @property
    def rig_size(self) -> int:
        """How many of them, the first ones, describe the rig: all but the captures' poses."""
        return self.size - 6 * len(self.T_rig_board)


class Bundle:
    """The least-squares problem: residuals and their analytic sparse Jacobian.

    Parameters
    ----------
    start : Estimate
        Where to begin; its sizes are the problem's.
    seen : Observations
    """

    def __init__(self, start: Estimate, seen: Observations) -> None:
        self.start, self.seen = start, seen
        self.degree = start.intrinsics[0].degree
        self.scale = np.array([i.scale for i in start.intrinsics])[seen.camera]
        self._columns, self._indptr = self._pattern()

    def residuals(self, x: Floats) -> Floats:
        """Return predicted minus observed pixels, shape (2 M,): u, v of the first corner, then of the second."""
        return (self._project(x)[0] - self.seen.pixels).ravel()

    def jacobian(self, x: Floats) -> csr_matrix:
        """Return the derivatives of `residuals`, shape (2 M, unknowns), sparse."""
        _, d_intrinsics, d_point = self._project(x, derivatives=True)
        state = _State(self.start, x)
        R_i, R_k = state.R_cam[self.seen.camera], state.R_board[self.seen.capture]
        turned = np.einsum("mij,mj->mi", R_k, self.seen.points)
        in_rig = turned + state.t_board[self.seen.capture]
        in_camera = np.einsum("mij,mj->mi", R_i, in_rig)
        d_in_rig = d_point @ R_i
        d_capture = np.concatenate([-d_in_rig @ _cross(turned) @ state.J_board[self.seen.capture], d_in_rig], -1)
        d_camera = np.concatenate([-d_point @ _cross(in_camera) @ state.J_cam[self.seen.camera], d_point], -1)
        entries = np.concatenate([d_intrinsics, d_camera, d_capture], axis=-1)  # (M, 2, entries of a row)
        entries = entries.reshape(-1, entries.shape[-1])[self._used]
        return csr_matrix((entries, self._columns, self._indptr), shape=(2 * len(self.scale), self.start.size))

    def _pattern(self) -> tuple[Ints, Ints]:
        """Return columns and row pointers of the Jacobian; camera 1's pose has no columns."""
        cameras, width = len(self.start.intrinsics), _SHAPE + self.degree
        first_pose = cameras * width
        first_capture = first_pose + 6 * (cameras - 1)
        intrinsics = self.seen.camera[:, None] * width + np.arange(width)
        camera = first_pose + 6 * (self.seen.camera[:, None] - 1) + np.arange(6)
        camera[self.seen.camera == 0] = -1
        capture = first_capture + 6 * self.seen.capture[:, None] + np.arange(6)
        columns = np.repeat(np.concatenate([intrinsics, camera, capture], axis=1), 2, axis=0)
        self._used = columns >= 0
        return columns[self._used], np.concatenate([[0], np.cumsum(self._used.sum(axis=1))])

    def _project(self, x: Floats, derivatives: bool = False) -> tuple[Floats, ...]:
        """Return pixels (M, 2) and, if asked, derivatives by intrinsics (M, 2, 4 + degree) and point (M, 2, 3)."""
        seen, state = self.seen, _State(self.start, x)
        u0, v0, c, d = state.intrinsics[seen.camera, :_SHAPE].T
        alpha = state.intrinsics[seen.camera, _SHAPE:]
        in_rig = np.einsum("mij,mj->mi", state.R_board[seen.capture], seen.points) + state.t_board[seen.capture]
        X, Y, Z = (np.einsum("mij,mj->mi", state.R_cam[seen.camera], in_rig) + state.t_cam[seen.camera]).T
        n = np.hypot(X, Y)
        beside = n > 1e-12  # a point on the axis lies in any direction, at radius 0
        px, py = np.where(beside, X, 1.0) / np.where(beside, n, 1.0), np.where(beside, Y / np.maximum(n, 1e-12), 0.0)
        r = self._radius(alpha, n, Z, np.stack([u0, v0], -1))
        mx, my = r * px, r * py
        pixels = np.stack([mx + d * my + u0, d * mx + c * my + v0], -1)
        if not derivatives:
            return (pixels,)
        f, slope, powers = self._polynomial(alpha, r)
        steep = slope * n + Z  # ∂/∂r of f(r) n + r Z, whose root r is
        A = np.stack([np.stack([np.ones_like(c), d], -1), np.stack([d, c], -1)], -2)
        r_n, r_Z = -f / steep, -r / steep
        across = np.where(n > 1e-9, r / np.maximum(n, 1e-9), -f / np.where(Z == 0, 1.0, Z))
        d_m = np.empty((len(r), 2, 3))
        d_m[:, 0, 0] = r_n * px * px + across * py * py
        d_m[:, 1, 1] = r_n * py * py + across * px * px
        d_m[:, 0, 1] = d_m[:, 1, 0] = (r_n - across) * px * py
        d_m[:, 0, 2], d_m[:, 1, 2] = r_Z * px, r_Z * py
        d_intrinsics = np.zeros((len(r), 2, _SHAPE + self.degree))
        d_intrinsics[:, 0, 0] = d_intrinsics[:, 1, 1] = 1.0
        d_intrinsics[:, 1, 2] = my
        d_intrinsics[:, 0, 3], d_intrinsics[:, 1, 3] = my, mx
        r_alpha = -powers * (n / steep)[:, None]
        direction = np.einsum("mij,mj->mi", A, np.stack([px, py], -1))
        d_intrinsics[:, :, _SHAPE:] = direction[:, :, None] * r_alpha[:, None, :]
        return pixels, d_intrinsics, A @ d_m

    def _radius(self, alpha: Floats, n: Floats, Z: Floats, center: Floats) -> Floats:
        """Solve f(r) n + r Z = 0 by Newton's method from the observed radius: the right one of several roots."""
        r = np.linalg.norm(self.seen.pixels - center, axis=-1)
        limit = 1.5 * r + 0.1 * self.scale
        for _ in range(_NEWTON_STEPS):
            f, slope, _ = self._polynomial(alpha, r)
            r = np.clip(r - (f * n + r * Z) / (slope * n + Z), 0.0, limit)
        return r

    def _polynomial(self, alpha: Floats, r: Floats) -> tuple[Floats, Floats, Floats]:
        """Return f(r), f'(r) and ∂f/∂α_k = s (r/s)^k, shapes (M,), (M,), (M, degree)."""
        powers = _powers(self.degree)
        ratio = (r / self.scale)[:, None]
        basis = ratio**powers
        slope = (alpha[:, 1:] * powers[1:] * ratio ** (powers[1:] - 1)).sum(axis=1)
        return self.scale * (alpha * basis).sum(axis=1), slope, self.scale[:, None] * basis


def adjust(
    start: Estimate,
    seen: Observations,
    loss: Literal["linear", "soft_l1"] = "linear",
    fixed: Literal["nothing", "rig"] = "nothing",
    steps: int = 50,
    tolerance: float = 1e-9,
) -> Estimate:
    """Minimise the reprojection error from a start that is near enough.

    Parameters
    ----------
    start : Estimate
    seen : Observations
    loss : "linear" | "soft_l1"
        Squares, or SciPy's smooth absolute value beyond one pixel, which lets wrong corners be wrong.
    fixed : "nothing" | "rig"
        "rig": cameras stay as they are, the captures' poses alone move.
    steps : int
        At most so many evaluations.
    tolerance : float
        Stop when a step lowers the cost by a smaller share than this.
    """
    bundle = Bundle(start, seen)
    x0 = start.vector()
    moving = slice(start.rig_size if fixed == "rig" else 0, None)
    residuals = bundle.residuals(x0)
    # In whitened unknowns y the columns of the Jacobian are orthonormal, at the start, and SciPy's iterative solver
    # is done in ten products instead of several hundred.
    P = _whitening(bundle.jacobian(x0)[:, moving])

    def product(A: Floats, v: Floats) -> Floats:
        # Not @: for so little, BLAS threads on a busy machine spend more time waiting than adding.
        return np.einsum("ij,j->i", A, v.ravel())

    def at(y: Floats) -> Floats:
        x = x0.copy()
        x[moving] += product(P, y)
        return x

    def jacobian(y: Floats) -> LinearOperator:
        J = bundle.jacobian(at(y))[:, moving]
        return LinearOperator(J.shape, matvec=lambda v: J @ product(P, v), rmatvec=lambda u: product(P.T, J.T @ u))

    solution = least_squares(
        lambda y: bundle.residuals(at(y)),
        np.zeros(len(P)),
        jac=jacobian,
        x_scale=np.linalg.norm(residuals) + 1e-12,  # a first step that may take away all of the error
        loss=loss,
        tr_solver="lsmr",
        tr_options={"atol": 1e-9, "btol": 1e-9},  # SciPy's loose default takes ten times as many steps
        xtol=0.1 * tolerance,
        ftol=tolerance,
        max_nfev=steps,
    )
    return start.with_vector(at(solution.x))


def _whitening(J: csr_matrix) -> Floats:
    """Return P with PᵀJᵀJP = I, by the Cholesky factor of the normal matrix with unit columns."""
    scale = _column_norms(J)
    normal = (J.T @ J).toarray() / np.outer(scale, scale)
    factor = np.linalg.cholesky(normal + 1e-12 * np.eye(len(normal)))
    return np.linalg.inv(factor).T / scale[:, None]


def _column_norms(J: csr_matrix) -> Floats:
    norms = np.sqrt(np.asarray(J.multiply(J).sum(axis=0)).ravel())
    return np.where(norms > 0, norms, 1.0)


def covariance(estimate: Estimate, seen: Observations, sigma: float) -> Floats:
    """Return the covariance of lenses and rig for corner noise `sigma` in pixels, shape (rig_size, rig_size).

    The inverse of JᵀJ / σ², without the rows and columns of the boards' poses. JᵀJ itself is never formed: it squares
    what separates the best known combination of unknowns from the worst, and the best, which the rays are made of,
    drown in rounding. Capture by capture, an orthogonal projection takes out what the board's pose can explain, and
    what is left is folded into a triangle R, which is a QR factorisation updated block by block.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the corners do not determine all unknowns.
    """
    J = Bundle(estimate, seen).jacobian(estimate.vector())
    rig = estimate.rig_size
    scale = _column_norms(J)[:rig]  # unit columns, so that metres and pixels meet in equal numbers
    R = np.zeros((0, rig))
    for k in range(len(estimate.T_rig_board)):
        rows = J[np.repeat(seen.capture == k, 2)]
        lenses, pose = rows[:, :rig].toarray() / scale, rows[:, rig + 6 * k : rig + 6 * (k + 1)].toarray()
        Q = np.linalg.qr(pose)[0]
        R = np.linalg.qr(np.concatenate([R, lenses - Q @ (Q.T @ lenses)]), mode="r")
    root = np.linalg.inv(R) / scale[:, None]
    return sigma**2 * root @ root.T


class _State:
    """Rotations, translations and the rotations' derivatives at x, stacked for indexing by corner."""

    def __init__(self, start: Estimate, x: Floats) -> None:
        cameras, rig = len(start.intrinsics), start.rig_size
        width = len(start.intrinsics[0].vector)
        self.intrinsics = x[: cameras * width].reshape(cameras, width)
        moving = np.concatenate([np.zeros((1, 6)), x[cameras * width : rig].reshape(-1, 6)])
        boards = x[rig:].reshape(-1, 6)
        self.R_cam, self.J_cam, self.t_cam = *_rotations(moving[:, :3]), moving[:, 3:]
        self.R_board, self.J_board, self.t_board = *_rotations(boards[:, :3]), boards[:, 3:]


def _rotations(r: Floats) -> tuple[Floats, Floats]:
    """Return R(r) and the left Jacobian J with R(r + δ) ≈ (I + [J δ]×) R(r), each (n, 3, 3).

    Rodrigues' formula: R = I + sin(a)/a K + (1 - cos a)/a² K², K = [r]×; J = I + (1 - cos a)/a² K + (a - sin a)/a³ K².
    """
    K = _cross(r)
    angle = np.linalg.norm(r, axis=-1)[:, None, None]
    a = np.maximum(angle, 1e-6)
    small = angle < 1e-6  # the series' first terms
    first = np.where(small, 1.0, np.sin(a) / a)
    second = np.where(small, 0.5, (1 - np.cos(a)) / a**2)
    third = np.where(small, 1 / 6, (a - np.sin(a)) / a**3)
    return np.eye(3) + first * K + second * K @ K, np.eye(3) + second * K + third * K @ K


def _cross(v: Floats) -> Floats:
    """Return the matrices [v]× of vectors (n, 3), shape (n, 3, 3)."""
    matrix = np.zeros((*v.shape, 3))
    matrix[:, 0, 1], matrix[:, 0, 2] = -v[:, 2], v[:, 1]
    matrix[:, 1, 0], matrix[:, 1, 2] = v[:, 2], -v[:, 0]
    matrix[:, 2, 0], matrix[:, 2, 1] = -v[:, 1], v[:, 0]
    return matrix


def _powers(degree: int) -> Ints:
    """Return the powers of r in f: 0, 2, 3, …, degree."""
    return np.array([0, *range(2, degree + 1)])


def observations(views: Sequence[Sequence[Floats | None]], points: Floats) -> Observations:
    """Flatten views[camera][capture], corners (K, 2) or None, NaN where a corner is missing.

    Parameters
    ----------
    views : nested sequence
    points : array, shape (K, 3)
        The board's corners in the same order, metres.
    """
    parts = [
        (np.full(len(points), i), np.full(len(points), k), np.arange(len(points)), points, corners)
        for i, row in enumerate(views)
        for k, corners in enumerate(row)
        if corners is not None
    ]
    seen = Observations(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
    return seen.where(np.isfinite(seen.pixels).all(axis=1))
