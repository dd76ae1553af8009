"""The commands on rigs whose frame, field of view or black rim is not what it should be."""

import re
import shlex

import numpy as np
import pytest
import scene
import yaml

import omnistereo_lib as osl
from omnistereo_lib.pictures import write_image
from omnistereo_rigs import read_any_rig
from omnistereo_tools import cli

pytestmark = pytest.mark.usefixtures("small")
FLU = osl.Pose(np.array([[0, 0, 1.0], [-1, 0, 0], [0, -1, 0]]), np.zeros(3))  # x forward, z up
SMALL = ["--grid", "96x24x16", "--method", "zncc"]


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """A rig in a robot's frame, its images, and the same black beyond 160° of the lens."""
    folder, rig = tmp_path_factory.mktemp("robot"), scene.rig(width=200, height=192)
    pictures = scene.images(rig, finest=0.25)
    osl.save_rig(osl.Rig(rig.cameras, rig.transformed(FLU).T_rig_cam, 0.5), folder / "rig.yaml")
    for k, (camera, picture) in enumerate(zip(rig.cameras, pictures, strict=True), 1):
        v, u = np.indices(picture.shape)
        seen = np.hypot(u - camera.center[0], v - camera.center[1]) <= camera.max_radius * 160 / 220
        write_image(folder / f"{k}.png", picture)
        write_image(folder / f"dark{k}.png", np.where(seen, picture, 0))
    return folder, rig


def depth(folder, out, *options, images="{}.png"):
    pictures = [str(folder / images.format(k)) for k in (1, 2, 3, 4)]
    rig = ["--rig", str(folder / "rig.yaml"), "--images", *pictures]
    return cli.main(["depth", *rig, *SMALL, "--out", str(out), *options])


def test_the_turn_is_stated_and_can_be_undone(world, tmp_path, capsys):
    folder, rig = world
    assert depth(folder, tmp_path / "turned") == 0
    assert re.search(
        r"^The rig was turned level, by 1[12][0-9]° \(`omnistereo rig --keep-frame` leaves it\)\.$",
        capsys.readouterr().err,
        re.M,
    )
    assert "rig turned level" in (tmp_path / "turned" / "index.html").read_text(encoding="utf-8")
    stored = yaml.safe_load((tmp_path / "turned" / "data" / "rig.yaml").read_text())
    T = osl.Pose.from_vector(stored["config"]["T_rig_file"])
    # A camera of the panorama's frame, back in the frame of the robot.
    there = osl.Pose.from_vector(stored["cameras"][1]["pose"])
    robot = rig.transformed(FLU).T_rig_cam[1]
    np.testing.assert_allclose((T.inverse() @ there).t, robot.t, atol=1e-9)
    np.testing.assert_allclose((T.inverse() @ there).R, robot.R, atol=1e-9)


@pytest.mark.parametrize(
    ("factor", "doubt"),
    [(1e-3, "are at one place: they see no depth"), (1e3, "Check the unit of the translations")],
)
def test_a_wrong_unit_is_doubted_without_images(tmp_path, capsys, factor, doubt):
    rig = scene.rig(width=200, height=192)
    osl.save_rig(
        rig.with_poses([osl.Pose(pose.R, factor * pose.t) for pose in rig.T_rig_cam]),
        tmp_path / "rig.yaml",
    )
    assert cli.main(["doctor", "--rig", str(tmp_path / "rig.yaml")]) == 0
    assert doubt in capsys.readouterr().err


def test_a_black_rim_is_told_and_masked(world, tmp_path, capsys):
    folder, _ = world
    assert depth(folder, tmp_path, images="dark{}.png") == 0
    said = capsys.readouterr().err
    pattern = (
        r"black beyond (\d+)° of the 220° stated: two cameras see (\d+) % of the sphere, not (\d+)"
        r" %.*--max-fov (\d+)"
    )
    found = re.search(f"images of camera 1, 2, 3, 4 are {pattern}", said)
    fov, after, before, proposed = map(int, found.groups())
    assert 155 <= fov <= 162 and after < before - 20 and 154 <= proposed <= 162


def test_a_converted_rig_keeps_its_frame_and_field_of_view(world, tmp_path, capsys):
    folder, rig = world
    converted = tmp_path / "a rig.yaml"  # typed again, the next command has to hold together
    command = ["rig", str(folder / "rig.yaml"), str(converted), "--keep-frame"]
    assert cli.main([*command, "--max-fov", "3.84"]) == 2
    said = capsys.readouterr().err
    assert re.search(r"--max-fov is 3.84; expected .* degrees.* radians \(220.0°\)", said)
    assert cli.main([*command, "--max-fov", "180"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("Good: 4 cameras, ")
    last = shlex.split(said.splitlines()[-1])
    assert last == ["omnistereo", "doctor", "--rig", str(converted)]
    read = read_any_rig(converted)
    assert {camera.max_fov_deg for camera in read.cameras} == {180}
    robot = rig.transformed(FLU).T_rig_cam[1]
    np.testing.assert_allclose(read.T_rig_cam[1].R, robot.R, atol=1e-9)


def test_the_frame_of_ground_truth_is_kept(tmp_path):
    grid = osl.SphereGrid(96, 24, (-45, 45), 16, 0.6)
    folder = scene.write_set(tmp_path / "set", scene.rig(width=200, height=192), grid, [(0, 0, 0)])
    rig = osl.load_rig(folder)
    osl.save_rig(osl.Rig(rig.cameras, rig.transformed(FLU).T_rig_cam, 0.6), folder / "config.yaml")
    kept = osl.load_dataset(folder).rig
    np.testing.assert_allclose(kept.T_rig_cam[0].R, (FLU @ rig.T_rig_cam[0]).R, atol=1e-12)
