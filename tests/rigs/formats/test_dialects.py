"""Files of other programs: pixels against formulas for one ray, poses against their rig."""

import json
import logging
import re
from functools import partial
from math import cos, sin, tan

import cv2
import numpy as np
import pytest
import yaml
from rigs.formats.rig_file_samples import (
    AHEAD,
    D4,
    EXAMPLES,
    FOCAL,
    K4,
    MEI,
    METASHAPE,
    PAGE,
    POSES,
    RAYS,
    SIZE,
    K,
    angle,
    basalt,
    brown,
    ds,
    dump,
    follows,
    four_by_four,
    fov,
    kalibr,
    kb4,
    matrix,
    mei,
    read,
    same,
    theta_d,
    transforms,
    write,
    wxyz,
)
from scene import refused
from scipy.spatial.transform import Rotation

from omnistereo_lib import Pose
from omnistereo_rigs.formats.dialects import DIALECTS
from omnistereo_rigs.formats.read import read_any_camera, read_any_rig, read_rig

WIDTH, HEIGHT = SIZE
TO_CAMERA = [pose.inverse() for pose in POSES]
EQUIDISTANT = partial(kb4, f=FOCAL[:2])


def chain(**lens):
    return kalibr(four_by_four_array(TO_CAMERA[1]), **lens)


def four_by_four_array(pose):
    return np.array(four_by_four(pose))


def every(data, **lens):
    """Give all cameras of a chain the same lens."""
    return {
        name: {k: v for k, v in (cam | lens).items() if v is not None} for name, cam in data.items()
    }


def kalibr_lens(model, intrinsics, distortion, coefficients):
    lens = {"distortion_model": distortion, "distortion_coeffs": coefficients}
    return every(chain(), camera_model=model, intrinsics=intrinsics, **lens)


def mc_calib(pose):
    K = {"rows": 3, "cols": 3, "dt": "d", "data": [200.0, 0, 400, 0, 199.0, 380, 0, 0, 1]}
    lens = {"camera_matrix": K, "distortion_vector": K4, "distortion_type": 1, "camera_group": 0}
    lens |= {"camera_pose_matrix": four_by_four(pose, scale=100)}
    return lens | {"img_width": WIDTH, "img_height": HEIGHT}


def toml():
    text = ""
    for n, pose in enumerate(TO_CAMERA):
        r, t = np.split(pose.as_vector(), 2)
        text += f"""[cam_{n}]
size = {list(SIZE)}
matrix = [[np.float64(200.0), 0, 400], [0, 199, 380], [0, 0, 1]]
distortions = {K4}
rotation = {r.tolist()}
translation = {t.tolist()}
fisheye = true
"""
    return text


K624, P624, S624 = (0.01, -0.02, 0.003, 0, 0, 1e-4), (1e-4, -2e-4), (2e-4, 0, -1e-4, 0)


def fisheye624(x, y, z):
    theta, around = angle(x, y, z)
    r = theta + sum(value * theta ** (2 * n + 3) for n, value in enumerate(K624))
    x, y = r * cos(around), r * sin(around)
    r2, dot = x * x + y * y, 2 * (P624[0] * x + P624[1] * y)
    u = x + x * dot + P624[0] * r2 + S624[0] * r2 + S624[1] * r2**2
    v = y + y * dot + P624[1] * r2 + S624[2] * r2 + S624[3] * r2**2
    return 240 * u + 400, 240 * v + 380


def aria():
    cams = []
    for n, pose in enumerate(POSES):
        w, *xyz = wxyz(pose.R)
        lens = {"Name": "FisheyeRadTanThinPrism", "Params": [240, 400, 380, *K624, *P624, *S624]}
        place = {"UnitQuaternion": [w, xyz], "Translation": pose.t.tolist()}
        cams.append({"Label": f"camera-{n}", "Projection": lens, "T_Device_Camera": place})
        cams[-1]["ImageSize"] = list(SIZE)
    return {"CameraCalibrations": cams}


