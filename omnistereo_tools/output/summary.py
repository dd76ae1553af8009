"""The result of one frame in plain sentences."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.stereo.depth import Depth
from omnistereo_lib.stereo.metrics import index_error
from omnistereo_tools.judge.trust import may_be_nearer
from omnistereo_tools.output.points import Limits

GOOD, _MISFIT = 20.0, 50.0  # percent of rays that are doubtful, at most
# columns: with 160 and the right rig, 51 % of a street by ZNCC + SGM are doubtful; with 320, 16 %
_COARSE = 320
# percent of rays at one distance, within a sphere of 192; of rendered scenes at most 78 are
_SAME = 95.0
_FEW = 0.002  # of the sphere: less is noise, not a thing
_NEAR = 0.1  # of the rays
_UNSEEN = 0.05  # of the rays: worth saying
_NEARER = 0.9  # of a depth: worth saying
_MARGIN = 0.8  # of the nearest depth: room for what comes nearer in the next frame


def fits(doubtful_percent: float) -> bool:
    """Return whether the rig and the images seem to fit, by how many percent of rays are doubtful.

    Measured on the first frame of sunny, cloudy, indoor and aerial, 320 columns, VolumeNet: 7, 7,
    34 and 2 % with the right rig; 33, 38, 67 and 31 % with one image of another moment, 40, 40, 60
    and 17 % with one upside down, 64, 63, 77 and 59 % with two swapped. So this tells the gross
    mistakes only; `first_look.image_doubts` tells others.
    """
    return doubtful_percent <= _MISFIT


def verdict(
    doubtful_percent: float, columns: int, of_what: str = "", doubt: str | None = None
) -> str:
    """Return the verdict on a depth, with the number that carries it, or with what is wrong."""
    if doubt:
        return f"Bad: {doubt}."
    number = f"{doubtful_percent:.0f} % of rays are doubtful{of_what}"
    if not fits(doubtful_percent):
        coarse = f"{columns} columns are too few, or " if columns < _COARSE else ""
        return f"Bad: {number}: {coarse}the rig and the images may not fit."
    if doubtful_percent > GOOD:
        return f"Fair: {number}."
    return f"Good: {100 - doubtful_percent:.0f} % of rays are sure{of_what}."


def depth_sentences(
    depth: Depth, limits: Limits, doubtful: NDArray[np.bool_], doubt: str | None = None
) -> list[str]:
    """Return the verdict, the depths found, what is doubtful or left out, and advice on spheres."""
    rays, known = depth.index.size, int(depth.valid.sum())
    keep = limits.keep(depth)
    far = int((depth.depth > limits.max_depth).sum())
    # The nearest of many noisy depths is too near: on full spheres of nine street frames by 10 to
    # 13 %. At the far ends of their bars it was within 6 % (in two rooms still 20, 40 % too near).
    nearest = nearest_depth(depth, keep & ~doubtful, beyond=1.0)
    found = f"the nearest sure thing is {metres(nearest)} away"
    if not (keep & ~doubtful).any():
        found = "no ray within the limits is sure" if keep.any() else "no ray is within the limits"
    share = doubt_shares(depth.depth, doubtful)[0]
    sentences = [
        _one_distance(depth) or verdict(share, depth.grid.width, doubt=doubt),
        (
            f"{100 * known / rays:.0f} % of {rays} rays have a depth, sure or doubtful: {found}, "
            f"the median depth is {metres(float(np.nanmedian(depth.depth)))}."
        ),
        *_doubt_sentence(depth, doubtful, nearest_depth(depth, keep), nearest),
        (
            f"The point cloud uses {int(keep.sum())} rays. Left out: {far} beyond"
            f" {metres(limits.max_depth)} (--max-depth)."
        ),
    ]
    # Where the rig does not fit, another nearest depth makes nothing better.
    return sentences + (_sphere_advice(depth, keep, nearest) if fits(share) and not doubt else [])


def depth_facts(
    depth: Depth, limits: Limits, doubtful: NDArray[np.bool_], gt_index: NDArray[Any] | None
) -> list[tuple[str, str]]:
    """Return the numbers of the sentences as names and values."""
    keep = limits.keep(depth)
    nearest = metres(nearest_depth(depth, keep & ~doubtful, beyond=1.0))
    share, of_near, near = doubt_shares(depth.depth, doubtful)
    used = f"{keep.sum()}, {100 * keep.mean():.0f} % of rays, up to {metres(limits.max_depth)}"
    facts = [
        ("Nearest sure thing", f"{nearest}; spheres from {depth.grid.min_depth:.3g} m"),
        ("Median depth", metres(float(np.nanmedian(depth.depth)))),
        ("Doubtful rays", f"{share:.0f} %; of rays up to {metres(near)}, {of_near:.0f} %"),
        ("Points", used),
    ]
    if gt_index is not None:
        error = index_error(depth.index, gt_index, depth.grid.num_spheres)
        facts.append(("Error", f"{error['MAE']:.2g} % of the range, mean"))
    return facts


def _one_distance(depth: Depth) -> str | None:
    """Return the verdict on a depth that is the same all around, whatever its confidence."""
    index = depth.index[depth.valid]
    middle = float(np.median(index))
    share = 100 * float((np.abs(index - middle) <= depth.grid.num_spheres / 192).mean())
    if share < _SAME:
        return None
    distance = metres(float(depth.grid.index_to_depth(middle)))
    return f"Bad: {share:.0f} % of rays are at one distance, {distance}: nothing is told apart."


def _sphere_advice(depth: Depth, keep: NDArray[np.bool_], nearest: float) -> list[str]:
    """Return what another nearest depth would do, if it would do something."""
    grid = depth.grid
    # what `propose_min_depth` found is not contradicted at once
    if _MARGIN * nearest > 1.5 * grid.min_depth:
        return [
            f"The spheres begin at {metres(grid.min_depth)}: --min-depth {_MARGIN * nearest:.2g}"
            " would use them better."
        ]
    if (depth.index[keep] >= grid.num_spheres - 1.5).sum() > 10 * _FEW * keep.sum():
        return [
            f"Many rays end on the nearest sphere, {metres(grid.min_depth)}: things may be nearer. "
            f"Try --min-depth {grid.min_depth / 2:.2g}."
        ]
    return []


def _doubt_sentence(
    depth: Depth, doubtful: NDArray[np.bool_], nearest: float, sure: float
) -> list[str]:
    """Return how many of the nearest rays are doubtful; `nearest` counts all, `sure` none."""
    if not (doubtful & depth.valid).any():
        return []
    _, of_near, near = doubt_shares(depth.depth, doubtful)
    nearer = (
        f" If they are right, the nearest thing is {metres(nearest)} away."
        if nearest < _NEARER * sure
        else ""
    )
    unseen = float(may_be_nearer(depth).mean())
    hidden = (
        f" On {100 * unseen:.0f} % only one camera would see a nearer thing."
        if unseen > _UNSEEN
        else ""
    )
    return [
        f"Of the nearest tenth of rays, up to {metres(near)}, {of_near:.0f} % are doubtful."
        f" Doubtful rays stay in the files, marked, and are faded in the images.{hidden}{nearer}"
    ]


def doubt_shares(depth: NDArray[Any], doubtful: NDArray[np.bool_]) -> tuple[float, float, float]:
    """Return how many percent of the rays are doubtful, and of the nearest tenth, and up to which
    depth that goes.

    The depth is in metres, (H, W), NaN where it is unknown.
    """
    near = float(np.nanquantile(depth, _NEAR, method="lower"))
    both = ~np.isnan(depth), depth <= near
    share, of_near = (100 * float(doubtful[rays].mean()) for rays in both)
    return share, of_near, near


def nearest_depth(depth: Depth, keep: NDArray[np.bool_], beyond: float = 0.0) -> float:
    """Return the depth in metres than which 2 ‰ of what the kept rays cover is nearer; NaN without
    any. Each ray counts at its depth, or `beyond` times σ farther.

    A ray covers cos φ: the rows at a pole have as many rays as others, and hardly any sphere.
    """
    if not keep.any():
        return float("nan")
    inverse = (depth.inverse_depth - beyond * np.nan_to_num(depth.sigma))[keep]
    covered = np.broadcast_to(np.cos(depth.grid.phis())[:, None], keep.shape)[keep]
    return float(1 / np.quantile(inverse, 1 - _FEW, weights=covered, method="inverted_cdf"))


def error_sentences(depth: Depth, gt_index: NDArray[Any]) -> list[str]:
    """Return the errors against the ground truth: relative ones, then those of the paper."""
    errors = index_error(depth.index, gt_index, depth.grid.num_spheres)
    truth = depth.grid.index_to_depth(gt_index)
    both = depth.valid & np.isfinite(truth) & np.isfinite(depth.depth)
    both &= truth >= depth.grid.min_depth
    off = np.abs(depth.depth[both] / truth[both] - 1)
    half, most = np.quantile(off, [0.5, 0.9]) if both.any() else (np.nan, np.nan)
    return [
        (
            f"Against the ground truth, half of the rays are within {100 * half:.1f} % of their"
            f" true depth and nine tenths within {100 * most:.0f} %: at 10 m that is"
            f" {10 * half:.2g} m and {10 * most:.2g} m."
        ),
        (
            f"In the terms of the paper, {errors['>1']:.0f} % of rays are off by more than 0.01 of"
            f" the range swept and {errors['>3']:.0f} % by more than 0.03; the mean error is"
            f" {errors['MAE'] / 100:.2g} of it."
        ),
    ]


def metres(depth: float) -> str:
    """Return a depth with two digits, such as "0.85 m" or "12 m"."""
    if not np.isfinite(depth):
        return "infinity" if depth == np.inf else "unknown"
    return f"{depth:.0f} m" if depth >= 10 else f"{depth:.2g} m"
