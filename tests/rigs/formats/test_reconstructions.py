"""COLMAP, transforms.json, MC-Calib and Gyroflow against formulas written here; what is exported
comes back."""

import json
from math import atan2, cos, hypot, sin, tan

import numpy as np
import pytest
from rig_file_samples import K4, RAYS, SIZE, dump, write
from test_more_formats import AHEAD, follows, theta_d

from omnistereo_lib import OmnistereoError, Pose
from omnistereo_rigs.formats.camera_models import make_camera_model
from omnistereo_rigs.formats.colmap import _lens as colmap_lens
from omnistereo_rigs.formats.read import read_any_camera, read_any_rig
from omnistereo_rigs.formats.write import export_rig

WIDTH, HEIGHT = SIZE
WORLD = Pose.from_vector([0.3, -0.4, 0.2, 5.0, -2.0, 1.0])  # rig → world
CAMERAS = [Pose.identity(), Pose.from_vector([0.1, 1.4, -0.2, 0.3, 0.05, -0.2])]  # camera → rig


def quaternion(R):
    """Return w x y z of a rotation by less than 120°, by the textbook formula."""
    w = np.sqrt(1 + np.trace(R)) / 2
    return [
        float(w),
        *((np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / (4 * w)).tolist()),
    ]


def fisheye(x, y, z, k=K4, f=(200.0, 199.0), c=(400.0, 380.0)):
    """Pixels count from the centre of the first one; the files add a half."""
    theta, around = atan2(hypot(x, y), z), atan2(y, x)
    return f[0] * theta_d(theta, k) * cos(around) + c[0], f[1] * theta_d(theta, k) * sin(
        around
    ) + c[1]


def brown(x, y, z, k1=-0.1, k2=0.01, p1=1e-5, p2=-1e-5):
    x, y = x / z, y / z
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2 * r2
    return (
        400 * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + 400,
        398 * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y) + 380,
    )


def fov(x, y, z):
    theta, around = atan2(hypot(x, y), z), atan2(y, x)
    r = np.arctan(2 * tan(theta) * tan(0.45)) / 0.9
    return 300 * r * cos(around) + 400, 300 * r * sin(around) + 380


MODELS = {
    "OPENCV_FISHEYE": ([200.0, 199.0, 400.5, 380.5, *K4], fisheye),
    "RADIAL_FISHEYE": (
        [200.0, 400.5, 380.5, -0.01, 0.004],
        lambda *X: fisheye(*X, [-0.01, 0.004, 0, 0], (200, 200)),
    ),
    "SIMPLE_RADIAL_FISHEYE": (
        [200.0, 400.5, 380.5, -0.01],
        lambda *X: fisheye(*X, [-0.01, 0, 0, 0], (200, 200)),
    ),
    "OPENCV": ([400.0, 398.0, 400.5, 380.5, -0.1, 0.01, 1e-5, -1e-5], brown),
    "SIMPLE_PINHOLE": (
        [400.0, 400.5, 380.5],
        lambda x, y, z: (400 * x / z + 400, 400 * y / z + 380),
    ),
    "FOV": ([300.0, 300.0, 400.5, 380.5, 0.9], fov),
}


def same_poses(rig):
    for ours, true in zip(rig.T_rig_cam, CAMERAS, strict=True):
        relative = rig.T_rig_cam[0].inverse() @ ours
        np.testing.assert_allclose(relative.R, true.R, atol=1e-9)
        np.testing.assert_allclose(relative.t, true.t, atol=1e-9)


def rig_config(**changes):
    pose = CAMERAS[1].inverse()
    turned = {
        "cam_from_rig_rotation": quaternion(pose.R),
        "cam_from_rig_translation": pose.t.tolist(),
    }
    return [
        {
            "cameras": [
                {"image_prefix": "a/", "ref_sensor": True} | changes,
                {"image_prefix": "b/"} | turned | changes,
            ]
        }
    ]