VINS = {"imu": 1, "num_of_cam": 2, "cam0_calib": "front.yaml", "cam1_calib": "back.yaml"}
VINS |= {
    f"body_T_cam{i}": {"rows": 4, "cols": 4, "data": np.ravel(four_by_four(T)).tolist()}
    for i, T in enumerate(POSES)
}
MU = {"mu": 200.0, "mv": 199.0, "u0": 400.0, "v0": 380.0}
MU |= dict(zip(("k2", "k3", "k4", "k5"), K4, strict=True))
KANNALA = {"model_type": "KANNALA_BRANDT", "image_width": WIDTH, "image_height": HEIGHT}
KANNALA |= {"projection_parameters": MU}
LINEAR = {"camera_model": "pinhole", "intrinsics": FOCAL}
OPENCV4 = {"camera_model": "OPENCV", "fl_x": 400.0, "fl_y": 398.0, "k1": -0.1, "k2": 0.01}
OPENCV4 |= {"k3": 0.0, "k4": None, "p1": 1e-5, "p2": -1e-5}
D_MEI = [-0.01, 0.002, 0.0, 0.0]
OMNI = partial(mei, f=FOCAL[:2], k1=-0.01, k2=0.002)
LINES = partial(brown, f=FOCAL[:2], k=(0, 0), p=(0, 0))
MC_CALIB = {"nb_camera": 2} | {f"camera_{n}": mc_calib(pose) for n, pose in enumerate(POSES)}
# Of a second camera: file, content, unit, projection, full field of view.
RIGS = {
    "basalt": ("a.json", basalt(), None, partial(ds, f=(225, 222.6)), 220),
    "kalibr ds": ("a.yaml", chain(), None, ds, 220),
    "kalibr equi": ("a.yaml", kalibr_lens("pinhole", FOCAL, "equi", K4), None, EQUIDISTANT, 180),
    "kalibr fov": ("a.yaml", kalibr_lens("Pinhole", FOCAL, "fov", [0.9]), None, fov, 180),
    "kalibr omni": ("a.yaml", kalibr_lens("omni", [1.5, *FOCAL], "radtan", D_MEI), None, OMNI, 220),
    "kalibr radtan": ("a.yaml", kalibr_lens("pinhole", FOCAL, "radtan", [0] * 4), None, LINES, 120),
    "kalibr no distortion": ("a.yaml", every(chain(), distortion_model=None), None, ds, 220),
    "vins": ("a.yaml", VINS, None, kb4, 220),
    "mc-calib": ("a.yml", MC_CALIB, "cm", kb4, 180),
    "anipose": ("a.toml", toml(), "m", kb4, 180),
    "aria": ("a.json", aria(), None, fisheye624, 180),
    "nerfstudio": ("a.json", transforms(), "m", kb4, 180),
    "nerfstudio opencv": ("a.json", transforms(**OPENCV4), "m", brown, 120),
}


@pytest.mark.parametrize("name", RIGS)
@pytest.mark.filterwarnings("ignore:.*no tangential distortion")
def test_rigs_of_other_programs(tmp_path, name):
    file, data, unit, pixel, field = RIGS[name]
    dump(tmp_path / "front.yaml", MEI)
    dump(tmp_path / "back.yaml", KANNALA)
    rig, said = read(tmp_path / file, data, unit)
    follows(rig.cameras[1], pixel, atol=0.3 if name == "aria" else 0.05)
    assert field - 75 < rig.cameras[1].max_fov_deg <= field
    if name == "basalt":  # its own poses
        T = rig.T_rig_cam[1]
        np.testing.assert_allclose(
            T.R, Rotation.from_rotvec([0, np.pi, 0.1]).as_matrix(), atol=1e-12
        )
        np.testing.assert_allclose(T.t, [0.1, 0, -0.06])
    else:
        same(rig)
    if name == "vins":
        follows(rig.cameras[0], mei, RAYS, least=0.3)
        np.testing.assert_allclose(rig.T_rig_cam[1].t, POSES[1].t)  # camera -> body, as it stands
    assert not [text for text in said if not re.search("tangential|one to one", text)]


