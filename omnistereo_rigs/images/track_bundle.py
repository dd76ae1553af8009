"""Bundle adjustment of a rig over tracks: poses, inverse distances, and lenses if asked.

A point is a unit direction u and an inverse distance ρ from the middle of the rig, so that
infinitely far points are not special. A camera sees it along Rᵀ (u - ρ t). The residual is the
angle to the observed ray in its tangent plane, in the pixels that this angle has there, so any
camera model will do.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix

from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import (
    Floats,
    Pose,
    axis_angle_from_rotation,
    nearest_rotation,
    rotation_from_axis_angle,
)
from omnistereo_lib.geometry.rig import Rig
from omnistereo_rigs.boards.bundle import cross
from omnistereo_rigs.boards.params import Ints
from omnistereo_rigs.images.features import Tracks

# A lens has three corrections: its centre (u, v) in pixels, and the share that its focal length
# grows by.
_LENS = 3
# The prior of a free lens: how far off each correction is likely to be (one standard deviation).
_LENS_PRIOR = np.array([3.0, 3.0, 0.01])
# A rotation, a shift and a scale of all cameras cannot be seen.
_GAUGE = 7
# The step, in radians, of the central differences through a camera model.
_STEP = 1e-4
# Points of one cell of this size share their errors: see `covariance`.
_CELL_DEG = 15.0
# The scale of the robust cost, in deviations: a track that misfits by so much has half of the
# largest cost that any track can have. The adjustment ends with it, and covariances are those of
# that cost.
HALF_SCALE = 2.5


class TrackBundle:
    """The least-squares problem and its solution so far.

    Args:
        rig: Initial poses; its lenses are those of the tracks.
        centre_sd: Standard deviation in metres of the initial centres, a prior; None: they are free
            up to scale.
        free_lenses: Also adjust the centre and the focal length of each lens.
    """

    def __init__(
        self, rig: Rig, tracks: Tracks, centre_sd: float | None = None, free_lenses: bool = False
    ) -> None:
        self.rig, self.tracks = rig, tracks
        self.centre_sd, self.free_lenses = centre_sd, free_lenses
        middle = rig.centers.mean(axis=0)
        self.R = np.stack([pose.R for pose in rig.T_rig_cam])
        self.t = self.t_prior = rig.centers - middle
        self.lens = np.zeros((len(rig), _LENS))
        self.size = mean_baseline(self.t)
        self.sigma_px = 1.0
        # A camera has three unknowns of rotation and three of its centre, and on request those of
        # its lens.
        self.width = 6 + _LENS * free_lenses
        # Each observation brings two numbers, and a point takes three of them: two of u and ρ.
        self.dof = 2 * np.bincount(tracks.point) - 3
        count = len(tracks.point)
        # This matrix sums over the observations of each point: (points, observations).
        self._by_point = csr_matrix((np.ones(count), (tracks.point, np.arange(count))))
        self.rays, self._to_px, self._from_center = self._observed()
        # Each point is (u, ρ), shape (N, 4).
        self.points = self._triangulate()

    def with_tracks(self, tracks: Tracks) -> TrackBundle:
        """Return the bundle of other tracks, at the poses and lenses found; priors stay."""
        other = TrackBundle(self.rig, tracks, self.centre_sd, self.free_lenses)
        other.R, other.t, other.lens = self.R, self.t, self.lens
        other.points = other._triangulate()
        return other

    def _observed(self) -> tuple[Floats, Floats, Floats]:
        """Return the rays (M, 3), matrices (M, 2, 3) ray → pixels, and pixels from the centre."""
        count = len(self.tracks.point)
        rays, to_px = np.zeros((count, 3)), np.zeros((count, 2, 3))
        from_center = np.zeros_like(self.tracks.pixels)
        for i, camera in enumerate(self.rig.cameras):
            mine = self.tracks.camera == i
            seen = camera.unproject(self.tracks.pixels[mine])[0]
            # Central differences: how the pixel moves when the ray leaves along either of its two
            # tangents,
            #     ∂pixel/∂tangent_k ≈ (Π(x + h e_k) - Π(x - h e_k)) / 2h
            basis = tangents(seen)
            ends = [
                camera.project(seen[:, None] + s * _STEP * np.swapaxes(basis, 1, 2))[0]
                for s in (1, -1)
            ]
            # A matrix that takes a change of the ray, in the camera's axes, to pixels. It maps the
            # observed ray itself to 0, so its product with a predicted ray is the residual, without
            # any polynomial.
            to_px[mine] = np.einsum("mki,mjk->mij", (ends[0] - ends[1]) / (2 * _STEP), basis)
            rays[mine], from_center[mine] = seen, self.tracks.pixels[mine] - camera.center
        return rays, to_px, from_center

    def _triangulate(self) -> Floats:
        """Return u and ρ of each point at the initial poses: the linear solution."""
        camera, point = self.tracks.camera, self.tracks.point
        # A point lies on the ray d of a camera at t if nothing of u - ρ t lies across d. So
        # minimise
        #     Σ |(I - d dᵀ) (u - ρ t)|²   over x = (u, ρ) with |x| = 1:
        # the eigenvector of the smallest eigenvalue of Σ AᵀA, a 4 × 4 matrix for each point.
        d = np.einsum("mij,mj->mi", self.R[camera], self.rays)
        across = np.eye(3) - d[:, :, None] * d[:, None, :]
        A = np.concatenate([across, -across @ self.t[camera][:, :, None]], axis=2)
        x = np.linalg.eigh(self._sums(np.swapaxes(A, 1, 2) @ A))[1][:, :, 0]
        # The eigenvector has no sign: take the one with which the point lies ahead of its cameras.
        ahead = self._sums(np.einsum("mi,mi->m", d, x[point, :3]))
        x = x * np.where(ahead < 0, -1.0, 1.0)[:, None]
        # Scaled to |u| = 1, the last number is the inverse distance.
        return x / np.maximum(np.linalg.norm(x[:, :3], axis=1, keepdims=True), 1e-9)

    def _sums(self, values: Floats) -> Floats:
        """Return the sums over the observations of each point, (N, ...)."""
        return (self._by_point @ values.reshape(len(values), -1)).reshape(-1, *values.shape[1:])

    def residuals(self) -> Floats:
        """Return predicted minus observed pixels, shape (M, 2)."""
        return self._residuals()[0]

    def _residuals(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Return residuals, rays in rig and camera frame, (M, 3) each, and the latter's lengths."""
        camera, point = self.tracks.camera, self.tracks.point
        # The predicted ray of an observation is Rᵀ (u - ρ t), scaled to length 1.
        in_rig = self.points[point, :3] - self.points[point, 3:] * self.t[camera]
        seen = np.einsum("mji,mj->mi", self.R[camera], in_rig)
        length = np.maximum(np.linalg.norm(seen, axis=1, keepdims=True), 1e-9)
        seen = seen / length
        # Beyond 90° the tangent plane would take a ray that points away for one that is near. A
        # fixed vector stands in for it, so such an observation never looks right.
        ahead = np.einsum("mi,mi->m", seen, self.rays) > 0
        residuals = np.einsum("mij,mj->mi", self._to_px, np.where(ahead[:, None], seen, 1.0))
        # A shifted centre shifts all pixels; a longer focal length moves them away from the centre.
        lens = self.lens[camera]
        return residuals + lens[:, :2] + lens[:, 2:] * self._from_center, in_rig, seen, length

    def misfits(self) -> Floats:
        """Return the squared residuals of each point by noise and freedom, (N,); 1 is usual."""
        return self._sums((self.residuals() ** 2).sum(axis=1)) / self.sigma_px**2 / self.dof

    def _linearised(self) -> tuple[Floats, Floats, Floats]:
        """Return residuals (M, 2), derivatives by camera (M, 2, width) and by point (M, 2, 3)."""
        camera, point = self.tracks.camera, self.tracks.point
        residuals, in_rig, seen, length = self._residuals()
        # Scaling y to length 1 takes away what lies along it: ∂(y/|y|) = (I - s sᵀ) ∂y / |y| with s
        # = y/|y|.
        d_seen = self._to_px - (self._to_px @ seen[:, :, None]) * seen[:, None, :]
        d_rig = d_seen / length[:, :, None] @ np.swapaxes(self.R[camera], 1, 2)
        # With R ← exp([ω]ₓ) R the ray becomes Rᵀ (x + [x]ₓ ω) for x = u - ρ t, and a shift of the
        # centre moves x by -ρ dt. So near points tell where a camera stands, and far ones how it is
        # turned.
        inverse = self.points[point, 3][:, None, None]
        parts = [d_rig @ cross(in_rig), -inverse * d_rig]
        if self.free_lenses:
            parts += [np.broadcast_to(np.eye(2), (len(point), 2, 2)), self._from_center[:, :, None]]
        # A point moves along the two tangents of u, and x by -t as ρ grows.
        self._basis = tangents(self.points[:, :3])
        d_point = [d_rig @ self._basis[point], -d_rig @ self.t[camera][:, :, None]]
        return residuals, np.concatenate(parts, axis=2), np.concatenate(d_point, axis=2)

    def _reduced(self, scale: float, damping: float = 0.0) -> tuple[Floats, ...]:
        """Return the normal equations without points (Schur complement), and the way back to them.

        The weight of a track is Geman and McClure's: (1 + misfit / scale²)⁻².

        Returns:
            S: (cameras · width, cameras · width)
            gradients: (N, cameras · width), of each point
            inverse, coupling, point_gradients: see `_step`
        """
        # In each point's part of the normal equations, with V of the point alone, W between cameras
        # and point, U of the cameras alone and the gradients g,
        #     | U   W | | dc |     | g_c |
        #     | Wᵀ  V | | dp | = - | g_p |
        # dp = -V⁻¹ (g_p + Wᵀ dc) can be put into the first row: what remains has cameras only
        # (Triggs et al. 2000, "Bundle adjustment: a modern synthesis", on the Schur complement),
        #     (U - W V⁻¹ Wᵀ) dc = -(g_c - W V⁻¹ g_p)
        tracks, n = self.tracks, len(self.rig)
        residuals, d_camera, d_point = self._linearised()
        weight = ((1 + self.misfits() / scale**2) ** -2)[tracks.point] / self.sigma_px**2
        weighted = weight[:, None, None] * d_point
        # V of all points, (N, 3, 3), damped by a share of its mean diagonal, and its inverse.
        of_points = self._sums(np.swapaxes(weighted, 1, 2) @ d_point)
        trace = np.trace(of_points, axis1=1, axis2=2)[:, None, None]
        inverse = np.linalg.inv(of_points + np.eye(3) * (damping * trace / 3 + 1e-9))
        point_gradients = self._sums(np.einsum("mki,mk->mi", weighted, residuals))
        # W of all points. A camera that does not see a point keeps its zeros.
        of_cameras = np.zeros((tracks.num_points, n, self.width, 3))
        of_cameras[tracks.point, tracks.camera] = np.swapaxes(d_camera, 1, 2) @ weighted
        coupling = of_cameras.reshape(tracks.num_points, n * self.width, 3)
        gradients = np.zeros((tracks.num_points, n, self.width))
        of_residuals = np.einsum("mki,mk->mi", d_camera, residuals)
        gradients[tracks.point, tracks.camera] = weight[:, None] * of_residuals
        # S = Σ U - W V⁻¹ Wᵀ. U has one block for each camera, since a residual is seen by one
        # camera only.
        back = coupling @ inverse
        S = -np.tensordot(back, coupling, ((0, 2), (0, 2)))
        for i in range(n):
            mine, block = tracks.camera == i, slice(i * self.width, (i + 1) * self.width)
            J = d_camera[mine]
            S[block, block] += np.einsum("m,mki,mkj->ij", weight[mine], J, J)
        by_points = np.einsum("nij,nj->ni", back, point_gradients)
        left = gradients.reshape(by_points.shape) - by_points
        return S, left, inverse, coupling, point_gradients

    def _prior(self) -> tuple[Floats, Floats]:
        """Return weights and gradient of the priors, (cameras · width,) each."""
        weights, offsets = np.zeros((2, len(self.rig), self.width))
        # A prior adds (t - t₀)² / σ² to the cost: the weight is 1/σ², the gradient weight times
        # offset.
        if self.centre_sd is not None:
            weights[:, 3:6], offsets[:, 3:6] = self.centre_sd**-2, self.t - self.t_prior
        if self.free_lenses:
            weights[:, 6:], offsets[:, 6:] = _LENS_PRIOR**-2, self.lens
        return weights.ravel(), (weights * offsets).ravel()

    def _cost(self, scale: float) -> float:
        # dof · m / (1 + m / scale²) for a misfit m: squares where it is small, and at most dof ·
        # scale² for a gross error. Its slope by m is dof times the weight in `_reduced`.
        misfits = self.misfits()
        weights, gradient = self._prior()
        prior = float((gradient**2 / np.where(weights > 0, weights, 1.0)).sum())
        return float((self.dof * misfits / (1 + misfits / scale**2)).sum()) + prior

    def solve(self, scale: float, steps: int) -> None:
        """Minimise the robust cost by Levenberg-Marquardt; the rig keeps its place and size."""
        cost, damping = self._cost(scale), 1e-3
        for _ in range(steps):
            # Levenberg-Marquardt: a step that lowers the cost is kept, and the next one is damped
            # less; otherwise it is taken back, and the next one is damped more.
            before = self.R, self.t, self.lens, self.points
            self._step(scale, damping)
            new_cost = self._cost(scale)
            if new_cost < cost:
                done, cost, damping = cost - new_cost < 1e-5 * cost, new_cost, damping / 5
                if done:
                    break
            else:
                self.R, self.t, self.lens, self.points = before
                damping *= 10

    def _step(self, scale: float, damping: float) -> None:
        S, gradients, inverse, coupling, point_gradients = self._reduced(scale, damping)
        weights, prior_gradient = self._prior()
        # No residual changes along the gauge, so S has seven directions without curvature.
        # Curvature of the usual size along them makes S invertible, and keeps the step from
        # drifting along them.
        G = self._gauge()
        held = G @ G.T * np.trace(S) / len(S)
        damped = S + np.diag(weights + damping * np.diag(S) + 1e-9) + held
        d = -np.linalg.solve(damped, gradients.sum(axis=0) + prior_gradient)
        # Back to the points: dp = -V⁻¹ (g_p + Wᵀ dc).
        back = point_gradients + np.einsum("nij,i->nj", coupling, d)
        d_points = -np.einsum("nij,nj->ni", inverse, back)
        d = d.reshape(len(self.rig), self.width)
        turns = zip(d[:, :3], self.R, strict=True)
        self.R = np.stack([rotation_from_axis_angle(w) @ R for w, R in turns])
        self.lens = self.lens + d[:, 6:] if self.free_lenses else self.lens
        # The new u is a little longer than 1; (u, ρ) times any factor is the same point.
        u = self.points[:, :3] + np.einsum("nij,nj->ni", self._basis, d_points[:, :2])
        points = np.concatenate([u, self.points[:, 3:] + d_points[:, 2:]], axis=1)
        points /= np.linalg.norm(u, axis=1, keepdims=True)
        t = self.t + d[:, 3:6]
        # Rays do not change if the rig grows and all inverse distances shrink with it: keep its
        # size.
        grown = mean_baseline(t) / self.size
        self.t = t / grown
        self.points = points * [1.0, 1.0, 1.0, grown]

    def rescale(self) -> None:
        """Estimate the noise from the median misfit."""
        # The median of χ² over its degrees of freedom k is about (1 - 2/(9 k))³ (Wilson, Hilferty
        # 1931). The noise is that with which the median track is usual, so gross errors do not
        # count.
        usual = (1 - 2 / (9 * self.dof)) ** 3
        self.sigma_px = max(self.sigma_px * float(np.sqrt(np.median(self.misfits() / usual))), 1e-3)

    def adjusted_rig(self) -> Rig:
        """Return the rig with the poses and lenses found, in the frame of the initial one."""
        middle = self.rig.centers.mean(axis=0)
        poses = [Pose(R, t + middle) for R, t in zip(self.R, self.t, strict=True)]
        cameras = list(map(_corrected, self.rig.cameras, self.lens))
        return replace(self.rig, cameras=tuple(cameras), T_rig_cam=tuple(poses))

    def _gauge(self) -> Floats:
        """Return the directions (cameras · width, 7) that change no ray."""
        # A common rotation ω moves the centres by ω × t = -[t]ₓ ω, a shift moves all alike, and a
        # common scale moves each centre along t.
        G = np.zeros((len(self.rig), self.width, _GAUGE))
        G[:, :3, :3] = G[:, 3:6, 3:6] = np.eye(3)
        G[:, 3:6, :3] = -cross(self.t)
        G[:, 3:6, 6] = self.t
        return G.reshape(-1, _GAUGE)

    def covariance(self) -> Floats:
        """Return the covariance of rotations (radians), centres (m): (6 cameras, 6 cameras).

        It is that of `pose_differences`: without a common rotation, shift and scale. What is
        independent are not the points, but `cells` of them, whose gradients are summed (sandwich;
        White 1982).
        """
        cells = self.cells()
        S, gradients, *_ = self._reduced(HALF_SCALE)
        # The gradient of one cell: neighbouring points may err together, those of different cells
        # are taken to err independently.
        summed = np.zeros((cells.max() + 1, gradients.shape[1]))
        np.add.at(summed, cells, gradients)
        weight = 1 / (1 + self.misfits() / HALF_SCALE**2)
        # With w = 1 / (1 + m/s²) the slope of the robust cost is w² r and its second derivative w²
        # (4 w - 3), less than the w² that S has: correct S for it, on average over the points.
        curvature = (weight**2 * (4 * weight - 3)).mean() / (weight**2).mean()
        # The sandwich H⁻¹ (Σ g gᵀ) H⁻¹. The poses are the first six unknowns of each camera.
        inverse = self._inverse(S * max(curvature, 0.2))
        middle = summed.T @ summed + np.diag(self._prior()[0])
        P, n = self._projection(), len(self.rig)
        poses = np.arange(n * self.width).reshape(n, self.width)[:, :6].ravel()
        return np.asarray(P @ (inverse @ middle @ inverse)[np.ix_(poses, poses)] @ P.T)

    def by_lenses(self) -> Floats:
        """Return the derivative (6 · cameras, 3 · cameras) of the poses, as in `covariance`, by the
        errors of the lenses.

        The errors are of the centre, in pixels, and of the focal length, as the pixels that it
        moves the usual point by.
        """
        # At the minimum the gradient by the poses stays 0 when a lens errs: S_pp dp + S_pl dl = 0,
        # so that
        #     dp/dl = -S_pp⁻¹ S_pl
        free = TrackBundle(self.rig, self.tracks, self.centre_sd, free_lenses=True)
        free.R, free.t, free.points, free.sigma_px = self.R, self.t, self.points, self.sigma_px
        count = len(self.rig)
        S = free._reduced(HALF_SCALE)[0].reshape(count, free.width, count, free.width)
        poses = S[:, :6, :, :6].reshape(6 * count, 6 * count)
        # A focal length that is off by a share of 1 / usual moves the usual point by one pixel.
        usual = np.median(np.linalg.norm(self._from_center, axis=1))
        lenses = (S[:, :6, :, 6:] * [1.0, 1.0, 1.0 / usual]).reshape(6 * count, _LENS * count)
        return np.asarray(-self._projection() @ self._inverse(poses) @ lenses)

    def _inverse(self, S: Floats) -> Floats:
        """Return the inverse of the normal equations, priors added, within what can be seen."""
        # The columns of Z span what is at right angles to the gauge; only there is S invertible.
        Z = np.linalg.svd(self._gauge().T)[2][_GAUGE:].T
        return np.asarray(Z @ np.linalg.inv(Z.T @ (S + np.diag(self._prior()[0])) @ Z) @ Z.T)

    def _projection(self) -> Floats:
        """Return the matrix that takes away what `pose_differences` takes away."""
        G = self._gauge().reshape(len(self.rig), self.width, 7)[:, :6].reshape(-1, 7)
        # P = I - G (L G)⁻¹ L. The rows of L take the mean rotation, the mean shift and the growth
        # of a change of the poses, and P moves it along the gauge until all three are 0.
        free = np.zeros((len(self.rig), 6, 7))
        free[:, :3, :3] = free[:, 3:6, 3:6] = np.eye(3)
        free[:, 3:6, 6] = self.t
        L = free.reshape(-1, 7).T
        return np.asarray(np.eye(len(G)) - G @ np.linalg.solve(L @ G, L))

    def cells(self) -> Ints:
        """Return for each point its cell of 15° of its frame, (N,)."""
        u = self.points[:, :3]
        # Rows of equal elevation. A row near a pole is shorter, so it has fewer cells around.
        row = np.round(np.degrees(np.arcsin(u[:, 1].clip(-1, 1))) / _CELL_DEG)
        around = np.maximum(np.round(np.cos(np.radians(row * _CELL_DEG)) * 360 / _CELL_DEG), 1)
        column = np.floor((np.arctan2(u[:, 0], u[:, 2]) / (2 * np.pi) + 0.5) * around)
        cells = np.stack([self.tracks.point_frame, row, column], axis=1)
        return np.unique(cells, axis=0, return_inverse=True)[1].ravel()


