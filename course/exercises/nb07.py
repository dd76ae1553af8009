"""Notebook 07: the tower of convolutions, where a camera shows a point, pairs, the hinge loss,
Adam, and training."""

import numpy as np
import torch
from torch import Tensor, nn

from course.exercises.compare import Array, Rng
from course.exercises.opened import Open

Layers = list[tuple[Tensor, Tensor]]


def tower(images, layers):
    """Features (B, C, h, w) of unit length of images (B, 1, H, W); layers: (weight, bias) of each
    convolution."""
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
        layers.append((_tensor(weight).requires_grad_(k % 2 == 0), _tensor(bias)))  # as in training
    return _tensor(images), layers


def _tensor(values: Array) -> Tensor:
    return torch.from_numpy(values).float()


check_tower = Open(tower, _images_and_layers).with_slips("""
    return x / → x = torch.relu(x); return x /  # no ReLU behind the last layer: it would cut signs
    x if k == 0 else torch.relu(x) → x  # put a ReLU behind each layer but the last
    x / x.norm(dim=1, keepdim=True).clamp(min=1e-6) → x
    # the features of a pixel have length 1: divide by their norm over the channels, axis 1
    dim=1 → dim=0
    # that is a norm over the images: each pixel has its own, over the channels, axis 1
    dim=1 → dim=3
    # that is a norm over the columns: each pixel has its own, over the channels, axis 1
""")


def shown_at(center, rays, true, tried):
    """Directions (…, 3) at which the panorama of a camera at center (3,) shows points on rays
    (…, 3), unit vectors.

    true (…): inverse depths of the points; tried (…): inverse radii of the spheres onto which its
    image is warped.
    """
    sight = rays - true[..., None] * center  # from the camera to the point, in units of its depth
    sight = sight / np.linalg.norm(sight, axis=-1, keepdims=True)
    start = tried[..., None] * center  # the camera, in units of the radius: the sphere has radius 1
    along = np.sum(start * sight, axis=-1, keepdims=True)
    # |start + far · sight| = 1
    far = np.sqrt(along**2 + 1 - np.sum(start**2, axis=-1, keepdims=True)) - along
    return start + far * sight


def _sights(rng: Rng, k: int) -> tuple:
    rays = rng.normal(0, 1, (4, 5, 3) if k % 2 else (9, 3))
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    true, tried = rng.uniform(0.02, 0.6, (2, *rays.shape[:-1]))
    tried.flat[0] = true.flat[0]  # warped onto its own sphere it is shown in its own direction
    true.flat[1] = tried.flat[2] = 0  # in the sky; a sphere at infinity
    return rng.normal(0, 0.4, 3), rays, true, tried


check_shown_at = Open(shown_at, _sights).with_slips("""
    far = np.sqrt(along**2 + 1 - np.sum(start**2, axis=-1, keepdims=True)) - along → far = 1.0
    # the way from the camera to the sphere is not the radius: the camera is not in its middle
    np.sum(start**2, axis=-1, keepdims=True)) - along
    → np.sum(start**2, axis=-1, keepdims=True)) + along
    # of the two roots take the one in front of the camera: - along
    sight = sight / np.linalg.norm(sight, axis=-1, keepdims=True) → sight = sight
    # the line of sight must have length 1 before you solve for the way along it
    start = tried[..., None] * center → start = true[..., None] * center
    # the sphere that is met is the one that is tried: its radius is the unit
    return start + far * sight → return sight
    # that is the direction from the camera; the panorama shows directions from the rig's centre:
    # start + far · sight
""")


def spheres_of_pairs(true_index, px_per_sphere, off_px, away_px, last):
    """Sphere indices (K,) of matches, off_px off the truth, and of non-matches, away_px off it; 0
    to last."""
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
    # beyond the last sphere
    away[[0, 1]], away[[2, 3]] = (-rng.uniform(1.5, 2.5, 2), rng.uniform(1.5, 2.5, 2))
    # just on it, and half a sphere before it
    px_per_sphere[4:8], away[4:8] = (0.5, (-1, 1, -0.75, 0.75))
    return true, px_per_sphere, off, away, last


check_spheres_of_pairs = Open(spheres_of_pairs, _some_rays).with_slips("""
    np.where(beyond, true_index - away, other) → np.clip(other, 0, last)
    # clipped to the last sphere a non-match may show the match: take it on the other side of the
    # truth
    np.where(beyond, true_index - away, other) → last - np.abs(last - np.abs(other))
    # reflected at the last sphere it comes too near: take it on the other side of the truth
    np.where(beyond, true_index - away, other) → other
    # there is no sphere below 0 or above `last`: take the non-match on the other side of the truth
    np.clip(true_index + off_px / px_per_sphere, 0, last) → true_index + off_px / px_per_sphere
    # there is no sphere below 0 or above `last`: clip the match
    other = true_index + away → other = match + away
    true_index - away → match - away
    # both are measured from the truth: the non-match, too
""")


