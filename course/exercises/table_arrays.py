"""Checkers of notebooks 08 and 09 that ask for functions on arrays, each beside its usual mistakes."""

from __future__ import annotations

from functools import partial

import numpy as np

from course.exercises.compare import Answer, Array, Case, Rng, by, checker


def _table(
    indices: Array, gt_index: Array, N: float, *, missing: float = 100, signed: bool = False, slack: float = 0
) -> Array:
    """One row for each method: >1, >3, >5, MAE, RMS, over the rays with ground truth."""
    rows = []
    for index in indices:
        difference = (index - gt_index)[np.isfinite(gt_index)]
        error = 100 / N * (difference if signed else np.abs(difference))
        error = error[np.isfinite(error)] if np.isnan(missing) else np.where(np.isnan(error), missing, error)
        rows.append(
            [*(100 * np.mean(error > limit - slack) for limit in (1, 3, 5)), error.mean(), np.sqrt(np.mean(error**2))]
        )
    return np.array(rows)


@checker
def check_error_table(rng: Rng, k: int) -> Case:
    """08.3: (methods, 5): >1, >3, >5, MAE and RMS in percent of N spheres; a missing estimate is an error of 100."""
    N = 100 if k % 3 == 1 else int(rng.integers(8, 30)) * 4  # in 100 spheres some errors are exactly 1, 3 and 5
    gt_index = rng.uniform(0, N - 1, (4, 9 + k % 4))
    indices = gt_index + rng.normal(0.005 * N, 0.035 * N, (2 + k % 4, *gt_index.shape))
    gt_index[1, :5] = N / 2
    indices[:, 1, :3] = N / 2 + np.array([1, 3, 5]) * N / 100
    indices[:, 1, 3] += N / 4
    gt_index[0, :2] = indices[0, 2, :3] = indices[-1, 3, 1] = np.nan
    gt_index, indices = np.round(gt_index * 1024) / 1024, np.round(indices * 1024) / 1024
    right = _table

    def changed(column: int, change: Answer) -> partial:
        def wrong(*inputs: Array) -> Array:
            table = right(*inputs)
            table[:, column] = change(table[:, column])
            return table

        return wrong

    wrong = [
        (lambda i, gt, N: right(i, gt, N) * [0.01, 0.01, 0.01, 1, 1], "shares in percent, not as fractions"),
        (lambda i, gt, N: right(i, gt, 100), "errors in percent of the N spheres: times 100 / N"),
        (lambda i, gt, N: right(i, gt, 100 * N), "errors in percent of the N spheres: times 100 / N, not 1 / N"),
        (lambda i, gt, N: right(i, gt, N - 1), "Eq. 5 divides by N, not by N - 1"),
        (
            lambda i, gt, N: right(np.where(np.isnan(gt), np.nan, i), np.nan_to_num(gt), N),
            "a ray without ground truth is left out; it is no error of 100",
        ),
        (partial(right, missing=np.nan), "a missing estimate is an error of 100, it is not left out"),
        (partial(right, missing=0), "a missing estimate is an error of 100, not of 0"),
        (
            lambda i, gt, N: right(i, np.nan_to_num(gt), N),
            "a ray without ground truth is left out; it is not at infinity",
        ),
        (lambda i, gt, N: np.nan * right(i, gt, N), "NaN spoils the means: leave rays without ground truth out"),
        (lambda i, gt, N: right(i, np.rint(gt), N), "do not round the ground truth"),
        (partial(right, signed=True), "too near is as wrong as too far: take the absolute value"),
        (partial(_table, slack=1e-9), "an error of exactly the limit is not above it"),
        (changed(4, np.square), "take the root of the mean square"),
        (lambda *a: right(*a)[:, [0, 1, 2, 4, 3]], "the mean first, then the root mean square"),
        (lambda *a: [100, 100, 100, 0, 0] + right(*a) * [-1, -1, -1, 1, 1], "the share of rays *above* each limit"),
        (lambda *a: right(*a)[:, :3], "MAE and RMS are missing: five columns"),
        (lambda *a: right(*a).T, "one row for each method: (methods, 5)"),
        (lambda *a: right(*a).mean(0), "that is the mean over the methods: each has its own row"),
    ]
    return by((indices, gt_index, N), right, wrong)


