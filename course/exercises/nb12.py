"""Notebook 12: the correlation of all cameras, a volume doubled, its loss, the read-out, and what hides a point."""

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import interpolate

from course.exercises.compare import Answer, Array, Rng
from course.exercises.opened import Open
from omnistereo_lib.stereo.volumenet import wrap


def correlation(f):
    """Mean product (…, 8) over all pairs of cameras that see a cell, of features (cameras, …, 32); NaN: not seen."""
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


def _pairs(f: Tensor) -> Tensor:
    k = (~f[..., :1].isnan()).sum(0)
    return (k * (k - 1)).clamp(min=1)


def _groups(f: Tensor) -> Tensor:
    return f.unflatten(-1, (8, 4)).mean(-1)


def _sum_squared(f: Tensor) -> Tensor:
    return f.nansum(0) ** 2


check_correlation = Open(
    correlation,
    _some_cells,
    [
        (
            lambda f: _groups((f.sum(0) ** 2 - (f**2).sum(0)) / _pairs(f)),
            "a camera that does not see the cell is NaN and spoils the rest: leave it out",
        ),
        (
            lambda f: _groups(_sum_squared(f) / _pairs(f)),
            "that includes each camera with itself: subtract the sum of the squares",
        ),
        (lambda f: correlation(f) * _pairs(f), "that is the sum over the pairs: divide by their number, k (k - 1)"),
        (lambda f: correlation(f) / 2, "i, j and j, i are both in the sum: their number is k (k - 1)"),
        (
            lambda f: correlation(f) * _pairs(f) / (len(f) * (len(f) - 1)),
            "k is the number of cameras that see the cell, not of all",
        ),
        (
            lambda f: (_sum_squared(f) - f.square().nansum(0)) / _pairs(f),
            "that keeps 32 numbers: take the mean over each group of four channels",
        ),
        (
            lambda f: ((_sum_squared(f) - f.square().nansum(0)) / _pairs(f)).unflatten(-1, (4, 8)).mean(-2),
            "a group is four channels that follow each other: the first is 0, 1, 2, 3",
        ),
        (lambda f: 4 * correlation(f), "that is the sum over a group: take its mean"),
        (lambda f: correlation(f).mean(-1), "that is the mean over all channels: each group keeps its own"),
        (
            lambda f: correlation(f) / (_pairs(f) > 1),
            "where fewer than two cameras see the cell, the correlation is 0: do not divide by 0",
        ),
    ],
)


def double(x):
    """Double columns, rows and spheres of a volume (B, C, W, H, N), interpolated between cells, around the seam too."""
    wider = wrap(x)  # (B, C, W + 2, H, N)
    return interpolate(wider, scale_factor=2, mode="trilinear")[:, :, 2:-2]


def _a_volume(rng: Rng, k: int) -> tuple:
    return (torch.from_numpy(rng.normal(0, 1, (1 + k % 2, 2, 4 + k % 3, 3 + k % 2, 5 - k % 2))),)


def _twice(x: Tensor, **how: object) -> Tensor:
    return interpolate(x, scale_factor=2, **{"mode": "trilinear"} | how)


check_double = Open(
    double,
    _a_volume,
    [
        (lambda x: _twice(x), "the columns at ±180° have neighbours on the other side: wrap first, crop afterwards"),
        (lambda x: _twice(wrap(x)), "wrapped, the volume has a column more on either side: crop them, doubled"),
        (lambda x: _twice(wrap(x))[:, :, 1:-1], "one column on either side becomes two: crop two"),
        (lambda x: _twice(x, mode="nearest"), "that repeats each cell: interpolate between them (trilinear)"),
        (
            lambda x: _twice(wrap(x), align_corners=True)[:, :, 2:-2],
            "align_corners=True stretches the grid: cells are areas, leave it out",
        ),
        (
            lambda x: interpolate(wrap(x), scale_factor=(2, 1, 1), mode="trilinear")[:, :, 2:-2],
            "rows and spheres double, too",
        ),
        (lambda x: torch.roll(double(x), 1, 2), "shifted by a column: crop as many on the left as on the right"),
        (lambda x: double(x.transpose(2, 3)).transpose(2, 3), "the columns wrap, the rows do not: they are axis 2"),
        (lambda x: double(x)[0], "keep the batch: five axes"),
    ],
)


