"""Checkers of notebooks 00 and 01 that ask for functions on arrays, each beside its usual mistakes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.polynomial import Polynomial
from numpy.polynomial.polynomial import polyval

from course.exercises.compare import Array, Case, Rng, by, checker


def _project(
    rays: Array, inv_poly: Array, center: Array, max_deg: float, *, sign: int = -1, shift: float = 0.0, unit: float = 1
) -> Array:
    """Pixels of rays one by one; `sign`, `shift` and `unit` make another angle of t."""
    pixels = []
    for x, y, z in rays.astype(np.float64):
        n = np.hypot(x, y)
        r = polyval(unit * (np.arctan2(sign * z, n) + shift), inv_poly)
        pixel = np.array([x, y]) * r / n + center if n else np.array(center)
        pixels.append(pixel if np.degrees(np.arctan2(n, z)) <= max_deg else [np.nan, np.nan])
    return np.array(pixels)


@checker
def check_pixels_of_rays(rng: Rng, k: int) -> Case:
    """01.4: pixels (K, 2) of rays (K, 3) by the inverse polynomial; NaN beyond `max_deg` from the axis."""
    F, max_deg, center = rng.uniform(180, 220), rng.uniform(95, 110), rng.uniform(350, 420, 2)
    inv_poly = Polynomial([0, F, rng.uniform(-8, 8), -0.05 * F])(Polynomial([np.pi / 2, 1])).coef  # in t
    theta, around = np.radians(rng.uniform(3, max_deg - 2, 9 + k % 4)), rng.uniform(-3, 3, 9 + k % 4)
    theta[-2:] = np.radians([max_deg + 5, max_deg + 30])
    theta[0] = 0 if k else theta[0]  # on the axis
    rays = np.stack([np.sin(theta) * np.cos(around), np.sin(theta) * np.sin(around), np.cos(theta)], 1)
    rays *= rng.uniform(0.5, 5, (len(rays), 1))

    def undirected(rays: Array, *rest: Array) -> Array:
        n = np.hypot(rays[:, :1], rays[:, 1:2])
        return (_project(rays, *rest) - rest[1]) * n + rest[1]

    def by_length(rays: Array, *rest: Array) -> Array:
        n, length = np.hypot(rays[:, :1], rays[:, 1:2]), np.linalg.norm(rays, axis=1, keepdims=True)
        return (_project(rays, *rest) - rest[1]) * n / length + rest[1]

    def divided(rays: Array, *rest: Array) -> Array:
        return np.where(np.hypot(rays[:, :1], rays[:, 1:2]) > 0, _project(rays, *rest), np.nan)

    wrong = [
        (divided, "on the axis hypot(x, y) is 0: that ray falls on the centre"),
        (partial(_project, sign=1), "the sign of z: t is the angle *below* the xy-plane, atan2(-z, n)"),
        (partial(_project, shift=np.pi / 2), "that is the angle from the axis; t is 90° less"),
        (partial(_project, unit=180 / np.pi), "the polynomial takes t in radians"),
        (lambda r, p, c, m: _project(r, p[::-1], c, m), "the coefficients run from low to high; np.polyval wants the"
         " highest first"),
        (lambda r, p, c, m: _project(r, p, c, m)[:, ::-1], "pixels are (u, v), right first, then down: yours are"
         " swapped"),
        (lambda r, p, c, m: _project(r[:, [1, 0, 2]], p, c, m), "u goes with x and v with y: they are swapped"),
        (lambda r, p, c, m: _project(r, p, c[::-1], m), "the centre is (u0, v0): its parts are swapped"),
        (lambda r, p, c, m: _project(r, p, 0 * c, m), "pixels do not count from the centre: add it"),
        (lambda r, p, c, m: 2 * c - _project(r, p, c, m), "the image is turned by 180°: u grows with x, v with y"),
        (lambda r, p, c, m: _project(r, p, c, 180), "beyond `max_deg` the lens sees nothing: NaN for both parts"),
        (lambda r, p, c, m: _project(r, p, c, m / 2), "`max_deg` counts from the axis; do not halve it"),
        (lambda r, p, c, m: np.nan_to_num(_project(r, p, c, m)), "a ray beyond `max_deg` has no pixel: NaN, not 0"),
        (undirected, "x and y give the direction only: divide them by hypot(x, y)"),
        (by_length, "divide x and y by hypot(x, y), not by the length of the ray"),
        (lambda r, p, c, m: _project(r, p, c, m) + 0.5, "half a pixel off: whole numbers are pixel centres, add"
         " nothing"),
        (lambda r, p, c, m: _project(r, p, c, m) - 0.5, "half a pixel off: whole numbers are pixel centres"),
        (lambda r, p, c, m: np.rint(_project(r, p, c, m)), "do not round: a ray falls between pixels"),
        (lambda r, p, c, m: _project(r, p, c, m).T, "one row for each ray: (K, 2), not (2, K)"),
    ]  # fmt: skip
    return by((rays, inv_poly, center, max_deg), _project, wrong)


def _unproject(pixels: Array, poly: Array, center: Array, affine: Sequence[float], *, power: int = -1) -> Array:
    """Unit rays of pixels (…, 2); `power` of the affine map: -1 takes pixels back to the lens."""
    c, d, e = affine
    A = np.linalg.matrix_power(np.array([[1, e], [d, c]]), power)
    xy = np.einsum("ij,...j->...i", A, pixels - center)
    rays = np.concatenate([xy, -polyval(np.hypot(xy[..., :1], xy[..., 1:]), poly)], -1)
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


@checker
def check_rays_of_pixels(rng: Rng, k: int) -> Case:
    """01.5: unit rays (H, W, 3) of pixels (H, W, 2), pixels not quite square: the affine map (c, d, e)."""
    center, affine = rng.uniform(350, 420, 2), (rng.uniform(0.8, 0.95), rng.uniform(0.05, 0.1), rng.uniform(-0.2, -0.1))
    poly = np.array([-196.0, 0.0, 1.6e-3, -1e-7]) * rng.uniform(0.8, 1.2, 4)
    pixels = rng.uniform(0, 780, (2 + k % 3, 4, 2))
    right = _unproject

    def long(pixels: Array, poly: Array, *rest: Array) -> Array:
        """Not divided by its length: x and y in pixels."""
        rays = right(pixels, poly, *rest)
        (c, d, e), offset = rest[1], pixels - rest[0]
        x = (c * offset[..., 0] - e * offset[..., 1]) / (c - d * e)
        return rays / rays[..., :1] * x[..., None]

    def over(axis: int | None) -> partial:
        return lambda *a: long(*a) / np.linalg.norm(long(*a), axis=axis, keepdims=axis is not None)

    wrong = [
        (partial(right, power=0), "the pixels are not square: undo the affine map before you take r"),
        (partial(right, power=1), "the affine map leads from the lens to the pixels: solve for x and y"),
        (lambda p, f, m, a: right(p, f, m, (a[0], a[2], a[1])), "u = x + e y and v = d x + c y: d and e are swapped"),
        (lambda p, f, m, a: right(p, f, m, (a[0], 0, 0)), "d and e count, too, not c alone"),
        (lambda p, f, m, a: right(p, f, 0 * m, a), "x and y count from the centre: subtract it, then undo the map"),
        (lambda p, f, m, a: right(p, f, m[::-1], a), "the centre is (u0, v0): its parts are swapped"),
        (lambda p, f, m, a: right(p[..., ::-1], f, m, a), "pixels are (u, v): yours are taken as (v, u)"),
        (lambda p, f, m, a: right(p, f[::-1], m, a), "the coefficients run from low to high; np.polyval wants the"
         " highest first"),
        (lambda p, f, m, a: right(p, f[:1], m, a), "the whole polynomial at r, not its first coefficient alone"),
        (lambda *a: right(*a) * [1, 1, -1], "the ray is (x, y, -f(r)): f is negative before the lens, z is forward"),
        (lambda *a: right(*a) * [-1, -1, 1], "x and y are the pixel minus the centre, not the other way round"),
        (lambda p, f, m, a: right(p + 0.5, f, m, a), "half a pixel off: whole numbers are pixel centres, add nothing"),
        (lambda p, f, m, a: right(np.rint(p), f, m, a), "do not round the pixels"),
        (long, "divide by the length: a ray is a unit vector"),
        (over(0), "normalised over the wrong axis: the length of each ray is over its three parts, the last axis"),
        (over(1), "normalised over the wrong axis: the length of each ray is over its three parts, the last axis"),
        (over(None), "divided by one length for all: each ray has its own"),
        (lambda *a: np.moveaxis(right(*a), -1, 0), "the coordinates come last: (H, W, 3)"),
    ]  # fmt: skip
    return by((pixels, poly, center, affine), right, wrong)
