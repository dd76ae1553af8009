"""How a claim of the paper is judged: the rules, and the functions that apply them to results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.evaluate.methods import METHODS
from omnistereo_lib.evaluate.records import Record
from omnistereo_lib.evaluate.regions import METRICS, SUMS, sums_to_metrics
from omnistereo_lib.evaluate.run import SCALES
from omnistereo_lib.evaluate.table import LIGHTS
from omnistereo_lib.stereo.methods import Method, penalties
from omnistereo_lib.stereo.sweepnet import SweepNet
from omnistereo_lib.train.recipes import RECIPES
from render.frames import SETS

Verdict = Literal["reproduced", "trend reproduced", "differs", "not evaluated"]
TOLERANCE = 0.2  # relative; the paper prints MAE with two digits, of which the last is up to 10 %
PERCENT = f"{100 * TOLERANCE:.0f} %"
EXACT = 1e-5  # relative to the largest value; the library computes costs in float32
_NAMED = 4  # places that a verdict's reason names before it only counts

_TABLE_II = """
zncc          40.7 28.0 25.2 10.0 23.0  44.9 31.0 27.9 10.9 23.9  39.5 26.8 24.0  9.7 22.9
mccnn         42.1 32.7 30.2 13.3 27.8  46.1 33.5 30.6 12.8 26.5  42.9 33.0 30.5 13.8 28.4
sweepnet      20.7 13.2 11.2  4.1 14.0  28.5 16.4 14.0  5.0 15.0  20.5 13.6 11.7  4.6 15.6
zncc+sgm      24.0  9.9  6.3  1.5  4.5  25.6  9.9  6.3  1.6  4.5  23.4  9.9  6.4  1.6  4.6
mccnn+sgm     19.3  7.6  5.1  1.4  4.5  21.2  7.2  4.7  1.4  4.4  18.8  7.6  5.1  1.4  4.6
sweepnet+sgm  15.4  6.8  4.8  1.1  3.8  19.6  7.2  4.9  1.2  3.8  14.8  7.0  4.9  1.2  3.9
"""


def _read_table(text: str) -> dict[str, dict[str, dict[str, float]]]:
    """Return method → light → figure → value."""
    table = {}
    for line in text.strip().splitlines():
        method, *numbers = line.split()
        values = map(float, numbers)
        table[method] = {light: {figure: next(values) for figure in METRICS} for light in LIGHTS}
    return table


PAPER_TABLE = _read_table(_TABLE_II)


class Finding(NamedTuple):
    """What we have to set against the paper, the verdict, and why it is no better."""

    ours: str
    verdict: Verdict
    reason: str = ""


Judge = Callable[[Record | None], Finding]


@dataclass(frozen=True)
class Claim:
    """Something that the paper says and that can be checked.

    Attributes:
        group: Heading in the ledger.
        source: Where the paper says it.
        text: What it says.
        where: What does it here, as "module:name" within `omnistereo_lib`.
        notebook: Where it is taught: a file's name without ending.
        paper: The paper's figures.
        judge: Takes results of an evaluation, or None, and returns a `Finding`.
    """

    group: str
    source: str
    text: str
    where: tuple[str, ...]
    notebook: str
    paper: str
    judge: Judge

    def finding(self, results: Record | None) -> Finding:
        """Return what results, as `Evaluation.results` returns them, say about the claim."""
        try:
            return self.judge(results)
        except _LackingError as lack:
            return Finding("–", "not evaluated", str(lack))


@dataclass(frozen=True)
class Difference:
    """What the paper's text and the authors' released code do not do alike, or do not say.

    Attributes:
        topic, paper, code: What it is about, what the paper's text says, what the released code does.
        follows: Which of them is the default here.
        here: Details of the default, where there are any.
        option: What chooses otherwise, as Python; "" where nothing does.
        where: As in `Claim`; the option is the first one's.
    """

    topic: str
    paper: str
    code: str
    follows: Literal["paper", "code", "both", "own"]
    here: str
    option: str
    where: tuple[str, ...]


class _LackingError(Exception):
    """The results do not hold what a claim is about."""


# ---- What the results say


def _config(results: Record | None) -> Record:
    if results is None:
        raise _LackingError("")
    return results["config"]


def _frames(results: Record | None, name: str, method: str) -> list[Record]:
    """Return a method's errors in the frames of a set, which must be there and of the paper's scale."""
    if scale_text(_config(results)) != PAPER_SCALE:
        raise _LackingError("results at another scale")
    frames = list(results["frames"].get(name, {}).values())
    if not frames or any(method not in frame for frame in frames):
        raise _LackingError(f"no {_label(method)} on {name}")
    return [frame[method] for frame in frames]


def _ours(results: Record | None, method: str, light: str) -> NDArray[np.float64]:
    """Return the means of the five figures over the frames that can be evaluated, as `errors_table` does."""
    found = [[frame["figures"][figure] for figure in METRICS] for frame in _frames(results, light, method)]
    known = [row for row in found if None not in row]
    if not known:
        raise _LackingError(f"no frame of {light} can be evaluated")
    return np.mean(known, 0)


def _papers(method: str, light: str) -> NDArray[np.float64]:
    return np.array(list(PAPER_TABLE[method][light].values()))


def _pooled(results: Record | None, name: str, method: str, stratum: str) -> NDArray[np.float64]:
    """Return the sums over a stratum of all frames, in the order of `SUMS`; there must be rays."""
    sums = [frame["strata"][stratum] for frame in _frames(results, name, method)]
    total = np.sum([[frame[key] for key in SUMS] for frame in sums], 0)
    if total[0] == 0:
        raise _LackingError(f"no ray of {name} is {stratum}")
    return total


def _shares_seen(results: Record | None) -> list[float]:
    """Return the shares of Sunny's rays whose true point is in the view of 0, 1, … 4 cameras."""
    total = _pooled(results, "sunny", "zncc", "all")[0]
    frames = [frame["strata"] for frame in _frames(results, "sunny", "zncc")]
    return [sum(strata[f"seen by {k}"]["rays"] for strata in frames) / total for k in range(5)]


