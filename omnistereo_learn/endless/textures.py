"""Procedural textures: gray values and holes as functions of a point of an object.

Every pattern takes the footprint of the pixel, its width on the surface. What is finer than the
footprint fades to its mean, so nothing aliases with a single ray a pixel.

Numba's cache looks at one file: after a change here, touch `caster.py`, too.
"""

import math
from typing import Any

import numpy as np

from omnistereo_lib.stereo.kernels.compiled import compiled

PLAIN, CLOUDS, CHECKER, BRICKS, FACADE, BOOKS, GRAIN, POSTER = range(8)  # textures
SOLID, LEAVES, BARS, MESH, OPENING = range(5)  # what is cut out of a surface

Vector = tuple[float, float, float]
_compiled = compiled(
    error_model="numpy", nogil=True, fastmath={"nnan", "nsz", "arcp", "contract", "reassoc"}
)
_A, _B, _C, _D = (
    np.uint64(k)
    for k in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB, 0xD6E8FEB86659FD93)
)
_SHIFT, _TOP = np.uint64(32), np.uint64(40)


@_compiled
def random(x: int, y: int, z: int, seed: int) -> float:
    """Return a number in [0, 1) that looks random and depends on four integers alone."""
    h = np.uint64(seed) * _A + np.uint64(x) * _B + np.uint64(y) * _C + np.uint64(z) * _D
    h = (h ^ (h >> _SHIFT)) * _B
    h = (h ^ (h >> _SHIFT)) * _C
    return np.float64(h >> _TOP) * 2.0**-24


@_compiled
def ramp(low: float, high: float, x: float) -> float:
    """Return 0 below `low`, 1 above `high` and a smooth rise between them."""
    t = min(max((x - low) / (high - low), 0.0), 1.0)
    return t * t * (3 - 2 * t)


@_compiled
def mix(a: float, b: float, t: float) -> float:
    """Return the value a fraction t of the way from a to b."""
    return a + (b - a) * t


@_compiled
def noise(p: Vector, seed: int) -> float:
    """Return smooth noise in [0, 1] with a wavelength of about 2."""
    x, y, z = math.floor(p[0]), math.floor(p[1]), math.floor(p[2])
    i, j, k = int(x), int(y), int(z)
    u, v, w = ramp(0.0, 1.0, p[0] - x), ramp(0.0, 1.0, p[1] - y), ramp(0.0, 1.0, p[2] - z)
    below = mix(
        mix(random(i, j, k, seed), random(i + 1, j, k, seed), u),
        mix(random(i, j + 1, k, seed), random(i + 1, j + 1, k, seed), u),
        v,
    )
    above = mix(
        mix(random(i, j, k + 1, seed), random(i + 1, j, k + 1, seed), u),
        mix(random(i, j + 1, k + 1, seed), random(i + 1, j + 1, k + 1, seed), u),
        v,
    )
    return mix(below, above, w)


@_compiled
def clouds(p: Vector, foot: float, gain: float, seed: int) -> float:
    """Return fractal noise around 0.5: six octaves, each `gain` times the one before."""
    total, amplitude, sum_of_amplitudes, frequency = 0.0, 1.0, 0.0, 1.0
    for octave in range(6):
        weight = 1 - ramp(0.25, 0.7, foot * frequency)
        if weight > 0:
            at = (p[0] * frequency, p[1] * frequency, p[2] * frequency)
            total += amplitude * weight * (noise(at, seed + octave) - 0.5)
        sum_of_amplitudes += amplitude
        amplitude, frequency = amplitude * gain, frequency * 2.03
    return 0.5 + 1.6 * total / sum_of_amplitudes


@_compiled
def _inside(distance: float, foot: float) -> float:
    """Return how much of a pixel lies on the positive side of an edge at a distance."""
    return ramp(-0.5 * foot - 1e-4, 0.5 * foot + 1e-4, distance)


@_compiled
def surface_coordinates(p: Vector, normal: Vector) -> tuple[float, float, int]:
    """Return coordinates on the face of a point (v down if there is a down), and its number."""
    x, y, z = abs(normal[0]), abs(normal[1]), abs(normal[2])
    if x > y and x > z:
        return p[2], p[1], 1 if normal[0] > 0 else 2
    if y > z:
        return p[0], p[2], 3 if normal[1] > 0 else 4
    return p[0], p[1], 5 if normal[2] > 0 else 6


@_compiled
def _bricks(u: float, v: float, foot: float, face: int, q: Any, seed: int) -> float:
    """Bricks, tiles or planks: q is height, width of a joint, and how different they are."""
    row = math.floor(v / q[0])
    u += 0.5 * (random(int(row), face, 0, seed) > 0.5)
    column = math.floor(u)
    du, dv = u - column, (v / q[0] - row) * q[0]
    brick = 0.5 + q[2] * (random(int(column), int(row), face, seed) - 0.5)
    joint = _inside(min(du, 1 - du) - q[1], foot) * _inside(min(dv, q[0] - dv) - q[1], foot)
    mean = 0.5 * max(1 - 2 * q[1], 0.0) * max(1 - 2 * q[1] / q[0], 0.0)
    return mix(mean, brick * joint, 1 - ramp(0.4, 1.2, foot))


