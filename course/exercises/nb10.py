"""Notebook 10: a row of Table II, regions by depth, errors of all frames, a table by region, what
error bars hold, an interval, a verdict."""

import numpy as np

from course.exercises import beside
from course.exercises.compare import Rng
from course.exercises.opened import Open


def metrics(index, gt_index, N):
    """Five metrics: >1, >3, >5 in percent of the rays, MAE and RMS; an error of 100 without an
    estimate."""
    known = np.isfinite(gt_index)
    e = 100 / N * np.abs(index - gt_index)[known]
    e = np.where(np.isnan(e), 100, e)
    above = [100 * np.mean(e > limit) for limit in (1, 3, 5)]
    return np.array([*above, e.mean(), np.sqrt(np.mean(e**2))])


def _two_maps(rng: Rng, k: int) -> tuple:
    # in 100 spheres some errors are exactly 1, 3 and 5
    N = 100 if k % 3 == 1 else int(rng.integers(8, 30)) * 4
    gt_index = rng.uniform(0, N - 1, (4, 9 + k % 4))
    index = gt_index + rng.normal(0.005 * N, 0.035 * N, gt_index.shape)
    gt_index[1, :3], index[1, :3] = N / 2, N / 2 + np.array([1, 3, 5]) * N / 100
    gt_index[0, :2] = index[0, 1:3] = index[2, :2] = np.nan
    index = index.astype(np.float32 if k % 2 else np.float64)
    return np.round(index * 1024) / 1024, np.round(gt_index * 1024) / 1024, N


check_metrics = Open(metrics, _two_maps).with_slips("""
    np.where(np.isnan(e), 100, e) → e[~np.isnan(e)]
    # a ray without an estimate is an error of 100; it is not left out
    np.where(np.isnan(e), 100, e) → np.nan_to_num(e)
    # a ray without an estimate is an error of 100, not of 0
    [known] →  # a ray without ground truth is left out; it is no error of 100
    100 / N * →  # errors in percent of the N spheres: times 100 / N
    e > limit → e >= limit  # an error of exactly the limit is not above it
""")


def depth_regions(gt_index, N):
    """Region (H, W) of each ray: 0 sky, then the thirds of the inverse depth: 1 far, 2 middle, 3
    near; NaN unknown."""
    fraction = gt_index / (N - 1)  # of the inverse depth of the nearest sphere
    region = np.sum([fraction > 0, fraction >= 1 / 3, fraction >= 2 / 3], axis=0)
    return np.where(np.isnan(gt_index), np.nan, region)


def _a_truth(rng: Rng, k: int) -> tuple:
    N = 1 + 3 * int(rng.integers(10, 60))  # thirds are whole spheres
    gt_index = rng.uniform(0, N - 1, (4, 6 + k % 4))
    gt_index[0, :3], gt_index[1, :3] = 0, np.nan
    gt_index[2, :4] = (N - 1) // 3, 2 * (N - 1) // 3, N - 1, 0.2
    return gt_index, N


check_depth_regions = Open(depth_regions, _a_truth, real=beside.truth).with_slips("""
    gt_index / (N - 1) → 1 - gt_index / (N - 1)
    # sphere 0 is at infinity, sphere N - 1 the nearest: it runs the other way
    fraction > 0 → fraction >= 0  # the sky, at index 0, is a region of its own
    fraction > 0 → gt_index >= 1  # only index 0 is the sky: a far house is none
    fraction >= → fraction >  # exactly a third belongs to the nearer region: >=
""")


def pooled(sums):
    """Metrics (5,) of all rays together, from each frame's sums (frames, 6): rays, rays >1, >3, >5,
    Σ e, Σ e²."""
    rays, *above, total, squares = sums.sum(axis=0)
    return np.array([*(100 * np.array(above) / rays), total / rays, np.sqrt(squares / rays)])


