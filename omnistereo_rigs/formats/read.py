"""The formats of rig files: how each is recognised, read, and checked.

To add one: write a reader, a function like `kalibr.read_kalibr`, and add its row to `FORMATS`.
"""

import logging
import os
import re
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from omnistereo_lib.errors import OmnistereoError, error_context
from omnistereo_lib.files import as_path, read_data, read_text
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.parse import (
    METRES_PER_UNIT,
    RigFile,
    Section,
    check_fov,
    is_irrelevant,
    metres_per_unit,
    numbered_lines,
    warn_if_different,
)
from omnistereo_lib.rig_file import parse_pose, read_ocam_txt, read_omnimvs, warn_of_polynomials
from omnistereo_rigs.formats import plausible
from omnistereo_rigs.formats.basalt import read_basalt
from omnistereo_rigs.formats.camodocal import read_camodocal, read_vins
from omnistereo_rigs.formats.kalibr import is_kalibr, read_kalibr
from omnistereo_rigs.formats.lens_files import (
    parse_hugin,
    read_gyroflow,
    read_hugin,
    read_metashape,
)
from omnistereo_rigs.formats.opencv import is_opencv, read_mc_calib, read_opencv
from omnistereo_rigs.formats.reconstructions import (
    read_colmap_model,
    read_colmap_rig,
    read_transforms,
)

_log = logging.getLogger("omnistereo_lib")


_UNSTATED = "`--unit`"


class Format(NamedTuple):
    """A format of rig or lens files; the docstring of its reader begins "Read NAME: WHAT.", see
    `formats_table`.
    """

    read: Callable[
        [Section, Path, float | None], RigFile
    ]  #: content, path, max_fov_deg; raises an `OmnistereoError`
    recognises: Callable[[dict[str, Any]], bool]  #: whether parsed content is of this format
    unit: str = "metres"  #: of its poses; `read_any_rig` needs the one of `_UNSTATED`
    has_settings: bool = False  #: whether its top level holds settings of a program, too

    @property
    def name(self) -> str:
        """Its name for people."""
        return _described(self.read)[0]


# In the order in which they are tried.
FORMATS = (
    Format(
        read_omnimvs,
        lambda data: data.get("cameras") == [] or _has_list("cameras", data, of="poly"),
    ),
    Format(read_basalt, lambda data: "value0" in data),
    Format(read_kalibr, is_kalibr),
    Format(read_vins, lambda data: "body_T_cam0" in data, has_settings=True),
    Format(read_camodocal, lambda data: "model_type" in data, ""),
    Format(read_colmap_rig, lambda data: _has_list("cameras", data, of="image_prefix"), _UNSTATED),
    Format(
        read_transforms, lambda data: _has_list("frames", data, of="transform_matrix"), _UNSTATED
    ),
    Format(read_gyroflow, lambda data: "fisheye_params" in data, "", has_settings=True),
    Format(
        read_mc_calib,
        lambda data: "camera_pose_matrix" in _mapping(data.get("camera_0")),
        _UNSTATED,
    ),
    Format(read_opencv, is_opencv, _UNSTATED),
    Format(read_metashape, lambda data: "calibration" in data, ""),
    Format(read_hugin, lambda data: {"w", "h", "f", "v"} <= data.keys(), ""),
)
# What is known, but not read: a pattern for a key of the file, and what to do instead.
_NOT_READ = {
    "project": (
        "PTGui projects are not read: rebuild the lens in Hugin (.pto), which has the same a, b"
        " and c"
    ),
    "document|chunk": (
        "Metashape projects are not read: save the calibration of each camera (Tools)"
    ),
    "cameraData": (
        "DepthAI calibrations are not read: write K, D, R, T and the size as OpenCV names them,"
        " --unit cm"
    ),
    r"Camera[12]?\.fx": "ORB-SLAM settings are not read: write the camchain of Kalibr",
    "rig": "DriveWorks rigs are not read: write K, D, R, T and the size as OpenCV names them",
}
_RIG_FILES = (
    "config.yaml",
    "rig.yaml",
    "calibration.json",
    "calibration.yaml",
    "rig_config.json",
    "transforms.json",
)
_LENS_FILES = ("ocam*.txt", "cam[0-9]*.*")  # the first found
_COLMAP = ("cameras.txt", "images.txt")
_MAX_BYTES = 1 << 18  # a hundred cameras have 60,000; a megabyte of YAML takes seconds


