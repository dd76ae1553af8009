"""Checkers for the notebooks' exercises: they try an answer and say what is wrong with it, and what to try next.

A checker compares the answer with the right one and with what the usual mistakes would give. It prints its
finding and never raises, whatever it is handed.
"""

from __future__ import annotations

import copy
import traceback
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.stereo.metrics import error_map

Answer = Callable[..., Any]
Array = NDArray[np.float64]
Mistakes = Sequence[tuple[ArrayLike, str]]

_FACTORS = (
    (-1.0, "that is the right value with the other sign"),
    (2.0, "that is twice the right value: look for a 2"),
    (0.5, "that is half the right value: look for a 2"),
    (100.0, "that is 100 times the right value: is something in centimetres, or in percent?"),
    (0.01, "that is a hundredth of the right value: is something in centimetres, or in percent?"),
    (180 / np.pi, "that is 180/π times the right value: are there degrees in place of radians?"),
    (np.pi / 180, "that is π/180 times the right value: are there radians in place of degrees?"),
)


def diagnose(answer: Answer, inputs: tuple, right: ArrayLike, mistakes: Mistakes) -> str:
    """Call an answer and put into words how its value compares.

    Parameters
    ----------
    answer : callable
        What the student wrote. It gets copies of the inputs, so it may change them.
    inputs : tuple
        Its arguments.
    right : array or float
        What it should return, finite.
    mistakes : sequence of (array or float, str)
        What a mistake gives instead, of any shape, and the hint that names it.

    Returns
    -------
    str
        "right", or what is wrong and the next thing to try.
    """
    if not callable(answer):
        return "hand over the function itself: its name, without brackets behind it"
    try:
        found = answer(*copy.deepcopy(inputs))
    except (Exception, SystemExit) as error:  # whatever a student's code raises is a finding; Ctrl-C is not
        return _stopped(error, len(inputs))
    if found is None or found is Ellipsis:
        return "nothing returned yet: replace the ... and return your result"
    right, values = np.asarray(right, np.float64), _numbers(found)
    return _not_numbers(found, right) if values is None else _compare(values, right, mistakes)


def check_index_to_depth(answer: Answer) -> None:
    """00.1: depth in metres of sphere index n, given N and D_min."""
    n, N, nearest = 10, 64, 1.65
    depth = nearest * (N - 1) / n
    mistakes = [
        (1 / depth, "that is the inverse depth in 1/m; the depth is one divided by it"),
        (nearest * N / n, "the spheres run from 0 to N - 1: it is N - 1 steps from infinity to D_min, not N"),
        (nearest * N / (n + 1), "the spheres count from 0, which is at infinity: n, not n + 1"),
        (nearest * (N - 1) / (N - 1 - n), "sphere 0 is the one at infinity, sphere N - 1 the nearest: turn n around"),
        (nearest * n / (N - 1), "the spheres are even in inverse depth, not in depth"),
        ((N - 1) / n, "that is in units of the nearest depth; metres are asked"),
    ]
    print(diagnose(answer, (n, N, nearest), depth, mistakes))


def check_ray_of_pixel(answer: Answer) -> None:
    """01.1: the unit ray of a pixel, given u, v, the direct polynomial (low to high) and the centre (u0, v0)."""
    u, v, poly, center = 520.0, 300.0, np.array([-196.0, 0.0, 1.6e-3, -1e-7]), np.array([401.0, 380.0])

    def ray(x: float, y: float, poly: Array = poly) -> Array:
        r = np.hypot(x, y)
        direction = np.array([x, y, -np.polyval(poly[::-1], r)])
        return direction / np.linalg.norm(direction)

    x, y = u - center[0], v - center[1]
    right = ray(x, y)
    r = np.hypot(x, y)
    mistakes = [
        (right * [1, 1, -1], "the ray is (x, y, -f(r)): f is negative before the lens, and z points forward"),
        (right * np.linalg.norm([x, y, np.polyval(poly[::-1], r)]), "divide by the length: a ray is a unit vector"),
        (ray(u, v), "x and y count from the centre: subtract it"),
        (-right * [1, 1, -1], "x and y are the pixel minus the centre, not the centre minus the pixel"),
        (ray(u - center[1], v - center[0]), "the centre is (u0, v0): its parts are swapped"),
        (ray(y, x), "x belongs to u and y to v: they are swapped"),
        (ray(x, y, poly[::-1]), "the coefficients run from low to high; np.polyval wants the highest first"),
        (ray(x, y, poly[:1]), "the whole polynomial at r, not its first coefficient alone"),
    ]
    print(diagnose(answer, (u, v, poly, center), right, mistakes))


