"""Evaluation: figures against float64 written out ray by ray, runs that survive being killed and shared, its tables."""

import csv
import hashlib
import io
import itertools
import json
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scene
import torch
from hypothesis import given
from hypothesis import strategies as st

import omnistereo_lib as osl
from omnistereo_lib import cli
from omnistereo_lib.dataset import write_inverse_depth
from omnistereo_lib.evaluate import (
    ABLATIONS,
    METHODS,
    SCALES,
    Evaluation,
    Scale,
    Table,
    errors_table,
    evaluate_frame,
    find_sets,
    regions_table,
    run,
    select_methods,
    write_results,
)
from omnistereo_lib.evaluate.records import read_record, write_record
from omnistereo_lib.evaluate.regions import (
    METRICS,
    SUMS,
    error_sums,
    find_regions,
    near_edges,
    sums_to_metrics,
    thin_objects,
)
from omnistereo_lib.evaluate.table import bootstrap
from omnistereo_lib.files import write_image
from omnistereo_lib.stereo.methods import Method

SMALL = Scale(96, 24, 12)
TINY = Scale(48, 14, 8)  # for the networks
ZNCC = METHODS[::3]
RIG = scene.rig(width=200, height=192)
FRAMES = (1, 2, 3)

PATHS = f"{Path(__file__).parent} {Path(__file__).parents[1]}"  # this module and the helpers beside its folder


@pytest.fixture(scope="session")
def data(tmp_path_factory):
    """Three frames of a rig that moves through the box, with ground truth."""
    folder = tmp_path_factory.mktemp("evaluate") / "box"
    folder.mkdir()
    osl.Rig(RIG.cameras, RIG.T_rig_cam, min_depth=0.6).save(folder / "config.yaml")
    grid = osl.SphereGrid(96, 24, (-45, 45), 12, 0.6)
    (folder / "omnidepth_gt_96").mkdir()
    for number in FRAMES:
        step = osl.Pose.from_vector([0, 0, 0, 0.2 * number - 0.5, 0, 0.15 * number])
        moved = osl.Rig(RIG.cameras, [step @ pose for pose in RIG.T_rig_cam])
        for k, picture in enumerate(scene.images(moved, finest=0.25), 1):
            (folder / f"cam{k}").mkdir(exist_ok=True)
            write_image(folder / f"cam{k}" / f"{number:04}.png", picture)
        truth = grid.index_to_inverse_depth(scene.true_index(moved, grid))
        write_inverse_depth(folder / "omnidepth_gt_96" / f"{number:05}.tiff", truth)
    return folder


@pytest.fixture(scope="session")
def weights(tmp_path_factory):
    """Networks that have learned nothing."""
    folder = tmp_path_factory.mktemp("weights")
    torch.manual_seed(0)
    osl.MCCNN().save(folder / "mccnn_fast.safetensors")
    osl.SweepNet().save(folder / "sweepnet.safetensors")
    return folder


def evaluation(out, data, methods=ZNCC, **options):
    return Evaluation(out, {"box": data}, methods, **{"scale": SMALL, "precision": "float32"} | options)


def whole(out, data, methods=ZNCC, **options):
    """Evaluate and merge; return the bytes of results.json."""
    task = evaluation(out, data, methods, **options)
    list(task.run())
    write_results(task.out, task.results())
    return (task.out / "results.json").read_bytes()


@pytest.fixture
def copy(data, tmp_path):
    """A copy of the data to spoil."""
    return shutil.copytree(data, tmp_path / "copy" / "box")


# ---- figures


def brute_figures(errors):
    if not errors:
        return [np.nan] * 5
    above = [100 * sum(e > limit for e in errors) / len(errors) for limit in (1, 3, 5)]
    return [*above, sum(errors) / len(errors), (sum(e * e for e in errors) / len(errors)) ** 0.5]


def brute_errors(index, truth, num_spheres, mask):
    """The paper's errors, ray by ray in Python's float64."""
    errors = []
    for estimate, true, wanted in zip(index.ravel(), truth.ravel(), mask.ravel(), strict=True):
        if wanted and 0 <= true < num_spheres:
            errors.append(100.0 if np.isnan(estimate) else 100 / num_spheres * abs(float(estimate) - float(true)))
    return errors


def random_maps(seed=0, shape=(9, 31), num_spheres=48):
    rng = np.random.default_rng(seed)
    truth = rng.uniform(-3, num_spheres + 3, shape)
    index = rng.integers(0, num_spheres, shape).astype(np.float32)
    truth[rng.random(shape) < 0.1] = np.nan
    index[rng.random(shape) < 0.1] = np.nan
    close = rng.random(shape) < 0.6
    index[close] = np.rint(truth[close])
    return index, truth


@pytest.mark.parametrize("seed", range(3))
def test_sums_and_figures_agree_with_the_definition(seed):
    index, truth = random_maps(seed)
    masks = {"all": np.ones(truth.shape, bool), "some": np.random.default_rng(9).random(truth.shape) < 0.3}
    found = error_sums(index, truth, 48, masks)
    for name, mask in masks.items():
        errors = brute_errors(index, truth, 48, mask)
        assert found[name]["rays"] == len(errors) > 50
        assert found[name]["sum"] == pytest.approx(sum(errors), rel=1e-12)
        of_sums = sums_to_metrics([found[name][key] for key in SUMS])
        np.testing.assert_allclose(of_sums, brute_figures(errors), rtol=1e-12)
        np.testing.assert_allclose(of_sums, list(osl.index_error(index, truth, 48, mask).values()), rtol=1e-12)


