"""Notebook 16: the correlation of all cameras, a volume doubled, its loss, the read-out, and a
table of reliability."""

import numpy as np
import torch
from torch.nn.functional import interpolate

from course.exercises.compare import Rng
from course.exercises.opened import Open
from omnistereo_lib.stereo.volumenet import wrap


def correlation(f):
    """Mean product (…, 8) over all pairs of cameras that see a cell, of features (cameras, …, 32);
    NaN: not seen."""
    k = (~f[..., :1].isnan()).sum(0)  # cameras that see the cell, (…, 1)
    f = f.nan_to_num()
    products = f.sum(0) ** 2 - (f**2).sum(0)  # all pairs i ≠ j, (…, 32); 0 where k < 2
    return (products / (k * (k - 1)).clamp(min=1)).unflatten(-1, (8, 4)).mean(-1)


def _some_cells(rng: Rng, k: int) -> tuple:
    f = rng.normal(0.4, 1, (4 + k % 3, 3, 4 + k % 4, 32))
    f[rng.uniform(0, 1, f.shape[:3]) < 0.3] = np.nan
    f[:, 0, 0] = f[1:, 0, 1] = f[2:, 0, 2] = np.nan  # cells that no camera, one, and two see
    f[0, 0, 1:3], f[1, 0, 2], f[:3, 0, 3] = 0.7, 0.9, 0.5
    return (torch.from_numpy(f),)


check_correlation = Open(correlation, _some_cells).with_slips("""
    - (f**2).sum(0) →  # that includes each camera with itself: subtract the sum of the squares
    unflatten(-1, (8, 4)).mean(-1) → unflatten(-1, (4, 8)).mean(-2)
    # a group is four channels that follow each other: the first is 0, 1, 2, 3
""")


def double(x):
    """Double columns, rows and spheres of a volume (B, C, W, H, N), interpolated between cells,
    around the seam too."""
    wider = wrap(x)  # (B, C, W + 2, H, N)
    return interpolate(wider, scale_factor=2, mode="trilinear")[:, :, 2:-2]


def _a_volume(rng: Rng, k: int) -> tuple:
    return (torch.from_numpy(rng.normal(0, 1, (1 + k % 2, 2, 4 + k % 3, 3 + k % 2, 5 - k % 2))),)


check_double = Open(double, _a_volume).with_slips("""
    wrap(x) → x
    [:, :, 2:-2] →
    # the columns at ±180° have neighbours on the other side: wrap first, crop afterwards
    [:, :, 2:-2] →  # wrapped, the volume has a column more on either side: crop them, doubled
    2:-2 → 1:-1  # one column on either side becomes two: crop two
    "trilinear" → "nearest"  # that repeats each cell: interpolate between them (trilinear)
    "trilinear" → "trilinear", align_corners=True
    # align_corners=True stretches the grid: cells are areas, leave it out
""")


def cross_entropy(scores, index):
    """Mean cross-entropy of scores (rays, N) with true indices (rays,), each divided between the
    spheres next to it."""
    log_p = scores.log_softmax(-1)
    lower = index.floor().clamp(max=scores.shape[-1] - 2).long()
    share = index - lower  # of the sphere above
    rays = torch.arange(len(index))
    return -((1 - share) * log_p[rays, lower] + share * log_p[rays, lower + 1]).mean()


def _some_scores(rng: Rng, k: int) -> tuple:
    rays, N = 6 + k, 8 + k % 4
    index = rng.uniform(0, N - 1, rays)
    index[:2] = 0, N - 1
    return torch.from_numpy(rng.normal(0, 2, (rays, N))).requires_grad_(), torch.from_numpy(index)


check_cross_entropy = Open(cross_entropy, _some_scores).with_slips("""
    share = index - lower → share = 1 - index + lower
    # the nearer sphere gets the larger share: they are swapped
    scores.log_softmax(-1) → scores.softmax(-1)  # the logarithm is missing: log_softmax
    scores.log_softmax(-1) → scores
    # the scores are not logarithms of probabilities yet: log_softmax over the spheres
    .mean() → .sum()  # that is the sum; take the mean over the rays
""")


def read_out(p, radius):
    """Sphere index (…) of probabilities (…, N): their mean over the best sphere and `radius` on
    either side."""
    n = torch.arange(p.shape[-1])
    best = p.argmax(-1, keepdim=True)
    near = p * ((n - best).abs() <= radius)  # fewer at the ends
    return (near * n).sum(-1) / near.sum(-1)


def _some_rays(rng: Rng, k: int) -> tuple:
    N = 14 + k % 5
    p = rng.uniform(0.2, 1, (2, 4 + k % 3, N))
    for place, best in zip(
        np.ndindex(p.shape[:2]), [1, N - 2, *rng.integers(5, N - 5, 20)], strict=False
    ):
        p[place][best] = 1.5
    p /= p.sum(-1, keepdims=True)
    return torch.from_numpy(p[0, 0] if k == 9 else p), N if k == 8 else 1 + k % 3


check_read_out = Open(read_out, _some_rays).with_slips("""
    return (p * torch.arange(p.shape[-1])).sum(-1)
    # that is the mean over all spheres, which may lie between two surfaces
    return p.argmax(-1)  # that is the best sphere: take the mean around it
    near = p * → near = 1.0 *  # that is the middle of the spheres: weight each by its probability
    / near.sum(-1) →  # the probabilities around the best do not add up to 1: divide by their sum
""")


def reliability(confidence, right, edges):
    """For each bin between edges (bins + 1,): rays, mean confidence, share right, its standard
    error, (bins, 4).

    confidence: in [0, 1]; right: True or False; both of any shape. NaN where a bin has no ray.
    """
    table = []
    for k in range(len(edges) - 1):
        low, high = edges[k : k + 2]
        inside = (confidence >= low) & (confidence < high)
        if k == len(edges) - 2:
            inside |= confidence == high  # the last bin holds its end
        n = np.sum(inside)
        if n == 0:
            table.append([0, np.nan, np.nan, np.nan])
            continue
        share = np.mean(right[inside])
        table.append([n, np.mean(confidence[inside]), share, np.sqrt(share * (1 - share) / n)])
    return np.array(table)


def _some_judgements(rng: Rng, k: int) -> tuple:
    edges = np.linspace(0, 1, 5 + k % 3)
    confidence = rng.uniform(0, 1, (6, 20)) if k % 2 else rng.uniform(0.3, 1, 90) ** 0.5
    confidence.flat[:4] = 1, edges[2], edges[-2], 1
    confidence[(confidence > edges[1]) & (confidence < edges[2])] = edges[2]  # an empty bin
    return confidence, rng.uniform(size=confidence.shape) < confidence**2, edges


check_reliability = Open(reliability, _some_judgements, whole=("confidence", "right")).with_slips(
    """
    inside |= confidence == high → pass
    # a ray of confidence 1 is in no bin: the last bin holds its end
    inside = (confidence >= low) & (confidence < high)
    → inside = (confidence > low) & (confidence <= high)
    # a confidence on an edge belongs to the bin above it
    np.mean(confidence[inside]) → (low + high) / 2
    # the mean confidence of the rays in the bin, not its middle
    np.sqrt(share * (1 - share) / n) → np.sqrt(share * (1 - share))
    # that is the deviation of one ray; the share of n rays is uncertain by the n-th part under the
    # root
    np.sqrt(share * (1 - share) / n) → share * (1 - share) / n
    # that is the variance of the share: take the root
"""
)
