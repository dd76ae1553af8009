"""The command line: what it writes, and one plain line on everything wrong with its input."""

import json
import re
import shlex

import cv2
import numpy as np
import pytest
import scene
import torch
import yaml

import omnistereo_lib as osl
from omnistereo_lib.frame import read_inverse_depth, write_inverse_depth
from omnistereo_lib.pictures import read_image, write_image
from omnistereo_rigs.doctor.rig_check import invert_poses
from omnistereo_tools import cli
from omnistereo_tools.commands import depth_command
from omnistereo_tools.commands.options import make_grid

pytestmark = pytest.mark.usefixtures("small")
SMALL = ["--grid", "96x24x16"]
GRID = osl.SphereGrid(96, 24, (-45, 45), 16, 0.6)
RESULTS = (
    "README.txt bound.tiff confidence.tiff depth_mm.png inverse_depth.png inverse_depth.tiff"
    " panorama.jpg points.ply provenance.json rig.yaml sigma.tiff trust.tiff"
)


@pytest.fixture(scope="module")
def scene_images():
    rig = scene.rig(width=200, height=192)
    rig = osl.Rig(rig.cameras, rig.T_rig_cam, min_depth=0.6)
    return rig, [picture.astype(np.uint8) for picture in scene.images(rig, finest=0.25)]


@pytest.fixture
def data(tmp_path, scene_images):
    """A data set of one frame with ground truth, in colour."""
    rig, pictures = scene_images
    folder = tmp_path / "data"
    folder.mkdir()
    osl.save_rig(rig, folder / "config.yaml")
    for k, picture in enumerate(pictures, 1):
        (folder / f"cam{k}").mkdir()
        write_image(folder / f"cam{k}" / "0001.png", np.stack([picture] * 3, -1))
    (folder / "omnidepth_gt_96").mkdir()
    truth = GRID.index_to_inverse_depth(scene.true_index(rig, GRID))
    write_inverse_depth(folder / "omnidepth_gt_96" / "00001.tiff", truth)
    return folder


def run(*arguments):
    """Run a command as its process would; return the exit status."""
    return cli.main([str(argument) for argument in arguments])


def with_images(data):
    return [
        "--rig",
        data / "config.yaml",
        "--images",
        *(data / f"cam{k}" / "0001.png" for k in (1, 2, 3, 4)),
    ]


def test_depth_of_a_data_set_frame(data, tmp_path, capsys):
    out = tmp_path / "deep" / "out"
    assert run("depth", "--rig", data, *SMALL, "--out", out) == 0
    assert sorted(path.name for path in out.iterdir()) == ["data", "index.html", "overview.png"]
    assert sorted(path.name for path in (out / "data").iterdir()) == sorted(
        [*RESULTS.split(), "errors.json"]
    )
    errors = json.loads((out / "data" / "errors.json").read_text())
    assert list(errors) == [">1", ">3", ">5", "MAE", "RMS"]
    assert 0 < errors["MAE"] < 5 and errors["MAE"] < errors["RMS"]  # percent of 16 spheres
    assert 0 <= errors[">5"] <= errors[">3"] <= errors[">1"] <= 100 and errors[">5"] < 20
    inverse_depth = read_inverse_depth(out / "data" / "inverse_depth.tiff")
    assert inverse_depth.shape == GRID.shape and np.nanmax(inverse_depth) <= 1 / 0.6 + 1e-6
    assert read_image(out / "data" / "inverse_depth.png").shape == (24, 96, 3)
    assert read_image(out / "data" / "panorama.jpg").shape == (24, 96, 3)
    text = (out / "data" / "README.txt").read_text()
    assert all(name in text for name in [*RESULTS.split()[1:], "errors.json"])
    captured = capsys.readouterr()
    assert f"the mean error is {errors['MAE'] / 100:.2g} of it" in captured.out
    assert f"written to {out}/: " in captured.out
    assert captured.out.startswith("Good: 90 % of rays are sure.\n")
    assert captured.out.endswith(f"\n{out / 'index.html'}\n")
    # the progress bar
    assert "of 2304 rays have a depth" in captured.out and "camera 1 of 4:" in captured.err


def test_las_without_laspy_is_refused_before_anything_is_computed(data, tmp_path, capsys):
    out = tmp_path / "out"
    assert run("depth", *with_images(data), *SMALL, "--out", out, "--las", out / "a.laz") == 2
    assert "--las needs laspy: pip install 'omnistereo-lib[las]'" in capsys.readouterr().err
    assert not out.exists()


