"""Error bars of depth, σ and a bound, from how the evidence of a ray is spread over the spheres.

Errors of stereo have long tails: one number cannot say both how far two thirds of the rays are off
and how far nearly all are. So there are two, each the exponential of a weighted sum of a few
properties of the ray. `python -m workshop error-bars` fits the weights by the pinball loss and
judges them on frames that it has not fitted; `error_bars.json` holds them.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from omnistereo_lib.files import read_data
from omnistereo_lib.geometry.sensitivity import calibration_deviation
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.kernels import distribution_numba
from omnistereo_lib.stereo.methods import Method
from omnistereo_lib.stereo.sweep import SphereSweep

# Shares of the rays: within σ and within the bound, as of a Gaussian within its σ and its 2 σ.
WITHIN = (0.683, 0.954)
# A second surface is told with this share of the evidence: one of the two is right in 9 of 10.
SECOND_MASS = 0.1
# Lengths are counted in spheres of a sweep of so many.
_SPHERES = 96
# Windows in a sweep, as those of `local_mean`.
_CELLS = 32
# A cost that no ray reaches: infinity is out of the question.
_MUCH = 1e3
Floats = NDArray[np.float32]


class ErrorBars(NamedTuple):
    """Of each ray, (H, W), in 1/m; NaN where it has none."""

    sigma: Floats  #: 68 % of the rays are off by at most this much
    bound: Floats  #: 95 % are
    second: Floats  #: inverse depth of a second surface that has a tenth of the evidence or more


@cache
def weights() -> dict[str, Any]:
    """Return the weights of each method that has any, with where they were measured."""
    found: dict[str, Any] = read_data(Path(__file__).with_suffix(".json"))
    return found


def weights_of(method: Method) -> Mapping[str, Any] | None:
    """Return the weights of a method; None for one that was not measured, or with other weights."""
    known: Mapping[str, Mapping[str, Any]] = weights()["methods"]
    return None if method.weights else known.get(method.base)


def error_bars(
    method: Method, sweep: SphereSweep, index: Floats, confidence: Floats, evidence: Floats
) -> ErrorBars | None:
    """Return the error bars of a depth; None for a method that has none.

    Where the rig states its `deviations`, what they do to the depth is added, as variances are.

    Args:
        index, confidence: (H, W), of `Method.read_out`.
        evidence: Of `evidence_of`.
    """
    if (fitted := weights_of(method)) is None:
        return None
    grid = sweep.grid
    known = properties(evidence, index, confidence, grid)
    sigma, bound = (np.exp(weighted(fitted[name], known)) for name in ("sigma", "bound"))
    bound = np.maximum(sigma, bound)
    # In 1/m; the truth is taken to lie within the spheres.
    per_sphere = grid.step * grid.num_spheres / _SPHERES
    sigma, bound = sigma * per_sphere, bound * per_sphere
    if sweep.rig.deviations:
        # What the uncertain poses do to the depth is independent of the matching, so variances add:
        # √(a² + b²), twice as much in the bound.
        rays, inverse = grid.rays(), grid.index_to_inverse_depth(index)
        seen = sweep.rig.sees(rays, inverse)
        moved = np.nan_to_num(calibration_deviation(sweep.rig, rays, inverse, seen))
        sigma, bound = np.hypot(sigma, moved), np.hypot(bound, 2 * moved)
    reach = np.maximum(index, grid.num_spheres - 1 - index) * grid.step
    second = np.where(evidence[3] > SECOND_MASS, grid.index_to_inverse_depth(evidence[4]), np.nan)
    # Of costs, a second surface is no better than one bar: see the measurement.
    if not method.reads_out:
        second = np.full_like(second, np.nan)
    return ErrorBars(*(x.astype(np.float32) for x in (sigma, np.minimum(bound, reach), second)))


def evidence_of(method: Method, costs: Sequence[Tensor], index: Tensor) -> Tensor:
    """Return what the costs of rays tell of their errors, (0, 5 or 7, H, W): `distribution`, then
    the cost of the depth, and how much more infinity costs.

    Args:
        costs: (H, W, N) each: as they are, and if the method smooths them, smooth.
        index: (H, W), of `Method.read_out`.
    """
    if (fitted := weights_of(method)) is None:
        return index.new_empty(0, *index.shape)
    spread = distribution(costs[-1], index, fitted["temperature"])
    return torch.cat([spread, costs_at(costs, index)]) if "cost" in fitted["sigma"] else spread


def costs_at(costs: Sequence[Tensor], index: Tensor) -> Tensor:
    """Return the cost of the depth, and how much more infinity costs once smooth, (2, H, W)."""
    nearest = index.nan_to_num().round().long()[..., None]
    raw, best = (cost.gather(-1, nearest)[..., 0].nan_to_num().float() for cost in costs)
    far = costs[1][..., : max(1, costs[1].shape[-1] // _CELLS)].nan_to_num(_MUCH).amin(-1)
    return torch.stack([raw, (far.float() - best).clip(0, _MUCH)])


def distribution(volume: Tensor, index: Tensor, temperature: float) -> Tensor:
    """Return `distribution_by_torch` of costs (H, W, N)."""
    on_cpu = volume.device.type == "cpu"
    compute = distribution_numba.distribution if on_cpu else distribution_by_torch
    return compute(volume.float(), index.float(), temperature, max(1.0, volume.shape[-1] / _CELLS))


def distribution_by_torch(
    volume: Tensor, index: Tensor, temperature: float, radius: float
) -> Tensor:
    """How the evidence of each ray is spread over the spheres, (5, H, W), in spheres or masses.

    p = 1 − C of probabilities (temperature 0), else p ∝ exp(−C / T): spread √Σ p (n − n*)² around
    the estimate n*, mass of the window around it, spread within it, mass of the heaviest other
    window, and the mean sphere of that one.
    """
    N = int(volume.shape[-1])
    n, half = torch.arange(N, device=volume.device), int(radius)
    if temperature == 0:
        p = 1 - volume.nan_to_num(1.0)
    else:
        p = (-volume.nan_to_num(torch.inf) / temperature).softmax(-1)
    p = p / p.sum(-1, keepdim=True)
    off = n - index[..., None]
    # A window has soft ends: spheres count fully within the radius, then less over one sphere.
    share = (radius + 1 - off.abs()).clamp(0, 1)
    mass = (p * share).sum(-1)
    inside = ((p * share * off.square()).sum(-1) / mass).sqrt()
    # What the window leaves, summed over windows of whole spheres.
    rest = p.where(off.abs() > radius + 1, 0.0)
    padded = torch.nn.functional.pad(rest, (half, half))
    windows = padded.unfold(-1, 2 * half + 1, 1)  # (H, W, N, 2 half + 1)
    second, middle = windows.sum(-1).max(-1)
    around = (n - middle[..., None]).abs() <= half
    spread, place = (p * off.square()).sum(-1).sqrt(), (rest * around * n).sum(-1) / second
    return torch.stack([spread, mass, inside, second, place])


def properties(
    evidence: Floats, index: Floats, confidence: Floats, grid: SphereGrid
) -> dict[str, NDArray[Any]]:
    """Return what tells the error of a ray, by name, each (H, W); see `error_bars`."""
    unit = _SPHERES / grid.num_spheres
    at, (spread, mass, inside, second, _, *costs) = np.nan_to_num(index), evidence
    known = {
        "constant": np.ones_like(at),
        "spread": np.log(unit * spread + 0.1),
        "spread of the peak": np.log(unit * inside + 0.1),
        "mass beside the peak": np.log(np.maximum(1 - mass, 0) + 2e-3),
        "second mass": second,
        "range of 3 x 3 rays": np.log(unit * range_around(at, 3) + 0.1),
        "range of 7 x 7 rays": np.log(unit * range_around(at, 7) + 0.1),
        "index": np.log(unit * at + 1),
        "confidence": np.log(np.nan_to_num(confidence) + 0.01),
        "swept": np.full_like(at, -np.log(grid.min_depth)),
    }
    if costs:
        # Where infinity costs little more, the ray may as well be of the sky, and then it is off by
        # as much as it was found to be near.
        known["cost"], gap = costs[0], np.log1p(costs[1])
        known["gap to infinity"] = gap
        for name in ("index", "range of 7 x 7 rays"):
            known[f"gap x {name}"] = gap * known[name]
    return known


def weighted(fitted: Mapping[str, float], known: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
    """Return the sum of the properties of each ray with their weights, (H, W)."""
    return np.sum([weight * known[name] for name, weight in fitted.items()], axis=0)


def range_around(values: NDArray[Any], side: int) -> NDArray[Any]:
    """Return the largest minus the smallest of the side × side rays around each ray."""
    import cv2

    reach = side // 2
    wide, kernel = np.pad(values, ((0, 0), (reach, reach)), "wrap"), np.ones((side, side))
    return (cv2.dilate(wide, kernel) - cv2.erode(wide, kernel))[:, reach:-reach]
