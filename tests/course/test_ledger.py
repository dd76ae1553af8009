"""The reproduction ledger: the paper's figures are consistent, the rules give their verdicts, every name exists."""

import ast
import inspect
import re
from collections import Counter
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

import omnistereo_lib as osl
from course import findings, formulas, ledger
from course.claims import CLAIMS, DIFFERENCES
from course.findings import EXACT, LIGHTS, PAPER_TABLE, TOLERANCE, Verdict
from omnistereo_lib.evaluate import METHODS, SCALES, errors_table
from omnistereo_lib.evaluate.regions import METRICS, REGIONS, SUMS

ROOT = Path(__file__).resolve().parents[2]
PLANNED = {"05_mccnn", "06_sweepnet", "08_evaluation", "09_your_own_rig", "10_render_a_city"}


# ---- hand-made results


def papers(method, light):
    """The paper's own figures, as if they were ours."""
    return list(PAPER_TABLE[method][light].values())


def record(figures_of=papers, sets=LIGHTS, methods=None, scale=SCALES["paper"], seen=(0, 0, 60, 40, 0), thin=(5, 9)):
    """Results of two frames, whose mean is what figures_of(method, set) returns."""
    methods = list(PAPER_TABLE) if methods is None else methods

    def frame(method, name, factor):
        above = dict(zip(SUMS, (100, 30, 20, thin[method != "sweepnet+sgm"], 90.0, 400.0), strict=True))
        strata = dict.fromkeys(REGIONS, above) | {f"seen by {k}": above | {"rays": n} for k, n in enumerate(seen)}
        values = [value * factor for value in figures_of(method, name)]
        return {"figures": dict(zip(METRICS, values, strict=True)), "strata": strata}

    return {
        "config": {**vars(scale), "precision": "float32", "rig": "own"},
        "methods": {method.name: vars(method) for method in METHODS if method.name in methods},
        "data": {},
        "weights": {"sweepnet.safetensors": "ab" * 32},
        "frames": {
            name: {f"{k:05}": {m: frame(m, name, 0.5 + k) for m in methods} for k in (0, 1)} for name in sets
        },
    }  # fmt: skip


def changed(method, light, factors):
    """The paper's figures but for one method in one light, multiplied."""

    def figures_of(m, name):
        values = np.array(papers(m, name))
        return list(values * factors) if (m, name) == (method, light) else list(values)

    return figures_of


def claim(part):
    (found,) = [claim for claim in CLAIMS if part in claim.text]
    return found


def verdict(part, results):
    return claim(part).finding(results).verdict


# ---- the paper's table


def test_the_papers_table_is_whole():
    assert list(PAPER_TABLE) == [method.name for method in METHODS]
    for lights in PAPER_TABLE.values():
        assert tuple(lights) == LIGHTS
        for figures in lights.values():
            assert tuple(figures) == METRICS
            assert figures[">1"] >= figures[">3"] >= figures[">5"] > 0
            assert figures["RMS"] >= figures["MAE"] > 0
            # An error counts at least its limit, at most 100.
            assert figures[">5"] * 5 / 100 <= figures["MAE"] <= 100 and figures["RMS"] <= 100


def test_the_lowest_figures_are_those_that_the_paper_prints_in_bold():
    for methods in (METHODS[:3], METHODS[3:]):
        for light in LIGHTS:
            best = np.argmin([papers(method.name, light) for method in methods], 0)
            printed = [2, 1, 1, 2, 2] if (light, methods) == ("cloudy", METHODS[3:]) else [2] * 5  # '>3': both in bold
            np.testing.assert_array_equal(best, printed)
    assert PAPER_TABLE["mccnn+sgm"]["cloudy"][">3"] == PAPER_TABLE["sweepnet+sgm"]["cloudy"][">3"]


def test_every_row_of_the_papers_tables_and_every_figure_and_equation_is_claimed():
    sources = " ".join(claim.source for claim in CLAIMS)
    assert len([claim for claim in CLAIMS if claim.group == "Table II"]) == 18
    expected = {f"Fig. {n}" for n in range(1, 10)} | {f"Eq. {n}" for n in range(1, 6)} | {"Table I", "Table II"}
    assert {name for name in expected if re.search(rf"{name}(?![\dI])", sources)} == expected
    assert len({(claim.source, claim.text) for claim in CLAIMS}) == len(CLAIMS)


# ---- names


def resolve(where):
    module, _, name = where.partition(":")
    return attrgetter(name)(import_module(module if module.startswith("render") else f"omnistereo_lib.{module}"))


@pytest.mark.parametrize("where", sorted({name for entry in (*CLAIMS, *DIFFERENCES) for name in entry.where}))
def test_what_is_named_exists(where):
    assert resolve(where) is not None


