"""From radiance to pixel values: exposure, falloff, noise, tone curve. NumPy alone."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from omnistereo_lib.geometry.pose import Floats
from workshop.render.camera.lens import Lens
from workshop.render.camera.render_rig import Sensor

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def develop(
    radiance: NDArray, lens: Lens, sensor: Sensor, exposure: float, gray: bool, rng: Generator
) -> NDArray[np.uint8]:
    """Return the picture that a camera makes of linear radiance.

    Args:
        radiance (array, shape (H, W, 3)): Linear light; 0 outside the lens circle.
        lens, sensor: The camera: falloff follows the distance from the lens's axis.
        exposure: The scene's exposure, a factor.
        gray: Whether the sensor is monochrome.
        rng: Source of the noise.

    Returns:
        array of uint8, shape (H, W) or (H, W, 3)
    """
    light = np.asarray(radiance, np.float64)
    if gray:
        light = light @ _LUMINANCE
    falloff = 1 - sensor.falloff * _relative_radius(light.shape[:2], lens) ** 2
    signal = light * exposure * sensor.gain * (falloff if gray else falloff[..., None])
    spread = np.sqrt(sensor.read_noise**2 + sensor.shot_noise * signal)
    noisy = signal + spread * rng.standard_normal(signal.shape)
    return np.round(255 * _tone(noisy)).astype(np.uint8)


def _relative_radius(shape: tuple[int, int], lens: Lens) -> Floats:
    """Return the distance of every pixel from the axis; 1 is the rim of the field of view."""
    height, width = shape
    scale = width / 800
    u, v = ((c + 0.5) * scale - 0.5 for c in lens.center)
    rows, columns = np.mgrid[:height, :width]
    return np.hypot(columns - u, rows - v) / (lens.radius(np.radians(lens.max_fov_deg / 2)) * scale)


def _tone(signal: Floats) -> Floats:
    """Return display values in [0, 1]: Narkowicz' fit of ACES, then the sRGB curve."""
    x = np.clip(signal, 0, None)
    film = np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0, 1)
    return np.where(film <= 0.0031308, 12.92 * film, 1.055 * film ** (1 / 2.4) - 0.055)
