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
    images[:, 0, 0], images[1:, 0, 1], images[0, 0, 1] = (
        np.nan,
        np.nan,
        90,
    )
    return images, angles, 1.9


check_blend = Open(blend, _some_views).with_slips("""
    half_fov - angles → angles  # the weight falls with the angle: half_fov - angle
    / weights.sum(axis=0) →  # divide by the sum of the weights
    half_fov - angles → 1.0 * (angles == np.where(seen, angles, np.inf).min(axis=0))
    # that is the nearest camera alone, which jumps where another takes over: mix all
""")


def two_best(samples, angles):
    """Gray values (2, H, W) of the two cameras that see a ray nearest their axes, in camera order;
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
    # those are the cameras' numbers: look their gray values up
    return np.take_along_axis(samples, best, axis=0)
    → return np.sort(np.take_along_axis(samples, best, axis=0), axis=0)
    # sort the numbers of the cameras, not their gray values
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


def quads(depth, limit):
    """Corners (M, 4) of cells, row · W + column, from the upper left down and around; depth ratio
    at most 1 + limit."""
    H, W = depth.shape
    number = np.arange(H * W).reshape(H, W)
    right = np.roll(number, -1, axis=1)  # the last column's neighbour is the first
    corners = np.stack([number[:-1], number[1:], right[1:], right[:-1]], axis=-1)
    at_corners = depth.ravel()[corners]
    return corners[at_corners.max(axis=-1) <= (1 + limit) * at_corners.min(axis=-1)]


def _a_depth(rng: Rng, k: int) -> tuple:
    depth = np.cumsum(rng.uniform(0.99, 1.03, (4, 7 + k % 3)) - 1, axis=1) + rng.uniform(2, 4)
    depth[1:3, 3:5] *= 0.5
    depth[:, 0] = depth[:, -1] * rng.choice([1, 1.5], 4)
    depth[0, 5] = np.nan
    depth[-1] *= 1.15
    return depth, 0.12 + 0.05 * (k % 2)


def _sorted_cells(cells):
    """Sort rows of four corners, wherever each begins."""
    rows = cells if cells.ndim == 2 and cells.shape[1] == 4 else None
    return cells if rows is None else rows[np.lexsort(np.sort(np.abs(rows), axis=1).T)]


check_quads = Open(quads, _a_depth, order=_sorted_cells).with_slips("""
    right = np.roll(number, -1, axis=1) → number, right = number[:, :-1], number[:, 1:]
    # around the seam the last column has a neighbour, the first
    corners[at_corners.max(axis=-1) <= (1 + limit) * at_corners.min(axis=-1)]
    → corners.reshape(-1, 4)
    # cells across an edge in depth are no surface: compare the corners
    <= (1 + limit) * at_corners.min(axis=-1) → - at_corners.min(axis=-1) <= limit
    # a limit on the ratio of depths, not on their difference in metres
    number[:-1], number[1:], right[1:], right[:-1] → number[:-1], right[:-1], right[1:], number[1:]
    # anticlockwise, as seen from the rig: lower left comes after upper left
    right[1:], right[:-1] → right[:-1], right[1:]
    # around the cell, not crosswise: lower right after lower left
""")
