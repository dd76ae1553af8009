"""The panorama that is looked at: cameras made equally bright, and blended."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.stereo.correlation import project_cells
from omnistereo_lib.stereo.depth import Depth
from omnistereo_lib.stereo.sweep import OUTSIDE
from omnistereo_lib.stereo.threads import map_threads
from omnistereo_tools.output.mesh_export import is_connected

DARKEST, BRIGHTEST = 6, 249  # gray values; below and above, a sensor is blind
_FEWEST = 200  # rays that two cameras share; fewer do not tell how bright they are
_LARGEST_GAIN = 2.0
_STRIPS = 16


def estimate_gains(depth: Depth) -> NDArray[np.float64]:
    """Return the factor of each camera, and of each channel, that makes all equally bright where
    they overlap.

    Exposure and white balance differ from camera to camera. The ratio of two cameras is the median
    over the rays that both see with values in range, so that wrong depths do not matter; the gains
    fit all ratios by least squares, with a mean logarithm of 0.

    Returns:
        array, shape (cameras, channels), where gray has one channel
    """
    samples = depth.samples.reshape(*depth.samples.shape[:3], -1)  # (cameras, H, W, channels)
    usable = np.all((samples >= DARKEST) & (samples <= BRIGHTEST), axis=-1)
    one = np.eye(len(samples))
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
    depth: Depth, gains: NDArray[Any] | None = None, factor: int = 1
) -> NDArray[np.float32]:
    """Return the images at the estimated depth, blended: `Depth.panorama` without the edges of the
    cameras.

    A camera counts the more, the farther the point is from the rim of its visible pixels.

    Args:
        gains: Of `estimate_gains`, None: those of its images, with values 0 to 255.
        factor: By which the panorama is larger than the depth; see `finer_index`.

    Returns:
        float32 array, shape (factor H, factor W) or (factor H, factor W, 3), 0 to 255: NaN where no
            camera sees the point, or there is no depth.
    """
    return blended_panoramas(depth, gains, (factor,))[0]


def blended_panoramas(
    depth: Depth, gains: NDArray[Any] | None, factors: Sequence[int]
) -> list[NDArray[np.float32]]:
    """Return what `blended_panorama` does for several factors, the images weighted once."""
    gains = (estimate_gains(depth) if gains is None else gains).astype(np.float32)
    rig, grid = depth.sweep.rig, depth.grid
    weights = depth.sweep.keep("weights", lambda: [*map_threads(_distance_from_rim, rig.cameras)])
    # In float32, by torch: three times as fast as `project_sphere`.
    rays = depth.sweep.keep("rays in float32", lambda: torch.from_numpy(grid.rays()).float())
    coarse = _project(rig, rays, depth.inverse_depth)
    places = [_pixels(depth, coarse, factor) for factor in factors]
    # Σ weight · colour, and Σ weight
    sizes = [(f * grid.height, f * grid.width, gains.shape[1] + 1) for f in factors]
    totals = [np.zeros(size, np.float32) for size in sizes]
    for k, (weight, image, gain) in enumerate(zip(weights, depth.images, gains, strict=True)):
        bright = np.asarray(image, np.float32).reshape(*weight.shape[:2], -1) * gain
        shares = np.dstack([bright * weight, weight])
        for total, maps_of in zip(totals, places, strict=True):
            _add(total, shares, maps_of(k))
    return [*map(_divided, totals)]


def _add(total: NDArray[np.float32], shares: NDArray[np.float32], maps: NDArray[Any]) -> None:
    """Add to a panorama what an image has at the places (H, W, 2)."""
    no_second: Any = None  # see `remap`
    for sums, places in zip(strips(total), strips(maps), strict=True):
        sums += cv2.remap(shares, places, no_second, cv2.INTER_LINEAR)


def strips(panorama: NDArray[Any]) -> list[NDArray[Any]]:
    """Return views of some rows each: temporary arrays of the whole would take 0.2 GB."""
    return np.array_split(panorama, min(_STRIPS, len(panorama)))


def _divided(total: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return Σ weight · colour / Σ weight in its place: (H, W, C), or (H, W) of one channel."""
    for sums in strips(total):
        *colors, weight = cv2.split(sums)  # NumPy is slow across interleaved channels
        with np.errstate(invalid="ignore"):
            for k, color in enumerate(colors):
                np.divide(color, weight, out=color).clip(0, 255, out=sums[..., k])
    return total[..., :-1] if total.shape[2] > 2 else total[..., 0]


