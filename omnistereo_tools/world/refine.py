"""A frame's own depth, and that of all frames: for each ray the one to believe."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

_Array = NDArray[Any]
_NEAR = 8.0  # metres: up to there one frame is finer than a voxel
_AGREE, _DISAGREE = 0.1, 0.12  # of the larger inverse depth
_OTHER_THROUGH, _OTHER_NEARER = 10.0, 30.0  # of 255
_WINDOW, _GROWN, _SEAM = 5, 2, 8  # pixels


def mix(own: _Array, fused: _Array, moving: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the fused depth of a frame where it is to be believed, elsewhere its own, both
    inverse, (H, W).

    The own depth stays where the fused one is unknown, where it is nearer than 8 m and both agree,
    and where something moves: the rays of `moving_rays`.

    Args:
        own, fused: (H, W), 1/m; NaN unknown.
    """
    near = (own > 1 / _NEAR) & (np.abs(own - fused) < _AGREE * own)
    return np.where(np.isfinite(fused) & ~near & ~moving | np.isnan(own), fused, own).astype(
        np.float32
    )


def moving_rays(
    own: _Array, fused: _Array, seen: _Array, remembered: _Array, sphere: float
) -> NDArray[np.bool_]:
    """Return the rays, (H, W), whose depth differs from what was fused, and which look otherwise
    there.

    Something moves there, or was seen by this frame alone.

    Args:
        own, fused: Inverse depth, (H, W), 1/m; NaN unknown.
        seen: What the images show at the fused depth, (H, W) or (H, W, channels), 0 to 255.
        remembered: What was fused there, (H, W, channels).
        sphere: Difference of the inverse depths of two spheres, 1/m.
    """
    known = np.isfinite(own) & np.isfinite(fused)
    a, b = np.where(known, own, 1.0), np.where(known, fused, 1.0)
    apart = known & (np.abs(a - b) > sphere)
    through, nearer = (apart & (x > (1 + _DISAGREE) * y) for x, y in ((a, b), (b, a)))
    # Exposure differs from frame to frame: compare with the gain that most agreeing rays have.
    seen = np.nan_to_num(seen).reshape(remembered.shape)
    agree = known & ~through & ~nearer & (seen.min(axis=-1) > 1)
    gain = np.median((remembered / np.maximum(seen, 1))[agree], axis=0) if agree.any() else 1.0
    other = np.abs(gain * seen - np.nan_to_num(remembered)).mean(axis=-1)
    return _regions(through, other > _OTHER_THROUGH) | _regions(nearer, other > _OTHER_NEARER)


def _regions(disagree: NDArray[np.bool_], other: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the rays that disagree where most of a window looks otherwise, and next to them."""
    padded = np.pad(disagree & other, ((0, 0), (_SEAM, _SEAM)), "wrap").astype(np.float32)
    grown = (cv2.blur(padded, (_WINDOW, _WINDOW)) > 0.5).astype(np.uint8)
    within = np.pad(disagree, ((0, 0), (_SEAM, _SEAM)), "wrap").astype(np.uint8)
    for _ in range(_GROWN):
        grown = np.asarray(cv2.dilate(grown & within, np.ones((3, 3))), np.uint8)
    return (grown & within)[:, _SEAM:-_SEAM].astype(bool)
