"""Snapshots of SweepNet in training, for notebook 08: its best spheres of one frame."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

import omnistereo_lib as osl
from omnistereo_learn import RECIPES, train
from omnistereo_learn.loop import WEIGHTS
from omnistereo_learn.samples.frames import DATA
from omnistereo_lib.files import atomic_write
from omnistereo_lib.stereo.learned import LearnedCost
from omnistereo_lib.stereo.sweepnet import SweepNet

STEPS = 50, 100, 200, 400, 800
FRAME = 831  # of the test streets, none of which is trained on
UNSEEN = 255  # stored for NaN
SNAPSHOTS = DATA / "results" / "snapshots.npz"


def take_snapshots() -> None:
    """Train SweepNet on small panoramas; store its best spheres of a frame after each of `STEPS`.

    The file has the arrays `steps`, `wrong` (fraction of wrong labels on held-out frames) and
    `index`, uint8 of shape (steps, H, W): the sphere with the lowest cost, without SGM, `UNSEEN`
    where no camera pair sees the ray.
    """
    recipe = replace(
        RECIPES["sweepnet"]["teaching"],
        width=160,
        height=40,
        num_spheres=32,
        steps=STEPS[-1],
        validate_every=STEPS[0],
        validation_groups=12,
    )
    data = osl.load_dataset(DATA / "sunny", split="test")
    grid = osl.SphereGrid(
        recipe.width, recipe.height, (-45, 45), recipe.num_spheres, data.rig.min_depth
    )
    sweep, images = osl.SphereSweep(data.rig, grid), data.frame(FRAME).images
    wrong, index = [], []

    def look(row: dict[str, float]) -> None:
        if row["step"] + 1 in STEPS:
            wrong.append(row["validation_error"])
            index.append(_winners(SweepNet.from_file(run / WEIGHTS), sweep, images))
            print(
                f"step {row['step'] + 1}: {100 * wrong[-1]:.1f} % wrong labels on held-out frames",
                flush=True,
            )

    with TemporaryDirectory() as folder:
        run = Path(folder)
        train(recipe, run, on_step=look)
    with atomic_write(SNAPSHOTS) as temporary:
        np.savez_compressed(temporary, steps=STEPS, wrong=wrong, index=np.stack(index))


def _winners(network: SweepNet, sweep: osl.SphereSweep, images: list[Any]) -> NDArray[np.uint8]:
    index = osl.winner_takes_all(osl.cost_volume(sweep, images, LearnedCost(network))).numpy()
    return np.where(np.isfinite(index), index, UNSEEN).astype(np.uint8)
