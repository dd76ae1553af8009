"""Solutions of notebooks 08 to 11: evaluation, your own rig, rendering."""

import numpy as np

# --- 08 Evaluation ----------------------------------------------------------------------------------------


def my_share_above(error, limit):
    right = error <= limit  # False for NaN, too, which is how no estimate counts as wrong
    return 100 * np.mean(~right)


def my_pooled_rms(rays, sums, squares):
    # First add up over the frames, then divide, then take the root. Σ e is not needed.
    return np.sqrt(squares.sum() / rays.sum())


def my_standard_error(a, b):
    # Both methods saw the same frames, so subtract frame by frame: what makes a frame hard cancels.
    difference = a - b
    deviation = difference.std(ddof=1)  # n - 1: the mean was taken from the same frames
    return deviation / np.sqrt(len(difference))


# --- 09 Your own rig --------------------------------------------------------------------------------------


def my_metres_per_unit(positions, i, j, measured):
    in_file = np.linalg.norm(positions[j] - positions[i])  # the distance does not care where the origin is
    return measured / in_file


def my_pose(matrix):
    R, t = matrix[:3, :3], matrix[:3, 3] / 1000  # millimetres -> metres; a rotation has no unit
    pose = np.eye(4)
    pose[:3, :3] = R.T  # rig -> camera becomes camera -> rig: p = R q + t gives q = Rᵀ(p - t)
    pose[:3, 3] = -R.T @ t
    return pose


def my_num_spheres(baseline, nearest, width, pixels):
    parallax = baseline / nearest / (2 * np.pi) * width  # from infinity to the nearest sphere, in pixels
    steps = np.ceil(parallax / pixels)  # rounded up: a step may be smaller, not larger
    return int(steps) + 1  # steps are between spheres


# --- 10 Render a city -------------------------------------------------------------------------------------


def my_distance(z_depth, ray):
    # Stretch the ray until its z is the depth; what is asked is its length then.
    stretched = ray * z_depth / ray[2]
    return np.linalg.norm(stretched)


def my_share(mask, low_deg, high_deg):
    rows = len(mask)
    height = (high_deg - low_deg) / rows  # of one row
    elevation = np.radians(low_deg + (np.arange(rows) + 0.5) * height)  # the rows' middles
    weight = np.cos(elevation)  # a circle of latitude is that much shorter than the equator
    return np.sum(weight * mask.mean(axis=1)) / np.sum(weight)


# --- 11 Gallery -------------------------------------------------------------------------------------------


def my_risk_ratio(agree, wrong):
    # The groups differ in size, so shares are compared, not numbers.
    return wrong[~agree].mean() / wrong[agree].mean()
