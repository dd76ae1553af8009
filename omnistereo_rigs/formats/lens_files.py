"""Lens files of other programs, one camera each: Metashape XML, Hugin .pto and .ini, lens profiles
of Gyroflow.

The top-left corner of the image is (0, 0) in Metashape and Hugin, so that pixel centres are shifted
by half a pixel. A profile of Gyroflow holds the fisheye camera of OpenCV.
"""

import configparser
import re
from pathlib import Path

import numpy as np

from omnistereo_lib.consumer_images import NO_DEPTH
from omnistereo_lib.errors import OmnistereoError, check_number
from omnistereo_lib.parse import RigFile, Section
from omnistereo_rigs.formats.camera_models import FISHEYE, RADII
from omnistereo_rigs.formats.fit import fit_camera
from omnistereo_rigs.formats.opencv import parse_focal

_METASHAPE = {
    "frame": "rectilinear",
    "fisheye": "equidistant",
    "equidistant_fisheye": "equidistant",
    "equisolid_fisheye": "equisolid",
}
_HUGIN = {
    0: "rectilinear",
    2: "equidistant",
    3: "equidistant",
    8: "orthographic",
    10: "stereographic",
    21: "equisolid",
}


def read_metashape(data: Section, path: Path, max_fov_deg: float | None) -> RigFile:
    """Read Metashape lens: XML of one camera.

    Absent coefficients are 0.
    """
    lens = data.section("calibration")
    projection = lens.word("projection", default="frame")
    if projection not in _METASHAPE:
        reason = (
            f". {NO_DEPTH}"
            if projection in ("spherical", "cylindrical")
            else ". Recalibrate with one of them"
        )
        raise OmnistereoError(
            f"projection is {projection}; expected one of {', '.join(_METASHAPE)}{reason}"
        )
    size = lens.size("width", "height")
    names = ("f", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4", "b1", "b2")
    parameters = {name: lens.number(name) for name in names if name == "f" or name in lens.values}
    for name, side in zip(("cx", "cy"), size, strict=True):  # from the middle of the image
        parameters[name] = lens.number(name, default=0) + side / 2 - 0.5
    model = f"metashape {_METASHAPE[projection]}"
    return RigFile([fit_camera(str(path), model, parameters, size, max_fov_deg)])


def read_hugin(data: Section, path: Path, max_fov_deg: float | None) -> RigFile:
    """Read Hugin lens: `.pto` or `.ini` of one camera."""
    kind = int(data.number("f"))
    if kind not in _HUGIN:
        reason = f". {NO_DEPTH}" if kind in (1, 4) else ". Recalibrate with one of them"
        raise OmnistereoError(
            f"the projection of the lens is {kind}; expected one of {[*_HUGIN]}{reason}"
        )
    if any(data.number(name, default=0) for name in "gt"):
        raise OmnistereoError(
            "the lens is sheared (g, t), as scans are; expected 0 and 0. Recalibrate"
        )
    width, height = size = data.size("w", "h")
    half_view = np.radians(
        check_number(data.number("v"), "the field of view v in degrees", 1, 360) / 2
    )
    parameters = {name: data.number(name, default=0) for name in "abc"}
    parameters |= {
        "f": width / 2 / float(RADII[_HUGIN[kind]](half_view)),
        "half_side": min(size) / 2,
    }
    for name, shift, side in (("cx", "d", width), ("cy", "e", height)):
        parameters[name] = side / 2 - 0.5 + data.number(shift, default=0)
    model = f"hugin {_HUGIN[kind]}"
    return RigFile([fit_camera(str(path), model, parameters, size, max_fov_deg)])


def read_gyroflow(data: Section, path: Path, max_fov_deg: float | None) -> RigFile:
    """Read Gyroflow lens profile: of one camera, opencv_fisheye, not stretched."""
    size, lens = data.section("calib_dimension").size("w", "h"), data.section("fisheye_params")
    kind = data.word("distortion_model") or "opencv_fisheye"
    stretched = {
        data.number(f"input_{side}_stretch", default=1) for side in ("horizontal", "vertical")
    } - {0, 1}
    if kind != "opencv_fisheye" or stretched or data.get("digital_lens"):
        raise OmnistereoError(
            "only profiles with the distortion_model opencv_fisheye, without stretch and"
            f" digital_lens, are read; found {kind}, {stretched or 'no'} stretch, digital_lens"
            f" {data.get('digital_lens')}. Calibrate the lens"
        )
    lens.ignore("radial_distortion_limit")  # `fit_camera` finds it
    D = lens.coefficients("distortion_coeffs", lens.floats("distortion_coeffs").tolist(), FISHEYE)
    return RigFile([fit_camera(str(path), "kb4", parse_focal(lens) | D, size, max_fov_deg)])


def parse_hugin(text: str, path: Path) -> dict[str, str]:
    """Return the lens of the first image of a project (.pto) or of a lens file (.ini), by the
    letters of a project.
    """
    if path.suffix == ".ini":
        parser = configparser.ConfigParser(interpolation=None)
        try:
            parser.read_string(text)
            lens = dict(parser["Lens"])
        except (configparser.Error, KeyError) as error:
            raise OmnistereoError(
                f"not a lens file of Hugin ({' '.join(str(error).split())[:200]})"
            ) from None
        names = {"image_width": "w", "image_height": "h", "type": "f", "hfov": "v"}
        return {
            names.get(key, key): value for key, value in lens.items() if key in (*names, *"abcdegt")
        }
    line = next((line for line in text.splitlines() if line.startswith("i ")), "")
    return dict(re.findall(r"\s([whfvabcdegt])(-?[0-9.]+(?:[eE][-+]?[0-9]+)?)(?=\s|$)", line))
