"""Evaluation runs: frames against single steps, interrupted runs, what is refused."""

import hashlib
import json
import re
import shutil

import pytest
import scene
import torch
from scene import refused

import omnistereo_lib as osl
from omnistereo_learn.evaluate import (
    ABLATIONS,
    METHODS,
    SCALES,
    Evaluation,
    Scale,
    errors_table,
    evaluate_frame,
    find_sets,
    run,
    select_methods,
    write_results,
)
from omnistereo_learn.evaluate.methods import EvaluatedMethod
from omnistereo_learn.evaluate.records import read_record
from omnistereo_learn.evaluate.regions import METRICS, error_sums, find_regions
from omnistereo_lib.stereo.learned import LearnedCost
from omnistereo_lib.stereo.methods import penalties
from omnistereo_tools import cli

SMALL = Scale(96, 24, 12)
TINY = Scale(48, 14, 8)  # for the networks
ZNCC = METHODS[::3]
RIG = scene.rig(width=200, height=192)  # of the data set
FRAMES = (1, 2, 3)


def evaluation(out, data, methods=ZNCC, **options):
    return Evaluation(
        out, {"box": data}, methods, **{"scale": SMALL, "precision": "float32"} | options
    )


def evaluate(out, data, methods=ZNCC, **options):
    """Evaluate and merge; return the bytes of results.json."""
    task = evaluation(out, data, methods, **options)
    list(task.run())
    write_results(task.out, task.results())
    return (task.out / "results.json").read_bytes()


@pytest.fixture(scope="session")
def own(tmp_path_factory, data):
    """A folder with the results of ZNCC; tests only read it."""
    folder = tmp_path_factory.mktemp("own")
    evaluate(folder, data)
    return folder


@pytest.fixture(scope="session")
def expected(own):
    return (own / "results.json").read_bytes()


@pytest.fixture(scope="session")
def expected_of_all(tmp_path_factory, data, weights):
    return evaluate(tmp_path_factory.mktemp("all"), data, METHODS, weights=weights, scale=TINY)


@pytest.fixture
def copy(data, tmp_path):
    """A copy of the data to spoil."""
    return shutil.copytree(data, tmp_path / "copy" / "box")


# ---- frames


def test_a_frame_agrees_with_the_single_steps(data, weights):
    more = ("zncc+sgm,p1=0.3,p2=2", "zncc,subindex=true,pairs=all")
    methods = [*METHODS, *map(EvaluatedMethod.parse, more)]
    methods.append(EvaluatedMethod.parse("sweepnet,wrap=false"))
    dataset = osl.load_dataset(data)
    grid = osl.SphereGrid(48, 14, num_spheres=8, min_depth=0.6)
    sweep = osl.SphereSweep(dataset.rig, grid)
    found = dict(
        evaluate_frame(sweep, dataset[1], methods, lambda m: m.load_cost(weights, "float32"))
    )
    assert set(found) == set(methods)
    gt_index = dataset[1].gt_index(grid)
    regions = find_regions(gt_index, sweep)
    volumes = {}
    for method, errors in found.items():
        if method.volume_key not in volumes:
            cost = osl.ZNCC()
            if method.cost != "zncc":
                name = {"mccnn": "mccnn_fast"}.get(method.cost, method.cost)
                network = {"mccnn": osl.MCCNN, "sweepnet": osl.SweepNet}[method.cost].from_file(
                    weights / f"{name}.safetensors"
                )
                network.wrap = method.wrap or method.cost != "sweepnet"
                cost = LearnedCost(network, "float32")
            volumes[method.volume_key] = osl.cost_volume(
                sweep, dataset[1].images, cost, method.pairs
            )
        volume = volumes[method.volume_key]
        if method.aggregate == "sgm":
            p1, p2 = penalties(48, 8) if method.p1 is None else (method.p1, method.p2)
            volume = osl.sgm(volume, p1, p2, wrap=method.wrap)
        index = osl.winner_takes_all(volume, method.subindex).numpy()
        assert errors["figures"] == osl.index_error(index, gt_index, 8)
        assert errors["strata"] == error_sums(index, gt_index, 8, regions)
    # every setting has an effect
    assert len({json.dumps(errors) for errors in found.values()}) == len(found)


