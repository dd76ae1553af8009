"""Students of the exercises on errors: what each checker says, and to which answer.

Each list has (words, answer): "right", or words of the hint.
"""

import math
from itertools import pairwise
from statistics import fmean

import numpy as np


def share_of(error, limit, wrong):
    """Percent of rays, row by row, that `wrong` says are."""
    judged = [wrong(x, limit) for row in error.tolist() for x in row]
    return 100 * judged.count(True) / len(judged)


SHARE_ABOVE = [
    ("right", lambda error, limit: share_of(error, limit, lambda x, limit: not x <= limit)),
    ("right", lambda error, limit: np.float32(100 - 100 * np.mean(error <= limit))),
    ("a fraction", lambda error, limit: np.mean(~(error <= limit))),
    ("NaN is False", lambda error, limit: share_of(error, limit, lambda x, limit: x > limit)),
    ("not left out", lambda error, limit: 100 * np.mean(error[np.isfinite(error)] > limit)),
    ("still right", lambda error, limit: 100 * np.mean(~(error < limit))),
    ("that are right", lambda error, limit: 100 * np.mean(error <= limit)),
    ("their number", lambda error, limit: int(np.sum(~(error <= limit)))),
    ("of each row", lambda error, limit: 100 * np.mean(~(error <= limit), axis=-1)),
]


def errors_like(rays, sums, squares):
    """Errors e ≥ 0 of all frames together, with these sums: half of a frame's rays on each side of its mean."""
    errors = []
    for n, total, square in zip(rays, sums, squares, strict=True):
        mean = total / n
        spread = math.sqrt(square / n - mean**2)
        errors += [mean - spread] * int(n / 2) + [mean + spread] * int(n / 2)
    return np.array(errors)


POOLED_RMS = [
    ("right", lambda rays, sums, squares: math.sqrt(fmean(errors_like(rays, sums, squares) ** 2))),
    ("right", lambda rays, sums, squares: np.sqrt(np.average(squares / rays, weights=rays))),
    ("take the root", lambda rays, sums, squares: sum(squares) / sum(rays)),
    ("counts too much", lambda rays, sums, squares: fmean(np.sqrt(squares / rays))),
    ("add up first", lambda rays, sums, squares: math.sqrt(fmean(squares / rays))),
    ("divide by the number", lambda rays, sums, squares: math.sqrt(sum(squares))),
    ("under the root", lambda rays, sums, squares: math.sqrt(sum(squares)) / sum(rays)),
    ("each frame's", lambda rays, sums, squares: (squares / rays) ** 0.5),
    ("the mean error", lambda rays, sums, squares: fmean(errors_like(rays, sums, squares))),
    ("standard deviation", lambda rays, sums, squares: np.std(errors_like(rays, sums, squares))),
]


def standard_error_loops(a, b, n_of=lambda n: n - 1, last=math.sqrt):
    differences = [x - y for x, y in zip(a.tolist(), b.tolist(), strict=True)]
    squares = sum((d - fmean(differences)) ** 2 for d in differences)
    return math.sqrt(squares / n_of(len(differences))) / last(len(differences))


STANDARD_ERROR = [
    ("right", standard_error_loops),
    ("right", lambda a, b: np.sqrt(np.cov(a - b) / len(a))),
    ("spread of single frames: the mean", lambda a, b: standard_error_loops(a, b, last=lambda n: 1)),
    ("not by n", lambda a, b: standard_error_loops(a, b, last=lambda n: n)),
    ("its square", lambda a, b: np.cov(a - b) / len(a)),
    ("n - 1 in the variance", lambda a, b: standard_error_loops(a, b, n_of=lambda n: n)),
    ("with n in place", lambda a, b: (a - b).std()),
    ("then look at the spread", lambda a, b: math.sqrt(sum(np.cov(x) for x in (a, b)) / len(a))),
    ("frame by frame first", lambda a, b: np.hypot(a.std(), b.std()) / len(a) ** 0.5),
    ("of a alone", lambda a, b: standard_error_loops(a, 0 * b)),
    ("the mean difference", lambda a, b: a.mean() - b.mean()),
    ("one number is asked", lambda a, b: a - b),
]


def share_loops(mask, low, high, first=0.5, step=None, cos=math.cos, part=1.0, every=True):
    """The share by adding up pixels; `first` and `step`: where rows lie."""
    covered = total = 0.0
    for k, row in enumerate(mask.tolist()):
        weight = cos(math.radians(low + (k + first) * (high - low) / (step or len(mask))))
        covered += weight * sum(row)
        total += weight * (len(row) if every else 1)
    return part * covered / total


def exact_bands(mask, low, high):
    """The area of each band of rows by Archimedes, which cos of the middle approaches to one common factor."""
    edges = [math.sin(math.radians(low + k * (high - low) / len(mask))) for k in range(len(mask) + 1)]
    areas = [b - a for a, b in pairwise(edges)]
    return sum(area * fmean(row) for area, row in zip(areas, mask.tolist(), strict=True)) / sum(areas)


def share_sum(mask, low, high):
    middles = [low + (k + 0.5) * (high - low) / len(mask) for k in range(len(mask))]
    return sum(math.cos(math.radians(m)) * sum(row) for m, row in zip(middles, mask.tolist(), strict=True))


SHARE_OF_SPHERE = [
    ("right", share_loops),
    ("right", exact_bands),
    ("share of the pixels", lambda mask, low, high: fmean(mask.ravel().tolist())),
    ("in percent", lambda mask, low, high: share_loops(mask, low, high, part=100)),
    ("half a pixel inside", lambda mask, low, high: share_loops(mask, low, high, first=0, step=len(mask) - 1)),
    ("wants radians", lambda mask, low, high: share_loops(mask, low, high, cos=lambda x: math.cos(math.degrees(x)))),
    ("not sin φ", lambda mask, low, high: share_loops(mask, low, high, cos=math.sin)),
    ("by the sum of all weights, not", lambda mask, low, high: share_sum(mask, low, high) / mask.size),
    ("divide by the sum of all of them", lambda mask, low, high: share_sum(mask, low, high)),
    ("once for every pixel", lambda mask, low, high: share_loops(mask, low, high, every=False)),
]


def risk(agree, wrong, group):
    """Share of wrong rays among those that agree, or do not, counted one by one."""
    chosen = [w for a, w in zip(agree.ravel(), wrong.ravel(), strict=True) if a == group]
    return sum(chosen) / len(chosen)


RISK_RATIO = [
    ("right", lambda agree, wrong: risk(agree, wrong, False) / risk(agree, wrong, True)),
    ("right", lambda agree, wrong: (wrong & ~agree).sum() / (~agree).sum() * agree.sum() / (wrong & agree).sum()),
    ("other way round", lambda agree, wrong: risk(agree, wrong, True) / risk(agree, wrong, False)),
    ("shares; divide", lambda agree, wrong: risk(agree, wrong, False) - risk(agree, wrong, True)),
    ("in percent", lambda agree, wrong: 100 * (risk(agree, wrong, False) - risk(agree, wrong, True))),
    ("numbers of rays", lambda agree, wrong: np.sum(wrong & ~agree) / np.sum(wrong & agree)),
    ("not with all", lambda agree, wrong: risk(agree, wrong, False) / np.mean(wrong)),
    ("divide by that", lambda agree, wrong: risk(agree, wrong, False)),
    ("split them by agreement", lambda agree, wrong: risk(wrong, agree, False) / risk(wrong, agree, True)),
]