GYROFLOW = {"name": "a", "fps": 50, "input_horizontal_stretch": 1.0, "distortion_model": None}
GYROFLOW |= {"calib_dimension": {"w": WIDTH, "h": HEIGHT}}
GYROFLOW |= {
    "fisheye_params": {"RMS_error": 0.6, "camera_matrix": K.tolist(), "distortion_coeffs": K4}
}


def of_metashape(x, y, z, radius):
    theta, around = angle(x, y, z)
    r = radius(theta)
    r *= 1 - 0.02 * r**2 + 0.004 * r**4 + 0.0001 * r**8
    x, y = r * cos(around), r * sin(around)
    # The centre of the top-left pixel is (0.5, 0.5) there.
    return 400 + 3.5 + 241.5 * x - 0.5 * y - 0.5, 380 - 2.0 + 240 * y - 0.5


def decentred(x, y, z):
    """Metashape's p1 multiplies r² + 2x² in x: small, since an OCam camera does not follow it."""
    x, y = x / z, y / z
    r2 = x * x + y * y
    radial, p1 = 1 - 0.02 * r2 + 0.004 * r2**2, 1e-4 * (1 + 0.5 * r2)
    x, y = x * radial + p1 * (r2 + 2 * x * x), y * radial + 2 * p1 * x * y
    return 403.0 + 241.5 * x - 0.5 * y, 377.5 + 240 * y


P1 = METASHAPE.replace("<k4>0.0001</k4>", "<p1>1e-4</p1><p2>0</p2><p3>0.5</p3>")
LENSES = {
    "mei": ("a.yaml", yaml.safe_dump(MEI), mei),
    "kannala-brandt": ("a.yaml", yaml.safe_dump(KANNALA), kb4),
    "gyroflow": ("a.json", json.dumps(GYROFLOW), kb4),
    "metashape decentred": ("a.xml", P1.format(projection="frame"), decentred),
}
RADII = {
    "frame": tan,
    "equidistant_fisheye": lambda theta: theta,
    "equisolid_fisheye": lambda theta: 2 * sin(theta / 2),
}
for name, radius in RADII.items():
    text = METASHAPE.format(projection=name)
    LENSES[f"metashape {name}"] = ("a.xml", text, partial(of_metashape, radius=radius))


@pytest.mark.parametrize("name", LENSES)
@pytest.mark.filterwarnings("ignore:.*no tangential distortion")
def test_lenses_of_other_programs(tmp_path, name):
    file, text, pixel = LENSES[name]
    camera = read_any_camera(write(tmp_path / file, text))
    follows(camera, pixel, atol=0.25 if name == "metashape decentred" else 0.02)


def test_a_folder_of_camera_files_has_poses_beside_them(tmp_path):
    for n in (1, 2):
        dump(tmp_path / f"cam{n}.json", GYROFLOW)
    with refused(r"poses.txt is missing beside cam1.json, cam2.json"):
        read_any_rig(tmp_path, "m")
    write(tmp_path / "poses.txt", "0 0 0 0 0 0\n0 1 0 10 0 0\n")
    assert read_any_rig(tmp_path, "cm").baselines[0] == pytest.approx(0.1)


def test_masks_of_basalt_are_bright_inside(tmp_path, caplog):
    mask = np.zeros(SIZE[::-1], np.uint8)
    cv2.circle(mask, (400, 380), 300, 255, -1)
    (tmp_path / "cam1").mkdir()
    cv2.imwrite(str(tmp_path / "cam1" / "mask.png"), mask)
    dump(tmp_path / "calibration.json", basalt())
    with caplog.at_level(logging.INFO, "omnistereo_lib"):
        rig = read_any_rig(tmp_path)
    assert "basalt JSON, 2 cameras" in caplog.text and "camera 1: ds fitted by OCam" in caplog.text
    np.testing.assert_array_equal(rig.cameras[1].mask, mask == 255)
    assert rig.cameras[0].mask is None


