"""Students of notebook 06: what each checker says, and to which answer.

Each list has (words, answer): "right", or words of the hint.
"""

import math
from statistics import fmean

import numpy as np
import torch

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
