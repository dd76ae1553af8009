"""Procedural materials: no picture is read, nothing repeats, every scale has detail."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy

Socket = Any  # an output of a Blender shader node, or a plain number or colour


class Shader:
    """One material's node graph, written as expressions."""

    def __init__(self, name: str) -> None:
        self.material = bpy.data.materials.new(name)
        self.material.use_nodes = True
        self.tree = self.material.node_tree
        self.tree.nodes.clear()
        geometry = self.node("ShaderNodeNewGeometry")
        self.position = geometry.outputs["Position"]  # world; right for everything that never moves
        self.object_position = self.node("ShaderNodeTexCoord").outputs["Object"]
        info = self.node("ShaderNodeObjectInfo")
        self.tint, self.random = info.outputs["Color"], info.outputs["Random"]
        value = self.node("ShaderNodeAttribute")
        value.attribute_name = "value"
        self.value = value.outputs["Fac"]
        x, y, z = self.split(self.position)
        self.height = z
        # Along a wall and up: walls stand along x or along y, so x + y runs along both.
        self.wall = self.join(self.math("ADD", x, y), z, 0.0)

    def node(self, kind: str, **inputs: Socket) -> Any:
        """Add a node; inputs are given by name (spaces as underscores) or as in0, in1 and so on."""
        node = self.tree.nodes.new(kind)
        for name, value in inputs.items():
            key = (
                int(name[2:])
                if name.startswith("in") and name[2:].isdigit()
                else name.replace("_", " ")
            )
            self.feed(node.inputs[key], value)
        return node

    def feed(self, target: Any, value: Socket) -> None:
        """Link a socket, or set a constant."""
        if isinstance(value, bpy.types.NodeSocket):
            self.tree.links.new(value, target)
        else:
            target.default_value = (
                (*value, 1.0) if isinstance(value, tuple) and target.type == "RGBA" else value
            )

    def math(self, operation: str, a: Socket, b: Socket = 0.0) -> Socket:
        """Return `operation` of two numbers."""
        node = self.node("ShaderNodeMath", in0=a, in1=b)
        node.operation = operation
        return node.outputs[0]

    def split(self, vector: Socket) -> tuple[Socket, Socket, Socket]:
        """Return the three numbers of a vector."""
        return tuple(self.node("ShaderNodeSeparateXYZ", in0=vector).outputs)

    def join(self, x: Socket, y: Socket, z: Socket) -> Socket:
        """Return the vector of three numbers."""
        return self.node("ShaderNodeCombineXYZ", in0=x, in1=y, in2=z).outputs[0]

    def stretch(self, vector: Socket, factors: tuple[float, float, float]) -> Socket:
        """Return the vector times `factors`, component by component."""
        node = self.node("ShaderNodeVectorMath", in0=vector, in1=factors)
        node.operation = "MULTIPLY"
        return node.outputs[0]

    def noise(
        self, scale: float, detail: float = 3.0, roughness: float = 0.6, at: Socket = None
    ) -> Socket:
        """Return fractal noise around 0.5; `scale` is lumps in a metre."""
        at = self.position if at is None else at
        node = self.node(
            "ShaderNodeTexNoise", Vector=at, Scale=scale, Detail=detail, Roughness=roughness
        )
        return node.outputs["Fac"]

    def cells(
        self, scale: float, feature: str = "F1", output: str = "Distance", at: Socket = None
    ) -> Socket:
        """Return a Voronoi texture's distance or its colour for each cell."""
        node = self.node(
            "ShaderNodeTexVoronoi", Vector=self.position if at is None else at, Scale=scale
        )
        node.feature = feature
        return node.outputs[output]

    def ramp(self, value: Socket, low: float, high: float) -> Socket:
        """Return `value` stretched so that low becomes 0 and high becomes 1, cut off outside."""
        node = self.node("ShaderNodeMapRange", in0=value, in1=low, in2=high)
        return node.outputs[0]

    def mix(self, share: Socket, a: Socket, b: Socket, blend: str = "MIX") -> Socket:
        """Return the colour a where share is 0 and b where it is 1."""
        node = self.node("ShaderNodeMixRGB", in0=share, in1=a, in2=b)
        node.blend_type = blend
        return node.outputs[0]

    def shade(self, color: Socket, low: float, high: float, by: Socket) -> Socket:
        """Return the colour times a gray between low and high, chosen by a number from 0 to 1."""
        gray = self.math("MULTIPLY_ADD", by, high - low)
        gray.node.inputs[2].default_value = low
        return self.mix(1.0, color, self.join(gray, gray, gray), "MULTIPLY")

    def bricks(
        self,
        colors: tuple[Socket, Socket, Socket],
        width: float,
        height: float,
        joint: float,
        at: Socket = None,
        shift: float = 0.5,
    ) -> Any:
        """Return a brick texture node: colour A, colour B, mortar; sizes in metres."""
        node = self.node(
            "ShaderNodeTexBrick",
            Vector=self.wall if at is None else at,
            Color1=colors[0],
            Color2=colors[1],
            Mortar=colors[2],
            Scale=1.0,
        )
        node.offset = shift
        for name, size in (
            ("Mortar Size", joint),
            ("Brick Width", width),
            ("Row Height", height),
            ("Mortar Smooth", 0.1),
        ):
            node.inputs[name].default_value = size
        return node

    def finish(
        self, color: Socket, plain: Socket, gloss: float = 0.0, roughness: float = 0.3
    ) -> Any:
        """End the graph: matt, or with a share of mirror that grows towards grazing angles.

        Light that arrives over a second matt surface sees the `plain` colour alone: nobody can
        tell, and the noise textures are what a bounce costs.
        """
        surface = self.node("ShaderNodeBsdfDiffuse", Color=color).outputs[0]
        if gloss:
            mirror = self.node("ShaderNodeBsdfGlossy", Roughness=roughness).outputs[0]
            fresnel = self.node("ShaderNodeFresnel", IOR=1.0 + gloss).outputs[0]
            surface = self.node(
                "ShaderNodeMixShader", in0=fresnel, in1=surface, in2=mirror
            ).outputs[0]
        cheap = self.node("ShaderNodeBsdfDiffuse", Color=plain).outputs[0]
        indirect = self.node("ShaderNodeLightPath").outputs["Is Diffuse Ray"]
        both = self.node("ShaderNodeMixShader", in0=indirect, in1=surface, in2=cheap).outputs[0]
        self.node("ShaderNodeOutputMaterial", Surface=both)
        return self.material

    def glow(self, color: Socket, strength: float) -> Any:
        """End the graph as a lamp that only the camera sees (no noise from tiny lights)."""
        self.node(
            "ShaderNodeOutputMaterial",
            Surface=self.node("ShaderNodeEmission", Color=color, Strength=strength).outputs[0],
        )
        self.material.cycles.emission_sampling = "NONE"
        return self.material


RECIPES: dict[str, Callable[[Shader], Any]] = {}


class Materials(dict):
    """Blender materials by name, made when first asked for."""

    def __missing__(self, name: str) -> Any:
        self[name] = RECIPES[name](Shader(name))
        return self[name]


def recipe(function: Callable[[Shader], Any]) -> Callable[[Shader], Any]:
    """Register a material under its function's name."""
    RECIPES[function.__name__] = function
    return function
