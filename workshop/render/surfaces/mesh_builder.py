"""Faces collected as NumPy arrays and handed to Blender in one go."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

# The six faces of a box as corner numbers; corner number = x + 2 y + 4 z.
_BOX_FACES = np.array(
    [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
)
_CORNERS = np.array([[(c >> axis) & 1 for axis in range(3)] for c in range(8)], float)


def points(x: ArrayLike, y: ArrayLike, z: ArrayLike) -> NDArray[np.float64]:
    """Return the points (..., 3) of coordinates, each a number or an array."""
    return np.stack(np.broadcast_arrays(x, y, z), axis=-1).astype(float)


class Mesh:
    """A growing set of faces, each with a material name and a value in [0, 1] that shaders can
    read.

    Coordinates are metres in the current frame: `origin` plus the rows of `axes` (x, y, z, the last
    up).
    """

    def __init__(self) -> None:
        self._faces: list[tuple[NDArray[np.float64], str, NDArray[np.float64]]] = []
        self.place()

    def place(
        self,
        origin: ArrayLike = (0, 0, 0),
        x_axis: ArrayLike = (1, 0, 0),
        y_axis: ArrayLike = (0, 1, 0),
    ) -> None:
        """Put what is added from now on into another frame; z stays up."""
        self._origin = np.asarray(origin, float)
        self._axes = np.stack([x_axis, y_axis, (0, 0, 1)]).astype(float)

    def turn(self, origin: ArrayLike, yaw: float) -> None:
        """Put what is added from now on at `origin`, turned by `yaw` radians about the vertical."""
        c, s = np.cos(yaw), np.sin(yaw)
        self.place(origin, (c, s, 0), (-s, c, 0))

    def add(self, corners: ArrayLike, material: str, value: ArrayLike = 0.5) -> None:
        """Add faces of equally many corners, shape (faces, corners, 3) or one face (corners, 3)."""
        corners = np.asarray(corners, float)
        corners = corners.reshape(-1, *corners.shape[-2:])
        if len(corners):
            values = np.broadcast_to(np.asarray(value, float), len(corners))
            self._faces.append((corners @ self._axes + self._origin, material, values))

    def floor(self, low: ArrayLike, high: ArrayLike, z: float, material: str) -> None:
        """Add a horizontal rectangle between opposite corners (x, y)."""
        (x0, y0), (x1, y1) = low, high
        self.add([(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)], material)

    def box(self, low: ArrayLike, high: ArrayLike, material: str, value: ArrayLike = 0.5) -> None:
        """Add boxes between opposite corners: (x, y, z) of numbers or arrays, or (boxes, 3)."""
        ends = (points(*end) if isinstance(end, tuple) else end for end in (low, high))
        low, high = np.broadcast_arrays(*(np.atleast_2d(np.asarray(end, float)) for end in ends))
        corners = low[:, None] + _CORNERS * (high - low)[:, None]
        values = np.repeat(np.broadcast_to(np.asarray(value, float), len(low)), len(_BOX_FACES))
        self.add(corners[:, _BOX_FACES].reshape(-1, 4, 3), material, values)

    def sheet(self, points: ArrayLike, material: str, value: ArrayLike = 0.5) -> None:
        """Add the quads of a grid of points, shape (rows, columns, 3)."""
        p = np.asarray(points, float)
        quads = np.stack([p[:-1, :-1], p[:-1, 1:], p[1:, 1:], p[1:, :-1]], axis=2)
        self.add(quads.reshape(-1, 4, 3), material, value)

    def tube(
        self, path: ArrayLike, radius: ArrayLike, material: str, sides: int = 8, value: float = 0.5
    ) -> None:
        """Add a pipe along `path`, (points, 3), one radius or one for each point, and caps."""
        path = np.asarray(path, float)
        along = np.gradient(path, axis=0)
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        helper = np.where(np.abs(along[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
        across = np.cross(along, helper)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        angle = np.linspace(0, 2 * np.pi, sides + 1)
        ring = (
            np.cos(angle)[:, None] * across[:, None]
            + np.sin(angle)[:, None] * np.cross(along, across)[:, None]
        )
        rings = path[:, None] + ring * np.broadcast_to(radius, len(path))[:, None, None]
        self.sheet(rings, material, value)
        self.add(rings[[0, -1], :-1], material, value)

    def ball(
        self, center: ArrayLike, radii: ArrayLike, material: str, rings: int = 8, value: float = 0.5
    ) -> None:
        """Add an ellipsoid with its axes along the frame's."""
        latitude = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)[:, None]
        angle = np.linspace(0, 2 * np.pi, 2 * rings + 1)
        girth = np.cos(latitude)
        unit = points(girth * np.cos(angle), girth * np.sin(angle), np.sin(latitude))
        self.sheet(np.asarray(center) + unit * np.asarray(radii), material, value)

    def prism(self, outline: ArrayLike, bottom: float, top: float, side: str, cover: str) -> None:
        """Add an upright prism, without floor, over a counter-clockwise polygon (n, 2)."""
        outline = np.asarray(outline, float)
        low, high = (np.column_stack([outline, np.full(len(outline), z)]) for z in (bottom, top))
        self.add(np.stack([low, np.roll(low, -1, 0), np.roll(high, -1, 0), high], axis=1), side)
        self.add(high, cover)

    def bounds(self) -> NDArray[np.float64]:
        """Return the lowest and the highest coordinates, shape (2, 3)."""
        points = np.concatenate([corners.reshape(-1, 3) for corners, _, _ in self._faces])
        return np.stack([points.min(axis=0), points.max(axis=0)])

    def to_blender(self, name: str, materials: Any, smooth: bool = False) -> Any:
        """Return a `bpy.types.Mesh`; `materials` maps a material name to a Blender material.

        With `smooth`, corners that coincide are joined and angles below 40° are shaded as round.
        """
        import bpy

        mesh = bpy.data.meshes.new(name)
        faces = [corners for corners, _, _ in self._faces]
        vertices = np.concatenate([corners.reshape(-1, 3) for corners in faces])
        sizes = np.concatenate([np.full(len(c), c.shape[1]) for c in faces])
        mesh.vertices.add(len(vertices))
        mesh.vertices.foreach_set("co", vertices.astype(np.float32).ravel())
        mesh.loops.add(len(vertices))
        mesh.loops.foreach_set("vertex_index", np.arange(len(vertices), dtype=np.int32))
        mesh.polygons.add(len(sizes))
        mesh.polygons.foreach_set("loop_start", (np.cumsum(sizes) - sizes).astype(np.int32))
        mesh.polygons.foreach_set("material_index", self._fill_slots(mesh, materials))
        values = np.concatenate([values for _, _, values in self._faces])
        attribute = mesh.attributes.new("value", "FLOAT", "FACE")
        attribute.data.foreach_set("value", values.astype(np.float32))
        mesh.update(calc_edges=True)
        if smooth:
            _join_and_smooth(mesh)
        return mesh

    def _fill_slots(self, mesh: Any, materials: Any) -> NDArray[np.int32]:
        names = sorted({material for _, material, _ in self._faces})
        for name in names:
            mesh.materials.append(materials[name])
        slots = [np.full(len(c), names.index(m), np.int32) for c, m, _ in self._faces]
        return np.concatenate(slots)


def _join_and_smooth(mesh: Any) -> None:
    import bmesh

    work = bmesh.new()
    work.from_mesh(mesh)
    bmesh.ops.remove_doubles(work, verts=work.verts, dist=1e-4)
    bmesh.ops.recalc_face_normals(work, faces=work.faces)
    work.to_mesh(mesh)
    work.free()
    mesh.polygons.foreach_set("use_smooth", np.ones(len(mesh.polygons), bool))
    mesh.set_sharp_from_angle(angle=np.radians(40))
