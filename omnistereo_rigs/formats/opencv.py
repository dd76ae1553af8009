"""OpenCV, ROS and MC-Calib files: K, D, R, T and image size of each camera; X_cam = R X_rig + T; no
unit is stated.

OpenCV defines no keys for a rig, so two layouts are read, as YAML, JSON and XML:

- one mapping per camera, at the top or under `cameras`, in order, with the keys of `_KEYS` (R is 3
  × 3 or an axis-angle; fx, fy, cx, cy may replace K, and k1, k2, … D; the size may be at the top
  for all cameras);
- the same keys at the top with the number or the side of the camera, as K1 D1 K2 D2 R2 T2; a pair
  may say R, T for the second camera, as `cv2.fisheye.stereoCalibrate` returns them: R1, R2, P1, P2
  are then the rectification.

The first camera may omit R and T: it is then the rig frame. MC-Calib states `camera_pose_matrix`
instead, camera → rig. Beside P, as in a camera_info, R is the rectification. The model is stated,
by xi, too, or found by `_guess_model`.
"""

import re
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from omnistereo_lib.errors import OmnistereoError, error_context
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.field_of_view import field_of_view_deg, ring_rays
from omnistereo_lib.geometry.pose import Pose, rotation_from_axis_angle
from omnistereo_lib.parse import (
    SAME_DEG,
    RigFile,
    Section,
    parse_axis_angle,
    parse_floats,
    parse_size,
)
from omnistereo_rigs.formats.camera_models import FISHEYE, PINHOLE, RADTAN, make_camera_model
from omnistereo_rigs.formats.fit import fit_camera, pixels_beyond

# What is read: its usual keys, then a pattern for every spelling, in lower case without "_" and
# "-".
_KEYS = {
    "K": (
        "K camera_matrix cameraMatrix",
        "[km]|mtx|(camera|cam|intrinsic|calibration)(matrix|mat|mtx)",
    ),
    "D": (
        "D dist_coeffs distortion_coefficients",
        r"d|coef\w*|(lens)?dist(ortions?)?(coef\w*|vec\w*|par\w*)?",
    ),
    "R": ("R rvec", "r|rvec|rotationvector"),
    "T": ("T t tvec", "t|tvec|translationvector"),
    "size": ("image_size resolution", "(image|img|calib)?(size|resolution|dims?|dimensions?)"),
    "width": ("image_width", "(image|img)?w(idth)?"),
    "height": ("image_height", "(image|img)?h(eight)?"),
    "model": (
        "distortion_model camera_model",
        "(camera|distortion|dist|lens|projection)(model|type)|model|projection",
    ),
    "fisheye": ("fisheye", "(is|use|opencv)*fisheye(model)?"),
}
_SIDES = "left|right|front|back|rear|top|bottom"
_RATIONAL = ("pinhole", RADTAN)
# Words for a model, in lower case without separators: ours, and its coefficients in the order of D.
# 0, 1: MC-Calib.
_MODELS = {
    "equi(distant)?|(opencv)?fisheye|kannalabrandt8?|kb[48]|1": ("kb4", FISHEYE),
    "plumbbob|rational(polynomial)?|radtan|radialtangential|brown(conrady)?|opencv|pinhole|"
    "perspective|0": (_RATIONAL),
    "omnidir(ectional)?|omni|mei": ("omni", RADTAN[:4]),
    "none": ("pinhole", ()),
}
_EXPECTED = (
    "expected fisheye (equidistant), plumb_bob, rational_polynomial, omnidir (with xi) or none."
    " Recalibrate with it"
)


def read_opencv(data: Section, path: Path, max_fov_deg: float | None) -> RigFile:
    """Read OpenCV, ROS: K, D, R, T and the size of each camera, fisheye, omnidirectional (`xi`),
    plumb_bob or rational.

    The layouts are those of the module docstring. Raises an `OmnistereoError` for a camera_info in
    a rig.
    """
    cams, cameras, T_rig_cam = _cameras(data), [], []
    for n, cam in enumerate(cams):
        name = f"camera {cam.name}" if cam.name else ""
        with error_context(name or path):
            T_rig_cam.append(_parse_pose(cam, n == 0, len(cams) == 1))
            cameras.append(
                _parse_camera(cam, data, f"{path}, {name}".removesuffix(", "), max_fov_deg)
            )
            if any(cam.number(key, default=0) > 1 for key in ("binning_x", "binning_y")):
                raise OmnistereoError(
                    "the images are binned (binning_x, binning_y). Calibrate them at their own size"
                )
            if cam.get("camera_group") != cams[0].get("camera_group"):
                raise OmnistereoError(
                    "camera_group is not that of the first camera: no pose connects them"
                )
    return RigFile(cameras, T_rig_cam)


