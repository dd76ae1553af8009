"""Solutions of notebook 12."""

import numpy as np

# --- 12 After SweepNet ------------------------------------------------------------------------------------


def my_correlation(f):
    seen = f[~np.isnan(f).any(axis=1)]
    k = len(seen)
    # (Σ f)² holds every product f_i f_j, i = j included; those are Σ f².
    return (seen.sum(0) ** 2 - (seen**2).sum(0)) / (k * (k - 1))


def my_local_mean(p):
    best = p.argmax()
    n = np.arange(max(best - 2, 0), min(best + 3, len(p)))  # fewer than five at the ends
    return p[n] @ n / p[n].sum()


def my_target(index, N):
    # A sphere at the index gets 1, one at a distance of 1 or more gets nothing: a triangle.
    return np.maximum(0, 1 - np.abs(np.arange(N) - index))
