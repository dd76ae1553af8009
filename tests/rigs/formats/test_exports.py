"""Files for other programs."""

import json
import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import scene
from rigs.formats.rig_file_samples import read, same
from scene import refused

import omnistereo_lib as osl
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_rigs.formats.read import read_rig
from omnistereo_rigs.formats.write import beyond_sentences, export_rig, resized
from omnistereo_tools import cli
from omnistereo_tools.commands.options import FrameOptions, read_frame
from omnistereo_tools.output.frame import equirectangular_depth

RAYS = np.random.default_rng(1).normal(size=(400, 3))


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    folder, rig = tmp_path_factory.mktemp("exported"), osl.load_rig("data_samples/sunny/test")
    return rig, folder, max(export_rig(rig, folder))


def test_equirectangular_depth_covers_the_sphere():
    rig = scene.rig(width=200, height=192)
    grid = osl.SphereGrid(160, 60, (-30.0, 60.0), num_spheres=64, min_depth=0.6)
    index = scene.true_index(rig, grid).astype(np.float32)
    panorama = equirectangular_depth(osl.Depth(index, np.ones_like(index), SphereSweep(rig, grid)))
    assert panorama.shape == (80, 160) and panorama.dtype == np.float32
    phi = (np.arange(80) + 0.5) / 80 * 180 - 90
    unknown = np.isnan(panorama).all(1)
    np.testing.assert_array_equal(unknown, (phi < -30) | (phi > 60))
    center = np.mean([pose.t for pose in rig.T_rig_cam], 0)
    truth = scene.distance(center, osl.SphereGrid(160, 80, (-90, 90)).rays())
    # of the nearest of 60 rows
    np.testing.assert_allclose(panorama[~unknown], truth[~unknown], rtol=0.03)


def test_opencv_opens_what_is_written_for_it(exported):
    """Its own reader, and its own projection, within 90°."""
    rig, folder, residual = exported
    storage = cv2.FileStorage(str(folder / "opencv.yaml"), cv2.FILE_STORAGE_READ)
    ahead = RAYS[RAYS[:, 2] > 0.1]
    for i, camera in enumerate(rig.cameras, 1):
        node = storage.getNode(f"cam{i}")
        K, D, R, T = (node.getNode(name).mat() for name in "KDRT")
        in_rig = (ahead @ R - (R.T @ T).ravel())[:, None]  # X_cam = R X_rig + T
        uv = cv2.fisheye.projectPoints(in_rig, cv2.Rodrigues(R)[0], T, K, D)[0].reshape(-1, 2)
        ours, valid = camera.project(ahead)
        assert valid.any() and np.abs(uv - ours)[valid].max() < residual + 0.01
        size = [node.getNode(f"image_{side}").real() for side in ("width", "height")]
        assert size == [800, 768]


def test_the_folder_for_colmap(exported):
    """Models and poses stand in rig_config.json, masks end at 85°, and half a pixel is added."""
    rig, folder, _ = exported
    colmap = folder / "colmap"
    (config,) = json.loads((colmap / "rig_config.json").read_text())
    lines = (colmap / "cameras.txt").read_text().splitlines()[1:]
    for i, (cam, line) in enumerate(zip(config["cameras"], lines, strict=True), 1):
        assert cam["camera_model_name"] == line.split()[1] == "OPENCV_FISHEYE"
        assert cam["camera_params"] == list(map(float, line.split()[4:]))
        assert cam["camera_params"][2] == rig.cameras[i - 1].center[0] + 0.5
        mask = cv2.imread(str(colmap / "masks" / f"cam{i}.png"), cv2.IMREAD_GRAYSCALE)
        for degrees, bright in ((84.5, 255), (85.5, 0)):
            theta = np.radians(degrees)
            (u, v), _ = rig.cameras[i - 1].project([np.sin(theta), 0, np.cos(theta)])
            assert mask[round(v), round(u)] == bright
    (said,) = beyond_sentences(rig)
    assert said.startswith("36 % of the pixels lie beyond 90°")


@pytest.mark.nightly
def test_colmap_reads_its_folder(exported, pycolmap):
    rig, folder, residual = exported
    model = pycolmap.Reconstruction(str(folder / "colmap"))
    (config,) = pycolmap.read_rig_config(str(folder / "colmap" / "rig_config.json"))
    first = rig.T_rig_cam[0]
    for i, (camera, stated) in enumerate(zip(rig.cameras, config.cameras, strict=True), 1):
        ours, valid = camera.project(RAYS[RAYS[:, 2] > 0.1])
        theirs = np.stack([model.cameras[i].img_from_cam(ray) for ray in RAYS[RAYS[:, 2] > 0.1]])
        assert np.abs(theirs - 0.5 - ours)[valid].max() < residual + 0.01
        if i > 1:
            T = rig.T_rig_cam[i - 1].inverse() @ first
            matrix = stated.cam_from_rig.matrix()
            np.testing.assert_allclose(matrix, np.column_stack([T.R, T.t]), atol=1e-9)


@pytest.mark.nightly
def test_binary_models_are_read_by_pycolmap(exported, pycolmap, tmp_path):
    """What COLMAP has made of our own lenses and two images of each."""
    rig, folder, residual = exported
    model = pycolmap.Reconstruction(folder / "colmap")
    for n, pose in enumerate(rig.T_rig_cam, 1):
        matrix = np.column_stack([pose.R.T, -pose.R.T @ pose.t])
        image = pycolmap.Image(name=f"cam{n}/1.png", camera_id=n, image_id=n)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(matrix))
    model.write_binary(tmp_path)
    back, said = read(tmp_path, None, "m")
    assert not (tmp_path / "cameras.txt").exists() and not said
    same(back, rig.T_rig_cam)
    for ours, true in zip(back.cameras, rig.cameras, strict=True):
        uv, seen = ours.project(RAYS)
        assert np.abs(uv - true.project(RAYS)[0])[seen].max() < residual + 0.02