def check_angle_from_axis(answer: Answer) -> None:
    """01.2: the angle from the optical axis, in degrees, of a ray given as (x, y, z)."""
    ray = np.array([0.8, 0.3, -0.4])
    x, y, z = ray
    across = np.hypot(x, y)
    theta = np.arctan2(across, z)
    mistakes = [
        (theta, "that is in radians; degrees are asked"),
        (np.degrees(np.arctan(across / z)), "arctan of a quotient loses the quadrant: beyond 90° use arctan2"),
        (np.degrees(np.arctan2(z, across)), "that is the angle above the xy-plane; the axis is 90° from it"),
        (np.degrees(np.arctan2(-z, across)), "that is t of the camera's docstring, below the xy-plane: add 90°"),
        (np.degrees(np.arccos(z)), "arccos(z) wants a unit vector: this ray has another length"),
        (np.degrees(np.arctan2(x, z)), "that leaves y out: the distance from the axis is hypot(x, y)"),
        (np.degrees(np.arcsin(across / np.linalg.norm(ray))), "arcsin cannot tell 60° from 120°: use arctan2"),
    ]
    print(diagnose(answer, (ray,), np.degrees(theta), mistakes))


def check_rms_per_component(answer: Answer) -> None:
    """01.3: the root mean square over all u and v of residuals, shape (K, 2)."""
    residuals = np.random.default_rng(1).normal(0.05, 0.2, (40, 2))
    squares = np.sum(residuals**2, axis=1)
    mistakes = [
        (np.sqrt(squares.mean()), "that is the rms distance, √2 more: take the mean over u and v both"),
        (np.sqrt(squares).mean(), "that is the mean distance; asked is the root of the mean square"),
        (np.mean(residuals**2), "take the root of the mean square"),
        (np.abs(residuals).mean(), "that is the mean magnitude; asked is the root of the mean square"),
        (residuals.std(), "that subtracts the mean first: a bias is an error, too"),
        (np.sqrt(np.sum(residuals**2)), "the mean of the squares, not their sum"),
    ]
    print(diagnose(answer, (residuals,), np.sqrt(np.mean(residuals**2)), mistakes))


def check_relative_pose(answer: Answer) -> None:
    """02.1: T_2_1, camera 1 → camera 2, of two cameras that see one board at T_1_board and T_2_board."""
    T_1_board = Pose.from_vector([0.2, 0.5, -0.1, 0.1, -0.2, 0.9])
    T_2_board = Pose.from_vector([0.1, -0.9, 0.3, -0.3, 0.1, 0.8])

    mistakes = [
        (T_1_board @ T_2_board.inverse(), "that is T_1_2, the way back: from camera 1 to the board, then to camera 2"),
        (T_1_board.inverse() @ T_2_board, "read the indices: T_board_1 takes to the board, T_2_board from there, so it"
         " stands on the left"),
        (T_2_board.inverse() @ T_1_board, "the inverse belongs to camera 1's pose, and the order turns: the board is"
         " between the two"),
        (T_2_board @ T_1_board, "the inner indices do not meet: camera 1 → board is the inverse of T_1_board"),
        (T_1_board @ T_2_board, "the inner indices do not meet: camera 1 → board is the inverse of T_1_board"),
    ]  # fmt: skip
    right = (T_2_board @ T_1_board.inverse()).as_vector()
    print(diagnose(answer, (T_1_board, T_2_board), right, [(T.as_vector(), hint) for T, hint in mistakes]))


