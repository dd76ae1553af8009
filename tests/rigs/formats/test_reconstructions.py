"""Reconstructions: COLMAP's rigs and models, transforms.json, and one moment of many."""

from functools import partial

import cv2
import numpy as np
import pytest
from rigs.formats.rig_file_samples import (
    K4,
    POSES,
    RAYS,
    SIZE,
    WORLD,
    brown,
    follows,
    four_by_four,
    fov,
    kb4,
    read,
    same,
    transforms,
    write,
    wxyz,
)
from scene import refused

from omnistereo_lib import Pose

ROUND, PINHOLE = partial(kb4, f=(200, 200)), partial(brown, f=(400, 400), k=(0, 0), p=(0, 0))
MODELS = {
    "OPENCV_FISHEYE": ([200.0, 199.0, 400.5, 380.5, *K4], kb4),
    "RADIAL_FISHEYE": ([200.0, 400.5, 380.5, -0.01, 0.004], partial(ROUND, k=[-0.01, 0.004, 0, 0])),
    "SIMPLE_RADIAL_FISHEYE": ([200.0, 400.5, 380.5, -0.01], partial(ROUND, k=[-0.01, 0, 0, 0])),
    "OPENCV": ([400.0, 398.0, 400.5, 380.5, -0.1, 0.01, 1e-5, -1e-5], brown),
    "SIMPLE_PINHOLE": ([400.0, 400.5, 380.5], PINHOLE),
    "FOV": ([300.0, 299.0, 400.5, 380.5, 0.9], fov),
}


def cameras_txt(name="OPENCV_FISHEYE", ids=(1, 2)):
    values = " ".join(map(str, MODELS[name][0]))
    return "".join(f"{n} {name} {SIZE[0]} {SIZE[1]} {values}\n" for n in ids)


def rig_config(name="OPENCV_FISHEYE", **changes):
    pose = POSES[1].inverse()
    turned = {"cam_from_rig_rotation": wxyz(pose.R), "cam_from_rig_translation": pose.t.tolist()}
    lens = {"camera_model_name": name, "camera_params": MODELS[name][0]} | changes
    first = {"image_prefix": "a/", "ref_sensor": True} | lens
    return [{"cameras": [first, {"image_prefix": "b/"} | turned | lens]}]


@pytest.mark.parametrize("name", MODELS)
def test_rigs_of_colmap(tmp_path, name):
    """Lenses are those of the rig, whatever the order of cameras.txt, which has their size."""
    write(tmp_path / "cameras.txt", "7 PINHOLE 10 10 5 5 5 5\n" + cameras_txt(name))
    rig, said = read(tmp_path / "rig_config.json", rig_config(name), "m")
    same(rig)
    follows(rig.cameras[1], MODELS[name][1], atol=0.05)
    assert rig.cameras[1].max_fov_deg <= 180
    assert not [text for text in said if "tangential" not in text and "one to one" not in text]


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (
            rig_config(camera_params=[1.0] * 8),
            r"camera 1: its camera_params are not in cameras.txt",
        ),
        (rig_config(camera_params=None), "camera 1: key 'camera_params' is missing"),
        (rig_config() * 2, "the file holds 2 rigs; expected one"),
    ],
)
def test_rigs_of_colmap_that_are_refused(tmp_path, data, message):
    write(tmp_path / "cameras.txt", cameras_txt())
    with refused(message):
        read(tmp_path / "rig_config.json", data, "m")
    (tmp_path / "cameras.txt").unlink()
    with refused(r"cameras.txt is missing; expected it|holds 2 rigs"):
        read(tmp_path / "rig_config.json", data, "m")


STEP = Pose.from_vector([0, 0.1, 0, 1, 0, 0])  # of the rig between two moments


def images_txt(*names, shared=True):
    """Return images of two cameras, moment after moment, one lens for both or one for each."""
    text, world = "# IMAGE_ID, QW, QX, …\n", WORLD
    for n, name in enumerate(names):
        pose = (world @ POSES[n % 2]).inverse()
        numbers = " ".join(map(str, [*wxyz(pose.R), *pose.t]))
        # A line of points, which may be empty, follows each image.
        text += f"{n + 1} {numbers} {1 if shared else n % 2 + 1} {name}\n{'1.0 2.0 -1' * (n % 3)}\n"
        world = world @ STEP if n % 2 else world
    return text


