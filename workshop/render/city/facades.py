"""Façades: windows, shops, entrances, balconies and signs of the buildings, from a random style."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cache

import bpy
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from workshop.render.surfaces.mesh_builder import Mesh, points

PALETTES = {
    "brick": [
        (0.33, 0.12, 0.07),
        (0.25, 0.11, 0.08),
        (0.4, 0.23, 0.13),
        (0.42, 0.33, 0.2),
        (0.2, 0.13, 0.11),
    ],
    "plaster": [
        (0.62, 0.52, 0.36),
        (0.55, 0.36, 0.25),
        (0.5, 0.52, 0.46),
        (0.62, 0.6, 0.54),
        (0.34, 0.42, 0.45),
        (0.56, 0.42, 0.18),
        (0.5, 0.27, 0.22),
        (0.38, 0.44, 0.32),
    ],
    "concrete": [(0.4, 0.39, 0.37), (0.33, 0.33, 0.33), (0.46, 0.43, 0.38)],
    "stone": [(0.52, 0.45, 0.33), (0.44, 0.4, 0.35), (0.5, 0.36, 0.25)],
    "tiles": [(0.16, 0.28, 0.3), (0.4, 0.36, 0.3), (0.3, 0.12, 0.1), (0.5, 0.5, 0.46)],
    "cladding": [(0.26, 0.3, 0.34), (0.4, 0.22, 0.12), (0.2, 0.2, 0.21), (0.42, 0.42, 0.4)],
    "curtain_wall": [(0.1, 0.16, 0.2), (0.12, 0.15, 0.13), (0.16, 0.13, 0.1)],
}
_WORDS = ["BAKERY", "CAFE", "BOOKS", "HOTEL", "BANK", "FLOWERS", "PHARMACY", "OPTICS"]
_WORDS += ["MARKET", "TEA ROOM", "SHOES", "PIZZA", "BICYCLES", "RECORDS", "DENTIST", "NOODLES"]
_WORDS += ["TAILOR", "TOYS", "PHOTO", "BARBER", "MUSIC", "TOOLS", "GALLERY", "LAUNDRY"]
_WORDS += ["BURGERS", "LIBRARY", "THEATRE", "GARDEN", "KITCHENS", "CLOCKS"]


@dataclass(frozen=True)
class Style:
    """How one building's façades are made; lengths in metres."""

    wall: str
    floors: int
    floor_height: float
    ground_height: float
    bay: float  # from window to window
    window_width: float
    window_height: float
    sill: float
    recess: float
    balconies: str  # "none" | "bars" | "solid"
    shops: bool
    gable: bool

    @property
    def height(self) -> float:
        """From the pavement to the top of the last floor."""
        return self.ground_height + (self.floors - 1) * self.floor_height


def random_style(rng: Generator) -> Style:
    """Draw a style: mostly four to six floors of brick, plaster or stone, some towers."""
    tall = rng.random() < 0.22
    floors = int(rng.integers(7, 14)) if tall else int(rng.integers(2, 7))
    old = ["brick", "plaster", "stone", "plaster", "brick"]
    new = ["concrete", "curtain_wall", "tiles", "cladding"]
    wall = str(rng.choice(new if tall or rng.random() < 0.25 else old))
    bay = rng.uniform(2.2, 3.6)
    floor_height = rng.uniform(2.9, 3.7)
    height = rng.uniform(1.3, min(2.2, floor_height - 1.0))
    return Style(
        wall,
        floors,
        floor_height,
        rng.uniform(3.9, 4.7),
        bay,
        bay * rng.uniform(0.36, 0.68),
        height,
        rng.uniform(0.5, floor_height - height - 0.35),
        rng.uniform(0.1, 0.28),
        str(rng.choice(["none", "bars", "solid", "none"])),
        bool(rng.random() < 0.62),
        bool(floors <= 5 and wall in ("brick", "plaster") and rng.random() < 0.45),
    )


def party_wall(style: Style) -> str:
    """Return the material of a wall without windows."""
    thin = style.wall in ("curtain_wall", "cladding", "tiles")
    return "concrete" if thin else style.wall


def facade(mesh: Mesh, length: float, style: Style, rng: Generator, on_street: bool) -> None:
    """Add one façade in the mesh's frame: x along the wall, y outwards, z up from the pavement."""
    if style.wall == "curtain_wall":
        _glass_front(mesh, length, style, rng)
    else:
        first = 1 if on_street else 0
        _windows(mesh, length, style, rng, first)
        _ornaments(mesh, length, style, rng)
    if on_street:
        (_shop_front if style.shops else _entrance_floor)(mesh, length, style, rng)


