"""The one format of rigs: config.yaml of OmniMVS, and the releases' OCamCalib text with poses.txt.

Poses are camera → rig. Other programs' files are read by `omnistereo_rigs.read_any_rig`, and turned
into this format, once, by `omnistereo rig IN OUT`.

OCam files keep (row, column) for the centre, the affine map and the image size; they are swapped to
(u, v) and (width, height) only here, in `ocam_camera` and `ocam_records`.
"""

import logging
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError, error_context
from omnistereo_lib.files import as_path, path_within, read_data, to_yaml, write_text
from omnistereo_lib.geometry.camera import OcamCamera, fit_inverse_polynomial
from omnistereo_lib.geometry.field_of_view import DEFAULT_FOV_DEG, Projected, field_of_view_deg
from omnistereo_lib.geometry.pose import Floats, Pose
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.parse import (
    METRES_PER_UNIT,
    RigFile,
    Section,
    check_fov,
    metres_per_unit,
    numbered_lines,
    parse_axis_angle,
    parse_floats,
    parse_size,
)
from omnistereo_lib.pictures import read_gray, write_image

_log = logging.getLogger("omnistereo_lib")

# Between direct and inverse polynomial, or a model and the polynomials fitted to it; beyond it a
# warning.
MAX_ERROR_PX = 0.1
# A hundred cameras have 60,000; a megabyte of YAML takes seconds.
MAX_BYTES = 1 << 18

# The five records in file order, with the comment written above each.
_RECORDS = {
    "poly": "direct polynomial, low to high: angle of a radius",
    "inv_poly": "inverse polynomial, low to high: radius of an angle",
    "center": "centre: row, column, counted from 0",
    "affine": "affine map: c, d, e",
    "image_size": "image size: height, width",
}


def load_rig(path: str | Path, unit: str | None = None, max_fov_deg: float | None = None) -> Rig:
    """Read a rig: a config.yaml, or a folder with one, or with ocam1.txt, … and poses.txt.

    Args:
        path: File or folder. In a folder with both, config.yaml is read, because it states its
            unit, unless a unit is given: only the text files need one.
        unit: "mm", "cm" or "m": that of poses.txt; config.yaml is in metres.
        max_fov_deg: Full field of view of the lenses, degrees. None: the value in the file, else up
            to 220°, as far as the image and the polynomials reach.

    Raises:
        OmnistereoError: If the file is missing, broken or another program's, or its unit is neither
            stated nor given.

    >>> rig = osl.load_rig("data_samples/sunny/test")
    >>> len(rig), rig.cameras[0].image_size
    (4, (800, 768))
    """
    path = as_path(path)
    if unit is not None and unit not in METRES_PER_UNIT:
        raise OmnistereoError(f"unit is {unit!r}; expected one of {list(METRES_PER_UNIT)}")
    if max_fov_deg is not None:
        check_fov(max_fov_deg, "max_fov_deg")
    if path.is_dir() and (path / "config.yaml").exists() and unit is None:
        path = path / "config.yaml"
    if path.is_dir():
        found = read_ocam_folder(path, max_fov_deg)
        scale = metres_per_unit(unit, np.stack([pose.t for pose in found.T_rig_cam]))
    else:
        found, scale = _read_config(path, max_fov_deg), 1.0
        if unit not in (None, "m"):
            raise OmnistereoError(f"{path}: config.yaml is in metres. Omit unit={unit!r}")
    with error_context(path):
        poses = [Pose(pose.R, scale * pose.t) for pose in found.T_rig_cam]
        T_rig_file = found.T_rig_file or Pose.identity()
        return Rig(tuple(found.cameras), tuple(poses), found.min_depth, T_rig_file)


def load_camera(path: str | Path, max_fov_deg: float | None = None) -> OcamCamera:
    r"""Read one camera: an OCamCalib text file.

    Args:
        path: The file.
        max_fov_deg: As for `load_rig`; the file does not state it.

    >>> with open("ocam1.txt", "w") as file:  # without an inverse polynomial, which is fitted
    ...     print("3 -200 0 1e-3", "0", "240 320", "1 0 0", "480 640", sep="\n", file=file)
    >>> osl.load_camera("ocam1.txt", max_fov_deg=180).center  # (u, v); the file has the row first
    (320.0, 240.0)
    """
    path = as_path(path)
    if max_fov_deg is not None:
        check_fov(max_fov_deg, "max_fov_deg")
    if path.suffix != ".txt":
        raise _others_file(path)
    camera = read_ocam_txt(path, max_fov_deg)
    warn_of_polynomials([camera], path)
    return camera


