"""Samples and loss of SweepNet: labelled rays on whole spheres (paper, Section III-C and IV)."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits, pad

from omnistereo_learn.recipes import SweepNetRecipe
from omnistereo_learn.samples.frames import Folders, SweptFrames, sample_true_indices, to_device
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.frame import Frame
from omnistereo_lib.geometry.rig import Pair
from omnistereo_lib.stereo.learned import Features
from omnistereo_lib.stereo.sweepnet import SweepNet

Columns = list[tuple[int, int]]  # (start, width) around the seam, for each camera
# draws of spheres, some of which may have positives only where no pair of cameras sees them
_TRIES = 10


@dataclass(frozen=True)
class Strip:
    """Feature columns start … stop - 1 that cameras i and j share, and their labelled pixels."""

    i: int
    j: int
    start: int
    stop: int
    labelled: Tensor  # bool (S, H, pixels)
    label: Tensor  # float (number labelled,): 0 = positive, 1 = negative


@dataclass(frozen=True)
class SphereBatch:
    """A micro-batch: images (cameras, S, H, W) of S spheres, NaN unseen, and labelled strips."""

    spherical_images: Tensor
    strips: list[Strip]


class SphereSamples(SweptFrames):
    """Draws micro-batches of spheres; see `SweptFrames`."""

    recipe: SweepNetRecipe

    def __init__(
        self, recipe: SweepNetRecipe, data: Folders, device: torch.device | str = "cpu"
    ) -> None:
        super().__init__(recipe, data, device)
        self.network = SweepNet(recipe.batch_norm, recipe.wrap)
        self.network.check_size(recipe.height, recipe.width)
        self.objective = SphereObjective(self.network)
        self._half_size = None
        if recipe.halve:
            half = replace(
                recipe,
                width=recipe.width // 2,
                height=recipe.height // 2,
                num_spheres=recipe.num_spheres // 2,
                halve=False,
                spheres_per_frame=2 * recipe.spheres_per_frame,
            )
            self._half_size = self.with_recipe(half)

    def micro_batch(self, frame: Frame, rng: np.random.Generator, augment: bool) -> SphereBatch:
        """Sample spheres of one frame and label rays on them (Eq. 3); `augment` turns them."""
        if self._half_size is not None and rng.integers(2):
            return self._half_size.micro_batch(frame, rng, augment)
        index = self.use(frame)
        images = self.images(frame, rng if augment else None)
        for _ in range(_TRIES):
            block, spheres = self._draw_spheres(index, frame, rng)
            spherical_images = self.sweep.warp_block(images, block)[
                :, [n - block.start for n in spheres]
            ]
            columns = [
                self.sweep.visible_columns(camera, block) for camera in range(len(self.sweep.rig))
            ]
            gt_sphere, pairs = np.rint(index), self.pairs  # NaN where unknown
            if augment:
                spherical_images, gt_sphere, columns = self._augment_rotation(
                    spherical_images, gt_sphere, columns, rng
                )
                pairs = [(j, i) if rng.integers(2) else (i, j) for i, j in pairs]
            visible = ~spherical_images.isnan().cpu().numpy()
            positive = gt_sphere == spheres[:, None, None]
            strips = self._strips(visible, positive, np.isfinite(gt_sphere), columns, pairs, rng)
            if strips:
                return SphereBatch(spherical_images, strips)
        raise OmnistereoError(
            f"frame {frame.number}: no true depth is visible to two cameras. Check the rig and the"
            " ground truth."
        )

    def _augment_rotation(
        self, images: Tensor, gt_sphere: NDArray[Any], columns: Columns, rng: np.random.Generator
    ) -> tuple[Tensor, NDArray[Any], Columns]:
        """Rotate the panorama by any number of columns, and flip it or not."""
        W = self.grid.width
        shift, flip = int(rng.integers(W)), bool(rng.integers(2))
        images, gt_sphere = images.roll(shift, -1), np.roll(gt_sphere, shift, -1)
        columns = [((start + shift) % W, width) for start, width in columns]
        if flip:
            images, gt_sphere = images.flip(-1), gt_sphere[:, ::-1]
            columns = [(-(start + width) % W, width) for start, width in columns]
        return images, gt_sphere, columns

    def _draw_spheres(
        self, index: NDArray[Any], frame: Frame, rng: np.random.Generator
    ) -> tuple[range, NDArray[Any]]:
        """Draw spheres of one block: enough positives equally often, at times others."""
        N = self.grid.num_spheres
        inside = index[(index > -0.5) & (index < N - 0.5)]
        enough = np.bincount(np.rint(inside).astype(int), minlength=N) >= self.recipe.min_positives
        if rng.random() < self.recipe.any_sphere:
            enough[:] = True
        blocks = self.sweep.blocks()
        counts = np.array([enough[spheres.start : spheres.stop].sum() for spheres in blocks])
        if counts.sum() == 0:
            raise OmnistereoError(
                f"frame {frame.number}: no sphere has {self.recipe.min_positives} positives. Check"
                " the nearest depth."
            )
        block = blocks[rng.choice(len(blocks), p=counts / counts.sum())]
        candidates = block.start + np.flatnonzero(enough[block.start : block.stop])
        spheres = rng.choice(
            candidates, min(self.recipe.spheres_per_frame, len(candidates)), replace=False
        )
        return block, np.sort(spheres)

    def _strips(
        self,
        visible: NDArray[Any],
        positive: NDArray[Any],
        known: NDArray[Any],
        columns: Columns,
        pairs: list[Pair],
        rng: np.random.Generator,
    ) -> list[Strip]:
        """Label the columns that each pair shares, of (cameras, S, H, W), (S, H, W) and (H, W)."""
        enough = positive.sum(axis=(1, 2), keepdims=True) >= self.recipe.min_positives
        known = known & (enough | ~positive)  # each of a few would weigh too much
        positive &= enough
        W = self.grid.width
        strips = []
        for i, j in pairs:
            for start, stop in self.network.shared_strips(columns[i], columns[j], W):
                pixels = np.arange(2 * start, 2 * stop) % W
                common = (visible[i] & visible[j] & known)[..., pixels]
                labelled, label = self._draw_labels(common, positive[..., pixels], rng)
                if labelled.any():
                    tensors = (to_device(x, self.sweep.device) for x in (labelled, label))
                    strips.append(Strip(i, j, start, stop, *tensors))
        return strips

    def _draw_labels(
        self, common: NDArray[Any], positive: NDArray[Any], rng: np.random.Generator
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        """Draw, on every sphere, positives and some negatives for each; return mask and labels."""
        labelled = np.zeros(common.shape, bool)
        for k in range(len(common)):
            positives = sample_true_indices(common[k] & positive[k], self.recipe.max_positives, rng)
            number = max(self.recipe.negatives * len(positives), self.recipe.min_negatives)
            negatives = sample_true_indices(common[k] & ~positive[k], number, rng)
            labelled[k].reshape(-1)[np.concatenate([positives, negatives])] = True
        return labelled, np.where(positive[labelled], 0.0, 1.0).astype(np.float32)


class SphereObjective(nn.Module):
    """The paper's binary cross-entropy (Eq. 4); positives and negatives weigh the same in all."""

    def __init__(self, network: SweepNet) -> None:
        super().__init__()
        self.network = network

    def forward(self, batch: SphereBatch) -> tuple[Tensor, Tensor]:
        """Return the loss and the balanced error: the mean of wrong positives and negatives."""
        score, label = self._scores(batch), torch.cat([strip.label for strip in batch.strips])
        fraction = torch.stack([(label == 0).float().mean(), (label == 1).float().mean()])
        weight = 0.5 / fraction.clamp_min(1e-9)[label.long()]
        loss = binary_cross_entropy_with_logits(score, label, weight)
        return loss, (weight * ((score > 0) != (label > 0.5))).mean()

    def _scores(self, batch: SphereBatch) -> Tensor:
        network, (C, S, H, W) = self.network, batch.spherical_images.shape
        features = network.extract_columns(batch.spherical_images.reshape(C * S, H, W), (0, W))
        cameras = [Features(maps, 0, W // 2) for maps in features.maps.split(S)]
        if network.wrap:
            return network.score_pixels(self._match_together(cameras, batch.strips))
        pixels = [
            network.match_columns(cameras[s.i], cameras[s.j], s.start, s.stop)[s.labelled]
            for s in batch.strips
        ]
        return network.score_pixels(torch.cat(pixels))

    def _match_together(self, cameras: list[Features], strips: list[Strip]) -> Tensor:
        """Match all strips at once, as wide as the widest: batch norms see the micro-batch."""
        widest, halo = max(strip.stop - strip.start for strip in strips), self.network.match_halo
        left, right = (
            torch.cat(
                [
                    cameras[k].wrapped_columns(s.start - halo, s.start + widest + halo)
                    for s, k in side
                ]
            )
            for side in ([(s, s.i) for s in strips], [(s, s.j) for s in strips])
        )
        pixels = self.network.match_features(left, right)[:, :, 2 * halo : 2 * (halo + widest)]
        labelled = [pad(s.labelled, (0, 2 * widest - s.labelled.shape[-1])) for s in strips]
        return pixels[torch.cat(labelled)]
