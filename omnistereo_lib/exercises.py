"""Checkers for the notebooks' exercises: they try an answer and say what is wrong with it, and what to try next.

A checker compares the answer with the right one and with what the usual mistakes would give. It prints its
finding and never raises, whatever it is handed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.camera import OcamCamera
from omnistereo_lib.metrics import error_map
from omnistereo_lib.pose import Pose
from omnistereo_lib.sphere import SphereGrid

Answer = Callable[..., Any]
Value = NDArray[np.float64] | float


def diagnose(answer: Answer, inputs: tuple, right: Value, mistakes: Mapping[str, Value]) -> str:
    """Call an answer and put into words how its value compares.

    Parameters
    ----------
    answer : callable
        What the student wrote.
    inputs : tuple
        Its arguments.
    right : array or float
    mistakes : mapping
        Hint → the value that the mistake behind it gives.

    Returns
    -------
    str
        "right", or what is wrong and the next thing to try.
    """
    try:
        found = answer(*inputs)
    except Exception as error:  # whatever a student's code raises is a finding
        return f"your function stopped with {type(error).__name__}: {error}. Call it yourself with the example above"
    if found is None or found is Ellipsis:
        return "nothing returned yet: replace the ... and return your result"
    try:
        found = np.asarray(found, np.float64)
    except (TypeError, ValueError):
        return f"expected numbers, got {type(found).__name__}: return an array or a float"
    right = np.asarray(right, np.float64)
    if found.shape != right.shape:
        return f"the shape is {found.shape}, expected {right.shape}: look at the axes that you sum or stack over"
    if np.allclose(found, right, rtol=1e-4, atol=1e-6, equal_nan=True):
        return "right"
    for hint, value in mistakes.items():
        if np.allclose(found, value, rtol=1e-4, atol=1e-6, equal_nan=True):
            return f"not yet: {hint}"
    if np.isnan(found).any() and not np.isnan(right).any():
        return "not yet: there are NaN values; look for 0/0, or for a mean over cells that no pair sees"
    worst = float(np.nanmax(np.abs(found - right)))
    return f"not yet: off by up to {worst:.3g}, and no usual mistake explains it. Print both for one value"


def check_index_to_depth(answer: Answer) -> None:
    """00.1: depth in metres of sphere index n, given N and D_min."""
    n, N, nearest = np.array([1.0, 10.0, 63.0]), 64, 1.65
    inverse = n / (nearest * (N - 1))
    mistakes = {
        "that is the inverse depth in 1/m; depth is one divided by it": inverse,
        "the spheres run from 0 to N - 1, so the last one has index N - 1: divide by N - 1, not by N": nearest * N / n,
        "the spheres are even in inverse depth, not in depth": nearest * n / (N - 1),
    }
    _report(answer, (n, N, nearest), 1 / inverse, mistakes)


def check_point_of_ray(answer: Answer) -> None:
    """03.1: the point at a distance along the ray of angles θ, φ in radians, rig frame."""
    theta, phi, depth = 0.7, 0.3, 4.0
    ray = _ray(theta, phi)
    mistakes = {
        "the angles come in radians, NumPy wants radians: no conversion is needed": depth
        * _ray(*np.radians([0.7, 0.3])),
        "that is the paper's printed ρ, whose panorama is turned by 90° and mirrored": depth
        * np.array([np.cos(phi) * np.cos(theta), np.sin(phi), np.cos(phi) * np.sin(theta)]),
        "y points down and φ is positive downwards: the second component is +sin φ": depth * ray * [1, -1, 1],
        "that is the unit ray; the point lies `depth` metres along it": ray,
        "that is divided by the depth: multiply": ray / depth,
    }
    _report(answer, (theta, phi, depth), depth * ray, mistakes)


def check_pixel_of_point(answer: Answer) -> None:
    """03.2: the pixel at which a camera sees a point that is given in the rig frame."""
    camera = OcamCamera([-200.0, 0.0, 1e-3], [314.159, 200.0], (400.0, 380.0), (1.0, 0.0, 0.0), (800, 768))
    T_rig_cam = Pose.from_vector([0.1, 0.9, -0.2, 0.3, -0.1, 0.5])
    point = np.array([2.0, 0.4, 1.5])
    back = T_rig_cam.inverse()
    mistakes = {
        "T_rig_cam takes camera coordinates to the rig; the point goes the other way: use its inverse": camera.project(
            T_rig_cam @ point
        )[0],
        "the rotation is inverted, the translation is not: the inverse's translation is -Rᵀt": camera.project(
            T_rig_cam.R.T @ point - T_rig_cam.t
        )[0],
        "pixels are (u, v): right first, then down; yours are swapped": camera.project(back @ point)[0][::-1],
        "the point is used as if it were in the camera frame: transform it first": camera.project(point)[0],
    }
    _report(answer, (camera, T_rig_cam, point), camera.project(back @ point)[0], mistakes)


def check_rotation_error(answer: Answer) -> None:
    """03.3: how many pixels of a panorama W wide a yaw error in degrees moves a far point."""
    yaw, width = 0.5, 320
    right = yaw / 360 * width
    mistakes = {
        "the error comes in degrees, and 360 of them make the full width": yaw / (2 * np.pi) * width,
        "the panorama spans 360°, not 180°": yaw / 180 * width,
        "that is the number of degrees in a pixel; it is asked the other way round": 360 / width,
    }
    _report(answer, (yaw, width), right, mistakes)


def check_zncc_cost(answer: Answer) -> None:
    """04.1: the matching cost (1 - ZNCC)/2 of two patches."""
    rng = np.random.default_rng(4)
    a = rng.normal(3, 2, (9, 9))
    b = 0.4 * a + rng.normal(1, 0.5, (9, 9))
    centred_a, centred_b = a - a.mean(), b - b.mean()
    zncc = (centred_a * centred_b).mean() / (a.std() * b.std())
    ncc = (a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum())
    mistakes = {
        "that is ZNCC itself, 1 for a match; the cost is (1 - ZNCC)/2": zncc,
        "the sign: a match must cost 0": (1 + zncc) / 2,
        "1 - ZNCC runs from 0 to 2: divide by 2": 1 - zncc,
        "subtract each patch's mean first (the Z of ZNCC)": (1 - ncc) / 2,
        "the covariance is divided by both standard deviations (the N of ZNCC)": (1 - (centred_a * centred_b).mean())
        / 2,
        "use the same divisor for the covariance and the deviations: n or n - 1, not both": (1 - zncc * 80 / 81) / 2,
        "sum and mean are mixed: take the mean of the products": (1 - 81 * zncc) / 2,
    }
    _report(answer, (a, b), (1 - zncc) / 2, mistakes)


def check_mean_over_pairs(answer: Answer) -> None:
    """04.2: the mean cost over the pairs that see a ray (Eq. 2); NaN marks a pair that does not."""
    costs = np.array([[0.2, np.nan, 0.4, 0.6], [np.nan, np.nan, 0.1, np.nan]]).T
    right = np.array([0.4, 0.1])
    mistakes = {
        "one pair that does not see the ray must not spoil the others: leave the NaN out": costs.mean(0),
        "a pair that does not see the ray says nothing; a 0 says 'perfect match'": np.nan_to_num(costs).mean(0),
        "divide by the number of pairs that see the ray, not by all pairs": np.nansum(costs, 0) / len(costs),
        "that is the mean over the rays: average over the pairs, the first axis": np.array([0.2, 0.25]),
        "that is the sum; the paper takes the mean": np.nansum(costs, 0),
    }
    _report(answer, (costs,), right, mistakes)


def check_pixels_per_index(answer: Answer) -> None:
    """04.3: how far a match moves between two neighbouring spheres, in panorama pixels (small angles)."""
    baseline, nearest, N, width = 0.6, 1.65, 64, 320
    step = 1 / (nearest * (N - 1))
    right = baseline * step * width / (2 * np.pi)
    mistakes = {
        "that is the angle in radians: turn it into pixels, W of them in 2π": baseline * step,
        "the panorama has W pixels in 2π, not in 360": baseline * step * width / 360,
        "the step between inverse depths is 1/(D_min (N - 1))": baseline / (nearest * N) * width / (2 * np.pi),
        "that is the whole range, from infinity to D_min": baseline / nearest * width / (2 * np.pi),
    }
    _report(answer, (baseline, nearest, N, width), right, mistakes)


def check_sgm_step(answer: Answer) -> None:
    """07.1: one step of SGM's recurrence along a path."""
    rng = np.random.default_rng(7)
    cost, before = rng.random(12), 3 * rng.random(12)
    p1, p2 = 0.1, 0.6

    def step(p1: float, p2: float, subtract: bool = True, best: float | None = None) -> NDArray[np.float64]:
        lowest = before.min() if best is None else best
        left = np.append(np.inf, before[:-1]) + p1
        right = np.append(before[1:], np.inf) + p1
        return cost + np.minimum.reduce([before, left, right, np.full(12, lowest + p2)]) - subtract * before.min()

    around = np.minimum.reduce(
        [before, np.roll(before, 1) + p1, np.roll(before, -1) + p1, np.full(12, before.min() + p2)]
    )
    mistakes = {
        "subtract min_k L(p - r, k) at the end, or the sums grow along the path": step(p1, p2, subtract=False),
        "P1 is for a step of one sphere, P2 for a jump: they are swapped": step(p2, p1),
        "the neighbours n ± 1 do not wrap around: sphere 0 has no left neighbour": cost + around - before.min(),
        "the jump is from the best sphere of the pixel before, min_k L(p - r, k), plus P2": step(p1, p2, best=0.0),
        "that is the cost alone; add the cheapest way to arrive": cost,
    }
    _report(answer, (cost, before, p1, p2), step(p1, p2), mistakes)