def read_mc_calib(data: Section, path: Path, max_fov_deg: float | None) -> RigFile:
    """Read MC-Calib: calibrated_cameras_data.yml, pinhole and fisheye."""
    return read_opencv(data, path, max_fov_deg)


def is_opencv(data: dict[str, Any]) -> bool:
    """Return whether a file has camera matrices, or focal lengths, as OpenCV and ROS name them."""
    cameras = data.get("cameras", data)
    inner = (
        [*cameras.values()]
        if isinstance(cameras, dict)
        else cameras
        if isinstance(cameras, list)
        else []
    )
    numbered = any(_meaning((_numbered(key) or ("",))[0]) == "K" for key in data)
    return numbered or _has_matrix(data) or any(map(_has_matrix, inner))


def _meaning(key: str) -> str | None:
    """Return what a key states, one of `_KEYS`."""
    letters = re.sub("[_-]", "", str(key)).lower()
    return next(
        (meaning for meaning, (_, pattern) in _KEYS.items() if re.fullmatch(pattern, letters)), None
    )


def _names(cam: Section, meaning: str) -> list[str]:
    """Return the keys of a camera that state something, then the usual ones."""
    return [
        *dict.fromkeys(
            [*(key for key in cam.values if _meaning(key) == meaning), *_KEYS[meaning][0].split()]
        )
    ]


def _numbered(key: str) -> tuple[str, str] | None:
    """Return the key and the camera of K1, dist_coeffs_0, cameraMatrixLeft and left_K; k1 is a
    coefficient.
    """
    behind = re.fullmatch(rf"(\w*?[A-Za-z])_?([0-9]{{1,4}}|(?i:{_SIDES})|(?<=_)[lr])", str(key))
    before = re.fullmatch(rf"((?i:{_SIDES}))_?(\w+)", str(key))
    name, camera = (
        (behind[1], behind[2]) if behind else (before[2], before[1]) if before else ("", "")
    )
    return None if re.fullmatch("[a-z]?", name) or not _meaning(name) else (name, camera.lower())


def _has_matrix(cam: Any) -> bool:
    """Return whether a value is one camera: it, or one block of it, states K, or fx, fy, cx and
    cy.
    """

    def states(keys: Iterable[str]) -> bool:
        return any(_meaning(key) == "K" for key in keys) or set(PINHOLE) <= set(keys)

    if not isinstance(cam, dict) or "data" in cam:
        return False
    return (
        states(cam)
        or [states(value) for value in cam.values() if isinstance(value, dict)].count(True) == 1
    )


def _flat(cam: dict[str, Any]) -> dict[str, Any]:
    """Return a camera with the keys of its blocks, such as intrinsics: {fx: …}, beside its own."""
    flat: dict[str, Any] = {}
    for key, value in cam.items():
        is_block = isinstance(value, dict) and "data" not in value and key != "roi"
        is_block = is_block and any(
            _meaning(inner) or inner in (*PINHOLE, *RADTAN) for inner in value
        )
        for name, inner in value.items() if is_block else [(key, value)]:
            if flat.setdefault(str(name), inner) != inner:
                raise OmnistereoError(
                    f"{name} is stated twice with different values. Delete the wrong one"
                )
    return flat


