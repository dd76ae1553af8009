"""Students of the exercises on costs, networks and SGM: what each checker says, and to which answer.

Each list has (words, answer): "right", or words of the hint.
"""

import math
from statistics import fmean

import numpy as np
import torch


def zncc_loops(a, b):
    a, b = a.ravel().tolist(), b.ravel().tolist()
    products = squares_a = squares_b = 0.0
    for x, y in zip(a, b, strict=True):
        products += (x - fmean(a)) * (y - fmean(b))
        squares_a += (x - fmean(a)) ** 2
        squares_b += (y - fmean(b)) ** 2
    return (1 - products / math.sqrt(squares_a * squares_b)) / 2


def cosine(a, b):
    return sum(x * y for x, y in zip(a.tolist(), b.tolist(), strict=True)) / math.sqrt(
        sum(x * x for x in a.tolist()) * sum(y * y for y in b.tolist())
    )


COSINE_COST = [
    ("right", lambda a, b: (1 - cosine(a, b)) / 2),
    ("right", lambda a, b: np.sum((a / np.linalg.norm(a) - b / np.linalg.norm(b)) ** 2) / 4),
    ("that is the cosine", cosine),
    ("the sign", lambda a, b: (1 + cosine(a, b)) / 2),
    ("divide by 2", lambda a, b: 1 - cosine(a, b)),
    ("by both lengths", lambda a, b: (1 - np.vdot(a, b)) / 2),
    ("the second length, too", lambda a, b: (1 - a @ b / np.sqrt(a @ a)) / 2),
    ("the first length, too", lambda a, b: (1 - a @ b / np.sqrt(b @ b)) / 2),
    ("not by their squares", lambda a, b: (1 - a @ b / (a @ a * (b @ b))) / 2),
    ("as ZNCC does", zncc_loops),
    ("the angle by π", lambda a, b: math.acos(cosine(a, b)) / math.pi),
]


def hinge(change):
    """The mean over rays of what `change` makes of (match, non-match, margin)."""
    return lambda positive, negative, m: fmean(
        change(p, n, m) for p, n in zip(positive.tolist(), negative.tolist(), strict=True)
    )


HINGE_LOSS = [
    ("right", hinge(lambda p, n, m: max(0.0, m + n - p))),
    ("right", lambda p, n, m: torch.nn.MarginRankingLoss(m)(*map(torch.tensor, (p, n)), torch.ones(len(p))).numpy()),
    ("the roles", hinge(lambda p, n, m: max(0.0, m + p - n))),
    ("costs 0, not less", hinge(lambda p, n, m: m + n - p)),
    ("of each ray: take the maximum", lambda *a: max(0.0, hinge(lambda p, n, m: m + n - p)(*a))),
    ("margin is missing", hinge(lambda p, n, m: max(0.0, n - p))),
    ("margin is added", hinge(lambda p, n, m: max(0.0, n - p - m))),
    ("that is the sum", lambda p, n, m: np.clip(m + n - p, 0, None).sum()),
    ("loss of each ray", lambda p, n, m: np.clip(m + n - p, 0, None)),
    ("not squared", hinge(lambda p, n, m: max(0.0, m + n - p) ** 2)),
    ("cost nothing count", lambda p, n, m: fmean(x for x in (m + n - p).tolist() if x > 0)),
]


def patch_by_probing(layers, kernel):
    """How much smaller an image gets, and one."""
    size = 500
    for _ in range(layers):
        size = len(np.convolve(np.ones(size), np.ones(kernel), "valid"))
    return 500 - size + 1


