"""basalt, Kalibr, OpenCV and COLMAP files, and the detection of the format."""

import logging

import cv2
import numpy as np
import pytest
from rig_file_samples import (
    D4,
    DOUBLE_SPHERE,
    FOCAL,
    R2,
    RAYS,
    SIZE,
    T2,
    K,
    basalt,
    dump,
    kalibr,
    matrix,
    write,
)
from scipy.spatial.transform import Rotation

from omnistereo_lib import OmnistereoError
from omnistereo_rigs.formats.camera_models import double_sphere
from omnistereo_rigs.formats.read import read_any_rig


def test_basalt(tmp_path, caplog):
    mask = np.zeros(SIZE[::-1], np.uint8)
    cv2.circle(mask, (400, 380), 300, 255, -1)
    (tmp_path / "cam1").mkdir()
    cv2.imwrite(str(tmp_path / "cam1" / "mask.png"), mask)
    with caplog.at_level(logging.INFO, "omnistereo_lib"):
        rig = read_any_rig(dump(tmp_path / "calibration.json", basalt()))
    assert "basalt JSON, 2 cameras" in caplog.text and "camera 1: ds fitted by OCam" in caplog.text
    T = rig.T_rig_cam[1]  # camera -> rig as stored: nothing is inverted
    np.testing.assert_allclose(T.R, Rotation.from_rotvec([0, np.pi, 0.1]).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(T.t, [0.1, 0, -0.06])
    np.testing.assert_array_equal(rig.cameras[1].mask, mask == 255)  # bright is inside
    assert rig.cameras[0].mask is None
    uv, valid = rig.cameras[0].project(RAYS)
    assert valid.any()
    np.testing.assert_allclose(uv[valid], double_sphere(RAYS, **DOUBLE_SPHERE)[0][valid], atol=0.02)
    assert read_any_rig(tmp_path).baselines[0] == pytest.approx(np.hypot(0.1, 0.06))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"intrinsics": [{"camera_type": "ds", "intrinsics": DOUBLE_SPHERE | {"xi": "a"}}] * 2},
            "xi must be numbers",
        ),
        ({"resolution": [list(SIZE)]}, "found 2 T_imu_cam, 2 intrinsics and 1 resolution;"),
        (
            {"T_imu_cam": [dict.fromkeys(("px", "py", "pz", "qx", "qy", "qz", "qw"), 0)] * 2},
            "length 0; expected 1",
        ),
        ({"T_imu_cam": 7}, "T_imu_cam: found 7; expected keys"),
    ],
)
def test_broken_basalt_files(tmp_path, changes, message):
    with pytest.raises(OmnistereoError, match=f"(?s)calibration.json: .*{message}"):
        read_any_rig(dump(tmp_path / "calibration.json", basalt(**changes)))


def test_kalibr_chain_is_inverted(tmp_path, caplog):
    T10, T21 = matrix([0, 1.5, 0.1], [0.1, 0, 0.2]), matrix([0.2, -1, 0], [-0.3, 0.1, 0])
    with caplog.at_level(logging.INFO, "omnistereo_lib"):
        rig = read_any_rig(dump(tmp_path / "camchain.yaml", kalibr(T10, T21)))
    assert "Kalibr camchain, 3 cameras" in caplog.text
    point = np.array([0.3, -0.2, 2.0, 1.0])  # in camera 0, which is the rig's frame
    for pose, T in zip(rig.T_rig_cam, (np.eye(4), T10, T21 @ T10), strict=True):
        np.testing.assert_allclose(pose @ (T @ point)[:3], point[:3], atol=1e-12)


