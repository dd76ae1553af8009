"""A living room: plain painted walls close by, a window with daylight, furniture. What stereo finds
hard at home.

World frame: x along the long walls, y from the bookcase to the window, z up, metres; the floor is z
= 0.
"""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from numpy.typing import ArrayLike

from omnistereo_lib.geometry.pose import Pose
from workshop.render.city import buildings, nature
from workshop.render.city.district import Stage
from workshop.render.city.drive import level_rig
from workshop.render.city.layout import Lot, Rectangle
from workshop.render.indoor import furniture
from workshop.render.surfaces.lights import add_light
from workshop.render.surfaces.materials import Shader, recipe
from workshop.render.surfaces.mesh_builder import Mesh

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
    skirting = [
        ((0, 0), (0.014, _WIDE)),
        ((_LONG - 0.014, 0), (_LONG, _WIDE)),
        ((0, 0), (3.98, 0.014)),
        ((5.02, 0), (_LONG, 0.014)),
        ((0, _WIDE - 0.014), (_LONG, _WIDE)),
    ]
    mesh.box([(*low, 0) for low, _ in skirting], [(*high, 0.08) for _, high in skirting], "enamel")
    y, middle, bar = _WIDE + 0.12, (x0 + x1) / 2, 0.055
    uprights = [(x0, x0 + bar), (middle - bar, middle + bar), (x1 - bar, x1)]
    mesh.box([(a, y, z0) for a, _ in uprights], [(b, y + 0.06, z1) for _, b in uprights], "enamel")
    rails = [(z0, z0 + bar), (z0 + 0.95, z0 + 0.99), (z1 - bar, z1)]
    mesh.box(
        [(x0, y + 0.003, a) for a, _ in rails], [(x1, y + 0.057, b) for _, b in rails], "enamel"
    )
    mesh.box((x0 - 0.06, _WIDE - 0.16, z0 - 0.03), (x1 + 0.06, y, z0 + 0.004), "enamel")
    mesh.tube(
        [(middle, y - 0.004, 1.5), (middle, y - 0.04, 1.5), (middle, y - 0.04, 1.38)], 0.009, "rim"
    )
    _door(mesh)
    for x, z in ((3.82, 1.1), (3.5, 0.25)):
        mesh.box((x - 0.04, 0, z - 0.04), (x + 0.04, 0.01, z + 0.04), "white")
        mesh.box((x - 0.02, 0.01, z - 0.025), (x + 0.02, 0.014, z + 0.025), "enamel")
    return mesh


def _door(mesh: Mesh) -> None:
    """Add a door with four panels, its frame, handle and hinges."""
    left, right, top = 4.05, 4.95, 2.05
    mesh.box((left, 0, 0.006), (right, 0.012, top), "enamel")
    for x, z, wide, tall in (
        (0.12, 0.18, 0.28, 0.62),
        (0.5, 0.18, 0.28, 0.62),
        (0.12, 0.95, 0.28, 0.95),
        (0.5, 0.95, 0.28, 0.95),
    ):
        mesh.box((left + x, 0.012, z), (left + x + wide, 0.022, z + tall), "enamel")
        mesh.box(
            (left + x + 0.03, 0.022, z + 0.03),
            (left + x + wide - 0.03, 0.027, z + tall - 0.03),
            "enamel",
        )
    frame = [
        ((left - 0.07, 0), (left, top + 0.07)),
        ((right, 0), (right + 0.07, top + 0.07)),
        ((left, top), (right, top + 0.07)),
    ]
    mesh.box([(x, 0, z) for (x, z), _ in frame], [(x, 0.03, z) for _, (x, z) in frame], "enamel")
    mesh.box((left + 0.05, 0.012, 0.95), (left + 0.08, 0.02, 1.12), "rim")
    mesh.tube(
        [(left + 0.065, 0.015, 1.06), (left + 0.065, 0.06, 1.06), (left + 0.19, 0.06, 1.06)],
        0.009,
        "rim",
        10,
    )
    for z in (0.25, 1.75):
        mesh.tube([(right + 0.002, 0.03, z), (right + 0.002, 0.03, z + 0.09)], 0.008, "rim")


# What stands on the floor and hangs on the walls


