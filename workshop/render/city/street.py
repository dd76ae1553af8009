"""The street itself: carriageway, kerbs, markings, and what stands on the pavement."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workshop.render.city.layout import (
    CORNER_RADIUS,
    HALF_STREET,
    KERB_HEIGHT,
    OUTSKIRTS,
    Block,
    District,
)
from workshop.render.surfaces.mesh_builder import Mesh, points

_PAINT = 0.004  # height of road markings above the asphalt


def ground(district: District) -> Mesh:
    """Return the carriageways, and everything flat that is painted on or let into them."""
    mesh, e = Mesh(), district.extent.inset(-900)
    mesh.floor((e.x0, e.y0), (e.x1, e.y1), 0, "asphalt")
    rng = np.random.default_rng([district.seed, 2])
    for line in district.ys:
        mesh.place((0, line, 0))
        _markings(mesh, np.sort(district.xs), rng)
    for line in district.xs:
        mesh.place((line, 0, 0), (0, 1, 0), (-1, 0, 0))
        _markings(mesh, np.sort(district.ys), rng)
    return mesh


def _stripes(mesh: Mesh, x0: ArrayLike, x1: ArrayLike, y0: ArrayLike, y1: ArrayLike) -> None:
    x0, x1, y0, y1 = np.broadcast_arrays(x0, x1, y0, y1)
    corners = (x0, y0), (x1, y0), (x1, y1), (x0, y1)
    mesh.add(np.stack([points(x, y, _PAINT) for x, y in corners], axis=-2), "paint_white")


def _markings(mesh: Mesh, crossings: NDArray, rng: np.random.Generator) -> None:
    """Mark one street, in a frame with x along it and its centre line at y = 0."""
    gap = HALF_STREET + CORNER_RADIUS
    ends = np.concatenate([[crossings[0] - OUTSKIRTS], crossings, [crossings[-1] + OUTSKIRTS]])
    for a, b in zip(ends[:-1] + gap, ends[1:] - gap, strict=True):
        dashes = np.arange(a + 6, b - 6, 4.5)
        _stripes(mesh, dashes, dashes + 2.4, -0.07, 0.07)
        bays = np.arange(a + 5.5, b - 5.0, 5.8)
        for side in (-1, 1):
            edge, kerb = side * (HALF_STREET - 2.15), side * HALF_STREET
            _stripes(mesh, bays, bays + 0.1, min(edge, kerb), max(edge, kerb))
            _stripes(mesh, [a + 5.5], [b - 5.0], edge - 0.05, edge + 0.05)
        for stop, sign in ((b - 3.4, -1), (a + 3.4, 1)):  # stop line on the right-hand lane
            _stripes(mesh, [stop - 0.2], [stop + 0.2], *((-3.4, -0.1) if sign < 0 else (0.1, 3.4)))
            _arrow(mesh, stop + sign * 5.0, 1.7 * sign, -sign)
        _lids(mesh, rng.uniform(a + 2, b - 2, 3), rng)
    bars = np.arange(-HALF_STREET + 0.4, HALF_STREET - 0.6, 1.0)
    for crossing in crossings:
        for x in (crossing - gap - 2.4, crossing + gap - 0.4):
            _stripes(mesh, np.full(len(bars), x), np.full(len(bars), x + 2.8), bars, bars + 0.5)


def _arrow(mesh: Mesh, x: float, y: float, sign: int) -> None:
    _stripes(mesh, [min(x, x + sign * 1.8)], [max(x, x + sign * 1.8)], y - 0.08, y + 0.08)
    neck, tip = x + sign * 1.8, x + sign * 2.9
    mesh.add(points((neck, neck, tip), (y - 0.35, y + 0.35, y), _PAINT), "paint_white")


def _lids(mesh: Mesh, xs: NDArray, rng: np.random.Generator) -> None:
    angle = np.linspace(0, 2 * np.pi, 25)[:-1]
    for x in xs:
        y = rng.uniform(-3, 3)
        disc = points(x + 0.33 * np.cos(angle), y + 0.33 * np.sin(angle), _PAINT / 2)
        mesh.add(disc, "iron_lid")


def pavement(block: Block, rng: np.random.Generator) -> Mesh:
    """Return one block's raised pavement with its kerb."""
    mesh = Mesh()
    surface = "cobbles" if rng.random() < 0.2 else "slabs"
    mesh.prism(block.kerb.rounded(CORNER_RADIUS), -0.05, KERB_HEIGHT, "kerbstone", "kerbstone")
    walked = block.kerb.inset(0.3).rounded(CORNER_RADIUS - 0.3)
    mesh.prism(walked, 0.0, KERB_HEIGHT + 0.003, surface, surface)
    return mesh


