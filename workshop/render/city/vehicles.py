"""Cars and vans: lofted bodies with glass, wheels, lamps. Forward is +x, ground z = 0."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from workshop.render.surfaces.mesh_builder import Mesh, points


@dataclass(frozen=True)
class Body:
    """A car's outline: stations along its length with the height of its top; metres."""

    length: float
    width: float
    belt: float  # height of the window sill
    stations: tuple[float, ...]  # 0 … 1 from tail to nose
    tops: tuple[float, ...]
    cabin: tuple[float, float]  # stations between which there is glass
    # closed panels instead of rear windows, as stations of their front edge
    solid: tuple[float, ...] = ()


BODIES = {
    "saloon": Body(
        4.6,
        1.8,
        0.92,
        (0, 0.03, 0.16, 0.33, 0.56, 0.72, 0.96, 1),
        (0.7, 0.92, 0.98, 1.4, 1.43, 0.98, 0.78, 0.55),
        (0.17, 0.71),
    ),
    "hatchback": Body(
        4.0,
        1.75,
        0.95,
        (0, 0.03, 0.14, 0.56, 0.75, 0.96, 1),
        (0.7, 1.0, 1.44, 1.49, 1.0, 0.8, 0.55),
        (0.04, 0.74),
    ),
    "estate": Body(
        4.7,
        1.85,
        0.98,
        (0, 0.02, 0.1, 0.55, 0.72, 0.96, 1),
        (0.75, 1.05, 1.5, 1.52, 1.03, 0.84, 0.6),
        (0.03, 0.71),
    ),
    "suv": Body(
        4.5,
        1.9,
        1.1,
        (0, 0.02, 0.1, 0.6, 0.75, 0.96, 1),
        (0.85, 1.2, 1.66, 1.7, 1.15, 0.98, 0.7),
        (0.03, 0.74),
    ),
    "van": Body(
        5.2,
        1.95,
        1.15,
        (0, 0.01, 0.05, 0.76, 0.88, 0.97, 1),
        (1.8, 2.0, 2.05, 2.08, 1.25, 0.95, 0.65),
        (0.02, 0.87),
        (0.58,),
    ),
}
PAINTS = [(0.55, 0.55, 0.56), (0.02, 0.02, 0.022), (0.75, 0.75, 0.74), (0.16, 0.17, 0.18)]
PAINTS += [(0.4, 0.02, 0.02), (0.02, 0.06, 0.25), (0.03, 0.12, 0.08), (0.5, 0.3, 0.02)]
PAINTS += [(0.3, 0.26, 0.2), (0.05, 0.18, 0.26)]
_CLEARANCE = 0.2


def car(kind: str) -> Mesh:
    """Return a car of one of `BODIES`, centred on the origin."""
    body, mesh = BODIES[kind], Mesh()
    _shell(mesh, body)
    for x in (-0.3 * body.length, 0.31 * body.length):
        for side in (-1, 1):
            _wheel(mesh, x, side * (body.width / 2 - 0.1), 0.31 + 0.03 * (body.belt > 1), side)
    _details(mesh, body)
    return mesh


def _shell(mesh: Mesh, body: Body) -> None:
    """Loft cross-sections from tail to nose; above the belt and in the cabin is glass."""
    t = np.unique(np.concatenate([np.linspace(0, 1, 41), body.stations, body.cabin]))
    x = (t - 0.5) * body.length
    top = np.interp(t, body.stations, body.tops)
    ends = 1 - 0.16 * np.abs(2 * t - 1) ** 6
    section = np.linspace(0, 1, 9)
    z = _CLEARANCE + section[None] * (top[:, None] - _CLEARANCE)
    peak = max(body.tops)
    lean = np.clip((z - body.belt) / (peak - body.belt), 0, 1)
    tuck = np.clip((0.45 - z) / 0.3, 0, 1)
    half = body.width / 2 * ends[:, None] * (1 - 0.2 * lean - 0.1 * tuck) - 0.05 * section**8
    side = points(x[:, None], half, z)
    roof = np.linspace(1, -1, 7)
    crown = 0.04 * (1 - roof**2)
    cover = points(x[:, None], half[:, -1:] * roof, z[:, -1:] + crown)
    full = np.concatenate([side, cover[:, 1:-1], (side * (1, -1, 1))[:, ::-1]], axis=1)
    quads = np.stack([full[:-1, :-1], full[1:, :-1], full[1:, 1:], full[:-1, 1:]], axis=2)
    quads = quads.reshape(-1, 4, 3)
    glass = _is_glass(quads, body)
    mesh.add(quads[glass], "car_glass")
    mesh.add(quads[~glass], "car_paint")
    for end in (0, -1):
        a, b, flat = full[end, :-1], full[end, 1:], (1, 0, 1)
        mesh.add(np.stack([a, b, b * flat, a * flat], 1), "car_paint")
    floor = np.stack([side[:, 0], side[:, 0] * (1, -1, 1)], axis=1)
    mesh.sheet(floor, "rubber")