NAMES = {
    "folders": ("left/1.png", "right/1.png", "left/2.png", "right/2.png"),
    "one moment": ("left.png", "right.png"),
    "one folder": ("a/left_7.png", "a/right_7.png"),
    "numbers": ("images/cam1.png", "images/cam2.png"),
}


@pytest.mark.parametrize("names", NAMES)
@pytest.mark.parametrize("shared", [True, False])
def test_cameras_of_colmap_are_those_of_the_images(tmp_path, names, shared):
    write(tmp_path / "cameras.txt", cameras_txt(ids=(1,) if shared else (1, 2)))
    write(tmp_path / "images.txt", images_txt(*NAMES[names], shared=shared))
    for path in (tmp_path, tmp_path / "images.txt"):
        rig, said = read(path, None, "m")
        same(rig)
        follows(rig.cameras[1], kb4, RAYS, least=0.49)
        assert not said
    with refused("does not state its unit"):
        read(tmp_path)


def test_cameras_are_in_the_order_of_their_numbers(tmp_path):
    write(tmp_path / "cameras.txt", cameras_txt(ids=(1,)))
    header, text = images_txt("cam1/a.png", "cam10/a.png", "cam1/b.png", "cam10/b.png").split(
        "\n", 1
    )
    lines = text.splitlines()
    write(tmp_path / "images.txt", "\n".join([header, *lines[2:4], *lines[:2], *lines[4:], ""]))
    same(read(tmp_path, None, "m")[0])


def test_moments_that_differ_are_said(tmp_path):
    write(tmp_path / "cameras.txt", cameras_txt(ids=(1,)))
    text = images_txt("cam1/0.png", "cam2/0.png", "cam1/1.png", "cam2/1.png")
    lines = text.splitlines()
    lines[7] = lines[7].replace(lines[7].split()[5], "9.0")
    said = read(write(tmp_path / "images.txt", "\n".join(lines)), None, "m")[1]
    assert "cam1/0.png and cam1/1.png contradict" in said[0]
    assert "camera 2: " in said[0] and "% of the size of the rig" in said[0]


POSE = " ".join(map(str, [*wxyz(POSES[1].inverse().R), *POSES[1].inverse().t]))
ONE = "moments of one camera, or cameras"
NO_POINTS = images_txt("left.png", "right.png").replace("\n\n", "\n")
CROSSED = images_txt("a/1.png", "b/1.png", "b/2.png", "a/2.png", shared=False)
WRONG_MODELS = [
    ("images.txt", "1 1 0 0 0 0 0 0 7 a.png", r"line 1: found .*CAMERA_ID NAME"),
    ("images.txt", "", "there is no image"),
    ("images.txt", NO_POINTS, "line 2: .*a line of its points, which may be empty"),
    ("images.txt", images_txt("1/a/0.png", "1/b/0.png", "2/a/0.png", "2/b/0.png"), ONE),
    ("images.txt", images_txt("10.png", "11.png"), ONE),
    ("images.txt", images_txt("1/a.png", "2/b.png"), "no file name is that of an image of"),
    ("images.txt", images_txt(*(f"frame_{n:04}.png" for n in range(4))), ONE),
    ("images.txt", images_txt("l_1.png", "r_1.png", "l_2.png", "r_2.png"), ONE),
    ("images.txt", CROSSED, "have several cameras"),
    ("cameras.txt", "1 OPENCV_FISHEYE 800\n", "line 1: found .*expected CAMERA_ID MODEL"),
    ("cameras.txt", cameras_txt().replace("OPENCV_FISHEYE", "DIVISION"), "is division; exp"),
    ("cameras.txt", "1 FISHEYE 800 760 200 199 400\n2 FISHEYE 8 7 2 2 2 2\n", "has 3 numbers; exp"),
    ("rigs.txt", "1 2 CAMERA 1 CAMERA 2 0\n", r"\['2'\] is not in cameras.txt, or has no"),
    ("rigs.txt", f"1 2 CAMERA 1 CAMERA 7 1 {POSE}\n", r"\['7'\] is not in cameras.txt"),
    ("rigs.txt", "1 1 IMU 1\n", r"line 1: camera \[\] is not in cameras.txt"),
    ("rigs.txt", 2 * f"1 2 CAMERA 1 CAMERA 2 1 {POSE}\n", "has 2 rigs of several cameras"),
]


