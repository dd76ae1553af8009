"""Notebook 00: the depth of a sphere, the error of an index, the share of bad rays, a panorama from all cameras."""

import numpy as np

from course.exercises import beside
from course.exercises.compare import Rng
from course.exercises.opened import Open


def depth_of_index(index, N, min_depth):
    """Depths in metres of sphere indices, of any shape, among N spheres; infinite at index 0."""
    inverse_depth = index / (min_depth * (N - 1))
    with np.errstate(divide="ignore"):
        return 1 / inverse_depth


def _some_indices(rng: Rng, k: int) -> tuple:
    N = int(rng.integers(50, 200))
    index = rng.uniform(0.5, N - 1, (3, 4 + k % 3))
    index[0, 0] = 0
    return index, N, rng.uniform(0.4, 3)


check_depth_of_index = Open(
    depth_of_index,
    _some_indices,
    [
        (
            lambda n, N, nearest: n / (nearest * (N - 1)),
            "that is the inverse depth in 1/m: the depth is 1 divided by it",
        ),
        (
            lambda n, N, nearest: depth_of_index(n, N + 1, nearest),
            "from infinity to min_depth there are N - 1 steps, not N",
        ),
        (
            lambda n, N, nearest: depth_of_index(n + 1, N, nearest),
            "the spheres count from 0, at infinity: n, not n + 1",
        ),
        (
            lambda n, N, nearest: depth_of_index(N - 1 - n, N, nearest),
            "sphere 0 is at infinity, sphere N - 1 the nearest",
        ),
        (lambda n, N, nearest: nearest * n / (N - 1), "the spheres are even in inverse depth, not in depth"),
        (lambda n, N, nearest: depth_of_index(n, N, 1), "that is in units of the nearest depth: metres are asked"),
        (
            lambda n, N, nearest: depth_of_index(np.rint(n), N, nearest),
            "do not round: an index may lie between two spheres",
        ),
        (
            lambda n, N, nearest: np.where(n == 0, 0, depth_of_index(n, N, nearest)),
            "sphere 0 is infinitely far away, not 0 m",
        ),
    ],
)


def index_errors(index, gt_index, N):
    """Errors e (H, W) in percent of the N spheres; 100 without an estimate, NaN without a ground truth."""
    e = 100 / N * np.abs(index - gt_index)
    e = np.where(np.isnan(index), 100, e)
    return np.where(np.isnan(gt_index), np.nan, e)


def _two_maps(rng: Rng, k: int) -> tuple:
    N = int(rng.integers(8, 40)) * 4
    gt_index = rng.uniform(0, N - 1, (4, 6 + k % 3))
    index = gt_index + rng.normal(0, 0.05 * N, gt_index.shape)
    gt_index[1, :2] = index[1, 1:3] = np.nan
    return index, gt_index, N


check_index_errors = Open(
    index_errors,
    _two_maps,
    [
        (
            lambda index, gt, N: 100 / N * np.abs(index - gt),
            "a ray without an estimate is NaN: count it as an error of 100",
        ),
        (
            lambda index, gt, N: np.nan_to_num(index_errors(index, gt, N), nan=100),
            "without a ground truth no error is known: NaN",
        ),
        (
            lambda index, gt, N: np.nan_to_num(index_errors(index, gt, N)),
            "a ray without ground truth is not a perfect one: NaN",
        ),
        (
            lambda *inputs: index_errors(*inputs) * np.sign(inputs[0] - inputs[1]),
            "too near is as wrong as too far: np.abs",
        ),
        (lambda index, gt, N: index_errors(index, gt, 100), "in percent of the N spheres: times 100 / N"),
        (lambda index, gt, N: index_errors(index, gt, 1), "divide by N: an error is a share of the range"),
        (lambda *inputs: index_errors(*inputs) / 100, "in percent, not as a fraction"),
        (lambda index, gt, N: index_errors(index, gt, N - 1), "Eq. 5 divides by N, not by N - 1"),
        (lambda index, gt, N: index_errors(np.rint(index), np.rint(gt), N), "do not round"),
        (lambda *inputs: np.nanmean(index_errors(*inputs)), "that is the mean: each ray keeps its own"),
    ],
)


def share_above(errors, limit):
    """Percentage of the rays whose error is larger than a limit, of those with an error that is known (not NaN)."""
    known = errors[np.isfinite(errors)]
    return 100 * np.mean(known > limit)


def _some_errors(rng: Rng, k: int) -> tuple:
    errors = np.round(rng.exponential(3, (5, 7 + k % 4)) * 4) / 4
    errors[0, :3] = np.nan
    errors[1, :3] = 1, 3, 5
    return errors, (1.0, 3.0, 5.0)[k % 3]


check_share_above = Open(
    share_above,
    _some_errors,
    [
        (lambda e, limit: 100 * np.mean(e > limit), "a ray without a known error is not a good one: leave NaN out"),
        (lambda e, limit: share_above(e, limit) / 100, "in percent, not as a fraction"),
        (lambda e, limit: 100 - share_above(e, limit), "that is the share of the good rays: above the limit is bad"),
        (lambda e, limit: share_above(e, limit - 1e-9), "an error of exactly the limit is not above it"),
        (lambda e, limit: np.sum(e > limit), "that is their number: divide by the number of rays that are known"),
        (lambda e, limit: share_above(e, 1), "the limit is an argument"),
        (lambda e, limit: np.nanmean(e), "that is the mean error: count the rays above the limit"),
        (lambda e, limit: 100 * np.nanmean(np.where(e > limit, 1, np.nan)), "divide by all rays that are known"),
    ],
)


def stitched(warped):
    """Mean panorama (H, W, 3) of the cameras that see each ray, of (cameras, H, W, 3); NaN where none does."""
    seen = np.isfinite(warped)
    count = seen.sum(axis=0)
    total = np.where(seen, warped, 0).sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _panoramas(rng: Rng, k: int) -> tuple:
    warped = rng.uniform(0, 255, (3 + k % 3, 4, 6 + k % 3, 3))
    warped[rng.uniform(0, 1, warped.shape[:3]) < 0.4] = np.nan
    warped[:, 0, 0] = np.nan  # a ray that no camera sees
    warped[0, 0, 1:] = 120
    return (warped,)


check_stitched = Open(
    stitched,
    _panoramas,
    [
        (lambda w: w.mean(axis=0), "a camera that does not see the ray is NaN and spoils the rest: leave it out"),
        (lambda w: np.nan_to_num(w).mean(axis=0), "divide by the number of cameras that see the ray, not by all"),
        (lambda w: np.nan_to_num(stitched(w)), "what no camera sees is NaN: it is not black"),
        (lambda w: np.nansum(w, axis=0), "that is the sum: divide by the number of cameras that see the ray"),
        (lambda w: np.nanmedian(w, axis=0), "that is the median: take the mean"),
        (lambda w: np.nanmax(w, axis=0), "that is the brightest camera: take the mean"),
        (lambda w: stitched(w).mean(axis=-1), "each colour keeps its own mean: (H, W, 3)"),
        (lambda w: np.nanmean(w, axis=(1, 2)), "the cameras are the first axis"),
    ],
    picture=lambda: (beside.warped(),),
)
