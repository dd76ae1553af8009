"""Notebook 05: the tower of convolutions, the spheres of a training pair, the hinge loss, one step of Adam."""

import numpy as np
import torch
from torch import Tensor, nn

from course.exercises.compare import Array, Rng
from course.exercises.opened import Open

Layers = list[tuple[Tensor, Tensor]]


def tower(images, layers):
    """Features (B, C, h, w) of unit length of images (B, 1, H, W); layers: (weight, bias) of each convolution."""
    x = images
    for k, (weight, bias) in enumerate(layers):
        x = nn.functional.conv2d(x if k == 0 else torch.relu(x), weight, bias)
    return x / x.norm(dim=1, keepdim=True).clamp(min=1e-6)


def _images_and_layers(rng: Rng, k: int) -> tuple:
    channels, count = 3 + k % 3, 2 + k % 3
    images = rng.normal(0, 1, (2, 1, 10, 11))
    if k == 3:
        images[1] = 0  # a camera that sees nothing: without biases its features are 0
    layers = []
    for layer in range(count):
        weight = rng.normal(0, 0.5, (channels, channels if layer else 1, 3, 3))
        bias = rng.normal(0, 0.0 if k == 3 else 0.3, channels)
        layers.append((_tensor(weight), _tensor(bias)))
    return _tensor(images), layers


def _tensor(values: Array) -> Tensor:
    return torch.from_numpy(values).float()


def _features(images: Tensor, layers: Layers, last: bool = False, between: bool = True, padding: int = 0) -> Tensor:
    """The maps before they are normalised, with a ReLU behind the last layer, none between, or with padding."""
    x = images
    for k, (weight, bias) in enumerate(layers):
        x = nn.functional.conv2d(x, weight, bias, padding=padding)
        if between and (last or k < len(layers) - 1):
            x = torch.relu(x)
    return x


def _unit(x: Tensor, dim: int | tuple[int, ...] = 1, least: float = 1e-6) -> Tensor:
    return x / (x**2).sum(dim, keepdim=True).sqrt().clamp(min=least)


check_tower = Open(
    tower,
    _images_and_layers,
    [
        (lambda x, layers: _unit(_features(x, layers, last=True)), "no ReLU behind the last layer: it would cut signs"),
        (lambda x, layers: _unit(_features(x, layers, between=False)), "put a ReLU behind each layer but the last"),
        (_features, "the features of a pixel have length 1: divide by their norm over the channels, axis 1"),
        (
            lambda x, layers: _unit(_features(x, layers), least=0),
            "a pixel whose features are all 0 divides 0 by 0: clamp the norm to at least 1e-6",
        ),
        (lambda x, layers: _unit(_features(x, layers, padding=1)), "no padding: each layer takes the rim away"),
        (
            lambda x, layers: _unit(_features(x, [(weight, 0 * bias) for weight, bias in layers])),
            "add the bias of each layer",
        ),
        (lambda x, layers: _unit(_features(x, layers), dim=(2, 3)), "each pixel has its own norm, over the channels"),
        (
            lambda x, layers: _unit(_features(x, layers), dim=(1, 2, 3)),
            "that is one norm for a whole image; each pixel has its own, over axis 1",
        ),
        (lambda x, layers: _unit(_features(x, layers)) ** 2, "divide the features, not their squares"),
        (lambda x, layers: tower(x[:1], layers), "that is the first image; describe all of them"),
        (lambda x, layers: tower(x, layers[:1]), "that is the first layer; the next one takes what it gives"),
    ],
)


def spheres_of_pairs(true_index, px_per_sphere, off_px, away_px, last):
    """Sphere indices (K,) of matches, off_px off the truth, and of non-matches, away_px off it; 0 to last."""
    match = np.clip(true_index + off_px / px_per_sphere, 0, last)
    away = away_px / px_per_sphere
    other = true_index + away
    beyond = (other < 0) | (other > last)
    return match, np.where(beyond, true_index - away, other)


