"""Rig and camera files: which dialect one is, and the OCam dialects themselves (the others are in `foreign`).

OCam files keep (row, column) for the centre, the affine map and the image size; here, and nowhere else,
they are swapped to (u, v) and (width, height).
"""

from __future__ import annotations

import json
import logging
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import atomic_write, read_gray, read_text, write_image
from omnistereo_lib.geometry.camera import OcamCamera, fit_inverse_polynomial
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.rig_files.camera_models import DEFAULT_FOV_DEG
from omnistereo_lib.rig_files.foreign import looks_like_opencv, read_basalt, read_kalibr, read_opencv
from omnistereo_lib.rig_files.parse import UNITS, entries, entry, metres_per_unit, naming, numbers, whole_numbers

_log = logging.getLogger("omnistereo_lib")

KNOWN = """known are
  - a folder with ocam1.txt, ocam2.txt, … and poses.txt (OCamCalib; say the unit)
  - config.yaml (OmniMVS): a list `cameras` with poly, inv_poly, pose
  - basalt JSON: value0 with T_imu_cam, intrinsics, resolution
  - Kalibr camchain YAML: cam0, cam1, … with camera_model and T_cn_cnm1
  - OpenCV fisheye YAML: K, D, R, T and image_size of each camera (say the unit)"""
_RIG_FILES = ("config.yaml", "rig.yaml", "calibration.json", "calibration.yaml")  # in a folder, the first counts
_DISAGREEMENT_TO_WARN = 0.1  # px


def load_rig(path: str | Path, unit: str | None = None, max_fov_deg: float | None = None) -> Rig:
    """Read a rig; the log (`logging`, name "omnistereo_lib") says which dialect it is.

    Parameters
    ----------
    path : path
        File or folder of one of the dialects in `KNOWN`. In a folder that has both, config.yaml is taken
        before the text files, because it states its unit, unless a unit is given: only they need one.
    unit : "mm" | "cm" | "m", optional
        Unit of the translations, required where the file does not state it, refused where it states another.
    max_fov_deg : float, optional
        Full field of view of the lenses, in degrees. None: the file's own (config.yaml), 220° for OCam text
        files, and for other lens models what `lenses.fit_ocam` finds.

    Raises
    ------
    OmnistereoError
        If the file is missing, broken or of no known dialect, or its unit is neither stated nor given.

    Warns
    -----
    UserWarning
        If a camera's two polynomials, or the file's lens and the fitted one, differ by more than 0.1 px.
    """
    path = Path(path)
    if unit is not None and unit not in UNITS:
        raise OmnistereoError(f"unit must be one of {list(UNITS)}, got {unit!r}")
    if max_fov_deg is not None and not 0 < max_fov_deg <= 360:
        raise OmnistereoError(f"max_fov_deg must be in (0, 360], got {max_fov_deg}")
    if path.is_dir():
        if list(path.glob("ocam*.txt")) and not (unit is None and (path / "config.yaml").exists()):
            return _load_ocam_folder(path, unit, max_fov_deg)
        path = _rig_file_in(path)
    with naming(path):
        data = _parse(path)
        dialect = _dialect(data)
        if dialect == "OpenCV fisheye":
            rig = read_opencv(data, path, max_fov_deg, unit)
        elif unit in (None, "m"):
            rig = _METRIC_READERS[dialect](data, path, max_fov_deg)
        else:
            raise OmnistereoError(f"{dialect} files are in metres by definition; leave out unit={unit!r}")
    return _announced(rig, path, dialect)


def _announced(rig: Rig, path: Path, dialect: str) -> Rig:
    low, high = rig.baselines.min(), rig.baselines.max()
    _log.info("%s: %s, %d cameras, %.3f to %.3f m apart", path, dialect, len(rig), low, high)
    return rig


def _dialect(data: Any) -> str:
    """Return the name of a parsed file's dialect."""
    data = data if isinstance(data, dict) else {}
    cameras = data.get("cameras")
    if isinstance(cameras, list) and any(isinstance(cam, dict) and "poly" in cam for cam in cameras):
        return "OmniMVS config.yaml"
    if "value0" in data:
        return "basalt JSON"
    if isinstance(data.get("cam0"), dict) and "camera_model" in data["cam0"]:
        return "Kalibr camchain"
    if looks_like_opencv(data):
        return "OpenCV fisheye"
    raise OmnistereoError(f"no known dialect, found the entries {sorted(map(str, data))[:8]}; {KNOWN}")