def _some_sums(rng: Rng, k: int) -> tuple:
    frames = 3 + k % 4
    rays, means = rng.integers(200, 2500, frames), rng.uniform(1, 5, frames)
    above = np.sort(rng.uniform(0, 0.6, (frames, 3)))[:, ::-1] * rays[:, None]
    return (
        np.column_stack(
            [rays, np.rint(above), rays * means, rays * means**2 * rng.uniform(1.5, 3, frames)]
        ),
    )


check_pooled = Open(pooled, _some_sums).with_slips("""
    rays, *above, total, squares = sums.sum(axis=0) → rays, *above, total, squares = sums.T
    np.array([*(100 * np.array(above) / rays), total / rays, np.sqrt(squares / rays)])
    → np.mean([*(100 * np.array(above) / rays), total / rays, np.sqrt(squares / rays)], axis=1)
    # that is the mean over the frames: a frame with few rays counts too much
    sums.sum(axis=0) → sums.T  # those are the metrics of each frame: add up over the frames first
    np.sqrt(squares / rays) → np.mean(np.sqrt(sums[:, 5] / sums[:, 0]))
    # a mean of roots is not the root of the mean: add up Σ e² first
    np.sqrt(squares / rays) → np.sqrt(squares) / rays  # divide under the root
""")


def region_table(indices, truths, N):
    """Rows (5, 6) of all rays, the sky, far, middle and near ones, over all frames: the share of
    rays in percent, five metrics. indices, truths (frames, H, W)."""
    table = []
    for region in (None, 0, 1, 2, 3):
        sums = []
        for index, truth in zip(indices, truths, strict=True):
            inside = np.isfinite(truth)
            if region is not None:
                inside &= depth_regions(truth, N) == region
            e = 100 / N * np.abs(index - truth)[inside]
            e = np.where(np.isnan(e), 100, e)
            above = [np.sum(e > limit) for limit in (1, 3, 5)]
            sums.append([e.size, *above, e.sum(), np.sum(e**2)])
        sums = np.array(sums)
        table.append([sums[:, 0].sum(), *pooled(sums)])
    table = np.array(table)
    table[:, 0] *= 100 / table[0, 0]
    return table


def _some_frames(rng: Rng, k: int) -> tuple:
    N = 1 + 3 * int(rng.integers(10, 30))
    truths = rng.uniform(0, N - 1, (3 + k % 2, 4, 12))
    truths[:, 0, :5] = 0
    truths[0, 1:, :] *= 0.1  # a frame with much that is far: the means of the frames would differ
    indices = truths + rng.normal(0.005 * N, 0.03 * N, truths.shape)
    truths[1, 2, :3] = indices[0, 0, :2] = indices[2, 3, 2] = np.nan
    return indices, truths, N


check_region_table = Open(region_table, _some_frames, whole=("indices", "truths")).with_slips("""
    *pooled(sums) → *np.mean([pooled(one[None]) for one in sums], axis=0)
    # that is the mean over the frames: a frame with few rays of a region counts too much. Pool the
    # sums
    np.where(np.isnan(e), 100, e) → e[~np.isnan(e)]
    # a ray without an estimate is an error of 100; it is not left out
    inside = np.isfinite(truth) → inside = np.isfinite(truth) & (truth > 0 if region is None else True)
    # "all rays" holds the sky, too
    depth_regions(truth, N) == region → depth_regions(index, N) == region
    # the truth decides which region a ray is in, the same for every method
    table[:, 0] *= 100 / table[0, 0] → table[:, 0] *= 100 / truths.size
    # rays whose truth is unknown are in no region: the share is of those in the first row
""")


def held(error, sigma, bound, edges):
    """Percent (bins, 2) of the errors that are within sigma and within the bound, of the rays with
    a sigma from one of the edges (bins + 1,) to below the next.

    error, sigma, bound: (H, W), 1/m; a ray with a NaN does not count. NaN where a bin has no ray.
    """
    known = np.isfinite(error + sigma + bound)
    table = []
    for k in range(len(edges) - 1):
        low, high = edges[k : k + 2]
        inside = known & (sigma >= low) & (sigma < high)
        off = np.abs(error[inside])
        if not inside.any():
            table.append([np.nan, np.nan])
            continue
        table.append([100 * np.mean(off <= width[inside]) for width in (sigma, bound)])
    return np.array(table)