def _others_file(path: Path) -> OmnistereoError:
    return OmnistereoError(
        f"{path} is no config.yaml of OmniMVS and no OCamCalib text file. Other programs' files:"
        f" omnistereo_rigs.read_any_rig reads them, `omnistereo rig {path} rig.yaml` converts them"
    )


def _read_config(path: Path, max_fov_deg: float | None) -> RigFile:
    if path.suffix not in (".yaml", ".yml", ".json"):
        raise _others_file(path)
    data = read_data(path, MAX_BYTES)
    if not is_omnimvs(data):
        raise _others_file(path)
    with error_context(path):
        section = Section(data)
        found = read_omnimvs(section, path, max_fov_deg)
        section.warn(path, False)
    return found


def is_omnimvs(data: Any) -> bool:
    """Return whether the content of a file is that of a config.yaml."""
    cameras = data.get("cameras") if isinstance(data, Mapping) else None
    return cameras == [] or (
        isinstance(cameras, list) and any(isinstance(c, Mapping) and "poly" in c for c in cameras)
    )


def read_ocam_folder(folder: Path, max_fov_deg: float | None) -> RigFile:
    """Read `ocam1.txt`, … and `poses.txt`, a line rx ry rz tx ty tz for each camera."""
    files = sorted(folder.glob("ocam*.txt"), key=lambda file: (len(file.name), file.name))
    if not files:
        raise _others_file(folder)
    poses = read_poses(folder / "poses.txt")
    check_count(poses, files)
    cameras = [read_ocam_txt(file, max_fov_deg) for file in files]
    warn_of_polynomials(cameras, folder)
    return RigFile(cameras, poses)


def read_poses(file: Path) -> list[Pose]:
    """Read poses.txt: camera → rig, in its own unit."""
    poses = []
    with error_context(file):
        for i, (number, words) in enumerate(numbered_lines(file), 1):
            with error_context(f"line {number}, camera {i}"):
                poses.append(parse_pose(words))
    return poses


def check_count(poses: Sequence[Pose], files: Sequence[Path]) -> None:
    """Refuse a poses.txt without exactly one line for each camera."""
    if len(poses) != len(files):
        raise OmnistereoError(
            f"{files[0].parent / 'poses.txt'}: found {len(poses)} poses and {len(files)} camera"
            f" files ({', '.join(file.name for file in files)}); expected one line rx ry rz tx ty"
            " tz per camera"
        )


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
                f"found {len(records)} records; expected 5: direct polynomial, inverse polynomial,"
                " centre, affine, image size. Check that this is an OCamCalib file and complete"
            )
        return ocam_camera(
            dict(zip(_RECORDS, records, strict=False)), max_fov_deg, source=str(path)
        )


def write_ocam_txt(camera: OcamCamera, path: str | Path) -> None:
    """Write a camera as an OCamCalib text file, every number in full; field of view and mask are
    not stored.
    """
    records = ocam_records(camera)
    write_text(
        path,
        "\n".join(
            f"# {title}\n\n{' '.join(map(repr, records[key]))}\n" for key, title in _RECORDS.items()
        ),
    )


def write_ocam_folder(rig: Rig, folder: str | Path) -> None:
    """Write a rig in the layout of the SweepNet release: ocam1.txt … and poses.txt (camera → rig,
    metres).
    """
    for number, camera in enumerate(rig.cameras, 1):
        write_ocam_txt(camera, Path(folder) / f"ocam{number}.txt")
    lines = [" ".join(map(repr, pose.as_vector().tolist())) for pose in rig.T_rig_cam]
    write_text(Path(folder) / "poses.txt", "\n".join(lines) + "\n")


