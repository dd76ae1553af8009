"""The results that ship: of the data and weights that ship, and the same again."""

import re
from itertools import product

import numpy as np
import pytest

import omnistereo_lib as osl
from omnistereo_learn import RECIPES
from omnistereo_learn.evaluate import SCALES, evaluate_frame
from omnistereo_learn.evaluate.methods import EvaluatedMethod
from omnistereo_learn.evaluate.records import config_checksum, read_record
from omnistereo_learn.evaluate.regions import METRICS
from omnistereo_learn.evaluate.run import DATA
from omnistereo_learn.evaluate.table import errors_table
from omnistereo_learn.samples.spheres import SphereSamples
from omnistereo_lib.files import checksum, unpack
from omnistereo_lib.stereo.weights import BUNDLED_WEIGHTS

# Those of evaluations; the others are tables of scripts of their own.
STORED = {
    path.stem: path
    for path in sorted((DATA / "results").glob("*.json"))
    if path.stem not in ("error_bars", "ray_sentences")
}
PAGE = (DATA.parent / "book" / "training.md").read_text(encoding="utf-8")


def cells(figures):
    return [f"{x:.{1 if '>' in key else 2}f}" for x, key in zip(figures, METRICS, strict=True)]


def folder_of(data):
    """Of a data set by its name in a result: "sunny" is its test frames, "sunny-train" others."""
    name, _, split = data.partition("-")
    return DATA / name / (split or "test")


@pytest.mark.parametrize("name", STORED)
def test_they_come_from_what_ships(name):
    stored = read_record(STORED[name])
    assert stored["config_sha256"] == config_checksum(stored)
    scale = SCALES["paper" if name.startswith("paper") else "teaching"]
    assert {key: stored["config"][key] for key in ("width", "height", "num_spheres")} == vars(scale)
    assert {
        name: checksum((BUNDLED_WEIGHTS / name).read_bytes()) for name in stored["weights"]
    } == stored["weights"]
    for key, digest in stored["data"].items():
        data, _, file = key.partition("/")
        unpack(folder_of(data))
        # lights share the depth of one drive
        own, shared = folder_of(data) / file, folder_of("sunny") / file
        assert checksum((own if own.is_file() else shared).read_bytes()) == digest, key
    frames = [frame for numbered in stored["frames"].values() for frame in numbered.values()]
    assert all(set(frame) == set(stored["methods"]) for frame in frames)


# ZNCC's, since the networks take minutes; notebook 10 computes a frame of "teaching" again.
@pytest.mark.parametrize(("name", "number"), [("ablations", 831), ("penalties", 153)])
def test_a_frame_again(name, number):
    stored = read_record(STORED[name])
    data = osl.load_dataset(folder_of(*stored["frames"]))
    scale = SCALES["teaching"]
    grid = osl.SphereGrid(
        scale.width, scale.height, num_spheres=scale.num_spheres, min_depth=data.rig.min_depth
    )
    every = [EvaluatedMethod.parse(text) for text in stored["methods"]]
    methods = [method for method in every if method.cost == "zncc" and not method.num_spheres]
    sweep = osl.SphereSweep(data.rig, grid)
    again = dict(
        evaluate_frame(
            sweep, data.frame(number), methods, lambda method: method.load_cost(BUNDLED_WEIGHTS)
        )
    )
    assert again.keys() == set(methods) and len(methods) >= 6
    for method, errors in again.items():
        (frames,) = stored["frames"].values()
        figures = frames[f"{number:05}"][method.name]["figures"]
        assert errors["figures"] == pytest.approx(figures, abs=0.1), method.name


def test_the_calibrated_rig_costs_little():
    """Notebook 02 calibrates it again."""
    calibrated, exact = (
        read_record(STORED[name])["frames"]["sunny"] for name in ("calibrated", "teaching")
    )
    for number, methods in calibrated.items():
        for method, errors in methods.items():
            known = exact[number][method]["figures"]
            assert errors["figures"]["MAE"] == pytest.approx(known["MAE"], rel=0.05)
            assert errors["figures"] != known


