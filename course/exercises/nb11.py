"""Notebook 11: a panorama without seams, the two best views of a ray, a choice among methods, a mesh."""

import numpy as np

from course.exercises.compare import Array, Rng
from course.exercises.opened import Open


def blend(images, angles, half_fov):
    """Mean (H, W, 3) of images (cameras, H, W, 3), weighted by how far inside its view each camera sees the ray."""
    seen = np.isfinite(images[..., 0])
    weights = np.where(seen, half_fov - angles, 0)[..., None]
    with np.errstate(invalid="ignore"):  # nobody sees the ray: 0/0 is NaN
        return np.sum(weights * np.nan_to_num(images), axis=0) / weights.sum(axis=0)


def _some_views(rng: Rng, k: int) -> tuple:
    images, angles = rng.uniform(0, 255, (4, 3, 6 + k % 3, 3)), rng.uniform(0.1, 1.8, (4, 3, 6 + k % 3))
    images[rng.uniform(0, 1, angles.shape) < 0.3] = np.nan
    images[:, 0, 0], images[1:, 0, 1], images[0, 0, 1] = np.nan, np.nan, 90  # rays that no camera sees, and one does
    return images, angles, 1.9


def _weighted(images: Array, weights: Array) -> Array:
    """The mean with other weights."""
    return blend(images, -weights, 0)


check_blend = Open(
    blend,
    _some_views,
    [
        (lambda i, a, h: _weighted(i, a), "the weight falls with the angle: half_fov - angle"),
        (lambda i, a, h: np.nanmean(i, axis=0), "that is the plain mean: weigh each camera by half_fov - angle"),
        (lambda i, a, h: _weighted(i, 1 / a), "the weight is half_fov - angle: it reaches 0 where the view ends"),
        (lambda i, a, h: _weighted(i, h - np.degrees(a)), "both angles are in radians"),
        (
            lambda i, a, h: np.sum((h - a)[..., None] * np.nan_to_num(i), 0) / np.sum(h - a, 0)[..., None],
            "a camera that does not see the ray has the weight 0, below the line, too",
        ),
        (lambda *v: np.nan_to_num(blend(*v)), "what no camera sees is NaN: it is not black"),
        (lambda i, a, h: np.sum((h - a)[..., None] * i, 0), "a camera that does not see the ray spoils it: NaN"),
        (lambda i, a, h: np.nansum((h - a)[..., None] * i, 0), "divide by the sum of the weights"),
        (
            lambda i, a, h: np.nanmean((h - a)[..., None] * i, 0),
            "divide by the sum of the weights, not by the number of cameras",
        ),
        (
            lambda i, a, h: _weighted(i, 1.0 * (a == np.nanmin(np.where(np.isnan(i[..., 0]), np.nan, a), 0))),
            "that is the nearest camera alone, which jumps where another takes over: mix all",
        ),
    ],
)


def two_best(samples, angles):
    """Gray values (2, H, W) of the two cameras that see a ray nearest their axes, in camera order; NaN if unseen."""
    angles = np.where(np.isnan(samples), np.inf, angles)
    best = np.sort(np.argsort(angles, axis=0)[:2], axis=0)
    return np.take_along_axis(samples, best, axis=0)


def _some_samples(rng: Rng, k: int) -> tuple:
    samples, angles = rng.normal(0, 1, (4, 3, 7 + k % 3)), rng.uniform(0, 1.9, (4, 3, 7 + k % 3))
    samples[rng.uniform(0, 1, samples.shape) < 0.3] = np.nan
    samples[:, 0, 0] = samples[1:, 0, 1] = np.nan
    return samples, angles


def _by_angle(samples: Array, angles: Array) -> Array:
    best = np.argsort(np.where(np.isnan(samples), np.inf, angles), axis=0)[:2]
    return np.take_along_axis(samples, best, axis=0)


