"""The training loop: seeds that decide everything, runs that survive being killed and shared."""

import csv
import hashlib
import multiprocessing
import os
import re
import shutil
import socket
from dataclasses import replace

import numpy as np
import pytest
import torch
from scene import refused
from tiny import MCCNN, SWEEPNET, TINY

import omnistereo_lib as osl
from omnistereo_learn import RECIPES, train
from omnistereo_learn.loop import LOG, STATE, WEIGHTS, _Run
from omnistereo_learn.samples.spheres import SphereObjective, SphereSamples
from omnistereo_lib.stereo.weights import load_tensors
from omnistereo_tools import cli
from workshop.results.ship import _hours, export_weights


def rows_of(recipe, out, data, **options):
    rows = []
    weights = train(recipe, out, data, precision="float32", on_step=rows.append, **options)
    assert weights == out / WEIGHTS
    return rows


def losses(recipe, out, data, **options):
    return [row["loss"] for row in rows_of(recipe, out, data, **options)]


def stopped(recipe, out, data, steps, **options):
    """The rows of a run that is interrupted after some steps; it writes its state after each."""
    rows = []

    def interrupt(row):
        rows.append(row)
        if len(rows) == steps:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(recipe, out, data, precision="float32", checkpoint_s=0, on_step=interrupt, **options)
    return rows


def weights(out):
    return load_tensors(out / WEIGHTS)[0]


def assert_same_weights(a, b):
    assert a.keys() == b.keys()
    for name in a:
        torch.testing.assert_close(a[name], b[name], atol=0, rtol=0)


@pytest.fixture(scope="module")
def finished(data, tmp_path_factory):
    """The folder and the rows of a run, stopped after two steps and resumed; only read."""
    out = tmp_path_factory.mktemp("finished") / "run"
    return out, stopped(SWEEPNET, out, data, 2) + rows_of(SWEEPNET, out, data)


# ---- the loop


@pytest.mark.parametrize(
    ("recipe", "optimizer"), [(SWEEPNET, "adamw"), (MCCNN, "sgd")], ids=["sweepnet", "mccnn"]
)
def test_the_seed_decides_the_weights_stopped_or_not(recipe, optimizer, data, tmp_path):
    recipe = replace(recipe, optimizer=optimizer)
    whole = losses(recipe, tmp_path / "whole", data)
    assert stopped(replace(recipe, seed=1), tmp_path / "seed", data, 1)[0]["loss"] != whole[0]
    part = [row["loss"] for row in stopped(recipe, tmp_path / "parts", data, 3)]
    with refused("Train to the end first"):
        export_weights(tmp_path / "parts", tmp_path / "weights")
    assert part + losses(recipe, tmp_path / "parts", data) == whole
    assert_same_weights(weights(tmp_path / "whole"), weights(tmp_path / "parts"))
    with (tmp_path / "parts" / LOG).open() as file:
        assert [int(row["step"]) for row in csv.DictReader(file)] == [0, 1, 2, 3]
    assert losses(recipe, tmp_path / "parts", data) == []  # nothing is left to do


def command(data, out, *settings, network="sweepnet"):
    recipe = {"sweepnet": SWEEPNET, "mccnn": MCCNN}[network]
    usual = RECIPES[network]["teaching"].as_dict()
    tiny = [f"{name}={value}" for name, value in recipe.as_dict().items() if value != usual[name]]
    verb = ["-m", "omnistereo_tools", "train", network, "--data", data, "--out", out]
    return [str(word) for word in [*verb, "--set", *tiny, *settings]]


def train_as(rank, port, *arguments):
    """Train as one of two processes, with the variables that torchrun sets."""
    os.environ |= {"RANK": str(rank), "WORLD_SIZE": "2"}
    os.environ |= {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port)}
    torch.set_num_threads(1)
    train(*arguments, precision="float32")