def _some_rays(rng: Rng, k: int) -> tuple:
    count, last = 12 + k, 40 + k
    true = rng.uniform(10, last - 10, count)
    true[:4] = 0.2, 1.5, last - 0.2, last - 1.5  # near the ends
    true[4:8] = 2, last - 2, 2, last - 2
    px_per_sphere, off = rng.uniform(0.3, 0.9, count), rng.uniform(0.3, 0.5, count)
    away = rng.uniform(1.5, 6, count) * rng.choice([-1, 1], count)
    off[0], off[2] = -0.4, 0.4
    away[[0, 1]], away[[2, 3]] = -rng.uniform(1.5, 2.5, 2), rng.uniform(1.5, 2.5, 2)  # beyond the last sphere
    px_per_sphere[4:8], away[4:8] = 0.5, (-1, 1, -0.75, 0.75)  # just on it, and half a sphere before it
    return true, px_per_sphere, off, away, last


def _not_turned(true: Array, rate: Array, off: Array, away: Array, last: int) -> tuple[Array, Array]:
    return np.clip(true + off / rate, 0, last), true + away / rate


def _from_the_match(true: Array, rate: Array, off: Array, away: Array, last: int) -> tuple[Array, Array]:
    match = np.clip(true + off / rate, 0, last)
    return match, spheres_of_pairs(match, rate, 0 * off, away, last)[1]


def _not_clipped(true: Array, rate: Array, off: Array, away: Array, last: int) -> tuple[Array, Array]:
    return true + off / rate, spheres_of_pairs(true, rate, off, away, last)[1]


check_spheres_of_pairs = Open(
    spheres_of_pairs,
    _some_rays,
    [
        (
            lambda n, px, off, away, last: spheres_of_pairs(n, 1 + 0 * px, off, away, last),
            "pixels are not spheres: divide by px_per_sphere",
        ),
        (
            lambda n, px, off, away, last: spheres_of_pairs(n, 1 / px, off, away, last),
            "pixels / (pixels per sphere) are spheres: divide, do not multiply",
        ),
        (
            lambda *inputs: np.clip(_not_turned(*inputs), 0, inputs[-1]),
            "clipped to the last sphere a non-match may show the match: take it on the other side of the truth",
        ),
        (_not_turned, "there is no sphere below 0 or above `last`: take the non-match on the other side of the truth"),
        (_not_clipped, "there is no sphere below 0 or above `last`: clip the match"),
        (_from_the_match, "both are measured from the truth: the non-match, too"),
        (lambda *inputs: spheres_of_pairs(*inputs)[::-1], "the match first, then the non-match"),
        (
            lambda n, px, off, away, last: spheres_of_pairs(n, px, 0 * off, away, last),
            "the match is off by `off_px`, as estimates on whole spheres are",
        ),
        (
            lambda n, px, off, away, last: spheres_of_pairs(n, px, off, np.abs(away), last),
            "the sign of `away_px` says to which side: keep it",
        ),
        (lambda *inputs: np.rint(spheres_of_pairs(*inputs)), "do not round: between two spheres there is one, too"),
    ],
)


def hinge(match, non_match, margin):
    """Mean over the rays of max(0, margin + non_match - match); both are cosines (K,), tensors."""
    return torch.relu(margin + non_match - match).mean()


def _cosines(rng: Rng, k: int) -> tuple:
    match, non_match = rng.uniform([[0.3], [0.0]], [[1.0], [0.7]], (2, 12 + k))
    return _tensor(match), _tensor(non_match), float(rng.uniform(0.15, 0.3))


check_hinge = Open(
    hinge,
    _cosines,
    [
        (lambda p, n, m: hinge(n, p, m), "the roles: the match must score higher by the margin"),
        (lambda p, n, m: (m + n - p).mean(), "a ray that is right by more than the margin costs 0, not less"),
        (
            lambda p, n, m: torch.relu((m + n - p).mean()),
            "the hinge is of each ray: first the maximum, then the mean",
        ),
        (lambda p, n, m: hinge(p, n, 0), "the margin is missing"),
        (lambda p, n, m: hinge(p, n, -m), "the margin is added: right by a hair is not enough"),
        (lambda p, n, m: torch.relu(m + n - p).sum(), "that is the sum; take the mean over the rays"),
        (lambda p, n, m: torch.relu(m + n - p), "that is the loss of each ray: take the mean"),
        (lambda p, n, m: (torch.relu(m + n - p) ** 2).mean(), "the hinge is not squared"),
        (lambda p, n, m: hinge(p, n, 0.2), "the margin is an argument: do not write 0.2"),
        (lambda p, n, m: (each := m + n - p)[each > 0].mean(), "rays that cost nothing count in the mean, too"),
    ],
)