def pose_differences(rig: Rig, reference: Rig) -> Floats:
    """Return each camera's turn (radians) and shift (metres) from a reference, (cameras, 6).

    A rotation, a shift and a scale that are common to all cameras are taken away: images alone do
    not show them.
    """
    R, R0 = (np.stack([pose.R for pose in one.T_rig_cam]) for one in (rig, reference))
    # The common rotation is the one nearest to all R R₀ᵀ; then compare centres of equal mean
    # baseline.
    common = nearest_rotation(np.einsum("nij,nkj->ik", R, R0)).T
    turns = [axis_angle_from_rotation(common @ a @ b.T) for a, b in zip(R, R0, strict=True)]
    t, t0 = (one.centers - one.centers.mean(axis=0) for one in (rig, reference))
    scale = mean_baseline(t0) / max(mean_baseline(t), 1e-12)
    return np.concatenate([np.stack(turns), scale * t @ common.T - t0], axis=1)


def moved_rig(rig: Rig, differences: Floats) -> Rig:
    """Return a rig whose `pose_differences` to this one are given, shape (cameras, 6)."""
    moved = zip(rig.T_rig_cam, differences, strict=True)
    poses = [Pose(rotation_from_axis_angle(d[:3]) @ T.R, T.t + d[3:]) for T, d in moved]
    return rig.with_poses(poses)


