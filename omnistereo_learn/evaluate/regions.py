"""Regions of a panorama: by depth, discontinuities, thin objects, number of cameras.

Regions depend only on the ground-truth index n̂, so that all methods are judged on the same rays.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.stereo.metrics import error_map
from omnistereo_lib.stereo.sweep import SphereSweep

METRICS = (">1", ">3", ">5", "MAE", "RMS")
# Every panorama has these, and "seen by 0", "seen by 1" … besides.
REGIONS = ("all", "sky", "far", "middle", "near", "at edges", "off edges", "thin", "at hand-overs")
SUMS = ("rays", ">1", ">3", ">5", "sum", "squares")
DISCONTINUITY_PERCENT = 5.0  # percent of N; the largest error threshold of the paper
EDGE_PX = 4  # half of a 9 × 9 patch: a patch centred nearer holds both surfaces
HANDOVER_DEG = 3.0  # on either side of the end of a camera's view
THIN_DEG = 3.0  # a post of 15 cm at 3 m is as wide
_FARTHEST = 60.0  # times D_min: points beyond, where there is no parallax, count as being there
# fractions of the way to a point; the first is at D_min or nearer
_SIGHT_STEPS = 1 / np.geomspace(1.05, _FARTHEST, 40)
_BEHIND = 1.05  # times the depth of a surface; less is the slope of the surface itself


def find_regions(gt_index: ArrayLike, sweep: SphereSweep) -> dict[str, NDArray[np.bool_]]:
    """Return the region masks (H, W) of a panorama, given its ground-truth index n̂ (H, W).

    "all". "sky" (infinitely far), "far", "middle" and "near": thirds of the inverse depth swept,
    beyond 3 D_min, from 3 to 1.5 D_min, and nearer. "at edges": `near_edges`; "off edges": all
    others. "thin": `thin_objects`. "at hand-overs": within `HANDOVER_DEG` of where the view of a
    camera ends, so that others take over. "seen by k": the ground-truth point is in the field of
    view of k cameras; occlusion is not tested. "occluded": with occlusion, fewer than two cameras
    see the point, see `occluded_points`; no stereo method can measure it.
    """
    gt_index = np.asarray(gt_index, np.float64)
    N = sweep.grid.num_spheres
    fraction = gt_index / (N - 1)  # 0 to 1 over the swept inverse depth
    edges = near_edges(gt_index, N)
    points = np.nan_to_num(gt_index)  # unknown ones count as far away, so that they end no view
    visible = sweep.rig.sees(sweep.grid.rays(), sweep.grid.index_to_inverse_depth(points))
    count = visible.sum(0)
    return {
        "all": np.ones(gt_index.shape, bool),
        "sky": fraction == 0,
        "far": (fraction > 0) & (fraction < 1 / 3),
        "middle": (fraction >= 1 / 3) & (fraction < 2 / 3),
        "near": fraction >= 2 / 3,
        "at edges": edges,
        "off edges": ~edges,
        "thin": thin_objects(gt_index, N),
        "at hand-overs": near_handovers(visible),
        "occluded": (visible & ~occluded_points(gt_index, sweep)).sum(0) < 2,
        **{f"seen by {k}": count == k for k in range(len(sweep.rig) + 1)},
    }


def near_edges(gt_index: NDArray[np.float64], num_spheres: int) -> NDArray[np.bool_]:
    """Return the mask (H, W) of the rays within `EDGE_PX` of a depth discontinuity.

    There n̂ of two neighbours differs by more than `DISCONTINUITY_PERCENT` of N. NaN is none.
    """
    limit = DISCONTINUITY_PERCENT / 100 * num_spheres
    across = np.abs(gt_index - np.roll(gt_index, -1, 1)) > limit
    down = np.abs(np.diff(gt_index, axis=0)) > limit
    return _within(across, down, EDGE_PX)


def near_handovers(visible: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the mask (H, W) of the rays near which the view of a camera ends.

    `visible` (cameras, H, W) says which points are in the view of which camera. "Near": within
    `HANDOVER_DEG`.
    """
    across = (visible != np.roll(visible, -1, 2)).any(0)
    down = (visible[:, 1:] != visible[:, :-1]).any(0)
    return _within(across, down, max(1, round(HANDOVER_DEG * visible.shape[2] / 360)))


