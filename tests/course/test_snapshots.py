"""What notebook 06 shows of a network while it learns."""

import numpy as np
import torch

from course import snapshots
from omnistereo_lib.stereo.sweepnet import SweepNet


def test_the_stored_snapshots_are_small_and_get_better():
    assert snapshots.SNAPSHOTS.stat().st_size < 150_000
    stored = np.load(snapshots.SNAPSHOTS)
    assert tuple(stored["steps"]) == snapshots.STEPS and len(stored["wrong"]) == len(snapshots.STEPS)
    index = stored["index"]
    assert index.shape == (len(snapshots.STEPS), 40, 160) and index.dtype == np.uint8
    assert set(np.unique(index)) <= {*range(32), snapshots.UNSEEN}
    assert stored["wrong"][-1] < 0.6 * stored["wrong"][0]


def test_only_the_decision_learns():
    network, weights = snapshots.undecided(0)
    learning = {name for name, weight in network.named_parameters() if weight.requires_grad}
    assert learning == {f"layers.{name}.{part}" for name in snapshots.DECISION for part in ("weight", "bias")}
    assert len(weights) == len(learning)
    bundled = SweepNet.pretrained()
    assert torch.equal(network.layers["conv18"].weight, bundled.layers["conv18"].weight)
    assert not torch.equal(network.layers["fc1"].weight, bundled.layers["fc1"].weight)