@pytest.mark.slow
def test_two_processes_compute_what_one_does(data, tmp_path):
    """By SGD: Adam divides by the gradient's size, rounding included where it is nearly zero."""
    recipe = replace(SWEEPNET, optimizer="sgd", learning_rate=0.01, steps=2)
    one = losses(recipe, tmp_path / "one", data)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    processes = multiprocessing.get_context("forkserver")
    processes.set_forkserver_preload(["torch._dynamo", "omnistereo_learn"])  # once for both
    both = [
        processes.Process(target=train_as, args=(rank, port, recipe, tmp_path / "two", data))
        for rank in (0, 1)
    ]
    for process in both:
        process.start()
    for process in both:
        process.join()
    assert [process.exitcode for process in both] == [0, 0]
    with (tmp_path / "two" / LOG).open() as file:
        two = [float(row["loss"]) for row in csv.DictReader(file)]
    np.testing.assert_allclose(two, one, rtol=2e-5)
    there, here = weights(tmp_path / "two"), weights(tmp_path / "one")
    for name in here:
        # The sums over two halves are rounded otherwise, and folding the norms divides by small
        # deviations.
        torch.testing.assert_close(there[name], here[name], atol=1e-3, rtol=1e-3)


@pytest.mark.parametrize("recipe", [SWEEPNET, MCCNN], ids=["sweepnet", "mccnn"])
def test_it_learns_a_batch_that_comes_again_and_again(recipe, data, tmp_path, same_batch):
    recipe = replace(recipe, steps=8, validate_every=8, augment=False, learning_rate=3e-3)
    first, *_, last = losses(recipe, tmp_path, data)
    assert last < 0.5 * first


def test_the_papers_recipe_on_a_small_panorama(data, tmp_path):
    """Table I as printed: no norms, zeros beyond the seam, one negative for each positive."""
    recipe = replace(RECIPES["sweepnet"]["paper"], **TINY, frames_per_step=2, min_positives=4)
    assert np.isfinite(losses(recipe, tmp_path, data)).all()
    assert osl.SweepNet.from_file(tmp_path / WEIGHTS).config == {"batch_norm": False, "wrap": False}


def test_what_is_exported_is_what_was_validated(data, finished):
    """The file holds Table I without norms; on the validation frame it has the log's loss."""
    out, rows = finished
    network = osl.SweepNet.from_file(out / WEIGHTS)
    assert sum(p.numel() for p in network.parameters()) == 757_729
    samples = SphereSamples(SWEEPNET, data)
    with torch.no_grad():
        batches = [
            samples.micro_batch(
                samples.validation[0], np.random.default_rng([0, 1, k]), augment=False
            )
            for k in range(2)
        ]
        found = np.mean([SphereObjective(network)(batch)[0].item() for batch in batches])
    assert found == pytest.approx(rows[-1]["validation_loss"], rel=1e-4)
    assert load_tensors(out / WEIGHTS)[1]["recipe"] == SWEEPNET.as_dict()


def test_a_finished_run_ships_with_its_curve_and_card(data, finished, tmp_path):
    run, rows = finished
    files = export_weights(run, tmp_path / "weights")
    assert [path.name for path in files] == ["sweepnet.safetensors", "sweepnet.csv", "sweepnet.md"]
    assert files[0].read_bytes() == (run / WEIGHTS).read_bytes()
    card = files[2].read_text()
    assert hashlib.sha256(files[0].read_bytes()).hexdigest() in card
    assert f"{data.parent.name}/{data.name}, 4 frames" in card and "float32" in card
    command = re.search(r"train sweepnet --preset shipped --set (.*?)`, then", card)[1].split()
    assert RECIPES["sweepnet"]["shipped"].with_overrides(command) == SWEEPNET
    assert f"{rows[-1]['validation_loss']:.4f}" in card
    with files[1].open(newline="") as file:
        curve = list(csv.DictReader(file))
    assert float(curve[0]["loss"]) == pytest.approx(
        np.mean([row["loss"] for row in rows[:10]]), rel=1e-3
    )
    assert int(curve[-1]["step"]) == SWEEPNET.steps
    half = export_weights(run, tmp_path / "half", half=True)
    assert half[0].stat().st_size < 0.55 * files[0].stat().st_size
    assert "python -m workshop ship --half`" in half[2].read_text()
    exact, halved = (osl.SweepNet.from_file(path).state_dict() for path in (files[0], half[0]))
    for name, value in exact.items():
        torch.testing.assert_close(halved[name], value, rtol=2**-11, atol=2**-25)
        assert halved[name].dtype == torch.float32


