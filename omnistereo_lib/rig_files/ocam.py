"""OCamCalib text files and poses.txt.

OCam files keep (row, column) for the centre, the affine map and the image size; they are swapped to (u, v) and
(width, height) only here, in `ocam_camera` and `ocam_records`.
"""

import logging
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import atomic_write, read_gray, read_text
from omnistereo_lib.geometry.camera import OcamCamera, fit_inverse_polynomial
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.rig_files.camera_models import DEFAULT_FOV_DEG
from omnistereo_lib.rig_files.parse import error_context, metres_per_unit, parse_axis_angle, parse_floats, parse_size

_log = logging.getLogger("omnistereo_lib")

# The five records in file order, with the comment written above each.
_RECORDS = {
    "poly": "direct polynomial, low to high: angle of a radius",
    "inv_poly": "inverse polynomial, low to high: radius of an angle",
    "center": "centre: row, column, counted from 0",
    "affine": "affine map: c, d, e",
    "image_size": "image size: height, width",
}
_MAX_POLYNOMIAL_ERROR = 0.1  # px, between the two polynomials; beyond it a warning


def load_camera(path: str | Path, max_fov_deg: float = DEFAULT_FOV_DEG) -> OcamCamera:
    """Read a camera from an OCamCalib text file.

    Five records, one per line, `#` starts a comment: the direct and the inverse polynomial (each the number of
    coefficients, then the coefficients from low to high), the centre (row, column), the affine c d e, the
    image size (height, width). A missing inverse polynomial is fitted; lines after the fifth record are ignored.

    The file does not state `max_fov_deg`, the full field of view of the lens. OmnistereoError if the polynomials do
    not reach it; UserWarning if they differ by more than 0.1 px anywhere in it.
    """
    camera = _read_camera(path, max_fov_deg)
    warn_of_polynomials([camera], path)
    return camera


def _read_camera(path: str | Path, max_fov_deg: float) -> OcamCamera:
    with error_context(path):
        records: list[Any] = _data_lines(path)
        if len(records) > 1 and (len(records[1]) == 2 or records[1] == ["0"]):
            # Some exports omit the inverse polynomial: the second record is then the centre, of two numbers.
            records = [records[0], None, *records[1 + (records[1] == ["0"]) :]]
        if len(records) < len(_RECORDS):
            raise OmnistereoError(
                f"found {len(records)} records; expected 5: direct polynomial, inverse polynomial, centre, affine, "
                "image size. Check that this is an OCamCalib file and complete"
            )
        return ocam_camera(dict(zip(_RECORDS, records, strict=False)), max_fov_deg, source=str(path))


def write_ocam_txt(camera: OcamCamera, path: str | Path) -> None:
    """Write a camera as an OCamCalib text file, every number in full; field of view and mask are not stored."""
    records = ocam_records(camera)
    text = "\n".join(f"# {title}\n\n{' '.join(map(repr, records[key]))}\n" for key, title in _RECORDS.items())
    with atomic_write(path) as temporary:
        temporary.write_text(text)


def read_ocam_folder(folder: Path, unit: str | None, max_fov_deg: float | None) -> Rig:
    """Read ocam1.txt, ocam2.txt, … and poses.txt (camera → rig), whose unit the files do not state."""
    files = sorted(folder.glob("ocam*.txt"), key=lambda file: (len(file.name), file.name))  # ocam2 before ocam10
    poses_file = folder / "poses.txt"
    with error_context(poses_file):
        poses = [parse_pose(line, camera) for camera, line in enumerate(_data_lines(poses_file), 1)]
        if len(poses) != len(files):
            raise OmnistereoError(
                f"found {len(poses)} poses and {len(files)} camera files "
                f"({', '.join(file.name for file in files)}); expected one line rx ry rz tx ty tz per camera"
            )
        scale = metres_per_unit(unit, np.stack([pose.t for pose in poses]))
    cameras = [_read_camera(file, DEFAULT_FOV_DEG if max_fov_deg is None else max_fov_deg) for file in files]
    warn_of_polynomials(cameras, folder)
    with error_context(folder):
        return Rig(cameras, [Pose(pose.R, pose.t * scale) for pose in poses])


def write_ocam_folder(rig: Rig, folder: str | Path) -> None:
    """Write a rig in the layout of the SweepNet release: ocam1.txt … and poses.txt (camera → rig, metres)."""
    for number, camera in enumerate(rig.cameras, 1):
        write_ocam_txt(camera, Path(folder) / f"ocam{number}.txt")
    lines = [" ".join(map(repr, pose.as_vector().tolist())) for pose in rig.T_rig_cam]
    with atomic_write(Path(folder) / "poses.txt") as temporary:
        temporary.write_text("\n".join(lines) + "\n")


