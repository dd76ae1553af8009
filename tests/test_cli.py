"""The command line: what it writes, and one plain line on everything that can be wrong with its input."""

import importlib
import json
import re

import numpy as np
import psutil
import pytest
import scene
import torch
import yaml

import omnistereo_lib as osl
from omnistereo_lib import cli
from omnistereo_lib.dataset import read_inverse_depth, write_inverse_depth
from omnistereo_lib.files import read_image, write_image
from omnistereo_tools.rig_check import invert_poses

SMALL = ["--width", "96", "--height", "24", "--spheres", "16"]
GRID = osl.SphereGrid(96, 24, (-45, 45), 16, 0.6)
RESULTS = ["README.txt", "confidence.tiff", "inverse_depth.png", "inverse_depth.tiff", "panorama.jpg", "points.ply",
           "rig.yaml"]  # fmt: skip


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
    rig.save(folder / "config.yaml")
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
    return ["--rig", data / "config.yaml", "--images", *(data / f"cam{k}" / "0001.png" for k in (1, 2, 3, 4))]


def test_depth_of_a_data_set_frame(data, tmp_path, capsys):
    out = tmp_path / "deep" / "out"
    assert run("depth", "--rig", data, *SMALL, "--out", out) == 0
    assert sorted(path.name for path in out.iterdir()) == ["data", "index.html", "overview.png"]
    assert sorted(path.name for path in (out / "data").iterdir()) == sorted([*RESULTS, "errors.json"])
    errors = json.loads((out / "data" / "errors.json").read_text())
    assert list(errors) == [">1", ">3", ">5", "MAE", "RMS"]
    assert 0 < errors["MAE"] < 5 and errors["MAE"] < errors["RMS"]  # percent of 16 spheres
    assert 0 <= errors[">5"] <= errors[">3"] <= errors[">1"] <= 100 and errors[">5"] < 20
    inverse_depth = read_inverse_depth(out / "data" / "inverse_depth.tiff")
    assert inverse_depth.shape == GRID.shape and np.nanmax(inverse_depth) <= 1 / 0.6 + 1e-6
    assert read_image(out / "data" / "inverse_depth.png").shape == (24, 96, 3)
    assert read_image(out / "data" / "panorama.jpg").shape == (24, 96, 3)
    text = (out / "data" / "README.txt").read_text()
    assert all(name in text for name in [*RESULTS[1:], "errors.json"])
    captured = capsys.readouterr()
    assert f"the mean error is {errors['MAE']:.1f} %" in captured.out and f"written to {out}/: " in captured.out
    assert "of the 2304 rays have a depth" in captured.out and "sweep" in captured.err  # the progress bar


def test_depth_of_images(data, tmp_path, capsys):
    out = tmp_path / "out"
    (out / "data").mkdir(parents=True)
    (out / "data" / "errors.json").write_text("of another frame")
    (out / "data" / "mine.txt").write_text("kept")
    files = ["--mesh", out / "a.ply", "--equirectangular", out / "a.tiff"]
    method = ["--phi", -30, 60, "--method", "zncc+sgm,pairs=all"]
    assert run("depth", *with_images(data), *SMALL, *method, "--out", out, *files) == 0
    assert {path.name for path in out.iterdir()} == {"a.ply", "a.tiff", "data", "index.html", "overview.png"}
    assert sorted(path.name for path in (out / "data").iterdir()) == sorted([*RESULTS, "mine.txt"])
    assert "ground truth" not in capsys.readouterr().out


def test_depth_of_gray_images_without_a_nearest_depth(data, tmp_path, capsys, scene_images):
    rig, pictures = scene_images
    osl.Rig(rig.cameras, rig.T_rig_cam).save(data / "config.yaml")
    for k, picture in enumerate(pictures, 1):
        write_image(data / f"cam{k}" / "0001.png", picture)
    assert run("depth", *with_images(data), *SMALL, "--out", tmp_path / "out") == 0
    proposed = re.search(r"proposes --min-depth (\S+)\.\n", capsys.readouterr().out)
    truth = GRID.index_to_depth(scene.true_index(rig, GRID)).min()
    assert 0.4 * truth < float(proposed[1]) < truth
    assert read_image(tmp_path / "out" / "data" / "panorama.jpg").ndim == 2


def test_doctor_of_a_rig(data, capsys, scene_images):
    assert run("doctor", "--rig", data, *SMALL) == 0
    out = capsys.readouterr().out
    low, high = scene_images[0].baselines.min(), scene_images[0].baselines.max()
    assert f"4 cameras, {low:.3g} … {high:.3g} m apart" in out and "OK    the rig fits the images" in out
    invert_poses(scene_images[0]).save(data / "config.yaml")
    assert run("doctor", *with_images(data), *SMALL) == 1
    assert "FAIL  the poses look inverted (rig → camera instead of camera → rig)" in capsys.readouterr().out


def test_doctor_of_a_rig_without_images_says_what_it_can_see(data, tmp_path, capsys):
    assert run("doctor", "--rig", data / "config.yaml", "--coverage", tmp_path / "coverage.png") == 0
    assert "At 5 m, a match that is off by one pixel puts a depth off by" in capsys.readouterr().out
    assert read_image(tmp_path / "coverage.png").shape[1] == 1080