@pytest.mark.parametrize(("file", "text", "message"), WRONG_MODELS)
def test_models_that_are_refused(tmp_path, file, text, message):
    write(tmp_path / "cameras.txt", cameras_txt())
    write(tmp_path / "images.txt", images_txt("left.png", "right.png", shared=False))
    write(tmp_path / file, text)
    with refused(message):
        read(tmp_path, None, "m")


def test_the_rig_of_rigs_txt(tmp_path):
    write(tmp_path / "cameras.txt", cameras_txt())
    write(tmp_path / "images.txt", images_txt("0001.png", "0002.png", shared=False))
    write(tmp_path / "rigs.txt", f"# RIG_ID, …\n1 2 CAMERA 1 CAMERA 2 1 {POSE}\n")
    same(read(tmp_path, None, "m")[0])


def test_binary_models_say_what_to_do(tmp_path, monkeypatch):
    monkeypatch.setattr("omnistereo_rigs.formats.read.find_spec", lambda name: None)
    write(tmp_path / "cameras.bin", "")
    with refused(r"Install pycolmap, or type `colmap model_converter"):
        read(tmp_path)


def test_frames_of_several_moments_are_one_rig(tmp_path):
    frames = []
    for moment, world in enumerate((WORLD, WORLD @ STEP, WORLD @ STEP @ STEP)):
        for k, pose in enumerate(POSES):
            stated = {"transform_matrix": four_by_four(world @ pose, (1, -1, -1))}
            frames.append(stated | {"file_path": f"images/cam{k}/{moment:04}.png"})
    rig, said = read(tmp_path / "t.json", transforms() | {"frames": frames}, "m")
    same(rig)
    assert not said
    frames[2]["fl_x"] = 210.0
    with refused("the frames of images/cam0 have several lenses"):
        read(tmp_path / "t.json", transforms() | {"frames": frames}, "m")


NO_FOCAL = {"fl_x": None, "fl_y": None, "camera_angle_x": 2.9}
WRONG_FRAMES = [
    (NO_FOCAL, "frame 1: key 'fl_x' is missing; found .*camera_angle_x"),
    ({"is_fisheye": True}, "is_fisheye is True; .* Write camera_model: OPENCV_FISHEYE"),
    ({"k1": None}, "frame 1: found k2 k3 k4; expected k1 k2 … without a gap"),
    ({"camera_model": None}, "camera_model is not stated; expected one of opencv, pinhole"),
    ({"camera_model": "EQUIRECTANGULAR"}, "camera_model is equirectangular; expected one"),
]


@pytest.mark.parametrize(("changes", "message"), WRONG_FRAMES)
def test_frames_that_are_refused(tmp_path, changes, message):
    with refused(message):
        read(tmp_path / "t.json", transforms(**changes), "m")


def test_coefficients_that_are_not_stated_are_said(tmp_path):
    none = dict.fromkeys(("k1", "k2", "k3", "k4"))
    rig, said = read(tmp_path / "t.json", transforms(**none), "m")
    follows(rig.cameras[0], partial(kb4, k=[0] * 4))
    assert len(said) == 1 and "none of k1 to k4 is stated: 0" in said[0]
    plain = transforms(**none, camera_model="PINHOLE")
    assert not [text for text in read(tmp_path / "t.json", plain, "m")[1] if "k1" in text]


def test_masks_of_frames_are_bright_inside(tmp_path):
    data = transforms()
    data["frames"][1]["mask_path"] = "masks/2.png"
    with refused(r"masks/2.png .*No such file"):
        read(tmp_path / "t.json", data, "m")
    mask = np.zeros(SIZE[::-1], np.uint8)
    mask[200:600, 100:700] = 255
    (tmp_path / "masks").mkdir()
    cv2.imwrite(str(tmp_path / "masks" / "2.png"), mask)
    first, second = read(tmp_path / "t.json", data, "m")[0].cameras
    assert first.mask is None
    np.testing.assert_array_equal(second.mask, mask == 255)


def test_moments_of_one_camera_are_no_rig(tmp_path):
    frames = transforms()["frames"] * 6
    many = [frame | {"file_path": f"images/{n:04}.png"} for n, frame in enumerate(frames)]
    with refused("moments of one camera, or cameras"):
        read(tmp_path / "t.json", transforms() | {"frames": many}, "m")
