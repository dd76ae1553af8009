"""The cameras of reconstructions: COLMAP's rig_config.json and text models, and one moment of many.

The centre of the top-left pixel is (0.5, 0.5). Quaternions are w x y z, poses rig → camera or world
→ camera.
"""

import re
from collections.abc import Mapping, Sequence
from itertools import zip_longest
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numpy as np

from omnistereo_lib.errors import OmnistereoError, error_context
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.parse import (
    Section,
    check_count,
    numbered_lines,
    parse_floats,
    warn_if_different,
)
from omnistereo_rigs.formats.camera_models import FISHEYE, FISHEYE624, PINHOLE, RADTAN
from omnistereo_rigs.formats.table import Parameters, Way, parse_pose

_SIMPLE = ("f", "cx", "cy")
_MODELS = {
    "simple_pinhole": ("pinhole", _SIMPLE),
    "pinhole": ("pinhole", PINHOLE),
    "simple_radial": ("pinhole", (*_SIMPLE, "k1")),
    "radial": ("pinhole", (*_SIMPLE, "k1", "k2")),
    "opencv": ("pinhole", (*PINHOLE, *RADTAN[:4])),
    "full_opencv": ("pinhole", (*PINHOLE, *RADTAN)),
    "simple_fisheye": ("kb4", _SIMPLE),
    "fisheye": ("kb4", PINHOLE),
    "simple_radial_fisheye": ("kb4", (*_SIMPLE, "k1")),
    "radial_fisheye": ("kb4", (*_SIMPLE, "k1", "k2")),
    "opencv_fisheye": ("kb4", (*PINHOLE, *FISHEYE)),
    "rad_tan_thin_prism_fisheye": ("fisheye624", (*PINHOLE, *FISHEYE624)),
    "eucm": ("eucm", (*PINHOLE, "alpha", "beta")),
    "fov": ("fov", (*PINHOLE, "w")),
}
#: camera model → ours, and its parameters in the order of COLMAP
MODELS: Mapping[str, tuple[str, Parameters]] = {
    name: (model, {"camera_params": names}) for name, (model, names) in _MODELS.items()
}
_KEYS = "cam_from_rig_rotation cam_from_rig_translation"
POSE = Way(_KEYS, is_quaternion=True, to_camera=True)
_IDENTITY = {"cam_from_rig_rotation": [1, 0, 0, 0], "cam_from_rig_translation": [0, 0, 0]}
# Names of cameras, where all images lie in one folder: longer numbers are moments.
_CAMERA = re.compile(r"cam(era)?[-_]?[0-9]{1,2}|[0-9]", re.IGNORECASE)

Camera = dict[str, Any]  # camera_model_name, camera_params, width, height


def config_cameras(data: Section, path: Path) -> list[Section]:
    """Return the cameras of a rig_config.json, with the sizes from the cameras.txt beside it."""
    cams = [*data.sections("cameras").values()]
    file = path.with_name("cameras.txt")
    if not file.exists():
        raise OmnistereoError(
            f"{file} is missing; expected it beside the rig, which states no size of images. "
            "`colmap model_converter` writes it"
        )
    listed = [*_read_cameras(file).values()]
    for cam in cams:
        with error_context(f"camera {cam.name}"):
            cam.ignore("image_prefix")
            name, values = cam.require("camera_model_name"), cam.floats("camera_params").tolist()
            stated = {"camera_model_name": name, "camera_params": values}
            same = [lens for lens in listed if stated.items() <= lens.items()]
            if len({(lens["width"], lens["height"]) for lens in same}) != 1:
                raise OmnistereoError(
                    f"its camera_params are not in {file.name}, or there in several sizes. Correct "
                    "one"
                )
            cam.values |= same[0] | (_IDENTITY if cam.get("ref_sensor") else {})
    return cams


def model_cameras(data: Section, folder: Path) -> list[Section]:
    """Return the cameras of a folder with cameras.txt and images.txt; rigs.txt where there is one.

    Without a rig in rigs.txt, they are those of `find_moment`, and may share their intrinsics.
    """
    listed, file = _read_cameras(folder / "cameras.txt"), folder / "images.txt"
    rig = _read_rigs(folder / "rigs.txt", listed)
    if not rig:
        names, ids, poses = _read_images(file, listed)
        T_world_cam = [parse_pose(Section(pose), POSE).inverse() for pose in poses]
        moment = find_moment(names, T_world_cam, file)
        for camera, images in moment.of_camera.items():
            if len({ids[n] for n in images}) > 1:
                raise OmnistereoError(
                    f"{file}: the images of {camera} have several cameras. Put each into its own "
                    "folder"
                )
        shown = moment.images
        return [data.add(names[n], listed[ids[n]] | poses[n], f"camera {names[n]}") for n in shown]
    return [data.add(f"camera {each}", listed[each] | rig[each]) for each in listed if each in rig]


def _read_images(
    file: Path, listed: Mapping[str, Camera]
) -> tuple[list[str], list[str], list[Camera]]:
    """Return name, camera and pose, world → camera, of each image."""
    names, ids, poses = [], [], []
    lines = iter(numbered_lines(file, empty=True))
    for number, words in lines:
        if words:
            points = next(lines, (0, []))[1]
            if len(words) < 10 or words[8] not in listed or not all(map(_is_number, points)):
                raise OmnistereoError(
                    f"{file}: line {number}: found {words[:10]}; expected IMAGE_ID QW QX QY QZ TX "
                    "TY TZ CAMERA_ID NAME, and a line of its points, which may be empty"
                )
            names.append(" ".join(words[9:]))
            ids.append(words[8])
            poses.append(_pose(words[1:8]))
    return names, ids, poses