def test_penalties_are_chosen_on_frames_that_no_network_learned_from():
    kept_apart = {
        f"{frame.number:05}"
        for frame in SphereSamples(
            RECIPES["sweepnet"]["shipped"], DATA / "sunny" / "train"
        ).validation
    }
    assert set(read_record(STORED["penalties"])["frames"]["sunny-train"]) <= kept_apart


def test_the_page_on_training_quotes_the_results():
    quoted = re.findall(r"^\| (Sunny|Aerial|Indoor) \| (.+?) \| (.+) \|$", PAGE, re.MULTILINE)
    means = {}
    for name in ("paper", "paper-volumenet"):
        table = errors_table(read_record(STORED[name]))
        means |= {
            (label, column): mean
            for (label,), row in table.rows
            for column, (mean, *_) in zip(table.columns, row, strict=True)
        }
    assert len(quoted) == 6
    for light, label, numbers in quoted:
        found = [means[label, f"{light} {metric}"] for metric in METRICS]
        assert numbers == " | ".join(cells(found))


def test_the_page_on_training_quotes_the_rigs_that_no_network_has_seen():
    """Mean error over the rays that two cameras see; VolumeNet is the best in each."""
    methods = ("zncc+sgm", "sweepnet+sgm", "sweepnet+sgm,weights=sweepnet_worlds", "volumenet")
    for world, frames in read_record(STORED["teaching-worlds"])["frames"].items():
        errors = np.zeros((len(frames), len(methods)))
        for row, frame in zip(errors, frames.values(), strict=True):
            for k, method in enumerate(methods):
                regions = [
                    sums
                    for name, sums in frame[method]["strata"].items()
                    if re.fullmatch("seen by [2-9]", name)
                ]
                row[k] = sum(sums["sum"] for sums in regions) / sum(
                    sums["rays"] for sums in regions
                )
        assert (errors.argmin(1) == methods.index("volumenet")).all()
        assert f"| {world} | {' | '.join(f'{mean:.2f}' for mean in errors.mean(0))} |" in PAGE


def test_sweepnet_of_all_worlds_is_better_in_rooms_and_no_worse_in_the_streets():
    """And the page on training quotes its figures."""
    lights, room = ("sunny", "cloudy", "sunset"), ("indoor",)
    places = {
        "streets": (lights, "teaching"),
        "room": (room, "teaching"),
        "room, 1200 × 300": (room, "paper"),
    }
    rows = []
    for (place, (sets, scale)), method in product(places.items(), ("sweepnet", "sweepnet+sgm")):
        means = []
        for trained_on, weights in (("Sunny", ""), ("all worlds", "sweepnet_worlds")):
            stored = read_record(STORED[f"{scale}-{weights}" if weights else scale])["frames"]
            name = f"{method},weights={weights}" if weights else method
            figures = [frame[name]["figures"] for key in sets for frame in stored[key].values()]
            means.append(np.array([np.mean([one[key] for one in figures]) for key in METRICS]))
            row = [place, EvaluatedMethod.parse(method).label, trained_on, *cells(means[-1])]
            rows.append(f"| {' | '.join(row)} |")
        assert (means[1] <= (1.02 if place == "streets" else 1.0) * means[0]).all(), (place, method)
    assert [
        row for row in PAGE.splitlines() if row.startswith(("| streets |", "| room |", "| room, "))
    ] == rows
    skies = []
    for name, method in (
        ("teaching", "sweepnet"),
        ("teaching-sweepnet_worlds", "sweepnet,weights=sweepnet_worlds"),
    ):
        frames = read_record(STORED[name])["frames"]["sunny"].values()
        total, rays = (
            sum(frame[method]["strata"]["sky"][key] for frame in frames) for key in ("sum", "rays")
        )
        skies.append(f"{total / rays:.1f}")
    assert f"Sunny's sky falls from {' to '.join(skies)}" in PAGE
