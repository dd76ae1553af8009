"""Procedural materials: no picture is read, nothing repeats, every scale has detail."""

from __future__ import annotations

from typing import Any

import bpy

Color = tuple[float, float, float]  # linear RGB
Socket = Any  # an output of a Blender shader node, or a plain number or colour


class Nodes:
    """A graph of Blender's shader nodes, written as expressions."""

    position: Socket  # where textures are looked up, unless told otherwise

    def __init__(self, tree: Any) -> None:
        self.tree = tree
        tree.nodes.clear()

    def node(self, kind: str, *inputs: Socket, **named: Socket) -> Any:
        """Add a ShaderNode…; inputs in their order or by name, with underscores for spaces."""
        node = self.tree.nodes.new(f"ShaderNode{kind}")
        for key, value in (*enumerate(inputs), *named.items()):
            target = node.inputs[key.replace("_", " ") if isinstance(key, str) else key]
            if isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, target)
            else:
                is_color = isinstance(value, tuple) and target.type == "RGBA"
                target.default_value = (*value, 1.0) if is_color else value
        return node

    def math(self, operation: str, *numbers: Socket) -> Socket:
        """Return `operation` of one to three numbers."""
        node = self.node("Math", *numbers)
        node.operation = operation
        return node.outputs[0]

    def split(self, vector: Socket) -> tuple[Socket, Socket, Socket]:
        """Return the three numbers of a vector."""
        return tuple(self.node("SeparateXYZ", vector).outputs)

    def join(self, x: Socket, y: Socket, z: Socket = 0.0) -> Socket:
        """Return the vector of three numbers."""
        return self.node("CombineXYZ", x, y, z).outputs[0]

    def stretch(self, vector: Socket, factors: tuple[float, float, float]) -> Socket:
        """Return the vector times `factors`, component by component."""
        node = self.node("VectorMath", vector, factors)
        node.operation = "MULTIPLY"
        return node.outputs[0]

    def noise(
        self, scale: float, detail: float = 3.0, roughness: float = 0.6, at: Socket = None
    ) -> Socket:
        """Return fractal noise around 0.5; `scale` is lumps in a metre."""
        sizes = {"Scale": scale, "Detail": detail, "Roughness": roughness}
        return self.node("TexNoise", Vector=at or self.position, **sizes).outputs["Fac"]

    def cells(
        self, scale: float, feature: str = "F1", output: str = "Distance", at: Socket = None
    ) -> Socket:
        """Return a Voronoi texture's distance or its colour for each cell."""
        node = self.node("TexVoronoi", Vector=at or self.position, Scale=scale)
        node.feature = feature
        return node.outputs[output]

    def ramp(
        self, value: Socket, low: float, high: float, start: float = 0.0, end: float = 1.0
    ) -> Socket:
        """Return `value` stretched so that low becomes start and high end, cut off outside."""
        return self.node("MapRange", value, low, high, start, end).outputs[0]

    def mix(self, share: Socket, a: Socket, b: Socket, blend: str = "MIX") -> Socket:
        """Return the colour a where share is 0 and b where it is 1."""
        node = self.node("MixRGB", share, a, b)
        node.blend_type = blend
        return node.outputs[0]

    def shade(self, color: Socket, low: float, high: float, by: Socket) -> Socket:
        """Return the colour times a gray between low and high, chosen by a number from 0 to 1."""
        gray = self.math("MULTIPLY_ADD", by, high - low, low)
        return self.mix(1.0, color, self.join(gray, gray, gray), "MULTIPLY")


class Shader(Nodes):
    """The graph of one material."""

    def __init__(self, name: str) -> None:
        self.material = bpy.data.materials.new(name)
        self.material.use_nodes = True
        super().__init__(self.material.node_tree)
        # in the world: right for everything that never moves
        self.position = self.node("NewGeometry").outputs["Position"]
        self.local = self.node("TexCoord").outputs["Object"]
        info = self.node("ObjectInfo")
        self.tint, self.random = info.outputs["Color"], info.outputs["Random"]
        value = self.node("Attribute")
        value.attribute_name = "value"
        self.value = value.outputs["Fac"]
        x, y, self.height = self.split(self.position)
        # Along a wall and up: walls stand along x or along y, so x + y runs along both.
        self.wall = self.join(self.math("ADD", x, y), self.height)

    def bricks(
        self,
        colors: tuple[Socket, Socket, Socket],
        width: float,
        height: float,
        joint: float,
        at: Socket = None,
        shift: float = 0.5,
    ) -> Socket:
        """Return the colour of bricks: colour A, colour B, mortar; sizes in metres."""
        sizes = {"Brick_Width": width, "Row_Height": height, "Mortar_Size": joint}
        node = self.node("TexBrick", at or self.wall, *colors, 1.0, Mortar_Smooth=0.1, **sizes)
        node.offset = shift
        return node.outputs[0]

    def finish(
        self, color: Socket, plain: Socket, gloss: float = 0.0, roughness: float = 0.3
    ) -> Any:
        """End the graph: matt, or with a share of mirror that grows towards grazing angles.

        Light that arrives over a second matt surface sees the `plain` colour alone: nobody can
        tell, and the noise textures are what a bounce costs.
        """
        surface = self.node("BsdfDiffuse", color).outputs[0]
        if gloss:
            mirror = self.node("BsdfGlossy", Roughness=roughness).outputs[0]
            fresnel = self.node("Fresnel", 1.0 + gloss).outputs[0]
            surface = self.node("MixShader", fresnel, surface, mirror).outputs[0]
        cheap = self.node("BsdfDiffuse", plain).outputs[0]
        indirect = self.node("LightPath").outputs["Is Diffuse Ray"]
        self.node("OutputMaterial", self.node("MixShader", indirect, surface, cheap).outputs[0])
        return self.material

    def glow(self, color: Socket, strength: float) -> Any:
        """End the graph as a lamp that only the camera sees (no noise from tiny lights)."""
        self.node("OutputMaterial", self.node("Emission", color, strength).outputs[0])
        self.material.cycles.emission_sampling = "NONE"
        return self.material
