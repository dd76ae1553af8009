"""The table of simple dialects, a row each, and the interpreter that reads them.

A row says what recognises a file, where its cameras are, which of our models a word means and in
which order its numbers stand, where size and pose are, in which direction the pose is meant, and
the unit. To add a dialect, write a row, an example in book/own_cameras.md and a test.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.consumer_images import NO_DEPTH
from omnistereo_lib.errors import OmnistereoError, error_context
from omnistereo_lib.files import path_within, read_data
from omnistereo_lib.geometry.pose import Pose, quaternion_pose, rotation_from_axis_angle
from omnistereo_lib.parse import (
    Section,
    check_count,
    is_irrelevant,
    parse_axis_angle,
    parse_floats,
    parse_size,
    warn_if_different,
)
from omnistereo_lib.pictures import read_gray
from omnistereo_lib.rig_file import MAX_BYTES
from omnistereo_rigs.formats.camera_models import (
    FISHEYE,
    FISHEYE624,
    MAX_PINHOLE_DEG,
    PINHOLE,
    RADTAN,
)
from omnistereo_rigs.formats.fit import OPENCV_DEG, Lens

UNSTATED = "`--unit`"
RADTAN4 = RADTAN[:4]
K9 = ("fx", "skew", "cx", "0", "fy", "cy", "0", "0", "1")  # a camera matrix, row by row
ALL = ("*",)  # every number of a mapping, by its name
_OPENGL = np.diag([1.0, -1.0, -1.0])  # the camera axes of OpenGL (y up, z back) in those of OpenCV
_FLU = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # camera axes in x forward, y left, z up
# Names of single frames of one camera, which say nothing of the camera.
_OF_A_MOMENT = re.compile(
    r"(frame|ima?ge?|pic|photo|dscn?|gopr|g[xh])[-_]*\d+|\d{3,}", re.IGNORECASE
)

# Between the rigs of two moments, the latter of its size: more than a reconstruction is wrong.
_OTHER_DEG, _OTHER_PLACE = 5.0, 0.2

Names = Sequence[str] | str  # of numbers in their order, or of one number
Parameters = Mapping[str, Names] | Callable[[Section], Mapping[str, Any]]  # by their paths


class Way(NamedTuple):
    """One way in which the poses of all cameras may be stated."""

    keys: str  #: of each camera, separated by a blank
    form: str = "matrix"  #: or opengl, named (qw … pz), scalar_first, axis_angle, depthai, flu
    to_camera: bool = False  #: from rig, or parent, to camera
    parent: str = (
        ""  #: "previous" camera, or the key of the number of the camera to which the pose leads
    )


@dataclass(frozen=True)
class Dialect:
    """A row: how the files of one program are read."""

    name: str
    what: str
    recognises: Callable[[dict[str, Any]], bool]
    cameras: Callable[[Section, Path], list[Section]]
    models: Mapping[str, tuple[str, Parameters]]  #: word → our model, its parameters by their paths
    model: str = ""  #: keys of the word, joined by " + "; a default behind "="
    size: str = "resolution"  #: the key of two numbers, or two keys
    poses: Sequence[
        Way
    ] = ()  #: those that all cameras state; the first is used, others are compared
    unit: str = "metres"  #: `UNSTATED`, or "" of a lens by itself
    measured: Mapping[str, float] | None = None  #: our model → degrees, see `Lens.measured_deg`
    origin: float | None = (
        0.0  #: of the centre of the first pixel; None: cx, cy count from the middle
    )
    aliases: Mapping[str, str] | None = None  #: words for words
    first_is_rig: bool = (
        False  #: whether the first camera is the rig frame, whatever the poses are to
    )
    settings: bool = False  #: whether its top level holds settings of a program, too
    mask: Callable[[Section, Path, int, tuple[int, int]], NDArray[np.bool_] | None] | None = None


class Found(NamedTuple):
    """What a reader finds: lenses, and poses in the unit of the file."""

    lenses: Sequence[Lens]
    T_rig_cam: Sequence[Pose] = ()  #: camera → rig
    clock_offsets_s: Sequence[float] | None = None  #: see `RigReading`
    scale: float = 1.0  #: metres of the unit of the file


def interpret(row: Dialect, data: Section, path: Path) -> Found:
    """Return what a file of a dialect holds, by its row."""
    cams = row.cameras(data, path)
    if not cams:
        raise OmnistereoError(f"found no camera of {row.name}. Check that the file is complete")
    check_count(len(cams))
    lenses = []
    for n, cam in enumerate(cams):
        with error_context(cam.name or path):
            lenses.append(_lens(row, cam, path, n))
    poses = _poses(row, cams, path) if len(cams) > 1 else []
    stated = [cam.number("timeshift_cam_imu", default=np.nan) for cam in cams]
    offsets = stated if np.isfinite(stated).all() else None
    return Found(lenses, poses, offsets, 0.01 if row.unit == "centimetres" else 1.0)


def _lens(row: Dialect, cam: Section, path: Path, n: int) -> Lens:
    keys, _, default = row.model.partition("=")
    words = [cam.at(key)[0].word(cam.at(key)[1]) for key in keys.split()]
    if len(words) == 2 and not words[1]:  # as in pinhole-equi
        words[0], _, words[1] = words[0].partition("-")
    word = " + ".join((row.aliases or {}).get(each, each) or default for each in words)
    if keys and word not in row.models:
        names = " + ".join(key.split(".")[-1] for key in keys.split())
        known = ", ".join(row.models)
        advice = NO_DEPTH if word in _STITCHED else "Recalibrate with one of them"
        shown, known = (word.upper(), known.upper()) if row.model == "model_type" else (word, known)
        raise OmnistereoError(f"{names} is {shown}; expected one of {known}. {advice}")
    model, spec = row.models[word]
    sides = [cam.at(key) for key in row.size.split()]
    if len(sides) == 1:
        size = parse_size(sides[0][0].require(*sides[0][1].split("|")), sides[0][1])
    else:
        values = [inner.number(key) for inner, key in sides]
        size = parse_size(values, " and ".join(key for _, key in sides))
    parameters = dict(spec(cam) if callable(spec) else _numbers(cam, spec))
    if "f" in parameters and not model.startswith("metashape"):
        parameters["fx"] = parameters["fy"] = parameters.pop("f")
    for axis, side in zip(("cx", "cy"), size, strict=True):
        if row.origin is None and model != "ocam":
            parameters[axis] = parameters.get(axis, 0.0) + side / 2 - 0.5
        elif row.origin and axis in parameters:
            parameters[axis] -= row.origin
    mask = row.mask(cam, path, n, size) if row.mask else None
    source = f"{path}, {cam.name}" if cam.name else str(path)
    return Lens(source, model, parameters, size, mask, (row.measured or {}).get(model))


def _numbers(cam: Section, spec: Mapping[str, Names]) -> dict[str, float]:
    """Return the numbers of a lens by our names, from their places in a camera; those marked "?"
    may be missing.
    """
    numbers: dict[str, float] = {}
    for place, names in spec.items():
        with error_context(place.rpartition(".")[0]):
            section, key = cam.at(place.rstrip("?"))
            keys = key.split("|")
            if place.endswith("?") and section.get(*keys) is None:
                continue
            if names == ALL:
                numbers |= section.section(key).numbers()
            elif isinstance(names, str):
                numbers[names] = section.number(*keys)
            else:
                stated = section.get(*keys, default=None if names else [])
                values = parse_floats(
                    section.require(*keys) if stated is None else stated, section.key(*keys)
                )
                numbers |= _named(section, section.key(*keys), values.tolist(), names)
    return numbers


def _named(
    section: Section, key: str, values: list[float], names: Sequence[str]
) -> dict[str, float]:
    found = (
        section.coefficients(key, values, names)
        if "0" not in names
        else dict(zip(names, values, strict=False))
    )
    if "0" in names:  # a matrix
        if len(values) != len(names):
            raise OmnistereoError(f"{key} must be {len(names)} numbers, found {len(values)}")
        constants = [value for value, name in zip(values, names, strict=True) if name in "01"]
        if not np.allclose(constants, [0, 0, 0, 1], atol=1e-9):
            raise OmnistereoError(f"{key} is {values}; expected fx skew cx, 0 fy cy, 0 0 1")
    return {name: value for name, value in found.items() if name not in ("0", "1")}


def _poses(row: Dialect, cams: Sequence[Section], path: Path) -> list[Pose]:
    """Return camera → rig by the first way that all cameras have; a UserWarning compares the
    others.
    """
    found: dict[str, list[Pose]] = {}
    for way in row.poses:
        first = 1 if way.parent == "previous" else 0
        keys, has = way.keys.split(), [_stated(cam, way) for cam in cams]
        if not all(has[first:]):
            continue
        poses = []
        for n, cam in enumerate(cams):
            with error_context(cam.name or path):
                poses.append(Pose.identity() if n < first else _parse_pose(cam, keys, way.form))
        if way.to_camera:
            poses = [pose.inverse() for pose in poses]
        if way.parent:
            poses = _chained(cams, poses, way.parent)
        if row.first_is_rig:
            poses = [poses[0].inverse() @ pose for pose in poses]
        found[keys[0]] = poses
    if not found:
        missing = next(
            (cam for cam in cams[1:] if not any(_stated(cam, w) for w in row.poses)), cams[-1]
        )
        expected = ", ".join(way.keys.split()[0] for way in row.poses)
        raise OmnistereoError(
            f"{missing.name}: no pose; found {sorted(missing.values)}; expected {expected} in "
            "every camera"
        )
    (name, used), *others = found.items()
    for other, poses in others:
        relative = [used[0] @ poses[0].inverse() @ pose for pose in poses]
        if warn_if_different(used, relative, name, other, path):
            break
    return used


def _stated(cam: Section, way: Way) -> bool:
    section, key = cam.at(way.keys.split()[0])
    return section.get(key) is not None


def _parse_pose(cam: Section, keys: Sequence[str], form: str) -> Pose:
    (section, key), *rest = [cam.at(each) for each in keys]
    if form in ("matrix", "opengl"):
        pose = section.pose(key)
        return Pose(pose.R @ _OPENGL, pose.t) if form == "opengl" else pose
    if form == "named":  # qw … pz in one mapping
        inner = section.section(key)
        numbers = [inner.number(name) for name in ("qw", "qx", "qy", "qz", "px", "py", "pz")]
        return quaternion_pose(np.array(numbers[:4]), np.array(numbers[4:]))
    where, place = rest[0]
    if form == "axis_angle":
        R = rotation_from_axis_angle(parse_axis_angle(section.require(key), key))
        return Pose(R, where.floats(place, count=3))
    if form == "scalar_first":  # [w, [x, y, z]] or [w, x, y, z]
        value = section.require(key)
        is_split = isinstance(value, list) and len(value) == 2 and isinstance(value[1], list)
        q = parse_floats([value[0], *value[1]] if is_split else value, key, 4)
        return quaternion_pose(q, where.floats(place, count=3))
    if form == "depthai":
        axes = where.section(place)
        R = section.rotation(key, section.floats(key, count=9))
        return Pose(R, np.array([axes.number(axis) for axis in "xyz"]))
    roll, pitch, yaw = np.radians(section.floats(key, count=3))  # flu: R = Rz Ry Rx, degrees
    Rx, Ry, Rz = (
        rotation_from_axis_angle(angle * np.eye(3)[k]) for k, angle in enumerate((roll, pitch, yaw))
    )
    return Pose(Rz @ Ry @ Rx @ _FLU, where.floats(place, count=3))


def _chained(cams: Sequence[Section], poses: Sequence[Pose], parent: str) -> list[Pose]:
    """Return camera → root of poses camera → parent: the previous camera, or the one with the
    number that a key has.
    """
    if parent == "previous":
        chain = [poses[0]]
        for pose in poses[1:]:
            chain.append(chain[-1] @ pose)
        return chain
    numbers = [int(cam.number("socket")) for cam in cams]
    parents = [int(cam.at(parent)[0].number(cam.at(parent)[1])) for cam in cams]

    def to_root(n: int, seen: tuple[int, ...] = ()) -> tuple[int, Pose]:
        if parents[n] not in numbers:
            return n, Pose.identity()
        if n in seen:
            raise OmnistereoError(f"{cams[n].name}: its poses lead in a circle. Check {parent}")
        root, pose = to_root(numbers.index(parents[n]), (*seen, n))
        return root, pose @ poses[n]

    chained = [to_root(n) for n in range(len(cams))]
    if len({root for root, _ in chained}) > 1:
        raise OmnistereoError(f"no pose connects all cameras. Check {parent} of each")
    return [pose for _, pose in chained]


class Moment(NamedTuple):
    """The images of one moment, one of each camera."""

    images: Sequence[int]  #: their places in the list of all images
    T_rig_cam: Sequence[Pose]  #: camera → first camera
    of_camera: Mapping[str, Sequence[int]]  #: all images of each camera


def find_moment(names: Sequence[str], T_world_cam: Sequence[Pose], path: Path) -> Moment:
    """Return the first moment that all cameras have; a UserWarning says that another differs.

    The images of a camera lie in a folder of its own; in one folder, what stands before the number
    at the end of the name is the camera, if the rig is then the same at all moments. One image of
    each camera is one moment. An `OmnistereoError` asks for folders where neither tells cameras
    from moments.
    """
    if not names:
        raise OmnistereoError(f"{path}: there is no image. Check that the file is complete")
    paths = [PurePosixPath(name.replace("\\", "/")) for name in names]
    stems = [path.stem for path in paths]
    alone = _moments([str(n) for n in range(len(names))], [""] * len(names))
    if len({*names}) < len(names):  # one name for all: each is a camera
        table = alone
    elif len({path.parent for path in paths}) > 1:
        table = _moments([str(path.parent) for path in paths], stems)
    else:
        ends = [re.search("[0-9]*$", stem) for stem in stems]
        numbers = [end[0] if end else "" for end in ends]
        prefixes = [stem.removesuffix(end) for stem, end in zip(stems, numbers, strict=True)]
        table = _moments(prefixes, numbers)
        whole = [moment for moment in table.values() if len(moment) == len({*prefixes})]
        if len({*prefixes}) == 1 or len(whole) < 2 or _differ(whole, T_world_cam):
            table = alone
    count = len({camera for moment in table.values() for camera in moment})
    in_one_folder = len({*names}) == len(names) and len({path.parent for path in paths}) == 1
    if in_one_folder and count == len(names) > 1 and all(map(_OF_A_MOMENT.fullmatch, stems)):
        raise OmnistereoError(
            f"{len(names)} images in one folder, {paths[0].name}, {paths[1].name}, …: moments of "
            "one "
            "camera, or cameras? Put the images of each camera into a folder of its own "
            "(cam1/0001.png)"
        )
    whole = [moment for moment in table.values() if len(moment) == count]
    if not whole:
        raise OmnistereoError(
            f"{path}: no file name is that of an image of each of the {count} cameras"
        )
    check_count(count)
    # By their numbers, where they have some: files are listed as a reconstruction found them.
    order = sorted(whole[0], key=_number) if table is not alone else [*whole[0]]
    rigs = [_rig_at(moment, order, T_world_cam) for moment in whole]
    size = max(float(np.linalg.norm(pose.t)) for pose in rigs[0]) or 1.0  # the scale is arbitrary
    of_first, key = names[whole[0][order[0]]], order[0]
    for moment, poses in zip(whole[1:], rigs[1:], strict=True):
        if warn_if_different(rigs[0], poses, of_first, names[moment[key]], path, size):
            break
    of_camera = {
        camera: [moment[camera] for moment in table.values() if camera in moment]
        for camera in order
    }
    return Moment([whole[0][camera] for camera in order], rigs[0], of_camera)


def _number(name: str) -> int:
    found = re.findall("[0-9]+", name)
    return int(found[-1][:18]) if found else 0


def _moments(cameras: Sequence[str], moments: Sequence[str]) -> dict[str, dict[str, int]]:
    """Return the image of each camera at each moment."""
    table: dict[str, dict[str, int]] = {}
    for n, (camera, moment) in enumerate(zip(cameras, moments, strict=True)):
        table.setdefault(moment, {})[camera] = n
    return table


def _rig_at(
    moment: Mapping[str, int], order: Iterable[str], T_world_cam: Sequence[Pose]
) -> list[Pose]:
    poses = [T_world_cam[moment[camera]] for camera in order]
    return [poses[0].inverse() @ pose for pose in poses]


def _differ(whole: Sequence[Mapping[str, int]], T_world_cam: Sequence[Pose]) -> bool:
    """Return whether the rigs of the first two moments differ more than those of one rig."""
    first, second = (_rig_at(moment, whole[0], T_world_cam) for moment in whole[:2])
    size = max(float(np.linalg.norm(pose.t)) for pose in first) or 1.0
    apart = [(a.inverse() @ b).magnitude() for a, b in zip(first, second, strict=True)]
    return any(degrees > _OTHER_DEG or t > _OTHER_PLACE * size for degrees, t in apart)


# Where the cameras are.


def _one(data: Section, path: Path) -> list[Section]:
    return [data]


def _named_cameras(data: Section, path: Path) -> list[Section]:
    """Return the cameras in the order of their numbers, from 0 or 1, else in that of the file; or
    the one.
    """
    if "camera_model" in data.values:
        return [data]
    found = {name: value for name, value in data.values.items() if isinstance(value, Mapping)}
    names = [
        name for name, value in found.items() if name.startswith("cam") or "camera_model" in value
    ]
    check_count(len(names))
    if all(re.fullmatch(r"cam(era)?_?[0-9]{1,4}", name) for name in names):
        prefix = names[0].rstrip("0123456789")
        first = min([1, *(int(re.sub(r"\D", "", name)) for name in names)])
        names = [
            f"{prefix}{n}" for n in range(first, first + len(names))
        ]  # a gap in the chain is an error
    return [data.section(name) for name in names]


def _anipose_cameras(data: Section, path: Path) -> list[Section]:
    cams = {name: value for name, value in data.values.items() if "matrix" in _mapping(value)}
    if any(cam.get("ignore") for cam in cams.values()):
        raise OmnistereoError("a camera says ignore = true. Delete it from the file")
    return [data.section(name) for name in cams]


def _basalt_cameras(data: Section, path: Path) -> list[Section]:
    value = data.section("value0")
    keys = ("T_imu_cam", "intrinsics", "resolution")
    lists = [value.require(key) for key in keys]
    for key, each in zip(keys, lists, strict=True):
        if not isinstance(each, list | dict):
            raise OmnistereoError(f"{key}: found {each!r:.80}; expected keys with values")
    if len({len(each) for each in lists}) > 1:
        counts = ", ".join(f"{len(each)} {key}" for key, each in zip(keys, lists, strict=True))
        raise OmnistereoError(
            f"found {counts}; expected one of each per camera".replace(", 1 res", " and 1 res")
        )
    items = [[*each.values()] if isinstance(each, dict) else each for each in lists]
    cams = []
    for n, (pose, lens, size) in enumerate(zip(*items, strict=True)):
        with error_context(f"intrinsics {n + 1}"):
            found = {"T_imu_cam": pose, "resolution": size} | Section(lens).values
        cams.append(value.add(f"camera {n}", found))
    return cams


def _vins_cameras(data: Section, path: Path) -> list[Section]:
    cams = []
    count = sum(name.startswith("body_T_cam") for name in data.values)
    check_count(count)
    for n in range(count):
        file = path_within(path.parent, data.require(f"cam{n}_calib"), path)
        pose = data.require(f"body_T_cam{n}")
        with error_context(file):
            lens = read_data(file, MAX_BYTES)
            cam = data.add(str(file), {"body_T_cam": pose} | Section(lens).values, f"cam{n}_calib")
            cam.ignore("body_T_cam")
        cams.append(cam)
    return cams


def _frames(data: Section, path: Path) -> list[Section]:
    """Return one frame for each camera of transforms.json, all of one moment."""
    shared = {key: value for key, value in data.values.items() if key != "frames"}
    frames = data.require("frames")
    data.ignore("frames", *shared)
    names = [str(_mapping(frame).get("file_path", "")) for frame in frames]
    cams, poses = [], []
    for n, frame in enumerate(frames, 1):
        with error_context(f"frame {n}"):
            cams.append(Section(shared | Section(frame).values, f"frame {n}"))
            poses.append(_parse_pose(cams[-1], ["transform_matrix"], "opengl"))
    moment = find_moment(names, poses, path)
    for camera, images in moment.of_camera.items():
        lenses = [
            [cams[n].values.get(key) for key in ("w", "h", "fl_x", "cx", "k1")] for n in images
        ]
        if any(lens != lenses[0] for lens in lenses):
            raise OmnistereoError(
                f"the frames of {camera} have several lenses; expected one. Keep those of one "
                "moment"
            )
    found = []
    for n in moment.images:
        cam = data.add(cams[n].name, cams[n].values)
        cam.ignore(*_NOT_OF_A_CAMERA)
        with error_context(cam.name):
            _focal_of_angle(cam)
        found.append(cam)
    return found


def _focal_of_angle(cam: Section) -> None:
    """Write the model that `is_fisheye` states, and the focal length that an angle does: a
    pinhole's.
    """
    name, flag = cam.word("camera_model").upper(), cam.word("is_fisheye")
    is_fisheye = flag in ("true", "1", "yes")
    if not name:
        cam.values["camera_model"] = name = "OPENCV_FISHEYE" if is_fisheye else "OPENCV"
        if not is_fisheye:
            cam.note("no camera_model is stated: read as OPENCV, a pinhole")
    if is_fisheye and "FISHEYE" not in name:
        raise OmnistereoError(f"camera_model is {name} and is_fisheye true. Delete the wrong one")
    if cam.get("fl_x") is None and cam.get("camera_angle_x") is not None:
        angle = cam.number("camera_angle_x")
        if "FISHEYE" in name or not 0 < angle < np.radians(MAX_PINHOLE_DEG):
            raise OmnistereoError(
                f"camera_angle_x = {angle:g} does not state the focal length of a fisheye: f = "
                "width / 2 "
                "/ tan(angle / 2) is a pinhole's. Write fl_x, for an equidistant lens width / angle"
            )
        cam.values["fl_x"] = cam.number("w") / 2 / float(np.tan(angle / 2))
    if cam.get("fl_y") is None:
        cam.values["fl_y"] = cam.values.get("fl_x")


def _drive_works_cameras(data: Section, path: Path) -> list[Section]:
    sensors = data.section("rig").sections("sensors").values()
    cams = [sensor for sensor in sensors if "camera" in str(sensor.get("name", default="camera"))]
    for cam in cams:
        given = [key for key in cam.values if key.startswith("correction")]
        if wrong := [key for key in given if not is_irrelevant("", cam.get(key))]:
            raise OmnistereoError(f"{wrong[0]} is not read. Add it to nominalSensor2Rig_FLU")
    data.note(
        "axes and pixel centres as DriveWorks documents them, not checked with it: sensor → rig by "
        "yaw, pitch, roll in x forward, y left, z up. `omnistereo doctor` with images checks them"
    )
    return cams


def _depthai_cameras(data: Section, path: Path) -> list[Section]:
    cams = []
    for item in data.require("cameraData"):
        if not (isinstance(item, list) and len(item) == 2):
            raise OmnistereoError("cameraData: expected pairs of a socket and a camera")
        cam = data.add(f"socket {item[0]}", {"socket": item[0]} | Section(item[1]).values)
        cam.ignore("lensPosition", "specHfovDeg", "socket")
        if "extrinsics" in cam.values:
            cam.section("extrinsics").ignore("specTranslation")
        cams.append(cam)
    data.ignore(*(key for key in data.values if key != "cameraData"))
    return cams


def _listed(key: str) -> Callable[[Section, Path], list[Section]]:
    return lambda data, path: [*data.sections(key).values()]


# Parameters that are more than numbers in their order.


def _scaramuzza(data: Section) -> dict[str, Any]:
    """Return OCam records; the affine map of camodocal is u = C x + D y + cx, v = E x + y + cy."""
    affine = data.section("affine_parameters")
    C, D, E, u, v = (affine.number(name) for name in ("ac", "ad", "ae", "cx", "cy"))
    poly, inv_poly = (
        _by_number(data.section(f"{name}_parameters")) for name in ("poly", "inv_poly")
    )
    if abs(C) < 1e-3:
        raise OmnistereoError(f"affine_parameters: ac is {C:g}; expected about 1")
    return {
        # In pixels along u: f(r) → C f(r / C).
        "poly": [len(poly), *(a * C ** (1 - k) for k, a in enumerate(poly))],
        "inv_poly": [len(inv_poly), *(C * b for b in inv_poly)],
        "center": [v, u],
        "affine": [1 / C, E / C, D / C],
        "image_size": [data.require("image_height"), data.require("image_width")],
        "linear": True,  # its keys say which coefficient is which
    }


def _by_number(block: Section) -> list[float]:
    """Return p0, p1, … in this order, which writers that sort words do not keep."""
    return [block.number(f"p{k}") for k in range(len(block.values))]


def _f_theta(sensor: Section) -> dict[str, float]:
    lens = sensor.section("properties")
    kind = lens.word("polynomial-type", default="pixeldistance-to-angle")
    if kind not in ("pixeldistance-to-angle", "angle-to-pixeldistance"):
        raise OmnistereoError(f"polynomial-type is {kind}; expected pixeldistance-to-angle")
    values = parse_floats(str(lens.require("polynomial", "bw-poly")).split(), "polynomial")
    if values[0] != 0 or not 2 <= len(values) <= 16:
        raise OmnistereoError(
            f"polynomial is {values.tolist()}; expected 0 and 1 to 15 coefficients"
        )
    affine = {
        name: lens.number(f"linear-{name}", default=one)
        for name, one in (("c", 1.0), ("d", 0.0), ("e", 0.0))
    }
    center = {name: lens.number(name) for name in ("cx", "cy")}
    to_angle = {"to_angle": float(kind.startswith("pixel"))}
    return center | to_angle | affine | {f"p{k}": value for k, value in enumerate(values.tolist())}


def _gyroflow(data: Section) -> dict[str, float]:
    sides = ("horizontal", "vertical")
    stretched = {data.number(f"input_{side}_stretch", default=1) for side in sides} - {0, 1}
    if stretched or data.get("digital_lens"):
        raise OmnistereoError(
            "only profiles with the distortion_model opencv_fisheye, without stretch and "
            f"digital_lens, are read; found {stretched or 'no'} stretch, digital_lens "
            f"{data.get('digital_lens')}. Calibrate the lens"
        )
    data.section("fisheye_params").ignore("radial_distortion_limit")  # the fit finds it
    return _numbers(
        data, {"fisheye_params.camera_matrix": K9, "fisheye_params.distortion_coeffs": FISHEYE}
    )


def _hugin(data: Section) -> dict[str, float]:
    if any(data.number(name, default=0) for name in "gt"):
        raise OmnistereoError(
            "the lens is sheared (g, t), as scans are; expected 0 and 0. Recalibrate"
        )
    if not 1 <= data.number("v") <= 360:
        found = data.number("v")
        raise OmnistereoError(
            f"the field of view v in degrees is {found}; expected a number of 1 to 360"
        )
    return {name: data.number(name, default=0) for name in "abcdevwh"}


# Masks, bright where the image is valid.


def _mask_beside(
    cam: Section, path: Path, n: int, size: tuple[int, int]
) -> NDArray[np.bool_] | None:
    file = path.parent / f"cam{n}" / "mask.png"
    return read_gray(file, size) >= 128 if file.exists() else None


def _mask_named(
    cam: Section, path: Path, n: int, size: tuple[int, int]
) -> NDArray[np.bool_] | None:
    name = cam.get("mask_path")
    return None if name is None else read_gray(path_within(path.parent, name, path), size) >= 128


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def has_list(key: str, data: dict[str, Any], of: str) -> bool:
    """Return whether a key holds a list of mappings, one of which has the key `of`."""
    values = data.get(key)
    return isinstance(values, list) and any(of in _mapping(value) for value in values)


def _is_kalibr(data: dict[str, Any]) -> bool:
    return any(
        {"camera_model", "intrinsics"} <= _mapping(cam).keys() for cam in (data, *data.values())
    )


_STITCHED = ("spherical", "cylindrical", "1", "4")  # projections of panoramas
_DISTORTION = "distortion_coeffs|distortion_coefficients"
_RADTAN_BLOCK = {f"distortion_parameters.{key}": key for key in RADTAN4}
_BY_NAME = {"intrinsics": ALL}
_PROJECTION = "projection_parameters."
_CAMODOCAL: dict[str, tuple[str, Parameters]] = {
    "mei": (
        "omni",
        {"mirror_parameters.xi": "xi"}
        | _RADTAN_BLOCK
        | {
            _PROJECTION + key: name
            for key, name in zip(("gamma1", "gamma2", "u0", "v0"), PINHOLE, strict=True)
        },
    ),
    "kannala_brandt": (
        "kb4",
        {
            _PROJECTION + key: name
            for key, name in zip(
                ("k2", "k3", "k4", "k5", "mu", "mv", "u0", "v0"), (*FISHEYE, *PINHOLE), strict=True
            )
        },
    ),
    "pinhole": ("pinhole", _RADTAN_BLOCK | {_PROJECTION + key: key for key in PINHOLE}),
    "scaramuzza": ("ocam", _scaramuzza),
}
_FL = {"fl_x": "fx", "fl_y": "fy", "cx": "cx", "cy": "cy"}
# Keys of transforms.json: of images, of the scene, and of the focal length in another form.
_NOT_OF_A_CAMERA = (
    *(
        "file_path",
        "depth_file_path",
        "colmap_im_id",
        "sharpness",
        "depth_unit_scale_factor",
        "is_fisheye",
    ),
    *(
        "train_filenames",
        "val_filenames",
        "test_filenames",
        "ply_file_path",
        "transform_matrix",
        "mask_path",
    ),
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
_METASHAPE = {"f": "f"} | {
    f"{key}?": key for key in ("cx", "cy", *RADTAN[:5], "k4", "p3", "p4", "b1", "b2")
}
_FISHEYE_LIMIT = {"kb4": OPENCV_DEG}

# In the order in which they are tried.
DIALECTS = (
    Dialect(
        name="basalt JSON",
        what="ds, eucm, ucm, kb4, pinhole, pinhole-radtan8 and fov. Masks camN/mask.png beside the "
        "file are read, too: N from 0, bright = valid",
        recognises=lambda data: "value0" in data,
        cameras=_basalt_cameras,
        model="camera_type",
        models={name: (name, _BY_NAME) for name in ("ds", "eucm", "ucm", "kb4", "pinhole", "fov")}
        | {"pinhole-radtan8": ("pinhole", _BY_NAME)},
        poses=(Way("T_imu_cam", "named"),),
        mask=_mask_beside,
    ),
    Dialect(
        name="Kalibr camchain",
        what="ds, eucm, omni, or pinhole with equidistant, radtan or fov; also one camera, and "
        "EuRoC's folders camN with sensor.yaml",
        recognises=_is_kalibr,
        cameras=_named_cameras,
        model="camera_model distortion_model=none",
        aliases={
            "equi": "equidistant",
            "kb4": "equidistant",
            "plumb_bob": "radtan",
            "radial-tangential": "radtan",
        },
        models={
            "ds + none": ("ds", {"intrinsics": ("xi", "alpha", *PINHOLE), _DISTORTION: ()}),
            "eucm + none": ("eucm", {"intrinsics": ("alpha", "beta", *PINHOLE), _DISTORTION: ()}),
            "omni + none": ("omni", {"intrinsics": ("xi", *PINHOLE), _DISTORTION: ()}),
            "omni + radtan": ("omni", {"intrinsics": ("xi", *PINHOLE), _DISTORTION: RADTAN4}),
            "pinhole + equidistant": ("kb4", {"intrinsics": PINHOLE, _DISTORTION: FISHEYE}),
            "pinhole + radtan": ("pinhole", {"intrinsics": PINHOLE, _DISTORTION: RADTAN4}),
            "pinhole + fov": ("fov", {"intrinsics": PINHOLE, _DISTORTION: ("w",)}),
            "pinhole + none": ("pinhole", {"intrinsics": PINHOLE, _DISTORTION: ()}),
        },
        poses=(
            Way("T_cn_cnm1", to_camera=True, parent="previous"),
            Way("T_cam_imu", to_camera=True),
            Way("T_imu_cam"),
            Way("T_BS"),
        ),
        first_is_rig=True,
    ),
    Dialect(
        name="VINS configuration",
        what="with `body_T_cam0`, …, and the camodocal files that `cam0_calib`, … name",
        recognises=lambda data: "body_T_cam0" in data,
        cameras=_vins_cameras,
        model="model_type",
        models=_CAMODOCAL,
        size="image_width image_height",
        poses=(Way("body_T_cam"),),
        settings=True,
    ),
    Dialect(
        name="camodocal camera",
        what="MEI, KANNALA_BRANDT, PINHOLE or SCARAMUZZA",
        recognises=lambda data: "model_type" in data,
        cameras=_one,
        model="model_type",
        models=_CAMODOCAL,
        size="image_width image_height",
        unit="",
    ),
    Dialect(
        name="nerfstudio",
        what="transforms.json, each frame a camera, or folders of frames: OPENCV, OPENCV_FISHEYE "
        "or PINHOLE, and masks",
        recognises=lambda data: has_list("frames", data, of="transform_matrix"),
        cameras=_frames,
        model="camera_model",
        models={
            "opencv": ("pinhole", _FL | {f"{key}?": key for key in RADTAN[:5]}),
            "pinhole": ("pinhole", _FL | {f"{key}?": key for key in RADTAN[:5]}),
            "simple_pinhole": ("pinhole", _FL | {f"{key}?": key for key in RADTAN[:5]}),
            "opencv_fisheye": ("kb4", _FL | {f"{key}?": key for key in FISHEYE}),
        },
        size="w h",
        poses=(Way("transform_matrix", "opengl"),),
        unit=UNSTATED,
        measured=_FISHEYE_LIMIT,
        origin=0.5,
        mask=_mask_named,
    ),
    Dialect(
        name="Gyroflow lens profile",
        what="of one camera, opencv_fisheye, not stretched",
        recognises=lambda data: "fisheye_params" in data,
        cameras=_one,
        model="distortion_model=opencv_fisheye",
        models={"opencv_fisheye": ("kb4", _gyroflow)},
        size="calib_dimension.w calib_dimension.h",
        unit="",
        measured=_FISHEYE_LIMIT,
        settings=True,
    ),
    Dialect(
        name="Anipose, Caliscope",
        what="calibration.toml, fisheye or not; rig → camera",
        recognises=lambda data: any(
            {"matrix", "distortions", "size"} <= _mapping(c).keys() for c in data.values()
        ),
        cameras=_anipose_cameras,
        model="fisheye=false",
        aliases={"0": "false", "1": "true"},
        models={
            "true": ("kb4", {"matrix": K9, "distortions": FISHEYE}),
            "false": ("pinhole", {"matrix": K9, "distortions": RADTAN[:5]}),
        },
        size="size",
        poses=(Way("rotation translation", "axis_angle", to_camera=True),),
        unit=UNSTATED,
        measured=_FISHEYE_LIMIT,
    ),
    Dialect(
        name="DepthAI",
        what="the calibration of a device: fisheye, perspective",
        recognises=lambda data: "cameraData" in data,
        cameras=_depthai_cameras,
        model="cameraType",
        aliases={"0": "perspective", "1": "fisheye"},
        models={
            "fisheye": ("kb4", {"intrinsicMatrix": K9, "distortionCoeff": FISHEYE}),
            "perspective": ("pinhole", {"intrinsicMatrix": K9, "distortionCoeff": RADTAN}),
        },
        size="width height",
        poses=(
            Way(
                "extrinsics.rotationMatrix extrinsics.translation",
                "depthai",
                parent="extrinsics.toCameraSocket",
            ),
        ),
        unit="centimetres",
        measured=_FISHEYE_LIMIT,
    ),
    Dialect(
        name="Project Aria",
        what="CameraCalibrations with FisheyeRadTanThinPrism and their image size; device ← camera",
        recognises=lambda data: has_list("CameraCalibrations", data, of="Projection"),
        cameras=_listed("CameraCalibrations"),
        model="Projection.Name",
        models={
            "fisheyeradtanthinprism": (
                "fisheye624",
                {"Projection.Params": ("f", "cx", "cy", *FISHEYE624)},
            ),
            "kannalabrandtk3": ("kb4", {"Projection.Params": (*PINHOLE, *FISHEYE)}),
        },
        measured={"fisheye624": OPENCV_DEG},
        size="ImageSize|image_size|ImageSizes|resolution",
        poses=(Way("T_Device_Camera.UnitQuaternion T_Device_Camera.Translation", "scalar_first"),),
        settings=True,
    ),
    Dialect(
        name="DriveWorks rig",
        what="cameras with an f-theta polynomial and nominalSensor2Rig_FLU",
        recognises=lambda data: has_list(
            "sensors", dict(_mapping(data.get("rig"))), of="properties"
        ),
        cameras=_drive_works_cameras,
        model="properties.Model",
        models={"ftheta": ("ftheta", _f_theta)},
        size="properties.width properties.height",
        poses=(Way("nominalSensor2Rig_FLU.roll-pitch-yaw nominalSensor2Rig_FLU.t", "flu"),),
        settings=True,
    ),
    Dialect(
        name="Metashape lens",
        what="XML of one camera",
        recognises=lambda data: "calibration" in data,
        cameras=lambda data, path: [data.add("", data.require("calibration"), "calibration")],
        model="projection=frame",
        models={
            word: (f"metashape {ours}", _METASHAPE)
            for word, ours in {
                "frame": "rectilinear",
                "fisheye": "equidistant",
                "equidistant_fisheye": "equidistant",
                "equisolid_fisheye": "equisolid",
            }.items()
        },
        size="width height",
        unit="",
        origin=None,
    ),
    Dialect(
        name="Hugin lens",
        what="`.pto` or `.ini` of one lens",
        recognises=lambda data: {"w", "h", "f", "v"} <= data.keys(),
        cameras=_one,
        model="f",
        models={
            str(number): (f"hugin {ours}", _hugin)
            for number, ours in {
                0: "rectilinear",
                2: "equidistant",
                3: "equidistant",
                8: "orthographic",
                10: "stereographic",
                21: "equisolid",
            }.items()
        },
        size="w h",
        unit="",
    ),
)
