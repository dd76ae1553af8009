"""Checkers of notebook 12: functions on arrays, tried on many random inputs."""

import numpy as np

from course.exercises.compare import Case, Rng, checker


@checker
def check_correlation(rng: Rng, k: int) -> Case:
    """12.1: the mean product over all pairs of different cameras that see a cell, for each channel."""
    f = rng.normal(0.4, 1, (rng.integers(4, 8), 3 + k))
    f[rng.choice(len(f), rng.integers(1, len(f) - 2), replace=False)] = np.nan
    seen = f[~np.isnan(f[:, 0])]
    k, total, squares = len(seen), seen.sum(0), (seen**2).sum(0)
    pairs = total**2 - squares
    return (
        (f,),
        pairs / (k * (k - 1)),
        [
            (np.full(f.shape[1], np.nan), "a camera that does not see the cell is NaN: leave its row out"),
            (pairs / (len(f) * (len(f) - 1)), "k is the number of cameras that see the cell, not of all"),
            (total**2 / k**2, "that includes each camera with itself: subtract the sum of the squares"),
            (total**2 / (k * (k - 1)), "that includes each camera with itself: subtract the sum of the squares"),
            (pairs, "that is the sum over the pairs: divide by their number, k (k - 1)"),
            (pairs / (2 * k * (k - 1)), "i, j and j, i are both in the sum: their number is k (k - 1)"),
            (pairs / k**2, "there are k (k - 1) pairs of different cameras, not k²"),
            (np.mean(pairs / (k * (k - 1))), "that is the mean over the channels, too: each keeps its own"),
        ],
    )


@checker
def check_local_mean(rng: Rng, k: int) -> Case:
    """12.2: the mean sphere of the most probable one and up to two on either side (a local soft-argmax)."""
    N = int(rng.integers(12, 30))
    best = (1, N - 2)[k - 1] if 0 < k < 3 else int(rng.integers(3, N - 3))
    p = rng.uniform(0.2, 1, N)
    p[best] = 1.5
    p /= p.sum()
    n = np.arange(N)

    def mean(low: int, high: int) -> float:
        inside = slice(max(low, 0), high)
        return float(p[inside] @ n[inside] / p[inside].sum())

    right = mean(best - 2, best + 3)
    near = slice(max(best - 2, 0), best + 3)
    return (
        (p,),
        right,
        [
            (float(p @ n), "that is the mean over all spheres, which lies between two surfaces"),
            (float(best), "that is the best sphere: take the mean around it, each sphere weighted by its probability"),
            (
                n[near].mean(),
                "that is the best sphere: take the mean around it, each sphere weighted by its probability",
            ),
            (mean(best - 1, best + 2), "two spheres on either side, not one"),
            (mean(best - 2, best + 2), "a slice leaves out its end: best - 2 … best + 2 are five spheres"),
            (float(p[near] @ n[near]), "the five probabilities do not add up to 1: divide by their sum"),
            (right - best, "that is the offset from the best sphere: add it"),
            (right - max(best - 2, 0), "the index counts from sphere 0, not from the first of the five"),
            (float(p[near].sum()), "that is the confidence; return the index"),
        ],
    )


@checker
def check_target(rng: Rng, k: int) -> Case:
    """12.3: target probabilities of a ray, its true index divided between the two spheres next to it."""
    N = int(rng.integers(6, 20))
    # First in general position; then the ends and a whole index, where one sphere gets it all.
    index = {1: N - 1.0, 2: 0.0, 3: 4.0}.get(k, float(rng.uniform(1.1, 1.4) + rng.integers(0, N - 3)))
    n, lower = np.arange(N), int(index)
    share = index - lower
    swapped = np.where(n == lower, share, np.where(n == lower + 1, 1 - share, 0.0))
    return (
        (index, N),
        np.maximum(0, 1 - np.abs(n - index)),
        [
            ((n == round(index)) * 1.0, "that is the nearest sphere alone: the one above gets its share, too"),
            (swapped, "the nearer sphere gets the larger share: they are swapped"),
            (np.where((n == lower) | (n == lower + 1), 0.5, 0.0), "half to each is right in the middle only"),
            (np.where(n == lower - 1, 1 - share, np.where(n == lower, share, 0.0)), "one sphere too low"),
            (np.where(n == lower + 1, 1 - share, np.where(n == lower + 2, share, 0.0)), "one sphere too high"),
        ],
    )
