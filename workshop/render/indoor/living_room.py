"""A living room: plain painted walls close by, a window with daylight, furniture. What stereo finds
hard at home.

World frame: x along the long walls, y from the bookcase to the window, z up, metres; the floor is z
= 0.
"""

from __future__ import annotations

import bpy
import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from omnistereo_lib.geometry.pose import Pose
from workshop.render.city import buildings, nature
from workshop.render.city.district import Stage
from workshop.render.city.drive import level_rig
from workshop.render.city.layout import Lot, Rectangle
from workshop.render.indoor import furniture
from workshop.render.surfaces.lights import add_lamp, add_light
from workshop.render.surfaces.mesh_builder import Mesh
from workshop.render.surfaces.shader import Color

_LONG, _WIDE, _HIGH = 5.5, 4.5, 2.7
_WALL = 0.28  # thickness
_WINDOW = np.array([(1.55, 0.92), (3.65, 2.32)])  # low and high corner in the north wall, (x, z)
_LAMP = np.array([2.6, 2.05, 2.42])
_TABLE = np.array([4.2, 2.95, 0.0])
_GARDEN = -0.5  # height of the ground outside
_EXPOSURE = 1.9
# Where somebody holds the rig: position and heading, radians from the x axis.
_PLACES = (((2.75, 2.2, 1.3), 0.35), ((2.0, 3.3, 1.36), -1.9))


def room_pose(index: int) -> Pose:
    """Return T_world_rig at one of the places, held by hand: a few degrees off level."""
    at, yaw = _PLACES[index]
    held = np.random.default_rng(index).normal(0, np.radians(2.0), 3)
    return Pose(level_rig(yaw) @ Pose.from_vector([*held, 0, 0, 0]).R, np.array(at))


def build_room(light: str, seed: int) -> float:
    """Fill the scene with the room and its window's view; return the exposure."""
    stage, rng = Stage(), np.random.default_rng([seed, 8])
    stage.add(_shell(), "shell")
    stage.add(_joinery(), "joinery")
    _furnish(stage, rng)
    _hang(stage, rng)
    _outside(stage, rng)
    add_light(light)
    _lamps(stage)
    # Most of the light in a room comes from its walls.
    cycles = bpy.context.scene.cycles
    cycles.max_bounces, cycles.diffuse_bounces = 6, 5
    return _EXPOSURE


# What does not move


def _shell() -> Mesh:
    """Return floor, ceiling and walls; the north wall is built around the window."""
    mesh, (x0, z0), (x1, z1) = Mesh(), *_WINDOW
    far_x, far_y = _LONG + _WALL, _WIDE + _WALL
    mesh.box((0, 0, -0.2), (_LONG, _WIDE, 0), "parquet")
    mesh.box((-_WALL, -_WALL, _HIGH), (far_x, far_y, _HIGH + 0.2), "ceiling")
    mesh.box((-_WALL, -_WALL, _GARDEN), (0, far_y, _HIGH), "wall_paint", 1.0)
    mesh.box((_LONG, -_WALL, _GARDEN), (far_x, far_y, _HIGH), "wall_paint", 0.0)
    mesh.box((0, -_WALL, _GARDEN), (_LONG, 0, _HIGH), "wall_paint", 0.0)
    low = [(0, _WIDE, _GARDEN), (x1, _WIDE, _GARDEN), (x0, _WIDE, _GARDEN), (x0, _WIDE, z1)]
    high = [(x0, far_y, _HIGH), (_LONG, far_y, _HIGH), (x1, far_y, z0), (x1, far_y, _HIGH)]
    mesh.box(low, high, "wall_paint", 0.0)
    return mesh


def _joinery() -> Mesh:
    """Return skirting boards, window frame and sill, the door, a socket and a switch."""
    mesh, (x0, z0), (x1, z1) = Mesh(), *_WINDOW
    skirting = np.array([0, _LONG - 0.014, 0, 5.02, 0]), np.array([0, 0, 0, 0, _WIDE - 0.014])
    ends = (0.014, _LONG, 3.98, _LONG, _LONG), (_WIDE, _WIDE, 0.014, 0.014, _WIDE)
    mesh.box((*skirting, 0), (*ends, 0.08), "enamel")
    y, middle, bar = _WIDE + 0.12, (x0 + x1) / 2, 0.055
    left, right = (x0, middle - bar, x1 - bar), (x0 + bar, middle + bar, x1)
    mesh.box((left, y, z0), (right, y + 0.06, z1), "enamel")
    low, high = (z0, z0 + 0.95, z1 - bar), (z0 + bar, z0 + 0.99, z1)
    mesh.box((x0, y + 0.003, low), (x1, y + 0.057, high), "enamel")
    mesh.box((x0 - 0.06, _WIDE - 0.16, z0 - 0.03), (x1 + 0.06, y, z0 + 0.004), "enamel")
    handle = [(middle, y - 0.004, 1.5), (middle, y - 0.04, 1.5), (middle, y - 0.04, 1.38)]
    mesh.tube(handle, 0.009, "rim")
    _door(mesh)
    for x, z in ((3.82, 1.1), (3.5, 0.25)):
        mesh.box((x - 0.04, 0, z - 0.04), (x + 0.04, 0.01, z + 0.04), "white")
        mesh.box((x - 0.02, 0.01, z - 0.025), (x + 0.02, 0.014, z + 0.025), "enamel")
    return mesh