# What stands on the pavement. Each is one mesh, used many times; +x points to the carriageway.


def lamp_post() -> Mesh:
    """Return a street lamp whose arm reaches over the carriageway."""
    mesh, height = Mesh(), 7.5
    mesh.tube([(0, 0, 0), (0, 0, 1.1)], 0.1, "green_paint", 12)
    arm = [(0, 0, 1.1), (0, 0, height - 0.6), (0.35, 0, height - 0.08), (1.7, 0, height)]
    mesh.tube(arm, [0.065, 0.05, 0.04, 0.035], "green_paint", 10)
    mesh.box((1.4, -0.14, height - 0.06), (2.1, 0.14, height + 0.06), "metal")
    mesh.box((1.5, -0.1, height - 0.09), (2.0, 0.1, height - 0.06), "lamp_off")
    mesh.box((-0.02, 0.06, 2.4), (0.02, 0.36, 3.1), "poster")
    return mesh


def traffic_light() -> Mesh:
    """Return a mast with lights for cars and walkers."""
    mesh = Mesh()
    mesh.tube([(0, 0, 0), (0, 0, 3.3)], 0.055, "metal", 10)
    mesh.box((-0.14, -0.1, 2.45), (0.14, 0.16, 3.35), "dark_trim")
    for k, lamp in enumerate(("lamp_green", "lamp_off", "lamp_red")):
        mesh.ball((0, 0.17, 2.6 + 0.28 * k), (0.1, 0.03, 0.1), lamp, 6)
        mesh.box((-0.11, 0.15, 2.7 + 0.28 * k), (0.11, 0.32, 2.72 + 0.28 * k), "dark_trim")
    mesh.box((0.06, -0.12, 1.9), (0.28, 0.12, 2.4), "dark_trim")
    mesh.ball((0.29, 0, 2.25), (0.02, 0.08, 0.08), "lamp_red", 6)
    mesh.box((-0.06, -0.09, 0.95), (0.07, 0.09, 1.2), "sign_yellow")
    return mesh


def sign(kind: int) -> Mesh:
    """Return a traffic sign: 0 round, 1 triangle, 2 square, 3 street name."""
    mesh, angle = Mesh(), np.linspace(0, 2 * np.pi, 25)[:-1]
    mesh.tube([(0, 0, 0), (0, 0, 2.9)], 0.03, "metal", 8)
    if kind == 3:
        mesh.box((-0.02, -0.5, 2.6), (0.02, 0.5, 2.82), "sign_blue")
        mesh.box((-0.5, -0.02, 2.85), (0.5, 0.02, 3.05), "sign_blue")
        mesh.box((-0.03, -0.4, 2.67), (0.03, 0.4, 2.75), "white")
        mesh.box((-0.4, -0.03, 2.92), (0.4, 0.03, 2.98), "white")
        return mesh
    corners = {0: angle, 1: np.radians([90, 210, 330]), 2: np.radians([45, 135, 225, 315])}[kind]
    for y, size, material in (
        (0.035, 0.34, "metal"),
        (0.045, 0.34, ("sign_red", "sign_red", "sign_blue")[kind]),
        (0.05, 0.24, ("white", "sign_yellow", "white")[kind]),
    ):
        mesh.add(points(size * np.cos(corners), y, 2.6 + size * np.sin(corners)), material)
    mesh.box((-0.03, 0.051, 2.52), (0.03, 0.055, 2.7), "dark_trim")
    return mesh


