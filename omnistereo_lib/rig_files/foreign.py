"""Rigs calibrated elsewhere with other lens models: basalt, Kalibr, OpenCV. Each lens becomes an OCam camera.

What differs from file to file, beside the names, is the direction of the poses. basalt stores camera → rig
(`T_imu_cam`); Kalibr chains camera n-1 → camera n (`T_cn_cnm1`) and OpenCV's R, T take the rig's coordinates
into the camera: both are inverted here, because `Rig.T_rig_cam` is camera → rig.
"""

from __future__ import annotations

import logging
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import read_gray
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose, rotation_from_axis_angle
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.rig_files.camera_models import fit_ocam, make_lens
from omnistereo_lib.rig_files.parse import entries, entry, metres_per_unit, naming, numbers, whole_numbers

_log = logging.getLogger("omnistereo_lib")

_RESIDUAL_TO_WARN = 0.1  # px


def fitted_camera(
    source: str,
    model: str,
    parameters: dict[str, float],
    image_size: tuple[int, int],
    max_fov_deg: float | None,
    mask: NDArray[np.bool_] | None = None,
) -> OcamCamera:
    """Return the OCam camera of another lens model, and say how well it fits.

    Parameters
    ----------
    source : str
        File and camera, for messages.
    model, parameters
        As for `lenses.make_lens`.
    image_size, max_fov_deg, mask
        As for `lenses.fit_ocam`.

    Warns
    -----
    UserWarning
        If the worst residual is above 0.1 px, as tangential distortion makes it.
    """
    try:
        with np.errstate(all="ignore"):  # absurd parameters overflow on the way to being refused
            camera, residual = fit_ocam(make_lens(model, parameters), image_size, max_fov_deg, mask)
    except np.linalg.LinAlgError:
        raise OmnistereoError(f"no camera can be made of the {model} parameters {parameters}; check them") from None
    _log.info("%s: %s fitted by OCam, %.1f° seen, worst residual %.2g px", source, model, camera.max_fov_deg, residual)
    if residual > _RESIDUAL_TO_WARN:
        warnings.warn(
            f"{source}: the OCam polynomials are up to {residual:.2f} px away from the file's {model} lens. "
            "Tangential distortion does this, and so does a model that turns back within the field of view: lower "
            "max_fov_deg, or calibrate the camera with an OCam model.",
            UserWarning,
            stacklevel=2,
        )
    return camera


def read_basalt(data: dict[str, Any], path: Path, max_fov_deg: float | None) -> Rig:
    """Read basalt's calibration JSON: `value0` with `T_imu_cam`, `intrinsics`, `resolution`; metres.

    A mask `camN/mask.png` beside the file, N from 0, is read where there is one: bright = usable.
    """
    value = entry(data, "value0")
    poses, lenses, sizes = (entries(value, key) for key in ("T_imu_cam", "intrinsics", "resolution"))
    if not len(poses) == len(lenses) == len(sizes):
        raise OmnistereoError(
            f"found {len(poses)} poses, {len(lenses)} intrinsics and {len(sizes)} resolutions, expected as many of each"
        )
    cameras, T_rig_cam = [], []
    for i, (pose, lens, size) in enumerate(zip(poses, lenses, sizes, strict=True)):
        with naming(f"camera {i}"):
            T_rig_cam.append(_pose_from_quaternion(pose))
            model, parameters = _basalt_lens(lens)
            image_size = whole_numbers(size, "resolution", 2)
            mask_file = path.parent / f"cam{i}" / "mask.png"
            mask = read_gray(mask_file, image_size) >= 128 if mask_file.exists() else None
            cameras.append(fitted_camera(f"{path}, camera {i}", model, parameters, image_size, max_fov_deg, mask))
    return Rig(cameras, T_rig_cam)


def _basalt_lens(lens: Any) -> tuple[str, dict[str, float]]:
    intrinsics = entry(lens, "intrinsics")
    names = intrinsics if isinstance(intrinsics, dict) else ()
    return str(entry(lens, "camera_type")), {name: float(numbers(intrinsics[name], name, 1)[0]) for name in names}


def _pose_from_quaternion(pose: Any) -> Pose:
    from scipy.spatial.transform import Rotation

    q = numbers([entry(pose, key) for key in ("qx", "qy", "qz", "qw")], "the quaternion", 4)
    t = numbers([entry(pose, key) for key in ("px", "py", "pz")], "the position", 3)
    if abs(np.linalg.norm(q) - 1) > 1e-3:
        raise OmnistereoError(
            f"the quaternion {q.tolist()} has length {np.linalg.norm(q):.4g}, expected 1: no rotation"
        )
    return Pose(Rotation.from_quat(q).as_matrix(), t)


