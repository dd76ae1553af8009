"""Notebook 07: one step of SGM, a walk over lines, eight paths around the panorama, the refined winner, its trust."""

import numpy as np

from course.exercises.compare import Array, Rng
from course.exercises.opened import Open


def step(cost, before, p1, p2):
    """Path costs of rays (…, N), from their costs and the path costs of the rays before them, both (…, N)."""
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


def _step(cost: Array, before: Array, p1: float, p2: float, best: Array, ends: str = "inf") -> Array:
    """A step with another best sphere before, or with other neighbours at the ends."""
    below, above = np.roll(before, 1, -1), np.roll(before, -1, -1)
    if ends == "inf":
        below[..., 0] = above[..., -1] = np.inf
    return cost + np.minimum(np.minimum(before, np.minimum(below, above) + p1), best + p2) - best


def _lowest(values: Array) -> Array:
    return values.min(-1, keepdims=True)


check_step = Open(
    step,
    _a_step,
    [
        (
            lambda c, b, p1, p2: step(c, b, p1, p2) + _lowest(b),
            "subtract the lowest path cost before, or the sums grow",
        ),
        (lambda c, b, p1, p2: step(c, b, p2, p1), "P1 is for a step of one sphere, P2 for a jump: they are swapped"),
        (
            lambda c, b, p1, p2: _step(c, b, p1, p2, _lowest(b), "wrap"),
            "n ± 1 does not wrap, as np.roll does: pad with inf",
        ),
        (
            lambda c, b, p1, p2: c + step(0 * c, b, p1, np.inf),
            "the jump is missing: the lowest path cost before, plus P2",
        ),
        (lambda c, b, p1, p2: step(c, b, np.inf, p2), "the neighbours are missing: n - 1 and n + 1, plus P1"),
        (
            lambda c, b, p1, p2: _step(c, b, p1, p2, 0 * b) - _lowest(b),
            "a jump starts at the lowest path cost: add P2 to it",
        ),
        (
            lambda c, b, p1, p2: _step(c, b, p1, p2, _lowest(c)),
            "the lowest of the path costs before, not of this ray's costs",
        ),
        (lambda c, b, p1, p2: _step(c, b, p1, p2, b.min()), "each ray has its own lowest cost: axis=-1, keepdims=True"),
        (lambda c, b, p1, p2: step(c, b, p1, p2) - c, "add the ray's own cost"),
    ],
)


def walk(costs, shift, p1, p2):
    """Path costs (lines, rays, N): each line looks at the one before, rolled by `shift` rays around the seam."""
    lines = [costs[0]]
    for cost in costs[1:]:
        before = np.roll(lines[-1], shift, axis=0)
        lines.append(step(cost, before, p1, p2))
    return np.stack(lines)


def _some_lines(rng: Rng, k: int) -> tuple:
    costs = rng.uniform(0, 1, (4 + k % 3, 5 + k % 4, 6))
    return costs, (-1, 1, 0)[k % 3], 0.1, 0.35


def _walk(costs: Array, shift: int, p1: float, p2: float, before=None) -> Array:
    """A walk whose lines look at something else before them."""
    lines = [costs[0]]
    for k, cost in enumerate(costs[1:]):
        lines.append(step(cost, before(costs, lines, k, shift), p1, p2))
    return np.stack(lines)


def _no_wrap(costs: Array, lines: list, k: int, shift: int) -> Array:
    rolled = np.roll(lines[-1], shift, 0)
    return np.concatenate([lines[-1][:1], rolled[1:]]) if shift > 0 else rolled


check_walk = Open(
    walk,
    _some_lines,
    [
        (lambda c, s, *p: walk(c, -s, *p), "rolled the wrong way: np.roll by +1 puts ray x - 1 in the place of ray x"),
        (lambda c, s, *p: walk(c, 0, *p), "the line before is rolled by `shift`"),
        (
            lambda c, s, *p: _walk(c, s, *p, lambda c, lines, k, s: np.roll(c[k], s, 0)),
            "look at the path costs, not at the costs",
        ),
        (
            lambda c, s, *p: _walk(c, s, *p, lambda c, lines, k, s: np.roll(lines[0], s, 0)),
            "look at the line before, not at the first",
        ),
        (
            lambda c, s, *p: _walk(c, s, *p, lambda c, lines, k, s: np.roll(lines[-1], s, 1)),
            "roll the rays, axis 0, not the spheres",
        ),
        (lambda c, s, *p: _walk(c, s, *p, _no_wrap), "the rays go around the seam: np.roll, with nothing kept"),
        (lambda c, s, p1, p2: walk(c, s, p2, p1), "P1 and P2 are swapped"),
        (lambda c, s, *p: walk(c, s, *p)[1:], "the first line belongs to the result: its path costs are its costs"),
        (lambda c, s, *p: walk(c, s, *p)[-1], "that is the last line: return all of them"),
        (lambda c, s, *p: walk(c[::-1], s, *p)[::-1], "walk from the first line to the last"),
    ],
)


def sum_of_paths(volume, p1, p2):
    """Path costs (H, W, N) summed over eight paths through a cost volume (H, W, N), around the seam."""
    total = np.zeros_like(volume)
    for shift in (-1, 0, 1):
        total += walk(volume, shift, p1, p2)  # from above
        total += walk(volume[::-1], shift, p1, p2)[::-1]  # from below
    W = volume.shape[1]
    around = np.concatenate([volume.swapaxes(0, 1)] * 3)  # columns as lines, three times around the panorama
    total += walk(around, 0, p1, p2)[-W:].swapaxes(0, 1)  # from the left, the last time around
    total += walk(around[::-1], 0, p1, p2)[-W:][::-1].swapaxes(0, 1)  # from the right
    return total


