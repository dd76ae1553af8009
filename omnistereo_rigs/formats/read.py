"""Any rig or lens file, of our format and of other programs, as a rig of OCam cameras."""

import configparser
import logging
import re
import tomllib
import warnings
import zipfile
from collections.abc import Callable, Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from omnistereo_lib.errors import OmnistereoError, error_context
from omnistereo_lib.files import as_path, read_bytes, read_data, read_text
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.ocam_text import read_ocam_txt
from omnistereo_lib.parse import (
    METRES_PER_UNIT,
    Section,
    check_count,
    is_irrelevant,
    warn_if_different,
)
from omnistereo_lib.rig_file import (
    MAX_BYTES,
    RigFile,
    check_options,
    load_camera,
    numbered_files,
    poses_beside,
    read_own,
    read_poses,
    rig_of,
)
from omnistereo_rigs.formats import colmap, plausible
from omnistereo_rigs.formats.fit import Lens, fit_lens
from omnistereo_rigs.formats.opencv import is_opencv, read_opencv
from omnistereo_rigs.formats.table import DIALECTS, UNSTATED, Found, has_list, interpret

_log = logging.getLogger("omnistereo_lib")

OWN = "config.yaml of OmniMVS"
_MAX_SHIFT_S = 1e-3  # between the clocks of cameras; beyond it equal stamps are not one moment


class RigReading(NamedTuple):
    """A rig, and what was assumed in reading it."""

    rig: Rig
    dialect: str  #: its name for people
    in_metres: bool  #: whether the dialect states its unit
    lenses: Sequence[Lens]  #: as the file states them; empty of our format
    residuals_px: Sequence[
        float
    ]  #: of each lens: the largest distance of the fitted camera from it
    #: Seconds to add to the time stamps of each camera, so that equal sums are one moment
    #: (`timeshift_cam_imu` of Kalibr:
    #: t_imu = t_cam + shift). None: the file states none.
    clock_offsets_s: tuple[float, ...] | None = None

    @property
    def is_own(self) -> bool:
        """Whether the file is of our format: there is nothing to convert."""
        return not self.lenses

    def limited(self) -> list[int]:
        """Return the cameras, from 1, that are read only as far as their program can have measured
        them.
        """
        pairs = enumerate(zip(self.lenses, self.rig.cameras, strict=False), 1)
        return [i for i, (lens, camera) in pairs if camera.max_fov_deg == lens.measured_deg]


class _Reader(NamedTuple):
    """A format that is read by code."""

    name: str
    what: str
    recognises: Callable[[dict[str, Any]], bool]
    read: Callable[[Section, Path], Found]
    unit: str = UNSTATED
    settings: bool = False


def _row_readers() -> Iterator[_Reader]:
    for row in DIALECTS:
        unit = row.unit

        def read(data: Section, path: Path, row: Any = row) -> Found:
            return interpret(row, data, path)

        yield _Reader(row.name, row.what, row.recognises, read, unit, row.settings)


_OPENCV = (
    _Reader(
        "COLMAP rig",
        "rig_config.json with the models of its cameras, or with cameras.txt beside it",
        lambda data: has_list("cameras", data, of="image_prefix"),
        colmap.read_rig_config,
    ),
    _Reader(
        "MC-Calib",
        "calibrated_cameras_data.yml, pinhole and fisheye",
        lambda data: (
            isinstance(data.get("camera_0"), dict) and "camera_pose_matrix" in data["camera_0"]
        ),
        read_opencv,
    ),
    _Reader(
        "OpenCV, ROS",
        "K, D, R, T and the size of each camera, or lists of each: fisheye, omnidirectional "
        "(`xi`), plumb_bob or rational; double_sphere, eucm, fov by their parameters; also XML, "
        "TOML, npz",
        is_opencv,
        read_opencv,
    ),
)
# Before OpenCV's, whose keys other dialects have, too, and after those that are only in one.
READERS = (*_row_readers(), *_OPENCV)
_FOLDERS = (
    ("a folder", "`cam1.xml`, `cam1.yaml`, … of any format above, and `poses.txt`"),
    (
        "COLMAP model",
        "a folder with `cameras.txt` and `images.txt`, and `rigs.txt` where there is one",
    ),
)
# What is known, but not read: a pattern for a key of the file, and what to do instead.
_NOT_READ = {
    "project": "PTGui projects are not read: rebuild the lens in Hugin (.pto), which has the same "
    "a, b and c",
    "document|chunk": "Metashape projects are not read: save the calibration of each camera "
    "(Tools)",
    r"Camera[12]?\.fx": "ORB-SLAM settings are not read: write the camchain of Kalibr",
    "camera_intrinsic": "nuScenes' sensors state neither image size nor distortion, and rotation "
    "is w x y z, sensor → car: write K, D, R, T and the size as OpenCV names them",
    "intrinsics|extrinsics": "whether extrinsics are camera → rig, and the order of intrinsics, is "
    "not stated: write K, D, R, T and the size as OpenCV names them",
}
_RIG_FILES = (
    "config.yaml",
    "rig.yaml",
    "calibration.json",
    "calibration.yaml",
    "calibration.toml",
    "rig_config.json",
    "transforms.json",
)
_COLMAP = ("cameras.txt", "images.txt")


