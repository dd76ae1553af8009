"""Rigs for other programs, as Kannala-Brandt lenses, and rigs for images of another size."""

import json
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from omnistereo_lib.errors import OmnistereoError, check_number
from omnistereo_lib.files import make_folder, to_yaml, write_text
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.field_of_view import AZIMUTHS, ring_rays
from omnistereo_lib.geometry.pose import Floats, Pose, quaternion_from_rotation
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.pictures import write_image
from omnistereo_lib.rig_file import save_rig, write_ocam_folder
from omnistereo_rigs.formats.camera_models import FISHEYE, PINHOLE, make_camera_model
from omnistereo_rigs.formats.table import OPENGL

_MAX_ERROR = 1.0  # px; beyond it a warning
_STRETCHED = 0.01  # of the ratio of the sides: resizing rounds them, cropping changes them more
# COLMAP's rays are right to 89.5°, and of another direction from 90° on.
MASKED_DEG = 85.0

Parameters = Sequence[Mapping[str, float]]  # of the model "kb4", for each camera


def convert(rig: Rig, program: str, path: Path) -> list[str]:
    """Write a rig for a program, one of `PROGRAMS`, into a file; for COLMAP, OCam a folder.

    Returns what the user must know. UserWarning if the lenses differ by more than a pixel.
    """
    if program not in PROGRAMS:
        PROGRAM_FOLDERS[program](rig, path)
        return []
    parameters, residuals = fit_lenses(rig)
    PROGRAMS[program](rig, parameters, path)
    return [
        f"its camera model follows the lenses to {max(residuals):.2f} px at worst",
        *beyond_sentences(rig, program == "colmap"),
    ]


def export_rig(rig: Rig, folder: str | Path) -> list[float]:
    """Write a rig as kalibr.yaml, opencv.yaml, transforms.json and a folder colmap into a folder.

    All use the Kannala-Brandt model with four coefficients: pinhole-equidistant in Kalibr, fisheye
    in OpenCV, OPENCV_FISHEYE in COLMAP and nerfstudio; none of them can use what lies beyond 90°
    from the axis.

    Returns the residual of each camera in pixels, a few tenths for most lenses beyond 180°;
    UserWarning above 1 px.
    """
    folder = make_folder(folder)
    parameters, residuals = fit_lenses(rig)
    for name, write in _FILES.items():
        write(rig, parameters, folder / name)
    return residuals


def fit_lenses(rig: Rig) -> tuple[Parameters, list[float]]:
    """Return the Kannala-Brandt parameters of all lenses, and their residuals in pixels."""
    fits = [_fit_kannala_brandt(camera) for camera in rig.cameras]
    large = [f"camera {i} {px:.1f} px" for i, (_, px) in enumerate(fits, 1) if px > _MAX_ERROR]
    if large:
        warnings.warn(
            "the camera model of Kalibr, OpenCV, COLMAP and nerfstudio does not follow "
            f"{', '.join(large)} at worst: their files have these errors. Use config.yaml where "
            "you can",
            stacklevel=3,
        )
    return [p for p, _ in fits], [px for _, px in fits]