_KALIBR_INTRINSICS = {  # (camera_model, distortion_model) -> our model, names in the file's order
    ("ds", "none"): ("ds", ("xi", "alpha", "fx", "fy", "cx", "cy")),
    ("eucm", "none"): ("eucm", ("alpha", "beta", "fx", "fy", "cx", "cy")),
    ("omni", "none"): ("omni", ("xi", "fx", "fy", "cx", "cy")),
    ("omni", "radtan"): ("omni", ("xi", "fx", "fy", "cx", "cy")),
    ("pinhole", "equidistant"): ("kb4", ("fx", "fy", "cx", "cy")),
}
_DISTORTION_NAMES = {
    "none": (),
    "radtan": ("k1", "k2", "p1", "p2"),
    "equidistant": ("k1", "k2", "k3", "k4"),
}


def read_kalibr(data: dict[str, Any], path: Path, max_fov_deg: float | None) -> Rig:
    """Read Kalibr's camchain YAML: `cam0`, `cam1`, …, each with `T_cn_cnm1`; metres; rig frame = cam0.

    Models: ds, eucm, omni (radtan or no distortion), pinhole with equidistant distortion.
    """
    cameras, T_rig_cam = [], [Pose.identity()]
    names = sorted((name for name in data if re.fullmatch(r"cam\d+", str(name))), key=lambda name: int(name[3:]))
    for n, name in enumerate(names):
        cam = data[name]
        with naming(name):
            if name != f"cam{n}":
                raise OmnistereoError(f"expected cam{n} here: the chain of T_cn_cnm1 has a gap")
            if n > 0:
                T_cam_previous = _pose_from_matrix(entry(cam, "T_cn_cnm1"))
                T_rig_cam.append(T_rig_cam[-1] @ T_cam_previous.inverse())
            model, parameters = _kalibr_lens(cam)
            image_size = whole_numbers(entry(cam, "resolution"), "resolution", 2)
            cameras.append(fitted_camera(f"{path}, {name}", model, parameters, image_size, max_fov_deg))
    return Rig(cameras, T_rig_cam)


def _kalibr_lens(cam: Any) -> tuple[str, dict[str, float]]:
    kind = (str(entry(cam, "camera_model")), str(cam.get("distortion_model") or "none"))
    if kind not in _KALIBR_INTRINSICS:
        raise OmnistereoError(
            f"camera_model + distortion_model {' + '.join(kind)} is not read, known are "
            f"{', '.join(' + '.join(known) for known in _KALIBR_INTRINSICS)}; recalibrate with one of them"
        )
    model, names = _KALIBR_INTRINSICS[kind]
    parameters = dict(zip(names, numbers(entry(cam, "intrinsics"), "intrinsics", len(names)).tolist(), strict=True))
    names = _DISTORTION_NAMES[kind[1]] or (("k1", "k2", "p1", "p2") if model == "omni" else ())
    coefficients = [0.0] * len(names) if kind[1] == "none" else entry(cam, "distortion_coeffs")
    return model, parameters | dict(
        zip(names, numbers(coefficients, "distortion_coeffs", len(names)).tolist(), strict=True)
    )


def _pose_from_matrix(values: Any) -> Pose:
    matrix = numbers(values, "the 4 × 4 pose", 16).reshape(4, 4)
    if not np.allclose(matrix[3], [0, 0, 0, 1], atol=1e-9):
        raise OmnistereoError(f"the pose's last row is {matrix[3].tolist()}, expected 0 0 0 1: no rigid transform")
    return Pose(matrix[:3, :3], matrix[:3, 3])


# What people call the same thing in OpenCV files.
_OPENCV_NAMES = {
    "K": ("K", "camera_matrix", "cameraMatrix"),
    "D": ("D", "dist_coeffs", "distCoeffs", "distortion_coefficients"),
    "R": ("R", "rvec"),
    "T": ("T", "t", "tvec"),
    "size": ("image_size", "imageSize", "resolution"),
}
_OPENCV_KEYS = {name: ours for ours, names in _OPENCV_NAMES.items() for name in names}


def looks_like_opencv(data: dict[str, Any]) -> bool:
    """Return whether a parsed YAML file holds camera matrices under one of the names that users give them."""
    return bool(_opencv_cameras(data))


