"""Checkers of notebooks 09 to 11: your own rig, rendering, two groups of rays."""

from __future__ import annotations

import numpy as np

from course.exercises.compare import Array, Case, Rng, checker
from omnistereo_lib.geometry.pose import Pose


@checker
def check_metres_per_unit(rng: Rng, k: int) -> Case:
    """09.1: by what to multiply a file's positions, given these, two cameras and their distance by ruler in metres."""
    positions = rng.uniform(-250, 250, (4 + k % 3, 3))
    i, j = (int(camera) for camera in rng.choice(len(positions), 2, replace=False))
    measured = np.linalg.norm(positions[j] - positions[i]) * rng.uniform(0.9e-3, 1.1e-3)
    apart = positions[j] - positions[i]
    distance = np.linalg.norm(apart)
    mistakes = [
        (distance / measured, "that many of the file's units make a metre; metres in one unit are asked"),
        (distance, "that is their distance in the file's unit; the measured one divided by it is asked"),
        (measured / np.linalg.norm(positions[j]), "from camera to camera, not from the origin: subtract"),
        (measured / np.linalg.norm(positions[i]), "from camera i to camera j, not from the origin: subtract"),
        (measured / np.abs(apart).sum(), "that adds up the components: take the root of the sum of squares"),
        (measured / np.sum(apart**2), "that divides by the squared distance: take the root"),
        (measured / np.abs(apart).max(), "all three components count, not the largest alone"),
        (measured / np.hypot(apart[0], apart[2]), "cameras stand at different heights, too: y is missing"),
        (measured / np.linalg.norm(positions[j - 1] - positions[i - 1]), "i and j are indices from 0: subtract no 1"),
        (0.001, "that is the unit it stands for, millimetres; return the ratio itself, which tells more"),
    ]
    return (positions, i, j, measured), measured / distance, mistakes


@checker
def check_pose_from_file(rng: Rng, k: int) -> Case:
    """09.2: T_rig_cam in metres, (4, 4), from a file's matrix that takes rig → camera, millimetres."""
    matrix = np.eye(4)
    T_cam_rig = Pose.from_vector([0.2, 1.4, -0.3, 120.0, -35.0, 260.0] * rng.uniform(0.6, 1.4, 6))
    matrix[:3, :3], matrix[:3, 3] = R, t = T_cam_rig.R, T_cam_rig.t

    def pose(R: Array, t: Array) -> Array:
        return np.vstack([np.column_stack([R, t / 1000]), [0, 0, 0, 1]])

    right = pose(R.T, -R.T @ t)
    mistakes = [
        (matrix, "that is the file's matrix: invert it, and go from millimetres to metres"),
        (np.linalg.inv(matrix), "the direction is right; the translation is still in millimetres"),
        (pose(R.T, -R.T @ t * 1e6), "millimetres to metres: divide by 1000, do not multiply"),
        (pose(R, t), "the unit is right; the matrix still takes the rig's coordinates to the camera: invert it"),
        (np.linalg.inv(matrix) / 1000, "only the translation has a unit: leave the rotation and the last row alone"),
        (np.linalg.inv(matrix / 1000), "only the translation has a unit: leave the rotation and the last row alone"),
        (pose(R.T, -t), "the inverse's translation is -Rᵀt, not -t: where the rig's origin was, turned back"),
        (pose(R.T, t), "the rotation is transposed, the translation untouched: it becomes -Rᵀt"),
        (pose(R.T, R.T @ t), "the sign: the inverse's translation is -Rᵀt"),
        (pose(R.T, -R @ t), "the translation is turned by R; turn it by Rᵀ"),
        (pose(R, -R.T @ t), "the translation is right; the rotation must be transposed, too"),
        (pose(R, -t), "both parts: the rotation is transposed, and the translation becomes -Rᵀt"),
        (matrix.T, "a transposed 4 × 4 matrix is no inverse: transpose R alone, and t becomes -Rᵀt"),
        (right[:3], "right, but for the last row 0 0 0 1: return the 4 × 4 matrix"),
    ]
    return (matrix,), right, mistakes


