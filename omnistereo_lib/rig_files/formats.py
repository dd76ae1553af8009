"""The formats of rig files: how each is recognised, read, and checked.

To add one: write a reader, a function like `kalibr.read_kalibr`, and add its row to `FORMATS`.
"""

from __future__ import annotations

import logging
import os
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

from omnistereo_lib.errors import OmnistereoError, error_context
from omnistereo_lib.files import as_path, read_data, read_text
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.rig_files import plausible
from omnistereo_lib.rig_files.basalt import read_basalt
from omnistereo_lib.rig_files.camodocal import read_camodocal, read_vins
from omnistereo_lib.rig_files.kalibr import read_kalibr
from omnistereo_lib.rig_files.lens_files import parse_hugin, read_hugin, read_metashape
from omnistereo_lib.rig_files.ocam import data_lines, parse_pose, read_ocam_txt, warn_of_polynomials
from omnistereo_lib.rig_files.omnimvs import read_omnimvs
from omnistereo_lib.rig_files.opencv import is_opencv, read_opencv
from omnistereo_lib.rig_files.parse import METRES_PER_UNIT, RigFile, Section, check_fov, metres_per_unit

_log = logging.getLogger("omnistereo_lib")


class Format(NamedTuple):
    """A format of rig or lens files."""

    name: str
    recognises: Callable[[dict[str, Any]], bool]  #: whether parsed content is of this format
    read: Callable[[Section, Path, float | None], RigFile]  #: content, path, max_fov_deg; raises an `OmnistereoError`
    in_metres: bool = True  #: whether the format defines its unit; else `load_rig` needs it


# In the order in which they are tried.
FORMATS = (
    Format("OmniMVS config.yaml", lambda data: _is_omnimvs(data.get("cameras")), read_omnimvs),
    Format("basalt JSON", lambda data: "value0" in data, read_basalt),
    Format("Kalibr camchain", lambda data: "camera_model" in _mapping(data.get("cam0")), read_kalibr),
    Format("VINS configuration", lambda data: "body_T_cam0" in data, read_vins),
    Format("OpenCV", is_opencv, read_opencv, in_metres=False),
    Format("camodocal camera", lambda data: "model_type" in data, read_camodocal),
    Format("Metashape lens", lambda data: "calibration" in data, read_metashape),
    Format("Hugin lens", lambda data: {"w", "h", "f", "v"} <= data.keys(), read_hugin),
)
_SUPPORTED = (
    "supported formats: OmniMVS config.yaml, basalt JSON, Kalibr camchain, VINS YAML, OpenCV or ROS (YAML, JSON, XML), "
    "and a folder with poses.txt and ocam1.txt, … (OCamCalib) or cam1, … (camodocal, OpenCV, Metashape, Hugin)"
)
_RIG_FILES = ("config.yaml", "rig.yaml", "calibration.json", "calibration.yaml")  # the first found in a folder
_LENS_FILES = ("ocam*.txt", "cam[0-9]*.*")  # the first found in a folder with poses.txt
_MAX_BYTES = 1 << 18  # a hundred cameras have 60,000; a megabyte of YAML takes seconds
_KNOWN_KEYS = {"dataset", "cam_id", "img_dir", "rostopic", "cam_overlaps"}  # of every such file, without a meaning here


