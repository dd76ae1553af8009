"""Checkers of notebooks 00 to 03: lens, rig, spheres."""

from __future__ import annotations

import numpy as np

from course.exercises.compare import Array, Case, Rng, checker
from omnistereo_lib.geometry.pose import Pose


@checker
def check_ray_of_pixel(rng: Rng, k: int) -> Case:
    """01.1: the unit ray of a pixel, given u, v, the direct polynomial (low to high) and the centre (u0, v0)."""
    u, v, center = *rng.uniform(450, 700, 2), rng.uniform(350, 420, 2)
    poly = np.array([-196.0, 0.0, 1.6e-3, -1e-7]) * rng.uniform(0.8, 1.2, 4)

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
    return (u, v, poly, center), right, mistakes


@checker
def check_angle_from_axis(rng: Rng, k: int) -> Case:
    """01.2: the angle from the optical axis, in degrees, of a ray given as (x, y, z)."""
    ray = np.array([0.8, 0.3, -0.4]) * rng.uniform(0.5, 1.2, 3) * (1, rng.choice([-1, 1]), 1 if k < 5 else -1)
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
    return (ray,), np.degrees(theta), mistakes


@checker
def check_rms_per_component(rng: Rng, k: int) -> Case:
    """01.3: the root mean square over all u and v of residuals, shape (K, 2)."""
    residuals = rng.normal(0.05, 0.2, (rng.integers(30, 50), 2))
    squares = np.sum(residuals**2, axis=1)
    mistakes = [
        (np.sqrt(squares.mean()), "that is the rms distance, √2 more: take the mean over u and v both"),
        (np.sqrt(squares).mean(), "that is the mean distance; return the root of the mean square"),
        (np.mean(residuals**2), "take the root of the mean square"),
        (np.abs(residuals).mean(), "that is the mean magnitude; return the root of the mean square"),
        (residuals.std(), "that subtracts the mean first: a bias is an error, too"),
        (np.sqrt(np.sum(residuals**2)), "the mean of the squares, not their sum"),
    ]
    return (residuals,), np.sqrt(np.mean(residuals**2)), mistakes


@checker
def check_relative_pose(rng: Rng, k: int) -> Case:
    """02.1: T_2_1, camera 1 → camera 2, of two cameras that see one board at T_1_board and T_2_board."""
    T_1_board, T_2_board = map(Pose.from_vector, rng.uniform(-1, 1, (2, 6)))
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
    return (T_1_board, T_2_board), right, [(T.as_vector(), hint) for T, hint in mistakes]


@checker
def check_count_unknowns(rng: Rng, k: int) -> Case:
    """02.2: unknowns of the joint adjustment, given cameras, captures and the degree M of the polynomials."""
    cameras, captures, degree = (int(rng.integers(*limits)) for limits in ((3, 9), (20, 60), (3, 9)))
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
    return (cameras, captures, degree), lenses + poses, mistakes


@checker
def check_depth_error(rng: Rng, k: int) -> Case:
    """02.4: metres of depth that one sphere more or less makes, to first order, given depth, N and D_min."""
    depth, N, nearest = rng.uniform(4, 12), int(rng.integers(60, 200)), rng.uniform(0.4, 0.9)
    step = 1 / (nearest * (N - 1))
    mistakes = [
        (depth * step, "inverse depth is 1/ρ: its derivative is -1/ρ², so the depth enters squared"),
        (step, "that is one step in inverse depth, 1/m; in metres it grows with ρ²"),
        (depth**2 / (nearest * N), "N - 1 steps lead from infinity to D_min, not N"),
        (nearest / (N - 1), "the spheres are even in inverse depth, not in depth"),
        (1 / step, "that is 1 over the step in inverse depth: the depth of sphere 1"),
        (1 / (1 / depth - step) - depth, "that is the exact difference one sphere further out; return ρ² times the"
         " step, its limit for small steps"),
        (depth - 1 / (1 / depth + step), "that is the exact difference one sphere nearer; return ρ² times the step,"
         " its limit for small steps"),
    ]  # fmt: skip
    return (depth, N, nearest), depth**2 * step, mistakes
