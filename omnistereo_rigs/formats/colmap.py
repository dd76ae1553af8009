"""Rigs of COLMAP: rig_config.json, and text models, with rigs.txt or with cameras that moments
share.

The centre of the top-left pixel is (0.5, 0.5). Quaternions are w x y z, poses rig → camera or world
→ camera.
"""

from pathlib import Path

import numpy as np

from omnistereo_lib.errors import OmnistereoError, error_context
from omnistereo_lib.files import path_within
from omnistereo_lib.geometry.pose import Pose, quaternion_pose
from omnistereo_lib.parse import Section, numbered_lines, parse_floats, parse_size
from omnistereo_lib.pictures import read_image
from omnistereo_rigs.formats.camera_models import FISHEYE, FISHEYE624, PINHOLE, RADTAN
from omnistereo_rigs.formats.fit import OPENCV_DEG, Lens
from omnistereo_rigs.formats.table import Found, find_moment

_SIMPLE = ("f", "cx", "cy")
# camera model → ours, and its parameters in the order of COLMAP
MODELS = {
    "SIMPLE_PINHOLE": ("pinhole", _SIMPLE),
    "PINHOLE": ("pinhole", PINHOLE),
    "SIMPLE_RADIAL": ("pinhole", (*_SIMPLE, "k1")),
    "RADIAL": ("pinhole", (*_SIMPLE, "k1", "k2")),
    "OPENCV": ("pinhole", (*PINHOLE, *RADTAN[:4])),
    "FULL_OPENCV": ("pinhole", (*PINHOLE, *RADTAN)),
    "SIMPLE_FISHEYE": ("kb4", _SIMPLE),
    "FISHEYE": ("kb4", PINHOLE),
    "SIMPLE_RADIAL_FISHEYE": ("kb4", (*_SIMPLE, "k1")),
    "RADIAL_FISHEYE": ("kb4", (*_SIMPLE, "k1", "k2")),
    "OPENCV_FISHEYE": ("kb4", (*PINHOLE, *FISHEYE)),
    "RAD_TAN_THIN_PRISM_FISHEYE": ("fisheye624", (*PINHOLE, *FISHEYE624)),
    "EUCM": ("eucm", (*PINHOLE, "alpha", "beta")),
    "FOV": ("fov", (*PINHOLE, "w")),
}
_IMAGES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp")
Camera = tuple[str, list[float], tuple[int, int]]  # model, parameters, size


def read_rig_config(data: Section, path: Path) -> Found:
    """Read COLMAP rig: rig_config.json with the models of its cameras, or with cameras.txt beside
    it.

    Without a cameras.txt, sizes are those of the images below image_prefix, in the folder or in its
    folder images.
    """
    lenses, T_rig_cam, cams = [], [], [*data.sections("cameras").values()]
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
            lenses.append(_lens(f"{path}, camera {cam.name}", (name, values, size)))
            pose = Pose.identity()
            if not cam.get("ref_sensor"):
                q, t = (
                    cam.floats("cam_from_rig_rotation", count=4),
                    cam.floats("cam_from_rig_translation", count=3),
                )
                pose = quaternion_pose(q, t)
            T_rig_cam.append(pose.inverse())
    return Found(lenses, T_rig_cam)


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
            "a rig_config.json of COLMAP does not state the size of the images, and there are "
            f"none in {prefix}. Put the images, or cameras.txt (`colmap model_converter` writes "
            "it), beside the file"
        )
    height, width = read_image(images[0]).shape[:2]
    return width, height


