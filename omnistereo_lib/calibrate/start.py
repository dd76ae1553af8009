"""A first camera and first poses out of nothing but corners: no focal length asked of the user.

A lens is taken for equidistant, r = F θ, for a row of focal lengths F. That makes every pixel a ray, and the
pose of a plane follows from its rays by linear algebra, whatever their angle to the axis: rays, unlike points
on the plane z = 1, do not care about 90°. The F whose planes fit best starts the bundle adjustment.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.calibrate.bundle import Bundle, Estimate, Intrinsics, Observations, adjust, observations
from omnistereo_lib.geometry.pose import Pose

Floats = NDArray[np.float64]

# F = image's smaller side / (2 × angle at its edge): from 130° at the edge (mirrors) down to 10° (telephoto).
_EDGE_ANGLES = np.radians([130, 110, 90, 75, 60, 45, 35, 25, 17, 10])
_WIDEST = np.radians(170)  # an equidistant start further out is no lens
_TRIED = 3  # of them, by adjustment
_STEPS = 30
_GOOD_PX = 1.0  # good enough not to try the next


def first_estimate(views: Sequence[Floats], points: Floats, image_size: tuple[int, int]) -> Estimate:
    """Return a camera of degree 4 and the pose of each view, near enough for the bundle adjustment.

    Parameters
    ----------
    views : sequence of arrays, shape (K, 2)
        Corners in pixels, NaN where missing.
    points : array, shape (K, 3)
        The same corners on the board, metres, z = 0.
    image_size : (int, int)
        Width and height, pixels.
    """
    center = (np.array(image_size) - 1) / 2
    farthest = max(np.nanmax(np.linalg.norm(view - center, axis=-1)) for view in views)
    focals = [min(image_size) / 2 / angle for angle in _EDGE_ANGLES]
    focals = [focal for focal in focals if farthest / focal < _WIDEST]
    misfits = [_median_misfit(views, points, center, focal) for focal in focals]
    seen = observations([views], points)
    best, least = None, np.inf
    for i in np.argsort(misfits)[:_TRIED]:
        start = _equidistant(views, points, image_size, focals[i], farthest)
        estimate = adjust(start, seen, loss="soft_l1", steps=_STEPS, tolerance=1e-4)
        error = _typical_error(estimate, seen)
        if error < least:
            best, least = estimate, error
        if least < _GOOD_PX:
            break
    return best


def _typical_error(estimate: Estimate, seen: Observations) -> float:
    """Mean distance in pixels, each taken as one of 10 px at most: wrong corners do not decide."""
    residuals = Bundle(estimate, seen).residuals(estimate.vector()).reshape(-1, 2)
    return float(np.minimum(np.linalg.norm(residuals, axis=-1), 10.0).mean())


def _equidistant(
    views: Sequence[Floats], points: Floats, image_size: tuple[int, int], focal: float, farthest: float
) -> Estimate:
    """Return the start for one focal length: r = F θ written as an OCam polynomial of degree 4."""
    center = (np.array(image_size) - 1) / 2
    scale = max(image_size) / 2
    r = np.linspace(0.01, 1.0, 200) * farthest
    powers = np.array([0, 2, 3, 4])
    depth = -r / np.tan(r / focal)
    # In pixels: f errors weigh with sin θ, or the end of a field near 180° would outweigh all the rest.
    weight = np.sin(r / focal)[:, None]
    basis = scale * (r[:, None] / scale) ** powers
    alpha = np.linalg.lstsq(basis * weight, depth * weight[:, 0], rcond=None)[0]
    intrinsics = Intrinsics(np.concatenate([center, [1.0, 0.0], alpha]), image_size)
    poses = [plane_pose(_rays(view, center, focal), points)[0] for view in views]
    return Estimate((intrinsics,), (Pose.identity(),), tuple(poses))


def _median_misfit(views: Sequence[Floats], points: Floats, center: Floats, focal: float) -> float:
    return float(np.median([focal * plane_pose(_rays(view, center, focal), points)[1] for view in views]))


def _rays(pixels: Floats, center: Floats, focal: float) -> Floats:
    """Return the unit rays of an equidistant lens, shape (K, 3)."""
    offset = pixels - center
    r = np.linalg.norm(offset, axis=-1, keepdims=True)
    theta = r / focal
    return np.concatenate([offset / np.maximum(r, 1e-9) * np.sin(theta), np.cos(theta)], axis=-1)


def plane_pose(rays: Floats, points: Floats) -> tuple[Pose, float]:
    """Return T_cam_board from the rays to points of a plane, and the misfit.

    The direct linear transform: λ b = [r1 r2 t] (X, Y, 1), so b × [r1 r2 t] (X, Y, 1) = 0, nine unknowns up to
    scale. The scale is that r1 and r2 have unit length, its sign that the points lie along their rays.

    Parameters
    ----------
    rays : array, shape (K, 3)
        Unit length; NaN where a corner is missing.
    points : array, shape (K, 3)
        z = 0, metres.

    Returns
    -------
    T_cam_board : Pose
    misfit : float
        Root mean square angle in radians between the rays and the plane's points.
    """
    known = np.isfinite(rays).all(axis=-1)
    b, size = rays[known], np.abs(points).max()
    plane = np.column_stack([points[known, :2] / size, np.ones(known.sum())])
    zero = np.zeros_like(plane)
    rows = [
        np.hstack([zero, -b[:, 2:] * plane, b[:, 1:2] * plane]),
        np.hstack([b[:, 2:] * plane, zero, -b[:, :1] * plane]),
        np.hstack([-b[:, 1:2] * plane, b[:, :1] * plane, zero]),
    ]
    A = np.concatenate(rows)
    H = np.linalg.eigh(A.T @ A)[1][:, 0].reshape(3, 3)
    H[:, :2] /= size
    H *= np.sign(np.sum(b * (plane * [size, size, 1] @ H.T))) * 2 / np.linalg.norm(H[:, :2], axis=0).sum()
    U, _, Vt = np.linalg.svd(H[:, :2], full_matrices=False)
    r1, r2 = (U @ Vt).T
    pose = Pose(np.column_stack([r1, r2, np.cross(r1, r2)]), H[:, 2])
    seen = pose @ points[known]
    angle = np.arctan2(np.linalg.norm(np.cross(seen, b), axis=-1), np.sum(seen * b, axis=-1))
    return pose, float(np.sqrt(np.mean(angle**2)))
