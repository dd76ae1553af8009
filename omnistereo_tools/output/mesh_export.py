"""A depth panorama as a textured mesh: GLB for Blender and viewers, PLY for the rest."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import atomic_write
from omnistereo_lib.stereo.depth import Depth
from omnistereo_tools.output.points import AXES, Limits

if TYPE_CHECKING:
    from trimesh import Scene, Trimesh

_EDGE = 0.2  # of the depth between neighbouring rays: a surface so oblique is hardly seen
_SPHERES = 1.5  # always connected: far away, one sphere is more than `_EDGE`
_EYE_FOV = 1.2  # radians from top to bottom, of the camera in a GLB
_TRANSLUCENT = 90  # of 255: doubtful triangles are faded, as in the pictures


def write_mesh(
    path: Path,
    depth: Depth,
    panorama: NDArray[np.uint8],
    limits: Limits,
    doubtful: NDArray[np.bool_] | None = None,
    up: str | None = None,
) -> tuple[int, int]:
    """Write the mesh of a depth panorama in metres; return its number of triangles, and how many
    are doubtful.

    A .glb file is textured and has y up, as glTF demands; its doubtful triangles are an object of
    their own, named so and translucent. A .ply file has colours and doubts at its vertices and the
    axes of the rig: x right, y down, z forward.

    Args:
        panorama: uint8 array, RGB, the whole panorama at any size: the texture
        limits: Rays that become vertices; the sky is beyond its `max_depth`.
        doubtful: Which rays are doubtful, (H, W); so is a triangle with such a vertex. None: none
            is.
        up: Of a .ply file, see `AXES`.

    Raises:
        OmnistereoError: If trimesh is not installed, no triangle is left, or the file cannot be
            written.
    """
    mesh = make_mesh(depth, limits)
    uv = mesh.metadata["uv"]
    vertices = _look_up(uv, np.zeros(depth.grid.shape, bool) if doubtful is None else doubtful)
    triangles = np.any(vertices[mesh.faces], axis=-1)
    if path.suffix.lower() == ".glb":
        mesh.vertices = mesh.vertices @ AXES["y"]
        content = _textured(mesh, uv, panorama, triangles)
    else:
        mesh.vertices = mesh.vertices @ AXES[up]
        content = _coloured(mesh, _look_up(uv, panorama), vertices)
    with atomic_write(path) as temporary:
        temporary.write_bytes(content)
    return len(mesh.faces), int(triangles.sum())


def import_trimesh() -> ModuleType:
    """Return the module trimesh; an `OmnistereoError` says how to install it."""
    try:
        import trimesh
    except ImportError:
        raise OmnistereoError(
            "a mesh needs trimesh: in the clone, .venv/bin/pip install -e '.[tools]'"
        ) from None
    return trimesh


def make_mesh(depth: Depth, limits: Limits) -> Trimesh:
    """Return the mesh in the axes of the rig, without colours; `metadata["uv"]` holds the texture
    coordinates (M, 2).

    Triangles face the rig. u grows with the columns from 0 to 1 and, in the triangles that close
    the circle, a little beyond; v grows upwards. Arguments and errors as in `write_mesh`.
    """
    trimesh = import_trimesh()
    points, corners = surfaces(depth, limits)
    if len(corners) == 0:
        raise OmnistereoError("no triangle is left for the mesh. Raise --max-depth")
    return _unwrap(trimesh.Trimesh(points, corners, process=False), depth)


def surfaces(depth: Depth, limits: Limits) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the vertices (M, 3), axes of the rig, and the triangles (F, 3), which face the rig."""
    distance = np.where(limits.keep(depth), depth.depth, np.nan)
    used, corners = np.unique(_triangles(distance, depth.index), return_inverse=True)
    on, towards = np.divmod(used, distance.size)
    rays = depth.grid.rays().reshape(-1, 3)
    halfway = rays[on] + rays[towards]  # of a vertex at a ray, the ray itself
    points = halfway / np.linalg.norm(halfway, axis=-1, keepdims=True) * distance.ravel()[on, None]
    return points, corners.reshape(-1, 3)


def _triangles(distance: NDArray[Any], index: NDArray[Any]) -> NDArray[np.int64]:
    """Return the corners (M, 3) of the triangles between neighbouring rays, circular, seen from the
    rig to the left.

    A corner is the number of its ray times the number of rays, plus the number of the ray towards
    which it lies: the ray itself, or at an edge in depth a neighbour. There each surface ends
    halfway, at its own depth (marching squares), so that nothing is stretched from one to the
    other, and rims have no teeth.
    """
    rays = np.arange(distance.size).reshape(distance.shape)
    above, below = rays[:-1], rays[1:]
    cells = np.stack([above, below, np.roll(below, -1, 1), np.roll(above, -1, 1)], -1).reshape(
        -1, 4
    )
    depths, indices = distance.ravel()[cells], index.ravel()[cells]
    whole = np.isfinite(depths).all(-1) & is_connected(depths.T, indices.T)
    found = [cells[whole][:, corners] * (distance.size + 1) for corners in ([0, 1, 3], [3, 1, 2])]
    cells, depths, indices = cells[~whole], depths[~whole], indices[~whole]
    left = np.isfinite(depths)
    for _ in range(2):  # the nearest surface of a cell, and the next one
        first = np.where(left, depths, np.inf).argmin(-1)[:, None]
        pairs = [
            np.stack([values, np.broadcast_to(np.take_along_axis(values, first, 1), values.shape)])
            for values in (depths, indices)
        ]
        on = left & is_connected(*pairs)
        for pattern in range(1, 15):
            outline = _outline(cells[on @ [1, 2, 4, 8] == pattern], pattern, distance.size)
            found += [outline[:, [0, k, k + 1]] for k in range(1, outline.shape[1] - 1)]
        left &= ~on
    return np.concatenate(found)


