"""The panorama that is looked at: cameras made equally bright and blended, so that none shows where it ends."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.stereo.correlation import project_cells
from omnistereo_lib.stereo.depth import Depth
from omnistereo_lib.stereo.sweep import OUTSIDE, remap

DARKEST, BRIGHTEST = 6, 249  # gray values; below and above, a sensor is blind
_FEWEST = 200  # rays that two cameras share; fewer do not tell how bright they are
_LARGEST_GAIN = 2.0


def estimate_gains(depth: Depth) -> NDArray[np.float64]:
    """Return the factor of each camera, and of each channel, that makes all equally bright where they overlap.

    Exposure and white balance differ from camera to camera. The ratio of two cameras is the median over the rays that
    both see with values in range, so that wrong depths do not matter; the gains fit all ratios by least squares, with
    a mean logarithm of 0.

    Returns:
        array, shape (cameras, channels), where gray has one channel
    """
    samples = np.stack(depth.sweep.warp(depth.images, depth.index))
    samples = samples.reshape(*samples.shape[:3], -1)  # (cameras, H, W, channels)
    usable, one = np.all((samples >= DARKEST) & (samples <= BRIGHTEST), axis=-1), np.eye(len(samples))
    rows, ratios = [np.ones(len(samples))], [np.zeros(samples.shape[-1])]
    for i, j in combinations(range(len(samples)), 2):
        both = usable[i] & usable[j]
        if both.sum() >= _FEWEST:
            weight = np.sqrt(both.mean())
            rows.append(weight * (one[i] - one[j]))
            ratios.append(weight * np.median(np.log(samples[j][both] / samples[i][both]), axis=0))
    logarithms = np.linalg.lstsq(np.stack(rows), np.stack(ratios), rcond=None)[0]
    return np.exp(logarithms.clip(-np.log(_LARGEST_GAIN), np.log(_LARGEST_GAIN)))


def blended_panorama(
    depth: Depth, gains: NDArray[Any] | None = None, index: NDArray[np.float32] | None = None
) -> NDArray[np.float32]:
    """Return the images at the estimated depth, blended: `Depth.panorama` without the edges of the cameras.

    A camera counts the more, the farther the point is from the rim of its visible pixels.

    Args:
        gains: Of `estimate_gains`, None: those of its images, with values 0 to 255.
        index: Sphere indices of a panorama of any size, (H, W), such as `finer_index` returns. None: those of `depth`.

    Returns:
        float32 array, shape (H, W) or (H, W, 3), 0 to 255: NaN where no camera sees the point, or there is no depth.
    """
    gains = (estimate_gains(depth) if gains is None else gains).astype(np.float32)
    index, sweep = depth.index if index is None else index, depth.sweep
    grid = replace(depth.grid, height=index.shape[0], width=index.shape[1])
    total, weights = np.zeros((*grid.shape, gains.shape[1]), np.float32), np.zeros((*grid.shape, 1), np.float32)
    # In float32, by torch: three times as fast as `project_sphere` on a sharp panorama.
    rays = sweep.keep(("rays in float32", grid.shape), lambda: torch.from_numpy(grid.rays()).float())
    rims = sweep.keep("rims", lambda: [_distance_from_rim(camera) for camera in sweep.rig.cameras])
    inverse_depth = torch.from_numpy(grid.index_to_inverse_depth(index)).float()
    half_pixels = project_cells(sweep.rig, rays, inverse_depth[..., None, None])
    for k, (rim, image) in enumerate(zip(rims, depth.images, strict=True)):
        maps = (2 * half_pixels[k][:, :, 0]).nan_to_num(OUTSIDE).numpy()
        weight = np.nan_to_num(remap(rim, maps))[..., None] ** 2
        sample = remap(np.asarray(image, np.float32), maps).reshape(total.shape)
        total += np.nan_to_num(sample) * weight * gains[k]
        weights += weight
    with np.errstate(invalid="ignore"):
        blended = np.clip(total / weights, 0, 255)
    return blended[..., 0] if gains.shape[1] == 1 else blended


def _distance_from_rim(camera: OcamCamera) -> NDArray[np.float32]:
    """Return the distance of each pixel from the nearest that is not visible, shape (height, width), at most 1."""
    visible = np.pad(camera.visible_pixels().astype(np.uint8), 1)  # the image ends in a rim, too
    distance = cv2.distanceTransform(visible, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    return distance / distance.max()
