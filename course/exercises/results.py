"""Checkers of notebook 10: rendering."""

from __future__ import annotations

import numpy as np

from course.exercises.compare import Array, Case, Rng, checker


@checker
def check_distance_from_z(rng: Rng, k: int) -> Case:
    """10.1: distance along a viewing ray (x, y, z) of any length, given the depth along the optical axis."""
    z_depth, ray = rng.uniform(3, 9), rng.uniform([0.5, -1, 1], [1, -0.4, 2])
    length, z = np.linalg.norm(ray), ray[2]
    mistakes = [
        (z_depth * z / length, "the wrong way round: the ray is longer than its part along the axis"),
        (z_depth * length, "the ray does not end at z = 1: divide by its z"),
        (z_depth / z, "that many rays long it is; times the ray's length gives metres"),
        (np.hypot(z_depth, np.hypot(*ray[:2])), "x and y belong to the ray as given; stretch it to the depth first"),
        (z_depth * np.hypot(*ray[:2]) / z, "that is the distance from the axis; the depth along it counts, too"),
        (z_depth * np.hypot(ray[0], z) / z, "y is missing: the ray goes up or down as well"),
        (z_depth, "z is the part along the axis; the ray to a point off the axis is longer"),
    ]
    return (z_depth, ray), z_depth * length / z, mistakes


@checker
def check_share_of_sphere(rng: Rng, k: int) -> Case:
    """10.2: the share of a panorama's solid angle, 0 … 1, that a mask covers; rows even in elevation."""
    low, high = rng.uniform(-80, -30), rng.uniform(30, 85)
    rows = int(rng.integers(4, 9))
    mask = rng.uniform(0, 1, (rows, 5)) < np.linspace(0.2, 0.9, rows)[:, None]

    def share(elevation: Array) -> float:
        return float(np.average(mask.mean(1), weights=np.cos(elevation)))

    middles = np.radians(low + (np.arange(rows) + 0.5) * (high - low) / rows)
    weight = np.cos(middles)[:, None]
    mistakes = [
        (mask.mean(), "that is the share of the pixels: one near a pole covers less, weigh the rows by cos φ"),
        (100 * share(middles), "that is in percent; a share runs from 0 to 1"),
        (share(np.radians(np.linspace(low, high, rows))), "rows are pixels: their middles lie half a pixel inside"),
        (share(np.degrees(middles)), "cos wants radians"),
        (share(np.pi / 2 - middles), "the elevation counts from the horizon: cos φ, not sin φ"),
        (np.mean(weight * mask), "divide by the sum of all weights, not by the number of pixels"),
        (np.sum(weight * mask), "that is a sum of weights; divide by the sum of all of them"),
        (np.sum(weight * mask) / weight.sum(), "each row's weight counts once for every pixel of the row"),
        (share(middles) * np.ptp(np.sin(np.radians([low, high]))) / 2, "that is the share of the whole sphere"),
    ]
    return (mask, low, high), share(middles), mistakes