def formats_table() -> str:
    """Return the formats as the table in book/own_cameras.md, whose test says how it is made."""
    rows = [("format", "what is read", "unit"), ("---",) * 3]
    rows += [(*_described(form.read), form.unit) for form in FORMATS]
    rows += [(*_described(read), _UNSTATED) for read in (_read_folder, read_colmap_model)]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _described(read: Callable[..., RigFile]) -> tuple[str, str]:
    """Return the name of what a function reads, and what it reads of that, by its docstring."""
    # PYTHONOPTIMIZE=2 drops docstrings; the name of the function is left.
    text = read.__doc__ or f"{read.__name__.removeprefix('read_')}: "
    name, what = (
        " ".join(text.split("\n\n")[0].split()).removeprefix("Read ").rstrip(".").split(":", 1)
    )
    return name, what.strip()


def _supported() -> str:
    return (
        f"supported formats: {'; '.join(form.name for form in FORMATS)}; folders with poses.txt or"
        " images.txt"
    )


def read_any_rig(
    path: str | Path,
    unit: str | None = None,
    max_fov_deg: float | None = None,
    keep_frame: bool = False,
) -> Rig:
    """Read a rig of any supported format; the log (`logging`, name "omnistereo_lib") states which.

    Warns of what is stated twice and differently, in the file or in poses.txt beside config.yaml,
    of keys that are not read, of a model that is not stated, of two polynomials, or a model and the
    fitted one, that differ by more than 0.1 px inside the image, of pixels beyond the model, and of
    an implausible principal point.

    Args:
        path: File or folder. In a folder with both, config.yaml is read instead of the OCamCalib
            text files, because it states its unit, unless a unit is given: only the text files need
            one.
        unit: Unit of the translations: required where the file does not state it, refused where it
            states another.
        max_fov_deg: Full field of view of the lenses, degrees. None: the value in the file
            (config.yaml), else up to 220°, or the mask, as far as the image and the model reach.
        keep_frame: Keep the frame of the file. False: a rig whose cameras agree that down is not +y
            is turned level, see `plausible.level`, unless it was saved after it had been loaded.

    Raises:
        OmnistereoError: If the file is missing, broken or of an unsupported format, or its unit is
            neither stated nor given.

    >>> from omnistereo_rigs import read_any_rig
    >>> rig = read_any_rig("data_samples/sunny/test")
    >>> len(rig), rig.cameras[0].image_size
    (4, (800, 768))
    """
    path = as_path(path)
    if unit is not None and unit not in METRES_PER_UNIT:
        raise OmnistereoError(f"unit is {unit!r}; expected one of {list(METRES_PER_UNIT)}")
    if max_fov_deg is not None:
        check_fov(max_fov_deg, "max_fov_deg")
    is_folder = os.path.isdir(path)
    lenses = (
        []
        if not is_folder or (unit is None and (path / "config.yaml").exists())
        else _lens_files(path)
    )
    if lenses and (lenses[0].name.startswith("ocam") or (path / "poses.txt").exists()):
        name, in_metres, found = "OCamCalib text files", False, _read_folder(path, max_fov_deg)
    elif path.name in _COLMAP or (is_folder and all((path / name).exists() for name in _COLMAP)):
        folder = path if is_folder else path.parent
        name, in_metres, found = "COLMAP model", False, read_colmap_model(folder, max_fov_deg)
    else:
        path = _find_rig_file(path) if is_folder else path
        name, in_metres, found = _read_file(path, max_fov_deg)
    with error_context(path):
        if len(found.cameras) == 1:
            raise OmnistereoError(
                f"{name} of one camera; a rig needs at least 2 cameras with their poses."
                " `read_any_camera` reads it; put cam1, cam2, … and poses.txt (rx ry rz tx ty tz,"
                " camera → rig) into a folder, and pass the folder"
            )
        if in_metres and unit not in (None, "m"):
            raise OmnistereoError(f"{name} files are in metres by definition. Omit unit={unit!r}")
        T_rig_file = found.T_rig_file or Pose.identity()
        rig = Rig(tuple(found.cameras), tuple(found.T_rig_cam), found.min_depth, T_rig_file)
        scale = 1.0 if in_metres else metres_per_unit(unit, rig.centers)
        rig = rig.with_poses([Pose(pose.R, scale * pose.t) for pose in rig.T_rig_cam])
        _compare_sources(rig, path)
        plausible.check_rig(rig, path)
        low, high = rig.baselines.min(), rig.baselines.max()
        in_unit = "" if in_metres else f" in {unit}"
        _log.info(
            "%s: %s%s, %d cameras, %.3f to %.3f m apart", path, name, in_unit, len(rig), low, high
        )
        return rig if keep_frame or found.T_rig_file else plausible.level(rig, path)


