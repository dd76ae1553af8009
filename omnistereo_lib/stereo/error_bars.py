"""Error bars of depth, σ and a bound, from how the evidence of a ray is spread over the spheres.

Errors of stereo have long tails: one number cannot say both how far two thirds of the rays are off
and how far nearly all are. So there are two, each the exponential of a weighted sum of a few
properties of the ray. `python -m workshop error-bars` fits the weights by the pinball loss and
judges them on frames that it has not fitted; `error_bars.json` holds them.
"""

from collections.abc import Mapping
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
from omnistereo_lib.stereo.threads import PART, map_threads

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
    method: Method,
    sweep: SphereSweep,
    volume: Tensor,
    smooth: Tensor,
    index: Tensor,
    confidence: Tensor,
) -> ErrorBars | None:
    """Return the error bars of a depth; None for a method that has none.

    Where the rig states its `deviations`, what they do to the depth is added, as variances are.

    Args:
        volume, smooth: Costs (H, W, N), and those that depth was read from, see `Method.smooth`.
        index, confidence: (H, W), of `Method.read_out`.
    """
    if (fitted := weights_of(method)) is None:
        return None
    grid = sweep.grid
    costs = (volume, smooth) if "cost" in fitted["sigma"] else None
    spread = distribution(smooth, index, fitted["temperature"])
    known = properties(spread, index, confidence, costs, grid)
    sigma, bound = (np.exp(weighted(fitted[name], known)) for name in ("sigma", "bound"))
    bound = np.maximum(sigma, bound)
    # In 1/m; the truth is taken to lie within the spheres.
    per_sphere = grid.step * grid.num_spheres / _SPHERES
    sigma, bound, at = sigma * per_sphere, bound * per_sphere, index.cpu().numpy()
    if sweep.rig.deviations:
        # What the uncertain poses do to the depth is independent of the matching, so variances add:
        # √(a² + b²), twice as much in the bound.
        rays, inverse = grid.rays(), grid.index_to_inverse_depth(at)
        seen = sweep.rig.sees(rays, inverse)
        moved = np.nan_to_num(calibration_deviation(sweep.rig, rays, inverse, seen))
        sigma, bound = np.hypot(sigma, moved), np.hypot(bound, 2 * moved)
    reach = np.maximum(at, grid.num_spheres - 1 - at) * grid.step
    second = np.where(spread[3] > SECOND_MASS, grid.index_to_inverse_depth(spread[4]), np.nan)
    # Of costs, a second surface is no better than one bar: see the measurement.
    if not method.reads_out:
        second = np.full_like(second, np.nan)
    return ErrorBars(*(x.astype(np.float32) for x in (sigma, np.minimum(bound, reach), second)))


def distribution(volume: Tensor, index: Tensor, temperature: float) -> Floats:
    """Return `distribution_by_torch` of costs (H, W, N), computed some rows at a time."""
    radius = max(1.0, volume.shape[-1] / _CELLS)

    def read(rows: Tensor, at: Tensor) -> Tensor:
        on_cpu = rows.device.type == "cpu"
        compute = distribution_numba.distribution if on_cpu else distribution_by_torch
        return compute(rows.float(), at.float(), temperature, radius)

    height = max(1, PART // volume[0].numel())
    parts = map_threads(read, volume.split(height), index.split(height))
    return torch.cat(list(parts), 1).cpu().numpy()


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
    spread: Floats,
    index: Tensor,
    confidence: Tensor,
    costs: tuple[Tensor, Tensor] | None,
    grid: SphereGrid,
) -> dict[str, NDArray[Any]]:
    """Return what tells the error of a ray, by name, each (H, W).

    Args:
        spread: Of `distribution`.
        costs: (H, W, N), before and after they are smoothed; None: without what these tell.
    """
    unit = _SPHERES / grid.num_spheres
    at = np.nan_to_num(index.cpu().numpy())
    known = {
        "constant": np.ones_like(at),
        "spread": np.log(unit * spread[0] + 0.1),
        "spread of the peak": np.log(unit * spread[2] + 0.1),
        "mass beside the peak": np.log(np.maximum(1 - spread[1], 0) + 2e-3),
        "second mass": spread[3],
        "range of 3 x 3 rays": np.log(unit * range_around(at, 3) + 0.1),
        "range of 7 x 7 rays": np.log(unit * range_around(at, 7) + 0.1),
        "index": np.log(unit * at + 1),
        "confidence": np.log(np.nan_to_num(confidence.cpu().numpy()) + 0.01),
        "swept": np.full_like(at, -np.log(grid.min_depth)),
    }
    if costs is not None:
        nearest = index.nan_to_num().round().long()[..., None]
        raw, best = (
            cost.gather(-1, nearest)[..., 0].nan_to_num().float().cpu().numpy() for cost in costs
        )
        known["cost"] = raw
        # By how much infinity costs more. Where that is little, the ray may as well be of the sky,
        # and then it is off by as much as it was found to be near.
        far = costs[1][..., : max(1, grid.num_spheres // _CELLS)].nan_to_num(_MUCH).amin(-1)
        gap = np.log1p((far.float().cpu().numpy() - best).clip(0, _MUCH))
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