def hinge(match, non_match, margin):
    """Mean over the rays of max(0, margin + non_match - match); both are cosines (K,), tensors."""
    return torch.relu(margin + non_match - match).mean()


def _cosines(rng: Rng, k: int) -> tuple:
    match, non_match = rng.uniform([[0.3], [0.0]], [[1.0], [0.7]], (2, 12 + k))
    return (
        _tensor(match).requires_grad_(),
        _tensor(non_match).requires_grad_(),
        float(rng.uniform(0.15, 0.3)),
    )


check_hinge = Open(hinge, _cosines).with_slips("""
    return (margin + non_match - match).mean()
    # a ray that is right by more than the margin costs 0, not less
    return torch.relu((margin + non_match - match).mean())
    # the hinge is of each ray: first the maximum, then the mean
    .mean() → .sum()  # that is the sum; take the mean over the rays
    return torch.relu(margin + non_match - match).mean()
    → x = margin + non_match - match; return x[x > 0].mean()
    # rays that cost nothing count in the mean, too
""")


def adam_step(weight, mean, square, gradient, step, rate):
    """One step of Adam, counted from 1: the weight, and the running means of its gradient and of
    the square."""
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
        # a weight that has never had a gradient
        mean, square, gradient[1] = (0 * mean, 0 * square, 0)
    return *map(_tensor, (weight, mean, square, gradient)), step, float(rng.uniform(0.01, 0.1))


check_adam_step = Open(adam_step, _a_step).with_slips("""
    mean / (1 - 0.9**step) → mean
    square / (1 - 0.999**step) → square
    # both means began at 0: divide them by 1 - 0.9^step and 1 - 0.999^step
    mean / (1 - 0.9**step) → mean
    # the mean of the gradient began at 0, too: divide it by 1 - 0.9^step
    square / (1 - 0.999**step) → square
    # the mean of the square began at 0, too: divide it by 1 - 0.999^step
    square_now.sqrt() → square_now  # divide by the root of the mean square
    1e-8), mean, square → 1e-8), mean_now, square_now
    # what is kept are the means as they run; the division is for this step alone
""")


def train(network, loss_of, batches, rates):
    """Losses (T,) of T steps of Adam on the weights of a network, in place: loss_of(network,
    batch), before each step."""
    weights = list(network.parameters())
    state = [(torch.zeros_like(weight), torch.zeros_like(weight)) for weight in weights]
    losses = []
    for step, (batch, rate) in enumerate(zip(batches, rates, strict=True), start=1):
        loss = loss_of(network, batch)
        gradients = torch.autograd.grad(loss, weights)
        with torch.no_grad():
            for k, (weight, gradient) in enumerate(zip(weights, gradients, strict=True)):
                moved, *state[k] = adam_step(weight, *state[k], gradient, step, rate)
                weight.copy_(moved)
        losses.append(loss.item())
    return losses


def _squared(network: nn.Module, batch: tuple[Tensor, Tensor]) -> Tensor:
    return (network(batch[0]) - batch[1]).square().mean()


def _a_course(rng: Rng, k: int) -> tuple:
    torch.manual_seed(int(rng.integers(2**31)))
    network = (
        nn.Sequential(nn.Linear(3, 4), nn.Tanh(), nn.Linear(4, 1)) if k % 2 else nn.Linear(3, 1)
    )
    batches = [(torch.randn(5, 3), torch.randn(5, 1)) for _ in range(4 + k % 4)]
    return network, _squared, batches, rng.uniform(0.02, 0.2, len(batches)).tolist()


check_train = Open(train, _a_course).with_slips("""
    enumerate(zip(batches, rates, strict=True), start=1)
    → enumerate(zip(batches, rates, strict=True), start=5)
    # Adam's steps are counted from 1: enumerate(…, start=1)
    moved, *state[k] = → moved, *_ =
    # the running means are lost after each step: keep them, one pair for each weight
    adam_step(weight, *state[k], gradient, step, rate) → weight - rate * gradient
    # that is plain descent: take a step of Adam, with the running means of this weight
    weight.copy_(moved) → pass
    # the losses of a network that does not change: write the moved weights into it,
    # weight.copy_(moved)
    adam_step(weight, *state[k], gradient, step, rate)
    → adam_step(weight, *state[k], gradient, step, rates[0])
    # each step has a rate of its own: rates has one for each batch
""")
