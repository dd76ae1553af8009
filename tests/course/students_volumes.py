"""Students of notebook 12: what each checker says, and to which answer.

Each list has (words, answer): "right", or words of the hint.
"""

from itertools import permutations

import numpy as np


def visible(f):
    return f[~np.isnan(f[:, 0])]


def by_pairs(f):
    return np.mean([a * b for a, b in permutations(visible(f), 2)], axis=0)


def count(f):
    return len(visible(f))


CORRELATION = [
    ("right", by_pairs),
    ("right", lambda f: (np.nansum(f, 0) ** 2 - np.nansum(f**2, 0)) / count(f) / (count(f) - 1)),
    ("leave its row out", lambda f: (f.sum(0) ** 2 - (f**2).sum(0)) / (len(f) * (len(f) - 1))),
    ("not of all", lambda f: (np.nansum(f, 0) ** 2 - np.nansum(f**2, 0)) / (len(f) * (len(f) - 1))),
    ("with itself", lambda f: np.nanmean(f, 0) ** 2),
    ("with itself", lambda f: np.nansum(f, 0) ** 2 / (count(f) * (count(f) - 1))),
    ("divide by their number", lambda f: np.nansum(f, 0) ** 2 - np.nansum(f**2, 0)),
    ("both in the sum", lambda f: by_pairs(f) / 2),
    ("not k²", lambda f: by_pairs(f) * (count(f) - 1) / count(f)),
    ("each keeps its own", lambda f: by_pairs(f).mean()),
]


def window(p, low=2, high=2):
    best = int(np.argmax(p))
    return range(max(best - low, 0), min(best + high + 1, len(p)))


def mean_of(p, spheres):
    return sum(p[n] * n for n in spheres) / sum(p[n] for n in spheres)


LOCAL_MEAN = [
    ("right", lambda p: mean_of(p, window(p))),
    ("right", lambda p: np.average(window(p), weights=p[list(window(p))])),
    ("over all spheres", lambda p: p @ np.arange(len(p))),
    ("the best sphere:", lambda p: p.argmax()),
    ("not one", lambda p: mean_of(p, window(p, 1, 1))),
    ("leaves out its end", lambda p: mean_of(p, window(p, 2, 1))),
    ("divide by their sum", lambda p: sum(p[n] * n for n in window(p))),
    ("weighted by its probability", lambda p: np.mean(window(p))),
    ("offset from the best", lambda p: mean_of(p, window(p)) - p.argmax()),
    ("counts from sphere 0", lambda p: mean_of(p, window(p)) - window(p)[0]),
    ("confidence", lambda p: sum(p[n] for n in window(p))),
]


def shares(index, N, first=0, swap=False, halves=False):
    target = np.zeros(N + 3)
    share = 0.5 if halves else index % 1
    target[int(index) + first : int(index) + first + 2] = (share, 1 - share) if swap else (1 - share, share)
    return target[:N]


TARGET = [
    ("right", shares),
    ("right", lambda index, N: np.interp(np.arange(N), [index - 1, index, index + 1], [0, 1, 0])),
    ("nearest sphere alone", lambda index, N: np.eye(N)[round(index)]),
    ("swapped", lambda index, N: shares(index, N, swap=True)),
    ("half to each", lambda index, N: shares(index, N, halves=True)),
    ("too low", lambda index, N: [*shares(index, N)[1:], 0]),
    ("too high", lambda index, N: shares(index, N, first=1)),
]
