"""config.yaml of OmniMVS: OCam cameras, poses camera → rig, metres."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from omnistereo_lib.errors import OmnistereoError, checked
from omnistereo_lib.files import atomic_write, path_within, write_image
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.rig_files.camera_models import DEFAULT_FOV_DEG
from omnistereo_lib.rig_files.ocam import ocam_camera, ocam_records, parse_pose, warn_of_polynomials
from omnistereo_lib.rig_files.parse import error_context, parse_floats, require_key, require_list, to_yaml


def read_omnimvs(data: dict[str, Any], path: Path, max_fov_deg: float | None) -> Rig:
    """Read a parsed config.yaml, and the masks that exist beside it."""
    cameras, poses, missing = [], [], []
    for i, cam in enumerate(require_list(data, "cameras"), 1):
        with error_context(f"camera {i}"):
            records = {key: require_key(cam, key) for key in ("poly", "inv_poly", "center", "affine", "image_size")}
            fov = float(parse_floats(cam.get("max_fov", DEFAULT_FOV_DEG), "max_fov", 1)[0])
            mask_file = path_within(path.parent, cam["invalid_mask"], path) if cam.get("invalid_mask") else None
            if mask_file and not mask_file.exists():
                missing.append(mask_file.name)
                mask_file = None
            fov = fov if max_fov_deg is None else max_fov_deg
            cameras.append(ocam_camera(records, fov, f"{path}, camera {i}", mask_file))
            pose = require_key(cam, "pose")
        poses.append(parse_pose(pose, i))
    if missing and any(camera.mask is not None for camera in cameras):
        raise OmnistereoError(f"the masks {', '.join(missing)} are named, but missing. Copy them beside the file")
    if missing and missing[0] != f"{path.stem}_mask1.png":  # `save_rig` names them for the public codes
        warnings.warn(f"{path}: the masks {', '.join(missing)} are missing; every pixel counts as valid", stacklevel=2)
    warn_of_polynomials(cameras, path)
    settings = data.get("config")
    min_depth = settings.get("omnimvs_sweep_min_depth") if isinstance(settings, dict) else None
    if min_depth is not None:
        min_depth = float(parse_floats(min_depth, "omnimvs_sweep_min_depth", 1)[0])
    return Rig(cameras, poses, min_depth)


@checked
def save_rig(rig: Rig, path: str | Path) -> None:
    """Write a rig as config.yaml (OmniMVS format, metres), every number in full.

    Masks are written beside it as <name>_mask1.png and so on, bright = outside. The public codes sweep around the
    origin of the file and need a nearest depth: for them, save `rig.recentered()` with a `min_depth`.
    """
    path = Path(path)
    if path.suffix not in (".yaml", ".yml"):
        raise OmnistereoError(f"{path}: a rig is saved as YAML. Give a file that ends in .yaml")
    cameras, masked = [], any(camera.mask is not None for camera in rig.cameras)
    for i, (camera, pose) in enumerate(zip(rig.cameras, rig.T_rig_cam, strict=True), 1):
        mask_file = path.with_name(f"{path.stem}_mask{i}.png")
        names = {"cam_id": i, "img_dir": f"cam{i}", "model": "ocam"}
        field = {"pose": pose.as_vector().tolist(), "max_fov": camera.max_fov_deg, "invalid_mask": mask_file.name}
        if masked:
            valid = np.ones(camera.image_size[::-1], bool) if camera.mask is None else camera.mask
            write_image(mask_file, np.where(valid, 0, 255).astype(np.uint8))
        cameras.append(names | ocam_records(camera) | field)
    data = {
        "config": {} if rig.min_depth is None else {"omnimvs_sweep_min_depth": float(rig.min_depth)},
        "dataset": {"img_fmt": "cam%d/%04d.png", "lut_fmt": "lt_(%d,%d,%d).hwd"},  # required by the public codes
        "cameras": cameras,
    }
    with atomic_write(path) as temporary:
        temporary.write_text(to_yaml(data))
    for camera in [] if masked else cameras:  # masks of a rig saved here before would be read with this one
        path.with_name(camera["invalid_mask"]).unlink(missing_ok=True)