@checker
def check_bootstrap_interval(rng: Rng, k: int) -> Case:
    """08.5: the 2.5th and 97.5th percentile of the mean difference a - b over drawn frames."""
    frames = int(rng.integers(8, 14))
    b = rng.uniform(5, 25, frames)
    a = b + rng.normal(1, 2, frames)
    draws = rng.integers(0, frames, (40 + 3 * k, frames))
    both = (2.5, 97.5)

    def right(a: Array, b: Array, draws: Array, percent: tuple = both, mean: Answer = np.mean, axis: int = 1) -> Array:
        return np.percentile(mean((a - b)[draws], axis=axis), percent)

    def normal(a: Array, b: Array, draws: Array) -> Array:
        means = (a - b)[draws].mean(1)
        return means.mean() + np.array([-1.96, 1.96]) * means.std()

    def apart(a: Array, b: Array, draws: Array) -> Array:
        """Each method with frames of its own."""
        return np.percentile(a[draws].mean(1) - b[draws[::-1]].mean(1), both)

    wrong = [
        (partial(right, percent=(5, 95)), "that holds 90 % of the means; for 95 % leave out 2.5 % on either side"),
        (partial(right, percent=(0.025, 0.975)), "np.percentile takes percent: 2.5, not 0.025"),
        (partial(right, percent=(0, 100)), "those are the smallest and the largest mean; return two percentiles"),
        (partial(right, percent=(97.5, 2.5)), "the lower end first"),
        (partial(right, percent=50), "that is the middle: return both ends"),
        (partial(right, axis=0), "the mean over the wrong axis: a row of `draws` holds the frames of one draw"),
        (partial(right, mean=np.median), "the mean of each draw, not the median"),
        (partial(right, mean=np.sum), "the mean of each draw, not the sum"),
        (lambda a, b, d: right(b, a, d), "a minus b, not b minus a"),
        (lambda a, b, d: right(a, 0, d), "the difference of both methods, not a alone"),
        (
            lambda a, b, d: np.percentile(a - b, both),
            "those are percentiles of the frames, not of the mean: draw first",
        ),
        (lambda a, b, d: np.percentile((a - b)[d], both), "take the mean of each draw before the percentiles"),
        (normal, "that assumes normally distributed means; take their percentiles"),
        (apart, "both methods saw the same frames: draw frames, and take both figures of each"),
        (lambda a, b, d: (a - b)[d].mean(1), "those are the means of all draws: take their percentiles"),
    ]
    return by((a, b, draws), right, wrong)


@checker
def check_rig_mask(rng: Rng, k: int) -> Case:
    """09.3: 1 where a pixel never changes by more than `limit` over the frames (T, H, W), 0 elsewhere."""
    frames = rng.integers(0, 256, (3 + k % 4, 6, 7 + k % 3)).astype(np.uint8)
    limit = int(rng.integers(4, 12))
    frames[:, 2:, 2:5] = rng.integers(40, 200, (4, 3)) + rng.integers(0, limit, (len(frames), 4, 3))
    frames[:, 0, 0], frames[-1, 0, 0] = 40, 40 + limit  # just within the limit
    frames[:, 0, 1] = (40 + 0.9 * limit * np.arange(len(frames))).astype(np.uint8)  # slowly, but it changes
    frames[:, 0, 2], frames[1, 0, 2] = 90, 200  # and back again

    def right(frames: Array, limit: float) -> Array:
        return (np.ptp(frames.astype(np.float64), axis=0) <= limit) * 1.0

    def steps(frames: Array) -> Array:
        return np.abs(np.diff(frames.astype(np.float64), axis=0))

    wrong = [
        (lambda f, x: 1 - right(f, x), "the wrong way round: 1 is what moves with the rig and so never changes"),
        (lambda f, x: (np.ptp(f.astype(float), axis=0) < x) * 1, "by exactly `limit` is not more than `limit`"),
        (lambda f, x: (steps(f).max(0) <= x) * 1, "small steps add up: compare the largest value with the smallest"),
        (lambda f, x: (steps(f).mean(0) <= x) * 1, "small steps add up: compare the largest value with the smallest"),
        (
            lambda f, x: (np.abs(f[-1].astype(float) - f[0]) <= x) * 1,
            "the first and the last frame are not enough: a pixel may change and come back",
        ),
        (lambda f, x: (np.abs(f[1].astype(float) - f[0]) <= x) * 1, "two frames are not enough: look at all"),
        (
            lambda f, x: (f.astype(float).std(0) <= x) * 1,
            "that is the standard deviation; the limit is of the whole change",
        ),
        (
            lambda f, x: (np.abs(f - f.astype(float).mean(0)).max(0) <= x) * 1,
            "that is the change from the mean; asked is from the smallest value to the largest",
        ),
        (
            lambda f, x: (np.abs(np.diff(f, axis=0)).max(0) <= x) * 1,
            "uint8 wraps around: 3 - 5 is 254. Compute with floats",
        ),
        (lambda f, x: (np.ptp(f.astype(float), axis=2) <= x) * 1, "the wrong axis: the frames are the first one"),
        (lambda f, x: np.ptp(f.astype(float), axis=0), "that is the change; return 1 where it is small, 0 elsewhere"),
        (lambda f, x: np.mean(right(f, x)), "that is the share of the pixels; return the whole mask"),
    ]
    return by((frames, limit), right, wrong)


