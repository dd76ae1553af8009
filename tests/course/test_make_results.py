"""`make results`: its table of evaluations is that of the stored results."""

import argparse

import pytest

from course import __main__
from course import stored_results as results
from omnistereo_lib.evaluate import SCALES, select_methods
from omnistereo_lib.evaluate.records import read_record
from omnistereo_tools.commands import evaluate_command


def test_every_stored_result_has_its_command():
    assert set(results.EVALUATIONS) == {path.stem for path in results.STORED.glob("*.json")}


@pytest.mark.parametrize("name", results.EVALUATIONS)
def test_the_command_is_the_one_that_the_stored_result_came_from(name):
    parser = argparse.ArgumentParser()
    evaluate_command.add_arguments(parser)
    options = parser.parse_args(results.EVALUATIONS[name].split())
    stored = read_record(results.STORED / f"{name}.json")
    assert {path.rpartition("/")[2] for path in options.sets} == set(stored["frames"])
    assert {method.name for method in select_methods(options.methods, options.ablations)} == set(stored["methods"])
    assert stored["config"]["num_spheres"] == SCALES[options.scale].num_spheres
    assert (stored["config"]["rig"] == "own") == (options.rig is None)
    if options.frames:
        assert {int(number) for number in stored["frames"]["sunny"]} == set(options.frames)


def test_the_results_are_computed_and_stored_one_after_the_other(tmp_path, monkeypatch):
    done = []

    def run(command, cwd, check):
        done.append(command[1:])
        if command[1] == "evaluate":
            out = results.OUT / command[command.index("--out") + 1]
            out.mkdir(parents=True)
            (out / "results.json").write_text(out.name)

    def table(out):
        out.mkdir()
        path = out / f"{out.name}.csv"
        path.write_text("a table")
        return path

    monkeypatch.setattr(results.subprocess, "run", run)
    monkeypatch.setattr(results, "OUT", tmp_path / "out")
    monkeypatch.setattr(results, "STORED", tmp_path)
    for name in ("compare_sweepnets", "compare_volumenets", "compare_worlds"):
        monkeypatch.setattr(results, name, table)
    for name in ("renew_report", "take_snapshots", "renew_manifest"):
        monkeypatch.setattr(results, name, lambda *_, name=name: done.append(name))
    results.compute_results(["--cluster", "here"])
    assert done[0][0] == "calibrate" and done[-3:] == ["renew_report", "take_snapshots", "renew_manifest"]
    assert all(command[-2:] == ["--cluster", "here"] for command in done[1:-3])
    assert {path.stem: path.read_text() for path in tmp_path.glob("*.json")} == {
        name: name for name in results.EVALUATIONS
    }
    assert len(list(tmp_path.glob("*.csv"))) == 3


def test_options_are_passed_on():
    options = vars(__main__._parser().parse_args(["results", "--", "--cluster", "tcp://a:1"]))
    assert options["options"] == ["--cluster", "tcp://a:1"]