def _furnish(stage: Stage, rng: np.random.Generator) -> None:
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
    for x, y, yaw in (
        (-0.62, -0.35, 0.12),
        (-0.58, 0.38, -0.1),
        (0.58, -0.36, 3.05),
        (0.6, 0.36, 3.3),
    ):
        _put(stage, furniture.chair(), _TABLE + np.array([x, y, 0]), yaw, (0.16, 0.24, 0.27))
    cables = Mesh()
    furniture.cable(
        cables, [(3.5, 0.02, 0.25), (3.45, 0.05, 0.0), (3.3, 0.1, 0.006), (3.1, 0.12, 0.006)]
    )
    furniture.cable(
        cables, [(0.4, 0.42, 0.02), (0.2, 0.3, 0.0), (0.3, 0.1, 0.006), (1.1, 0.06, 0.006)]
    )
    stage.add(cables, "cables")


def _rug(stage: Stage) -> None:
    """Lay a rug before the sofa, its edges a little wavy, with fringes at both ends."""
    mesh = Mesh()
    mesh.box((1.02, 0.72, 0), (2.2, 2.72, 0.012), "rug", 0.3)
    x = np.arange(1.03, 2.19, 0.025)
    for y, out in ((0.72, -0.06), (2.72, 0.06)):
        ends = np.sort([y, y + out])
        mesh.box(
            np.column_stack([x, 0 * x + ends[0], 0 * x]),
            np.column_stack([x + 0.009, 0 * x + ends[1], 0 * x + 0.005]),
            "curtain",
            0.7,
        )
    stage.add(mesh, "rug")


def _hang(stage: Stage, rng: np.random.Generator) -> None:
    x0, x1 = _WINDOW[:, 0]
    for start in (x0 - 0.38, x1 - 0.12):
        _put(stage, furniture.curtain(rng, 0.5, 2.32), (start, _WIDE - 0.17, 0.05), -np.pi / 2)
    rod, y = Mesh(), _WIDE - 0.25
    rod.tube([(x0 - 0.55, y, 2.39), (x1 + 0.55, y, 2.39)], 0.014, "rim", 12)
    for x in (x0 - 0.55, x1 + 0.55):
        rod.ball((x, y, 2.39), (0.03, 0.03, 0.03), "rim")
        rod.tube(
            [(x + 0.1 * np.sign(2.6 - x), y, 2.39), (x + 0.1 * np.sign(2.6 - x), _WIDE, 2.39)],
            0.01,
            "rim",
        )
    stage.add(rod, "curtain rod")
    for y, wide, tall, z in ((1.35, 0.7, 0.5, 1.62), (2.25, 0.42, 0.56, 1.65)):
        _put(stage, furniture.picture(wide, tall, "canvas", rng.random()), (0, y, z))
    _put(stage, furniture.picture(0.9, 0.6, "canvas", rng.random()), (_LONG, 3.0, 1.6), np.pi)
    _put(stage, furniture.clock(), (4.5, 0, 2.35), np.pi / 2)
    _put(stage, furniture.pendant(1.05), (*_TABLE[:2], _HIGH))


def _put(
    stage: Stage,
    mesh: Mesh,
    at: ArrayLike,
    yaw: float = 0.0,
    color: tuple[float, float, float] = (0.5, 0.5, 0.5),
) -> None:
    stage.put(mesh.to_blender("furniture", stage.materials, smooth=True), at, yaw, color)


# Outside and light


def _outside(stage: Stage, rng: np.random.Generator) -> None:
    """Put a lawn, a hedge, trees and the houses across the garden before the window."""
    mesh = Mesh()
    mesh.add(
        [(-60, -60, _GARDEN), (60, -60, _GARDEN), (60, 60, _GARDEN), (-60, 60, _GARDEN)], "grass"
    )
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
    _bulb("globe", _LAMP, 9.0, 0.16, warm)
    _bulb("pendant", (*_TABLE[:2], _HIGH - 1.12), 3.0, 0.04, warm)
    _bulb("floor lamp", (0.4, 0.42, 1.45), 3.0, 0.05, warm)
    for portal, watts in ((True, 1.0), (False, 66.0)):
        _window_light(portal, watts)


def _bulb(
    name: str, at: ArrayLike, watts: float, radius: float, color: tuple[float, float, float]
) -> None:
    light = bpy.data.lights.new(name, "POINT")
    light.energy, light.color, light.shadow_soft_size = watts, color, radius
    _shine(light, at)


def _window_light(portal: bool, watts: float) -> None:
    """Light the room through its window: a portal guides paths to the sky, a lamp makes up for what
    5.5 m swallow.

    A camera's range of brightness is far smaller than that between a room and the sky.
    """
    (x0, z0), (x1, z1) = _WINDOW
    light = bpy.data.lights.new("window", "AREA")
    light.shape, light.size, light.size_y, light.energy = "RECTANGLE", x1 - x0, z1 - z0, watts
    light.color, light.cycles.is_portal = (0.9, 0.96, 1.0), portal
    item = _shine(light, ((x0 + x1) / 2, _WIDE + 0.1, (z0 + z1) / 2))
    item.rotation_euler, item.visible_camera = (-np.pi / 2, 0.0, 0.0), False


