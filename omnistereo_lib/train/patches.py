"""Samples and losses of MC-CNN: pairs of 9 × 9 patches that do or do not show the same point."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits

from omnistereo_lib.dataset import Frame
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.stereo.mccnn import MCCNN, PATCH
from omnistereo_lib.stereo.sweep import OUTSIDE, remap
from omnistereo_lib.train.frames import TrainingFrames, to_device
from omnistereo_lib.train.recipes import MCCNNRecipe

_RADIUS = PATCH // 2
_DRAWS = 4  # rays drawn for each one needed: some are unseen, hidden, or too near the rig's axis of motion
_LEAST_RATE = 0.02  # pixels a sphere: below, no sphere is a whole non-match away
_HIDDEN_STEPS = 12  # points looked at between a camera and what it should see


@dataclass(frozen=True)
class PatchGroup:
    """Patches (2 K, 9, 9) of two cameras: K pairs that match, then K of the same rays that do not."""

    left: Tensor
    right: Tensor


class PatchSamples(TrainingFrames):
    """Draws groups of patch pairs; see `TrainingFrames`."""

    recipe: MCCNNRecipe

    def __init__(self, recipe: MCCNNRecipe, data: str | Path, device: torch.device | str = "cpu") -> None:
        super().__init__(recipe, data, "cpu")  # patches are cut out here, and compared on the device
        self.device = torch.device(device)
        self.network = MCCNN(recipe.variant)
        self.network.check_size(recipe.height, recipe.width)

    def group(self, frame: Frame, rng: np.random.Generator, augment: bool) -> PatchGroup:
        """Draw rays of a frame, camera pairs for them, and spheres where they match and where they do not."""
        images = [image.numpy() for image in self.images(frame, rng if augment else None)]
        index = self.gt_index(frame)
        sides: tuple[list, list] = ([], [])
        quota = -(-self.recipe.rays_per_frame // len(self.pairs))
        for i, j in self.pairs:
            pixel, match, other = self.draw_rays(index, i, j, quota, rng)
            if len(pixel) == 0:
                continue
            i, j = (j, i) if augment and rng.integers(2) else (i, j)
            for side, camera in zip(sides, (i, j), strict=True):
                side.append([self.patches(images[camera], camera, pixel, n) for n in (match, other)])
        if not sides[0]:
            raise OmnistereoError(
                f"no ray of frame {frame.number} fits: seen by two cameras, and a sphere on which what they see is "
                f"{self.recipe.negative_low_px} pixels off. Are the rig and the ground truth right?"
            )
        left, right = (np.concatenate([np.concatenate(kind) for kind in zip(*side, strict=True)]) for side in sides)
        if augment and rng.integers(2):  # a mirrored world
            left, right = left[..., ::-1], right[..., ::-1]
        return PatchGroup(to_device(left, self.device), to_device(right, self.device))

    def draw_rays(
        self, index: NDArray, i: int, j: int, count: int, rng: np.random.Generator
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """Draw rays that cameras i and j both see, and spheres at which they show the same point and another.

        Returns
        -------
        pixel : shape (K, 2), K ≤ count
            Row and column of each ray.
        match, other : shape (K,)
            Sphere indices: off the truth by at most `positive_px`, and by `negative_low_px` … `negative_high_px`,
            in pixels by which the two cameras' pictures of the point part.
        """
        recipe, last = self.recipe, self.grid.num_spheres - 1
        rows, columns = (rng.integers(size, size=_DRAWS * count) for size in self.grid.shape)
        true = index[rows, columns].astype(np.float64)
        inside = (true >= 0) & (true <= last)
        true = np.where(inside, true, 0.0)
        rate = self.parting(i, j, rows, columns, true, 1.0)
        off = rng.uniform(-recipe.positive_px, recipe.positive_px, len(true)) / np.maximum(rate, _LEAST_RATE)
        away = rng.uniform(recipe.negative_low_px, recipe.negative_high_px, len(true)) / np.maximum(rate, _LEAST_RATE)
        away *= rng.choice([-1, 1], len(true))
        away = np.where((true + away < 0) | (true + away > last), -away, away)
        fits = inside & (rate > _LEAST_RATE) & (true + away >= 0) & (true + away <= last)
        for camera in (i, j):
            fits &= self.sees(camera, rows, columns, true) & ~self._hidden(camera, index, rows, columns, true)
            fits &= self.sees(camera, rows, columns, true + away)
        kept = np.flatnonzero(fits)[:count]
        pixel = np.stack([rows, columns], -1)[kept]
        return pixel, (true + off).clip(0, last)[kept], (true + away)[kept]

    def parting(
        self, i: int, j: int, rows: NDArray, columns: NDArray, true: NDArray, away: ArrayLike
    ) -> NDArray[np.float64]:
        """Return how far apart, in pixels, two cameras show a point on a sphere `away` spheres off its own.

        On its own sphere they show it at the same place. `away` = 1 gives the rate in pixels a sphere.
        """
        shown = [self.grid.pixel(self._shown_at(camera, rows, columns, true, true + away))[0] for camera in (i, j)]
        apart = shown[0] - shown[1]
        W = self.grid.width
        apart[..., 0] = (apart[..., 0] + W / 2) % W - W / 2
        return np.hypot(apart[..., 0], apart[..., 1])

    def _shown_at(
        self, camera: int, rows: NDArray, columns: NDArray, true: NDArray, swept: NDArray
    ) -> NDArray[np.float64]:
        """Return the direction at which the panorama of sphere `swept` shows the true point of a ray: (K, 3).

        It is where the line of sight from the camera's centre c, direction u, meets the sphere: |d c + s u| = 1.
        """
        center = self.sweep.rig.T_rig_cam[camera].t
        sight = self.rays[rows, columns] - self._inverse(true) * center
        sight /= np.linalg.norm(sight, axis=-1, keepdims=True)
        start = self._inverse(swept) * center
        along = (start * sight).sum(-1, keepdims=True)
        return start + sight * (np.sqrt(along**2 + 1 - (start**2).sum(-1, keepdims=True)) - along)

    def _inverse(self, index: NDArray) -> NDArray[np.float64]:
        return self.grid.index_to_inverse_depth(index)[:, None]

    def sees(self, camera: int, rows: NDArray, columns: NDArray, index: NDArray) -> NDArray[np.bool_]:
        """Say whether rays at given spheres lie in a camera's field of view."""
        return self._project(camera, self.rays[rows, columns], self._inverse(index))[1]

    def _hidden(self, camera: int, index: NDArray, rows: NDArray, columns: NDArray, true: NDArray) -> NDArray[np.bool_]:
        """Say whether something stands between a camera and a point, by the ground truth seen from the centre."""
        center = self.sweep.rig.T_rig_cam[camera].t
        inverse = np.maximum(self._inverse(true), 1e-6)
        hidden = np.zeros(len(true), bool)
        for t in np.linspace(0.1, 0.95, _HIDDEN_STEPS):
            point = center + t * (self.rays[rows, columns] / inverse - center)
            pixel, inside = self.grid.pixel(point)
            column, row = np.rint(pixel).astype(int).T
            here = self.grid.depth_to_index(np.linalg.norm(point, axis=-1))
            nearest = index[row.clip(0, self.grid.height - 1), column % self.grid.width]
            hidden |= inside & (nearest > here + 1)  # one sphere of slack for slanted surfaces
        return hidden

    def patches(
        self, image: NDArray[np.float32], camera: int, pixel: NDArray[np.int64], index: NDArray[np.float64]
    ) -> NDArray[np.float32]:
        """Cut patches (K, 9, 9) around pixels (K, 2) out of a camera's panoramas of spheres `index` (K,).

        They are what `MCCNN` sees: 0 where the camera does not see, above and below the panorama.
        """
        around = np.arange(-_RADIUS, _RADIUS + 1)
        rows = pixel[:, 0, None, None] + around[:, None]
        columns = (pixel[:, 1, None, None] + around) % self.grid.width
        rays = self.rays[rows.clip(0, self.grid.height - 1), columns]
        uv, valid = self._project(camera, rays, self._inverse(index)[..., None, None])
        valid &= (rows >= 0) & (rows < self.grid.height)
        maps = np.where(valid[..., None], uv, OUTSIDE).astype(np.float32)
        return np.nan_to_num(remap(image, maps.reshape(-1, PATCH, 2))).reshape(-1, PATCH, PATCH)

    def _project(self, camera: int, rays: NDArray, inverse: NDArray) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        T_cam_rig = self.sweep.rig.T_rig_cam[camera].inverse()
        return self.sweep.rig.cameras[camera].project(
            rays @ T_cam_rig.R.T + np.maximum(inverse, 2.0**-23) * T_cam_rig.t
        )


class PatchObjective(nn.Module):
    """MC-CNN's losses: a hinge on cosines (fast), binary cross-entropy (accurate)."""

    def __init__(self, network: MCCNN, margin: float) -> None:
        super().__init__()
        self.network, self.margin = network, margin

    def forward(self, group: PatchGroup) -> tuple[Tensor, Tensor]:
        """Return the loss of a group and its error: the share of wrong answers.

        Wrong is, for the fast variant, a non-match that looks more alike than the match of the same ray.
        """
        left, right = (self.network.describe_patches(side) for side in (group.left, group.right))
        score = self.network.compare(left, right, torch.ones(len(left), 1, 1, dtype=torch.bool, device=left.device), 0)
        match, other = score.chunk(2)
        if self.network.variant == "fast":
            return (self.margin + other - match).clamp_min(0).mean(), (other >= match).float().mean()
        label = torch.cat([torch.zeros_like(match), torch.ones_like(other)])
        return binary_cross_entropy_with_logits(score, label), ((score > 0) != (label > 0.5)).float().mean()
