"""Scenes of many things at all distances around the rig: floating or on a ground, before a far
background or none.

World frame: the rig centre is the origin, z up, metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.geometry.pose import Pose
from workshop.render.city import nature, street, vehicles
from workshop.render.city.drive import level_rig
from workshop.render.indoor import furniture
from workshop.render.surfaces.mesh_builder import Mesh
from workshop.render.things.shapes import bounds_after, distance_to_box, random_shape

_FARTHEST = 30.0  # of the things; backgrounds are farther or at infinity
_MATERIALS = 18
MAX_TILT_DEG = 15.0
_MODELS = {
    "person": lambda rng: nature.person(rng, walking=rng.random() < 0.5),
    "tree": lambda rng: nature.tree(rng, rng.uniform(3, 7), rng.uniform(1, 2)),
    "plant": lambda rng: furniture.plant(rng, rng.uniform(0.7, 1.4)),
    "chair": lambda rng: furniture.chair(),
    "sofa": lambda rng: furniture.sofa(rng),
    "table": lambda rng: furniture.table(rng),
    "bookcase": lambda rng: furniture.bookcase(rng, rng.uniform(0.8, 2), rng.uniform(1, 2.2)),
    "car": lambda rng: vehicles.car(str(rng.choice(list(vehicles.BODIES)))),
    "bicycle": lambda rng: street.bicycle(),
    "bench": lambda rng: street.bench(),
    "sign": lambda rng: street.sign(int(rng.integers(4))),
    "lamp": lambda rng: street.lamp_post(),
}


@dataclass(frozen=True)
class Thing:
    """A mesh with its place: position (3,), m, Euler angles, rad, a factor on its size."""

    mesh: Mesh
    at: NDArray[np.float64]
    angles: tuple[float, float, float]
    scale: float
    nearest: float  # lower bound of its distance from the rig centre, metres


@dataclass(frozen=True)
class ThingsPlan:
    """All that is drawn at random before Blender builds the scene."""

    min_depth: float
    T_world_rig: Pose
    ground: float | None  # height, below the rig
    backdrop: str  # "sky" | "plain" | "box" | "ball"
    extent: NDArray[np.float64]  # half the size of the backdrop along x, y, z
    things: tuple[Thing, ...]


def random_pose(rng: np.random.Generator, at: NDArray[np.float64]) -> Pose:
    """Draw T_world_rig at a place: any heading, tilted by at most `MAX_TILT_DEG`."""
    axis, tilt = rng.uniform(0, 2 * np.pi), np.radians(MAX_TILT_DEG) * np.sqrt(rng.random())
    tilted = Pose.from_vector([tilt * np.cos(axis), 0, tilt * np.sin(axis), 0, 0, 0])
    return Pose(level_rig(rng.uniform(-np.pi, np.pi)) @ tilted.R, np.asarray(at, float))


def plan_things(rng: np.random.Generator) -> ThingsPlan:
    """Draw a scene; nothing in it is nearer to the rig centre than its `min_depth`."""
    min_depth = float(np.exp(rng.uniform(np.log(0.4), np.log(3.0))))
    backdrop = str(rng.choice(["sky", "plain", "box", "ball"], p=[0.4, 0.15, 0.3, 0.15]))
    extent = np.exp(rng.uniform(np.log(8.0 + 2 * min_depth), np.log(60.0), 3))
    extent[2] = min(extent[2], rng.uniform(8, 25))
    if backdrop == "ball":
        extent[:] = extent[0]
    ground = -min_depth * float(np.exp(rng.uniform(0.05, 1.6))) if rng.random() < 0.5 else None
    farthest = _FARTHEST if backdrop in ("sky", "plain") else 0.95 * float(extent.min())
    things = [_floating(rng, min_depth, farthest) for _ in range(rng.integers(30, 110))]
    if ground is not None:
        things = [thing for thing in things if thing.at[2] - thing.scale > ground]
        things += [_standing(rng, min_depth, farthest, ground) for _ in range(rng.integers(15, 60))]
    kept = tuple(thing for thing in things if thing.nearest > min_depth)
    return ThingsPlan(min_depth, random_pose(rng, np.zeros(3)), ground, backdrop, extent, kept)


def _names(rng: np.random.Generator) -> list[str]:
    return [str(k) for k in rng.integers(0, _MATERIALS, 3)]


def _floating(rng: np.random.Generator, min_depth: float, farthest: float) -> Thing:
    """Draw a shape in any direction; its distance and its apparent size are log-uniform."""
    nearest = np.exp(rng.uniform(np.log(1.03 * min_depth), np.log(farthest)))
    radius = nearest * np.exp(rng.uniform(np.log(0.07), np.log(0.7)))
    up, around = np.radians(np.clip(rng.normal(0, 30), -80, 80)), rng.uniform(0, 2 * np.pi)
    direction = np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])
    angles = tuple(rng.uniform(-np.pi, np.pi, 3))
    mesh, at = random_shape(rng, _names(rng)), (nearest + radius) * direction
    return Thing(mesh, at, angles, float(radius), float(nearest))


def _standing(rng: np.random.Generator, min_depth: float, farthest: float, ground: float) -> Thing:
    """Draw a shape or a model that stands on the ground."""
    distance = np.exp(rng.uniform(np.log(1.1 * min_depth), np.log(farthest)))
    around = rng.uniform(0, 2 * np.pi)
    if rng.random() < 0.5:
        mesh = random_shape(rng, _names(rng))
        scale = distance * np.exp(rng.uniform(np.log(0.1), np.log(0.6)))
    else:
        mesh, scale = _MODELS[str(rng.choice(list(_MODELS)))](rng), rng.uniform(0.6, 1.5)
    yaw = rng.uniform(-np.pi, np.pi)
    at = np.array([distance * np.cos(around), distance * np.sin(around), ground])
    at[2] -= scale * mesh.bounds()[0, 2]
    nearest = distance_to_box(np.zeros(3), bounds_after(mesh, yaw, scale, at))
    return Thing(mesh, at, (0.0, 0.0, yaw), float(scale), nearest)


def build_things(plan: ThingsPlan, rng: np.random.Generator) -> None:
    """Fill the current Blender scene."""
    from workshop.render.city.district import Stage
    from workshop.render.surfaces.patterns import random_color, random_materials

    stage = Stage(random_materials(rng, _MATERIALS))
    for thing in plan.things:
        mesh = thing.mesh.to_blender("thing", stage.materials, smooth=True)
        item = stage.put(mesh, thing.at, 0.0, random_color(rng), thing.scale)
        item.rotation_euler = thing.angles
    _add_ground(stage, plan, rng)
    if plan.backdrop in ("box", "ball"):
        _add_backdrop(stage, plan, rng)
    _add_lights(plan, rng)


def _add_ground(stage: Any, plan: ThingsPlan, rng: np.random.Generator) -> None:
    from workshop.render.surfaces.patterns import random_material

    if plan.ground is None:
        return
    scale = float(rng.uniform(0.2, 1.5))
    stage.materials["ground"] = random_material(rng, scale=scale, world=True, gloss=0.3)
    mesh = Mesh()
    mesh.floor((-400, -400), (400, 400), plan.ground, "ground")
    stage.add(mesh, "ground")


def _add_backdrop(stage: Any, plan: ThingsPlan, rng: np.random.Generator) -> None:
    """Enclose the scene; light passes through, so that the sky lights what is inside."""
    from workshop.render.surfaces.patterns import PATTERNS, random_material

    mesh, walls = Mesh(), ("plain",) if rng.random() < 0.35 else PATTERNS
    for k in range(6):
        scale = float(np.exp(rng.uniform(np.log(0.04), np.log(0.6))))
        stage.materials[f"wall{k}"] = random_material(rng, walls, scale, world=True, gloss=0.0)
    if plan.backdrop == "ball":
        mesh.ball((0, 0, 0), plan.extent, "wall0", 48)
    else:
        (x, y, z), thick = plan.extent, 0.1
        for k, axis in enumerate((0, 1, 2, 0, 1, 2)):
            low, high = np.array([-x, -y, -z]), np.array([x, y, z])
            if k < 3:
                high[axis] = low[axis] + thick
            else:
                low[axis] = high[axis] - thick
            mesh.box(low, high, f"wall{k}")
    smooth = plan.backdrop == "ball"
    item = stage.put(mesh.to_blender("backdrop", stage.materials, smooth), (0, 0, 0))
    item.visible_shadow = item.visible_diffuse = False


def _add_lights(plan: ThingsPlan, rng: np.random.Generator) -> None:
    """Light the scene with sky and sun, or a dome; add up to three lamps."""
    from workshop.render.surfaces.lights import add_dome, add_lamp, add_light, random_sky
    from workshop.render.surfaces.patterns import random_color

    if plan.backdrop == "sky" and plan.ground is None:
        add_light("cloudy")  # the other skies are black below the horizon
    elif plan.backdrop == "sky" or rng.random() < 0.5:
        add_light(random_sky(rng))
    else:
        add_dome([random_color(rng, 0.5) for _ in range(2)], float(rng.uniform(0.4, 1.2)))
    for _ in range(rng.integers(0, 4)):
        away, (x, y, z) = rng.uniform(3, 12), rng.normal(size=3)
        at = away * np.array([x, y, abs(z)]) / np.linalg.norm([x, y, z])
        watts, radius = 20 * away**2 * rng.uniform(0.3, 2), rng.uniform(0.02, 1.0)
        lamp = add_lamp("POINT", at, watts, np.array(random_color(rng, 0.4)) + 0.4, radius)
        lamp.visible_camera = False
