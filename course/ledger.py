"""The reproduction ledger: every table, figure, equation and claim of the paper, where it is here, and if it holds.

It is made, never typed. The paper's figures are `PAPER_TABLE`; ours are taken from the results of an evaluation, or
from running the library beside the formula as printed; every verdict follows from them by one of these rules:

- Size. Data, lenses and training differ from the paper's, so errors are compared as ratios to ZNCC's in the same
  light; ZNCC's own as they are. Within `TOLERANCE` of the paper's: reproduced. Ratios on the same side of 1: trend
  reproduced. Else: differs.
- Order, such as "SweepNet below ZNCC". True wherever it is in the paper's table: reproduced. In more than half of
  these places: trend reproduced. Else: differs.
- Picture. The paper shows it and prints no figure, so that an order which holds here is a trend reproduced at most.
- Formula. Library and print agree to `EXACT` on random input: reproduced. Else: differs.
- Setting. The same as the paper's: reproduced. Else: differs.

What the results do not hold, or hold at another scale than the paper's, is not evaluated.
"""

from __future__ import annotations

import html
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

import course.formulas as formulas
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.evaluate.methods import METHODS
from omnistereo_lib.evaluate.records import Record, config_checksum
from omnistereo_lib.evaluate.regions import METRICS, SUMS, sums_to_metrics
from omnistereo_lib.evaluate.run import SCALES
from omnistereo_lib.evaluate.table import LIGHTS
from omnistereo_lib.files import atomic_write, read_bytes
from omnistereo_lib.stereo.methods import Method
from omnistereo_lib.stereo.sweepnet import SweepNet
from omnistereo_lib.train.recipes import RECIPES
from render.frames import SETS

Verdict = Literal["reproduced", "trend reproduced", "differs", "not evaluated"]
TOLERANCE = 0.2  # relative; the paper prints MAE with two digits, of which the last is up to 10 %
_PERCENT = f"{100 * TOLERANCE:.0f} %"
EXACT = 1e-5  # relative to the largest value; the library computes costs in float32
MARKERS = ("<!-- ledger -->", "<!-- /ledger -->")
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

    Attributes
    ----------
    group : str
        Heading in the ledger.
    source : str
        Where the paper says it.
    text : str
        What it says.
    where : tuple of str
        What does it here, as "module:name" within `omnistereo_lib`.
    notebook : str
        Where it is taught: a file's name without ending.
    paper : str
        The paper's figures.
    judge : callable
        Takes results of an evaluation, or None, and returns a `Finding`.
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

    Attributes
    ----------
    topic, paper, code : str
        What it is about, what the paper's text says, what the released code does.
    follows : "paper" | "code" | "both" | "own"
        Which of them is the default here.
    here : str
        Details of the default, where there are any.
    option : str
        What chooses otherwise, as Python; "" where nothing does.
    where : tuple of str
        As in `Claim`; the option is the first one's.
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
    if _scale_text(_config(results)) != _PAPER_SCALE:
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
        return "trend reproduced", f"beyond {_PERCENT}: {_listed(names, far)}"
    where = f"; on the other side of 1: {_listed(names, other_side)}" if ratios else ""
    return "differs", f"beyond {_PERCENT}: {_listed(names, far)}{where}"


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


def _row(method: str, light: str) -> Claim:
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


