"""`omnistereo world`: what it writes, that it resumes, and what it refuses."""

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest
import scene

import omnistereo_lib as osl
from omnistereo_lib.frame import write_inverse_depth
from omnistereo_lib.pictures import write_image
from omnistereo_tools import cli
from omnistereo_tools.world.build import RecordedFrames
from workshop.peers import __main__ as peers

GRID = osl.SphereGrid(160, 40, num_spheres=32, min_depth=0.6)
PLACES = [[0, 0, 0.15 * n] for n in range(3)]


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A recording of three frames in the textured box, with exact depth."""
    folder = tmp_path_factory.mktemp("recording") / "drive"
    rig = scene.rig(width=300, height=288).recentered()
    data = {"width": 160, "height": 40, "spheres": 32, "min_depth": 0.6}
    for kind in ("depth_estimate_160", "confidence_160", "trust_160"):
        (folder / kind).mkdir(parents=True)
    (folder / "recording.json").write_text(json.dumps(data))
    (folder / "times.json").write_text(json.dumps({str(n): n * 10**8 for n in (1, 2, 3)}))
    osl.save_rig(osl.Rig(rig.cameras, rig.T_rig_cam, min_depth=0.6), folder / "config.yaml")
    for number, place in enumerate(PLACES, 1):
        moved = rig.transformed(osl.Pose(np.eye(3), place))
        for k, picture in enumerate(scene.images(moved, finest=0.12), 1):
            (folder / f"cam{k}").mkdir(exist_ok=True)
            write_image(folder / f"cam{k}" / f"{number:05}.png", picture)
        depth = scene.distance(np.array(place), GRID.rays())
        write_inverse_depth(folder / "depth_estimate_160" / f"{number:05}.tiff", 1 / depth)
        for kind in ("confidence_160", "trust_160"):
            write_inverse_depth(folder / kind / f"{number:05}.tiff", np.ones(GRID.shape))
    return folder


COMMAND = ["--voxel", "0.1", "--video"]


@pytest.fixture(scope="module")
def world(recording):
    pytest.importorskip("trimesh")
    assert cli.main(["world", str(recording), *COMMAND]) == 0
    return recording / "world"


@pytest.fixture
def copy(recording, tmp_path):
    left_out = shutil.ignore_patterns("omnidepth*", "mesh*", "world.json")
    return shutil.copytree(recording, tmp_path / "drive", ignore=left_out)


def test_path_meshes_and_refined_depth_of_a_recording(recording, world, capsys):
    import trimesh

    command, out = ["world", str(recording), *COMMAND], world
    path = np.loadtxt(out / "trajectory.txt")
    np.testing.assert_array_equal(path[:, 0], [1, 2, 3])
    np.testing.assert_allclose(path[:, 1:4], PLACES, atol=0.01)
    timed = np.loadtxt(out / "trajectory_seconds.txt")
    np.testing.assert_allclose(timed, np.column_stack([[0.1, 0.2, 0.3], path[:, 1:]]), atol=1e-12)
    data = osl.load_dataset(out)
    truth = scene.distance(np.array(PLACES[1]), GRID.rays())
    assert np.median(np.abs(data.frame(2).inverse_depth * truth - 1)) < 0.02
    walls = (trimesh.load(out / "mesh.ply").vertices - scene.CENTER) / scene.HALF_SIZE
    assert np.median(np.abs(np.abs(walls).max(axis=1) - 1)) < 0.02
    up = trimesh.load(out / "mesh.glb", force="mesh").vertices
    assert up[:, 1].max() == pytest.approx(
        -(trimesh.load(out / "mesh.ply").vertices[:, 1].min()), abs=1e-4
    )
    # The same command keeps what is there; another one keeps the steps.
    before = {file: file.stat().st_mtime_ns for file in out.iterdir()}
    assert cli.main(command) == 0 and "already" in capsys.readouterr().out
    assert {file: file.stat().st_mtime_ns for file in out.iterdir()} == before
    assert cli.main(["world", str(recording), "--voxel", "0.2"]) == 0
    assert (out / "steps.json").stat().st_mtime_ns == before[out / "steps.json"]


def test_how_good_the_world_is_is_said_and_a_flight_is_drawn(recording, world, capsys):
    frames = RecordedFrames.open(recording)
    page = (world / "index.html").read_text()
    holes = r"(?:(\d+) % of what|All that) is seen within 30 m has (?:no|a) surface"
    said = re.search(f"{holes}.*drift is unknown", page)
    assert int(said[1] or 0) <= 10
    video = cv2.VideoCapture(str(world / "flight.mp4"))
    read = []
    while (found := video.read())[0]:
        read.append(found[1])
    assert len(read) in (2, 3) and read[0].shape == (1080, 1920, 3)  # 0.3 m at 3 m/s
    panorama = frames.panorama(frames.data[0], frames.data[0].inverse_depth)[..., 0]
    expected = 255 * (panorama[18:22, 78:82] / 255) ** 0.8
    height = len(read[0]) - 44 - 240
    ahead = read[0][round(0.45 * height) - 60 : round(0.45 * height) + 60, 900:1020]
    assert ahead.mean() == pytest.approx(expected.mean(), abs=25)


def test_a_path_that_comes_back_says_by_how_much_it_is_off(recording):
    """The third frame is really 0.3 m from the first."""
    frames, forward = RecordedFrames.open(recording), np.array([0, 0, 1.0])
    for z, expected in ((0.35, 0.05), (0.3, 0.0)):
        places = {1: 0 * forward, 2: 3 * forward, 3: z * forward}
        off = frames.drift({n: osl.Pose(np.eye(3), place) for n, place in places.items()})
        assert off == pytest.approx(expected, abs=0.01)
    places = {n: n * forward for n in (1, 2, 3)}
    assert frames.drift({n: osl.Pose(np.eye(3), place) for n, place in places.items()}) is None


READ = """
import json, sys
from rerun.chunk import RrdReader
found = {}
for chunk in RrdReader(sys.argv[1]).stream():
    batch = chunk.to_record_batch()
    for name, column in zip(batch.schema.names, batch.columns):
        if name.split(":")[-1] in ("frame", "time", "translation", "positions", "media_type"):
            values = (column.cast("int64") if name == "time" else column).to_pylist()
            found.setdefault(f"{chunk.entity_path} {name}", []).extend(values)
