"""VolumeNet's variants: what each shows its U-net, what its samples leave out, and the table of
all."""

import csv
import re

import numpy as np
import pytest
import scene
import torch

import omnistereo_lib as osl
from omnistereo_learn import RECIPES
from omnistereo_learn.samples import frames
from omnistereo_learn.samples.frames import DATA
from omnistereo_lib.stereo import correlation
from workshop.results.volume_variants import (
    VARIANTS,
    MeanAndVariance,
    SpheresAsChannels,
    train_variant,
)


def test_mean_and_variance_of_whole_pixels_by_hand():
    rng = np.random.default_rng(0)
    maps = [torch.from_numpy(rng.normal(size=(32, 12, 16)).astype(np.float32)) for _ in range(3)]
    height, width = maps[0].shape[-2:]
    uv = [
        np.stack([rng.integers(width, size=(4, 5, 2)), rng.integers(height, size=(4, 5, 2))], -1)
        for _ in maps
    ]
    at = [torch.tensor(cells, dtype=torch.float32) for cells in uv]
    at[2][1, 2, 0] = torch.nan
    found = MeanAndVariance().compare(maps, at).numpy()
    features = np.stack(
        [m.numpy()[:, cells[..., 1], cells[..., 0]] for m, cells in zip(maps, uv, strict=True)]
    )
    features[2, :, 1, 2, 0] = np.nan  # not visible there
    np.testing.assert_allclose(found[:32], np.nanmean(features, 0), atol=1e-4)
    np.testing.assert_allclose(found[32:64], np.nanvar(features, 0), atol=1e-4)
    assert found[64, 1, 2, 0] == 2 / 4 and found[64, 0, 0, 0] == 3 / 4


@pytest.mark.parametrize(("network", "flat"), [(MeanAndVariance, False), (SpheresAsChannels, True)])
def test_a_variant_is_a_cost(network, flat):
    rig, grid = (
        scene.rig(width=60, height=56),
        osl.SphereGrid(64, 16, num_spheres=32, min_depth=0.6),
    )
    model = network().eval()
    assert all(not isinstance(layer, torch.nn.Conv3d) for layer in model.modules()) == flat
    volume = osl.cost_volume(osl.SphereSweep(rig, grid), scene.images(rig, finest=0.5), model)
    assert torch.allclose((1 - volume).nansum(-1), torch.tensor(1.0), atol=1e-4)


@pytest.mark.parametrize(
    ("name", "upright", "fixed"),
    [("grids not rotated", True, False), ("nearest depth not scaled", False, True)],
)
def test_what_the_samples_leave_out(name, upright, fixed):
    worlds, _, samples = VARIANTS[name]
    recipe = RECIPES["volumenet"]["teaching"].with_overrides(["worlds=rooms"])
    views = [
        samples(recipe, [DATA / "rooms" / "test"]).view(np.random.default_rng(k)) for k in range(3)
    ]
    assert all(np.array_equal(rotation, np.eye(3)) == upright for rotation, _ in views)
    assert all((scale == 1) == fixed for _, scale in views)
    assert worlds == VARIANTS["as shipped"][0]


def test_a_variant_is_trained_by_its_recipe(tmp_path, monkeypatch):
    (tmp_path / "rooms").mkdir()
    (tmp_path / "rooms" / "train").symlink_to(DATA / "rooms" / "test")  # fewer frames
    monkeypatch.setattr(frames, "DATA", tmp_path)
    monkeypatch.setattr(correlation, "COARSE", (32, 8))
    small = [
        "worlds=rooms",
        "width=64",
        "height=16",
        "num_spheres=16",
        "steps=1",
        "warmup=1",
        "validation_groups=1",
    ]
    recipe = RECIPES["volumenet"]["teaching"].with_overrides(small)
    _, network, samples = VARIANTS["as shipped"]
    torch.manual_seed(recipe.seed)
    start = network()
    trained = train_variant(recipe, network, samples)
    changed = [
        not torch.equal(a, b) for a, b in zip(trained.parameters(), start.parameters(), strict=True)
    ]
    assert all(changed) and not trained.training


@pytest.mark.parametrize("name", ["volume_variants", "volume_worlds"])
def test_the_page_on_training_quotes_the_mean_errors(name):
    text = (DATA.parent / "book" / "training.md").read_text(encoding="utf-8")
    with (DATA / "results" / f"{name}.csv").open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            errors = " | ".join(
                f"{float(value):.2f}" for column, value in row.items() if column.endswith("MAE")
            )
            assert re.search(
                rf"^\| {row['variant']}[^|]* \| {re.escape(errors)} \|$", text, re.MULTILINE
            ), row
