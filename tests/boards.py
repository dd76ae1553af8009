"""Corners of a board as lenses with closed-form projections see them: the truth."""

import numpy as np
from scene import polar_rays

from omnistereo_lib.geometry.pose import Pose
from omnistereo_rigs.boards.checkerboard import Checkerboard

BOARD = Checkerboard((12, 10), 0.06)
SIZE = (800, 768)
CENTER = np.array([402.5, 379.0])

# θ from the axis in radians -> distance from the centre in px, and how far the lens sees in
# degrees.
LENSES = {
    "equidistant 210": (lambda theta: 200 * theta, 105),
    "equisolid 210": (lambda theta: 2 * 225 * np.sin(theta / 2), 105),
    "stereographic 180": (lambda theta: 2 * 150 * np.tan(theta / 2), 90),
    "pinhole 60": (lambda theta: 600 * np.tan(theta), 30),
    "telephoto 26": (lambda theta: 1600 * np.tan(theta), 13),
    "mirror 220": (lambda theta: 150 * theta + 10 * theta**3, 110),
}


def project(points, lens="equidistant 210", center=CENTER):
    """Pixels (..., 2) of points (..., 3) in the camera frame, and where the image has them."""
    radius, reach_deg = LENSES[lens]
    theta = np.arctan2(np.hypot(points[..., 0], points[..., 1]), points[..., 2])
    n = np.maximum(np.hypot(points[..., 0], points[..., 1]), 1e-12)
    uv = (
        center + (radius(np.minimum(theta, np.radians(reach_deg))) / n)[..., None] * points[..., :2]
    )
    inside = ((uv >= 0) & (uv <= np.array(SIZE) - 1)).all(axis=-1)
    return uv, inside & (theta <= np.radians(reach_deg))


def somewhere(rng, reach_deg, angle_deg=None):
    """A pose of the board, facing the camera, anywhere in the field of view, tilted every way."""
    angle, azimuth = np.radians(rng.uniform(0, reach_deg)), rng.uniform(0, 2 * np.pi)
    angle = angle if angle_deg is None else np.radians(angle_deg)
    forward = polar_rays(angle, azimuth)
    right = np.cross([0.0, 1.0, 0.01], forward)
    right /= np.linalg.norm(right)
    # A long lens has to stand back to see all of it.
    distance = rng.uniform(1, 2) * max(0.6, 0.6 / np.tan(np.radians(min(reach_deg, 45))))
    there = Pose(np.column_stack([right, np.cross(forward, right), forward]), distance * forward)
    tilt = Pose.from_vector([*rng.normal(0, 0.4, 2), rng.uniform(-3, 3), 0, 0, 0])
    return there @ tilt @ Pose(np.eye(3), -BOARD.points.mean(axis=0))


def views(rng, count=24, lens="equidistant 210", noise=0.05):
    """Corners (K, 2) of `count` whole boards, from the axis to the rim, and their T_cam_board."""
    corners, poses = [], []
    while len(corners) < count:
        reach = LENSES[lens][1]
        # As far out as a whole board can be, in turn.
        angle = reach * np.sqrt(rng.uniform(0, 1)) * (len(corners) + 1) / count
        pose = somewhere(rng, reach, angle)
        uv, seen = project(pose @ BOARD.points, lens)
        if seen.all() and pose.R[:, 2] @ (pose @ BOARD.points.mean(axis=0)) > 0:
            corners.append(uv + rng.normal(0, noise, uv.shape))
            poses.append(pose)
    return corners, poses


def ray_error_deg(intrinsics, lens="equidistant 210", reach_deg=None):
    """Root mean square angle between the rays of a fitted camera and the lens's own."""
    theta = np.radians(np.linspace(1, reach_deg or LENSES[lens][1], 50))
    theta, azimuth = np.meshgrid(theta, np.arange(24) * np.pi / 12)
    rays = polar_rays(theta, azimuth)
    uv, seen = project(rays, lens)
    fitted = intrinsics.rays(uv[seen])
    error = np.arctan2(
        np.linalg.norm(np.cross(fitted, rays[seen]), axis=-1), np.sum(fitted * rays[seen], axis=-1)
    )
    return float(np.degrees(np.sqrt(np.mean(error**2))))


def rig_poses():
    """Four cameras on a square of 300 mm, each looking outwards, T_rig_cam; a little crooked."""
    rng = np.random.default_rng(1)
    return [
        Pose.from_vector([0, a, 0, 0.21 * np.sin(a), 0, 0.21 * np.cos(a)])
        @ Pose.from_vector(rng.normal(0, 0.01, 6))
        for a in np.arange(4) * np.pi / 2
    ]


def captures(rng, alone=7, shared=5, noise=0.1):
    """views[camera][capture]: boards before each camera, then between; None if not whole."""
    T_rig_cam = rig_poses()
    headings = [i * np.pi / 2 for i in range(4) for _ in range(alone)]
    headings += [(i + 0.5) * np.pi / 2 for i in range(4) for _ in range(shared)]
    rows = [[] for _ in range(4)]
    for number, heading in enumerate(headings):
        wide = 0.6 if number < 4 * alone else 0.1
        place = Pose.from_vector([0, heading + rng.normal(0, wide), 0, 0, 0, 0])
        place @= Pose.from_vector([rng.normal(0, wide), 0, 0, 0, 0, 0])
        tilt = Pose.from_vector([*rng.normal(0, 0.35, 2), rng.uniform(-3, 3), 0, 0, 0])
        ahead = Pose(np.eye(3), [0, 0, rng.uniform(0.9, 1.2)])
        T_rig_board = place @ ahead @ tilt @ Pose(np.eye(3), -BOARD.points.mean(axis=0))
        for row, pose in zip(rows, T_rig_cam, strict=True):
            T_cam_board = pose.inverse() @ T_rig_board
            uv, seen = project(T_cam_board @ BOARD.points)
            front = T_cam_board.R[:, 2] @ (T_cam_board @ BOARD.points.mean(axis=0)) > 0
            uv = uv + rng.normal(0, noise, uv.shape)
            # Nobody can tell the two ends of this board apart.
            uv = uv[::-1] if rng.random() < 0.5 else uv
            row.append(uv if seen.all() and front else None)
    return rows