@pytest.mark.parametrize("well", [True, False])
def test_doctor_of_the_installation(monkeypatch, well):
    module = importlib.import_module("omnistereo_lib.doctor")
    monkeypatch.setattr(module, "doctor", lambda: well)
    assert run("doctor") == (0 if well else 1)


@pytest.mark.parametrize("command", [[], ["depth"], ["doctor"], ["train"]])
def test_help_is_given(command, capsys):
    with pytest.raises(SystemExit) as stop:
        run(*command, "--help")
    assert stop.value.code == 0 and "usage: omnistereo" in capsys.readouterr().out


def test_without_a_command_the_help_is_given(capsys):
    with pytest.raises(SystemExit) as stop:
        run()
    assert stop.value.code == 0 and "usage: omnistereo" in capsys.readouterr().out


@pytest.mark.parametrize("wrong, answer", [("deph", "Did you mean depth?"), ("xyz", "Expected one of depth, ")])
def test_a_command_that_does_not_exist(wrong, answer, capsys):
    with pytest.raises(SystemExit) as stop:
        run(wrong, "--out", "out")
    assert stop.value.code == 2 and capsys.readouterr().err.startswith(
        f"error: there is no command {wrong!r}. {answer}"
    )


def test_warnings_are_plain_lines(data, tmp_path, capsys):
    """A polynomial that is not the other's inverse is told, without a line of source code."""
    config = yaml.safe_load((data / "config.yaml").read_text())
    for camera in config["cameras"][:2]:
        camera["inv_poly"][1] += 1
    (data / "config.yaml").write_text(yaml.safe_dump(config))
    assert run("depth", *with_images(data), *SMALL, "--out", tmp_path / "out") == 0
    warned = [line for line in capsys.readouterr().err.splitlines() if line.startswith("warning: ")]
    assert len(warned) == 1 and "of cameras 1, 2 disagree by up to 1.00 px" in warned[0]


# --- Bad input. Each function spoils something and returns the arguments. ---


def missing_image(data):
    (data / "cam2" / "0001.png").unlink()
    return with_images(data)


def truncated_image(data):
    path = data / "cam2" / "0001.png"
    path.write_bytes(path.read_bytes()[:2000])
    return with_images(data)


def no_image(data):
    (data / "cam2" / "0001.png").write_text("hello")
    return with_images(data)


def smaller_image(data):
    write_image(data / "cam2" / "0001.png", np.zeros((96, 100, 3), np.uint8))
    return with_images(data)


def edited(change):
    """Return a function that changes the rig's file."""

    def spoil(data):
        config = yaml.safe_load((data / "config.yaml").read_text())
        change(config["cameras"][1])
        (data / "config.yaml").write_text(yaml.safe_dump(config))
        return with_images(data)

    return spoil


def kalibr_with(R):
    """Return a function that writes a Kalibr chain whose second camera has this rotation."""

    def spoil(data):
        camera = {
            "camera_model": "ds", "intrinsics": [-0.2, 0.55, 60.0, 60.0, 100.0, 96.0], "resolution": [200, 192],
            "distortion_model": "none", "distortion_coeffs": [],
        }  # fmt: skip
        T = np.eye(4)
        T[:3, :3] = R
        chain = {"cam0": camera, "cam1": {**camera, "T_cn_cnm1": T.tolist()}}
        (data / "chain.yaml").write_text(yaml.safe_dump(chain))
        return ["--rig", data / "chain.yaml", "--images", *(data / f"cam{k}" / "0001.png" for k in (1, 2))]

    return spoil


def unknown_dialect(data):
    (data / "config.yaml").write_text("cameras: 4\n")
    return with_images(data)


def no_shared_view(data):
    narrow = scene.camera(200, 192, max_fov_deg=60)
    poses = [osl.Pose.from_vector([0, turn, 0, 0.2 * turn, 0, 0]) for turn in (0, np.pi)]
    osl.Rig([narrow, narrow], poses, min_depth=0.6).save(data / "config.yaml")
    return with_images(data)[:-2]


def broken_truth(data):
    (data / "omnidepth_gt_96" / "00001.tiff").write_bytes(b"II*\0")
    return ["--rig", data]


def out_is_a_file(data):
    (data / "out").write_text("")
    return [*with_images(data), "--out", data / "out"]


def below_a_file(data):
    return [*with_images(data), "--out", data / "config.yaml" / "out"]


def option(*values):
    return lambda data: [*with_images(data), *values]


