"""Notebook 08: a row of Table II, regions by depth, the errors of all frames together, an interval, a verdict."""

import numpy as np

from course.exercises import beside
from course.exercises.compare import Answer, Array, Rng
from course.exercises.opened import Open


def metrics(index, gt_index, N):
    """Five metrics: >1, >3, >5 in percent of the rays, MAE and RMS; an error of 100 without an estimate."""
    known = np.isfinite(gt_index)
    e = 100 / N * np.abs(index - gt_index)[known]
    e = np.where(np.isnan(e), 100, e)
    above = [100 * np.mean(e > limit) for limit in (1, 3, 5)]
    return np.array([*above, e.mean(), np.sqrt(np.mean(e**2))])


def _two_maps(rng: Rng, k: int) -> tuple:
    N = 100 if k % 3 == 1 else int(rng.integers(8, 30)) * 4  # in 100 spheres some errors are exactly 1, 3 and 5
    gt_index = rng.uniform(0, N - 1, (4, 9 + k % 4))
    index = gt_index + rng.normal(0.005 * N, 0.035 * N, gt_index.shape)
    gt_index[1, :3], index[1, :3] = N / 2, N / 2 + np.array([1, 3, 5]) * N / 100
    gt_index[0, :2] = index[0, 1:3] = index[2, :2] = np.nan
    return np.round(index * 1024) / 1024, np.round(gt_index * 1024) / 1024, N


check_metrics = Open(
    metrics,
    _two_maps,
    [
        (
            lambda index, gt, N: metrics(index, np.where(np.isnan(index), np.nan, gt), N),
            "a ray without an estimate is an error of 100; it is not left out",
        ),
        (
            lambda index, gt, N: metrics(np.where(np.isnan(index), gt, index), gt, N),
            "a ray without an estimate is an error of 100, not of 0",
        ),
        (
            lambda index, gt, N: metrics(np.where(np.isnan(gt), np.nan, index), np.nan_to_num(gt), N),
            "a ray without ground truth is left out; it is no error of 100",
        ),
        (lambda *inputs: metrics(*inputs) * np.nan, "NaN spoils the means: leave out rays without ground truth"),
        (lambda index, gt, N: metrics(index, gt, 100), "errors in percent of the N spheres: times 100 / N"),
        (lambda index, gt, N: metrics(index, gt, N - 1), "Eq. 5 divides by N, not by N - 1"),
        (lambda index, gt, N: metrics(index, np.rint(gt), N), "do not round the ground truth"),
        (lambda *inputs: metrics(*inputs) * [0.01, 0.01, 0.01, 1, 1], "shares in percent, not as fractions"),
        (lambda *inputs: [100, 100, 100, 0, 0] + metrics(*inputs) * [-1, -1, -1, 1, 1], "the share *above* each limit"),
        (lambda *inputs: metrics(*inputs) ** [1, 1, 1, 1, 2], "take the root of the mean square"),
        (lambda *inputs: metrics(*inputs)[[0, 1, 2, 4, 3]], "the mean first, then the root mean square"),
    ],
)


def depth_regions(gt_index, N):
    """Region (H, W) of each ray: 0 sky, then the thirds of the inverse depth: 1 far, 2 middle, 3 near; NaN unknown."""
    fraction = gt_index / (N - 1)  # of the inverse depth of the nearest sphere
    region = np.sum([fraction > 0, fraction >= 1 / 3, fraction >= 2 / 3], axis=0)
    return np.where(np.isnan(gt_index), np.nan, region)


def _a_truth(rng: Rng, k: int) -> tuple:
    N = 1 + 3 * int(rng.integers(10, 60))  # thirds are whole spheres
    gt_index = rng.uniform(0, N - 1, (4, 6 + k % 4))
    gt_index[0, :3], gt_index[1, :3] = 0, np.nan
    gt_index[2, :4] = (N - 1) // 3, 2 * (N - 1) // 3, N - 1, 0.2
    return gt_index, N


