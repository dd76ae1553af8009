"""Any rig or lens file, of our format and of other programs, as a rig of OCam cameras."""

import logging
import re
import tomllib
import warnings
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from omnistereo_lib.errors import OmnistereoError, error_context
from omnistereo_lib.files import as_path, read_bytes, read_data, read_text
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.parse import Section, check_count, is_irrelevant, warn_if_different
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
from omnistereo_rigs.formats import plausible
from omnistereo_rigs.formats.dialects import DIALECTS
from omnistereo_rigs.formats.fit import Lens, fit_lens
from omnistereo_rigs.formats.table import METRES, Dialect, Found, interpret

_log = logging.getLogger("omnistereo_lib")

_ROWS = {row.name: row for row in DIALECTS}
_SUPPORTED = f"supported formats: OmniMVS config.yaml; {'; '.join(_ROWS)}; folders with poses.txt"
_RIG_FILES = ["config.yaml", "rig.yaml", "calibration.json", "calibration.yaml", "calibration.toml"]
_RIG_FILES += ["rig_config.json", "transforms.json"]
_COLMAP = ("cameras.txt", "images.txt")
_FAR = 1000.0  # metres
_MAX_SHIFT_S = 1e-3  # between the clocks of cameras; beyond it equal stamps are not one moment


class RigReading(NamedTuple):
    """A rig, and what was assumed in reading it."""

    rig: Rig
    found: Found  #: as the file states it; without lenses if it is of our format
    residuals_px: Sequence[float]  #: of each lens: the largest distance of the fitted camera

    @property
    def is_own(self) -> bool:
        """Whether the file is of our format: there is nothing to convert."""
        return not self.found.lenses

    def limited(self) -> list[int]:
        """Return the cameras, from 1, that end where their program can have measured them."""
        pairs = enumerate(zip(self.found.lenses, self.rig.cameras, strict=False), 1)
        return [i for i, (lens, camera) in pairs if camera.max_fov_deg == lens.measured_deg]


