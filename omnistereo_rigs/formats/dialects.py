"""The table of dialects, a row each; `table` says what a row means and interprets it."""

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from omnistereo_lib.errors import OmnistereoError, error_context
from omnistereo_lib.files import path_within, read_data
from omnistereo_lib.parse import Section, check_count, parse_floats
from omnistereo_lib.rig_file import MAX_BYTES
from omnistereo_rigs.formats import colmap, opencv
from omnistereo_rigs.formats.camera_models import (
    F_THETA,
    FISHEYE,
    FISHEYE624,
    METASHAPE,
    PINHOLE,
    RADTAN,
)
from omnistereo_rigs.formats.table import (
    ALL,
    FLU,
    K9,
    OPENGL,
    Dialect,
    Parameters,
    Value,
    Way,
    in_order,
    numbers,
    parse_pose,
)

# Where the cameras are.


def _one(data: Section, path: Path) -> list[Section]:
    return [data]


def _having(*keys: str) -> Callable[[Section, Path], list[Section]]:
    """Return the mappings that have one of the keys."""
    return lambda data, path: [
        data.section(name)
        for name in in_order(n for n, cam in data.values.items() if {*keys} & _mapping(cam).keys())
    ]


def _chain(data: Section, path: Path) -> list[Section]:
    """Return the cameras, without a gap in their numbers; or the one."""
    if "camera_model" in data.values:
        return [data]
    cams = _having("camera_model", "intrinsics")(data, path)
    numbers = [int(found[0]) for cam in cams if (found := re.search("[0-9]{1,9}$", cam.name))]
    if len(numbers) == len(cams) > 0 and numbers[-1] - numbers[0] != len(cams) - 1:
        raise OmnistereoError(
            f"found {', '.join(cam.name for cam in cams)}; expected a chain without a gap. Add the "
            "camera, or number them anew"
        )
    return cams


def _basalt(data: Section, path: Path) -> list[Section]:
    value = data.section("value0")
    keys = ("T_imu_cam", "intrinsics", "resolution")
    lists = [value.require(key) for key in keys]
    if any(not isinstance(each, list) or len(each) != len(lists[0]) for each in lists):
        raise OmnistereoError(f"expected lists of one {', '.join(keys)} each per camera")
    cams = []
    for n, (pose, lens, size) in enumerate(zip(*lists, strict=True)):
        cam = value.add(f"camera {n}", lens)
        cam.values |= {"T_imu_cam": pose, "resolution": size}
        cams.append(cam)
    return cams


def _vins(data: Section, path: Path) -> list[Section]:
    cams = []
    count = sum(name.startswith("body_T_cam") for name in data.values)
    check_count(count)
    for n in range(count):
        file = path_within(path.parent, data.require(f"cam{n}_calib"), path)
        pose = data.require(f"body_T_cam{n}")
        with error_context(file):
            lens = {"body_T_cam": pose} | Section(read_data(file, MAX_BYTES)).values
            cams.append(data.add(str(file), lens, f"cam{n}_calib"))
    return cams


def _frames(data: Section, path: Path) -> list[Section]:
    """Return one frame for each camera of transforms.json, all of one moment."""
    shared = {key: value for key, value in data.values.items() if key != "frames"}
    frames = data.require("frames")
    data.ignore("frames", *shared)
    cams = []
    for n, frame in enumerate(frames, 1):
        with error_context(f"frame {n}"):
            cams.append(Section(shared | Section(frame).values, f"frame {n}"))
    poses = [parse_pose(cam, _TRANSFORM) for cam in cams]
    moment = colmap.find_moment([str(cam.get("file_path")) for cam in cams], poses, path)
    for camera, images in moment.of_camera.items():
        lenses = [[cams[n].values.get(key) for key in (*_FL, "w", "h", "k1")] for n in images]
        if any(lens != lenses[0] for lens in lenses):
            raise OmnistereoError(
                f"the frames of {camera} have several lenses; expected one. Keep those of one "
                "moment"
            )
    found = [data.add(cams[n].name, cams[n].values) for n in moment.images]
    for cam in found:
        cam.ignore(*_NOT_OF_A_CAMERA.split())
        stated = [key for key in FISHEYE if cam.values.get(key) is not None]
        if stated != [*FISHEYE[: len(stated)]]:
            raise OmnistereoError(
                f"{cam.name}: found {' '.join(stated)}; expected k1 k2 … without a gap. Write what "
                "is missing, 0 where the lens has none"
            )
        if not stated and "FISHEYE" in str(cam.values.get("camera_model")):
            cam.note("none of k1 to k4 is stated: 0, as nerfstudio takes it")
    return found


