"""The cameras of OpenCV and ROS files: K, D, R, T and image size of each; X_cam = R X_rig + T.

OpenCV defines no keys for a rig, so three layouts are read, as YAML, JSON, XML, TOML and npz:

- one mapping per camera, at the top or under `cameras`, in order; fx, fy, cx, cy may replace K, and
  what all cameras share may stand at the top;
- the same keys at the top with the number of the camera, as K1 D1 K2 D2 R2 T2; a pair may say R, T
  for the second camera, as `cv2.fisheye.stereoCalibrate` returns them: R1, R2, P1, P2 are then the
  rectification;
- lists of one value per camera, as `cv2.calibrateMultiview` returns them.

The model is stated, or shown by the 5, 8, 12 or 14 coefficients of a pinhole.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from omnistereo_lib.errors import OmnistereoError, error_context
from omnistereo_lib.parse import Section, check_count, parse_floats
from omnistereo_rigs.formats.camera_models import FISHEYE, PINHOLE, RADTAN
from omnistereo_rigs.formats.table import K9, Parameters, in_order

# The keys that are read: OpenCV's samples, tutorials and arguments, ROS.
K = "K|k|M|camera_matrix|cameraMatrix|mtx"
D = "D|d|distortion_coefficients|distortion_coeffs|dist_coeffs|distCoeffs|dist"
POSE = "R|rvec T|t|tvec"
SIZE = "image_size|imageSize|resolution|dim|DIM"
_SIDES = ("image_width", "image_height"), ("width", "height")
_WORDS = ("distortion_model", "camera_model", "lens_type", "model")
_FLAGS = ("fisheye", "is_fisheye", "fisheye_model")
_SHARED = (*SIZE.split("|"), *_SIDES[0], *_WORDS, *_FLAGS)
_LISTS = {"Ks": "K", "distortions": "D", "Rs": "R", "Ts": "T", "image_sizes": "image_size"}
_LISTS |= {"is_fisheye": "is_fisheye"}
_NOT_BLOCKS = ("roi", "header")

_K = {K: K9}
MODELS: dict[str, tuple[str, Parameters]] = {
    "fisheye": ("kb4", _K | {D: FISHEYE}),
    "plumb_bob": ("pinhole", _K | {f"{D}?": RADTAN}),
    "omnidir": ("omni", _K | {f"{D}?": RADTAN[:4], "xi": "xi"}),
    "double_sphere": ("ds", _K | {D: (), "xi": "xi", "alpha": "alpha"}),
    "eucm": ("eucm", _K | {D: (), "alpha": "alpha", "beta": "beta"}),
    "ucm": ("ucm", _K | {D: (), "alpha": "alpha"}),
    "fov": ("fov", _K | {D: (), "omega": "w"}),
    "none": ("pinhole", _K | {D: ()}),
}
ALIASES = {
    word: name
    for name, words in {
        "fisheye": "equidistant equi opencv_fisheye kannala_brandt kb4",
        "plumb_bob": "rational_polynomial rational radtan brown brown_conrady opencv pinhole",
        "omnidir": "omni omnidirectional mei",
        "double_sphere": "ds",
        "fov": "atan",
    }.items()
    for word in words.split()
}
_OF_A_PINHOLE = (5, 8, 12, 14)  # coefficients of OpenCV; cv2.fisheye has 4


def is_opencv(data: Mapping[str, Any]) -> bool:
    """Return whether a file has camera matrices, or focal lengths, as OpenCV and ROS name them."""
    cameras = data.get("cameras", data)
    inner = cameras.values() if isinstance(cameras, Mapping) else cameras
    listed = not isinstance(inner, str | int | float)
    return (
        "Ks" in data
        or _has_matrix(data)
        or any(_numbered(key) for key in data)
        or (listed and any(map(_has_matrix, inner)))
    )


def _has_matrix(cam: Any) -> bool:
    """Return whether a value is one camera: it, or one block of it, states K, or fx, fy, cx, cy."""
    if not isinstance(cam, Mapping) or "data" in cam:
        return False
    blocks = [cam, *(each for each in cam.values() if isinstance(each, Mapping))]
    return [bool({*K.split("|")} & {*b}) or {*PINHOLE} <= {*b} for b in blocks].count(True) == 1


def _numbered(key: str) -> tuple[str, int] | None:
    """Return the key and the camera of K1, D_2 and camera_matrix_0; k1 is a coefficient."""
    found = re.fullmatch(r"(\w*?[A-Za-z])_?([0-9]{1,4})", str(key))
    known = (*K.split("|"), *D.split("|"), "R", "T", "rvec", "tvec", "xi")
    if found is None or found[1] not in known or found[1] in ("k", "d"):
        return None
    return found[1], int(found[2])


def cameras(data: Section, path: Path) -> list[Section]:
    """Return the cameras in file order, each with the keys that all share, and its model."""
    cams = [data.add(name, cam) for name, cam in _layout(data).items()]
    for cam in cams:
        cam.values = {k: data.get(k) for k in _SHARED if data.get(k) is not None} | cam.values
        with error_context(cam.name or path):
            _complete(cam)
        has_pose = cam.get("T") is not None and not {"header", "binning_x"} & cam.values.keys()
        is_info = cam.get("P|p") is not None and cam.get("R|r") is not None and not has_pose
        if is_info and len(cams) > 1:
            raise OmnistereoError(
                "camera_info has no pose: R there is the rectification. Put cam1.yaml, cam2.yaml, "
                "… and poses.txt (a line rx ry rz tx ty tz for each, camera → rig) into a folder, "
                "and pass the folder"
            )
    return cams


def _complete(cam: Section) -> None:
    """Write model, camera matrix, coefficients and size in the form that the row reads."""
    cam.values["model"] = model = _model(cam)
    cam.ignore(*_WORDS, *_FLAGS)
    if set(PINHOLE) <= cam.values.keys() and not cam.get(K):
        fx, fy, cx, cy = (cam.number(name) for name in PINHOLE)
        cam.values["K"] = [fx, 0, cx, 0, fy, cy, 0, 0, 1]
    if "k1" in cam.values and not cam.get(D):
        names = FISHEYE if model == "fisheye" else RADTAN
        cam.values["D"] = [cam.number(name, default=0) for name in names]
    for width, height in _SIDES:
        if cam.get(SIZE) is None and cam.get(width) is not None:
            cam.values["image_size"] = [cam.number(width), cam.number(height)]


def _layout(data: Section) -> dict[str, dict[str, Any]]:
    """Return the keys of each camera, by its name."""
    lists = {key: data.get(key) for key in _LISTS if isinstance(data.get(key), list)}
    if "Ks" in lists:
        count = len(lists["Ks"])
        check_count(count)
        if {*map(len, lists.values())} != {count}:
            raise OmnistereoError(f"{' '.join(lists)} have different lengths; expected {count}")
        each = ({_LISTS[key]: value[n] for key, value in lists.items()} for n in range(count))
        return {f"camera {n}": cam for n, cam in enumerate(each, 1)}
    if "cameras" in data.values:
        value = data.require("cameras")
        cams = value if isinstance(value, Mapping) else dict(enumerate(value, 1))
        check_count(len(cams))
        return {f"camera {key}": _flat(Section(cams[key]).values) for key in in_order(cams)}
    nested = [key for key, value in data.values.items() if _has_matrix(value)]
    check_count(len(nested))
    if len(nested) > 1:
        data.ignore(*nested)
        return {f"camera {key}": _flat(data.values[key]) for key in in_order(nested)}
    numbered: dict[int, dict[str, Any]] = {}  # as K1, D1, R2, T2
    for key in data.values:
        if found := _numbered(key):
            cam = numbered.setdefault(found[1], {})
            if found[0] in cam:
                raise OmnistereoError(
                    f"{key}: camera {found[1]} has another {found[0]}. Delete one"
                )
            cam[found[0]] = data.get(key)
    numbered = {n: numbered[n] for n in sorted(numbered) if _has_matrix(numbered[n])}
    check_count(len(numbered))
    R, T = data.get("R"), data.get("T")
    if len(numbered) == 2 and R is not None and T is not None:
        for cam in numbered.values():  # R1 and R2 rectify
            cam.pop("R", None)
        numbered[max(numbered)] |= {"R": R, "T": T}
    if numbered:
        return {f"camera {n}": cam for n, cam in numbered.items()}
    data.ignore(*data.values)
    return {"": _flat(data.values)}


def _flat(cam: Mapping[str, Any]) -> dict[str, Any]:
    """Return a camera with the keys of its blocks, such as intrinsics: {fx: …}, beside its own."""
    flat: dict[str, Any] = {}
    for key, value in cam.items():
        is_block = isinstance(value, Mapping) and "data" not in value and key not in _NOT_BLOCKS
        for name, inner in value.items() if is_block else [(key, value)]:
            name = str(name).lower() if str(name).lower() in ("xi", "alpha", "beta") else str(name)
            if flat.setdefault(name, inner) != inner:
                raise OmnistereoError(f"{name} is stated twice, differently. Delete the wrong one")
    return flat


def _model(cam: Section) -> str:
    """Return the model that a camera states, or that its coefficients show, by our word."""
    words = [re.sub(r"[\s-]", "_", cam.word(key)) for key in _WORDS if cam.get(key) is not None]
    flags = [cam.word(key) for key in _FLAGS if cam.get(key) is not None]
    words += ["fisheye" if flag in ("true", "1", "yes", "on") else "pinhole" for flag in flags]
    # pinhole + equidistant is a fisheye
    stated = dict.fromkeys(ALIASES.get(word, word) for word in words if word != "pinhole")
    if len(stated) > 1:
        raise OmnistereoError(f"two camera models are stated, {' and '.join(words)}. Delete one")
    if words:
        return [*stated, "plumb_bob"][0]
    key = cam.at(D)[1]
    count = parse_floats(cam.get(D, []), key).size
    if count not in _OF_A_PINHOLE:
        raise OmnistereoError(
            f"no model is stated, and {key} has {count} numbers. Add distortion_model: fisheye "
            "(cv2.fisheye, equidistant), plumb_bob (cv2.calibrateCamera), none, omnidir (xi), "
            "double_sphere, eucm, ucm or fov"
        )
    return "plumb_bob"
