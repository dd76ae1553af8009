"""config.yaml of OmniMVS: OCam cameras, poses camera → rig, metres."""

import re
import warnings
from pathlib import Path

import numpy as np

from omnistereo_lib.errors import OmnistereoError, error_context
from omnistereo_lib.files import as_path, path_within, to_yaml, write_image, write_text
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.rig_files.ocam import ocam_camera, ocam_records, parse_pose, warn_of_polynomials
from omnistereo_lib.rig_files.parse import RigFile, Section, check_fov


def read_omnimvs(data: Section, path: Path, max_fov_deg: float | None) -> RigFile:
    """Read OmniMVS config.yaml: with the masks beside it, and what `save_rig` writes."""
    cameras, poses, missing = [], [], []
    for i, cam in data.sections("cameras").items():
        with error_context(f"camera {i}"):
            if cam.word("model", default="ocam") != "ocam":
                raise OmnistereoError(f"model is {cam.get('model')!r}; expected ocam. Recalibrate with it")
            records = {key: cam.require(key) for key in ("poly", "center", "affine", "image_size")}
            records["inv_poly"] = cam.get("inv_poly")
            stated = None if cam.get("max_fov") is None else check_fov(cam.number("max_fov"), "max_fov")
            mask = cam.get("invalid_mask")
            mask_file = None if mask is None else path_within(path.parent, mask, path)
            if mask_file is not None and not mask_file.exists():
                missing.append(mask_file.name)
                mask_file = None
            fov = stated if max_fov_deg is None else max_fov_deg
            cameras.append(ocam_camera(records, fov, f"{path}, camera {i}", mask_file))
            poses.append(parse_pose(cam.require("pose")))
    if missing and any(camera.mask is not None for camera in cameras):
        raise OmnistereoError(f"the masks {', '.join(missing)} are named, but missing. Copy them beside the file")
    if missing and not re.fullmatch(rf"{re.escape(path.stem)}_mask1.png|.*_no_mask1.png", missing[0]):
        warnings.warn(f"{path}: the masks {', '.join(missing)} are missing; every pixel counts as valid", stacklevel=2)
    warn_of_polynomials(cameras, path)
    config = Section(data.get("config", default={}), "config")
    min_depth = None if config.get("omnimvs_sweep_min_depth") is None else config.number("omnimvs_sweep_min_depth")
    turned = config.get("T_rig_file")
    return RigFile(cameras, poses, min_depth, None if turned is None else parse_pose(turned))


def save_rig(rig: Rig, path: str | Path) -> None:
    """Write a rig as config.yaml (OmniMVS format, metres), every number in full.

    Masks are written beside it as <name>_mask1.png and so on, bright = outside. The public codes need a name even
    without a mask, and write their own there: <name>_no_mask1.png. They sweep around the origin of the file and need a
    nearest depth: for them, save `rig.recentered()` with a `min_depth`.

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
        field = {"pose": pose.as_vector().tolist(), "max_fov": camera.max_fov_deg, "invalid_mask": mask_file.name}
        if masked:
            valid = np.ones(camera.image_size[::-1], bool) if camera.mask is None else camera.mask
            write_image(mask_file, np.where(valid, 0, 255).astype(np.uint8))
        cameras.append(names | ocam_records(camera) | field)
    config = {} if rig.min_depth is None else {"omnimvs_sweep_min_depth": float(rig.min_depth)}
    turned = {} if rig.T_rig_file is None else {"T_rig_file": rig.T_rig_file.as_vector().tolist()}
    data = {
        "config": config | turned,
        "dataset": {"img_fmt": "cam%d/%04d.png", "lut_fmt": "lt_(%d,%d,%d).hwd"},  # required by the public codes
        "cameras": cameras,
    }
    write_text(path, to_yaml(data))