def _a_volume(rng: Rng, k: int) -> tuple:
    return rng.uniform(0, 1, (5 + k % 3, 24 + k % 4, 5)), 0.1, 0.3  # wide: two laps and three agree


def _paths(
    volume: Array, p1: float, p2: float, downs=(-1, 0, 1), ups=(-1, 0, 1), laps: int = 3, back: bool = True
) -> Array:
    total = sum(walk(volume, s, p1, p2) for s in downs) + sum(walk(volume[::-1], s, p1, p2)[::-1] for s in ups)
    W = volume.shape[1]
    around = np.concatenate([volume.swapaxes(0, 1)] * max(laps, 1))
    rows = [walk(around, 0, p1, p2)[-W:], walk(around[::-1], 0, p1, p2)[-W:][::-1]][: 1 + back]
    return total + sum(row.swapaxes(0, 1) for row in rows if laps)


check_sum_of_paths = Open(
    sum_of_paths,
    _a_volume,
    [
        (lambda *v: _paths(*v, laps=1), "the rows begin at the seam: go around more than once, and keep the last time"),
        (lambda *v: _paths(*v, laps=0), "the paths along the rows are missing: from the left and from the right"),
        (lambda *v: _paths(*v, back=False), "the path from the right is missing"),
        (lambda *v: _paths(*v, ups=()), "the three paths from below are missing"),
        (lambda *v: _paths(*v, downs=(0,), ups=(0,)), "that is four paths: the diagonals are missing, shifts -1 and 1"),
        (
            lambda *v: _paths(*v, ups=()) + _paths(*v, ups=(), laps=0),
            "from below: reverse the lines, walk, reverse back",
        ),
        (lambda v, *p: _paths(v, *p) - 7 * v, "each path has the ray's own cost in it: leave it there"),
        (lambda *v: _paths(*v) / 8, "that is the mean of the paths; return their sum"),
        (lambda v, p1, p2: _paths(v, p2, p1), "P1 and P2 are swapped"),
    ],
)


def refined(costs):
    """Index (H, W) of the cheapest sphere of each ray (H, W, N), with the offset of a parabola; whole at the ends."""
    n = costs.argmin(axis=-1)
    inner = np.clip(n, 1, costs.shape[-1] - 2)[..., None]
    left, middle, right = (np.take_along_axis(costs, inner + k, axis=-1)[..., 0] for k in (-1, 0, 1))
    offset = (left - right) / (2 * (left - 2 * middle + right))
    return np.where(n == inner[..., 0], n + offset, n)


def _some_costs(rng: Rng, k: int) -> tuple:
    costs = rng.uniform(0.2, 1, (3, 4 + k % 3, 6 + k % 5)).astype(np.float32 if k % 2 else np.float64)
    costs[0, 0, 0] = costs[0, 1, -1] = 0.1  # the first sphere wins, and the last
    return (costs,)


def _at_ends(costs: Array, value: float) -> Array:
    n = costs.argmin(-1)
    return np.where((n == 0) | (n == costs.shape[-1] - 1), value, refined(costs))


check_refined = Open(
    refined,
    _some_costs,
    [
        (lambda c: 2 * c.argmin(-1) - refined(c), "the sign: the vertex lies towards the cheaper neighbour"),
        (lambda c: 2 * refined(c) - c.argmin(-1), "the 2 below the line is missing"),
        (lambda c: (refined(c) + c.argmin(-1)) / 2, "that is half the offset: 2 (l - 2c + r) is below the line"),
        (lambda c: c.argmin(-1), "that is the cheapest sphere: add the offset"),
        (lambda c: refined(c) - c.argmin(-1), "that is the offset: add it to the cheapest sphere"),
        (lambda c: _at_ends(c, np.nan), "a winner at the first or last sphere is one, too: it stays whole, not NaN"),
        (lambda c: _at_ends(c, 0), "a winner at the last sphere stays there"),
        (lambda c: refined(c[..., 1:-1]) + 1, "the first and the last sphere may win: do not leave them out"),
        (lambda c: refined(-c), "that is the dearest sphere; a match costs little"),
        (lambda c: refined(np.moveaxis(c, 0, -1)), "the wrong axis: the spheres are the last one"),
    ],
)


def mean_error_of_the_rest(error, confidence, fractions):
    """Mean error after the least confident of n rays are removed, int(fraction n) of them, for each fraction."""
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
    mean_error_of_the_rest,
    _errors,
    [
        (
            lambda e, c, f: mean_error_of_the_rest(e, -c, f),
            "that removes the most confident; the least confident go first",
        ),
        (
            lambda e, c, f: mean_error_of_the_rest(e, -e + 0 * c, f),
            "that sorts by the error, which only an oracle knows",
        ),
        (lambda e, c, f: mean_error_of_the_rest(e, 0 * c, f), "nothing is sorted: np.argsort(confidence)"),
        (
            lambda e, c, f: mean_error_of_the_rest(e, c, 1 - f - 1e-9),
            "those are the rays removed: return the rest's mean",
        ),
        (lambda e, c, f: mean_error_of_the_rest(np.nan_to_num(e), c, f), "a ray without an error is not a perfect one"),
        (lambda e, c, f: mean_error_of_the_rest(e, c, f) * (1 - f), "divide by the number of rays that remain"),
        (
            lambda e, c, f: np.array([np.nanmean(e[c >= x]) for x in f]),
            "remove a fraction of the rays, not all below it",
        ),
        (lambda e, c, f: mean_error_of_the_rest(e, c, f) * np.nan, "leave rays out whose error or confidence is NaN"),
        (lambda e, c, f: mean_error_of_the_rest(e, c, f).mean(), "that is one number: one for each fraction"),
    ],
)