def load_rig(
    path: str | Path, unit: str | None = None, max_fov_deg: float | None = None, keep_frame: bool = False
) -> Rig:
    """Read a rig of any supported format; the log (`logging`, name "omnistereo_lib") states which.

    Warns of what the file states twice and differently, of two polynomials, or a model and the fitted one, that differ
    by more than 0.1 px inside the image, and of an implausible principal point.

    Args:
        path: File or folder. In a folder with both, config.yaml is read instead of the OCamCalib text files, because it
            states its unit, unless a unit is given: only the text files need one.
        unit: Unit of the translations: required where the file does not state it, refused where it states another.
        max_fov_deg: Full field of view of the lenses, degrees. None: the value in the file (config.yaml), else up to
            220°, or the mask, as far as the image and the model reach.
        keep_frame: Keep the frame of the file. False: a rig whose cameras agree that down is not +y is turned level,
            see `plausible.level`, unless it was saved after it had been loaded.

    Raises:
        OmnistereoError: If the file is missing, broken or of an unsupported format, or its unit is neither stated nor
            given.

    >>> rig = osl.load_rig("data_samples/sunny/test")
    >>> len(rig), rig.cameras[0].image_size
    (4, (800, 768))
    """
    path = as_path(path)
    if unit is not None and unit not in METRES_PER_UNIT:
        raise OmnistereoError(f"unit is {unit!r}; expected one of {list(METRES_PER_UNIT)}")
    if max_fov_deg is not None:
        check_fov(max_fov_deg, "max_fov_deg")
    if os.path.isdir(path) and not (unit is None and (path / "config.yaml").exists()) and _lens_files(path):
        name, in_metres, found = "OCamCalib text files", False, _read_folder(path, max_fov_deg)
    else:
        path = _find_rig_file(path) if os.path.isdir(path) else path
        name, in_metres, found = _read_file(path, max_fov_deg)
    with error_context(path):
        if len(found.cameras) == 1:
            raise OmnistereoError(
                f"{name} of one camera; a rig needs at least 2 cameras with their poses. `load_camera` reads it; put "
                "cam1, cam2, … and poses.txt (rx ry rz tx ty tz, camera → rig) into a folder, and pass the folder"
            )
        if in_metres and unit not in (None, "m"):
            raise OmnistereoError(f"{name} files are in metres by definition. Omit unit={unit!r}")
        T_rig_file = found.T_rig_file or Pose.identity()
        rig = Rig(tuple(found.cameras), tuple(found.T_rig_cam), found.min_depth, T_rig_file)
        scale = 1.0 if in_metres else metres_per_unit(unit, rig.centers)
        rig = rig.with_poses([Pose(pose.R, scale * pose.t) for pose in rig.T_rig_cam])
        plausible.check_rig(rig, path)
        low, high = rig.baselines.min(), rig.baselines.max()
        in_unit = "" if in_metres else f" in {unit}"
        _log.info("%s: %s%s, %d cameras, %.3f to %.3f m apart", path, name, in_unit, len(rig), low, high)
        return rig if keep_frame or found.T_rig_file else plausible.level(rig, path)


