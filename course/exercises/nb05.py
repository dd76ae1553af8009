"""Notebook 05: one step of SGM, paths around the panorama, the refined winner, its trust."""

import numpy as np

from course.exercises import beside
from course.exercises.compare import Rng
from course.exercises.opened import Open


def step(cost, before, p1, p2):
    """Path costs of rays (…, N), from their costs and the path costs of the rays before them, both
    (…, N)."""
    lowest = before.min(axis=-1, keepdims=True)
    ends = np.full_like(lowest, np.inf)  # sphere 0 has no neighbour below, sphere N - 1 none above
    below = np.concatenate([ends, before[..., :-1]], axis=-1)
    above = np.concatenate([before[..., 1:], ends], axis=-1)
    neighbour = np.minimum(below, above) + p1
    return cost + np.minimum(np.minimum(before, neighbour), lowest + p2) - lowest


def _a_step(rng: Rng, k: int) -> tuple:
    shape = (int(rng.integers(8, 14)),) if k % 2 else (3, int(rng.integers(8, 14)))
    before = 1.2 + rng.uniform(0, 1, shape)
    before[..., -1 if k % 4 < 2 else 0] = 1.15  # a neighbour across the end would be cheap
    before += rng.uniform(0, 1, (*shape[:-1], 1))
    return rng.uniform(0, 1, shape), before, rng.uniform(0.05, 0.15), rng.uniform(0.4, 0.6)


check_step = Open(step, _a_step).with_slips("""
    lowest + p2) - lowest → lowest + p2)  # subtract the lowest path cost before, or the sums grow
    np.concatenate([ends, before[..., :-1]], axis=-1) → np.roll(before, 1, axis=-1)
    np.concatenate([before[..., 1:], ends], axis=-1) → np.roll(before, -1, axis=-1)
    # n ± 1 does not wrap, as np.roll does: pad with inf
    np.minimum(np.minimum(before, neighbour), lowest + p2) → np.minimum(before, neighbour)
    # the jump is missing: the lowest path cost before, plus P2
    lowest + p2) → p2)  # a jump starts at the lowest path cost: add P2 to it
    before.min(axis=-1, keepdims=True) → np.full_like(before[..., :1], before.min())
    # each ray has its own lowest cost: axis=-1, keepdims=True
""")


def sum_of_paths(volume, p1, p2, directions):
    """Path costs (H, W, N) summed over paths through a cost volume (H, W, N), around the seam.

    directions: the step of each path, rows down and columns to the right, such as (0, 1)."""
    total = np.zeros_like(volume)
    for down, right in directions:
        # lines of rays in the order of the walk; columns are lines for three laps
        lines = volume if down else np.concatenate([volume.swapaxes(0, 1)] * 3)
        backwards = (down or right) < 0
        if backwards:
            lines = lines[::-1]
        path = [lines[0]]
        for cost in lines[1:]:
            before = np.roll(path[-1], right if down else 0, axis=0)
            path.append(step(cost, before, p1, p2))
        # the last lap, in the order of the volume
        path = np.stack(path if down else path[-volume.shape[1] :])
        if backwards:
            path = path[::-1]
        total += path if down else path.swapaxes(0, 1)
    return total


def _a_volume(rng: Rng, k: int) -> tuple:
    directions = rng.permutation(beside.EIGHT)[: 2 if k % 4 == 3 else 8].tolist()
    # wide: two laps and three agree
    return rng.uniform(0, 1, (5 + k % 3, 24 + k % 4, 5)), 0.1, 0.3, directions


check_sum_of_paths = Open(
    sum_of_paths, _a_volume, real=lambda: (*beside.volume(), beside.EIGHT)
).with_slips("""
    path = path[::-1] → path = path  # up and to the left: reverse the lines, walk, reverse back
    path[-1] → lines[len(path) - 1]  # look at the path costs, not at the costs
    right if down else 0, axis=0 → right if down else 0
    # without an axis np.roll takes all numbers for one long row: axis=0
    np.roll(path[-1], right if down else 0, axis=0)
    → np.pad(path[-1], ((1, 1), (0, 0)), "edge")[1 - (right if down else 0) :][: len(cost)]
    # the rays go around the seam: np.roll, with nothing kept
    path[-volume.shape[1] :] → path[: volume.shape[1]]
    # the rows begin at the seam: go around more than once, and keep the last time
""")


def refined(costs):
    """Index (H, W) of the cheapest sphere of each ray (H, W, N), with the offset of a parabola;
    whole at the ends."""
    n = costs.argmin(axis=-1)
    inner = np.clip(n, 1, costs.shape[-1] - 2)[..., None]
    left, middle, right = (
        np.take_along_axis(costs, inner + k, axis=-1)[..., 0] for k in (-1, 0, 1)
    )
    offset = (left - right) / (2 * (left - 2 * middle + right))
    return np.where(n == inner[..., 0], n + offset, n)


def _some_costs(rng: Rng, k: int) -> tuple:
    costs = rng.uniform(0.2, 1, (3, 4 + k % 3, 6 + k % 5)).astype(
        np.float32 if k % 2 else np.float64
    )
    costs[0, 0, 0] = costs[0, 1, -1] = 0.1  # the first sphere wins, and the last
    return (costs,)


check_refined = Open(refined, _some_costs, real=beside.costs).with_slips("""
    n + offset, n) → n - offset, n)  # the sign: the vertex lies towards the cheaper neighbour
    / (2 * (left - 2 * middle + right)) → / (left - 2 * middle + right)
    # the 2 below the line is missing
    np.where(n == inner[..., 0], n + offset, n) → n  # that is the cheapest sphere: add the offset
    n + offset, n) → offset, 0)  # that is the offset: add it to the cheapest sphere
    np.where(n == inner[..., 0], n + offset, n) → inner[..., 0] + offset
    # at the first and the last sphere there is no parabola: the winner stays whole
""")


def mean_error_of_the_rest(error, confidence, fractions):
    """Mean error after the least confident of n rays are removed, int(fraction n) of them, for each
    fraction."""
    known = np.isfinite(error) & np.isfinite(confidence)
    ranked = error[known][np.argsort(confidence[known])]  # the least confident first
    return np.array([ranked[int(fraction * len(ranked)) :].mean() for fraction in fractions])


def _errors(rng: Rng, k: int) -> tuple:
    confidence = rng.uniform(0, 1, (5, 8 + k % 4))
    error = rng.exponential(3, confidence.shape) * (1.3 - confidence)
    error[0, :3] = confidence[1, :2] = np.nan
    fractions = np.sort(rng.uniform(0.05, 0.9, 4 + k % 3))
    fractions[0] = 0
    return error, confidence, fractions


check_mean_error_of_the_rest = Open(
    mean_error_of_the_rest, _errors, real=beside.confidences
).with_slips("""
    np.argsort(confidence[known]) → np.argsort(-error[known])
    # that sorts by the error, which only an oracle knows
    error[known][np.argsort(confidence[known])] → error[known]
    # nothing is sorted: np.argsort(confidence)
    int(fraction * len(ranked)) : → : int(fraction * len(ranked))
    # those are the rays removed: return the rest's mean
    .mean() for → .sum() / len(ranked) for  # divide by the number of rays that remain
""")