def _shine(light: Any, at: ArrayLike) -> Any:
    item = bpy.data.objects.new(light.name, light)
    item.location = at
    bpy.context.scene.collection.objects.link(item)
    return item


# Materials


@recipe
def wall_paint(s: Shader) -> Any:
    """Emulsion paint on plaster: a faint grain, fainter clouds. The face's value is the colour."""
    color = s.mix(s.value, (0.72, 0.69, 0.62), (0.42, 0.52, 0.5))
    grained = s.shade(color, 0.93, 1.05, s.noise(55.0, 4, 0.7))
    return s.finish(s.shade(grained, 0.95, 1.03, s.noise(1.1, 3)), color)


@recipe
def ceiling(s: Shader) -> Any:
    """White distemper."""
    return s.finish(
        s.shade((0.8, 0.8, 0.78), 0.96, 1.02, s.noise(40.0, 4, 0.7)), (0.78, 0.78, 0.76)
    )


@recipe
def parquet(s: Shader) -> Any:
    """Oak boards along x, each with its own brown, varnished."""
    boards = s.bricks(
        ((0.4, 0.24, 0.12), (0.27, 0.15, 0.075), (0.05, 0.03, 0.02)),
        1.4,
        0.13,
        0.0025,
        s.position,
        0.37,
    )
    grain = s.noise(7.0, 6, 0.7, s.stretch(s.position, (0.8, 9.0, 1.0)))
    return s.finish(s.shade(boards.outputs[0], 0.72, 1.25, grain), (0.33, 0.2, 0.1), 0.3, 0.28)


@recipe
def oak(s: Shader) -> Any:
    """Oiled wood, light or dark by the face's value."""
    color = s.mix(s.value, (0.2, 0.11, 0.055), (0.5, 0.33, 0.17))
    grain = s.noise(9.0, 6, 0.7, s.stretch(s.object_position, (6.0, 0.9, 1.4)))
    return s.finish(s.shade(color, 0.68, 1.25, grain), (0.35, 0.22, 0.11), 0.2, 0.35)


@recipe
def book(s: Shader) -> Any:
    """Cloth and paper spines, a colour for each face value, with bands for title and author."""
    own = s.join(s.math("MULTIPLY", s.value, 613.0), 0.0, 0.0)
    dye = s.shade(s.cells(1.0, output="Color", at=own), 0.35, 0.75, s.value)
    color = s.mix(0.5, dye, s.mix(s.value, (0.3, 0.26, 0.2), (0.04, 0.035, 0.03)))
    lines = s.ramp(
        s.noise(1.0, 2, 0.5, s.join(s.math("MULTIPLY", s.height, 42.0), own, 0.0)), 0.6, 0.64
    )
    return s.finish(
        s.mix(lines, s.shade(color, 0.5, 0.95, s.noise(30.0, 4)), (0.6, 0.55, 0.4)),
        (0.2, 0.16, 0.13),
    )


@recipe
def glaze(s: Shader) -> Any:
    """Glazed earthenware, from sea green to clay by the face's value, speckled."""
    color = s.mix(s.value, (0.1, 0.22, 0.24), (0.55, 0.36, 0.22))
    return s.finish(
        s.shade(color, 0.6, 1.2, s.noise(24.0, 5, 0.7, s.object_position)),
        (0.3, 0.27, 0.22),
        0.4,
        0.12,
    )


@recipe
def screen(s: Shader) -> Any:
    """Dark glass of a display that is off."""
    return s.finish((0.012, 0.013, 0.015), (0.012, 0.013, 0.015), 0.35, 0.12)


@recipe
def magazine(s: Shader) -> Any:
    """Pages of photographs and columns of text; the face's value turns the leaf."""
    at = s.node(
        "ShaderNodeVectorMath",
        in0=s.object_position,
        in1=s.join(s.math("MULTIPLY", s.value, 31.0), 0.0, 0.0),
    )
    photo = s.cells(14.0, output="Color", at=at.outputs[0])
    text = s.bricks(
        ((0.62, 0.61, 0.57), (0.62, 0.61, 0.57), (0.16, 0.16, 0.16)),
        0.06,
        0.009,
        0.002,
        at.outputs[0],
    )
    picture = s.math("GREATER_THAN", s.noise(5.0, 1, 0.5, at.outputs[0]), 0.52)
    return s.finish(s.mix(picture, text.outputs[0], photo), (0.45, 0.44, 0.42), 0.15, 0.3)