@pytest.mark.parametrize("notebook", sorted({claim.notebook for claim in CLAIMS}))
def test_notebooks_exist_or_are_planned(notebook):
    assert (ROOT / "notebooks" / f"{notebook}.ipynb").is_file() or notebook in PLANNED


@pytest.mark.parametrize("difference", [d for d in DIFFERENCES if d.option], ids=lambda d: d.topic)
def test_options_exist(difference):
    """An option is a call with keywords of the first thing named, or an entry of it."""
    tree, target = ast.parse(difference.option, mode="eval").body, resolve(difference.where[0])
    if isinstance(tree, ast.Subscript):
        assert eval(difference.option, {difference.option.split("[")[0]: target}) is not None
        return
    assert difference.where[0].replace(":", ".").endswith(ast.unparse(tree.func))
    assert {keyword.arg for keyword in tree.keywords} <= set(inspect.signature(target).parameters)


def test_differences_say_what_is_followed():
    assert {difference.follows for difference in DIFFERENCES} == {"paper", "code", "both", "own"}
    assert all(difference.here for difference in DIFFERENCES if difference.follows == "own")
    defaults = {d.topic: d for d in DIFFERENCES}
    assert defaults["camera pairs"].follows == "code"
    for call, name, value in (
        ("stereo.volume:cost_volume", "pairs", "ring"), ("stereo.sgm:sgm", "wrap", True),
        ("stereo.sgm:sgm", "paths", 8),
        ("stereo.sweepnet:SweepNet", "wrap", True), ("train.recipes:SweepNetRecipe", "batch_norm", True),
        ("geometry.camera:OcamCamera", "max_fov_deg", 220.0), ("stereo.mccnn:MCCNN", "variant", "fast"),
        ("geometry.sphere:SphereGrid", "sampling", "center"), ("stereo.methods:Method", "subindex", False),
    ):  # fmt: skip
        assert inspect.signature(resolve(call)).parameters[name].default == value


# ---- rules


def test_without_results_only_what_the_library_shows_by_itself_is_judged():
    found = [(entry.group, entry.finding(None)) for entry in CLAIMS]
    judged = {group for group, finding in found if finding.verdict != "not evaluated"}
    assert judged == {"Set-up and Table I", "Equations"}
    assert {finding for _, finding in found if finding.verdict == "not evaluated"} == {("–", "not evaluated", "")}


@pytest.mark.parametrize("entry", [claim for claim in CLAIMS if claim.group == "Equations"], ids=lambda c: c.text)
def test_the_library_follows_the_formulas(entry):
    assert entry.finding(None) == (f"within {EXACT:g}", "reproduced", "")


def test_a_formula_that_is_not_followed_is_seen(monkeypatch):
    monkeypatch.setattr(formulas, "index_error", lambda *a: {"MAE": 1.0} | osl.index_error(*a) | {"RMS": 3.0})
    found = claim("error and its five figures").finding(None)
    assert found.verdict == "differs" and found.ours.endswith("apart")
    monkeypatch.setattr(formulas, "winner_takes_all", lambda volume: np.full(volume.shape[:2], np.nan))
    assert verdict("argmin", None) == "differs"


def test_the_layers_are_those_of_table_one(monkeypatch):
    assert claim("SweepNet's layers").finding(None) == ("26 of 26 layers", "reproduced", "")
    monkeypatch.setitem(findings.LAYERS, "conv7", (5, 32, 1))
    monkeypatch.setitem(findings.LAYERS, "fc3", (1, 128, 1))
    assert claim("SweepNet's layers").finding(None) == ("24 of 26 layers", "trend reproduced", "not conv7, fc3")


def test_the_papers_own_figures_are_reproduced():
    results = record()
    for entry in CLAIMS:
        found = entry.finding(results)
        if entry.group == "Table II":
            assert found == (entry.paper, "reproduced", "")
        elif entry.source == "Fig. 7":
            assert found.verdict == "trend reproduced" and entry.paper == "shown"
        elif entry.group == "Claims and figures" and entry.source not in ("Fig. 8", "Fig. 9"):
            assert found.verdict == "reproduced"


def test_our_figures_are_those_of_the_table():
    rng = np.random.default_rng(0)
    values = {(method, light): rng.uniform(1, 50, 5) for method in PAPER_TABLE for light in LIGHTS}
    results = record(lambda method, light: values[method, light])
    table = {words[0]: cells[:, 0].reshape(3, 5) for words, cells in errors_table(results).rows}
    rows = iter([claim for claim in CLAIMS if claim.group == "Table II"])
    for method in METHODS:
        for cells, zncc in zip(table[method.label], table["ZNCC"], strict=True):
            figures, _, ratios = next(rows).finding(results).ours.partition("\n÷ ZNCC: ")
            np.testing.assert_allclose([float(x) for x in figures.split()], cells, atol=0.051)
            expected = [] if method.name == "zncc" else cells / zncc
            np.testing.assert_allclose([float(x) for x in ratios.split()], expected, atol=0.0051)