# ---- Rules


def _by_size(ours: ArrayLike, paper: ArrayLike, names: Sequence[str], ratios: bool = True) -> tuple[Verdict, str]:
    """Compare figures, all of which must agree; only ratios have a side of 1 to be on."""
    ours, paper = np.asarray(ours, np.float64), np.asarray(paper, np.float64)
    far = ~(np.abs(ours / paper - 1) <= TOLERANCE)  # NaN is far
    other_side = ((ours < 1) != (paper < 1)) | ~np.isfinite(ours)
    if not far.any():
        return "reproduced", ""
    if ratios and not other_side.any():
        return "trend reproduced", f"beyond {PERCENT}: {_listed(names, far)}"
    where = f"; on the other side of 1: {_listed(names, other_side)}" if ratios else ""
    return "differs", f"beyond {PERCENT}: {_listed(names, far)}{where}"


def _by_order(held: ArrayLike, expected: ArrayLike, names: Sequence[str]) -> tuple[Verdict, str]:
    """Compare where an order holds with where it does in the paper."""
    held, expected = np.ravel(held), np.ravel(expected)
    broken = expected & ~held
    if not broken.any():
        return "reproduced", ""
    verdict = "trend reproduced" if 2 * broken.sum() < expected.sum() else "differs"
    return verdict, f"not {_listed(names, broken)}"


def _listed(names: Sequence[str], chosen: NDArray[np.bool_]) -> str:
    listed = [name for name, wanted in zip(names, chosen, strict=True) if wanted]
    more = len(listed) - _NAMED
    return ", ".join(listed[:_NAMED]) + (f" and {more} more" if more > 0 else "")


def row(method: str, light: str) -> Claim:
    """Return the claim of five figures of Table II."""

    def text(values: NDArray, zncc: NDArray) -> str:
        ratios = "" if method == "zncc" else "\n÷ ZNCC: " + " ".join(f"{ratio:.2f}" for ratio in values / zncc)
        return " ".join(f"{value:.1f}" for value in values) + ratios

    def judge(results: Record | None) -> Finding:
        ours, zncc = _ours(results, method, light), _ours(results, "zncc", light)
        with np.errstate(divide="ignore", invalid="ignore"):  # ratios to 0 are on no side of 1
            if method == "zncc":
                return Finding(text(ours, zncc), *_by_size(ours, paper, METRICS, ratios=False))
            return Finding(text(ours, zncc), *_by_size(ours / zncc, paper / paper_zncc, METRICS))

    paper, paper_zncc = _papers(method, light), _papers("zncc", light)
    what = f"{_label(method)}, {light.capitalize()}"
    where = ("evaluate:errors_table",)
    return Claim(_TABLE, "Table II", what, where, "08_evaluation", text(paper, paper_zncc), judge)