def read_omnimvs(data: Section, path: Path, max_fov_deg: float | None) -> RigFile:
    """Read OmniMVS config.yaml: with the masks beside it, and what `save_rig` writes."""
    cameras, poses, missing = [], [], []
    for i, cam in data.sections("cameras").items():
        with error_context(f"camera {i}"):
            if cam.word("model", default="ocam") != "ocam":
                raise OmnistereoError(
                    f"model is {cam.get('model')!r}; expected ocam. Recalibrate with it"
                )
            records = {key: cam.require(key) for key in ("poly", "center", "affine", "image_size")}
            records["inv_poly"] = cam.get("inv_poly")
            stated = (
                None if cam.get("max_fov") is None else check_fov(cam.number("max_fov"), "max_fov")
            )
            mask = cam.get("invalid_mask")
            mask_file = None if mask is None else path_within(path.parent, mask, path)
            if mask_file is not None and not mask_file.exists():
                missing.append(mask_file.name)
                mask_file = None
            fov = stated if max_fov_deg is None else max_fov_deg
            cameras.append(ocam_camera(records, fov, f"{path}, camera {i}", mask_file))
            poses.append(parse_pose(cam.require("pose")))
    if missing and any(camera.mask is not None for camera in cameras):
        raise OmnistereoError(
            f"the masks {', '.join(missing)} are named, but missing. Copy them beside the file"
        )
    if missing and not re.fullmatch(
        rf"{re.escape(path.stem)}_mask1.png|.*_no_mask1.png", missing[0]
    ):
        warnings.warn(
            f"{path}: the masks {', '.join(missing)} are missing; every pixel counts as valid",
            stacklevel=2,
        )
    warn_of_polynomials(cameras, path)
    config = Section(data.get("config", default={}), "config")
    min_depth = (
        None
        if config.get("omnimvs_sweep_min_depth") is None
        else config.number("omnimvs_sweep_min_depth")
    )
    turned = config.get("T_rig_file")
    return RigFile(cameras, poses, min_depth, None if turned is None else parse_pose(turned))


def save_rig(rig: Rig, path: str | Path) -> None:
    """Write a rig as config.yaml (OmniMVS format, metres), every number in full.

    Masks are written beside it as <name>_mask1.png and so on, bright = outside. The public codes
    need a name even without a mask, and write their own there: <name>_no_mask1.png. They sweep
    around the origin of the file and need a nearest depth: for them, save `rig.recentered()` with a
    `min_depth`.

    >>> osl.save_rig(osl.load_rig("data_samples/sunny/test").recentered(), "rig.yaml")
    >>> bool(np.allclose(osl.load_rig("rig.yaml").centers.mean(axis=0), 0))
    True
    """
    path = as_path(path)
    if path.suffix not in (".yaml", ".yml"):
        raise OmnistereoError(f"{path}: a rig is saved as YAML. Give a file that ends in .yaml")
    cameras, masked = [], any(camera.mask is not None for camera in rig.cameras)
    for i, (camera, pose) in enumerate(zip(rig.cameras, rig.T_rig_cam, strict=True), 1):
        mask_file = path.with_name(f"{path.stem}_{'' if masked else 'no_'}mask{i}.png")
        names = {"cam_id": i, "img_dir": f"cam{i}", "model": "ocam"}
        field = {
            "pose": pose.as_vector().tolist(),
            "max_fov": camera.max_fov_deg,
            "invalid_mask": mask_file.name,
        }
        if masked:
            valid = np.ones(camera.image_size[::-1], bool) if camera.mask is None else camera.mask
            write_image(mask_file, np.where(valid, 0, 255).astype(np.uint8))
        cameras.append(names | ocam_records(camera) | field)
    config = {} if rig.min_depth is None else {"omnimvs_sweep_min_depth": float(rig.min_depth)}
    turned = {} if rig.T_rig_file is None else {"T_rig_file": rig.T_rig_file.as_vector().tolist()}
    data = {
        "config": config | turned,
        # required by the public codes
        "dataset": {"img_fmt": "cam%d/%04d.png", "lut_fmt": "lt_(%d,%d,%d).hwd"},
        "cameras": cameras,
    }
    write_text(path, to_yaml(data))


def parse_pose(values: Any) -> Pose:
    """Return the pose of six numbers rx ry rz tx ty tz, camera → rig."""
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
    records: Mapping[str, Any],
    max_fov_deg: float | None,
    source: str,
    mask_file: Path | None = None,
) -> OcamCamera:
    """Return the camera of five records in file order (row, column).

    `inv_poly` may be None and is then fitted to `poly`. `max_fov_deg` is the full field of view of
    the lens, which the inverse polynomial must reach. None: up to 220°, as far as the image and the
    polynomial do.
    """
    poly = _counted(records["poly"], "the direct polynomial")
    row, column = parse_floats(records["center"], "the centre (row, column)", 2).tolist()
    c, d, e = parse_floats(records["affine"], "the affine map c d e", 3).tolist()
    height, width = parse_size(records["image_size"], "the image size (height, width)")
    with np.errstate(all="ignore"):  # broken coefficients overflow before they are refused
        if records["inv_poly"] is None:
            _log.info("%s: no inverse polynomial, fitting one", source)
            max_radius = 3.0 * max(width, height)
            fov = _direct_reach_deg(poly, max_radius) if max_fov_deg is None else max_fov_deg
            inv_poly = fit_inverse_polynomial(poly, fov, max_radius)
        else:
            inv_poly = _counted(records["inv_poly"], "the inverse polynomial")
        # not 0 is outside
        mask = None if mask_file is None else read_gray(mask_file, (width, height)) == 0
        camera = OcamCamera(poly, inv_poly, (column, row), (c, d, e), (width, height), 1.0, mask)
        return replace(camera, max_fov_deg=_field_of_view(camera, max_fov_deg))