def _line(a: Array, b: Array) -> Array:
    """Least squares by its normal equations."""
    both = np.isfinite(a) & np.isfinite(b)
    x, y = a[both].astype(np.float64), b[both].astype(np.float64)
    gain = np.sum((x - x.mean()) * (y - y.mean())) / np.sum((x - x.mean()) ** 2)
    return np.array([gain, y.mean() - gain * x.mean()])


@checker
def check_gain_and_offset(rng: Rng, k: int) -> Case:
    """09.5: gain and offset of camera b against camera a on the rays that both see, by least squares."""
    a = rng.uniform(20, 230, (5, 8 + k % 4))
    b = rng.uniform(0.7, 1.3) * a + rng.uniform(5, 20) + rng.normal(0, 9, a.shape)
    a[0, :3] = b[1, :2] = b[0, 1] = np.nan
    if k % 2:
        a, b = a.astype(np.float32), b.astype(np.float32)

    def moments(a: Array, b: Array) -> tuple[float, float, float, float]:
        both = np.isfinite(a) & np.isfinite(b)
        return a[both].mean(), a[both].std(), b[both].mean(), b[both].std()

    def with_gain(gain: float, a: Array, b: Array) -> Array:
        mean_a, _, mean_b, _ = moments(a, b)
        return np.array([gain, mean_b - gain * mean_a])

    def through_zero(a: Array, b: Array) -> Array:
        return np.array([np.nansum(a * b) / np.nansum(a**2 * np.isfinite(b)), 0])

    def each_own(a: Array, b: Array) -> Array:
        """Means over all rays of each camera, not of both."""
        product = np.nanmean((a - np.nanmean(a)) * (b - np.nanmean(b)))
        gain = product / np.nanvar(a)
        return np.array([gain, np.nanmean(b) - gain * np.nanmean(a)])

    wrong = [
        (lambda a, b: _line(b, a), "the other way round: b is gain times a plus offset"),
        (lambda a, b: _line(a, b)[::-1], "the gain first, then the offset"),
        (through_zero, "with an offset the line does not go through 0: fit both numbers"),
        (lambda a, b: through_zero(a, b)[:1], "gain and offset are asked"),
        (lambda a, b: _line(a, b)[0], "gain and offset are asked"),
        (
            lambda a, b: with_gain(moments(a, b)[2] / moments(a, b)[0], a, b),
            "the quotient of the means is no gain: it has the offset in it",
        ),
        (
            lambda a, b: with_gain(moments(a, b)[3] / moments(a, b)[1], a, b),
            "the quotient of the deviations takes noise for gain: divide the covariance by the variance of a",
        ),
        (lambda a, b: with_gain(1, a, b), "that is an offset alone: the gain is not 1"),
        (
            lambda a, b: np.array([1 / _line(b, a)[0], -_line(b, a)[1] / _line(b, a)[0]]),
            "that minimises the errors of a; minimise those of b",
        ),
        (lambda a, b: _line(np.nan_to_num(a), np.nan_to_num(b)), "NaN is not black: use the rays that both see"),
        (lambda a, b: np.array([np.nan, np.nan]), "NaN spoils the sums: use the rays that both see"),
        (each_own, "all means over the same rays, those that both see"),
        (lambda a, b: _line(a, b) * [1, -1], "the sign of the offset: mean of b minus gain times mean of a"),
    ]
    return by((a, b), _line, wrong)