def read_any_rig(
    path: str | Path,
    unit: str | None = None,
    max_fov_deg: float | None = None,
    keep_frame: bool = False,
) -> Rig:
    """Read a rig of our format or of another program; the table in book/own_cameras.md lists them.

    Warns of what `osl.load_rig` warns of, of a model that is not stated, of one that a fitted
    camera follows to more than 0.1 px, and of pixels beyond it.

    Args:
        path: File or folder.
        unit: Of the translations, "mm", "cm" or "m": required where the file does not state it.
        max_fov_deg: Full field of view of the lenses, degrees. None: that in the file, else as far
            as image and model reach, up to 220°, and up to 180° where the program cannot have
            measured more (OpenCV, COLMAP, Anipose).
        keep_frame: As for `osl.load_rig`.

    Raises:
        OmnistereoError: If the file is missing, broken or of no known format, or its unit is
            neither stated nor given.

    >>> rig = omnistereo_rigs.read_any_rig("data_samples/sunny/test")
    >>> len(rig)
    4
    """
    return read_rig(path, unit, max_fov_deg, keep_frame).rig


def read_rig(
    path: str | Path,
    unit: str | None = None,
    max_fov_deg: float | None = None,
    keep_frame: bool = False,
) -> RigReading:
    """Read a rig as `read_any_rig` does, with what was assumed, such as
    `RigReading.clock_offsets_s`.
    """
    path = as_path(path)
    check_options(unit, max_fov_deg)
    if (own := _own(path, unit, max_fov_deg)) is not None:
        rig = _finished(own, path, unit, keep_frame)
        return RigReading(rig, own.name, own.in_metres, (), ())
    file, name, in_metres, found = _read(path)
    with error_context(file):
        fitted = _fitted(found.lenses, max_fov_deg)
        T_rig_cam = [Pose(pose.R, found.scale * pose.t) for pose in found.T_rig_cam]
        read = RigFile([camera for camera, _ in fitted], T_rig_cam, name=name, in_metres=in_metres)
    rig = _finished(read, file, unit, keep_frame)
    offsets = None if found.clock_offsets_s is None else tuple(map(float, found.clock_offsets_s))
    _warn_of_clocks(offsets, file)
    return RigReading(rig, name, in_metres, found.lenses, [px for _, px in fitted], offsets)


def read_any_camera(path: str | Path, max_fov_deg: float | None = None) -> OcamCamera:
    """Read one camera: an OCamCalib text file, a lens file, or any supported format that holds one
    camera.

    Args:
        path: The file.
        max_fov_deg: As for `read_any_rig`.
    """
    path = as_path(path)
    if path.suffix == ".txt":
        camera = load_camera(path, max_fov_deg)
        plausible.warn_of_camera(camera, path)
        return camera
    cameras = load_cameras(path, max_fov_deg)
    if len(cameras) != 1:
        raise OmnistereoError(f"{path}: {len(cameras)} cameras; expected one. Use read_any_rig")
    plausible.warn_of_camera(cameras[0], path)
    return cameras[0]


