"""VolumeNet trained in many ways, for the same short time each: the ablation studies in
book/training.md.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import grid_sample, interpolate, relu
from tqdm import tqdm

import omnistereo_lib as osl
from omnistereo_learn import RECIPES, VolumeNetRecipe
from omnistereo_learn.loop import write_csv
from omnistereo_learn.recipes import ENDLESS
from omnistereo_learn.samples.frames import DATA, folders_of
from omnistereo_learn.samples.volumes import VolumeObjective, VolumeSamples
from omnistereo_lib.files import make_folder
from omnistereo_lib.stereo.correlation import pixels_per_degree, volume_sizes
from omnistereo_lib.stereo.images import reduce_images
from omnistereo_lib.stereo.kernels.correlation_numba import CHANNELS, GROUPS
from omnistereo_lib.stereo.learned import autocast
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_lib.stereo.volumenet import WIDTHS, Conv3d, VolumeNet, local_mean


class MeanAndVariance(VolumeNet):
    """A network that gives its U-net the mean and variance of the cameras' features instead of
    their correlation.
    """

    def __init__(self) -> None:
        super().__init__()
        self.stem[0] = Conv3d(2 * CHANNELS + 1, WIDTHS[0])

    def compare(self, features: Sequence[Tensor], coordinates: Sequence[Tensor]) -> Tensor:
        """Return means, variances and k / 4, shape (65, W, H, N); see `VolumeNet.compare`."""
        count = total = squares = torch.zeros(1)
        for maps, uv in zip(features, coordinates, strict=True):
            size = torch.tensor(maps.shape[:0:-1])
            at = (2 * uv / (size - 1) - 1).nan_to_num(nan=-9).flatten(1, 2)  # outside: 0
            warped = grid_sample(maps[None], at[None], align_corners=True)[0].view(
                -1, *uv.shape[:3]
            )
            count = count + (~uv[..., :1].isnan()).movedim(-1, 0)
            total, squares = total + warped, squares + warped.square()
        mean = total / count.clamp(min=1)
        return torch.cat([mean, squares / count.clamp(min=1) - mean.square(), count / 4])


class SpheresAsChannels(VolumeNet):
    """A U-net of 2-D convolutions over θ and φ, whose channels are the spheres; for volumes of 32
    spheres.
    """

    widths, spheres = (40, 64, 80, 96), 32

    def __init__(self) -> None:
        super().__init__()
        conv = lambda a, b, stride=1: nn.Sequential(  # noqa: E731
            nn.Conv2d(a, b, 3, stride, padding=1, bias=False),
            nn.BatchNorm2d(b, momentum=None),
            nn.ReLU(),
        )
        first, steps = self.widths[0], list(pairwise(self.widths))
        self.stem = nn.Sequential(conv((GROUPS + 1) * self.spheres, first), conv(first, first))
        self.down = nn.ModuleList(nn.Sequential(conv(a, b, 2), conv(b, b)) for a, b in steps)
        self.up = nn.ModuleList(nn.ModuleList([nn.Conv2d(b, a, 1), conv(a, a)]) for a, b in steps)
        self.head = nn.Conv2d(first, self.spheres, 3, padding=1)  # type: ignore[assignment]

    def forward(self, volume: Tensor) -> Tensor:
        """Return logits (B, W, H, N) of volumes (B, 9, W, H, N); see `VolumeNet.forward`."""
        levels = [self.stem(volume.permute(0, 1, 4, 2, 3).flatten(1, 2))]
        for down in self.down:
            levels.append(down(levels[-1]))
        x = levels.pop()
        steps: Any = reversed(self.up)
        for project, merge in steps:
            x = merge(
                interpolate(relu(project(x)), scale_factor=2.0, mode="bilinear") + levels.pop()
            )
        return self.head(x).float().permute(0, 2, 3, 1)


class NotRotated(VolumeSamples):
    """Every grid stands upright, with the seam at the back."""

    def view(self, rng: np.random.Generator | None) -> tuple[np.ndarray, float]:
        """Return no rotation, and the scale; see `VolumeSamples.view`."""
        return np.eye(3), super().view(rng)[1]


class NotScaled(VolumeSamples):
    """The nearest sphere is at the depth that the rig file states."""

    def view(self, rng: np.random.Generator | None) -> tuple[np.ndarray, float]:
        """Return the rotation, and no scale; see `VolumeSamples.view`."""
        return super().view(rng)[0], 1.0


# name → worlds, network, samples
Variants = dict[str, tuple[str, type[VolumeNet], type[VolumeSamples]]]

ALL = "sunny streets things rooms"
VARIANTS: Variants = {
    "as shipped": (ALL, VolumeNet, VolumeSamples),
    "mean and variance": (ALL, MeanAndVariance, VolumeSamples),
    "2-D, spheres as channels": (ALL, SpheresAsChannels, VolumeSamples),
    "grids not rotated": (ALL, VolumeNet, NotRotated),
    "nearest depth not scaled": (ALL, VolumeNet, NotScaled),
    "streets only": ("sunny streets", VolumeNet, VolumeSamples),
    "streets and rooms": ("sunny streets rooms", VolumeNet, VolumeSamples),
}
WORLDS: Variants = {
    "shipped": (ALL, VolumeNet, VolumeSamples),
    "endless": (ENDLESS, VolumeNet, VolumeSamples),
    "both": (f"{' '.join([ENDLESS] * 4)} {ALL}", VolumeNet, VolumeSamples),
}


def compare_volumenets(out: Path) -> Path:
    """Train each of `VARIANTS` and measure it; return the CSV, whose rows are not computed again."""
    return _compare(
        VARIANTS,
        out / "volume_variants.csv",
        ["steps=110", "warmup=15"],
        ("sunny", "indoor", "aerial"),
    )


def compare_worlds(out: Path) -> Path:
    """Train on shipped worlds, on endless ones, and on both; return the CSV, whose rows are not
    computed again.
    """
    sets = ("sunny", "indoor", "aerial", "things", "rooms")
    return _compare(WORLDS, out / "volume_worlds.csv", ["steps=250", "warmup=25"], sets)


def _compare(variants: Variants, table: Path, settings: Sequence[str], sets: Sequence[str]) -> Path:
    rows = {}
    if table.is_file():
        with table.open(newline="", encoding="utf-8") as file:
            rows = {row["variant"]: row for row in csv.DictReader(file)}
    for name, (worlds, network, samples) in variants.items():
        if name not in rows:
            recipe: Any = RECIPES["volumenet"]["teaching"].with_overrides(
                [f"worlds={worlds}", *settings]
            )
            trained = train_variant(recipe, network, samples, name)
            parameters = sum(p.numel() for p in network().parameters())
            rows[name] = {"variant": name, "parameters": parameters, **measure(trained, sets)}
            make_folder(table.parent)
            write_csv(table, list(rows[name]), [list(row.values()) for row in rows.values()])
    return table


def train_variant(
    recipe: VolumeNetRecipe, network: type[VolumeNet], samples: type[VolumeSamples], name: str = ""
) -> VolumeNet:
    """Return a network trained by a recipe on the worlds that it names.

    A loop of its own: `train` takes the networks of `RECIPES` only, and the stored tables are this
    one's.
    """
    torch.manual_seed(recipe.seed)
    data = samples(recipe, folders_of(recipe))
    model = network().train()
    objective = VolumeObjective(model, data.grid_of(1.0))
    optimizer = torch.optim.AdamW(model.parameters(), weight_decay=recipe.weight_decay)

    def loss(k: int, purpose: int = 0) -> Tensor:
        rng = np.random.default_rng([recipe.seed, purpose, k])
        with autocast("auto", torch.device("cpu")):
            return objective(data.micro_batch(data.training_frame(k), rng, augment=True))[0]

    for step in tqdm(range(recipe.steps), desc=name):
        optimizer.param_groups[0]["lr"] = recipe.learning_rate_at(step)
        optimizer.zero_grad()
        loss(step).backward()
        nn.utils.clip_grad_norm_(model.parameters(), recipe.clip)
        optimizer.step()
    with torch.no_grad():  # statistics of the batch norms, computed again as `train` does
        for layer in model.modules():
            if isinstance(layer, nn.modules.batchnorm._BatchNorm):
                layer.reset_running_stats()
        for k in range(recipe.validation_groups):
            loss(k, purpose=1)
    return model.eval()


def measure(model: VolumeNet, sets: Sequence[str]) -> dict[str, Any]:
    """Return the mean '>1', '>3' and MAE over the test frames of each set at 320 × 80 × 64.

    Images have the resolution of the training: of finer ones VolumeNet looks at a second volume,
    which the 2-D network cannot take.
    """
    metrics: dict[str, Any] = {}
    for name in sets:
        errors = []
        for frame in osl.load_dataset(DATA / name, split="test"):
            grid = osl.SphereGrid(320, 80, num_spheres=64, min_depth=frame.rig.min_depth)
            rig, images = reduce_images(
                frame.rig, frame.images, pixels_per_degree(volume_sizes(grid)[0])
            )
            sweep = SphereSweep(rig, grid)
            index = local_mean(osl.cost_volume(sweep, images, model))[0].numpy()
            error = osl.index_error(index, frame.gt_index(sweep.grid), 64)
            errors.append([error[">1"], error[">3"], error["MAE"]])
        means = np.mean(errors, axis=0).round(2).tolist()
        metrics |= dict(zip((f"{name} >1", f"{name} >3", f"{name} MAE"), means, strict=True))
    return metrics
