"""Cameras of camodocal (`model_type`: MEI, KANNALA_BRANDT, PINHOLE), and rigs of VINS that name them; metres.

A VINS rig has `body_T_cam0` (camera → body) and `cam0_calib`, the file of the camera, for each camera.
"""

from pathlib import Path

from omnistereo_lib.errors import OmnistereoError, error_context
from omnistereo_lib.files import path_within, read_data
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.rig_files.fit import fit_camera
from omnistereo_lib.rig_files.parse import RigFile, Section, parse_matrix, parse_size

# model_type → our model, and our parameters where its names differ
_MODELS = {
    "mei": ("omni", {"gamma1": "fx", "gamma2": "fy", "u0": "cx", "v0": "cy"}),
    "kannala_brandt": (
        "kb4",
        {"mu": "fx", "mv": "fy", "u0": "cx", "v0": "cy", "k2": "k1", "k3": "k2", "k4": "k3", "k5": "k4"},
    ),
    "pinhole": ("pinhole", {}),
}


def read_camodocal(data: Section, path: Path, max_fov_deg: float | None) -> RigFile:
    """Read a parsed camera file, which has no pose."""
    return RigFile([_camera(data, path, max_fov_deg)], [Pose.identity()])


def read_vins(data: Section, path: Path, max_fov_deg: float | None) -> RigFile:
    """Read a parsed VINS configuration and the camera files that it names."""
    cameras, poses = [], []
    for n in range(sum(name.startswith("body_T_cam") for name in data.values)):
        poses.append(parse_matrix(data.require(f"body_T_cam{n}"), f"body_T_cam{n}"))
        file = path_within(path.parent, data.require(f"cam{n}_calib"), path)
        with error_context(file):
            cameras.append(_camera(Section(read_data(file)), file, max_fov_deg))
    return RigFile(cameras, poses)


def _camera(data: Section, path: Path, max_fov_deg: float | None) -> OcamCamera:
    model_type = data.word("model_type")
    if model_type not in _MODELS:
        raise OmnistereoError(
            f"model_type is {model_type.upper()}; expected one of {', '.join(_MODELS).upper()}. Recalibrate with one "
            "of them; SCARAMUZZA is read from the text file of OCamCalib"
        )
    model, names = _MODELS[model_type]
    parameters: dict[str, float] = {}
    for key in ("mirror_parameters", "distortion_parameters", "projection_parameters"):
        if key in data.values:
            found = data.section(key).numbers()
            parameters |= {names.get(name, name): value for name, value in found.items()}
    size = parse_size([data.require("image_width"), data.require("image_height")], "image size")
    return fit_camera(str(path), model, parameters, size, max_fov_deg)