def load_cameras(path: str | Path, max_fov_deg: float | None = None) -> list[OcamCamera]:
    """Read the cameras of a rig file, or of a folder of files of one camera each, without their
    poses.

    Args:
        path, max_fov_deg: As for `read_any_rig`; a folder needs no poses.txt.
    """
    path = as_path(path)
    check_options(None, max_fov_deg)
    files = numbered_files(path, "ocam*.txt", "cam[0-9]*.*") if path.is_dir() else []
    if files and not (path / "config.yaml").exists():
        return [read_any_camera(file, max_fov_deg) for file in files]
    if (own := _own(path, None, max_fov_deg)) is not None:
        return [*own.cameras]
    file, _, _, found = _read(path)
    with error_context(file):
        return [camera for camera, _ in _fitted(found.lenses, max_fov_deg)]


def _finished(found: RigFile, path: Path, unit: str | None, keep_frame: bool) -> Rig:
    """Return the checked rig of what was read, in metres and level."""
    path = found.source or path
    rig = rig_of(found, path, unit)
    with error_context(path):
        _compare_sources(rig, path)
        plausible.check_rig(rig, path)
        low, high = rig.baselines.min(), rig.baselines.max()
        in_unit = "" if found.in_metres else f" in {unit}"
        apart = f"{len(rig)} cameras, {low:.3f} to {high:.3f} m apart"
        _log.info("%s: %s%s, %s", path, found.name, in_unit, apart)
        return rig if keep_frame or found.T_rig_file else plausible.level(rig, path)


def _compare_sources(rig: Rig, path: Path) -> None:
    """Warn if poses.txt and config.yaml stand in one folder and state different poses."""
    folder = path if path.is_dir() else path.parent
    poses_file, config = folder / "poses.txt", folder / "config.yaml"
    if path not in (folder, config) or not (poses_file.exists() and config.exists()):
        return
    used, unused = (config, poses_file) if path == config else (poses_file, config)
    try:
        own = read_own(config, None, None) if unused == config else None
        other = own.T_rig_cam if own else read_poses(unused)
        if len(other) != len(rig):
            raise OmnistereoError(f"{unused.name} has {len(other)} cameras, {used.name} {len(rig)}")
    except OmnistereoError as error:
        text = f"{folder}: {used.name} is used, not {unused.name} beside it: {error}"
        warnings.warn(text, stacklevel=3)
        return
    first, second = ([ps[0].inverse() @ pose for pose in ps] for ps in (rig.T_rig_cam, other))
    if path == config:  # poses.txt does not state its unit: that in which it fits best
        far = [max(float(np.linalg.norm(p.t)) for p in poses) or 1.0 for poses in (first, second)]
        ratio = far[0] / far[1]
        scale = min(METRES_PER_UNIT.values(), key=lambda scale: abs(np.log(ratio / scale)))
        second = [Pose(pose.R, scale * pose.t) for pose in second]
    warn_if_different(first, second, used.name, unused.name, folder)


def formats_table() -> str:
    """Return the formats as the table in book/own_cameras.md, whose test says how it is made."""
    rows = [("format", "what is read", "unit"), ("---",) * 3]
    rows += [
        ("OmniMVS config.yaml", "with the masks beside it, and what `save_rig` writes", "metres")
    ]
    rows += [("OCamCalib text", "a folder with `ocam1.txt`, … and `poses.txt`", UNSTATED)]
    rows += [(reader.name, reader.what, reader.unit) for reader in READERS]
    rows += [(name, what, UNSTATED) for name, what in _FOLDERS]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _supported() -> str:
    names = "; ".join(reader.name for reader in READERS)
    return f"supported formats: {OWN}; {names}; folders with poses.txt or images.txt"


def _own(path: Path, unit: str | None, max_fov_deg: float | None) -> RigFile | None:
    """Return what a file of our format holds, if it is one; its other suffixes are read here."""
    if path.is_dir() or path.suffix in (".txt", ".yaml", ".yml", ".json", ""):
        return read_own(path, unit, max_fov_deg)
    return None


def _fitted(lenses: Sequence[Lens], max_fov_deg: float | None) -> list[tuple[OcamCamera, float]]:
    check_count(len(lenses))
    return [fit_lens(lens, max_fov_deg) for lens in lenses]


def _warn_of_clocks(offsets: tuple[float, ...] | None, path: Path) -> None:
    """Warn where equal time stamps of the cameras are not one moment."""
    if offsets is None:
        return
    late = np.array(offsets) - np.median(offsets)
    worst = int(np.argmax(np.abs(late)))
    if abs(late[worst]) > _MAX_SHIFT_S:
        warnings.warn(
            f"{path}: timeshift_cam_imu of camera {worst + 1} differs by {1000 * late[worst]:.0f} "
            "ms from the others: images of equal time stamps are not of one moment. `omnistereo "
            "record` adds the shifts where stamps are times",
            stacklevel=3,
        )


