"""Checkers of notebooks 00 to 03: lens, rig, spheres."""

from __future__ import annotations

import numpy as np

from course.exercises.compare import Array, Case, Rng, _ray, checker
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose


@checker
def check_index_to_depth(rng: Rng, k: int) -> Case:
    """00.1: depth in metres of sphere index n, given N and D_min."""
    n, N, nearest = int(rng.integers(3, 20)), int(rng.integers(50, 200)), rng.uniform(0.4, 0.9)
    depth = nearest * (N - 1) / n
    mistakes = [
        (1 / depth, "that is the inverse depth in 1/m; the depth is one divided by it"),
        (nearest * N / n, "the spheres run from 0 to N - 1: it is N - 1 steps from infinity to D_min, not N"),
        (nearest * N / (n + 1), "the spheres count from 0, which is at infinity: n, not n + 1"),
        (nearest * (N - 1) / (N - 1 - n), "sphere 0 is the one at infinity, sphere N - 1 the nearest: turn n around"),
        (nearest * n / (N - 1), "the spheres are even in inverse depth, not in depth"),
        ((N - 1) / n, "that is in units of the nearest depth; metres are asked"),
    ]
    return (n, N, nearest), depth, mistakes


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


@checker
def check_point_of_ray(rng: Rng, k: int) -> Case:
    """03.1: the point at a distance along the ray of angles θ, φ in radians, rig frame."""
    theta, phi, depth = rng.uniform(0.5, 1.2) + 3 * (k % 2), rng.uniform(0.2, 0.5), rng.uniform(2, 8)
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
    return (theta, phi, depth), depth * ray, mistakes


@checker
def check_pixel_of_point(rng: Rng, k: int) -> Case:
    """03.2: the pixel (u, v) at which a camera sees a point that is given in the rig frame."""
    camera = OcamCamera([-200.0, 0.0, 1e-3], [314.159, 200.0], (400.0, 380.0), (1.0, 0.0, 0.0), (800, 768))
    T_rig_cam = Pose.from_vector([0.1, 0.9, -0.2, 0.3, -0.1, 0.5] * rng.uniform(0.7, 1.3, 6))
    R, t = T_rig_cam.R, T_rig_cam.t
    point = rng.uniform(0.8, 2.5, 3)

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
    return (camera, T_rig_cam, point), pixel, mistakes


@checker
def check_rotation_error(rng: Rng, k: int) -> Case:
    """03.3: how many pixels of a panorama W wide a yaw error in degrees moves a far point."""
    yaw, width = rng.uniform(0.2, 0.9), int(rng.integers(200, 1300))
    mistakes = [
        (yaw / (2 * np.pi) * width, "the error is in degrees, and 360 of them, not 2π, make the full width"),
        (yaw / 180 * width, "the panorama spans 360°, not 180°"),
        (yaw / 360 * (width - 1), "W columns make the full circle, not W - 1"),
        (width / 360, "that is the number of pixels in one degree: multiply by the error"),
        (360 / width, "that is the number of degrees in a pixel; pixels are asked"),
        (yaw * 360 / width, "360 and the width are swapped: W pixels make 360°"),
    ]
    return (yaw, width), yaw / 360 * width, mistakes