print(json.dumps(found))
"""


@pytest.mark.nightly
def test_rerun_reads_a_world(recording, tmp_path):
    """Points lie on the walls of the box where Rerun puts the rig, at the times of the frames."""
    python, site = peers.install("rerun")
    env, drive = os.environ | {"PYTHONPATH": str(site)}, shutil.copytree(recording, tmp_path / "a")
    make = [sys.executable, "-m", "omnistereo_tools", "world", drive, *COMMAND, "--rrd"]
    subprocess.run(make, env=env, check=True)
    read = [python, "-c", READ, drive / "world/world.rrd"]
    done = subprocess.run(read, env=env, check=True, capture_output=True, text=True)
    found = json.loads(done.stdout)
    order = np.argsort(found["/world/rig frame"])
    assert np.take(found["/world/rig frame"], order).tolist() == [1, 2, 3]
    assert np.take(found["/world/rig time"], order).tolist() == [10**8, 2 * 10**8, 3 * 10**8]
    places = np.squeeze(found["/world/rig Transform3D:translation"])[order]
    np.testing.assert_allclose(places, PLACES, atol=0.01)
    first = int(np.argmin(found["/world/rig/points frame"]))
    walls = np.array(found["/world/rig/points Points3D:positions"][first]) - scene.CENTER
    assert np.median(np.abs(np.abs(walls / scene.HALF_SIZE).max(axis=1) - 1)) < 0.02
    for k in range(1, 5):
        assert found[f"/world/rig/cam{k}/image EncodedImage:media_type"] == [["image/jpeg"]] * 3


@pytest.mark.parametrize("size", [(900, 600), (390, 600)], ids=str)
def test_the_page_flies_through_the_mesh(recording, world, open_page, size):
    page = open_page(*size, reduced_motion="no-preference")
    page.goto((world / "index.html").as_uri())
    page.wait_for_selector("body[data-drawn]")
    # Around two directions, what the first frame shows there, as bright as the page draws it.
    frames = RecordedFrames.open(recording)
    panorama = frames.panorama(frames.data[0], frames.data[0].inverse_depth)[..., 0]
    for yaw in (0, 1.5):
        column = 80 + round(160 * yaw / (2 * np.pi))
        expected = 255 * (panorama[16:24, column - 4 : column + 4] / 255) ** 0.8
        assert middle(page, yaw, degrees=9).mean() == pytest.approx(expected.mean(), abs=6)
    # Measured along two rays to the walls, and between their ends.
    ends = []
    for yaw in (0, 1.5):
        look = "(yaw) => { view.yaw = yaw; return placeAt(canvas.width / 2, canvas.height / 2) }"
        ends.append(page.evaluate(look, yaw))
        way = np.array([np.sin(yaw), 0, np.cos(yaw)])
        np.testing.assert_allclose(ends[-1], scene.distance(np.zeros(3), way) * way, atol=0.06)
        page.evaluate("pick(canvas.width / 2, canvas.height / 2)")
    metres = np.linalg.norm(np.subtract(*ends))
    assert page.inner_text("#told") == f"{metres:.2f} m between the two marks."
    at_ends = []
    for key in ("Home", "End"):
        page.press("#along", key)
        page.wait_for_selector(f"body[data-drawn='{0 if key == 'Home' else 2}']")
        number = 1 if key == "Home" else 3
        assert f"frame {number} by itself" in page.inner_text("#pictures")
        assert page.evaluate(
            "n => ['before', 'after'].every(name => $(name).src === D.views[n - 1][name])", number
        )
        said, plan = page.inner_text("#place"), page.locator("#plan").screenshot()
        at_ends.append((said, middle(page, 0, 9).mean(), plan))
    (first, near, plan), (last, nearer, other_plan) = at_ends
    assert first == "frame 1, 0.0 of 0.3 m" and last == "frame 3, 0.3 of 0.3 m"
    assert near != nearer and plan != other_plan
    page.click("#fly")  # from the end it begins again
    page.wait_for_function("!flight && view.at === along.at(-1)")
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert page.complaints == []


def middle(page, yaw, degrees):
    """What the page draws in a square around a direction from the rig; (N, N, 3)."""
    read = page.evaluate(
        """([yaw, degrees]) => {
            Object.assign(view, { yaw, pitch: 0, behind: 0 })
            draw()
            const gl = canvas.getContext("webgl2"), [w, h] = [canvas.width, canvas.height]
            const half = Math.round(seen().focal * Math.tan(degrees * Math.PI / 180))
            const side = 2 * half, read = new Uint8Array(4 * side * side)
            const [x, y] = [w, h].map(size => Math.round(size / 2) - half)
            gl.readPixels(x, y, side, side, gl.RGBA, gl.UNSIGNED_BYTE, read)
            return [...read]
        }""",
        [yaw, degrees],
    )
    side = round((len(read) / 4) ** 0.5)
    return np.array(read).reshape(side, side, 4)[..., :3]


def fails(capsys, *arguments):
    assert cli.main(["world", *map(str, arguments)]) == 2
    return capsys.readouterr().err


def test_what_is_missing_is_named(copy, capsys, tmp_path):
    assert "recording.json" in fails(capsys, tmp_path)
    (copy / "confidence_160" / "00002.tiff").unlink()
    (copy / "depth_estimate_160" / "00003.tiff").unlink()
    assert "1 frames with depth" in fails(capsys, copy)


def lines(capsys, *arguments):
    assert cli.main(["world", *map(str, arguments)]) == 0
    return "".join(capsys.readouterr())


@pytest.mark.parametrize(
    "kind, damage, why",
    [
        ("depth_estimate", np.nan, "has depth and confidence"),
        ("depth_estimate", np.inf, "has depth and confidence"),
        ("depth_estimate", -1.0, "has depth and confidence"),
        ("depth_estimate", 1e30, "holds 1e.30; expected at most 1.668"),
        ("depth_estimate", "lower", "is 160 × 20; expected 160 × 40"),
        ("depth_estimate", "torn", "is not a complete"),
        ("confidence", 0.0, "has depth and confidence"),
        ("confidence", 1e30, "holds 1e.30; expected at most 1.001"),
        ("trust", "torn", "is not a complete"),
        ("trust", "missing", "cannot be read"),
    ],
)
def test_a_frame_that_is_damaged_or_empty_is_named_and_left_out(copy, capsys, kind, damage, why):
    path = copy / f"{kind}_160" / "00003.tiff"
    if damage == "torn":
        path.write_bytes(path.read_bytes()[:-60] + bytes(40) + path.read_bytes()[-20:])
    elif damage == "missing":
        path.unlink()
    else:
        shape = (20, 160) if damage == "lower" else GRID.shape
        write_inverse_depth(path, np.full(shape, 0.1 if damage == "lower" else damage))
    frames, said = RecordedFrames.open(copy), capsys.readouterr().err
    # "depth_estimate" is named where confidence is missing, as either may be what is wrong.
    assert re.search(f"frame 3 is left out: .*_160/00003.tiff {why}", said)
    assert len(frames.data) == 2 and frames.doubtful_percent([1, 2]) == 0


def test_a_frame_that_repeats_another_is_named_and_left_out(copy, capsys):
    for k in (1, 2, 3, 4):
        shutil.copy(copy / f"cam{k}" / "00001.png", copy / f"cam{k}" / "00003.png")
    assert len(RecordedFrames.open(copy).data) == 2
    assert "frame 3 is left out: its pictures are those of frame 1" in capsys.readouterr().err


@pytest.mark.parametrize(
    "width, said", [(0, "width is 0"), ("x", "width must be"), (10**9, "width is 1000000000")]
)
def test_damaged_settings_of_a_recording_are_named(copy, width, said):
    settings = json.loads((copy / "recording.json").read_text()) | {"width": width}
    (copy / "recording.json").write_text(json.dumps(settings))
    with pytest.raises(osl.OmnistereoError, match=f"recording.json: {said}"):
        RecordedFrames.open(copy)


def test_a_world_in_which_nothing_is_near_is_refused(copy, capsys):
    assert "no ray of" in fails(capsys, copy, "--range", "0.5")
    assert "no surface is left" in fails(capsys, copy, "--voxel", "5")


@pytest.mark.slow
@pytest.mark.parametrize("damage", ["mesh.glb", "mesh.ply", "omnidepth_world_160/00002.tiff"])
def test_a_world_of_which_a_part_is_lost_is_made_again(recording, world, tmp_path, capsys, damage):
    copy = shutil.copytree(recording, tmp_path / "drive", symlinks=True)
    lines(capsys, copy, *COMMAND)
    path = copy / "world" / damage
    content = path.read_bytes()
    path.write_bytes(content[:-9]) if damage == "mesh.ply" else path.unlink()
    how = "not whole" if damage == "mesh.ply" else "missing"
    assert f"{path} is {how}" in lines(capsys, copy, *COMMAND)
    assert path.read_bytes() == content and "already" in lines(capsys, copy, *COMMAND)


@pytest.mark.slow
def test_a_world_of_other_depth_or_of_another_rig_is_made_again(recording, world, tmp_path, capsys):
    copy = shutil.copytree(recording, tmp_path / "drive", symlinks=True)
    lines(capsys, copy, *COMMAND)
    depth = copy / "depth_estimate_160" / "00002.tiff"
    shutil.copyfile(copy / "depth_estimate_160" / "00001.tiff", depth)
    assert "is made again: other inputs" in lines(capsys, copy, *COMMAND)
    rig = osl.load_rig(copy / "config.yaml")
    mask = np.ones(rig.cameras[0].image_size[::-1], bool)
    mask[:40] = False
    masked = [replace(rig.cameras[0], mask=mask), *rig.cameras[1:]]
    osl.save_rig(replace(rig, cameras=tuple(masked)), copy / "config.yaml")
    assert "other rig" in lines(capsys, copy, *COMMAND)
    assert np.array_equal(osl.load_dataset(copy / "world").rig.cameras[0].mask, mask)


@pytest.mark.slow
def test_a_black_camera_is_named(copy, capsys):
    write_image(copy / "cam2" / "00002.png", np.zeros((288, 300)))
    assert "frame 2: camera 2 shows black" in lines(capsys, copy, *COMMAND)


def test_more_memory_than_there_is_is_refused(copy, capsys, monkeypatch):
    monkeypatch.setattr(
        "omnistereo_tools.world.fusion.bytes_needed", lambda keys, channels: 1 << 60
    )
    assert "not enough memory: needs" in fails(capsys, copy)
    assert not (copy / "world" / "mesh.ply").exists()


@pytest.mark.slow
def test_frames_that_have_nothing_in_common_give_no_world(copy, capsys):
    shutil.rmtree(copy / "world", ignore_errors=True)
    rng = np.random.default_rng(0)
    for path in copy.glob("cam*/*"):
        write_image(path, rng.integers(0, 255, (288, 300)))
    assert "no step between two frames is sure" in fails(capsys, copy)
