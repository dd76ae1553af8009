"""The nearest depth of a sweep, proposed from the rig and its images where nobody states it."""

from __future__ import annotations

import numpy as np

from omnistereo_lib.frame import Frame
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.images import reduce_images
from omnistereo_lib.stereo.methods import VIDEO_METHOD
from omnistereo_lib.stereo.pipeline import estimate_depth
from omnistereo_tools.judge.coverage import Coverage

_WIDTH, _HEIGHT, _SPHERES = 320, 80, 64  # coarse: a tenth of a second
_QUANTILE = 0.002  # of the confident rays: fewer are mismatches
_MARGIN = 0.55  # for what comes nearer in the next frame, and for small things that a coarse sweep misses
_PASSES = 2


def propose_min_depth(frame: Frame) -> float:
    """Return a nearest depth in metres, rounded: a little less than the nearest thing that a coarse sweep finds.

    The first pass begins where the rig can measure, see `Coverage.nearest`; what is nearer is not found. The second
    pass sweeps from what the first one found: with fewer spheres wasted in front of it, it is sharper. Both look around
    the horizon, where nothing is distorted; a floor that is nearer below is within the margin.

    Raises:
        OmnistereoError: If no two cameras see a ray.
    """
    small = Frame.of(*reduce_images(frame.rig, frame.images, _WIDTH / 360))
    nearest = Coverage.of(small.rig).nearest
    for _ in range(_PASSES):
        grid = SphereGrid(_WIDTH, _HEIGHT, num_spheres=_SPHERES, min_depth=nearest)
        depth = estimate_depth(small, grid, VIDEO_METHOD)
        sure = depth.valid & (depth.confidence >= np.nanmedian(depth.confidence))
        nearest = max(nearest, _MARGIN * float(np.quantile(depth.depth[sure], _QUANTILE)))
    return float(f"{nearest:.2g}")