@pytest.mark.parametrize("damage", ["gone", "rubbish", "of another run"])
def test_a_finished_run_with_other_weights_gets_its_own_back(data, finished, tmp_path, damage):
    run = shutil.copytree(finished[0], tmp_path / "run")
    before = {path.name: path.read_bytes() for path in run.iterdir()}
    if damage == "gone":
        (run / WEIGHTS).unlink()
    elif damage == "rubbish":
        (run / WEIGHTS).write_bytes(bytes(100))
    else:
        train(replace(SWEEPNET, steps=1, seed=3), tmp_path / "other", data)
        shutil.copyfile(tmp_path / "other" / WEIGHTS, run / WEIGHTS)
    train(SWEEPNET, run, data)
    assert {path.name: path.read_bytes() for path in run.iterdir()} == before


def test_other_data_under_the_same_name_are_another_run(data, tmp_path):
    copy = shutil.copytree(data, tmp_path / data.parent.name / data.name)
    train(replace(SWEEPNET, steps=1), tmp_path / "run", copy)
    picture = next(copy.glob("cam1/*"))
    picture.write_bytes(picture.read_bytes() + b"\n")
    with refused("belongs to a different run: data: "):
        train(replace(SWEEPNET, steps=1), tmp_path / "run", copy)


def test_a_run_may_begin_with_trained_weights(data, finished, tmp_path):
    recipe = replace(SWEEPNET, batch_norm=False, steps=2, warmup=0)
    start = finished[0] / WEIGHTS  # of a network with norms, which are folded into them
    samples = SphereSamples(recipe, data)
    rng = [np.random.default_rng([recipe.seed, 0, k]) for k in range(2)]
    objective = SphereObjective(osl.SweepNet.from_file(start))
    expected = [
        objective(samples.micro_batch(samples.training_frame(k), rng[k], augment=True))[0].item()
        for k in range(2)
    ]
    found = losses(recipe, tmp_path / "whole", data, init_weights=start)
    assert found[0] == pytest.approx(np.mean(expected), rel=1e-5)
    card = export_weights(tmp_path / "whole", tmp_path / "weights")[2].read_text()
    assert (
        "--init-weights FILE`, FILE with SHA-256"
        f" `{hashlib.sha256(start.read_bytes()).hexdigest()}`" in card
    )
    with refused(r"a different run: init_weights: \w{64} there, None here"):
        losses(recipe, tmp_path / "whole", data)
    with refused(r"holds SweepNet\(batch_norm=False, .*; expected SweepNet\(batch_norm=True"):
        losses(SWEEPNET, tmp_path / "norms", data, init_weights=start)
    with refused(r"holds SweepNet\(.*; expected MCCNN\(variant='fast'"):
        losses(MCCNN, tmp_path / "patches", data, init_weights=start)


def test_hours_are_those_of_all_calls():
    rows = [{"seconds": s} for s in (10.0, 30.0, 5.0, 3600.0, 2.0)]
    assert _hours(rows) == pytest.approx((30 + 3600 + 2) / 3600)


