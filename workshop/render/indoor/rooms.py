"""Rooms, corridors and halls, each with walls, windows, lamps and furniture of its own.

World frame: x along the room, y across, z up, metres; the floor is z = 0 and one corner is the
origin.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from omnistereo_lib.geometry.pose import Floats, Pose
from workshop.render.city import nature
from workshop.render.indoor import furniture
from workshop.render.surfaces.mesh_builder import Mesh, points
from workshop.render.things.scenes import random_pose
from workshop.render.things.shapes import bounds_after, distance_to_box, random_shape

_KINDS = {  # lowest and highest (length, width, height) in metres, and largest min_depth of the rig
    "room": ((3.2, 2.8, 2.35), (7.0, 5.5, 3.0), 0.9),
    "corridor": ((8.0, 1.7, 2.3), (25.0, 3.2, 3.0), 0.7),
    "hall": ((9.0, 7.0, 3.2), (26.0, 18.0, 7.0), 2.2),
}
# yaw of what has its back to the wall at x = 0, y = 0, far x, far y
_SIDES = (0.0, np.pi / 2, np.pi, -np.pi / 2)
SMALL_MATERIALS = 6  # random materials "0" to "5" of small things


@dataclass(frozen=True)
class Opening:
    """A window in a wall: side (see `wall_frame`), extent along the wall and upwards, metres."""

    side: int
    start: float
    end: float
    sill: float
    top: float


@dataclass(frozen=True)
class Piece:
    """Something in the room: mesh, position (3,), yaw, scale, and its box, (2, 3)."""

    mesh: Mesh
    at: Floats
    yaw: float
    scale: float
    box: Floats


@dataclass
class RoomPlan:
    """All that is drawn at random before Blender builds the room."""

    size: Floats  # (length, width, height)
    min_depth: float
    T_world_rig: Pose
    windows: list[Opening] = field(default_factory=list)
    # positions under the ceiling, (3,)
    lamps: list[Floats] = field(default_factory=list)
    pieces: list[Piece] = field(default_factory=list)


def wall_frame(size: Floats, side: int) -> tuple[NDArray, NDArray, NDArray, float]:
    """Return start (3,), direction along (3,), direction outwards (3,) and length of a wall.

    Sides 0 to 3 are x = 0, y = 0, x = length, y = width.
    """
    x, y = size[0], size[1]
    starts = ((0, y, 0), (0, 0, 0), (x, 0, 0), (x, y, 0))
    along = np.array(((0, -1, 0), (1, 0, 0), (0, 1, 0), (-1, 0, 0))[side], float)
    outward = np.array(((-1, 0, 0), (0, -1, 0), (1, 0, 0), (0, 1, 0))[side], float)
    return np.array(starts[side], float), along, outward, float((y, x, y, x)[side])


def plan_room(rng: Generator) -> RoomPlan:
    """Draw a room; nothing in it is nearer to the rig centre than its `min_depth`."""
    kind = str(rng.choice(list(_KINDS), p=[0.6, 0.2, 0.2]))
    low, high, largest = _KINDS[kind]
    size = rng.uniform(low, high)
    largest = min(largest, 0.42 * size[1], 0.42 * size[2])
    min_depth = float(np.exp(rng.uniform(np.log(0.3), np.log(largest))))
    margin = 1.04 * min_depth + 0.05
    at = rng.uniform((margin,) * 3, size - margin)
    at[2] = np.clip(rng.uniform(0.7, 1.8), margin, size[2] - margin)
    plan = RoomPlan(size, min_depth, random_pose(rng, at))
    _plan_windows(plan, rng)
    _plan_lamps(plan, rng)
    _furnish(plan, rng, float(np.clip(size[0] * size[1] * 2, 25, 110) * rng.uniform(0.15, 1.3)))
    return plan


def _plan_windows(plan: RoomPlan, rng: Generator) -> None:
    if rng.random() < 0.25:
        return
    for side in rng.choice(4, int(rng.integers(1, 3)), replace=False):
        length = wall_frame(plan.size, side)[3]
        wide, sill = rng.uniform(0.7, 2.2), rng.choice([0.05, 0.4, 0.85, 1.0])
        top = min(plan.size[2] - 0.15, sill + rng.uniform(0.9, 2.0))
        count = min(int(length / (wide + rng.uniform(0.4, 2.5))), 6)
        for k in range(count):
            left, right = ((k + 0.5) * length / count + half for half in (-wide / 2, wide / 2))
            plan.windows.append(Opening(int(side), left, right, float(sill), float(top)))


def _plan_lamps(plan: RoomPlan, rng: Generator) -> None:
    nx, ny = (max(1, round(extent / rng.uniform(2.5, 5.0))) for extent in plan.size[:2])
    for i in range(min(nx, 4)):
        for j in range(min(ny, 2)):
            x, y = (i + 0.5) / min(nx, 4) * plan.size[0], (j + 0.5) / min(ny, 2) * plan.size[1]
            plan.lamps.append(np.array([x, y, plan.size[2] - 0.03]))


def _furnish(plan: RoomPlan, rng: Generator, count: float) -> None:
    for _ in range(round(count)):
        pick = rng.random()
        if pick < 0.45:
            _at_wall(plan, rng)
        elif pick < 0.6:
            _on_wall(plan, rng)
        elif pick < 0.9:
            _stand(plan, _FREE[str(rng.choice(list(_FREE)))](rng), rng)
        else:
            _table_with_things(plan, rng)


def _place(plan: RoomPlan, mesh: Mesh, at: Floats, yaw: float, scale: float = 1.0) -> bool:
    """Add a piece if it is inside the room and clear of rig and pieces; return whether."""
    box = bounds_after(mesh, yaw, scale, at)
    if (box[0] < -0.01).any() or (box[1] > plan.size + 0.01).any():
        return False
    if distance_to_box(plan.T_world_rig.t, box) < 1.03 * plan.min_depth:
        return False
    for other in plan.pieces:
        if ((box[0] < other.box[1] - 0.02) & (box[1] > other.box[0] + 0.02)).all():
            return False
    plan.pieces.append(Piece(mesh, at, yaw, scale, box))
    return True


def _at_wall(plan: RoomPlan, rng: Generator) -> None:
    """Stand a piece of furniture with its back to a wall."""
    name = str(rng.choice(list(_BACKED)))
    mesh, side = _BACKED[name](rng), int(rng.integers(4))
    (x0, y0, _), (_, y1, top) = mesh.bounds()
    start, along, outward, length = wall_frame(plan.size, side)
    blocked = any(w.side == side and w.sill < top - 0.1 for w in plan.windows)
    if y1 - y0 > length - 0.1 or (blocked and name != "curtain"):
        return
    s = rng.uniform(0.05, length - (y1 - y0) - 0.05)
    # The piece's +x points into the room; its y axis is then against `along` or with it.
    yaw = _SIDES[side]
    y_axis = np.array([-np.sin(yaw), np.cos(yaw), 0])
    first = s - y0 if y_axis @ along > 0 else s + y1
    _place(plan, mesh, start + first * along + outward * (x0 - 0.012), yaw)


def _on_wall(plan: RoomPlan, rng: Generator) -> None:
    """Hang a picture, a clock or a board on a wall without windows."""
    side = int(rng.integers(4))
    start, along, outward, length = wall_frame(plan.size, side)
    if any(w.side == side for w in plan.windows):
        return
    wide = rng.uniform(0.3, 1.8)
    kind = str(rng.choice(["0", "1", "2", "white", "canvas"]))
    mesh = (
        furniture.clock()
        if rng.random() < 0.15
        else furniture.picture(wide, wide * rng.uniform(0.5, 1.2), kind, 0.5)
    )
    at = start + rng.uniform(0.5, 0.95) * length * along - 0.004 * outward
    at[2] += rng.uniform(1.2, 1.8)
    _place(plan, mesh, at, _SIDES[side])


def _stand(plan: RoomPlan, mesh: Mesh, rng: Generator) -> None:
    """Stand something anywhere on the floor."""
    at = np.array([*rng.uniform((0.3, 0.3), plan.size[:2] - 0.3), 0.0])
    _place(plan, mesh, at - (0, 0, mesh.bounds()[0, 2]), rng.uniform(-np.pi, np.pi))


def _table_with_things(plan: RoomPlan, rng: Generator) -> None:
    """Stand a table somewhere, chairs at it and small things on it."""
    long, wide, high = rng.uniform(0.8, 2.0), rng.uniform(0.5, 1.0), rng.uniform(0.45, 0.95)
    yaw = rng.choice(_SIDES) + rng.normal(0, 0.05)
    at = np.array([*rng.uniform((0.6, 0.6), plan.size[:2] - 0.6), 0.0])
    if not _place(plan, _desk(long, wide, high), at, yaw):
        return
    c, s = np.cos(yaw), np.sin(yaw)
    half = np.array([wide, long]) / 2
    for x, y in 0.85 * rng.uniform(-half, half, (int(rng.integers(3, 12)), 2)):
        thing = random_shape(rng, [str(k) for k in rng.integers(0, SMALL_MATERIALS, 3)])
        size = rng.uniform(0.04, 0.16)
        up = high - size * thing.bounds()[0, 2]
        spot = at + np.array([c * x - s * y, s * x + c * y, up])
        _place(plan, thing, spot, rng.uniform(-np.pi, np.pi), size)
    for x, y in ((-wide / 2 - 0.28, 0.0), (wide / 2 + 0.28, rng.uniform(-0.2, 0.2))):
        seat = at + np.array([c * x - s * y, s * x + c * y, 0])
        _place(plan, furniture.chair(), seat, yaw + (0 if x < 0 else np.pi) + rng.normal(0, 0.2))


# Furniture that only these rooms have; "0" to "5" are random materials


def _desk(long: float, wide: float, high: float) -> Mesh:
    mesh, half = Mesh(), np.array([wide, long]) / 2
    mesh.box((*-half, high - 0.03), (*half, high), "oak", 0.7)
    for i in (-1, 1):
        for j in (-1, 1):
            x, y = half * (i, j) * 0.92
            mesh.box((x - 0.02, y - 0.02, 0), (x + 0.02, y + 0.02, high - 0.03), "dark_trim")
    return mesh


def _cupboard(rng: Generator) -> Mesh:
    mesh, deep = Mesh(), rng.uniform(0.3, 0.65)
    wide, high = rng.uniform(0.5, 2.2), rng.uniform(0.7, 2.2)
    paint = str(rng.choice(["enamel", "oak", "0", "1"]))
    mesh.box((0, 0, 0), (deep, wide, high), paint)
    count = max(1, round(wide / 0.5))
    for k in range(count):
        a, b = k * wide / count + 0.008, (k + 1) * wide / count - 0.008
        mesh.box((deep, a, 0.08), (deep + 0.018, b, high - 0.02), paint, 0.6)
        handle = points(deep + 0.04, b - 0.05, (0.5 * high, 0.5 * high + 0.12))
        mesh.tube(handle, 0.007, "rim")
    return mesh


def _door(rng: Generator) -> Mesh:
    mesh, wide, high = Mesh(), rng.uniform(0.75, 1.0), rng.uniform(1.98, 2.15)
    paint = str(rng.choice(["enamel", "oak", "2"]))
    mesh.box((0, -0.07, 0), (0.03, 0, high), "enamel")
    mesh.box((0, wide, 0), (0.03, wide + 0.07, high), "enamel")
    mesh.box((0, -0.07, high), (0.03, wide + 0.07, high + 0.07), "enamel")
    mesh.box((0, 0, 0.005), (0.015, wide, high), paint)
    handle = points((0.015, 0.06, 0.06), (wide - 0.07, wide - 0.07, wide - 0.19), 1.05)
    mesh.tube(handle, 0.009, "rim", 8)
    return mesh


def _bed(rng: Generator) -> Mesh:
    mesh, wide = Mesh(), rng.uniform(0.9, 1.8)
    mesh.box((0, 0, 0.1), (2.0, wide, 0.3), "oak", 0.4)
    furniture.cushion(mesh, (1.02, wide / 2, 0.4), (1.95, wide, 0.24), "curtain", 0.9)
    furniture.cushion(mesh, (0.3, wide / 2, 0.56), (0.4, 0.75 * wide, 0.14), "3")
    furniture.cushion(mesh, (1.35, wide / 2, 0.5), (1.3, wide + 0.05, 0.12), "upholstery")
    return mesh


def _cartons(rng: Generator) -> Mesh:
    mesh, z = Mesh(), 0.0
    for _ in range(int(rng.integers(1, 4))):
        half, high = rng.uniform(0.12, 0.3, 2), rng.uniform(0.15, 0.45)
        x, y = rng.normal(0, 0.04, 2)
        low, top = (x - half[0], y - half[1], z), (x + half[0], y + half[1], z + high)
        mesh.box(low, top, str(rng.integers(SMALL_MATERIALS)))
        z += high
    return mesh


def _pillar(rng: Generator) -> Mesh:
    mesh, half = Mesh(), rng.uniform(0.12, 0.3)
    if rng.random() < 0.5:
        mesh.box((-half, -half, 0), (half, half, 2.3), "wall")
    else:
        mesh.tube([(0, 0, 0), (0, 0, 2.3)], half, "wall", 24)
    return mesh


def _toy(rng: Generator) -> Mesh:
    """Return a ball, a block or another shape on the floor."""
    mesh, size = Mesh(), rng.uniform(0.08, 0.35)
    if rng.random() < 0.5:
        mesh.ball((0, 0, size), np.full(3, size), str(rng.integers(SMALL_MATERIALS)), 14)
    else:
        low, high = (-size, -0.7 * size, 0), (size, 0.7 * size, size)
        mesh.box(low, high, str(rng.integers(SMALL_MATERIALS)))
    return mesh


_BACKED: dict[str, Callable[[Generator], Mesh]] = {
    "bookcase": lambda rng: furniture.bookcase(rng, rng.uniform(0.7, 2.4), rng.uniform(0.8, 2.2)),
    "sofa": lambda rng: furniture.sofa(rng, rng.uniform(1.5, 2.4)),
    "sideboard": lambda rng: furniture.sideboard(rng, rng.uniform(1.4, 2.0)),
    "radiator": lambda rng: furniture.radiator(rng.uniform(0.6, 1.6)),
    "curtain": lambda rng: furniture.curtain(rng, rng.uniform(0.4, 1.6), rng.uniform(1.9, 2.25)),
    "shoes": furniture.shoes,
    "cupboard": _cupboard,
    "door": _door,
    "bed": _bed,
}
_FREE: dict[str, Callable[[Generator], Mesh]] = {
    "person": lambda rng: nature.person(rng, walking=rng.random() < 0.3),
    "somebody": lambda rng: nature.person(rng, walking=False),
    "chair": lambda rng: furniture.chair(),
    "table": lambda rng: furniture.table(rng, rng.uniform(1.1, 2.0)),
    "low_table": furniture.low_table,
    "plant": lambda rng: furniture.plant(rng, rng.uniform(0.6, 1.5)),
    "lamp": lambda rng: furniture.floor_lamp(),
    "basket": furniture.basket,
    "cartons": _cartons,
    "pillar": _pillar,
    "toy": _toy,
}