def test_a_volume_is_computed_once_for_all_that_share_it(data, weights, tmp_path, monkeypatch):
    calls = []
    monkeypatch.setattr(run, "cost_volume", lambda *a: calls.append(a[3]) or osl.cost_volume(*a))
    methods = [*METHODS, *ABLATIONS["penalties"], *ABLATIONS["subindex"]]
    methods += select_methods(["zncc,pairs=all"])
    task = evaluation(tmp_path / "out", data, methods, weights=weights, frames=[1], scale=TINY)
    assert len(list(task.run())) == len(task.jobs) == len(set(methods)) == 6 + 36 + 6 + 1
    assert calls == ["ring", "ring", "ring", "all"]


def test_a_method_may_have_its_own_number_of_spheres(data, tmp_path):
    methods = [EvaluatedMethod(cost="zncc", num_spheres=n) for n in (0, 12, 24)]
    frames = json.loads(evaluate(tmp_path / "out", data, methods, frames=[2]))["frames"]["box"][
        "00002"
    ]
    assert frames["zncc"] == frames["zncc,num_spheres=12"] != frames["zncc,num_spheres=24"]


# ---- interrupted runs


def test_the_merged_file_states_its_inputs(data, weights, expected_of_all):
    def sha(path):
        return hashlib.sha256(path.read_bytes()).hexdigest()

    results = json.loads(expected_of_all)
    assert json.dumps(results) == json.dumps(results, sort_keys=True)  # the order in the file
    line = next(line for line in expected_of_all.decode().splitlines() if '"figures"' in line)
    assert max(len(decimals) for decimals in re.findall(r"\.([0-9]+)", line)) == 5
    assert all(f'"{name}"' in line for name in METRICS)
    scale = {"width": 48, "height": 14, "num_spheres": 8}
    assert results["config"] == {**scale, "precision": "float32", "rig": "own"}
    named = {"cost": "mccnn", "aggregate": "sgm", "weights": "", "pairs": "ring"}
    usual = dict.fromkeys(("window", "p1", "p2"))
    usual |= {"wrap": True, "subindex": False, "num_spheres": 0}
    assert results["methods"]["mccnn+sgm"] == named | usual
    files = ["config.yaml", *(f"omnidepth_gt_96/{number:05}.tiff" for number in FRAMES)]
    files += [f"cam{k}/{number:04}.png" for k in (1, 2, 3, 4) for number in FRAMES]
    assert results["data"] == {f"box/{name}": sha(data / name) for name in files}
    assert results["weights"] == {path.name: sha(path) for path in weights.iterdir()}
    assert {number: set(frame) for number, frame in results["frames"]["box"].items()} == {
        f"{number:05}": {method.name for method in METHODS} for number in FRAMES
    }
    settings = {name: results[name] for name in ("config", "methods")}
    compact = json.dumps(settings, sort_keys=True, separators=(",", ":")).encode()
    assert results["config_sha256"] == hashlib.sha256(compact).hexdigest()


def test_an_interrupted_run_resumes_to_the_same_file(data, tmp_path, expected):
    task = evaluation(tmp_path, data)
    running = task.run()
    next(running)
    running.close()
    (done,) = tmp_path.glob("frames/*/*/*.json")
    done.with_name(".123.zncc+sgm.json").write_text("{")  # as a kill leaves it
    assert len(task.missing()) == 5
    with refused(r"5 of 6 results are missing, such as .*zncc.*json"):
        task.results()
    # the order of methods does not matter
    assert evaluate(tmp_path, data, tuple(reversed(ZNCC))) == expected


def test_results_of_several_machines_are_merged_by_copying(data, tmp_path, expected):
    for machine in (0, 1):
        task = evaluation(tmp_path / f"machine{machine}", data)
        for _ in task.run(task.jobs[machine::2]):
            pass
        shutil.copytree(task.out, tmp_path / "together", dirs_exist_ok=True)
    assert evaluation(tmp_path / "together", data).missing() == []
    assert evaluate(tmp_path / "together", data) == expected


# ---- another rig


def test_a_set_with_a_rig_for_each_frame_equals_its_frames_evaluated_alone(data, tmp_path):
    alone = {}
    for number, min_depth in ((1, 0.5), (2, 0.9)):
        rig = osl.Rig(RIG.cameras[: 5 - number], RIG.T_rig_cam[: 5 - number], min_depth=min_depth)
        grid = osl.SphereGrid(96, 24, (-45, 45), 12, min_depth)
        scene.write_set(
            tmp_path / "rigs" / f"{number:04}", rig, grid, [(0.2 * number, 0, 0)], first=number
        )
        errors = json.loads(evaluate(tmp_path / f"out{number}", tmp_path / "rigs" / f"{number:04}"))
        alone |= errors["frames"]["box"]
    together = json.loads(evaluate(tmp_path / "both", tmp_path / "rigs"))
    assert together["frames"]["box"] == alone and alone.keys() == {"00001", "00002"}


