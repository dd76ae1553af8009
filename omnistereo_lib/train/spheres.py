"""Samples and loss of SweepNet: labelled rays on whole spheres (paper, Section III-C and IV)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits, pad

from omnistereo_lib.dataset import Frame
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.stereo.learned import Features
from omnistereo_lib.stereo.sweepnet import SweepNet
from omnistereo_lib.train.frames import TrainingFrames, shuffled_true, to_device
from omnistereo_lib.train.recipes import SweepNetRecipe

_TRIES = 10  # draws of spheres, of which some may have their positives where no pair of cameras sees them


@dataclass(frozen=True)
class Strip:
    """The feature columns first … last - 1 that cameras i and j share, and its labelled pixels."""

    i: int
    j: int
    first: int
    last: int
    labelled: Tensor  # bool (S, H, pixels)
    label: Tensor  # float (number labelled,): 0 = positive, 1 = negative


@dataclass(frozen=True)
class SphereGroup:
    """Some spheres of one frame: warped images (cameras, S, H, W), NaN where unseen, and the strips with labels."""

    spherical: Tensor
    strips: list[Strip]


class SphereSamples(TrainingFrames):
    """Draws groups of spheres; see `TrainingFrames`."""

    recipe: SweepNetRecipe

    def __init__(self, recipe: SweepNetRecipe, data: str | Path, device: torch.device | str = "cpu") -> None:
        super().__init__(recipe, data, device)
        self.network = SweepNet(recipe.batch_norm, recipe.wrap)
        self.network.check_size(recipe.height, recipe.width)
        self._halved = SphereSamples(_halved(recipe), data, device) if recipe.halve else None

    def group(self, frame: Frame, rng: np.random.Generator, augment: bool) -> SphereGroup:
        """Draw spheres of a frame, camera pairs' labels on them, and how the panorama is turned and mirrored."""
        if self._halved is not None and rng.integers(2):
            return self._halved.group(frame, rng, augment)
        images, index = self.images(frame, rng if augment else None), self.gt_index(frame)
        for _ in range(_TRIES):
            block, spheres = self._draw_spheres(index, frame, rng)
            spherical = self.sweep.warp_block(images, block)[:, [n - block.start for n in spheres]]
            columns = [self.sweep.visible_columns(camera, block) for camera in range(len(self.sweep.rig))]
            true_sphere, pairs = np.rint(index), self.pairs  # NaN where unknown
            if augment:
                spherical, true_sphere, columns = self._turned(spherical, true_sphere, columns, rng)
                pairs = [(j, i) if rng.integers(2) else (i, j) for i, j in pairs]
            strips = self._strips(spherical, spheres, true_sphere, columns, pairs, rng)
            if strips:
                return SphereGroup(spherical, strips)
        raise OmnistereoError(f"no true depth of frame {frame.number} is seen by two cameras: is the rig right?")

    def _turned(
        self, spherical: Tensor, true_sphere: NDArray, columns: list[tuple[int, int]], rng: np.random.Generator
    ) -> tuple[Tensor, NDArray, list[tuple[int, int]]]:
        """Turn the panorama by any number of columns, and mirror the world or not."""
        W = self.grid.width
        shift, mirror = int(rng.integers(W)), bool(rng.integers(2))
        spherical, true_sphere = spherical.roll(shift, -1), np.roll(true_sphere, shift, -1)
        columns = [((start + shift) % W, width) for start, width in columns]
        if mirror:
            spherical, true_sphere = spherical.flip(-1), true_sphere[:, ::-1]
            columns = [(-(start + width) % W, width) for start, width in columns]
        return spherical, true_sphere, columns

    def _draw_spheres(self, index: NDArray, frame: Frame, rng: np.random.Generator) -> tuple[range, NDArray[np.int64]]:
        """Draw spheres from one block, about equally often all that have enough positives, and now and then others."""
        N = self.grid.num_spheres
        inside = index[(index > -0.5) & (index < N - 0.5)]
        enough = np.bincount(np.rint(inside).astype(int), minlength=N) >= self.recipe.min_positives
        if rng.random() < self.recipe.any_sphere:
            enough[:] = True
        if self.recipe.far_end and rng.random() < self.recipe.far_end:  # 0 draws nothing: the samples stay as they were
            enough[:] = False
            enough[slice(0, 1) if rng.integers(2) else slice(1, max(2, N // 6))] = True
        blocks = self.sweep.blocks()
        counts = np.array([enough[spheres.start : spheres.stop].sum() for spheres in blocks])
        if counts.sum() == 0:
            raise OmnistereoError(
                f"no sphere of frame {frame.number} has {self.recipe.min_positives} positives: is D_min right?"
            )
        block = blocks[rng.choice(len(blocks), p=counts / counts.sum())]
        candidates = block.start + np.flatnonzero(enough[block.start : block.stop])
        chosen = rng.choice(candidates, min(self.recipe.spheres_per_frame, len(candidates)), replace=False)
        return block, np.sort(chosen)

    def _strips(
        self,
        spherical: Tensor,
        spheres: NDArray[np.int64],
        true_sphere: NDArray,
        columns: list[tuple[int, int]],
        pairs: list[tuple[int, int]],
        rng: np.random.Generator,
    ) -> list[Strip]:
        seen = ~spherical.isnan().cpu().numpy()
        positive = true_sphere == spheres[:, None, None]
        enough = positive.sum(axis=(1, 2), keepdims=True) >= self.recipe.min_positives
        known = np.isfinite(true_sphere) & (enough | ~positive)  # each of a few would weigh too much
        positive &= enough
        W = self.grid.width
        strips = []
        for i, j in pairs:
            for first, last in self.network.strips(columns[i], columns[j], W):
                pixels = np.arange(2 * first, 2 * last) % W
                common = (seen[i] & seen[j] & known)[..., pixels]
                labelled, label = self._draw_labels(common, positive[..., pixels], rng)
                if labelled.any():
                    tensors = (to_device(x, self.sweep.device) for x in (labelled, label))
                    strips.append(Strip(i, j, first, last, *tensors))
        return strips

    def _draw_labels(
        self, common: NDArray[np.bool_], positive: NDArray[np.bool_], rng: np.random.Generator
    ) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
        """Draw, on every sphere, positives and for each of them some negatives; return which, and their labels."""
        labelled = np.zeros(common.shape, bool)
        for k in range(len(common)):
            chosen = shuffled_true(common[k] & positive[k], self.recipe.max_positives, rng)
            number = max(self.recipe.negatives * len(chosen), self.recipe.min_negatives)
            others = shuffled_true(common[k] & ~positive[k], number, rng)
            labelled[k].reshape(-1)[np.concatenate([chosen, others])] = True
        return labelled, np.where(positive[labelled], 0.0, 1.0).astype(np.float32)


def _halved(recipe: SweepNetRecipe) -> SweepNetRecipe:
    width, height, spheres = recipe.width // 2, recipe.height // 2, 2 * recipe.spheres_per_frame
    num_spheres = recipe.num_spheres // 2
    return replace(recipe, halve=False, width=width, height=height, num_spheres=num_spheres, spheres_per_frame=spheres)


class SphereObjective(nn.Module):
    """The paper's binary cross-entropy (Eq. 4), positives and negatives weighing the same.

    Parameters
    ----------
    network : SweepNet
    """

    def __init__(self, network: SweepNet) -> None:
        super().__init__()
        self.network = network

    def forward(self, group: SphereGroup) -> tuple[Tensor, Tensor]:
        """Return the loss of a group and its balanced error: the mean share of wrong positives and negatives."""
        score, label = self._scores(group)
        share = torch.stack([(label == 0).float().mean(), (label == 1).float().mean()])
        weight = 0.5 / share.clamp_min(1e-9)[label.long()]
        loss = binary_cross_entropy_with_logits(score, label, weight)
        return loss, (weight * ((score > 0) != (label > 0.5))).mean()

    def _scores(self, group: SphereGroup) -> tuple[Tensor, Tensor]:
        C, S, H, W = group.spherical.shape
        maps = self.network.describe(group.spherical.reshape(C * S, H, W), (0, W)).maps
        cameras = [Features(part, 0, W // 2) for part in maps.split(S)]
        label = torch.cat([strip.label for strip in group.strips])
        if self.network.wrap:
            return self._compare_together(cameras, group.strips), label
        parts = (self.network.score(cameras[s.i], cameras[s.j], s.first, s.last, s.labelled) for s in group.strips)
        return torch.cat(list(parts)), label

    def _compare_together(self, cameras: list[Features], strips: list[Strip]) -> Tensor:
        """Compare all strips at once, widened to the widest, so that norms see all of the group."""
        widest, margin = max(strip.last - strip.first for strip in strips), self.network.margin
        sides, labelled = ([], []), []
        for strip in strips:
            for side, camera in zip(sides, (strip.i, strip.j), strict=True):
                side.append(cameras[camera].columns(strip.first - margin, strip.first + widest + margin))
            labelled.append(pad(strip.labelled, (0, 2 * widest - strip.labelled.shape[-1])))
        left, right = (torch.cat(side) for side in sides)
        return self.network.compare(left, right, torch.cat(labelled), 2 * margin)
