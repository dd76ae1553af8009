"""Kalibr camchain YAML: `cam0`, `cam1`, … with `T_cn_cnm1` (camera n-1 → camera n); metres; rig frame = cam0."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.rig_files.camera_models import fit_camera
from omnistereo_lib.rig_files.parse import error_context, parse_floats, parse_size, require_key

_RADTAN, _EQUIDISTANT = ("k1", "k2", "p1", "p2"), ("k1", "k2", "k3", "k4")
# (camera_model, distortion_model) → our model, its parameters in file order: intrinsics, distortion_coeffs
_MODELS = {
    ("ds", "none"): ("ds", ("xi", "alpha", "fx", "fy", "cx", "cy"), ()),
    ("eucm", "none"): ("eucm", ("alpha", "beta", "fx", "fy", "cx", "cy"), ()),
    ("omni", "none"): ("omni", ("xi", "fx", "fy", "cx", "cy"), ()),
    ("omni", "radtan"): ("omni", ("xi", "fx", "fy", "cx", "cy"), _RADTAN),
    ("pinhole", "equidistant"): ("kb4", ("fx", "fy", "cx", "cy"), _EQUIDISTANT),
}


def read_kalibr(data: dict[str, Any], path: Path, max_fov_deg: float | None) -> Rig:
    """Read a parsed camchain: models ds, eucm, omni (radtan or no distortion), pinhole with equidistant distortion."""
    cameras, T_rig_cam = [], [Pose.identity()]
    for n in range(sum(bool(re.fullmatch(r"cam[0-9]+", str(name))) for name in data)):
        name = f"cam{n}"
        cam = require_key(data, name)  # a gap in the chain is an error
        with error_context(name):
            if n > 0:
                T_cam_previous = _pose_from_matrix(require_key(cam, "T_cn_cnm1"))
                T_rig_cam.append(T_rig_cam[-1] @ T_cam_previous.inverse())
            model, parameters = _parse_model(cam)
            image_size = parse_size(require_key(cam, "resolution"), "resolution")
            cameras.append(fit_camera(f"{path}, {name}", model, parameters, image_size, max_fov_deg))
    return Rig(cameras, T_rig_cam)


def _parse_model(cam: Any) -> tuple[str, dict[str, float]]:
    key = (str(require_key(cam, "camera_model")), str(cam.get("distortion_model") or "none"))
    if key not in _MODELS:
        raise OmnistereoError(
            f"camera_model + distortion_model is {' + '.join(key)}; expected one of "
            f"{', '.join(' + '.join(known) for known in _MODELS)}. Recalibrate with one of them"
        )
    model, intrinsics, distortion = _MODELS[key]
    values = parse_floats(require_key(cam, "intrinsics"), "intrinsics", len(intrinsics)).tolist()
    if distortion:
        values += parse_floats(require_key(cam, "distortion_coeffs"), "distortion_coeffs", len(distortion)).tolist()
    return model, dict(zip(intrinsics + distortion, values, strict=True))


def _pose_from_matrix(values: Any) -> Pose:
    matrix = parse_floats(values, "the 4 × 4 pose", 16).reshape(4, 4)
    if not np.allclose(matrix[3], [0, 0, 0, 1], atol=1e-9):
        raise OmnistereoError(f"the last row of the pose is {matrix[3].tolist()}; expected 0 0 0 1")
    return Pose(matrix[:3, :3], matrix[:3, 3])
