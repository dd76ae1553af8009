"""The computed cells of book/reproduction.md: what the paper prints, what we have, and the verdict.

The page is written by hand, but for the last three cells of each row of `ROWS` and the counts of
the verdicts. These are computed from the stored results: `python -m workshop reproduction`. The
page explains the verdicts.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from course.nbtools import ROOT
from omnistereo_learn.evaluate.records import Record, config_checksum, read_record
from omnistereo_learn.evaluate.regions import METRICS, SUMS, sums_to_metrics
from omnistereo_learn.evaluate.table import LIGHTS
from omnistereo_learn.recipes import RECIPES, SweepNetRecipe
from omnistereo_lib.files import write_text
from omnistereo_lib.stereo.methods import Method, penalties
from omnistereo_lib.stereo.zncc import default_window
from workshop.render.image_sets import SETS

PAGE = ROOT / "book" / "reproduction.md"
RESULTS = ROOT / "data_samples" / "results" / "paper.json"
TOLERANCE = 0.2  # relative; the last digit of the MAE that the paper prints is worth up to 10 %
REPRODUCED, TREND, DIFFERS = "reproduced", "trend reproduced", "differs"
_NAMED = 4  # a reason lists this many places and counts the others

_TABLE_II = """
zncc          40.7 28.0 25.2 10.0 23.0  44.9 31.0 27.9 10.9 23.9  39.5 26.8 24.0  9.7 22.9
mccnn         42.1 32.7 30.2 13.3 27.8  46.1 33.5 30.6 12.8 26.5  42.9 33.0 30.5 13.8 28.4
sweepnet      20.7 13.2 11.2  4.1 14.0  28.5 16.4 14.0  5.0 15.0  20.5 13.6 11.7  4.6 15.6
zncc+sgm      24.0  9.9  6.3  1.5  4.5  25.6  9.9  6.3  1.6  4.5  23.4  9.9  6.4  1.6  4.6
mccnn+sgm     19.3  7.6  5.1  1.4  4.5  21.2  7.2  4.7  1.4  4.4  18.8  7.6  5.1  1.4  4.6
sweepnet+sgm  15.4  6.8  4.8  1.1  3.8  19.6  7.2  4.9  1.2  3.8  14.8  7.0  4.9  1.2  3.9
"""
PAPER = {  # (method, light) → the five metrics
    (method, light): np.array(numbers[5 * k : 5 * k + 5], float)
    for method, *numbers in map(str.split, _TABLE_II.strip().splitlines())
    for k, light in enumerate(LIGHTS)
}


class Finding(NamedTuple):
    """The cells of a row; `reason` says why the verdict is not better."""

    paper: str
    ours: str
    verdict: str
    reason: str = ""


Comparison = Callable[[Record], Finding]


# ---- Metrics of stored results


def mean_metrics(results: Record, method: str, light: str) -> NDArray[np.float64]:
    """Return the five metrics of a method, means over the frames of a set."""
    frames = results["frames"][light].values()
    of_frames = (frame[method]["figures"] for frame in frames)
    return np.mean([[figures[metric] for metric in METRICS] for figures in of_frames], axis=0)


def region_sums(results: Record, method: str, name: str, region: str) -> NDArray[np.float64]:
    """Return `SUMS` of the errors of a method in a region, over all frames of a set."""
    frames = results["frames"][name].values()
    of_frames = (frame[method]["strata"][region] for frame in frames)
    return np.sum([[sums[key] for key in SUMS] for sums in of_frames], axis=0)


def seen_by(results: Record) -> NDArray[np.float64]:
    """Return the fractions of Sunny's rays whose true point is in the view of 0, 1 … 4 cameras."""
    rays = np.array([region_sums(results, "zncc", "sunny", f"seen by {k}")[0] for k in range(5)])
    return rays / rays.sum()


# ---- Verdicts


