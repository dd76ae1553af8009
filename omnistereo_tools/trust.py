"""How far the depth of a ray is trusted: its confidence, judged at equal range, and whether cameras saw anything."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.stereo.depth import Depth
from omnistereo_lib.stereo.methods import Method
from omnistereo_tools.blend import BRIGHTEST, DARKEST

DOUBTFUL = 0.5  # trust below which a depth is about as likely wrong as right
_SPHERES = 20  # from infinity on: two spheres, of which the confidence of a network speaks, are a tenth of the depth
_AROUND = 5  # rays
_RATIO_SPHERES = 4  # the same for the ratio of costs, which speaks of no distance


def trust(depth: Depth, images: Sequence[ArrayLike], method: str | Method) -> NDArray[np.float32]:
    """Return how far each ray's depth is trusted, in [0, 1], shape (H, W); below `DOUBTFUL` it is doubtful.

    A confidence says how sure the *sphere* is. Near the rig a sphere more or less hardly changes the depth, so the same
    confidence means a better depth there, and what is near is seldom confident: it shows in few cameras, from very
    different sides. Trust is 1 - (1 - confidence)^x, where x grows with the number of spheres between the ray's and
    infinity. x is chosen so that on frames with ground truth about half of what is just doubtful is off by more than
    two spheres and a tenth of the depth, at all ranges.

    Trust is 0 where there is no evidence: where fewer than two cameras see anything but black or white, on the last two
    spheres, since things may be nearer still, and where there is no depth.
    """
    grid, method = depth.grid, Method.parse(method)
    step = (1 / grid.min_depth - 1 / grid.max_depth) / (grid.num_spheres - 1)
    spheres = depth.inverse_depth / step
    exponent = np.sqrt(np.maximum(spheres / _SPHERES, 1)) if method.reads_out else spheres / _RATIO_SPHERES
    evidence = depth.valid & (depth.index <= grid.num_spheres - 3) & _is_lit(depth, images)
    return np.where(evidence, 1 - (1 - depth.confidence.clip(0, 1)) ** exponent, 0).astype(np.float32)


def _is_lit(depth: Depth, images: Sequence[ArrayLike]) -> NDArray[np.bool_]:
    """Return where two cameras see neither black nor saturated pixels, for most rays around a ray, shape (H, W)."""
    samples = np.stack(depth.sweep.warp(images, depth.index))
    samples = samples.reshape(*samples.shape[:3], -1)  # (cameras, H, W, channels)
    lit = ((samples.max(-1) >= DARKEST) & (samples.min(-1) <= BRIGHTEST)).sum(0) >= 2  # False where NaN
    return cv2.medianBlur(lit.astype(np.uint8), _AROUND) > 0