def _columns(length: float, bay: float) -> NDArray[np.float64]:
    count = max(1, int((length - 0.8) / bay))
    return (np.arange(count) + 0.5) * (length / count)


def _windows(mesh: Mesh, length: float, style: Style, rng: Generator, first_floor: int) -> None:
    """Fill the wall around openings: piers, spandrels between floors, panes inside."""
    centers = _columns(length, style.bay)
    half = min(style.window_width, length / len(centers) - 0.3) / 2
    levels = np.arange(first_floor, style.floors)
    floor = np.where(levels == 0, 0, style.ground_height + (levels - 1) * style.floor_height)
    low, high = floor + style.sill, floor + style.sill + style.window_height
    base = style.ground_height if first_floor else 0.0
    left = np.concatenate([[0], centers + half])
    right = np.concatenate([centers - half, [length]])
    _wall(mesh, left, right, base, style.height, style.wall)
    gaps = np.concatenate([[base], high]), np.concatenate([low, [style.height]])
    for bottom, top in zip(*gaps, strict=True):
        _wall(mesh, centers - half, centers + half, bottom, top, style.wall)
    s, z0 = (grid.ravel() for grid in np.meshgrid(centers, low))
    openings(mesh, s - half, s + half, z0, z0 + style.window_height, style.recess, style.wall, rng)
    if style.balconies != "none":
        _balconies(mesh, centers, half, floor[1:] if first_floor == 0 else floor, style, rng)


def _wall(mesh: Mesh, s0: NDArray, s1: NDArray, z0: float, z1: float, material: str) -> None:
    s0, s1, z0, z1 = np.broadcast_arrays(s0, s1, z0, z1)
    corners = (s0, z0), (s1, z0), (s1, z1), (s0, z1)
    mesh.add(np.stack([points(s, 0, z) for s, z in corners], 1), material)


def openings(
    mesh: Mesh,
    s0: NDArray,
    s1: NDArray,
    z0: NDArray,
    z1: NDArray,
    recess: float,
    wall: str,
    rng: Generator,
) -> None:
    """Add windows: reveals, a pane with its curtain, a frame with a cross, a sill."""
    corner = {c: points((s0, s1)[c & 1], -recess, (z0, z1)[c >> 1]) for c in range(4)}
    outer = {c: p * (1, 0, 1) for c, p in corner.items()}
    for a, b in ((0, 1), (1, 3), (3, 2), (2, 0)):
        mesh.add(np.stack([outer[a], outer[b], corner[b], corner[a]], 1), wall)
    panes = np.stack([corner[0], corner[1], corner[3], corner[2]], 1)
    mesh.add(panes, "window", rng.random(len(s0)))
    bar, y0, y1 = 0.06, -recess, -recess + 0.045
    middle, cross = (s0 + s1) / 2, z0 + (z1 - z0) * 0.68
    bars = [
        (s0, s0 + bar, z0, z1),
        (s1 - bar, s1, z0, z1),
        (s0, s1, z0, z0 + bar),
        (s0, s1, z1 - bar, z1),
        (middle - bar / 2, middle + bar / 2, z0, z1),
        (s0, s1, cross, cross + bar),
    ]
    for left, right, bottom, top in bars:
        mesh.box((left, y0, bottom), (right, y1, top), "trim")
    mesh.box((s0 - 0.08, y0, z0 - 0.07), (s1 + 0.08, 0.07, z0), "trim")


def _balconies(
    mesh: Mesh, centers: NDArray, half: float, floors: NDArray, style: Style, rng: Generator
) -> None:
    chosen = centers[rng.random(len(centers)) < 0.45]
    for s in chosen:
        for floor in floors[rng.random(len(floors)) < 0.9]:
            z, wide, deep = floor + style.sill - 0.28, half + 0.35, 0.95
            mesh.box((s - wide, 0.0, z), (s + wide, deep, z + 0.14), "trim")
            if style.balconies == "solid":
                mesh.box((s - wide, deep - 0.07, z + 0.14), (s + wide, deep, z + 1.0), style.wall)
                sides = np.array([s - wide, s + wide - 0.07])
                low, high = (sides, 0.0, z + 0.14), (sides + 0.07, deep - 0.07, z + 1.0)
                mesh.box(low, high, style.wall)
            else:
                _railing(mesh, s - wide, s + wide, deep, z + 0.14)
            if rng.random() < 0.4:
                s0, s1 = s - wide + 0.1, s + wide - 0.1
                mesh.box((s0, deep, z + 0.55), (s1, deep + 0.2, z + 0.75), "roof_tiles")
                _flowers(mesh, s0, s1, deep + 0.1, z + 0.75, rng)