def judge_size(
    ours: ArrayLike, paper: ArrayLike, names: Sequence[str], ratios: bool = True
) -> tuple[str, str]:
    """Compare values, all of which must agree; only ratios have a side of 1 to be on."""
    ours, paper = np.asarray(ours, float), np.asarray(paper, float)
    far, other_side = np.abs(ours / paper - 1) > TOLERANCE, (ours < 1) != (paper < 1)
    if not far.any():
        return REPRODUCED, ""
    reason = f"beyond {100 * TOLERANCE:.0f} %: {_listed(names, far)}"
    if ratios and other_side.any():
        reason += f"; on the other side of 1: {_listed(names, other_side)}"
    return (TREND if ratios and not other_side.any() else DIFFERS), reason


def judge_order(holds: ArrayLike, expected: ArrayLike, names: Sequence[str]) -> tuple[str, str]:
    """Compare where an order holds with where it does in the paper."""
    broken = np.ravel(expected) & ~np.ravel(holds)
    if not broken.any():
        return REPRODUCED, ""
    verdict = TREND if 2 * broken.sum() < np.sum(expected) else DIFFERS
    return verdict, f"not {_listed(names, broken)}"


def _listed(names: Sequence[str], chosen: NDArray[np.bool_]) -> str:
    listed = [name for name, wanted in zip(names, chosen, strict=True) if wanted]
    more = f" and {len(listed) - _NAMED} more" if len(listed) > _NAMED else ""
    return ", ".join(listed[:_NAMED]) + more


# ---- Comparisons


def table_row(method: str, light: str) -> Comparison:
    """Compare metrics of Table II: ZNCC's as they are, the others as ratios to ZNCC's."""

    def text(values: NDArray[Any], zncc: NDArray[Any]) -> str:
        words = " ".join(f"{x:.1f}" for x in values)
        ratios = " ".join(f"{x:.2f}" for x in values / zncc)
        return words if method == "zncc" else f"{words}<br><sub>÷ ZNCC: {ratios}</sub>"

    def compare(results: Record) -> Finding:
        paper, paper_zncc = PAPER[method, light], PAPER["zncc", light]
        ours, zncc = mean_metrics(results, method, light), mean_metrics(results, "zncc", light)
        if method == "zncc":
            judged = judge_size(ours, paper, METRICS, ratios=False)
        else:
            judged = judge_size(ours / zncc, paper / paper_zncc, METRICS)
        return Finding(text(paper, paper_zncc), text(ours, zncc), *judged)

    return compare


def below(*pairs: tuple[str, str], metrics: Sequence[str] = METRICS) -> Comparison:
    """Compare where the first of each pair has smaller errors, by metric and light."""
    places = list(product(pairs, LIGHTS))
    columns = [METRICS.index(metric) for metric in metrics]
    names = [
        (f"{label(a)} / {label(b)} " if len(pairs) > 1 else "") + f"{light.capitalize()} {metric}"
        for ((a, b), light), metric in product(places, metrics)
    ]

    def compare(results: Record) -> Finding:
        ours = {key: mean_metrics(results, *key) for key in PAPER}
        expected, holds = (
            np.array([(table[a, light] < table[b, light])[columns] for (a, b), light in places])
            for table in (PAPER, ours)
        )
        paper, found = (f"{order.sum()} of {order.size}" for order in (expected, holds))
        return Finding(paper, found, *judge_order(holds, expected, names))

    return compare


def unseen_light(light: str) -> Comparison:
    """Compare how much worse SweepNet + SGM is in a light that it was not trained in."""

    def compare(results: Record) -> Finding:
        method = "sweepnet+sgm"
        paper = PAPER[method, light][0] / PAPER[method, "sunny"][0]
        ours = mean_metrics(results, method, light)[0] / mean_metrics(results, method, "sunny")[0]
        return Finding(f"× {paper:.2f}", f"× {ours:.2f}", *judge_size([ours], [paper], [">1"]))

    return compare


def shown(region: str, *sets: str) -> Comparison:
    """Compare '>5' of two methods in a region; a picture prints no number: a trend at most."""

    def compare(results: Record) -> Finding:
        methods = ("sweepnet+sgm", "zncc+sgm")
        errors = np.array(
            [
                [sums_to_metrics(region_sums(results, m, name, region))[2] for m in methods]
                for name in sets
            ]
        )
        verdict, reason = judge_order(errors[:, 0] < errors[:, 1], np.ones(len(sets), bool), sets)
        text = ", ".join(f"{sweepnet:.1f} against {zncc:.1f}" for sweepnet, zncc in errors)
        return Finding("shown", text, TREND if verdict == REPRODUCED else verdict, reason)

    return compare


