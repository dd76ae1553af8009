"""Rigs for other programs: their fisheye model fitted to ours, the residual said.

What Kalibr calls pinhole-equidistant, OpenCV fisheye and COLMAP OPENCV_FISHEYE is one model (Kannala and Brandt
2006 with four coefficients): r(θ) = f (θ + k1 θ³ + k2 θ⁵ + k3 θ⁷ + k4 θ⁹). It has no room for the parts d and e of
our affine map. OpenCV's own functions stop at 90° from the axis, whatever the file says.
"""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import atomic_write, make_folder
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.rig_files.camera_models import kannala_brandt

_RINGS, _AZIMUTHS = 180, 24
_FOLLOWS_PX = 1.0  # more than that is no rounding but another lens


def fit_kannala_brandt(camera: OcamCamera) -> tuple[dict[str, float], float]:
    """Fit OpenCV's fisheye model to a camera by linear least squares.

    Returns
    -------
    parameters : dict
        fx, fy, cx, cy in pixels, k1 … k4, as `lenses.kannala_brandt` takes them.
    residual : float
        Largest distance in pixels between the two models over the field of view.

    Raises
    ------
    OmnistereoError
        If the fit is not a lens: a field of view far beyond what four coefficients follow.
    """
    theta, azimuth = np.meshgrid(
        np.radians(np.linspace(0.25, camera.max_fov_deg / 2, _RINGS)), np.arange(_AZIMUTHS) * 2 * np.pi / _AZIMUTHS
    )
    rays = np.stack([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)], axis=-1)
    uv = camera.project(rays, exact=True)[0]
    c, _, _ = camera.affine
    offset = (uv - np.array(camera.center)) / [1.0, c]
    radius = offset[..., 0] * np.cos(azimuth) + offset[..., 1] * np.sin(azimuth)
    basis = theta.ravel()[:, None] ** np.arange(1, 10, 2)
    scale = np.abs(basis).max(axis=0)
    f, *rest = np.linalg.lstsq(basis / scale, radius.ravel(), rcond=None)[0] / scale
    if not f > 0:
        raise OmnistereoError(f"no Kannala-Brandt camera follows this lens over {camera.max_fov_deg:.0f}°")
    k = {f"k{i}": float(value / f) for i, value in enumerate(rest, start=1)}
    parameters = {"fx": float(f), "fy": float(f * c), "cx": camera.center[0], "cy": camera.center[1], **k}
    fitted, _ = kannala_brandt(rays, **parameters)
    return parameters, float(np.linalg.norm(fitted - uv, axis=-1).max())


def write_for_others(rig: Rig, folder: str | Path) -> list[float]:
    """Write a rig as kalibr.yaml, opencv.yaml, colmap_cameras.txt and colmap_rig_config.json into a folder.

    Returns
    -------
    list of float
        Each camera's residual in pixels; a few tenths are usual for lenses beyond 180°. A warning says where it is
        more than a pixel: that lens is not one that their model can follow.
    """
    folder = make_folder(folder)
    fits = [fit_kannala_brandt(camera) for camera in rig.cameras]
    parameters = [fit[0] for fit in fits]
    far_off = [f"camera {i} {residual:.1f} px" for i, (_, residual) in enumerate(fits, 1) if residual > _FOLLOWS_PX]
    if far_off:
        warnings.warn(
            f"the lens model of Kalibr, OpenCV and COLMAP does not follow {', '.join(far_off)} at worst: "
            f"what is written to {folder} is that far off there; keep to config.yaml where you can",
            stacklevel=2,
        )
    for name, text in {
        "kalibr.yaml": _kalibr(rig, parameters),
        "opencv.yaml": _opencv(rig, parameters),
        "colmap_cameras.txt": _colmap_cameras(rig, parameters),
        "colmap_rig_config.json": _colmap_rig(rig),
    }.items():
        with atomic_write(folder / name) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return [fit[1] for fit in fits]


def _kalibr(rig: Rig, parameters: list[dict[str, float]]) -> str:
    """Kalibr's camchain: each camera's pose against the one before."""
    lines = []
    for i, (camera, p) in enumerate(zip(rig.cameras, parameters, strict=True)):
        lines += [
            f"cam{i}:",
            "  camera_model: pinhole",
            f"  intrinsics: {[p['fx'], p['fy'], p['cx'], p['cy']]}",
            "  distortion_model: equidistant",
            f"  distortion_coeffs: {[p[f'k{n}'] for n in (1, 2, 3, 4)]}",
            f"  resolution: {list(camera.image_size)}",
            f"  rostopic: /cam{i}/image_raw",
        ]
        if i > 0:
            T = rig.T_rig_cam[i].inverse() @ rig.T_rig_cam[i - 1]
            rows = [*np.column_stack([T.R, T.t]).tolist(), [0.0, 0.0, 0.0, 1.0]]
            lines += ["  T_cn_cnm1:", *(f"  - {row}" for row in rows)]
    return "\n".join(lines) + "\n"


def _opencv(rig: Rig, parameters: list[dict[str, float]]) -> str:
    """K, D, size, R, T of each camera; X_cam = R X_rig + T, the rig in the frame of camera 1, metres."""
    lines = ["cameras:"]
    for i, (camera, p) in enumerate(zip(rig.cameras, parameters, strict=True)):
        T = rig.T_rig_cam[i].inverse() @ rig.T_rig_cam[0]
        lines += [
            f"  cam{i + 1}:",
            f"    K: {[[p['fx'], 0.0, p['cx']], [0.0, p['fy'], p['cy']], [0.0, 0.0, 1.0]]}",
            f"    D: {[p[f'k{n}'] for n in (1, 2, 3, 4)]}",
            f"    image_size: {list(camera.image_size)}",
            f"    R: {T.R.tolist()}",
            f"    T: {T.t.tolist()}",
        ]
    return "\n".join(lines) + "\n"


def _colmap_cameras(rig: Rig, parameters: list[dict[str, float]]) -> str:
    """COLMAP's cameras.txt; its pixel (0.5, 0.5) is the middle of the top-left one."""
    lines = ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"]
    for i, (camera, p) in enumerate(zip(rig.cameras, parameters, strict=True), start=1):
        values = [p["fx"], p["fy"], p["cx"] + 0.5, p["cy"] + 0.5, *(p[f"k{n}"] for n in (1, 2, 3, 4))]
        lines.append(f"{i} OPENCV_FISHEYE {camera.image_size[0]} {camera.image_size[1]} {' '.join(map(repr, values))}")
    return "\n".join(lines) + "\n"


def _colmap_rig(rig: Rig) -> str:
    cameras = []
    for i, pose in enumerate(rig.T_rig_cam):
        T = pose.inverse() @ rig.T_rig_cam[0]
        entry: dict[str, object] = {"image_prefix": f"cam{i + 1}/"}
        entry |= (
            {"ref_sensor": True}
            if i == 0
            else {
                "cam_from_rig_rotation": _quaternion(T),
                "cam_from_rig_translation": T.t.tolist(),
            }
        )
        cameras.append(entry)
    return json.dumps([{"cameras": cameras}], indent=1) + "\n"


def _quaternion(pose: Pose) -> list[float]:
    """Return (w, x, y, z)."""
    r = pose.as_vector()[:3]
    angle = np.linalg.norm(r)
    axis = r / angle if angle > 0 else r
    return [float(np.cos(angle / 2)), *(np.sin(angle / 2) * axis).tolist()]