@pytest.mark.parametrize("name", MODELS)
def test_rigs_of_colmap(tmp_path, name):
    values, pixel = MODELS[name]
    text = "".join(f"{n} {name} {WIDTH} {HEIGHT} {' '.join(map(str, values))}\n" for n in (1, 2))
    write(tmp_path / "cameras.txt", text)
    rig = read_any_rig(dump(tmp_path / "rig_config.json", rig_config()), "m")
    same_poses(rig)
    follows(rig.cameras[1], pixel, AHEAD, atol=0.05)


def test_models_in_the_rig_of_colmap(tmp_path):
    name, values = "SIMPLE_PINHOLE", MODELS["SIMPLE_PINHOLE"][0]
    text = "".join(f"{n} {name} {WIDTH} {HEIGHT} {' '.join(map(str, values))}\n" for n in (1, 2))
    write(tmp_path / "cameras.txt", text)
    stated = rig_config(camera_model_name=name, camera_params=values)
    same_poses(read_any_rig(dump(tmp_path / "rig_config.json", stated), "m"))
    stated[0]["cameras"][0]["camera_params"] = [1.0, *values[1:]]
    with pytest.raises(OmnistereoError, match=r"camera 1: camera_params differ from cameras.txt"):
        read_any_rig(dump(tmp_path / "rig_config.json", stated), "m")
    (tmp_path / "cameras.txt").unlink()
    with pytest.raises(OmnistereoError, match="does not state the size of the images"):
        read_any_rig(
            dump(
                tmp_path / "rig_config.json",
                rig_config(camera_model_name=name, camera_params=values),
            ),
            "m",
        )


def images_txt(*moments):
    lines, n = ["# IMAGE_ID, QW, QX, …"], 0
    for moment, world in enumerate(moments):
        for k, camera in enumerate(CAMERAS, 1):
            n, pose = n + 1, camera.inverse() @ world.inverse()
            lines += [
                f"{n} {' '.join(map(str, [*quaternion(pose.R), *pose.t]))} {k} cam{k}/{moment}.png",
                "1.0 2.0 -1" * (n % 2),
            ]
    return "\n".join(lines) + "\n"


def test_models_of_colmap(tmp_path):
    values = " ".join(map(str, MODELS["OPENCV_FISHEYE"][0]))
    write(
        tmp_path / "cameras.txt",
        "".join(f"{n} OPENCV_FISHEYE {WIDTH} {HEIGHT} {values}\n" for n in (1, 2)),
    )
    write(
        tmp_path / "images.txt", images_txt(WORLD, WORLD @ Pose.from_vector([0, 0.1, 0, 1, 0, 0]))
    )
    rig = read_any_rig(tmp_path, "m")
    same_poses(rig)
    follows(rig.cameras[0], fisheye, RAYS, least=0.49)
    with pytest.raises(OmnistereoError, match="does not state its unit"):
        read_any_rig(tmp_path / "images.txt")
    lines = images_txt(WORLD, WORLD).splitlines()
    lines[-2] = lines[-2].replace(lines[-2].split()[5], "9.0")
    write(tmp_path / "images.txt", "\n".join(lines))
    with pytest.warns(
        UserWarning,
        match=r"images.txt: cam1/0.png and cam1/1.png contradict .*camera 2: .* % of the size of the rig",
    ):
        read_any_rig(tmp_path, "m")
    for text, message in (
        ("1 1 0 0 0 0 0 0 7 a.png", r"line 1: found .*CAMERA_ID NAME"),
        ("", "there is no image"),
    ):
        with pytest.raises(OmnistereoError, match=message):
            write(tmp_path / "images.txt", text)
            read_any_rig(tmp_path, "m")


def transforms(**changes):
    """OpenGL: the third column points back, the second up."""
    frames = []
    for pose in CAMERAS:
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = (WORLD @ pose).R, (WORLD @ pose).t
        matrix[:3, 1:3] *= -1
        frames.append({"file_path": "a.png", "transform_matrix": matrix.tolist()})
    shared = {
        "w": WIDTH,
        "h": HEIGHT,
        "fl_x": 200.0,
        "fl_y": 199.0,
        "cx": 400.5,
        "cy": 380.5,
        "aabb_scale": 16,
    }
    shared |= {"camera_model": "OPENCV_FISHEYE"} | dict(
        zip(("k1", "k2", "k3", "k4"), K4, strict=True)
    )
    return shared | changes | {"frames": frames}