def load_camera(path: str | Path, max_fov_deg: float | None = None) -> OcamCamera:
    r"""Read one camera: an OCamCalib text file, a lens file, or any supported format that holds one camera.

    Args:
        path: The file.
        max_fov_deg: As for `load_rig`.

    >>> with open("ocam1.txt", "w") as file:  # without an inverse polynomial, which is fitted
    ...     print("3 -200 0 1e-3", "0", "240 320", "1 0 0", "480 640", sep="\n", file=file)
    >>> osl.load_camera("ocam1.txt", max_fov_deg=180).center  # (u, v); the file has the row first
    (320.0, 240.0)
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
            raise OmnistereoError(f"{path}: {name} of {len(found.cameras)} cameras; expected one. Use load_rig")
        camera = found.cameras[0]
    with error_context(path):
        if doubt := plausible.camera_doubt(camera):
            warnings.warn(f"{path}: {doubt}", UserWarning, stacklevel=2)
    return camera


def load_cameras(path: str | Path, max_fov_deg: float | None = None) -> list[OcamCamera]:
    """Read the cameras of a rig file, or of a folder of files of one camera each, without their poses.

    Args:
        path, max_fov_deg: As for `load_rig`; a folder needs no poses.txt.
    """
    path = as_path(path)
    if max_fov_deg is not None:
        check_fov(max_fov_deg, "max_fov_deg")
    files = _sorted(file for pattern in _LENS_FILES for file in path.glob(pattern) if file.is_file())
    if files and not (path / "config.yaml").exists():
        return [load_camera(file, max_fov_deg) for file in files]
    return _read_file(_find_rig_file(path) if path.is_dir() else path, max_fov_deg)[2].cameras


def _lens_files(folder: Path) -> list[Path]:
    """Return the files of single cameras in the order of their numbers: cam2 before cam10."""
    found = [list(folder.glob(pattern)) for pattern in _LENS_FILES]
    files = found[0] or (found[1] if (folder / "poses.txt").exists() else [])
    return _sorted(files)


def _sorted(files: Iterable[Path]) -> list[Path]:
    return sorted(files, key=lambda file: (len(file.name), file.name))


def _read_folder(folder: Path, max_fov_deg: float | None) -> RigFile:
    """Read the files of single cameras, and poses.txt: camera → rig, in an unstated unit."""
    files, poses, poses_file = _lens_files(folder), [], folder / "poses.txt"
    with error_context(poses_file):
        for i, line in enumerate(data_lines(poses_file), 1):
            with error_context(f"camera {i}"):
                poses.append(parse_pose(line))
        if len(poses) != len(files):
            raise OmnistereoError(
                f"found {len(poses)} poses and {len(files)} camera files "
                f"({', '.join(file.name for file in files)}); expected one line rx ry rz tx ty tz per camera"
            )
    if files[0].suffix != ".txt":
        return RigFile([load_camera(file, max_fov_deg) for file in files], poses)
    cameras = [read_ocam_txt(file, max_fov_deg) for file in files]
    warn_of_polynomials(cameras, folder)
    return RigFile(cameras, poses)


def _find_rig_file(folder: Path) -> Path:
    for name in _RIG_FILES:
        if (folder / name).exists():
            return folder / name
    found = sorted(file.name for file in folder.iterdir())[:8]
    raise OmnistereoError(f"{folder}: found {found}; expected ocam*.txt or one of {_RIG_FILES}; {_SUPPORTED}")


def _read_file(path: Path, max_fov_deg: float | None) -> tuple[str, bool, RigFile]:
    """Return the name of the format of a file, whether it is in metres, and what the file holds."""
    with error_context(path):
        if path.suffix == ".txt":
            raise OmnistereoError(f"a text file holds one camera or the poses. Pass the folder of a rig; {_SUPPORTED}")
        is_hugin = path.suffix in (".pto", ".ini")
        data = parse_hugin(read_text(path, _MAX_BYTES), path) if is_hugin else read_data(path, _MAX_BYTES)
        content = _mapping(data)
        content = _mapping(content.get("opencv_storage", content))  # the root of OpenCV's XML
        form = next((each for each in FORMATS if each.recognises(content)), None)
        if form is None:
            keys = sorted(map(str, content))[:8]
            raise OmnistereoError(f"unknown format, found the keys {keys}{_unread_format(path, content)}; {_SUPPORTED}")
        section = Section(content)
        found = form.read(section, path, max_fov_deg)
        ignored = sorted(set(section.unread()) - _KNOWN_KEYS)
        if ignored:
            _log.info("%s: ignored keys: %s", path, ", ".join(ignored))
        return form.name, form.in_metres, found


def _mapping(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _is_omnimvs(cameras: Any) -> bool:
    return cameras == [] or (isinstance(cameras, list) and any(isinstance(c, dict) and "poly" in c for c in cameras))


def _unread_format(path: Path, data: dict[str, Any]) -> str:
    """Return what to do about a file of a program that is known, but whose files are not read."""
    if path.suffix == ".pts" or "project" in data:
        return ". PTGui projects are not read: rebuild the lens in Hugin (.pto), which has the same a, b and c"
    if "document" in data or "chunk" in data:
        return ". Metashape projects are not read: save the calibration of each camera (Tools, Camera Calibration)"
    return ""
