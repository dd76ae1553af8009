"""What notebook 06 shows of a network while it learns."""

import numpy as np
import torch

from course import snapshots
from omnistereo_lib.stereo.sweepnet import SweepNet
from omnistereo_lib.train.loop import WEIGHTS


def test_the_stored_snapshots_are_small_and_get_better():
    assert snapshots.SNAPSHOTS.stat().st_size < 150_000
    stored = np.load(snapshots.SNAPSHOTS)
    assert tuple(stored["steps"]) == snapshots.STEPS and len(stored["wrong"]) == len(snapshots.STEPS)
    index = stored["index"]
    assert index.shape == (len(snapshots.STEPS), 40, 160) and index.dtype == np.uint8
    assert set(np.unique(index)) <= {*range(32), snapshots.UNSEEN}
    assert stored["wrong"][-1] < 0.6 * stored["wrong"][0]


def test_a_snapshot_is_of_the_weights_at_its_step(tmp_path, monkeypatch):
    def train(recipe, run, on_step):
        network = SweepNet()
        for step in range(recipe.steps):
            torch.nn.init.constant_(network.layers["fc5"].bias, step + 1)
            network.save(run / WEIGHTS)
            on_step({"step": step, "validation_error": 0.5 / (step + 1)})

    monkeypatch.setattr(snapshots, "train", train)
    monkeypatch.setattr(snapshots, "_winners", lambda network, *_: np.uint8([[network.layers["fc5"].bias.item()]]))
    stored = np.load(snapshots.take_snapshots(tmp_path / "snapshots.npz", steps=(1, 2, 4)))
    assert stored["index"].ravel().tolist() == stored["steps"].tolist() == [1, 2, 4]
    assert stored["wrong"].tolist() == [0.5, 0.25, 0.125]
