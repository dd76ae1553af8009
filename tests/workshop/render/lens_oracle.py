"""Where Blender draws a direction, by its documented lens: the oracle for ours."""

import numpy as np
from scene import polar_rays

from workshop.render.camera.lens import SENSOR_MM


def blender_pixel(lens, directions, size):
    """Where Cycles draws directions (n, 3): θ of its polynomial by bisection, then its shift."""
    width, height = size
    k = np.array(lens.blender_coefficients())
    theta = np.arctan2(np.hypot(*directions.T[:2]), directions[:, 2])
    low, high = np.zeros(len(theta)), np.full(len(theta), SENSOR_MM / 2 * 1.1)
    for _ in range(60):
        middle = (low + high) / 2
        beyond = -np.polynomial.polynomial.polyval(middle, k) > theta
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
    radius = low / SENSOR_MM * width
    azimuth = np.arctan2(directions[:, 1], directions[:, 0])
    shift_x, shift_y = lens.blender_shift()
    u = (width - 1) / 2 - shift_x * width + radius * np.cos(azimuth)
    v = (height - 1) / 2 + shift_y * height + radius * np.sin(azimuth)
    return np.stack([u, v], -1)


def directions(max_deg):
    theta, azimuth = np.radians(np.linspace(0, max_deg, 56)), np.linspace(0, 2 * np.pi, 24)
    return polar_rays(theta, azimuth[:, None]).reshape(-1, 3)