def _rig_file_in(folder: Path) -> Path:
    for name in _RIG_FILES:
        if (folder / name).exists():
            return folder / name
    found = sorted(file.name for file in folder.iterdir())[:8]
    raise OmnistereoError(f"{folder}: a folder without ocam*.txt or any of {_RIG_FILES}, found {found}; {KNOWN}")


def _parse(path: Path) -> Any:
    """Return the content of a JSON or YAML file as Python values; OpenCV's matrices become their numbers."""
    import yaml

    text = read_text(path)
    if path.suffix == ".txt":
        raise OmnistereoError(f"a text file may hold one camera or the poses; for a rig give its folder. Else {KNOWN}")

    class Loader(yaml.SafeLoader):
        pass

    for tag in ("opencv-matrix", "opencv-nd-matrix"):
        Loader.add_constructor(
            f"tag:yaml.org,2002:{tag}", lambda loader, node: loader.construct_mapping(node, deep=True).get("data")
        )
    try:
        if path.suffix == ".json":
            return json.loads(text)
        # OpenCV before 5 writes "%YAML:1.0" where YAML wants "%YAML 1.0".
        return Loader(re.sub(r"\A\s*%YAML:.*", "", text)).get_single_data()
    except (yaml.YAMLError, ValueError, TypeError, AttributeError, RecursionError) as error:
        what = str(error).replace("\n", " ") or type(error).__name__
        raise OmnistereoError(f"neither sound JSON nor sound YAML ({what}); is it cut short? {KNOWN}") from None


def read_ocam_txt(path: str | Path, max_fov_deg: float = DEFAULT_FOV_DEG) -> OcamCamera:
    """Read a camera from OCamCalib's text file.

    Five records, one per line, `#` starts a comment: the direct polynomial and the inverse one (each its
    number of coefficients, then these from low to high), the centre (row, column), the affine c d e, the
    image size (height, width). A missing inverse polynomial is fitted; lines after the fifth record are ignored.

    Parameters
    ----------
    path : path
    max_fov_deg : float
        Full field of view of the lens, degrees: the file does not state it.

    Raises
    ------
    OmnistereoError
        If the file is missing, cut short or not of this format, or its polynomials do not reach max_fov_deg.

    Warns
    -----
    UserWarning
        If the two polynomials differ by more than 0.1 px anywhere in the field of view.
    """
    path = Path(path)
    with naming(path):
        lines = [line.split("#")[0].split() for line in read_text(path).splitlines()]
        records = [line for line in lines if line]
        if len(records) > 1 and (len(records[1]) == 2 or records[1] == ["0"]):
            # Some exports leave the inverse polynomial out: then a centre of two numbers comes second.
            records = [records[0], None, *records[1 + (records[1] == ["0"]) :]]
        if len(records) < 5:
            raise OmnistereoError(
                f"found {len(records)} records, expected 5: direct polynomial, inverse polynomial, centre, "
                "affine, image size. Is the file cut short, or not OCamCalib's?"
            )
        return _ocam_camera(records[:5], max_fov_deg, source=str(path))


def _ocam_camera(records: list[Any], max_fov_deg: float, source: str, mask_file: Path | None = None) -> OcamCamera:
    """Make a camera of an OCam file's five records, in its (row, column) order; records[1] may be None."""
    poly = _counted(records[0], "the direct polynomial")
    row, column = numbers(records[2], "the centre (row, column)", 2).tolist()
    c, d, e = numbers(records[3], "the affine map c d e", 3).tolist()
    height, width = whole_numbers(records[4], "the image size (height, width)", 2)
    if not (0 <= row < height and 0 <= column < width):
        raise OmnistereoError(
            f"the centre, row {row:g} and column {column:g}, lies outside the image of height {height} and "
            f"width {width}. Is the file cut short, or does it have columns before rows?"
        )
    with np.errstate(all="ignore"):  # broken coefficients overflow on the way to being refused
        if records[1] is None:
            _log.info("%s: no inverse polynomial, fitting one", source)
            inv_poly = fit_inverse_polynomial(poly, max_fov_deg, 3 * max(width, height))
        else:
            inv_poly = _counted(records[1], "the inverse polynomial")
        mask = None
        if mask_file is not None:  # OmniMVS: anything but 0 is outside
            mask = read_gray(mask_file, (width, height)) == 0
        camera = OcamCamera(poly, inv_poly, (column, row), (c, d, e), (width, height), max_fov_deg, mask)
        _check_polynomials(camera, source)
    return camera