def _sensors(data: Section, path: Path) -> list[Section]:
    """Return the cameras among the sensors, with R of roll, pitch, yaw in degrees: Rz Ry Rx."""
    data.note("axes and pixel centres are as DriveWorks documents them, not checked with it")
    sensors = data.section("rig").sections("sensors").values()
    cams = [each for each in sensors if "camera" in str(each.get("name", "camera"))]
    for cam in cams:
        degrees = cam.floats("nominalSensor2Rig_FLU.roll-pitch-yaw", 3)
        cam.values["R"] = Rotation.from_euler("xyz", degrees, degrees=True).as_matrix().tolist()
    return cams


def _sockets(data: Section, path: Path) -> list[Section]:
    """Return the cameras in the order of their sockets; the root states no rotation."""
    cams, items = dict[str, Section](), data.require("cameraData")
    for item in items if isinstance(items, list) else [items]:
        if not (isinstance(item, list) and len(item) == 2):
            raise OmnistereoError("cameraData: expected pairs of a socket and a camera")
        cam = data.add(f"socket {item[0]}", {"socket": item[0]} | Section(item[1]).values)
        cam.ignore("lensPosition", "specHfovDeg", "socket")
        if "extrinsics" in cam.values:
            pose = cam.section("extrinsics")
            pose.ignore("specTranslation", "lengthUnit")
            if pose.values.get("lengthUnit", 1) != 1:
                raise OmnistereoError(
                    f"{cam.name}: lengthUnit is {pose.values['lengthUnit']}; expected 1, "
                    "centimetres. Write its translation in them"
                )
            if not pose.values.get("rotationMatrix"):
                pose.values["rotationMatrix"] = np.eye(3).tolist()
        cams[cam.name] = cam
    return [cams[name] for name in in_order(cams)]


# Parameters that are more than numbers in their order.


def _metashape(lens: Section) -> dict[str, float]:
    """Return its numbers; u = (f + b1) x + b2 y + cx, v = f y + cy, from the middle."""
    found = numbers(lens, {"f": "f"} | {f"{key}?": key for key in METASHAPE})
    b1, b2, cx, cy = (lens.number(key, 0) for key in ("b1", "b2", "cx", "cy"))
    middle = {"cx": lens.number("width") / 2 + cx - 0.5, "cy": lens.number("height") / 2 + cy - 0.5}
    return found | middle | {"fx": found["fx"] + b1, "skew": b2}


def _f_theta(sensor: Section) -> dict[str, float]:
    """Return its numbers, radii in units of 100 px: u = c x + d y + cx, v = e x + y + cy."""
    kind = sensor.word("properties.polynomial-type", "pixeldistance-to-angle")
    if kind not in ("pixeldistance-to-angle", "angle-to-pixeldistance"):
        raise OmnistereoError(f"polynomial-type is {kind}; expected pixeldistance-to-angle")
    terms = parse_floats(str(sensor.require("properties.polynomial|bw-poly")).split(), "polynomial")
    if terms[0] != 0 or not 2 <= len(terms) <= 1 + len(F_THETA):
        raise OmnistereoError(f"polynomial is {terms}; expected 0 and 1 to 15 coefficients")
    to_angle = kind.startswith("pixel")
    terms = terms * 100.0 ** np.arange(len(terms)) if to_angle else terms / 100
    found = {"to_angle": float(to_angle), "fy": 100.0}
    for key, ours, default in (("c", "fx", 1), ("d", "skew", 0), ("e", "shear", 0)):
        found[ours] = 100 * sensor.number(f"properties.linear-{key}", default)
    center = numbers(sensor, {f"properties.{key}": key for key in ("cx", "cy")})
    return found | center | dict(zip(F_THETA, terms[1:].tolist(), strict=False))


# What recognises a file.


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _has(key: str) -> Callable[[dict[str, Any]], bool]:
    return lambda data: key in data


