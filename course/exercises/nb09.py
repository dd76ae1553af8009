"""Notebook 09: the receptive field, influence and the window with most of it, covers, the prior."""

import numpy as np
import torch

from course.exercises.compare import Rng
from course.exercises.opened import Open

Sizes = list[tuple[int, float]]


def receptive_field(layers):
    """Side in pixels of the input that one output sees; layers: (kernel, stride) in order, stride
    1/2 doubles."""
    # what one value sees, and how far apart neighbouring values are, both in pixels of the input
    side = 1
    pixel = 1.0
    for kernel, stride in layers:
        # the kernel of a layer that doubles lies on its output
        side += (kernel - 1) * pixel * min(stride, 1)
        pixel *= stride
    return side


def _some_layers(rng: Rng, k: int) -> tuple:
    drawn = rng.choice([3, 5, 7], 2 + k % 3), rng.choice([1, 2, 3], 2 + k % 3)
    middle = [(int(kernel), int(stride)) for kernel, stride in zip(*drawn, strict=True)]
    if k == 9:
        return ([],)
    return ([(5, 2), (3, 1), *middle, (3, 2), (3, 1), (3, 0.5), (5, 1)],)


check_receptive_field = Open(receptive_field, _some_layers).with_slips("""
    * pixel * min(stride, 1) →
    # behind a stride of 2 a value is two pixels from the next: multiply by all the strides before
    min(stride, 1) → stride  # a layer's own stride counts for the layers behind it
    * min(stride, 1) →  # the kernel of a layer that doubles lies on its finer output
    pixel *= stride → pixel *= max(stride, 1)
    # a stride of 1/2 halves the distance between values again
    pixel *= stride → pixel = stride  # strides multiply up: the product of all that came before
""")


def mean_influence(score, image, places, radius):
    """Mean map (2 radius + 1, 2 radius + 1) of the absolute gradient of score(image, row, column)
    by an image (H, W) around the rays at places (P, 2), each map of sum 1."""
    side = 2 * radius + 1
    maps = []
    for row, column in places:
        pixels = image.nan_to_num().requires_grad_()
        score(pixels, int(row), int(column)).backward()
        influence = pixels.grad.abs()
        # the ray into the middle: columns go around, beyond the rows there is nothing
        influence = torch.roll(influence, radius - int(column), dims=1)[:, :side]
        influence = torch.nn.functional.pad(influence, (0, 0, radius, radius))
        influence = influence[int(row) : int(row) + side]
        maps.append(influence / influence.sum())  # each ray weighs the same
    return torch.stack(maps).mean(dim=0)