def test_what_a_polynomial_cannot_follow_is_told(tmp_path):
    lens = {"camera_model": "omni", "intrinsics": [1.5, *FOCAL], "distortion_model": "radtan"}
    lens |= {"distortion_coeffs": [0.0, 0.0, 2e-3, 0.0]}
    with pytest.warns(
        UserWarning,
        match=r"camchain.yaml, cam0: .* follows the omni model .* px only: .*tangential",
    ):
        read_any_rig(dump(tmp_path / "camchain.yaml", kalibr(np.eye(4), **lens)))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (
            kalibr(np.eye(4), distortion_model="radtan"),
            r"cam0: camera_model \+ distortion_model is ds \+ radtan; expected",
        ),
        (kalibr(2 * np.eye(4)), "cam1: the last row of the pose"),
        (kalibr(np.diag([2.0, 2, 2, 1])), "cam1: T_cn_cnm1 is not a rotation"),
        (kalibr(np.eye(3)), "cam1: the 4 × 4 pose T_cn_cnm1 must be 16 numbers, found 9"),
        ({**kalibr(), "cam2": kalibr()["cam0"]}, "key 'cam1' is missing"),
    ],
)
def test_broken_kalibr_files(tmp_path, data, message):
    with pytest.raises(OmnistereoError, match=f"camchain.yaml: .*{message}"):
        read_any_rig(dump(tmp_path / "camchain.yaml", data))


def opencv_file(path, **values):
    """Written by OpenCV itself."""
    values = {"K1": K, "D1": D4, "K2": K, "D2": D4, "R": R2, "T": T2.reshape(3, 1)} | values
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in ({"image_width": SIZE[0], "image_height": SIZE[1]} | values).items():
        file.write(name, value)
    file.release()
    return path


@pytest.mark.parametrize("suffix", [".json", ".xml", ".yaml"])
def test_file_storage_in_each_of_its_formats(tmp_path, suffix, caplog):
    path = opencv_file(tmp_path / f"fisheye{suffix}")
    with caplog.at_level(logging.INFO, "omnistereo_lib"):
        rig = read_any_rig(path, "cm")
    assert "OpenCV, ROS in cm, 2 cameras" in caplog.text
    point = np.array([0.1, 0.2, 0.7])  # in the first camera, metres
    np.testing.assert_allclose(rig.T_rig_cam[1] @ (R2 @ point + T2 / 100), point, atol=1e-12)
    np.testing.assert_allclose(rig.T_rig_cam[0] @ point, point)
    ahead = RAYS[RAYS[:, 2] > 0.3]
    theirs, _ = cv2.fisheye.projectPoints(ahead.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), K, D4)
    uv, valid = rig.cameras[1].project(ahead)
    assert valid.mean() > 0.8
    np.testing.assert_allclose(uv[valid], theirs.reshape(-1, 2)[valid], atol=0.02)


def test_opencv_files_need_a_unit(tmp_path):
    path = opencv_file(tmp_path / "fisheye.yaml")
    distance = np.linalg.norm(T2)
    with pytest.raises(
        OmnistereoError, match=rf"fisheye.yaml: .*not state its unit.*cm.*{distance / 100:.4g}"
    ):
        read_any_rig(path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"D2": np.ones(5), "distortion_model": "fisheye"},
            "camera 2: D has 5 numbers; expected 4: k1 k2 k3 k4",
        ),
        ({"K1": K.T}, "camera 1: K is .*expected fx skew cx"),
        ({"R": np.eye(2)}, "camera 2: R has 4 numbers; expected a 3 × 3 matrix or an axis-angle"),
        ({"T": np.full(3, np.nan)}, r"camera 2: T must be numbers, found \['.Nan'"),
        ({"K3": K}, "camera 2: key 'R' or 'rvec' is missing"),
    ],
)
def test_broken_opencv_files(tmp_path, changes, message):
    path = opencv_file(tmp_path / "fisheye.yaml", **changes)
    with pytest.raises(OmnistereoError, match=f"fisheye.yaml: .*{message}"):
        read_any_rig(path, "cm")


@pytest.mark.parametrize("text", ["", "- 1\n- 2", "cam0: 3"])
def test_unknown_files_list_what_is_known(tmp_path, text):
    known = (
        r"(?s)rig.yaml: unknown format, found the keys .*; supported formats.*basalt"
        r" JSON.*Kalibr.*OpenCV"
    )
    with pytest.raises(OmnistereoError, match=known):
        read_any_rig(write(tmp_path / "rig.yaml", text))


def test_a_folder_without_a_rig(tmp_path):
    write(tmp_path / "notes.md", "")
    with pytest.raises(
        OmnistereoError, match=r"(?s)found \['notes.md'\]; expected ocam.*supported formats"
    ):
        read_any_rig(tmp_path)