def read_any_camera(path: str | Path, max_fov_deg: float | None = None) -> OcamCamera:
    r"""Read one camera: an OCamCalib text file, a lens file, or any supported format that holds one
    camera.

    Args:
        path: The file.
        max_fov_deg: As for `read_any_rig`.
    """
    path = as_path(path)
    if max_fov_deg is not None:
        check_fov(max_fov_deg, "max_fov_deg")
    if path.suffix == ".txt":
        camera = read_ocam_txt(path, max_fov_deg)
        warn_of_polynomials([camera], path)
    else:
        name, _, found = _read_file(path, max_fov_deg)
        if len(found.cameras) != 1:
            raise OmnistereoError(
                f"{path}: {name} of {len(found.cameras)} cameras; expected one. Use read_any_rig"
            )
        camera = found.cameras[0]
    with error_context(path):
        if doubt := plausible.camera_doubt(camera):
            warnings.warn(f"{path}: {doubt}", UserWarning, stacklevel=2)
    return camera


def load_cameras(path: str | Path, max_fov_deg: float | None = None) -> list[OcamCamera]:
    """Read the cameras of a rig file, or of a folder of files of one camera each, without their
    poses.

    Args:
        path, max_fov_deg: As for `read_any_rig`; a folder needs no poses.txt.
    """
    path = as_path(path)
    if max_fov_deg is not None:
        check_fov(max_fov_deg, "max_fov_deg")
    if (files := _lens_files(path)) and not (path / "config.yaml").exists():
        return [read_any_camera(file, max_fov_deg) for file in files]
    return _read_file(_find_rig_file(path) if path.is_dir() else path, max_fov_deg)[2].cameras


def _lens_files(folder: Path) -> list[Path]:
    """Return the files of single cameras in the order of their numbers: cam2 before cam10."""
    found = next((files for pattern in _LENS_FILES if (files := [*folder.glob(pattern)])), [])
    return sorted(found, key=lambda file: (len(file.name), file.name))


def _read_folder(folder: Path, max_fov_deg: float | None) -> RigFile:
    """Read a folder: `ocam1.txt`, … (OCamCalib), or `cam1.xml`, `cam1.yaml`, … of any format above,
    and `poses.txt`.
    """
    files, poses = _lens_files(folder), _read_poses(folder / "poses.txt")
    with error_context(folder / "poses.txt"):
        if len(poses) != len(files):
            raise OmnistereoError(
                f"found {len(poses)} poses and {len(files)} camera files"
                f" ({', '.join(file.name for file in files)}); expected one line rx ry rz tx ty tz"
                " per camera"
            )
    if files[0].suffix != ".txt":
        return RigFile([read_any_camera(file, max_fov_deg) for file in files], poses)
    cameras = [read_ocam_txt(file, max_fov_deg) for file in files]
    warn_of_polynomials(cameras, folder)
    return RigFile(cameras, poses)


def _read_poses(file: Path) -> list[Pose]:
    poses = []
    with error_context(file):
        for i, (number, words) in enumerate(numbered_lines(file), 1):
            with error_context(f"line {number}, camera {i}"):
                poses.append(parse_pose(words))
    return poses


