"""OpenCV, ROS and MC-Calib files: K, D, R, T and image size of each camera; X_cam = R X_rig + T; no
unit is stated.

OpenCV defines no keys for a rig, so three layouts are read, as YAML, JSON, XML, TOML and npz:

- one mapping per camera, at the top or under `cameras`, in order, with the keys of `_KEYS` (R is 3
  × 3 or an axis-angle; fx, fy, cx, cy may replace K, and k1, k2, … D; the size may be at the top
  for all cameras);
- the same keys at the top with the number or the side of the camera, as K1 D1 K2 D2 R2 T2; a pair
  may say R, T for the second camera, as `cv2.fisheye.stereoCalibrate` returns them: R1, R2, P1, P2
  are then the rectification;
- lists of one value per camera, as `cv2.calibrateMultiview` returns them: Ks, distortions, Rs, Ts,
  image_sizes.

The first camera may omit R and T: it is then the rig frame. MC-Calib states `camera_pose_matrix`
instead, camera → rig. Beside P, as in a camera_info, R is the rectification. The model is stated,
or shown by the parameters that only it has.
"""

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from omnistereo_lib.errors import OmnistereoError, error_context
from omnistereo_lib.geometry.field_of_view import field_of_view_deg
from omnistereo_lib.geometry.pose import Pose, rotation_from_axis_angle
from omnistereo_lib.parse import (
    SAME_DEG,
    Section,
    check_count,
    parse_axis_angle,
    parse_floats,
    parse_size,
)
from omnistereo_rigs.formats.camera_models import FISHEYE, PINHOLE, RADTAN, make_camera_model
from omnistereo_rigs.formats.fit import OPENCV_DEG, Lens, pixels_beyond
from omnistereo_rigs.formats.table import Found

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
_RATIONAL = ("pinhole", RADTAN, ())
# Words for a model, in lower case without separators: ours, its coefficients in the order of D, and
# its parameters that
# stand by themselves. 0, 1: MC-Calib.
_MODELS: dict[str, tuple[str, tuple[str, ...], tuple[str, ...]]] = {
    "equi(distant)?|(opencv)?fisheye|kannalabrandt8?|kb[48]|1": ("kb4", FISHEYE, ()),
    "plumbbob|rational(polynomial)?|radtan|radialtangential": _RATIONAL,
    "brown(conrady)?|opencv|pinhole|perspective|0": _RATIONAL,
    "omnidir(ectional)?|omni|mei": ("omni", RADTAN[:4], ("xi",)),
    "ds|doublesphere": ("ds", (), ("xi", "alpha")),
    "eucm|extendedunified(camera)?": ("eucm", (), ("alpha", "beta")),
    "ucm|unified(camera)?": ("ucm", (), ("alpha",)),
    "fov|atan|fieldofview": ("fov", (), ("omega",)),
    "none": ("pinhole", (), ()),
}
# A camera that states no model has that one whose parameters it states: the first that fits.
_SHOWN_BY = (
    ("ds", {"xi", "alpha"}),
    ("eucm", {"alpha", "beta"}),
    ("omni", {"xi"}),
    ("ucm", {"alpha"}),
    ("fov", {"omega"}),
)
_LISTS = {
    "K": "ks",
    "D": "ds",
    "R": "rs",
    "T": "ts",
}  # plurals that the pattern with an s behind does not find
_TANGENTIAL = 0.002  # p1 and p2 of lenses are below
_EXPECTED = (
    "expected fisheye (equidistant), plumb_bob, rational_polynomial, omnidir (with xi), "
    "double_sphere, eucm, fov or none. Recalibrate with it"
)


def read_opencv(data: Section, path: Path) -> Found:
    """Read OpenCV, ROS: K, D, R, T and the size of each camera, in the layouts of the module
    docstring.
    """
    cams, lenses, T_rig_cam = _cameras(data), [], []
    for n, cam in enumerate(cams):
        name = f"camera {cam.name}" if cam.name else ""
        with error_context(name or path):
            T_rig_cam.append(_parse_pose(cam, n == 0, len(cams) == 1))
            lenses.append(_parse_lens(cam, data, f"{path}, {name}".removesuffix(", ")))
            if any(cam.number(key, default=0) > 1 for key in ("binning_x", "binning_y")):
                raise OmnistereoError(
                    "the images are binned (binning_x, binning_y). Calibrate them at their own size"
                )
            if cam.get("camera_group") != cams[0].get("camera_group"):
                raise OmnistereoError(
                    "camera_group is not that of the first camera: no pose connects them"
                )
    return Found(lenses, T_rig_cam)


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
    return (
        numbered
        or _has_matrix(data)
        or any(map(_has_matrix, inner))
        or _list_of("K", data) is not None
    )


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
    """Return whether a value is one camera: it, or one block of it, states K, or fx, fy, cx, cy."""

    def states(keys: Iterable[str]) -> bool:
        return any(_meaning(key) == "K" for key in keys) or set(PINHOLE) <= set(keys)

    if not isinstance(cam, dict) or "data" in cam:
        return False
    return (
        states(cam)
        or [states(value) for value in cam.values() if isinstance(value, dict)].count(True) == 1
    )