def test_frames_of_nerfstudio(tmp_path, recwarn):
    rig = read_any_rig(dump(tmp_path / "transforms.json", transforms()), "m")
    same_poses(rig)
    follows(rig.cameras[1], fisheye, RAYS, least=0.49)
    focal = {
        "fl_x": 400.0,
        "fl_y": 398.0,
        "k1": -0.1,
        "k2": 0.01,
        "k3": 0.0,
        "k4": None,
        "p1": 1e-5,
        "p2": -1e-5,
    }
    follows(
        read_any_rig(
            dump(tmp_path / "t.json", transforms(camera_model="OPENCV", **focal)), "m"
        ).cameras[0],
        brown,
    )
    angle = {
        "fl_x": None,
        "fl_y": None,
        "camera_angle_x": 2 * np.arctan(400 / 400),
        "camera_model": "PINHOLE",
    } | {"k4": 0}
    angle |= dict.fromkeys(("k1", "k2", "k3"), 0)
    rig = read_any_rig(dump(tmp_path / "t.json", transforms(**angle)), "m")
    follows(rig.cameras[0], lambda x, y, z: (400 * x / z + 400, 400 * y / z + 380))
    assert not recwarn.list
    with pytest.raises(
        OmnistereoError, match="frame 1: camera_model is equirectangular; expected one of"
    ):
        read_any_rig(dump(tmp_path / "t.json", transforms(camera_model="EQUIRECTANGULAR")), "m")
    with pytest.warns(UserWarning, match="no camera_model is stated: read as OPENCV"):
        read_any_rig(dump(tmp_path / "t.json", transforms(camera_model=None, **focal)), "m")


def mc_calib(pose, kind=1, D=K4):
    K = {"rows": 3, "cols": 3, "dt": "d", "data": [200.0, 0, 400, 0, 199.0, 380, 0, 0, 1]}
    matrix = np.vstack([np.column_stack([pose.R, 100 * pose.t]), [0, 0, 0, 1]])
    lens = {"camera_matrix": K, "distortion_vector": D, "distortion_type": kind, "camera_group": 0}
    return lens | {"img_width": WIDTH, "img_height": HEIGHT, "camera_pose_matrix": matrix.tolist()}


def test_cameras_of_mc_calib(tmp_path, recwarn):
    data = {"nb_camera": 2} | {f"camera_{n}": mc_calib(pose) for n, pose in enumerate(CAMERAS)}
    rig = read_any_rig(dump(tmp_path / "calibrated_cameras_data.yml", data), "cm")
    same_poses(rig)
    follows(rig.cameras[1], fisheye, RAYS, least=0.49)
    data["camera_1"]["camera_group"] = 1
    assert not recwarn.list
    with pytest.raises(
        OmnistereoError, match="camera camera_1: camera_group is not that of the first camera"
    ):
        read_any_rig(dump(tmp_path / "calibrated_cameras_data.yml", data), "cm")


def test_profiles_of_gyroflow(tmp_path):
    lens = {
        "RMS_error": 0.6,
        "camera_matrix": [[200.0, 0, 400], [0, 199, 380], [0, 0, 1]],
        "distortion_coeffs": K4,
    }
    profile = {
        "name": "a",
        "camera_brand": "b",
        "fps": 50,
        "input_horizontal_stretch": 1.0,
        "distortion_model": None,
    }
    profile |= {
        "calib_dimension": {"w": WIDTH, "h": HEIGHT},
        "fisheye_params": lens | {"radial_distortion_limit": 2},
    }
    for n in (1, 2):
        follows(
            read_any_camera(dump(tmp_path / f"cam{n}.json", profile)), fisheye, RAYS, least=0.49
        )
    write(tmp_path / "poses.txt", "0 0 0 0 0 0\n0 1 0 10 0 0\n")
    assert read_any_rig(tmp_path, "cm").baselines[0] == pytest.approx(0.1)
    for wrong in (
        {"distortion_model": "poly5"},
        {"input_vertical_stretch": 1.33},
        {"digital_lens": "gopro_superview"},
    ):
        with pytest.raises(OmnistereoError, match="opencv_fisheye"):
            read_any_camera(dump(tmp_path / "lens.json", profile | wrong))


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """A rig, the folder of what it is exported to, and the largest residual of the models there."""
    rig, folder = read_any_rig("data_samples/sunny/test"), tmp_path_factory.mktemp("exported")
    return rig, folder, max(export_rig(rig, folder))