def _below(
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
    return Claim(_CLAIMS, source, text, where, notebook, f"{expected.sum()} of {expected.size}", judge)


def _unseen_light(light: str) -> Claim:
    """Return the claim of what a light costs that the network has not been trained in."""

    def judge(results: Record | None) -> Finding:
        ours = _ours(results, method, light)[0] / _ours(results, method, "sunny")[0]
        return Finding(f"× {ours:.2f}", *_by_size([ours], [paper], [">1"]))

    method = "sweepnet+sgm"
    paper = _papers(method, light)[0] / _papers(method, "sunny")[0]
    text = f"{_label(method)}, trained in Sunny alone: '>1' in {light.capitalize()}"
    return Claim(_CLAIMS, "Table II", text, ("train.loop:train",), "06_sweepnet", f"× {paper:.2f}", judge)


def _shown(source: str, text: str, stratum: str, sets: Sequence[str] = LIGHTS) -> Claim:
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
    return Claim(_CLAIMS, source, text, where, "08_evaluation", "shown", judge)


# ---- Facts


def _coverage(results: Record | None) -> Finding:
    share = 1 - sum(_shares_seen(results)[:2])
    verdict = "reproduced" if round(share, 3) == 1 else "trend reproduced" if share > 0.5 else "differs"
    return Finding(f"{100 * share:.1f} % of Sunny's", verdict)


def _labels(results: Record | None) -> Finding:
    """Count labels as the paper draws them: for each camera pair that sees a true point one positive, one negative."""
    shares = _shares_seen(results)
    ring, every = (
        2 * 350 * 600 * 150 / 1e6 * np.dot(shares, pairs) for pairs in ((0, 0, 1, 2, 4), (0, 0, 1, 3, 6))
    )  # pairs among 0 … 4 cameras that stand side by side
    return Finding(f"{ring:.0f} M\nwith all pairs {every:.0f} M", *_by_size([ring], [92], ["labels"], ratios=False))


def _frame_counts(results: Record | None) -> Finding:
    _config(results)
    counts = [len(results["frames"].get(light, {})) for light in LIGHTS]
    verdict, _ = _by_size(counts, [300] * 3, LIGHTS, ratios=False)
    shipped = [len(SETS[f"{light}/test"].shipped) for light in LIGHTS]
    reason = "keeps the clone small" if counts == shipped else f"{sum(shipped)} ship"
    return Finding(" + ".join(map(str, counts)), verdict, "" if verdict == "reproduced" else reason)


def _scale(results: Record | None) -> Finding:
    ours = _scale_text(_config(results))
    return Finding(ours, "reproduced" if ours == _PAPER_SCALE else "differs")


def _settings(_: Record | None) -> Finding:
    found = {(method.window, method.p1, method.p2) for method in METHODS}
    window, p1, p2 = next(iter(found))
    text = f"{window} × {window}, P1 = {p1:g}, P2 = {p2:g}"
    return Finding(text, "reproduced" if found == {(9, 0.1, 12.0)} else "differs")


def _drives(_: Record | None) -> Finding:
    train, test = SETS["sunny/train"], SETS["sunny/test"]
    sizes = [f"{width} × {height}" for width, height in dict.fromkeys((train.size, test.size))]
    same = (train.count, test.count, sizes) == (700, 300, ["800 × 768"])
    text = f"{train.count} + {test.count} frames, {' + '.join(sizes)}"
    return Finding(text, "reproduced" if same else "differs", "" if same else "keeps the clone small")


def _recipe(_: Record | None) -> Finding:
    ours, paper = RECIPES["sweepnet"]["shipped"], RECIPES["sweepnet"]["paper"]
    text = f"{_scale_text(ours.as_dict())}, {ours.optimizer} {ours.learning_rate:g}, {ours.steps} steps"
    same = ours.as_dict() == paper.as_dict()
    return Finding(text, "reproduced" if same else "differs", "" if same else "two cores; `--preset paper` is theirs")


def _patches(_: Record | None) -> Finding:
    recipe = RECIPES["mccnn"]["shipped"]
    pairs = 2 * recipe.steps * recipe.frames_per_step * recipe.rays_per_frame / 1e6
    verdict, _ = _by_size([pairs], [40 * 14], ["pairs"], ratios=False)
    reason = "" if verdict == "reproduced" else "two cores; `--preset paper` is theirs"
    return Finding(f"{pairs:.1f} M in all", verdict, reason)


_CONVOLUTIONS = {f"conv{k}": (3, 32, 1) for k in range(2, 19)}  # side, maps, stride
_LAYERS = {
    "conv1": (5, 32, 2), **_CONVOLUTIONS, "conv19": (3, 128, 1), "deconv1": (3, 128, 2), "conv20": (3, 128, 1),
    **{f"fc{k}": (1, 256, 1) for k in range(1, 5)}, "fc5": (1, 1, 1),
}  # fmt: skip


def _table_one(_: Record | None) -> Finding:
    def layer(module: Any) -> tuple[int, int, int]:
        if isinstance(module, torch.nn.Linear):  # a 1 × 1 convolution
            return 1, module.out_features, 1
        return module.kernel_size[0], module.out_channels, module.stride[0]

    with torch.random.fork_rng():
        ours = {name: layer(module) for name, module in SweepNet().layers.items()}
    names = list(_LAYERS)
    held = [ours.get(name) == _LAYERS[name] for name in names]
    verdict, reason = _by_order(held, np.ones(len(names), bool), names)
    return Finding(f"{sum(held)} of {len(names)} layers", verdict if list(ours) == names else "differs", reason)


# ---- Formulas: each returns how far the library is from what the paper prints


def _formula(source: str, text: str, where: tuple[str, ...], notebook: str, difference: Callable[[], float]) -> Claim:
    def judge(_: Record | None) -> Finding:
        found = difference()
        if found <= EXACT:
            return Finding(f"within {EXACT:g}", "reproduced")
        return Finding(f"{found:.1e} apart", "differs")

    return Claim(_EQUATIONS, source, text, where, notebook, "the formula", judge)


# ---- The ledger's content


def _label(method: str) -> str:
    return Method.parse(method).label


def _scale_text(config: Record) -> str:
    return f"{config['width']} × {config['height']}, N = {config['num_spheres']}"


_CLAIMS, _TABLE, _SETUP, _EQUATIONS = "Claims and figures", "Table II", "Set-up and Table I", "Equations"
_PAPER_SCALE = _scale_text(asdict(SCALES["paper"]))
_RAW, _SMOOTH = ("zncc", "mccnn", "sweepnet"), ("zncc+sgm", "mccnn+sgm", "sweepnet+sgm")


_EVALUATION = ("evaluate:errors_table",)

CLAIMS: tuple[Claim, ...] = (
    _below("Section IV", "SweepNet below ZNCC in every figure and light", [("sweepnet", "zncc")],
           ("stereo.sweepnet:SweepNet", "stereo.zncc:ZNCC"), "06_sweepnet"),
    _below("Section IV", "SweepNet below MC-CNN", [("sweepnet", "mccnn")],
           ("stereo.sweepnet:SweepNet", "stereo.mccnn:MCCNN"), "06_sweepnet"),
    _below("Section IV", "SweepNet + SGM below ZNCC + SGM", [("sweepnet+sgm", "zncc+sgm")],
           _EVALUATION, "08_evaluation"),
    _below("Section IV", "SweepNet + SGM below MC-CNN + SGM, \"best in all datasets\"",
           [("sweepnet+sgm", "mccnn+sgm")], _EVALUATION, "08_evaluation"),
    _below("Table II", "MC-CNN above ZNCC without SGM", [("zncc", "mccnn")], ("stereo.mccnn:MCCNN",), "05_mccnn"),
    _below("Table II", "MC-CNN below ZNCC with SGM", [("mccnn+sgm", "zncc+sgm")], ("stereo.mccnn:MCCNN",), "05_mccnn"),
    _below("Section III-B", "SGM lowers every figure of every cost", list(zip(_SMOOTH, _RAW, strict=True)),
           ("stereo.sgm:sgm",), "07_sgm"),
    *map(_unseen_light, LIGHTS[1:]),
    Claim(_CLAIMS, "Abstract, Fig. 1", "full 360°, no blind regions: rays seen by two or more cameras",
          ("stereo.sweep:SphereSweep.pixels", "stereo.depth:Depth"), "00_quickstart", "100 %", _coverage),
    _below("Fig. 6", "SweepNet's raw volume is the cleanest: fewer winners far off ('>5')",
           [("sweepnet", "zncc"), ("sweepnet", "mccnn")], ("stereo.volume:cost_volume",), "08_evaluation", (">5",)),
    _shown("Fig. 7", "thin structures are reconstructed", "thin"),
    _shown("Fig. 7", "so is the sky", "sky"),
    _shown("Fig. 8", "indoors what is close is accurate; ours is a rendered room", "near", ("indoor",)),
    _shown("Fig. 9", "a tilted rig in the air, here within ±45°", "all", ("aerial",)),
    *(_row(method, light) for method in PAPER_TABLE for light in LIGHTS),
    Claim(_SETUP, "Section IV", "panorama and spheres in testing", ("evaluate:SCALES", "geometry.sphere:SphereGrid"),
          "08_evaluation", _PAPER_SCALE, _scale),
    Claim(_SETUP, "Section IV", "test frames in Sunny, Cloudy, Sunset", ("dataset:load_dataset",),
          "08_evaluation", "300 + 300 + 300", _frame_counts),
    Claim(_SETUP, "Section IV", "ZNCC's window, SGM's penalties", ("stereo.methods:Method",), "08_evaluation",
          "9 × 9, P1 = 0.1, P2 = 12", _settings),
    Claim(_SETUP, "Section IV, Fig. 5", "a drive through a rendered city, training + test", ("render.frames:SETS",),
          "10_render_a_city", "700 + 300 frames, 800 × 768", _drives),
    Claim(_SETUP, "Section IV", "SweepNet's training", ("train.recipes:RECIPES", "train:train"), "06_sweepnet",
          "600 × 150, N = 192, sgd 0.003, 350 frames × 14 epochs", _recipe),
    Claim(_SETUP, "Section IV", "labels to train on, one positive and one negative for each ray and pair",
          ("train.spheres:SphereSamples", "stereo.volume:camera_pairs"), "06_sweepnet", "92 M", _labels),
    Claim(_SETUP, "Section IV", "MC-CNN's training pairs", ("train.patches:PatchSamples", "train.recipes:RECIPES"),
          "05_mccnn", "40 M × 14 epochs", _patches),
    Claim(_SETUP, "Table I", "SweepNet's layers", ("stereo.sweepnet:SweepNet",), "06_sweepnet",
          f"{len(_LAYERS)} layers", _table_one),
    _formula("Section III-A, Fig. 2a", "x = A(Π(X; Φ))",
             ("geometry.camera:OcamCamera.project", "geometry.camera:OcamCamera.unproject"),
             "01_fisheye_model", formulas.projection),
    _formula("Section III-A", "M(Θ), ⋆ and inverse", ("geometry.pose:Pose.from_vector", "geometry.pose:Pose.inverse"),
             "02_rig_calibration", formulas.poses),
    _formula("Section III-A, Fig. 2b", "the sum of squares that calibration minimises",
             ("calibrate.rig:calibrate_rig", "calibrate.bundle:Bundle.residuals"), "02_rig_calibration",
             formulas.reprojection),
    _formula("Section III-B", "ρ(p), mirrored and turned by 90°",
             ("geometry.sphere:SphereGrid.rays",), "03_sphere_sweep",
             formulas.rays),
    _formula("Section III-B", "d_n = n / (D_min (N − 1))", ("geometry.sphere:SphereGrid.inverse_depths",),
             "03_sphere_sweep", formulas.spheres),
    _formula("Eq. 1, Fig. 3", "spherical images, d_0 = 2⁻²³", ("stereo.sweep:SphereSweep.warp",), "03_sphere_sweep",
             formulas.spherical_images),
    _formula("Eq. 2, Fig. 4", "mean cost over camera pairs, with (1 − ZNCC)/2",
             ("stereo.volume:cost_volume", "stereo.zncc:ZNCC"), "04_zncc", formulas.mean_cost),
    _formula("Section III-B", "n* = argmin C(p, n)", ("stereo.depth:winner_takes_all",), "04_zncc", formulas.winner),
    _formula("Eq. 3", "n̂ of the labels", ("geometry.sphere:SphereGrid.depth_to_index", "train.spheres:SphereSamples"),
             "06_sweepnet", formulas.true_index),
    _formula("Eq. 4", "binary cross-entropy", ("train.spheres:SphereObjective",), "06_sweepnet", formulas.loss),
    _formula("Eq. 5", "error and its five figures",
             ("stereo.metrics:error_map", "stereo.metrics:index_error"), "08_evaluation",
             formulas.errors),
)  # fmt: skip

_UNSAID, _NO_CODE = "not stated", "not released"
_PRESET = 'RECIPES["sweepnet"]["paper"]'

DIFFERENCES = tuple(
    Difference(*row)
    for row in (
        ("camera pairs", "all unordered pairs", "the four adjacent, in order", "code", "", 'cost_volume(pairs="all")',
         ("stereo.volume:cost_volume", "stereo.volume:camera_pairs")),
        ("panorama's axes", "ρ = (cosφ cosθ, sinφ, cosφ sinθ)", "centre along +z, right is +x", "code", "", "",
         ("geometry.sphere:SphereGrid.rays",)),
        ("ray of a pixel", _UNSAID, "half a pixel beside its centre; OmniMVS's rows from end to end", "own",
         "its centre", 'SphereGrid.released(code="sweepnet")', ("geometry.sphere:SphereGrid.released",)),
        ("sphere 0", "d = 2⁻²³", "d = 2⁻⁵²", "paper", "", "", ("stereo.sweep:SphereSweep.pixels",)),
        ("seam in SweepNet", "circular columns for the input alone", "the same", "own", "in every layer",
         "SweepNet(wrap=False)", ("stereo.sweepnet:SweepNet",)),
        ("batch normalisation", "none in Table I", "in every layer but the last", "code",
         "for training; `fold` makes Table I's network of it", "SweepNetRecipe(batch_norm=False)",
         ("train.recipes:SweepNetRecipe", "stereo.sweepnet:SweepNet.fold")),
        ("seam in SGM", _UNSAID, "paths end there", "own", "paths go on", "sgm(wrap=False)", ("stereo.sgm:sgm",)),
        ("SGM's paths", _UNSAID, "8, summed", "code", "", "sgm(paths=4)", ("stereo.sgm:sgm",)),
        ("SGM where nothing is seen", _UNSAID, "C++ passes NaN on, CUDA leaves it out", "own", "infinitely expensive",
         "", ("stereo.sgm:sgm",)),
        ("true index", "rounded for labels; the same symbol in Eq. 5", "not rounded in evaluation", "both",
         "rounded for labels, not in evaluation", "", ("stereo.metrics:error_map", "train.spheres:SphereSamples")),
        ("rays evaluated", _UNSAID, "0 ≤ n̂ ≤ N, without small holes of the depth", "own",
         "0 ≤ n̂ < N; a missing estimate counts 100 %", "index_error(valid=known)", ("stereo.metrics:index_error",)),
        ("sub-index", "none", "none", "both", "in evaluation; `estimate_depth` refines", "sweep_depth(subindex=False)",
         ("stereo.pipeline:sweep_depth",)),
        ("gray values", "zero mean, unit variance", "over the pixels of the lens circle", "code", "", "",
         ("stereo.sweep:SphereSweep.prepare",)),
        ("rays that a camera misses", "not considered", "cost NaN, left out of the mean", "code", "", "",
         ("stereo.volume:cost_volume",)),
        ("poses", "Θ* from rig to camera", "files from camera to rig", "code", "", "", ("geometry.rig:Rig",)),
        ("unit, nearest depth", _UNSAID, "0.20 and 0.55 m in one file, 0.60 and 1.65 m in another", "code",
         "metres, or the unit given", 'Rig.load(unit="cm")', ("geometry.rig:Rig.load",)),
        ("field of view", "220°", "225.8°; OmniMVS 220°", "paper", "", "OcamCamera(max_fov_deg=225.8)",
         ("geometry.camera:OcamCamera",)),
        ("training SweepNet", "SGD, one negative for each positive; batch not stated", _NO_CODE, "own",
         "AdamW, augmented, more negatives of the same weight, also on spheres without positives", _PRESET,
         ("train.recipes:RECIPES",)),
        ("MC-CNN", "variant not stated", _NO_CODE, "own", "fast", 'MCCNN(variant="accurate")', ("stereo.mccnn:MCCNN",)),
        ("ZNCC at the rim of a lens", _UNSAID, _NO_CODE, "own", "the patch's pixels that both see", "",
         ("stereo.zncc:ZNCC",)),
    )
)  # fmt: skip


# ---- The ledger as text


def ledger(results: Record | None = None) -> str:
    """Return the reproduction ledger in Markdown.

    Parameters
    ----------
    results : dict, optional
        What `Evaluation.results` returns, or the content of results.json; without, what needs them is not evaluated.

    Returns
    -------
    str
        Links to notebooks are relative to the repository's root.
    """
    found = [(claim, claim.finding(results)) for claim in CLAIMS]
    parts = [f"{_provenance(results)}\n\n{_rules()}\n\n**In all: {_counts(finding for _, finding in found)}.**\n"]
    for group in dict.fromkeys(claim.group for claim in CLAIMS):
        members = [pair for pair in found if pair[0].group == group]
        rows = [_claim_row(claim, finding) for claim, finding in members]
        table = _table(["claim", "where", "paper", "ours", "verdict"], rows)
        parts.append(_folded(f"{group}: {_counts(finding for _, finding in members)}", table, group == _CLAIMS))
    heads = ["", "the paper's text", "the released code", "here", "otherwise", "where"]
    table = _table(heads, map(_difference_row, DIFFERENCES))
    parts.append(_folded("Where the paper's text and the authors' released code differ, and what we do", table))
    return "\n".join(parts)


def split_at_markers(path: str | Path) -> tuple[str, str]:
    """Return a Markdown file's text up to where its ledger begins, and from where it ends; both with their marker.

    Raises
    ------
    OmnistereoError
        If the file cannot be read or does not hold each of the two `MARKERS` once, in their order.
    """
    try:
        text = read_bytes(path).decode()
    except UnicodeDecodeError:
        raise OmnistereoError(f"{path} is no text in UTF-8: give a Markdown file") from None
    first, last = MARKERS
    if text.count(first) != 1 or text.count(last) != 1 or text.index(first) > text.index(last):
        raise OmnistereoError(
            f"{path} holds {text.count(first)} × {first} and {text.count(last)} × {last}: "
            "expected one line of each, in this order, where the ledger is to stand"
        )
    return text[: text.index(first) + len(first)], text[text.index(last) :]


def write_ledger(path: str | Path, results: Record | None = None) -> None:
    """Replace what stands between the two `MARKERS` of a Markdown file by the ledger, whole or not at all.

    Raises
    ------
    OmnistereoError
        As `split_at_markers`, or if the file cannot be written.
    """
    before, after = split_at_markers(path)
    text = f"{before}\n{ledger(results)}{after}"
    with atomic_write(path) as temporary:
        temporary.write_bytes(text.encode())


def _provenance(results: Record | None) -> str:
    made = "Made by `python -m course ledger`, never typed"
    if results is None:
        return f"{made}; no results were given."
    frames = ", ".join(f"{len(frames)} of {name}" for name, frames in sorted(results["frames"].items()))
    weights = "".join(f", {name} `{digest[:12]}`" for name, digest in sorted(results["weights"].items()))
    settings = f"settings `{config_checksum(results)[:12]}`"
    return f"{made}. Results: frames {frames}; {_scale_text(results['config'])}; checksums: {settings}{weights}."


def _rules() -> str:
    return (
        "Errors are compared as ratios to ZNCC's in the same light, since the data differ. *Reproduced*: within "
        f"{_PERCENT} of the paper's; an order that holds wherever it does in the paper; a formula that the library "
        f"follows to {EXACT:g}; the same setting. *Trend reproduced*: ratios on the same side of 1, an order that "
        "holds in more than half of these places; at most that, where the paper shows a picture and no figure. "
        "*Differs*: neither. *Not evaluated*: not in these results, or not at the paper's scale."
    )


def _counts(findings: Iterable[Finding]) -> str:
    counts = Counter(finding.verdict for finding in findings)
    return ", ".join(f"{counts[verdict]} {verdict}" for verdict in get_args(Verdict) if counts[verdict])


def _folded(title: str, table: str, is_open: bool = False) -> str:
    return f"<details{' open' * is_open}><summary>{_escaped(title)}</summary>\n\n{table}\n</details>\n"


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [heads, ["---"] * len(heads), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _claim_row(claim: Claim, finding: Finding) -> list[str]:
    notebook = f"[{claim.notebook[:2]}](notebooks/{claim.notebook}.ipynb)"
    verdict = f"{finding.verdict}\n{finding.reason}" if finding.reason else finding.verdict
    text = claim.text if claim.source == claim.group else f"{claim.source}: {claim.text}"
    cells = [text, claim.paper, finding.ours, verdict]
    text, *others = map(_cell, cells)
    return [text, f"{_code(claim.where)} · {notebook}", *others]


def _difference_row(difference: Difference) -> list[str]:
    follows = "" if difference.follows == "own" else difference.follows
    here = ": ".join(filter(None, (follows, difference.here)))
    option = f"`{difference.option}`" if difference.option else ""
    cells = map(_cell, (difference.topic, difference.paper, difference.code, here))
    return [*cells, option, _code(difference.where)]


def full_name(where: str) -> str:
    """Return the full name of what a row names, such as omnistereo_lib.stereo.sgm.sgm."""
    name = where.replace(":", ".")
    return name if name.startswith("render.") else f"omnistereo_lib.{name}"


def _code(where: Sequence[str]) -> str:
    return ", ".join(f"`{name.replace(':', '.')}`" for name in where)


def _cell(text: str) -> str:
    """Return a cell of a Markdown table: the first line, and the others small."""
    first, _, rest = _escaped(text).partition("\n")
    return f"{first}<br><sub>{rest}</sub>" if rest else first


def _escaped(text: str) -> str:
    return html.escape(text, quote=False).replace("|", "\\|")