def bench() -> Mesh:
    """Return a park bench along y."""
    mesh = Mesh()
    x = np.arange(4) * 0.12 - 0.22
    mesh.box((x, -0.8, 0.44), (x + 0.1, 0.8, 0.48), "wood")
    z = 0.55 + 0.14 * np.arange(3)
    mesh.box((-0.3, -0.8, z), (-0.26, 0.8, z + 0.1), "wood")
    for y in (-0.65, 0.6):
        low = (np.array([-0.25, 0.15, -0.27, -0.29]), y, np.array([0, 0, 0.4, 0.4]))
        high = (np.array([-0.2, 0.2, 0.2, -0.24]), y + 0.05, np.array([0.44, 0.44, 0.44, 0.98]))
        mesh.box(low, high, "dark_trim")
    return mesh


def bin_() -> Mesh:
    """Return a litter bin."""
    mesh = Mesh()
    mesh.tube([(0, 0, 0.08), (0, 0, 0.85)], [0.24, 0.27], "green_paint", 14)
    mesh.tube([(0, 0, 0.98), (0, 0, 1.06)], [0.3, 0.12], "dark_trim", 14)
    posts = np.array([-0.26, 0.22])
    mesh.box((posts, -0.02, 0), (posts + 0.04, 0.02, 1.0), "metal")
    return mesh


def hydrant() -> Mesh:
    """Return a fire hydrant."""
    mesh = Mesh()
    body = points(0, 0, (0, 0.06, 0.55, 0.72))
    mesh.tube(body, [0.17, 0.11, 0.1, 0.03], "sign_yellow", 12)
    mesh.tube([(0, -0.18, 0.45), (0, 0.18, 0.45)], 0.05, "sign_red", 8)
    mesh.tube([(0.0, 0, 0.4), (0.17, 0, 0.4)], 0.06, "sign_red", 8)
    return mesh


def bollard() -> Mesh:
    """Return a bollard with a white band."""
    mesh = Mesh()
    mesh.tube([(0, 0, 0), (0, 0, 0.95)], 0.06, "dark_trim", 10)
    mesh.ball((0, 0, 0.95), (0.065, 0.065, 0.05), "dark_trim", 5)
    mesh.tube([(0, 0, 0.74), (0, 0, 0.84)], 0.063, "white", 10)
    return mesh


def bicycle() -> Mesh:
    """Return a bicycle along y against a hoop."""
    mesh, angle = Mesh(), np.linspace(0, 2 * np.pi, 25)
    for y in (-0.52, 0.52):
        circle = points(0, y + 0.34 * np.cos(angle), 0.34 + 0.34 * np.sin(angle))
        mesh.tube(circle, 0.018, "rubber", 6)
        for a in angle[:-1:3]:
            end = (0, y + 0.33 * np.cos(a), 0.34 + 0.33 * np.sin(a))
            mesh.tube([(0, y, 0.34), end], 0.004, "rim", 3)
    for a, b in (
        ((-0.52, 0.34), (-0.05, 0.33)),
        ((-0.05, 0.33), (0.4, 0.75)),
        ((-0.05, 0.33), (-0.2, 0.8)),
        ((-0.18, 0.74), (0.38, 0.78)),
        ((-0.52, 0.34), (-0.18, 0.74)),
        ((0.52, 0.34), (0.38, 0.95)),
    ):
        mesh.tube([(0, *a), (0, *b)], 0.016, "tinted", 7)
    mesh.tube([(-0.27, 0.36, 0.95), (0.27, 0.36, 0.95)], 0.013, "dark_trim", 6)
    mesh.ball((0, -0.22, 0.84), (0.07, 0.13, 0.035), "rubber", 5)
    hoop = points(0.12, (-0.35, -0.35, 0.35, 0.35), (0, 0.8, 0.8, 0))
    mesh.tube(hoop, 0.022, "metal", 8)
    return mesh


