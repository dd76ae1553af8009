"""COLMAP cameras.txt (OPENCV_FISHEYE) and rig_config.json; written, not read."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.rig import Rig


def colmap_cameras_text(rig: Rig, parameters: Sequence[dict[str, float]]) -> str:
    """Return cameras.txt; in COLMAP the centre of the top-left pixel is (0.5, 0.5)."""
    lines = ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"]
    for i, (camera, p) in enumerate(zip(rig.cameras, parameters, strict=True), start=1):
        values = [p["fx"], p["fy"], p["cx"] + 0.5, p["cy"] + 0.5, *(p[f"k{n}"] for n in (1, 2, 3, 4))]
        lines.append(f"{i} OPENCV_FISHEYE {camera.image_size[0]} {camera.image_size[1]} {' '.join(map(repr, values))}")
    return "\n".join(lines) + "\n"


def colmap_rig_text(rig: Rig) -> str:
    """Return rig_config.json, camera 1 the reference; poses are rig → camera."""
    cameras: list[dict[str, Any]] = [{"image_prefix": "cam1/", "ref_sensor": True}]
    for i, pose in enumerate(rig.T_rig_cam[1:], start=2):
        T = pose.inverse() @ rig.T_rig_cam[0]
        rotation = {"cam_from_rig_rotation": _quaternion(T), "cam_from_rig_translation": T.t.tolist()}
        cameras.append({"image_prefix": f"cam{i}/"} | rotation)
    return json.dumps([{"cameras": cameras}], indent=1) + "\n"


def _quaternion(pose: Pose) -> list[float]:
    """Return (w, x, y, z)."""
    half = pose.as_vector()[:3] / 2
    angle = np.linalg.norm(half)
    return [float(np.cos(angle)), *(np.sinc(angle / np.pi) * half).tolist()]