def check_count_unknowns(answer: Answer) -> None:
    """02.2: unknowns of the joint adjustment, given cameras, captures and the degree M of the polynomials."""
    cameras, captures, degree = 4, 40, 6
    lenses, poses = cameras * (4 + degree), 6 * (cameras - 1 + captures)
    mistakes = [
        (lenses + 6 * (cameras + captures), "camera 1 is the rig's frame: its pose is no unknown"),
        (lenses + 6 * (cameras - 1), "each capture's board has a pose, too: six numbers more for each"),
        (lenses + 6 * (cameras - 1 + cameras * captures), "a board has one pose for each capture, not one for each"
         " camera that sees it: that is what ties the cameras together"),
        (cameras * (5 + degree) + poses, "degree M has M coefficients: a0, then a2 … aM; a1 is zero"),
        (cameras * (6 + degree) + poses, "there is no a1, and d = e count once: 4 + M for each camera"),
        (poses, "the lenses are adjusted with the poses: 4 + M numbers for each camera"),
        (4 + degree + poses, "each camera has a lens of its own"),
        (lenses + 3 * (cameras - 1 + captures), "a pose has six numbers: three of rotation, three of translation"),
    ]  # fmt: skip
    print(diagnose(answer, (cameras, captures, degree), lenses + poses, mistakes))


def check_depth_error(answer: Answer) -> None:
    """02.3: metres of depth that one sphere more or less makes, to first order, given depth, N and D_min."""
    depth, N, nearest = 8.0, 192, 0.55
    step = 1 / (nearest * (N - 1))
    mistakes = [
        (depth * step, "inverse depth is 1/ρ: its derivative is -1/ρ², so the depth enters squared"),
        (step, "that is one step in inverse depth, 1/m; in metres it grows with ρ²"),
        (depth**2 / (nearest * N), "N - 1 steps lead from infinity to D_min, not N"),
        (nearest / (N - 1), "the spheres are even in inverse depth, not in depth"),
        (1 / step, "that is 1 over the step in inverse depth: the depth of sphere 1"),
        (1 / (1 / depth - step) - depth, "that is the exact difference one sphere further out; asked is ρ² times the"
         " step, its limit for small steps"),
        (depth - 1 / (1 / depth + step), "that is the exact difference one sphere nearer; asked is ρ² times the step,"
         " its limit for small steps"),
    ]  # fmt: skip
    print(diagnose(answer, (depth, N, nearest), depth**2 * step, mistakes))


def check_point_of_ray(answer: Answer) -> None:
    """03.1: the point at a distance along the ray of angles θ, φ in radians, rig frame."""
    theta, phi, depth = 0.7, 0.3, 4.0
    x, y, z = ray = _ray(theta, phi)
    mistakes = [
        (depth * _ray(*np.radians([theta, phi])), "the angles are in radians already, and NumPy wants radians"),
        (depth * _ray(*np.degrees([theta, phi])), "NumPy wants radians, and the angles are in radians already"),
        (depth * _ray(phi, theta), "θ goes around and φ goes down: they are swapped"),
        (depth * np.array([z, y, x]), "that is the paper's printed ρ, whose panorama is turned by 90° and mirrored"),
        (depth * ray * [1, -1, 1], "y points down and φ is positive downwards: the second component is +sin φ"),
        (depth * ray * [-1, 1, 1], "x points right and θ grows to the right: the first component is +cos φ sin θ"),
        (depth * np.array([np.sin(theta), y, np.cos(theta)]), "cos φ belongs to x and z: a ray has length 1"),
        (depth * ray / z, "the depth is measured along the ray, not along z"),
        (ray, "that is the unit ray; the point lies `depth` metres along it"),
        (ray / depth, "that is divided by the depth, as if it were an inverse depth: multiply"),
    ]
    print(diagnose(answer, (theta, phi, depth), depth * ray, mistakes))


