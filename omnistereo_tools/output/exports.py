"""Files for other programs, on demand: a mesh, depth as an equirectangular picture, perspective crops."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.files import atomic_write, make_folder
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.depth import Depth
from omnistereo_tools.output import mesh_export
from omnistereo_tools.output.crops import write_crops
from omnistereo_tools.output.frame import FrameResult

_ALL = 0.99  # of what the cameras see


def export_frame(
    result: FrameResult,
    mesh_file: Path | None,
    faces: int | None,
    equirectangular: Path | None,
    crops: Path | None,
    all_crops: bool = False,
) -> list[str]:
    """Write the files that are asked for; return their names, each with what it holds.

    Args:
        mesh_file, faces: See `write_mesh`.
        equirectangular: See `equirectangular_depth`.
        crops, all_crops: See `write_crops`.
    """
    written = []
    if mesh_file is not None:
        make_folder(mesh_file.parent)
        triangles, doubtful = mesh_export.write_mesh(
            mesh_file, result.depth, result.panorama, result.limits, faces, result.doubtful
        )
        written.append(f"{mesh_file} ({triangles} triangles, {doubtful} of them doubtful and marked)")
    if equirectangular is not None:
        import tifffile

        make_folder(equirectangular.parent)
        with atomic_write(equirectangular) as temporary:
            tifffile.imwrite(temporary, equirectangular_depth(result.depth), compression="deflate")
        written.append(f"{equirectangular} (metres along the ray)")
    if crops is not None:
        count, share = write_crops(make_folder(crops), result.depth, result.limits, all_crops)
        more = "" if all_crops or share > _ALL else "; --all-crops covers the rest"
        written.append(
            f"{crops}/ ({count} crops of {100 * share:.0f} % of what the cameras see{more}; transforms.json)"
        )
    return written


def equirectangular_depth(depth: Depth) -> NDArray[np.float32]:
    """Return depth along the ray in metres as a panorama of the whole sphere, shape (W / 2, W).

    Infinite where nothing is near, NaN where it is unknown, such as at the poles. Each ray takes the nearest pixel:
    depth between two surfaces would be in neither.
    """
    width = depth.grid.width
    rays = SphereGrid(width, width // 2, (-90.0, 90.0)).rays()
    pixels, inside = depth.grid.project(rays)
    column, row = np.moveaxis(np.rint(pixels).astype(int), -1, 0)
    found = depth.depth[row.clip(0, depth.grid.height - 1), column % width]
    return np.where(inside, found, np.nan).astype(np.float32)
