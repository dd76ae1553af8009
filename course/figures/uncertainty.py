"""Uncertainty of a calibration and its effect on depth: the shift of the best sphere along each
ray, to first order.

A point that belongs at direction s of the panorama appears, in the image of camera i warped with
the wrong rig onto sphere n + δ, at s - M⁻¹(∂u/∂n δ + Δu), where M = ∂u/∂s is the derivative of the
pixel u with respect to direction and Δu the error of the projection in pixels. The images of two
cameras coincide where these agree.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.rig import Pairs, Rig, camera_pairs
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_rigs.boards.params import CalibrationParams, Intrinsics
from omnistereo_rigs.boards.report import CameraReport, RigReport

Floats = NDArray[np.float64]

_ANGLE_STEP = 1e-4  # radians, for derivatives with respect to direction
_INDEX_STEP = 0.05  # spheres, for derivatives with respect to the index
_AZIMUTHS = np.linspace(0, 2 * np.pi, 12, endpoint=False)


def ray_uncertainty_deg(report: CameraReport, angles_deg: Floats) -> Floats:
    """Return the standard deviation of rays at some angles from the axis, degrees, for the worst of
    12 azimuths.

    The pixels are fixed where the camera sees those angles; the covariance of the report varies
    their rays.
    """
    camera = report.intrinsics.camera(2.0 * min(float(np.max(angles_deg)) + 0.1, 179.0))
    theta, phi = np.meshgrid(np.radians(angles_deg), _AZIMUTHS)
    rays = np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1
    )
    pixels = camera.project(rays, use_direct_poly=True)[0]

    def directions(vector: Floats) -> Floats:
        return Intrinsics(vector, report.intrinsics.image_size).rays(pixels)

    sigma = standard_deviation(directions, report.intrinsics.vector, report.covariance)
    return np.degrees(np.linalg.norm(sigma, axis=-1).max(axis=0))


def index_shift(
    rig: Rig, wrong: Rig, grid: SphereGrid, index: float, pairs: Pairs = "ring"
) -> Floats:
    """Predict the shift of the best sphere if `wrong` is used in place of `rig`.

    Args:
        rig, wrong: The right rig and the wrong one, in the same frame with the sweep centre as its
        origin.
        index: True sphere index of the scene, in (0, N - 1].
        pairs: Camera pairs; the result minimises the sum of their squared errors.

    Returns:
        array, shape (H, W), spheres: Positive where the scene appears nearer than it is, NaN where
            no pair sees the ray. To first order: the shift in the images must be small compared
            with the texture.
    """
    return _shift(_linearize(rig, grid, index), wrong, grid, index, camera_pairs(pairs, rig))


def shown_beside(
    camera: OcamCamera, T_rig_cam: Pose, T_used: Pose, points: Floats, radius: Floats
) -> Floats:
    """Return how far beside their own rays points appear in the image of a camera, warped onto
    spheres with a pose that may be wrong.

    Args:
        camera, T_rig_cam: The camera, and where it is.
        T_used: Where it is taken to be.
        points: (…, 3) m, rig frame.
        radius: Of the sphere of each point, (…) m.

    Returns:
        array, shape (…, 2), radians: To the right and down; NaN where the camera does not see them.
    """
    in_camera = T_rig_cam.inverse() @ points
    sight = in_camera / np.linalg.norm(in_camera, axis=-1, keepdims=True) @ T_used.R.T
    # where the line t + s · sight leaves the sphere
    along = sight @ T_used.t
    s = -along + np.sqrt(along**2 + radius**2 - T_used.t @ T_used.t)
    shown = (T_used.t + s[..., None] * sight) / radius[..., None]
    rays = points / np.linalg.norm(points, axis=-1, keepdims=True)
    right = np.cross([0, 1, 0], rays)
    right /= np.linalg.norm(right, axis=-1, keepdims=True)
    axes = right, np.cross(rays, right)
    beside = np.stack([np.sum((shown - rays) * axis, axis=-1) for axis in axes], axis=-1)
    return np.where(camera.project(in_camera)[1][..., None], beside, np.nan)


def index_uncertainty(
    report: RigReport, grid: SphereGrid, index: float, pairs: Pairs = "ring"
) -> Floats:
    """Return the standard deviation of the sphere index due to calibration uncertainty.

    Args:
        report: Report of `calibrate_rig`, whose covariance is propagated through `index_shift`.
        grid, index, pairs: See `index_shift`.

    Returns:
        array, shape (H, W), spheres
    """
    nominal = CalibrationParams(report.params.intrinsics, report.params.T_cam_rig, ())
    rig = _rig(nominal, report)
    center = rig.centers.mean(axis=0)
    cameras, pairs = _linearize(rig.recentered(center), grid, index), camera_pairs(pairs, rig)

    def shift(vector: Floats) -> Floats:
        perturbed = _rig(nominal.from_vector(vector), report)
        return _shift(cameras, perturbed.recentered(center), grid, index, pairs)

    return standard_deviation(shift, nominal.to_vector(), report.covariance)


def _rig(params: CalibrationParams, report: RigReport) -> Rig:
    cameras = [
        intrinsics.camera(2 * camera.max_corner_angle_deg)
        for intrinsics, camera in zip(params.intrinsics, report.joint, strict=True)
    ]
    return Rig(cameras, [pose.inverse() for pose in params.T_cam_rig])


@dataclass(frozen=True)
class _Linearized:
    """Projection of one camera, linearized at the point of every ray on a sphere."""

    pixels: Floats  # u, (H, W, 2)
    valid: NDArray[np.bool_]  # (H, W)
    pixel_to_angle: Floats  # M⁻¹, (H, W, 2, 2): from pixels to radians on the panorama
    parallax_per_sphere: Floats  # M⁻¹ ∂u/∂n, (H, W, 2)


def _linearize(rig: Rig, grid: SphereGrid, index: float) -> list[_Linearized]:
    """Linearize every camera of the right rig, once for any number of wrong rigs."""
    rays = grid.rays()
    right = np.stack([rays[..., 2], np.zeros(grid.shape), -rays[..., 0]], axis=-1)  # along θ …
    right /= np.maximum(np.linalg.norm(right, axis=-1, keepdims=True), 1e-12)
    down = np.cross(rays, right)  # … and along φ
    cameras = []
    for i in range(len(rig)):
        u, valid = _project(rig, i, rays, grid, index)
        columns = []
        for axis in (right, down):
            ahead, back = (
                _project(rig, i, rays + s * _ANGLE_STEP * axis, grid, index)[0] for s in (1, -1)
            )
            columns.append((ahead - back) / (2 * _ANGLE_STEP))
        M = np.stack(columns, axis=-1)
        M[~valid] = np.eye(2)
        ahead, back = (_project(rig, i, rays, grid, index + s * _INDEX_STEP)[0] for s in (1, -1))
        inverse: NDArray[Any] = np.linalg.inv(M)
        cameras.append(
            _Linearized(u, valid, inverse, _times(inverse, (ahead - back) / (2 * _INDEX_STEP)))
        )
    return cameras


def _shift(
    cameras: list[_Linearized],
    wrong: Rig,
    grid: SphereGrid,
    index: float,
    pairs: list[tuple[int, int]],
) -> Floats:
    """Return the shift that fits all pairs best: least squares along each ray."""
    rays = grid.rays()
    errors = [
        _times(camera.pixel_to_angle, _project(wrong, i, rays, grid, index)[0] - camera.pixels)
        for i, camera in enumerate(cameras)
    ]
    numerator, denominator = np.zeros((2, *grid.shape))
    for i, j in pairs:
        both = cameras[i].valid & cameras[j].valid
        parallax = cameras[i].parallax_per_sphere - cameras[j].parallax_per_sphere
        numerator -= np.where(both, np.sum(parallax * (errors[i] - errors[j]), axis=-1), 0.0)
        denominator += np.where(both, np.sum(parallax * parallax, axis=-1), 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(denominator > 0, numerator / denominator, np.nan)


def _project(
    rig: Rig, i: int, directions: Floats, grid: SphereGrid, index: float
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the pixels of points on a sphere in camera i, and whether they are visible."""
    points = directions / grid.index_to_inverse_depth(index)
    return rig.cameras[i].project(rig.T_rig_cam[i].inverse() @ points, use_direct_poly=True)


def _times(matrices: Floats, vectors: Floats) -> Floats:
    return (matrices @ vectors[..., None])[..., 0]


def standard_deviation(
    function: Callable[[Floats], Floats], x: Floats, covariance: Floats
) -> Floats:
    """Return the standard deviation of everything a function returns, to first order: √diag(J Σ
    Jᵀ).

    Derivatives are numerical, along the principal axes of Σ with steps of one standard deviation:
    coefficients of a polynomial are known together far better than each by itself.

    Args:
        function: A function of the parameters (n,) that returns an array of any shape.
        x: array, shape (n,)
        covariance (array, shape (n, n)): Covariance of the parameters.
    """
    scale = np.sqrt(np.diag(covariance))
    variances, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
    steps = (scale[:, None] * axes * np.sqrt(variances.clip(0.0))).T
    return np.sqrt(
        sum(np.square((function(x + step) - function(x - step)) / 2.0) for step in steps)
    )