@pytest.mark.parametrize(
    ("factors", "expected"),
    [
        (np.ones(5), ("reproduced", "")),
        (1 + 0.95 * TOLERANCE * np.array([1, -1, 1, -1, 1]), ("reproduced", "")),
        ([1, 1, 1 + 1.05 * TOLERANCE, 1, 1 - 1.05 * TOLERANCE], ("trend reproduced", "beyond 20 %: >5, RMS")),
        ([1, 3, 1, 1, 1], ("differs", "beyond 20 %: >3; on the other side of 1: >3")),
        ([3, 3, 3, 3, 3], ("differs", "beyond 20 %: >1, >3, >5, MAE and 1 more; on the other side of 1: >1, >3, >5, MAE"
                           " and 1 more")),
    ],
)  # fmt: skip
def test_sizes_are_compared_as_ratios(factors, expected):
    results = record(changed("sweepnet", "sunny", factors))
    assert claim("SweepNet, Sunny").finding(results)[1:] == expected
    assert verdict("SweepNet, Sunset", results) == "reproduced"
    half = record(lambda method, name: [0.5 * value for value in papers(method, name)])  # easier data: the same ratios
    assert verdict("SweepNet, Sunny", half) == "reproduced"


def test_the_yardstick_is_compared_as_it_is():
    assert claim("ZNCC, Sunny").finding(record(changed("zncc", "sunny", [1, 0.5, 1, 1, 1])))[1:] == (
        "differs", "beyond 20 %: >3",
    )  # fmt: skip
    assert verdict("ZNCC, Sunny", record(changed("zncc", "sunny", 1.1))) == "reproduced"
    found = claim("MC-CNN, Sunny").finding(record(changed("zncc", "sunny", 0)))
    assert found.verdict == "differs" and "inf" in found.ours


def test_orders():
    part = "SweepNet below ZNCC in every"
    assert claim(part).paper == "15 of 15"
    found = claim(part).finding(record(changed("sweepnet", "cloudy", [1, 1, 1, 3, 1])))
    assert found == ("14 of 15", "trend reproduced", "not Cloudy MAE")
    worse = record(lambda method, name: [9.0 if method == "zncc" else value for value in papers(method, name)])
    found = claim(part).finding(worse)
    assert found[:2] == ("3 of 15", "differs")  # MAE alone is below 9
    assert found.reason == "not Sunny >1, Sunny >3, Sunny >5, Sunny RMS and 8 more"


def test_an_order_need_not_hold_where_it_does_not_in_the_paper():
    entry = claim("SweepNet + SGM below MC-CNN")
    assert entry.paper == "13 of 15"
    assert entry.finding(record()) == ("13 of 15", "reproduced", "")
    all_better = record(changed("sweepnet+sgm", "cloudy", 0.5))
    assert entry.finding(all_better) == ("15 of 15", "reproduced", "")
    assert entry.finding(record(changed("sweepnet+sgm", "sunny", 9))).ours == "8 of 15"
    assert "SweepNet + SGM / SweepNet Sunny >1" in claim("SGM lowers").finding(
        record(changed("sweepnet+sgm", "sunny", 9))
    ).reason  # fmt: skip


def test_unseen_light():
    entry = claim("'>1' in Cloudy")
    assert entry.paper == "× 1.27" and entry.finding(record())[:2] == ("× 1.27", "reproduced")
    assert entry.finding(record(changed("sweepnet+sgm", "cloudy", 2)))[1] == "trend reproduced"
    assert entry.finding(record(changed("sweepnet+sgm", "cloudy", 0.7)))[1] == "differs"


def test_pictures_are_a_trend_at_most():
    entry = claim("thin structures")
    assert entry.finding(record())[:2] == ("5.0 against 9.0, 5.0 against 9.0, 5.0 against 9.0", "trend reproduced")
    assert entry.finding(record(thin=(9, 5)))[1:] == ("differs", "not sunny, cloudy, sunset")
    assert verdict("rendered room", record()) == "not evaluated"
    ours = record(lambda method, name: papers(method, "sunny"), sets=[*LIGHTS, "indoor", "aerial"])
    assert verdict("rendered room", ours) == verdict("in the air", ours) == "trend reproduced"