def check_pixel_of_point(answer: Answer) -> None:
    """03.2: the pixel (u, v) at which a camera sees a point that is given in the rig frame."""
    camera = OcamCamera([-200.0, 0.0, 1e-3], [314.159, 200.0], (400.0, 380.0), (1.0, 0.0, 0.0), (800, 768))
    T_rig_cam = Pose.from_vector([0.1, 0.9, -0.2, 0.3, -0.1, 0.5])
    R, t = T_rig_cam.R, T_rig_cam.t
    point = np.array([1.0, 1.0, 2.5])

    def project(point: Array) -> Array:
        return camera.project(point)[0]

    pixel = project(T_rig_cam.inverse() @ point)
    mistakes = [
        (project(T_rig_cam @ point), "T_rig_cam takes camera coordinates to the rig, the point goes back: invert it"),
        (project(R @ (point - t)), "the translation is undone, but the rotation is not transposed: Rᵀ(p - t)"),
        (project(R.T @ point - t), "the inverse's translation is -Rᵀt, not -t: Rᵀ(p - t)"),
        (project(R.T @ point + t), "the inverse's translation is -Rᵀt, not t: Rᵀ(p - t)"),
        (project(R.T @ point), "the rotation is undone, the translation is left out: Rᵀ(p - t)"),
        (project(point - t), "the translation is undone, the rotation is left out: Rᵀ(p - t)"),
        (project(point), "the point is used as if it were in the camera's frame: transform it first"),
        (pixel[::-1], "pixels are (u, v), right first, then down: yours are swapped"),
        (pixel + 0.5, "whole numbers are pixel centres here: add no half pixel"),
        (pixel - 0.5, "whole numbers are pixel centres here: subtract no half pixel"),
        (np.rint(pixel), "do not round: a point falls between pixels"),
        (np.floor(pixel), "do not cut off the decimals: a point falls between pixels"),
    ]
    print(diagnose(answer, (camera, T_rig_cam, point), pixel, mistakes))


def check_rotation_error(answer: Answer) -> None:
    """03.3: how many pixels of a panorama W wide a yaw error in degrees moves a far point."""
    yaw, width = 0.7, 320
    mistakes = [
        (yaw / (2 * np.pi) * width, "the error is in degrees, and 360 of them, not 2π, make the full width"),
        (yaw / 180 * width, "the panorama spans 360°, not 180°"),
        (yaw / 360 * (width - 1), "W columns make the full circle, not W - 1"),
        (width / 360, "that is the number of pixels in one degree: multiply by the error"),
        (360 / width, "that is the number of degrees in a pixel; pixels are asked"),
        (yaw * 360 / width, "360 and the width are swapped: W pixels make 360°"),
    ]
    print(diagnose(answer, (yaw, width), yaw / 360 * width, mistakes))


def check_zncc_cost(answer: Answer) -> None:
    """04.1: the matching cost (1 - ZNCC)/2 of two patches."""
    rng = np.random.default_rng(4)
    a = rng.normal(3, 2, (9, 9))
    b = 0.4 * a + rng.normal(1, 0.5, (9, 9))
    covariance, deviations = np.mean((a - a.mean()) * (b - b.mean())), a.std() * b.std()
    zncc, n = covariance / deviations, a.size
    ncc = np.sum(a * b) / np.sqrt(np.sum(a**2) * np.sum(b**2))
    mistakes = [
        (zncc, "that is ZNCC itself, 1 for a match; the cost is (1 - ZNCC)/2"),
        ((1 + zncc) / 2, "the sign: a match must cost 0"),
        (1 - zncc, "1 - ZNCC runs from 0 to 2: divide by 2"),
        (1 - zncc / 2, "brackets: the whole 1 - ZNCC is divided by 2"),
        ((1 - ncc) / 2, "subtract each patch's mean first (the Z of ZNCC)"),
        ((1 - np.mean(a * b) / deviations) / 2, "subtract the means in the product, too (the Z of ZNCC)"),
        ((1 - covariance) / 2, "divide the covariance by both standard deviations (the N of ZNCC)"),
        ((1 - covariance / deviations**2) / 2, "divide by the standard deviations, not by the variances"),
        ((1 - zncc * n / (n - 1)) / 2, "the covariance is divided by n - 1 and the deviations by n: use n for both"),
        ((1 - zncc * (n - 1) / n) / 2, "the covariance is divided by n and the deviations by n - 1: use n for both"),
        ((1 - zncc * n) / 2, "sum and mean are mixed: take the mean of the products"),
    ]
    print(diagnose(answer, (a, b), (1 - zncc) / 2, mistakes))


