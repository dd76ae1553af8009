"""Rigs of reconstructions: rig_config.json and text models of COLMAP, transforms.json of nerfstudio
and Instant NGP.

The centre of the top-left pixel is (0.5, 0.5). COLMAP's quaternions are w x y z, its poses rig →
camera or world → camera. A transforms.json has one frame for each camera, camera → world, with the
axes of OpenGL: y up, z back.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from omnistereo_lib.errors import OmnistereoError, error_context
from omnistereo_lib.files import path_within
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose, quaternion_pose
from omnistereo_lib.parse import (
    RigFile,
    Section,
    numbered_lines,
    parse_floats,
    parse_size,
    warn_if_different,
)
from omnistereo_lib.pictures import read_gray, read_image
from omnistereo_rigs.formats.camera_models import FISHEYE, PINHOLE, RADTAN
from omnistereo_rigs.formats.fit import fit_camera

_SIMPLE = ("f", "cx", "cy")
# camera model → ours, and its parameters in the order of COLMAP
_MODELS = {
    "SIMPLE_PINHOLE": ("pinhole", _SIMPLE),
    "PINHOLE": ("pinhole", PINHOLE),
    "SIMPLE_RADIAL": ("pinhole", (*_SIMPLE, "k1")),
    "RADIAL": ("pinhole", (*_SIMPLE, "k1", "k2")),
    "OPENCV": ("pinhole", (*PINHOLE, *RADTAN[:4])),
    "FULL_OPENCV": ("pinhole", (*PINHOLE, *RADTAN)),
    "SIMPLE_RADIAL_FISHEYE": ("kb4", (*_SIMPLE, "k1")),
    "RADIAL_FISHEYE": ("kb4", (*_SIMPLE, "k1", "k2")),
    "OPENCV_FISHEYE": ("kb4", (*PINHOLE, *FISHEYE)),
    "FOV": ("fov", (*PINHOLE, "w")),
}
_IMAGES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp")
# Keys of transforms.json: of images, of the scene, and of the focal length in another form.
_NOT_OF_A_CAMERA = (
    *("file_path", "depth_file_path", "colmap_im_id", "sharpness"),
    *("train_filenames", "val_filenames", "test_filenames", "ply_file_path"),
    *(
        "aabb_scale",
        "scale",
        "offset",
        "applied_transform",
        "applied_scale",
        "orientation_override",
    ),
    *("camera_angle_x", "camera_angle_y"),
)
_OPENGL = np.diag([1.0, -1.0, -1.0])  # the camera axes of OpenGL in those of OpenCV


def read_colmap_rig(data: Section, path: Path, max_fov_deg: float | None) -> RigFile:
    """Read COLMAP rig: rig_config.json with the models of its cameras, or with cameras.txt beside
    it.

    Without a cameras.txt, sizes are those of the images below image_prefix, in the folder or in its
    folder images.
    """
    cameras, T_rig_cam, cams = [], [], [*data.sections("cameras").values()]
    file = path.with_name(path.name.replace("rig_config.json", "cameras.txt"))
    listed = [*_read_cameras(file).values()] if file.suffix == ".txt" and file.exists() else []
    if listed and len(listed) != len(cams):
        raise OmnistereoError(
            f"{file.name} has {len(listed)} cameras, the rig has {len(cams)}. Delete the wrong one"
        )
    for n, cam in enumerate(cams):
        with error_context(f"camera {cam.name}"):
            prefix = str(cam.require("image_prefix"))
            if listed:
                name, values, size = listed[n]
                stated = (
                    cam.floats("camera_params")
                    if cam.get("camera_params") is not None
                    else np.array(values)
                )
                if cam.get("camera_model_name", default=name) != name or not np.array_equal(
                    stated, values
                ):
                    raise OmnistereoError(
                        f"camera_params differ from {file.name}. Delete the wrong ones"
                    )
            else:
                name, values = (
                    str(cam.require("camera_model_name")),
                    cam.floats("camera_params").tolist(),
                )
                size = _size_of_images(path, prefix)
            cameras.append(_camera(f"{path}, camera {cam.name}", name, values, size, max_fov_deg))
            pose = Pose.identity()
            if not cam.get("ref_sensor"):
                q, t = (
                    cam.floats("cam_from_rig_rotation", count=4),
                    cam.floats("cam_from_rig_translation", count=3),
                )
                pose = quaternion_pose(q, t)
            T_rig_cam.append(pose.inverse())
    return RigFile(cameras, T_rig_cam)


def _size_of_images(path: Path, prefix: str) -> tuple[int, int]:
    folders = [path_within(path.parent, each, path) for each in (prefix, f"images/{prefix}")]
    images = [
        file
        for folder in folders
        for file in sorted(folder.glob("*"))
        if file.suffix.lower() in _IMAGES
    ]
    if not images:
        raise OmnistereoError(
            "a rig_config.json of COLMAP does not state the size of the images, and there are none"
            f" in {prefix}. Put the images, or cameras.txt (`colmap model_converter` writes it),"
            " beside the file"
        )
    height, width = read_image(images[0]).shape[:2]
    return width, height


def read_colmap_model(folder: Path, max_fov_deg: float | None) -> RigFile:
    """Read COLMAP model: a folder with `cameras.txt` and `images.txt`.

    The rig frame is the first camera. The images of one moment have one file name, in a folder for
    each camera. The poses are those of the first moment that all cameras have; a UserWarning says
    that another one differs.
    """
    listed, frames = _read_cameras(folder / "cameras.txt"), dict[str, dict[str, Pose]]()
    file = folder / "images.txt"
    lines = iter(numbered_lines(file, empty=True))
    for number, words in lines:
        if words:
            next(lines, None)  # its points
            with error_context(f"{file}: line {number}"):
                if len(words) < 10 or words[8] not in listed:
                    raise OmnistereoError(
                        f"found {words[:10]}; expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"
                    )
                pose = parse_floats(words[1:8], "QW QX QY QZ TX TY TZ", 7)
                frames.setdefault(Path(words[9]).name, {})[words[8]] = quaternion_pose(
                    pose[:4], pose[4:]
                )
    # one image of each camera
    if len(frames) == len(listed) and all(len(frame) == 1 for frame in frames.values()):
        frames = {"": {camera: pose for frame in frames.values() for camera, pose in frame.items()}}
    first = next(iter(listed), "")
    rigs = {
        name: [frame[first] @ frame[camera].inverse() for camera in listed]
        for name, frame in frames.items()
        if len(frame) == len(listed)
    }
    if not rigs:
        raise OmnistereoError(
            f"{file}: no file name is that of an image of each of the {len(listed)} cameras"
        )
    name, T_rig_cam = next(iter(rigs.items()))
    # the scale of a reconstruction is arbitrary
    size = max(float(np.linalg.norm(pose.t)) for pose in T_rig_cam) or 1.0
    for other, poses in rigs.items():
        if warn_if_different(T_rig_cam, poses, name, other, file, size):
            break
    cameras = [_camera(f"{folder}, camera {each}", *listed[each], max_fov_deg) for each in listed]
    return RigFile(cameras, T_rig_cam)


def _read_cameras(file: Path) -> dict[str, tuple[str, list[float], tuple[int, int]]]:
    found = {}
    for number, words in numbered_lines(file):
        with error_context(f"{file}: line {number}"):
            if len(words) < 5:
                raise OmnistereoError(
                    f"found {words}; expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]"
                )
            found[words[0]] = (
                words[1],
                parse_floats(words[4:], "PARAMS").tolist(),
                parse_size(words[2:4], "the size"),
            )
    return found


def _camera(
    source: str,
    name: str,
    values: Sequence[float],
    size: tuple[int, int],
    max_fov_deg: float | None,
) -> OcamCamera:
    if name not in _MODELS or len(values) != len(_MODELS[name][1]):
        known = ", ".join(f"{known} ({' '.join(names)})" for known, (_, names) in _MODELS.items())
        raise OmnistereoError(
            f"camera model {name} with {len(values)} parameters is not read; expected one of"
            f" {known}"
        )
    model, names = _MODELS[name]
    parameters = dict.fromkeys(FISHEYE if model == "kb4" else (), 0.0) | dict(
        zip(names, values, strict=True)
    )
    if "f" in parameters:
        parameters["fx"] = parameters["fy"] = parameters.pop("f")
    return fit_camera(source, model, parameters | _center(parameters), size, max_fov_deg)


def _center(parameters: dict[str, float]) -> dict[str, float]:
    """Return the principal point counted from the centre of the first pixel."""
    return {name: parameters[name] - 0.5 for name in ("cx", "cy")}


def read_transforms(data: Section, path: Path, max_fov_deg: float | None) -> RigFile:
    """Read nerfstudio: transforms.json, each frame a camera: OPENCV, OPENCV_FISHEYE or PINHOLE, and
    masks.
    """
    cameras, T_rig_cam = [], []
    shared = {key: value for key, value in data.values.items() if key != "frames"}
    data.ignore(*shared)
    for n, frame in data.sections("frames").items():
        with error_context(f"frame {n}"):
            frame.values = shared | frame.values
            frame.ignore(*_NOT_OF_A_CAMERA)
            pose = frame.pose("transform_matrix")
            T_rig_cam.append(Pose(pose.R @ _OPENGL, pose.t))
            size = frame.size("w", "h")
            mask = None
            if frame.get("mask_path") is not None:
                mask = (
                    read_gray(path_within(path.parent, frame.get("mask_path"), path), size) >= 128
                )
            model, parameters = _of_frame(frame, size[0])
            cameras.append(
                fit_camera(f"{path}, frame {n}", model, parameters, size, max_fov_deg, mask)
            )
    return RigFile(cameras, T_rig_cam)


def _of_frame(frame: Section, width: int) -> tuple[str, dict[str, float]]:
    """Return the model of a frame of transforms.json and its parameters."""
    name = frame.word("camera_model").upper()
    if not name:
        name = "OPENCV_FISHEYE" if frame.get("is_fisheye") else "OPENCV"
        if not frame.get("is_fisheye"):
            frame.note("no camera_model is stated: read as OPENCV, a pinhole")
    if name not in ("OPENCV", "OPENCV_FISHEYE", "PINHOLE", "SIMPLE_PINHOLE"):
        raise OmnistereoError(
            f"camera_model {name} is not read; expected OPENCV, OPENCV_FISHEYE or PINHOLE"
        )
    if frame.get("fl_x") is None and frame.get("camera_angle_x") is not None:
        focal = width / 2 / float(np.tan(frame.number("camera_angle_x") / 2))
    else:
        focal = frame.number("fl_x")
    parameters = {"fx": focal, "fy": frame.number("fl_y", default=focal)}
    parameters |= _center({side: frame.number(side) for side in ("cx", "cy")})
    fisheye = name == "OPENCV_FISHEYE"
    coefficients = {
        key: frame.number(key, default=0.0) for key in (FISHEYE if fisheye else RADTAN[:5])
    }
    return "kb4" if fisheye else "pinhole", parameters | coefficients
