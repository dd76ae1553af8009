"""Unknowns and observations of the bundle adjustment.

The parameters of a camera are u0, v0, c, d, α0, α2, …, αM. Three degrees of freedom of the model
are fixed:

- The polynomial is written f(r) = s (α0 + α2 (r/s)² + …), s half the larger side of the image, so
  that all parameters are of the order of one. Files have a_k = α_k s^(1-k). There is no a1: f is
  smooth across the axis.
- e = d. Rotating a camera about its axis and rotating A back gives the same pixels, so A is kept
  symmetric: all roll is in the pose.
- The frame of camera 1 is the rig frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.geometry.camera import OcamCamera, fit_inverse_polynomial
from omnistereo_lib.geometry.pose import Floats, Pose
from omnistereo_rigs.formats.fit import fit_direct_polynomial

Ints = NDArray[np.int64]

NUM_AFFINE = 4  # u0, v0, c, d: the parameters of a camera besides its polynomial


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """One camera's Φ and A as the optimiser sees them."""

    # (4 + M,): u0, v0 (pixels), c, d = e, then the M numbers α0, α2, …, αM of a polynomial of
    # degree M
    vector: Floats
    image_size: tuple[int, int]  # width and height, pixels

    @property
    def degree(self) -> int:
        """Degree M of the polynomial."""
        return len(self.vector) - NUM_AFFINE

    @property
    def scale(self) -> float:
        """The polynomial's unit of length s, pixels."""
        return max(self.image_size) / 2

    @property
    def poly(self) -> Floats:
        """The direct polynomial a0, 0, a2, …, aM of the files, pixels, low to high."""
        powers = powers_of(self.degree)
        poly = np.zeros(self.degree + 1)
        poly[powers] = self.vector[NUM_AFFINE:] * self.scale ** (1.0 - powers)
        return poly

    def with_degree(self, degree: int) -> Intrinsics:
        """Return the same camera with a polynomial of at least this degree, new coefficients 0."""
        more = np.zeros(max(int(degree) - self.degree, 0))
        return Intrinsics(np.concatenate([self.vector, more]), self.image_size)

    def rays(self, pixels: Floats) -> Floats:
        """Return the rays (..., 3), camera frame, of pixels (..., 2), by the direct polynomial."""
        u0, v0, c, d = self.vector[:NUM_AFFINE]
        # Undo A, then the direct polynomial: the ray of (x, y) is (x, y, -f(r)).
        xy = (pixels - [u0, v0]) @ np.linalg.inv([[1.0, d], [d, c]]).T
        depth = -np.polynomial.polynomial.polyval(np.linalg.norm(xy, axis=-1), self.poly)
        rays = np.concatenate([xy, depth[..., None]], axis=-1)
        return rays / np.linalg.norm(rays, axis=-1, keepdims=True)

    @classmethod
    def of_camera(cls, camera: OcamCamera) -> tuple[Intrinsics, Pose]:
        """Return a camera for the optimiser, and the roll from the camera frame to its own.

        The polynomial is fitted to the inverse polynomial, which is what projects.
        """
        c, d, e = camera.affine
        U, singular, Vt = np.linalg.svd(np.array([[1.0, e], [d, c]]))
        # By the polar decomposition A = symmetric × rotation, and the rotation goes into the pose.
        A = U @ np.diag(singular) @ U.T
        t = np.linspace(-np.pi / 2, np.radians(camera.max_fov_deg / 2) - np.pi / 2, 257)[1:]
        radius = A[0, 0] * np.polynomial.polynomial.polyval(t, camera.inv_poly)
        poly = fit_direct_polynomial(radius, t)
        scale, powers = max(camera.image_size) / 2, powers_of(len(poly) - 1)
        alpha = poly[powers] * scale ** (powers - 1.0)
        A, roll = A / A[0, 0], np.eye(3)
        roll[:2, :2] = U @ Vt
        vector = np.array([*camera.center, A[1, 1], A[0, 1], *alpha])
        return cls(vector, camera.image_size), Pose(roll, np.zeros(3))

    def camera(self, max_fov_deg: float) -> OcamCamera:
        """Return the camera, its inverse polynomial fitted to better than 0.01 px.

        Raises an `OmnistereoError` if the polynomial is not monotonic over the field of view.
        """
        u0, v0, c, d = (float(value) for value in self.vector[:NUM_AFFINE])
        inv_poly = fit_inverse_polynomial(self.poly, max_fov_deg, 3.0 * max(self.image_size))
        return OcamCamera(self.poly, inv_poly, (u0, v0), (c, d, d), self.image_size, max_fov_deg)


