"""Cameras of camodocal (MEI, KANNALA_BRANDT, PINHOLE, SCARAMUZZA), and rigs of VINS that name them; metres.

A VINS rig has `body_T_cam0` (camera → body) and `cam0_calib`, the file of the camera, for each camera.
"""

from pathlib import Path

from omnistereo_lib.errors import OmnistereoError, error_context
from omnistereo_lib.files import path_within, read_data
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.rig_files.fit import fit_camera
from omnistereo_lib.rig_files.ocam import ocam_camera
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
    if model_type == "scaramuzza":
        return _scaramuzza(data, path, max_fov_deg)
    if model_type not in _MODELS:
        known = ", ".join([*_MODELS, "scaramuzza"]).upper()
        raise OmnistereoError(
            f"model_type is {model_type.upper()}; expected one of {known}. Recalibrate with one of them"
        )
    model, names = _MODELS[model_type]
    parameters: dict[str, float] = {}
    for key in ("mirror_parameters", "distortion_parameters", "projection_parameters"):
        if key in data.values:
            found = data.section(key).numbers()
            parameters |= {names.get(name, name): value for name, value in found.items()}
    size = parse_size([data.require("image_width"), data.require("image_height")], "image size")
    return fit_camera(str(path), model, parameters, size, max_fov_deg)


def _scaramuzza(data: Section, path: Path, max_fov_deg: float | None) -> OcamCamera:
    """Return the camera of OCam parameters, whose affine map is u = C x + D y + cx, v = E x + y + cy."""
    C, D, E, u, v = (data.section("affine_parameters").number(name) for name in ("ac", "ad", "ae", "cx", "cy"))
    poly, inv_poly = (list(data.section(f"{name}_parameters").numbers().values()) for name in ("poly", "inv_poly"))
    if abs(C) < 1e-3:
        raise OmnistereoError(f"affine_parameters: ac is {C:g}; expected about 1")
    records = {
        "poly": [len(poly), *(a * C ** (1 - k) for k, a in enumerate(poly))],  # in pixels along u: f(r) → C f(r / C)
        "inv_poly": [len(inv_poly), *(C * b for b in inv_poly)],
        "center": [v, u],
        "affine": [1 / C, E / C, D / C],
        "image_size": [data.require("image_height"), data.require("image_width")],
    }
    return ocam_camera(records, max_fov_deg, str(path))