def test_sums_of_frames_add_up():
    everywhere = {"all": np.ones((9, 31), bool)}
    maps = [random_maps(seed) for seed in range(4)]
    sums = [list(error_sums(*pair, 48, everywhere)["all"].values()) for pair in maps]
    together = [np.concatenate(side) for side in zip(*maps, strict=True)]
    expected = brute_figures(brute_errors(*together, 48, np.ones((36, 31), bool)))
    np.testing.assert_allclose(sums_to_metrics(np.sum(sums, 0)), expected, rtol=1e-12)


DEGENERATE = {
    "nothing estimated": (np.full((4, 6), np.nan), np.full((4, 6), 3.2), [100, 100, 100, 100, 100]),
    "all sky": (np.zeros((4, 6)), np.zeros((4, 6)), [0, 0, 0, 0, 0]),
    "sky missed": (np.full((4, 6), 2.0), np.zeros((4, 6)), [100, 100, 100, 10, 10]),
    "constant": (np.full((4, 6), 7.0), np.full((4, 6), 7.4), [100, 0, 0, 2, 2]),
    "no truth": (np.full((4, 6), 7.0), np.full((4, 6), np.nan), [np.nan] * 5),
    "truth out of range": (np.full((4, 6), 7.0), np.full((4, 6), 20.0), [np.nan] * 5),
}


@pytest.mark.parametrize("name", DEGENERATE)
def test_degenerate_maps(name):
    index, truth, expected = DEGENERATE[name]
    sweep = osl.SphereSweep(RIG, osl.SphereGrid(6, 4, num_spheres=20, min_depth=0.6))
    strata = find_regions(truth, sweep)
    found = error_sums(index, truth, 20, strata)
    np.testing.assert_allclose(sums_to_metrics([found["all"][key] for key in SUMS]), expected, atol=1e-12)
    assert found["at edges"]["rays"] == found["thin"]["rays"] == 0
    assert found["sky"]["rays"] == (24 if "sky" in name else 0)
    json.dumps(found, allow_nan=False)


# ---- strata


def relief(seed=0, shape=(16, 40), num_spheres=64):
    """A ground plane with posts, boxes, one across the seam, sky, and unknown rays."""
    rng = np.random.default_rng(seed)
    truth = np.tile(np.linspace(0, 12, shape[0])[:, None], shape[1])
    truth[:5] = 0
    for width in (1, 2, 3, 4, 5, 6, 9):
        row, column = rng.integers(shape[0] - 3), rng.integers(shape[1])
        columns = (column + np.arange(width)) % shape[1]
        truth[row : row + 8, columns] = rng.uniform(5, num_spheres + 2)
    truth[2:6, [-2, -1, 0, 1, 2]] = 40.7
    truth[rng.random(shape) < 0.02] = np.nan
    return truth


@pytest.mark.parametrize("seed", range(4))
def test_edges_are_near_a_jump(seed):
    truth, limit = relief(seed), 0.05 * 64
    H, W = truth.shape
    beside = set()
    for y, x in itertools.product(range(H), range(W)):
        for other in ((y, (x + 1) % W), (y + 1, x)):
            if other[0] < H and abs(truth[y, x] - truth[other]) > limit:
                beside |= {(y, x), other}
    expected = np.zeros((H, W), bool)
    for y, x in beside:
        for dy, dx in itertools.product(range(-3, 4), repeat=2):
            if 0 <= y + dy < H:
                expected[y + dy, (x + dx) % W] = True
    assert 0.1 < expected.mean() < 0.95
    np.testing.assert_array_equal(near_edges(truth, 64), expected)