def test_kalibr_chains_are_inverted_whatever_is_around_them(tmp_path):
    T10, T21 = matrix([0, 1.5, 0.1], [0.1, 0, 0.2]), matrix([0.2, -1, 0], [-0.3, 0.1, 0])
    data = kalibr(T10, T21)
    names = dict(zip(("front", "right", "back"), data.values(), strict=True))
    for each in (data, {"cameras": [*data.values()]}, [*data.values()], names):
        rig, _ = read(tmp_path / "camchain.json", each)
        point = np.array([0.3, -0.2, 2.0, 1.0])  # in camera 0, which is the rig's frame
        for pose, T in zip(rig.T_rig_cam, (np.eye(4), T10, T21 @ T10), strict=True):
            np.testing.assert_allclose(pose @ (T @ point)[:3], point[:3], atol=1e-12)


@pytest.mark.parametrize("key", ["T_cam_imu", "T_imu_cam"])
def test_chains_by_the_imu_alone(tmp_path, key):
    T_cam_imu = [matrix([0.1, 0, 0.02], [0.01, 0.02, 0.03]), matrix([0.1, 1.2, 0], [0.1, 0, 0.2])]
    data = kalibr(np.eye(4))
    for i, T in enumerate(T_cam_imu):
        data[f"cam{i}"].pop("T_cn_cnm1", None)
        data[f"cam{i}"][key] = (T if key == "T_cam_imu" else np.linalg.inv(T)).tolist()
    rig, _ = read(tmp_path / "chain.yaml", data)
    point = np.array([0.3, -0.2, 2.0, 1.0])  # in the frame of the IMU
    np.testing.assert_allclose(
        rig.T_rig_cam[1] @ (T_cam_imu[1] @ point)[:3], (T_cam_imu[0] @ point)[:3], atol=1e-12
    )


def test_euroc_folders(tmp_path):
    lens = kalibr()["cam0"] | {"rate_hz": 20, "sensor_type": "camera"}
    for n, T in enumerate(POSES):
        stated = {"T_BS": {"rows": 4, "cols": 4, "data": np.ravel(four_by_four(T)).tolist()}}
        dump(tmp_path / "mav0" / f"cam{n}" / "sensor.yaml", lens | stated)
    for folder in (tmp_path, tmp_path / "mav0"):
        rig, said = read(folder)
        same(rig)
        assert not said


def test_clocks_that_differ_are_said(tmp_path):
    data = kalibr(np.eye(4), np.eye(4))
    for n, shift in enumerate((0.0012, 0.0011, 0.0678)):
        data[f"cam{n}"]["timeshift_cam_imu"] = shift
    with pytest.warns(UserWarning, match=r"camera 3 differs by 67 ms"):
        found = read_rig(dump(tmp_path / "chain.yaml", data))
    assert found.found.clock_offsets_s == (0.0012, 0.0011, 0.0678)
    del data["cam1"]["timeshift_cam_imu"]
    assert read_rig(dump(tmp_path / "chain.yaml", data)).found.clock_offsets_s is None


def sockets(*parents):
    """Return cameras of DepthAI, each with the pose camera → the next one, centimetres."""
    cams = []
    for socket, parent in enumerate(parents):
        pose = TO_NEXT if parent >= 0 else Pose.identity()
        t = dict(zip("xyz", pose.t.tolist(), strict=True))
        extrinsics = {"rotationMatrix": pose.R.tolist(), "translation": t, "toCameraSocket": parent}
        lens = {"intrinsicMatrix": K.tolist(), "distortionCoeff": [*K4, *[0.0] * 10]}
        lens |= {"cameraType": 1, "width": WIDTH, "height": HEIGHT, "extrinsics": extrinsics}
        cams.insert(0, [socket, lens])  # in any order, as a device states them
        if parent < 0:
            extrinsics["rotationMatrix"] = []
    return {"cameraData": cams, "boardName": "OAK"}