def _some_bars(rng: Rng, k: int) -> tuple:
    edges = np.array([0, 0.25, 0.5, 1, 2, 4])[: 5 + k % 2]
    sigma = np.exp(rng.uniform(-2, 1.5, (6, 12 + k % 5)))
    bound = sigma * rng.uniform(1.2, 4, sigma.shape)
    error = sigma * rng.normal(0, 1.2, sigma.shape)
    sigma[(sigma > 0.5) & (sigma < 1)] = 0.5 if k % 3 else 1.5  # on an edge, or an empty bin
    error[0, :4] = sigma[0, :4] * [1, -1, 1, -1]
    error[1, :2] = sigma[2, :2] = bound[2, :2] = np.nan
    return error, sigma, bound, edges


check_held = Open(held, _some_bars, whole=("error", "sigma", "bound")).with_slips("""
    np.abs(error[inside]) → error[inside]  # an error that is too far counts as one too near: np.abs
    (sigma >= low) & (sigma < high) → (sigma > low) & (sigma <= high)
    # a bar on an edge belongs to the bin above it
    np.isfinite(error + sigma + bound) → True
    # a ray without an estimate or a truth does not count: it is neither within nor beyond
    off <= width[inside] → off < width[inside]  # an error of exactly the bar is within it
    off <= width[inside] → off > width[inside]  # those are the errors beyond the bar
""")


def interval(values, draws):
    """Ends (2, …) of the middle 95 % of the mean of values (frames, …) over draws (draws, frames)
    of frame numbers."""
    means = values[draws].mean(axis=1)
    return np.percentile(means, [2.5, 97.5], axis=0)


def _some_draws(rng: Rng, k: int) -> tuple:
    frames = int(rng.integers(8, 14))
    values = rng.uniform(5, 25, (frames, 5) if k % 2 else frames)
    return values, rng.integers(0, frames, (40 + 3 * k, frames))


check_interval = Open(interval, _some_draws, whole=("values",)).with_slips("""
    return np.percentile(values, [2.5, 97.5], axis=0)
    # those are percentiles of the frames, not of their mean: draw first
    [2.5, 97.5] → [5, 95]  # that holds 90 % of the means; for 95 % leave out 2.5 % on either side
    [2.5, 97.5] → [0.025, 0.975]  # np.percentile takes percent: 2.5, not 0.025
    mean(axis=1) → mean(axis=0)  # a row of `draws` holds the frames of one draw: mean over axis 1
""")


def verdict(ours, paper):
    """Verdicts (…) on ratios to ZNCC, ours and the paper's: 2 within 20 %, else 1 on the same side
    of 1, else 0."""
    near = np.abs(ours / paper - 1) <= 0.2
    same_side = (ours < 1) == (paper < 1)
    return np.where(near, 2, np.where(same_side, 1, 0))


def _some_ratios(rng: Rng, k: int) -> tuple:
    paper = rng.uniform(0.3, 1.6, (4, 6))
    ours = paper * rng.uniform(0.5, 1.6, (4, 6))
    ours[0], paper[0] = [0.95, 0.6, 1.3, 0.45, 0.2, 0.5], [1.05, 0.9, 1.55, 0.54, 0.3, 0.3]
    ours[1, :2], paper[1, :2] = [1.4, 0.7], [0.8, 1.3]
    return ours, paper


check_verdict = Open(verdict, _some_ratios).with_slips("""
    np.abs(ours / paper - 1) → np.abs(ours - paper)  # 20 % of the paper's ratio, not 0.2
    np.abs(ours / paper - 1) → (ours / paper - 1)  # too small is as far off as too large: np.abs
    == (paper < 1) → & (paper < 1)  # both above 1 is the same side, too
    np.where(near, 2 → np.where(near & same_side, 2  # within 20 % is 2, on whichever side of 1
    np.where(same_side, 1, 0) → 0  # on the same side of 1 is a trend, 1
""")
