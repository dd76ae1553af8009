"""Kalibr camchain YAML, metres: `cam0`, `cam1`, … with `T_cn_cnm1` (camera n-1 → camera n) or the IMU poses.

The rig frame is cam0. `T_cam_imu` (IMU → camera) and `T_imu_cam` (camera → IMU) are read where the chain is missing,
and compared with it where both are there.
"""

import re
from collections.abc import Sequence
from pathlib import Path

from omnistereo_lib.errors import OmnistereoError, error_context
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.rig_files.camera_models import RADTAN
from omnistereo_lib.rig_files.fit import fit_camera
from omnistereo_lib.rig_files.parse import RigFile, Section, parse_floats, parse_matrix, parse_size, warn_if_different

_PINHOLE = ("fx", "fy", "cx", "cy")
# (camera_model, distortion_model) → our model, its parameters in file order: intrinsics, distortion_coeffs
_MODELS: dict[tuple[str, str], tuple[str, tuple[str, ...], tuple[str, ...]]] = {
    ("ds", "none"): ("ds", ("xi", "alpha", *_PINHOLE), ()),
    ("eucm", "none"): ("eucm", ("alpha", "beta", *_PINHOLE), ()),
    ("omni", "none"): ("omni", ("xi", *_PINHOLE), ()),
    ("omni", "radtan"): ("omni", ("xi", *_PINHOLE), RADTAN[:4]),
    ("pinhole", "equidistant"): ("kb4", _PINHOLE, ("k1", "k2", "k3", "k4")),
    ("pinhole", "radtan"): ("pinhole", _PINHOLE, RADTAN[:4]),
    ("pinhole", "fov"): ("fov", _PINHOLE, ("w",)),
    ("pinhole", "none"): ("pinhole", _PINHOLE, ()),
}
_ALIASES = {"equi": "equidistant", "kb4": "equidistant", "plumb_bob": "radtan", "radial-tangential": "radtan"}


def read_kalibr(data: Section, path: Path, max_fov_deg: float | None) -> RigFile:
    """Read a parsed camchain: models ds, eucm, omni and pinhole, with every distortion that Kalibr has for them."""
    count = sum(bool(re.fullmatch(r"cam[0-9]+", name)) for name in data.values)
    cams = [data.section(f"cam{n}") for n in range(count)]  # a gap in the chain is an error
    cameras = []
    for cam in cams:
        with error_context(cam.name):
            model, parameters = _parse_model(cam)
            image_size = parse_size(cam.require("resolution"), "resolution")
            cameras.append(fit_camera(f"{path}, {cam.name}", model, parameters, image_size, max_fov_deg))
    return RigFile(cameras, _parse_poses(cams, path))


def _parse_model(cam: Section) -> tuple[str, dict[str, float]]:
    lens, _, distortion = cam.word("camera_model").partition("-")  # as in pinhole-equi
    distortion = cam.word("distortion_model", default=distortion or "none")
    key = (lens, _ALIASES.get(distortion, distortion))
    if key not in _MODELS:
        raise OmnistereoError(
            f"camera_model + distortion_model is {lens} + {distortion}; expected one of "
            f"{', '.join(' + '.join(known) for known in _MODELS)}. Recalibrate with one of them"
        )
    model, intrinsics, coefficients = _MODELS[key]
    values = cam.floats("intrinsics", count=len(intrinsics)).tolist()
    stated = cam.get("distortion_coeffs", "distortion_coefficients", default=[] if not coefficients else None)
    values += parse_floats(stated, "distortion_coeffs", None if not coefficients else len(coefficients)).tolist()
    return model, dict(zip(intrinsics + coefficients, values, strict=False))


def _parse_poses(cams: Sequence[Section], path: Path) -> list[Pose]:
    """Return camera → cam0 by the chain, else by the IMU."""
    chain, by_imu, imu_key = [Pose.identity()], [], "T_cam_imu"
    for n, cam in enumerate(cams):
        with error_context(cam.name):
            previous = cam.get("T_cn_cnm1") if n > 0 else None
            if previous is not None and len(chain) == n:
                chain.append(chain[-1] @ parse_matrix(previous, "T_cn_cnm1").inverse())
            T_cam_imu, T_imu_cam = cam.get("T_cam_imu"), cam.get("T_imu_cam", "T_BS")
            if T_imu_cam is not None:
                imu_key = "T_imu_cam"
                by_imu.append(parse_matrix(T_imu_cam, imu_key))
            elif T_cam_imu is not None:
                by_imu.append(parse_matrix(T_cam_imu, "T_cam_imu").inverse())
            if len(chain) <= n and len(by_imu) <= n:
                raise OmnistereoError(
                    f"no pose; found {sorted(cam.values)}; expected T_cn_cnm1, or T_cam_imu in every camera"
                )
    if len(by_imu) < len(cams):
        return chain
    by_imu = [by_imu[0].inverse() @ pose for pose in by_imu]
    if len(chain) < len(cams):
        return by_imu
    warn_if_different(chain, by_imu, "T_cn_cnm1", imu_key, path)
    return chain