def test_depth_of_images(data, tmp_path, capsys):
    out = tmp_path / "out"
    (out / "data").mkdir(parents=True)
    (out / "data" / "errors.json").write_text("of another frame")
    (out / "data" / "mine.txt").write_text("kept")
    files = ["--mesh", out / "a.ply", "--equirectangular", out / "a.tiff"]
    method = ["--phi", -30, 60, "--method", "zncc+sgm,pairs=all"]
    assert run("depth", *with_images(data), *SMALL, *method, "--out", out, *files) == 0
    written = "a.ply a.tiff a_colors.jpg a_photo.jpg data index.html overview.png"
    assert {path.name for path in out.iterdir()} == set(written.split())
    assert sorted(path.name for path in (out / "data").iterdir()) == sorted(
        [*RESULTS.split(), "mine.txt"]
    )
    assert "ground truth" not in capsys.readouterr().out
    sphere = cv2.imread(str(out / "a.tiff"), cv2.IMREAD_UNCHANGED)  # 2:1, from -90° to 90°
    assert sphere.shape == (48, 96) and np.isnan(sphere[:16]).all() and np.isnan(sphere[40:]).all()
    inverse_depth = read_inverse_depth(out / "data" / "inverse_depth.tiff")
    np.testing.assert_allclose(sphere[16:40] * inverse_depth, 1, rtol=1e-6)


def test_depth_of_gray_images_without_a_nearest_depth(
    data, tmp_path, capsys, monkeypatch, scene_images
):
    rig, pictures = scene_images
    osl.save_rig(osl.Rig(rig.cameras, rig.T_rig_cam), data / "config.yaml")
    for k, picture in enumerate(pictures, 1):
        write_image(data / f"cam{k}" / "0001.png", picture)
    monkeypatch.chdir(tmp_path)
    assert run("depth", *with_images(data), *SMALL) == 0
    proposed = re.search(r"proposes --min-depth (\S+)\.\n", capsys.readouterr().err)
    truth = GRID.index_to_depth(scene.true_index(rig, GRID)).min()
    assert 0.4 * truth < float(proposed[1]) < truth
    # by the rig's name, or its folder's
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["depth_data"]
    assert read_image(tmp_path / "out" / "depth_data" / "data" / "panorama.jpg").ndim == 2


def test_a_rig_in_a_wrong_unit_is_the_verdict(data, tmp_path, capsys, scene_images):
    """Not that a quarter of its rays are doubtful."""
    rig = scene_images[0]
    poses = [osl.Pose(pose.R, 1000 * pose.t) for pose in rig.T_rig_cam]
    osl.save_rig(osl.Rig(rig.cameras, poses, 100.0), data / "config.yaml")
    assert run("depth", *with_images(data), *SMALL, "--out", tmp_path / "out", "--strict") == 1
    said = capsys.readouterr().out.splitlines()[0]
    assert re.search(r"^Bad: the cameras are up to \d+ m apart. Check the unit .*--unit", said)


def test_a_black_image_is_the_verdict(data, tmp_path, capsys):
    """Not that its camera is late."""
    write_image(data / "cam3" / "0001.png", np.zeros((192, 200)))
    for command in ("depth", "--out", tmp_path / "out", *SMALL), ("doctor",):
        run(command[0], *with_images(data), *command[1:])
        said = capsys.readouterr()
        assert said.out.startswith("Bad: camera 3 shows black. Check lens caps and paths.\n")
        assert "late" not in said.err and said.err.count("shows black") <= 1


@pytest.mark.parametrize("order", [(1, 0, 2, 3), (3, 0, 1, 2)], ids=["swapped", "moved on"])
def test_images_in_another_order_are_put_right_by_the_command_that_doctor_prints(
    data, tmp_path, capsys, order
):
    """Which writes no rig for the wrong order, that would stay."""
    given = with_images(data)
    right, given[3:] = given[3:], [given[3 + k] for k in order]
    assert run("depth", *given, *SMALL, "--out", tmp_path / "out") == 0
    name = "Bad: the images look swapped (give them in the order "
    assert capsys.readouterr().out.startswith(name)
    assert run("doctor", *given) == 1
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith(name) and "off by one pixel" not in "".join(said)
    expected = ["omnistereo", "depth", *given[:3], *right]
    assert shlex.split(said[-1]) == list(map(str, expected))


def test_doctor_of_a_wrong_rig(data, capsys, scene_images):
    osl.save_rig(invert_poses(scene_images[0]), data / "config.yaml")
    assert run("doctor", "--rig", data) == 1
    assert (
        "Bad: the poses look inverted (rig → camera instead of camera → rig)"
        in capsys.readouterr().out
    )


def test_doctor_of_a_rig_without_images_says_what_it_can_see(data, capsys):
    assert run("doctor", "--rig", data / "config.yaml") == 0
    said = capsys.readouterr().out
    assert "A match that is off by one pixel puts a depth off by" in said and " m at 5 m," in said
    # without images nothing can run
    assert "Ready to run" not in said and "omnistereo depth" not in said