def _door(mesh: Mesh) -> None:
    """Add a door with four panels, its frame, handle and hinges."""
    left, right, top = 4.05, 4.95, 2.05
    mesh.box((left, 0, 0.006), (right, 0.012, top), "enamel")
    for bottom, tall in ((0.18, 0.62), (0.95, 0.95)):
        x, up = left + np.array([0.12, 0.5]), bottom + tall
        mesh.box((x, 0.012, bottom), (x + 0.28, 0.022, up), "enamel")
        mesh.box((x + 0.03, 0.022, bottom + 0.03), (x + 0.25, 0.027, up - 0.03), "enamel")
    low, high = ((left - 0.07, right, left), 0, (0, 0, top)), (left, right + 0.07, right)
    mesh.box(low, (high, 0.03, top + 0.07), "enamel")
    mesh.box((left + 0.05, 0.012, 0.95), (left + 0.08, 0.02, 1.12), "rim")
    x = left + 0.065
    mesh.tube([(x, 0.015, 1.06), (x, 0.06, 1.06), (left + 0.19, 0.06, 1.06)], 0.009, "rim", 10)
    for z in (0.25, 1.75):
        mesh.tube([(right + 0.002, 0.03, z), (right + 0.002, 0.03, z + 0.09)], 0.008, "rim")


# What stands on the floor and hangs on the walls


def _furnish(stage: Stage, rng: Generator) -> None:
    # turns of what stands with its back to that wall
    east, north, south = np.pi, -np.pi / 2, np.pi / 2
    _put(stage, furniture.sofa(rng), (0.03, 0.85, 0))
    _put(stage, furniture.floor_lamp(), (0.4, 0.42, 0))
    _put(stage, furniture.basket(rng), (0.42, 3.2, 0))
    _put(stage, furniture.plant(rng, 1.25), (0.5, 3.98, 0))
    _put(stage, furniture.bookcase(rng, 1.9, 2.05), (3.05, 0.016, 0), south)
    _put(stage, furniture.sideboard(rng), (_LONG - 0.05, 1.95, 0), east)
    _put(stage, furniture.shoes(rng), (5.06, 0.03, 0), south)
    _put(stage, furniture.radiator(1.5), (1.85, _WIDE - 0.02, 0), north)
    _put(stage, furniture.low_table(rng), (1.6, 1.75, 0.012))
    _rug(stage)
    _put(stage, furniture.table(rng), _TABLE)
    chairs = (-0.62, -0.35, 0.12), (-0.58, 0.38, -0.1), (0.58, -0.36, 3.05), (0.6, 0.36, 3.3)
    for x, y, yaw in chairs:
        _put(stage, furniture.chair(), _TABLE + np.array([x, y, 0]), yaw, (0.16, 0.24, 0.27))
    cables = Mesh()
    television = (3.5, 0.02, 0.25), (3.45, 0.05, 0.0), (3.3, 0.1, 0.006), (3.1, 0.12, 0.006)
    lamp = (0.4, 0.42, 0.02), (0.2, 0.3, 0.0), (0.3, 0.1, 0.006), (1.1, 0.06, 0.006)
    for cable in (television, lamp):
        furniture.cable(cables, cable)
    stage.add(cables, "cables")


def _rug(stage: Stage) -> None:
    """Lay a rug before the sofa, its edges a little wavy, with fringes at both ends."""
    mesh = Mesh()
    mesh.box((1.02, 0.72, 0), (2.2, 2.72, 0.012), "rug", 0.3)
    x = np.arange(1.03, 2.19, 0.025)
    for y, out in ((0.72, -0.06), (2.72, 0.06)):
        low, high = sorted((y, y + out))
        mesh.box((x, low, 0), (x + 0.009, high, 0.005), "curtain", 0.7)
    stage.add(mesh, "rug")