def whitening(covariance: Floats) -> Floats:
    """Return the matrix (6 · cameras - 7, 6 · cameras) that whitens `pose_differences`.

    A common rotation, shift and scale are left out: the covariance has seven eigenvalues of 0.
    """
    # Along the other eigenvectors, each over its deviation.
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray((vectors[:, _GAUGE:] / np.sqrt(values[_GAUGE:])).T, np.float64)


def by_moving(rig: Rig, camera: int) -> Floats:
    """Return the derivative (6 · cameras, 6) of `pose_differences` by one camera's pose."""
    step, columns = 1e-5, []
    for change in step * np.eye(6):
        moved = np.zeros((len(rig), 6))
        moved[camera] = change
        columns.append(pose_differences(moved_rig(rig, moved), rig).ravel() / step)
    return np.stack(columns, axis=1)


def mean_baseline(centers: Floats) -> float:
    """Return the mean distance of all pairs of centres (cameras, 3)."""
    i, j = np.triu_indices(len(centers), 1)
    return float(np.linalg.norm(centers[i] - centers[j], axis=1).mean())


def _corrected(camera: OcamCamera, lens: Floats) -> OcamCamera:
    """Return a camera with its centre and focal length corrected."""
    if not lens.any():
        return camera
    # A picture that grows by g has r' = g r, so f' (r') = g f(r' / g): coefficient k gets g¹⁻ᵏ. The
    # inverse polynomial, which gives r, gets g.
    grown, powers = 1 + lens[2], np.arange(len(camera.poly))
    center = camera.center[0] + lens[0], camera.center[1] + lens[1]
    return replace(
        camera,
        poly=camera.poly * grown ** (1.0 - powers),
        inv_poly=camera.inv_poly * grown,
        center=center,
    )


def tangents(rays: Floats) -> Floats:
    """Return two unit vectors across each ray, (M, 3, 2)."""
    # The x axis, or for rays near it the y axis, is surely not along the ray: cross products with
    # it are well defined.
    other = np.where(np.abs(rays[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(rays, other)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-12)
    return np.stack([first, np.cross(rays, first)], axis=2)
