"""The frames to train on, shared by the samples of all networks."""

import hashlib
from collections.abc import Sequence
from copy import copy
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from omnistereo_learn.endless.worlds import EndlessFrame, EndlessWorlds
from omnistereo_learn.recipes import ENDLESS, Recipe
from omnistereo_lib.dataset import load_dataset
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import read_bytes
from omnistereo_lib.frame import Frame, to_gray
from omnistereo_lib.geometry.rig import Rig, camera_pairs
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.sweep import SphereSweep

DATA = Path(__file__).resolve().parents[2] / "data_samples"
Folders = str | Path | Sequence[str | Path]
# rigs at a time: that of the streets recurs, those of the other worlds do not come again soon
_SWEEPS = 4
_HELD_OUT = 1 << 40  # the seed of the endless worlds of validation; no recipe has it


def folders_of(recipe: Recipe) -> list[str | Path]:
    """Return what a recipe trains on by default: training sets of data_samples, "endless"."""
    return [name if name == ENDLESS else DATA / name / "train" for name in recipe.worlds.split()]


class TrainingFrames:
    """The frames of data sets with ground truth: every tenth for validation, the others to train.

    `data` is a folder that `load_dataset` reads, or several. "endless" among them stands for
    endless worlds, in which every frame is a new one: of "endless", "endless" and two folders,
    every other micro-batch is of such a frame. Raises `OmnistereoError` if fewer than two frames of
    a folder have ground truth, or a rig file does not state the nearest depth.
    """

    def __init__(self, recipe: Recipe, data: Folders) -> None:
        self.recipe = recipe
        self.validation: list[Frame] = []
        self.training: list[Frame] = []
        worlds = [Path(world) for world in ([data] if isinstance(data, str | Path) else data)]
        folders = [world for world in worlds if str(world) != ENDLESS]
        # so many of so many micro-batches
        self._endless_of = len(worlds) - len(folders), len(worlds)
        self.endless = EndlessWorlds(recipe.seed, faults=recipe.faults)
        self.held_out = EndlessWorlds(_HELD_OUT, workers=0, faults=recipe.faults)
        digest = hashlib.sha256()
        for folder in folders:
            frames = [frame for frame in load_dataset(folder) if frame.gt_path is not None]
            if len(frames) < 2:
                raise OmnistereoError(
                    f"{folder} has {len(frames)} frames with ground truth; expected at least 2"
                )
            if any(frame.rig.min_depth is None for frame in frames):
                raise OmnistereoError(
                    f"the rig of {folder} does not state its nearest depth. Add it to config.yaml."
                )
            self.validation += frames[::10]
            self.training += [frame for k, frame in enumerate(frames) if k % 10]
            for path in (path for frame in frames for path in (*frame.image_paths, frame.gt_path)):
                digest.update(read_bytes(path) if path else b"")
        names = ", ".join(
            "/".join(world.resolve().parts[-2:]) if world in folders else ENDLESS
            for world in worlds
        )
        count = len(self.training) + len(self.validation)
        self.metadata = {"folder": names, "frames": count, "sha256": digest.hexdigest()}

    def grid_of(self, min_depth: float) -> SphereGrid:
        """Return the grid of a frame."""
        size = self.recipe.width, self.recipe.height
        return SphereGrid(*size, num_spheres=self.recipe.num_spheres, min_depth=min_depth)

    def training_frame(self, number: int) -> Frame | EndlessFrame:
        """Return the frame of a micro-batch, over all steps; once per epoch, shuffled."""
        endless, number = self._split(number)
        if endless:
            return self.endless.frame(number)
        epoch, place = divmod(number, len(self.training))
        order = np.random.default_rng([self.recipe.seed, epoch]).permutation(len(self.training))
        return self.training[order[place]]

    def validation_frame(self, number: int) -> Frame | EndlessFrame:
        """Return the frame of a micro-batch of the validation."""
        endless, number = self._split(number)
        return (
            self.held_out.frame(number)
            if endless
            else self.validation[number % len(self.validation)]
        )

    def _split(self, number: int) -> tuple[bool, int]:
        """Return whether a micro-batch is of an endless world, and its number among its kind."""
        endless, total = self._endless_of
        before, after = number * endless // total, (number + 1) * endless // total
        return after > before, before if after > before else number - before


class SweptFrames(TrainingFrames):
    """Training frames and the sweep of one rig at a time, for networks of pairs of images."""

    def __init__(self, recipe: Recipe, data: Folders, device: torch.device | str) -> None:
        super().__init__(recipe, data)
        self._sweep_device = device
        self._forget()

    def _forget(self) -> None:
        self._sweeps: dict[Rig, SphereSweep] = {}
        self._gt_index: dict[Path, NDArray[Any]] = {}  # lights of one drive share the file
        self.use(self.validation_frame(0))

    def with_recipe(self, recipe: Recipe) -> Self:
        """Return the same frames and network with sweeps of another size."""
        other = copy(self)
        other.recipe = recipe
        other._forget()
        return other

    def use(self, frame: Frame | EndlessFrame) -> NDArray[np.float32]:
        """Select the rig of a frame; return its ground-truth index (H, W), not rounded."""
        if frame.rig not in self._sweeps:
            assert frame.rig.min_depth is not None  # the constructor refuses others
            self._sweeps[frame.rig] = SphereSweep(
                frame.rig, self.grid_of(frame.rig.min_depth), device=self._sweep_device
            )
        self.sweep = self._sweeps.pop(frame.rig)
        self._sweeps = dict([*self._sweeps.items(), (frame.rig, self.sweep)][-_SWEEPS:])
        self.grid, self.rays = self.sweep.grid, self.sweep.grid.rays()
        self.pairs = camera_pairs("ring", self.sweep.rig)
        if frame.gt_path is None:
            return frame.gt_index(self.grid).astype(np.float32)
        if frame.gt_path not in self._gt_index:
            self._gt_index[frame.gt_path] = frame.gt_index(self.grid).astype(np.float32)
        return self._gt_index[frame.gt_path]

    def images(self, frame: Frame | EndlessFrame, rng: np.random.Generator | None) -> list[Tensor]:
        """Return the normalised images of a frame; with an rng, random gains and gammas."""
        if rng is None:
            return self.sweep.normalize_images(frame.images)
        gammas = np.exp(rng.uniform(-0.25, 0.25, len(frame.images)))
        curved = [
            255 * (to_gray(image) / 255) ** np.float32(g)
            for image, g in zip(frame.images, gammas, strict=True)
        ]
        normalized = self.sweep.normalize_images(curved)
        return [
            image * float(np.exp(rng.uniform(-0.2, 0.2))) + rng.uniform(-0.2, 0.2)
            for image in normalized
        ]


def sample_true_indices(mask: NDArray[Any], count: int, rng: np.random.Generator) -> NDArray[Any]:
    """Return flat indices of at most `count` true cells of a mask, drawn at random."""
    cells = np.flatnonzero(mask)
    return cells if len(cells) <= count else rng.choice(cells, count, replace=False)


def to_device(values: NDArray[Any], device: torch.device) -> Tensor:
    """Copy an array to a device."""
    return torch.from_numpy(np.ascontiguousarray(values)).to(device)