def check_parabola(answer: Answer) -> None:
    """07.2: the offset of a parabola's vertex from its middle sample."""
    left, middle, right = 0.5, 0.2, 0.3
    offset = (left - right) / (2 * (left - 2 * middle + right))
    mistakes = {
        "the sign: the vertex lies towards the cheaper neighbour": -offset,
        "the curvature is divided by twice": offset * 2,
        "that is off by a factor of 2: the vertex is at (l - r)/(2 (l - 2c + r))": offset / 2,
    }
    _report(answer, (left, middle, right), offset, mistakes)


def check_index_error(answer: Answer) -> None:
    """07.3: mean absolute error in percent of the range swept (Eq. 5)."""
    index, truth, N = np.array([3.0, 50.0, 20.0, np.nan]), np.array([3.4, 48.0, 21.7, 5.0]), 64
    grid = SphereGrid(8, 4, num_spheres=N)
    error = error_map(index, truth, N)[:3]
    depth_error = np.abs(grid.index_to_depth(index) - grid.index_to_depth(truth))[:3]
    mistakes = {
        "the error is in percent of the N spheres: multiply by 100/N": np.abs(index - truth)[:3].mean(),
        "the ground truth is not rounded in the evaluation": error_map(index, np.rint(truth), N)[:3].mean(),
        "compare indices, not depths: an error of a metre means little far away": depth_error.mean(),
        "rays without an estimate (NaN) are left out of this mean": np.nan,
        "that is the root mean square; the MAE is the mean of the absolute values": np.sqrt((error**2).mean()),
        "take the absolute value before the mean": (100 / N * (index - truth))[:3].mean(),
    }
    _report(answer, (index, truth, N), error.mean(), mistakes)


def _ray(theta: float, phi: float) -> NDArray[np.float64]:
    return np.array([np.cos(phi) * np.sin(theta), np.sin(phi), np.cos(phi) * np.cos(theta)])


def _report(answer: Answer, inputs: tuple, right: Value, mistakes: Mapping[str, Value]) -> None:
    print(diagnose(answer, inputs, right, mistakes))
