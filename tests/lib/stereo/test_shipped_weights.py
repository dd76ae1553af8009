"""The networks that ship, on a frame of streets that no training saw."""

import csv
import hashlib
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from test_sweepnet import dense

import omnistereo_lib as osl
from omnistereo_learn import RECIPES
from omnistereo_learn.evaluate.records import read_record
from omnistereo_learn.evaluate.regions import METRICS
from omnistereo_lib.files import unpack
from omnistereo_lib.stereo.learned import LearnedCost, choose_precision
from omnistereo_lib.stereo.mccnn import MCCNN
from omnistereo_lib.stereo.pipeline import sweep_depth
from omnistereo_lib.stereo.sweepnet import SweepNet
from omnistereo_lib.stereo.weights import BUNDLED_WEIGHTS, load_tensors

SUNNY = Path(osl.__file__).parents[1] / "data_samples" / "sunny"
NETWORKS = {"sweepnet": SweepNet, "mccnn_fast": MCCNN}
RECIPE = {
    "sweepnet": RECIPES["sweepnet"]["shipped"],
    "sweepnet_worlds": RECIPES["sweepnet"]["worlds"],
    "mccnn_fast": RECIPES["mccnn"]["shipped"],
    "mccnn_accurate": replace(
        RECIPES["mccnn"]["shipped"], variant="accurate", negative_high_px=18.0
    ),
    "volumenet": RECIPES["volumenet"]["refined"],
}


@pytest.fixture(scope="module")
def frame():
    return osl.load_dataset(SUNNY, split="test").frame(831)


@pytest.mark.parametrize("name", RECIPE)
def test_card_and_curve_are_of_these_weights(name):
    content = (BUNDLED_WEIGHTS / f"{name}.safetensors").read_bytes()
    _, about = load_tensors(BUNDLED_WEIGHTS / f"{name}.safetensors")
    card = (BUNDLED_WEIGHTS / f"{name}.md").read_text(encoding="utf-8")
    assert hashlib.sha256(content).hexdigest() in card
    known = {number: value for number, value in about["recipe"].items() if number != "network"}
    # later ones: off
    assert type(RECIPE[name])(**known) == RECIPE[name] and about["step"] + 1 == RECIPE[name].steps
    preset, asked = re.search(
        r"--preset (\w+)(?: --set (.*?))?(?: --init-weights .*)?`, then", card
    ).groups("")
    assert RECIPES[RECIPE[name].network][preset].with_overrides(asked.split()) == RECIPE[name]
    with (BUNDLED_WEIGHTS / f"{name}.csv").open(newline="") as file:
        curve = [float(row["loss"]) for row in csv.DictReader(file)]
    # In a further round the loss falls by less than batches differ.
    rows, ratio = (30, 0.95) if about.get("init_weights") else (10, 0.7)
    assert np.mean(curve[-rows:]) < ratio * np.mean(curve[:rows])


def test_every_file_of_weights_has_its_recipe():
    assert {path.stem for path in BUNDLED_WEIGHTS.glob("*.safetensors")} == set(RECIPE)


def test_training_data_are_those_that_ship():
    @cache
    def content(world):
        folder = SUNNY.parent / world / "train"
        unpack(folder)
        # one for each frame, beside the folders of its images
        truths = sorted(folder.rglob("omnidepth_gt_*/*.png"))
        frames = [
            (*sorted(truth.parents[1].glob(f"cam*/{int(truth.stem):04}.*")), truth)
            for truth in truths
        ]
        return b"".join(path.read_bytes() for frame in frames for path in frame)

    for name, recipe in RECIPE.items():
        digest, worlds = hashlib.sha256(), recipe.worlds.split()
        for world in worlds:
            digest.update(content(world))
        _, about = load_tensors(BUNDLED_WEIGHTS / f"{name}.safetensors")
        assert about["data"]["folder"] == ", ".join(f"{world}/train" for world in worlds)
        assert about["data"]["sha256"] == digest.hexdigest()


