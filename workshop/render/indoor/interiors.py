"""Build the rooms that `rooms` plans: shell, windows, paint, what is outside, lamps."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from workshop.render.city import nature
from workshop.render.city.district import Stage
from workshop.render.indoor.rooms import SMALL_MATERIALS, Opening, RoomPlan, wall_frame
from workshop.render.surfaces.lights import add_lamp, add_light, random_sky
from workshop.render.surfaces.mesh_builder import Mesh
from workshop.render.surfaces.patterns import random_color, random_material, random_materials
from workshop.render.surfaces.shader import Shader

_WALL = 0.25  # thickness
_GARDEN = -0.6  # height of the ground outside


def build_room(plan: RoomPlan, rng: np.random.Generator) -> None:
    """Fill the current Blender scene with a room, what its windows show, and light."""
    stage = Stage(random_materials(rng, SMALL_MATERIALS, scale=4.0))
    _choose_materials(stage, rng)
    stage.add(_shell(plan), "shell")
    stage.add(_window_frames(plan), "frames") if plan.windows else None
    for piece in plan.pieces:
        mesh = piece.mesh.to_blender("piece", stage.materials, smooth=True)
        stage.put(mesh, piece.at, piece.yaw, random_color(rng), piece.scale)
    lamps = not plan.windows or rng.random() < 0.6
    if plan.windows:
        _outside(stage, plan, rng)
    add_light(random_sky(rng))
    for opening in plan.windows:
        _window_light(plan, opening, float(rng.uniform(8, 25)))
    if lamps:
        _light_lamps(stage, plan, rng)
    cycles = bpy.context.scene.cycles
    cycles.max_bounces, cycles.diffuse_bounces, cycles.glossy_bounces = 3, 2, 1


def _paint(rng: np.random.Generator, lightest: float = 0.8) -> Any:
    """Return the material of a blank wall: pale, plain or with a grain of a few percent."""
    value, hue = rng.uniform(0.25, lightest) ** 0.5 * lightest**0.5, rng.uniform(0.92, 1.0, 3)
    color = tuple(float(c) for c in value * hue)
    s, grain = Shader("paint"), rng.choice([0.0, 0.015, 0.04])
    noise = s.noise(float(rng.uniform(20, 70)), 4, 0.7)
    return s.finish(s.shade(color, 1 - grain, 1 + grain, noise), color)


def _choose_materials(stage: Stage, rng: np.random.Generator) -> None:
    """Draw the materials of walls, floor, ceiling and what furniture is made of."""
    made, metres = stage.materials, {"world": True, "gloss": 0.3}
    walls = ("bricks", "checks", "stripes", "clouds", "blots", "print")
    blank, accent = _paint(rng), rng.integers(4) if rng.random() < 0.35 else -1
    if rng.random() < 0.2:
        blank = random_material(rng, walls, float(rng.uniform(0.6, 3)), **metres)
    for side in range(4):
        made[f"wall{side}"] = blank
        if side == accent:
            made[f"wall{side}"] = random_material(rng, walls, float(rng.uniform(0.6, 3)), **metres)
    made["wall"] = blank
    if rng.random() < 0.8:
        made["ceiling"] = _paint(rng)
    else:
        made["ceiling"] = random_material(rng, ("bricks", "checks"), 1.0, **metres)
    floors = ("plain", "grain", "bricks", "bricks", "checks", "clouds", "stripes")
    brown = [(0.42, 0.26, 0.13), (0.2, 0.11, 0.06)] if rng.random() < 0.4 else None
    made["floor"] = random_material(rng, floors, float(rng.uniform(1, 3)), brown, **metres)
    cloths = {
        "upholstery": (("plain", "grain", "stripes", "checks", "cells"), 4.0),
        "rug": (("cells", "stripes", "checks", "blots", "cracks"), 4.0),
        "canvas": (("cells", "blots", "clouds", "print", "gradient"), 3.0),
    }
    for name, (patterns, scale) in cloths.items():
        made[name] = random_material(rng, patterns, scale, gloss=0.0)
    if rng.random() < 0.5:
        made["oak"] = _paint(rng)
    if rng.random() < 0.6:
        patterns = ("plain", "stripes", "grain", "print")
        made["curtain"] = random_material(rng, patterns, 3.0, gloss=0.0)


def _shell(plan: RoomPlan) -> Mesh:
    """Return floor, ceiling, skirting and walls; walls are built around their windows."""
    mesh, (x, y, z) = Mesh(), plan.size
    mesh.box((0, 0, -0.2), (x, y, 0), "floor")
    mesh.box((-_WALL, -_WALL, z), (x + _WALL, y + _WALL, z + 0.2), "ceiling")
    for side in range(4):
        start, along, outward, length = wall_frame(plan.size, side)
        mesh.place(start, along, outward)
        edge = -_WALL
        for opening in (w for w in plan.windows if w.side == side):
            mesh.box((edge, 0, _GARDEN), (opening.start, _WALL, z), f"wall{side}")
            mesh.box((opening.start, 0, _GARDEN), (opening.end, _WALL, opening.sill), f"wall{side}")
            mesh.box((opening.start, 0, opening.top), (opening.end, _WALL, z), f"wall{side}")
            edge = opening.end
        mesh.box((edge, 0, _GARDEN), (length + _WALL, _WALL, z), f"wall{side}")
        mesh.box((0, -0.012, 0), (length, 0, 0.07), "enamel")
    mesh.place()
    return mesh


def _window_frames(plan: RoomPlan) -> Mesh:
    mesh = Mesh()
    for w in plan.windows:
        start, along, outward, _ = wall_frame(plan.size, w.side)
        mesh.place(start, along, outward)
        bars = np.linspace(w.start, w.end - 0.06, 2 + int((w.end - w.start) > 1.2))
        mesh.box((bars, 0.1, w.sill), (bars + 0.06, 0.16, w.top), "enamel")
        rails = np.array([w.sill, w.top - 0.06])
        mesh.box((w.start, 0.103, rails), (w.end, 0.157, rails + 0.06), "enamel")
    return mesh


def _outside(stage: Stage, plan: RoomPlan, rng: np.random.Generator) -> None:
    """Put a ground, houses as plain blocks, and a few trees around the room."""
    ground, center = Mesh(), plan.size[:2] / 2
    ground.floor((-200, -200), (200, 200), _GARDEN, "grass")
    away = np.linalg.norm(plan.size[:2])
    for k in range(10):
        angle, far = rng.uniform(0, 2 * np.pi), away + rng.uniform(14, 60)
        half = rng.uniform(3, 9, 2)
        at = center + far * np.array([np.cos(angle), np.sin(angle)])
        top, wall = rng.uniform(3, 20), ("brick", "plaster", "skyline")[k % 3]
        ground.box((*(at - half), _GARDEN), (*(at + half), top), wall)
    stage.add(ground, "outside", random_color(rng))
    tree = nature.tree(rng, 5.5, 1.6).to_blender("tree", stage.materials, smooth=True)
    for _ in range(5):
        angle, far = rng.uniform(0, 2 * np.pi), away / 2 + rng.uniform(3.5, 12)
        at = center + far * np.array([np.cos(angle), np.sin(angle)])
        stage.put(tree, (*at, _GARDEN), angle)


def _window_light(plan: RoomPlan, w: Opening, watts: float) -> None:
    """Shine through a window: a camera's range is smaller than from a room to the sky."""
    start, along, outward, _ = wall_frame(plan.size, w.side)
    wide, high = w.end - w.start, w.top - w.sill
    middle = start + along * (w.start + w.end) / 2 + outward * 0.2
    at, color = (*middle[:2], (w.sill + w.top) / 2), (0.9, 0.96, 1.0)
    item = add_lamp("AREA", at, watts * wide * high, color, (wide, high))
    item.visible_camera = False
    item.rotation_euler = (np.pi / 2, 0.0, float(np.arctan2(-outward[1], -outward[0])) + np.pi / 2)


def _light_lamps(stage: Stage, plan: RoomPlan, rng: np.random.Generator) -> None:
    """Mount square or round panels under the ceiling that shine downwards."""
    half = rng.uniform(0.08, 0.6, 2)
    watts = float(rng.uniform(4, 14) * plan.size[0] * plan.size[1] / len(plan.lamps))
    mesh = Mesh()
    for x, y, z in plan.lamps:
        mesh.box((x - half[0], y - half[1], z), (x + half[0], y + half[1], plan.size[2]), "bulb")
        color = (1.0, rng.uniform(0.8, 0.98), rng.uniform(0.6, 0.95))
        add_lamp("AREA", (x, y, z - 0.01), watts, color, 2 * half).visible_camera = False
    stage.add(mesh, "lamps")
