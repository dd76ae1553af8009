"""A first look at a rig and its images, before anything is computed: what cannot be right, and how
near things are.

Poses in a wrong unit, one image twice or swapped images compute as well, but mean nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.frame import Frame
from omnistereo_lib.geometry.rig import Rig, camera_pairs
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_tools.input.masks import black_cameras
from omnistereo_tools.judge.coverage import Coverage

if TYPE_CHECKING:
    from omnistereo_lib.stereo.sweep import SphereSweep

_TOGETHER = 1e-3  # m
_FAR_APART = 100.0  # m
# median matching cost below which nothing is looked for; a few right rigs cost up to 0.17
_MATCHES = 0.1
_OUTSIDE = 1.5  # times the nearest depth; rigs of the public sets and of the course stay below 0.5
_WINDOW = 9  # px
_NO_OVERLAP = 0.5  # cost of a patch without texture, which is no evidence for or against a match
_QUANTILE = 0.002  # of the confident rays: fewer are mismatches
# for what comes nearer in the next frame, and for small things that a coarse sweep misses
_MARGIN = 0.55
_PASSES = 2


def frame_doubts(frame: Frame, grid: SphereGrid) -> list[str]:
    """Return what cannot be right with the rig of a frame or, if that may be right, its images."""
    return [*rig_doubts(frame.rig, grid.min_depth)] or [*image_doubts(frame, grid)]


def rig_doubts(rig: Rig, min_depth: float) -> Iterator[str]:
    """Yield what cannot be right with the poses of a rig whose sweep begins at a depth, metres."""
    pairs = zip(combinations(range(1, len(rig) + 1), 2), rig.baselines, strict=True)
    together = [f"{i} and {j}" for (i, j), apart in pairs if apart < _TOGETHER]
    if together:
        yield (
            f"cameras {', '.join(together)} are at one place: they see no depth. Check their"
            " translations"
        )
    reach = float(np.linalg.norm(rig.recentered().centers, axis=1).max())
    if rig.baselines.max() > _FAR_APART:
        yield (
            f"the cameras are up to {rig.baselines.max():.0f} m apart. Check the unit of the"
            " translations: `omnistereo rig --unit` converts"
        )
    elif reach > _OUTSIDE * min_depth:
        yield (
            f"the cameras are up to {reach:.3g} m from their centre, but the spheres begin at"
            f" {min_depth:.3g} m, inside the rig. Check the unit of the translations and the"
            " nearest depth"
        )


def picture_doubt(images: Sequence[NDArray[Any]]) -> str | None:
    """Return which images are black or, if none, identical; one that two cameras share is right."""
    if black := black_cameras(images):
        return f"{black}. Check lens caps and paths"
    pairs = combinations(enumerate(images, 1), 2)
    same = [f"{i} and {j}" for (i, a), (j, b) in pairs if a is not b and np.array_equal(a, b)]
    return f"images {', '.join(same)} are identical. Check their paths" if same else None


def matching_cost(frame: Frame, grid: SphereGrid, sweep: SphereSweep | None = None) -> float:
    """Return how well images match along the rays of a rig, the first sign of one that does not
    fit: the median of `lowest_costs`; 0.5 if no pair shares a view.
    """
    lowest = lowest_costs(frame, grid, sweep)
    return _NO_OVERLAP if np.isnan(lowest).all() else float(np.nanmedian(lowest))


def lowest_costs(
    frame: Frame, grid: SphereGrid, sweep: SphereSweep | None = None
) -> NDArray[np.float32]:
    """Return the best raw ZNCC cost of each ray, (H, W) in [0, 1], NaN where no pair sees one.

    The images are reduced as suits the grid. A sweep of that rig and grid may lend its tables.
    """
    # These load torch, which takes a second that what needs no cost volume does not wait.
    from omnistereo_lib.stereo.sweep import SphereSweep
    from omnistereo_lib.stereo.volume import cost_volume
    from omnistereo_lib.stereo.zncc import ZNCC

    small = frame.reduced(grid.width / 360)
    sweep = sweep or SphereSweep(small.rig, grid)
    valid = sweep.rig.sees(grid.rays(), 1 / grid.max_depth)
    if not any((valid[i] & valid[j]).any() for i, j in camera_pairs("ring", sweep.rig)):
        return np.full((grid.height, grid.width), np.nan, np.float32)
    volume = cost_volume(sweep, small, ZNCC(_WINDOW))
    lowest = volume.nan_to_num(np.inf).amin(-1).numpy()
    return np.where(np.isfinite(lowest), lowest, np.nan)


def image_doubts(frame: Frame, grid: SphereGrid) -> Iterator[str]:
    """Yield what cannot be right with the images of a frame, after coarse cost volumes."""
    if doubt := picture_doubt(frame.images):
        yield doubt
        return
    from omnistereo_lib.stereo.sweep import SphereSweep

    coarse = replace(grid, width=160, height=40, num_spheres=16)
    small = frame.reduced(coarse.width / 360)
    given = coarse, SphereSweep(small.rig, coarse)
    cost = matching_cost(small, *given)
    # Images that are all moved on fit a ring of cameras nearly as well as in their order.
    if cost > _MATCHES or any(matching_cost(other, *given) < cost for other in _moved_on(small)):
        from omnistereo_rigs.doctor.rig_check import find_mixup

        if found := find_mixup(frame):
            yield found


def _moved_on(frame: Frame) -> Iterator[Frame]:
    """Yield the frame with its images moved on by one camera, by two, …, if they are of a size."""
    if len({camera.image_size for camera in frame.rig.cameras}) == 1:
        for k in range(1, len(frame.images)):
            yield Frame.of(frame.rig, [*frame.images[k:], *frame.images[:k]])


def propose_min_depth(frame: Frame) -> float:
    """Return a nearest depth in metres, rounded: a little less than the nearest thing that a coarse
    sweep finds.

    The first pass begins where the rig can measure, see `Coverage.nearest`; what is nearer is not
    found. The second pass sweeps from what the first one found: with fewer spheres wasted in front
    of it, it is sharper. Both look around the horizon, where nothing is distorted; a floor that is
    nearer below is within the margin.
    """
    from omnistereo_lib.stereo.methods import VIDEO_METHOD
    from omnistereo_lib.stereo.pipeline import estimate_depth

    small = frame.reduced(320 / 360)
    nearest = Coverage.of(small.rig).nearest
    for _ in range(_PASSES):
        grid = SphereGrid(320, 80, num_spheres=64, min_depth=nearest)
        depth = estimate_depth(small, grid, VIDEO_METHOD)
        sure = depth.valid & (depth.confidence >= np.nanmedian(depth.confidence))
        nearest = max(nearest, _MARGIN * float(np.quantile(depth.depth[sure], _QUANTILE)))
    return float(f"{nearest:.2g}")
