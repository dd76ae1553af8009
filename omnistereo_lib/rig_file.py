"""The one rig format inside: config.yaml of OmniMVS, and OCamCalib's text with poses.txt of the
releases.

Poses are camera → rig. OCam files keep (row, column) for the centre, the affine map and the image
size; `ocam_text` swaps them to (u, v) and (width, height). Files of other programs are read by
`omnistereo_rigs.read_any_rig`.
"""

import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from omnistereo_lib.errors import OmnistereoError, error_context
from omnistereo_lib.files import as_path, path_within, read_data, to_yaml, write_text
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.rig import Deviation, Rig
from omnistereo_lib.ocam_text import (
    ocam_camera,
    ocam_records,
    read_ocam_txt,
    warn_of_polynomials,
    write_ocam_txt,
)
from omnistereo_lib.parse import (
    METRES_PER_UNIT,
    Section,
    check_count,
    check_fov,
    metres_per_unit,
    numbered_lines,
    parse_axis_angle,
    parse_floats,
)
from omnistereo_lib.pictures import write_image

# 64 cameras have 90,000 bytes. Of YAML, the parser reads as many in about 2 s.
MAX_BYTES = 1 << 17
_OWN_FILES = ("config.yaml", "rig.yaml")


class RigFile(NamedTuple):
    """What a reader finds in a file."""

    cameras: Sequence[OcamCamera]
    #: camera → rig, in the unit of the file; none of one camera by itself
    T_rig_cam: Sequence[Pose] = ()
    min_depth: float | None = None  #: metres
    T_rig_file: Pose | None = None  #: see `Rig`
    deviations: Sequence[Deviation] = ()  #: of the cameras, or none
    name: str = "OmniMVS config.yaml"  #: of its format, for people
    in_metres: bool = True  #: else the file does not state its unit
    source: Path | None = None  #: the file or folder that was read


