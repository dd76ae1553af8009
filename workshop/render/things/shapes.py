"""Shapes of many kinds, each inside the unit sphere around the origin. Only NumPy."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workshop.render.indoor.furniture import cushion
from workshop.render.surfaces.mesh_builder import Mesh, points

Builder = Callable[[Mesh, np.random.Generator, Sequence[str]], None]


def random_shape(rng: np.random.Generator, materials: Sequence[str]) -> Mesh:
    """Draw a shape inside the unit sphere with faces of the named materials."""
    mesh = Mesh()
    SHAPES[str(rng.choice(list(SHAPES)))](mesh, rng, materials)
    return mesh


def bounds_after(mesh: Mesh, yaw: float, scale: float, at: ArrayLike) -> NDArray[np.float64]:
    """Return the box, (2, 3), around a mesh scaled, rotated by `yaw`, moved."""
    (x0, y0, z0), (x1, y1, z1) = mesh.bounds() * scale
    c, s = np.cos(yaw), np.sin(yaw)
    x, y, z = np.meshgrid((x0, x1), (y0, y1), (z0, z1))
    corners = points(c * x - s * y, s * x + c * y, z).reshape(-1, 3)
    return np.stack([corners.min(axis=0), corners.max(axis=0)]) + at


def distance_to_box(point: ArrayLike, box: NDArray[np.float64]) -> float:
    """Return the distance from a point (3,) to a box (2, 3) of low and high; 0 inside."""
    point = np.asarray(point, float)
    return float(np.linalg.norm(np.maximum(np.maximum(box[0] - point, point - box[1]), 0)))


def _box(mesh: Mesh, rng: np.random.Generator, materials: Sequence[str]) -> None:
    half = np.exp(rng.uniform(-1.2, 0, 3))
    half /= np.linalg.norm(half)
    mesh.box(-half, half, materials[0])


def _boxes(mesh: Mesh, rng: np.random.Generator, materials: Sequence[str]) -> None:
    """Add a heap of boxes, as parcels or a house with a tower."""
    for k in range(int(rng.integers(2, 6))):
        low = rng.uniform(-0.57, 0.3, 3)
        high = np.minimum(low + rng.uniform(0.15, 0.8, 3), 0.57)
        mesh.box(low, high, materials[k % len(materials)])


def _ball(mesh: Mesh, rng: np.random.Generator, materials: Sequence[str]) -> None:
    mesh.ball((0, 0, 0), rng.uniform(0.5, 1.0, 3) ** (rng.random() < 0.6), materials[0], 16)


def _pillow(mesh: Mesh, rng: np.random.Generator, materials: Sequence[str]) -> None:
    cushion(mesh, (0, 0, 0), rng.uniform(0.4, 1.1, 3), materials[0])


def _pipe(mesh: Mesh, rng: np.random.Generator, materials: Sequence[str]) -> None:
    """Add a cylinder, a cone or something between."""
    length, ends = rng.uniform(0.2, 0.85), rng.uniform(0.0, 0.5, 2) * (1, rng.random() < 0.7) + 0.01
    sides = int(rng.choice([3, 4, 5, 6, 24]))
    mesh.tube([(0, 0, -length), (0, 0, length)], ends, materials[0], sides)


def _ring(mesh: Mesh, rng: np.random.Generator, materials: Sequence[str]) -> None:
    thick, angle = rng.uniform(0.05, 0.3), np.linspace(0, 2 * np.pi, 37)
    around = np.linspace(0, 2 * np.pi, 13)[:, None]
    radius = 1 - thick + thick * np.cos(around)
    ring = points(radius * np.cos(angle), radius * np.sin(angle), thick * np.sin(around))
    mesh.sheet(ring, materials[0])


def _wire(mesh: Mesh, rng: np.random.Generator, materials: Sequence[str]) -> None:
    """Add a thick wire that winds through the sphere."""
    t = np.linspace(0, 2 * np.pi, 60)
    path = np.sin(rng.integers(1, 4, 3) * t[:, None] + rng.uniform(0, 6, 3))
    mesh.tube(0.5 * path, rng.uniform(0.02, 0.1), materials[0], 8)


def _star(mesh: Mesh, rng: np.random.Generator, materials: Sequence[str]) -> None:
    """Add a star or a cog: a prism over an outline that goes in and out."""
    count, depth = int(rng.integers(4, 12)), rng.uniform(0.4, 0.9)
    angle = np.linspace(0, 2 * np.pi, 4 * count, endpoint=False)
    radius = 0.85 * np.where(np.arange(4 * count) % 4 < 2, 1.0, depth)
    high = rng.uniform(0.05, 0.45)
    outline = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    mesh.prism(outline, -high, high, materials[0], materials[-1])
    mesh.add(np.column_stack([outline, np.full(len(outline), -high)]), materials[-1])


def _rock(mesh: Mesh, rng: np.random.Generator, materials: Sequence[str]) -> None:
    latitude, angle = np.linspace(-np.pi / 2, np.pi / 2, 15)[:, None], np.linspace(0, 2 * np.pi, 29)
    girth = np.cos(latitude)
    ball = points(girth * np.cos(angle), girth * np.sin(angle), np.sin(latitude))
    bumps = sum(np.sin(ball @ rng.normal(0, 2.5, 3) + rng.uniform(0, 6)) for _ in range(5))
    mesh.sheet(ball * (0.75 + 0.05 * bumps[..., None]) * rng.uniform(0.5, 1.0, 3), materials[0])


def _vase(mesh: Mesh, rng: np.random.Generator, materials: Sequence[str]) -> None:
    z = np.linspace(-0.75, 0.75, 20)
    radius = 0.35 + 0.15 * np.sin(rng.uniform(2, 6) * z + rng.uniform(0, 6))
    radius += 0.1 * np.sin(rng.uniform(1, 9) * z)
    mesh.tube(points(0, 0, z), radius, materials[0], 24)


def _crate(mesh: Mesh, rng: np.random.Generator, materials: Sequence[str]) -> None:
    """Add the twelve edges of a box: something to look through."""
    half, thick = rng.uniform(0.3, 0.55, 3), rng.uniform(0.02, 0.07)
    for axis in range(3):
        for i in (-1, 1):
            for j in (-1, 1):
                low, high = -half.copy(), half.copy()
                for other, sign in ((axis - 1, i), (axis - 2, j)):
                    middle = sign * half[other]
                    low[other], high[other] = middle - thick / 2, middle + thick / 2
                mesh.box(low, high, materials[0])


def _fence(mesh: Mesh, rng: np.random.Generator, materials: Sequence[str]) -> None:
    """Add upright bars between two rails."""
    x = np.linspace(-0.8, 0.8, int(rng.integers(4, 12)))
    thick, high = rng.uniform(0.015, 0.06), rng.uniform(0.2, 0.5)
    mesh.box((x - thick, -thick, -high), (x + thick, thick, high), materials[0])
    for z in (-0.7 * high, 0.7 * high):
        mesh.box((-0.85, -1.5 * thick, z - thick), (0.85, -thick, z + thick), materials[-1])


def _panel(mesh: Mesh, rng: np.random.Generator, materials: Sequence[str]) -> None:
    """Add a flat or bent board."""
    u, v = np.linspace(-0.7, 0.7, 25), np.linspace(-0.65, 0.65, 2)[:, None] * rng.uniform(0.3, 1.0)
    bend = rng.uniform(0, 0.25) * np.sin(rng.uniform(1, 6) * u)
    for offset in (0.0, 0.03):
        mesh.sheet(points(u, bend + offset, v), materials[0])


def _steps(mesh: Mesh, rng: np.random.Generator, materials: Sequence[str]) -> None:
    count, wide = int(rng.integers(3, 8)), rng.uniform(0.2, 0.55)
    x = np.linspace(-0.6, 0.6, count + 1)
    for k in range(count):
        top = (x[k + 1], wide, -0.5 + (k + 1) / count)
        mesh.box((x[k], -wide, -0.5), top, materials[k % len(materials)])


def _shrub(mesh: Mesh, rng: np.random.Generator, materials: Sequence[str]) -> None:
    """Add many small leaves."""
    count = int(rng.integers(80, 300))
    at = rng.normal(size=(count, 1, 3))
    at *= 0.7 * rng.uniform(0.4, 1, (count, 1, 1)) / np.linalg.norm(at, axis=2, keepdims=True)
    leaves = at + np.clip(rng.normal(0, 0.09, (count, 4, 3)), -0.17, 0.17)
    mesh.add(leaves, materials[0], rng.random(count))


SHAPES: dict[str, Builder] = {
    function.__name__[1:]: function
    for function in (
        *(_box, _boxes, _ball, _pillow, _pipe, _ring, _wire, _star),
        *(_rock, _vase, _crate, _fence, _panel, _steps, _shrub),
    )
}
