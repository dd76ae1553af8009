"""Training of VolumeNet: ground truth, a loss in closed form, runs that learn and resume."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
import scene
import torch
from scene import refused
from torch.nn.functional import interpolate

import omnistereo_lib as osl
from omnistereo_learn import RECIPES, train
from omnistereo_learn.endless import worlds
from omnistereo_learn.endless.worlds import EndlessWorlds
from omnistereo_learn.recipes import VolumeNetRecipe
from omnistereo_learn.samples.volumes import VolumeObjective, VolumeSample, VolumeSamples
from omnistereo_lib.dataset import load_dataset
from omnistereo_lib.stereo import correlation
from omnistereo_lib.stereo.volumenet import local_mean
from omnistereo_lib.stereo.weights import load_tensors
from workshop.results.ship import export_weights, file_name

TINY = VolumeNetRecipe(
    width=64, height=16, num_spheres=16, steps=4, validate_every=2, validation_groups=1, warmup=2
)


@pytest.fixture(autouse=True)
def small_volumes(monkeypatch):
    monkeypatch.setattr(correlation, "COARSE", (32, 8))


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Three frames of a rig in the box, with ground truth of 90° × 360°."""
    grid = osl.SphereGrid(256, 64, (-45, 45), 16, 0.6)
    places = [(0.2 * number - 0.4, 0, 0.1 * number) for number in (1, 2, 3)]
    return scene.write_set(
        tmp_path_factory.mktemp("volumes") / "box", scene.rig(width=100, height=96), grid, places
    )


def test_the_ground_truth_turns_with_the_grid(data, monkeypatch):
    """At the estimated depth a turned grid, mirrored (3, 4) or not (5), shows what the box does."""
    samples = VolumeSamples(TINY, data)
    frame = load_dataset(data)[1]
    plain = samples.micro_batch(frame, np.random.default_rng(0), augment=False)[0]
    grid = samples.grid_of(0.6)
    step = osl.Pose.from_vector([0, 0, 0, 0, 0, 0.2])
    rig = osl.Rig(frame.rig.cameras, [step @ pose for pose in frame.rig.T_rig_cam])
    exact = scene.true_index(rig, grid).T
    known = plain.index.isfinite().numpy()
    assert known.mean() > 0.9 and np.median(np.abs(plain.index.numpy() - exact)[known]) < 0.05
    pictures = scene.images(rig, finest=1.0)  # smooth: values are read at the nearest pixel
    monkeypatch.setattr(correlation, "COARSE", (128, 48))
    fine = VolumeSamples(replace(TINY, width=256, height=64, num_spheres=96), data)
    straight = _spread(pictures, fine._sample(frame, None))
    for seed in (3, 4, 5):
        turned = fine._sample(frame, np.random.default_rng(seed))
        elsewhere = replace(turned, index=turned.index.roll(32, 0))
        assert abs(_spread(pictures, turned) - straight) < 0.3
        assert _spread(pictures, elsewhere) - straight > 0.5


def _spread(pictures, sample):
    """The median over the rays of the deviation of the cameras' values at a sample's depth."""
    half = interpolate(sample.index[None, None], scale_factor=0.5, mode="nearest")[0, 0]
    cell = ((half + 0.5) / 2 - 0.5).round()  # of the volume
    cell = cell.nan_to_num(0).clamp(0, 47).long()[..., None, None].expand(-1, -1, 1, 2)
    values = []
    for picture, coordinates in zip(pictures, sample.coordinates, strict=True):
        uv = (2 * coordinates.gather(2, cell)[:, :, 0]).round()
        column, row = uv.nan_to_num(0).long().unbind(-1)
        known = uv.isfinite().all(-1) & half.isfinite()
        values.append(np.where(known, picture[row.numpy(), column.numpy()], np.nan))
    shared = np.isfinite(values).sum(0) > 1
    assert shared.mean() > 0.4
    return np.median(np.nanstd(np.array(values)[:, shared], 0))


def test_the_loss_is_the_cross_entropy_of_the_two_nearest_spheres():
    class Fixed(torch.nn.Module):
        def correlation(self, *_):
            return torch.zeros(9, 8, 8, 8)

        def forward(self, volumes):
            return torch.arange(8.0).expand(len(volumes), 8, 8, 8)

    index = torch.full((8, 8), torch.nan)
    index[0, 0], index[3, 4] = 6.75, 7.0
    grid = osl.SphereGrid(8, 8, num_spheres=8)
    sample = VolumeSample([], [], [], index)
    loss, error = VolumeObjective(Fixed(), grid)([sample])
    log_p = np.arange(8.0) - np.log(np.exp(np.arange(8.0)).sum())
    assert abs(loss.item() + (0.25 * log_p[6] + 0.75 * log_p[7] + log_p[7]) / 2) < 1e-6
    read, _ = local_mean(torch.from_numpy(1 - np.exp(log_p))[None])
    # of two rays, the one at 7 is off by more than 0.08
    assert 6.67 < read.item() < 6.83 and error.item() == 0.5


def test_it_learns_a_batch_that_comes_again_and_again(data, tmp_path, same_batch):
    rows = []
    recipe = replace(TINY, steps=6, validate_every=6)
    train(recipe, tmp_path, data, precision="float32", on_step=rows.append)
    assert rows[-1]["loss"] < 0.8 * rows[0]["loss"]


def test_a_run_among_folders_and_endless_worlds_resumes_to_the_same_weights(
    data, tmp_path, monkeypatch
):
    monkeypatch.setattr(
        "omnistereo_learn.samples.frames.EndlessWorlds", partial(EndlessWorlds, workers=0)
    )
    # a frame is its seed and number
    monkeypatch.setattr(worlds, "draw_frame", cache(worlds.draw_frame))

    def interrupt(row):
        if row["step"] == 1:
            raise KeyboardInterrupt

    recipe, both = replace(TINY, steps=3, validate_every=3), [data, "endless"]
    whole = train(recipe, tmp_path / "whole", both, precision="float32")
    with pytest.raises(KeyboardInterrupt):
        train(
            recipe, tmp_path / "parts", both, precision="float32", checkpoint_s=0, on_step=interrupt
        )
    parts = train(recipe, tmp_path / "parts", both, precision="float32")
    assert whole.read_bytes() == parts.read_bytes()
    _, metadata = load_tensors(whole)
    assert metadata["architecture"] == "VolumeNet" and metadata["data"]["frames"] == 3
    weights, curve, card = export_weights(tmp_path / "whole", tmp_path / "weights", half=True)
    assert weights.name == "volumenet.safetensors"
    assert "\n3," in curve.read_text()
    assert "things" in card.read_text()


def test_the_file_of_weights_says_what_they_learned_from():
    known = [("volumenet", "refined"), ("sweepnet", "shipped")]
    known += [("sweepnet", "worlds"), ("mccnn", "shipped")]
    names = [file_name(RECIPES[network][preset]) for network, preset in known]
    assert names == ["volumenet", "sweepnet", "sweepnet_worlds", "mccnn_fast"]


def test_frames_without_depth_in_the_swept_range_are_refused(data):
    samples = VolumeSamples(TINY, data)
    sample = samples.micro_batch(samples.training[0], np.random.default_rng(0), augment=False)[0]
    with refused("no ray of a batch has ground truth within the swept range"):
        samples.objective([replace(sample, index=torch.full_like(sample.index, torch.nan))])
    with refused("worlds = ''; expected names of folders"):
        replace(TINY, worlds="")