def test_what_the_cameras_see():
    entry = claim("no blind regions")
    assert entry.finding(record())[:2] == ("100.0 % of Sunny's", "reproduced")
    assert entry.finding(record(seen=(0, 2, 58, 40, 0)))[:2] == ("98.0 % of Sunny's", "trend reproduced")
    assert entry.finding(record(seen=(30, 40, 20, 10, 0)))[1] == "differs"
    # Two cameras side by side are one pair, three are two of neighbours and three in all.
    found = claim("labels to train on").finding(record(seen=(0, 0, 60, 40, 0)))
    million = 2 * 350 * 600 * 150 / 1e6
    assert found.ours == f"{1.4 * million:.0f} M\nwith all pairs {1.8 * million:.0f} M"
    assert found.verdict == "reproduced"


def test_the_set_up_is_stated():
    assert verdict("panorama and spheres", record()) == "reproduced"
    assert claim("panorama and spheres").finding(record(scale=SCALES["teaching"]))[:2] == (
        "320 × 80, N = 64",
        "differs",
    )
    assert claim("test frames").finding(record())[:2] == ("2 + 2 + 2", "differs")
    many = record(sets=())
    many["frames"] = {light: {str(k): {} for k in range(300)} for light in LIGHTS}
    assert claim("test frames").finding(many) == ("300 + 300 + 300", "reproduced", "")
    assert verdict("ZNCC's window", None) == "reproduced"


@pytest.mark.parametrize(
    ("results", "part", "reason"),
    [
        (record(scale=SCALES["teaching"]), "SweepNet, Sunny", "results at another scale"),
        (record(sets=("sunny", "cloudy")), "SweepNet, Sunset", "no SweepNet on sunset"),
        (record(methods=["zncc", "mccnn"]), "SweepNet, Sunny", "no SweepNet on sunny"),
        (record(methods=["sweepnet"]), "SweepNet, Sunny", "no ZNCC on sunny"),
        (record(methods=["zncc", "mccnn"]), "SweepNet below ZNCC in every", "no SweepNet on sunny"),
        (record(), "rendered room", "no SweepNet + SGM on indoor"),
        (record(lambda *_: [np.nan] * 5), "ZNCC, Sunny", "no frame of sunny can be evaluated"),
    ],
    ids=str,
)
def test_what_the_results_lack_is_not_evaluated(results, part, reason):
    for frames in results["frames"].values():  # NaN is None on file
        for methods in frames.values():
            for errors in methods.values():
                errors["figures"] = {
                    name: None if value != value else value for name, value in errors["figures"].items()
                }
    assert claim(part).finding(results) == ("–", "not evaluated", reason)


def test_rays_of_a_kind_that_is_not_there():
    results = record()
    for frame in results["frames"]["sunset"].values():
        for errors in frame.values():
            errors["strata"]["thin"] = dict.fromkeys(SUMS, 0)
    assert claim("thin structures").finding(results)[1:] == ("not evaluated", "no ray of sunset is thin")


# ---- the text


@pytest.mark.parametrize("results", [None, record(), record(scale=SCALES["teaching"])], ids=["none", "whole", "other"])
def test_the_ledger_is_readable_markdown(results):
    text = ledger.ledger(results)
    assert text == ledger.ledger(results)
    tables = re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE)
    assert len(tables) == 5 and text.count("<details") == text.count("</details>") == 5
    rows = [re.split(r"(?<!\\) \| ", line.strip("| ")) for table in tables[:4] for line in table.splitlines()[2:]]
    assert len(rows) == len(CLAIMS) and {len(row) for row in rows} == {5}
    assert len(tables[4].splitlines()) == 2 + len(DIFFERENCES)
    assert {line.count(" | ") for line in tables[4].splitlines()} == {5}
    assert max(len(re.sub(r"<[^>]*>|\(notebooks[^)]*\)", "", cell)) for row in rows for cell in row) < 130
    assert not re.search(r"\bnan\b|\bNone\b|\d{3}\.\d{4}", text)
    assert not set(re.findall(r"<(/?\w+)", text)) - {"details", "/details", "summary", "/summary", "br", "sub", "/sub"}
    links = set(re.findall(r"\(notebooks/(\w+)\.ipynb\)", text))
    assert links == {claim.notebook for claim in CLAIMS}
    verdicts = Counter(row[4].split("<br>")[0] for row in rows)
    assert set(verdicts) <= set(get_args(Verdict))
    total = ", ".join(f"{verdicts[name]} {name}" for name in get_args(Verdict) if verdicts[name])
    assert f"**In all: {total}.**" in text


def test_the_ledger_says_where_its_figures_come_from():
    text = ledger.ledger(record())
    assert "frames 2 of cloudy, 2 of sunny, 2 of sunset; 1200 × 300, N = 192; checksums: settings `" in text
    assert "sweepnet.safetensors `abababababab`" in text and "within 20 % of the paper's" in text
    assert "no results were given" in ledger.ledger()
