"""Checkers of notebooks 02 and 03 that ask for functions on arrays, each beside its usual mistakes."""

from __future__ import annotations

from functools import partial

import numpy as np

from course.exercises.compare import Array, Case, Rng, by, checker
from omnistereo_lib.geometry.pose import Pose


def _matrices(rng: Rng, number: int) -> Array:
    poses = [Pose.from_vector(rng.uniform(-1, 1, 6)) for _ in range(number)]
    return np.array([np.vstack([np.column_stack([T.R, T.t]), [0, 0, 0, 1]]) for T in poses])


@checker
def check_chain_of_poses(rng: Rng, k: int) -> Case:
    """02.3: camera 0 → camera k for all cameras, (K + 1, 4, 4), from the poses from each camera to the next."""
    steps = _matrices(rng, 3 + k % 4)  # four cameras, and more

    def chain(steps: Array) -> Array:
        poses = [np.eye(4)]
        for T in steps:
            poses.append(T @ poses[-1])
        return np.array(poses)

    def other_way(steps: Array) -> Array:
        poses = [np.eye(4)]
        for T in steps:
            poses.append(poses[-1] @ T)
        return np.array(poses)

    def by_parts(steps: Array) -> Array:
        poses = chain(steps)
        poses[1:, :3, 3] = np.cumsum(steps[:, :3, 3], axis=0)
        return poses

    wrong = [
        (other_way, "read from the right: the pose so far is applied first, so the next step stands on its left"),
        (lambda s: np.linalg.inv(chain(s)), "inverse poses: yours take camera k to camera 0"),
        (lambda s: chain(np.linalg.inv(s)), "do not invert the steps: they lead from each camera to the next already"),
        (lambda s: chain(s)[1:], "camera 0 → camera 0 belongs to it: the identity comes first"),
        (lambda s: chain(s)[:-1], "the last camera is missing: K steps lead to K + 1 cameras"),
        (lambda s: chain(s)[-1], "that is the last pose alone; all are asked"),
        (
            lambda s: np.concatenate([np.eye(4)[None], s]),
            "those are the steps: each pose is the product of all before it",
        ),
        (
            lambda s: np.cumprod(np.concatenate([np.ones((1, 4, 4)), s]), axis=0),
            "`*` multiplies number by number; poses want `@`",
        ),
        (
            lambda s: np.concatenate([np.eye(4)[None], np.cumprod(s, axis=0)]),
            "`*` multiplies number by number; poses want `@`",
        ),
        (by_parts, "translations do not add up: each step turns what came before"),
        (lambda s: chain(s.swapaxes(1, 2)), "the matrices are transposed: a point is a column, right of the matrix"),
        (lambda s: chain(s).swapaxes(1, 2), "the matrices are transposed: a point is a column, right of the matrix"),
    ]
    return by((steps,), chain, wrong)


def _residuals(
    T: Array, board: Array, corners: Array, F: float, center: Array, *, bend: np.ufunc | None = None
) -> Array:
    """Distances (K, P), or vectors, of projected from found corners; `bend` makes another lens of r = F θ."""
    points = np.einsum("kij,pj->kpi", T[:, :3, :3], board) + T[:, None, :3, 3]
    n = np.hypot(points[..., 0], points[..., 1])
    theta = np.arctan2(n, points[..., 2])
    r = F * (bend(theta) if bend else theta)
    return points[..., :2] * (r / n)[..., None] + center - corners


@checker
def check_view_rms(rng: Rng, k: int) -> Case:
    """02.5: rms distance in pixels of the found corners of each view, (K,), for an equidistant lens r = F θ."""
    columns, rows, views = 3 + k % 2, 3, 2 + k % 4
    board = 0.1 * np.stack([*np.meshgrid(np.arange(columns), np.arange(rows)), np.zeros((rows, columns))], -1)
    board = board.reshape(-1, 3)
    T = _matrices(rng, views)
    T[:, :3, 3] = rng.uniform([-1, -0.8, 0.4], [1, 0.8, 1.2], (views, 3))
    F, center = rng.uniform(150, 250), rng.uniform(350, 420, 2)
    corners = _residuals(T, board, np.zeros(2), F, center)
    corners += rng.normal(0, 0.4, corners.shape) * rng.uniform(0.5, 2, (views, 1, 1))
    corners[0, :2] = corners[-1, 3] = np.nan

    def distance(*inputs: Array, **lens: np.ufunc) -> Array:
        return np.linalg.norm(_residuals(*inputs, **lens), axis=-1)

    def right(*inputs: Array, **lens: np.ufunc) -> Array:
        return np.sqrt(np.nanmean(distance(*inputs, **lens) ** 2, axis=1))

    def rotated_only(T: Array, *rest: Array) -> Array:
        T = T.copy()
        T[:, :3, 3] = 0
        return right(T, *rest)

    wrong = [
        (
            lambda T, *rest: right(np.linalg.inv(T), *rest),
            "inverse pose: T_cam_board takes the board to the camera already",
        ),
        (rotated_only, "the translation is missing"),
        (lambda T, *rest: right(np.swapaxes(T, 1, 2), *rest), "the rotation is transposed"),
        (partial(right, bend=np.tan), "that is a pinhole, r = F tan θ; this lens has r = F θ"),
        (partial(right, bend=np.sin), "that is r = F sin θ; this lens has r = F θ"),
        (partial(right, bend=np.degrees), "θ is in radians in r = F θ"),
        (lambda T, b, c, F, m: right(T, b, c[..., ::-1], F, m), "u and v swapped"),
        (lambda T, b, c, F, m: right(T, b, c, F, m[::-1]), "the centre is (u0, v0): its parts are swapped"),
        (lambda T, b, c, F, m: right(T, b, c, F, 0 * m), "pixels do not count from the centre: add it"),
        (lambda T, b, c, F, m: right(T, b, c, F, m + 0.5), "half a pixel off: whole numbers are pixel centres"),
        (lambda *a: np.nanmean(distance(*a), axis=1), "that is the mean distance: square before you take the mean"),
        (lambda *a: right(*a) ** 2, "take the root"),
        (
            lambda *a: np.sqrt(np.nanmean(_residuals(*a) ** 2, axis=(1, 2))),
            "that is the rms of u and v; the rms distance is √2 more",
        ),
        (lambda *a: np.sqrt(np.nansum(distance(*a) ** 2, axis=1)), "the mean of the squares, not their sum"),
        (lambda *a: np.sqrt(np.nanmean(distance(*a) ** 2)), "that is one number for all views; each has its own"),
        (
            lambda *a: np.sqrt(np.nanmean(distance(*a) ** 2, axis=0)),
            "the mean over the wrong axis: over the corners of a view",
        ),
        (lambda *a: np.sqrt(np.mean(distance(*a) ** 2, axis=1)), "a corner that was not found is NaN: leave it out"),
        (
            lambda *a: np.sqrt(np.nan_to_num(distance(*a) ** 2).mean(1)),
            "a corner that was not found is no error of 0, and none of those to divide by",
        ),
        (distance, "those are the distances of all corners; take the rms of each view"),
    ]
    return by((T, board, corners, F, center), right, wrong)
