"""Initial camera and board poses from corners alone: the user gives no focal length.

For a row of focal lengths F the camera is assumed equidistant, r = F θ. That makes every pixel a
ray, and the pose of a plane follows from its rays by linear algebra at any angle to the axis: rays,
unlike points on the plane z = 1, exist beyond 90°. The F whose planes fit best starts the bundle
adjustment.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Floats, Pose
from omnistereo_rigs.boards.bundle import bundle_adjust
from omnistereo_rigs.boards.params import CalibrationParams, Intrinsics, collect_observations

# F = smaller image side / (2 × angle at its edge): from 130° at the edge (mirrors) down to 10°
# (telephoto).
_CANDIDATE_EDGE_ANGLES = np.radians([130, 110, 90, 75, 60, 45, 35, 25, 17, 10])
# An equidistant camera needs corners within this angle.
_WIDEST = np.radians(170)
# So many focal lengths, the best ones, are adjusted.
_MAX_CANDIDATES = 3
_STEPS = 30
# If a camera is as good as this, the next one is not tried.
_GOOD_PX = 1.0


def initial_estimate(
    views: Sequence[Floats], points: Floats, image_size: tuple[int, int]
) -> CalibrationParams:
    """Return a camera of degree 4 and the pose of each view, near enough for the bundle adjustment.

    Args:
        views (sequence of arrays, shape (K, 2)): Corners in pixels, NaN where missing.
        points (array, shape (K, 3)): The same corners in the board frame, metres, z = 0.
        image_size: Width and height, pixels.
    """
    center = (np.array(image_size) - 1) / 2
    farthest = max(np.nanmax(np.linalg.norm(view - center, axis=-1)) for view in views)
    focals = [min(image_size) / 2 / angle for angle in _CANDIDATE_EDGE_ANGLES]
    focals = [focal for focal in focals if farthest / focal < _WIDEST]
    # With F given every pixel is a ray, and each view a plane: see how well planes fit for each F.
    planes = [[solve_planar_pose(_rays(view, center, f), points) for view in views] for f in focals]
    errors = focals * np.array([np.median([error for _, error in row]) for row in planes])
    observations = collect_observations([views], points)
    best, least = None, np.inf
    for i in np.argsort(errors)[:_MAX_CANDIDATES]:
        intrinsics = _init_equidistant(image_size, focals[i], farthest)
        poses = tuple(pose for pose, _ in planes[i])
        params = CalibrationParams((intrinsics,), (Pose.identity(),), poses)
        options: dict[str, Any] = {"loss": "soft_l1", "steps": _STEPS, "tolerance": 1e-4}
        params, distance = bundle_adjust(params, observations, **options)
        # In pixels, cut off at 10 so that wrong corners do not decide.
        error = distance.clip(max=10.0).mean()
        if error < least:
            best, least = params, error
        if least < _GOOD_PX:
            break
    if best is None:
        raise OmnistereoError(
            f"corners lie up to {farthest:.0f} px from the middle of an image of {image_size};"
            " check the image size"
        )
    return best


def estimate_poses(
    camera: OcamCamera, views: Sequence[Floats], points: Floats
) -> CalibrationParams:
    """Return a given camera, as it is, and the pose of each view; see `initial_estimate`."""
    intrinsics, roll = Intrinsics.of_camera(camera)
    rays = [np.where(ok[:, None], r @ roll.R.T, np.nan) for r, ok in map(camera.unproject, views)]
    poses = tuple(solve_planar_pose(of_view, points)[0] for of_view in rays)
    return CalibrationParams((intrinsics,), (Pose.identity(),), poses, fixed_intrinsics=True)


def _init_equidistant(image_size: tuple[int, int], focal: float, farthest: float) -> Intrinsics:
    """Return r = F θ as an OCam polynomial of degree 4."""
    scale = max(image_size) / 2
    # f(r) = -r / tan(r / F) is the polynomial of r = F θ, fitted in the powers 0, 2, 3 and 4.
    r = np.linspace(0.01, 1.0, 200) * farthest
    # In pixels: errors of f weigh with sin θ, or the end of a field near 180° would outweigh all
    # the rest.
    weight = np.sin(r / focal)
    basis = scale * (r[:, None] / scale) ** [0, 2, 3, 4]
    alpha = np.linalg.lstsq(basis * weight[:, None], -r / np.tan(r / focal) * weight, rcond=None)[0]
    return Intrinsics(np.array([*(np.array(image_size) - 1) / 2, 1.0, 0.0, *alpha]), image_size)


def _rays(pixels: Floats, center: Floats, focal: float) -> Floats:
    """Return the unit rays of an equidistant camera, shape (K, 3)."""
    offset = pixels - center
    r = np.linalg.norm(offset, axis=-1, keepdims=True)
    return np.concatenate(
        [offset / np.maximum(r, 1e-9) * np.sin(r / focal), np.cos(r / focal)], axis=-1
    )


def solve_planar_pose(rays: Floats, points: Floats) -> tuple[Pose, float]:
    """Return T_cam_board from the rays to points of a plane, and the residual.

    The direct linear transform: λ b = [r1 r2 t] (X, Y, 1), so b × [r1 r2 t] (X, Y, 1) = 0, nine
    unknowns up to scale. The scale follows from the unit length of r1 and r2, the sign from points
    that lie along their rays.

    Args:
        rays (array, shape (K, 3)): Unit length; NaN where a corner is missing.
        points (array, shape (K, 3)): z = 0, metres.

    Returns:
        residual: Root mean square angle between the rays and the points of the plane, radians.
    """
    finite = np.isfinite(rays).all(axis=-1)
    b, size = rays[finite], np.abs(points).max()
    plane = np.column_stack([points[finite, :2] / size, np.ones(finite.sum())])
    x, y, z = b.T[:, :, None]
    zero = np.zeros_like(plane)
    # [b]ₓ H (X, Y, 1) = 0 for all corners: three equations each, of the nine numbers of H. The
    # solution is the eigenvector of AᵀA for its smallest eigenvalue. Lengths are divided by the
    # size of the board, so that all numbers are of one order.
    A = np.block(
        [
            [zero, -z * plane, y * plane],
            [z * plane, zero, -x * plane],
            [-y * plane, x * plane, zero],
        ]
    )
    H = np.linalg.eigh(A.T @ A)[1][:, 0].reshape(3, 3)
    H[:, :2] /= size
    # Both first columns have length 1 on average, and points lie along their rays, not against
    # them.
    H *= 2 / np.linalg.norm(H[:, :2], axis=0).sum()
    H *= np.sign(np.sum(b * (plane * [size, size, 1] @ H.T)))
    # The nearest two columns that are orthonormal; the third column is their cross product.
    U, _, Vt = np.linalg.svd(H[:, :2], full_matrices=False)
    r1, r2 = (U @ Vt).T
    pose = Pose(np.column_stack([r1, r2, np.cross(r1, r2)]), H[:, 2])
    seen = pose @ points[finite]
    angle = np.arctan2(np.linalg.norm(np.cross(seen, b), axis=-1), np.sum(seen * b, axis=-1))
    return pose, float(np.sqrt(np.mean(angle**2)))