def planter(rng: np.random.Generator) -> Mesh:
    """Return a concrete tub with a shrub."""
    mesh = Mesh()
    mesh.box((-0.4, -0.4, 0), (0.4, 0.4, 0.5), "kerbstone")
    mesh.box((-0.33, -0.33, 0.5), (0.33, 0.33, 0.51), "soil")
    n = 500
    at = rng.normal(0, 0.17, (n, 3)) + np.array([0, 0, 0.78])
    mesh.add(at[:, None] + rng.normal(0, 0.045, (n, 4, 3)), "leaf", rng.random(n))
    return mesh


def kiosk() -> Mesh:
    """Return an advertising column with a small roof."""
    mesh, angle = Mesh(), np.linspace(0, 2 * np.pi, 33)
    mesh.tube([(0, 0, 0), (0, 0, 0.35)], 0.66, "kerbstone", 32)
    wall = 0.58 * np.column_stack([np.cos(angle), np.sin(angle)])
    mesh.sheet([[(*p, z) for p in wall] for z in (0.35, 2.9)], "poster")
    mesh.tube([(0, 0, 2.9), (0, 0, 3.05), (0, 0, 3.5)], [0.72, 0.72, 0.05], "green_paint", 32)
    return mesh


def utility_pole() -> Mesh:
    """Return a wooden pole with cross-arms and insulators; wires hang along y at 7.4 and 8.1 m."""
    mesh = Mesh()
    mesh.tube([(0, 0, 0), (0, 0, 8.4)], [0.13, 0.09], "bark", 10)
    for z in (7.3, 8.0):
        mesh.box((-0.8, -0.05, z - 0.06), (0.8, 0.05, z + 0.04), "wood")
        for x in (-0.7, -0.35, 0.35, 0.7):
            mesh.tube([(x, 0, z + 0.03), (x, 0, z + 0.13)], 0.035, "lamp_off", 6)
    mesh.tube([(0.16, 0.1, 6.2), (0.16, 0.1, 6.9)], 0.17, "metal", 10)
    return mesh


WIRE_SPOTS = [(x, z + 0.1) for z in (7.3, 8.0) for x in (-0.7, -0.35, 0.35, 0.7)]


def wire(start: NDArray, end: NDArray, sag: float) -> Mesh:
    """Return a wire of 14 mm between two points."""
    mesh, t = Mesh(), np.linspace(0, 1, 13)[:, None]
    path = start + t * (end - start) - np.array([0, 0, 4 * sag]) * t * (1 - t)
    mesh.tube(path, 0.007, "rubber", 4)
    return mesh


def bus_shelter() -> Mesh:
    """Return a shelter with a glass back, along y, open to the carriageway."""
    mesh = Mesh()
    mesh.box([(-0.75, -1.9, 2.3)], [(0.55, 1.9, 2.42)], "dark_trim")
    for y in (-1.85, 0.0, 1.8):
        mesh.box((-0.75, y, 0), (-0.68, y + 0.07, 2.3), "metal")
    mesh.box((-0.73, -1.8, 0.25), (-0.71, 1.8, 2.1), "car_glass")
    mesh.box((-0.6, 1.78, 0.3), (0.4, 1.88, 2.1), "poster")
    mesh.box((-0.68, -1.3, 0.42), (-0.3, 1.2, 0.48), "wood")
    legs = np.array([-1.0, 0.9])
    mesh.box((-0.5, legs, 0), (-0.42, legs + 0.06, 0.42), "metal")
    return mesh


def parking_slots(start: float, end: float) -> NDArray[np.float64]:
    """Return the middles of the marked bays between two corners, matching the lines of `ground`."""
    bays = np.arange(start + 5.5, end - 5.0, 5.8)
    return (bays[:-1] + bays[1:]) / 2 + 0.05


MODELS = {"lamp": lamp_post, "light": traffic_light, "bench": bench, "bin": bin_}
MODELS |= {"hydrant": hydrant, "bollard": bollard, "bicycle": bicycle, "kiosk": kiosk}
MODELS |= {"pole": utility_pole, "shelter": bus_shelter}
