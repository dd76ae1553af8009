"""OpenCV fisheye YAML: K, D, R, T and image size of each camera; X_cam = R X_rig + T; the unit is not stated.

OpenCV defines no keys for a rig, so two layouts are read:

- one mapping per camera, at the top or under `cameras`, in order, with the keys of `_ALIASES` (R is 3 × 3 or an
  axis-angle; image_width and image_height may replace image_size; the size may be at the top for all cameras);
- the same keys at the top with the camera number behind, as K1 D1 K2 D2 R2 T2; a pair may say R, T for the second
  camera, as `cv2.fisheye.stereoCalibrate` returns them.

The first camera may omit R and T: it is then the rig frame.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.pose import Pose, rotation_from_axis_angle
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.rig_files.camera_models import fit_camera
from omnistereo_lib.rig_files.parse import (
    error_context,
    metres_per_unit,
    parse_axis_angle,
    parse_floats,
    parse_size,
    require_key,
)

_ALIASES = {
    "K": ("K", "camera_matrix", "cameraMatrix"),
    "D": ("D", "dist_coeffs", "distCoeffs", "distortion_coefficients"),
    "R": ("R", "rvec"),
    "T": ("T", "t", "tvec"),
    "image_size": ("image_size", "imageSize", "resolution"),
}
_STANDARD_KEYS = {alias: key for key, aliases in _ALIASES.items() for alias in aliases}


def read_opencv(data: dict[str, Any], path: Path, max_fov_deg: float | None, unit: str | None) -> Rig:
    """Read a parsed OpenCV fisheye calibration in one of the layouts of the module docstring."""
    cams = opencv_cameras(data)
    T_cam_rig = []
    for n, (name, cam) in enumerate(cams.items()):
        with error_context(f"camera {name}"):
            T_cam_rig.append(_parse_pose(cam, first=n == 0))
    T_rig_cam = [pose.inverse() for pose in T_cam_rig]
    scale = metres_per_unit(unit, np.stack([pose.t for pose in T_rig_cam]))
    cameras = []
    for name, cam in cams.items():
        with error_context(f"camera {name}"):
            parameters, sized = _parse_intrinsics(cam), _with_standard_keys(data) | cam
            size = sized.get("image_size")
            size = [require_key(sized, f"image_{side}") for side in ("width", "height")] if size is None else size
            image_size = parse_size(size, "image_size")
            cameras.append(fit_camera(f"{path}, camera {name}", "kb4", parameters, image_size, max_fov_deg))
    return Rig(cameras, [Pose(pose.R, pose.t * scale) for pose in T_rig_cam])


def opencv_cameras(data: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return each camera with the standard keys, in file order; empty if the file has no camera matrices."""
    nested = data.get("cameras", data)
    nested = dict(enumerate(nested, 1)) if isinstance(nested, list) else nested
    found = {str(name): _with_standard_keys(cam) for name, cam in nested.items()} if isinstance(nested, dict) else {}
    found = {name: cam for name, cam in found.items() if "K" in cam}
    if found:
        return found
    for key, value in data.items():
        match = re.fullmatch(r"(\w*?[A-Za-z])_?([0-9]{1,4})", str(key))
        if match and match[1] in _STANDARD_KEYS:
            found.setdefault(match[2], {})[_STANDARD_KEYS[match[1]]] = value
    found = {name: found[name] for name in sorted(found, key=int) if "K" in found[name]}
    if len(found) == 2:
        second = list(found)[1]
        common = {key: value for key, value in _with_standard_keys(data).items() if key in ("R", "T")}
        found[second] = common | found[second]
    return found


def _with_standard_keys(cam: Any) -> dict[str, Any]:
    cam = cam if isinstance(cam, dict) else {}
    return {_STANDARD_KEYS.get(str(key), str(key)): value for key, value in cam.items()}


def _parse_pose(cam: dict[str, Any], first: bool) -> Pose:
    if first and "R" not in cam and "T" not in cam:
        return Pose.identity()
    R = parse_floats(require_key(cam, "R"), "R")
    if R.size not in (3, 9):
        raise OmnistereoError(f"R has {R.size} numbers; expected a 3 × 3 matrix or an axis-angle of 3 numbers")
    R = R.reshape(3, 3) if R.size == 9 else rotation_from_axis_angle(parse_axis_angle(R, "R"))
    return Pose(R, parse_floats(require_key(cam, "T"), "T", 3))


def _parse_intrinsics(cam: dict[str, Any]) -> dict[str, float]:
    K = parse_floats(require_key(cam, "K"), "K", 9)
    D = parse_floats(require_key(cam, "D"), "D (k1 to k4 of the OpenCV fisheye model, not of a pinhole model)", 4)
    if not np.allclose(K[[1, 3, 6, 7, 8]], [0, 0, 0, 0, 1], atol=1e-9):
        raise OmnistereoError(f"K is {K.tolist()}; expected fx 0 cx, 0 fy cy, 0 0 1")
    names = ("fx", "cx", "fy", "cy", "k1", "k2", "k3", "k4")
    return dict(zip(names, [*K[[0, 2, 4, 5]].tolist(), *D.tolist()], strict=True))
