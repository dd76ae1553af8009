"""Recordings: matched frames, a data set that `load_dataset` reads back, resumed after any end."""

import json
import re
import shutil
import struct
from dataclasses import replace
from fractions import Fraction
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import scene
from command_server import make_small
from scene import refused, write_video

import omnistereo_lib as osl
from omnistereo_learn.evaluate.run import DATA
from omnistereo_lib.frame import read_inverse_depth
from omnistereo_lib.pictures import read_image, write_image
from omnistereo_lib.stereo import device
from omnistereo_lib.stereo.methods import FRAME_METHOD, VIDEO_METHOD
from omnistereo_tools import cli
from omnistereo_tools.input.sources import Recording, open_sources
from omnistereo_tools.judge import pace
from omnistereo_tools.judge.trust import trust
from omnistereo_tools.live_view import Cameras
from omnistereo_tools.output.colors import ColorScale
from omnistereo_tools.output.pictures import FILM, panes
from omnistereo_tools.record import recordings, watching

GRID = osl.SphereGrid(96, 24, num_spheres=16, min_depth=0.6)
SMALL = ["--grid", "96x24x16", "--method", "zncc"]
FRAMES = 6


@pytest.fixture(scope="module", autouse=True)
def small_films():
    with pytest.MonkeyPatch.context() as patch:
        make_small(patch.setattr)
        yield


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A rig that moves through the box: folders of numbered pictures beside its rig file."""
    return scene.write_drive(tmp_path_factory.mktemp("recorded"), FRAMES)


def views(folder):
    return [folder / f"view{k}" for k in (1, 2, 3, 4)]


def run(*arguments):
    return cli.main([str(argument) for argument in arguments])


def record_command(folder, out):
    rig = ["--rig", folder / "rig.yaml"]
    return ["record", *rig, "--images", *views(folder), *SMALL, "--out", out]


@pytest.fixture(scope="module")
def done(recorded, tmp_path_factory):
    """The depth of the whole recording, computed in one go, with a video."""
    out = tmp_path_factory.mktemp("done") / "out"
    assert run(*record_command(recorded, out), "--video", out / "depth.mp4") == 0
    return out


def test_the_result_is_a_data_set(recorded, done):
    data = osl.load_dataset(done)
    assert len(data) == FRAMES and [frame.number for frame in data] == list(range(1, FRAMES + 1))
    for frame in data[::3]:
        np.testing.assert_array_equal(
            frame.images[1], read_image(recorded / "view2" / f"cam2_{frame.number:03}.png")
        )
        alone = osl.estimate_depth(
            osl.Frame.of(osl.load_rig(recorded / "rig.yaml"), frame.images), GRID, "zncc"
        )
        np.testing.assert_array_equal(frame.inverse_depth, alone.inverse_depth.astype(np.float32))


def test_every_frame_has_the_confidence_and_trust_of_a_single_frame(recorded, done):
    frame = osl.Frame.of(osl.load_rig(recorded / "rig.yaml"), osl.load_dataset(done)[2].images)
    alone = osl.estimate_depth(frame, GRID, "zncc")
    kinds = {"depth_estimate": alone.inverse_depth, "confidence": alone.confidence}
    kinds["trust"] = trust(alone)
    for kind, expected in kinds.items():
        stored = read_inverse_depth(done / f"{kind}_96" / "00003.tiff")
        np.testing.assert_allclose(stored, expected, rtol=1e-6, atol=1e-7)


def test_the_summary_says_how_many_rays_are_doubtful_also_of_the_nearest(recorded, done, capsys):
    assert run(*record_command(recorded, done)) == 0  # all is there: it only sums up
    said = re.search(
        r"^\w+: (\d+) % of rays are sure over \d+ frames(?:; .*)?\.\nOf the nearest tenth"
        r" of rays of each frame, (\d+) % are doubtful",
        capsys.readouterr().out,
    )
    shares = []
    for name in [f"{n:05}.tiff" for n in range(1, FRAMES + 1)]:
        inverse, trusted = (
            read_inverse_depth(done / f"{kind}_96" / name) for kind in ("depth_estimate", "trust")
        )
        nearest = np.argsort(-inverse.ravel())[: round(inverse.size / 10)]
        shares.append([(trusted < 0.5).mean(), (trusted.ravel()[nearest] < 0.5).mean()])
    np.testing.assert_allclose([100 - int(said[1]), int(said[2])], 100 * np.mean(shares, 0), atol=1)


def test_doubtful_rays_are_faded_in_the_video(done):
    picture = read_image(done / "video" / "00003.jpg")
    top, rows = panes(GRID)
    shown = np.split(picture[top : top + rows], 2, 1)[1]
    picture = cv2.resize(shown, (96, 24), interpolation=cv2.INTER_AREA).astype(int)
    inverse, trusted = (
        read_inverse_depth(done / f"{kind}_96" / "00003.tiff")
        for kind in ("depth_estimate", "trust")
    )
    colors = ColorScale(0.0, 0.8 / GRID.min_depth).colorize(inverse)
    off = np.abs(picture - colors).mean(-1)
    assert (trusted < 0.5).sum() > 20 and off[trusted < 0.5].mean() > 3 * off[trusted >= 0.5].mean()


def test_the_video_has_every_frame_with_panorama_and_depth(done):
    video = cv2.VideoCapture(str(done / "depth.mp4"))
    frames = []
    while (read := video.read())[0]:
        frames.append(read[1])
    top, rows = panes(GRID)
    assert len(frames) == FRAMES and frames[0].shape[1::-1] == FILM and rows == 240
    first = frames[0].astype(int)
    assert np.abs(first[:top] - frames[-1][:top]).mean() > 1  # the eye turns
    parts = np.split(first[top : top + rows], 2, axis=1)
    gray, colored = (np.ptp(part, axis=-1).mean() for part in parts)
    assert parts[0].std() > 20 and gray < 10 < colored  # the scene is gray


def test_a_minute_of_video_takes_at_most_20_mb(tmp_path):
    """Of noise, which no codec can make small."""
    rng, rate = np.random.default_rng(0), Fraction(5)
    noise = rng.integers(0, 256, (4, 270, 480, 3), np.uint8)
    pictures = (cv2.resize(noise[k % 4], FILM) for k in range(30))
    seconds = recordings.write_film(tmp_path / "noise.mp4", pictures, rate)
    assert (tmp_path / "noise.mp4").stat().st_size / seconds * 60 < 20e6


def test_a_video_with_two_circles_is_two_cameras(tmp_path):
    back = osl.Pose.from_vector([0, np.pi, 0, 0, 0, -0.1])
    rig = osl.Rig((scene.camera(200, 192, 220),) * 2, (osl.Pose.identity(), back), min_depth=0.5)
    osl.save_rig(rig, tmp_path / "rig.yaml")
    picture = np.hstack(
        [np.stack([image.astype(np.uint8)] * 3, -1) for image in scene.images(rig, finest=0.25)]
    )
    write_video(tmp_path / "dual.mkv", [picture] * 2)
    command = ["record", "--rig", tmp_path / "rig.yaml", "--images", tmp_path / "dual.mkv", *SMALL]
    assert run(*command, "--out", tmp_path / "out") == 0
    data = osl.load_dataset(tmp_path / "out")
    assert len(data) == 2
    for image, half in zip(data[0].images, np.split(picture, 2, axis=1), strict=True):
        assert np.abs(image - half.astype(float)).mean() < 3  # JPEG


def test_a_recording_beside_its_pictures_twice_in_a_row(recorded, tmp_path, monkeypatch):
    """As it is typed: with relative paths, and without --out."""
    monkeypatch.chdir(shutil.copytree(recorded, tmp_path / "here"))
    for _ in range(2):
        typed = ["record", "--rig", "rig.yaml", "--images", *(f"view{k}" for k in "1234")]
        assert run(*typed, *SMALL, "--frames", ":2") == 0
        assert len(osl.load_dataset("out/record_rig")) == 1


def test_resumed_it_is_the_same_and_no_frame_is_computed_again(recorded, done, tmp_path, capsys):
    """`tests/test_kills.py` kills it at any moment; here no frame is computed again."""
    out = tmp_path / "out"
    folder = out / "depth_estimate_96"
    video = ["--video", out / "depth.mp4"]
    assert run(*record_command(recorded, out), *video, "--frames", ":4") == 0
    assert "depth.mp4: 3 frames, 0.3 s\n" in capsys.readouterr().out
    halfway = {path.name: path.stat().st_mtime_ns for path in folder.glob("0*.tiff")}
    for torn in (folder / "00001.tiff", out / "video" / "00002.jpg"):  # as after a power cut
        torn.write_bytes(torn.read_bytes()[:-9])
    assert run(*record_command(recorded, out), *video) == 0
    again = {name for name, mtime in halfway.items() if (folder / name).stat().st_mtime_ns != mtime}
    assert again == {"00001.tiff", "00002.tiff"} and len(halfway) == 3
    whole, resumed = (
        {path.relative_to(root): path.read_bytes() for path in root.rglob("depth_*/*")}
        for root in (done, out)
    )
    assert resumed == whole


def test_a_hole_in_a_result_is_computed_again(recorded, done, tmp_path):
    out = shutil.copytree(done, tmp_path / "out", symlinks=True)
    for kind in ("depth_estimate", "confidence", "trust"):
        path = out / f"{kind}_96" / "00002.tiff"
        content = path.read_bytes()
        path.write_bytes(content[:-300] + bytes(200) + content[-100:])
    assert run(*record_command(recorded, out)) == 0
    for kind in ("depth_estimate", "confidence", "trust"):
        name = f"{kind}_96/00002.tiff"
        assert (out / name).read_bytes() == (done / name).read_bytes()


def test_the_rig_of_a_frame_stays_with_it(recorded, tmp_path):
    """The second camera turned by 1° at frame 5: an earlier frame keeps the old pose."""
    out, rng = tmp_path / "out", np.random.default_rng(0)
    assert run(*record_command(recorded, out), "--follow") == 0
    before = read_inverse_depth(out / "depth_estimate_96" / "00002.tiff")
    looks = []
    for frame in (1, 1, 2, 2, 5, 5, 6, 6):
        change = rng.normal(0, 1e-5, (4, 6))
        change[:, 1] -= np.radians(0.25) * (frame > 4)
        change[1, 1] += np.radians(1) * (frame > 4)
        looks.append([frame, change.tolist(), (np.eye(24) * 1e-10).tolist()])
    (out / "watch.json").write_text(json.dumps(looks))
    for number in (2, 6):
        (out / "depth_estimate_96" / f"{number:05}.tiff").unlink()
    assert run(*record_command(recorded, out), "--follow") == 0
    np.testing.assert_array_equal(
        read_inverse_depth(out / "depth_estimate_96" / "00002.tiff"), before
    )
    data = osl.load_dataset(out)
    turns = [
        (data.rig.T_rig_cam[1].inverse() @ frame.rig.T_rig_cam[1]).magnitude()[0] for frame in data
    ]
    np.testing.assert_allclose(turns, [0, 0, 0, 0, 0, 1], atol=0.05)
    again = osl.estimate_depth(data[5], GRID, "zncc")
    np.testing.assert_array_equal(again.inverse_depth.astype(np.float32), data[5].inverse_depth)
    # Given again without a turn, the frame is that of the rig.
    (out / "watch.json").unlink()
    (out / "depth_estimate_96" / "00006.tiff").unlink()
    assert run(*record_command(recorded, out)) == 0 and not (out / "poses" / "00006.json").exists()


@pytest.mark.parametrize(
    "frame, change, spread",
    [(np.inf, 0, 1), ("x", 0, 1), (2, np.nan, 1), (2, 0, 0), (2, 0, np.inf), (2, 0, [1])],
)
def test_looks_that_cannot_be_are_left_out(tmp_path, frame, change, spread):
    looks = [[1, np.zeros((4, 6)).tolist(), np.eye(24).tolist()]]
    matrix = (np.where(np.eye(24) > 0, spread, 0) if np.ndim(spread) == 0 else np.ones(3)).tolist()
    looks.append([frame, np.full((4, 6), change).tolist(), matrix])
    (tmp_path / "watch.json").write_text(json.dumps(looks))
    assert [look.frame for look in watching._stored(tmp_path / "watch.json", 4)] == [1]


def test_the_precision_of_a_recording_is_kept(recorded, tmp_path, monkeypatch):
    """Whatever the processor that goes on with it would choose."""
    command = record_command(recorded, tmp_path / "out")
    command[command.index("--method") + 1] = "mccnn"
    monkeypatch.setattr("torch.cpu.get_capabilities", dict)
    assert run(*command, "--frames", ":2") == 0
    monkeypatch.setattr("torch.cpu.get_capabilities", lambda: {"avx512_bf16": True})
    first = tmp_path / "out" / "depth_estimate_96" / "00001.tiff"
    content = first.read_bytes()
    first.unlink()
    assert run(*command, "--frames", ":2") == 0 and first.read_bytes() == content


def test_a_picture_that_has_changed_is_computed_again(recorded, done, tmp_path, capsys):
    pictures, out = shutil.copytree(recorded, tmp_path / "pictures"), tmp_path / "out"
    assert run(*record_command(pictures, out)) == 0
    changed = pictures / "view2" / "cam2_003.png"
    write_image(changed, np.zeros((96, 100)))
    before = {path.name: path.stat().st_mtime_ns for path in out.glob("depth_estimate_96/*")}
    assert run(*record_command(pictures, out)) == 0
    said = capsys.readouterr().err
    assert f"frame 3 is computed again: {changed} has changed" in said
    assert "frame 3: camera 2 shows black" in said
    after = {path.name: path.stat().st_mtime_ns for path in out.glob("depth_estimate_96/*")}
    assert [name for name in after if after[name] != before[name]] == ["00003.tiff"]
    old, new = (
        read_inverse_depth(folder / "depth_estimate_96" / "00003.tiff") for folder in (done, out)
    )
    assert not np.array_equal(old, new, equal_nan=True)
    assert run(*record_command(pictures, out)) == 0
    assert "computed again" not in capsys.readouterr().out


def test_bad_frames_are_named_and_left_out_if_asked(recorded, done, tmp_path, capsys):
    folder = shutil.copytree(recorded, tmp_path / "copy")
    torn, other = folder / "view3" / "cam3_002.png", folder / "view1" / "cam1_005.png"
    torn.write_bytes(torn.read_bytes()[:-2000])
    write_image(other, np.zeros((9, 9), np.uint8))
    command = record_command(tmp_path / "copy", tmp_path / "out")
    assert run(*command) == 2
    capsys.readouterr()
    assert run(*command, "--skip-bad") == 0
    said = capsys.readouterr().err
    assert f"frame 2 is left out: {torn}" in said
    assert f"frame 5 is left out: {other} is 9 × 9 px" in said
    frames = osl.load_dataset(tmp_path / "out")
    assert [frame.number for frame in frames] == [1, 3, 4, 6]
    np.testing.assert_array_equal(frames[1].inverse_depth, osl.load_dataset(done)[2].inverse_depth)


@pytest.mark.parametrize(("seconds", "method"), [(1.9, FRAME_METHOD), (2.1, VIDEO_METHOD)])
def test_by_default_it_takes_the_best_method_that_keeps_pace_and_goes_on_with_it(
    recorded, tmp_path, capsys, monkeypatch, seconds, method
):
    monkeypatch.setattr(pace, "_FEW_FRAMES", 2)
    measured = lambda sweep, first, name, _: (seconds if name == FRAME_METHOD else 0.5, [])  # noqa: E731
    monkeypatch.setattr(pace, "_measure", measured)
    command = record_command(recorded, tmp_path / "out")
    del command[command.index("--method") : command.index("--method") + 2]
    assert run(*command, "--frames", ":3") == 0
    took = pace.in_words(2 * (seconds if method == FRAME_METHOD else 0.5))
    said = capsys.readouterr().err
    assert f"method: {method}, " in said and f"2 frames: about {took} by {method}\n" in said
    # the machine is busy, or no longer
    monkeypatch.setattr(pace, "_measure", lambda *_: (4.0 - seconds, []))
    assert run(*command) == 0
    stored = json.loads((tmp_path / "out" / "recording.json").read_text())
    assert stored["provenance"]["method"] == method


def test_frames_that_were_timed_are_not_computed_again(recorded, done, tmp_path, monkeypatch):
    monkeypatch.setattr(pace, "_FEW_FRAMES", 2)
    estimate, computed = recordings.sweep_depth, []
    counted = lambda *args, **of: computed.append(args) or estimate(*args, **of)  # noqa: E731
    for module in (pace, recordings):
        monkeypatch.setattr(module, "sweep_depth", counted)
    assert run(*record_command(recorded, tmp_path / "out")) == 0
    assert len(computed) == FRAMES
    for frame, alone in zip(*map(osl.load_dataset, (tmp_path / "out", done)), strict=True):
        np.testing.assert_array_equal(frame.inverse_depth, alone.inverse_depth)


def test_a_volume_that_memory_cannot_hold_is_refused_before_anything_is_written(
    recorded, tmp_path, capsys, monkeypatch
):
    whole = lambda cameras, grid, volume: 10**12 if volume and grid == GRID else 1  # noqa: E731
    monkeypatch.setattr(device, "bytes_of_ray", whole)
    assert run(*record_command(recorded, tmp_path / "out"), "--frames", ":3") == 2
    assert "GiB of cpu memory" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    # That of VolumeNet is never whole, but the other method would be timed beside it.
    monkeypatch.setattr(pace, "_FEW_FRAMES", 2)
    monkeypatch.setattr(pace, "_PACE_S", 0.0)
    command = record_command(recorded, tmp_path / "out")
    k = command.index("--method")
    for name, method in {"asked": ["--method", FRAME_METHOD], "found": []}.items():
        command[k:] = [*method, "--out", tmp_path / name, "--frames", ":3"]
        assert run(*command) == 0
        assert VIDEO_METHOD not in capsys.readouterr().err


def test_another_recording_is_not_overwritten(recorded, done, capsys):
    assert run(*record_command(recorded, done), "--grid", "96x24x32", "--method", "zncc+sgm") == 2
    said = capsys.readouterr().err
    assert (
        "recording.json is of a recording with other settings: spheres: 16 there, 32 here; method:"
        " zncc there, " in said
    )
    assert "already" not in said


def test_depth_of_another_rig_or_of_other_pictures_is_not_kept(recorded, done, tmp_path, capsys):
    rig = osl.load_rig(recorded / "rig.yaml")
    moved = [*rig.T_rig_cam[:3], osl.Pose(rig.T_rig_cam[3].R, 1.01 * rig.T_rig_cam[3].t)]
    mask = np.ones(rig.cameras[0].image_size[::-1], bool)
    mask[:9] = False
    masked = [replace(rig.cameras[0], mask=mask), *rig.cameras[1:]]
    before = (done / "config.yaml").read_bytes()
    for k, other in enumerate([rig.with_poses(moved), osl.Rig(masked, rig.T_rig_cam, 0.6)]):
        (tmp_path / str(k)).mkdir()
        osl.save_rig(other, tmp_path / str(k) / "rig.yaml")
        assert run(*record_command(recorded, done), "--rig", tmp_path / str(k) / "rig.yaml") == 2
        said = capsys.readouterr().err
        assert "recording.json is of a recording with other settings" in said
        assert "is computed again" not in said
    shutil.copytree(recorded, tmp_path / "copy")
    assert run(*record_command(tmp_path / "copy", done)) == 2
    assert "recording.json is of a recording with other settings" in capsys.readouterr().err
    assert (done / "config.yaml").read_bytes() == before
    assert run(*record_command(recorded, done)) == 0


def test_a_frame_that_gets_another_name_is_another_recording(tmp_path):
    folders = [pictures(tmp_path / name, "b.png", "c.png") for name in "xy"]
    first = Recording.open(folders, stop=1)
    assert first.checksum == Recording.open(folders).checksum  # more frames continue it
    for folder in folders:
        write_image(folder / "a.png", np.zeros((4, 4)))
    assert first.checksum != Recording.open(folders).checksum
    numbered = [pictures(tmp_path / name, "1.png", "2.png") for name in "zw"]
    shorter = Recording.open(numbered)
    for folder in numbered:
        write_image(folder / "0.png", np.zeros((4, 4)))
    again, turned = (Recording.open(folders).checksum for folders in (numbered, numbered[::-1]))
    assert shorter.checksum == again != turned


class Colors:
    """Stands for a recording, whose pictures have three colours, one beside the other."""

    recording, rate = SimpleNamespace(frames=range(3)), Fraction("29.97")

    def picture(self, number):
        return np.repeat(np.array([SATURATED], np.uint8)[..., ::-1], 40, 1).repeat(48, 0)


SATURATED = [(230, 30, 20), (30, 200, 40), (250, 160, 10)]  # RGB


@pytest.mark.browser
@pytest.mark.parametrize("suffix", [".mp4", ".webm"])
def test_a_browser_shows_the_colours_of_the_video_at_once(tmp_path, open_page, suffix):
    path = tmp_path / f"depth{suffix}"
    assert recordings.write_video(path, Colors()) == pytest.approx(3 / 29.97)
    if suffix == ".mp4":
        content = path.read_bytes()
        assert content.index(b"moov") < content.index(b"mdat")
    (tmp_path / "page.html").write_text(f'<video muted src="{path.name}"></video><canvas></canvas>')
    page = open_page(400, 300)
    page.goto((tmp_path / "page.html").as_uri())
    page.wait_for_function("document.querySelector('video').readyState >= 2")
    # A canvas may not be read that shows a local file; a screenshot may.
    page.locator("video").screenshot(path=str(tmp_path / "shot.png"))
    shot = read_image(tmp_path / "shot.png")
    for k, color in enumerate(SATURATED):
        assert np.abs(shot[24, 20 + 40 * k].astype(int) - color).max() <= 4, shot[24, 20 + 40 * k]


def test_frames_of_a_turned_video_are_those_that_are_stored(tmp_path):
    """The rotation that a telephone states is a matrix in the header of the track."""
    upright, turned = ((1, 0, 0, 0, 1, 0), (0, 1, 0, -1, 0, 0))
    path, picture = tmp_path / "a.mp4", np.zeros((48, 64, 3), np.uint8)
    picture[:24] = 200
    write_video(path, [picture] * 3, 25, "mp4v")
    head, mark, tail = path.read_bytes().partition(b"tkhd")
    old, new = (struct.pack(">6i", *(x << 16 for x in matrix)) for matrix in (upright, turned))
    path.write_bytes(head + mark + tail.replace(old, new, 1))
    assert cv2.VideoCapture(str(path)).read()[1].shape == (64, 48, 3)  # as players show it
    with pytest.warns(
        UserWarning, match=r"a.mp4 is marked as turned by 90°; its pixels .* as they are stored"
    ) as said:
        frames = [*open_sources([path])[0].read([0, 2], (64, 48))]
    assert len(said) == 1
    assert all(np.abs(frame.astype(int) - picture).max() < 20 for frame in frames)
    cameras = Cameras([str(path)] * 4, scene.rig(width=64, height=48))
    assert cameras.first[0].shape == (48, 64, 3)


def test_videos_are_recordings_too(recorded, done, tmp_path, capsys):
    for k, view in enumerate(views(recorded), 1):
        pictures = [read_image(path) for path in sorted(view.iterdir())]
        write_video(tmp_path / f"{k}.mkv", pictures[: 5 if k == 3 else None])
    videos = [tmp_path / f"{k}.mkv" for k in (1, 2, 3, 4)]
    command = ["record", "--rig", recorded / "rig.yaml", "--images", *videos, *SMALL]
    assert run(*command, "--out", tmp_path / "out", "--frames", "1::2") == 0
    assert "3.mkv lacks 1 frame that other cameras have; left out: 5" in capsys.readouterr().err
    data = osl.load_dataset(tmp_path / "out")
    assert [frame.number for frame in data] == [1, 3]
    of_pictures = osl.load_dataset(done)[3]  # frame 4 of the pictures, which count from 1
    agree = np.isclose(data[1].inverse_depth, of_pictures.inverse_depth, rtol=0.05, equal_nan=True)
    assert agree.mean() > 0.95


@pytest.mark.filterwarnings("ignore:the time stamps of a frame differ")
@pytest.mark.parametrize(("rate", "apart"), [(20, 20), (30, 16.7), (12.5, 20)])
def test_videos_of_unequal_rates_are_matched_by_time(tmp_path, rate, apart):
    """The gray value of a frame is its time in hundredths of a second; the first one has 25."""
    for name, fps in (("a.mkv", 25), ("b.avi", rate)):
        grays = [np.full((16, 16), round(100 * k / fps), np.uint8) for k in range(round(2 * fps))]
        write_video(tmp_path / name, grays, fps)
    found = Recording.open([tmp_path / "a.mkv", tmp_path / "b.avi"])
    assert len(found.frames) == min(50, round(2 * rate))
    times = [
        [int(picture[0, 0, 0]) for picture in source.read([*found.frames], None)]
        for source in found.sources
    ]
    assert np.abs(np.subtract(*times)).max() <= apart / 10 + 1
    stated = [found.times[number] / 1e7 for number in found.frames]
    assert np.ptp(np.subtract(stated, times[0])) <= 1  # hundredths of a second


@pytest.mark.parametrize("unit", [1, 1000], ids=["ns", "µs"])
def test_time_stamps_as_names_are_matched_by_nearest_time(tmp_path, unit):
    start, frame = 1403636579763555584 // unit, 50_000_000 // unit
    times = start + frame * np.arange(6)
    late = np.delete(times, 2) + np.array([0, 5184, -700_000, 3000, 24_000_000]) // unit
    folders = [
        pictures(tmp_path / name, *(f"{t}.png" for t in ts))
        for name, ts in (("a", times), ("b", late))
    ]
    with pytest.warns(UserWarning, match="differ by up to 24 ms; .* 50 ms apart"):
        found = Recording.open(folders)
    assert list(found.frames) == list(np.delete(times, 2))
    assert found.missing == {folders[1]: [times[2]]}
    matched = [found.sources[1].files[key].stem for key in found.frames.values()]
    assert matched == [str(t) for t in late]
    assert found.times == {t: t * unit for t in found.frames}


def test_a_picture_is_of_one_moment_only(tmp_path):
    """The second camera is twice as fast: of its two pictures the nearer is taken."""
    slow, fast = ([1700000000.0 + k / rate for k in range(n)] for rate, n in ((10, 4), (20, 8)))
    a = pictures(tmp_path / "a", *(f"{t:.6f}".rstrip("0") + "0.png" for t in slow))
    b = pictures(tmp_path / "b", *(f"{t + 0.001:.6f}.png" for t in fast))
    found = Recording.open([a, b])
    matched = [found.sources[1].files[key].name for key in found.frames.values()]
    assert matched == [f"{t + 0.001:.6f}.png" for t in slow] and len(found.missing[a]) == 4


def test_equal_time_stamps_and_counters_are_matched_exactly(tmp_path, recwarn):
    stamps = [pictures(tmp_path / name, "1700000000.png", "1700000001.png") for name in "ab"]
    assert list(Recording.open(stamps).frames) == [1700000000, 1700000001]
    names = {"c": ("0000000000.png", "0000000010.png"), "d": ("1.png", "10.png")}
    counters = [pictures(tmp_path / folder, *some) for folder, some in names.items()]
    assert list(Recording.open(counters).frames) == [10] and not recwarn


def test_hidden_files_are_no_pictures_and_of_one_name_there_is_one(tmp_path):
    folder = pictures(tmp_path / "a", "0001.jpg", "0002.jpg")
    (folder / "._0001.jpg").write_bytes(b"of macOS")
    assert list(Recording.open([folder]).frames) == [1, 2]
    write_image(folder / "0001.tif", np.zeros((4, 4)))
    with refused(r"a has 0001\.jpg and 0001\.tif; expected one"):
        Recording.open([folder])


def pictures(folder, *names):
    folder.mkdir()
    for name in names:
        write_image(folder / name, np.zeros((4, 4)))
    return folder


def test_frames_are_matched_by_number_or_by_name(tmp_path):
    a = pictures(tmp_path / "a", "left_7.png", "left_08.png", "left_10.png", "mask.png")
    b = pictures(tmp_path / "b", "r7.png", "r8.png", "r9.png", "r10.png")
    found = Recording.open([a, b])
    assert list(found.frames) == [7, 8, 10] and found.missing == {a: [9]}
    assert list(Recording.open([a, b], start=8, step=2).frames) == [8]
    c = pictures(tmp_path / "c", "x.png", "y.png")
    d = pictures(tmp_path / "d", "y.png", "x.png", "z.png")
    named = Recording.open([c, d])
    assert named.frames == {0: "x", 1: "y"} and named.missing == {c: ["z"]}
    with refused("have no frame in common"):
        Recording.open([a, c])
    with refused("no frame is left of 7 … 10"):
        Recording.open([a, b], start=11)


def test_what_is_no_recording_is_told(tmp_path):
    (tmp_path / "empty").mkdir()
    with refused("empty holds no images"):
        Recording.open([tmp_path / "empty"])
    (tmp_path / "a.mp4").write_bytes(b"no video" * 100)
    with refused(r"a.mp4 is not a video that can be read"):
        Recording.open([tmp_path / "a.mp4"])


def test_a_video_shorter_than_it_says_is_told(tmp_path):
    rng = np.random.default_rng(0)
    write_video(tmp_path / "a.mkv", list(rng.integers(0, 256, (5, 48, 64), np.uint8)))
    source = Recording.open([tmp_path / "a.mkv"]).sources[0]
    whole = (tmp_path / "a.mkv").read_bytes()
    assert len(list(source.read([1, 4], (64, 48)))) == 2
    (tmp_path / "a.mkv").write_bytes(whole[: len(whole) * 3 // 5])
    with refused(r"a.mkv: frame 4 cannot be"):
        list(source.read([1, 4], (64, 48)))
    assert list(source.unreadable([1, 3, 4], (64, 48))) == [3, 4]
    with refused(r"a.mkv is 64 × 48 px; the camera has 48 × 64 px"):
        next(source.read([1], (48, 64)))


@pytest.mark.slow
def test_a_late_camera_is_found_stored_and_put_right(tmp_path, capsys):
    """Its depth is that of the pictures as they were before their names were moved by a frame."""
    drive = DATA / "drive" / "test"

    def recorded(name, late, *more):
        folders = [tmp_path / name / f"cam{k}" for k in (1, 2, 3, 4)]
        for folder, own in zip(folders, late, strict=True):
            folder.mkdir(parents=True)
            pictures = sorted((drive / folder.name).iterdir())[2 - own : 12 - own]
            for k, picture in enumerate(pictures):
                (folder / f"{100 * k:04}.jpg").symlink_to(picture)
        out = tmp_path / f"{name}_out"
        command = ["record", "--rig", drive, "--images", *folders, *SMALL, "--out", out]
        assert run(*command, *more) == 0
        return command, out, {f.number: f.inverse_depth for f in osl.load_dataset(out)}

    *_, right = recorded("on_time", (0, 0, 0, 0))
    command, out, found = recorded("late", (0, 0, 1, 0), "--sync", "--frames", ":500")
    assert "camera 3 is one frame late" in capsys.readouterr().err
    late = json.loads((out / "recording.json").read_text())["late_s"]
    assert late == pytest.approx([0, 0, 100, 0], abs=10)
    # Gone on with, without measuring again.
    assert run(*command) == 0
    found = {frame.number: frame.inverse_depth for frame in osl.load_dataset(out)}
    assert list(found) == list(right)[:-1]
    for number, inverse_depth in found.items():
        np.testing.assert_array_equal(inverse_depth, right[number])


def test_how_late_a_camera_is_cannot_be_measured_where_nothing_moves(recorded, tmp_path, capsys):
    images = [tmp_path / f"cam{k}" for k in (1, 2, 3, 4)]
    for folder, view in zip(images, views(recorded), strict=True):
        folder.mkdir()
        for k in range(6):
            (folder / f"{k}.png").symlink_to(sorted(view.iterdir())[0])
    command = record_command(recorded, tmp_path / "out")
    command[4:8] = images
    assert run(*command, "--sync") == 2
    assert "cannot be measured" in capsys.readouterr().err and not (tmp_path / "out").exists()
