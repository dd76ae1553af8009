"""Buildings: façades with recessed windows, balconies, shop fronts, cornices, roofs."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
from numpy.random import Generator

from workshop.render.city.facades import PALETTES, Style, facade, party_wall, random_style
from workshop.render.city.layout import KERB_HEIGHT, Lot, Rectangle
from workshop.render.surfaces.mesh_builder import Mesh, points


def build(lot: Lot, rng: Generator) -> tuple[Mesh, tuple[float, float, float]]:
    """Return a building as a mesh in world coordinates, and its colour."""
    style, mesh = random_style(rng), Mesh()
    palette = PALETTES[style.wall]
    color = np.array(palette[rng.integers(len(palette))]) * rng.uniform(0.85, 1.15)
    setback = rng.uniform(0.0, 0.5)
    south, east, north, west = (setback * on_street for on_street in lot.street_sides)
    g = lot.ground
    body = Rectangle(g.x0 + west, g.y0 + south, g.x1 - east, g.y1 - north)
    _storeys(mesh, body, lot, style, rng, KERB_HEIGHT, style.height)
    top = KERB_HEIGHT + style.height
    if style.floors > 7 and min(body.size) > 9:
        upper = body.inset(2.2)
        top = _set_back(mesh, upper, style, rng, top)
        body = upper
    if style.gable:
        _gable_roof(mesh, body, top)
    else:
        _flat_roof(mesh, body, top, rng)
    return mesh, tuple(np.clip(color, 0, 0.8))


def _storeys(
    mesh: Mesh, body: Rectangle, lot: Lot, style: Style, rng: Generator, base: float, height: float
) -> None:
    for side, (start, along, length) in enumerate(body.sides()):
        mesh.place((*start, base), (*along, 0), (along[1], -along[0], 0))
        if lot.open_sides[side]:
            facade(mesh, length, style, rng, lot.street_sides[side])
        else:
            wall = points((0, length, length, 0), 0, (0, 0, height, height))
            mesh.add(wall, party_wall(style))
    mesh.place()
    x, y = (body.x0, body.x1, body.x1, body.x0), (body.y0, body.y0, body.y1, body.y1)
    mesh.add(points(x, y, base + height), "roof")


def _set_back(mesh: Mesh, upper: Rectangle, style: Style, rng: Generator, base: float) -> float:
    floors = int(rng.integers(2, 5))
    plain = replace(style, floors=floors, ground_height=style.floor_height)
    plain = replace(plain, balconies="none", shops=False, gable=False)
    lot = Lot(upper, (True,) * 4, (False,) * 4, False)
    _storeys(mesh, upper, lot, plain, rng, base, plain.height)
    return base + plain.height


def _flat_roof(mesh: Mesh, body: Rectangle, z: float, rng: Generator) -> None:
    """Add a parapet, a stair head, boxes, a tank, aerials."""
    for start, along, length in body.sides():
        mesh.place((*start, z), (*along, 0), (along[1], -along[0], 0))
        mesh.box((0, -0.25, 0), (length, 0.04, 0.7), "trim")
    mesh.place((*body.center, z))
    reach = np.array(body.size) / 2 - 2.2
    if min(reach) < 1:
        return
    spots = rng.permutation([(i, j) for i in (-0.7, 0, 0.7) for j in (-0.7, 0, 0.7)]) * reach
    w, d, h = rng.uniform(1.0, 1.8), rng.uniform(1.0, 1.6), rng.uniform(2.2, 3.2)
    mesh.box((*(spots[0] - (w, d)), 0), (*(spots[0] + (w, d)), h), "plaster")
    for spot in spots[1 : int(rng.integers(2, 5))]:
        size = rng.uniform(0.4, 0.9, 2)
        mesh.box((*(spot - size), 0.0), (*(spot + size), rng.uniform(0.7, 1.5)), "metal")
    x, y = spots[5]
    mesh.tube([(x, y, 0), (x, y, 3.6)], 0.03, "metal", 6)
    z = 3.0 + 0.25 * np.arange(3)
    mesh.box((x - 0.7, y - 0.015, z), (x + 0.7, y + 0.015, z + 0.03), "metal")
    if rng.random() < 0.35:
        x, y = spots[6]
        mesh.tube([(x, y, 1.2), (x, y, 3.4)], 1.0, "wood", 16)
        mesh.tube([(x, y, 3.4), (x, y, 4.2)], [1.05, 0.05], "roof", 16)
        for a, b in itertools.product((x - 0.7, x + 0.6), (y - 0.7, y + 0.6)):
            mesh.box((a, b, 0), (a + 0.1, b + 0.1, 1.2), "metal")


def _gable_roof(mesh: Mesh, body: Rectangle, z: float) -> None:
    """Add a pitched roof with its ridge along x, gables and chimneys."""
    mesh.place()
    x0, y0, x1, y1 = body.x0, body.y0, body.x1, body.y1
    mid, rise, over = (y0 + y1) / 2, min(5.5, (y1 - y0) * 0.3), 0.3
    slope = rise / (mid - y0)
    for edge, sign in ((y0 - over, 1), (y1 + over, -1)):
        low = z - slope * over + 0.02
        pitch = points((x0, x1, x1, x0), (edge, edge, mid, mid), (low, low, z + rise, z + rise))
        mesh.add(pitch, "roof_tiles")
        ends = sorted((edge, edge + sign * 0.12))
        mesh.box((x0, ends[0], low - 0.12), (x1, ends[1], low), "trim")
    for x in (x0, x1):
        mesh.add([(x, y0, z), (x, y1, z), (x, mid, z + rise)], "brick")
    for x in (x0 + 1.2, x1 - 1.8):
        mesh.box((x, mid - 1.4, z + rise - 1.5), (x + 0.7, mid - 0.8, z + rise + 1.2), "brick")