def _hang(stage: Stage, rng: Generator) -> None:
    x0, x1 = _WINDOW[:, 0]
    for start in (x0 - 0.38, x1 - 0.12):
        _put(stage, furniture.curtain(rng, 0.5, 2.32), (start, _WIDE - 0.17, 0.05), -np.pi / 2)
    rod, y = Mesh(), _WIDE - 0.25
    rod.tube([(x0 - 0.55, y, 2.39), (x1 + 0.55, y, 2.39)], 0.014, "rim", 12)
    for x in (x0 - 0.55, x1 + 0.55):
        rod.ball((x, y, 2.39), (0.03, 0.03, 0.03), "rim")
        at = x + 0.1 * np.sign(2.6 - x)
        rod.tube([(at, y, 2.39), (at, _WIDE, 2.39)], 0.01, "rim")
    stage.add(rod, "curtain rod")
    for y, wide, tall, z in ((1.35, 0.7, 0.5, 1.62), (2.25, 0.42, 0.56, 1.65)):
        _put(stage, furniture.picture(wide, tall, "canvas", rng.random()), (0, y, z))
    _put(stage, furniture.picture(0.9, 0.6, "canvas", rng.random()), (_LONG, 3.0, 1.6), np.pi)
    _put(stage, furniture.clock(), (4.5, 0, 2.35), np.pi / 2)
    _put(stage, furniture.pendant(1.05), (*_TABLE[:2], _HIGH))


def _put(
    stage: Stage, mesh: Mesh, at: ArrayLike, yaw: float = 0.0, color: Color = (0.5, 0.5, 0.5)
) -> None:
    stage.put(mesh.to_blender("furniture", stage.materials, smooth=True), at, yaw, color)


# Outside and light


def _outside(stage: Stage, rng: Generator) -> None:
    """Put a lawn, a hedge, trees and the houses across the garden before the window."""
    mesh = Mesh()
    mesh.floor((-60, -60), (60, 60), _GARDEN, "grass")
    stage.add(mesh, "lawn")
    hedge = nature.hedge(16.0, rng)
    stage.put(hedge.to_blender("hedge", stage.materials), (-5, 9.5, _GARDEN))
    for x, y in ((-0.6, 8.0), (4.6, 12.5), (9.5, 11.0)):
        tree = nature.tree(rng, 5.5, 1.6)
        stage.put(tree.to_blender("tree", stage.materials, smooth=True), (x, y, _GARDEN))
    for x in (-14.0, 2.0, 19.0):
        lot = Lot(Rectangle(x, 20, x + 14, 30), (True,) * 4, (True, False, False, False), False)
        house, color = buildings.build(lot, rng)
        stage.put(house.to_blender("house", stage.materials), (0, 0, _GARDEN), 0.0, color)


def _lamps(stage: Stage) -> None:
    """Hang a globe, light the lamps, and let the sky's light in through the window."""
    globe = Mesh()
    globe.ball(_LAMP, (0.16, 0.16, 0.16), "bulb", 16)
    globe.tube([_LAMP + np.array([0, 0, 0.15]), (*_LAMP[:2], _HIGH)], 0.012, "rim", 10)
    globe.tube([(*_LAMP[:2], _HIGH - 0.025), (*_LAMP[:2], _HIGH)], 0.06, "rim", 20)
    item = stage.put(globe.to_blender("globe", stage.materials, smooth=True), (0, 0, 0))
    item.visible_shadow = False
    warm = (1.0, 0.86, 0.7)
    add_lamp("POINT", _LAMP, 9.0, warm, 0.16)
    add_lamp("POINT", (*_TABLE[:2], _HIGH - 1.12), 3.0, warm, 0.04)
    add_lamp("POINT", (0.4, 0.42, 1.45), 3.0, warm, 0.05)
    # Light through the window: a portal guides paths to the sky, a lamp makes up for what 5.5 m
    # swallow. A camera's range of brightness is far smaller than that between a room and the sky.
    (x0, z0), (x1, z1) = _WINDOW
    middle = (x0 + x1) / 2, _WIDE + 0.1, (z0 + z1) / 2
    for portal, watts in ((True, 1.0), (False, 66.0)):
        item = add_lamp("AREA", middle, watts, (0.9, 0.96, 1.0), (x1 - x0, z1 - z0))
        item.data.cycles.is_portal = portal
        item.rotation_euler, item.visible_camera = (-np.pi / 2, 0.0, 0.0), False