def read_any_rig(
    path: str | Path,
    unit: str | None = None,
    max_fov_deg: float | None = None,
    keep_frame: bool = False,
) -> Rig:
    """Read a rig of our format or of another program; the table in book/own_cameras.md lists them.

    Warns of what `osl.load_rig` warns of, of a lens that a fitted camera follows to more than
    0.1 px, and of pixels beyond its model.

    Args:
        path: File or folder.
        unit: Of the translations, "mm", "cm" or "m": required where the file does not state it.
        max_fov_deg: Full field of view of the lenses, degrees. None: that in the file, else as far
            as image and model reach, up to 220°, and up to 180° where the program cannot have
            measured more (OpenCV, COLMAP, the fisheye of Kalibr).
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
    """Read a rig as `read_any_rig` does, and what was assumed, as `Found.clock_offsets_s`."""
    path = as_path(path)
    check_options(unit, max_fov_deg)
    if (own := read_own(path, unit, max_fov_deg)) is not None:
        rig = _finished(own, path, unit, keep_frame)
        return RigReading(rig, Found(own.name, unit="metres" if own.in_metres else ""), ())
    file, found = _read(path)
    with error_context(file):
        cameras, residuals = zip(*_fitted(found, max_fov_deg), strict=True)
        scale = METRES.get(found.unit, 1.0)
        poses = [Pose(pose.R, scale * pose.t) for pose in found.T_rig_cam]
        read = RigFile(cameras, poses, name=found.name, in_metres=found.unit != "")
    rig = _finished(read, file, unit, keep_frame)
    _warn_of_clocks(found.clock_offsets_s, file)
    return RigReading(rig, found, residuals)


def read_any_camera(path: str | Path, max_fov_deg: float | None = None) -> OcamCamera:
    """Read one camera: an OCamCalib text file, or any supported format that holds one.

    Args:
        path: The file.
        max_fov_deg: As for `read_any_rig`.
    """
    path = as_path(path)
    is_text = path.suffix == ".txt"
    cameras = [load_camera(path, max_fov_deg)] if is_text else load_cameras(path, max_fov_deg)
    if len(cameras) != 1:
        raise OmnistereoError(f"{path}: {len(cameras)} cameras; expected one. Use read_any_rig")
    plausible.check_cameras(cameras, path)
    return cameras[0]


def load_cameras(path: str | Path, max_fov_deg: float | None = None) -> list[OcamCamera]:
    """Read the cameras of a rig file, or of a folder of lens files, without their poses.

    Args:
        path, max_fov_deg: As for `read_any_rig`; a folder needs no poses.txt.
    """
    path = as_path(path)
    check_options(None, max_fov_deg)
    files = numbered_files(path, "ocam*.txt", "cam[0-9]*.*") if path.is_dir() else []
    if files and not (path / "config.yaml").exists():
        return [read_any_camera(file, max_fov_deg) for file in files]
    if (own := read_own(path, None, max_fov_deg)) is not None:
        return [*own.cameras]
    file, found = _read(path)
    with error_context(file):
        return [camera for camera, _ in _fitted(found, max_fov_deg)]


def _fitted(found: Found, max_fov_deg: float | None) -> list[tuple[OcamCamera, float]]:
    check_count(len(found.lenses))
    return [fit_lens(lens, max_fov_deg) for lens in found.lenses]


def _finished(found: RigFile, path: Path, unit: str | None, keep_frame: bool) -> Rig:
    """Return the checked rig of what was read, in metres and level."""
    path = found.source or path
    rig = rig_of(found, path, unit)
    with error_context(path):
        _compare_sources(rig, path)
        if (far := np.abs(rig.centers).max()) > _FAR:
            raise OmnistereoError(
                f"a camera stands {far:.4g} m from the origin; expected at most {_FAR:g} m"
            )
        plausible.check_cameras(rig.cameras, path)
        plausible.check_poses(rig, path)
        low, high = rig.baselines.min(), rig.baselines.max()
        in_unit = "" if found.in_metres else f" in {unit}"
        apart = f"{len(rig)} cameras, {low:.3f} to {high:.3f} m apart"
        _log.info("%s: %s%s, %s", path, found.name, in_unit, apart)
        return rig if keep_frame or found.T_rig_file else plausible.level(rig, path)


def _compare_sources(rig: Rig, path: Path) -> None:
    """Warn if poses.txt and config.yaml of one folder state different poses, in any unit."""
    folder = path if path.is_dir() else path.parent
    poses_file, config = folder / "poses.txt", folder / "config.yaml"
    if path not in (folder, config) or not (poses_file.exists() and config.exists()):
        return
    used, unused = (config, poses_file) if path == config else (poses_file, config)
    own = read_own(config, None, None) if unused == config else None
    other = own.T_rig_cam if own else read_poses(unused)
    if len(other) != len(rig):
        counts = f"{unused.name} has {len(other)} cameras, {used.name} {len(rig)}"
        warnings.warn(f"{folder}: {used.name} is used: {counts}", stacklevel=3)
        return
    sizes, relative = [], []
    for poses in (rig.T_rig_cam, other):
        relative.append([poses[0].inverse() @ pose for pose in poses])
        sizes.append(max(float(np.linalg.norm(pose.t)) for pose in relative[-1]) or 1.0)
    scaled = [Pose(pose.R, sizes[0] / sizes[1] * pose.t) for pose in relative[1]]
    warn_if_different(relative[0], scaled, used.name, unused.name, folder)


def _warn_of_clocks(offsets: Sequence[float] | None, path: Path) -> None:
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


def _read(path: Path) -> tuple[Path, Found]:
    """Return the file or folder that is read, and what it holds."""
    is_folder = path.is_dir()
    if is_folder and (path / "mav0").is_dir():
        path = path / "mav0"
    names = [name for name in _RIG_FILES if (path / name).exists()] if is_folder else []
    # A rig_config.json beside a model states the rig itself.
    is_model = is_folder and all((path / name).exists() for name in _COLMAP)
    if path.name in _COLMAP or (is_model and "rig_config.json" not in names):
        folder = path if is_folder else path.parent
        return folder, _interpreted(_ROWS["COLMAP model"], {}, folder)
    if is_folder and (path / "cameras.bin").exists() and find_spec("pycolmap"):
        import pycolmap

        with error_context(path), TemporaryDirectory() as text:
            pycolmap.Reconstruction(path).write_text(text)
            return path, _interpreted(_ROWS["COLMAP model"], {}, Path(text))
    if is_folder and (files := sorted(path.glob("cam*/sensor.yaml"))):  # EuRoC's
        check_count(len(files))
        data = {file.parent.name: read_data(file, MAX_BYTES) for file in files}
        return path, _interpreted(_ROWS["Kalibr camchain"], data, path)
    if is_folder and not names and (files := numbered_files(path, "cam[0-9]*.*")):
        poses, lenses = poses_beside(path, files), list[Lens]()
        for file in files:
            found = _read_file(file).lenses
            if len(found) != 1:
                raise OmnistereoError(f"{file}: {len(found)} cameras; expected one in each file")
            lenses += found
        return path, Found("folder of camera files", lenses, poses)
    if len(names) > 1:
        pass_one = f"{names[0]} is read. Pass the file that is meant"
        warnings.warn(f"{path}: found {' and '.join(names)}; {pass_one}", stacklevel=3)
    file = path / names[0] if names else path
    if file.is_dir():
        raise _no_rig(file)
    return file, _read_file(file)


def _no_rig(folder: Path) -> OmnistereoError:
    if (folder / "cameras.bin").exists():
        return OmnistereoError(
            f"{folder} is a binary model of COLMAP. Install pycolmap, or type `colmap "
            f"model_converter --input_path {folder} --output_path {folder} --output_type TXT`"
        )
    names = sorted(file.name for file in folder.iterdir())[:8]
    return OmnistereoError(
        f"{folder}: found {names}; expected ocam*.txt or one of {_RIG_FILES}; {_SUPPORTED}"
    )


def _interpreted(row: Dialect, content: dict[str, Any], path: Path) -> Found:
    with error_context(path):
        section = Section(content)
        found = interpret(row, section, path)
        if settings := section.warn(path, row.settings):
            _log.info("%s: keys of the program, not of cameras: %s", path, ", ".join(settings))
    return found


def _read_file(path: Path) -> Found:
    with error_context(path):
        if path.suffix == ".txt":
            raise OmnistereoError(
                "a text file holds one OCam camera, ocam1.txt, …, or the poses. Pass the folder of "
                f"a rig; {_SUPPORTED}"
            )
        data = _content(path)
        layers = [*_layers(data)]
    for content in layers:
        for row in DIALECTS:
            if row.recognises(content):
                return _interpreted(row, content, path)
    top = data if isinstance(data, dict) else {}
    listed = data if isinstance(data, list) else top.values()
    keys = sorted(map(str, top))[:8]
    inner = sorted({str(key) for item in listed if isinstance(item, dict) for key in item})[:8]
    raise OmnistereoError(
        f"{path}: unknown format, found the keys {keys}, and in them {inner}. Write K, D, R, T and "
        f"the size of each camera as OpenCV names them; {_SUPPORTED}"
    )


def _content(path: Path) -> Any:
    """Return the content of a file as Python values."""
    suffix = path.suffix.lower()
    try:
        if suffix == ".toml":
            # Writers of before NumPy 2 print its numbers as they are, later ones do not.
            number = r"\bnp\.(?:float|int)[0-9]*\(([^()\s]+)\)"
            return tomllib.loads(re.sub(number, r"\1", read_text(path, MAX_BYTES)))
        if suffix == ".npz":
            with np.load(BytesIO(read_bytes(path, MAX_BYTES)), allow_pickle=False) as arrays:
                if sum(part.file_size for part in arrays.zip.infolist()) > MAX_BYTES:
                    raise OmnistereoError("the arrays are larger than those of any rig")
                return {name: arrays[name].tolist() for name in arrays.files}
    except OmnistereoError:
        raise
    except Exception as error:  # of any kind, where bytes are damaged
        kind = "valid TOML" if suffix == ".toml" else "an npz file of arrays"
        reason = "it holds Python objects" if "pickle" in str(error) else error
        raise OmnistereoError(f"not {kind} ({reason}). Check that the file is complete") from None
    return read_data(path, MAX_BYTES)


def _layers(data: Any) -> Iterator[dict[str, Any]]:
    """Yield the content as a mapping, and what is in it while it only wraps a list or a key."""
    if isinstance(data, list):
        rigs = [each for each in data if isinstance(each, dict) and "cameras" in each]
        if len(rigs) > 1:
            raise OmnistereoError(f"the file holds {len(rigs)} rigs; expected one. Delete others")
        data = rigs[0] if rigs else {"cameras": data}
    while isinstance(data, dict):
        yield data
        inner = [value for key, value in data.items() if not is_irrelevant(key, value)]
        data = inner[0] if len(inner) == 1 else None
        if isinstance(data, list):
            data = {f"cam{n}": value for n, value in enumerate(data)}