check_depth_regions = Open(
    depth_regions,
    _a_truth,
    [
        (lambda gt, N: np.nan_to_num(depth_regions(gt, N)), "a ray whose depth is unknown is not sky: NaN"),
        (
            lambda gt, N: depth_regions(N - 1 - gt, N),
            "sphere 0 is at infinity, sphere N - 1 the nearest: it runs the other way",
        ),
        (lambda gt, N: np.maximum(depth_regions(gt, N), 1 + 0 * gt), "the sky, at index 0, is a region of its own"),
        (lambda gt, N: np.where(gt < 1, 0, depth_regions(gt, N)), "only index 0 is the sky: a far house is none"),
        (
            lambda gt, N: depth_regions(np.where(gt % ((N - 1) / 3) == 0, gt - 1e-9, gt), N),
            "exactly a third belongs to the nearer region: >=",
        ),
        (lambda gt, N: depth_regions(gt, N + 1), "N spheres have N - 1 steps between them"),
        (lambda gt, N: depth_regions(gt, N) - 1, "count from 0, for the sky, to 3"),
        (lambda gt, N: np.bincount(depth_regions(gt, N)[np.isfinite(gt)].astype(int)), "that counts them: label each"),
    ],
    picture=beside.truth,
)


def pooled(sums):
    """Metrics (5,) of all rays together, from each frame's sums (frames, 6): rays, rays >1, >3, >5, Σ e, Σ e²."""
    rays, *above, total, squares = sums.sum(axis=0)
    return np.array([*(100 * np.array(above) / rays), total / rays, np.sqrt(squares / rays)])


def _some_sums(rng: Rng, k: int) -> tuple:
    frames = 3 + k % 4
    rays, means = rng.integers(200, 2500, frames), rng.uniform(1, 5, frames)
    above = np.sort(rng.uniform(0, 0.6, (frames, 3)))[:, ::-1] * rays[:, None]
    return (np.column_stack([rays, np.rint(above), rays * means, rays * means**2 * rng.uniform(1.5, 3, frames)]),)


def _each(sums: Array) -> Array:
    return np.stack([pooled(frame[None]) for frame in sums])


check_pooled = Open(
    pooled,
    _some_sums,
    [
        (lambda s: _each(s).mean(0), "that is the mean over the frames: a frame with few rays counts too much"),
        (lambda s: _each(s), "those are the metrics of each frame: add up over the frames first"),
        (lambda s: pooled(s) * [0.01, 0.01, 0.01, 1, 1], "shares in percent, not as fractions"),
        (lambda s: pooled(s) ** [1, 1, 1, 1, 2], "take the root of the mean square"),
        (
            lambda s: [*pooled(s)[:4], _each(s)[:, 4].mean()],
            "a mean of roots is not the root of the mean: add up Σ e² first",
        ),
        (lambda s: [*pooled(s)[:4], pooled(s)[4] / np.sqrt(s[:, 0].sum())], "divide under the root"),
        (
            lambda s: [*pooled(s)[:4], np.sqrt(pooled(s)[4] ** 2 - pooled(s)[3] ** 2)],
            "that is the standard deviation: do not subtract the mean",
        ),
        (lambda s: s.sum(0)[1:], "divide by the number of rays"),
        (lambda s: s.mean(0)[1:], "divide by the number of rays, not of frames"),
    ],
)


def interval(values, draws):
    """Ends (2, …) of the middle 95 % of the mean of values (frames, …) over draws (draws, frames) of frame numbers."""
    means = values[draws].mean(axis=1)
    return np.percentile(means, [2.5, 97.5], axis=0)


def _some_draws(rng: Rng, k: int) -> tuple:
    frames = int(rng.integers(8, 14))
    values = rng.uniform(5, 25, (frames, 5) if k % 2 else frames)
    return values, rng.integers(0, frames, (40 + 3 * k, frames))