PATCH_SIZE = [
    ("right", patch_by_probing),
    ("right", lambda layers, kernel: layers * kernel - layers + 1),
    ("overlap", lambda layers, kernel: layers * kernel),
    ("add it", lambda layers, kernel: layers * (kernel - 1)),
    ("to both sides", lambda layers, kernel: 1 + layers * (kernel - 1) // 2),
    ("not one", lambda layers, kernel: kernel + (layers - 1)),
    ("sizes add up", lambda layers, kernel: kernel**layers),
    ("one layer sees", lambda layers, kernel: kernel),
]
SPHERE_LABELS = [
    ("right", lambda gt, n: np.where(np.isnan(gt), np.nan, np.abs(gt - n) > 0.5)),
    ("right", lambda gt, n: [[x if x != x else int(round(x) != n) for x in row] for row in gt.tolist()]),
    ("NaN stays NaN", lambda gt, n: (np.abs(gt - n) > 0.5).astype(int)),
    ("NaN stays NaN", lambda gt, n: np.where(np.rint(gt) == n, 0, 1)),
    ("the wrong way round", lambda gt, n: (np.abs(gt - n) < 0.5) * 1.0),
    ("rounding down", lambda gt, n: (gt.astype(int) != n) * 1),
    ("not up", lambda gt, n: [[float(np.ceil(x) != n) for x in row] for row in gt]),
    ("no whole number", lambda gt, n: (gt != n) * 1),
    ("half a sphere", lambda gt, n: 1 - np.isclose(gt, n, rtol=0, atol=1)),
    ("yes or no", lambda gt, n: abs(gt - n)),
    ("not of the first row", lambda gt, n: [0 if round(x) == n else 1 for x in gt[0].tolist()]),
]


def entropy(cost, label, weights=(0.5, 0.5), log=math.log, turn=False):
    """The cross-entropy by adding up; weights of all positives and of all negatives."""
    means = []
    for kind in (0, 1):
        chosen = [c for c, x in zip(cost.tolist(), label.tolist(), strict=True) if x == kind]
        means.append(fmean(-log(c if (kind == 1) != turn else 1 - c) for c in chosen))
    return weights[0] * means[0] + weights[1] * means[1]


def torch_entropy(cost, label, balanced=True):
    weight = torch.tensor(np.where(label == 0, 0.5 / np.mean(label == 0), 0.5 / np.mean(label == 1)))
    loss = torch.nn.functional.binary_cross_entropy(
        torch.tensor(cost), torch.tensor(label), weight if balanced else None
    )
    return float(loss)


BALANCED_LOSS = [
    ("right", entropy),
    ("right", torch_entropy),
    ("there are more negatives", lambda cost, label: torch_entropy(cost, label, balanced=False)),
    ("divide the sum of both means by 2", lambda cost, label: entropy(cost, label, (1, 1))),
    ("the minus", lambda cost, label: -entropy(cost, label)),
    ("probability of *no*", lambda cost, label: entropy(cost, label, turn=True)),
    ("base 2", lambda cost, label: entropy(cost, label, log=math.log2)),
    ("base 10", lambda cost, label: entropy(cost, label, log=math.log10)),
    (
        "squared error",
        lambda cost, label: fmean([np.mean((cost - label)[label == kind] ** 2) for kind in (0, 1)]),
    ),
    ("positives are missing", lambda cost, label: entropy(cost, label, (0, 0.5))),
    ("negatives are missing", lambda cost, label: entropy(cost, label, (0.5, 0))),
]


def field_backwards(layers):
    """From the output back to the input: one pixel, then what each layer needs of the one before."""
    size = 1
    for kernel, stride in reversed(layers):
        size = (size - 1) * stride + kernel
    return size


def field(layers, own=False, compound=True, one=1):
    """From the input on, with the usual mistakes."""
    size, jump = one, 1
    for kernel, stride in layers:
        if own:
            jump = jump * stride if compound else stride
        size += (kernel - 1) * jump
        if not own:
            jump *= stride
    return size


RECEPTIVE_FIELD = [
    ("right", field_backwards),
    ("right", field),
    ("two pixels of the input", lambda layers: field([(kernel, 1) for kernel, _ in layers])),
    ("not for itself", lambda layers: field(layers, own=True)),
    ("strides multiply up", lambda layers: field(layers, own=True, compound=False)),
    (
        "layers behind it only",
        lambda layers: math.prod(s for _, s in layers) * field([(kernel, 1) for kernel, _ in layers]),
    ),
    ("one pixel: add it", lambda layers: field(layers, one=0)),
    ("windows overlap", lambda layers: sum(kernel for kernel, _ in layers)),
]