def _read(path: Path) -> tuple[Path, str, bool, Found]:
    """Return the file that is read, the name of its format, whether it is in metres, and what it
    holds.
    """
    is_folder = path.is_dir()
    if is_folder and (path / "mav0").is_dir():
        path = path / "mav0"
    # A rig_config.json beside a model states the rig itself.
    is_model = is_folder and all((path / name).exists() for name in _COLMAP)
    if path.name in _COLMAP or (is_model and not (path / "rig_config.json").exists()):
        return path, "COLMAP model", False, colmap.read_model(path if is_folder else path.parent)
    if is_folder and (sensors := sorted(path.glob("cam*/sensor.yaml"))):
        return path, "EuRoC folder", True, _read_sensors(path, sensors)
    lenses = numbered_files(path, "cam[0-9]*.*") if is_folder else []
    if lenses and not any((path / name).exists() for name in _RIG_FILES):
        return path, "folder of camera files", False, _read_folder(path, lenses)
    file = _find_rig_file(path) if is_folder else path
    with error_context(file):
        name, in_metres, found = _read_file(file)
    return file, name, in_metres, found


def _read_folder(folder: Path, files: Sequence[Path]) -> Found:
    """Read a folder: `cam1.xml`, `cam1.yaml`, … of any format above, and `poses.txt`."""
    poses, lenses = poses_beside(folder, files), list[Lens]()
    for file in files:
        with error_context(file):
            found = _read_file(file)[2].lenses
            if len(found) != 1:
                raise OmnistereoError(f"{len(found)} cameras; expected one in each file")
            lenses += found
    return Found(lenses, poses)


def _read_sensors(folder: Path, files: Sequence[Path]) -> Found:
    """Read EuRoC's folders: cam0/sensor.yaml, …, each a camera as Kalibr names it, with T_BS."""
    check_count(len(files))
    data = Section({file.parent.name: read_data(file, MAX_BYTES) for file in files})
    row = next(row for row in DIALECTS if row.name == "Kalibr camchain")
    found = interpret(row, data, folder)
    data.warn(folder)
    return found


def _find_rig_file(folder: Path) -> Path:
    found = [name for name in _RIG_FILES if (folder / name).exists()]
    if found:
        if len(found) > 1:
            pass_one = f"{found[0]} is read. Pass the file that is meant"
            warnings.warn(f"{folder}: found {' and '.join(found)}; {pass_one}", stacklevel=3)
        return folder / found[0]
    if (folder / "cameras.bin").exists():
        raise OmnistereoError(
            f"{folder} is a binary model of COLMAP. Type `colmap model_converter --input_path "
            f"{folder} --output_path {folder} --output_type TXT`, or in Python "
            f"pycolmap.Reconstruction({str(folder)!r}).write_text(…)"
        )
    names = sorted(file.name for file in folder.iterdir())[:8]
    raise OmnistereoError(
        f"{folder}: found {names}; expected ocam*.txt or one of {_RIG_FILES}; {_supported()}"
    )


def _read_file(path: Path) -> tuple[str, bool, Found]:
    """Return the name of the format of a file, whether it is in metres, and what the file holds."""
    if path.suffix == ".txt":
        if path.name.startswith("cam"):
            camera = read_ocam_txt(path)
            raise OmnistereoError(
                f"an OCam camera of {camera.image_size}. Rename the files to ocam1.txt, …"
            )
        raise OmnistereoError(
            f"a text file holds one camera or the poses. Pass the folder of a rig; {_supported()}"
        )
    data = _content(path)
    layers = [*_layers(data)]
    found = next(
        ((reader, data) for data in layers for reader in READERS if reader.recognises(data)), None
    )
    if found is None:
        raise OmnistereoError(_unknown(data, layers))
    reader, content = found
    section = Section(content)
    read = reader.read(section, path)
    if settings := section.warn(path, reader.settings):
        _log.info("%s: keys of the program, not of cameras: %s", path, ", ".join(settings))
    return reader.name, reader.unit != UNSTATED, read


