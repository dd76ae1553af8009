"""Students of the exercises on errors: what each checker says, and to which answer.

Each list has (words, answer): "right", or words of the hint.
"""

import math
from itertools import pairwise
from statistics import fmean


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
