"""Notebook 04: ZNCC of two patches, sums over windows, the costs of a pair, the mean of all pairs, the best sphere."""

import cv2
import numpy as np

from course.exercises import beside
from course.exercises.compare import Array, Rng
from course.exercises.opened import Open


def zncc(a, b):
    """Zero-mean normalised cross-correlation of two patches of equal shape, -1 to 1; 0 if one of them is flat."""
    covariance = np.mean((a - a.mean()) * (b - b.mean()))
    deviations = a.std() * b.std()
    return covariance / deviations if deviations > 1e-12 else 0.0


def _two_patches(rng: Rng, k: int) -> tuple:
    a = rng.normal(3, 2, (5 + 2 * (k % 3), 9))
    b = (-1) ** k * 0.4 * a + rng.normal(1, 0.5, a.shape)
    return (a, np.full(a.shape, 7.0)) if k == 9 else (a, b)


def _not_zero_mean(a: Array, b: Array) -> float:
    return zncc(np.concatenate([a, -a]), np.concatenate([b, -b]))


check_zncc = Open(
    zncc,
    _two_patches,
    [
        (lambda a, b: np.nan if np.ptp(b) == 0 else zncc(a, b), "a flat patch divides 0 by 0: return 0 for it"),
        (lambda a, b: (1 - zncc(a, b)) / 2, "that is the cost; return ZNCC itself, 1 for a match"),
        (_not_zero_mean, "subtract the mean of each patch first (the Z of ZNCC)"),
        (
            lambda a, b: zncc(a, b) + (a.mean() * b.mean() / a.std() / b.std() if np.ptp(b) else 0),
            "subtract the means, too",
        ),
        (lambda a, b: zncc(a, b) * a.std() * b.std(), "divide by both standard deviations (the N of ZNCC)"),
        (lambda a, b: zncc(a, b) / (a.std() * max(b.std(), 1e-12)), "divide by the deviations, not by the variances"),
        (lambda a, b: zncc(a, b) * a.size, "sum and mean are mixed: take the mean of the products"),
        (lambda a, b: zncc(a, b) * a.size / (a.size - 1), "n and n - 1 are mixed: np.mean and np.std both divide by n"),
        (lambda a, b: np.abs(zncc(a, b)), "the sign counts: a negative is not a match"),
    ],
)