def below(
    source: str,
    text: str,
    pairs: Sequence[tuple[str, str]],
    where: tuple[str, ...],
    notebook: str,
    chosen: Sequence[str] = METRICS,
) -> Claim:
    """Return the claim that the first method of each pair has smaller figures than the second, in every light."""

    def orders(figures_of: Callable[[str, str], NDArray]) -> NDArray[np.bool_]:
        wanted = [METRICS.index(figure) for figure in chosen]
        return np.array([figures_of(a, light)[wanted] < figures_of(b, light)[wanted] for (a, b), light in places])

    def judge(results: Record | None) -> Finding:
        held = orders(lambda method, light: _ours(results, method, light))
        return Finding(f"{held.sum()} of {held.size}", *_by_order(held, expected, names))

    places = list(product(pairs, LIGHTS))
    several = [f"{_label(a)} / {_label(b)} " if len(pairs) > 1 else "" for (a, b), _ in places]
    names = [
        f"{pair}{light.capitalize()} {f}" for pair, (_, light) in zip(several, places, strict=True) for f in chosen
    ]
    expected = orders(_papers)
    return Claim(CLAIMS_GROUP, source, text, where, notebook, f"{expected.sum()} of {expected.size}", judge)


def unseen_light(light: str) -> Claim:
    """Return the claim of what a light costs that the network has not been trained in."""

    def judge(results: Record | None) -> Finding:
        ours = _ours(results, method, light)[0] / _ours(results, method, "sunny")[0]
        return Finding(f"× {ours:.2f}", *_by_size([ours], [paper], [">1"]))

    method = "sweepnet+sgm"
    paper = _papers(method, light)[0] / _papers(method, "sunny")[0]
    text = f"{_label(method)}, trained in Sunny alone: '>1' in {light.capitalize()}"
    return Claim(CLAIMS_GROUP, "Table II", text, ("train.loop:train",), "06_sweepnet", f"× {paper:.2f}", judge)


def shown(source: str, text: str, stratum: str, sets: Sequence[str] = LIGHTS) -> Claim:
    """Return the claim of a picture: SweepNet + SGM is wrong on fewer rays of a kind than ZNCC + SGM."""

    def judge(results: Record | None) -> Finding:
        methods = ("sweepnet+sgm", "zncc+sgm")
        above = np.array([[sums_to_metrics(_pooled(results, name, m, stratum))[2] for m in methods] for name in sets])
        held = above[:, 0] < above[:, 1]
        verdict, reason = _by_order(held, np.ones(len(sets), bool), sets)
        ours = ", ".join(f"{ours:.1f} against {zncc:.1f}" for ours, zncc in above)
        return Finding(ours, "trend reproduced" if verdict == "reproduced" else verdict, reason)

    text += f" ('>5' on {stratum} rays, SweepNet + SGM against ZNCC + SGM)"
    where = ("evaluate.regions:find_regions", "evaluate:regions_table")
    return Claim(CLAIMS_GROUP, source, text, where, "08_evaluation", "shown", judge)


# ---- Facts


def coverage(results: Record | None) -> Finding:
    """Judge the share of rays that two or more cameras see."""
    share = 1 - sum(_shares_seen(results)[:2])
    verdict = "reproduced" if round(share, 3) == 1 else "trend reproduced" if share > 0.5 else "differs"
    return Finding(f"{100 * share:.1f} % of Sunny's", verdict)


def labels(results: Record | None) -> Finding:
    """Count labels as the paper draws them: for each camera pair that sees a true point one positive, one negative."""
    shares = _shares_seen(results)
    ring, every = (
        2 * 350 * 600 * 150 / 1e6 * np.dot(shares, pairs) for pairs in ((0, 0, 1, 2, 4), (0, 0, 1, 3, 6))
    )  # pairs among 0 … 4 cameras that stand side by side
    return Finding(f"{ring:.0f} M\nwith all pairs {every:.0f} M", *_by_size([ring], [92], ["labels"], ratios=False))


def frame_counts(results: Record | None) -> Finding:
    """Judge the number of test frames."""
    _config(results)
    counts = [len(results["frames"].get(light, {})) for light in LIGHTS]
    verdict, _ = _by_size(counts, [300] * 3, LIGHTS, ratios=False)
    shipped = [len(SETS[f"{light}/test"].shipped) for light in LIGHTS]
    reason = "keeps the clone small" if counts == shipped else f"{sum(shipped)} ship"
    return Finding(" + ".join(map(str, counts)), verdict, "" if verdict == "reproduced" else reason)


def scale(results: Record | None) -> Finding:
    """Judge the size of the panorama and the number of spheres."""
    ours = scale_text(_config(results))
    return Finding(ours, "reproduced" if ours == PAPER_SCALE else "differs")


