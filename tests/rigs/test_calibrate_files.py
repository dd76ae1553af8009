"""Calibration from files to files: captures in folders, shipped sets, the command line."""

import json
import re
from dataclasses import replace
from pathlib import Path

import boards
import cv2
import numpy as np
import pytest
import scene
from boards import BOARD, SIZE
from scene import refused

import omnistereo_lib as osl
from omnistereo_lib.geometry.pose import Pose
from omnistereo_rigs import calibrate_rig
from omnistereo_rigs.boards.captures import find_captures, load_corners, save_corners
from omnistereo_rigs.boards.detect import find_corners
from omnistereo_rigs.formats.write import export_rig
from omnistereo_tools import cli
from workshop.render.boards.positions import CAPTURES, true_corners
from workshop.render.camera.render_rig import make_rig
from workshop.render.image_sets import SEED

SHIPPED = Path(osl.__file__).resolve().parents[1] / "data_samples" / "calibration"


# --- Captures


def picture(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.full((20, 30), 100, np.uint8))


def test_captures_are_matched_by_name_in_the_order_of_numbers(tmp_path):
    for name in ("cam10/2.png", "cam2/10.jpg", "cam2/2.png", "cam1/1.png", "cam1/notes.txt"):
        picture(tmp_path / name) if not name.endswith("txt") else (tmp_path / name).write_text(
            "no picture"
        )
    captures = find_captures(tmp_path)
    assert captures.cameras == ("cam1", "cam2", "cam10") and captures.names == ("1", "2", "10")
    found = [[path is not None for path in row] for row in captures.paths]
    assert found == [[1, 0, 0], [0, 1, 1], [0, 1, 0]]
    assert captures.views()[2][1].shape == (20, 30) and captures.views()[2][0] is None


def test_only_pictures_are_views(tmp_path):
    picture(tmp_path / "cam1" / "1.png")
    names = "cam1/2.tiff cam1/3.yaml cam1/corners_cam1.yaml cam1/4.npz cam1/.5.png .cache/6.png"
    for name in names.split():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "gt").mkdir()
    (tmp_path / "gt" / "1.tiff").write_bytes(b"")
    captures = find_captures(tmp_path)
    assert captures.cameras == ("cam1",) and captures.names == ("1",)


def test_two_pictures_of_one_name(tmp_path):
    picture(tmp_path / "cam1" / "1.png")
    picture(tmp_path / "cam1" / "1.jpg")
    with refused(r"1\.jpg and 1\.png.*Keep one"):
        find_captures(tmp_path)


def test_one_camera_needs_no_folder_of_its_own(tmp_path):
    picture(tmp_path / "b.png")
    picture(tmp_path / "a.png")
    captures = find_captures(tmp_path)
    assert captures.names == ("a", "b") and len(captures.cameras) == 1


def test_folders_without_pictures_or_common_names(tmp_path):
    with refused("has no images"):
        find_captures(tmp_path)
    with refused("is not a folder"):
        find_captures(tmp_path / "none")
    picture(tmp_path / "cam1" / "left_1.png")
    picture(tmp_path / "cam2" / "right_2.png")
    with pytest.warns(
        UserWarning,
        match=r"no two cameras have an image of the same name or time \(cam1/left_1, cam2/right_2",
    ):
        find_captures(tmp_path)


# --- The shipped sets


def truth_of(name):
    """Capture → (mistake, {camera from 0: (T_rig_board, true corners (K, 2))})."""
    rig, truth = osl.load_rig(SHIPPED / name), {}
    for capture in json.loads((SHIPPED / name / "truth.json").read_text())["captures"]:
        seen = {}
        for view in capture["views"]:
            i, T_rig_board = view["camera"] - 1, Pose.from_vector(view["T_rig_board"])
            points = rig.T_rig_cam[i].inverse() @ T_rig_board @ BOARD.points
            seen[i] = T_rig_board, rig.cameras[i].project(points)[0]
        truth[capture["name"]] = capture["mistake"], seen
    return truth


@pytest.mark.parametrize("name", ["handheld", "van"])  # of "mistakes" all are searched below
def test_shipped_captures_show_what_their_truth_says(name):
    """Every twelfth picture: the corners found are the recorded ones, without a bias."""
    captures, truth = find_captures(SHIPPED / name), truth_of(name)
    errors = []
    for i, row in enumerate(captures.paths):
        for k, path in list(enumerate(row))[i::12]:
            if path is not None and truth[captures.names[k]][0] is None:
                found = find_corners(osl.load_images([path])[0], BOARD)
                true = truth[captures.names[k]][1][i][1]
                if found is not None:
                    ends = [found - true[order] for order in BOARD.symmetries]
                    errors.append(min(ends, key=lambda e: np.nanmean(e**2)))
    errors = np.concatenate(errors)
    assert len(errors) >= 5 * 120
    assert np.sqrt(np.nanmean(errors**2)) < 0.09
    assert np.abs(np.nanmean(errors, axis=0)).max() < 0.02