@pytest.mark.parametrize(("width", "side"), [(40, 3), (600, 5), (1200, 11)])
def test_thin_is_what_no_square_of_a_few_degrees_fits_into(width, side):
    truth = np.tile(relief(), (1, width // 40))
    H, W = truth.shape
    found = thin_objects(truth, 64)
    assert 0 < found.mean() < 0.5
    r = side // 2
    filled = np.where(np.isnan(truth), np.inf, truth)
    for y, x in np.random.default_rng(0).permutation(list(itertools.product(range(H), range(W))))[:640]:
        lowest = []
        for cy, cx in itertools.product(range(y - r, y + r + 1), range(x - r, x + r + 1)):
            cy = min(max(cy, 0), H - 1)
            rows = np.arange(cy - r, cy + r + 1).clip(0, H - 1)
            lowest.append(filled[rows][:, np.arange(cx - r, cx + r + 1) % W].min())
        assert found[y, x] == (truth[y, x] - max(lowest) > 0.05 * 64)


def test_a_post_is_thin_and_a_car_is_not():
    truth = np.zeros((80, 320))
    truth[20:60, 100:102] = 30.0
    truth[40:60, [318, 319, 0, 1]] = 30.0  # across the seam: four pixels
    expected = np.zeros(truth.shape, bool)
    expected[20:60, 100:102] = True
    np.testing.assert_array_equal(thin_objects(truth, 64), expected)


def test_depth_ranges_and_cameras(data):
    grid = osl.SphereGrid(96, 24, num_spheres=12, min_depth=0.6)
    sweep = osl.SphereSweep(RIG, grid)
    depth = np.random.default_rng(0).choice([np.inf, 5.0, 1.9, 1.7, 1.0, 0.8, 0.6], grid.shape)
    truth = grid.depth_to_index(depth)
    truth[3, 4] = np.nan
    strata = find_regions(truth, sweep)
    known = np.isfinite(truth)
    for name, expected in {
        "all": True, "sky": np.isinf(depth), "far": (depth > 3 * 0.6) & np.isfinite(depth),
        "middle": (depth <= 3 * 0.6) & (depth > 1.5 * 0.6), "near": depth <= 1.5 * 0.6,
    }.items():  # fmt: skip
        np.testing.assert_array_equal(strata[name] & known, expected & known)
    center = np.mean([pose.t for pose in RIG.T_rig_cam], 0)
    points = center + grid.rays() * np.where(np.isinf(depth), 1e7, depth)[..., None]
    cameras = zip(RIG.cameras, RIG.T_rig_cam, strict=True)
    count = np.sum([lens.project(pose.inverse() @ points)[1] for lens, pose in cameras], 0)
    assert len(set(count[known])) >= 2
    for k in range(5):
        np.testing.assert_array_equal(strata[f"seen by {k}"] & known, (count == k) & known)
    parts = [name for name in strata if name.startswith("seen")]
    assert np.sum([strata[name] for name in parts], 0).min() == 1
    assert (strata["at edges"] ^ strata["off edges"]).all()


# ---- frames


def test_a_frame_agrees_with_the_steps_done_one_by_one(data, weights):
    methods = [*METHODS, Method.parse("zncc+sgm,p1=0.3,p2=2"), Method.parse("zncc,subindex=true,pairs=all")]
    methods.append(Method.parse("sweepnet,wrap=false"))
    dataset = osl.load_dataset(data)
    grid = osl.SphereGrid(48, 14, num_spheres=8, min_depth=0.6)
    sweep = osl.SphereSweep(dataset.rig, grid)
    found = dict(evaluate_frame(sweep, dataset[1], methods, lambda m: m.load_cost(weights, "float32")))
    assert set(found) == set(methods)
    truth = dataset[1].gt_index(grid)
    strata = find_regions(truth, sweep)
    costs = {
        "zncc": osl.ZNCC(), "mccnn": osl.MCCNN.load(weights / "mccnn_fast.safetensors", "float32"),
        "sweepnet": osl.SweepNet.load(weights / "sweepnet.safetensors", "float32"),
    }  # fmt: skip
    for method, errors in found.items():
        cost = costs[method.cost]
        if method.cost == "sweepnet":
            cost.wrap = method.wrap
        volume = osl.cost_volume(sweep, dataset[1].images, cost, method.pairs)
        if method.aggregate == "sgm":
            volume = osl.sgm(volume, method.p1, method.p2, wrap=method.wrap)
        index = osl.winner_takes_all(volume, method.subindex).numpy()
        expected = brute_figures(brute_errors(index, truth, 8, strata["all"]))
        np.testing.assert_allclose(list(errors["figures"].values()), expected, rtol=1e-12)
        for name, mask in strata.items():
            expected = brute_figures(brute_errors(index, truth, 8, mask))
            np.testing.assert_allclose(sums_to_metrics(list(errors["strata"][name].values())), expected, rtol=1e-9)
    distinct = {json.dumps(errors) for errors in found.values()}
    assert len(distinct) == len(found)  # every setting had an effect


def test_a_volume_is_computed_once_for_all_methods_that_share_it(data, weights, tmp_path, monkeypatch):
    calls = []
    monkeypatch.setattr(run, "cost_volume", lambda *a: calls.append(a[3]) or osl.cost_volume(*a))
    methods = [*METHODS, *ABLATIONS["penalties"], *ABLATIONS["subindex"], *select_methods(["zncc,pairs=all"])]
    task = evaluation(tmp_path / "out", data, methods, weights=weights, frames=[1], scale=TINY)
    assert len(list(task.run())) == len(task.jobs) == len(set(methods)) == 6 + 33 + 6 + 1
    assert calls == ["ring", "ring", "ring", "all"]


def test_zncc_finds_the_walls(data, tmp_path):
    results = json.loads(whole(tmp_path / "out", data))
    for frame in results["frames"]["box"].values():
        assert frame["zncc"]["figures"]["MAE"] < 6 and frame["zncc"]["strata"]["all"]["rays"] == 96 * 24


def test_the_number_of_spheres_is_the_methods(data, tmp_path):
    methods = [Method(cost="zncc", num_spheres=n) for n in (0, 12, 24)]
    frames = json.loads(whole(tmp_path / "out", data, methods, frames=[2]))["frames"]["box"]["00002"]
    assert frames["zncc"] == frames["zncc,num_spheres=12"] != frames["zncc,num_spheres=24"]


# ---- methods


# ---- runs that are stopped and shared


nested = st.recursive(
    st.text(" {}\n\\,:a") | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.none(),
    lambda inner: st.dictionaries(st.text(" {}\n\\,:a"), inner, max_size=3),
)


@given(nested)
def test_a_record_comes_back(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("record") / "a.json"
    record = {name: {} for name in ("config", "methods", "data", "weights")} | {"frames": content}
    write_record(path, record)
    assert read_record(path) == record


def test_the_merged_file_says_what_it_came_from(data, weights, tmp_path):
    def sha(path):
        return hashlib.sha256(path.read_bytes()).hexdigest()

    text = whole(tmp_path / "out", data, METHODS, weights=weights, frames=[1, 3], scale=TINY)
    results = json.loads(text)
    assert json.dumps(results) == json.dumps(results, sort_keys=True)  # as they stand in the file
    line = next(line for line in text.decode().splitlines() if '"figures"' in line)
    assert all(f'"{name}"' in line for name in METRICS)
    scale = {"width": 48, "height": 14, "num_spheres": 8}
    assert results["config"] == {**scale, "precision": "float32", "rig": "own"}
    assert results["methods"]["mccnn+sgm"] == {
        "cost": "mccnn", "aggregate": "sgm", "window": 9, "weights": "", "pairs": "ring", "p1": 0.1, "p2": 12.0,
        "wrap": True, "subindex": False, "num_spheres": 0,
    }  # fmt: skip
    expected = {"box/config.yaml": sha(data / "config.yaml")}
    for number in (1, 3):
        expected |= {f"box/cam{k}/{number:04}.png": sha(data / f"cam{k}" / f"{number:04}.png") for k in (1, 2, 3, 4)}
        truth = f"omnidepth_gt_96/{number:05}.tiff"
        expected[f"box/{truth}"] = sha(data / truth)
    assert results["data"] == expected
    names = ("mccnn_fast.safetensors", "sweepnet.safetensors")
    assert results["weights"] == {name: sha(weights / name) for name in names}
    assert {number: set(frame) for number, frame in results["frames"]["box"].items()} == {
        number: {method.name for method in METHODS} for number in ("00001", "00003")
    }
    settings = {name: results[name] for name in ("config", "methods")}
    compact = json.dumps(settings, sort_keys=True, separators=(",", ":")).encode()
    assert results["config_sha256"] == hashlib.sha256(compact).hexdigest()


def test_a_stopped_run_goes_on_to_the_same_file(data, tmp_path):
    expected = whole(tmp_path / "whole", data)
    for stop in (1, 2, 3, 5):
        task = evaluation(tmp_path / f"stop{stop}", data)
        running = task.run()
        for _ in range(stop):
            next(running)
        running.close()
        assert len(task.missing()) == 6 - stop
        with pytest.raises(osl.OmnistereoError, match=rf"{6 - stop} of 6 results are missing, such as .*zncc.*json"):
            task.results()
        task = evaluation(task.out, data, tuple(reversed(ZNCC)))  # nor does the order matter
        assert len(list(task.run())) == 6 - stop
        write_results(task.out, task.results())
        assert (task.out / "results.json").read_bytes() == expected


def test_a_killed_process_goes_on_to_the_same_file(data, weights, tmp_path):
    """SIGKILL, whatever it is doing."""
    script = (
        "import sys, pathlib; sys.path[:0] = sys.argv[1].split(); import test_evaluate as t\n"
        "task = t.evaluation(sys.argv[2], pathlib.Path(sys.argv[3]), t.METHODS, weights=sys.argv[4], scale=t.TINY)\n"
        "for job in task.run(): pass"
    )
    tiny = {"weights": weights, "scale": TINY}
    arguments = [
        sys.executable,
        "-c",
        script,
        PATHS,
        tmp_path / "killed",
        data,
        weights,
    ]
    process = subprocess.Popen([str(word) for word in arguments])
    while process.poll() is None and not list((tmp_path / "killed").glob("frames/*/*/[!.]*.json")):
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    process.wait()
    left = len(evaluation(tmp_path / "killed", data, METHODS, **tiny).missing())
    assert 0 < left < 18
    expected = whole(tmp_path / "whole", data, METHODS, **tiny)
    assert whole(tmp_path / "killed", data, METHODS, **tiny) == expected


def test_what_a_kill_leaves_in_the_middle_of_writing_is_no_result(data, tmp_path):
    task = evaluation(tmp_path, data)
    next(task.run())
    (done,) = tmp_path.glob("frames/*/*/*.json")
    done.with_name(".123.zncc+sgm.json").write_text("{")
    assert len(evaluation(tmp_path, data).missing()) == 5


@pytest.mark.parametrize("parts", [2, 3, 4])
def test_shards_of_several_machines_merge_to_the_same_file(data, tmp_path, parts):
    expected = whole(tmp_path / "whole", data)
    seen = []
    for part in range(1, parts + 1):
        task = evaluation(tmp_path / f"machine{part}", data)
        seen += task.run(task.share(f"{part}/{parts}"))
        shutil.copytree(task.out, tmp_path / "together", dirs_exist_ok=True)
    task = evaluation(tmp_path / "together", data)
    assert set(seen) == set(task.jobs) and len(seen) == len(task.jobs) and list(task.run()) == []
    write_results(task.out, task.results())
    assert (task.out / "results.json").read_bytes() == expected


def test_processes_of_torchrun_share_the_frames(data, tmp_path, monkeypatch):
    monkeypatch.setenv("WORLD_SIZE", "2")
    shares = []
    for rank in ("0", "1"):
        monkeypatch.setenv("RANK", rank)
        shares.append({job.frame for job in evaluation(tmp_path, data).share()})
    assert shares == [{1, 3}, {2}]
    assert {job.frame for job in evaluation(tmp_path, data).share("2/2")} == set()  # one frame, and this is the second


@pytest.mark.parametrize("shard", ["0/2", "3/2", "2", "a/b", "1/0"])
def test_bad_shards(data, tmp_path, shard):
    with pytest.raises(osl.OmnistereoError, match="a shard is written i/n"):
        evaluation(tmp_path, data).share(shard)


# ---- another rig


def test_the_same_rig_in_another_frame_changes_nothing(data, tmp_path):
    whole(tmp_path / "own", data)
    RIG.moved(osl.Pose.from_vector([0.3, -0.2, 0.5, 1.0, 2.0, -3.0])).save(tmp_path / "moved.yaml")
    moved = evaluation(tmp_path / "moved", data, rig=tmp_path / "moved.yaml")
    list(moved.run())
    own = evaluation(tmp_path / "own", data).results()["frames"]["box"]
    for number, methods in moved.results()["frames"]["box"].items():
        for name, errors in methods.items():
            assert errors["figures"] == pytest.approx(own[number][name]["figures"], abs=0.05)


def test_a_bent_rig_is_worse_and_kept_apart(data, tmp_path):
    whole(tmp_path / "own", data)
    bend = osl.Pose.from_vector([0, np.radians(5), 0, 0, 0, 0])
    osl.Rig(RIG.cameras, [*RIG.T_rig_cam[:-1], RIG.T_rig_cam[-1] @ bend]).save(tmp_path / "bent.yaml")
    bent = evaluation(tmp_path / "out", data, rig=tmp_path / "bent.yaml")
    list(bent.run())
    own = evaluation(tmp_path / "own", data).results()["frames"]["box"]
    for number, methods in bent.results()["frames"]["box"].items():
        assert methods["zncc+sgm"]["figures"]["MAE"] > 1.2 * own[number]["zncc+sgm"]["figures"]["MAE"]
    assert "Not the sets' own rig, but " in errors_table(bent.results()).text()
    with pytest.raises(osl.OmnistereoError, match=r"config rig = own there, \w{12}"):
        evaluation(tmp_path / "own", data, rig=tmp_path / "bent.yaml")


def test_a_rig_of_other_cameras_is_named(data, tmp_path):
    osl.Rig(RIG.cameras[:3], RIG.T_rig_cam[:3]).save(tmp_path / "three.yaml")
    with pytest.raises(osl.OmnistereoError, match=r"three.yaml has cameras of .* pixels, .*box of .*: another rig"):
        evaluation(tmp_path / "out", data, rig=tmp_path / "three.yaml")
    with pytest.raises(osl.OmnistereoError, match=r"none.yaml"):
        evaluation(tmp_path / "out", data, rig=tmp_path / "none.yaml")
    assert not (tmp_path / "out").exists()


# ---- results of another evaluation


def test_another_scale_is_refused(data, tmp_path):
    whole(tmp_path, data)
    with pytest.raises(osl.OmnistereoError, match=r"config height = 24 there, 12 here; config width = 96 there, 48"):
        evaluation(tmp_path, data, scale=Scale(48, 12, 12))
    with pytest.raises(osl.OmnistereoError, match=r"num_spheres = 12 there, 24 here\): choose another folder"):
        evaluation(tmp_path, data, [Method(cost="zncc", window=5)], scale=Scale(96, 24, 24))


@pytest.mark.parametrize("changed", ["config.yaml", "cam3/0002.png", "omnidepth_gt_96/00002.tiff"])
def test_other_data_are_refused(data, copy, tmp_path, changed):
    out = tmp_path / "out"
    whole(out, copy)
    content = (copy / changed).read_bytes()
    (copy / changed).write_bytes(content + b"\n")
    with pytest.raises(osl.OmnistereoError, match=rf"data box/{changed} = \w{{12}}… there, \w{{12}}… here"):
        evaluation(out, copy)
    (copy / changed).write_bytes(content)
    assert evaluation(out, copy).missing() == []


def test_other_weights_are_refused(data, weights, tmp_path):
    other = shutil.copytree(weights, tmp_path / "weights")
    whole(tmp_path / "out", data, METHODS, weights=other, scale=TINY, frames=[1])
    torch.manual_seed(1)
    osl.MCCNN().save(other / "mccnn_fast.safetensors")
    with pytest.raises(osl.OmnistereoError, match=r"weights mccnn_fast.safetensors = \w{12}… there") as error:
        evaluation(tmp_path / "out", data, METHODS, weights=other, scale=TINY)
    assert "sweepnet.safetensors" not in str(error.value)
    evaluation(tmp_path / "out", data, ZNCC, scale=TINY)  # which have none
    with pytest.raises(osl.OmnistereoError, match="config precision = float32 there, bfloat16 here"):
        evaluation(tmp_path / "out", data, METHODS, weights=weights, scale=TINY, precision="bfloat16")


def test_stored_results_can_be_checked_from_elsewhere(data, copy, tmp_path):
    whole(tmp_path / "out", data)
    shutil.copy(tmp_path / "out" / "results.json", tmp_path / "stored.json")
    task = evaluation(tmp_path / "again", data, frames=[2])
    stored = task.check(tmp_path / "stored.json")
    list(task.run())
    again, there = task.results()["frames"]["box"], stored["frames"]["box"]
    assert again == {"00002": there["00002"]}
    (copy / "cam1" / "0002.png").write_bytes((copy / "cam1" / "0001.png").read_bytes())
    with pytest.raises(osl.OmnistereoError, match=r"data box/cam1/0002.png = .* there"):
        evaluation(tmp_path / "new", copy, frames=[2]).check(tmp_path / "stored.json")


@pytest.mark.parametrize("content", ["", "{", "[1]", '{"frames": {}}', "\xff"])
def test_damaged_results_are_named(data, tmp_path, content):
    task = evaluation(tmp_path, data)
    next(task.run())
    task.path(task.jobs[0]).write_text(content, encoding="latin-1")
    with pytest.raises(osl.OmnistereoError, match=r"zncc.json (is damaged .*|holds no results .*)delete it"):
        evaluation(tmp_path, data)


def test_missing_weights_are_named(data, weights, tmp_path):
    shutil.copy(weights / "sweepnet.safetensors", tmp_path)
    with pytest.raises(
        osl.OmnistereoError, match=r"missing: \S+mccnn_fast.safetensors, for mccnn, mccnn\+sgm\."
    ) as error:
        evaluation(tmp_path / "out", data, METHODS, weights=tmp_path)
    assert str(error.value).endswith("leave these methods out: --methods zncc sweepnet zncc+sgm sweepnet+sgm")
    with pytest.raises(osl.OmnistereoError, match=r"plain.safetensors, for .*--methods zncc zncc\+sgm"):
        evaluation(tmp_path / "out", data, select_methods(["sweepnet,weights=plain"]), weights=weights)
    assert not (tmp_path / "out").exists()


def test_bad_data_are_named(data, copy, tmp_path):
    with pytest.raises(osl.OmnistereoError, match="has no frame 9, it has 1, 2, 3"):
        evaluation(tmp_path / "out", data, frames=[1, 9])
    (copy / "omnidepth_gt_96" / "00002.tiff").unlink()
    assert {job.frame for job in evaluation(tmp_path / "out", copy).jobs} == {1, 3}
    with pytest.raises(osl.OmnistereoError, match="has no ground truth for some of the frames asked for"):
        evaluation(tmp_path / "out", copy, frames=[1, 2])
    shutil.rmtree(copy / "omnidepth_gt_96")
    with pytest.raises(osl.OmnistereoError, match="has no ground truth for the frames asked for"):
        evaluation(tmp_path / "out", copy)
    RIG.save(copy / "config.yaml")
    with pytest.raises(osl.OmnistereoError, match="does not state its nearest depth"):
        evaluation(tmp_path / "out", copy)


def test_sets_are_found_by_name_and_by_folder(data, tmp_path):
    sunny = find_sets(["sunny"])["sunny"]
    assert sunny.parts[-3:] == ("data_samples", "sunny", "test")
    (tmp_path / "city" / "train").mkdir(parents=True)
    assert find_sets([str(data), str(tmp_path / "city" / "train")]) == {
        "box": data, "city-train": tmp_path / "city" / "train",
    }  # fmt: skip
    (tmp_path / "box").mkdir()
    with pytest.raises(osl.OmnistereoError, match="would both be called 'box'"):
        find_sets([str(data), str(tmp_path / "box")])
    with pytest.raises(osl.OmnistereoError, match=r"there is no data set 'rainy': neither .*rainy/test nor .*rainy"):
        find_sets(["rainy"])


# ---- tables


def mean(x):
    return x


def test_bootstrap_of_two_frames_by_hand():
    """The mean is a, (a + b)/2 or b with chances 1/4, 1/2, 1/4."""
    ends = bootstrap([[3.0], [5.0]], mean)
    assert ends.tolist() == [[4.0, 3.0, 5.0]]
    assert bootstrap([[3.0], [5.0]], mean, level=0.4).tolist() == [[4.0, 4.0, 4.0]]


def test_bootstrap_of_four_frames_against_all_resamples():
    values = np.array([1.0, 2.0, 4.0, 9.0])
    means = [np.mean(drawn) for drawn in itertools.product(values, repeat=4)]
    expected = [4.0, *np.percentile(means, [2.5, 97.5])]
    np.testing.assert_allclose(bootstrap(values[:, None], mean)[0], expected, atol=0.26)  # the steps between means


def test_bootstrap_of_many_normal_frames():
    values = np.random.default_rng(3).normal(7, 2, (400, 2))
    value, low, high = bootstrap(values, mean).T
    half = 1.96 * values.std(0) / 20
    np.testing.assert_allclose(low, value - half, atol=0.03)
    np.testing.assert_allclose(high, value + half, atol=0.03)


def test_bootstrap_covers_less_with_few_frames():
    rng = np.random.default_rng(0)
    inside = [
        (lambda cell: cell[1] <= 0 <= cell[2])(bootstrap(rng.normal(size=(8, 1)), mean, count=400)[0])
        for _ in range(2000)
    ]
    assert np.mean(inside) == pytest.approx(0.89, abs=0.02)


def test_bootstrap_is_the_same_every_time_and_open_for_one_frame():
    values = np.random.default_rng(0).normal(size=(6, 5))
    assert bootstrap(values, mean).tolist() == bootstrap(values, mean).tolist()
    one = bootstrap(values[:1], mean)
    np.testing.assert_array_equal(one[:, 0], values[0])
    assert np.isnan(one[:, 1:]).all()


def record(figures_of, sets=("box", "sunset", "sunny")):
    """Results with these figures for every method, set and frame, out of order."""
    methods = [Method.parse(name) for name in ("zncc+sgm", "zncc,window=5", "mccnn", "zncc")]
    frames = {
        name: {
            f"{k:05}": {
                method.name: {
                    "figures": dict(zip(METRICS, figures_of(name, k, method.name), strict=True)),
                    "strata": {
                        "all": dict(zip(SUMS, (100, 50, 20, 10 + k, 150.0, 900.0), strict=True)),
                        "thin": dict(zip(SUMS, (10 * k, 5 * k, 0, 0, 40.0 * k, 160.0 * k), strict=True)),
                        "seen by 0": dict.fromkeys(SUMS, 0),
                    }
                    | dict.fromkeys(("sky", "far", "middle", "near", "at edges", "off edges"), dict.fromkeys(SUMS, 0)),
                }
                for method in methods
            }
            for k in (1, 2, 3)
        }
        for name in sets
    }
    config = {"width": 320, "height": 80, "num_spheres": 64, "rig": "own"}
    return {"config": config, "methods": {m.name: vars(m) for m in methods}, "frames": frames}


def test_the_table_has_the_papers_form():
    table = errors_table(record(lambda name, k, method: [10.0 * k, 5.0 * k, k, len(name) + k / 8, 0.5 * k]))
    assert table.columns[:5] == ["Sunny >1", "Sunny >3", "Sunny >5", "Sunny MAE", "Sunny RMS"]
    assert [column.split()[0] for column in table.columns[::5]] == ["Sunny", "Sunset", "Box"]
    assert [words[0] for words, _ in table.rows] == ["ZNCC", "ZNCC, window = 5", "MC-CNN", "ZNCC + SGM"]
    cells = table.rows[0][1]
    np.testing.assert_allclose(cells[:5, 0], [20, 10, 2, 5.25, 1])
    assert (cells[:, 1] < cells[:, 0]).all() and (cells[:, 0] < cells[:, 2]).all()
    lines = table.text().splitlines()
    assert table.caption == lines.pop() == table.markdown().splitlines()[-1]
    assert table.caption.startswith("Means over frames (3 of sunny, 3 of sunset, 3 of box), in % of the N spheres")
    assert "320 × 80, N = 64, pairs = ring, p1 = 0.1, p2 = 12.0, whole indices, unless" in table.caption
    assert len(lines) == 1 + 2 * 4
    assert lines[1].split()[:6] == ["ZNCC", "20.0", "10.0", "2.0", "5.25", "1.00"]
    assert lines[2].split()[0] == f"{cells[0, 1]:.1f}–{cells[0, 2]:.1f}"
    ends = {
        line.index(value) + len(value)
        for line, value in zip(lines[:3], ("Sunny >1", "20.0", lines[2].split()[0]), strict=True)
    }
    assert len(ends) == 1  # aligned
    rows = [line.strip("| ").split(" | ") for line in table.markdown().splitlines()[:-2]]
    assert {len(row) for row in rows} == {16} and rows[0][1] == "Sunny &gt;1" and rows[1][:2] == ["---", "---:"]
    assert rows[2][1] == f"20.0<br><sub>{cells[0, 1]:.1f}–{cells[0, 2]:.1f}</sub>"
    head, *rows = csv.reader(io.StringIO(table.csv()))
    assert head[:4] == ["method", "Sunny >1", "Sunny >1 low", "Sunny >1 high"] and len(head) == 46
    np.testing.assert_allclose([float(x) for x in rows[0][1:]], cells.ravel(), rtol=1e-5)


def test_frames_that_cannot_be_evaluated_are_left_out_of_the_mean():
    def some(name, k, method):
        return [None] * 5 if (k == 2 or name == "box") else [float(k)] * 5

    table = errors_table(record(some))
    cells = table.rows[0][1]
    np.testing.assert_allclose(cells[:10, 0], 2.0)
    assert np.isnan(cells[10:]).all()
    assert table.text().splitlines()[1].split()[-5:] == ["–"] * 5 and "nan" not in table.markdown() + table.csv()


def test_the_strata_pool_all_rays():
    table = regions_table(record(lambda *_: [1.0] * 5, sets=("sunny",)))
    assert [words[:3] for words, _ in table.rows[::4]] == [["sunny", "all", "100.0 %"], ["sunny", "thin", "20.0 %"]]
    assert [words[3] for words, _ in table.rows[:4]] == ["ZNCC", "ZNCC, window = 5", "MC-CNN", "ZNCC + SGM"]
    np.testing.assert_allclose(table.rows[0][1][:, 0], [50, 20, 12, 1.5, 3])
    np.testing.assert_allclose(table.rows[0][1][2], [12, 11, 13], atol=0.34)
    np.testing.assert_allclose(table.rows[4][1], [[50] * 3, [0] * 3, [0] * 3, [4] * 3, [4] * 3])  # in every frame


def test_a_table_of_one_frame_has_no_intervals():
    table = Table(["method"], ["MAE"], [(["ZNCC"], np.array([[1.5, np.nan, np.nan]]))])
    assert table.text() == "method   MAE\nZNCC    1.50\n"
    assert table.markdown().splitlines()[-1] == "| ZNCC | 1.50 |"
    assert table.csv() == "method,MAE,MAE low,MAE high\nZNCC,1.5,,\n"


# ---- the command line


@pytest.fixture
def small(monkeypatch):
    monkeypatch.setitem(SCALES, "teaching", SMALL)


def command(*words):
    return cli.main(["evaluate", *(str(word) for word in words)])


FILES = ["errors.csv", "errors.md", "errors.txt", "frames", "results.json", "strata.csv", "strata.md", "strata.txt"]


def test_the_command_line(data, weights, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(SCALES, "teaching", TINY)
    out = tmp_path / "out"
    arguments = ["--sets", data, "--weights", weights, "--precision", "float32", "--out", out]
    assert command(*arguments) == 0
    assert sorted(path.name for path in out.iterdir()) == FILES
    assert (out / "results.json").read_bytes() == whole(tmp_path / "whole", data, METHODS, weights=weights, scale=TINY)
    captured = capsys.readouterr()
    assert (out / "errors.txt").read_text() in captured.out and "18/18" in captured.err
    assert captured.out.splitlines()[0].split()[:3] == ["method", "Box", ">1"]
    assert f"written to {out}/: results.json, errors.txt" in captured.out
    assert command(*arguments, "--ablations", "window", "--frames", "2") == 0
    assert "ZNCC, window = 13" in capsys.readouterr().out


def test_the_command_line_in_shards(data, tmp_path, capsys, small, monkeypatch):
    arguments = ["--sets", data, "--methods", "zncc", "zncc+sgm", "--out", tmp_path / "out"]
    assert command(*arguments, "--shard", "1/2") == 0
    assert "4 of 6 results are in" in capsys.readouterr().out
    assert not (tmp_path / "out" / "results.json").exists()
    assert command(*arguments, "--shard", "2/2") == 0
    expected = whole(tmp_path / "whole", data)
    assert (tmp_path / "out" / "results.json").read_bytes() == expected
    arguments[-1] = tmp_path / "processes"
    monkeypatch.setenv("WORLD_SIZE", "2")
    for rank in ("1", "0"):
        monkeypatch.setenv("RANK", rank)
        assert command(*arguments) == 0
    assert (tmp_path / "processes" / "results.json").read_bytes() == expected


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--methods", "magic"], "error: cost must be one of zncc"),
        (["--ablations", "everything"], "error: unknown ablation 'everything'; expected one of window, weights"),
        (["--sets", "rainy"], "error: there is no data set 'rainy'"),
        (["--shard", "3/2"], "error: a shard is written i/n"),
        (["--weights", "nowhere"], "error: weights are missing: nowhere/mccnn_fast.safetensors, nowhere/sweepnet"),
        (["--frames", "77"], "has no frame 77"),
    ],
    ids=str,
)
def test_bad_input_is_one_plain_line(data, weights, tmp_path, capsys, small, words, message):
    assert command("--sets", data, "--weights", weights, "--out", tmp_path / "out", *words) == 2
    err = capsys.readouterr().err
    assert message in err and err.count("\n") == 1


def test_another_evaluation_in_the_folder_is_one_plain_line(data, tmp_path, capsys, small, monkeypatch):
    arguments = ["--sets", data, "--methods", "zncc", "--frames", "1", "--out", tmp_path / "out"]
    assert command(*arguments) == 0
    capsys.readouterr()
    monkeypatch.setitem(SCALES, "teaching", replace(SMALL, width=48, height=12))
    assert command(*arguments) == 2
    assert "is of another evaluation (config height = 24 there, 12 here" in capsys.readouterr().err


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_no_gpu(data, tmp_path, capsys, small):
    assert command("--sets", data, "--methods", "zncc", "--device", "cuda", "--out", tmp_path / "out") == 2
    assert capsys.readouterr().err.startswith("error: there is no CUDA GPU")