check_two_best = Open(
    two_best,
    _some_samples,
    [
        (_by_angle, "in camera order: sort their numbers, or a window mixes two cameras where the nearer one changes"),
        (lambda s, a: two_best(s, -a), "nearest the axis is the smallest angle"),
        (lambda s, a: _by_angle(s, -a), "nearest the axis is the smallest angle"),
        (
            lambda s, a: np.take_along_axis(s, np.sort(np.argsort(a, axis=0)[:2], axis=0), axis=0),
            "a camera that does not see the ray is NaN, however small its angle: leave it out",
        ),
        (lambda s, a: s[:2], "each ray has its own two cameras"),
        (lambda s, a: two_best(s, s), "choose by the angles, not by the gray values"),
        (lambda s, a: np.nan_to_num(two_best(s, a)), "what is not seen stays NaN: it is not gray"),
        (lambda s, a: np.sort(np.argsort(np.where(np.isnan(s), np.inf, a), axis=0)[:2], axis=0), "look them up"),
        (lambda s, a: np.nanmean(two_best(s, a), axis=0), "both of them, not their mean"),
        (lambda s, a: np.sort(_by_angle(s, a), axis=0), "sort the numbers of the cameras, not their gray values"),
    ],
)


def pick(index, score):
    """Index (H, W) of the method with the highest score at each ray, of (methods, H, W); a score of NaN never wins."""
    best = np.argmax(np.where(np.isnan(score), -np.inf, score), axis=0)
    return np.take_along_axis(index, best[None], axis=0)[0]


def _some_methods(rng: Rng, k: int) -> tuple:
    index, score = rng.uniform(0, 95, (2 + k % 3, 4, 6 + k % 4)), rng.uniform(-1, 1, (2 + k % 3, 4, 6 + k % 4))
    score[0, :2, 0], score[-1, 1, 2:4] = np.nan, np.nan
    return index, score


check_pick = Open(
    pick,
    _some_methods,
    [
        (
            lambda i, s: np.take_along_axis(i, np.argmax(s, 0)[None], 0)[0],
            "for np.argmax NaN is the largest number of all: put -inf in its place",
        ),
        (lambda i, s: pick(i, np.nan_to_num(s)), "a score of NaN never wins; 0 may"),
        (lambda i, s: pick(i, -s), "the highest score, not the lowest"),
        (lambda i, s: pick(i, i), "choose by the scores, not by the indices"),
        (lambda i, s: np.argmax(np.nan_to_num(s, nan=-9), 0), "that is the method's number: look up its index there"),
        (lambda i, s: np.nanmax(s, 0), "that is the score: return the index that belongs to it"),
        (
            lambda i, s: i[np.argmax(np.nanmean(s, axis=(1, 2)))],
            "each ray has its own best method; that takes one for all",
        ),
        (lambda i, s: np.mean(i, 0), "choose one; their mean may be a place where nothing is"),
    ],
)


def quads(depth, limit):
    """Corners (M, 4) of cells, row · W + column, from the upper left down and around; depth ratio at most 1 + limit."""
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


def _cells(depth: Array, limit: float, spread) -> Array:
    corners = quads(np.ones_like(depth), limit)
    values = depth.ravel()[corners]
    return corners[spread(values, values.min(-1)) <= limit]


check_quads = Open(
    quads,
    _a_depth,
    [
        (
            lambda d, x: quads(d, x)[np.ptp(quads(d, x) % d.shape[1], axis=-1) == 1],
            "around the seam the last column has a neighbour, the first",
        ),
        (lambda d, x: quads(np.ones_like(d), x), "cells across an edge in depth are no surface: compare the corners"),
        (lambda d, x: quads(np.nan_to_num(d, nan=np.nanmean(d)), x), "a corner without depth makes no surface"),
        (
            lambda d, x: _cells(d, x, lambda v, near: v.max(-1) - near),
            "a limit on the ratio of depths, not on their difference in metres",
        ),
        (
            lambda d, x: _cells(d, x, lambda v, near: np.abs(v[:, 0] / v[:, 3] - 1)),
            "all four corners: the largest depth against the smallest",
        ),
        (
            lambda d, x: quads(d, x)[:, [0, 3, 2, 1]],
            "anticlockwise, as seen from the rig: lower left comes after upper left",
        ),
        (lambda d, x: quads(d, x)[:, [0, 1, 3, 2]], "around the cell, not crosswise: lower right after lower left"),
        (lambda d, x: quads(d, x)[:, :3], "four corners a cell"),
        (lambda d, x: len(quads(d, x)), "that is their number: return the corners"),
    ],
)