def same(paper: str, ours: Callable[[Record], str], reason: str = "") -> Comparison:
    """Compare a setting, as text; `reason` says why ours is another one."""

    def compare(results: Record) -> Finding:
        equal = ours(results) == paper
        return Finding(paper, ours(results), *((REPRODUCED, "") if equal else (DIFFERS, reason)))

    return compare


def labels(results: Record) -> Finding:
    """Compare the labels to train on: two for each pair that sees a true point."""
    million = 2 * 350 * 600 * 150 / 1e6  # labels of a pair that sees every ray of 350 frames
    # among 0 to 4 adjacent cameras
    pairs_of_neighbours, all_pairs = (0, 0, 1, 2, 4), (0, 0, 1, 3, 6)
    ring, every = (million * seen_by(results) @ pairs for pairs in (pairs_of_neighbours, all_pairs))
    text = f"{ring:.0f} M<br><sub>with all pairs {every:.0f} M</sub>"
    return Finding("92 M", text, *judge_size([ring], [92], ["labels"], ratios=False))


def patches(_: Record) -> Finding:
    """Compare the number of patch pairs that MC-CNN was trained on."""
    recipe: Any = RECIPES["mccnn"]["shipped"]
    pairs = 2 * recipe.steps * recipe.frames_per_step * recipe.rays_per_frame / 1e6
    verdict = judge_size([pairs], [40 * 14], ["pairs"], ratios=False)[0]
    return Finding("40 M × 14 epochs", f"{pairs:.1f} M in all", verdict, _TWO_CORES)


def label(method: str) -> str:
    """Return a method as tables have it, such as "SweepNet + SGM"."""
    return Method.parse(method).label


def _scale(config: Record) -> str:
    return f"{config['width']} × {config['height']}, N = {config['num_spheres']}"


def _coverage(results: Record) -> str:
    return f"{100 * seen_by(results)[2:].sum():.1f} %"


def _settings(_: Record) -> str:
    window = default_window(1200)
    return f"{window} × {window}, " + "P1 = {:g}, P2 = {:g}".format(*penalties(1200, 192))


def _drives(_: Record) -> str:
    train, test = SETS["sunny/train"], SETS["sunny/test"]
    sizes = dict.fromkeys(f"{width} × {height}" for width, height in (train.size, test.size))
    return f"{train.count} + {test.count} frames, {' + '.join(sizes)}"


def _recipe(recipe: SweepNetRecipe) -> str:
    optimizer = f"{recipe.optimizer} {recipe.learning_rate:g}"
    return f"{_scale(recipe.as_dict())}, {optimizer}, {recipe.steps} steps"


# ---- The page

_SMALL, _TWO_CORES = "keeps the clone small", "two cores; `--preset paper` is theirs"
_SGM = [(f"{cost}+sgm", cost) for cost in ("zncc", "mccnn", "sweepnet")]
_RECIPES: dict[str, Any] = RECIPES["sweepnet"]