def cross_entropy(scores, index):
    """Mean cross-entropy of scores (rays, N) with true indices (rays,), each divided between the spheres next to it."""
    log_p = scores.log_softmax(-1)
    lower = index.floor().clamp(max=scores.shape[-1] - 2).long()
    share = index - lower  # of the sphere above
    rays = torch.arange(len(index))
    return -((1 - share) * log_p[rays, lower] + share * log_p[rays, lower + 1]).mean()


def _some_scores(rng: Rng, k: int) -> tuple:
    rays, N = 6 + k, 8 + k % 4
    index = rng.uniform(0, N - 1, rays)
    index[:2] = 0, N - 1
    return torch.from_numpy(rng.normal(0, 2, (rays, N))), torch.from_numpy(index)


def _with_shares(scores: Tensor, index: Tensor, shares: Answer) -> Tensor:
    """The cross-entropy with other targets: a function of the distances (rays, N) to the true index."""
    return -(shares(torch.arange(scores.shape[-1]) - index[:, None]) * scores.log_softmax(-1)).sum(-1).mean()


check_cross_entropy = Open(
    cross_entropy,
    _some_scores,
    [
        (
            lambda s, n: torch.nn.functional.cross_entropy(s, n.round().long()),
            "that rounds the index: divide it between the two spheres next to it",
        ),
        (
            lambda s, n: _with_shares(s, n, lambda d: (d.abs() < 1) * torch.where(n % 1 == 0, 1, d.abs().T).T),
            "the nearer sphere gets the larger share: they are swapped",
        ),
        (
            lambda s, n: _with_shares(s, n, lambda d: (d.abs() < 1) / torch.where(n % 1 == 0, 1, 2)[:, None]),
            "half to each is right in the middle only",
        ),
        (lambda s, n: -cross_entropy(s, n), "log-probabilities are negative, the loss is positive: a minus is missing"),
        (lambda s, n: len(n) * cross_entropy(s, n), "that is the sum; take the mean over the rays"),
        (
            lambda s, n: _with_shares(s.log_softmax(-1).exp(), n, lambda d: (1 - d.abs()).clamp(min=0)),
            "the scores are not probabilities yet: one softmax, not two",
        ),
        (
            lambda s, n: -((1 - (torch.arange(s.shape[-1]) - n[:, None]).abs()).clamp(min=0) * s).sum(-1).mean(),
            "the scores are not logarithms of probabilities yet: log_softmax over the spheres",
        ),
        (
            lambda s, n: (
                -((1 - (torch.arange(s.shape[-1]) - n[:, None]).abs()).clamp(min=0) * s.softmax(-1)).sum(-1).mean()
            ),
            "the logarithm is missing: log_softmax",
        ),
        (
            lambda s, n: (
                -((1 - (torch.arange(s.shape[-1]) - n[:, None]).abs()).clamp(min=0) * s.log_softmax(0)).sum(-1).mean()
            ),
            "the softmax goes over the spheres, the last axis",
        ),
    ],
)


def read_out(p, radius):
    """Sphere index (…) of probabilities (…, N): their mean over the best sphere and `radius` on either side."""
    n = torch.arange(p.shape[-1])
    best = p.argmax(-1, keepdim=True)
    near = p * ((n - best).abs() <= radius)  # fewer at the ends
    return (near * n).sum(-1) / near.sum(-1)


def _some_rays(rng: Rng, k: int) -> tuple:
    N = 14 + k % 5
    p = rng.uniform(0.2, 1, (2, 4 + k % 3, N))
    for place, best in zip(np.ndindex(p.shape[:2]), [1, N - 2, *rng.integers(5, N - 5, 20)], strict=False):
        p[place][best] = 1.5
    return torch.from_numpy(p / p.sum(-1, keepdims=True)), 1 + k % 3


def _near(p: Tensor, radius: int) -> Tensor:
    return p * ((torch.arange(p.shape[-1]) - p.argmax(-1, keepdim=True)).abs() <= radius)


