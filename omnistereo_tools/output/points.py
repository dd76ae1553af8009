"""The point cloud: points, colours, normals, confidence and doubts; as binary PLY or LAS."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import atomic_write

if TYPE_CHECKING:
    from omnistereo_lib.stereo.depth import Depth

# beyond it, one sphere more or less is a quarter of the depth: a spray of points, not a surface
_FAR_SPHERE = 4

_PROPERTIES = dict.fromkeys(("x", "y", "z", "nx", "ny", "nz"), "<f4")
_PROPERTIES |= dict.fromkeys(("red", "green", "blue"), "u1")
# MeshLab knows a quality of vertices, and reads a property called confidence as garbage.
_PROPERTIES |= {"quality": "<f4", "doubtful": "u1"}
# What turns points, as rows, from the axes of the rig to those with another direction up: y as in
# OpenGL and glTF, z as in ROS (REP 103).
AXES = {
    None: np.eye(3),
    "y": np.diag([1.0, -1, -1]),
    "z": np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]),
}
AXES_IN_WORDS = {
    None: "x right, y down, z forward",
    "y": "x right, y up, z back",
    "z": "x forward, y left, z up",
}
_PLY_TYPES = {"<f4": "float", "u1": "uchar"}


@dataclass(frozen=True)
class Limits:
    """Rays that become points or triangles: up to `max_depth`, m, from `min_confidence` on."""

    max_depth: float
    min_confidence: float

    @classmethod
    def of(
        cls, depth: Depth, max_depth: float | None = None, min_confidence: float | None = None
    ) -> Limits:
        """Return the limits; by default up to the fourth sphere from infinity."""
        if max_depth is None:
            max_depth = float(
                depth.grid.index_to_depth(min(_FAR_SPHERE, depth.grid.num_spheres - 1))
            )
        return cls(max_depth, min_confidence or 0.0)

    def keep(self, depth: Depth) -> NDArray[np.bool_]:
        """Return which rays are within the limits, bool, shape (H, W)."""
        return (
            depth.valid
            & (depth.depth <= self.max_depth)
            & (depth.confidence >= self.min_confidence)
        )


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Points around the sweep centre in the axes of the rig, each array with M rows."""

    points: NDArray[np.float32]  #: (M, 3), metres
    normals: NDArray[np.float32]  #: (M, 3), unit length, towards the rig
    colors: NDArray[np.uint8]  #: (M, 3), RGB
    confidence: NDArray[np.float32]  #: (M,), in [0, 1]
    doubtful: NDArray[np.bool_]  #: (M,)

    @classmethod
    def of(
        cls,
        depth: Depth,
        panorama: NDArray[np.float32],
        limits: Limits,
        doubtful: NDArray[np.bool_],
    ) -> PointCloud:
        """Return the points of the rays within the limits, coloured by a panorama."""
        colors = np.repeat(panorama[..., None], 3, -1) if panorama.ndim == 2 else panorama
        keep = limits.keep(depth) & np.isfinite(colors[..., 0])
        points = depth.grid.rays() * np.where(keep, depth.depth, 0)[..., None]
        return cls(
            points[keep].astype(np.float32),
            normals(points)[keep].astype(np.float32),
            colors[keep].clip(0, 255).round().astype(np.uint8),
            depth.confidence[keep].astype(np.float32),
            doubtful[keep],
        )

    def write(self, path: Path, up: str | None = None) -> None:
        """Write the points as binary PLY, with the properties that MeshLab, CloudCompare and Open3D
        read, in the axes of the rig or with `up`; see `AXES`.
        """
        rows = np.empty(len(self.points), list(_PROPERTIES.items()))
        places = [*(self.points @ AXES[up]).T, *(self.normals @ AXES[up]).T]
        columns = [*places, *self.colors.T, self.confidence, self.doubtful]
        for name, column in zip(_PROPERTIES, columns, strict=True):
            rows[name] = column
        header = [
            "ply",
            "format binary_little_endian 1.0",
            f"comment metres; {AXES_IN_WORDS[up]}; quality is the confidence",
        ]
        header += [f"element vertex {len(rows)}"]
        header += [f"property {_PLY_TYPES[kind]} {name}" for name, kind in _PROPERTIES.items()]
        with atomic_write(path) as temporary:
            temporary.write_bytes("\n".join([*header, "end_header", ""]).encode() + rows.tobytes())

    def write_las(self, path: Path) -> None:
        """Write the points as LAS 1.4, or as LAZ by the suffix: z up, whole millimetres."""
        laspy, content = import_laspy(), BytesIO()
        header = laspy.LasHeader(point_format=7, version="1.4")
        header.scales = np.full(3, 0.001)  # before there are points, which keep those of the header
        las = laspy.LasData(header)
        las.xyz = self.points @ AXES["z"]
        las.red, las.green, las.blue = 257 * self.colors.T.astype(np.uint16)
        for name, values in (("confidence", self.confidence), ("doubtful", self.doubtful)):
            values = values.astype(np.float32)
            las.add_extra_dim(laspy.ExtraBytesParams(name, values.dtype))
            las[name] = values
        las.write(content, do_compress=path.suffix.lower() == ".laz")
        with atomic_write(path) as temporary:
            temporary.write_bytes(content.getvalue())


def import_laspy() -> ModuleType:
    """Return the module laspy; an `OmnistereoError` says how to install it."""
    try:
        import laspy
    except ImportError:
        raise OmnistereoError("--las needs laspy: pip install 'omnistereo-lib[las]'") from None
    return laspy


def normals(points: NDArray[Any]) -> NDArray[np.float64]:
    """Return unit normals of a panorama of points (H, W, 3), towards the rig: the cross product of
    the neighbours.

    The neighbour on either side is taken that is nearer in depth, so that a normal does not span a
    depth edge.
    """
    across = _nearer(np.roll(points, -1, 1) - points, points - np.roll(points, 1, 1))
    padded = np.pad(points, ((1, 1), (0, 0), (0, 0)), "reflect")
    down = _nearer(padded[2:] - points, points - padded[:-2])
    normal = np.cross(across, down)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    normal = np.where(length > 1e-12, normal / np.maximum(length, 1e-12), -points)
    normal *= np.where((normal * points).sum(-1, keepdims=True) > 0, -1, 1)
    return normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)


def _nearer(a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.float64]:
    """Return the shorter of two differences for each point, (H, W, 3)."""
    shorter = np.linalg.norm(a, axis=-1) <= np.linalg.norm(b, axis=-1)
    return np.where(shorter[..., None], a, b)