ROWS: dict[str, Comparison] = {  # first cell → comparison
    "Section IV: SweepNet below ZNCC in every metric and light": below(("sweepnet", "zncc")),
    "Section IV: SweepNet below MC-CNN": below(("sweepnet", "mccnn")),
    "Section IV: SweepNet + SGM below ZNCC + SGM": below(("sweepnet+sgm", "zncc+sgm")),
    'Section IV: SweepNet + SGM below MC-CNN + SGM, "best in all datasets"': below(
        ("sweepnet+sgm", "mccnn+sgm")
    ),
    "Table II: MC-CNN above ZNCC without SGM": below(("zncc", "mccnn")),
    "Table II: MC-CNN below ZNCC with SGM": below(("mccnn+sgm", "zncc+sgm")),
    "Section III-B: SGM lowers every metric of every cost": below(*_SGM),
    "Table II: SweepNet + SGM, trained only in Sunny: '>1' in Cloudy": unseen_light("cloudy"),
    "Table II: SweepNet + SGM, trained only in Sunny: '>1' in Sunset": unseen_light("sunset"),
    "Abstract, Fig. 1: full 360°, no blind regions: rays of Sunny seen by two or more cameras": (
        same("100.0 %", _coverage)
    ),
    "Fig. 6: SweepNet's raw volume is the cleanest: fewest winners far off, by '>5'": below(
        ("sweepnet", "zncc"), ("sweepnet", "mccnn"), metrics=(">5",)
    ),
    "Fig. 7: thin structures are reconstructed: '>5' on thin objects": shown("thin", *LIGHTS),
    "Fig. 7: the sky is reconstructed: '>5' in the sky": shown("sky", *LIGHTS),
    "Fig. 8: indoors what is near is accurate: '>5' on near rays of our rendered room": shown(
        "near", "indoor"
    ),
    "Fig. 9: a tilted rig in the air, here within ±45°: '>5' on all rays": shown("all", "aerial"),
    **{
        f"{label(method)}, {light.capitalize()}": table_row(method, light)
        for method, light in PAPER
    },
    "Section IV: panorama and spheres in testing": same(
        "1200 × 300, N = 192", lambda results: _scale(results["config"])
    ),
    "Section IV: test frames in Sunny, Cloudy, Sunset": same(
        "300 + 300 + 300",
        lambda results: " + ".join(str(len(results["frames"][light])) for light in LIGHTS),
        _SMALL,
    ),
    "Section IV: ZNCC's window, SGM's penalties": same("9 × 9, P1 = 0.1, P2 = 12", _settings),
    "Section IV, Fig. 5: a drive through a rendered city, training + test": same(
        "700 + 300 frames, 800 × 768", _drives, _SMALL
    ),
    "Section IV: SweepNet's training, 350 frames × 14 epochs": same(
        _recipe(_RECIPES["paper"]), lambda _: _recipe(_RECIPES["shipped"]), _TWO_CORES
    ),
    "Section IV: labels to train on, one positive and one negative for each ray and pair": labels,
    "Section IV: MC-CNN's training pairs": patches,
}


def report(results: Record) -> str:
    """Return the text of the page, computed from the content of results.json."""
    lines = PAGE.read_text(encoding="utf-8").split("\n")
    text = "\n".join(_computed(line, results) for line in lines)
    text = re.sub(
        "(<summary>[^:<]+: )[^<]*(</summary>.*?</details>)",
        lambda found: f"{found[1]}{_counts(found[2])}{found[2]}",
        text,
        flags=re.DOTALL,
    )
    return re.sub(r"(?<=\*\*In all: ).*(?=\.\*\*)", _counts(text), text)


def _computed(line: str, results: Record) -> str:
    if line.startswith("Results: "):
        return _provenance(results)
    first, *cells = line.removeprefix("| ").split(" | ")
    if first not in ROWS:
        return line
    paper, ours, verdict, reason = ROWS[first](results)
    return (
        f"| {first} | {cells[0]} | {paper} | {ours} |"
        f" {verdict}{f'<br><sub>{reason}</sub>' if reason else ''} |"
    )


def _provenance(results: Record) -> str:
    of_sets, digests = sorted(results["frames"].items()), sorted(results["weights"].items())
    frames = ", ".join(f"{len(of_set)} of {name}" for name, of_set in of_sets)
    weights = "".join(f", {name} `{digest[:12]}`" for name, digest in digests)
    settings = f"settings `{config_checksum(results)[:12]}`"
    return f"Results: frames {frames}; {_scale(results['config'])}; checksums: {settings}{weights}."


def _counts(text: str) -> str:
    """Count the verdicts in the last cells of tables."""
    verdicts = Counter(re.findall(r"\| ([a-z ]+)(?:<br>.*)? \|$", text, re.MULTILINE))
    return ", ".join(
        f"{verdicts[verdict]} {verdict}"
        for verdict in (REPRODUCED, TREND, DIFFERS)
        if verdicts[verdict]
    )


def renew_report() -> None:
    """Compute the cells of the page again from the stored results."""
    text = report(read_record(RESULTS))
    write_text(PAGE, text)
