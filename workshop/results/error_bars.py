"""Fit the error bars of depth on some frames, and judge them on others.

Every frame is computed at 320 × 80 × 96 with its exact rig, and what its rays are told by is kept
in a folder, so that a run resumes. What is judged: how many errors are within σ and within the
bound, at each range, at edges, in each set, and in kinds of scenes that were left out of the fit;
how wide the bars are; and whether their order is that of the errors.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.stats import spearmanr

from omnistereo_lib.dataset import load_dataset
from omnistereo_lib.files import make_folder, write_text
from omnistereo_lib.frame import Frame
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo import error_bars
from omnistereo_lib.stereo.error_bars import (
    WITHIN,
    costs_at,
    distribution,
    properties,
    range_around,
    weighted,
)
from omnistereo_lib.stereo.methods import Method
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_lib.stereo.volume import cost_volume
from workshop.render.image_sets import renew_manifest

DATA = Path("data_samples")
WEIGHTS = Path(error_bars.__file__).with_suffix(".json")
RESULTS = DATA / "results" / "error_bars.json"
WIDTH, HEIGHT, SPHERES = 320, 80, 96
_STREETS, _OTHERS = (706, 781, 881, 931), (731, 831, 906, 981)
FITTED = {
    "sunny": _STREETS,
    "cloudy": _STREETS,
    "rooms": (1001, 1002, 1003, 1004),
    "things": (1001, 1002, 1003, 1004),
    "indoor": (1,),
}
JUDGED = {
    "sunny": _OTHERS,
    "cloudy": _OTHERS,
    "sunset": _OTHERS,
    "rooms": (1005, 1006, 1007, 1008),
    "things": (1005, 1006, 1007, 1008),
    "indoor": (2,),
    "aerial": (756, 871),
}
KINDS = (("sunny", "cloudy", "sunset"), ("rooms",), ("things",), ("indoor",))
_ALWAYS: tuple[str, ...] = ("constant", "spread", "spread of the peak")
_ALWAYS += ("mass beside the peak", "second mass")
_ALWAYS += ("range of 3 x 3 rays", "range of 7 x 7 rays", "index", "confidence")
# Temperature of costs after SGM: of .1 to 8, the truth is likeliest at 2 for ZNCC; the networks'
# costs take the same. VolumeNet's probabilities are right as they are. The range swept halves the
# misses of VolumeNet in rooms that were not fitted, and doubles those of costs among things.
PROPERTIES = {"volumenet": (*_ALWAYS, "swept")}
METHODS = {"volumenet": 0.0, "zncc+sgm": 2.0, "mccnn+sgm": 2.0, "sweepnet+sgm": 2.0}
_SLOW = ("mccnn+sgm", "sweepnet+sgm")  # no cloudy, no sunset
_COSTS = ("cost", "gap to infinity", "gap x index", "gap x range of 7 x 7 rays")
_RAYS, _STEPS, _FLOOR = 40_000, 400, 1e-3  # of the fit; spheres
_ROUNDS, _PULL = 4, 0.8  # of the fit of costs, which balances the ranges


@dataclass(frozen=True, eq=False)
class Rays:
    """Rays of frames whose depth is known exactly, each array (M,) or a mapping of such."""

    known: Mapping[str, NDArray[Any]]  #: of `properties`
    error: NDArray[Any]  #: estimate minus truth, spheres
    depth: NDArray[Any]  #: exact, metres
    edge: NDArray[Any]  #: whether the truth jumps within two rays
    reach: NDArray[Any]  #: spheres to the farther end of the sweep
    of_set: NDArray[Any]  #: name of the set

    def __getitem__(self, chosen: Any) -> "Rays":
        known = {name: values[chosen] for name, values in self.known.items()}
        return Rays(known, *(getattr(self, n)[chosen] for n in list(vars(self))[1:]))

    def widths(self, weights: Mapping[str, Mapping[str, float]]) -> list[NDArray[Any]]:
        """Return σ and the bound of each ray, spheres."""
        sigma, bound = (np.exp(weighted(weights[name], self.known)) for name in ("sigma", "bound"))
        return [sigma, np.minimum(np.maximum(sigma, bound), self.reach)]


def run(out: Path, methods: list[str] | None = None) -> None:
    """Measure, fit and judge methods, print the tables, and store weights and shares."""
    chosen = methods or list(METHODS)
    stored = json.loads(WEIGHTS.read_text()) if WEIGHTS.exists() else {"methods": {}}
    results = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    for name in chosen:
        fitted, judged = (rays_of(name, frames, out) for frames in (FITTED, JUDGED))
        weights = fit(fitted, name)
        results[name] = judge(judged, weights, fitted, name)
        stored["methods"][name] = {"temperature": METHODS[name]} | weights
    stored["measured"] = f"{WIDTH} x {HEIGHT} x {SPHERES}, fitted on {_text(FITTED)}"
    write_text(WEIGHTS, json.dumps(stored, indent=1) + "\n")
    write_text(RESULTS, json.dumps(results, indent=1) + "\n")
    renew_manifest(DATA)


def _text(frames: Mapping[str, tuple[int, ...]]) -> str:
    return "; ".join(f"{name} {', '.join(map(str, numbers))}" for name, numbers in frames.items())


def rays_of(name: str, frames: Mapping[str, tuple[int, ...]], out: Path) -> Rays:
    """Return the rays of all frames of some sets; what was measured before is read."""
    parts = []
    for of_set, numbers in frames.items():
        if name in _SLOW and of_set in ("cloudy", "sunset"):
            continue
        for number in numbers[: 2 if name in _SLOW and frames is JUDGED else None]:
            path = make_folder(out / name) / f"{of_set}_{number}.npz"
            if not path.exists():
                frame = load_dataset(DATA / of_set, split="test").frame(number)
                np.savez(path, **measure(frame, Method.parse(name)))
            with np.load(path) as file:
                parts.append(dict(file) | {"of_set": np.full(len(file["error"]), of_set)})
    joined = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    others = [joined.pop(key) for key in ("error", "depth", "edge", "reach", "of_set")]
    return Rays(joined, *others)


def measure(frame: Frame, method: Method) -> dict[str, Any]:
    """Return properties and errors of the rays of a frame that have an estimate and a truth."""
    grid = SphereGrid(WIDTH, HEIGHT, num_spheres=SPHERES, min_depth=frame.rig.min_depth or 1.0)
    sweep = SphereSweep(frame.rig, grid)
    volume = cost_volume(sweep, frame.images, method.cost_of(sweep), method.pairs)
    smooth = method.smooth(volume)
    index, confidence = method.read_out(smooth, True)
    told = [distribution(smooth, index, METHODS[method.name])]
    if not method.reads_out:
        told.append(costs_at((volume, smooth), index))
    at = index.numpy()
    known = properties(torch.cat(told).numpy(), at, confidence.numpy(), grid)
    truth = frame.gt_index(grid)
    edge = range_around(np.nan_to_num(truth).astype(np.float32), 5) > 0.03 * SPHERES
    usable = np.isfinite(at) & np.isfinite(truth) & (truth >= 0) & (truth < SPHERES)
    reach = np.maximum(at, SPHERES - 1 - at)
    found = {"error": at - truth, "depth": grid.index_to_depth(truth), "edge": edge, "reach": reach}
    return {key: np.float32(values[usable]) for key, values in (known | found).items()}


def fit(rays: Rays, name: str) -> dict[str, dict[str, float]]:
    """Return the weights of σ and of the bound.

    Of costs, the share that each range is fitted to, at edges and away from them, is moved against
    what it came out as, some rounds: else what is far has too little, since no property tells it.
    """
    names = PROPERTIES.get(name, (*_ALWAYS, *_COSTS))
    some = np.random.default_rng(0).permutation(len(rays.error))[:_RAYS]
    X = np.stack([rays.known[key][some] for key in names], -1).astype(np.float64)
    y = np.log(np.abs(rays.error[some]) + _FLOOR)
    of_group = np.digitize(rays.depth[some], (5, 15)) + 3 * (rays.edge[some] > 0)
    found = {}
    for kind, share in zip(("sigma", "bound"), WITHIN, strict=True):
        shares = np.full(6, share)
        values = quantile_weights(X, y, shares[of_group])
        for _ in range(0 if name in PROPERTIES else _ROUNDS - 1):
            held = np.bincount(of_group, y <= X @ values, 6) / np.bincount(of_group, minlength=6)
            shares = np.clip(shares + _PULL * (share - held), 0.3, 0.995)
            values = quantile_weights(X, y, shares[of_group])
        found[kind] = {key: round(float(x), 4) for key, x in zip(names, values, strict=True)}
    return found


def quantile_weights(X: NDArray[Any], y: NDArray[Any], share: NDArray[Any]) -> NDArray[Any]:
    """Return w so that a share of y is below X w: the pinball loss, first column constant."""
    mean, scale = X.mean(0), np.maximum(X.std(0), 1e-6)
    mean[0], scale[0] = 0, 1
    Z, target, level = (torch.from_numpy(a).float() for a in ((X - mean) / scale, y, share))
    w = torch.zeros(X.shape[1], dtype=torch.float32)
    w[0] = target.median()
    w.requires_grad_()
    optimizer = torch.optim.Adam([w], 0.04)
    for step in range(_STEPS):
        optimizer.param_groups[0]["lr"] = 0.04 if step < 0.6 * _STEPS else 0.008
        off = target - Z @ w
        loss = torch.maximum(level * off, (level - 1) * off).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    found = w.detach().numpy() / scale
    found[0] -= found[1:] @ mean[1:]
    return np.asarray(found)


def judge(rays: Rays, weights: Any, fitted: Rays, name: str) -> dict[str, Any]:
    """Print and return how the bars do on rays that were not fitted, in percent."""
    sigma, bound = rays.widths(weights)
    off = np.abs(rays.error)
    some = np.random.default_rng(0).permutation(len(off))[:50_000]
    shares = {key: within(off[of], sigma[of], bound[of]) for key, of in groups(rays)}
    left_out = {}
    for kind in KINDS:
        rest, of = fitted[~np.isin(fitted.of_set, kind)], np.isin(rays.of_set, kind)
        widths = rays[of].widths(fit(rest, name))
        left_out[" ".join(kind)] = within(off[of], *widths)
    found = {
        "rays": len(off),
        "mean sigma": round(100 * float(sigma.mean()) / (SPHERES - 1), 2),
        "mean bound": round(100 * float(bound.mean()) / (SPHERES - 1), 2),
        "rank correlation": round(float(spearmanr(sigma[some], off[some])[0]), 3),
        "within": shares,
        "within, left out of the fit": left_out,
    }
    print(name, json.dumps(found), flush=True)
    return found


def groups(rays: Rays) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Yield each slice that is judged by itself."""
    depth = rays.depth
    yield "all", depth >= 0
    yield "below 5 m", depth < 5
    yield "5 to 15 m", (depth >= 5) & (depth <= 15)
    yield "beyond 15 m", depth > 15
    yield "edges", rays.edge > 0
    yield "away from edges", rays.edge == 0
    for name in dict.fromkeys(rays.of_set):
        yield name, rays.of_set == name


def within(off: NDArray[Any], sigma: NDArray[Any], bound: NDArray[Any]) -> list[int]:
    """Return how many percent of errors are within σ and within the bound."""
    return [round(100 * float(np.mean(off <= width))) for width in (sigma, bound)]


def table() -> str:
    """Return the table of the book: how many errors are within the bars, on frames not fitted."""
    results: dict[str, Any] = json.loads(RESULTS.read_text(encoding="utf-8"))
    slices = ("all", "below 5 m", "5 to 15 m", "beyond 15 m", "edges", "away from edges")
    rows = [f"| method | {' | '.join(slices)} | mean σ | mean bound |", "|---" * 9 + "|"]
    for name, found in results.items():
        shares = ["{} / {} %".format(*found["within"][key]) for key in slices]
        widths = [f"{found[key]:.1f} %" for key in ("mean sigma", "mean bound")]
        rows.append(f"| {name} | {' | '.join([*shares, *widths])} |")
    return "\n".join(rows) + "\n"
