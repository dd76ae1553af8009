"""What is refused, in words that name the file, the camera and what to do."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from rigs.formats.rig_file_samples import (
    DOUBLE_SPHERE,
    EXAMPLES,
    K4,
    MEI,
    METASHAPE,
    SIZE,
    K,
    basalt,
    dump,
    kalibr,
    omnimvs,
    read,
    transforms,
    write,
)
from rigs.formats.test_dialects import GYROFLOW, KANNALA, aria, sockets
from scene import refused

from omnistereo_lib import OmnistereoError
from omnistereo_rigs.formats.read import read_any_camera, read_any_rig


def each(data, *without, **changes):
    """Return a config.yaml with keys of all cameras changed."""
    for camera in data["cameras"]:
        camera |= changes
        for key in without:
            del camera[key]
    return data


def changed(data, *path, value=None):
    """Return a copy with one value inside set, or, without a value, deleted."""
    copy = json.loads(json.dumps(data))
    *outer, last = path
    inner = copy
    for key in outer:
        inner = inner[key]
    if value is None:
        del inner[last]
    else:
        inner[last] = value
    return copy


def f_theta(*more, **lens):
    """Return the example of the book, its lenses changed."""
    data = json.loads(EXAMPLES["DriveWorks rig"][1])
    for sensor in data["rig"]["sensors"]:
        sensor["properties"] |= lens | (more[0] if more else {})
    return data


KB4 = {"camera_type": "kb4", "intrinsics": {"fx": 225.0, "fy": 225.0, "cx": 250.0}}
ONE = {"value0": {k: v[:1] for k, v in basalt()["value0"].items()}}
NO_SIZE = changed(aria(), "CameraCalibrations", 0, "ImageSize")
THIN = changed(sockets(1, -1), "cameraData", 0, 1, "distortionCoeff", 9, value=0.1)
MANY_KEYS = {"centre_px": 1} | dict.fromkeys("abcdefghijkl", 0)
FAR = {"pose": [0, 0, 0, 1001, 0, 0]}
NO_TURN = changed(f_theta(), "rig", "sensors", 0, "correction_rig_T", value=[0, 0, 1])
DS = {"camera_type": "ds", "intrinsics": DOUBLE_SPHERE | {"xi": "a"}}
LINEAR = {"fx": 300.0, "fy": 300.0, "cx": 400.0, "cy": 380.0}
K3 = {"camera_type": "pinhole", "intrinsics": LINEAR | {"k3": 0.1}}
NO_ROTATION = dict.fromkeys(("px", "py", "pz", "qx", "qy", "qz", "qw"), 0)
IMU = kalibr(np.eye(4), T_cam_imu=np.eye(4).tolist())
KNOWN = r"unknown format, found the keys .*supported formats.*basalt JSON.*Kalibr.*OpenCV"
NUMPY = "cam1: {D: !!python/object/apply:numpy.core.multiarray._reconstruct {args: []}}\n"
ENTITY = '<!DOCTYPE a [<!ENTITY b "bb">]><opencv_storage>&b;</opencv_storage>'
# As other programs publish them: a lens, or a rig, whose keys could be taken for those of a format.
OTHERS = yaml.safe_load(Path(__file__).with_name("others.yaml").read_text("utf-8"))


@pytest.mark.parametrize("data", OTHERS.values(), ids=OTHERS)
def test_files_of_programs_that_are_not_read_are_never_read_as_another_format(tmp_path, data):
    """With those that the page describes these are the files of 29 programs."""
    path = dump(tmp_path / "a.json", data)
    for function in (read_any_rig, read_any_camera):
        with refused(r"unknown format, found the keys|model is stand"):
            function(path)


RIGS = [
    ("a.json", basalt(intrinsics=[DS, DS]), "camera 0: .*xi must be numbers"),
    ("a.json", basalt(resolution=[list(SIZE)]), "expected lists of one T_imu_cam, intrinsics"),
    ("a.json", basalt(T_imu_cam=[NO_ROTATION] * 2), "length 0; expected 1"),
    ("a.json", basalt(intrinsics=[K3, K3]), "'k3' is a parameter of a lens that is not"),
    ("a.json", basalt(intrinsics=[K3 | {"intrinsics": LINEAR | {"fx": 0.4}}] * 2), "fx = 0.4"),
    ("a.json", basalt(intrinsics=[KB4] * 2), "'fx', 'fy', 'cx', 'cy'.*found"),
    ("a.json", basalt(T_imu_cam=7), "expected lists of one T_imu_cam, .* each per camera"),
    ("a.json", basalt(T_imu_cam=[], intrinsics=[], resolution=[]), "found no camera of basalt"),
    ("a.json", ONE, "basalt JSON of one camera; a rig needs"),
    ("a.yaml", kalibr(np.eye(4), distortion_model="radtan"), r"camera_model \+ .* is ds \+ radtan"),
    ("a.yaml", kalibr(np.eye(4), distortion_coeffs=[0.1]), "coeffs has 1 numbers; expected 0"),
    ("a.yaml", kalibr(np.eye(4), alpha=0.5), "cam0: 'alpha' is a parameter of a lens that is not"),
    ("a.yaml", kalibr(2 * np.eye(4)), "cam1: the last row of the pose"),
    ("a.yaml", kalibr(np.diag([2.0, 2, 2, 1])), "cam1: T_cn_cnm1 is not a rotation"),
    ("a.yaml", kalibr(np.eye(3)), "pose T_cn_cnm1 must be 16 numbers, found 9"),
    ("a.yaml", {**kalibr(), "cam2": kalibr()["cam0"]}, "found cam0, cam2; .* without a gap"),
    ("a.yaml", changed(IMU, "cam1", "T_cn_cnm1"), "cam1: no pose; .*T_cam_imu, .* in every"),
    ("a.json", NO_SIZE, "'ImageSize' or .* is missing"),
    ("a.json", {"cameraData": []}, "found no camera of DepthAI"),
    ("a.json", {"cameraData": [1]}, "cameraData: expected pairs"),
    ("a.json", {"cameraData": 1}, "cameraData: expected pairs"),
    ("a.json", THIN, "has 14 numbers; expected 4"),
    ("a.json", f_theta(polynomial="1 2"), "polynomial is .*; expected 0 and 1 to 15"),
    ("a.json", f_theta({"polynomial-type": "other"}), "polynomial-type is other; expected pixel"),
    ("a.json", NO_TURN, "Add it to nominalSensor2Rig_FLU"),
    ("config.yaml", each(omnimvs(), "max_fov", max_fow=220), "no meaning; is 'max_fov' meant"),
    ("config.yaml", each(omnimvs(), "invalid_mask", invalidmask="a.png"), "is 'invalid_mask'"),
    ("config.yaml", each(omnimvs(), "inv_poly", Inv_poly=[2, 1, 1]), "is 'inv_poly' meant"),
    ("config.yaml", each(omnimvs(), "center", **MANY_KEYS), r"found \['centre_px', .* \d+ more"),
    ("config.yaml", each(omnimvs(), max_fov=3.84), r"max_fov is 3.84; .*radians \(220.0°\)"),
    ("config.yaml", each(omnimvs(), "invalid_mask", **FAR), "a camera stands 1001 m from the"),
    ("a.json", [{"a": 1}], "unknown format"),
    ("a.json", [{"token": "t", "b": K.tolist()}] * 2, r"unknown .*in them \['b', 'token'\]"),
    ("a.json", {"a": {"intrinsics": K4, "extrinsics": 1}}, r"\['a'\].* them \['extrinsics', 'intr"),
    ("a.yaml", "", KNOWN),
    ("a.yaml", "- 1\n- 2", KNOWN),
    ("a.yaml", "cam0: 3", KNOWN),
    ("a.pto", "i w800 h760 f3 v180\n", KNOWN),
    ("a.yaml", NUMPY, r"holds Python objects.*\.tolist"),
    ("a.toml", "[cam_0\n", "not valid TOML"),
    ("a.npz", "PK", "not an npz file of arrays"),
    ("a.xml", ENTITY, "XML with a document type"),
    ("a.xml", "<opencv_storage><K1>", "not valid XML .*complete"),
    ("ocam1.txt", "", "Pass the folder of a rig"),
]


@pytest.mark.parametrize(("name", "data", "message"), RIGS)
def test_rigs_that_are_refused(tmp_path, name, data, message):
    with refused(f"(?s){name}: .*{message}|{name} {message}"):
        read(tmp_path / name, data)


LENSES = [
    ("a.xml", METASHAPE.format(projection="spherical"), "is spherical; .*no depth"),
    ("a.xml", "<document><chunk/></document>", "unknown format"),
    ("a.yaml", {"model_type": "other"}, "expected one of mei, kannala_brandt, pinhole"),
    ("a.yaml", changed(KANNALA, "projection_parameters", "mv"), "key 'mv' is missing"),
    ("a.yaml", changed(MEI, "mirror_parameters", "xi", value=-1.5), "xi = -1.5 of .* 'omni'"),
    ("a.json", GYROFLOW | {"distortion_model": "poly5"}, "poly5; .* one of opencv_fisheye"),
    ("a.json", GYROFLOW | {"input_vertical_stretch": 1.33}, "is 1.33; expected 1. Recal"),
    ("a.json", GYROFLOW | {"digital_lens": "gopro"}, "gopro; expected nothing. Recal"),
    ("a.json", basalt(), "2 cameras; expected one. Use read_any_rig"),
]


@pytest.mark.parametrize(("name", "data", "message"), LENSES)
def test_lenses_that_are_refused(tmp_path, name, data, message):
    path = tmp_path / name
    write(path, data) if isinstance(data, str) else dump(path, data)
    with refused(f"{name}: .*{message}"):
        read_any_camera(path)


def test_a_folder_without_a_rig(tmp_path):
    write(tmp_path / "notes.md", "")
    with refused(r"(?s)found \['notes.md'\]; expected ocam.*supported formats"):
        read_any_rig(tmp_path)


FRAMES = [transforms()["frames"][0] | {"file_path": f"cam{n}/a.png"} for n in range(65)]
OPENCV = {"K": K.tolist(), "D": K4, "distortion_model": "fisheye", "image_size": list(SIZE)}
OWN = {"poly": [3, -140, 0, 1e-3], "center": [380, 400], "affine": [1, 0, 0]}
OWN |= {"image_size": [760, 800], "pose": [0] * 6}
MANY = {
    "kalibr": {f"cam{n}": kalibr()["cam0"] for n in range(65)},
    "opencv": {"cameras": [OPENCV] * 65},
    "opencv by name": {f"c{n}": OPENCV for n in range(65)},
    "numbered": {f"K{n}": K.tolist() for n in range(65)},
    "lists": {"Ks": [K.tolist()] * 65},
    "nerfstudio": transforms() | {"frames": FRAMES},
    "own": {"cameras": [OWN] * 65},
    "depthai": sockets(*[-1] * 65),
}


@pytest.mark.parametrize("data", MANY.values(), ids=MANY)
def test_a_rig_has_at_most_64_cameras(tmp_path, data):
    with refused("found 65 cameras; expected at most 64"):
        read_any_rig(write(tmp_path / "rig.json", json.dumps(data)), "m")


def test_what_a_folder_or_a_rig_names_is_counted_before_it_is_read(tmp_path):
    for n in range(65):
        write(tmp_path / "euroc" / f"cam{n}" / "sensor.yaml", "a: [")
        write(tmp_path / "lenses" / f"cam{n}.json", "{")
        write(tmp_path / "ocam" / f"ocam{n}.txt", "")
    for folder in ("lenses", "ocam"):
        write(tmp_path / folder / "poses.txt", "0 0 0 0 0 0\n" * 65)
    vins = {f"body_T_cam{n}": np.eye(4).tolist() for n in range(65)}
    vins |= {f"cam{n}_calib": "a.yaml" for n in range(65)}
    for path in ("euroc", "lenses", "ocam", dump(tmp_path / "vins.yaml", vins)):
        with refused("found 65 cameras; expected at most 64"):
            read_any_rig(tmp_path / path, "m")


def test_a_large_file_is_refused_at_once(tmp_path, limits):
    """150 KB of lenses, each of which would be fitted, and of text that no parser finishes."""
    limits(1 << 30, seconds=5)
    lens = {k: v for k, v in OPENCV.items() if k != "D"} | {"D": [-0.01 + 1e-9, 0.004, 0, 0]}
    cameras = json.dumps({"cameras": [lens] * 1000})
    assert len(cameras) > 150_000
    for name, text in {
        "a.json": cameras,
        "b.yaml": cameras,
        "c.yaml": "a: [" * 40_000,
        "d.toml": "a = [" + "[" * 150_000,
        "e.yaml": "cameras:\n- &c " + json.dumps(lens) + "\n- *c" * 30_000,
    }.items():
        with pytest.raises(OmnistereoError):
            read_any_rig(write(tmp_path / name, text), "m")
