"""Samples and loss of VolumeNet: whole frames, each on a grid of its own."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.random import Generator
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import interpolate, log_softmax

from omnistereo_learn.endless.worlds import EndlessFrame
from omnistereo_learn.recipes import VolumeNetRecipe
from omnistereo_learn.samples.frames import Folders, TrainingFrames, to_device
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.frame import Frame
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.correlation import feature_coordinates, pixels_per_degree, volume_sizes
from omnistereo_lib.stereo.sweep import blur
from omnistereo_lib.stereo.volumenet import VolumeNet, local_mean, normalize, resize_logits


@dataclass(frozen=True)
class VolumeSample:
    """One frame: what `VolumeNet.correlation` takes, and the true index (W, H), NaN unknown."""

    images: list[Tensor]
    masks: list[Tensor]
    coordinates: list[Tensor]
    index: Tensor


class VolumeSamples(TrainingFrames):
    """Draws micro-batches of frames; see `TrainingFrames`."""

    recipe: VolumeNetRecipe

    def __init__(
        self, recipe: VolumeNetRecipe, data: Folders, device: torch.device | str = "cpu"
    ) -> None:
        super().__init__(recipe, data)
        self.device = torch.device(device)
        self.network = VolumeNet()
        self.objective = VolumeObjective(self.network, self.grid_of(1.0))
        self._rays = self.grid_of(1.0).rays()

    def micro_batch(
        self, frame: Frame | EndlessFrame, rng: Generator, augment: bool
    ) -> list[VolumeSample]:
        """Return a frame and others, `batch_frames` in all; with `augment`, each seen differently.

        The others of a folder are drawn at random; those of endless worlds are the next ones, so
        that each frame comes again in the following micro-batch, seen differently.
        """
        count = self.recipe.batch_frames - 1
        if isinstance(frame, EndlessFrame):
            worlds = self.endless if augment else self.held_out
            others = [worlds.frame(frame.number + 1 + k) for k in range(count)]
        else:
            pool = self.training if augment else self.validation
            others = [pool[k] for k in rng.integers(len(pool), size=count)]
        return [self._sample(one, rng if augment else None) for one in (frame, *others)]

    def view(self, rng: Generator | None) -> tuple[NDArray[Any], float]:
        """Draw the rotation of a grid, any way about the vertical, ±10° tilted, and a scale."""
        if rng is None:
            return np.eye(3), 1.0
        tilt = np.radians(rng.uniform(-10, 10))
        axis = rng.uniform(0, 2 * np.pi)
        roll = rng.uniform(0, 2 * np.pi)
        tilted = Pose.from_vector([tilt * np.cos(axis), 0, tilt * np.sin(axis), 0, 0, 0])
        rotation = tilted.R @ Pose.from_vector([0, roll, 0, 0, 0, 0]).R
        return rotation, float(np.exp(rng.uniform(np.log(0.4), np.log(2.5))))

    def _sample(self, frame: Frame | EndlessFrame, rng: Generator | None) -> VolumeSample:
        """Return a frame on a grid; with an rng, rotated, scaled, mirrored, its images changed."""
        rotation, scale = self.view(rng)
        assert frame.rig.min_depth is not None  # `TrainingFrames` refuses others
        grid = self.grid_of(scale * frame.rig.min_depth)
        size = volume_sizes(grid)[0]
        whole = Frame.of(frame.rig.recentered(), frame.images)
        small, pose = whole.reduced(pixels_per_degree(size)), Pose(rotation, np.zeros(3))
        masks = [to_device(camera.visible_pixels(), self.device) for camera in small.rig.cameras]
        gray = [_other_look(image, rng, self.device) for image in small.gray]
        coordinates = feature_coordinates(small.rig.transformed(pose), grid, size, self.device)
        gt_index = grid.inverse_depth_to_index(frame.inverse_depth_along(self._rays @ rotation))
        # (W, H)
        known = np.where(gt_index <= grid.num_spheres - 1, gt_index, np.nan).astype(np.float32).T
        index = to_device(known, self.device)
        index = index.where(_shared_rays(coordinates, index.shape), torch.nan)
        if rng is not None and rng.integers(2):  # a mirrored world: θ becomes -θ
            index, coordinates = index.flip(0), [uv.flip(0) for uv in coordinates]
        return VolumeSample(
            [normalize(*pair) for pair in zip(gray, masks, strict=True)], masks, coordinates, index
        )


def _shared_rays(coordinates: list[Tensor], shape: torch.Size) -> Tensor:
    """Return on which rays (W, H) two cameras see a common cell of `feature_coordinates`."""
    visible = torch.stack([~uv[..., 0].isnan() for uv in coordinates])
    shared = (visible.sum(0) > 1).any(-1)
    return interpolate(shared[None, None].float(), shape, mode="nearest")[0, 0] > 0


def _other_look(image: NDArray[np.float32], rng: Generator | None, device: torch.device) -> Tensor:
    """Copy an image in [0, 255] to a device; with an rng, change how its camera sees."""
    if rng is None:
        return to_device(image, device)
    if rng.random() < 0.3:
        image = blur(image, rng.uniform(0.3, 1.0))
    gain = np.exp(rng.uniform(-0.25, 0.25))
    gamma = np.exp(rng.uniform(-0.3, 0.3))
    noise = rng.uniform(0, 0.02)
    gray = (to_device(image, device) / 255 * gain).clamp(0, 1) ** gamma
    generator = torch.Generator(device).manual_seed(int(rng.integers(1 << 62)))
    return gray + noise * torch.randn(gray.shape, device=device, generator=generator)


class VolumeObjective(nn.Module):
    """The cross-entropy of the sphere index, its true value shared by the two spheres beside it."""

    def __init__(self, network: VolumeNet, grid: SphereGrid) -> None:
        super().__init__()
        self.network, self.grid = network, grid

    def forward(self, batch: list[VolumeSample]) -> tuple[Tensor, Tensor]:
        """Return the loss and the fraction of rays whose index is off by more than 1 % of N."""
        volumes = [self.network.correlation(b.images, b.masks, b.coordinates) for b in batch]
        index = torch.stack([one.index for one in batch])
        columns = torch.arange(self.grid.width, device=index.device)
        logits = resize_logits(self.network(torch.stack(volumes)), columns, self.grid)
        known = ~index.isnan()
        if not known.any():
            raise OmnistereoError(
                "no ray of a batch has ground truth within the swept range. Check the nearest"
                " depth."
            )
        logits, index = logits[known], index[known]
        N = self.grid.num_spheres
        lower = index.floor().clamp(max=N - 2).long()[:, None]
        weight = index - lower[:, 0]
        log_p = log_softmax(logits, -1)
        loss = -(
            log_p.gather(1, lower)[:, 0] * (1 - weight) + log_p.gather(1, lower + 1)[:, 0] * weight
        ).mean()
        estimate, _ = local_mean(1 - log_p.detach().exp())
        return loss, ((estimate - index).abs() > 0.01 * N).float().mean()
