"""Perspective crops with depth and poses, for NeRF and Gaussian splatting programs."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.files import make_folder, write_text
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.pictures import write_image
from omnistereo_lib.stereo.depth import Depth
from omnistereo_lib.stereo.sweep import OUTSIDE, remap
from omnistereo_tools.output.pictures import in_millimetres
from omnistereo_tools.output.points import Limits, PointCloud

_FOV_DEG = 91.0  # the faces of a cube, which share their edges
_STEPS = 20  # of the search for the depth of a pixel; it has converged after 5 but at depth edges
_CONVERGED = 0.02  # of the depth
_FARTHEST = 1e4  # metres, in place of infinity
_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])  # y down, z forward ↔ y up, z backward, as in OpenGL


@dataclass(frozen=True)
class Crop:
    """A pinhole camera at the place of a camera of the rig."""

    T_rig_crop: Pose
    size: int  #: pixels, square

    @property
    def focal(self) -> float:
        """Focal length in pixels."""
        return float(self.size / 2 / np.tan(np.radians(_FOV_DEG / 2)))

    def rays(self) -> NDArray[np.float64]:
        """Return the ray of every pixel, z = 1 in its own frame, (size, size, 3)."""
        offset = (np.arange(self.size) + 0.5 - self.size / 2) / self.focal
        x, y = np.meshgrid(offset, offset)
        return np.stack([x, y, np.ones_like(x)], -1)


def crops_of(lens: OcamCamera, pose: Pose) -> Iterator[Crop]:
    """Yield the faces of a cube that a camera's field of view reaches, as fine as its image."""
    half = lens.max_fov_deg / 2
    corner = np.degrees(np.arctan(np.sqrt(2) * np.tan(np.radians(_FOV_DEG / 2))))
    turns = [(0.0, 0.0)]  # pitch and yaw
    if half > _FOV_DEG / 2:
        turns += [(0.0, 90.0), (0.0, -90.0), (90.0, 0.0), (-90.0, 0.0)]
    if half > 180 - corner:
        turns += [(0.0, 180.0)]
    size = 2 * round(_FOV_DEG * lens.image_size[0] / lens.max_fov_deg / 2)
    for turn in turns:
        yield Crop(pose @ Pose.from_vector([*np.radians(turn), 0, 0, 0, 0]), size)


def write_crops(out: Path, depth: Depth, limits: Limits, cloud: PointCloud) -> int:
    """Write crops, their depth and transforms.json, as nerfstudio reads them, into a folder; return
    their number.

    images/1b.png    the second crop of camera 1; a number at the end would be that of a moment
    depth/1b.png     16 bits: depth along the optical axis in millimetres; 0 where it is unknown or
                     beyond 65 m
    masks/1b.png     0 where the lens or its mask covers a pixel; of all crops, or of none if there
                     is no such pixel: nerfstudio refuses masks of some
    points.ply       the cloud, from which splatting starts, with y up
    transforms.json  intrinsics, and poses with y up and the view along -z; the world is the rig
                     with y up
    """
    rig = depth.sweep.rig
    frames = dict[str, dict[str, Any]]()
    masks = dict[str, NDArray[np.bool_]]()
    for k, (lens, pose) in enumerate(zip(rig.cameras, rig.T_rig_cam, strict=True)):
        for letter, crop in zip("abcdef", crops_of(lens, pose), strict=False):
            name = f"{k + 1}{letter}.png"
            picture, masks[name] = crop_image(crop, lens, pose, depth.images[k])
            z = np.where(masks[name], crop_depth(crop, depth, limits), np.nan)
            write_image(make_folder(out / "images") / name, picture)
            write_image(make_folder(out / "depth") / name, in_millimetres(z))
            frames[name] = {"file_path": f"images/{name}", "depth_file_path": f"depth/{name}"}
            frames[name] |= _intrinsics(crop)
    if not all(mask.all() for mask in masks.values()):
        for name, mask in masks.items():
            write_image(make_folder(out / "masks") / name, (255 * mask).astype(np.uint8))
            frames[name]["mask_path"] = f"masks/{name}"
    cloud.write(out / "points.ply", "y")
    scene: dict[str, Any] = {"camera_model": "PINHOLE", "depth_unit_scale_factor": 0.001}
    scene |= {"ply_file_path": "points.ply", "frames": [*frames.values()]}
    write_text(out / "transforms.json", json.dumps(scene, indent=1) + "\n")
    return len(frames)


def crop_image(
    crop: Crop, lens: OcamCamera, pose: Pose, image: ArrayLike
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the undistorted image of a crop, 0 to 255, and where it is seen, (size, size)."""
    uv, visible = lens.project(crop.rays() @ crop.T_rig_crop.R.T @ pose.R)
    maps = np.where(visible[..., None], uv, OUTSIDE).astype(np.float32)
    return np.nan_to_num(remap(np.asarray(image, np.float32), maps)), visible


def crop_depth(crop: Crop, depth: Depth, limits: Limits) -> NDArray[np.float64]:
    """Return the depth of every pixel of a crop along its optical axis, metres, (size, size); NaN
    unknown.

    The crop is not where the panorama was computed: on each of its rays the point is searched whose
    distance from the sweep centre is the depth of the panorama in its direction.
    """
    finite = np.nan_to_num(depth.depth, nan=_FARTHEST, posinf=_FARTHEST)
    rays, center = crop.rays() @ crop.T_rig_crop.R.T, crop.T_rig_crop.t
    length = np.linalg.norm(rays, axis=-1)
    directions = rays / length[..., None]
    along = directions @ center
    points = directions * np.median(finite)
    for _ in range(_STEPS):
        found, _ = depth.grid.look_up(finite, points)
        # of |center + s directions| = found
        root = np.maximum(along**2 + found**2 - center @ center, 0)
        distance = -along + np.sqrt(root)
        points = center + distance[..., None] * directions
    panorama = np.where(limits.keep(depth), depth.depth, np.nan)
    found, inside = depth.grid.look_up(panorama, points)
    error = np.abs(found / np.linalg.norm(points, axis=-1) - 1)
    return np.where((error < _CONVERGED) & inside & (distance > 0), distance / length, np.nan)


def _intrinsics(crop: Crop) -> dict[str, Any]:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = crop.T_rig_crop.R, crop.T_rig_crop.t
    pose = _FLIP @ matrix @ _FLIP
    center = {"cx": crop.size / 2, "cy": crop.size / 2}
    focal = {"fl_x": crop.focal, "fl_y": crop.focal}
    return {"w": crop.size, "h": crop.size, **focal, **center, "transform_matrix": pose.tolist()}
