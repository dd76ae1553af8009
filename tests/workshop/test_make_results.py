"""`make results`: its table of evaluations is that of the stored results."""

import pytest

from omnistereo_learn.evaluate import SCALES, select_methods
from omnistereo_learn.evaluate.records import read_record
from omnistereo_tools import cli
from workshop.results import stored_results as results


def test_every_stored_result_has_its_command():
    stored = {path.stem for path in results.STORED.glob("*.json")}
    # The other two have commands of their own.
    assert set(results.EVALUATIONS) == stored - {"error_bars", "ray_sentences"}


@pytest.mark.parametrize("name", results.EVALUATIONS)
def test_the_command_is_the_one_that_the_stored_result_came_from(name):
    options = cli._parse(["evaluate", *results.EVALUATIONS[name].split()])[1]
    stored = read_record(results.STORED / f"{name}.json")
    # data_samples/sunny/train is called sunny-train
    called = {path.removeprefix("data_samples/").replace("/", "-") for path in options.sets}
    assert called == set(stored["frames"])
    assert {method.name for method in select_methods(options.methods, options.ablations)} == set(
        stored["methods"]
    )
    assert stored["config"]["num_spheres"] == SCALES[options.scale].num_spheres
    assert (stored["config"]["rig"] == "own") == (options.rig is None)
    if options.frames:
        assert {int(number) for number in stored["frames"][min(called)]} == set(options.frames)