def _counted(record: Any, what: str) -> np.ndarray:
    """Return the coefficients of a record that starts with their number."""
    values = numbers(record, what)
    if len(values) < 2 or values[0] != len(values) - 1:
        raise OmnistereoError(
            f"{what} must be its number of coefficients, then these; found {len(values)} numbers, "
            f"starting with {values[:1]}. Is the file cut short?"
        )
    return values[1:]


def _check_polynomials(camera: OcamCamera, source: str) -> None:
    """Refuse an inverse polynomial that turns back within the field of view; warn if the two disagree."""
    angles = np.linspace(0.0, np.radians(camera.max_fov_deg / 2), 1000)
    radii = np.polynomial.polynomial.polyval(angles - np.pi / 2, camera.inv_poly)
    grows = np.diff(radii) > 0
    if not grows.all():
        raise OmnistereoError(
            f"the inverse polynomial must grow up to max_fov_deg = {camera.max_fov_deg:g}, but turns back at "
            f"{2 * np.degrees(angles[np.argmin(grows)]):.1f}°. Lower max_fov_deg or recalibrate."
        )
    disagreement = camera.polynomial_disagreement()
    if not np.isfinite(disagreement):
        raise OmnistereoError("the direct polynomial has no root for every ray in the field of view; recalibrate")
    if disagreement > _DISAGREEMENT_TO_WARN:
        warnings.warn(
            f"{source}: direct and inverse polynomial (poly, inv_poly) disagree by up to {disagreement:.2f} px. "
            "Projection uses inv_poly, as every released code does; exact=True uses poly.",
            UserWarning,
            stacklevel=2,
        )


def write_ocam_txt(camera: OcamCamera, path: str | Path) -> None:
    """Write a camera as OCamCalib's text file, every number in full; it has no field of view and no mask."""
    (u, v), (width, height) = camera.center, camera.image_size
    records = {
        "direct polynomial, low to high: angle of a radius": [len(camera.poly), *camera.poly.tolist()],
        "inverse polynomial, low to high: radius of an angle": [
            len(camera.inv_poly),
            *camera.inv_poly.tolist(),
        ],
        "centre: row, column, counted from 0": [v, u],
        "affine map: c, d, e": list(camera.affine),
        "image size: height, width": [height, width],
    }
    text = "\n".join(f"# {title}\n\n{' '.join(map(repr, values))}\n" for title, values in records.items())
    with atomic_write(path) as temporary:
        temporary.write_text(text)


def write_ocam_folder(rig: Rig, folder: str | Path) -> None:
    """Write a rig as SweepNet's release has it: ocam1.txt … and poses.txt (camera → rig: axis-angle, metres)."""
    lines = []
    for number, (camera, pose) in enumerate(zip(rig.cameras, rig.T_rig_cam, strict=True), start=1):
        write_ocam_txt(camera, Path(folder) / f"ocam{number}.txt")
        lines.append(" ".join(map(repr, pose.as_vector().tolist())))
    with atomic_write(Path(folder) / "poses.txt") as temporary:
        temporary.write_text("\n".join(lines) + "\n")


def _load_ocam_folder(folder: Path, unit: str | None, max_fov_deg: float | None) -> Rig:
    files = sorted(folder.glob("ocam*.txt"), key=lambda file: (len(file.name), file.name))  # ocam2 before ocam10
    poses_file = folder / "poses.txt"
    with naming(poses_file):
        lines = [line.split("#")[0].split() for line in read_text(poses_file).splitlines()]
        poses = [_pose(line, i) for i, line in enumerate(filter(None, lines), 1)]
        if len(poses) != len(files):
            raise OmnistereoError(
                f"found {len(poses)} poses and {len(files)} camera files "
                f"({', '.join(file.name for file in files)}), expected one line rx ry rz tx ty tz per camera"
            )
        scale = metres_per_unit(unit, np.stack([pose.t for pose in poses]))
    cameras = [read_ocam_txt(file, DEFAULT_FOV_DEG if max_fov_deg is None else max_fov_deg) for file in files]
    with naming(folder):
        rig = Rig(cameras, [Pose(pose.R, pose.t * scale) for pose in poses])
    return _announced(rig, folder, f"OCamCalib text files in {unit}")


