"""basalt calibration JSON: `value0` with `T_imu_cam` (camera → rig), `intrinsics`, `resolution`; metres."""

from pathlib import Path
from typing import Any

import numpy as np

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import read_gray
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.rig_files.camera_models import fit_camera
from omnistereo_lib.rig_files.parse import error_context, parse_floats, parse_size, require_key, require_list


def read_basalt(data: dict[str, Any], path: Path, max_fov_deg: float | None) -> Rig:
    """Read a parsed calibration.json, and the masks camN/mask.png that exist beside it: N from 0, bright = valid."""
    value = require_key(data, "value0")
    poses, intrinsics, sizes = (require_list(value, key) for key in ("T_imu_cam", "intrinsics", "resolution"))
    if not len(poses) == len(intrinsics) == len(sizes):
        raise OmnistereoError(
            f"found {len(poses)} poses, {len(intrinsics)} intrinsics and {len(sizes)} resolutions; "
            "expected the same number of each"
        )
    cameras, T_rig_cam = [], []
    for i, (pose, model, size) in enumerate(zip(poses, intrinsics, sizes, strict=True)):
        with error_context(f"camera {i}"):
            T_rig_cam.append(_pose_from_quaternion(pose))
            image_size = parse_size(size, "resolution")
            mask_file = path.parent / f"cam{i}" / "mask.png"
            mask = read_gray(mask_file, image_size) >= 128 if mask_file.exists() else None
            values = require_key(model, "intrinsics")
            values = values.items() if isinstance(values, dict) else ()
            parameters = {name: float(parse_floats(value, name, 1)[0]) for name, value in values}
            name = str(require_key(model, "camera_type"))
            cameras.append(fit_camera(f"{path}, camera {i}", name, parameters, image_size, max_fov_deg, mask))
    return Rig(cameras, T_rig_cam)


def _pose_from_quaternion(pose: Any) -> Pose:
    from scipy.spatial.transform import Rotation

    q = parse_floats([require_key(pose, key) for key in ("qx", "qy", "qz", "qw")], "the quaternion", 4)
    t = parse_floats([require_key(pose, key) for key in ("px", "py", "pz")], "the position", 3)
    if not np.abs(q).max() < 2 or abs(np.linalg.norm(q) - 1) > 1e-3:  # the largest first: squares can overflow
        raise OmnistereoError(
            f"the quaternion {q.tolist()} has length {np.linalg.norm(q.clip(-1e9, 1e9)):.4g}; expected 1"
        )
    return Pose(Rotation.from_quat(q).as_matrix(), t)