def _is_glass(quads: np.ndarray, body: Body) -> np.ndarray:
    center = quads.mean(axis=1)
    t, z = center[:, 0] / body.length + 0.5, center[:, 2]
    local_top = np.interp(t, body.stations, body.tops)
    in_cabin = (t > body.cabin[0]) & (t < body.cabin[1])
    is_cover = np.abs(center[:, 1]) < body.width / 2 * 0.72
    fine = np.linspace(0, 1, 201)
    slope = np.abs(np.gradient(np.interp(fine, body.stations, body.tops)) * 200 / body.length)
    steep = np.interp(t, fine, slope) > 0.22
    flank = ~is_cover & (z > body.belt + 0.04) & (z < local_top - 0.1)
    pillar = np.min([np.abs(t - p) for p in (0.38, 0.6)], axis=0) < 0.013
    screen = is_cover & steep & (z > body.belt + 0.03)
    closed = np.any([t < s for s in body.solid], axis=0) if body.solid else np.zeros(len(t), bool)
    return in_cabin & ((flank & ~pillar) | screen) & ~closed


def _wheel(mesh: Mesh, x: float, y: float, radius: float, side: int) -> None:
    mesh.tube([(x, y - 0.1, radius), (x, y + 0.115 * 1.0, radius)], radius, "rubber", 20)
    outer = y + side * (0.115 if side > 0 else 0.1) + side * 0.004
    mesh.tube([(x, outer - side * 0.02, radius), (x, outer, radius)], radius * 0.62, "rim", 14)
    angle = np.linspace(0, 2 * np.pi, 6)[:-1]
    hole = radius * 0.42
    for a in angle:
        at = (x + hole * np.cos(a), outer, radius + hole * np.sin(a))
        mesh.ball(at, (0.045, 0.006, 0.045), "rubber", 4)
    # The arch: a dark ring behind the tyre, wider than it.
    arch = points(x, (y - side * 0.11, y + side * 0.105), radius + 0.02)
    mesh.tube(arch, radius + 0.045, "rubber", 20)


def _details(mesh: Mesh, body: Body) -> None:
    nose, tail, half = body.length / 2, -body.length / 2, body.width / 2
    low = min(0.62, body.belt - 0.3)
    for side in (-1, 1):
        y = side * (half * 0.66)
        mesh.box((nose - 0.12, y - 0.17, low), (nose + 0.015, y + 0.17, low + 0.14), "lamp_off")
        lamp = (tail - 0.015, y - 0.16, low + 0.05), (tail + 0.12, y + 0.16, low + 0.22)
        mesh.box(*lamp, "sign_red")
        mirror = body.length * (body.cabin[1] - 0.5) - 0.25
        at = (mirror, side * (half + 0.09), body.belt + 0.08)
        mesh.ball(at, (0.07, 0.11, 0.08), "car_paint", 5)
        for t in (0.4, 0.6):  # door gaps and handles
            x, y, belt = (t - 0.5) * body.length, side * (half - 0.006), body.belt
            mesh.box((x - 0.006, y - 0.008, 0.35), (x + 0.006, y + 0.008, belt), "rubber")
            y = side * half
            mesh.box((x - 0.25, y - 0.02, belt - 0.13), (x - 0.08, y + 0.02, belt - 0.1), "rim")
        x, y = 0.42 * body.length, side * half * 0.93
        mesh.box((-x, y - 0.03, 0.19), (x, y + 0.03, 0.27), "rubber")
    wide = half * 0.45
    mesh.box((nose - 0.1, -wide, low - 0.1), (nose + 0.01, wide, low + 0.06), "rubber")
    for x, end in ((nose, nose + 0.025), (tail, tail - 0.025)):
        mesh.box((min(x, end), -0.26, 0.38), (max(x, end), 0.26, 0.49), "plate")
        mesh.box((x - 0.12, -half * 0.8, 0.2), (x + 0.12, half * 0.8, 0.34), "rubber")
