"""Notebook 06: the features of a camera, the comparison of two, the labels of a sphere, the balanced loss."""

import numpy as np
import torch
from torch import Tensor, nn

from course.exercises.compare import Array, Rng
from course.exercises.opened import Open

Layers = list[tuple[Tensor, Tensor]]


def camera_features(images, layers):
    """Feature maps (B, C, H/2, W/2) of images (B, H, W); layers: (weight, bias) of conv1 to conv18."""
    conv1, *blocks, conv18 = layers
    x = torch.relu(nn.functional.conv2d(images[:, None], *conv1, stride=2, padding=2))
    for one, two in zip(blocks[::2], blocks[1::2], strict=True):
        inner = torch.relu(nn.functional.conv2d(x, *one, padding=1))
        x = torch.relu(x + nn.functional.conv2d(inner, *two, padding=1))
    return torch.relu(nn.functional.conv2d(x, *conv18, padding=1))


def _layers(rng: Rng, *shapes: tuple[int, ...]) -> Layers:
    """Weights and biases; their scale keeps the numbers behind the layers alive and apart."""
    drawn = [(rng.normal(0.03, 0.5 / np.sqrt(shape[1]), shape), shape) for shape in shapes]
    return [(_tensor(weight), _tensor(rng.normal(0.1, 0.2, shape[0]))) for weight, shape in drawn]


def _tensor(values: Array) -> Tensor:
    return torch.from_numpy(np.asarray(values)).float()


def _per_camera(rng: Rng, channels: int, blocks: int) -> Layers:
    return _layers(rng, (channels, 1, 5, 5), *[(channels, channels, 3, 3)] * (2 * blocks + 1))


def _images_and_layers(rng: Rng, k: int) -> tuple:
    return _tensor(rng.normal(0, 1, (2, 8, 10 + 2 * (k % 3)))), _per_camera(rng, 3 + k % 2, 2 + k % 2)


def _features(
    images: Tensor, layers: Layers, add: str = "before", inner: bool = True, last: bool = True, stride: int = 2
) -> Tensor:
    """Features with the shortcut before the ReLU, behind it or nowhere, without a ReLU in the blocks or at the end."""
    conv1, *blocks, conv18 = layers
    x = torch.relu(nn.functional.conv2d(images[:, None], *conv1, stride=stride, padding=2))
    for one, two in zip(blocks[::2], blocks[1::2], strict=True):
        y = nn.functional.conv2d(x, *one, padding=1)
        y = nn.functional.conv2d(torch.relu(y) if inner else y, *two, padding=1)
        x = {"before": torch.relu(x + y), "behind": x + torch.relu(y), "nowhere": torch.relu(y)}[add]
    x = nn.functional.conv2d(x, *conv18, padding=1)
    return torch.relu(x) if last else x


check_camera_features = Open(
    camera_features,
    _images_and_layers,
    [
        (lambda x, layers: _features(x, layers, add="nowhere"), "the shortcut is missing: add the input of each block"),
        (lambda x, layers: _features(x, layers, add="behind"), "add the input of a block before its last ReLU"),
        (lambda x, layers: _features(x, layers, inner=False), "there is a ReLU between the two layers of a block, too"),
        (lambda x, layers: _features(x, layers, last=False), "conv18 has a ReLU behind it as well"),
        (lambda x, layers: _features(x, layers, stride=1), "conv1 halves the image: stride=2"),
        (
            lambda x, layers: camera_features(x, [(w, 0 * b) for w, b in layers]),
            "add the bias of each layer, the second argument of conv2d after the image",
        ),
        (
            lambda x, layers: camera_features(x, [layers[0], *[layers[1]] * (len(layers) - 2), layers[-1]]),
            "each layer has its own weights",
        ),
        (lambda x, layers: camera_features(x, [*layers[:3], layers[-1]]), "that is one block: go through all of them"),
        (lambda x, layers: camera_features(x[:1], layers), "that is the first image; describe all of them"),
    ],
)


def pair_features(left, right, per_camera, per_pair, halo):
    """Numbers (B, H, W, C) of each ray, of two warped images (B, H, W), NaN where unseen, around the seam."""
    left, right = (nn.functional.pad(x.nan_to_num(), (halo, halo), mode="circular") for x in (left, right))
    conv19, deconv1, conv20 = per_pair
    x = torch.cat([camera_features(left, per_camera), camera_features(right, per_camera)], dim=1)
    x = torch.relu(nn.functional.conv2d(x, *conv19, padding=1))
    x = torch.relu(nn.functional.conv_transpose2d(x, *deconv1, stride=2, padding=1, output_padding=1))
    x = torch.relu(nn.functional.conv2d(x, *conv20, padding=1))
    return x[..., halo : x.shape[-1] - halo].permute(0, 2, 3, 1)


