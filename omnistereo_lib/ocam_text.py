"""OCam cameras as files keep them: five records, in OCamCalib's text or in a config.yaml.

They keep (row, column) for the centre, the affine map and the image size, which are swapped to (u,
v) and (width, height) only here, in `ocam_camera` and `ocam_records`.
"""

import logging
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyval

from omnistereo_lib.errors import OmnistereoError, error_context
from omnistereo_lib.files import write_text
from omnistereo_lib.geometry.camera import OcamCamera, fit_inverse_polynomial
from omnistereo_lib.geometry.field_of_view import DEFAULT_FOV_DEG, Projected, field_of_view_deg
from omnistereo_lib.geometry.pose import Floats
from omnistereo_lib.parse import numbered_lines, parse_floats, parse_size
from omnistereo_lib.pictures import read_gray

_log = logging.getLogger("omnistereo_lib")

# Between the two polynomials, or a fitted lens and its model; beyond it a warning.
MAX_ERROR_PX = 0.1
# The five records in file order, with the comment written above each.
_RECORDS = {
    "poly": "direct polynomial, low to high: angle of a radius",
    "inv_poly": "inverse polynomial, low to high: radius of an angle",
    "center": "centre: row, column, counted from 0",
    "affine": "affine map: c, d, e",
    "image_size": "image size: height, width",
}


def read_ocam_txt(path: str | Path, max_fov_deg: float | None = None) -> OcamCamera:
    """Read a camera from an OCamCalib text file.

    Five records, one per line, `#`, `%` or `//` starts a comment: the direct and the inverse
    polynomial (each the number of coefficients, then the coefficients from low to high), the centre
    (row, column), the affine c d e, the image size (height, width). A missing inverse polynomial is
    fitted; lines after the fifth record are ignored. For `max_fov_deg` see `ocam_camera`.
    """
    with error_context(path):
        records: list[Any] = [words for _, words in numbered_lines(path)]
        if len(records) > 1 and (len(records[1]) == 2 or records[1] == ["0"]):
            # Some exports omit the inverse polynomial: the second record is then the centre, of two
            # numbers.
            records = [records[0], None, *records[1 + (records[1] == ["0"]) :]]
        if len(records) < len(_RECORDS):
            raise OmnistereoError(
                f"found {len(records)} records; expected 5: direct polynomial, inverse polynomial, "
                "centre, affine, image size. Check that this is an OCamCalib file and complete"
            )
        return ocam_camera(
            dict(zip(_RECORDS, records, strict=False)), max_fov_deg, source=str(path)
        )


def write_ocam_txt(camera: OcamCamera, path: str | Path) -> None:
    """Write a camera as OCamCalib text, numbers in full; field of view and mask are not stored."""
    records = ocam_records(camera)
    texts = [
        f"# {title}\n\n{' '.join(map(repr, records[key]))}\n" for key, title in _RECORDS.items()
    ]
    write_text(path, "\n".join(texts))


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
    records: Mapping[str, Any],
    max_fov_deg: float | None,
    source: str,
    mask_file: Path | None = None,
) -> OcamCamera:
    """Return the camera of five records in file order (row, column).

    `inv_poly` may be None and is then fitted to `poly`. `max_fov_deg` is the full field of view of
    the lens, which the inverse polynomial must reach. None: up to 220°, as far as the image and the
    polynomial do. An `OmnistereoError` refuses a direct polynomial with
    a linear term, which OCam's has not, and an inverse one that does not invert it.
    """
    poly = _counted(records["poly"], "the direct polynomial")
    row, column = parse_floats(records["center"], "the centre (row, column)", 2).tolist()
    affine = parse_floats(records["affine"], "the affine map c d e", 3).tolist()
    height, width = parse_size(records["image_size"], "the image size (height, width)")
    side = max(width, height)
    if abs(poly[1]) > 1e-6 / side * abs(poly[0]):
        raise OmnistereoError(
            f"the direct polynomial is {poly.tolist()}; expected a0 0 a2 a3 …: OCam has no linear "
            "term. If these are the four numbers of MATLAB's MappingCoefficients, a0 a2 a3 a4, "
            "put the missing 0 behind the first, and 5 as their number"
        )
    with np.errstate(all="ignore"):  # broken coefficients overflow before they are refused
        if records["inv_poly"] is None:
            _log.info("%s: no inverse polynomial, fitting one", source)
            fov = _direct_reach_deg(poly, 3.0 * side) if max_fov_deg is None else max_fov_deg
            inv_poly = fit_inverse_polynomial(poly, fov, 3.0 * side)
        else:
            inv_poly = _counted(records["inv_poly"], "the inverse polynomial")
            _check_inverse(poly, inv_poly, side / 2)
        # Not 0 is outside.
        mask = None if mask_file is None else read_gray(mask_file, (width, height)) == 0
        c, d, e = affine
        camera = OcamCamera(poly, inv_poly, (column, row), (c, d, e), (width, height), 1.0, mask)
        return replace(camera, max_fov_deg=_field_of_view(camera, max_fov_deg))