def _ends(values: Array, draws: Array, percent=(2.5, 97.5), mean: Answer = np.mean, axis: int = 1) -> Array:
    return np.percentile(mean(values[draws], axis=axis), percent, axis=0)


check_interval = Open(
    interval,
    _some_draws,
    [
        (
            lambda v, d: np.percentile(v, [2.5, 97.5], axis=0),
            "those are percentiles of the frames, not of their mean: draw first",
        ),
        (lambda v, d: _ends(v, d, (5, 95)), "that holds 90 % of the means; for 95 % leave out 2.5 % on either side"),
        (lambda v, d: _ends(v, d, (0.025, 0.975)), "np.percentile takes percent: 2.5, not 0.025"),
        (lambda v, d: _ends(v, d, (0, 100)), "those are the smallest and the largest mean"),
        (lambda v, d: _ends(v, d, (97.5, 2.5)), "the lower end first"),
        (lambda v, d: _ends(v, d, axis=0), "a row of `draws` holds the frames of one draw: mean over axis 1"),
        (lambda v, d: _ends(v, d, mean=np.median), "the mean of each draw, not the median"),
        (lambda v, d: _ends(v, d, mean=np.sum), "the mean of each draw, not the sum"),
        (lambda v, d: _ends(v, d - 1), "frame numbers count from 0, as indices do"),
        (lambda v, d: np.percentile(v[d].mean(1), [2.5, 97.5]), "each column has its own interval: axis=0"),
        (
            lambda v, d: v[d].mean(1).mean(0) + np.multiply.outer([-1.96, 1.96], v[d].mean(1).std(0)),
            "that assumes a normal distribution: take percentiles of the means",
        ),
    ],
)


def verdict(ours, paper):
    """Verdicts (…) on ratios to ZNCC, ours and the paper's: 2 within 20 %, else 1 on the same side of 1, else 0."""
    near = np.abs(ours / paper - 1) <= 0.2
    same_side = (ours < 1) == (paper < 1)
    return np.where(near, 2, np.where(same_side, 1, 0))


def _some_ratios(rng: Rng, k: int) -> tuple:
    paper = rng.uniform(0.3, 1.6, (4, 6))
    ours = paper * rng.uniform(0.5, 1.6, (4, 6))
    ours[0], paper[0] = [0.95, 0.6, 1.3, 0.45, 0.2, 0.5], [1.05, 0.9, 1.55, 0.54, 0.3, 0.3]
    ours[1, :2], paper[1, :2] = [1.4, 0.7], [0.8, 1.3]
    return ours, paper


def _verdict(near: Array, same_side: Array) -> Array:
    return np.where(near, 2, np.where(same_side, 1, 0))


check_verdict = Open(
    verdict,
    _some_ratios,
    [
        (lambda o, p: verdict(p, o), "20 % of the paper's ratio: divide by the paper's"),
        (lambda o, p: _verdict(np.abs(o - p) <= 0.2, (o < 1) == (p < 1)), "20 % of the paper's ratio, not 0.2"),
        (lambda o, p: _verdict(o / p - 1 <= 0.2, (o < 1) == (p < 1)), "too small is as far off as too large: np.abs"),
        (lambda o, p: _verdict(np.abs(o / p - 1) <= 20, (o < 1) == (p < 1)), "20 % is 0.2"),
        (lambda o, p: _verdict(np.abs(o / p - 1) <= 0.2, (o < 1) & (p < 1)), "both above 1 is the same side, too"),
        (lambda o, p: np.where((o < 1) == (p < 1), verdict(o, p), 0), "within 20 % is 2, on whichever side of 1"),
        (lambda o, p: 2 - verdict(o, p), "2 is the best verdict, 0 the worst"),
        (lambda o, p: (verdict(o, p) == 2) * 2, "on the same side of 1 is a trend, 1"),
        (lambda o, p: verdict(o, p).min(), "each ratio has its own verdict"),
    ],
)