def _pose(values: Any, camera: int) -> Pose:
    """Return the pose of six numbers rx ry rz tx ty tz, camera → rig; errors name the camera."""
    with naming(f"camera {camera}"):
        vector = numbers(values, "the pose rx ry rz tx ty tz", 6)
        if not np.abs(vector[:3]).max() <= 2 * np.pi:
            raise OmnistereoError(f"the rotation {vector[:3].tolist()} is more than a turn: radians are expected")
        return Pose.from_vector(vector)


def _read_omnimvs(data: dict[str, Any], path: Path, max_fov_deg: float | None) -> Rig:
    """Read OmniMVS's config.yaml: OCam cameras, poses camera → rig, metres; masks where their files exist."""
    cameras, poses = [], []
    for i, cam in enumerate(entries(data, "cameras"), 1):
        with naming(f"camera {i}"):
            records = [entry(cam, key) for key in ("poly", "inv_poly", "center", "affine", "image_size")]
            fov = float(numbers(cam.get("max_fov", DEFAULT_FOV_DEG), "max_fov", 1)[0])
            mask_file = path.parent / str(cam["invalid_mask"]) if cam.get("invalid_mask") else None
            mask_file = mask_file if mask_file and mask_file.exists() else None
            cameras.append(
                _ocam_camera(records, fov if max_fov_deg is None else max_fov_deg, f"{path}, camera {i}", mask_file)
            )
            pose = entry(cam, "pose")
        poses.append(_pose(pose, i))
    settings = data.get("config")
    min_depth = settings.get("omnimvs_sweep_min_depth") if isinstance(settings, dict) else None
    if min_depth is not None:
        min_depth = float(numbers(min_depth, "omnimvs_sweep_min_depth", 1)[0])
    return Rig(cameras, poses, min_depth)


_METRIC_READERS = {"OmniMVS config.yaml": _read_omnimvs, "basalt JSON": read_basalt, "Kalibr camchain": read_kalibr}


def save_rig(rig: Rig, path: str | Path) -> None:
    """Write a rig as config.yaml (OmniMVS dialect, metres), every number in full.

    Masks go beside it as <name>_mask1.png and so on, bright = outside, as the dialect has it. The public
    codes sweep around the file's origin and need a nearest depth: for them, save `rig.centered()` with a
    `min_depth`.

    Raises
    ------
    OmnistereoError
        If the folder is missing or not writable. No half-written file stays.
    """
    import yaml

    path = Path(path)
    cameras = []
    for i, (camera, pose) in enumerate(zip(rig.cameras, rig.T_rig_cam, strict=True), 1):
        mask_file = path.with_name(f"{path.stem}_mask{i}.png")
        if camera.mask is not None:
            write_image(mask_file, np.where(camera.mask, 0, 255).astype(np.uint8))
        else:
            mask_file.unlink(missing_ok=True)  # left by a rig saved here before: it would be read as this one's
        cameras.append(_omnimvs_camera(camera, pose, i) | {"invalid_mask": mask_file.name})
    data = {
        "config": {} if rig.min_depth is None else {"omnimvs_sweep_min_depth": float(rig.min_depth)},
        "dataset": {
            "img_fmt": "cam%d/%04d.png",
            "lut_fmt": "lt_(%d,%d,%d).hwd",
        },  # the public codes ask for these
        "cameras": cameras,
    }
    with atomic_write(path) as temporary:
        temporary.write_text(yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=100))


def _omnimvs_camera(camera: OcamCamera, pose: Pose, number: int) -> dict[str, Any]:
    (u, v), (width, height) = camera.center, camera.image_size
    return {
        "cam_id": number,
        "img_dir": f"cam{number}",
        "model": "ocam",
        "poly": [len(camera.poly), *camera.poly.tolist()],
        "inv_poly": [len(camera.inv_poly), *camera.inv_poly.tolist()],
        "center": [float(v), float(u)],
        "affine": [float(value) for value in camera.affine],
        "image_size": [int(height), int(width)],
        "pose": pose.as_vector().tolist(),
        "max_fov": float(camera.max_fov_deg),
    }
