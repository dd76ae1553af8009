"""A world as a recording of Rerun, which plays it: images, points, path and mesh over time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import ModuleType

import numpy as np

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import atomic_write
from omnistereo_lib.frame import read_inverse_depth
from omnistereo_lib.geometry.pose import Pose
from omnistereo_tools.world.build import RecordedFrames
from omnistereo_tools.world.surface import Surface


def import_rerun() -> ModuleType:
    """Return the module rerun; an `OmnistereoError` says how to install it."""
    try:
        import rerun
    except ImportError:
        how = "in the clone, .venv/bin/pip install -e '.[rerun]'"
        raise OmnistereoError(f"--rrd needs rerun-sdk: {how}") from None
    return rerun


def write_rrd(
    path: Path, frames: RecordedFrames, poses: Mapping[int, Pose], refined: Path, surface: Surface
) -> None:
    """Write the mesh, and for each frame the rig's pose, images and points, by its number and time.

    The world is the rig of the first frame: x right, y down, z forward; metres.
    """
    rr, times = import_rerun(), frames.times
    with atomic_write(path) as temporary, rr.RecordingStream("omnistereo") as out:
        out.save(temporary)
        out.log("world", rr.ViewCoordinates.RDF, static=True)
        colors = np.broadcast_to(surface.color, surface.vertices.shape).round().astype(np.uint8)
        triangles = {"triangle_indices": surface.faces, "vertex_colors": colors}
        mesh = rr.Mesh3D(vertex_positions=surface.vertices, **triangles)
        out.log("world/mesh", mesh, static=True)
        for number, pose in poses.items():
            out.set_time("frame", sequence=number)
            if number in times:
                out.set_time("time", timestamp=np.datetime64(times[number], "ns"))
            frame = frames.data.frame(number)
            out.log("world/rig", rr.Transform3D(translation=pose.t, mat3x3=pose.R))
            cameras = zip(frames.sweep_of(frame).rig.T_rig_cam, frame.images, strict=True)
            for k, (own, image) in enumerate(cameras, 1):
                name = f"world/rig/cam{k}"
                out.log(name, rr.Transform3D(translation=own.t, mat3x3=own.R))
                out.log(f"{name}/image", rr.Image(image).compress())
            inverse = read_inverse_depth(refined / f"{number:05}.tiff")
            known = inverse > 0
            points = frames.grid.rays()[known] / inverse[known][:, None]
            colors = np.nan_to_num(frames.panorama(frame, inverse)[known]).round().astype(np.uint8)
            colors = np.broadcast_to(colors, points.shape)
            out.log("world/rig/points", rr.Points3D(points, colors=colors))