def check_mean_over_pairs(answer: Answer) -> None:
    """04.2: the mean cost over the pairs that see a ray (Eq. 2); NaN marks a pair that does not."""
    nan = np.nan
    costs = np.array([[0.2, nan, 0.5], [nan, nan, 0.9], [0.3, 0.1, 0.4], [0.7, nan, 0.4]])
    mistakes = [
        (costs.mean(0), "a pair that does not see the ray must not spoil the others: leave the NaN out"),
        (np.nan_to_num(costs).mean(0), "a pair that does not see the ray is no 0, and none of those to divide by"),
        (np.nansum(costs, 0), "that is the sum; the paper takes the mean"),
        (costs[2], "leave a pair out only at the rays that it does not see, not everywhere"),
        (np.nanmean(costs, 1), "that is the mean over the rays; average over the pairs, the first axis"),
        (np.nanmean(costs), "that is the mean over pairs and rays; each ray keeps its own"),
        (np.nanmin(costs, 0), "that is the best pair; the paper takes the mean"),
        (np.nanmedian(costs, 0), "that is the median; the paper takes the mean"),
    ]
    print(diagnose(answer, (costs,), np.array([0.4, 0.1, 0.55]), mistakes))


def check_pixels_per_index(answer: Answer) -> None:
    """04.3: how far a match moves between two neighbouring spheres, in panorama pixels (small angles)."""
    baseline, nearest, N, width = 0.6, 1.65, 64, 320
    angle, per_radian = baseline / (nearest * (N - 1)), width / (2 * np.pi)
    mistakes = [
        (angle, "that is the angle in radians: turn it into pixels, W of them in 2π"),
        (np.degrees(angle), "that is the angle in degrees: turn it into pixels, W of them in 360°"),
        (angle * width / 360, "the angle is in radians, and W pixels make 2π of them, not 360"),
        (angle * width / np.pi, "W pixels make the full circle, 2π, not π"),
        (baseline / (nearest * N) * per_radian, "N spheres have N - 1 steps: the step is 1/(D_min (N - 1))"),
        (baseline / nearest * per_radian, "that is the whole range, from infinity to D_min; one step of it is asked"),
        (baseline * nearest / (N - 1) * per_radian, "the step is in inverse depth: D_min belongs below the line"),
        (1 / (angle * per_radian), "that is the number of spheres in a pixel; it is asked the other way round"),
    ]
    print(diagnose(answer, (baseline, nearest, N, width), angle * per_radian, mistakes))