@pytest.mark.parametrize("name", ["colmap", "transforms.json", "opencv.yaml", "kalibr.yaml"])
def test_what_is_exported_comes_back(exported, name, recwarn):
    """COLMAP's two files in the same way as the other ones: the residual is that of the model."""
    true, folder, residual = exported
    rig = read_any_rig(folder / name, None if "kalibr" in name else "m")
    for n, camera in enumerate(rig.cameras):
        error = (
            (true.T_rig_cam[0].inverse() @ true.T_rig_cam[n]).inverse()
            @ rig.T_rig_cam[0].inverse()
            @ rig.T_rig_cam[n]
        )
        assert max(error.magnitude()) < 1e-9
        (uv, seen), (other, _) = camera.project(RAYS), true.cameras[n].project(RAYS)
        assert np.abs(uv - other)[seen].max() < residual + 0.02
    assert not recwarn.list


def test_unread_programs_say_what_to_do(tmp_path):
    for data, message in (
        (
            {"boardName": "OAK", "cameraData": []},
            "found no camera of DepthAI",
        ),
        (
            {"Camera.type": "KannalaBrandt8", "Camera1.fx": 200.0},
            "ORB-SLAM settings are not read: write the camchain",
        ),
        (rig_config() * 2, "the file holds 2 rigs; expected one"),
        ([{"a": 1}], "unknown format"),
    ):
        with pytest.raises(OmnistereoError, match=message):
            read_any_rig(write(tmp_path / "file.json", json.dumps(data)))


THEIRS = {
    "SIMPLE_FISHEYE": [200.0, 400.5, 380.5],
    "FISHEYE": [200.0, 199.0, 400.5, 380.5],
    "OPENCV_FISHEYE": [200.0, 199.0, 400.5, 380.5, *K4],
    "SIMPLE_RADIAL_FISHEYE": [200.0, 400.5, 380.5, -0.01],
    "RADIAL_FISHEYE": [200.0, 400.5, 380.5, -0.01, 0.004],
    "RAD_TAN_THIN_PRISM_FISHEYE": [
        *(200.0, 199, 400.5, 380.5, 0.01, -0.02, 3e-3, 1e-4, 0, 1e-5),
        *(1e-3, -2e-3, 2e-3, 1e-4, -1e-3, 3e-4),
    ],
    "EUCM": [220.0, 219.0, 400.5, 380.5, 0.6, 1.1],
    "FOV": [300.0, 299.0, 400.5, 380.5, 0.9],
    "FULL_OPENCV": [400.0, 398, 400.5, 380.5, 0.1, -0.02, 1e-3, -1e-3, 0.01, 0.02, -0.01, 1e-3],
}


@pytest.mark.nightly
@pytest.mark.parametrize("name", THEIRS)
def test_models_against_colmap_itself(name):
    pycolmap = pytest.importorskip("pycolmap")
    theirs = pycolmap.Camera(model=name, width=WIDTH, height=HEIGHT, params=THEIRS[name])
    lens = colmap_lens("", (name, THEIRS[name], SIZE))
    uv, valid = make_camera_model(lens.model, dict(lens.parameters))(AHEAD)
    expected = np.stack([theirs.img_from_cam(ray) for ray in AHEAD]) - 0.5
    assert valid.all() and len(AHEAD) > 30
    np.testing.assert_allclose(uv, expected, atol=1e-9)
