"""Checkers of notebooks 08 to 11: evaluation, your own rig, rendering."""

from __future__ import annotations

import numpy as np

from course.exercises.compare import Answer, Array, diagnose
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.stereo.metrics import error_map


def check_index_error(answer: Answer) -> None:
    """07.3: mean absolute error in percent of the range swept (Eq. 5), over the rays with an estimate."""
    index, truth, N = np.array([3.0, 50.0, 20.0, np.nan]), np.array([3.4, 48.0, 18.3, 5.0]), 64
    known = slice(3)
    error = error_map(index, truth, N)[known]
    mistakes = [
        (error.mean() * N / 100, "that is in indices; the error is in percent of the N spheres: multiply by 100/N"),
        (error.mean() / 100, "that is a fraction of the N spheres: percent is 100 times that"),
        (error.mean() * N / (N - 1), "Eq. 5 divides by N, not by N - 1"),
        (error_map(index, np.rint(truth), N)[known].mean(), "do not round the truth: that is for training only"),
        (np.nan, "a ray without an estimate (NaN) spoils the mean: leave it out"),
        (error.sum() / len(index), "a ray without an estimate (NaN) is not among those to divide by, either"),
        ((error.sum() + 100) / len(index), "leave rays without an estimate out; `index_error` counts them as 100"),
        (error.sum(), "that is the sum: divide by the number of rays with an estimate"),
        (np.sqrt((error**2).mean()), "that is the root mean square; the MAE is the mean of the absolute values"),
        (100 / N * (index - truth)[known].mean(), "take the absolute value of each ray, before the mean"),
        (error, "that is the error of each ray: take the mean"),
        (error_map(index, truth, N), "that is the error of each ray: leave the NaN out and take the mean"),
    ]
    print(diagnose(answer, (index, truth, N), error.mean(), mistakes))


def check_share_above(answer: Answer) -> None:
    """08.1: percent of rays whose error exceeds a limit; NaN, no estimate, counts as wrong."""
    error, limit = np.array([[0.2, 3.0, np.nan, 7.5], [3.1, 0.0, 2.9, 2.0], [12.0, 1.0, 3.0, 0.5]]), 3.0
    above, missing = error > limit, np.isnan(error)
    right = 100 * np.mean(above | missing)
    mistakes = [
        (right / 100, "that is a fraction; percent are asked"),
        (100 * np.mean(above), "a comparison with NaN is False: a ray without an estimate counts as wrong"),
        (100 * np.mean(above[~missing]), "a ray without an estimate counts as wrong; it is not left out"),
        (100 * np.mean((error >= limit) | missing), "exceeds: an error equal to the limit is still right"),
        (100 - right, "that is the share of the rays that are right"),
        (float(np.sum(above | missing)), "that is their number; the share is asked"),
        (100 * np.mean(above | missing, axis=1), "that is the share of each row; one number is asked"),
    ]
    print(diagnose(answer, (error, limit), right, mistakes))


def check_pooled_rms(answer: Answer) -> None:
    """08.2: RMS of all frames together, from each frame's number of rays, sum of e and sum of e²."""
    rays, sums = np.array([1000.0, 4000.0, 500.0]), np.array([900.0, 8200.0, 2600.0])
    squares = np.array([2100.0, 31000.0, 26000.0])
    right = np.sqrt(squares.sum() / rays.sum())
    mistakes = [
        (right**2, "take the root"),
        (np.sqrt(squares / rays).mean(), "that is the mean over the frames: a frame with few rays counts too much"),
        (np.sqrt((squares / rays).mean()), "the frames have different numbers of rays: add up first, then divide"),
        (np.sqrt(squares.sum()), "divide by the number of rays"),
        (np.sqrt(squares.sum()) / rays.sum(), "divide under the root"),
        (np.sqrt(squares / rays), "that is each frame's; add up over the frames"),
        (sums.sum() / rays.sum(), "that is the mean error; Σ e² is asked for"),
        (np.sqrt(squares.sum() / rays.sum() - (sums.sum() / rays.sum()) ** 2), "that is the standard deviation: do not"
         " subtract the mean"),
    ]  # fmt: skip
    print(diagnose(answer, (rays, sums, squares), right, mistakes))


def check_standard_error(answer: Answer) -> None:
    """08.3: standard error of the mean difference a - b of two methods, from their figures in the same frames."""
    a, b = np.array([12.1, 9.4, 20.3, 15.0, 11.2, 17.9]), np.array([10.8, 9.1, 17.2, 13.9, 10.9, 14.6])
    n, difference = len(a), a - b
    deviation = np.std(difference, ddof=1)
    apart = np.sqrt((np.var(a, ddof=1) + np.var(b, ddof=1)) / n)
    mistakes = [
        (deviation, "that is the spread of single frames: the mean of n frames is √n times as certain"),
        (deviation / n, "divide by √n, not by n"),
        (deviation**2 / n, "that is its square: take the root"),
        (
            np.std(difference) / np.sqrt(n),
            "the mean came from the same frames: n - 1 in the variance",
        ),
        (
            np.std(difference),
            "the spread of single frames, with n in place of n - 1: take that, then divide by √n",
        ),
        (apart, "both methods saw the same frames: subtract frame by frame, then look at the spread"),
        (np.sqrt((np.var(a) + np.var(b)) / n), "both methods saw the same frames: subtract frame by frame first"),
        (np.std(a, ddof=1) / np.sqrt(n), "that is the standard error of a alone; take the differences a - b"),
        (difference.mean(), "that is the mean difference; how uncertain is it?"),
        (difference, "those are the differences; one number is asked"),
    ]
    print(diagnose(answer, (a, b), deviation / np.sqrt(n), mistakes))