def _pixels(
    depth: Depth, coarse: list[NDArray[np.float32]], factor: int
) -> Callable[[int], NDArray[np.float32]]:
    """Return what gives where camera k sees the points of the rays, (factor H, factor W, 2) in
    pixels, given these for a factor of 1.

    Within a surface pixels are interpolated, too, since to project all places would take as long as
    to find the depth.
    """
    rig, grid = depth.sweep.rig, depth.grid
    if factor == 1:
        return coarse.__getitem__
    index, (rows, columns) = finer_index(depth, factor)
    fine = replace(grid, width=factor * grid.width, height=factor * grid.height)
    theta, phi = fine.thetas()[columns], fine.phis()[rows]
    level = np.cos(phi)
    directions = np.stack([level * np.sin(theta), np.sin(phi), level * np.cos(theta)], -1)
    inverse_depth = grid.index_to_inverse_depth(index[rows, columns])
    at_edges = _project(rig, torch.from_numpy(directions[None]).float(), inverse_depth[None])

    def enlarged(k: int) -> NDArray[np.float32]:
        maps = _enlarge(_pad(coarse[k]), factor)
        maps[rows, columns] = at_edges[k][0]
        return maps

    return enlarged


def _project(rig: Rig, rays: Tensor, inverse_depth: NDArray[Any]) -> list[NDArray[np.float32]]:
    """Return where each camera sees the points of rays (H, W, 3), (H, W, 2) in pixels."""
    half_pixels = project_cells(rig, rays, torch.from_numpy(inverse_depth).float()[..., None, None])
    return [(2 * places[:, :, 0]).nan_to_num(OUTSIDE).numpy() for places in half_pixels]


def finer_index(depth: Depth, factor: int) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...]]:
    """Return the sphere indices of a panorama that is larger by a factor; and rows and columns of
    places at edges.

    They are interpolated within a surface. At an edge in depth each place takes the surface of
    those of the four rays around it that weigh most in bilinear interpolation, so that rims have no
    teeth and nothing lies between surfaces.
    """
    index = _pad(depth.index)
    fine, corners = _enlarge(index, factor), _cells(index)
    edges = ~is_connected(_cells(_pad(depth.depth)), corners)
    rows, columns = ((np.arange(side) + 0.5) / factor + 0.5 for side in fine.shape)
    chosen = np.nonzero(edges[rows.astype(int)][:, columns.astype(int)])
    # The shares of the four rays: those on the nearer surface, on the farther one, or unknown.
    (q, row), (p, column) = np.modf(rows[chosen[0]]), np.modf(columns[chosen[1]])
    shares = np.stack([(1 - q) * (1 - p), (1 - q) * p, q * (1 - p), q * p])
    values = corners[:, row.astype(int), column.astype(int)]
    middle = (np.fmin.reduce(values) + np.fmax.reduce(values)) / 2
    surfaces = shares * [values > middle, values <= middle, np.isnan(values)]
    most = surfaces.sum(1).argmax(0)
    weights = np.take_along_axis(surfaces, most[None, None], 0)[0]
    mean = (weights * np.nan_to_num(values)).sum(0) / weights.sum(0)
    fine[chosen] = np.where(most == 2, np.nan, mean)
    return fine, chosen


def _pad(values: NDArray[Any]) -> NDArray[Any]:
    """Return a panorama (H, W) or (H, W, C) with one more ray on each side, circular in columns."""
    rows = np.concatenate([values[:1], values, values[-1:]])
    return np.concatenate([rows[:, -1:], rows, rows[:, :1]], 1)


def _enlarge(padded: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    """Return a padded panorama larger by a factor, interpolated, without its padding."""
    fine = cv2.resize(padded, None, fx=factor, fy=factor, interpolation=cv2.INTER_LINEAR)
    return np.asarray(fine[factor:-factor, factor:-factor], np.float32)


def _cells(padded: NDArray[Any]) -> NDArray[Any]:
    """Return the four rays around each place between rays, (4, H + 1, W + 1)."""
    return np.stack([padded[:-1, :-1], padded[:-1, 1:], padded[1:, :-1], padded[1:, 1:]])


def _distance_from_rim(camera: OcamCamera) -> NDArray[np.float32]:
    """Return the squared distance from the nearest invisible pixel, (h, w, 1), largest 1."""
    visible = np.pad(camera.visible_pixels().astype(np.uint8), 1)  # the image ends in a rim, too
    distance = cv2.distanceTransform(visible, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    return (distance / distance.max())[..., None] ** 2
