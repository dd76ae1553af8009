"""Checkers of notebook 09 that ask for functions on arrays, each beside its usual mistakes."""

from __future__ import annotations

import numpy as np

from course.exercises.compare import Array, Case, Rng, by, checker


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
