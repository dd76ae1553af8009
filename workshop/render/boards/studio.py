"""The studio of the calibration captures: softly shining walls, one board on a pole."""

from __future__ import annotations

from typing import Any

import bpy
import mathutils
import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.geometry.pose import Pose
from workshop.render.blender import empty_scene, fisheye_picture
from workshop.render.boards.positions import (
    ARM,
    COLUMNS,
    MARGIN,
    ROOM,
    ROWS,
    SQUARE,
    STAND,
    T_WORLD_RIG,
    CaptureSet,
)
from workshop.render.camera.render_rig import RigCamera
from workshop.render.surfaces.mesh_builder import Mesh
from workshop.render.surfaces.shader import Shader

_THICKNESS = 0.008  # of the board
_FRONT, _RIGHT, _BACK, _LEFT = 4.1, 3.9, -3.7, -4.3
_GRAYS = {"ink": 0.035, "paper": 0.80, "metal": 0.22, "wood": 0.30, "cloth": 0.16, "pale": 0.55}


class Studio:
    """The scene, and a function that photographs the board in it."""

    exposure = 0.55

    def __init__(self) -> None:
        empty_scene()
        # Light comes from the walls and reaches the board straight: nothing has to be found by
        # chance.
        bpy.context.scene.cycles.diffuse_bounces = 1
        materials = {name: _matt(name, gray) for name, gray in _GRAYS.items()}
        materials |= {
            "wall": _glowing("wall", 0.42),
            "floor": _glowing("floor", 0.26),
            "lamp": _glowing("lamp", 1.3),
        }
        _put("room", _room(), materials)
        self.board = _put("board", _board(), materials)
        self.pole = _put("pole", _pole(), materials)

    def radiance(
        self, camera: RigCamera, T_rig_board: Pose, captures: CaptureSet, seed: int
    ) -> NDArray[np.float32]:
        """Return what a camera sees: linear light, shape (height, width, 3)."""
        T_world_board = T_WORLD_RIG @ T_rig_board
        self.board.matrix_world = _matrix(T_world_board)
        foot = T_world_board @ STAND
        # The pole stands behind the board: on the floor if the front looks up, else it hangs from
        # the ceiling.
        end = ROOM[0, 2] if T_world_board.R[2, 2] < 0 else ROOM[1, 2]
        self.pole.location, self.pole.scale = foot, (1.0, 1.0, end - foot[2])
        return fisheye_picture(
            camera.lens, T_WORLD_RIG @ camera.T_rig_cam, captures.size, captures.samples, seed
        )


def _put(name: str, mesh: Mesh, materials: dict[str, Any]) -> Any:
    item = bpy.data.objects.new(name, mesh.to_blender(name, materials))
    bpy.context.scene.collection.objects.link(item)
    return item


def _matrix(pose: Pose) -> mathutils.Matrix:
    return mathutils.Matrix(
        [[*row, t] for row, t in zip(pose.R.tolist(), pose.t.tolist(), strict=True)]
        + [[0, 0, 0, 1]]
    )


def _board() -> Mesh:
    """Return the board in its own frame.

    Every square is a face of its own: its corners are exact.
    """
    mesh = Mesh()
    lines = [
        np.array([-SQUARE - MARGIN, *(SQUARE * np.arange(-1, n + 1)), SQUARE * n + MARGIN])
        for n in (COLUMNS, ROWS)
    ]
    x, y = np.meshgrid(*lines)
    for row in range(ROWS + 3):
        for column in range(COLUMNS + 3):
            inside = 0 < row < ROWS + 2 and 0 < column < COLUMNS + 2
            ends = [(row, column), (row, column + 1), (row + 1, column + 1), (row + 1, column)]
            corners = [(x[end], y[end], 0.0) for end in ends]
            mesh.add(corners, "ink" if inside and (row + column) % 2 == 0 else "paper")
    low, high = (x[0, 0], y[0, 0]), (x[-1, -1], y[-1, -1])
    mesh.box((*low, 1e-4), (*high, _THICKNESS), "pale")
    mesh.box((*(STAND[:2] - 0.04), _THICKNESS), (*(STAND[:2] + 0.04), _THICKNESS + 0.02), "metal")
    mesh.tube([(*STAND[:2], _THICKNESS), (*STAND[:2], ARM)], 0.012, "metal")
    return mesh


def _pole() -> Mesh:
    mesh = Mesh()
    mesh.tube([(0, 0, 0), (0, 0, 1)], 0.014, "metal", sides=16)
    mesh.ball((0, 0, 0), (0.02, 0.02, 0.02), "metal")
    return mesh


def _room() -> Mesh:
    """Return walls, floor and ceiling, lamps under it, and some furniture at the walls."""
    mesh = Mesh()
    low, high = ROOM
    mesh.box(low, (*high[:2], high[2]), "wall")
    mesh.box((*low[:2], low[2] + 1e-3), (*high[:2], low[2] + 2e-3), "floor")
    for x in (-2.6, -0.2, 2.2):
        for y in (-2.2, 0.2, 2.6):
            mesh.box(
                (x - 0.5, y - 0.15, high[2] - 0.06), (x + 0.5, y + 0.15, high[2] - 0.02), "lamp"
            )
    mesh.box((low[0], low[1], 0), (high[0], low[1] + 0.02, 0.12), "pale")  # skirting
    mesh.box((low[0], high[1] - 0.02, 0), (high[0], high[1], 0.12), "pale")
    mesh.box((1.2, high[1] - 0.04, 0), (2.1, high[1], 2.1), "wood")  # a door
    mesh.box((-3.2, high[1] - 0.5, 0), (-1.6, high[1] - 0.02, 0.95), "wood")  # a cupboard
    mesh.box((-2.9, high[1] - 0.4, 0.95), (-2.5, high[1] - 0.1, 1.3), "cloth")
    mesh.box((high[0] - 0.7, -2.2, 0.72), (high[0] - 0.02, -0.4, 0.76), "wood")  # a desk
    for y in (-2.15, -0.45):
        mesh.box((high[0] - 0.65, y - 0.03, 0), (high[0] - 0.05, y + 0.03, 0.72), "metal")
    mesh.box((high[0] - 0.25, -1.6, 0.86), (high[0] - 0.2, -1.0, 1.22), "cloth")  # a screen
    mesh.box((low[0], 0.4, 1.1), (low[0] + 0.03, 1.9, 2.2), "pale")  # a whiteboard
    mesh.box((-1.9, low[1], 0), (-0.9, low[1] + 0.35, 1.9), "cloth")  # a shelf
    mesh.box((1.4, low[1], 1.2), (2.2, low[1] + 0.02, 2.1), "wood")  # a picture
    return mesh


def _matt(name: str, gray: float) -> Any:
    s = Shader(name)
    s.node("OutputMaterial", s.node("BsdfDiffuse", (gray,) * 3).outputs[0])
    return s.material


def _glowing(name: str, glow: float) -> Any:
    """Return a surface that shines softly, more towards the ceiling, unevenly in large patches.

    No ray is aimed at it: rays that leave the board in all directions find it anyway, without
    noise.
    """
    s = Shader(name)
    patches = s.ramp(s.noise(0.5, detail=1.0), 0.3, 0.7)
    level = s.math("MULTIPLY_ADD", patches, 0.25 * glow, 0.75 * glow)
    strength = s.math("MULTIPLY", level, s.math("MULTIPLY_ADD", s.height, 0.22, 0.70))
    return s.glow((1.0, 1.0, 1.0), strength)