def _railing(mesh: Mesh, s0: float, s1: float, deep: float, z: float) -> None:
    s = np.arange(s0, s1, 0.12)
    mesh.box((s, deep - 0.03, z), (s + 0.018, deep - 0.012, z + 0.9), "dark_trim")
    rails = ((s0, s0, s1 - 0.04), (deep - 0.05, 0.0, 0.0)), ((s1, s0 + 0.04, s1), deep)
    mesh.box((*rails[0], z + 0.88), (*rails[1], z + 0.93), "dark_trim")


def _flowers(mesh: Mesh, s0: float, s1: float, deep: float, z: float, rng: Generator) -> None:
    n = int(40 * (s1 - s0))
    center = points(rng.uniform(s0, s1, n), rng.normal(deep, 0.06, n), z + rng.uniform(0, 0.22, n))
    mesh.add(center[:, None] + rng.normal(0, 0.05, (n, 4, 3)), "leaf", rng.random(n))


def _ornaments(mesh: Mesh, length: float, style: Style, rng: Generator) -> None:
    """Add a cornice, string courses, a drain pipe, a few air conditioners."""
    top = style.height
    mesh.box((0, 0, top - 0.5), (length, 0.12, top - 0.22), "trim")
    mesh.box((0, 0, top - 0.22), (length, 0.3, top), "trim")
    if rng.random() < 0.5:
        floors = np.arange(0, style.floors - 1, int(rng.integers(1, 3)))
        z = style.ground_height + floors * style.floor_height
        mesh.box((0, 0, z - 0.12), (length, 0.09, z + 0.06), "trim")
    for s in (0.25, length - 0.25)[: int(rng.integers(1, 3))]:
        mesh.tube([(s, 0.09, 0.0), (s, 0.09, top - 0.5)], 0.055, "metal", 6)
    for _ in range(int(rng.integers(0, 4))):
        s = rng.choice(_columns(length, style.bay))
        z = style.ground_height + rng.integers(0, style.floors) * style.floor_height
        if z + 0.3 < top - 0.7 and style.sill > 0.8:
            mesh.box((s - 0.4, 0.02, z + 0.02), (s + 0.4, 0.38, z + 0.55), "metal")


def _glass_front(mesh: Mesh, length: float, style: Style, rng: Generator) -> None:
    """Add a curtain wall: panes between mullions and transoms."""
    count = max(2, round(length / 1.5))
    s = np.linspace(0, length, count + 1)
    z = np.concatenate([[0.0], style.ground_height + np.arange(style.floors) * style.floor_height])
    for bottom, top in itertools.pairwise(z):
        panel = bottom + 0.8
        for low, high in ((bottom, panel), (panel, top)):
            corners = [(s[:-1], low), (s[1:], low), (s[1:], high), (s[:-1], high)]
            quads = np.stack([points(a, 0, b) for a, b in corners], 1)
            mesh.add(quads, "curtain_wall" if low == bottom else "window", rng.random(count))
    mesh.box((s - 0.035, 0, 0), (s + 0.035, 0.13, z[-1]), "dark_trim")
    rows = np.concatenate([z, z[:-1] + 0.8])
    mesh.box((0, 0, rows - 0.04), (length, 0.08, rows + 0.04), "metal")


def _shop_front(mesh: Mesh, length: float, style: Style, rng: Generator) -> None:
    """Add shops along the ground floor: pillars, glass, door, sign, perhaps an awning."""
    count = max(1, round(length / 6.5))
    edges = np.linspace(0, length, count + 1)
    height, board = style.ground_height, style.ground_height - 0.75
    wall = party_wall(style)
    _wall(mesh, np.array([0.0]), np.array([length]), board, height, wall)
    left, right = (edges - 0.25).clip(0), (edges + 0.25).clip(max=length)
    mesh.box((left, -0.3, 0), (right, 0.06, board), wall)
    for s0, s1 in zip(edges[:-1] + 0.25, edges[1:] - 0.25, strict=True):
        door = s0 + 0.1 if rng.random() < 0.5 else s1 - 1.2
        mesh.box((s0, -0.3, 0.0), (s1, -0.05, 0.45), wall)
        pane = points((s0, s1, s1, s0), -0.2, (0, 0, board, board))
        mesh.add(pane, "shop_window", rng.random())
        mesh.box((s0, -0.3, board - 0.02), (s1, 0.0, board), wall)
        mesh.box((door, -0.22, 0.0), (door + 1.1, -0.02, 2.3), "tinted")
        across = door + np.array([0.15, 0.95, 0.95, 0.15])
        mesh.add(points(across, -0.015, (0.5, 0.5, 2.1, 2.1)), "window", 0.2)
        bars = np.arange(s0, s1 + 0.01, max(1.2, (s1 - s0) / 4))
        mesh.box((bars - 0.03, -0.22, 0.45), (bars + 0.03, -0.12, board), "dark_trim")
        _sign_board(mesh, s0, s1, board, height - 0.1, rng)
        if rng.random() < 0.4:
            _awning(mesh, s0, s1, board, rng)