def _check_inverse(poly: Floats, inv_poly: Floats, reach: float) -> None:
    """Raise an `OmnistereoError` if the polynomials differ in the inner half of the image as
    conventions do.

    Two of one calibration differ by less than 1 % there, those of released files by 0.02 %.
    """
    radii = np.linspace(0, reach / 2, 64)
    t = np.arctan2(polyval(radii, poly), radii)
    if poly[0] >= 0 or not (np.diff(t) > 0).all():
        return  # `OcamCamera` says it
    if not float(np.median(np.abs(polyval(t, inv_poly) - radii))) < 0.05 * reach:
        raise OmnistereoError(
            "the inverse polynomial (inv_poly) is not the inverse of poly; expected r(t) with "
            "t = -π/2 on the axis, in radians, coefficients from low to high. If poly is right, "
            "leave inv_poly out: it is then fitted"
        )


def _field_of_view(camera: OcamCamera, max_fov_deg: float | None) -> float:
    """Return the field of view, or the one given if the inverse polynomial reaches as far."""

    def project(rays: Floats) -> Projected:
        n = np.hypot(rays[..., 0], rays[..., 1])
        radius = polyval(np.arctan2(-rays[..., 2], n), camera.inv_poly)
        x, y = (rays[..., k] / np.maximum(n, 1e-300) * radius for k in (0, 1))
        c, d, e = camera.affine
        uv = np.stack([x + e * y + camera.center[0], d * x + c * y + camera.center[1]], -1)
        return uv, np.isfinite(radius)

    if max_fov_deg is None:
        return field_of_view_deg(project, camera.image_size)
    angles = np.linspace(0.0, np.radians(max_fov_deg / 2), 1000)
    increasing = np.diff(polyval(angles - np.pi / 2, camera.inv_poly)) > 0
    if not increasing.all():
        reach = 2 * np.degrees(angles[np.argmin(increasing)])
        raise OmnistereoError(
            f"the inverse polynomial increases only up to {reach:.1f}°; expected the field of "
            f"view, {max_fov_deg:g}°. Lower max_fov_deg (`omnistereo rig --max-fov {int(reach)}`)"
        )
    return max_fov_deg


def _direct_reach_deg(poly: Floats, max_radius: float) -> float:
    """Return the full field of view, at most 220°, up to which the direct polynomial grows."""
    radii = np.linspace(0.0, max_radius, 4096)
    angles = np.arctan2(polyval(radii, poly), radii)
    end = np.argmin(np.append(np.diff(angles) > 0, False))
    return min(DEFAULT_FOV_DEG, float(np.floor(180 + 2 * np.degrees(angles[end]))))


def _counted(record: Any, name: str) -> Floats:
    """Return the coefficients of a record that starts with their number."""
    values = parse_floats(record, name)
    if len(values) < 2 or values[0] != len(values) - 1:
        raise OmnistereoError(
            f"{name} has {len(values)} numbers starting with {values[:1]}; expected the number of "
            "coefficients, then the coefficients. Check that the file is complete"
        )
    return values[1:]


def warn_of_polynomials(cameras: Sequence[OcamCamera], source: Path | str) -> None:
    """Warn once if the polynomials of some cameras disagree, and say what that means."""
    found = {i: _polynomial_error(camera) for i, camera in enumerate(cameras, 1)}
    errors = {i: error for i, error in found.items() if error > MAX_ERROR_PX}
    if not errors:
        return
    numbers = f" of camera{'s' * (len(errors) > 1)} {', '.join(map(str, errors))}"
    worst = max(errors.values())
    is_finite = np.isfinite(worst)
    apart = (
        f"by up to {worst:.2f} px" if is_finite else "so much that poly has no ray for some pixels"
    )
    warnings.warn(
        f"{source}: direct and inverse polynomial (poly, inv_poly){numbers * (len(cameras) > 1)} "
        f"disagree {apart}. Projection uses inv_poly, as every released code does. If poly is the "
        "one that was calibrated, delete inv_poly from the file: it is then fitted to poly",
        UserWarning,
        stacklevel=2,
    )


def _polynomial_error(camera: OcamCamera) -> float:
    """Return `inverse_poly_error_px`, infinite where poly ends inside the image."""
    try:
        with np.errstate(all="ignore"):
            return camera.inverse_poly_error_px()
    except OmnistereoError:
        return float("inf")