def _some_rays(rng: Rng, k: int) -> tuple:
    H, W, radius = 7, 12 + k % 3, 2 + k % 2
    weights = torch.from_numpy(rng.normal(0, 1, (H, W)))
    image = torch.from_numpy(rng.normal(0, 1, (H, W)))
    image[2, 3] = np.nan

    def score(image, row, column):
        rows, columns = torch.arange(H)[:, None] - row, torch.arange(W) - column
        columns = (columns + W // 2) % W - W // 2
        near = torch.exp(-(rows**2 + columns**2) / 2.0)
        return (near * weights * image**2).sum() * (1 + row)

    places = np.stack([rng.integers(0, H, 3), rng.integers(0, W, 3)], axis=1)
    places[0, 1], places[1, 0] = 0, H - 1
    return score, image, places, radius


check_mean_influence = Open(mean_influence, _some_rays).with_slips("""
    pixels.grad.abs() → pixels.grad
    # a pixel that lowers the score has influence, too: the absolute value
    influence / influence.sum() → influence
    # a ray with steep scores outvotes the others: divide each map by its sum
    .mean(dim=0) → .sum(dim=0)  # that is the sum of the maps
    radius - int(column) → -int(column)
    # the ray is at the left: shift its column to the middle, number `radius`
""")


def side_with_share(influence, share):
    """Side of the smallest square around the middle of a map (2 R + 1, 2 R + 1) that holds a share
    of its sum."""
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


check_side_with_share = Open(side_with_share, _a_map, whole=("influence",)).with_slips("""
    return 2 * np.argmax(held >= share * held[-1]) + 1 → return np.argmax(held >= share * held[-1])
    # that is the distance to the side: a square around a pixel has 2 r + 1 of them
    np.maximum(np.abs(rows), np.abs(columns)) → np.hypot(rows, columns).astype(int)
    # that is a disc: a square is all within max(|row|, |column|)
    np.maximum(np.abs(rows), np.abs(columns)) → np.abs(rows) + np.abs(columns)
    # that is a square on its tip: max(|row|, |column|), no sum
    share * held[-1] → share  # a share of the map's sum, which need not be 1
""")


def ask_covered(ask, images, places, cameras, half):
    """Answers (P, …) of ask(images), for each of the places (P, 2), row and column, with a square of
    2 half + 1 pixels a side around it grey, 0, in some of the cameras.

    images: (cameras, B, H, W); columns go around, NaN stays NaN."""
    H, W = images.shape[-2:]
    answers = []
    for row, column in places:
        rows = np.arange(max(row - half, 0), min(row + half + 1, H))
        columns = np.arange(column - half, column + half + 1) % W
        covered = images.clone()
        for camera in cameras:
            covered[camera][:, rows[:, None], columns] *= 0
        answers.append(ask(covered))
    return torch.stack(answers)


def _as_they_are(images: torch.Tensor) -> torch.Tensor:
    return images.nan_to_num(nan=-9)


def _some_places(rng: Rng, k: int) -> tuple:
    images = torch.from_numpy(rng.uniform(0.5, 1, (4, 2, 7, 12 + k % 3)))
    images[1, :, :, 3:5] = torch.nan
    places = np.stack([rng.integers(0, 7, 4), rng.integers(0, 12, 4)], axis=1)
    # at the seam, and on the first and the last row
    places[:3] = (3, 0), (0, 11), (6, 4)
    return _as_they_are, images, places, ([1], [0, 1], [2], [])[k % 4], 1 + k % 2


check_ask_covered = Open(ask_covered, _some_places, whole=("images", "places")).with_slips("""
    images.clone() → images  # each place needs images of its own, without the squares before
    column + half + 1) % W → column + half + 1).clip(0, W - 1)
    # the panorama goes around: columns modulo its width
    *= 0 → = 0  # what a camera does not see stays NaN: multiply by 0
    max(row - half, 0) → row - half  # rows do not go around: a negative one counts from the end
    for camera in cameras: → for camera in range(len(images)):
    # only in the cameras that are asked for
""")


def with_prior(cost, share, strength):
    """Costs (…, N) of a balanced network, given the share (N,) of rays whose true sphere is n;
    strength 1 is Bayes."""
    # eps: a cost of exactly 0 or 1 would be sure whatever the prior
    score = torch.logit(cost, eps=1e-4)
    return torch.sigmoid(score - strength * torch.log(share / (1 - share)))


def _costs_and_share(rng: Rng, k: int) -> tuple:
    cost = rng.uniform(0.02, 0.98, (3, 4 + k % 2, 6 + k % 4))
    cost[0, 0, 1], cost[1, 1, 2] = 0, 1
    cost[2, 0] = np.nan
    share = rng.uniform(0.02, 0.3, (cost.shape[-1],))
    return torch.from_numpy(cost), torch.from_numpy(share / share.sum()), float(rng.uniform(0.3, 1))


check_with_prior = Open(with_prior, _costs_and_share).with_slips("""
    torch.log(share / (1 - share)) → torch.log(share)  # odds are share / (1 - share)
    torch.log(share / (1 - share)) → share / (1 - share)  # the logarithm of the odds is missing
    , eps=1e-4 →  # no cost is quite sure: logit(cost, eps=1e-4)
    torch.sigmoid(score - strength * torch.log(share / (1 - share)))
    → cost - strength * torch.log(share / (1 - share))
    # odds add to scores, not to costs: logit first, sigmoid last
    score - strength * torch.log(share / (1 - share))
    → strength * (score - torch.log(share / (1 - share)))
    # the strength is that of the prior, not of the score
""")
