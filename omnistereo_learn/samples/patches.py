"""Samples and losses of MC-CNN: pairs of 9 × 9 patches that do or do not show the same point."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits

from omnistereo_learn.recipes import MCCNNRecipe
from omnistereo_learn.samples.frames import Folders, SweptFrames, to_device
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.frame import Frame
from omnistereo_lib.stereo.mccnn import MCCNN, PATCH
from omnistereo_lib.stereo.sweep import OUTSIDE, remap

_RADIUS = PATCH // 2
# rays drawn per ray needed: some are not visible, or too near the direction in which the cameras
# are apart
_DRAWS = 4
_MIN_PX_PER_SPHERE = 0.02  # below, no sphere is a whole non-match away
_OCCLUSION_STEPS = 12  # points tested between a camera and a scene point


@dataclass(frozen=True)
class PatchBatch:
    """Patches (2 K, 9, 9) of two cameras: K pairs that match, then K that do not."""

    left: Tensor
    right: Tensor


class PatchSamples(SweptFrames):
    """Draws micro-batches of patch pairs; see `SweptFrames`."""

    recipe: MCCNNRecipe

    def __init__(
        self, recipe: MCCNNRecipe, data: Folders, device: torch.device | str = "cpu"
    ) -> None:
        # patches are cut out here, and compared on the device
        super().__init__(recipe, data, "cpu")
        self.device = torch.device(device)
        self.network = MCCNN(recipe.variant)
        self.network.check_size(recipe.height, recipe.width)
        self.objective: nn.Module = (
            HingeObjective(self.network, recipe.margin)
            if recipe.variant == "fast"
            else EntropyObjective(self.network)
        )

    def micro_batch(self, frame: Frame, rng: np.random.Generator, augment: bool) -> PatchBatch:
        """Sample rays of a frame with a camera pair each, and spheres that match and not."""
        index = self.use(frame)
        images = [image.numpy() for image in self.images(frame, rng if augment else None)]
        sides: tuple[list[list[NDArray[Any]]], list[list[NDArray[Any]]]] = ([], [])
        quota = -(-self.recipe.rays_per_frame // len(self.pairs))
        for i, j in self.pairs:
            pixel, match, other = self.draw_rays(index, i, j, quota, rng)
            if len(pixel) == 0:
                continue
            i, j = (j, i) if augment and rng.integers(2) else (i, j)
            for side, camera in zip(sides, (i, j), strict=True):
                side.append(
                    [self.patches(images[camera], camera, pixel, n) for n in (match, other)]
                )
        if not sides[0]:
            raise OmnistereoError(
                f"frame {frame.number}: no ray is visible to two cameras with a sphere on which"
                f" their views are {self.recipe.negative_low_px} pixels apart. Check the rig and"
                " the ground truth."
            )
        left, right = (
            np.concatenate([np.concatenate(kind) for kind in zip(*side, strict=True)])
            for side in sides
        )
        if augment and rng.integers(2):  # a mirrored world
            left, right = left[..., ::-1], right[..., ::-1]
        return PatchBatch(to_device(left, self.device), to_device(right, self.device))

    def draw_rays(
        self, index: NDArray[Any], i: int, j: int, count: int, rng: np.random.Generator
    ) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Draw rays that cameras i and j both see, and spheres of one point and of another.

        Distances are in pixels between the two cameras' views of the point.

        Returns:
            pixel (shape (K, 2), K ≤ count): Row and column of each ray.
            match (shape (K,)): Sphere indices off the ground truth by at most `positive_px`.
            other (shape (K,)): Sphere indices off it by `negative_low_px` to `negative_high_px`.
        """
        recipe, last = self.recipe, self.grid.num_spheres - 1
        rows, columns = (rng.integers(size, size=_DRAWS * count) for size in self.grid.shape)
        gt_index = index[rows, columns].astype(np.float64)
        inside = (gt_index >= 0) & (gt_index <= last)
        gt_index = np.where(inside, gt_index, 0.0)
        px_per_sphere = self.pair_shift_px(i, j, rows, columns, gt_index, 1.0)
        divisor = np.maximum(px_per_sphere, _MIN_PX_PER_SPHERE)
        off = rng.uniform(-recipe.positive_px, recipe.positive_px, len(rows)) / divisor
        away = rng.uniform(recipe.negative_low_px, recipe.negative_high_px, len(rows)) / divisor
        away *= rng.choice([-1, 1], len(rows))
        other = gt_index + away
        other = np.where((other < 0) | (other > last), gt_index - away, other)
        fits = inside & (px_per_sphere > _MIN_PX_PER_SPHERE) & (other >= 0) & (other <= last)
        for camera in (i, j):
            fits &= self.sees(camera, rows, columns, gt_index) & self.sees(
                camera, rows, columns, other
            )
            fits &= ~self._occluded(camera, index, rows, columns, gt_index)
        chosen = np.flatnonzero(fits)[:count]
        return (
            np.stack([rows, columns], -1)[chosen],
            (gt_index + off).clip(0, last)[chosen],
            other[chosen],
        )

    def pair_shift_px(
        self,
        i: int,
        j: int,
        rows: NDArray[Any],
        columns: NDArray[Any],
        gt_index: NDArray[Any],
        away: ArrayLike,
    ) -> NDArray[Any]:
        """Return how far apart, px, two cameras show a point on a sphere `away` from its own.

        On its own sphere they show it at the same place. `away` = 1 gives pixels per sphere.
        """
        rays, sweep_index = self.rays[rows, columns], gt_index + away
        left, right = (
            self.grid.project(self._apparent_direction(k, rays, gt_index, sweep_index))[0]
            for k in (i, j)
        )
        shift, W = left - right, self.grid.width
        return np.hypot((shift[..., 0] + W / 2) % W - W / 2, shift[..., 1])

    def _apparent_direction(
        self, camera: int, rays: NDArray[Any], gt_index: NDArray[Any], sweep_index: NDArray[Any]
    ) -> NDArray[Any]:
        """Return the direction (K, 3) at which a camera's panorama of a sphere shows a point.

        It is where the line of sight from the camera centre c, direction u, meets the sphere: |d c
        + s u| = 1.
        """
        center = self.sweep.rig.T_rig_cam[camera].t
        sight = rays - self._inverse(gt_index) * center
        sight /= np.linalg.norm(sight, axis=-1, keepdims=True)
        start = self._inverse(sweep_index) * center
        along = (start * sight).sum(-1, keepdims=True)
        return start + sight * (np.sqrt(along**2 + 1 - (start**2).sum(-1, keepdims=True)) - along)

    def _inverse(self, index: NDArray[Any]) -> NDArray[Any]:
        return self.grid.index_to_inverse_depth(index)[:, None]

    def sees(
        self, camera: int, rows: NDArray[Any], columns: NDArray[Any], index: NDArray[Any]
    ) -> NDArray[Any]:
        """Return whether rays at given spheres lie in the field of view of a camera."""
        return self._project(camera, self.rays[rows, columns], self._inverse(index))[1]

    def _occluded(
        self,
        camera: int,
        index: NDArray[Any],
        rows: NDArray[Any],
        columns: NDArray[Any],
        gt_index: NDArray[Any],
    ) -> NDArray[Any]:
        """Return whether something is between a camera and points, by the ground truth."""
        center = self.sweep.rig.T_rig_cam[camera].t
        points = self.rays[rows, columns] / np.maximum(self._inverse(gt_index), 1e-6)
        occluded = np.zeros(len(points), bool)
        for t in np.linspace(0.1, 0.95, _OCCLUSION_STEPS):
            between = center + t * (points - center)
            nearest, inside = self.grid.look_up(index, between)
            here = self.grid.depth_to_index(np.linalg.norm(between, axis=-1))
            occluded |= inside & (nearest > here + 1)  # one sphere of slack for slanted surfaces
        return occluded

    def patches(
        self, image: NDArray[Any], camera: int, pixel: NDArray[Any], index: NDArray[Any]
    ) -> NDArray[Any]:
        """Cut patches (K, 9, 9) around pixels (K, 2) out of a camera's panoramas of spheres (K,).

        As in `MCCNN`, they are 0 where the camera does not see and above and below the panorama.
        """
        around = np.arange(-_RADIUS, _RADIUS + 1)
        rows = pixel[:, 0, None, None] + around[:, None]
        columns = (pixel[:, 1, None, None] + around) % self.grid.width
        rays = self.rays[rows.clip(0, self.grid.height - 1), columns]
        uv, valid = self._project(camera, rays, self._inverse(index)[..., None, None])
        valid &= (rows >= 0) & (rows < self.grid.height)
        maps = np.where(valid[..., None], uv, OUTSIDE).astype(np.float32)
        return np.nan_to_num(remap(image, maps.reshape(-1, PATCH, 2))).reshape(-1, PATCH, PATCH)

    def _project(
        self, camera: int, rays: NDArray[Any], inverse: NDArray[Any]
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        T_cam_rig = self.sweep.rig.T_rig_cam[camera].inverse()
        points = rays @ T_cam_rig.R.T + np.maximum(inverse, 2.0**-23) * T_cam_rig.t
        return self.sweep.rig.cameras[camera].project(points)


class _PatchObjective(nn.Module):
    """What the losses of MC-CNN's two variants share."""

    def __init__(self, network: MCCNN) -> None:
        super().__init__()
        self.network = network

    def scores(self, batch: PatchBatch) -> tuple[Tensor, Tensor]:
        """Return the scores (K,) of the patch pairs that match, and of those that do not."""
        left, right = (self.network.extract_features(side) for side in (batch.left, batch.right))
        match, other = (
            self.network.score_pixels(self.network.match_features(left, right)).flatten().chunk(2)
        )
        return match, other


class HingeObjective(_PatchObjective):
    """The loss of the fast variant: a hinge on cosines."""

    def __init__(self, network: MCCNN, margin: float) -> None:
        super().__init__(network)
        self.margin = margin

    def forward(self, batch: PatchBatch) -> tuple[Tensor, Tensor]:
        """Return the loss, and the fraction of rays whose non-match looks no worse."""
        match, other = self.scores(batch)
        return (self.margin + other - match).clamp_min(0).mean(), (other >= match).float().mean()


class EntropyObjective(_PatchObjective):
    """The loss of the accurate variant: binary cross-entropy on logits of a mismatch."""

    def forward(self, batch: PatchBatch) -> tuple[Tensor, Tensor]:
        """Return the loss, and the fraction of pairs that are taken for the wrong kind."""
        match, other = self.scores(batch)
        score = torch.cat([match, other])
        label = torch.cat([torch.zeros_like(match), torch.ones_like(other)])
        return (
            binary_cross_entropy_with_logits(score, label),
            ((score > 0) != (label > 0.5)).float().mean(),
        )