def _outline(cells: NDArray[np.int64], pattern: int, rays: int) -> NDArray[np.int64]:
    """Return the outline of the corners of cells (M, 4) that a pattern of bits names."""
    found = []
    for k in range(4):
        here, following = cells[:, k], cells[:, (k + 1) % 4]
        starts, ends = pattern >> k & 1, pattern >> (k + 1) % 4 & 1
        if starts:
            found.append(here * (rays + 1))
        if starts != ends:
            found.append(here * rays + following if starts else following * rays + here)
    return np.stack(found, -1)


def is_connected(depths: NDArray[Any], indices: NDArray[Any]) -> NDArray[np.bool_]:
    """Return whether neighbouring rays show one surface, (M,), by metres and indices (rays, M)."""
    near, far = depths.min(0), depths.max(0)  # NaN if one is unknown
    return (far <= (1 + _EDGE) * near) | (np.ptp(indices, axis=0) <= _SPHERES)


def _unwrap(mesh: Trimesh, depth: Depth) -> Trimesh:
    """Return the mesh with texture coordinates; at the ±180° seam vertices are repeated."""
    pixels, _ = depth.grid.project(mesh.vertices)
    u, v = (pixels[:, 0] + 0.5) / depth.grid.width, 1 - (pixels[:, 1] + 0.5) / depth.grid.height
    faces, vertices = np.array(mesh.faces), np.array(mesh.vertices)
    beyond = (np.ptp(u[faces], axis=1) > 0.5)[:, None] & (u[faces] < 0.5)
    repeated, copies = np.unique(faces[beyond], return_inverse=True)
    faces[beyond] = len(vertices) + copies
    uv = np.concatenate([np.stack([u, v], -1), np.stack([u[repeated] + 1, v[repeated]], -1)])
    vertices = np.concatenate([vertices, vertices[repeated]])
    return type(mesh)(vertices, faces, process=False, metadata={"uv": uv})


def _coloured(mesh: Trimesh, colors: NDArray[np.uint8], doubtful: NDArray[np.bool_]) -> bytes:
    """Return a PLY file with the colours and doubts of the vertices."""
    from trimesh.exchange.ply import export_ply
    from trimesh.visual import ColorVisuals

    mesh.visual = ColorVisuals(mesh, vertex_colors=colors)
    mesh.vertex_attributes["doubtful"] = doubtful.astype(np.uint8)
    return export_ply(mesh)


def _textured(
    mesh: Trimesh, uv: NDArray[Any], panorama: NDArray[np.uint8], doubtful: NDArray[np.bool_]
) -> bytes:
    """Return a GLB file with the sure and the doubtful triangles of a mesh as two objects."""
    from PIL import Image
    from trimesh import Scene
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    scene = Scene()
    for name, chosen, alpha in (("surface", ~doubtful, None), ("doubtful", doubtful, _TRANSLUCENT)):
        if not chosen.any():
            continue
        used, corners = np.unique(mesh.faces[chosen], return_inverse=True)
        material = PBRMaterial(
            name=name,
            baseColorTexture=Image.fromarray(panorama),
            baseColorFactor=None if alpha is None else [255, 255, 255, alpha],
            alphaMode=None if alpha is None else "BLEND",
            metallicFactor=0.0,
            roughnessFactor=1.0,
            doubleSided=True,
        )
        part = type(mesh)(mesh.vertices[used], corners.reshape(-1, 3), process=False)
        part.visual = TextureVisuals(uv=uv[used], material=material)
        scene.add_geometry(part, node_name=name, geom_name=name)
    return export_glb(scene)


def export_glb(scene: Trimesh | Scene) -> bytes:
    """Return a GLB file that is shown as its photographs are, without light, with a camera at the
    origin that looks ahead.

    Vertex colours are those of `vertex_attributes["_COLOR_0"]`, linear, (M, 3) float32: glTF's are
    not sRGB, which 8 bits would turn to bands in the dark, and MeshLab misreads 16.
    """

    def unlit(tree: dict[str, Any]) -> None:
        for mesh in tree["meshes"]:
            for primitive in mesh["primitives"]:
                attributes = primitive["attributes"]
                if "_COLOR_0" in attributes:
                    attributes["COLOR_0"] = attributes.pop("_COLOR_0")
                    primitive.setdefault("material", 0)
        plain = {"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0}}
        for material in tree.setdefault("materials", [plain | {"doubleSided": True}]):
            material["extensions"] = {"KHR_materials_unlit": {}}
        tree["extensionsUsed"] = [*tree.get("extensionsUsed", ()), "KHR_materials_unlit"]
        eye = {"yfov": _EYE_FOV, "znear": 0.01}
        tree["cameras"] = [{"name": "rig", "type": "perspective", "perspective": eye}]
        tree["scenes"][tree["scene"]]["nodes"].append(len(tree["nodes"]))
        tree["nodes"].append({"name": "rig", "camera": 0})

    content = scene.export(file_type="glb", tree_postprocessor=unlit)
    assert isinstance(content, bytes)
    return content


def linear(colors: NDArray[Any]) -> NDArray[np.float32]:
    """Return the linear light, 0 to 1, of sRGB colours from 0 to 255 (IEC 61966-2-1)."""
    share = np.asarray(colors, np.float32) / 255
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def _look_up(uv: NDArray[Any], panorama: NDArray[Any]) -> NDArray[Any]:
    """Return the values of a panorama of any size at texture coordinates (M, 2)."""
    height, width = panorama.shape[:2]
    column = np.floor(uv[:, 0] * width).astype(int) % width
    row = np.floor((1 - uv[:, 1]) * height).astype(int).clip(0, height - 1)
    return panorama[row, column]