def _compare_sources(rig: Rig, path: Path) -> None:
    """Warn if poses.txt and config.yaml stand in one folder and state different poses."""
    folder = path if os.path.isdir(path) else path.parent
    poses_file, config = folder / "poses.txt", folder / "config.yaml"
    if path not in (folder, config) or not (poses_file.exists() and config.exists()):
        return
    used, unused = (config, poses_file) if path == config else (poses_file, config)
    try:
        other = _read_poses(unused) if path == config else _read_file(unused, None)[2].T_rig_cam
        if len(other) != len(rig):
            raise OmnistereoError(f"{unused.name} has {len(other)} cameras, {used.name} {len(rig)}")
    except OmnistereoError as error:
        warnings.warn(
            f"{folder}: {used.name} is used, not {unused.name} beside it: {error}", stacklevel=3
        )
        return
    first, second = (
        [poses[0].inverse() @ pose for pose in poses] for poses in (rig.T_rig_cam, other)
    )
    if path == config:  # poses.txt does not state its unit: that in which it fits best
        far = [
            max(float(np.linalg.norm(pose.t)) for pose in poses) or 1.0 for poses in (first, second)
        ]
        scale = min(
            METRES_PER_UNIT.values(), key=lambda scale: abs(np.log(far[0] / far[1] / scale))
        )
        second = [Pose(pose.R, scale * pose.t) for pose in second]
    warn_if_different(first, second, used.name, unused.name, folder)


def _find_rig_file(folder: Path) -> Path:
    found = [name for name in _RIG_FILES if (folder / name).exists()]
    if found:
        if len(found) > 1:
            warnings.warn(
                f"{folder}: found {' and '.join(found)}; {found[0]} is read. Pass the file that is"
                " meant",
                stacklevel=3,
            )
        return folder / found[0]
    found = sorted(file.name for file in folder.iterdir())[:8]
    raise OmnistereoError(
        f"{folder}: found {found}; expected ocam*.txt or one of {_RIG_FILES}; {_supported()}"
    )


def _read_file(path: Path, max_fov_deg: float | None) -> tuple[str, bool, RigFile]:
    """Return the name of the format of a file, whether it is in metres, and what the file holds."""
    with error_context(path):
        if path.suffix == ".txt":
            raise OmnistereoError(
                "a text file holds one camera or the poses. Pass the folder of a rig;"
                f" {_supported()}"
            )
        is_hugin = path.suffix in (".pto", ".ini")
        data = (
            parse_hugin(read_text(path, _MAX_BYTES), path)
            if is_hugin
            else read_data(path, _MAX_BYTES)
        )
        layers = [*_layers(data)]
        found = next(
            ((form, data) for data in layers for form in FORMATS if form.recognises(data)), None
        )
        if found is None:
            keys = sorted(map(str, layers[0] if layers else []))
            known = next(
                (f". {do}" for key, do in _NOT_READ.items() for k in keys if re.fullmatch(key, k)),
                "",
            )
            raise OmnistereoError(
                f"unknown format, found the keys {keys[:8]}{known}; {_supported()}"
            )
        form, content = found
        section = Section(content)
        rig = form.read(section, path, max_fov_deg)
        if settings := section.warn(path, form.has_settings):
            _log.info("%s: keys of the program, not of cameras: %s", path, ", ".join(settings))
        return form.name, form.unit != _UNSTATED, rig


def _layers(data: Any) -> Iterator[dict[str, Any]]:
    """Yield the content of a file as a mapping, and what is in it as long as it only wraps: a list,
    a single key.
    """
    if isinstance(data, list) and (rigs := [each for each in data if "cameras" in _mapping(each)]):
        if len(rigs) > 1:
            raise OmnistereoError(
                f"the file holds {len(rigs)} rigs; expected one. Delete the others"
            )
        data = rigs[0]
    data = {"cameras": data} if isinstance(data, list) else data
    while isinstance(data, dict):
        yield data
        inner = [value for key, value in data.items() if not is_irrelevant(key, value)]
        data = inner[0] if len(inner) == 1 else None
        data = (
            {f"cam{n}": value for n, value in enumerate(data)} if isinstance(data, list) else data
        )


def _mapping(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _has_list(key: str, data: dict[str, Any], of: str) -> bool:
    """Return whether a key holds a list of mappings, one of which has the key `of`."""
    values = data.get(key)
    return isinstance(values, list) and any(of in _mapping(value) for value in values)