def _inside(*keys: str) -> Callable[[dict[str, Any]], bool]:
    """Return whether a file, or a mapping in it, has all keys."""
    return lambda data: any({*keys} <= _mapping(each).keys() for each in (data, *data.values()))


def _items(name: str, key: str) -> Callable[[dict[str, Any]], bool]:
    """Return whether a list, or one in `rig`, holds mappings one of which has the key."""

    def recognises(data: dict[str, Any]) -> bool:
        lists = [each.get(name) for each in (data, _mapping(data.get("rig")))]
        found = [item for each in lists if isinstance(each, list) for item in each]
        return any(key in _mapping(item) for item in found)

    return recognises


_TRANSFORM = Way("transform_matrix", OPENGL)
_NONE = "distortion_coeffs|distortion_coefficients"
_BY_NAME = {"intrinsics": ALL}
_RADTAN_BLOCK = {f"distortion_parameters.{key}": key for key in RADTAN[:4]}
_MU = dict(zip(("mu", "mv", "u0", "v0", "k2", "k3", "k4", "k5"), (*PINHOLE, *FISHEYE), strict=True))
_GAMMA = dict(zip(("gamma1", "gamma2", "u0", "v0"), PINHOLE, strict=True))


def _block(names: Mapping[str, str]) -> dict[str, str]:
    return {f"projection_parameters.{key}": name for key, name in names.items()}


_CAMODOCAL: dict[str, tuple[str, Parameters]] = {
    "mei": ("omni", {"mirror_parameters.xi": "xi"} | _RADTAN_BLOCK | _block(_GAMMA)),
    "kannala_brandt": ("kb4", _block(_MU)),
    "pinhole": ("pinhole", _RADTAN_BLOCK | _block({key: key for key in PINHOLE})),
}
_FL = {"fl_x": "fx", "fl_y": "fy", "cx": "cx", "cy": "cy"}
_FL_RADTAN: dict[str, str] = _FL | {f"{key}?": key for key in RADTAN[:5]}
# Keys of transforms.json: of images, of the scene, and of the focal length in another form.
_NOT_OF_A_CAMERA = """file_path depth_file_path colmap_im_id sharpness depth_unit_scale_factor
train_filenames val_filenames test_filenames ply_file_path mask_path aabb_scale scale
offset applied_transform orientation_override camera_angle_x camera_angle_y"""
_FISHEYES = {"fisheye": "equidistant", "equidistant_fisheye": "equidistant"}
_FISHEYES |= {"frame": "rectilinear", "equisolid_fisheye": "equisolid"}
# These programs project a fisheye by x / z and y / z: no point beyond 90° can have been used.
_AHEAD = 180.0
_DIVIDES = {"kb4": _AHEAD}
_RECALIBRATE = "Recalibrate without"

