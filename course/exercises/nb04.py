"""Notebook 04: ZNCC of two patches, sums over windows, the costs of a pair, the mean of all pairs,
the best sphere."""

import cv2
import numpy as np

from course.exercises import beside
from course.exercises.compare import Rng
from course.exercises.opened import Open


def zncc(a, b):
    """Zero-mean normalised cross-correlation of two patches of equal shape, -1 to 1; 0 if one of
    them is flat."""
    covariance = np.mean((a - a.mean()) * (b - b.mean()))
    deviations = a.std() * b.std()
    return covariance / deviations if deviations > 1e-12 else 0.0


def _two_patches(rng: Rng, k: int) -> tuple:
    a = rng.normal(3, 2, (5 + 2 * (k % 3), 9))
    b = (-1) ** k * 0.4 * a + rng.normal(1, 0.5, a.shape)
    flat = np.full(a.shape, 7.0)
    return {8: (flat, b), 9: (a, flat)}.get(k, (a, b))


check_zncc = Open(zncc, _two_patches).with_slips("""
    covariance / deviations if deviations > 1e-12 else 0.0 → covariance / deviations
    # a flat patch divides 0 by 0: return 0 for it
    covariance / deviations if deviations > 1e-12 else 0.0
    → (1 - covariance / deviations) / 2 if deviations > 1e-12 else 0.5
    # that is the cost; return ZNCC itself, 1 for a match
    (a - a.mean()) * (b - b.mean()) → a * b  # subtract the mean of each patch first (the Z of ZNCC)
    covariance / deviations if → covariance if  # divide by both standard deviations (the N of ZNCC)
    np.mean(( → np.sum((  # sum and mean are mixed: take the mean of the products
""")


