"""Which rays are hard: the errors of a panorama by depth, at depth edges, on thin objects, by the cameras that see.

Everything is decided on the true index n̂, so that all methods are judged on the same rays.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.stereo.metrics import error_map
from omnistereo_lib.stereo.sweep import SphereSweep

FIGURES = (">1", ">3", ">5", "MAE", "RMS")
STRATA = ("all", "sky", "far", "middle", "near", "at edges", "off edges", "thin")  # and "seen by 0", 1 …
SUMS = ("rays", ">1", ">3", ">5", "sum", "squares")
JUMP = 5.0  # % of the range swept: taking one surface for the other is wrong by all of the paper's figures
EDGE_PX = 4  # half of a 9 × 9 patch: one that is centred nearer holds both surfaces
THIN_DEG = 3.0  # as wide as a post of 15 cm at 3 m


def find_strata(gt_index: ArrayLike, sweep: SphereSweep) -> dict[str, NDArray[np.bool_]]:
    """Say which rays belong to which part of a panorama.

    Parameters
    ----------
    gt_index : array, shape (H, W)
        Ground-truth index n̂, not rounded; NaN unknown.
    sweep : SphereSweep

    Returns
    -------
    dict of bool arrays, shape (H, W)
        "all". "sky" (infinitely far), "far", "middle" and "near": thirds of the inverse depth swept, beyond 3,
        from 3 to 1.5, and within 1.5 times D_min. "at edges": a jump of n̂ between two neighbours by more than
        `JUMP` % of N within `EDGE_PX` pixels, around the seam; "off edges": the others. "thin": what an opening
        of n̂ lowers by more than that (`thin_objects`). "seen by k": the point at the true depth is in the field
        of view of k cameras, for every k; what stands in between is not looked at.
    """
    gt_index = np.asarray(gt_index, np.float64)
    share = gt_index / (sweep.grid.num_spheres - 1)  # of the inverse depth swept
    edges = near_edges(gt_index, sweep.grid.num_spheres)
    cameras = range(len(sweep.rig))
    seen = np.sum([sweep.pixels(camera, gt_index)[1] for camera in cameras], axis=0)
    return {
        "all": np.ones(gt_index.shape, bool),
        "sky": share == 0,
        "far": (share > 0) & (share < 1 / 3),
        "middle": (share >= 1 / 3) & (share < 2 / 3),
        "near": share >= 2 / 3,
        "at edges": edges,
        "off edges": ~edges,
        "thin": thin_objects(gt_index, sweep.grid.num_spheres),
        **{f"seen by {k}": seen == k for k in range(len(sweep.rig) + 1)},
    }


def near_edges(gt_index: NDArray[np.float64], num_spheres: int) -> NDArray[np.bool_]:
    """Return the rays, shape (H, W), within `EDGE_PX` pixels of a jump of n̂ by more than `JUMP` % of N."""
    from scipy.ndimage import maximum_filter

    limit = JUMP / 100 * num_spheres
    across = np.abs(gt_index - np.roll(gt_index, -1, 1)) > limit  # NaN is no jump
    down = np.abs(np.diff(gt_index, axis=0)) > limit
    beside = across | np.roll(across, 1, 1)
    beside[:-1] |= down
    beside[1:] |= down
    return maximum_filter(beside.astype(np.uint8), 2 * EDGE_PX - 1, mode=("nearest", "wrap")).astype(bool)


def thin_objects(gt_index: NDArray[np.float64], num_spheres: int) -> NDArray[np.bool_]:
    """Return the rays, shape (H, W), of what stands out from its background and is narrower than a few degrees.

    A gray-value opening of n̂ (near is high) with a square removes what cannot hold the square. Its side is
    2 r + 1 pixels, r = `THIN_DEG` / 2 in pixels, at least 1: 3 at W = 320, 5 at 600, 11 at 1200. A ray is thin
    where that lowers n̂ by more than `JUMP` % of N. Unknown rays count as near, so that nothing is thin for
    touching them.
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    side = 2 * max(1, round(gt_index.shape[1] * THIN_DEG / 720)) + 1
    known = np.where(np.isnan(gt_index), np.inf, gt_index)
    opened = maximum_filter(minimum_filter(known, side, mode=("nearest", "wrap")), side, mode=("nearest", "wrap"))
    return gt_index - opened > JUMP / 100 * num_spheres


def error_sums(
    index: ArrayLike, gt_index: ArrayLike, num_spheres: int, strata: Mapping[str, NDArray[np.bool_]]
) -> dict[str, dict[str, float]]:
    """Sum the errors of a panorama over each stratum; sums of several frames add up to those of all.

    Parameters
    ----------
    index, gt_index, num_spheres
        As in `index_error`, which also says which rays are evaluated and what a missing estimate counts.
    strata : mapping of name to bool array, shape (H, W)

    Returns
    -------
    dict of dict
        For each stratum "rays": their number; ">1", ">3", ">5": how many have such an error e (Eq. 5);
        "sum", "squares": Σ e and Σ e².
    """
    gt_index = np.asarray(gt_index, np.float64)
    error = error_map(index, gt_index, num_spheres)
    error = np.where(np.isnan(error), 100.0, error)
    evaluated = (gt_index >= 0) & (gt_index < num_spheres)
    return {name: _sums(error[evaluated & stratum]) for name, stratum in strata.items()}


def _sums(error: NDArray[np.float64]) -> dict[str, float]:
    above = {f">{limit}": int(np.count_nonzero(error > limit)) for limit in (1, 3, 5)}
    return {"rays": error.size, **above, "sum": float(error.sum()), "squares": float((error**2).sum())}


def figures(sums: ArrayLike) -> NDArray[np.float64]:
    """Return the paper's five `FIGURES`, shape (..., 5), of `SUMS`, shape (..., 6); NaN where there are no rays."""
    rays, above, total, squares = np.split(np.asarray(sums, np.float64), [1, 4, 5], axis=-1)
    with np.errstate(invalid="ignore"):
        return np.concatenate([100 * above / rays, total / rays, np.sqrt(squares / rays)], -1)