def test_doctor_of_a_right_rig_prints_the_command_that_depth_is_by_default(
    data, capsys, monkeypatch, scene_images
):
    rig, _ = scene_images
    # without a nearest depth
    osl.save_rig(osl.Rig(rig.cameras, rig.T_rig_cam), data / "config.yaml")
    grids = []

    def stop(*arguments):
        grids.append(make_grid(*arguments))
        raise osl.OmnistereoError("seen enough")

    monkeypatch.setattr(depth_command, "make_grid", stop)
    assert run("doctor", *with_images(data)) == 0
    out = capsys.readouterr().out
    assert f"4 cameras, {rig.baselines.min():.3g} to {rig.baselines.max():.3g} m apart" in out
    assert "Good: the rig fits its images" in out
    command = shlex.split(out.splitlines()[-1])
    assert command[0] == "omnistereo" and run(*command[1:]) == 2
    assert run("depth", *with_images(data)) == 2
    assert grids[0] == grids[1] and grids[0].phi_deg == (-90, 90) and grids[0].shape == (320, 640)


def test_doctor_of_a_folder_that_holds_a_rig_alone(data, tmp_path, capsys):
    (tmp_path / "rig").mkdir()
    (data / "config.yaml").rename(tmp_path / "rig" / "config.yaml")
    assert run("doctor", "--rig", tmp_path / "rig") == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0] == "Unknown: without --images nothing shows whether the poses are right."
    assert said[-1].startswith("Pass --images, one per camera: ")


def test_doctor_of_the_same_picture_twice(data, capsys):
    (data / "cam1" / "0001.png").write_bytes((data / "cam2" / "0001.png").read_bytes())
    assert run("doctor", *with_images(data)) == 1
    assert capsys.readouterr().out.startswith(
        "Bad: images 1 and 2 are identical. Check their paths.\n"
    )


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("depth --rig none --images a b --method bogus", "cost must be one of .*'bogus'"),
        ("record --rig none --images none/ b --grid 96x24x1", "num_spheres is 1"),
        ("depth --rig none --images a b --frame 3", "--frame is of a data set. Leave"),
        ("record --rig none --images none/ b --frames 3", "--frames is 3; .*START:STOP:STEP"),
        ("start none --board 9x6 --square 0.1 --max-fov 900", "--max-fov is 900"),
        ("depth --rig none --images a b --phi 20 10", r"phi_deg is \(20.0, 10.0\)"),
        ("live --rig none --cameras 0 1 --method zncc,window=4", "window"),
        ("onnx --rig none --grid 8x-8", "--grid is 8x-8; expected columns x rows"),
        ("calibrate none --board 12x10 --square 0.06 --max-fov 9", "max_fov_deg is 9"),
        ("evaluate --methods zncc bogus", "--methods bogus: cost must be one of .*'bogus'"),
        ("depth --rig none --method zncc,p3=2", "--method zncc,p3=2: unknown setting"),
        ("train volumenet --data none --set steps=0", "steps = 0"),
    ],
)
def test_what_is_typed_is_checked_before_a_file_is_opened(
    tmp_path, monkeypatch, capsys, command, said
):
    monkeypatch.chdir(tmp_path)
    assert run(*command.split()) == 2
    assert re.match(f"error: .*{said}", capsys.readouterr().err)


@pytest.mark.parametrize(
    "command", [[], ["--help"], *([name, "--help"] for name in cli.COMMANDS)], ids=" ".join
)
def test_help_is_given(command, capsys):
    with pytest.raises(SystemExit) as stop:
        run(*command)
    said = capsys.readouterr().out
    assert stop.value.code == 0 and "usage: omnistereo" in said
    assert said.split("\n\n")[-1].startswith("exit status: 0 done")


def test_warnings_are_plain_lines(data, tmp_path, capsys):
    """A polynomial that is not the other's inverse is told, without a line of source code."""
    config = yaml.safe_load((data / "config.yaml").read_text())
    for camera in config["cameras"][:2]:
        camera["inv_poly"][1] += 1
    (data / "config.yaml").write_text(yaml.safe_dump(config))
    assert run("depth", *with_images(data), *SMALL, "--out", tmp_path / "out") == 0
    warned = [line for line in capsys.readouterr().err.splitlines() if line.startswith("warning: ")]
    assert len(warned) == 1 and "of cameras 1, 2 disagree by up to 1.00 px" in warned[0]


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_cuda_where_there_is_none(data, tmp_path, capsys):
    assert run("depth", *with_images(data), "--device", "cuda", "--out", tmp_path / "out") == 2
    assert "PyTorch finds no CUDA GPU" in capsys.readouterr().err