def _sign_board(mesh: Mesh, s0: float, s1: float, z0: float, z1: float, rng: Generator) -> None:
    board = str(rng.choice(["sign_red", "sign_blue", "green_paint", "dark_trim", "wood", "tinted"]))
    mesh.box((s0 + 0.1, 0.0, z0 + 0.03), (s1 - 0.1, 0.12, z1), board)
    triangles, width = letters(str(rng.choice(_WORDS)))
    size = min((z1 - z0) * 0.62, (s1 - s0 - 0.5) / width)
    middle, y = (s0 + s1) / 2 - width * size / 2, 0.135
    x, z = middle + triangles[..., 0] * size, triangles[..., 1] * size
    mesh.add(points(x, y, (z0 + z1) / 2 - 0.33 * size + z), "white")


def _awning(mesh: Mesh, s0: float, s1: float, z: float, rng: Generator) -> None:
    deep, drop = rng.uniform(0.8, 1.3), rng.uniform(0.35, 0.55)
    edges = np.arange(s0, s1, 0.3)
    for k, (a, b) in enumerate(itertools.pairwise(edges)):
        material = "white" if k % 2 else "tinted"
        edge, hem, across = z - drop, z - drop - 0.2, (a, b, b, a)
        mesh.add(points(across, (0.14, 0.14, deep, deep), (z, z, edge, edge)), material)
        mesh.add(points(across, deep, (edge, edge, hem, hem)), material)


def _entrance_floor(mesh: Mesh, length: float, style: Style, rng: Generator) -> None:
    """Add a ground floor with windows, a door with steps, and a plinth."""
    centers = _columns(length, style.bay)
    half = min(style.window_width, length / len(centers) - 0.3) / 2
    door = int(rng.integers(len(centers)))
    wall, height = party_wall(style), style.ground_height
    low, high = 1.1, 1.1 + min(style.window_height, height - 1.5)
    left, right = np.concatenate([[0], centers + half]), np.concatenate([centers - half, [length]])
    _wall(mesh, left, right, 0.0, height, wall)
    keep = np.arange(len(centers)) != door
    s = centers[keep]
    _wall(mesh, s - half, s + half, 0.0, low, wall)
    _wall(mesh, centers - half, centers + half, high, height, wall)
    bottom, top = np.full(len(s), low), np.full(len(s), high)
    openings(mesh, s - half, s + half, bottom, top, style.recess, wall, rng)
    c = centers[door]
    mesh.box((c - half, -0.12, 0.0), (c + half, 0.01, high), "wood")
    mesh.box((c - half, 0, 0), (c + half, 0.32, 0.15), "kerbstone")
    mesh.box((c - half - 0.2, 0, 0), (c + half + 0.2, 0.62, 0.08), "kerbstone")
    mesh.box((0, 0, 0), (c - half, 0.05, 0.45), "stone")
    mesh.box((c + half, 0, 0), (length, 0.05, 0.45), "stone")


@cache
def letters(word: str) -> tuple[NDArray[np.float64], float]:
    """Return a word as triangles (n, 3, 2), capitals about 0.7 high, and its width."""
    curve = bpy.data.curves.new("word", "FONT")
    curve.body, curve.resolution_u = word, 3
    text = bpy.data.objects.new("word", curve)
    mesh = text.to_mesh()
    mesh.calc_loop_triangles()
    points = np.array([v.co[:2] for v in mesh.vertices])
    triangles = points[np.array([t.vertices[:] for t in mesh.loop_triangles])]
    text.to_mesh_clear()
    bpy.data.objects.remove(text)
    bpy.data.curves.remove(curve)
    triangles = triangles - [triangles[..., 0].min(), 0]
    return triangles, float(triangles[..., 0].max())