def test_rates():
    cosine = replace(SWEEPNET, steps=1000, warmup=100, learning_rate=1.0)
    assert cosine.learning_rate_at(0) == pytest.approx(0.01)
    assert cosine.learning_rate_at(500) == pytest.approx(0.5)
    assert cosine.learning_rate_at(999) < 1e-5
    drop = replace(SWEEPNET, steps=1400, warmup=0, schedule="drop", learning_rate=0.003)
    assert [drop.learning_rate_at(step) for step in (0, 1099, 1100, 1399)] == pytest.approx(
        [0.003, 0.003, 0.0003, 0.0003]
    )


# ---- bad input


def test_a_folder_with_another_run_is_left_alone(data, finished):
    with refused(r"a different run: seed: 0 there, 5 here"):
        losses(replace(SWEEPNET, seed=5), finished[0], data)
    with refused(r"a different run: network: sweepnet there, mccnn here; "):
        losses(MCCNN, finished[0], data)


def test_a_loss_that_is_not_finite_stops_the_run(data, tmp_path):
    recipe = replace(
        SWEEPNET, optimizer="sgd", learning_rate=1e30, warmup=0, batch_norm=False, steps=4
    )
    with refused(r"was not finite in 2 of \d+ steps\. Lower learning_rate"):
        losses(recipe, tmp_path, data, checkpoint_s=0)
    # finite: `load_tensors` checks
    assert (tmp_path / STATE).is_file() and load_tensors(tmp_path / STATE)


def test_a_step_that_is_not_finite_is_skipped(data, tmp_path, monkeypatch):
    """The second step has no loss, changes no weight, is empty in the log, and counts."""
    spoiled, loss = [1], _Run.loss
    calls = []

    def spoil(run, batch, objective=None):
        calls.append(None)
        value, error = loss(run, batch, objective)
        return (value * np.nan if len(calls) - 1 in spoiled else value), error

    monkeypatch.setattr(_Run, "loss", spoil)
    recipe = replace(SWEEPNET, frames_per_step=1, validate_every=100, batch_norm=False)
    before = stopped(recipe, tmp_path, data, steps=1)[0]["loss"]
    state = load_tensors(tmp_path / STATE)[0]
    assert np.isnan(stopped(recipe, tmp_path, data, steps=1)[0]["loss"]) and np.isfinite(before)
    stored = load_tensors(tmp_path / STATE)[0]
    assert all(torch.equal(tensor, state[name]) for name, tensor in stored.items())
    assert (tmp_path / LOG).read_text().splitlines()[2].startswith("1,,")
    spoiled.append(2)
    with refused("was not finite in 2 of 3 steps"):
        losses(recipe, tmp_path, data)


def test_weights_that_are_not_finite_stop_the_run(data, tmp_path):
    """The last step has no loss after it that would tell."""
    recipe = replace(
        SWEEPNET, optimizer="sgd", learning_rate=1e38, clip=1e9, warmup=0, batch_norm=False, steps=1
    )
    recipe = replace(recipe, weight_decay=1e3, momentum=0.0)
    with refused(r"weights.safetensors: .* is NaN or infinite; .* Lower learning_rate"):
        losses(recipe, tmp_path, data)
    assert not list(tmp_path.iterdir())


def test_bad_data(data, tmp_path):
    with refused("nothing"):
        losses(SWEEPNET, tmp_path / "out", tmp_path / "nothing")
    for kind, name in (("truth", "omnidepth_gt_96"), ("min_depth", None)):
        copy = tmp_path / kind
        copy.mkdir()
        for path in data.iterdir():
            if path.name not in (name, "config.yaml"):
                (copy / path.name).symlink_to(path)
        rig = osl.load_rig(data)
        nearest = 0.6 if name else None
        osl.save_rig(osl.Rig(rig.cameras, rig.T_rig_cam, min_depth=nearest), copy / "config.yaml")
    with refused("has 0 frames with ground truth"):
        losses(SWEEPNET, tmp_path / "out", tmp_path / "truth")
    with refused("does not state its nearest depth"):
        losses(SWEEPNET, tmp_path / "out", tmp_path / "min_depth")


