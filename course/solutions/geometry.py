"""Solutions of notebooks 00 to 03: lens, rig, spheres."""

import numpy as np

# --- 00 Quickstart ----------------------------------------------------------------------------------------


# --- 01 Fisheye model -------------------------------------------------------------------------------------


def my_ray(u, v, poly, center):
    x, y = u - center[0], v - center[1]
    r = np.hypot(x, y)
    # np.polyval wants the highest coefficient first. f is negative before the lens, z points forward.
    z = -np.polyval(poly[::-1], r)
    ray = np.array([x, y, z])
    return ray / np.linalg.norm(ray)


def my_angle(ray):
    x, y, z = ray
    # arctan2 knows the quadrant, so it is right beyond 90°, and the ray's length cancels.
    return np.degrees(np.arctan2(np.hypot(x, y), z))


def my_rms(residuals):
    # Square, mean, root; the mean runs over all 2K numbers, u and v alike.
    return np.sqrt(np.mean(residuals**2))


def my_pixels(rays, inv_poly, center, max_deg):
    x, y, z = rays.T
    n = np.hypot(x, y)
    r = np.polyval(inv_poly[::-1], np.arctan2(-z, n))
    # x / n and y / n are the direction in the image. On the axis there is none, and any other number than 0 will do.
    scale = np.where(n > 0, r / np.where(n > 0, n, 1), 0)
    pixels = np.stack([x * scale, y * scale], axis=1) + center
    seen = np.degrees(np.arctan2(n, z)) <= max_deg
    return np.where(seen[:, None], pixels, np.nan)


def my_rays(pixels, poly, center, affine):
    c, d, e = affine
    A = np.array([[1, e], [d, c]])
    xy = (pixels - center) @ np.linalg.inv(A).T  # A p for a column p is p Aᵀ for a row
    r = np.linalg.norm(xy, axis=-1, keepdims=True)
    rays = np.concatenate([xy, -np.polyval(poly[::-1], r)], axis=-1)
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


# --- 02 Rig calibration -----------------------------------------------------------------------------------


def my_relative_pose(T_1_board, T_2_board):
    # Read from the right: camera 1 -> board, then board -> camera 2. The inner indices meet.
    return T_2_board @ T_1_board.inverse()


def my_unknowns(cameras, captures, degree):
    coefficients = degree  # a0, a2, a3 … aM: there is no a1
    lenses = cameras * (2 + 2 + coefficients)  # centre; c and d = e; polynomial
    poses = (cameras - 1) + captures  # camera 1 is the rig's frame; one board for each capture
    return lenses + 6 * poses


def my_depth_error(depth, N, nearest):
    step = 1 / (nearest * (N - 1))  # in inverse depth
    # depth = 1/d, so its derivative is -1/d², which is -depth².
    return depth**2 * step


def my_chain(steps):
    poses = [np.eye(4)]
    for step in steps:
        poses.append(step @ poses[-1])  # first the way so far, then one camera further
    return np.array(poses)


def my_view_rms(T_cam_board, board, corners, F, center):
    rms = []
    for T, found in zip(T_cam_board, corners, strict=True):
        x, y, z = T[:3, :3] @ board.T + T[:3, 3:]
        n = np.hypot(x, y)
        r = F * np.arctan2(n, z)
        predicted = np.stack([x / n * r, y / n * r], axis=1) + center
        squares = np.sum((predicted - found) ** 2, axis=1)  # of the distances
        rms.append(np.sqrt(np.nanmean(squares)))  # corners that were not found have no say
    return np.array(rms)


# --- 03 Sphere sweep --------------------------------------------------------------------------------------