@pytest.mark.parametrize(
    ("size", "scale"), [((400, 384), (0.5, 0.5)), ((1000, 955), (1.25, 955 / 768))]
)
def test_a_rig_for_resized_images(exported, size, scale):
    """A pixel's centre moves as cv2.resize has it; sides that are rounded stretch a little."""
    rig, _, _ = exported
    for old, new in zip(rig.cameras, resized(rig, size).cameras, strict=True):
        uv, valid = old.project(RAYS)
        other, seen = new.project(RAYS)
        both = valid & seen
        assert both.mean() > 0.3
        np.testing.assert_allclose(other[both], ((uv + 0.5) * scale - 0.5)[both], atol=1e-6)
        rays, _ = new.unproject(other[both], use_direct_poly=True)
        true, _ = old.unproject(uv[both], use_direct_poly=True)
        np.testing.assert_allclose(rays, true, atol=1e-6)
    with refused("other ratios of their sides"):
        resized(rig, (400, 400))


@pytest.mark.parametrize("program", ["kalibr", "opencv", "colmap", "nerfstudio", "ocam"])
def test_the_command_goes_both_ways(exported, program, tmp_path, capsys):
    rig, _, _ = exported
    name = {"opencv": "rig.yaml", "kalibr": "rig.yaml", "nerfstudio": "rig.json"}.get(
        program, "rig"
    )
    there, back = tmp_path / name, tmp_path / "back.yaml"
    source = "data_samples/sunny/test"
    assert cli.main(["rig", source, str(there), "--to", program]) == 0
    said = capsys.readouterr().out
    assert re.search(r"^Good: 4 cameras, 0.841 to 1.2 m apart.\n.*; metres by the format", said)
    unit = [] if program == "kalibr" else ["--unit", "m"]
    assert cli.main(["rig", str(there), str(back), *unit, "--max-fov", "220"]) == 0
    assert capsys.readouterr().out.endswith(f"\nomnistereo doctor --rig {back}\n")
    read = read_rig(back)
    assert read.is_own
    for n, camera in enumerate(read.rig.cameras):
        relative = read.rig.T_rig_cam[0].inverse() @ read.rig.T_rig_cam[n]
        true = rig.T_rig_cam[0].inverse() @ rig.T_rig_cam[n]
        assert max((true.inverse() @ relative).magnitude()) < 1e-8
        (uv, seen), (other, _) = camera.project(RAYS), rig.cameras[n].project(RAYS)
        assert np.abs(uv - other)[seen].max() < 0.05


def test_the_command_says_what_it_assumed(exported, tmp_path, capsys):
    _, folder, _ = exported
    out = str(tmp_path / "rig.yaml")
    assert cli.main(["rig", str(folder / "opencv.yaml"), out]) == 2
    assert "does not state its unit. Pass it (`omnistereo rig --unit`)" in capsys.readouterr().err
    assert (
        cli.main(["rig", str(folder / "opencv.yaml"), out, "--unit", "m", "--size", "400x384"]) == 0
    )
    said = capsys.readouterr().out
    for line in (
        r"opencv.yaml: OpenCV, ROS; m \(--unit\)",
        r"lenses:  kb4, 800 × 768 px, followed to 0.0\d px at worst",
        r"field:   180°; camera 1, 2, 3, 4: no more can have been measured, --max-fov goes on",
        r"frame:   that of the file",
        r"doubts:  none",
        r"resized: to 400 × 384 px \(pixel centres at whole numbers",
    ):
        assert re.search(line, said), said
    assert osl.load_rig(out).cameras[0].image_size == (400, 384)
    for wrong in ([out, out], ["--size", "4x"], ["--to", "opencv"]):
        arguments = wrong if wrong[0] == out else [out, str(tmp_path / "other"), *wrong]
        assert cli.main(["rig", *arguments]) == 2


def test_a_command_converts_and_names_the_command_that_does_it_once(exported, capsys):
    _, folder, _ = exported
    file = folder / "kalibr.yaml"
    assert cli.main(["doctor", "--rig", str(file)]) == 0
    said = capsys.readouterr().err
    assert f"{file} (Kalibr camchain) is converted; `omnistereo rig {file} rig.yaml`" in said


def test_the_library_names_the_converter(exported):
    _, folder, _ = exported
    with refused(r"omnistereo rig .*kalibr.yaml.*read_any_rig"):
        osl.load_rig(folder / "kalibr.yaml")


def test_a_data_set_with_a_rig_of_another_program(exported, tmp_path, capsys):
    _, folder, _ = exported
    shutil.copy(folder / "kalibr.yaml", tmp_path / "calibration.yaml")
    for n in (1, 2, 3, 4):
        source = Path("data_samples/sunny/test") / f"cam{n}"
        (tmp_path / f"cam{n}").symlink_to(source.resolve())
    frame = read_frame(FrameOptions(rig=tmp_path))
    assert len(frame.rig) == 4 and frame.images[0].shape[:2] == (768, 800)
    assert "`omnistereo rig " in capsys.readouterr().err