def check_sgm_step(answer: Answer) -> None:
    """07.1: one step of SGM's recurrence along a path."""
    cost = np.array([0.5, 0.3, 0.6, 0.1, 0.2, 0.7, 0.4, 0.8])
    before = np.array([2.0, 2.1, 1.7, 1.2, 1.3, 1.9, 1.5, 1.4])
    p1, p2, best = 0.1, 0.6, before.min()
    ends = np.pad(before, 1, constant_values=np.inf)

    def step(p1: float, p2: float, best: float = best, around: Array = ends) -> Array:
        neighbours = np.minimum(around[:-2], around[2:]) + p1
        return cost + np.minimum(np.minimum(before, neighbours), best + p2) - best

    right = step(p1, p2)
    mistakes = [
        (right + best, "subtract min_k L(p - r, k) at the end, or the sums grow along the path"),
        (step(p2, p1), "P1 is for a step of one sphere, P2 for a jump: they are swapped"),
        (step(p1, p2, around=np.pad(before, 1, mode="wrap")), "n ± 1 does not wrap: sphere 0 has no left neighbour"),
        (step(p1, p2, best=0.0) - best, "a jump starts at the best sphere before: min_k L(p - r, k) + P2, not P2"),
        (step(p1, np.inf), "the jump is missing: min_k L(p - r, k) + P2"),
        (step(np.inf, p2), "the neighbours are missing: L(p - r, n ± 1) + P1"),
        (step(p1, p2, best=cost.min()), "min_k is over the path costs before, not over this ray's costs"),
        (right - cost, "add this ray's own cost, C(p, n)"),
        (cost, "that is the cost alone: add the cheapest way to arrive"),
    ]
    print(diagnose(answer, (cost, before, p1, p2), right, mistakes))


def check_parabola(answer: Answer) -> None:
    """07.2: the offset of a parabola's vertex from its middle sample."""
    left, middle, right = 0.5, 0.2, 0.3
    slope, curvature = left - right, left - 2 * middle + right
    offset = slope / (2 * curvature)
    mistakes = [
        (-offset, "the sign: the vertex lies towards the cheaper neighbour"),
        (slope / curvature, "the 2 below the line is missing"),
        (slope / 2 * curvature, "brackets: `/ 2 * x` divides by 2, then multiplies by x; `/ (2 * x)` divides by both"),
        (slope / (4 * curvature), "the parabola's leading coefficient is half of l - 2c + r"),
        (slope / (2 * (left - middle + right)), "the middle sample counts twice: l - 2c + r"),
        (1 + offset, "that is measured from the left sample; the offset is from the middle one"),
    ]
    print(diagnose(answer, (left, middle, right), offset, mistakes))


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


def check_cosine_cost(answer: Answer) -> None:
    """05.1: the cost (1 - cos)/2 of two descriptions of any length."""
    rng = np.random.default_rng(5)
    f_i = rng.normal(0.3, 1, 64)
    f_j = 1.7 * f_i + rng.normal(0.2, 0.9, 64)
    dot, length_i, length_j = f_i @ f_j, np.linalg.norm(f_i), np.linalg.norm(f_j)
    cos = dot / (length_i * length_j)
    mistakes = [
        (cos, "that is the cosine, 1 for a match; the cost is (1 - cos)/2"),
        ((1 + cos) / 2, "the sign: a match must cost 0"),
        (1 - cos, "1 - cos runs from 0 to 2: divide by 2"),
        ((1 - dot) / 2, "divide the dot product by both lengths"),
        ((1 - dot / length_i) / 2, "divide by the second length, too"),
        ((1 - dot / length_j) / 2, "divide by the first length, too"),
        ((1 - dot / (length_i * length_j) ** 2) / 2, "divide by the lengths, not by their squares"),
        ((1 - np.corrcoef(f_i, f_j)[0, 1]) / 2, "that subtracts the means, as ZNCC does; the cosine does not"),
        (np.arccos(cos) / np.pi, "that is the angle by π; the cosine is asked"),
    ]
    print(diagnose(answer, (f_i, f_j), (1 - cos) / 2, mistakes))


def check_hinge_loss(answer: Answer) -> None:
    """05.2: the mean of max(0, margin + negative - positive) over the rays."""
    positive, negative = np.array([0.9, 0.7, 0.55, 0.95, 0.2]), np.array([0.1, 0.6, 0.85, 0.3, 0.15])
    margin = 0.2
    each = np.maximum(0, margin + negative - positive)
    mistakes = [
        (np.maximum(0, margin + positive - negative).mean(), "the roles: the match must score higher by the margin"),
        ((margin + negative - positive).mean(), "a ray that is right by more than the margin costs 0, not less"),
        (max(0.0, (margin + negative - positive).mean()), "the hinge is of each ray: take the maximum, then the mean"),
        (np.maximum(0, negative - positive).mean(), "the margin is missing"),
        (
            np.maximum(0, negative - positive - margin).mean(),
            "the margin is added: right by a hair is not enough",
        ),
        (each.sum(), "that is the sum; take the mean over the rays"),
        (each, "that is the loss of each ray: take the mean"),
        ((each**2).mean(), "the hinge is not squared"),
        (each[each > 0].mean(), "rays that cost nothing count in the mean as well"),
    ]
    print(diagnose(answer, (positive, negative, margin), each.mean(), mistakes))