def _two_images(rng: Rng, k: int) -> tuple:
    channels, wide = 3, 4
    images = rng.normal(0, 1, (2, 1, 8, 12 + 2 * (k % 3)))
    images[0, :, 2:4, 5:8] = images[1, :, :2, 1:3] = np.nan
    left, right = map(_tensor, images)
    per_pair = _layers(rng, (wide, 2 * channels, 3, 3), (wide, wide, 3, 3), (wide, wide, 3, 3))
    return left, right, _per_camera(rng, channels, 2), per_pair, 4 + 2 * (k % 2)


def _pair(left: Tensor, right: Tensor, cameras: Layers, pair: Layers, halo: int, mode: str = "circular") -> Tensor:
    """A comparison with another way to go on beyond the ends."""
    wide = [nn.functional.pad(x.nan_to_num(), (halo, halo), mode=mode) for x in (left, right)]
    return pair_features(*wide, cameras, pair, 0)[:, :, halo : halo + left.shape[-1]]


def _filled(x: Tensor) -> Tensor:
    """NaN by the value on its left, and 0 in the first column."""
    filled = x.clone()
    for column in range(x.shape[-1]):
        before = filled[..., column - 1] if column else torch.zeros_like(x[..., 0])
        filled[..., column] = torch.where(x[..., column].isnan(), before, x[..., column])
    return filled


check_pair_features = Open(
    pair_features,
    _two_images,
    [
        (
            lambda left, right, cameras, pair, halo: pair_features(left, right, cameras, pair, 0),
            "columns must go on around the seam: repeat `halo` of them on both sides, mode='circular'",
        ),
        (lambda *a: _pair(*a, mode="replicate"), "the panorama is a circle: mode='circular'"),
        (lambda *a: _pair(*a, mode="constant"), "zeros beyond the seam are not what is there: mode='circular'"),
        (lambda *a: _pair(*a, mode="reflect"), "the panorama is a circle: it goes on, it is no mirror"),
        (
            lambda left, right, cameras, pair, halo: _pair(
                *(nn.functional.pad(x.nan_to_num(), (halo, halo), mode="circular") for x in (left, right)),
                cameras,
                pair,
                0,
            ),
            "cut the repeated columns off again: `halo` on both sides",
        ),
        (
            lambda left, right, *rest: pair_features(left + 0 * right, right + 0 * left, *rest),
            "each image keeps what it sees: only its own NaN become 0",
        ),
        (lambda left, right, *rest: pair_features(right, left, *rest), "left first, then right"),
        (lambda left, right, *rest: pair_features(left, left, *rest), "both features come from the left image"),
        (lambda *a: pair_features(*a).permute(0, 3, 1, 2), "the numbers of a ray come last: permute(0, 2, 3, 1)"),
        (
            lambda *a: torch.full_like(pair_features(*a), torch.nan),
            "a NaN spreads through every layer: 0 first",
        ),
        (lambda left, right, *rest: pair_features(_filled(left), _filled(right), *rest), "what is unseen is 0"),
    ],
)


def draw_labels(true_index, n, luck, most, per_positive, least):
    """Labels (H, W) of sphere n: 0 on positives, 1 on negatives, NaN on rays that are not asked."""
    positives = np.flatnonzero(np.rint(true_index) == n)
    negatives = np.flatnonzero(np.abs(np.rint(true_index) - n) >= 1)  # an unknown index, NaN, is neither
    positives = positives[luck.flat[positives].argsort()[:most]]
    count = max(per_positive * len(positives), least)
    negatives = negatives[luck.flat[negatives].argsort()[:count]]
    labels = np.full(true_index.shape, np.nan)
    labels.flat[positives] = 0
    labels.flat[negatives] = 1
    return labels