def check_metres_per_unit(answer: Answer) -> None:
    """09.1: by what to multiply a file's positions, given these, two cameras and their distance by ruler in metres."""
    positions = np.array([[40.0, -12.0, 215.0], [262.0, 3.0, 31.0], [38.0, 130.0, -213.0], [-174.0, 8.0, 5.0]])
    i, j, measured = 1, 2, 0.36
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
    ]  # fmt: skip
    print(diagnose(answer, (positions, i, j, measured), measured / distance, mistakes))


def check_pose_from_file(answer: Answer) -> None:
    """09.2: T_rig_cam in metres, (4, 4), from a file's matrix that takes rig → camera, millimetres."""
    matrix = np.eye(4)
    T_cam_rig = Pose.from_vector([0.2, 1.4, -0.3, 120.0, -35.0, 260.0])
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
    print(diagnose(answer, (matrix,), right, mistakes))


def check_spheres_needed(answer: Answer) -> None:
    """09.3: fewest spheres for which a match moves by at most `pixels` from one to the next (small angles)."""
    baseline, nearest, width, pixels = 0.43, 0.7, 640, 0.8
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
        (np.ceil(baseline * nearest * width / (2 * np.pi) / pixels) + 1, "near things move more: divide by the"
         " nearest depth"),
        (np.ceil(nearest / baseline * width / (2 * np.pi) / pixels) + 1, "the parallax is baseline / depth, not the"
         " other way round"),
        (np.ceil(np.degrees(baseline / nearest) / pixels) + 1, "that counts degrees for pixels: W pixels make 360°"),
        (np.ceil(baseline / nearest / pixels) + 1, "that counts radians for pixels: W pixels make 2π"),
    ]  # fmt: skip
    print(diagnose(answer, (baseline, nearest, width, pixels), N, mistakes))


def check_distance_from_z(answer: Answer) -> None:
    """10.1: distance along a viewing ray (x, y, z) of any length, given the depth along the optical axis."""
    z_depth, ray = 6.0, np.array([0.9, -0.4, 1.5])
    length, z = np.linalg.norm(ray), ray[2]
    mistakes = [
        (z_depth * z / length, "turned around: the ray is longer than its part along the axis"),
        (z_depth * length, "the ray does not end at z = 1: divide by its z"),
        (z_depth / z, "that many rays long it is; times the ray's length gives metres"),
        (np.hypot(z_depth, np.hypot(*ray[:2])), "x and y belong to the ray as given; stretch it to the depth first"),
        (z_depth * np.hypot(*ray[:2]) / z, "that is the distance from the axis; the depth along it counts, too"),
        (z_depth * np.hypot(ray[0], z) / z, "y is missing: the ray goes up or down as well"),
        (z_depth, "z is the part along the axis; the ray to a point off the axis is longer"),
    ]
    print(diagnose(answer, (z_depth, ray), z_depth * length / z, mistakes))


def check_share_of_sphere(answer: Answer) -> None:
    """10.2: the share of a panorama's solid angle, 0 … 1, that a mask covers; rows even in elevation."""
    low, high = -45.0, 70.0
    mask = np.array([[1, 1, 1, 1], [1, 0, 1, 0], [0, 0, 1, 0], [0, 0, 0, 0], [0, 1, 0, 0]], bool)
    rows = len(mask)

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
    ]
    print(diagnose(answer, (mask, low, high), share(middles), mistakes))


def check_risk_ratio(answer: Answer) -> None:
    """11.1: how many times as often a ray is wrong where two cameras disagree as where they agree."""
    agree = np.array([1, 1, 1, 1, 1, 1, 1, 0, 0, 0, 1, 1], bool).reshape(3, 4)
    wrong = np.array([0, 1, 0, 0, 0, 1, 0, 1, 1, 0, 0, 0], bool).reshape(3, 4)
    among_agreeing, among_others = wrong[agree].mean(), wrong[~agree].mean()
    mistakes = [
        (among_agreeing / among_others, "that is the other way round: disagreeing over agreeing"),
        (among_others - among_agreeing, "that is the difference of the shares; divide them"),
        (100 * (among_others - among_agreeing), "that is the difference of the shares in percent; divide them"),
        (wrong[~agree].sum() / wrong[agree].sum(), "those are numbers of rays: take shares, the groups differ in size"),
        (among_others / wrong.mean(), "compare with the rays that agree, not with all"),
        (among_others, "that is the share of wrong rays where they disagree; divide by that where they agree"),
        (agree[~wrong].mean() / agree[wrong].mean(), "that splits the rays by error; split them by agreement"),
    ]  # fmt: skip
    print(diagnose(answer, (agree, wrong), among_others / among_agreeing, mistakes))
