"""The reproduction report: the paper's numbers agree, rules give verdicts, the page is new."""

import re
from copy import deepcopy
from importlib import import_module
from operator import attrgetter

import numpy as np
import pytest

from course.nbtools import ROOT
from omnistereo_learn.evaluate import errors_table
from omnistereo_learn.evaluate.records import read_record
from omnistereo_learn.evaluate.regions import METRICS
from workshop.publish.reproduction import (
    PAGE,
    PAPER,
    RESULTS,
    ROWS,
    TOLERANCE,
    judge_order,
    judge_size,
    report,
)

TEXT = PAGE.read_text(encoding="utf-8")
CELLS = [line.strip("| ").split(" | ") for line in TEXT.splitlines() if line.startswith("| ")]


@pytest.fixture
def results():
    """The stored results, with the paper's metrics in place of ours."""
    stored = deepcopy(read_record(RESULTS))
    for (method, light), values in PAPER.items():
        for frame in stored["frames"][light].values():
            frame[method]["figures"] = dict(zip(METRICS, values, strict=True))
    return stored


def finding(part, results):
    (compare,) = [compare for claim, compare in ROWS.items() if part in claim]
    return compare(results)


def change(results, method, light, factors):
    for frame in results["frames"][light].values():
        values = np.multiply(PAPER[method, light], factors)
        frame[method]["figures"] = dict(zip(METRICS, values, strict=True))


# ---- the paper's table


# ---- rules


def test_the_papers_own_numbers_are_reproduced(results):
    for claim, compare in ROWS.items():
        found = compare(results)
        if any(part in claim for part in ("Fig. 7", "Fig. 8", "Fig. 9")):
            assert (found.paper, found.verdict) != ("shown", "reproduced")
        elif not claim.startswith("Section IV") or "below" in claim:
            assert found == (found.paper, found.paper, "reproduced", ""), claim


@pytest.mark.parametrize(
    ("factors", "expected"),
    [
        (1 + 0.95 * TOLERANCE * np.array([1, -1, 1, -1, 1]), ("reproduced", "")),
        (
            [1, 1, 1 + 1.05 * TOLERANCE, 1, 1 - 1.05 * TOLERANCE],
            ("trend reproduced", "beyond 20 %: >5, RMS"),
        ),
        ([1, 3, 1, 1, 1], ("differs", "beyond 20 %: >3; on the other side of 1: >3")),
        (
            [3] * 5,
            (
                "differs",
                "beyond 20 %: {0}; on the other side of 1: {0}".format(
                    ">1, >3, >5, MAE and 1 more"
                ),
            ),
        ),
    ],
)
def test_errors_are_compared_as_ratios_to_zncc(results, factors, expected):
    change(results, "sweepnet", "sunny", factors)
    assert finding("SweepNet, Sunny", results)[2:] == expected
    assert finding("SweepNet, Sunset", results).verdict == "reproduced"


def test_zncc_is_compared_as_it_is(results):
    assert judge_size([1.1], [0.9], ["MAE"], ratios=False) == ("differs", "beyond 20 %: MAE")
    change(results, "zncc", "sunny", [1, 0.5, 1, 1, 1])
    assert finding("ZNCC, Sunny", results)[2:] == ("differs", "beyond 20 %: >3")


def test_an_order_need_not_hold_where_it_does_not_in_the_paper(results):
    order = np.array([True, True, True, False])
    assert judge_order(order, order, "abcd") == ("reproduced", "")
    assert judge_order([True] * 4, order, "abcd") == ("reproduced", "")
    assert judge_order([True, True, False, True], order, "abcd") == ("trend reproduced", "not c")
    assert judge_order([True, False, False, True], order, "abcd") == ("differs", "not b, c")
    change(results, "sweepnet+sgm", "sunny", 9)
    assert finding("SweepNet + SGM below MC-CNN", results)[:2] == ("13 of 15", "8 of 15")
    assert "SweepNet + SGM / SweepNet Sunny >1" in finding("SGM lowers", results).reason


def test_what_the_cameras_see(results):
    """Two cameras side by side are one pair, three are two of neighbours and three in all."""
    for frame in results["frames"]["sunny"].values():
        for seen, rays in enumerate((10, 0, 50, 40, 0)):
            frame["zncc"]["strata"][f"seen by {seen}"]["rays"] = rays
    assert finding("no blind regions", results)[1:3] == ("90.0 %", "differs")
    million = 2 * 350 * 600 * 150 / 1e6
    expected = f"{1.3 * million:.0f} M<br><sub>with all pairs {1.7 * million:.0f} M</sub>"
    assert finding("labels to train on", results)[1:3] == (expected, "reproduced")


def test_our_numbers_are_those_of_the_table():
    stored = read_record(RESULTS)
    for (label, *_), cells in errors_table(stored).rows:
        lights = [column.split()[0] for column in errors_table(stored).columns]
        for light in ("Sunny", "Cloudy", "Sunset"):
            if f"{label}, {light}" not in ROWS:
                continue
            shown = [float(x) for x in ROWS[f"{label}, {light}"](stored).ours.split("<")[0].split()]
            expected = [cell[0] for cell, name in zip(cells, lights, strict=True) if name == light]
            np.testing.assert_allclose(shown, expected, atol=0.051)


# ---- the page


def test_the_page_is_of_the_stored_results():
    assert report(read_record(RESULTS)) == TEXT, "run: python -m workshop reproduction"
    assert [claim for claim in ROWS if TEXT.count(f"\n| {claim} | ") != 1] == []


def test_every_table_figure_and_equation_of_the_paper_is_there():
    sources = " ".join(cells[0] for cells in CELLS)
    expected = (
        {f"Fig. {n}" for n in range(1, 10)}
        | {f"Eq. {n}" for n in range(1, 6)}
        | {"Table I", "Table II"}
    )
    assert {name for name in expected if re.search(rf"{name}(?![\dI])", sources)} == expected


def resolve(name):
    """Return what a dotted name of a package, or below omnistereo_lib, stands for."""
    name = name if name.startswith(("omnistereo_", "workshop.")) else f"omnistereo_lib.{name}"
    for split in range(name.count("."), 0, -1):
        parts = name.split(".")
        try:
            return attrgetter(".".join(parts[split:]))(import_module(".".join(parts[:split])))
        except ModuleNotFoundError:
            continue
    raise AssertionError(name)


def test_what_is_named_exists():
    for name in {*re.findall(r"`((?:\w+\.)+\w+)`", TEXT)}:
        assert resolve(name) is not None


def test_tests_and_notebooks_exist():
    paths = {
        "".join(path) for path in re.findall(r"`(tests/[^`]+)`|\(\.\./(notebooks/[^)]+)\)", TEXT)
    }
    assert [path for path in paths if not (ROOT / path).is_file()] == []
