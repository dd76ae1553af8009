"""OpenCV and ROS files: K, D, R, T and image size of each camera; X_cam = R X_rig + T; the unit is not stated.

OpenCV defines no keys for a rig, so two layouts are read, as YAML, JSON and XML:

- one mapping per camera, at the top or under `cameras`, in order, with the keys of `_ALIASES` (R is 3 × 3 or an
  axis-angle; image_width and image_height may replace image_size; the size may be at the top for all cameras);
- the same keys at the top with the camera number behind, as K1 D1 K2 D2 R2 T2; a pair may say R, T for the second
  camera, as `cv2.fisheye.stereoCalibrate` returns them: R1, R2, P1, P2 are then the rectification.

The first camera may omit R and T: it is then the rig frame. D of four numbers is the fisheye model of OpenCV, unless
`distortion_model` names another one; `xi` makes it the omnidirectional model of opencv_contrib.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np

from omnistereo_lib.errors import OmnistereoError, error_context
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose, rotation_from_axis_angle
from omnistereo_lib.rig_files.camera_models import RADTAN
from omnistereo_lib.rig_files.fit import fit_camera
from omnistereo_lib.rig_files.parse import RigFile, Section, parse_axis_angle, parse_floats, parse_size

_ALIASES = {
    "K": ("K", "camera_matrix", "cameraMatrix"),
    "D": ("D", "dist_coeffs", "distCoeffs", "distortion_coefficients"),
    "R": ("R", "rvec"),
    "T": ("T", "t", "tvec"),
    "xi": ("xi",),
    "image_size": ("image_size", "imageSize", "resolution"),
    "model": ("distortion_model", "camera_model", "model", "projection"),
}
_NUMBERED = {alias: key for key, aliases in _ALIASES.items() for alias in aliases}
_FISHEYE = ("k1", "k2", "k3", "k4")
# distortion_model → our model and its coefficients in the order of D
_MODELS = {
    **dict.fromkeys(("equidistant", "fisheye", "kannala_brandt", "opencv_fisheye", "kb4"), ("kb4", _FISHEYE)),
    **dict.fromkeys(("plumb_bob", "rational_polynomial", "radtan", "brown", "opencv"), ("pinhole", RADTAN)),
    **dict.fromkeys(("omnidir", "mei", "omni"), ("omni", RADTAN[:4])),
    "none": ("pinhole", ()),
}


def read_opencv(data: Section, path: Path, max_fov_deg: float | None) -> RigFile:
    """Read a parsed calibration of OpenCV or ROS in one of the layouts of the module docstring."""
    cameras, T_rig_cam = [], []
    for n, cam in enumerate(_cameras(data)):
        with error_context(f"camera {cam.name}"):
            T_rig_cam.append(_parse_pose(cam, first=n == 0).inverse())
            cameras.append(_parse_camera(cam, data, f"{path}, camera {cam.name}", max_fov_deg))
    return RigFile(cameras, T_rig_cam)


def is_opencv(data: dict[str, Any]) -> bool:
    """Return whether a file has camera matrices as OpenCV and ROS name them."""
    cameras = data.get("cameras", data)
    inner = list(cameras.values()) if isinstance(cameras, dict) else cameras if isinstance(cameras, list) else []
    named = [cam for cam in inner if isinstance(cam, dict) and set(_ALIASES["K"]) & set(cam)]
    return bool(named) or any(re.fullmatch(rf"({'|'.join(_ALIASES['K'])})_?[0-9]*", str(key)) for key in data)


def _cameras(data: Section) -> list[Section]:
    """Return the cameras in file order."""
    if "cameras" in data.values:
        return list(data.sections("cameras").values())
    nested = [
        data.section(key) for key, value in data.values.items() if isinstance(value, dict) and "data" not in value
    ]
    nested = [cam for cam in nested if set(_ALIASES["K"]) & set(cam.values)]
    if nested:
        return nested
    numbered: dict[str, dict[str, Any]] = {}
    for key in data.values:
        match = re.fullmatch(r"(\w*?[A-Za-z])_?([0-9]{1,4})", key)
        if match and match[1] in _NUMBERED:
            numbered.setdefault(match[2], {})[match[1]] = data.get(key)
    numbered = {name: numbered[name] for name in sorted(numbered, key=int) if set(_ALIASES["K"]) & set(numbered[name])}
    R, T = data.get(*_ALIASES["R"]), data.get(*_ALIASES["T"])
    if len(numbered) == 2 and R is not None and T is not None:
        first, second = numbered.values()
        for cam in (first, second):  # R1 and R2 rectify
            cam.pop("R", None)
        second |= {"R": R, "T": T}
    return [Section(cam, name) for name, cam in numbered.items()] or [data]


def _parse_pose(cam: Section, first: bool) -> Pose:
    """Return rig → camera."""
    R, T = cam.get(*_ALIASES["R"]), cam.get(*_ALIASES["T"])
    if first and R is None and T is None:
        return Pose.identity()
    R = parse_floats(cam.require(*_ALIASES["R"]), "R")
    if R.size not in (3, 9):
        raise OmnistereoError(f"R has {R.size} numbers; expected a 3 × 3 matrix or an axis-angle of 3 numbers")
    R = R.reshape(3, 3) if R.size == 9 else rotation_from_axis_angle(parse_axis_angle(R, "R"))
    return Pose(R, cam.floats(*_ALIASES["T"], count=3))


def _parse_camera(cam: Section, data: Section, source: str, max_fov_deg: float | None) -> OcamCamera:
    K = cam.floats(*_ALIASES["K"], count=9)
    if not np.allclose(K[[3, 6, 7, 8]], [0, 0, 0, 1], atol=1e-9):
        raise OmnistereoError(f"K is {K.tolist()}; expected fx skew cx, 0 fy cy, 0 0 1")
    parameters = dict(zip(("fx", "skew", "cx", "fy", "cy"), K[[0, 1, 2, 4, 5]].tolist(), strict=True))
    D = parse_floats(cam.get(*_ALIASES["D"], default=[]), "D").tolist()
    if has_xi := cam.get("xi") is not None:
        parameters["xi"] = cam.number("xi")
    guess = "omnidir" if has_xi else {0: "none", 4: "fisheye", 5: "plumb_bob"}.get(len(D), "rational_polynomial")
    name = cam.word(*_ALIASES["model"]) or data.word(*_ALIASES["model"]) or guess
    model, coefficients = _MODELS.get(name, ("", ()))
    if not model or has_xi != (model == "omni"):
        found = f"{name} {'with' if has_xi else 'without'} xi"
        raise OmnistereoError(f"the camera model is {found}; expected one of {', '.join(_MODELS)}. Recalibrate with it")
    if not len(D) == len(coefficients) and not (model == "pinhole" and len(D) in (4, 5, 8)):
        raise OmnistereoError(f"D has {len(D)} numbers; expected those of the {name} model, {' '.join(coefficients)}")
    parameters |= dict(zip(coefficients, D, strict=False))
    stated = cam if {*_ALIASES["image_size"], "image_width"} & set(cam.values) else data
    size = stated.get(*_ALIASES["image_size"])
    size = [stated.require("image_width"), stated.require("image_height")] if size is None else size
    return fit_camera(source, model, parameters, parse_size(size, "image_size"), max_fov_deg)