@pytest.mark.parametrize("cost", ["mccnn", "sweepnet"])
def test_learned_costs_beat_zncc_on_a_street_they_have_not_seen(cost):
    """By the stored results, ZNCC with the paper's window; its own has fewer rays above 1 %."""
    small, ablations, paper = (
        read_record(SUNNY.parent / "results" / f"{name}.json")["frames"]["sunny"]["00831"]
        for name in ("teaching", "ablations", "paper")
    )
    # raw, it is now and then wrong by far
    pairs = [(small[cost], ablations["zncc,window=9"], METRICS[:-1])]
    pairs += [(paper[f"{cost}{end}"], paper[f"zncc{end}"], METRICS) for end in ("", "+sgm")]
    for learned, zncc, figures in pairs:
        assert all(learned["figures"][figure] < zncc["figures"][figure] for figure in figures)


@pytest.mark.parametrize(
    ("name", "number", "size", "ratio"),
    [
        ("sunny", 831, (320, 80, 64), 0.8),
        ("indoor", 2, (320, 80, 64), 1.0),
        ("sunny", 831, (96, 24, 16), 1.0),
    ],
)
def test_volumenet_beats_zncc_with_sgm(name, number, size, ratio):
    """On a street and in a room that no training saw, and on a small panorama."""
    data = osl.load_dataset(SUNNY.parent / name, split="test")
    grid = osl.SphereGrid(*size[:2], num_spheres=size[2], min_depth=data.rig.min_depth)
    frame, sweep = data.frame(number), osl.SphereSweep(data.rig, grid)
    results = [sweep_depth(sweep, frame.images, method) for method in ("volumenet", "zncc+sgm")]
    ours, theirs = (osl.index_error(one.index, frame.gt_index(grid), size[2]) for one in results)
    assert all(ours[metric] < ratio * theirs[metric] for metric in ours)


def test_fast_inference_is_the_plain_networks(frame):
    """Trained weights are larger than random ones: the crops must stay exact."""
    sweep = osl.SphereSweep(
        osl.load_dataset(SUNNY, split="test").rig,
        osl.SphereGrid(160, 40, num_spheres=16, min_depth=1.65),
    )
    net, pairs = SweepNet.pretrained(), [(0, 1), (1, 2), (2, 3), (3, 0)]
    block = sweep.blocks()[-1]
    spherical = sweep.warp_block(sweep.normalize_images(frame.images), block)[:, -2:]
    columns = [sweep.visible_columns(camera, block) for camera in range(4)]
    expected = dense(net, spherical, pairs)
    assert expected[~expected.isnan()].std() > 0.05
    cost = LearnedCost(net, "float32")(spherical, pairs, columns)
    torch.testing.assert_close(cost.double(), expected, atol=1e-5, rtol=0, equal_nan=True)


@pytest.mark.slow
@pytest.mark.skipif(
    choose_precision("auto", "cpu") == "float32", reason="minutes, on this processor"
)
@pytest.mark.parametrize("name", NETWORKS)
def test_bfloat16_changes_no_figure(name, frame):
    rig = osl.load_dataset(SUNNY, split="test").rig
    grid = osl.SphereGrid(160, 40, num_spheres=16, min_depth=1.65)
    sweep, network = osl.SphereSweep(rig, grid), NETWORKS[name].pretrained()
    exact, half = (
        osl.cost_volume(sweep, frame.images, LearnedCost(network, precision))
        for precision in ("float32", "bfloat16")
    )
    # not one here; the sigmoid is steep
    assert ((half - exact).abs() > 2e-2).double().mean() < 1e-6
    exact, half = (
        osl.index_error(
            osl.winner_takes_all(osl.sgm(volume)).numpy(), frame.gt_index(grid), grid.num_spheres
        )
        for volume in (exact, half)
    )
    assert max(abs(half[figure] - exact[figure]) for figure in exact) < 0.1