def adam_step(weight, mean, square, gradient, step, rate):
    """One step of Adam, counted from 1: the weight, and the running means of its gradient and of the square."""
    mean = 0.9 * mean + 0.1 * gradient
    square = 0.999 * square + 0.001 * gradient**2
    mean_now = mean / (1 - 0.9**step)  # both means began at 0: what is missing to a weight of 1
    square_now = square / (1 - 0.999**step)
    return weight - rate * mean_now / (square_now.sqrt() + 1e-8), mean, square


def _a_step(rng: Rng, k: int) -> tuple:
    weight, mean, gradient = rng.normal(0, 1, (3, 4 + k % 3))
    square = rng.uniform(0.2, 2, len(weight))
    step = 1 + 3 * k
    if step == 1:
        mean, square = 0 * mean, 0 * square
    return *map(_tensor, (weight, mean, square, gradient)), step, float(rng.uniform(0.01, 0.1))


def _adam(w: Tensor, m: Tensor, s: Tensor, g: Tensor, t: int, rate: float, **changed: float) -> tuple[Tensor, ...]:
    """A step with one of its numbers changed: the powers of the corrections, the exponent of the square."""
    now = {"t_mean": t, "t_square": t, "root": 0.5, "keep": 0.9, "keep_square": 0.999, "power": 2} | changed
    m = now["keep"] * m + (1 - now["keep"]) * g
    s = now["keep_square"] * s + (1 - now["keep_square"]) * g ** now["power"]
    right, spread = m / (1 - 0.9 ** now["t_mean"]), s / (1 - 0.999 ** now["t_square"])
    return w - rate * right / (spread ** now["root"] + 1e-8), m, s


check_adam_step = Open(
    adam_step,
    _a_step,
    [
        (lambda w, m, s, g, t, rate: adam_step(w, m, s, g, t, -rate), "against the gradient: subtract"),
        (
            lambda *a: _adam(*a, t_mean=np.inf, t_square=np.inf),
            "both means began at 0: divide them by 1 - 0.9^step and 1 - 0.999^step",
        ),
        (lambda *a: _adam(*a, t_mean=np.inf), "the mean of the gradient began at 0, too: divide it by 1 - 0.9^step"),
        (lambda *a: _adam(*a, t_square=np.inf), "the mean of the square began at 0, too: divide it by 1 - 0.999^step"),
        (lambda *a: _adam(*a, root=1), "divide by the root of the mean square"),
        (lambda *a: _adam(*a, power=1), "`square` is the running mean of the square of the gradient"),
        (lambda *a: _adam(*a, keep=0.1), "0.9 of the mean is kept, 0.1 is new"),
        (lambda *a: _adam(*a, keep=0.999, keep_square=0.9), "0.9 is for the mean, 0.999 for the square: swapped"),
        (
            lambda w, m, s, g, t, rate: (w - rate * g, m, s),
            "that is plain gradient descent: take the running mean, by the root of the running square",
        ),
        (lambda w, m, s, g, t, rate: (adam_step(w, m, s, g, t, rate)[0], m, s), "return the new means as well"),
        (
            lambda w, m, s, g, t, rate: _corrected(adam_step(w, m, s, g, t, rate), t),
            "what is kept are the means as they run; the division is for this step alone",
        ),
        (lambda *a: adam_step(*a)[0], "return three things: the weight, the mean, the mean square"),
    ],
)


def _corrected(after: tuple[Tensor, ...], step: int) -> tuple[Tensor, ...]:
    return after[0], after[1] / (1 - 0.9**step), after[2] / (1 - 0.999**step)
