"""Notebook 08: the features of a camera, the comparison of two, the labels of a sphere, the
balanced loss."""

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
    return [
        (_tensor(weight).requires_grad_(), _tensor(rng.normal(0.1, 0.2, shape[0])))
        for weight, shape in drawn
    ]


def _tensor(values: Array) -> Tensor:
    return torch.from_numpy(np.asarray(values)).float()


def _per_camera(rng: Rng, channels: int, blocks: int) -> Layers:
    return _layers(rng, (channels, 1, 5, 5), *[(channels, channels, 3, 3)] * (2 * blocks + 1))


def _images_and_layers(rng: Rng, k: int) -> tuple:
    return _tensor(rng.normal(0, 1, (2, 8, 10 + 2 * (k % 3)))), _per_camera(
        rng, 3 + k % 2, 2 + k % 2
    )


check_camera_features = Open(camera_features, _images_and_layers).with_slips("""
    torch.relu(x + nn → torch.relu(nn  # the shortcut is missing: add the input of each block
    torch.relu(x + nn → x + torch.relu(nn  # add the input of a block before its last ReLU
    inner = torch.relu(nn.functional.conv2d(x, *one, padding=1))
    → inner = nn.functional.conv2d(x, *one, padding=1)
    # there is a ReLU between the two layers of a block, too
    return torch.relu(nn.functional.conv2d(x, *conv18, padding=1))
    → return nn.functional.conv2d(x, *conv18, padding=1)
    # conv18 has a ReLU behind it as well
    *conv1, stride → conv1[0], stride
    *one → one[0]
    *two → two[0]
    *conv18 → conv18[0]
    # add the bias of each layer, the second argument of conv2d after the image
""")


def pair_features(left, right, per_camera, per_pair, halo):
    """Numbers (B, H, W, C) of each ray, of two warped images (B, H, W), NaN where a camera does not
    see it, around the seam; NaN where not both see the ray."""
    seen = (left + right).isfinite()
    left, right = (
        nn.functional.pad(x.nan_to_num(), (halo, halo), mode="circular") for x in (left, right)
    )
    conv19, deconv1, conv20 = per_pair
    x = torch.cat([camera_features(left, per_camera), camera_features(right, per_camera)], dim=1)
    x = torch.relu(nn.functional.conv2d(x, *conv19, padding=1))
    x = torch.relu(
        nn.functional.conv_transpose2d(x, *deconv1, stride=2, padding=1, output_padding=1)
    )
    x = torch.relu(nn.functional.conv2d(x, *conv20, padding=1))
    x = x[..., halo : x.shape[-1] - halo].permute(0, 2, 3, 1)
    return torch.where(seen[..., None], x, torch.nan)


def _two_images(rng: Rng, k: int) -> tuple:
    channels, wide = 3, 4
    images = rng.normal(0, 1, (2, 1, 8, 12 + 2 * (k % 3)))
    images[0, :, 2:4, 5:8] = images[1, :, :2, 1:3] = np.nan
    left, right = map(_tensor, images)
    per_pair = _layers(rng, (wide, 2 * channels, 3, 3), (wide, wide, 3, 3), (wide, wide, 3, 3))
    return left, right, _per_camera(rng, channels, 2), per_pair, 4 + 2 * (k % 2)


check_pair_features = Open(pair_features, _two_images).with_slips("""
    mode="circular" → mode="constant"
    # zeros beyond the seam are not what is there: mode='circular'
    mode="circular" → mode="replicate"  # the panorama is a circle: mode='circular'
    seen = (left + right).isfinite()
    → seen = (left + right).isfinite(); left, right = left + 0 * right, right + 0 * left
    # each image keeps what it sees: only its own NaN become 0
    torch.where(seen[..., None], x, torch.nan) → x
    # NaN where not both see the ray
""")


def draw_labels(true_index, n, luck, most, per_positive, least):
    """Labels (H, W) of sphere n: 0 on positives, 1 on negatives, NaN on rays that are not asked."""
    positives = np.flatnonzero(np.rint(true_index) == n)
    # an unknown index, NaN, is neither
    negatives = np.flatnonzero(np.abs(np.rint(true_index) - n) >= 1)
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
    return (
        true_index,
        n,
        rng.uniform(0, 1, true_index.shape),
        (4, 8, 50)[k % 3],
        (1, 2)[k % 2],
        (0, 12, 25)[k // 2 % 3],
    )


check_draw_labels = Open(
    draw_labels, _a_sphere, keywords=("most", "per_positive", "least")
).with_slips("""
    max(per_positive * len(positives), least) → per_positive * len(positives)
    # at least `least` negatives: a sphere without positives has them, too
    max(per_positive * len(positives) → max(per_positive * np.sum(np.rint(true_index) == n)
    # count the positives that were drawn, not all of them
    max(per_positive * len(positives), least) → per_positive * len(positives) + least
    # the larger of the two numbers, not their sum
    [:most] →  # at most `most` positives
""")


def balanced_loss(score, label):
    """Eq. 4 of scores (K,) before the sigmoid; all positives (label 0) weigh one half, and so do
    all negatives."""
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
    return _tensor(score).requires_grad_(), _tensor(label)


check_balanced_loss = Open(balanced_loss, _scores).with_slips("""
    (weight * loss).sum() → loss.mean()
    # there are more negatives: each kind weighs one half in all
    (weight * loss).sum() → (loss[positive].mean() + loss[negative].mean()) / 2
    # the mean of no rays is NaN: a batch without positives has one kind only, which weighs one half
    nn.functional.softplus(torch.where(positive, score, -score))
    → -torch.log(torch.where(positive, 1 - torch.sigmoid(score), torch.sigmoid(score)))
    # where the sigmoid rounds to 1, log(1 - sigmoid) is infinite: softplus(score) is the same,
    # exactly
    torch.where(positive, score, -score) → torch.where(positive, score.sigmoid(), -score.sigmoid())
    # softplus takes the score, not its sigmoid
""")
