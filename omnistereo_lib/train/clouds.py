"""Clouds over the skies of training frames: a texture at infinity, where what each camera sees is known exactly.

A clear sky looks the same on every sphere and teaches a cost little. Clouds are so far away that a camera sees them
by its rotation alone, so they can be painted onto the images as they are, and sphere 0 is where they match.
"""

from __future__ import annotations

from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.rig import Rig
from omnistereo_lib.sphere import SphereGrid

_WAVES = 48
_FREQUENCY = (3.0, 100.0)  # radians of phase per radian of view: waves of 120° down to 3.6°, seven training pixels
_STRENGTH = (0.01, 0.35)  # from a haze to a storm, as a share of the sky's own gray value
_NEAR_ROOFS = 9  # side of a window that must be all sky: a roof stands elsewhere for each camera than for the centre


class Clouds:
    """Paints clouds onto the sky of a rig's images.

    Parameters
    ----------
    rig : Rig
        Moved to the sweep centre.
    grid : SphereGrid
        Of the true index that tells the sky.
    """

    def __init__(self, rig: Rig, grid: SphereGrid) -> None:
        self.rig, self.grid = rig, grid

    @cached_property
    def directions(self) -> list[NDArray[np.float32]]:
        """Where every pixel of every camera looks, (height, width, 3), unit vectors in the rig frame."""
        directions = []
        for camera, T_rig_cam in zip(self.rig.cameras, self.rig.T_rig_cam, strict=True):
            width, height = camera.image_size
            rays, _ = camera.unproject(np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1))
            directions.append((np.nan_to_num(rays) @ T_rig_cam.R.T).astype(np.float32))
        return directions

    @cached_property
    def _pixels(self) -> list[NDArray[np.float32]]:
        """Where those directions fall in the panorama, columns from 0 up to W; above it, in its first row."""
        H, W = self.grid.shape
        pixels = (self.grid.pixel(directions)[0] for directions in self.directions)
        return [np.stack([uv[..., 0] % W, uv[..., 1].clip(0, H - 1)], -1).astype(np.float32) for uv in pixels]

    def paint(
        self, images: list[NDArray[np.float32]], index: NDArray[np.float32], rng: np.random.Generator
    ) -> list[NDArray[np.float32]]:
        """Return gray images with clouds where the truth says sky.

        Parameters
        ----------
        images : one array per camera, (height, width), 0 … 255
        index : array, shape (H, W)
            True sphere index; 0 is the sky.
        rng : numpy generator
            Draws the clouds: how many, how sharp, how strong, which.
        """
        sky = _far_from_roofs(index == 0)
        cover = rng.uniform(-0.7, 0.7)
        contrast, strength = rng.uniform(0.7, 2.5), np.exp(rng.uniform(*np.log(_STRENGTH)))
        waves = _plane_waves(rng)
        painted = []
        for image, directions, pixels in zip(images, self.directions, self._pixels, strict=True):
            share = cv2.remap(sky, pixels, None, cv2.INTER_LINEAR)
            clouds = np.zeros_like(image)
            up = share > 0
            clouds[up] = np.tanh(contrast * _ripples(directions[up], *waves) + cover)
            painted.append(np.clip(image * (1 + np.float32(strength) * share * clouds), 0, 255))
        return painted


def _far_from_roofs(sky: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return how much of the clouds each ray of a panorama (H, W) shows: 0 near what is not sky, 1 far from it.

    One column more than the panorama, the first again: rays between the last and the first lie between them.
    """
    r = _NEAR_ROOFS
    around = np.pad(sky.astype(np.float32), ((0, 0), (r, r + 1)), "wrap")
    eroded = cv2.erode(around, np.ones((r, r)))
    return np.ascontiguousarray(cv2.blur(eroded, (5, 5))[:, r:-r])


def _plane_waves(rng: np.random.Generator) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Draw wave vectors (waves, 3), phases and amplitudes, the latter of unit variance together."""
    frequency = np.exp(rng.uniform(*np.log(_FREQUENCY), _WAVES))
    axes = rng.standard_normal((_WAVES, 3))
    axes *= (frequency / np.linalg.norm(axes, axis=1))[:, None]
    amplitude = frequency ** -rng.uniform(0.2, 1.0)  # clouds: the finer the fainter
    amplitude *= np.sqrt(2 / np.sum(amplitude**2))
    return tuple(x.astype(np.float32) for x in (axes, rng.uniform(0, 2 * np.pi, _WAVES), amplitude))


def _ripples(directions: NDArray, axes: NDArray, phases: NDArray, amplitudes: NDArray) -> NDArray[np.float32]:
    """Return a sum of plane waves at directions (M, 3): unlike noise on a map it has no pole and no seam."""
    return np.cos(directions @ axes.T + phases) @ amplitudes