@_compiled
def pane(u: float, v: float, foot: float, q: Any) -> float:
    """Return whether a point lies on a pane: q is the height of a floor and half a window."""
    du, dv = u - math.floor(u) - 0.5, (v / q[0] - math.floor(v / q[0]) - 0.5) * q[0]
    return (
        _inside(q[1] - abs(du), foot)
        * _inside(q[2] * q[0] - abs(dv), foot)
        * _inside(abs(du) - 0.02, foot)
    )


@_compiled
def _facade(u: float, v: float, foot: float, face: int, q: Any, seed: int) -> float:
    """Windows in rows: dark panes, some lit, with a sill and a cross bar."""
    column, floor = math.floor(u), math.floor(v / q[0])
    dv = (v / q[0] - floor - 0.5) * q[0]
    lit = 0.15 + 0.5 * random(int(column), int(floor), face, seed) ** 3
    sill = _inside(0.03 - abs(dv - q[2] * q[0] - 0.03), foot) * _inside(
        q[1] + 0.04 - abs(u - column - 0.5), foot
    )
    return mix(mix(0.9, 0.6, sill), lit, pane(u, v, foot, q))


@_compiled
def _books(u: float, v: float, foot: float, face: int, q: Any, seed: int) -> float:
    """Stripes of random width and brightness in rows of height q[0], along u or along v."""
    if q[2] > 0.5:
        u, v = v, u
    column, row = math.floor(u), math.floor(v / q[0])
    split = 0.2 + 0.6 * random(int(column), int(row), face, seed + 1)
    left = random(int(column), int(row), face, seed + 2)
    right = random(int(column), int(row), face, seed + 3)
    return mix(0.5, mix(left, right, _inside(u - column - split, foot)), 1 - ramp(0.4, 1.2, foot))


@_compiled
def _poster(u: float, v: float, foot: float, face: int, q: Any, seed: int) -> float:
    """Blocks at two scales, q[0] the share of the finer ones."""
    coarse = random(math.floor(u), math.floor(v), face, seed)
    fine = random(math.floor(5 * u), math.floor(5 * v), face, seed + 1)
    return mix(
        0.5, mix(coarse, fine, q[0] * (1 - ramp(0.08, 0.25, foot))), 1 - ramp(0.4, 1.2, foot)
    )


@_compiled
def albedo(m: Any, p: Vector, normal: Vector, foot: float) -> float:
    """Return the gray value in [0.01, 1] of a primitive at a point of its own frame."""
    q, seed, s = m.pattern, m.seed, m.scale
    at, fine = (p[0] * s, p[1] * s, p[2] * s), foot * s
    u, v, face = surface_coordinates(at, normal)
    k = 0.0
    if m.texture == CLOUDS:  # q: gain, and how hard its edges are
        k = clouds(at, fine, q[0], seed)
        k = mix(k, ramp(0.5 - q[1], 0.5 + q[1], k), q[2])
    elif m.texture == CHECKER:
        x, y = abs(u - 2 * math.floor(u / 2) - 1) - 0.5, abs(v - 2 * math.floor(v / 2) - 1) - 0.5
        square = (2 * _inside(x, fine) - 1) * (2 * _inside(y, fine) - 1)
        k = 0.5 + 0.5 * square * (1 - ramp(0.5, 1.2, fine))
    elif m.texture == BRICKS:
        k = _bricks(u, v, fine, face, q, seed)
    elif m.texture == FACADE:
        k = _facade(u, v, fine, face, q, seed)
    elif m.texture == BOOKS:
        k = _books(u, v, fine, face, q, seed)
    elif m.texture == GRAIN:  # marble and wood: q is how wavy and how slanted
        wave = math.sin(2 * at[0] + q[1] * at[1] + 6 * q[0] * clouds(at, fine, 0.55, seed))
        k = 0.5 + 0.5 * wave * (1 - ramp(0.3, 1.0, fine * (1 + 3 * q[0])))
    elif m.texture == POSTER:
        k = _poster(u, v, fine, face, q, seed)
    value = mix(m.dark, m.light, k)
    if m.dirt > 0:
        s = m.dirt_scale
        value *= 1 + 2 * m.dirt * (
            clouds((p[0] * s, p[1] * s, p[2] * s), foot * s, 0.6, seed + 50) - 0.5
        )
    return min(max(value, 0.01), 1.0)


@_compiled
def is_hole(m: Any, p: Vector, normal: Vector) -> bool:
    """Return whether a primitive is cut out at a point: leaves, bars, wire mesh, a window."""
    q = m.cut
    if m.cutout == LEAVES:  # q: frequency and share of leaves
        i, j, k = math.floor(q[0] * p[0]), math.floor(q[0] * p[1]), math.floor(q[0] * p[2])
        return noise((q[0] * p[0], q[0] * p[1], q[0] * p[2]), m.seed) > q[1] + 0.2 * (
            random(i, j, k, m.seed) - 0.5
        )
    u, v, _ = surface_coordinates(p, normal)
    if m.cutout == OPENING:  # q: centre and half size
        return abs(u - q[0]) < q[2] and abs(v - q[1]) < q[3]
    # metres from the middle of a gap of width q[0]
    across = abs(u / q[0] - math.floor(u / q[0]) - 0.5) * q[0]
    if m.cutout == BARS:
        return across < 0.5 * (q[0] - q[1])
    down = abs(v / q[0] - math.floor(v / q[0]) - 0.5) * q[0]
    return m.cutout == MESH and max(across, down) < 0.5 * (q[0] - q[1])