def test_the_same_rig_in_another_frame_changes_nothing(data, tmp_path, expected):
    osl.save_rig(
        RIG.transformed(osl.Pose.from_vector([0.3, -0.2, 0.5, 1.0, 2.0, -3.0])),
        tmp_path / "moved.yaml",
    )
    moved = json.loads(evaluate(tmp_path / "moved", data, rig=tmp_path / "moved.yaml"))
    for number, methods in json.loads(expected)["frames"]["box"].items():
        for name, errors in methods.items():
            found = moved["frames"]["box"][number][name]
            assert found["figures"] == pytest.approx(errors["figures"], abs=0.05)


def test_a_bent_rig_is_worse_and_kept_apart(data, tmp_path, own, expected):
    bend = osl.Pose.from_vector([0, torch.pi / 36, 0, 0, 0, 0])
    bent = osl.Rig(RIG.cameras, [*RIG.T_rig_cam[:-1], RIG.T_rig_cam[-1] @ bend])
    osl.save_rig(bent, tmp_path / "bent.yaml")
    bent = json.loads(evaluate(tmp_path / "out", data, rig=tmp_path / "bent.yaml"))
    for number, methods in json.loads(expected)["frames"]["box"].items():
        found = bent["frames"]["box"][number]["zncc+sgm"]
        assert found["figures"]["MAE"] > 1.2 * methods["zncc+sgm"]["figures"]["MAE"]
    assert "Not the sets' own rig, but " in errors_table(bent).text()
    with refused("holds another evaluation: other rig"):
        evaluation(own, data, rig=tmp_path / "bent.yaml")


def test_a_rig_of_other_cameras_is_named(data, tmp_path):
    osl.save_rig(osl.Rig(RIG.cameras[:3], RIG.T_rig_cam[:3]), tmp_path / "three.yaml")
    with refused(r"three.yaml has cameras of .* pixels; expected .*, as in .*box"):
        evaluation(tmp_path / "out", data, rig=tmp_path / "three.yaml")
    assert not (tmp_path / "out").exists()


# ---- results of another evaluation


OTHER = (
    r"zncc\.json comes from another scale, .* data or other weights\. Use another output folder, or"
    r" delete"
)


def test_another_scale_is_refused(own, data):
    with refused("holds another evaluation: num_spheres: 12 there, 24 here"):
        evaluation(own, data, scale=Scale(96, 24, 24))


def test_the_precision_of_the_first_run_is_kept(data, weights, tmp_path, monkeypatch):
    """Whatever the processor of the second one would choose; another one by name is refused."""
    arguments = [tmp_path / "out", data, select_methods(["mccnn"])]
    monkeypatch.setattr("torch.cpu.get_capabilities", dict)
    options = {"weights": weights, "scale": TINY, "frames": [1]}
    first = evaluate(*arguments, precision="auto", **options)
    monkeypatch.setattr("torch.cpu.get_capabilities", lambda: {"avx512_bf16": True})
    assert evaluate(*arguments, precision="auto", **options) == first
    with refused("precision: float32 there, bfloat16 here"):
        evaluation(*arguments, precision="bfloat16", **options)


def test_other_data_are_refused(own, copy):
    for changed in ("config.yaml", "cam3/0002.png", "omnidepth_gt_96/00002.tiff"):
        content = (copy / changed).read_bytes()
        (copy / changed).write_bytes(content + b"\n")
        with refused(OTHER):
            evaluation(own, copy)
        (copy / changed).write_bytes(content)
    # where the rig was says nothing about depth
    (copy / "trajectory.txt").write_text("1 0 0 0 0 0 0 1\n")
    assert evaluation(own, copy).missing() == []


def test_other_weights_are_refused(data, weights, tmp_path):
    other = shutil.copytree(weights, tmp_path / "weights")
    methods = select_methods(["zncc", "mccnn"])
    evaluate(tmp_path / "out", data, methods, weights=other, scale=TINY, frames=[1])
    torch.manual_seed(1)
    osl.MCCNN().save(other / "mccnn_fast.safetensors")
    with refused(r"mccnn\.json comes from another"):
        evaluation(tmp_path / "out", data, methods, weights=other, scale=TINY)
    evaluation(tmp_path / "out", data, ZNCC, scale=TINY)  # has no weights
    with refused("precision: float32 there, bfloat16 here"):
        evaluation(
            tmp_path / "out", data, methods, weights=weights, scale=TINY, precision="bfloat16"
        )