TO_NEXT = Pose.from_vector([0, 0.3, 0.1, 7.5, 0.2, -1.0])


def test_depthai_leads_from_socket_to_socket(tmp_path):
    rig, said = read(tmp_path / "oak.json", sockets(1, 2, -1))
    assert len(said) == 1 and "the zeros after the first 4 are dropped" in said[0]
    step = Pose(TO_NEXT.R, TO_NEXT.t / 100)
    same(rig, [step @ step, step, Pose.identity()])
    follows(rig.cameras[0], kb4)
    with pytest.warns(UserWarning, match="zeros after"):
        assert read_rig(tmp_path / "oak.json").found.unit == "centimetres"
    metres = sockets(1, -1)
    metres["cameraData"][1][1]["extrinsics"]["lengthUnit"] = 0
    with refused("socket 0: lengthUnit is 0; expected 1, centimetres"):
        read(tmp_path / "oak.json", metres)
    for parents in ((1, 2, 0), (1, 0, -1), (-1, -1, 0)):
        with refused("lead in a circle or apart"):
            read(tmp_path / "oak.json", sockets(*parents))


@pytest.mark.parametrize("kind", ["pixeldistance-to-angle", "angle-to-pixeldistance"])
def test_f_theta_rigs(tmp_path, kind):
    """θ = 4e-3 r + 2e-9 r³, and r = 240 θ - 5 θ³; then u = c x + d y + cx, v = e x + y + cy."""
    terms = {"pixeldistance-to-angle": "0 4e-3 0 2e-9", "angle-to-pixeldistance": "0 240 0 -5"}
    lens = {"Model": "ftheta", "width": "800", "height": "760", "cx": "400.5", "cy": "380"}
    lens |= {"polynomial": terms[kind], "polynomial-type": kind}
    lens |= {"linear-c": 0.99, "linear-d": 0.002, "linear-e": -0.001}
    sensors = [
        {"name": f"camera:{yaw}", "nominalSensor2Rig_FLU": place, "properties": lens}
        for yaw, t in ((0, [2, 0, 1]), (90, [1, 1, 1]))
        for place in [{"roll-pitch-yaw": [0, 0, yaw], "t": t}]
    ]
    sensors.append({"name": "lidar:top", "properties": {}})
    rig, said = read(tmp_path / "rig.json", {"rig": {"sensors": sensors}})
    assert len(said) == 1 and "DriveWorks documents" in said[0]

    def pixel(x, y, z):
        theta, around = angle(x, y, z)
        roots = np.roots([2e-9, 0, 4e-3, -theta])
        r = float(roots[abs(roots.imag) < 1e-9].real.min()) if kind[0] == "p" else 0
        r = r or 240 * theta - 5 * theta**3
        x, y = r * cos(around), r * sin(around)
        return 400.5 + 0.99 * x + 0.002 * y, 380 - 0.001 * x + y

    follows(rig.cameras[0], pixel)
    # The second camera looks to the left of the first, stands 1 m behind it and 1 m to its left.
    there = rig.T_rig_cam[0].inverse() @ rig.T_rig_cam[1]
    np.testing.assert_allclose(there.t, [-1, 0, -1], atol=1e-9)
    np.testing.assert_allclose(there.R[:, 2], [-1, 0, 0], atol=1e-9)