# Rows, in the order in which they are tried; fields on a line belong together.
# fmt: off
_COLMAP = Dialect(
    name="COLMAP rig", what="rig_config.json with cameras.txt beside it",
    recognises=_items("cameras", "image_prefix"), cameras=colmap.config_cameras,
    model="camera_model_name", models=colmap.MODELS, size="width height", origin=0.5,
    poses=(colmap.POSE,), measured_deg={model: _AHEAD for model, _ in colmap.MODELS.values()},
)
DIALECTS = (
    Dialect(
        name="basalt JSON",
        what="ds, eucm, ucm, kb4, pinhole, pinhole-radtan8 and fov. Masks camN/mask.png beside the "
             "file are read, too: N from 0, bright = valid",
        recognises=_has("value0"), cameras=_basalt, mask=lambda cam, n: f"cam{n}/mask.png",
        model="camera_type", poses=(Way("T_imu_cam"),), unit="metres",
        models={name: (name, _BY_NAME) for name in ("ds", "eucm", "ucm", "kb4", "fov")} | {
            "pinhole-radtan8": ("pinhole", _BY_NAME),
            "pinhole": ("pinhole", {f"intrinsics.{name}": name for name in PINHOLE}),
        },
    ),
    Dialect(
        name="Kalibr camchain",
        what="ds, eucm, omni, or pinhole with equidistant, radtan or fov; also one camera, and "
             "EuRoC's folders camN with sensor.yaml",
        recognises=_inside("camera_model", "intrinsics"), cameras=_chain,
        model="camera_model distortion_model=none",
        aliases={"equi": "equidistant", "plumb_bob": "radtan", "radial-tangential": "radtan"},
        models={
            "ds + none": ("ds", {"intrinsics": ("xi", "alpha", *PINHOLE), _NONE: ()}),
            "eucm + none": ("eucm", {"intrinsics": ("alpha", "beta", *PINHOLE), _NONE: ()}),
            "omni + none": ("omni", {"intrinsics": ("xi", *PINHOLE), _NONE: ()}),
            "omni + radtan": ("omni", {"intrinsics": ("xi", *PINHOLE), _NONE: RADTAN[:4]}),
            "pinhole + equidistant": ("kb4", {"intrinsics": PINHOLE, _NONE: FISHEYE}),
            "pinhole + radtan": ("pinhole", {"intrinsics": PINHOLE, _NONE: RADTAN[:4]}),
            "pinhole + fov": ("fov", {"intrinsics": PINHOLE, _NONE: ("w",)}),
            "pinhole + none": ("pinhole", {"intrinsics": PINHOLE, _NONE: ()}),
        },
        poses=(Way("T_cn_cnm1", to_camera=True, parent="previous"),
               Way("T_cam_imu", to_camera=True), Way("T_imu_cam"), Way("T_BS")),
        unit="metres", first_is_rig=True, measured_deg=_DIVIDES,
    ),
    Dialect(
        name="VINS configuration",
        what="with `body_T_cam0`, …, and the camodocal files that `cam0_calib`, … name",
        recognises=_has("body_T_cam0"), cameras=_vins, settings=True,
        model="model_type", models=_CAMODOCAL, size="image_width image_height",
        poses=(Way("body_T_cam"),), unit="metres",
    ),
    Dialect(
        name="camodocal camera", what="MEI, KANNALA_BRANDT or PINHOLE",
        recognises=_has("model_type"), cameras=_one,
        model="model_type", models=_CAMODOCAL, size="image_width image_height", unit="",
    ),
    Dialect(
        name="nerfstudio",
        what="transforms.json, each frame a camera, or folders of frames: OPENCV, OPENCV_FISHEYE "
             "or PINHOLE, and masks",
        recognises=_items("frames", "transform_matrix"), cameras=_frames,
        mask=lambda cam, n: cam.get("mask_path"), size="w h", origin=0.5, model="camera_model",
        models=dict.fromkeys(("opencv", "pinhole", "simple_pinhole"), ("pinhole", _FL_RADTAN))
        | {"opencv_fisheye": ("kb4", _FL | {f"{key}?": key for key in FISHEYE})},
        poses=(_TRANSFORM,), measured_deg=_DIVIDES,
        values={"is_fisheye": Value((), "Write camera_model: OPENCV_FISHEYE in its place"),
                "applied_scale": Value((1,), "Divide the translations by it, and delete it")},
    ),
    Dialect(
        name="Gyroflow lens profile", what="of one camera, opencv_fisheye, not stretched",
        recognises=_has("fisheye_params"), cameras=_one, settings=True,
        model="distortion_model=opencv_fisheye", size="calib_dimension.w calib_dimension.h",
        models={"opencv_fisheye": ("kb4", {"fisheye_params.camera_matrix": K9,
                                           "fisheye_params.distortion_coeffs": FISHEYE})},
        unit="", measured_deg=_DIVIDES,
        values={"input_horizontal_stretch": Value((1,), _RECALIBRATE),
                "input_vertical_stretch": Value((1,), _RECALIBRATE),
                "digital_lens": Value((), _RECALIBRATE)},
    ),
    Dialect(
        name="Anipose, Caliscope", what="calibration.toml, fisheye or not; rig → camera",
        recognises=_inside("matrix", "distortions", "size"), cameras=_having("matrix"),
        model="fisheye=false", aliases={"0": "false", "1": "true"}, size="size",
        models={"true": ("kb4", {"matrix": K9, "distortions": FISHEYE}),
                "false": ("pinhole", {"matrix": K9, "distortions": RADTAN[:5]})},
        poses=(Way("rotation translation", to_camera=True),), measured_deg=_DIVIDES,
        values={"ignore": Value((), "Delete the camera from the file")},
    ),
    Dialect(
        name="DepthAI", what="the calibration of a device: fisheye, perspective",
        recognises=_has("cameraData"), cameras=_sockets, settings=True,
        model="cameraType", aliases={"0": "perspective", "1": "fisheye"}, size="width height",
        models={"fisheye": ("kb4", {"intrinsicMatrix": K9, "distortionCoeff": FISHEYE}),
                "perspective": ("pinhole", {"intrinsicMatrix": K9, "distortionCoeff": RADTAN})},
        poses=(Way("extrinsics.rotationMatrix extrinsics.translation",
                   parent="extrinsics.toCameraSocket"),),
        unit="centimetres", measured_deg=_DIVIDES,
    ),
    Dialect(
        name="Project Aria",
        what="CameraCalibrations with FisheyeRadTanThinPrism and their image size; device ← camera",
        recognises=_items("CameraCalibrations", "Projection"), settings=True,
        cameras=lambda data, path: [*data.sections("CameraCalibrations").values()],
        model="Projection.Name", size="ImageSize|image_size|ImageSizes|resolution",
        models={"fisheyeradtanthinprism": ("fisheye624",
                                           {"Projection.Params": ("f", "cx", "cy", *FISHEYE624)}),
                "kannalabrandtk3": ("kb4", {"Projection.Params": (*PINHOLE, *FISHEYE)})},
        poses=(Way("T_Device_Camera.UnitQuaternion T_Device_Camera.Translation",
                   is_quaternion=True),),
        unit="metres", measured_deg={"fisheye624": _AHEAD},
    ),
    Dialect(
        name="DriveWorks rig",
        what="cameras with an f-theta polynomial and nominalSensor2Rig_FLU",
        recognises=_items("sensors", "properties"), cameras=_sensors, settings=True,
        model="properties.Model", models={"ftheta": ("ftheta", _f_theta)},
        size="properties.width properties.height",
        poses=(Way("R nominalSensor2Rig_FLU.t", FLU),), unit="metres",
        values=dict.fromkeys(("correction_sensor_R_FLU", "correction_rig_T"),
                             Value((), "Add it to nominalSensor2Rig_FLU, and delete it")),
    ),
    Dialect(
        name="Metashape lens", what="XML of one camera", recognises=_has("calibration"),
        cameras=lambda data, path: [data.add("", data.require("calibration"), "calibration")],
        model="projection=frame", size="width height", unit="",
        models={word: (f"metashape {ours}", _metashape) for word, ours in _FISHEYES.items()},
        measured_deg={f"metashape {ours}": _AHEAD for ours in _FISHEYES.values()},
    ),
    _COLMAP,
    replace(
        _COLMAP, name="COLMAP model", first_is_rig=True,
        what="a folder with `cameras.txt` and `images.txt`, and `rigs.txt` where there is one; "
             "binary where pycolmap is installed",
        recognises=lambda data: False, cameras=colmap.model_cameras,
    ),
    Dialect(
        name="MC-Calib", what="calibrated_cameras_data.yml, pinhole and fisheye",
        recognises=_inside("camera_matrix", "camera_pose_matrix"),
        cameras=_having("camera_pose_matrix"), model="distortion_type", size="img_width img_height",
        models={"0": ("pinhole", {"camera_matrix": K9, "distortion_vector": RADTAN[:5]}),
                "1": ("kb4", {"camera_matrix": K9, "distortion_vector": FISHEYE})},
        poses=(Way("camera_pose_matrix"),), measured_deg=_DIVIDES,
        values={"camera_group": Value((), "No pose connects it to the cameras of another group")},
    ),
    # Last: its keys are in other dialects, too.
    Dialect(
        name="OpenCV, ROS",
        what="K, D, R, T and the size of each camera, or lists of each: fisheye, omnidirectional "
             "(`xi`), plumb_bob or rational; double_sphere, eucm, ucm, fov; also "
             "XML, TOML, npz",
        recognises=opencv.is_opencv, cameras=opencv.cameras,
        model="model", models=opencv.MODELS, aliases=opencv.ALIASES, size=opencv.SIZE,
        poses=(Way(opencv.POSE, to_camera=True, first_may_lack=True),), measured_deg=_DIVIDES,
        values=dict.fromkeys(("binning_x", "binning_y"),
                             Value((1,), "Calibrate the images at their own size")),
    ),
)
# fmt: on