@checker
def check_spheres_needed(rng: Rng, k: int) -> Case:
    """09.4: fewest spheres for which a match moves by at most `pixels` from one to the next (small angles)."""
    baseline, nearest = rng.uniform(0.3, 0.6), rng.uniform(0.5, 1.2)
    width, pixels = int(rng.integers(400, 900)), rng.uniform(0.4, 0.9)
    moves = baseline / nearest * width / (2 * np.pi)
    steps = moves / pixels
    N = int(np.ceil(steps)) + 1
    mistakes = [
        (steps + 1, "there is no part of a sphere: round up"),
        (N - 1, "one too few: round the steps up, and one sphere more than steps"),
        (N - 2, "two too few: round the steps up, not down, and one sphere more than steps"),
        (steps, "that is the steps; round up, and there is one sphere more than steps"),
        (np.ceil(moves) + 1, "that is for one pixel a sphere: divide by `pixels`"),
        (np.ceil(moves * pixels) + 1, "fewer pixels a sphere need more spheres: divide by `pixels`"),
        (np.ceil(2 * steps) + 1, "W pixels make the full circle, 2π, not π"),
        (np.ceil(baseline / nearest * width / 360 / pixels) + 1, "baseline / nearest is in radians, 2π for W pixels"),
        (
            np.ceil(baseline * nearest * width / (2 * np.pi) / pixels) + 1,
            "near things move more: divide by the nearest depth",
        ),
        (
            np.ceil(nearest / baseline * width / (2 * np.pi) / pixels) + 1,
            "the parallax is baseline / depth, not the other way round",
        ),
        (np.ceil(np.degrees(baseline / nearest) / pixels) + 1, "that counts degrees for pixels: W pixels make 360°"),
        (np.ceil(baseline / nearest / pixels) + 1, "that counts radians for pixels: W pixels make 2π"),
    ]
    return (baseline, nearest, width, pixels), N, mistakes


@checker
def check_distance_from_z(rng: Rng, k: int) -> Case:
    """10.1: distance along a viewing ray (x, y, z) of any length, given the depth along the optical axis."""
    z_depth, ray = rng.uniform(3, 9), rng.uniform([0.5, -1, 1], [1, -0.4, 2])
    length, z = np.linalg.norm(ray), ray[2]
    mistakes = [
        (z_depth * z / length, "the wrong way round: the ray is longer than its part along the axis"),
        (z_depth * length, "the ray does not end at z = 1: divide by its z"),
        (z_depth / z, "that many rays long it is; times the ray's length gives metres"),
        (np.hypot(z_depth, np.hypot(*ray[:2])), "x and y belong to the ray as given; stretch it to the depth first"),
        (z_depth * np.hypot(*ray[:2]) / z, "that is the distance from the axis; the depth along it counts, too"),
        (z_depth * np.hypot(ray[0], z) / z, "y is missing: the ray goes up or down as well"),
        (z_depth, "z is the part along the axis; the ray to a point off the axis is longer"),
    ]
    return (z_depth, ray), z_depth * length / z, mistakes


@checker
def check_share_of_sphere(rng: Rng, k: int) -> Case:
    """10.2: the share of a panorama's solid angle, 0 … 1, that a mask covers; rows even in elevation."""
    low, high = rng.uniform(-80, -30), rng.uniform(30, 85)
    rows = int(rng.integers(4, 9))
    mask = rng.uniform(0, 1, (rows, 5)) < np.linspace(0.2, 0.9, rows)[:, None]

    def share(elevation: Array) -> float:
        return float(np.average(mask.mean(1), weights=np.cos(elevation)))

    middles = np.radians(low + (np.arange(rows) + 0.5) * (high - low) / rows)
    weight = np.cos(middles)[:, None]
    mistakes = [
        (mask.mean(), "that is the share of the pixels: one near a pole covers less, weigh the rows by cos φ"),
        (100 * share(middles), "that is in percent; a share runs from 0 to 1"),
        (share(np.radians(np.linspace(low, high, rows))), "rows are pixels: their middles lie half a pixel inside"),
        (share(np.degrees(middles)), "cos wants radians"),
        (share(np.pi / 2 - middles), "the elevation counts from the horizon: cos φ, not sin φ"),
        (np.mean(weight * mask), "divide by the sum of all weights, not by the number of pixels"),
        (np.sum(weight * mask), "that is a sum of weights; divide by the sum of all of them"),
        (np.sum(weight * mask) / weight.sum(), "each row's weight counts once for every pixel of the row"),
        (share(middles) * np.ptp(np.sin(np.radians([low, high]))) / 2, "that is the share of the whole sphere"),
    ]
    return (mask, low, high), share(middles), mistakes


@checker
def check_risk_ratio(rng: Rng, k: int) -> Case:
    """11.1: how many times as often a ray is wrong where two cameras disagree as where they agree."""
    agree, wrong = rng.uniform(0, 1, (2, 5, 6 + k % 3)) < np.array([0.7, 0.4])[:, None, None]
    agree[0, :4], wrong[0, :4] = (1, 1, 0, 0), (1, 0, 1, 0)  # all four kinds there are
    among_agreeing, among_others = wrong[agree].mean(), wrong[~agree].mean()
    mistakes = [
        (among_agreeing / among_others, "that is the other way round: disagreeing over agreeing"),
        (among_others - among_agreeing, "that is the difference of the shares; divide them"),
        (100 * (among_others - among_agreeing), "that is the difference of the shares in percent; divide them"),
        (wrong[~agree].sum() / wrong[agree].sum(), "those are numbers of rays: take shares, the groups differ in size"),
        (among_others / wrong.mean(), "compare with the rays that agree, not with all"),
        (among_others, "that is the share of wrong rays where they disagree; divide by that where they agree"),
        (agree[~wrong].mean() / agree[wrong].mean(), "that splits the rays by error; split them by agreement"),
    ]
    return (agree, wrong), among_others / among_agreeing, mistakes