def test_a_result_that_cannot_be_read_is_missing(own, data, tmp_path):
    """As a machine leaves it that loses power, or a disk that is full."""
    task = evaluation(shutil.copytree(own, tmp_path / "copy"), data)
    path = task.path(task.jobs[0])
    content = path.read_text()
    for damaged in ("", content[:-9], "[1]", content.replace('"MAE":', '"MAE":-')):
        path.write_text(damaged)
        with refused("1 of 6 results are missing"):
            task.results()
    assert list(evaluation(tmp_path / "copy", data).run()) == [task.jobs[0]]
    assert path.read_text() == content


def test_results_that_lack_a_region_are_refused(own, tmp_path):
    record = json.loads((own / "results.json").read_text())
    del record["frames"]["box"]["00002"]["zncc+sgm"]["strata"]["at hand-overs"]
    (tmp_path / "old.json").write_text(json.dumps(record))
    with refused(r"old\.json is damaged .*a region is missing.*evaluate again"):
        read_record(tmp_path / "old.json")


def test_missing_weights_are_named(data, weights, tmp_path):
    shutil.copy(weights / "sweepnet.safetensors", tmp_path)
    with refused(r"missing: \S+mccnn_fast.*, for mccnn, mccnn\+sgm\.") as error:
        evaluation(tmp_path / "out", data, METHODS, weights=tmp_path)
    assert str(error.value).endswith(
        "leave these methods out: --methods zncc sweepnet zncc+sgm sweepnet+sgm"
    )
    assert not (tmp_path / "out").exists()


def test_bad_data_are_named(data, copy, tmp_path):
    with refused("has no frame 9; expected one of 1, 2, 3"):
        evaluation(tmp_path / "out", data, frames=[1, 9])
    (copy / "omnidepth_gt_96" / "00002.tiff").unlink()
    assert {job.frame for job in evaluation(tmp_path / "out", copy).jobs} == {1, 3}
    with refused("has no ground truth for some of the frames requested"):
        evaluation(tmp_path / "out", copy, frames=[1, 2])
    shutil.rmtree(copy / "omnidepth_gt_96")
    with refused("has no ground truth for the frames requested"):
        evaluation(tmp_path / "out", copy)
    osl.save_rig(RIG, copy / "config.yaml")
    with refused("does not state its nearest depth"):
        evaluation(tmp_path / "out", copy)


def test_sets_are_found_by_name_and_by_folder(data, tmp_path):
    assert find_sets(["sunny"])["sunny"].parts[-3:] == ("data_samples", "sunny", "test")
    train = tmp_path / "city" / "train"
    train.mkdir(parents=True)
    assert find_sets([str(data), str(train)]) == {"box": data, "city-train": train}
    (tmp_path / "box").mkdir()
    with refused("are both called 'box'"):
        find_sets([str(data), str(tmp_path / "box")])
    with refused(r"data set 'rainy' not found in .*rainy/test or .*rainy\. Pass"):
        find_sets(["rainy"])


# ---- the command line


def command(*words):
    return cli.main(["evaluate", *(str(word) for word in words)])


TABLES = [f"{name}.{end}" for name in ("errors", "regions") for end in ("csv", "md", "txt")]
FILES = sorted([*TABLES, "frames", "provenance.json", "results.json"])


def test_the_command_line(data, weights, tmp_path, capsys, monkeypatch, expected_of_all):
    monkeypatch.setitem(SCALES, "teaching", TINY)
    monkeypatch.setattr("omnistereo_learn.evaluate.run.choose_precision", lambda *_: "float32")
    out = tmp_path / "out"
    arguments = ["--sets", data, "--weights", weights, "--out", out]
    assert command(*arguments) == 0
    assert sorted(path.name for path in out.iterdir()) == FILES
    assert (out / "results.json").read_bytes() == expected_of_all
    captured = capsys.readouterr()
    assert (out / "errors.txt").read_text() in captured.out and "/18" in captured.err
    verdict, heads, *_ = captured.out.splitlines()
    assert re.fullmatch(r".* has the lowest mean error, [\d.]+ % of the range swept\.", verdict)
    assert heads.split()[:3] == ["method", "Box", ">1"]
    assert f"written to {out}/: results.json, errors.txt" in captured.out
    assert command(*arguments, "--ablations", "window", "--frames", "2") == 0
    assert "ZNCC, window = 13" in capsys.readouterr().out