def read_opencv(data: dict[str, Any], path: Path, max_fov_deg: float | None, unit: str | None) -> Rig:
    """Read OpenCV fisheye calibrations: K, D (4 numbers), image size, R and T of each camera.

    OpenCV fixes no names for a rig, so two layouts are read. Either one mapping per camera, at the top or
    under `cameras`, in order: K | camera_matrix | cameraMatrix; D | dist_coeffs | distCoeffs |
    distortion_coefficients; image_size | imageSize | resolution ([width, height]) or image_width and
    image_height (here, or at the top for all); R (3 × 3) or rvec, with T | t | tvec. Or the same names at
    the top with the camera's number behind, as K1 D1 K2 D2 R2 T2, where a pair may say R, T for the second
    camera, as `cv2.fisheye.stereoCalibrate` returns them. R, T are OpenCV's: X_cam = R X_rig + T. The first
    camera may go without: it is the rig frame then.
    """
    cams = _opencv_cameras(data)
    T_cam_rig = []
    for n, (name, cam) in enumerate(cams.items()):
        with naming(f"camera {name}"):
            T_cam_rig.append(_opencv_pose(cam, first=n == 0))
    T_rig_cam = [pose.inverse() for pose in T_cam_rig]
    scale = metres_per_unit(unit, np.stack([pose.t for pose in T_rig_cam]))
    cameras = []
    for name, cam in cams.items():
        with naming(f"camera {name}"):
            parameters, image_size = _opencv_lens(cam), _opencv_size(cam, data)
            cameras.append(fitted_camera(f"{path}, camera {name}", "kb4", parameters, image_size, max_fov_deg))
    return Rig(cameras, [Pose(pose.R, pose.t * scale) for pose in T_rig_cam])


def _opencv_cameras(data: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return each camera's entries under our names, in the file's order."""
    nested = data.get("cameras", data)
    nested = dict(enumerate(nested, 1)) if isinstance(nested, list) else nested
    found = {str(name): _renamed(cam) for name, cam in nested.items()} if isinstance(nested, dict) else {}
    found = {name: cam for name, cam in found.items() if "K" in cam}
    if found:
        return found
    for key, value in data.items():
        match = re.fullmatch(r"(\w*?[A-Za-z])_?(\d+)", str(key))
        if match and match[1] in _OPENCV_KEYS:
            found.setdefault(match[2], {})[_OPENCV_KEYS[match[1]]] = value
    found = {name: found[name] for name in sorted(found, key=int) if "K" in found[name]}
    if len(found) == 2:
        second = found[list(found)[1]]
        second.update({key: value for key, value in _renamed(data).items() if key in "RT" and key not in second})
    return found


def _renamed(cam: Any) -> dict[str, Any]:
    cam = cam if isinstance(cam, dict) else {}
    return {_OPENCV_KEYS.get(str(key), str(key)): value for key, value in cam.items()}


def _opencv_pose(cam: dict[str, Any], first: bool) -> Pose:
    if first and "R" not in cam and "T" not in cam:
        return Pose.identity()
    R = numbers(entry(cam, "R"), "R")
    if R.size not in (3, 9):
        raise OmnistereoError(f"R must be a 3 × 3 matrix or an axis-angle of 3 numbers, found {R.size}")
    R = R.reshape(3, 3) if R.size == 9 else rotation_from_axis_angle(R)
    return Pose(R, numbers(entry(cam, "T"), "T", 3))


def _opencv_lens(cam: dict[str, Any]) -> dict[str, float]:
    K = numbers(entry(cam, "K"), "K", 9)
    D = numbers(entry(cam, "D"), "D (k1 … k4 of OpenCV's fisheye model; a pinhole model will not do)", 4)
    if not np.allclose(K[[1, 3, 6, 7, 8]], [0, 0, 0, 0, 1], atol=1e-9):
        raise OmnistereoError(f"K must be fx 0 cx, 0 fy cy, 0 0 1, found {K.tolist()}")
    names = ("fx", "cx", "fy", "cy", "k1", "k2", "k3", "k4")
    return dict(zip(names, [*K[[0, 2, 4, 5]].tolist(), *D.tolist()], strict=True))


def _opencv_size(cam: dict[str, Any], data: dict[str, Any]) -> tuple[int, ...]:
    values = _renamed(data) | cam  # a camera's own size comes before the common one
    if "size" in values:
        return whole_numbers(values["size"], "image_size", 2)
    return whole_numbers([entry(values, "image_width"), entry(values, "image_height")], "image_size", 2)
