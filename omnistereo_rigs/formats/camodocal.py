"""Cameras of camodocal (MEI, KANNALA_BRANDT, PINHOLE, SCARAMUZZA), and rigs of VINS that name them;
metres.

A VINS rig has `body_T_cam0` (camera → body) and `cam0_calib`, the file of the camera, for each
camera.
"""

from pathlib import Path

from omnistereo_lib.errors import OmnistereoError, error_context
from omnistereo_lib.files import path_within, read_data
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.parse import RigFile, Section
from omnistereo_lib.rig_file import ocam_camera
from omnistereo_rigs.formats.camera_models import PINHOLE, RADTAN
from omnistereo_rigs.formats.fit import fit_camera

# model_type → our model, and for each block of the file its keys with our names of them
_PROJECTION = "projection_parameters"
_DISTORTION = {"distortion_parameters": {key: key for key in RADTAN[:4]}}
_MODELS: dict[str, tuple[str, dict[str, dict[str, str]]]] = {
    "mei": (
        "omni",
        {"mirror_parameters": {"xi": "xi"}}
        | _DISTORTION
        | {_PROJECTION: {"gamma1": "fx", "gamma2": "fy", "u0": "cx", "v0": "cy"}},
    ),
    "kannala_brandt": (
        "kb4",
        {
            _PROJECTION: {
                "k2": "k1",
                "k3": "k2",
                "k4": "k3",
                "k5": "k4",
                "mu": "fx",
                "mv": "fy",
                "u0": "cx",
                "v0": "cy",
            }
        },
    ),
    "pinhole": ("pinhole", _DISTORTION | {_PROJECTION: {key: key for key in PINHOLE}}),
}


def read_camodocal(data: Section, path: Path, max_fov_deg: float | None) -> RigFile:
    """Read camodocal camera: MEI, KANNALA_BRANDT, PINHOLE or SCARAMUZZA."""
    return RigFile([_camera(data, path, max_fov_deg)])


def read_vins(data: Section, path: Path, max_fov_deg: float | None) -> RigFile:
    """Read VINS configuration: with `body_T_cam0`, …, and the camodocal files that `cam0_calib`, …
    name.
    """
    cameras, poses = [], []
    for n in range(sum(name.startswith("body_T_cam") for name in data.values)):
        poses.append(data.pose(f"body_T_cam{n}"))
        file = path_within(path.parent, data.require(f"cam{n}_calib"), path)
        with error_context(file):
            cameras.append(_camera(data.add(f"cam{n}_calib", read_data(file)), file, max_fov_deg))
    return RigFile(cameras, poses)


def _camera(data: Section, path: Path, max_fov_deg: float | None) -> OcamCamera:
    model_type = data.word("model_type")
    if model_type == "scaramuzza":
        return _scaramuzza(data, path, max_fov_deg)
    if model_type not in _MODELS:
        known = ", ".join([*_MODELS, "scaramuzza"]).upper()
        raise OmnistereoError(
            f"model_type is {model_type.upper()}; expected one of {known}. Recalibrate with one of"
            " them"
        )
    model, blocks = _MODELS[model_type]
    parameters: dict[str, float] = {}
    for block, keys in blocks.items():
        with error_context(block):
            parameters |= {ours: data.section(block).number(key) for key, ours in keys.items()}
    return fit_camera(
        str(path), model, parameters, data.size("image_width", "image_height"), max_fov_deg
    )


def _scaramuzza(data: Section, path: Path, max_fov_deg: float | None) -> OcamCamera:
    """Return the camera of OCam parameters, whose affine map is u = C x + D y + cx, v = E x + y +
    cy.
    """
    C, D, E, u, v = (
        data.section("affine_parameters").number(name) for name in ("ac", "ad", "ae", "cx", "cy")
    )
    poly, inv_poly = (
        list(data.section(f"{name}_parameters").numbers().values()) for name in ("poly", "inv_poly")
    )
    if abs(C) < 1e-3:
        raise OmnistereoError(f"affine_parameters: ac is {C:g}; expected about 1")
    records = {
        # in pixels along u: f(r) → C f(r / C)
        "poly": [len(poly), *(a * C ** (1 - k) for k, a in enumerate(poly))],
        "inv_poly": [len(inv_poly), *(C * b for b in inv_poly)],
        "center": [v, u],
        "affine": [1 / C, E / C, D / C],
        "image_size": [data.require("image_height"), data.require("image_width")],
    }
    return ocam_camera(records, max_fov_deg, str(path))
