"""What stands, hangs and lies in a room.

Feet at z = 0, the back at x = 0, +x points to whoever uses it.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from workshop.render.surfaces.mesh_builder import Mesh, points


def cushion(mesh: Mesh, at: ArrayLike, size: ArrayLike, material: str, value: float = 0.5) -> None:
    """Add a soft box of a full `size`: a superellipsoid, flat in the middle."""
    latitude = np.linspace(-np.pi / 2, np.pi / 2, 13)[:, None]
    angle = np.linspace(0, 2 * np.pi, 29)
    bent = (np.sign(wave) * np.abs(wave) ** 0.35 for wave in (np.cos(angle), np.sin(angle)))
    height = np.sign(latitude) * np.abs(np.sin(latitude)) ** 0.6
    girth = np.cos(latitude).clip(0) ** 0.35
    unit = points(*(girth * wave for wave in bent), height)
    mesh.sheet(np.asarray(at) + unit * np.asarray(size) / 2, material, value)


def bookcase(rng: Generator, width: float, height: float) -> Mesh:
    """Return open shelves along y, 0.3 m deep, with books and a few other things."""
    mesh, shelves = Mesh(), np.linspace(0.08, height - 0.03, round(height / 0.35) + 1)
    mesh.box((0, 0, 0), (0.012, width, height), "oak", 0.2)
    sides = np.array([0, width - 0.025])
    mesh.box((0, sides, 0), (0.3, sides + 0.025, height), "oak", 0.4)
    mesh.box((0, 0.025, shelves - 0.025), (0.295, width - 0.025, shelves), "oak", 0.5)
    for z, above in itertools.pairwise(shelves):
        _row_of_books(mesh, rng, 0.03, width - 0.03, z, above - z - 0.05)
    return mesh


def _row_of_books(mesh: Mesh, rng: Generator, y: float, end: float, z: float, room: float) -> None:
    while y < end - 0.06:
        kind = rng.random()
        if kind < 0.045 and y < end - 0.26:
            _pile(mesh, rng, (0.15, y + 0.12, z), int(rng.integers(2, 5)))
            y += 0.26
        elif kind < 0.08 and y < end - 0.2:
            vase = points(0.15, y + 0.09, z + room * np.array([0, 0.3, 0.62, 0.8]))
            mesh.tube(vase, [0.05, 0.075, 0.03, 0.045], "glaze", 18, rng.random())
            y += 0.2
        elif kind < 0.11:
            y += rng.uniform(0.03, 0.12)  # somebody is reading it
        else:
            thick, tall = rng.uniform(0.012, 0.048), room * rng.uniform(0.68, 1.0)
            deep = rng.uniform(0.13, 0.22)
            mesh.box((0.03, y, z), (0.03 + deep, y + thick, z + tall), "book", rng.random())
            y += thick + 0.001


def _pile(mesh: Mesh, rng: Generator, at: ArrayLike, count: int) -> None:
    x, y, z = at
    for _ in range(count):
        thick = rng.uniform(0.015, 0.04)
        half = np.array([rng.uniform(0.07, 0.1), rng.uniform(0.09, 0.12)])
        low, high = np.array([x, y]) - half, np.array([x, y]) + half
        mesh.box((*low, z), (*high, z + thick), "book", rng.random())
        z += thick


def table(rng: Generator, length: float = 1.5) -> Mesh:
    """Return a dining table along y around the origin, laid with what a day leaves on it."""
    mesh, half, height = Mesh(), np.array([0.85, length]) / 2, 0.74
    mesh.box((*-half, height - 0.035), (*half, height), "oak", 0.8)
    legs = np.array([(i, j) for i in (-1, 1) for j in (-1, 1)]) * (half - 0.07)
    for x, y in legs:
        mesh.tube([(x, y, 0), (x, y, height - 0.03)], [0.022, 0.034], "oak", 10, 0.6)
    mesh.box((*-(half - 0.09), height - 0.11), (*(half - 0.09), height - 0.035), "oak", 0.6)
    _fruit_bowl(mesh, rng, (0.08, 0.1, height))
    _pile(mesh, rng, (-0.2, 0.5, height), 4)
    mesh.box((-0.15, -0.62, height), (0.1, -0.28, height + 0.016), "dark_trim")
    x, up = (-0.15, -0.15, -0.25, -0.25), np.array([0.02, 0.02, 0.24, 0.24])
    mesh.add(points(x, (-0.62, -0.28, -0.28, -0.62), height + up), "screen")
    for x, y in ((0.24, -0.2), (0.22, 0.42), (-0.3, 0.05)):
        mesh.tube([(x, y, height), (x, y, height + 0.09)], 0.038, "glaze", 16, rng.random())
    for x, y in ((0.26, -0.52), (0.3, 0.22)):
        low, high = (x - 0.1, y - 0.07, height), (x + 0.1, y + 0.07, height + 0.003)
        mesh.box(low, high, "magazine", rng.random())
    return mesh


def _fruit_bowl(mesh: Mesh, rng: Generator, at: ArrayLike) -> None:
    outside = (0.05, 0.0), (0.06, 0.01), (0.13, 0.05), (0.16, 0.09)
    inside = (0.15, 0.09), (0.1, 0.04), (0.0, 0.03)
    mesh.sheet(np.asarray(at) + _turned(*outside, *inside), "glaze", 0.55)
    for k in range(7):
        ring = 0.07 * np.cos(0.9 * k), 0.07 * np.sin(0.9 * k), 0.135
        spot = ring if k else (0, 0, 0.1)
        mesh.ball(np.add(at, spot), np.full(3, rng.uniform(0.034, 0.042)), "fruit", 9, rng.random())


def _turned(*profile: tuple[float, float]) -> NDArray[np.float64]:
    """Return the points of a body of revolution, from its radii and heights."""
    angle = np.linspace(0, 2 * np.pi, 29)
    radius, height = np.array(profile).T[..., None]
    return points(radius * np.cos(angle), radius * np.sin(angle), height)


def chair() -> Mesh:
    """Return a wooden chair around the origin that faces +x."""
    mesh = Mesh()
    for x, top, lean in ((-0.19, 0.86, 0.05), (0.19, 0.44, 0.0)):
        for y in (-0.19, 0.19):
            leg = [(x, y, 0), (x, y, 0.42), (x - lean, y, top)]
            mesh.tube(leg, [0.014, 0.019, 0.016], "oak", 9, 0.3)
    mesh.box((-0.21, -0.21, 0.43), (0.22, 0.21, 0.455), "oak", 0.45)
    cushion(mesh, (0.01, 0, 0.468), (0.38, 0.38, 0.035), "tinted")
    for z in (0.58, 0.68, 0.78):
        mesh.box((-0.245, -0.19, z), (-0.225, 0.19, z + 0.06), "oak", 0.4)
    for y in (-0.19, 0.19):
        mesh.tube([(-0.19, y, 0.2), (0.19, y, 0.2)], 0.01, "oak", 8, 0.3)
    return mesh


def sofa(rng: Generator, width: float = 2.0) -> Mesh:
    """Return a sofa along y whose back is at x = 0, with loose cushions and a folded blanket."""
    mesh, deep, seats = Mesh(), 0.9, 3
    mesh.box((0.08, 0.06, 0.0), (0.84, width - 0.06, 0.1), "dark_trim")
    cushion(mesh, (deep / 2, width / 2, 0.2), (deep, width, 0.24), "upholstery")
    for y in (0.1, width - 0.1):
        cushion(mesh, (deep / 2, y, 0.36), (deep, 0.2, 0.46), "upholstery")
    wide = (width - 0.4) / seats
    for k in range(seats):
        y = 0.2 + (k + 0.5) * wide
        cushion(mesh, (0.53, y, 0.37), (0.72, wide - 0.01, 0.17), "upholstery")
        cushion(mesh, (0.2, y, 0.61), (0.24, wide - 0.02, 0.46), "upholstery")
    for k, y in enumerate((0.36, 0.62, width - 0.42)):
        mesh.place((0.39, y, 0.62), (np.cos(0.25), 0, 0.25 * k), (0.1 * (-1) ** k, 1, 0))
        cushion(mesh, (0, 0, 0), (0.13, 0.4, 0.38), "rug", rng.random())
    mesh.place()
    for k in range(4):
        at = (0.62, width - 0.72, 0.47 + 0.03 * k)
        cushion(mesh, at, (0.4, 0.5, 0.035), "curtain", 0.3 + 0.1 * k)
    return mesh


def low_table(rng: Generator) -> Mesh:
    """Return a round coffee table around the origin with magazines and a vase of twigs."""
    mesh = Mesh()
    top = _turned((0, 0.38), (0.4, 0.38), (0.41, 0.395), (0.4, 0.41), (0, 0.41))
    mesh.sheet(top, "oak", 0.7)
    for k in range(3):
        c, s = np.cos(2.1 * k), np.sin(2.1 * k)
        leg = [(0.32 * c, 0.32 * s, 0), (0.22 * c, 0.22 * s, 0.39)]
        mesh.tube(leg, [0.014, 0.024], "oak", 9, 0.5)
    for k in range(4):
        mesh.turn((-0.14, -0.06, 0.41 + 0.006 * k), rng.uniform(-0.5, 0.5))
        mesh.box((-0.105, -0.15, 0), (0.105, 0.15, 0.005), "magazine", rng.random())
    mesh.place((0.15, 0.13, 0.41))
    vase = _turned((0, 0), (0.05, 0), (0.07, 0.08), (0.03, 0.19), (0.036, 0.22))
    mesh.sheet(vase, "glaze", 0.15)
    for _ in range(7):
        tip = np.array([*rng.normal(0, 0.1, 2), rng.uniform(0.4, 0.55)])
        mesh.tube([(0, 0, 0.1), tip * (0.4, 0.4, 0.6), tip], [0.004, 0.003, 0.002], "bark", 5)
        leaves(mesh, rng, tip, 10, 0.025)
    return mesh


def leaves(mesh: Mesh, rng: Generator, center: ArrayLike, count: int, size: float) -> None:
    """Add small leaves around a point."""
    at = center + rng.normal(0, 1.6 * size, (count, 1, 3))
    mesh.add(at + rng.normal(0, size, (count, 4, 3)), "leaf", rng.random(count))


def plant(rng: Generator, height: float) -> Mesh:
    """Return a pot plant around the origin: stems that arch out, each leaf folded along its rib."""
    mesh = Mesh()
    pot = _turned((0, 0.0), (0.13, 0), (0.18, 0.3), (0.19, 0.33), (0.165, 0.33), (0.16, 0.29))
    mesh.sheet(pot, "glaze", 0.35)
    around = np.linspace(0, 2 * np.pi, 17)[:-1]
    mesh.add(points(0.16 * np.cos(around), 0.16 * np.sin(around), 0.29), "soil")
    for k in range(22):
        angle, up = 2.4 * k + rng.uniform(-0.3, 0.3), rng.uniform(0.45, 1.0) * (height - 0.35)
        out = np.array([np.cos(angle), np.sin(angle), 0]) * rng.uniform(0.12, 0.34)
        root, tip = np.array([0, 0, 0.28]), np.array([0, 0, 0.28 + up]) + out
        mesh.tube([root, (root + tip) / 2 - 0.2 * out, tip], [0.008, 0.006, 0.004], "leaf", 5, 0.3)
        _big_leaf(mesh, tip, out / np.linalg.norm(out), rng.uniform(0.2, 0.34), rng.random())
    return mesh


def _big_leaf(mesh: Mesh, root: NDArray, out: NDArray, length: float, value: float) -> None:
    t = np.linspace(0, 1, 9)[:, None]
    rib = root + length * (t * out + np.array([0, 0, 0.35]) * t - np.array([0, 0, 0.75]) * t**2)
    side = np.cross(out, (0, 0, 1.0)) * 0.26 * length * np.sin(np.pi * t**0.8)
    up = np.array([0, 0, 0.35]) * np.linalg.norm(side, axis=1, keepdims=True)
    mesh.sheet(np.stack([rib - side + up, rib, rib + side + up]), "leaf", value)


def floor_lamp() -> Mesh:
    """Return a standing lamp around the origin, 1.6 m high."""
    mesh = Mesh()
    mesh.sheet(_turned((0, 0.0), (0.15, 0), (0.15, 0.02), (0.0, 0.03)), "dark_trim")
    mesh.tube([(0, 0, 0.02), (0, 0, 1.4)], 0.011, "rim", 10)
    mesh.sheet(_turned((0.19, 1.3), (0.13, 1.6)), "lamp_shade")
    return mesh


def pendant(drop: float) -> Mesh:
    """Return a lamp that hangs `drop` metres down from the origin, over a table."""
    mesh = Mesh()
    mesh.tube([(0, 0, 0), (0, 0, -0.03)], 0.05, "white", 16)
    mesh.tube([(0, 0, 0), (0, 0, 0.22 - drop)], 0.004, "rubber", 6)
    outside = (0.02, 0.22), (0.06, 0.2), (0.15, 0.1), (0.2, 0.0)
    inside = (0.19, 0.0), (0.14, 0.09), (0.0, 0.12)
    mesh.sheet(_turned(*outside, *inside) - (0, 0, drop), "sign_red")
    mesh.ball((0, 0, 0.05 - drop), (0.04, 0.04, 0.05), "bulb", 8)
    return mesh


def radiator(width: float) -> Mesh:
    """Return a ribbed radiator along y with its valve and pipes."""
    mesh, valve = Mesh(), width + 0.08
    for y in np.arange(0.03, width - 0.03, 0.06):
        cushion(mesh, (0.1, y, 0.42), (0.1, 0.05, 0.6), "enamel")
    for z in (0.17, 0.67):
        mesh.tube([(0.1, 0, z), (0.1, width, z)], 0.018, "enamel", 10)
    mesh.tube([(0.1, width, 0.17), (0.1, valve, 0.17), (0.1, valve, 0)], 0.011, "rim", 8)
    mesh.tube([(0.1, valve, 0.17), (0.22, valve, 0.17)], 0.022, "white", 12)
    return mesh


def curtain(rng: Generator, width: float, height: float) -> Mesh:
    """Return a gathered curtain along y whose hem hangs free."""
    y, z = np.linspace(0, width, 160), np.linspace(0, height, 12)[:, None]
    phase = np.cumsum(rng.uniform(0.7, 1.3, len(y))) * 2 * np.pi * width / 0.13 / len(y)
    folds = 0.035 * np.sin(phase) * (1 - 0.35 * z / height) + 0.012 * np.sin(0.43 * phase + 3 * z)
    mesh = Mesh()
    mesh.sheet(points(0.08 + folds, y + 0.008 * np.sin(2 * phase), z), "curtain", 0.8)
    return mesh


def picture(width: float, height: float, kind: str, value: float) -> Mesh:
    """Return a framed picture in the y-z plane, its middle at the origin, that faces +x."""
    mesh, y, z = Mesh(), width / 2, height / 2
    mesh.box((0, -y, -z), (0.012, y, z), "white")
    right, up = np.array([-1, 1, 1, -1]), np.array([-1, -1, 1, 1])
    mesh.add(points(0.013, right * (y - 0.05), up * (z - 0.05)), kind, value)
    low = (0, np.array([-y, -y, -y, y - 0.025]), np.array([-z, z - 0.025, -z, -z]))
    high = (0.028, np.array([y, y, 0.025 - y, y]), np.array([0.025 - z, z, z, z]))
    mesh.box(low, high, "dark_trim")
    return mesh


def clock() -> Mesh:
    """Return a wall clock in the y-z plane around the origin; it is ten past ten."""
    mesh, angle = Mesh(), np.linspace(0, 2 * np.pi, 33)
    for x, radius, material in ((0.03, 0.15, "dark_trim"), (0.032, 0.135, "white")):
        mesh.add(points(x, radius * np.cos(angle), radius * np.sin(angle))[:-1], material)
    rim = points(np.array([[0], [0.03]]), 0.15 * np.cos(angle), 0.15 * np.sin(angle))
    mesh.sheet(rim, "dark_trim")
    for a in angle[:-1:4]:
        tick = np.array([0.034, 0.12 * np.cos(a), 0.12 * np.sin(a)])
        half = 0.006 * np.array([0.1, 1, 1])
        mesh.box(tick - half, tick + half, "dark_trim")
    for a, long in ((np.radians(30), 0.1), (np.radians(145), 0.07)):
        tip = (0.036, long * np.cos(a), long * np.sin(a))
        mesh.tube([(0.036, 0, 0), tip], 0.004, "dark_trim", 5)
    return mesh


def sideboard(rng: Generator, width: float = 1.7) -> Mesh:
    """Return a low cupboard along y: television, loudspeakers, records, cables."""
    mesh, top = Mesh(), 0.55
    mesh.box((0, 0, 0.12), (0.42, width, top), "oak", 0.25)
    doors = np.arange(4) * width / 3
    mesh.box((0.42, doors[:-1] + 0.01, 0.14), (0.437, doors[1:] - 0.01, top - 0.02), "oak", 0.35)
    for k in range(3):
        mesh.ball((0.45, (k + 0.5) * width / 3, 0.45), (0.015, 0.015, 0.015), "rim", 6)
    for x, y in ((0.05, 0.08), (0.37, 0.08), (0.05, width - 0.08), (0.37, width - 0.08)):
        mesh.tube([(x, y, 0), (x, y, 0.12)], 0.018, "dark_trim", 8)
    middle = width / 2 + 0.1
    mesh.box((0.1, middle - 0.3, top), (0.3, middle + 0.3, top + 0.012), "dark_trim")
    mesh.box((0.17, middle - 0.05, top), (0.2, middle + 0.05, top + 0.1), "dark_trim")
    mesh.box((0.17, middle - 0.52, top + 0.08), (0.2, middle + 0.52, top + 0.68), "rubber")
    y, z = np.array([-0.5, 0.5, 0.5, -0.5]), np.array([0.1, 0.1, 0.66, 0.66])
    mesh.add(points(0.201, middle + y, top + z), "screen")
    for y in (0.12, width - 0.12):
        mesh.box((0.1, y - 0.09, top), (0.3, y + 0.09, top + 0.3), "oak", 0.1)
        mesh.ball((0.3, y, top + 0.1), (0.015, 0.065, 0.065), "rubber", 8)
        mesh.ball((0.3, y, top + 0.23), (0.01, 0.03, 0.03), "rubber", 8)
    for end in (0.05, 0.35, width - 0.1):
        slack = [(0.06, middle, top + 0.3), (0.02, middle, top), (-0.02, middle + 0.2, 0.3)]
        cable(mesh, [*slack, (0.03, end, 0.02)])
    return mesh


def cable(mesh: Mesh, along: ArrayLike) -> None:
    """Add a cable near a few points: along a Bézier curve of their number."""
    path, t = np.asarray(along, float), np.linspace(0, 1, 24)[:, None, None]
    while path.shape[-2] > 1:
        path = (1 - t) * path[..., :-1, :] + t * path[..., 1:, :]
    mesh.tube(path[:, 0], 0.005, "rubber", 6)


def basket(rng: Generator) -> Mesh:
    """Return a wicker basket with balls of wool around the origin."""
    mesh = Mesh()
    mesh.sheet(_turned((0, 0.0), (0.16, 0), (0.21, 0.26), (0.2, 0.26), (0.15, 0.02)), "wicker")
    for _ in range(9):
        x, y = rng.uniform(-0.09, 0.09, 2)
        mesh.ball((x, y, rng.uniform(0.12, 0.24)), np.full(3, 0.06), "fabric", 9, rng.random())
    return mesh


def shoes(rng: Generator) -> Mesh:
    """Return pairs of shoes along y, toes to +x."""
    mesh = Mesh()
    for k in range(3):
        value = rng.random()
        for side in (0.0, 0.11):
            y, x = 0.34 * k + side, rng.uniform(0.14, 0.2)
            cushion(mesh, (x, y, 0.035), (0.28, 0.09, 0.07), "fabric", value)
            cushion(mesh, (x - 0.07, y, 0.08), (0.13, 0.08, 0.09), "fabric", value)
    return mesh