def read_model(folder: Path) -> Found:
    """Read COLMAP model: a folder with `cameras.txt` and `images.txt`; `rigs.txt` where there is
    one.

    Without a rig in rigs.txt, the images of a camera lie in a folder of its own or begin alike, and
    those of one moment have one file name or number, see `find_moment`: cameras of the rig may
    share one of cameras.txt. The rig frame is the first camera. The poses are those of the first
    moment that all cameras have; a UserWarning says that another one differs.
    """
    listed, file = _read_cameras(folder / "cameras.txt"), folder / "images.txt"
    if rig := _read_rigs(folder / "rigs.txt", listed):
        ids = [each for each in listed if each in rig]
        T_rig_cam = [rig[each] for each in ids]
    else:
        names, of_image, T_world_cam = _read_images(file, listed)
        moment = find_moment(names, T_world_cam, file)
        for camera, images in moment.of_camera.items():
            if len({of_image[n] for n in images}) > 1:
                raise OmnistereoError(
                    f"{file}: the images of {camera} have several cameras. Put each into its own "
                    "folder"
                )
        ids, T_rig_cam = [of_image[n] for n in moment.images], [*moment.T_rig_cam]
    return Found([_lens(f"{folder}, camera {each}", listed[each]) for each in ids], T_rig_cam)


def _read_images(file: Path, listed: dict[str, Camera]) -> tuple[list[str], list[str], list[Pose]]:
    """Return name, camera and camera → world of each image."""
    names, of_image, poses = [], [], []
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
                names.append(" ".join(words[9:]))
                of_image.append(words[8])
                poses.append(quaternion_pose(pose[:4], pose[4:]).inverse())
    return names, of_image, poses


def _read_rigs(file: Path, listed: dict[str, Camera]) -> dict[str, Pose]:
    """Return camera → rig of each camera of the one rig in rigs.txt; nothing where each camera is a
    rig of its own.

    A line is RIG_ID NUM_SENSORS REF_TYPE REF_ID, then for each other sensor TYPE ID HAS_POSE QW QX
    QY QZ TX TY TZ.
    """
    rigs = []
    for number, words in numbered_lines(file) if file.exists() else []:
        with error_context(f"{file}: line {number}"):
            if len(words) < 4 or words[2] != "CAMERA":
                raise OmnistereoError(
                    f"found {words[:4]}; expected RIG_ID NUM_SENSORS CAMERA REF_SENSOR_ID"
                )
            rig, rest = {words[3]: Pose.identity()}, words[4:]
            while rest:
                kind, sensor, has_pose = (*rest[:3], "", "")[:3]
                count = 10 if has_pose == "1" else 3
                if kind == "CAMERA":
                    if count == 3:
                        raise OmnistereoError(
                            f"camera {sensor} has no pose in the rig. Calibrate the rig in COLMAP"
                        )
                    pose = parse_floats(rest[3:10], "QW QX QY QZ TX TY TZ", 7)
                    rig[sensor] = quaternion_pose(pose[:4], pose[4:]).inverse()
                rest = rest[count:]
            if unknown := next((sensor for sensor in rig if sensor not in listed), None):
                raise OmnistereoError(
                    f"camera {unknown} is not in cameras.txt. Export the model again"
                )
            rigs.append(rig)
    whole = [rig for rig in rigs if len(rig) > 1]
    if len(whole) > 1:
        raise OmnistereoError(
            f"{file} has {len(whole)} rigs of several cameras; expected one. Delete the others"
        )
    return whole[0] if whole else {}


def _read_cameras(file: Path) -> dict[str, Camera]:
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


def _lens(source: str, camera: Camera) -> Lens:
    name, values, size = camera
    if name not in MODELS or len(values) != len(MODELS[name][1]):
        known = ", ".join(f"{known} ({' '.join(names)})" for known, (_, names) in MODELS.items())
        raise OmnistereoError(
            f"camera model {name} with {len(values)} parameters is not read; expected one of "
            f"{known}"
        )
    model, names = MODELS[name]
    parameters = dict.fromkeys(FISHEYE if model == "kb4" else (), 0.0) | dict(
        zip(names, values, strict=True)
    )
    if "f" in parameters:
        parameters["fx"] = parameters["fy"] = parameters.pop("f")
    for side in ("cx", "cy"):
        parameters[side] -= 0.5
    # COLMAP drops what lies beyond 90° from the axis, whatever the model.
    return Lens(source, model, parameters, size, None, OPENCV_DEG)