def _unknown(data: Any, layers: Sequence[dict[str, Any]]) -> str:
    """Return the message for content that no reader knows: its keys, those of the items of a list,
    and advice.
    """
    listed = data if isinstance(data, list) else []
    keys = sorted(map(str, layers[0] if layers else []))
    inner = sorted({str(key) for item in listed if isinstance(item, dict) for key in item})
    shown = (
        f"a list of {len(listed)} items with the keys {inner[:8]}"
        if inner
        else f"the keys {keys[:8]}"
    )
    deep = sorted(
        {
            str(key)
            for layer in layers
            for value in layer.values()
            if isinstance(value, dict)
            for key in value
        }
    )
    pairs = ((key, do, k) for key, do in _NOT_READ.items() for k in (*keys, *inner, *deep))
    known = next((f". {do}" for key, do, k in pairs if re.fullmatch(key, k)), "")
    return f"unknown format, found {shown}{known}; {_supported()}"


def _content(path: Path) -> Any:
    """Return the content of a file as Python values."""
    suffix = path.suffix.lower()
    if suffix in (".pto", ".ini"):
        return _parse_hugin(read_text(path, MAX_BYTES), suffix)
    if suffix == ".toml":
        # Writers of before NumPy 2 print its numbers as they are, later ones do not.
        text = re.sub(r"\bnp\.(?:float|int)[0-9]*\(([^()\s]+)\)", r"\1", read_text(path, MAX_BYTES))
        try:
            return tomllib.loads(text)
        except (tomllib.TOMLDecodeError, RecursionError) as error:
            raise OmnistereoError(
                f"not valid TOML ({error}). Check that the file is complete"
            ) from None
    if suffix == ".npz":
        return _arrays(read_bytes(path, MAX_BYTES))
    return read_data(path, MAX_BYTES)


def _arrays(content: bytes) -> dict[str, Any]:
    """Return the arrays of an npz file as lists."""
    try:
        with zipfile.ZipFile(BytesIO(content)) as archive:
            if sum(part.file_size for part in archive.infolist()) > MAX_BYTES:
                raise OmnistereoError("the arrays are larger than those of any rig")
        with np.load(BytesIO(content), allow_pickle=False) as arrays:
            return {name: arrays[name].tolist() for name in arrays.files}
    except (
        ValueError,
        OSError,
        zipfile.BadZipFile,
        EOFError,
        KeyError,
        NotImplementedError,
    ) as error:
        reason = "it holds Python objects" if "pickle" in str(error) else str(error)
        raise OmnistereoError(
            f"not an npz file of arrays ({reason}). Write arrays of numbers"
        ) from None


def _layers(data: Any) -> Iterator[dict[str, Any]]:
    """Yield the content of a file as a mapping, and what is in it as long as it only wraps: a list,
    a single key.
    """
    if isinstance(data, list) and (
        rigs := [each for each in data if isinstance(each, dict) and "cameras" in each]
    ):
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


def _parse_hugin(text: str, suffix: str) -> dict[str, str]:
    """Return the lens of a project (.pto) or of a lens file (.ini), by the letters of a project;
    several are refused.
    """
    if suffix == ".ini":
        parser = configparser.ConfigParser(interpolation=None)
        try:
            parser.read_string(text)
            lens = dict(parser["Lens"])
        except (configparser.Error, KeyError) as error:
            found = " ".join(str(error).split())[:200]
            raise OmnistereoError(f"not a lens file of Hugin ({found})") from None
        names = {"image_width": "w", "image_height": "h", "type": "f", "hfov": "v"}
        return {
            names.get(key, key): value for key, value in lens.items() if key in (*names, *"abcdegt")
        }
    lenses: list[dict[str, str]] = []
    pattern = r"\s([whfvabcdegt])(=?-?[0-9.]+(?:[eE][-+]?[0-9]+)?)(?=\s|$)"
    images = [line for line in text.splitlines() if line.startswith("i ")]
    for pairs in (re.findall(pattern, line) for line in images):
        # "=2" is that of another image: only what an image states itself can differ.
        lenses.append({letter: value for letter, value in pairs if not value.startswith("=")})
    for n, lens in enumerate(lenses[1:], 2):
        if any(value != lenses[0].get(letter) for letter, value in lens.items()):
            raise OmnistereoError(
                f"the project has several lenses: image {n} is not of that of the first. Save each "
                "lens by itself (its .ini)"
            )
    return lenses[0] if lenses else {}