def test_bad_recipes(data, tmp_path, monkeypatch):
    with refused(r"panorama of 47 × 12 pixels; .* must be even"):
        losses(replace(SWEEPNET, width=47), tmp_path, data)
    with refused("num_spheres is 1; expected"):
        losses(replace(SWEEPNET, num_spheres=1), tmp_path, data)
    with refused("no sphere has 99999 positives"):
        losses(replace(SWEEPNET, min_positives=99999), tmp_path, data)
    unlike = replace(MCCNN, negative_low_px=200.0, negative_high_px=300.0)
    with refused(r"their views are 200\.0 pixels apart"):
        losses(unlike, tmp_path, data)
    with refused("expected positive_px < negative_low_px"):
        replace(MCCNN, negative_low_px=0.1)
    monkeypatch.setenv("WORLD_SIZE", "3")
    with refused(
        "is not divisible by 3 processes; expected 1 or 2 of them. .* --set frames_per_step=3$"
    ):
        losses(SWEEPNET, tmp_path, data)
    monkeypatch.setenv("WORLD_SIZE", "2")
    monkeypatch.delenv("MASTER_ADDR", raising=False)
    with refused(r"WORLD_SIZE is 2.*start by torchrun"):
        losses(SWEEPNET, tmp_path, data)


@pytest.mark.parametrize(
    "recipe, name, value, expected",
    [
        (SWEEPNET, "steps", 0, "a finite number > 0"),
        (SWEEPNET, "learning_rate", float("inf"), "a finite number > 0"),
        (SWEEPNET, "clip", float("nan"), "a finite number > 0"),
        (SWEEPNET, "warmup", -5, "a finite number ≥ 0"),
        (SWEEPNET, "momentum", float("nan"), "a fraction"),
        (SWEEPNET, "any_sphere", 20, "a fraction"),
        (SWEEPNET, "optimizer", "adam", "one of adamw, sgd"),
        (MCCNN, "variant", "slow", "one of fast, accurate"),
        (MCCNN, "positive_px", -0.1, "a finite number ≥ 0"),
    ],
)
def test_recipes_check_their_ranges(recipe, name, value, expected):
    with refused(f"recipe: {name} = {value!r}; expected {expected}"):
        replace(recipe, **{name: value})


def test_the_command_line(data, tmp_path, capsys):
    assert cli.main(command(data, tmp_path / "out", "wrap=true", network="mccnn")[2:]) == 2
    assert "unknown setting 'wrap'; a mccnn recipe has worlds" in capsys.readouterr().err
    assert cli.main(command(data, tmp_path / "out", network="mccnn")[2:]) == 0
    captured = capsys.readouterr()
    assert "step 2: validation" in captured.out + captured.err
    assert "4 steps are done" in captured.out
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(
        [LOG, STATE, WEIGHTS, "provenance.json"]
    )
    assert cli.main(["train", "mccnn", "--set", "steps=many"]) == 2
    assert "steps=many: 'many'; expected int" in capsys.readouterr().err
    assert osl.MCCNN.from_file(tmp_path / "out" / WEIGHTS).variant == "fast"


def test_runs_with_other_settings_have_other_default_folders(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folders = []
    monkeypatch.setattr(
        "omnistereo_learn.train", lambda recipe, out, *_, **__: folders.append(str(out))
    )
    for settings in (
        [],
        ["--set", "worlds=sunny things", "steps=9"],
        ["--set", "steps=9", "worlds=sunny things"],
    ):
        assert cli.main(["train", "mccnn", *settings]) == 0
    other = "out/mccnn_teaching_steps=9_worlds=sunny-things"
    assert folders == ["out/mccnn_teaching", other, other]


def test_a_folder_in_the_place_of_the_state_is_refused_before_the_first_step(data, tmp_path):
    (tmp_path / STATE).mkdir()
    steps = []
    with refused(STATE):
        train(MCCNN, tmp_path, data, on_step=steps.append)
    assert steps == []