def check_patch_size(answer: Answer) -> None:
    """05.3: side of the patch that `layers` convolutions of kernel × kernel see, one behind the other."""
    layers, kernel = 5, 7
    mistakes = [
        (
            layers * kernel,
            "neighbouring windows overlap: each layer adds kernel - 1 to what it starts from",
        ),
        (layers * (kernel - 1), "with no layer at all it is one pixel: add it"),
        (1 + layers * (kernel // 2), "the windows grow to both sides: each layer adds kernel - 1"),
        (kernel + layers - 1, "each layer adds kernel - 1 pixels, not one"),
        (kernel**layers, "sizes add up; they multiply with strides only"),
        (kernel, "that is what one layer sees"),
    ]
    print(diagnose(answer, (layers, kernel), 1 + layers * (kernel - 1), mistakes))


def check_sphere_labels(answer: Answer) -> None:
    """06.1: SweepNet's labels of sphere n: 0 where the true index rounds to n, 1 elsewhere."""
    gt_index, n = np.array([[2.4, 2.6, 3.0, 3.4], [3.6, 0.0, 4.0, 3.1]]), 3
    label = np.where(np.rint(gt_index) == n, 0.0, 1.0)
    mistakes = [
        (1 - label, "turned around: a match is 0, as every cost of a match is"),
        (np.where(np.floor(gt_index) == n, 0.0, 1.0), "round to the nearest sphere; cutting off is rounding down"),
        (np.where(np.ceil(gt_index) == n, 0.0, 1.0), "round to the nearest sphere, not up"),
        (np.where(gt_index == n, 0.0, 1.0), "the true index is no whole number: round it first"),
        (np.where(np.abs(gt_index - n) <= 1, 0.0, 1.0), "half a sphere to each side, not a whole one"),
        (np.abs(gt_index - n), "that is a distance; a label says yes or no"),
        (np.minimum(np.abs(np.rint(gt_index) - n), 1.0)[0], "the labels of all rays, not of the first row"),
    ]
    print(diagnose(answer, (gt_index, n), label, mistakes))


def check_balanced_loss(answer: Answer) -> None:
    """06.2: binary cross-entropy (Eq. 4) with as much weight on all positives as on all negatives."""
    cost = np.array([0.1, 0.4, 0.9, 0.7, 0.8, 0.95, 0.3])
    label = np.array([0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    match = label == 0
    positive, negative = -np.log(1 - cost[match]), -np.log(cost[~match])
    right = (positive.mean() + negative.mean()) / 2
    mistakes = [
        (np.concatenate([positive, negative]).mean(), "there are more negatives: the mean of each kind, then of both"),
        (positive.mean() + negative.mean(), "each kind weighs one half: divide the sum of both means by 2"),
        (-right, "the minus: logarithms of numbers below 1 are negative, a loss is not"),
        ((-np.log(cost[match]).mean() - np.log(1 - cost[~match]).mean()) / 2, "the cost is the probability of *no*"
         " match: label 0 takes log(1 - cost)"),
        (right / np.log(2), "that is with the logarithm to base 2; take the natural one"),
        (right / np.log(10), "that is with the logarithm to base 10; take the natural one"),
        (((cost[match] ** 2).mean() + ((1 - cost[~match]) ** 2).mean()) / 2, "that is the squared error; asked is the"
         " cross-entropy"),
        (negative.mean() / 2, "the positives are missing: label 0 takes log(1 - cost)"),
        (positive.mean() / 2, "the negatives are missing: label 1 takes log(cost)"),
    ]  # fmt: skip
    print(diagnose(answer, (cost, label), right, mistakes))


def check_receptive_field(answer: Answer) -> None:
    """06.3: side of the input that an output depends on, given (kernel, stride) of each layer in order."""
    layers = [(5, 2), (3, 1), (3, 1), (3, 2), (3, 1)]
    kernels, strides = np.array(layers).T
    before, after = np.concatenate([[1], np.cumprod(strides)[:-1]]), np.cumprod(strides)
    plain = 1 + np.sum(kernels - 1)
    right = 1 + np.sum((kernels - 1) * before)
    mistakes = [
        (plain, "behind a stride of 2 a pixel is two pixels of the input: each layer adds (kernel - 1) times the"
         " product of all strides before it"),
        (1 + np.sum((kernels - 1) * after), "a layer's own stride counts for those behind it, not for itself"),
        (1 + np.sum((kernels - 1) * strides), "strides multiply up: the product of all that came before"),
        (plain * after[-1], "a stride counts for the layers behind it only"),
        (right - 1, "with no layer at all it is one pixel: add it"),
        (kernels.sum(), "neighbouring windows overlap: each layer adds kernel - 1"),
    ]  # fmt: skip
    print(diagnose(answer, (layers,), float(right), mistakes))


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


def _ray(theta: float, phi: float) -> Array:
    return np.array([np.cos(phi) * np.sin(theta), np.sin(phi), np.cos(phi) * np.cos(theta)])


def _stopped(error: BaseException, arguments: int) -> str:
    if isinstance(error, TypeError) and error.__traceback__.tb_next is None:  # the call itself, nothing inside
        return f"your function is called with {arguments} arguments: keep its first line as it was ({error})"
    message = "".join(traceback.format_exception_only(error)).strip()
    return f"your function stopped with {message}. Call it with numbers of your own: Python then shows the line"


def _numbers(found: Any) -> Array | None:
    try:
        values = np.asarray(found.as_vector() if isinstance(found, Pose) else found)
    except Exception:  # parts of unequal shape, a tensor with a gradient, an object's own error
        return None
    return values.astype(np.float64) if values.dtype.kind in "iuf" else None  # no text, truth values, complex numbers


def _not_numbers(found: Any, right: Array) -> str:
    first = _numbers(found[0]) if isinstance(found, tuple) and found else None
    if first is not None and _same(first, right):
        return "not yet: the first thing that you return is right, return it alone"
    kind = type(found).__name__
    if isinstance(found, np.ndarray):
        kind = f"an array of {found.dtype}"
    elif isinstance(found, list | tuple):  # they are welcome, with numbers in them
        kind = f"a {kind} that is no array of numbers"
    return f"not yet: expected {_form(right)}, got {kind}. Return real numbers, and nothing beside them"


def _compare(found: Array, right: Array, mistakes: Mistakes) -> str:
    if _same(found, right):
        return "right"
    for value, hint in mistakes:
        if _same(found, value):
            return f"not yet: {hint}"
    if found.shape != right.shape:
        return f"not yet: expected {_form(right)}, got {_form(found)}. Look at the axes that you sum or stack over"
    if not np.isfinite(found).all():
        return "not yet: there are NaN or infinite values. Look for a division by zero, or NaN that is not left out"
    for factor, hint in _FACTORS:
        if _same(found, factor * right):
            return f"not yet: {hint}"
    worst = np.abs(found - right).max()
    return (
        f"not yet: off by up to {worst:.3g}, and no usual mistake explains it. Work out one value by hand and compare"
    )


def _same(found: Array, value: ArrayLike) -> bool:
    return found.shape == np.shape(value) and np.allclose(found, value, rtol=1e-4, atol=1e-6, equal_nan=True)


def _form(values: Array) -> str:
    return f"numbers of shape {values.shape}" if values.ndim else "one number"


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