def _field_of_view(camera: OcamCamera, max_fov_deg: float | None) -> float:
    """Return the field of view in degrees, as `ocam_camera` chooses it."""

    def project(rays: Floats) -> Projected:
        n = np.hypot(rays[..., 0], rays[..., 1])
        radius = np.polynomial.polynomial.polyval(np.arctan2(-rays[..., 2], n), camera.inv_poly)
        x, y = (rays[..., k] / np.maximum(n, 1e-300) * radius for k in (0, 1))
        c, d, e = camera.affine
        uv = np.stack([x + e * y + camera.center[0], d * x + c * y + camera.center[1]], -1)
        return uv, np.isfinite(radius)

    if max_fov_deg is None:
        return field_of_view_deg(project, camera.image_size)
    angles = np.linspace(0.0, np.radians(max_fov_deg / 2), 1000)
    increasing = np.diff(np.polynomial.polynomial.polyval(angles - np.pi / 2, camera.inv_poly)) > 0
    if not increasing.all():
        reach = 2 * np.degrees(angles[np.argmin(increasing)])
        raise OmnistereoError(
            f"the inverse polynomial increases only up to {reach:.1f}°; expected the field of view,"
            f" {max_fov_deg:g}°. Lower max_fov_deg (--max-fov {int(reach)})"
        )
    return max_fov_deg


def _direct_reach_deg(poly: Floats, max_radius: float) -> float:
    """Return the full field of view in degrees, at most 220, up to which the direct polynomial is
    monotonic.
    """
    radii = np.linspace(0.0, max_radius, 4096)
    angles = np.arctan2(np.polynomial.polynomial.polyval(radii, poly), radii)
    end = np.argmin(np.append(np.diff(angles) > 0, False))
    return min(DEFAULT_FOV_DEG, float(np.floor(180 + 2 * np.degrees(angles[end]))))


def _counted(record: Any, name: str) -> NDArray[np.float64]:
    """Return the coefficients of a record that starts with their number."""
    values = parse_floats(record, name)
    if len(values) < 2 or values[0] != len(values) - 1:
        raise OmnistereoError(
            f"{name} has {len(values)} numbers starting with {values[:1]}; expected the number of"
            " coefficients, then the coefficients. Check that the file is complete"
        )
    return values[1:]


def warn_of_polynomials(cameras: Sequence[OcamCamera], source: Path | str) -> None:
    """Warn once if direct and inverse polynomial of some cameras disagree where pixels are, and say
    what that means.
    """
    errors = {
        i: error
        for i, camera in enumerate(cameras, 1)
        if (error := _polynomial_error(camera)) > MAX_ERROR_PX
    }
    if not errors:
        return
    of_cameras = (
        f" of camera{'s' * (len(errors) > 1)} {', '.join(map(str, errors))}"
        if len(cameras) > 1
        else ""
    )
    worst = max(errors.values())
    apart = (
        f"by up to {worst:.2f} px"
        if np.isfinite(worst)
        else "so much that poly has no ray for some pixels"
    )
    warnings.warn(
        f"{source}: direct and inverse polynomial (poly, inv_poly){of_cameras} disagree {apart}."
        " Projection uses inv_poly, as every released code does. If poly is the one that was"
        " calibrated, delete inv_poly from the file: it is then fitted to poly",
        UserWarning,
        stacklevel=2,
    )


def _polynomial_error(camera: OcamCamera) -> float:
    """Return `inverse_poly_error_px`, infinite where the direct polynomial ends inside the
    image.
    """
    try:
        with np.errstate(all="ignore"):
            return camera.inverse_poly_error_px()
    except OmnistereoError:
        return float("inf")