def _fit_kannala_brandt(camera: OcamCamera) -> tuple[dict[str, float], float]:
    """Fit the Kannala-Brandt model to an OCam camera by linear least squares.

    Returns its parameters, and the largest distance in pixels between the two models over the
    field of view, infinite where the fit is not one to one. OmnistereoError if the field is too
    wide for four coefficients.
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
        raise OmnistereoError(f"no Kannala-Brandt lens follows this over {camera.max_fov_deg:.0f}°")
    k = {f"k{i}": value / f for i, value in enumerate(rest, start=1)}
    parameters = {"fx": f, "fy": f * c, "cx": camera.center[0], "cy": camera.center[1], **k}
    fitted, valid = make_camera_model("kb4", parameters)(rays)
    apart = np.where(valid, np.linalg.norm(fitted - uv, axis=-1), np.inf)
    return parameters, float(apart.max())


def _relative(rig: Rig) -> list[Pose]:
    """Return camera 1 → each camera."""
    return [pose.inverse() @ rig.T_rig_cam[0] for pose in rig.T_rig_cam]


def write_kalibr(rig: Rig, parameters: Parameters, path: Path) -> None:
    """Write a camchain of pinhole-equidistant cameras, each pose relative to the one before."""
    chain: dict[str, dict[str, Any]] = {}
    for i, (camera, p) in enumerate(zip(rig.cameras, parameters, strict=True)):
        chain[f"cam{i}"] = {
            "camera_model": "pinhole",
            "intrinsics": [p[name] for name in PINHOLE],
            "distortion_model": "equidistant",
            "distortion_coeffs": [p[name] for name in FISHEYE],
            "resolution": list(camera.image_size),
            "rostopic": f"/cam{i}/image_raw",
        }
        if i > 0:
            T = rig.T_rig_cam[i].inverse() @ rig.T_rig_cam[i - 1]
            chain[f"cam{i}"]["T_cn_cnm1"] = _matrix(T.R, T.t)
    write_text(path, to_yaml(chain))


def _matrix(R: Floats, t: Floats) -> list[list[float]]:
    return [*np.column_stack([R, t]).tolist(), [0.0, 0.0, 0.0, 1.0]]


def write_opencv(rig: Rig, parameters: Parameters, path: Path) -> None:
    """Write a mapping per camera by cv2.FileStorage, the rig in the frame of camera 1, metres."""
    if path.suffix not in (".yaml", ".yml", ".json", ".xml"):
        raise OmnistereoError(f"{path}: OpenCV writes .yaml, .json or .xml. Give such a name")
    mode = cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY
    storage = cv2.FileStorage(path.suffix, mode)
    cameras = zip(rig.cameras, parameters, _relative(rig), strict=True)
    for i, (camera, p, T) in enumerate(cameras, 1):
        storage.startWriteStruct(f"cam{i}", cv2.FILE_NODE_MAP)
        width, height = camera.image_size
        for name, value in {"image_width": width, "image_height": height}.items():
            storage.write(name, value)
        storage.write("distortion_model", "fisheye")
        K = np.array([[p["fx"], 0.0, p["cx"]], [0.0, p["fy"], p["cy"]], [0.0, 0.0, 1.0]])
        D = np.array([[p[name] for name in FISHEYE]])
        for name, matrix in {"K": K, "D": D, "R": T.R, "T": T.t.reshape(3, 1)}.items():
            storage.write(name, np.ascontiguousarray(matrix))
        storage.endWriteStruct()
    write_text(path, storage.releaseAndGetString())


def write_transforms(rig: Rig, parameters: Parameters, path: Path) -> None:
    """Write transforms.json of nerfstudio: a frame for each camera → rig, with axes of OpenGL."""
    frames = []
    cameras = zip(rig.cameras, parameters, rig.T_rig_cam, strict=True)
    for i, (camera, p, pose) in enumerate(cameras, 1):
        width, height = camera.image_size
        lens = {"fl_x": p["fx"], "fl_y": p["fy"], "cx": p["cx"] + 0.5, "cy": p["cy"] + 0.5}
        lens |= {name: p[name] for name in FISHEYE}
        matrix = {"transform_matrix": _matrix(pose.R @ OPENGL, pose.t)}
        frames.append({"file_path": f"cam{i}.png", "w": width, "h": height} | lens | matrix)
    text = json.dumps({"camera_model": "OPENCV_FISHEYE", "frames": frames}, indent=1)
    write_text(path, text + "\n")


def write_colmap(rig: Rig, parameters: Parameters, folder: Path) -> None:
    """Write a folder that COLMAP opens: an empty model with cameras, rig_config.json and masks.

    The centre of the top-left pixel is (0.5, 0.5); poses are rig → camera, camera 1 the reference.
    masks/cam1.png is black where COLMAP has no right ray, from 85° on.
    """
    folder = make_folder(folder)
    lines, cameras = ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"], []
    found = zip(rig.cameras, parameters, _relative(rig), strict=True)
    for i, (camera, p, T) in enumerate(found, 1):
        values = [p["fx"], p["fy"], p["cx"] + 0.5, p["cy"] + 0.5, *(p[name] for name in FISHEYE)]
        width, height = camera.image_size
        lines.append(f"{i} OPENCV_FISHEYE {width} {height} {' '.join(map(repr, values))}")
        q = np.roll(quaternion_from_rotation(T.R), 1).tolist()  # w x y z
        pose = {"cam_from_rig_rotation": q, "cam_from_rig_translation": T.t.tolist()}
        model = {"camera_model_name": "OPENCV_FISHEYE", "camera_params": values}
        where = {"ref_sensor": True} if i == 1 else pose
        cameras.append({"image_prefix": f"cam{i}/"} | model | where)
        mask = (_angles(camera) <= MASKED_DEG).astype(np.uint8) * 255
        write_image(make_folder(folder / "masks") / f"cam{i}.png", mask)
    write_text(folder / "cameras.txt", "\n".join(lines) + "\n")
    write_text(folder / "images.txt", "# no image yet\n")
    write_text(folder / "points3D.txt", "# no point yet\n")
    write_text(folder / "rig_config.json", json.dumps([{"cameras": cameras}], indent=1) + "\n")


def _angles(camera: OcamCamera) -> Floats:
    """Return the angle of each pixel from the axis, degrees, (height, width); NaN: none."""
    rays, valid = camera.unproject(np.stack(np.meshgrid(*map(np.arange, camera.image_size)), -1))
    return np.where(valid, np.degrees(np.arccos(np.clip(rays[..., 2], -1, 1))), np.nan)


def beyond_sentences(rig: Rig, with_masks: bool = True) -> list[str]:
    """Return how much of the images other programs cannot use, and what COLMAP's masks do."""
    angles = np.concatenate([_angles(camera).ravel() for camera in rig.cameras])
    share = float((angles > 90).sum() / np.isfinite(angles).sum())
    if share == 0:
        return []
    said = f"{100 * share:.0f} % of the pixels lie beyond 90° from the axis: OpenCV, COLMAP and "
    said += "nerfstudio give them false rays without a word"
    masks = "--ImageReader.camera_mask_path colmap/masks/cam1.png"
    do = f". Extract the features of cam1/ with {masks}, and so on"
    return [said + do * with_masks]