def _is_number(word: str) -> bool:
    return re.fullmatch(r"[-+0-9.eE]+", word) is not None


def _pose(words: Sequence[str]) -> Camera:
    return dict(zip(_IDENTITY, (words[:4], words[4:]), strict=True))


def _read_rigs(file: Path, listed: Mapping[str, Camera]) -> dict[str, Camera]:
    """Return the pose, rig → camera, of each camera of the one rig in rigs.txt, if there is one.

    A line is RIG_ID NUM_SENSORS REF_TYPE REF_ID, then for each other sensor TYPE ID HAS_POSE QW QX
    QY QZ TX TY TZ.
    """
    rigs = []
    for number, words in numbered_lines(file) if file.exists() else []:
        has_reference, rest = words[2:3] == ["CAMERA"] and len(words) > 3, words[4:]
        rig: dict[str, Camera] = {words[3]: _IDENTITY} if has_reference else {}
        while rest:
            count = 10 if rest[2:3] == ["1"] else 3
            if rest[0] == "CAMERA":
                rig[" ".join(rest[1:2])] = _pose(rest[3:10]) if count == 10 else {}
            rest = rest[count:]
        wrong = [each for each in rig if each not in listed or not rig[each]]
        if wrong or not rig:
            raise OmnistereoError(
                f"{file}: line {number}: camera {wrong} is not in cameras.txt, or has no pose in "
                "the rig. Calibrate the rig in COLMAP, and export the model again"
            )
        rigs.append(rig)
    whole = [rig for rig in rigs if len(rig) > 1]
    if len(whole) > 1:
        raise OmnistereoError(f"{file} has {len(whole)} rigs of several cameras; expected one")
    return whole[0] if whole else {}


def _read_cameras(file: Path) -> dict[str, Camera]:
    found = {}
    for number, words in numbered_lines(file):
        with error_context(f"{file}: line {number}"):
            if len(words) < 5:
                raise OmnistereoError(f"found {words}; expected CAMERA_ID MODEL WIDTH HEIGHT …")
            lens = {"camera_model_name": words[1], "width": words[2], "height": words[3]}
            found[words[0]] = lens | {"camera_params": parse_floats(words[4:], "PARAMS").tolist()}
    return found


class Moment(NamedTuple):
    """The images of one moment, one of each camera."""

    images: Sequence[int]  #: their places in the list of all images
    of_camera: Mapping[str, Sequence[int]]  #: all images of each camera


def find_moment(names: Sequence[str], T_world_cam: Sequence[Pose], path: Path) -> Moment:
    """Return the first moment that all cameras have; a UserWarning says that another differs.

    The images of a camera lie in a folder of its own, those of a moment have one name. In one
    folder each image is a camera. An `OmnistereoError` asks for such folders where names or folders
    may be moments.
    """
    if not names:
        raise OmnistereoError(f"{path}: there is no image. Check that the file is complete")
    paths = [PurePosixPath(name.replace("\\", "/")) for name in names]
    folders = {each.parent for each in paths}
    if len(folders) > 1:
        keys = [(str(each.parent), each.stem) for each in paths]
        # day1/cam1 and day2/cam2 differ in more than the camera.
        levels = zip_longest(*(folder.parts for folder in folders))
        is_unclear = [len({*level}) > 1 for level in levels].count(True) > 1
    else:
        keys = [(each.stem, "") for each in paths]
        starts = {each.stem.rstrip("0123456789") for each in paths}
        is_named = all(_CAMERA.fullmatch(each.stem) for each in paths)
        is_unclear = len(starts) < len(names) and not is_named
    if is_unclear:
        raise OmnistereoError(
            f"{len(names)} images, {names[0]}, {names[-1]}, …: moments of one camera, or cameras? "
            "Put the images of each camera into one folder (cam1/0001.png)"
        )
    table: dict[str, dict[str, int]] = {}
    for n, (camera, moment) in enumerate(keys):
        table.setdefault(moment, {})[camera] = n
    # By their numbers, where they have some: files are listed as a reconstruction found them.
    cameras = sorted(dict.fromkeys(camera for camera, _ in keys), key=_number)
    check_count(len(cameras))
    whole = [moment for moment in table.values() if len(moment) == len(cameras)]
    if not whole:
        raise OmnistereoError(
            f"{path}: no file name is that of an image of each of the {len(cameras)} cameras"
        )
    first, *others = ([T_world_cam[moment[camera]] for camera in cameras] for moment in whole)
    relative = [first[0].inverse() @ pose for pose in first]
    size = max(float(np.linalg.norm(pose.t)) for pose in relative) or 1.0  # the scale is arbitrary
    of_first = names[whole[0][cameras[0]]]
    for images, poses in zip(whole[1:], others, strict=True):
        then = [poses[0].inverse() @ pose for pose in poses]
        if warn_if_different(relative, then, of_first, names[images[cameras[0]]], path, size):
            break
    of_camera = {name: [n for n, key in enumerate(keys) if key[0] == name] for name in cameras}
    return Moment([whole[0][camera] for camera in cameras], of_camera)


def _number(name: str) -> tuple[int, ...]:
    found = re.findall("[0-9]+", name)
    return (int(found[-1][:18]),) if found else ()
