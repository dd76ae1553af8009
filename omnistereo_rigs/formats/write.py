"""Rigs for other programs: Kalibr, OpenCV and COLMAP, all with the Kannala-Brandt model of four
coefficients.
"""

import json
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import make_folder, to_yaml, write_text
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.field_of_view import AZIMUTHS, ring_rays
from omnistereo_lib.geometry.pose import quaternion_from_rotation
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.rig_file import save_rig, write_ocam_folder
from omnistereo_rigs.formats.camera_models import kannala_brandt

_MAX_ERROR = 1.0  # px; beyond it a warning


def export_rig(rig: Rig, folder: str | Path) -> list[float]:
    """Write a rig as kalibr.yaml, opencv.yaml, colmap_cameras.txt and colmap_rig_config.json into a
    folder.

    All four use the Kannala-Brandt model with four coefficients: pinhole-equidistant in Kalibr,
    fisheye in OpenCV (whose functions stop at 90° from the axis), OPENCV_FISHEYE in COLMAP.

    Returns the residual of each camera in pixels, a few tenths for most lenses beyond 180°;
    UserWarning above 1 px.
    """
    folder = make_folder(folder)
    fits = [fit_kannala_brandt(camera) for camera in rig.cameras]
    parameters, residuals = [fit[0] for fit in fits], [fit[1] for fit in fits]
    large = [f"camera {i} {px:.1f} px" for i, px in enumerate(residuals, 1) if px > _MAX_ERROR]
    if large:
        warnings.warn(
            f"the camera model of Kalibr, OpenCV and COLMAP does not follow {', '.join(large)} at "
            f"worst: the files in {folder} have these errors. Use config.yaml where you can",
            stacklevel=2,
        )
    for name, text in {
        "kalibr.yaml": kalibr_text(rig, parameters),
        "opencv.yaml": opencv_text(rig, parameters),
        "colmap_cameras.txt": colmap_cameras_text(rig, parameters),
        "colmap_rig_config.json": colmap_rig_text(rig),
    }.items():
        write_text(folder / name, text)
    return residuals


def fit_kannala_brandt(camera: OcamCamera) -> tuple[dict[str, float], float]:
    """Fit the Kannala-Brandt model, which has no d and e of the affine map, to an OCam camera:
    linear least squares.

    Returns the keyword arguments of `kannala_brandt`, and the largest distance in pixels between
    the two models over the field of view. OmnistereoError if that is too wide for four
    coefficients.
    """
    theta = np.radians(np.linspace(0.25, camera.max_fov_deg / 2, 180))
    rays = ring_rays(theta)
    uv = camera.project(rays, use_direct_poly=True)[0]
    c = camera.affine[0]
    offset = (uv - np.array(camera.center)) / [1.0, c]
    radius = (offset[..., 0] * np.cos(AZIMUTHS) + offset[..., 1] * np.sin(AZIMUTHS)).mean(1)
    powers = theta[:, None] ** np.arange(1, 10, 2)
    scale = powers.max(axis=0)
    f, *rest = (np.linalg.lstsq(powers / scale, radius, rcond=None)[0] / scale).tolist()
    if not f > 0:
        raise OmnistereoError(
            f"no Kannala-Brandt camera follows this lens over {camera.max_fov_deg:.0f}°"
        )
    k = {f"k{i}": value / f for i, value in enumerate(rest, start=1)}
    parameters = {"fx": f, "fy": f * c, "cx": camera.center[0], "cy": camera.center[1], **k}
    fitted, _ = kannala_brandt(rays, **parameters)
    return parameters, float(np.linalg.norm(fitted - uv, axis=-1).max())


def kalibr_text(rig: Rig, parameters: Sequence[dict[str, float]]) -> str:
    """Return a camchain with pinhole-equidistant cameras; each pose is relative to the camera
    before.
    """
    chain: dict[str, dict[str, Any]] = {}
    for i, (camera, p) in enumerate(zip(rig.cameras, parameters, strict=True)):
        chain[f"cam{i}"] = {
            "camera_model": "pinhole",
            "intrinsics": [p[name] for name in ("fx", "fy", "cx", "cy")],
            "distortion_model": "equidistant",
            "distortion_coeffs": [p[name] for name in ("k1", "k2", "k3", "k4")],
            "resolution": list(camera.image_size),
            "rostopic": f"/cam{i}/image_raw",
        }
        if i > 0:
            T = rig.T_rig_cam[i].inverse() @ rig.T_rig_cam[i - 1]
            chain[f"cam{i}"]["T_cn_cnm1"] = [
                *np.column_stack([T.R, T.t]).tolist(),
                [0.0, 0.0, 0.0, 1.0],
            ]
    return to_yaml(chain)


def opencv_text(rig: Rig, parameters: Sequence[dict[str, float]]) -> str:
    """Return one mapping per camera, the rig in the frame of camera 1, metres."""
    cameras = {}
    for i, (camera, p) in enumerate(zip(rig.cameras, parameters, strict=True)):
        T = rig.T_rig_cam[i].inverse() @ rig.T_rig_cam[0]
        cameras[f"cam{i + 1}"] = {
            "K": [[p["fx"], 0.0, p["cx"]], [0.0, p["fy"], p["cy"]], [0.0, 0.0, 1.0]],
            "D": [p[f"k{n}"] for n in (1, 2, 3, 4)],
            "distortion_model": "fisheye",
            "image_size": list(camera.image_size),
            "R": T.R.tolist(),
            "T": T.t.tolist(),
        }
    return to_yaml({"cameras": cameras})


def colmap_cameras_text(rig: Rig, parameters: Sequence[dict[str, float]]) -> str:
    """Return cameras.txt; in COLMAP the centre of the top-left pixel is (0.5, 0.5)."""
    lines = ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"]
    for i, (camera, p) in enumerate(zip(rig.cameras, parameters, strict=True), start=1):
        values = [
            p["fx"],
            p["fy"],
            p["cx"] + 0.5,
            p["cy"] + 0.5,
            *(p[f"k{n}"] for n in (1, 2, 3, 4)),
        ]
        lines.append(
            f"{i} OPENCV_FISHEYE {camera.image_size[0]} {camera.image_size[1]} "
            f"{' '.join(map(repr, values))}"
        )
    return "\n".join(lines) + "\n"


def colmap_rig_text(rig: Rig) -> str:
    """Return rig_config.json, camera 1 the reference; poses are rig → camera."""
    cameras: list[dict[str, Any]] = [{"image_prefix": "cam1/", "ref_sensor": True}]
    for i, pose in enumerate(rig.T_rig_cam[1:], start=2):
        T = pose.inverse() @ rig.T_rig_cam[0]
        quaternion = np.roll(quaternion_from_rotation(T.R), 1)  # w x y z
        rotation = {
            "cam_from_rig_rotation": quaternion.tolist(),
            "cam_from_rig_translation": T.t.tolist(),
        }
        cameras.append({"image_prefix": f"cam{i}/"} | rotation)
    return json.dumps([{"cameras": cameras}], indent=1) + "\n"


def write_rig(rig: Rig, out: Path) -> list[str]:
    """Write a rig into a folder in all formats, and say how well they hold it; return the names of
    the files.
    """
    save_rig(rig, out / "config.yaml")
    write_ocam_folder(rig, out)
    residual = max(export_rig(rig, out))
    print(
        f"kalibr.yaml, opencv.yaml and colmap_*: their camera model follows ours to {residual:.2f} "
        "px at worst"
    )
    return ["config.yaml", "ocam*.txt", "poses.txt", "kalibr.yaml", "opencv.yaml", "colmap_*"]