def resized(rig: Rig, size: tuple[int, int]) -> Rig:
    """Return the rig for images that were resized as a whole to `size`, width and height in pixels.

    Pixel centres are at whole numbers, as cv2.resize has it: u becomes (u + ½) s - ½.
    OmnistereoError for sides of another ratio, which are those of a cropped image.
    """
    width, height = (int(check_number(n, "the size", 2, 100_000, whole=True)) for n in size)
    return replace(rig, cameras=[_resized(camera, (width, height)) for camera in rig.cameras])


def _resized(camera: OcamCamera, size: tuple[int, int]) -> OcamCamera:
    was, (sx, sy) = camera.image_size, np.array(size) / camera.image_size
    if abs(sx / sy - 1) > _STRETCHED:
        raise OmnistereoError(
            f"{was[0]} × {was[1]} and {size[0]} × {size[1]} px have other ratios of their sides; "
            "expected images resized as a whole. A cropped image has another centre: calibrate it, "
            "or crop first"
        )
    (c, d, e), (u, v), mask = camera.affine, camera.center, camera.mask
    if mask is not None:
        mask = cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST_EXACT) > 0
    # Radii are scaled by sx, which rows, by sy, undo in the affine map.
    return replace(
        camera,
        poly=camera.poly * sx ** (1.0 - np.arange(len(camera.poly))),
        inv_poly=camera.inv_poly * sx,
        center=((u + 0.5) * sx - 0.5, (v + 0.5) * sy - 0.5),
        affine=(c * sy / sx, d * sy / sx, e),
        image_size=size,
        mask=mask,
    )


PROGRAMS: dict[str, Callable[[Rig, Parameters, Path], None]] = {
    "kalibr": write_kalibr,
    "opencv": write_opencv,
    "nerfstudio": write_transforms,
    "colmap": write_colmap,
}
_FILES = dict(
    zip(("kalibr.yaml", "opencv.yaml", "transforms.json", "colmap"), PROGRAMS.values(), strict=True)
)
PROGRAM_FOLDERS: dict[str, Callable[[Rig, Path], None]] = {
    "omnimvs": save_rig,
    "ocam": lambda rig, folder: write_ocam_folder(rig, make_folder(folder)),
}