def _list_of(meaning: str, data: dict[str, Any]) -> str | None:
    """Return the key of a list of matrices, one per camera: Ks, camera_matrices."""
    for key, value in data.items():
        letters = re.sub("[_-]", "", str(key)).lower()
        singular = re.sub("ices$", "ix", letters).removesuffix("s")
        plural = letters == _LISTS.get(meaning) or (
            letters != singular and _meaning(singular) == meaning
        )
        if plural and isinstance(value, list) and len(value) > 1:
            first = value[0]
            if isinstance(first, list) and first and isinstance(first[0], list):
                return key
    return None


def _per_camera(data: Section) -> list[dict[str, Any]]:
    """Return the cameras of a file of lists, each of whose values belongs to one camera."""
    count = len(data.values[str(_list_of("K", data.values))])
    check_count(count)
    cams: list[dict[str, Any]] = [{} for _ in range(count)]
    for key, value in data.values.items():
        letters = re.sub("[_-]", "", key).lower()
        singular = next((one for one, plural in _LISTS.items() if letters == plural), "")
        singular = singular or (
            key if _meaning(key) else re.sub("ices$", "ix", key).removesuffix("s")
        )
        if not (isinstance(value, list) and len(value) == count and _meaning(singular)):
            continue
        if _meaning(singular) != "size" or isinstance(value[0], list):  # else that of all cameras
            data.ignore(key)
            for cam, each in zip(cams, value, strict=True):
                cam[singular] = each
    return cams


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
    if _list_of("K", data.values):
        return [data.add(str(n), cam) for n, cam in enumerate(_per_camera(data), 1)]
    if "cameras" in data.values:
        cameras = data.require("cameras")
        check_count(len(cameras))
        items = cameras.items() if isinstance(cameras, dict) else enumerate(cameras, 1)
        return [
            data.add(str(name), _flat(cam) if isinstance(cam, dict) else cam) for name, cam in items
        ]
    nested = [key for key, value in data.values.items() if _has_matrix(value)]
    check_count(len(nested))
    if len(nested) > 1:
        data.ignore(*nested)
        return [data.add(key, _flat(data.values[key])) for key in nested]
    numbered: dict[str, dict[str, Any]] = {}  # as K1, D1, R2, T2
    for key in data.values:
        if found := _numbered(key):
            numbered.setdefault(found[1], {})[found[0]] = data.get(key)
    numbered = {name: cam for name, cam in numbered.items() if _has_matrix(cam)}
    check_count(len(numbered))
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
            "camera_info has no pose: R there is the rectification. Put cam1.yaml, cam2.yaml, … "
            "and poses.txt (a line rx ry rz tx ty tz for each, camera → rig) into a folder, and "
            "pass the folder"
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


def _parse_lens(cam: Section, data: Section, source: str) -> Lens:
    parameters, singles = _parse_focal(cam), _lens_parameters(cam)
    size = _parse_size(cam, data)
    name, model, coefficients, own = (
        _stated_model(cam) or _stated_model(data) or _shown_model(singles) or ("", "", (), ())
    )
    key = cam.key(*_names(cam, "D"))
    D = parse_floats(cam.get(key, default=[]), key).tolist()
    if not D and (
        single := [k for k in (*FISHEYE, *RADTAN) if k in cam.values]
    ):  # each by its name
        names = FISHEYE if model == "kb4" or (not model and set(single) <= {*FISHEYE}) else RADTAN
        D, key = [cam.number(k, default=0) for k in names], " ".join(dict.fromkeys(single))
    if not model:
        name, model, coefficients, own = _model_of(cam, key, D, parameters, size)
    if "xi" in singles and model not in ("ds", "omni"):
        raise OmnistereoError(f"the camera model is {name} with xi; {_EXPECTED}")
    if missing := [each for each in own if each not in singles]:
        raise OmnistereoError(
            f"the camera model is {name} without {' and '.join(missing)}; {_EXPECTED}"
        )
    parameters |= {"w" if each == "omega" else each: cam.number(singles[each]) for each in own}
    parameters |= cam.coefficients(
        key,
        D,
        coefficients,
        (4, 5) if model == "pinhole" and D else (0,) if not D and model != "kb4" else (),
    )
    return Lens(source, model, parameters, size, None, OPENCV_DEG if model == "kb4" else None)


def _parse_size(cam: Section, data: Section) -> tuple[int, int]:
    sides = ("size", "width")
    sized = next(
        (s for s in (cam, data) for side in sides if s.get(*_names(s, side)) is not None), cam
    )
    key, width = sized.key(*_names(sized, "size")), sized.key(*_names(sized, "width"))
    if sized.get(key) is None and sized.get(width) is not None:
        return sized.size(width, sized.key(*_names(sized, "height")))
    return parse_size(sized.require(*_names(sized, "size")), key)