def load_rig(path: str | Path, unit: str | None = None, max_fov_deg: float | None = None) -> Rig:
    """Read a rig: a config.yaml as `save_rig` writes it, or a folder with one, or with ocam1.txt.

    Warns of keys that are not read, and of two polynomials that differ by more than 0.1 px inside
    the image. `omnistereo_rigs.read_any_rig` reads files of other programs, and turns a rig level.

    Args:
        path: File or folder. In a folder with both, config.yaml is read, because it states its
            unit, unless a unit is given: only the text files, with poses.txt, need one.
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
    check_options(unit, max_fov_deg)
    found = read_own(path, unit, max_fov_deg)
    if found is None:
        raise OmnistereoError(
            f"{path} is no config.yaml of OmniMVS and no folder of ocam*.txt and poses.txt. A rig "
            f"of another program: `omnistereo rig {path} rig.yaml` converts it, "
            "omnistereo_rigs.read_any_rig reads it"
        )
    return rig_of(found, path, unit)


def rig_of(found: RigFile, path: Path, unit: str | None) -> Rig:
    """Return the rig of what was read, in metres."""
    with error_context(found.source or path):
        if len(found.cameras) == 1:
            raise OmnistereoError(
                f"{found.name} of one camera; a rig needs at least 2 cameras with their poses. "
                "`omnistereo_rigs.read_any_camera` reads it; put cam1, cam2, … and poses.txt (rx "
                "ry rz tx ty tz, camera → rig) into a folder, and pass the folder"
            )
        if found.in_metres and unit not in (None, "m"):
            stated = f"{found.name} files state their unit by definition"
            raise OmnistereoError(f"{stated}. Omit unit={unit!r}")
        T_rig_file = found.T_rig_file or Pose.identity()
        rig = Rig(found.cameras, found.T_rig_cam, found.min_depth, T_rig_file, found.deviations)
        scale = 1.0 if found.in_metres else metres_per_unit(unit, rig.centers)
        return rig.with_poses([Pose(pose.R, scale * pose.t) for pose in rig.T_rig_cam])


def load_camera(path: str | Path, max_fov_deg: float | None = None) -> OcamCamera:
    r"""Read one camera from an OCamCalib text file; `omnistereo_rigs.read_any_camera` reads other
    lens files.

    Args:
        path: The file.
        max_fov_deg: As for `load_rig`.

    >>> with open("ocam1.txt", "w") as file:  # without an inverse polynomial, which is fitted
    ...     print("3 -200 0 1e-3", "0", "240 320", "1 0 0", "480 640", sep="\n", file=file)
    >>> osl.load_camera("ocam1.txt", max_fov_deg=180).center  # (u, v); the file has the row first
    (320.0, 240.0)
    """
    path = as_path(path)
    check_options(None, max_fov_deg)
    if path.suffix != ".txt":
        raise OmnistereoError(
            f"{path}: expected a text file of OCamCalib. omnistereo_rigs.read_any_camera reads "
            "other lens files, and `omnistereo rig IN OUT` converts a rig"
        )
    camera = read_ocam_txt(path, max_fov_deg)
    warn_of_polynomials([camera], path)
    return camera


def check_options(unit: str | None, max_fov_deg: float | None) -> None:
    """Raise an `OmnistereoError` for a unit or a field of view that cannot be."""
    if unit is not None and unit not in METRES_PER_UNIT:
        raise OmnistereoError(f"unit is {unit!r}; expected one of {list(METRES_PER_UNIT)}")
    if max_fov_deg is not None:
        check_fov(max_fov_deg, "max_fov_deg")


def read_own(path: Path, unit: str | None, max_fov_deg: float | None) -> RigFile | None:
    """Return what a path of our formats holds, see `load_rig`; None: of another format."""
    config = path
    if path.is_dir():
        config = next((path / name for name in _OWN_FILES if (path / name).exists()), path)
        lenses = numbered_files(path, "ocam*.txt")
        if lenses and (unit is not None or config.name != "config.yaml"):
            return _read_folder(path, lenses, max_fov_deg)
        if config == path:
            return None
    with error_context(config):
        if config.suffix == ".txt" and config.name not in ("cameras.txt", "images.txt"):
            raise OmnistereoError(
                "a text file holds one camera or the poses. Pass the folder of a rig"
            )
        if config.suffix not in (".yaml", ".yml", ".json", ""):
            return None
        data = read_data(config, MAX_BYTES)
        if not is_omnimvs(data):
            return None
        return read_omnimvs(Section(data), config, max_fov_deg)._replace(source=config)


def is_omnimvs(data: Any) -> bool:
    """Return whether the content of a file is a config.yaml of OmniMVS, or begins to be one."""
    cameras = data.get("cameras") if isinstance(data, dict) else None
    if not isinstance(cameras, list):
        return False
    return cameras == [] or any(isinstance(cam, dict) and "poly" in cam for cam in cameras)


def numbered_files(folder: Path, *patterns: str) -> list[Path]:
    """Return the files of the first pattern that has some, by their numbers: 2 before 10."""
    found = next((files for pattern in patterns if (files := sorted(folder.glob(pattern)))), [])
    numbers: dict[tuple[int, ...], Path] = {}
    for file in found:
        number = tuple(map(int, re.findall("[0-9]+", file.stem)))
        if (other := numbers.setdefault(number, file)) != file:
            raise OmnistereoError(
                f"{folder}: {other.name} and {file.name} are of one camera. Delete one"
            )
    return [numbers[number] for number in sorted(numbers)]


def read_poses(file: Path) -> list[Pose]:
    """Return the poses, camera → rig, of a poses.txt: a line rx ry rz tx ty tz for each camera."""
    poses = []
    with error_context(file):
        for i, (number, words) in enumerate(numbered_lines(file), 1):
            with error_context(f"line {number}, camera {i}"):
                poses.append(parse_pose(words))
    return poses


def poses_beside(folder: Path, lenses: Sequence[Path]) -> list[Pose]:
    """Return the poses in poses.txt for as many camera files, or an `OmnistereoError`."""
    file, names = folder / "poses.txt", ", ".join(file.name for file in lenses)
    one_each = "one line rx ry rz tx ty tz (camera → rig) per camera"
    if not file.exists():
        raise OmnistereoError(
            f"{folder}: poses.txt is missing beside {names}; expected {one_each}. Write it"
        )
    check_count(len(lenses))
    poses = read_poses(file)
    if len(poses) != len(lenses):
        raise OmnistereoError(
            f"{file}: found {len(poses)} poses and {len(lenses)} camera files ({names}); expected "
            f"{one_each}"
        )
    return poses


def _read_folder(folder: Path, lenses: Sequence[Path], max_fov_deg: float | None) -> RigFile:
    poses = poses_beside(folder, lenses)
    cameras = [read_ocam_txt(file, max_fov_deg) for file in lenses]
    warn_of_polynomials(cameras, folder)
    return RigFile(cameras, poses, name="OCamCalib text files", in_metres=False)


def write_ocam_folder(rig: Rig, folder: str | Path) -> None:
    """Write a rig as the SweepNet release: ocam1.txt … and poses.txt (camera → rig, metres)."""
    for number, camera in enumerate(rig.cameras, 1):
        write_ocam_txt(camera, Path(folder) / f"ocam{number}.txt")
    lines = [" ".join(map(repr, pose.as_vector().tolist())) for pose in rig.T_rig_cam]
    write_text(Path(folder) / "poses.txt", "\n".join(lines) + "\n")


def read_omnimvs(data: Section, path: Path, max_fov_deg: float | None) -> RigFile:
    """Read OmniMVS config.yaml, with the masks beside it; it is also what `save_rig` writes."""
    cameras, poses, deviations, missing = [], [], [], []
    for i, cam in data.sections("cameras").items():
        with error_context(f"camera {i}"):
            if cam.word("model", default="ocam") != "ocam":
                found = repr(cam.get("model"))
                raise OmnistereoError(f"model is {found}; expected ocam. Recalibrate with it")
            records = {key: cam.require(key) for key in ("poly", "center", "affine", "image_size")}
            records["inv_poly"] = cam.get("inv_poly")
            has_fov = cam.get("max_fov") is not None
            stated = check_fov(cam.number("max_fov"), "max_fov") if has_fov else None
            mask = cam.get("invalid_mask")
            mask_file = None if mask is None else path_within(path.parent, mask, path)
            if mask_file is not None and not mask_file.exists():
                missing.append(mask_file.name)
                mask_file = None
            fov = stated if max_fov_deg is None else max_fov_deg
            cameras.append(ocam_camera(records, fov, f"{path}, camera {i}", mask_file))
            poses.append(parse_pose(cam.require("pose")))
            if cam.get("deviation") is not None:
                deviations.append(Deviation(*cam.floats("deviation", count=3).tolist()))
    if missing and any(camera.mask is not None for camera in cameras):
        found = f"the masks {', '.join(missing)} are named, but missing"
        raise OmnistereoError(f"{found}. Copy them beside the file")
    ours = rf"{re.escape(path.stem)}_mask1.png|.*_no_mask1.png"
    if missing and not re.fullmatch(ours, missing[0]):
        text = f"{path}: the masks {', '.join(missing)} are missing; every pixel counts as valid"
        warnings.warn(text, stacklevel=2)
    warn_of_polynomials(cameras, path)
    config, key = Section(data.get("config", default={}), "config"), "omnimvs_sweep_min_depth"
    min_depth = None if config.get(key) is None else config.number(key)
    turned = config.get("T_rig_file")
    data.warn(path, settings=True)
    T_rig_file = None if turned is None else parse_pose(turned)
    return RigFile(cameras, poses, min_depth, T_rig_file, deviations)


def save_rig(rig: Rig, path: str | Path) -> None:
    """Write a rig as config.yaml (OmniMVS format, metres), every number in full.

    Masks are written beside it as <name>_mask1.png and so on, bright = outside. The public codes
    need a name even without a mask, and write their own there: <name>_no_mask1.png. They sweep
    around the origin of the file and need a nearest depth: for them, save `rig.recentered()` with
    a `min_depth`.

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
        field = {"pose": pose.as_vector().tolist(), "max_fov": camera.max_fov_deg}
        field["invalid_mask"] = mask_file.name
        if rig.deviations:  # rotation in radians, centre in metres, lens in radians
            field["deviation"] = [float(value) for value in rig.deviations[i - 1]]
        if masked:
            valid = np.ones(camera.image_size[::-1], bool) if camera.mask is None else camera.mask
            write_image(mask_file, np.where(valid, 0, 255).astype(np.uint8))
        cameras.append(names | ocam_records(camera) | field)
    near = {} if rig.min_depth is None else {"omnimvs_sweep_min_depth": float(rig.min_depth)}
    turned = {} if rig.T_rig_file is None else {"T_rig_file": rig.T_rig_file.as_vector().tolist()}
    data = {
        "config": near | turned,
        # Required by the public codes.
        "dataset": {"img_fmt": "cam%d/%04d.png", "lut_fmt": "lt_(%d,%d,%d).hwd"},
        "cameras": cameras,
    }
    write_text(path, to_yaml(data))


def parse_pose(values: Any) -> Pose:
    """Return the pose of six numbers rx ry rz tx ty tz, camera → rig."""
    vector = parse_floats(values, "the pose rx ry rz tx ty tz", 6)
    parse_axis_angle(vector[:3], "the rotation")
    return Pose.from_vector(vector)
