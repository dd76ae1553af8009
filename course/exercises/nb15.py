"""Notebook 15: a panorama without seams, the two best views of a ray, a choice among methods, a
mesh."""

import numpy as np

from course.exercises.compare import Rng
from course.exercises.opened import Open


def blend(images, angles, half_fov):
    """Mean (H, W, 3) of images (cameras, H, W, 3), weighted by how far inside its view each camera
    sees the ray."""
    seen = np.isfinite(images[..., 0])
    weights = np.where(seen, half_fov - angles, 0)[..., None]
    with np.errstate(invalid="ignore"):  # nobody sees the ray: 0/0 is NaN
        return np.sum(weights * np.nan_to_num(images), axis=0) / weights.sum(axis=0)


def _some_views(rng: Rng, k: int) -> tuple:
    images, angles = (
        rng.uniform(0, 255, (4, 3, 6 + k % 3, 3)),
        rng.uniform(0.1, 1.8, (4, 3, 6 + k % 3)),
    )
    images[rng.uniform(0, 1, angles.shape) < 0.3] = np.nan
    # rays that no camera sees, and one does
    images[:, 0, 0], images[1:, 0, 1], images[0, 0, 1] = (np.nan, np.nan, 90)
    return images, angles, 1.9


check_blend = Open(blend, _some_views).with_slips("""
    half_fov - angles → angles  # the weight falls with the angle: half_fov - angle
    / weights.sum(axis=0) →  # divide by the sum of the weights
    half_fov - angles → 1.0 * (angles == np.where(seen, angles, np.inf).min(axis=0))
    # that is the nearest camera alone, which jumps where another takes over: mix all
""")


def two_best(samples, angles):
    """Grey values (2, H, W) of the two cameras that see a ray nearest their axes, in camera order;
    NaN if unseen."""
    angles = np.where(np.isnan(samples), np.inf, angles)
    best = np.sort(np.argsort(angles, axis=0)[:2], axis=0)
    return np.take_along_axis(samples, best, axis=0)


def _some_samples(rng: Rng, k: int) -> tuple:
    samples, angles = rng.normal(0, 1, (4, 3, 7 + k % 3)), rng.uniform(0, 1.9, (4, 3, 7 + k % 3))
    samples[rng.uniform(0, 1, samples.shape) < 0.3] = np.nan
    samples[:, 0, 0] = samples[1:, 0, 1] = np.nan
    return samples, angles


check_two_best = Open(two_best, _some_samples).with_slips("""
    np.sort(np.argsort(angles, axis=0)[:2], axis=0) → np.argsort(angles, axis=0)[:2]
    # in camera order: sort their numbers, or a window mixes two cameras where the nearer one
    # changes
    angles = np.where(np.isnan(samples), np.inf, angles) →
    # a camera that does not see the ray is NaN, however small its angle: leave it out
    axis=0)[:2] → axis=0)[-2:]
    # the two smallest angles are the nearest; unseen, with infinity, comes last
    np.take_along_axis(samples, best, axis=0) → best
    # those are the cameras' numbers: look their grey values up
    return np.take_along_axis(samples, best, axis=0)
    → return np.sort(np.take_along_axis(samples, best, axis=0), axis=0)
    # sort the numbers of the cameras, not their grey values
""")


def pick(index, score):
    """Index (H, W) of the method with the highest score at each ray, of (methods, H, W); a score of
    NaN never wins."""
    best = np.argmax(np.where(np.isnan(score), -np.inf, score), axis=0)
    return np.take_along_axis(index, best[None], axis=0)[0]


def _some_methods(rng: Rng, k: int) -> tuple:
    index, score = (
        rng.uniform(0, 95, (2 + k % 3, 4, 6 + k % 4)),
        rng.uniform(-1, 1, (2 + k % 3, 4, 6 + k % 4)),
    )
    score[0, :2, 0], score[-1, 1, 2:4] = np.nan, np.nan
    return index, score


check_pick = Open(pick, _some_methods).with_slips("""
    np.where(np.isnan(score), -np.inf, score) → score
    # for np.argmax NaN is the largest number of all: put -inf in its place
    np.take_along_axis(index, best[None], axis=0)[0] → best
    # that is the method's number: look up its index there
    return np.nanmax(score, axis=0)  # that is the score: return the index that belongs to it
""")


def triangles(points, limit):
    """Corners (T, 3) of triangles between points (H, W, 3) of neighbouring rays, each as row · W +
    column, from the upper left down and around; depth ratio at most 1 + limit."""
    H, W = points.shape[:2]
    number = np.arange(H * W).reshape(H, W)
    right = np.roll(number, -1, axis=1)  # the last column's neighbour is the first
    cells = np.stack([number[:-1], number[1:], right[1:], right[:-1]], axis=-1).reshape(-1, 4)
    # no cell across an edge in depth; NaN compares as False
    flat = points.reshape(-1, 3)
    depth = np.linalg.norm(flat, axis=-1)[cells]
    cells = cells[depth.max(axis=-1) <= (1 + limit) * depth.min(axis=-1)]
    # two triangles of each, on both sides of its shorter diagonal
    down, up = (np.linalg.norm(flat[cells[:, k]] - flat[cells[:, k + 2]], axis=-1) for k in (0, 1))
    turned = np.where((down <= up)[:, None], cells, np.roll(cells, -1, axis=1))
    return np.concatenate([turned[:, :3], turned[:, [0, 2, 3]]])


def _some_points(rng: Rng, k: int) -> tuple:
    H, W = 4, 7 + k % 3
    depth = np.cumsum(rng.uniform(0.99, 1.03, (H, W)) - 1, axis=1) + rng.uniform(2, 4)
    depth[1:3, 3:5] *= 0.5
    depth[:, 0] = depth[:, -1] * rng.choice([1, 1.5], 4)
    depth[0, 5] = np.nan
    depth[-1] *= 1.15
    theta, phi = 2 * np.pi * np.arange(W) / W, np.linspace(-0.5, 0.6, H)[:, None]
    rays = np.stack(
        np.broadcast_arrays(np.cos(phi) * np.sin(theta), np.sin(phi), np.cos(phi) * np.cos(theta)),
        axis=-1,
    )
    return depth[..., None] * rays, 0.12 + 0.05 * (k % 2)


def _in_order(found):
    """Begin each triangle at its smallest number, which keeps its side, and sort all of them."""
    if found.ndim != 2 or 3 not in found.shape:
        return found
    if found.shape[1] != 3:
        return _in_order(found.T).T
    first = np.abs(found).argmin(axis=1)[:, None]
    rows = np.take_along_axis(found, (first + np.arange(3)) % 3, axis=1)
    return rows[np.lexsort(np.abs(rows).T)]


check_triangles = Open(triangles, _some_points, order=_in_order).with_slips("""
    right = np.roll(number, -1, axis=1) → number, right = number[:, :-1], number[:, 1:]
    # around the seam the last column has a neighbour, the first
    cells = cells[depth.max(axis=-1) <= (1 + limit) * depth.min(axis=-1)] →
    # cells across an edge in depth are no surface: compare the depths of the corners
    <= (1 + limit) * depth.min(axis=-1) → - depth.min(axis=-1) <= limit
    # a limit on the ratio of depths, not on their difference in metres
    down <= up → down > up  # cut along the shorter diagonal
    number[:-1], number[1:], right[1:], right[:-1] → number[:-1], right[:-1], right[1:], number[1:]
    # anticlockwise, as seen from the rig: lower left comes after upper left
""")