def _lens_parameters(cam: Section) -> dict[str, str]:
    """Return the keys of parameters that only some models have: xi, alpha, beta, and omega, which
    may be called w.
    """
    found = {
        key.lower(): key for key in cam.values if key.lower() in ("xi", "alpha", "beta", "omega")
    }
    w = cam.values.get("w")
    if isinstance(w, float) and 0 < w < np.pi and not w.is_integer():  # no width
        found["omega"] = "w"
        cam.values["omega"] = cam.values.pop("w")
        found["omega"] = "omega"
    return found


def _parse_focal(cam: Section) -> dict[str, float]:
    """Return fx, fy, cx, cy, and the skew if a camera matrix states them."""
    key = cam.key(*_names(cam, "K"))
    if key not in cam.values and set(PINHOLE) <= cam.values.keys():
        return {name: cam.number(name) for name in PINHOLE}
    K = cam.floats(*_names(cam, "K"), count=9)
    if not np.allclose(K[[3, 6, 7, 8]], [0, 0, 0, 1], atol=1e-9):
        raise OmnistereoError(f"{key} is {K.tolist()}; expected fx skew cx, 0 fy cy, 0 0 1")
    named = dict(zip(("fx", "skew", "cx", "fy", "cy"), K[[0, 1, 2, 4, 5]].tolist(), strict=True))
    return named if named["skew"] else {name: named[name] for name in PINHOLE}


_Model = tuple[
    str, str, tuple[str, ...], tuple[str, ...]
]  # its word, ours, its coefficients, its other parameters


def _stated_model(cam: Section) -> _Model | None:
    """Return the model that a section names."""
    words = [cam.word(key) for key in _names(cam, "model") if cam.get(key) is not None]
    flag = cam.word(*_names(cam, "fisheye"))
    words += ["fisheye" if flag in ("true", "1", "yes", "on") else "pinhole"] * bool(flag)
    words += ["fisheye"] if "RMS_error" in cam.values else []  # a block of Gyroflow
    stated = [
        (word, *_model(word)) for word in words if word != "pinhole"
    ]  # pinhole + equidistant is a fisheye
    if len({model for _, model, _, _ in stated}) > 1:
        raise OmnistereoError(
            f"two camera models are stated, {' and '.join(words)}. Delete the wrong one"
        )
    return (stated or [("pinhole", *_model("pinhole"))])[0] if words else None


def _shown_model(singles: dict[str, str]) -> _Model | None:
    """Return the model whose parameters a camera states."""
    word = next((word for word, names in _SHOWN_BY if names <= singles.keys()), None)
    return None if word is None else (word, *_model(word))


def _model(word: str) -> tuple[str, tuple[str, ...], tuple[str, ...]]:
    letters = re.sub(r"[\s_-]", "", word)
    found = next(
        (ours for pattern, ours in _MODELS.items() if re.fullmatch(pattern, letters)), None
    )
    if found is None:
        raise OmnistereoError(f"the camera model is {word}; {_EXPECTED}")
    return found


def _model_of(
    cam: Section, key: str, D: list[float], focal: dict[str, float], size: tuple[int, int]
) -> _Model:
    """Return the model of a camera that states none, with a note that says why.

    Five or eight numbers are a pinhole's. Four are a fisheye's (k1 k2 k3 k4) or a pinhole's (k1 k2
    p1 p2), which sees 120° at most: where it does not reach the corners of the image, and the last
    two are larger than any p1 and p2, the camera is a fisheye, as in files of cv2.fisheye. Else an
    `OmnistereoError` asks for the model.
    """
    found = f"{key} has {len(D)} numbers" if " " not in key else f"{key} are stated"
    if len(D) not in (0, 4, 5, 8, 12, 14):
        raise OmnistereoError(
            f"{key} has {len(D)} numbers; expected 4 (fisheye), 5 or 8 (pinhole), and "
            "distortion_model"
        )
    said = f"{found if D else 'no distortion'} and no model is stated:"
    if len(D) != 4:
        cam.note(f"{said} read as a pinhole {'(plumb_bob)' if D else 'without distortion'}")
        word = "plumb_bob" if D else "none"
        return word, *_model(word)
    models = {
        model: make_camera_model(model, focal | dict(zip(names, D, strict=False)))
        for model, names in (("kb4", FISHEYE), ("pinhole", RADTAN))
    }
    fisheye, pinhole = (field_of_view_deg(model, size) for model in models.values())
    looks_tangential = 0 < max(map(abs, D[2:])) < _TANGENTIAL
    if looks_tangential or pixels_beyond(models["pinhole"], size)[1] == 0:
        raise OmnistereoError(
            f"{said} a fisheye (k1 k2 k3 k4, {fisheye:.0f}°) and a pinhole (k1 k2 p1 p2, "
            f"{pinhole:.0f}°) are possible. Add distortion_model: fisheye or plumb_bob"
        )
    cam.note(
        f"{said} read as a fisheye (k1 k2 k3 k4, {fisheye:.0f}°), since a pinhole does not reach "
        "the corners of the image. If it is a pinhole, add distortion_model: plumb_bob"
    )
    return "fisheye", *_model("fisheye")
