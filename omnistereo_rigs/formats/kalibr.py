"""Kalibr camchain YAML, metres: `cam0`, `cam1`, … with `T_cn_cnm1` (camera n-1 → camera n) or the
IMU poses.

The cameras may have other names, then in the order of the file; the rig frame is the first one.
`T_cam_imu` (IMU → camera) and `T_imu_cam` or `T_BS` (camera → IMU) are read where the chain is
missing, and compared with it.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from omnistereo_lib.errors import OmnistereoError, error_context
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.parse import RigFile, Section, parse_floats, parse_size, warn_if_different
from omnistereo_rigs.formats.camera_models import FISHEYE, PINHOLE, RADTAN
from omnistereo_rigs.formats.fit import fit_camera

# (camera_model, distortion_model) → our model, its parameters in file order: intrinsics,
# distortion_coeffs
_MODELS: dict[tuple[str, str], tuple[str, tuple[str, ...], tuple[str, ...]]] = {
    ("ds", "none"): ("ds", ("xi", "alpha", *PINHOLE), ()),
    ("eucm", "none"): ("eucm", ("alpha", "beta", *PINHOLE), ()),
    ("omni", "none"): ("omni", ("xi", *PINHOLE), ()),
    ("omni", "radtan"): ("omni", ("xi", *PINHOLE), RADTAN[:4]),
    ("pinhole", "equidistant"): ("kb4", PINHOLE, FISHEYE),
    ("pinhole", "radtan"): ("pinhole", PINHOLE, RADTAN[:4]),
    ("pinhole", "fov"): ("fov", PINHOLE, ("w",)),
    ("pinhole", "none"): ("pinhole", PINHOLE, ()),
}
_ALIASES = {
    "equi": "equidistant",
    "kb4": "equidistant",
    "plumb_bob": "radtan",
    "radial-tangential": "radtan",
}


def is_kalibr(data: dict[str, Any]) -> bool:
    """Return whether a file has cameras, or is one camera, as Kalibr writes them."""
    return any(
        isinstance(cam, dict) and {"camera_model", "intrinsics"} <= cam.keys()
        for cam in (data, *data.values())
    )


def read_kalibr(data: Section, path: Path, max_fov_deg: float | None) -> RigFile:
    """Read Kalibr camchain: ds, eucm, omni, or pinhole with equidistant, radtan or fov; also one
    camera.
    """
    cams, cameras = _cameras(data), []
    for cam in cams:
        with error_context(cam.name or path):
            model, parameters = _parse_model(cam)
            source = f"{path}, {cam.name}" if cam.name else str(path)
            cameras.append(
                fit_camera(
                    source,
                    model,
                    parameters,
                    parse_size(cam.require("resolution"), "resolution"),
                    max_fov_deg,
                )
            )
    return RigFile(cameras, _parse_poses(cams, path))


def _cameras(data: Section) -> list[Section]:
    """Return the cameras in the order of their numbers, from 0 or 1, else in that of the file."""
    if "camera_model" in data.values:
        return [data]
    found = {name: value for name, value in data.values.items() if isinstance(value, dict)}
    names = [
        name for name, value in found.items() if name.startswith("cam") or "camera_model" in value
    ]
    if all(re.fullmatch(r"cam(era)?_?[0-9]{1,4}", name) for name in names):
        prefix, first = (
            names[0].rstrip("0123456789"),
            min([1, *(int(re.sub(r"\D", "", name)) for name in names)]),
        )
        # a gap in the chain is an error
        names = [f"{prefix}{n}" for n in range(first, first + len(names))]
    return [data.section(name) for name in names]


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
    values = dict(
        zip(intrinsics, cam.floats("intrinsics", count=len(intrinsics)).tolist(), strict=True)
    )
    name = cam.key("distortion_coeffs", "distortion_coefficients")
    stated = parse_floats(cam.require(name) if coefficients else cam.get(name, default=[]), name)
    return model, values | cam.coefficients(name, stated.tolist(), coefficients)


def _parse_poses(cams: Sequence[Section], path: Path) -> list[Pose]:
    """Return camera → first camera by the chain, else by the IMU."""
    chain, by_imu, imu_key = [Pose.identity()], [], "T_cam_imu"
    for n, cam in enumerate(cams):
        with error_context(cam.name or path):
            if n > 0 and cam.get("T_cn_cnm1") is not None and len(chain) == n:
                chain.append(chain[-1] @ cam.pose("T_cn_cnm1").inverse())
            imu_key = cam.key("T_imu_cam", "T_BS")
            if cam.get(imu_key) is not None:
                by_imu.append(cam.pose(imu_key))
            elif cam.get("T_cam_imu") is not None:
                imu_key = "T_cam_imu"
                by_imu.append(cam.pose(imu_key).inverse())
            if len(chain) <= n and len(by_imu) <= n:
                raise OmnistereoError(
                    f"no pose; found {sorted(cam.values)}; expected T_cn_cnm1, or T_cam_imu in"
                    " every camera"
                )
    if len(by_imu) < len(cams):
        return chain
    by_imu = [by_imu[0].inverse() @ pose for pose in by_imu]
    if len(chain) < len(cams):
        return by_imu
    warn_if_different(chain, by_imu, "T_cn_cnm1", imu_key, path)
    return chain
