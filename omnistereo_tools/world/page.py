"""What is written of a world: its surface, and a page to fly through it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.files import atomic_write
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.threads import map_threads
from omnistereo_tools.output.colors import colorize_depth
from omnistereo_tools.output.mesh_export import export_glb, import_trimesh, linear
from omnistereo_tools.output.points import AXES
from omnistereo_tools.output.viewer import packed, page_of
from omnistereo_tools.output.webp import webp
from omnistereo_tools.world.surface import Surface, choose_views

_MOST_TRIANGLES = 450_000  # of the page, which stays below 5 MB
_STEPS = 65535  # of a coordinate on the page
MOST_VIEWS, VIEW_WIDTH = 24, 1280  # of the page; px of each panorama


def write_surface(folder: Path, surface: Surface) -> None:
    """Write mesh.glb, y up, and mesh.ply, axes of the world, with the colours of the images."""
    trimesh, colors = import_trimesh(), _colors(surface)
    up, of_vertices = surface.vertices @ AXES["y"], {"_COLOR_0": linear(colors)}
    glb = trimesh.Trimesh(up, surface.faces, vertex_attributes=of_vertices, process=False)
    ply = trimesh.Trimesh(surface.vertices, surface.faces, vertex_colors=colors, process=False)
    for name, content in (("mesh.glb", export_glb(glb)), ("mesh.ply", ply.export(file_type="ply"))):
        with atomic_write(folder / name) as temporary:
            temporary.write_bytes(content)


def _colors(surface: Surface) -> NDArray[np.uint8]:
    return np.broadcast_to(
        surface.color.round().clip(0, 255).astype(np.uint8), (len(surface.vertices), 3)
    )


@dataclass(frozen=True, eq=False)
class PageView:
    """A frame on the page: what it has seen, which colours the surface, and its depth."""

    number: int
    pose: Pose  #: rig → world
    panorama: NDArray[np.uint8]  #: RGB, any size, of the whole grid
    own: NDArray[np.float32]  #: inverse depth by itself, (H, W), 1/m
    refined: NDArray[np.float32]  #: and after fusing all frames


def world_page(
    surface: Surface,
    poses: Mapping[int, Pose],
    views: Sequence[PageView],
    grid: SphereGrid,
    farthest: float,
    title: str,
    sentences: Sequence[str],
) -> str:
    """Return the page, in one piece: the surface seen from the path, the path on a plan, frames
    before and after.

    Args:
        poses: Rig → world, of each frame.
        views: Frames along the path.
        farthest: Metres up to which depth was fused.
        title: The verdict on the world.
        sentences: What carries it.
    """
    small = _coarser(surface)
    low = small.vertices.min(axis=0)
    size = np.maximum(small.vertices.max(axis=0) - low, 1e-6)
    chosen = choose_views(small, ((view.pose, view.refined) for view in views), grid)
    order = np.argsort(chosen, kind="stable")

    def draw(view: PageView) -> dict[str, str]:
        depths = {"before": view.own, "after": view.refined}
        pictures = {name: webp(colorize_depth(one, grid), 80) for name, one in depths.items()}
        return {"picture": webp(panorama_with_far(view, farthest), 70), **pictures}

    data = {
        "title": title,
        "words": " ".join(sentences),
        "count": len(small.vertices),
        "triangles": len(small.faces),
        "low": low.tolist(),
        "size": size.tolist(),
        "vertices": packed((_STEPS * (small.vertices - low) / size).round().astype("<u2").T),
        "colors": packed(_colors(small).T),
        "faces": packed(small.faces[order].astype("<u4").T),
        "plain": int((chosen < 0).sum()),
        "phi": np.radians(grid.phi_deg).tolist(),
        "views": [
            {
                "number": view.number,
                "triangles": int((chosen == k).sum()),
                "turn": view.pose.R.ravel().tolist(),
                "place": view.pose.t.tolist(),
                **pictures,
            }
            for k, (view, pictures) in enumerate(zip(views, map_threads(draw, views), strict=True))
        ],
        "path": [
            {
                "number": n,
                "place": pose.t.tolist(),
                "heading": float(np.arctan2(pose.R[0, 2], pose.R[2, 2])),
            }
            for n, pose in poses.items()
        ],
    }
    return page_of(data, "world.html", ("data.js", "gl.js", "world.js"))


def panorama_with_far(view: PageView, farthest: float) -> NDArray[np.uint8]:
    """Return a panorama as RGBA, to be seen behind the surface: opaque beyond the range, and less
    so from there to half the range, where surfaces may be missing.

    It is half transparent at most, so that a browser that multiplies by it loses one bit.
    """
    far = (2 - farthest * view.refined).clip(0, 1)
    alpha = cv2.blur(cv2.resize(far, view.panorama.shape[1::-1]), (9, 9))
    return np.dstack([view.panorama, 128 + 8 * (15 * alpha).astype(np.uint8)])


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
