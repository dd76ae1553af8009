"""Notebook 06b: the receptive field, the window that holds most of the influence, and the prior."""

import numpy as np
import torch
from torch import Tensor

from course.exercises.compare import Array, Rng
from course.exercises.opened import Open

Sizes = list[tuple[int, float]]


def receptive_field(layers):
    """Side in pixels of the input that one output sees; layers: (kernel, stride) in order, stride 1/2 doubles."""
    side, pixel = 1, 1.0  # what one value sees, and how far apart neighbouring values are, both in pixels of the input
    for kernel, stride in layers:
        side += (kernel - 1) * pixel * min(stride, 1)  # the kernel of a layer that doubles lies on its output
        pixel *= stride
    return side


def _some_layers(rng: Rng, k: int) -> tuple:
    drawn = rng.choice([3, 5, 7], 2 + k % 3), rng.choice([1, 2, 3], 2 + k % 3)
    middle = [(int(kernel), int(stride)) for kernel, stride in zip(*drawn, strict=True)]
    return ([(5, 2), (3, 1), *middle, (3, 2), (3, 1), (3, 0.5), (5, 1)],)


def _side(layers: Sizes, own: object = lambda stride: min(stride, 1), one: int = 1) -> float:
    """The side with another rule for a layer's own stride."""
    side, pixel = one, 1.0
    for kernel, stride in layers:
        side += (kernel - 1) * pixel * own(stride)
        pixel *= stride
    return side


def _last_stride(layers: Sizes) -> float:
    strides = [1, *(stride for _, stride in layers)]
    return 1 + sum((kernel - 1) * stride for (kernel, _), stride in zip(layers, strides, strict=False))


