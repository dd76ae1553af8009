"""How an error of a camera's direction moves the depth of a ray."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.geometry.rig import Rig

Floats = NDArray[np.float64]


def inverse_depth_shifts(
    rays: Floats, inverse_depth: Floats, centers: Floats, seen: NDArray[np.bool_]
) -> Floats:
    """Return how the inverse depth moves if a camera rotates, 1/m per radian, (cameras, ...).

    A point that moves along the ray moves in camera i by v_i radians per 1/m, a vector. If camera i
    is rotated by ε, the inverse depth that fits all pairs by least squares moves by ε |Σ_j (v_i -
    v_j)| / Σ |v_i - v_j|²: of two cameras with a baseline b across the ray, by ε / b.

    Args:
        rays: (..., 3), unit length, rig frame at the sweep centre.
        inverse_depth: (...), 1/m.
        centers: (cameras, 3), metres.
        seen: (cameras, ...), which cameras see the point; the others do not count.

    Returns:
        (cameras, ...); NaN where fewer than two cameras see the point.
    """
    places = centers.reshape(len(centers), *[1] * (rays.ndim - 1), 3)
    # The way from camera i to the point, times its inverse depth q: ρ - q c_i.
    towards = rays - inverse_depth[..., None] * places
    length = np.linalg.norm(towards, axis=-1, keepdims=True)
    unit = towards / length
    # v_i is its derivative by q, -c_i, as far as it lies across the view, over the length: the
    # direction in which camera i sees the point moves by so many radians per 1/m.
    moves = (unit * (unit * places).sum(-1, keepdims=True) - places) / length * seen[..., None]
    count, total = seen.sum(0), moves.sum(0)
    pull = np.linalg.norm(count[..., None] * moves - total, axis=-1)
    # Σ over pairs |v_i − v_j|² = k Σ |v_i|² − |Σ v_i|².
    power = count * np.square(moves).sum((0, -1)) - np.square(total).sum(-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(seen, pull, 0) / np.where(count >= 2, power, np.nan)


def calibration_deviation(
    rig: Rig, rays: Floats, inverse_depth: Floats, seen: NDArray[Any]
) -> Floats:
    """Return the standard deviation of the inverse depth due to the calibration, 1/m, (...).

    Arguments as of `inverse_depth_shifts`, of a rig that states its `deviations`.
    """
    shifts = inverse_depth_shifts(rays, inverse_depth, rig.centers, seen)
    # Of a camera's centre, what lies across the view turns it by metres over the depth.
    turns = [
        np.sqrt((one.rotation**2 + (one.center * inverse_depth) ** 2) / 3 + one.lens**2)
        for one in rig.deviations
    ]
    return np.sqrt(np.square(shifts * np.stack(turns)).sum(0))
