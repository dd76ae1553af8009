"""Solutions of notebook 02."""

import numpy as np


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