def _cameras(data: Section) -> list[Section]:
    """Return the cameras in file order."""
    if "cameras" in data.values:
        cameras = data.require("cameras")
        items = cameras.items() if isinstance(cameras, dict) else enumerate(cameras, 1)
        return [
            data.add(str(name), _flat(cam) if isinstance(cam, dict) else cam) for name, cam in items
        ]
    nested = [key for key, value in data.values.items() if _has_matrix(value)]
    if len(nested) > 1:
        data.ignore(*nested)
        return [data.add(key, _flat(data.values[key])) for key in nested]
    numbered: dict[str, dict[str, Any]] = {}  # as K1, D1, R2, T2
    for key in data.values:
        if found := _numbered(key):
            numbered.setdefault(found[1], {})[found[0]] = data.get(key)
    numbered = {name: cam for name, cam in numbered.items() if _has_matrix(cam)}
    if not numbered:
        data.values = _flat(data.values)
        return [data]
    R, T = data.get(*_names(data, "R")), data.get(*_names(data, "T"))
    if len(numbered) == 2 and R is not None and T is not None:
        first, second = numbered.values()
        for cam in (first, second):  # R1 and R2 rectify
            cam.pop("R", None)
        second |= {"R": R, "T": T}
    names = sorted(numbered, key=int) if all(map(str.isdecimal, numbered)) else [*numbered]
    return [data.add(name, numbered[name]) for name in names]


def _parse_pose(cam: Section, first: bool, alone: bool) -> Pose:
    """Return camera → rig; of a file of one camera the identity."""
    if cam.get("camera_pose_matrix") is not None:
        return cam.pose("camera_pose_matrix")
    keys, T = (
        [key for key in _names(cam, "R") if cam.get(key) is not None],
        cam.get(*_names(cam, "T")),
    )
    is_info = cam.get("P", "p") is not None and (
        T is None or bool({"binning_x", "header"} & cam.values.keys())
    )
    if alone and (keys or T is not None) and not is_info:
        cam.note("R and T are not used: the pose of a camera by itself is that in poses.txt")
    if keys and is_info and not alone:
        raise OmnistereoError(
            "camera_info has no pose: R there is the rectification. Put cam1.yaml, cam2.yaml, … and"
            " poses.txt (a line rx ry rz tx ty tz for each, camera → rig) into a folder, and pass"
            " the folder"
        )
    if alone or (first and not keys and T is None):
        return Pose.identity()
    poses = []
    for key in keys or ["R"]:
        R = cam.floats(*([key] if keys else _names(cam, "R")))
        if R.size not in (3, 9):
            raise OmnistereoError(
                f"{key} has {R.size} numbers; expected a 3 × 3 matrix or an axis-angle of 3 numbers"
            )
        R = (
            cam.rotation(key, R)
            if R.size == 9
            else rotation_from_axis_angle(parse_axis_angle(R, key))
        )
        poses.append(Pose(R, cam.floats(*_names(cam, "T"), count=3)))
    if (poses[0].inverse() @ poses[-1]).magnitude()[0] > SAME_DEG:
        raise OmnistereoError(
            f"{' and '.join(keys)} state different rotations. Delete the wrong one"
        )
    return poses[0].inverse()


def _parse_camera(
    cam: Section, data: Section, source: str, max_fov_deg: float | None
) -> OcamCamera:
    sized = next(
        (
            s
            for s in (cam, data)
            for side in ("size", "width")
            if s.get(*_names(s, side)) is not None
        ),
        cam,
    )
    key, width = sized.key(*_names(sized, "size")), sized.key(*_names(sized, "width"))
    if sized.get(key) is None and sized.get(width) is not None:
        size = sized.size(width, sized.key(*_names(sized, "height")))
    else:
        size = parse_size(sized.require(*_names(sized, "size")), key)
    parameters, (name, model, coefficients) = (
        parse_focal(cam),
        _stated_model(cam) or _stated_model(data) or ("",) * 3,
    )
    if has_xi := cam.get("xi") is not None:
        parameters["xi"] = cam.number("xi")
    key = cam.key(*_names(cam, "D"))
    D = parse_floats(cam.get(key, default=[]), key).tolist()
    if not D and (single := [k for k in RADTAN if k in cam.values]):  # each by its name
        names = FISHEYE if model == "kb4" or (not model and set(single) <= {*FISHEYE}) else RADTAN
        D, key = [cam.number(k, default=0) for k in names], " ".join(single)
    if not model:
        name = "omni" if has_xi else _guess_model(cam, key, D, parameters, size)
        model, coefficients = _model(name)
    if has_xi != (model == "omni"):
        found = f"{name} {'with' if has_xi else 'without'} xi"
        raise OmnistereoError(f"the camera model is {found}; {_EXPECTED}")
    parameters |= cam.coefficients(key, D, coefficients, (4, 5) if model == "pinhole" else ())
    return fit_camera(source, model, parameters, size, max_fov_deg)