check_read_out = Open(
    read_out,
    _some_rays,
    [
        (
            lambda p, r: (p * torch.arange(p.shape[-1])).sum(-1),
            "that is the mean over all spheres, which may lie between two surfaces",
        ),
        (lambda p, r: p.argmax(-1), "that is the best sphere: take the mean around it"),
        (
            lambda p, r: read_out((_near(p, r) > 0) * 1.0, p.shape[-1]),
            "that is the middle of the spheres: weight each by its probability",
        ),
        (
            lambda p, r: (_near(p, r) * torch.arange(p.shape[-1])).sum(-1),
            "the probabilities around the best do not add up to 1: divide by their sum",
        ),
        (lambda p, r: read_out(p, r) - p.argmax(-1), "that is the offset from the best sphere: add it"),
        (lambda p, r: read_out(p, r - 1), "`radius` spheres on either side, the last one included"),
        (lambda p, r: read_out(p, r + 1), "`radius` spheres on either side, not one more"),
        (lambda p, r: read_out(p, 2), "the radius is an argument: do not write 2"),
        (lambda p, r: _near(p, r).sum(-1), "that is the confidence; return the index"),
        (lambda p, r: read_out(p, r) + 1, "the spheres count from 0"),
    ],
)


def behind(center, points, inverse_depth, phi_deg, t):
    """How far lines of sight get behind surfaces (…): the largest ratio of a place's distance from the rig to the depth
    of the surface in its direction, at the fractions t (steps,) of the way from a camera (3,) to points (…, 3)."""
    H, W = inverse_depth.shape  # of the surface, 1/m, by a panorama whose rows go from phi_deg[0] to phi_deg[1]
    places = center + np.multiply.outer(t, points - center)  # (steps, …, 3)
    x, y, z = np.moveaxis(places, -1, 0)
    theta, phi = np.arctan2(x, z), np.degrees(np.arctan2(y, np.hypot(x, z)))
    column = np.floor((theta / (2 * np.pi) + 0.5) * W).astype(int) % W
    row = np.floor((phi - phi_deg[0]) / (phi_deg[1] - phi_deg[0]) * H).astype(int).clip(0, H - 1)
    return (np.linalg.norm(places, axis=-1) * inverse_depth[row, column]).max(axis=0)


def _a_scene(rng: Rng, k: int) -> tuple:
    H, W = 8 + k % 3, 20 + k % 5
    points = rng.normal(0, 3, (3, 4 + k % 3, 3))
    points[0] = [-0.05, 0.2, -2.5] + 0.1 * rng.normal(size=points[0].shape)  # at the seam
    points[1, :2] = [0, 4, 1], [0.3, -4, 1]  # below and above the panorama
    t = np.sort(rng.uniform(0.1, 0.9, 6 + k % 2))
    return rng.normal(0, 0.4, 3), points, rng.uniform(0.1, 0.8, (H, W)), (-40.0, 45.0 + k), t


def _from(*inputs: Array, turn: Answer = lambda q: q) -> Array:
    """The ratio with the places seen from a rig that is turned."""
    center, points, *rest = inputs
    return behind(turn(center), turn(points), *rest)


check_behind = Open(
    behind,
    _a_scene,
    [
        (
            lambda c, p, *rest: behind(0 * c, p, *rest),
            "the line of sight begins at the camera: center + …",
        ),
        (
            lambda c, p, d, phi, t: behind(c, p, d, phi, 1 - t),
            "t is counted from the camera: center + t (points - center)",
        ),
        (lambda c, p, d, phi, t: behind(c, p, d, phi, t[-1:]), "every place on the way counts: the largest of all"),
        (
            lambda *a: np.min([behind(*a[:4], a[4][i : i + 1]) for i in range(len(a[4]))], axis=0),
            "one place behind a surface is enough: the largest, not the smallest",
        ),
        (
            lambda *a: np.stack([behind(*a[:4], a[4][i : i + 1]) for i in range(len(a[4]))]),
            "that is each place's own: take the largest over the steps",
        ),
        (
            lambda *a: behind(*a[:2], a[2][::-1], *a[3:]),
            "the first row is phi_deg[0], and φ grows downwards with y",
        ),
        (lambda *a: behind(*a[:2], a[2][:, ::-1], *a[3:]), "θ is mirrored: arctan2(x, z)"),
        (
            lambda c, p, d, phi, t: behind(c, p, np.roll(d, d.shape[1] // 2, 1), phi, t),
            "θ = 0 is in the middle of the panorama: add half of its width",
        ),
        (
            lambda c, p, d, phi, t: behind(c, p, d, (-90, 90), t),
            "the rows run from phi_deg[0] to phi_deg[1], not from -90° to 90°",
        ),
        (
            lambda c, p, d, phi, t: behind(c, p, d, np.radians(phi), t),
            "phi_deg is in degrees, arctan2 gives radians",
        ),
        (lambda *a: _from(*a, turn=lambda q: q[..., [2, 1, 0]]), "θ is measured from z: arctan2(x, z), not (z, x)"),
    ],
)