@dataclass(frozen=True, eq=False)
class CalibrationParams:
    """All unknowns at once."""

    intrinsics: tuple[Intrinsics, ...]  # one for each camera, of equal degree
    T_cam_rig: tuple[Pose, ...]  # the paper's Θ_i: rig → camera; the first is the identity
    T_rig_board: tuple[Pose, ...]  # the paper's Θ_k: board → rig, one for each capture
    fixed_intrinsics: bool = False  # the intrinsics are given, and stay as they are

    def with_degree(self, degree: int) -> CalibrationParams:
        """Return the same unknowns with polynomials of at least this degree."""
        return replace(self, intrinsics=tuple(one.with_degree(degree) for one in self.intrinsics))

    def with_captures(self, captures: Sequence[int]) -> CalibrationParams:
        """Return the unknowns of some captures only."""
        return replace(self, T_rig_board=tuple(self.T_rig_board[k] for k in captures))

    def to_vector(self) -> Floats:
        """Return all unknowns: intrinsics of all cameras, poses of cameras 2 …, of captures."""
        poses = [*self.T_cam_rig[1:], *self.T_rig_board]
        lenses = [one.vector for one in self.intrinsics]
        return np.concatenate([*lenses, *(pose.as_vector() for pose in poses)])

    def from_vector(self, x: Floats) -> CalibrationParams:
        """Return the inverse of `to_vector`: cameras and captures as here, values from x."""
        parts = np.split(x[: self.num_intrinsics], len(self.intrinsics))
        sizes = [one.image_size for one in self.intrinsics]
        intrinsics = tuple(map(Intrinsics, parts, sizes))
        poses = [Pose.from_vector(theta) for theta in x[self.num_intrinsics :].reshape(-1, 6)]
        others = len(self.T_cam_rig) - 1
        T_cam_rig = (Pose.identity(), *poses[:others])
        boards = tuple(poses[others:])
        return CalibrationParams(intrinsics, T_cam_rig, boards, self.fixed_intrinsics)

    @property
    def num_intrinsics(self) -> int:
        """Number of unknowns of the lenses, the first ones."""
        return sum(len(i.vector) for i in self.intrinsics)

    @property
    def num_fixed(self) -> int:
        """Number of unknowns, the first ones, that are given."""
        return self.num_intrinsics if self.fixed_intrinsics else 0

    @property
    def num_rig_params(self) -> int:
        """Number of unknowns of the rig: the first ones, all but the poses of the captures."""
        return self.num_intrinsics + 6 * (len(self.T_cam_rig) - 1)

    @property
    def num_params(self) -> int:
        """Number of all unknowns."""
        return self.num_rig_params + 6 * len(self.T_rig_board)


@dataclass(frozen=True, eq=False)
class Observations:
    """M observed corners."""

    camera: Ints  # (M,), as the next two: indices from 0
    capture: Ints
    corner: Ints
    pixels: Floats  # (M, 2)
    board_points: Floats  # (K, 3): all corners in the board frame, metres

    @property
    def points(self) -> Floats:
        """Observed corners in the board frame, shape (M, 3), metres."""
        return self.board_points[self.corner]

    def select(self, mask: NDArray[np.bool_]) -> Observations:
        """Return the corners where the mask, shape (M,), is True."""
        camera, capture, corner = (each[mask] for each in (self.camera, self.capture, self.corner))
        return Observations(camera, capture, corner, self.pixels[mask], self.board_points)


def collect_observations(views: Sequence[Sequence[Floats | None]], points: Floats) -> Observations:
    """Flatten views[camera][capture], corners (K, 2) or None, NaN where a corner is missing.

    Args:
        points (array, shape (K, 3)): The corners in the board frame in the same order, metres.
    """
    index = [(i, k) for i, row in enumerate(views) for k, uv in enumerate(row) if uv is not None]
    camera, capture = np.repeat(index, len(points), axis=0).T
    pixels = np.concatenate([views[i][k] for i, k in index])
    corner = np.tile(np.arange(len(points)), len(index))
    everything = Observations(camera, capture, corner, pixels, points)
    return everything.select(np.isfinite(pixels).all(axis=1))


def powers_of(degree: int) -> Ints:
    """Return the powers of r in f: 0, 2, 3, …, degree."""
    return np.array([0, *range(2, degree + 1)])