def parse_focal(cam: Section) -> dict[str, float]:
    """Return fx, fy, cx, cy, and the skew if a camera matrix states them."""
    key = cam.key(*_names(cam, "K"))
    if key not in cam.values and set(PINHOLE) <= cam.values.keys():
        return {name: cam.number(name) for name in PINHOLE}
    K = cam.floats(*_names(cam, "K"), count=9)
    if not np.allclose(K[[3, 6, 7, 8]], [0, 0, 0, 1], atol=1e-9):
        raise OmnistereoError(f"{key} is {K.tolist()}; expected fx skew cx, 0 fy cy, 0 0 1")
    return dict(zip(("fx", "skew", "cx", "fy", "cy"), K[[0, 1, 2, 4, 5]].tolist(), strict=True))


def _stated_model(cam: Section) -> tuple[str, str, tuple[str, ...]] | None:
    """Return the model that a section names: its word, our name of it, and its coefficients."""
    words = [cam.word(key) for key in _names(cam, "model") if cam.get(key) is not None]
    flag = cam.word(*_names(cam, "fisheye"))
    words += {"": [], "true": ["fisheye"], "1": ["fisheye"]}.get(flag, ["pinhole"])
    words += ["fisheye"] if "RMS_error" in cam.values else []  # a block of Gyroflow
    # pinhole + equidistant is a fisheye
    stated = [(word, *_model(word)) for word in words if word != "pinhole"]
    if len({model for _, model, _ in stated}) > 1:
        raise OmnistereoError(
            f"two camera models are stated, {' and '.join(words)}. Delete the wrong one"
        )
    return (stated or [("pinhole", *_model("pinhole"))])[0] if words else None


def _model(word: str) -> tuple[str, tuple[str, ...]]:
    letters = re.sub(r"[\s_-]", "", word)
    found = next(
        (ours for pattern, ours in _MODELS.items() if re.fullmatch(pattern, letters)), None
    )
    if found is None:
        raise OmnistereoError(f"the camera model is {word}; {_EXPECTED}")
    return found


def _guess_model(
    cam: Section, key: str, D: list[float], focal: dict[str, float], size: tuple[int, int]
) -> str:
    """Return the model of a camera that states none, with a note that says why.

    Four numbers are a fisheye (k1 k2 k3 k4) or a pinhole (k1 k2 p1 p2). A pinhole sees 120° at
    most: where it does not reach the corners of the image, the camera is a fisheye. Where both do
    and differ by more than a pixel, an `OmnistereoError` asks for the model.
    """
    found = f"{key} has {len(D)} numbers" if " " not in key else f"{key} are stated"
    stated = f"{found if D else 'no distortion'} and no model is stated:"
    if len(D) not in (0, 4, 5, 8, 12, 14):
        raise OmnistereoError(
            f"{key} has {len(D)} numbers; expected 4 (fisheye), 5 or 8 (pinhole), and"
            " distortion_model"
        )
    if len(D) != 4:
        cam.note(f"{stated} read as a pinhole {'(plumb_bob)' if D else 'without distortion'}")
        return "plumb_bob" if D else "none"
    of_D = partial(zip, D, strict=True)
    fisheye = make_camera_model("kb4", focal | {k: d for d, k in of_D(FISHEYE)})
    pinhole = make_camera_model("pinhole", focal | {k: d for d, k in of_D(RADTAN[:4])})
    view, rays = field_of_view_deg(fisheye, size), ring_rays(np.radians(np.arange(1, 60)))
    uv, other = fisheye(rays)[0], pinhole(rays)[0]
    inside = ((uv >= 0) & (uv <= np.array(size) - 1)).all(-1)
    reach = all(pixels_beyond(model, size)[1] == 0 for model in (fisheye, pinhole))
    if reach and np.linalg.norm(uv - other, axis=-1)[inside].max(initial=0) > 1:
        raise OmnistereoError(
            f"{stated} a fisheye (k1 k2 k3 k4, {view:.0f}°) and a pinhole (k1 k2 p1 p2,"
            f" {field_of_view_deg(pinhole, size):.0f}°) are possible. Add distortion_model: fisheye"
            " or plumb_bob"
        )
    cam.note(
        f"{stated} read as a fisheye (k1 k2 k3 k4, {view:.0f}°), since a pinhole does not reach the"
        " corners of the image. If it is a pinhole, add distortion_model: plumb_bob"
    )
    return "fisheye"
