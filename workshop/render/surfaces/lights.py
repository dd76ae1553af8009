"""The lights of the paper: sunny, cloudy, sunset; each a sky, two with a sun."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import bpy
import numpy as np


@dataclass(frozen=True)
class Light:
    """One weather; angles in degrees, strengths in Blender's units, exposure a factor."""

    elevation: float
    azimuth: float  # of the sun, counter-clockwise from east
    sun: float
    sun_color: tuple[float, float, float]
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
    world = bpy.data.worlds.new("sky")
    bpy.context.scene.world = world
    world.use_nodes = True
    _Sky(world.node_tree, light).build()
    world.cycles.sampling_method, world.cycles.sample_map_resolution = "MANUAL", 512
    if light.sun:
        sun = bpy.data.lights.new("sun", "SUN")
        sun.energy, sun.angle, sun.color = light.sun, np.radians(0.53), light.sun_color
        item = bpy.data.objects.new("sun", sun)
        item.rotation_euler = (0.0, np.radians(90 - light.elevation), np.radians(light.azimuth))
        bpy.context.scene.collection.objects.link(item)
    return light


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


def add_dome(colors: Sequence[tuple[float, float, float]], strength: float) -> None:
    """Give the current scene a dome that shines in the first colour below and the second above."""
    world = bpy.data.worlds.new("dome")
    bpy.context.scene.world = world
    world.use_nodes = True
    tree = world.node_tree
    tree.nodes.clear()
    split, mix = tree.nodes.new("ShaderNodeSeparateXYZ"), tree.nodes.new("ShaderNodeMixRGB")
    tree.links.new(tree.nodes.new("ShaderNodeTexCoord").outputs["Generated"], split.inputs[0])
    height = tree.nodes.new("ShaderNodeMapRange")
    tree.links.new(split.outputs["Z"], height.inputs[0])
    height.inputs[1].default_value = -1.0
    tree.links.new(height.outputs[0], mix.inputs[0])
    for k, color in enumerate(colors, start=1):
        mix.inputs[k].default_value = (*color, 1.0)
    background, output = (
        tree.nodes.new("ShaderNodeBackground"),
        tree.nodes.new("ShaderNodeOutputWorld"),
    )
    tree.links.new(mix.outputs[0], background.inputs["Color"])
    background.inputs["Strength"].default_value = strength
    tree.links.new(background.outputs[0], output.inputs["Surface"])


def remove_lights() -> None:
    """Take every lamp and the sky out of the current scene."""
    for item in [item for item in bpy.data.objects if item.type == "LIGHT"]:
        bpy.data.objects.remove(item)
    bpy.context.scene.world = None


class _Sky:
    """The nodes of a sky: Nishita's clear one or an overcast dome, with clouds."""

    def __init__(self, tree: Any, light: Light) -> None:
        self.tree, self.light = tree, light
        tree.nodes.clear()
        self.direction = tree.nodes.new("ShaderNodeTexCoord").outputs["Generated"]

    def node(self, kind: str, *inputs: Any, **settings: Any) -> Any:
        node = self.tree.nodes.new(kind)
        for name, value in settings.items():
            setattr(node, name, value)
        for socket, value in zip(node.inputs, inputs, strict=False):
            if isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, socket)
            elif value is not None:
                socket.default_value = value
        return node.outputs[0]

    def build(self) -> None:
        split = self.tree.nodes.new("ShaderNodeSeparateXYZ")
        self.tree.links.new(self.direction, split.inputs[0])
        x, y, z = split.outputs
        color = self._overcast(z) if self.light.overcast else self._clear()
        color = self.node(
            "ShaderNodeMixRGB", self._clouds(x, y, z), color, self._cloud_color(x, y, z)
        )
        strength = self.light.sky
        background = self.node("ShaderNodeBackground", color, strength)
        if self.light.sun:
            background = self._with_sun_disc(background)
        output = self.tree.nodes.new("ShaderNodeOutputWorld")
        self.tree.links.new(background, output.inputs["Surface"])

    def _clear(self) -> Any:
        sky = self.tree.nodes.new("ShaderNodeTexSky")
        sky.sky_type, sky.sun_disc = "NISHITA", False
        sky.sun_elevation = np.radians(self.light.elevation)
        sky.sun_rotation = np.radians(90 - self.light.azimuth)
        return sky.outputs[0]

    def _overcast(self, z: Any) -> Any:
        brightness = self.node("ShaderNodeMapRange", z, -0.1, 1.0, 0.55, 1.35)
        return self.node("ShaderNodeCombineXYZ", brightness, brightness, brightness)

    def _on_cloud_layer(self, x: Any, y: Any, z: Any) -> Any:
        height = self.node("ShaderNodeMath", z, 0.0, operation="MAXIMUM")
        height = self.node("ShaderNodeMath", height, 0.12, operation="ADD")
        flat = [self.node("ShaderNodeMath", v, height, operation="DIVIDE") for v in (x, y)]
        return self.node("ShaderNodeCombineXYZ", *flat)

    def _clouds(self, x: Any, y: Any, z: Any) -> Any:
        noise = self.node("ShaderNodeTexNoise", self._on_cloud_layer(x, y, z), None, 1.1, 9.0, 0.62)
        edge = 0.66 - 0.3 * self.light.clouds
        return self.node("ShaderNodeMapRange", noise, edge, edge + 0.16, 0.0, 0.85)

    def _cloud_color(self, x: Any, y: Any, z: Any) -> Any:
        noise = self.node("ShaderNodeTexNoise", self._on_cloud_layer(x, y, z), None, 0.8, 8.0, 0.6)
        low, high = (0.35, 1.25) if self.light.overcast else (2.4, 5.2)
        if self.light.elevation < 20:
            low, high = 0.8, 2.2
        gray = self.node("ShaderNodeMapRange", noise, 0.32, 0.68, low, high)
        tint = self.light.sun_color if self.light.elevation < 20 else (1.0, 1.0, 1.03)
        parts = [self.node("ShaderNodeMath", gray, t, operation="MULTIPLY") for t in tint]
        return self.node("ShaderNodeCombineXYZ", *parts)

    def _with_sun_disc(self, background: Any) -> Any:
        """Show the sun to the camera alone; for lighting there is the lamp."""
        up, turn = np.radians(self.light.elevation), np.radians(self.light.azimuth)
        towards = (np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up))
        dot = self.tree.nodes.new("ShaderNodeVectorMath")
        dot.operation = "DOT_PRODUCT"
        self.tree.links.new(self.direction, dot.inputs[0])
        dot.inputs[1].default_value = towards
        inside = self.node(
            "ShaderNodeMath",
            dot.outputs["Value"],
            float(np.cos(np.radians(0.45))),
            operation="GREATER_THAN",
        )
        path = self.tree.nodes.new("ShaderNodeLightPath").outputs["Is Camera Ray"]
        share = self.node("ShaderNodeMath", inside, path, operation="MULTIPLY")
        disc = self.node("ShaderNodeBackground", (*self.light.sun_color, 1.0), 60.0)
        return self.node("ShaderNodeMixShader", share, background, disc)