def window_sums(image, radius):
    """Sums (H, W) over windows of 2 radius + 1 pixels a side; columns wrap around, beyond the rows there is nothing."""
    side = 2 * radius + 1
    wide = np.pad(image, ((0, 0), (radius, radius)), mode="wrap")
    sums = cv2.boxFilter(wide, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
    return sums[:, radius:-radius]


def _an_image(rng: Rng, k: int) -> tuple:
    return rng.uniform(0.5, 1, (8 + k % 3, 11 + k % 4)), 1 + k % 3


def _sums(image: Array, radius: int, rows: str = "constant", columns: str = "wrap") -> Array:
    """Window sums with other ways to go on beyond the ends."""
    padded = np.pad(np.pad(image, ((radius,) * 2, (0, 0)), rows), ((0, 0), (radius,) * 2), columns)
    return np.lib.stride_tricks.sliding_window_view(padded, (2 * radius + 1,) * 2).sum((2, 3))


check_window_sums = Open(
    window_sums,
    _an_image,
    [
        (lambda image, r: _sums(image, r, columns="constant"), "the panorama is a circle: columns wrap around"),
        (
            lambda image, r: _sums(image, r, columns="edge"),
            "the panorama is a circle: columns wrap, they do not repeat",
        ),
        (lambda image, r: _sums(image, r, rows="wrap"), "rows do not wrap: above the first one there is nothing"),
        (lambda image, r: _sums(image, r, rows="edge"), "rows do not repeat: above the first one there is nothing"),
        (lambda image, r: _sums(image, r, rows="reflect"), "beyond the rows there is nothing: BORDER_CONSTANT"),
        (lambda image, r: window_sums(image, r) / (2 * r + 1) ** 2, "that is the mean: normalize=False"),
        (lambda image, r: window_sums(image, 2 * r), "the window has 2 radius + 1 pixels a side"),
        (lambda image, r: np.roll(window_sums(image, r), r, 1), "the columns are off: cut `radius` off on both sides"),
        (lambda image, r: window_sums(image.T, r).T, "rows and columns are swapped: columns wrap"),
    ],
    picture=lambda: (np.nan_to_num(beside.gray()[0]), 3),
)


def zncc_costs(a, b, radius):
    """Costs (1 - ZNCC) / 2 of two warped images (H, W), each over the window around it; NaN where not both see."""
    both = np.isfinite(a) & np.isfinite(b)
    a, b = np.where(both, a, 0.0), np.where(both, b, 0.0)
    count = np.maximum(window_sums(both.astype(float), radius), 1)
    mean_a, mean_b = window_sums(a, radius) / count, window_sums(b, radius) / count
    covariance = window_sums(a * b, radius) / count - mean_a * mean_b
    variance_a = window_sums(a * a, radius) / count - mean_a**2
    variance_b = window_sums(b * b, radius) / count - mean_b**2
    zncc = covariance / np.sqrt(np.maximum(variance_a * variance_b, 1e-12))
    return np.where(both, (1 - zncc) / 2, np.nan)


def _two_images(rng: Rng, k: int) -> tuple:
    a = rng.normal(1, 1, (7 + k % 3, 12 + k % 4))
    b = 0.6 * a + rng.normal(3, 0.6, a.shape)
    a[:, :3] = b[2:5, 7:9] = np.nan
    b[0, 4:6] = np.nan
    return a, b, 1 + k % 2


def _filled(a: Array, b: Array, radius: int, value: float = 0.0) -> Array:
    """Costs that take what one camera does not see for a gray value."""
    costs = zncc_costs(np.nan_to_num(a, nan=value), np.nan_to_num(b, nan=value), radius)
    return np.where(np.isfinite(a) & np.isfinite(b), costs, np.nan)


def _spoilt(a: Array, b: Array, radius: int) -> Array:
    unseen = window_sums((~np.isfinite(a + b)).astype(float), radius) > 0
    return np.where(unseen, np.nan, zncc_costs(a, b, radius))


check_zncc_costs = Open(
    zncc_costs,
    _two_images,
    [
        (_spoilt, "one NaN spoils its whole window: put 0 for what not both see, and count the rest"),
        (_filled, "0 is a gray value, too: divide the sums by the number of pixels that both cameras see"),
        (lambda *inputs: np.nan_to_num(zncc_costs(*inputs)), "where not both see there is no cost: NaN, not 0"),
        (lambda *inputs: 1 - 2 * zncc_costs(*inputs), "that is ZNCC; the cost is (1 - ZNCC) / 2"),
        (lambda *inputs: 1 - zncc_costs(*inputs), "the sign: a match costs 0"),
        (lambda *inputs: 2 * zncc_costs(*inputs), "1 - ZNCC runs from 0 to 2: divide by 2"),
        (lambda a, b, r: zncc_costs(a, b, 2 * r), "the window has the radius that is given"),
        (lambda a, b, r: zncc_costs(a, b, 4), "the radius is an argument: do not write 4"),
        (lambda a, b, r: zncc_costs(a, b, r)[np.isfinite(a + b)], "return the whole map, with NaN where not both see"),
    ],
    picture=lambda: (*beside.gray()[:2], 4),
)


def mean_of_pairs(costs):
    """Mean (H, W) over camera pairs of costs (pairs, H, W), of those that see the ray; NaN where none does (Eq. 2)."""
    seen = np.isfinite(costs)
    count = seen.sum(axis=0)
    total = np.where(seen, costs, 0).sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _costs_of_pairs(rng: Rng, k: int) -> tuple:
    costs = rng.uniform(0.05, 1, (4 + k % 4, 3, 5 + k % 3))
    costs[rng.uniform(0, 1, costs.shape) < 0.3] = np.nan
    costs[:, 0, 0] = costs[1:, 0, 1] = np.nan  # rays that no pair sees, and one
    costs[0, 0, 1] = 0.4
    return (costs,)


check_mean_of_pairs = Open(
    mean_of_pairs,
    _costs_of_pairs,
    [
        (lambda c: c.mean(0), "a pair that does not see the ray must not spoil the others: leave NaN out"),
        (lambda c: np.nan_to_num(c).mean(0), "divide by the number of pairs that see the ray, not by all"),
        (lambda c: np.nansum(c, 0), "that is the sum; the paper takes the mean"),
        (lambda c: np.nan_to_num(mean_of_pairs(c)), "a ray that no pair sees has no cost: NaN, and not a perfect 0"),
        (lambda c: np.nan_to_num(mean_of_pairs(c), nan=1), "a ray that no pair sees has no cost: NaN"),
        (lambda c: np.nanmean(c, (1, 2)), "that is the mean over the rays; average over the pairs, the first axis"),
        (lambda c: np.nanmean(c), "that is one number; each ray keeps its own"),
        (lambda c: np.nanmin(c, 0), "that is the best pair; the paper takes the mean"),
        (lambda c: np.nanmedian(c, 0), "that is the median; the paper takes the mean"),
    ],
)


def winner(costs):
    """Index (H, W) of the cheapest sphere of each ray, of costs (H, W, N); NaN where no sphere has a cost."""
    filled = np.where(np.isnan(costs), np.inf, costs)
    return np.where(np.isnan(costs).all(axis=-1), np.nan, filled.argmin(axis=-1))


def _a_volume(rng: Rng, k: int) -> tuple:
    costs = rng.uniform(0, 1, (4, 5 + k % 3, 7 + k % 5)).astype(np.float32 if k % 2 else np.float64)
    costs[rng.uniform(0, 1, costs.shape) < 0.2] = np.nan
    costs[0, :2], costs[1, 0] = np.nan, 0.5  # no pair sees two rays; all spheres cost the same on a third
    costs[2, :2] = rng.uniform(0.3, 1, costs[2, :2].shape)
    costs[2, 0, -1], costs[2, 1, 0] = 0.1, 0.2  # the last sphere wins, and the first
    return (costs,)


check_winner = Open(
    winner,
    _a_volume,
    [
        (lambda c: np.argmin(c, -1), "np.argmin takes NaN for the smallest of all: put infinity for it"),
        (lambda c: np.nan_to_num(winner(c)), "a ray that no pair sees has no index: NaN, and not sphere 0"),
        (lambda c: winner(-c), "that is the dearest sphere; a match costs little"),
        (lambda c: winner(c) + 1, "spheres count from 0"),
        (lambda c: c.shape[-1] - 1 - winner(c[..., ::-1]), "of equal costs the first wins, as in np.argmin"),
        (lambda c: c.shape[-1] - 1 - winner(c), "sphere 0 is the one at infinity: the wrong way round"),
        (lambda c: np.fmin.reduce(c, axis=-1), "that is the lowest cost; return the sphere that has it"),
        (lambda c: winner(np.moveaxis(c, 0, -1)), "the wrong axis: the spheres are the last one"),
        (lambda c: winner(c.reshape(-1)), "that is one number: each ray has its own winner"),
    ],
)
