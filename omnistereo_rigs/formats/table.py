"""The interpreter of the table of dialects, whose rows are in `dialects`.

A row says what recognises a file, where its cameras are, which of our models a word means and in
which order its numbers stand, where size and pose are, in which direction the pose is meant, and
the unit. To add a dialect, write a row, an example in book/own_cameras.md and a test.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from omnistereo_lib.errors import OmnistereoError, error_context
from omnistereo_lib.files import path_within
from omnistereo_lib.geometry.pose import Floats, Pose, quaternion_pose, rotation_from_axis_angle
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
from omnistereo_rigs.formats.camera_models import RADTAN
from omnistereo_rigs.formats.fit import Lens

UNSTATED = "`--unit`"
METRES = {"metres": 1.0, "centimetres": 0.01}  # of the unit of a row; 1 where it is not stated
K9 = ("fx", "skew", "cx", "0", "fy", "cy", "0", "0", "1")  # a camera matrix, row by row
ALL = ("*",)  # every number of a mapping, by its name
OPENGL = np.diag([1.0, -1.0, -1.0])  # the camera axes of OpenGL (y up, z back) in those of OpenCV
FLU = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # camera axes in x forward, y left, z up

Names = Sequence[str] | str  # of numbers in their order, or of one number
Parameters = Mapping[str, Names] | Callable[[Section], Mapping[str, Any]]  # by their paths


class Way(NamedTuple):
    """One way in which the poses of all cameras may be stated.

    Keys are those of a 4 × 4 matrix, of a rotation and a translation, separated by a blank, or of
    a mapping qw … pz. A rotation of 3 numbers is an axis-angle, of 9 a matrix.
    """

    keys: str
    axes: Floats | None = None  #: of the camera in the file, where they are not ours
    is_quaternion: bool = False  #: the rotation is w x y z
    to_camera: bool = False  #: from rig, or parent, to camera
    parent: str = ""  #: "previous" camera, or the key of its number, to which the pose leads
    first_may_lack: bool = False  #: the first camera is then the rig frame


class Value(NamedTuple):
    """What a key must be where it is stated, and what to do if it is not."""

    allowed: Sequence[float]
    advice: str


@dataclass(frozen=True)
class Dialect:
    """How files of a program are read. Places are keys joined by dots, alternatives by "|"."""

    name: str
    what: str
    recognises: Callable[[dict[str, Any]], bool]
    cameras: Callable[[Section, Path], Sequence[Section]]
    models: Mapping[str, tuple[str, Parameters]]  #: word → our model, its parameters by place
    model: str = ""  #: places of the word, joined by " + "; a default behind "="
    size: str = "resolution"  #: the place of two numbers, or two places
    poses: Sequence[Way] = ()  #: the first that all cameras state is used, others are compared
    unit: str = UNSTATED  #: or one of `METRES`; "" of a lens by itself
    measured_deg: Mapping[str, float] = field(default_factory=dict)  #: of our model: see `Lens`
    origin: float = 0.0  #: of the first pixel's centre
    aliases: Mapping[str, str] = field(default_factory=dict)  #: words for words
    values: Mapping[str, Value] = field(default_factory=dict)  #: what is read only if it is so
    first_is_rig: bool = False  #: whether the first camera is the rig frame, whatever poses say
    settings: bool = False  #: whether its top level holds settings of a program, too
    #: The file of a camera's mask, bright where the image is valid, by its number, from 0.
    mask: Callable[[Section, int], str | None] = lambda cam, n: None


class Found(NamedTuple):
    """What a reader finds: lenses, and poses in the unit of the file."""

    name: str  #: of the format
    lenses: Sequence[Lens] = ()
    T_rig_cam: Sequence[Pose] = ()  #: camera → rig
    unit: str = ""  #: a key of `METRES`, or "" where the format states none
    #: Seconds to add to the time stamps of each camera, so that equal sums are one moment
    #: (`timeshift_cam_imu` of Kalibr: t_imu = t_cam + shift). None: the file states none.
    clock_offsets_s: tuple[float, ...] | None = None


def in_order(names: Iterable[Any]) -> list[Any]:
    """Return names of cameras by the number behind a common word, cam2 before cam10, or as is."""
    found = [*names]
    ends = [re.fullmatch(r"(\D*)([0-9]{1,9})", str(name)) for name in found]
    if len({end and end[1] for end in ends}) > 1 or None in ends:
        return found
    numbers = {int(re.sub(r"\D", "", str(name))): name for name in found}
    if len(numbers) < len(found):
        raise OmnistereoError(f"two of {', '.join(map(str, found))} have one number. Rename one")
    return [numbers[number] for number in sorted(numbers)]


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
    shifts = tuple(cam.number("timeshift_cam_imu", default=np.nan) for cam in cams)
    unit = row.unit if row.unit in METRES else ""
    return Found(row.name, lenses, poses, unit, shifts if np.isfinite(shifts).all() else None)


def _lens(row: Dialect, cam: Section, path: Path, n: int) -> Lens:
    for key, value in row.values.items():
        stated = cam.get(key, 0)
        if not (is_irrelevant("", stated) or stated in value.allowed):
            expected = " or ".join(map(str, value.allowed)) or "nothing"
            raise OmnistereoError(f"{key} is {stated}; expected {expected}. {value.advice}")
    model, spec = row.models[_word(row, cam)]
    sides = [cam.require(place) for place in row.size.split()]
    names = " and ".join(cam.at(place)[1] for place in row.size.split())
    size = parse_size(sides if len(sides) > 1 else sides[0], names)
    parameters = dict(spec(cam) if callable(spec) else numbers(cam, spec))
    shared = {"cx", "cy"} & parameters.keys()  # what is missing is named below
    parameters |= {axis: parameters[axis] - row.origin for axis in shared}
    name = row.mask(cam, n)
    file = None if name is None else path_within(path.parent, name, path)
    mask = None
    # What a camera names is there; a mask beside the file may be.
    if file is not None and (file.exists() or cam.get("mask_path") is not None):
        mask = read_gray(file, size) >= 128
    source = f"{path}, {cam.name}" if cam.name else str(path)
    return Lens(source, model, parameters, size, mask, row.measured_deg.get(model))


def _word(row: Dialect, cam: Section) -> str:
    places, _, default = row.model.partition("=")
    words = [cam.word(place) for place in places.split()]
    word = " + ".join(row.aliases.get(each, each) or default for each in words)
    if word not in row.models:
        names = " + ".join(place.split(".")[-1] for place in places.split())
        raise OmnistereoError(
            f"{names} is {word or 'not stated'}; expected one of {', '.join(row.models)}. "
            "Recalibrate with one of them; pictures that are stitched already have no depth"
        )
    return word


def numbers(cam: Section, spec: Mapping[str, Names]) -> dict[str, float]:
    """Return the numbers of a lens by our names, from their places; marked "?" may be missing."""
    found: dict[str, float] = {}
    for mark, names in spec.items():
        place = mark.rstrip("?")
        if mark != place and cam.get(place) in (None, []):
            continue
        if names == ALL:
            at = cam.section(place)
            found |= {name: at.number(name) for name in at.values}
        elif isinstance(names, str):
            found[names] = cam.number(place)
        elif names or cam.get(place):
            found |= _named(cam, place, names)
    if "f" in found:
        found["fx"] = found["fy"] = found.pop("f")
    return found


def _named(cam: Section, place: str, names: Sequence[str]) -> dict[str, float]:
    """Return the numbers of a list by their names; zeros behind them are dropped."""
    values, key = cam.floats(place).tolist(), cam.at(place)[1]
    if names == K9:
        if len(values) != 9:
            raise OmnistereoError(f"{key} must be 9 numbers, found {len(values)}")
        if not np.allclose([values[n] for n in (3, 6, 7, 8)], [0, 0, 0, 1], atol=1e-9):
            raise OmnistereoError(f"{key} is {values}; expected fx skew cx, 0 fy cy, 0 0 1")
    counts = sorted({len(names), *((4, 5) if names == RADTAN else ())})
    if len(values) > len(names) and not any(values[len(names) :]):
        count = len(names)
        cam.note(f"{key} has {len(values)} numbers; the zeros after the first {count} are dropped")
        values = values[: len(names)]
    if len(values) not in counts:
        expected = ", ".join(map(str, counts))
        raise OmnistereoError(
            f"{key} has {len(values)} numbers; expected {expected}: {' '.join(names)}"
        )
    return {name: value for name, value in zip(names, values, strict=False) if name not in "01"}


def _poses(row: Dialect, cams: Sequence[Section], path: Path) -> list[Pose]:
    """Return camera → rig by the first way that all cameras have; the others are compared."""
    found: dict[str, list[Pose]] = {}
    for way in row.poses:
        has = [_stated(cam, way) for cam in cams]
        lacks_first = way.parent == "previous" or (way.first_may_lack and not has[0])
        if not all(has[lacks_first:]):
            continue
        poses = [Pose.identity()] * lacks_first
        for cam in cams[lacks_first:]:
            with error_context(cam.name or path):
                pose = parse_pose(cam, way)
                poses.append(pose.inverse() if way.to_camera else pose)
        if way.parent:
            poses = _chained(cams, poses, way.parent)
        if row.first_is_rig:
            poses = [poses[0].inverse() @ pose for pose in poses]
        found[way.keys.split()[0].split("|")[0]] = poses
    if not found:
        missing = next((c for c in cams[1:] if not any(_stated(c, w) for w in row.poses)), cams[-1])
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
    return cam.get(way.keys.split()[0]) is not None


def parse_pose(cam: Section, way: Way) -> Pose:
    """Return the pose of a camera as it is stated, with our axes of the camera."""
    place, *rest = way.keys.split()
    value = cam.require(place)
    if isinstance(value, Mapping) and "qw" in value:
        q = np.array([cam.number(f"{place}.q{axis}") for axis in "wxyz"])
        pose = quaternion_pose(q, np.array([cam.number(f"{place}.p{axis}") for axis in "xyz"]))
    elif not rest:
        pose = cam.pose(place)
    else:
        t, key = cam.require(rest[0]), cam.at(rest[0])[1]
        t = [t.get(axis) for axis in "xyz"] if isinstance(t, Mapping) and "x" in t else t
        R = _rotation(cam, cam.at(place)[1], value, way.is_quaternion)
        pose = Pose(R, parse_floats(t, key, 3))
    return pose if way.axes is None else Pose(pose.R @ way.axes, pose.t)


def _rotation(cam: Section, key: str, value: Any, is_quaternion: bool) -> Floats:
    match value:
        case [float() | int() as w, [x, y, z]]:
            value = [w, x, y, z]
    if is_quaternion:
        return quaternion_pose(parse_floats(value, key, 4), np.zeros(3)).R
    r = parse_floats(value, key)
    if r.size not in (3, 9):
        raise OmnistereoError(
            f"{key} has {r.size} numbers; expected a 3 × 3 matrix or an axis-angle of 3 numbers"
        )
    if r.size == 9:
        return cam.rotation(key, r)
    return rotation_from_axis_angle(parse_axis_angle(r, key))


def _chained(cams: Sequence[Section], poses: Sequence[Pose], parent: str) -> list[Pose]:
    """Return camera → root of poses camera → parent: the one before, or the key's number."""
    parents = [n - 1 for n in range(len(cams))]
    if parent != "previous":
        own = [cam.number("socket") for cam in cams]
        leads = [cam.number(parent) for cam in cams]
        parents = [own.index(to) if to in own else -1 for to in leads]
    chained = []
    for n, pose in enumerate(poses):
        for _ in cams:  # at most so many steps to the root
            n = parents[n]
            pose = pose if n < 0 else poses[n] @ pose
            if n < 0:
                break
        if n >= 0 or parents.count(-1) > 1:
            raise OmnistereoError(f"the poses lead in a circle or apart. Check {parent} of each")
        chained.append(pose)
    # The root may state the pose of another body.
    root = poses[parents.index(-1)]
    return [root.inverse() @ pose for pose in chained]