check_receptive_field = Open(
    receptive_field,
    _some_layers,
    [
        (
            lambda layers: 1 + sum(kernel - 1 for kernel, _ in layers),
            "behind a stride of 2 a value is two pixels from the next: multiply by all the strides before",
        ),
        (lambda layers: _side(layers, lambda stride: stride), "a layer's own stride counts for the layers behind it"),
        (lambda layers: _side(layers, lambda stride: 1), "the kernel of a layer that doubles lies on its finer output"),
        (
            lambda layers: _side([(kernel, max(stride, 1)) for kernel, stride in layers]),
            "a stride of 1/2 halves the distance between values again",
        ),
        (
            lambda layers: _side([(kernel, 1 / stride if stride < 1 else stride) for kernel, stride in layers]),
            "a stride of 1/2 halves the distance between values again",
        ),
        (_last_stride, "strides multiply up: the product of all that came before"),
        (lambda layers: _side(layers, one=0), "with no layer at all it is one pixel: begin with 1"),
        (lambda layers: sum(kernel for kernel, _ in layers), "neighbouring windows overlap: a layer adds kernel - 1"),
        (lambda layers: receptive_field(layers) // 2, "the whole side, not half of it"),
    ],
)


def side_with_share(influence, share):
    """Side of the smallest square around the middle of a map (2 R + 1, 2 R + 1) that holds a share of its sum."""
    rows, columns = np.indices(influence.shape) - len(influence) // 2
    ring = np.maximum(np.abs(rows), np.abs(columns))
    held = np.bincount(ring.ravel(), weights=influence.ravel()).cumsum()
    return 2 * np.argmax(held >= share * held[-1]) + 1


def _a_map(rng: Rng, k: int) -> tuple:
    radius = 6 + k % 4
    rows, columns = np.indices((2 * radius + 1,) * 2) - radius
    distance = np.hypot(rows / (1 + 0.5 * (k % 2)), columns)
    influence = rng.uniform(0.5, 1.5, distance.shape) * np.exp(-distance / (1.5 + 0.5 * (k % 3)))
    return influence * rng.uniform(0.5, 3), float(rng.uniform(0.5, 0.95))


def _share_of(values: Array, share: float, size: object) -> int:
    """The side by another size of a pixel's ring."""
    rows, columns = np.indices(values.shape) - len(values) // 2
    ring = size(np.abs(rows), np.abs(columns)).astype(int)
    held = np.bincount(ring.ravel(), values.ravel()).cumsum()
    return 2 * int(np.argmax(held >= share * held[-1])) + 1


check_side_with_share = Open(
    side_with_share,
    _a_map,
    [
        (lambda x, share: side_with_share(x / x.sum(), share) // 2, "the side of the square, not half of it"),
        (lambda x, share: side_with_share(x, share) - 1, "a square around a pixel has an odd side: 2 r + 1"),
        (lambda x, share: side_with_share(x, share) ** 2, "that is its area; return its side"),
        (lambda x, share: _share_of(x, share, np.hypot), "that is a disc: a square is all within max(|row|, |column|)"),
        (
            lambda x, share: _share_of(x, share, np.add),
            "that is a square on its tip: max(|row|, |column|), no sum",
        ),
        (lambda x, share: _share_of(x, share, lambda row, column: column), "rows count as well as columns"),
        (lambda x, share: side_with_share(x, 1 - share), "that is what lies outside: the square holds the share"),
        (
            lambda x, share: _share_of(np.ones(x.shape), share, np.maximum),
            "weigh each pixel by its influence",
        ),
    ],
)


def with_prior(cost, share, strength):
    """Costs (…, N) of a balanced network, given the share (N,) of rays whose true sphere is n; strength 1 is Bayes."""
    score = torch.logit(cost, eps=1e-4)  # eps: a cost of exactly 0 or 1 would be sure whatever the prior
    return torch.sigmoid(score - strength * torch.log(share / (1 - share)))


def _costs_and_share(rng: Rng, k: int) -> tuple:
    cost = rng.uniform(0.02, 0.98, (3, 4 + k % 2, 6 + k % 4))
    cost[0, 0, 1], cost[1, 1, 2] = 0, 1
    cost[2, 0] = np.nan
    share = rng.uniform(0.02, 0.3, cost.shape[-1])
    return torch.from_numpy(cost), torch.from_numpy(share / share.sum()), float(rng.uniform(0.3, 1))


def _prior(cost: Tensor, share: Tensor, strength: float, odds: object, eps: float | None = 1e-4) -> Tensor:
    return torch.sigmoid(torch.logit(cost, eps=eps) - strength * odds(share))


def _log_odds(share: Tensor) -> Tensor:
    return torch.log(share / (1 - share))


check_with_prior = Open(
    with_prior,
    _costs_and_share,
    [
        (lambda c, s, w: with_prior(c, s, -w), "a likely sphere costs less: the sign"),
        (lambda c, s, w: with_prior(c, s, 1), "the strength is missing: it multiplies the logarithm"),
        (lambda c, s, w: _prior(c, s, w, torch.log), "odds are share / (1 - share)"),
        (lambda c, s, w: _prior(c, s, w, lambda s: s / (1 - s)), "the logarithm of the odds is missing"),
        (lambda c, s, w: _prior(c, s, w, _log_odds, None), "no cost is quite sure: logit(cost, eps=1e-4)"),
        (lambda c, s, w: torch.logit(with_prior(c, s, w)), "that is the score: sigmoid of it is the cost"),
        (lambda c, s, w: c - w * _log_odds(s), "odds add to scores, not to costs: logit first, sigmoid last"),
        (lambda c, s, w: torch.sigmoid(c - w * _log_odds(s)), "the cost becomes a score first: torch.logit"),
        (lambda c, s, w: torch.nan_to_num(with_prior(c, s, w)), "a ray without a cost stays NaN"),
        (
            lambda c, s, w: torch.sigmoid(w * (torch.logit(c, eps=1e-4) - _log_odds(s))),
            "the strength is that of the prior, not of the score",
        ),
        (lambda c, s, w: c * (1 - s) ** w, "the prior belongs inside the sigmoid: logit, minus log odds, sigmoid"),
    ],
)