def window_sums(image, radius):
    """Sums (H, W) over windows of 2 radius + 1 pixels a side; columns wrap around, beyond the rows
    there is nothing."""
    side = 2 * radius + 1
    wide = np.pad(image, ((0, 0), (radius, radius)), mode="wrap")
    sums = cv2.boxFilter(wide, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
    return sums[:, radius:-radius]


def _an_image(rng: Rng, k: int) -> tuple:
    return rng.uniform(0.5, 1, (8 + k % 3, 11 + k % 4)).astype(
        np.float32 if k % 2 else np.float64
    ), 1 + k % 3


check_window_sums = Open(
    window_sums, _an_image, real=lambda: (np.nan_to_num(beside.gray()[0]), 3)
).with_slips("""
    mode="wrap" → mode="constant"  # the panorama is a circle: columns wrap around
    ((0, 0), (radius, radius)) → ((radius, radius), (0, 0))
    sums[:, radius:-radius] → sums[radius:-radius]
    # the columns wrap, axis 1, and the rows do not: that is the other way round
    ((0, 0), (radius, radius)) → radius
    sums[:, radius:-radius] → sums[radius:-radius, radius:-radius]
    # rows do not wrap: above the first one there is nothing
    , borderType=cv2.BORDER_CONSTANT →  # beyond the rows there is nothing: BORDER_CONSTANT
    normalize=False, →  # that is the mean: normalize=False
""")


def zncc_costs(a, b, radius):
    """Costs (1 - ZNCC) / 2 of two warped images (H, W), each over the window around it; NaN where
    not both see."""
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


check_zncc_costs = Open(
    zncc_costs, _two_images, real=lambda: (*beside.gray()[:2], 4), within=1e-3
).with_slips("""
    a, b = np.where(both, a, 0.0), np.where(both, b, 0.0) →
    # one NaN spoils its whole window: put 0 for what not both see, and count the rest
    np.where(both, a, 0.0), np.where(both, b, 0.0) → np.nan_to_num(a), np.nan_to_num(b)
    # only pixels that both cameras see may count, in all five sums
    np.maximum(window_sums(both.astype(float), radius), 1) → (2 * radius + 1) ** 2
    # 0 is a grey value, too: divide the sums by the number of pixels that both cameras see
    (1 - zncc) / 2 → zncc  # that is ZNCC; the cost is (1 - ZNCC) / 2
""")


def mean_of_pairs(costs):
    """Mean (H, W) over camera pairs of costs (pairs, H, W), of those that see the ray; NaN where
    none does (Eq. 2)."""
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


check_mean_of_pairs = Open(mean_of_pairs, _costs_of_pairs).with_slips("""
    return np.nansum(costs, axis=0)  # that is the sum; the paper takes the mean
    return np.nanmin(costs, axis=0)  # that is the best pair; the paper takes the mean
""")


def winner(costs):
    """Index (H, W) of the cheapest sphere of each ray, of costs (H, W, N); NaN where no sphere has
    a cost."""
    filled = np.where(np.isnan(costs), np.inf, costs)
    return np.where(np.isnan(costs).all(axis=-1), np.nan, filled.argmin(axis=-1))


def _a_volume(rng: Rng, k: int) -> tuple:
    costs = rng.uniform(0, 1, (4, 5 + k % 3, 7 + k % 5)).astype(np.float32 if k % 2 else np.float64)
    costs[rng.uniform(0, 1, costs.shape) < 0.2] = np.nan
    # no pair sees two rays; all spheres cost the same on a third
    costs[0, :2], costs[1, 0] = (np.nan, 0.5)
    costs[2, :2] = rng.uniform(0.3, 1, costs[2, :2].shape)
    costs[2, 0, -1], costs[2, 1, 0] = 0.1, 0.2  # the last sphere wins, and the first
    scale = 20 if k % 3 == 1 else 1  # path costs are no shares
    return (np.multiply(costs, scale, dtype=costs.dtype),)


check_winner = Open(winner, _a_volume, real=beside.costs).with_slips("""
    return np.fmin.reduce(costs, axis=-1)  # that is the lowest cost; return the sphere that has it
    axis=-1 → axis=0  # the wrong axis: the spheres are the last one
""")


def suspects(bad, texture_of, index, radius):
    """Rows (4, 2): percent of all rays, and percent of them that are bad (H, W), of all rays, flat
    windows, windows whose index varies, and the rest."""
    # flat: a standard deviation below 2 grey levels; varies: by more than 4 spheres

    def windows(image):  # (H, W, window): columns go around, beyond the rows nothing is known
        wide = np.pad(image, ((0, 0), (radius, radius)), mode="wrap")
        wide = np.pad(wide, ((radius, radius), (0, 0)), constant_values=np.nan)
        side = 2 * radius + 1
        around = np.lib.stride_tricks.sliding_window_view(wide, (side, side))
        return around.reshape(*image.shape, side * side)

    flat = np.nanstd(windows(texture_of), axis=-1) < 2
    indices = windows(index)
    varies = np.nanmax(indices, axis=-1) - np.nanmin(indices, axis=-1) > 4
    groups = (np.ones_like(bad), flat, varies, ~flat & ~varies)
    return np.array([[100 * group.mean(), 100 * bad[group].mean()] for group in groups])


def _a_street(rng: Rng, k: int) -> tuple:
    H, W, radius = 12, 20 + k, 1 + k % 2
    texture_of = rng.normal(100, 8, (H, W))
    texture_of[3:9, 2:9] = 100 + rng.normal(0, 0.5, (6, 7))  # a blank wall
    index = 10 + rng.normal(0, 0.3, (H, W))
    index[:, 12:15] += 9
    bad = rng.uniform(0, 1, (H, W)) < np.where(index > 15, 0.8, 0.3)
    return bad, texture_of, index, radius


check_suspects = Open(suspects, _a_street, whole=("bad", "texture_of", "index")).with_slips("""
    mode="wrap" → constant_values=np.nan
    # the panorama is a circle: its first columns stand in the windows of its last ones
    np.nanstd(windows(texture_of), axis=-1) < 2 → np.nanvar(windows(texture_of), axis=-1) < 2
    # that is the variance: its root is compared with 2 grey levels
    ~flat & ~varies → ~(flat & varies)
    # the rest is neither flat nor varying
    bad[group].mean() → (bad & group).mean()
    # of the rays of the group, not of all
    np.nanstd → np.std  # at the top and the bottom the window ends: leave NaN out
""")