def _a_sphere(rng: Rng, k: int) -> tuple:
    n = int(rng.integers(2, 9))
    true_index = n + rng.uniform(-3, 3, (8, 10 + k % 3))
    true_index[:2] = n + rng.uniform(-0.49, 0.49, true_index[:2].shape)
    true_index[rng.uniform(0, 1, true_index.shape) < 0.2] = np.nan
    if k == 4:
        true_index = np.where(np.rint(true_index) == n, np.nan, true_index)  # no positive at all
    return true_index, n, rng.uniform(0, 1, true_index.shape), (4, 8, 50)[k % 3], (1, 2)[k % 2], (0, 12, 25)[k // 2 % 3]


def _labels(true: Array, n: int, luck: Array, most: int, per: int, least: int, count: object, rounded: object) -> Array:
    """Labels with another number of negatives, or another sphere of a ray."""
    positive, known = rounded(true) == n, np.isfinite(true)
    labels = np.full(true.shape, np.nan)
    chosen = np.flatnonzero(positive)[luck[positive].argsort()[:most]]
    others = np.flatnonzero(known & ~positive)
    number = count(len(chosen), int(positive.sum()), per, least)
    labels.flat[others[luck.flat[others].argsort()[:number]]] = 1
    labels.flat[chosen] = 0
    return labels


def _larger(chosen: int, all_of_them: int, per: int, least: int) -> int:
    return max(per * chosen, least)


check_draw_labels = Open(
    draw_labels,
    _a_sphere,
    [
        (lambda *a: 1 - draw_labels(*a), "the wrong way round: a match is 0, for the label as for the cost"),
        (lambda *a: np.nan_to_num(draw_labels(*a)), "a ray that is not asked has no label: NaN"),
        (lambda *a: np.nan_to_num(draw_labels(*a), nan=1), "a ray that is not asked has no label: NaN"),
        (lambda *a: _labels(*a, _larger, np.floor), "a ray belongs to the nearest sphere: round, do not cut off"),
        (
            lambda *a: _labels(*a, _larger, lambda x: np.where(np.abs(x - a[1]) <= 1, a[1], x)),
            "half a sphere to each side, not a whole one",
        ),
        (
            lambda *a: _labels(*a, lambda chosen, every, per, least: per * every, np.rint),
            "count the positives that were drawn, not all of them; and take at least `least`",
        ),
        (
            lambda *a: _labels(*a, lambda chosen, every, per, least: max(per * every, least), np.rint),
            "count the positives that were drawn, not all of them",
        ),
        (
            lambda *a: _labels(*a, lambda chosen, every, per, least: per * chosen, np.rint),
            "at least `least` negatives: a sphere without positives has them, too",
        ),
        (
            lambda *a: _labels(*a, lambda chosen, every, per, least: per * chosen + least, np.rint),
            "the larger of the two numbers, not their sum",
        ),
        (
            lambda *a: _labels(*a, lambda chosen, every, per, least: min(per * chosen, least), np.rint),
            "`least` is a lower limit: max, not min",
        ),
        (lambda t, n, luck, *rest: draw_labels(t, n, -luck, *rest), "those with the smallest luck"),
        (lambda t, n, luck, *rest: draw_labels(t, n, np.arange(luck.size), *rest), "those with the smallest luck"),
        (lambda t, n, luck, most, *rest: draw_labels(t, n, luck, luck.size, *rest), "at most `most` positives"),
        (lambda t, n, luck, *rest: draw_labels(np.nan_to_num(t), n, luck, *rest), "an unknown index is no sphere"),
    ],
)


def balanced_loss(score, label):
    """Eq. 4 of scores (K,) before the sigmoid; all positives (label 0) weigh one half, and so do all negatives."""
    positive, negative = label == 0, label == 1
    loss = nn.functional.softplus(torch.where(positive, score, -score))
    weight = torch.where(positive, 0.5 / positive.sum(), 0.5 / negative.sum())
    return (weight * loss).sum()


def _scores(rng: Rng, k: int) -> tuple:
    label = np.repeat([0.0, 1.0], [0 if k == 4 else 4, 11 + k])
    rng.shuffle(label)
    score = rng.normal(0, 2, len(label))
    score[label == 1] += 1
    if k == 6:
        score[label == 0] = 30 + np.arange(4)  # the sigmoid of these is 1 in single precision
    return _tensor(score), _tensor(label)


def _naive(score: Tensor, label: Tensor) -> Tensor:
    cost = torch.sigmoid(score)
    each = torch.where(label == 0, -torch.log(1 - cost), -torch.log(cost))
    return (each * torch.where(label == 0, 0.5 / (label == 0).sum(), 0.5 / (label == 1).sum())).sum()


def _each(score: Tensor, label: Tensor) -> Tensor:
    return nn.functional.softplus(torch.where(label == 0, score, -score))


def _means(score: Tensor, label: Tensor) -> Tensor:
    each = _each(score, label)
    return (each[label == 0].mean() + each[label == 1].mean()) / 2


def _one_kind(kind: int):
    return lambda s, label: 0.5 * _each(s, label)[label == kind].sum() / max(1, int((label == kind).sum()))


check_balanced_loss = Open(
    balanced_loss,
    _scores,
    [
        (lambda s, label: balanced_loss(-s, label), "the sigmoid of the score is the probability of *no* match: signs"),
        (lambda s, label: _each(s, label).mean(), "there are more negatives: each kind weighs one half in all"),
        (lambda s, label: _each(s, label), "add up: one number for all rays"),
        (lambda s, label: 2 * balanced_loss(s, label), "each kind weighs one half, not one"),
        (_means, "the mean of no rays is NaN: a batch without positives has one kind only, which weighs one half"),
        (_naive, "where the sigmoid rounds to 1, log(1 - sigmoid) is infinite: softplus(score) is the same, exactly"),
        (lambda s, label: balanced_loss(torch.sigmoid(s), label), "softplus takes the score, not its sigmoid"),
        (_one_kind(1), "the positives are missing: label 0 costs softplus(score)"),
        (_one_kind(0), "the negatives are missing: label 1 costs softplus(-score)"),
        (lambda s, label: balanced_loss(s, label) / np.log(2), "the natural logarithm, not base 2"),
    ],
)
