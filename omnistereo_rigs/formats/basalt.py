"""basalt calibration JSON: `value0` with `T_imu_cam` (camera → rig), `intrinsics`, `resolution`;
metres.
"""

from pathlib import Path

import numpy as np

from omnistereo_lib.errors import OmnistereoError, error_context
from omnistereo_lib.geometry.pose import quaternion_pose
from omnistereo_lib.parse import RigFile, Section, parse_size
from omnistereo_lib.pictures import read_gray
from omnistereo_rigs.formats.fit import fit_camera

_MODELS = {"pinhole-radtan8": "pinhole"}  # what basalt calls otherwise than `camera_models`


def read_basalt(data: Section, path: Path, max_fov_deg: float | None) -> RigFile:
    """Read basalt JSON: ds, eucm, ucm, kb4, pinhole, pinhole-radtan8 and fov.

    Masks camN/mask.png beside the file are read, too: N from 0, bright = valid.
    """
    value = data.section("value0")
    poses, intrinsics = value.sections("T_imu_cam"), value.sections("intrinsics")
    sizes = value.require("resolution")
    counts = [
        len(each) if isinstance(each, dict | list) else 0 for each in (poses, intrinsics, sizes)
    ]
    if len(set(counts)) > 1:
        raise OmnistereoError(
            "found {} T_imu_cam, {} intrinsics and {} resolution; expected one per camera".format(
                *counts
            )
        )
    cameras, T_rig_cam = [], []
    for i, (pose, model, size) in enumerate(
        zip(poses.values(), intrinsics.values(), sizes, strict=True)
    ):
        with error_context(f"camera {i}"):
            q = np.array([pose.number(key) for key in ("qw", "qx", "qy", "qz")])
            T_rig_cam.append(
                quaternion_pose(q, np.array([pose.number(key) for key in ("px", "py", "pz")]))
            )
            image_size = parse_size(size, "resolution")
            mask_file = path.parent / f"cam{i}" / "mask.png"
            mask = read_gray(mask_file, image_size) >= 128 if mask_file.exists() else None
            name = model.word("camera_type")
            parameters = model.section("intrinsics").numbers()
            source = f"{path}, camera {i}"
            cameras.append(
                fit_camera(
                    source, _MODELS.get(name, name), parameters, image_size, max_fov_deg, mask
                )
            )
    return RigFile(cameras, T_rig_cam)