def settings(_: Record | None) -> Finding:
    """Judge the window of ZNCC and the penalties of SGM at the scale of the paper."""
    windows = {method.window for method in METHODS}
    p1, p2 = penalties(1200, 192)
    text = f"{min(windows)} × {min(windows)}, P1 = {p1:g}, P2 = {p2:g}"
    return Finding(text, "reproduced" if (windows, p1, p2) == ({9}, 0.1, 12.0) else "differs")


def drives(_: Record | None) -> Finding:
    """Judge the size of the rendered drive."""
    train, test = SETS["sunny/train"], SETS["sunny/test"]
    sizes = [f"{width} × {height}" for width, height in dict.fromkeys((train.size, test.size))]
    same = (train.count, test.count, sizes) == (700, 300, ["800 × 768"])
    text = f"{train.count} + {test.count} frames, {' + '.join(sizes)}"
    return Finding(text, "reproduced" if same else "differs", "" if same else "keeps the clone small")


def recipe(_: Record | None) -> Finding:
    """Judge the recipe that SweepNet was trained by."""
    ours, paper = RECIPES["sweepnet"]["shipped"], RECIPES["sweepnet"]["paper"]
    text = f"{scale_text(ours.as_dict())}, {ours.optimizer} {ours.learning_rate:g}, {ours.steps} steps"
    same = ours.as_dict() == paper.as_dict()
    return Finding(text, "reproduced" if same else "differs", "" if same else "two cores; `--preset paper` is theirs")


def patches(_: Record | None) -> Finding:
    """Judge the number of patches that MC-CNN was trained on."""
    recipe = RECIPES["mccnn"]["shipped"]
    pairs = 2 * recipe.steps * recipe.frames_per_step * recipe.rays_per_frame / 1e6
    verdict, _ = _by_size([pairs], [40 * 14], ["pairs"], ratios=False)
    reason = "" if verdict == "reproduced" else "two cores; `--preset paper` is theirs"
    return Finding(f"{pairs:.1f} M in all", verdict, reason)


_CONVOLUTIONS = {f"conv{k}": (3, 32, 1) for k in range(2, 19)}  # side, maps, stride
LAYERS = {
    "conv1": (5, 32, 2), **_CONVOLUTIONS, "conv19": (3, 128, 1), "deconv1": (3, 128, 2), "conv20": (3, 128, 1),
    **{f"fc{k}": (1, 256, 1) for k in range(1, 5)}, "fc5": (1, 1, 1),
}  # fmt: skip


def table_one(_: Record | None) -> Finding:
    """Compare the layers of SweepNet with Table I."""

    def layer(module: Any) -> tuple[int, int, int]:
        if isinstance(module, torch.nn.Linear):  # a 1 × 1 convolution
            return 1, module.out_features, 1
        return module.kernel_size[0], module.out_channels, module.stride[0]

    with torch.random.fork_rng():
        ours = {name: layer(module) for name, module in SweepNet().layers.items()}
    names = list(LAYERS)
    held = [ours.get(name) == LAYERS[name] for name in names]
    verdict, reason = _by_order(held, np.ones(len(names), bool), names)
    return Finding(f"{sum(held)} of {len(names)} layers", verdict if list(ours) == names else "differs", reason)


# ---- Formulas: each returns how far the library is from what the paper prints


def formula(source: str, text: str, where: tuple[str, ...], notebook: str, difference: Callable[[], float]) -> Claim:
    """Return the claim that the library follows a formula: `difference` is relative to the largest value."""

    def judge(_: Record | None) -> Finding:
        found = difference()
        if found <= EXACT:
            return Finding(f"within {EXACT:g}", "reproduced")
        return Finding(f"{found:.1e} apart", "differs")

    return Claim(_EQUATIONS, source, text, where, notebook, "the formula", judge)


def _label(method: str) -> str:
    return Method.parse(method).label


def scale_text(config: Record) -> str:
    """Return a scale in words, such as "1200 × 300, N = 192"."""
    return f"{config['width']} × {config['height']}, N = {config['num_spheres']}"


CLAIMS_GROUP, _TABLE, SETUP, _EQUATIONS = "Claims and figures", "Table II", "Set-up and Table I", "Equations"
PAPER_SCALE = scale_text(asdict(SCALES["paper"]))
RAW, SMOOTH = ("zncc", "mccnn", "sweepnet"), ("zncc+sgm", "mccnn+sgm", "sweepnet+sgm")
