"""The formats of rig files: detection, reading any of them."""

import logging
import os
from pathlib import Path
from typing import Any

from omnistereo_lib.errors import OmnistereoError, check_number, checked
from omnistereo_lib.files import read_data
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.rig_files.basalt import read_basalt
from omnistereo_lib.rig_files.kalibr import read_kalibr
from omnistereo_lib.rig_files.ocam import read_ocam_folder
from omnistereo_lib.rig_files.omnimvs import read_omnimvs
from omnistereo_lib.rig_files.opencv import opencv_cameras, read_opencv
from omnistereo_lib.rig_files.parse import METRES_PER_UNIT, error_context

_log = logging.getLogger("omnistereo_lib")

_SUPPORTED = """supported formats:
  - a folder with ocam1.txt, ocam2.txt, … and poses.txt (OCamCalib; pass the unit)
  - config.yaml (OmniMVS): a list `cameras` with poly, inv_poly, pose
  - basalt JSON: value0 with T_imu_cam, intrinsics, resolution
  - Kalibr camchain YAML: cam0, cam1, … with camera_model and T_cn_cnm1
  - OpenCV fisheye YAML: K, D, R, T and image_size of each camera (pass the unit)"""
_RIG_FILES = ("config.yaml", "rig.yaml", "calibration.json", "calibration.yaml")  # the first found in a folder
_MAX_BYTES = 1 << 18  # a hundred cameras have 60,000; a megabyte of YAML takes seconds
_FAR = 1000.0  # metres
_METRIC_READERS = {"OmniMVS config.yaml": read_omnimvs, "basalt JSON": read_basalt, "Kalibr camchain": read_kalibr}


@checked
def load_rig(path: str | Path, unit: str | None = None, max_fov_deg: float | None = None) -> Rig:
    """Read a rig of any supported format; the log (`logging`, name "omnistereo_lib") states which.

    Warns if the two polynomials of a camera, or the model in the file and the fitted one, differ by more than 0.1 px.

    Args:
        path: File or folder. In a folder with both, config.yaml is read instead of the OCamCalib text files, because it
            states its unit, unless a unit is given: only the text files need one.
        unit: Unit of the translations: required where the file does not state it, refused where it states another.
        max_fov_deg: Full field of view of the lenses, degrees. None: the value in the file (config.yaml), 220° for OCam
            text files, and for other camera models the choice of `camera_models.fit_ocam`.

    Raises:
        OmnistereoError: If the file is missing, broken or of an unsupported format, or its unit is neither stated nor
            given.
    """
    path = Path(path)
    if unit is not None and unit not in METRES_PER_UNIT:
        raise OmnistereoError(f"unit is {unit!r}; expected one of {list(METRES_PER_UNIT)}")
    if max_fov_deg is not None:
        check_number(max_fov_deg, "max_fov_deg", 1, 360)
    is_folder = os.path.isdir(path)  # False also for a name that no file can have
    if is_folder and list(path.glob("ocam*.txt")) and not (unit is None and (path / "config.yaml").exists()):
        rig, format_name = read_ocam_folder(path, unit, max_fov_deg), f"OCamCalib text files in {unit}"
    else:
        path = _find_rig_file(path) if is_folder else path
        with error_context(path):
            rig, format_name = _read_file(path, unit, max_fov_deg)
    if (far := abs(rig.centers).max()) > _FAR:
        raise OmnistereoError(f"{path}: a camera stands {far:.4g} m from the origin; expected at most {_FAR:g} m")
    low, high = rig.baselines.min(), rig.baselines.max()
    _log.info("%s: %s, %d cameras, %.3f to %.3f m apart", path, format_name, len(rig), low, high)
    return rig


def _find_rig_file(folder: Path) -> Path:
    for name in _RIG_FILES:
        if (folder / name).exists():
            return folder / name
    found = sorted(file.name for file in folder.iterdir())[:8]
    raise OmnistereoError(f"{folder}: found {found}; expected ocam*.txt or one of {_RIG_FILES}; {_SUPPORTED}")


def _read_file(path: Path, unit: str | None, max_fov_deg: float | None) -> tuple[Rig, str]:
    """Return the rig in a file and the name of its format."""
    if path.suffix == ".txt":
        raise OmnistereoError(f"a text file holds one camera or the poses. Pass the folder of a rig; {_SUPPORTED}")
    data = read_data(path, _MAX_BYTES)
    format_name = _detect_format(data)
    if format_name == "OpenCV fisheye":
        return read_opencv(data, path, max_fov_deg, unit), format_name
    if unit not in (None, "m"):
        raise OmnistereoError(f"{format_name} files are in metres by definition. Omit unit={unit!r}")
    return _METRIC_READERS[format_name](data, path, max_fov_deg), format_name


def _detect_format(data: Any) -> str:
    data = data if isinstance(data, dict) else {}
    cameras = data.get("cameras")
    if cameras == [] or (isinstance(cameras, list) and any(isinstance(cam, dict) and "poly" in cam for cam in cameras)):
        return "OmniMVS config.yaml"
    if "value0" in data:
        return "basalt JSON"
    if isinstance(data.get("cam0"), dict) and "camera_model" in data["cam0"]:
        return "Kalibr camchain"
    if opencv_cameras(data):
        return "OpenCV fisheye"
    raise OmnistereoError(f"unknown format, found the keys {sorted(map(str, data))[:8]}; {_SUPPORTED}")