def occluded_points(gt_index: NDArray[np.float64], sweep: SphereSweep) -> NDArray[np.bool_]:
    """Return the mask (cameras, H, W) of points that a camera cannot see, given n̂ (H, W).

    The line of sight to such a point gets behind a surface: at one of `_SIGHT_STEPS` it is farther
    from the sweep centre than the panorama's surface in that direction, by more than `_BEHIND`. The
    panorama does not tell how thick things are, so all are solid; nor what is outside of it.
    Unknown rays count as infinitely far.
    """
    grid = sweep.grid
    surface = np.nan_to_num(grid.index_to_inverse_depth(gt_index))  # 1/m
    points = grid.rays() / np.maximum(surface, 1 / (_FARTHEST * grid.min_depth))[..., None]
    occluded = np.zeros((len(sweep.rig), *grid.shape), bool)
    for camera, center in enumerate(sweep.rig.centers):
        for step in _SIGHT_STEPS:
            place = center + step * (points - center)
            nearest, inside = grid.look_up(surface, place)
            occluded[camera] |= inside & (np.linalg.norm(place, axis=-1) * nearest > _BEHIND)
    return occluded


def _within(across: NDArray[np.bool_], down: NDArray[np.bool_], pixels: int) -> NDArray[np.bool_]:
    """Return the mask (H, W) of the pixels within a distance of an edge.

    Edges lie between a column and the next, around the seam, `across` (H, W), and between a row and
    the next, `down` (H - 1, W). The two pixels beside an edge are within 1 pixel of it.
    """
    from scipy.ndimage import maximum_filter

    below, above = (np.pad(down, (rows, (0, 0))) for rows in ((0, 1), (1, 0)))
    beside = across | np.roll(across, 1, 1) | below | above
    return maximum_filter(beside.astype(np.uint8), 2 * pixels - 1, mode=("nearest", "wrap")).astype(
        bool
    )


def thin_objects(gt_index: NDArray[np.float64], num_spheres: int) -> NDArray[np.bool_]:
    """Return the mask (H, W) of the rays on objects narrower than `THIN_DEG`.

    These are the rays where a gray-value opening of n̂ (near is high) lowers n̂ by more than
    `DISCONTINUITY_PERCENT` of N. Its square has sides of 2 r + 1 pixels with r = `THIN_DEG` / 2 in
    pixels, at least 1: 3 at W = 320, 5 at 600, 11 at 1200. Unknown rays count as near, so that
    their neighbours are not thin.
    """
    from scipy.ndimage import grey_opening

    side = 2 * max(1, round(gt_index.shape[1] * THIN_DEG / 720)) + 1
    known = np.where(np.isnan(gt_index), np.inf, gt_index)
    opened = grey_opening(known, side, mode=("nearest", "wrap"))
    return gt_index - opened > DISCONTINUITY_PERCENT / 100 * num_spheres


def error_sums(
    index: ArrayLike,
    gt_index: ArrayLike,
    num_spheres: int,
    regions: Mapping[str, NDArray[np.bool_]],
) -> dict[str, dict[str, float]]:
    """Return `SUMS` of the errors of a panorama for each region; the sums of frames can be added.

    "rays": their number; ">1", ">3", ">5": how many have a larger error e (Eq. 5); "sum",
    "squares": Σ e and Σ e². Arguments as in `index_error`, which says which rays are evaluated and
    how a missing estimate counts.
    """
    gt_index = np.asarray(gt_index, np.float64)
    error = error_map(index, gt_index, num_spheres)
    error = np.where(np.isnan(error), 100.0, error)
    evaluated = (gt_index >= 0) & (gt_index < num_spheres)
    sums = {}
    for name, mask in regions.items():
        e = error[evaluated & mask]
        above = {f">{limit}": int(np.count_nonzero(e > limit)) for limit in (1, 3, 5)}
        of_all = {"sum": float(e.sum()), "squares": float((e**2).sum())}
        sums[name] = {"rays": e.size, **above, **of_all}
    return sums


def sums_to_metrics(sums: ArrayLike) -> NDArray[np.float64]:
    """Return `METRICS` (..., 5) of `SUMS` (..., 6); NaN where there are no rays."""
    rays, above, total, squares = np.split(np.asarray(sums, np.float64), [1, 4, 5], axis=-1)
    with np.errstate(invalid="ignore"):
        return np.concatenate([100 * above / rays, total / rays, np.sqrt(squares / rays)], -1)
