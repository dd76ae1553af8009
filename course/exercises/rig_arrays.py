"""Checkers of notebooks 02 and 03 that ask for functions on arrays, each beside its usual mistakes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
        (lambda s: np.concatenate([np.eye(4)[None], s]), "those are the steps: each pose is the product of all before"
         " it"),
        (lambda s: np.cumprod(np.concatenate([np.ones((1, 4, 4)), s]), axis=0), "`*` multiplies number by number;"
         " poses want `@`"),
        (lambda s: np.concatenate([np.eye(4)[None], np.cumprod(s, axis=0)]), "`*` multiplies number by number; poses"
         " want `@`"),
        (by_parts, "translations do not add up: each step turns what came before"),
        (lambda s: chain(s.swapaxes(1, 2)), "the matrices are transposed: a point is a column, right of the matrix"),
        (lambda s: chain(s).swapaxes(1, 2), "the matrices are transposed: a point is a column, right of the matrix"),
    ]  # fmt: skip
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
        (lambda T, *rest: right(np.linalg.inv(T), *rest), "inverse pose: T_cam_board takes the board to the camera"
         " already"),
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
        (lambda *a: np.sqrt(np.nanmean(_residuals(*a) ** 2, axis=(1, 2))), "that is the rms of u and v; the rms"
         " distance is √2 more"),
        (lambda *a: np.sqrt(np.nansum(distance(*a) ** 2, axis=1)), "the mean of the squares, not their sum"),
        (lambda *a: np.sqrt(np.nanmean(distance(*a) ** 2)), "that is one number for all views; each has its own"),
        (lambda *a: np.sqrt(np.nanmean(distance(*a) ** 2, axis=0)), "the mean over the wrong axis: over the corners"
         " of a view"),
        (lambda *a: np.sqrt(np.mean(distance(*a) ** 2, axis=1)), "a corner that was not found is NaN: leave it out"),
        (lambda *a: np.sqrt(np.nan_to_num(distance(*a) ** 2).mean(1)), "a corner that was not found is no error of 0,"
         " and none of those to divide by"),
        (distance, "those are the distances of all corners; take the rms of each view"),
    ]  # fmt: skip
    return by((T, board, corners, F, center), right, wrong)


def _panorama_pixels(points: Array, W: int, H: int, phi_deg: Sequence[float], *, half: float = 0.5) -> Array:
    """Panorama pixels (…, 2) of points (…, 3), NaN outside the rows."""
    low, high = np.radians(phi_deg)
    x, y, z = np.moveaxis(points, -1, 0)
    theta, phi = np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))
    column, row = (theta + np.pi) / (2 * np.pi) * W - half, (phi - low) / (high - low) * H - half
    inside = (phi >= low) & (phi <= high)
    return np.where(inside[..., None], np.stack([column, row], -1), np.nan)


@checker
def check_panorama_pixels(rng: Rng, k: int) -> Case:
    """03.4: (column, row) of points in a panorama W × H from phi_deg[0] to phi_deg[1]; NaN above and below it."""
    W, H = int(rng.integers(100, 1300)), int(rng.integers(30, 300))
    phi_deg = (-float(rng.integers(30, 50)), float(rng.integers(20, 29)))
    points = rng.normal(0, 1, (3, 6 + k % 3, 3)) * [2, 0.5, 2]
    points[0, 0], points[0, 1], points[0, 2] = (0.1, 3, 0.2), (-0.01, 0.05, -2), (0.01, 0.05, -2)
    right = _panorama_pixels

    def scaled(points: Array, W: int, H: int, phi_deg: Sequence[float]) -> Array:
        """Rows from φ = arcsin(y), columns right."""
        pixels, y = right(points, W, H, phi_deg), points[..., 1]
        row = (np.arcsin(y) - np.radians(phi_deg[0])) / np.radians(phi_deg[1] - phi_deg[0]) * H - 0.5
        inside = np.abs(np.degrees(np.arcsin(y)) - np.mean(phi_deg)) <= np.ptp(phi_deg) / 2
        return np.where(inside[..., None], np.stack([pixels[..., 0], row], -1), np.nan)

    def from_zero(points: Array, W: int, *rest: Sequence[float]) -> Array:
        pixels = right(points, W, *rest)
        pixels[..., 0] = (pixels[..., 0] + 0.5 - W / 2) % W - 0.5
        return pixels

    def unbounded(points: Array, W: int, H: int, phi_deg: Sequence[float]) -> Array:
        return right(points, W, H * 180 / np.ptp(phi_deg), (-90, 90)) - [0, (phi_deg[0] + 90) / np.ptp(phi_deg) * H]

    def modulo(points: Array, W: int, *rest: Sequence[float]) -> Array:
        return right(points, W, *rest) % [W, np.inf]

    wrong = [
        (modulo, "columns run from -0.5 to W - 0.5: modulo W puts the left half of the first one at the far end"),
        (partial(right, half=0.0), "half a pixel off: the first column has its centre at 0, its left edge at -0.5"),
        (partial(right, half=-0.5), "half a pixel off, to the wrong side: subtract it"),
        (lambda *a: right(*a)[..., ::-1], "column first, then row: they are swapped"),
        (lambda p, *a: right(p * [-1, 1, 1], *a), "θ mirrored: it grows to the right, with x"),
        (lambda p, *a: right(p * [1, -1, 1], *a), "y points down, and so do the rows: do not change its sign"),
        (lambda p, *a: right(p[..., [2, 1, 0]], *a), "θ counts from z, forward: atan2(x, z), not atan2(z, x)"),
        (lambda p, *a: right(p[..., [1, 0, 2]], *a), "θ goes around with x, φ goes down with y: they are swapped"),
        (lambda p, W, H, phi: right(p, W - 1, H, phi), "W columns make the full circle, not W - 1"),
        (lambda p, W, H, phi: right(p, W, H - 1, phi), "H rows make the height, not H - 1: the edges of the first and"
         " the last row are at its ends"),
        (lambda p, W, H, phi: right(p, H, W, phi), "W and H are swapped"),
        (from_zero, "the seam is behind, at ±180°: θ = 0, forward, lies in the middle"),
        (scaled, "a point has any length: φ is atan2(y, hypot(x, z)), not arcsin(y)"),
        (unbounded, "a point above or below the panorama has no pixel: NaN for both parts"),
        (lambda *a: np.nan_to_num(right(*a)), "a point above or below the panorama has no pixel: NaN, not 0"),
        (lambda *a: np.rint(right(*a)), "index rounded: a point falls between pixels"),
        (lambda *a: np.floor(right(*a)), "index cut off: a point falls between pixels"),
    ]  # fmt: skip
    return by((points, W, H, phi_deg), right, wrong)


def _sample(
    panorama: Array, pixels: Array, *, wrap: bool = True, mix: Callable[[float, float], tuple] = lambda a, b: (a, b)
) -> Array:
    """Values at pixels (K, 2) one by one; `mix` changes the weights of the neighbours to the right and below."""
    H, W = panorama.shape
    values = []
    for column, row in pixels:
        x, y = np.floor([column, row]).astype(int)
        a, b = mix(column - x, row - y)
        xs = np.arange(x, x + 2) % W if wrap else np.clip(np.arange(x, x + 2), 0, W - 1)
        corners = panorama[np.ix_(np.clip(np.arange(y, y + 2), 0, H - 1), xs)].astype(np.float64)
        values.append([1 - b, b] @ corners @ [1 - a, a] if 0 <= row <= H - 1 else np.nan)
    return np.array(values)


@checker
def check_panorama_sample(rng: Rng, k: int) -> Case:
    """03.5: values (K,) of a panorama between its pixels (column, row), around the seam; NaN above and below."""
    H, W = 5 + k % 3, 8 + k % 4
    panorama = rng.uniform(0, 255, (H, W)).astype([np.float64, np.uint8, np.float32][k % 3])
    pixels = rng.uniform([0, 0], [W - 1, H - 1], (12, 2))
    pixels[:3, 0] = W - 0.7, -0.3, W - 0.9  # at the seam
    pixels[3:5, 1] = 0, H - 1  # the first and the last row belong to the panorama
    pixels[5:7, 1] = -0.3, H - 0.7
    right = _sample

    def clamped(panorama: Array, pixels: Array) -> Array:
        return right(panorama, np.stack([pixels[:, 0], np.clip(pixels[:, 1], 0, len(panorama) - 1)], 1))

    def seamless(panorama: Array, pixels: Array) -> Array:
        seam = (pixels[:, 0] < 0) | (pixels[:, 0] > panorama.shape[1] - 1)
        return np.where(seam, np.nan, right(panorama, pixels))

    wrong = [
        (partial(right, wrap=False), "around the seam the first column follows the last one: take columns modulo W"),
        (seamless, "the panorama does not end at the seam: the first column follows the last one"),
        (partial(right, mix=lambda a, b: (round(a), round(b))), "index rounded: mix the four neighbours by distance"),
        (partial(right, mix=lambda a, b: (0, 0)), "index cut off: mix the four neighbours by their distance"),
        (partial(right, mix=lambda a, b: (a, 0)), "that mixes left and right only: above and below count, too"),
        (partial(right, mix=lambda a, b: (0, b)), "that mixes above and below only: left and right count, too"),
        (partial(right, mix=lambda a, b: (1 - a, 1 - b)), "the weights are swapped: the nearer neighbour counts more"),
        (partial(right, mix=lambda a, b: (b, a)), "the two fractions are swapped: the column's mixes left and right"),
        (lambda p, xy: right(p, xy[:, ::-1]), "a pixel is (column, row), an array's index [row, column]"),
        (clamped, "above the first row and below the last one there is nothing: NaN"),
        (lambda p, xy: np.nan_to_num(right(p, xy)), "above the first row and below the last one there is nothing:"
         " NaN, not 0"),
        (lambda p, xy: np.where((xy[:, 1] <= 0) | (xy[:, 1] >= len(p) - 1), np.nan, right(p, xy)), "the first and the"
         " last row belong to the panorama: a pixel exactly on them has a value"),
        (lambda p, xy: np.where(xy[:, 1] >= len(p) - 1, np.nan, right(p, xy)), "the last row belongs to the panorama:"
         " a pixel exactly on it has a value"),
        (lambda p, xy: np.rint(right(p, xy)), "a mean of gray values is no whole number: compute with floats"),
        (lambda p, xy: np.floor(right(p, xy)), "a mean of gray values is no whole number: compute with floats"),
        (lambda p, xy: np.roll(right(p, xy), 1), "the values are in another order than the pixels"),
    ]  # fmt: skip
    return by((panorama, pixels), right, wrong)