def test_what_a_polynomial_cannot_follow_is_told(tmp_path):
    lens = {"camera_model": "omni", "intrinsics": [1.5, *FOCAL], "distortion_model": "radtan"}
    _, said = read(
        tmp_path / "a.yaml", kalibr(np.eye(4), **lens, distortion_coeffs=[0, 0, 2e-3, 0])
    )
    assert "a.yaml, cam0: an OCam camera follows the omni model" in said[0]
    assert "tangential" in said[0]
    plumb_bob = [-0.007, 0.044, -0.042, 0.008]  # of a T265, whose driver means a fisheye
    lens = LINEAR | {"distortion_model": "radtan", "distortion_coeffs": plumb_bob}
    with refused(r"px only: no lens is like that.*T265"):
        read(tmp_path / "a.yaml", every(chain(), **lens))


def test_the_share_of_pixels_beyond_a_model_is_said(tmp_path):
    """θ - 0.3 θ³ grows up to θ = 1.054, at a radius of 200 · 0.703 px."""
    lens = LINEAR | {"intrinsics": [200.0, 200.0, 399.5, 379.5], "distortion_model": "equidistant"}
    rig, said = read(tmp_path / "a.yaml", every(chain(), **lens, distortion_coeffs=[-0.3, 0, 0, 0]))
    share = 100 - 100 * np.pi * (200 * 0.7027) ** 2 / (WIDTH * HEIGHT)
    assert len(said) == 2 and f": {share:.0f} % of the pixels" in said[0], said
    assert rig.cameras[0].max_fov_deg == pytest.approx(2 * np.degrees(1.054), abs=1)


@pytest.mark.parametrize(("limit", "field"), [(None, 180.0), (200.0, 200.0)])
def test_a_fisheye_that_divides_by_z_was_measured_within_180_degrees(tmp_path, limit, field):
    lens = LINEAR | {"intrinsics": [200.0, 199.0, 400.0, 380.0], "distortion_model": "equidistant"}
    path = dump(tmp_path / "a.yaml", every(chain(), **lens, distortion_coeffs=K4))
    found = read_rig(path, None, limit)
    assert [camera.max_fov_deg for camera in found.rig.cameras] == [field, field]
    assert found.limited() == ([1, 2] if limit is None else [])
    theirs = cv2.fisheye.projectPoints(AHEAD.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), K, D4)[0]
    uv, valid = found.rig.cameras[0].project(AHEAD)
    assert valid.mean() > 0.9
    np.testing.assert_allclose(uv[valid], theirs.reshape(-1, 2)[valid], atol=0.02)
    assert theta_d(1, K4) == pytest.approx(1 + sum(K4))


def test_the_formats_in_the_book_are_those_of_the_table():
    rows = [f"| {row.name} | {row.what} | {row.unit} |\n" for row in DIALECTS]
    assert "".join(rows) in PAGE
    others = {"OmniMVS config.yaml", "a folder", "images.txt"}
    assert set(EXAMPLES) == {row.name for row in DIALECTS} | others


@pytest.mark.parametrize("row", DIALECTS, ids=lambda row: row.name)
def test_each_example_is_read(tmp_path, row):
    for name in {row.name, "camodocal camera", "COLMAP model", "images.txt"}:
        write(tmp_path / EXAMPLES[name][0], EXAMPLES[name][1])
    path = tmp_path / EXAMPLES[row.name][0]
    if not row.unit:
        assert read_any_camera(path).image_size == (640, 480)
        return
    rig, said = read(path, None, "m" if "unit" in row.unit else None)
    assert rig.baselines[0] == pytest.approx(20 if row.name == "MC-Calib" else 0.2)
    assert not [text for text in said if "DriveWorks" not in text]


def test_the_example_of_a_folder_is_read(tmp_path):
    for name in ("Metashape lens", "a folder"):
        write(tmp_path / EXAMPLES[name][0], EXAMPLES[name][1])
    write(tmp_path / "cam2.xml", EXAMPLES["Metashape lens"][1])
    assert read_any_rig(tmp_path, "m").baselines[0] == pytest.approx(0.2)
