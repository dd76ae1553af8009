"""The lights of the paper: sunny, cloudy, sunset; each a sky, two with a sun."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import bpy
import numpy as np
from numpy.typing import ArrayLike

from workshop.render.surfaces.shader import Color, Nodes, Socket


@dataclass(frozen=True)
class Light:
    """One weather; angles in degrees, strengths in Blender's units, exposure a factor."""

    elevation: float
    azimuth: float  # of the sun, counter-clockwise from east
    sun: float
    sun_color: Color
    sky: float
    clouds: float  # share of the sky covered
    overcast: bool
    exposure: float


LIGHTS = {
    "sunny": Light(52.0, 37.0, 4.2, (1.0, 0.94, 0.84), 0.22, 0.35, False, 0.62),
    "cloudy": Light(60.0, 37.0, 0.0, (1.0, 1.0, 1.0), 1.0, 1.0, True, 1.0),
    # Almost along the streets that run east, so that it reaches the ground and shines into the
    # lens.
    "sunset": Light(9.0, 172.0, 3.6, (1.0, 0.56, 0.26), 0.42, 0.5, False, 1.15),
}


def add_light(name: str | Light) -> Light:
    """Give the scene the sky and sun of `LIGHTS[name]`, or of another light; return it."""
    light = LIGHTS[name] if isinstance(name, str) else name
    world = _new_world("sky")
    _shine_as_sky(Nodes(world.node_tree), light)
    world.cycles.sampling_method, world.cycles.sample_map_resolution = "MANUAL", 512
    if light.sun:
        sun = bpy.data.lights.new("sun", "SUN")
        sun.energy, sun.angle, sun.color = light.sun, np.radians(0.53), light.sun_color
        item = bpy.data.objects.new("sun", sun)
        item.rotation_euler = (0.0, np.radians(90 - light.elevation), np.radians(light.azimuth))
        bpy.context.scene.collection.objects.link(item)
    return light


def _new_world(name: str) -> Any:
    world = bpy.data.worlds.new(name)
    bpy.context.scene.world = world
    world.use_nodes = True
    return world


def random_sky(rng: np.random.Generator) -> Light:
    """Draw one of the lights with another sun, other clouds and another strength of the sun."""
    light = LIGHTS[str(rng.choice(list(LIGHTS)))]
    elevation = rng.uniform(6, 20) if light.elevation < 20 else rng.uniform(25, 75)
    return replace(
        light,
        elevation=float(elevation),
        azimuth=float(rng.uniform(0, 360)),
        sun=light.sun * float(rng.uniform(0.5, 1.3)),
        clouds=1.0 if light.overcast else float(rng.uniform(0.1, 0.8)),
    )


def add_lamp(kind: str, at: ArrayLike, watts: float, color: ArrayLike, size: ArrayLike) -> Any:
    """Add a "POINT" of a radius, or an "AREA" of a width and a height, in metres; return it."""
    lamp = bpy.data.lights.new("lamp", kind)
    lamp.energy, lamp.color = watts, color
    if kind == "POINT":
        lamp.shadow_soft_size = size
    else:
        lamp.shape, (lamp.size, lamp.size_y) = "RECTANGLE", size
    item = bpy.data.objects.new("lamp", lamp)
    item.location = at
    bpy.context.scene.collection.objects.link(item)
    return item


def add_dome(colors: Sequence[Color], strength: float) -> None:
    """Give the current scene a dome that shines in the first colour below and the second above."""
    s = Nodes(_new_world("dome").node_tree)
    height = s.ramp(s.split(s.node("TexCoord").outputs["Generated"])[2], -1.0, 1.0)
    shine = s.node("Background", s.mix(height, *colors), strength).outputs[0]
    s.node("OutputWorld", shine)


def remove_lights() -> None:
    """Take every lamp and the sky out of the current scene."""
    for item in [item for item in bpy.data.objects if item.type == "LIGHT"]:
        bpy.data.objects.remove(item)
    bpy.context.scene.world = None


def _shine_as_sky(s: Nodes, light: Light) -> None:
    """Make a world Nishita's clear sky or an overcast dome, with clouds."""
    direction = s.node("TexCoord").outputs["Generated"]
    x, y, z = s.split(direction)
    if light.overcast:
        brightness = s.ramp(z, -0.1, 1.0, 0.55, 1.35)
        color = s.join(brightness, brightness, brightness)
    else:
        sky = s.node("TexSky")
        sky.sky_type, sky.sun_disc = "NISHITA", False
        sky.sun_elevation = np.radians(light.elevation)
        sky.sun_rotation = np.radians(90 - light.azimuth)
        color = sky.outputs[0]
    height = s.math("ADD", s.math("MAXIMUM", z, 0.0), 0.12)
    s.position = s.join(s.math("DIVIDE", x, height), s.math("DIVIDE", y, height))  # of the clouds
    edge = 0.66 - 0.3 * light.clouds
    clouds = s.ramp(s.noise(1.1, 9.0, 0.62), edge, edge + 0.16, 0.0, 0.85)
    darkest, lightest = (0.35, 1.25) if light.overcast else (2.4, 5.2)
    tint = (1.0, 1.0, 1.03)
    if light.elevation < 20:
        darkest, lightest, tint = 0.8, 2.2, light.sun_color
    gray = s.ramp(s.noise(0.8, 8.0, 0.6), 0.32, 0.68, darkest, lightest)
    white = s.join(*(s.math("MULTIPLY", gray, share) for share in tint))
    shine = s.node("Background", s.mix(clouds, color, white), light.sky).outputs[0]
    s.node("OutputWorld", _with_sun_disc(s, light, direction, shine) if light.sun else shine)


def _with_sun_disc(s: Nodes, light: Light, direction: Socket, background: Socket) -> Socket:
    """Show the sun to the camera alone; for lighting there is the lamp."""
    up, turn = np.radians(light.elevation), np.radians(light.azimuth)
    towards = (np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up))
    dot = s.node("VectorMath", direction, towards)
    dot.operation = "DOT_PRODUCT"
    inside = s.math("GREATER_THAN", dot.outputs["Value"], np.cos(np.radians(0.45)))
    share = s.math("MULTIPLY", inside, s.node("LightPath").outputs["Is Camera Ray"])
    disc = s.node("Background", light.sun_color, 60.0).outputs[0]
    return s.node("MixShader", share, background, disc).outputs[0]
