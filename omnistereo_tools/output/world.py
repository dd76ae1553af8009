"""What is written of a world: its surface, and a page to look at."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from omnistereo_lib.files import atomic_write
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.world.surface import Surface
from omnistereo_tools.output.mesh_export import Y_UP, import_trimesh
from omnistereo_tools.output.pictures import colorize_depth

_SHOWN = 200_000  # points of the plan


def write_surface(folder: Path, surface: Surface) -> None:
    """Write mesh.glb, y up, and mesh.ply in the axes of the world, with the colours of the images."""
    colors = np.broadcast_to(surface.color.round().clip(0, 255).astype(np.uint8), (len(surface.vertices), 3))
    for name, axes in (("mesh.glb", Y_UP), ("mesh.ply", np.eye(3))):
        mesh = import_trimesh().Trimesh(surface.vertices @ axes, surface.faces, vertex_colors=colors, process=False)
        with atomic_write(folder / name) as temporary:
            temporary.write_bytes(mesh.export(file_type=name[-3:]))


def draw_overview(
    surface: Surface,
    poses: Mapping[int, Pose],
    own: NDArray[np.float32],
    refined: NDArray[np.float32],
    grid: SphereGrid,
) -> Figure:
    """Return the page: the path on a plan of the surface, and the depth of one frame before and after, (H, W) each."""
    figure = Figure(figsize=(12, 12), layout="constrained")
    plan, before, after = figure.subplots(3, 1, height_ratios=[3, 1, 1])
    points = surface.vertices[:: len(surface.vertices) // _SHOWN + 1]
    path = np.array([pose.t for pose in poses.values()])
    # The longer way lies across the page; seen from above either way, not mirrored.
    turned = bool(np.ptp(points[:, 0]) > np.ptp(points[:, 2]))
    across, along = (-points[:, 0], points[:, 2]) if turned else (points[:, 2], -points[:, 0])
    shown = plan.scatter(across, along, c=-points[:, 1], s=0.3, cmap="viridis", rasterized=True)
    plan.plot(*((-path[:, 0], path[:, 2]) if turned else (path[:, 2], -path[:, 0])), "r.-", lw=1)
    labels = ["metres ahead of the first frame", "metres to its left"]
    plan.set(aspect="equal", xlabel=labels[turned], ylabel=labels[not turned])
    if turned:
        plan.invert_yaxis()
    plan.set_title(f"The path of the rig, {len(poses)} frames, on the surfaces from above")
    figure.colorbar(shown, ax=plan, label="height over the first frame in metres", shrink=0.7)
    for ax, inverse, title in ((before, own, "Depth of one frame alone"), (after, refined, "After fusing all frames")):
        ax.imshow(colorize_depth(inverse, grid), interpolation="nearest")
        ax.set(title=title, xticks=[], yticks=[])
    return figure