@pytest.mark.parametrize("name", ["handheld", "mistakes", "van"])
def test_the_recorded_rig_sees_what_its_lenses_draw(name):
    """The polynomials of the config against the lens itself, at the boards of every fifth view."""
    drawn = make_rig(SEED, CAPTURES[f"calibration/{name}"].rig)
    views = [view for _, seen in truth_of(name).values() for view in seen.items()]
    for i, (T_rig_board, uv) in views[::5]:
        assert np.nanmax(np.abs(uv - true_corners(drawn.cameras[i], T_rig_board, SIZE[0]))) < 0.02


def assert_is_the_true_rig(rig, report, name):
    """Every pose within four of its predicted standard deviations."""
    true = osl.load_rig(SHIPPED / name)
    for i, (sigma_deg, sigma_m) in enumerate(report.pose_uncertainty()[1:], start=1):
        error = (true.T_rig_cam[0].inverse() @ true.T_rig_cam[i]).inverse() @ rig.T_rig_cam[i]
        angle, shift = error.magnitude()
        assert angle < 4 * sigma_deg and shift < 4 * sigma_m


@pytest.mark.slow
def test_the_report_on_pictures_names_exactly_the_bad_ones():
    captures, truth = find_captures(SHIPPED / "mistakes"), truth_of("mistakes")
    rig, report = calibrate_rig(captures.views(), BOARD, degree=6)
    named = {mistake: set() for mistake in ("blurred", "cut", "moved")}
    named["moved"] = {(captures.names[k], None) for k in report.rejected}
    for i, camera in enumerate(report.joint):
        for k, why in camera.rejected.items():
            named["cut" if why == "no board found" else "blurred"].add((captures.names[k], i))
            assert why == "no board found" or why.startswith("blurred: edges ")
    expected = {mistake: set() for mistake in named}
    for name, (mistake, seen) in truth.items():
        if mistake is not None:
            expected[mistake] |= {(name, None)} if mistake == "moved" else {(name, i) for i in seen}
    assert named == expected
    assert_is_the_true_rig(rig, report, "mistakes")


# --- Other programs


def test_a_lens_that_their_model_cannot_follow_is_named(tmp_path):
    rig = scene.rig()
    sheared = replace(rig.cameras[1], affine=(1.0, 0.01, 0.01))
    rig = osl.Rig([rig.cameras[0], sheared, *rig.cameras[2:]], rig.T_rig_cam)
    with pytest.warns(UserWarning, match=r"does not follow camera 2 \d\.\d px at worst") as said:
        residuals = export_rig(rig, tmp_path)
    assert len(said) == 1 and residuals[1] > 1 > max(residuals[0], *residuals[2:])


# --- The command line


def test_a_rig_from_corners_on_file(tmp_path, capsys, monkeypatch):
    """And again from what the first run has left, as after its corners were edited."""
    detected, out = tmp_path / "detected", tmp_path / "out"
    detected.mkdir()
    for i, row in enumerate(
        boards.captures(np.random.default_rng(2), alone=3, shared=4, noise=0.05)[:2], start=1
    ):
        save_corners(
            detected / f"corners_cam{i}.yaml",
            {f"{k:04d}": view for k, view in enumerate(row)},
            BOARD,
            SIZE,
        )
    board = ["--board", "12x10", "--square", "0.06"]
    assert cli.main(["calibrate", str(detected), *board, "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert re.match(r"(Good|Fair: .+;)[: ]+the poses are known to 0\.\d+° and [\d.]+ mm\.\n", said)
    assert said.endswith(f"add --images.\nomnistereo doctor --rig {out / 'config.yaml'}\n")
    assert (out / "report.txt").read_text().startswith("rig: 2 cameras")
    assert len(osl.load_rig(out / "config.yaml", max_fov_deg=200)) == 2
    for i in (1, 2):
        assert (out / f"report_cam{i}.png").is_file()
        (found, *about), (given, *same) = (
            load_corners(at / f"corners_cam{i}.yaml") for at in (out, detected)
        )
        assert about == same and found.keys() == given.keys()
        # for the next run; some boards had been read from their other end
        for name, corners in given.items():
            assert corners is found[name] is None or any(
                np.array_equal(found[name], ends, equal_nan=True)
                for ends in (corners, corners[::-1])
            )
    before = {path: path.read_bytes() for path in out.glob("corners_*")}
    # which takes the longest
    monkeypatch.setattr("omnistereo_tools.outputs.save_figure", lambda *_, **__: None)
    assert cli.main(["calibrate", str(out), *board, "--out", str(out)]) == 0
    assert {path: path.read_bytes() for path in before} == before