@recipe
def fruit(s: Shader) -> Any:
    """Apples and oranges by the face's value."""
    color = s.mix(s.math("GREATER_THAN", s.value, 0.5), (0.5, 0.07, 0.03), (0.7, 0.33, 0.04))
    return s.finish(
        s.shade(color, 0.7, 1.25, s.noise(30.0, 4, 0.6, s.object_position)),
        (0.55, 0.2, 0.05),
        0.3,
        0.25,
    )


@recipe
def upholstery(s: Shader) -> Any:
    """Grey-blue wool: weave and wear."""
    weave = s.shade((0.17, 0.21, 0.26), 0.65, 1.35, s.noise(160.0, 2, 0.6, s.object_position))
    return s.finish(
        s.shade(weave, 0.75, 1.2, s.noise(4.0, 4, 0.6, s.object_position)), (0.17, 0.21, 0.26)
    )


@recipe
def rug(s: Shader) -> Any:
    """Nested lozenges in wool; the face's value shifts their colours."""
    x, y, z = s.split(s.object_position)
    across = s.math("PINGPONG", s.math("ADD", x, z), 0.16)
    ring = s.math("ADD", s.math("MULTIPLY", s.math("PINGPONG", y, 0.1), 1.6), across)
    warm = s.mix(s.value, (0.36, 0.08, 0.055), (0.5, 0.32, 0.1))
    inner = s.mix(s.math("GREATER_THAN", ring, 0.09), (0.08, 0.12, 0.18), (0.5, 0.43, 0.32))
    lozenges = s.mix(s.math("GREATER_THAN", ring, 0.13), inner, warm)
    outer = s.mix(s.math("GREATER_THAN", ring, 0.24), lozenges, (0.1, 0.13, 0.16))
    return s.finish(
        s.shade(outer, 0.65, 1.25, s.noise(130.0, 2, 0.6, s.object_position)), (0.28, 0.16, 0.11)
    )


@recipe
def curtain(s: Shader) -> Any:
    """Linen, from sand to ochre by the face's value."""
    color = s.mix(s.value, (0.4, 0.24, 0.1), (0.6, 0.53, 0.41))
    threads = s.noise(60.0, 3, 0.6, s.stretch(s.object_position, (1.0, 3.0, 0.3)))
    return s.finish(s.shade(color, 0.75, 1.15, threads), (0.5, 0.43, 0.32))


@recipe
def lamp_shade(s: Shader) -> Any:
    """Parchment with a lamp behind."""
    return s.glow((1.0, 0.82, 0.58), 0.7)


@recipe
def bulb(s: Shader) -> Any:
    """Frosted glass that shines."""
    return s.glow((1.0, 0.92, 0.8), 1.7)


@recipe
def enamel(s: Shader) -> Any:
    """White gloss paint on wood and iron."""
    return s.finish(
        s.shade((0.74, 0.73, 0.7), 0.94, 1.03, s.noise(18.0, 4)), (0.72, 0.71, 0.68), 0.25, 0.25
    )


@recipe
def wicker(s: Shader) -> Any:
    """Woven willow."""
    rows = s.bricks(
        ((0.42, 0.28, 0.14), (0.27, 0.16, 0.08), (0.05, 0.03, 0.02)), 0.045, 0.016, 0.003
    )
    return s.finish(s.shade(rows.outputs[0], 0.6, 1.25, s.noise(30.0, 4)), (0.3, 0.19, 0.1))


@recipe
def canvas(s: Shader) -> Any:
    """Painted shapes in the colours of sea and fields, another one for each face value."""
    offset = s.join(s.math("MULTIPLY", s.value, 77.0), 0.0, 0.0)
    at = s.node("ShaderNodeVectorMath", in0=s.object_position, in1=offset).outputs[0]
    shapes = s.mix(s.ramp(s.noise(3.2, 3, 0.5, at), 0.46, 0.5), (0.08, 0.2, 0.28), (0.62, 0.5, 0.3))
    strokes = s.mix(s.ramp(s.noise(6.5, 4, 0.6, at), 0.56, 0.6), shapes, (0.5, 0.15, 0.08))
    return s.finish(s.shade(strokes, 0.6, 1.2, s.noise(40.0, 5, 0.7)), (0.33, 0.28, 0.22))
