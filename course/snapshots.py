"""Snapshots of SweepNet in training, for notebook 06: its best spheres of one frame after some steps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

import omnistereo_lib as osl
from omnistereo_lib.files import atomic_write
from omnistereo_lib.stereo.sweepnet import SweepNet
from omnistereo_lib.train import RECIPES
from omnistereo_lib.train.frames import DATA
from omnistereo_lib.train.spheres import SphereObjective, SphereSamples

STEPS = 0, 5, 15, 40, 80, 150
FRAME = 831  # of the test streets, none of which is trained on
UNSEEN = 255  # stored for NaN
SNAPSHOTS = DATA / "results" / "snapshots.npz"
RATE = 1e-3  # as in the notebook's own loop
DECISION = [f"fc{k}" for k in range(1, 6)]
HELD_OUT = 8  # micro-batches, the same ones every time


def take_snapshots(out: Path = SNAPSHOTS) -> Path:
    """Train longer than notebook 06 does, and store the best spheres of one frame after each of `STEPS`.

    The convolutions are those of the bundled SweepNet. Its decision, fc1 to fc5, starts from random weights and learns
    by the teaching recipe on the small panoramas of the notebook.

    The file has the arrays `steps`, `wrong` (fraction of wrong labels on held-out frames) and `index`, uint8 of shape
    (steps, H, W): the sphere with the lowest cost, without SGM, `UNSEEN` where no camera pair sees the ray.
    """
    recipe = replace(RECIPES["sweepnet"]["teaching"], width=160, height=40, num_spheres=32)
    samples = SphereSamples(recipe, DATA / "sunny" / "train")
    network, weights = undecided(recipe.seed)
    objective, optimizer = SphereObjective(network), torch.optim.AdamW(weights, RATE)
    data = osl.load_dataset(DATA / "sunny", split="test")
    grid = osl.SphereGrid(recipe.width, recipe.height, (-45, 45), recipe.num_spheres, data.rig.min_depth)
    sweep, images = osl.SphereSweep(data.rig, grid), data.frame(FRAME).images
    wrong, index = [], []
    for step in range(STEPS[-1] + 1):
        if step in STEPS:
            wrong.append(_error(objective, samples))
            index.append(_winners(network, sweep, images))
            print(f"step {step}: {100 * wrong[-1]:.1f} % wrong labels on held-out frames", flush=True)
        for k in range(recipe.frames_per_step):
            number = step * recipe.frames_per_step + k
            batch = samples.micro_batch(samples.training_frame(number), np.random.default_rng([0, number]), True)
            (objective(batch)[0] / recipe.frames_per_step).backward()
        optimizer.step()
        optimizer.zero_grad()
    with atomic_write(out) as temporary:
        np.savez_compressed(temporary, steps=STEPS, wrong=wrong, index=np.stack(index))
    return out


def undecided(seed: int) -> tuple[SweepNet, list[torch.nn.Parameter]]:
    """Return the bundled network with a random decision, and the weights of the decision; only these learn."""
    network = SweepNet.pretrained().requires_grad_(False)
    torch.manual_seed(seed)
    fresh = SweepNet()
    for name in DECISION:
        network.layers[name] = fresh.layers[name]
    return network, [weight for name in DECISION for weight in network.layers[name].parameters()]


@torch.no_grad()
def _error(objective: SphereObjective, samples: SphereSamples) -> float:
    batches = (
        samples.micro_batch(samples.validation[k % len(samples.validation)], np.random.default_rng([1, k]), False)
        for k in range(HELD_OUT)
    )
    return float(np.mean([objective(batch)[1].item() for batch in batches]))


def _winners(network: SweepNet, sweep: osl.SphereSweep, images: list) -> NDArray[np.uint8]:
    index = osl.winner_takes_all(osl.cost_volume(sweep, images, osl.LearnedCost(network))).numpy()
    return np.where(np.isfinite(index), index, UNSEEN).astype(np.uint8)
