"""Checkers of notebook 06: labels, the loss, the receptive field."""

from __future__ import annotations

import numpy as np

from course.exercises.compare import Case, Rng, checker


@checker
def check_sphere_labels(rng: Rng, k: int) -> Case:
    """06.1: SweepNet's labels of sphere n: 0 where the true index rounds to n, 1 elsewhere."""
    n = int(rng.integers(1, 9))
    gt_index = n + rng.uniform(-1.6, 1.6, (3, 6 + k % 3))
    gt_index[0, :3] = n + np.array([0, 0.4, -0.4])
    gt_index[1:, :2] = np.nan
    label, unknown = np.where(np.rint(gt_index) == n, 0.0, 1.0), np.isnan(gt_index)
    wrong = [
        (1 - label, "the wrong way round: a match is 0, as every cost of a match is"),
        (np.where(np.floor(gt_index) == n, 0.0, 1.0), "round to the nearest sphere; cutting off is rounding down"),
        (np.where(np.ceil(gt_index) == n, 0.0, 1.0), "round to the nearest sphere, not up"),
        (np.where(gt_index == n, 0.0, 1.0), "the true index is no whole number: round it first"),
        (np.where(np.abs(gt_index - n) <= 1, 0.0, 1.0), "half a sphere to each side, not a whole one"),
        (np.abs(gt_index - n), "that is a distance; a label says yes or no"),
        (np.minimum(np.abs(np.rint(gt_index) - n), 1.0)[0], "the labels of all rays, not of the first row"),
    ]
    mistakes = [(np.where(unknown, one, label), "no ground truth, no label: NaN stays NaN") for one in (0, 1)]
    for value, hint in wrong:  # with NaN left as it is, and with what a comparison makes of it
        keeps_nan = value.ndim < 2 or np.isnan(value).any()
        mistakes += [(value, hint)] if keeps_nan else [(value, hint), (np.where(unknown, np.nan, value), hint)]
    return (gt_index, n), np.where(unknown, np.nan, label), mistakes


@checker
def check_balanced_loss(rng: Rng, k: int) -> Case:
    """06.2: binary cross-entropy (Eq. 4) with as much weight on all positives as on all negatives."""
    label = np.repeat([0.0, 1.0], rng.integers([3, 8], [6, 12]))
    rng.shuffle(label)
    cost = rng.uniform(0.05, 0.95, len(label))
    match = label == 0
    positive, negative = -np.log(1 - cost[match]), -np.log(cost[~match])
    right = (positive.mean() + negative.mean()) / 2
    mistakes = [
        (np.concatenate([positive, negative]).mean(), "there are more negatives: the mean of each kind, then of both"),
        (positive.mean() + negative.mean(), "each kind weighs one half: divide the sum of both means by 2"),
        (-right, "the minus: logarithms of numbers below 1 are negative, a loss is not"),
        (
            (-np.log(cost[match]).mean() - np.log(1 - cost[~match]).mean()) / 2,
            "the cost is the probability of *no* match: label 0 takes log(1 - cost)",
        ),
        (right / np.log(2), "that is with the logarithm to base 2; take the natural one"),
        (right / np.log(10), "that is with the logarithm to base 10; take the natural one"),
        (
            ((cost[match] ** 2).mean() + ((1 - cost[~match]) ** 2).mean()) / 2,
            "that is the squared error; return the cross-entropy",
        ),
        (negative.mean() / 2, "the positives are missing: label 0 takes log(1 - cost)"),
        (positive.mean() / 2, "the negatives are missing: label 1 takes log(cost)"),
    ]
    return (cost, label), right, mistakes


@checker
def check_receptive_field(rng: Rng, k: int) -> Case:
    """06.4: side of the input that an output depends on, given (kernel, stride) of each layer in order."""
    drawn = rng.choice([3, 5, 7], 2 + k % 4), rng.choice([1, 2, 3], 2 + k % 4)
    layers = [(5, 2), (3, 1), *((int(size), int(stride)) for size, stride in zip(*drawn, strict=True)), (3, 2), (3, 1)]
    kernels, strides = np.array(layers).T
    before, after = np.concatenate([[1], np.cumprod(strides)[:-1]]), np.cumprod(strides)
    plain = 1 + np.sum(kernels - 1)
    right = 1 + np.sum((kernels - 1) * before)
    mistakes = [
        (
            plain,
            "behind a stride of 2 a pixel is two pixels of the input: each layer adds (kernel - 1) times the"
            " product of all strides before it",
        ),
        (1 + np.sum((kernels - 1) * after), "a layer's own stride counts for those behind it, not for itself"),
        (1 + np.sum((kernels - 1) * strides), "strides multiply up: the product of all that came before"),
        (plain * after[-1], "a stride counts for the layers behind it only"),
        (right - 1, "with no layer at all it is one pixel: add it"),
        (kernels.sum(), "neighbouring windows overlap: each layer adds kernel - 1"),
    ]
    return (layers,), float(right), mistakes