BAD = {
    "missing image": (missing_image, r"cam2.0001.png cannot be read: No such file"),
    "truncated image": (truncated_image, r"cam2.0001.png is truncated .2000 bytes"),
    "non-image": (no_image, r"cam2.0001.png is not an image .5 bytes"),
    "wrong size": (smaller_image, r"image 2 has shape \(96, 100, 3\); camera 2 expects \(192, 200\)"),
    "fewer images": (lambda data: with_images(data)[:-1], r"there are 3 images for 4 cameras"),
    "more images": (lambda data: [*with_images(data), data / "cam1" / "0001.png"], r"5 images for 4 cameras"),
    "images without a rig": (lambda data: with_images(data)[2:], r"--images needs --rig"),
    "NaN pose": (edited(lambda camera: camera["pose"].__setitem__(0, float("nan"))), r"camera 2.* finite numbers"),
    "short pose": (edited(lambda camera: camera["pose"].pop()), r"camera 2.* must be 6 numbers"),
    "no pose": (edited(lambda camera: camera.pop("pose")), r"camera 2.* 'pose' is missing"),
    "singular rotation": (kalibr_with(np.zeros((3, 3))), r"chain.yaml.* not a rotation"),
    "mirrored rotation": (kalibr_with(np.diag([1, 1, -1])), r"chain.yaml.* not a rotation"),
    "scaled rotation": (kalibr_with(2 * np.eye(3)), r"chain.yaml.* not a rotation"),
    "unknown format": (unknown_dialect, r"config.yaml: unknown format"),
    "missing rig": (lambda data: ["--rig", data / "none.yaml", *with_images(data)[2:]], r"none.yaml.* No such file"),
    "no shared view": (no_shared_view, r"no ray is visible to both cameras of any pair"),
    "phi too high": (option("--phi", -45, 91), r"phi_deg is \(-45.0, 91.0\); expected two angles"),
    "phi upside down": (option("--phi", 45, -45), r"phi_deg is .* first < last"),
    "negative depth": (option("--min-depth", -1), r"min_depth is -1.0 and max_depth inf"),
    "zero depth": (option("--min-depth", 0), r"min_depth is 0.0 and max_depth inf"),
    "infinite depth": (option("--min-depth", "inf"), r"min_depth is inf and max_depth inf"),
    "NaN depth": (option("--min-depth", "nan"), r"min_depth is nan and max_depth inf"),
    "one sphere": (option("--spheres", 1), r"num_spheres is 1; expected an integer"),
    "no width": (option("--width", 0), r"width is 0; expected an integer of 2 to 1000000"),
    "smaller than the window": (option("--method", "zncc", "--height", 4), r"window is 9; expected at most .* 96 × 4"),
    "out of memory": (option("--width", 200_000, "--height", 50_000), r"200000 × 50000 with 16 spheres needs 13.*GiB"),
    "unknown method": (option("--method", "magic"), r"one of zncc, mccnn, sweepnet, volumenet, got 'magic'"),
    "unknown frame": (lambda data: ["--rig", data, "--frame", 7], r"has frames 0 … 0, not 7"),
    "not a data set": (lambda data: ["--rig", data / "config.yaml"], r"config.yaml is not a data set folder"),
    "unit stated twice": (option("--unit", "cm"), r"in metres by definition. Omit unit='cm'"),
    "broken ground truth": (broken_truth, r"00001.tiff is not a complete TIFF file"),
    "out is a file": (out_is_a_file, r"folder .*out cannot be made or written to: File exists"),
    "out below a file": (below_a_file, r"folder .*out cannot be made or written to: Not a directory"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_one_plain_line_and_nothing_is_written(data, tmp_path, capsys, name):
    spoil, message = BAD[name]
    out = tmp_path / "out"
    arguments = spoil(data)
    before = sorted(data.rglob("*"))
    assert run("depth", *SMALL, *["--out", out], *arguments) == 2
    lines = [line for line in re.split(r"[\r\n]+", capsys.readouterr().err) if line and "block/s" not in line]
    assert lines[0].startswith("error: ") and "Traceback" not in "".join(lines)
    assert re.search(message, "\n".join(lines)), lines
    assert sorted(data.rglob("*")) == before
    assert not out.exists() or not list(out.iterdir())


@pytest.mark.parametrize(
    "arguments",
    [["--unit", "inch"], ["--device", "tpu"], ["--width", "wide"], ["--no-such-option"]],
    ids=" ".join,
)
def test_options_that_do_not_exist(data, capsys, arguments):
    with pytest.raises(SystemExit) as stop:
        run("depth", *with_images(data), *arguments)
    assert stop.value.code == 2 and "error: " in capsys.readouterr().err


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_cuda_where_there_is_none(data, tmp_path, capsys):
    assert run("depth", *with_images(data), "--device", "cuda", "--out", tmp_path / "out") == 2
    assert "PyTorch finds no CUDA GPU" in capsys.readouterr().err


def test_doctor_refuses_bad_input_too(data, capsys):
    assert run("doctor", *with_images(data)[:-1]) == 2
    assert "error: there are 3 images for 4 cameras" in capsys.readouterr().err


def test_out_of_memory_is_foreseen_with_the_figure(data, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(psutil, "virtual_memory", lambda: type("Memory", (), {"available": 2**20})())
    assert run("depth", *with_images(data), *SMALL, "--out", tmp_path / "out") == 2
    assert "0.0 GiB are available. Use fewer spheres or a smaller panorama" in capsys.readouterr().err
