"""What is written of a world: its surface, and a page to fly through it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.files import atomic_write
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_tools.output.mesh_export import export_glb, import_trimesh, linear
from omnistereo_tools.output.pictures import colorize_depth
from omnistereo_tools.output.points import AXES
from omnistereo_tools.output.viewer import packed, page_of, webp
from omnistereo_tools.world.surface import Surface

_MOST_TRIANGLES = 450_000  # of the page, which stays below 5 MB
_STEPS = 65535  # of a coordinate on the page


def write_surface(folder: Path, surface: Surface) -> None:
    """Write mesh.glb, y up, and mesh.ply, axes of the world, with the colours of the images."""
    trimesh, colors = import_trimesh(), _colors(surface)
    glb = trimesh.Trimesh(
        surface.vertices @ AXES["y"],
        surface.faces,
        vertex_attributes={"_COLOR_0": linear(colors)},
        process=False,
    )
    ply = trimesh.Trimesh(surface.vertices, surface.faces, vertex_colors=colors, process=False)
    for name, content in (("mesh.glb", export_glb(glb)), ("mesh.ply", ply.export(file_type="ply"))):
        with atomic_write(folder / name) as temporary:
            temporary.write_bytes(content)


def _colors(surface: Surface) -> NDArray[np.uint8]:
    return np.broadcast_to(
        surface.color.round().clip(0, 255).astype(np.uint8), (len(surface.vertices), 3)
    )


def world_page(
    surface: Surface,
    poses: Mapping[int, Pose],
    number: int,
    own: NDArray[np.float32],
    refined: NDArray[np.float32],
    grid: SphereGrid,
    title: str,
) -> str:
    """Return the page, in one piece: the surface seen from the path, the path on a plan, one frame
    before and after.

    Args:
        poses: Rig → world, of each frame.
        number: Of the frame that is shown.
        own, refined: Its inverse depth, (H, W), 1/m.
        title: The verdict on the world.
    """
    small = _coarser(surface)
    low = small.vertices.min(axis=0)
    size = np.maximum(small.vertices.max(axis=0) - low, 1e-6)
    data = {
        "title": title,
        "count": len(small.vertices),
        "triangles": len(small.faces),
        "low": low.tolist(),
        "size": size.tolist(),
        "vertices": packed((_STEPS * (small.vertices - low) / size).round().astype("<u2").T),
        "colors": packed(_colors(small).T),
        "faces": packed(small.faces.astype("<u4").T),
        "path": [
            {
                "number": n,
                "place": pose.t.tolist(),
                "heading": float(np.arctan2(pose.R[0, 2], pose.R[2, 2])),
            }
            for n, pose in poses.items()
        ],
    }
    for name, inverse, words in (
        ("before", own, "by itself"),
        ("after", refined, "after fusing all frames"),
    ):
        picture = webp(colorize_depth(inverse, grid), 80)
        data[name] = {
            "picture": picture,
            "caption": f"Depth of frame {number} {words}; near is bright.",
        }
    return page_of(data, "world.html", ("data.js", "gl.js", "world.js"))


def _coarser(surface: Surface) -> Surface:
    """Return a surface of few enough triangles: vertices in each cell of a grid become one."""
    small, cell = surface, 0.15
    while len(small.faces) > _MOST_TRIANGLES:
        cell *= max(1.1, np.sqrt(len(small.faces) / _MOST_TRIANGLES))
        cells = np.floor(surface.vertices / cell).astype(np.int64)
        joined, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)[1:]
        vertices, color = (
            np.stack(
                [np.bincount(joined.ravel(), column) / count for column in values.T], axis=1
            ).astype(np.float32)
            for values in (surface.vertices, surface.color)
        )
        a, b, c = (faces := joined.ravel()[surface.faces]).T
        small = Surface(vertices, faces[(a != b) & (b != c) & (c != a)], color)
    return small