def _data_lines(path: str | Path) -> list[list[str]]:
    """Return the words of every line that is not empty or a comment."""
    lines = [line.split("#")[0].split() for line in read_text(path).splitlines()]
    return [line for line in lines if line]


def parse_pose(values: Any, camera: int) -> Pose:
    """Return the pose of six numbers rx ry rz tx ty tz, camera → rig; errors name the camera."""
    with error_context(f"camera {camera}"):
        vector = parse_floats(values, "the pose rx ry rz tx ty tz", 6)
        parse_axis_angle(vector[:3], "the rotation")
        return Pose.from_vector(vector)


def ocam_records(camera: OcamCamera) -> dict[str, list[float]]:
    """Return a camera as OCam files keep it: count before coefficients, row before column."""
    (u, v), (width, height) = camera.center, camera.image_size
    return {
        "poly": [len(camera.poly), *camera.poly.tolist()],
        "inv_poly": [len(camera.inv_poly), *camera.inv_poly.tolist()],
        "center": [v, u],
        "affine": list(camera.affine),
        "image_size": [height, width],
    }


def ocam_camera(
    records: Mapping[str, Any], max_fov_deg: float, source: str, mask_file: Path | None = None
) -> OcamCamera:
    """Return the camera of five records in file order (row, column); `inv_poly` may be None."""
    poly = _counted(records["poly"], "the direct polynomial")
    row, column = parse_floats(records["center"], "the centre (row, column)", 2).tolist()
    affine = tuple(parse_floats(records["affine"], "the affine map c d e", 3).tolist())
    height, width = parse_size(records["image_size"], "the image size (height, width)")
    if not (0 <= row < height and 0 <= column < width):
        raise OmnistereoError(
            f"the centre, row {row:g} and column {column:g}, lies outside the image of height {height} and "
            f"width {width}. Check that the file is complete and has rows before columns"
        )
    with np.errstate(all="ignore"):  # broken coefficients overflow before they are refused
        if records["inv_poly"] is None:
            _log.info("%s: no inverse polynomial, fitting one", source)
            inv_poly = fit_inverse_polynomial(poly, max_fov_deg, 3 * max(width, height))
        else:
            inv_poly = _counted(records["inv_poly"], "the inverse polynomial")
        mask = None if mask_file is None else read_gray(mask_file, (width, height)) == 0  # not 0 is outside
        camera = OcamCamera(poly, inv_poly, (column, row), affine, (width, height), max_fov_deg, mask)
        _check_polynomials(camera)
    return camera


def _counted(record: Any, name: str) -> NDArray[np.float64]:
    """Return the coefficients of a record that starts with their number."""
    values = parse_floats(record, name)
    if len(values) < 2 or values[0] != len(values) - 1:
        raise OmnistereoError(
            f"{name} has {len(values)} numbers starting with {values[:1]}; expected the number of coefficients, "
            "then the coefficients. Check that the file is complete"
        )
    return values[1:]


def _check_polynomials(camera: OcamCamera) -> None:
    """Refuse an inverse polynomial that is not monotonic within the field of view, or a direct one without a root."""
    angles = np.linspace(0.0, np.radians(camera.max_fov_deg / 2), 1000)
    increasing = np.diff(np.polynomial.polynomial.polyval(angles - np.pi / 2, camera.inv_poly)) > 0
    if not increasing.all():
        raise OmnistereoError(
            f"the inverse polynomial increases only up to {2 * np.degrees(angles[np.argmin(increasing)]):.1f}°; "
            f"expected max_fov_deg = {camera.max_fov_deg:g}. Lower max_fov_deg or recalibrate"
        )
    if not np.isfinite(camera.inverse_poly_error_px()):
        raise OmnistereoError("the direct polynomial has no root for every ray in the field of view. Recalibrate")


def warn_of_polynomials(cameras: Sequence[OcamCamera], source: Path | str) -> None:
    """Warn once if direct and inverse polynomial of some cameras disagree, and say what that means."""
    with np.errstate(all="ignore"):
        errors = {i: camera.inverse_poly_error_px() for i, camera in enumerate(cameras, 1)}
    far_off = [i for i, error in errors.items() if error > _MAX_POLYNOMIAL_ERROR]
    if far_off:
        of_cameras = f" of camera{'s' * (len(far_off) > 1)} {', '.join(map(str, far_off))}" if len(cameras) > 1 else ""
        warnings.warn(
            f"{source}: direct and inverse polynomial (poly, inv_poly){of_cameras} disagree by up to "
            f"{max(errors.values()):.2f} px. Projection uses inv_poly, as every released code does; if poly is the one "
            "that was calibrated, images are warped that far off. Recalibrate, or pass use_direct_poly=True.",
            UserWarning,
            stacklevel=2,
        )
