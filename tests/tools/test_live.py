"""The live view, from video files, in the browser."""

import _thread
import re
import shutil
import socket
import threading
import time
import urllib.error
import urllib.request
import webbrowser
from contextlib import contextmanager
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest
import scene

import omnistereo_lib as osl
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_tools import cli, live_view
from omnistereo_tools.commands import demo_command
from omnistereo_tools.judge.ray import explain
from omnistereo_tools.live_view import (
    Cameras,
    Latest,
    LivePicture,
    draw_picture,
    live_pictures,
    serve,
)
from omnistereo_tools.output.colors import ColorScale
from omnistereo_tools.output.pictures import FILM, panes

FRAMES = 5
# nearer, one camera alone sees some rays
GRID = osl.SphereGrid(96, 24, num_spheres=16, min_depth=0.8)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A rig file and one video per camera, lossless."""
    folder = tmp_path_factory.mktemp("videos")
    rig = scene.rig(width=100, height=96)
    rig = osl.Rig(rig.cameras, rig.T_rig_cam, min_depth=GRID.min_depth)
    osl.save_rig(rig, folder / "rig.yaml")
    for k, picture in enumerate(scene.images(rig, finest=0.25)):
        scene.write_video(folder / f"{k}.mkv", [picture] * FRAMES)
    return rig, folder, [str(folder / f"{k}.mkv") for k in range(4)]


def decode(jpeg):
    return cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)


def parts(jpeg):
    """The panorama and the depth beside it."""
    top, height = panes(GRID)
    return np.split(decode(jpeg)[top : top + height], 2, axis=1)


def place_of(row, column, part=0):
    """Where a ray is in a picture, 0 to 1; part 1 is the depth."""
    top, height = panes(GRID)
    return (column + 0.5) / 96 / 2 + part / 2, (top + (row + 0.5) / 24 * height) / FILM[1]


def test_pictures_show_the_panorama_and_its_depth(recorded):
    rig, _, videos = recorded
    pictures = list(live_pictures(Cameras(videos, rig), SphereSweep(rig, GRID), "zncc"))
    assert 1 <= len(pictures) <= FRAMES  # who is slow misses frames
    panorama, depth = parts(pictures[-1].jpeg)
    first = [cv2.cvtColor(cv2.VideoCapture(v).read()[1], cv2.COLOR_BGR2GRAY) for v in videos]
    truth = osl.estimate_depth(osl.Frame.of(rig, first), GRID, "zncc")
    small = cv2.resize(depth, (96, 24), interpolation=cv2.INTER_AREA).astype(int).sum(-1)
    assert np.corrcoef(small.ravel(), truth.inverse_depth.ravel())[0, 1] > 0.9  # near is bright
    # the scene is gray
    assert panorama.std() > 20 and np.ptp(panorama.astype(int), axis=-1).mean() < 3


def test_a_video_begins_to_play_when_the_first_depth_was_computed(recorded, monkeypatch):
    """Compiling and tables take longer than a short video."""
    rig, _, videos = recorded
    compute, calls = live_view.sweep_depth, []

    def slow_at_first(*arguments):
        calls.append(arguments)
        time.sleep(1.0 if len(calls) == 1 else 0.0)  # the video takes 0.25 s
        return compute(*arguments)

    monkeypatch.setattr(live_view, "sweep_depth", slow_at_first)
    first = next(iter(live_pictures(Cameras(videos, rig), SphereSweep(rig, GRID), "zncc")))
    assert len(calls) >= 2 and parts(first.jpeg)[0].std() > 20


@pytest.fixture(scope="module")
def picture(recorded):
    """A picture of the box at its true depth."""
    rig = recorded[0]
    index = scene.true_index(rig, GRID).astype(np.float32)
    index[0, 0] = np.nan
    depth = osl.Depth(
        index, np.ones_like(index), SphereSweep(rig, GRID), scene.images(rig, finest=0.25)
    )
    trust = np.where(np.indices(index.shape)[1] < 48, 0.0, 1.0)  # doubtful in the left half
    return depth, draw_picture(depth, np.ones((4, 1)), trust, ColorScale(0.0, 1.3), "zncc")


def test_doubtful_rays_are_faded(picture):
    depth, shown = picture
    colors = cv2.resize(parts(shown.jpeg)[1], (96, 24), interpolation=cv2.INTER_AREA)
    expected = cv2.cvtColor(ColorScale(0.0, 1.3).colorize(depth.inverse_depth), cv2.COLOR_RGB2BGR)
    off = np.abs(colors.astype(int) - expected).mean((0, 2))
    assert off[:47].mean() > 25 and off[49:].mean() < 8


def test_the_depth_below_the_pointer_is_told(picture):
    depth, shown = picture
    row, column = 17, 40
    for part in (0, 1):  # the panorama and the depth below it
        told = shown.depth_at(*place_of(row, column, part))
        assert told == f"{depth.depth[row, column]:.2f} m along the ray"
    assert shown.depth_at(*place_of(0, 0)) == "no depth here" and shown.depth_at(0.5, 0.99) == ""


def test_why_a_ray_has_its_depth_is_told_as_on_the_page_of_a_frame(picture):
    depth, shown = picture
    told = shown.why_at(*place_of(17, 40))
    assert told == explain(depth, column=40, row=17).sentence and shown.why_at(0.5, 0.99) == ""


def test_videos_pause_step_and_begin_again(recorded):
    rig, _, videos = recorded
    cameras = Cameras(videos, rig, loop=True)
    cameras.pause()
    reader = threading.Thread(target=cameras.read)
    reader.start()
    pictures = iter(cameras.newest)
    for _ in range(FRAMES + 2):  # past the end
        assert cameras.newest.newest is None
        cameras.step()
        next(pictures)
        cameras.newest.put(None)
        next(pictures)
    cameras.play()
    assert len(next(pictures)) == 4
    cameras.close()
    reader.join(60)
    assert not reader.is_alive()


def test_the_browser_gets_a_stream_and_depths(picture):
    depth, shown = picture
    latest = Latest()
    with serve(latest) as address:
        assert 'src="stream"' in urllib.request.urlopen(address, timeout=60).read().decode()
        assert not latest.watched.is_set()  # nobody looks yet
        stream = urllib.request.urlopen(address + "stream", timeout=60)
        assert latest.watched.wait(60)
        latest.put(shown)
        told = urllib.request.urlopen(
            address + "depth?{}&{}".format(*place_of(17, 40)), timeout=60
        ).read()
        latest.close()
        streamed = stream.read()
    assert told.decode() == f"{depth.depth[17, 40]:.2f} m along the ray"
    # with the head of the next one, without which a browser would not show it
    assert streamed == live_view.PART + shown.jpeg + b"\r\n" + live_view.PART


def test_on_a_telephone_the_panoramas_lie_below_each_other_and_are_tapped(picture, open_page):
    depth, shown = picture
    latest, (top, height) = Latest(), panes(GRID)
    with serve(latest) as address:
        page = open_page(390, 844, has_touch=True)
        page.goto(address, wait_until="commit")
        assert latest.watched.wait(60)
        latest.put(shown)
        page.wait_for_function("first > 0")
        box = page.locator("#upright").bounding_box()
        assert box["width"] == 390 and box["y"] + box["height"] < 844
        row, column, scale = 17, 40, 390 / 960
        for part in (0, 1):  # the panorama, the depth below it
            y = top * 4 / 3 + (part + (row + 0.5) / GRID.height) * height
            x = (column + 0.5) / GRID.width * 960
            page.touchscreen.tap(box["x"] + scale * x, box["y"] + scale * y)
            told = f"{depth.depth[row, column]:.2f} m along the ray"
            page.wait_for_function("told => $('depth').textContent === told", arg=told)
            page.evaluate("$('depth').textContent = ''")
        latest.close()


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example:8765", "", None])
def test_a_page_of_another_name_gets_no_pictures(host):
    """As of a site whose name its owner lets point here (DNS rebinding)."""
    with serve(Latest()) as address:
        asked = urllib.request.Request(address, headers={} if host is None else {"Host": host})
        if host is None:  # urllib would add it
            with socket.create_connection(("127.0.0.1", urlsplit(address).port), 60) as client:
                client.sendall(b"GET / HTTP/1.0\r\n\r\n")
                assert b" 403 " in client.makefile("rb").readline()
        else:
            with pytest.raises(urllib.error.HTTPError, match="403"):
                urllib.request.urlopen(asked, timeout=60)


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_a_page_of_another_site_is_not_shown_the_stream(site):
    with serve(Latest()) as address:
        for name in ("stream", "depth?0.5&0.5"):
            asked = urllib.request.Request(address + name, headers={"Sec-Fetch-Site": site})
            with pytest.raises(urllib.error.HTTPError, match="403"):
                urllib.request.urlopen(asked, timeout=60)
        assert (
            urllib.request.urlopen(address, timeout=60).headers["Cross-Origin-Resource-Policy"]
            == "same-origin"
        )


def test_an_origin_of_another_site_is_refused_where_a_browser_tells_no_more():
    latest = Latest()
    with serve(latest) as address:
        for origin, answer in (("http://evil.example", 403), (address.rstrip("/"), 400)):
            asked = urllib.request.Request(address + "depth?", headers={"Origin": origin})
            with pytest.raises(urllib.error.HTTPError, match=str(answer)):
                urllib.request.urlopen(asked, timeout=60)


class Device:
    """A camera as OpenCV has it, which shows one picture."""

    def __init__(self, source):
        pass

    def isOpened(self):
        return True

    def set(self, what, value):
        pass

    def grab(self):
        return True

    def retrieve(self):
        return True, np.concatenate([np.full((96, 100, 3), 60 * k, np.uint8) for k in range(4)], 1)


def test_a_camera_may_be_a_device_or_a_stream_and_send_all_lenses(recorded, monkeypatch):
    opened = []

    def capture(source):
        return opened.append(source) or Device(source)

    monkeypatch.setattr(live_view.cv2, "VideoCapture", capture)
    for source in ("rtsp://10.0.0.1/stream", "/dev/v4l/by-id/usb-front", 0):
        first = Cameras([source], recorded[0]).first
        assert [image[0, 0, 0] for image in first] == [0, 60, 120, 180]
    assert opened == ["rtsp://10.0.0.1/stream", "/dev/v4l/by-id/usb-front", 0]


class Ending(Device):
    """A camera whose cable is pulled after three pictures, or whose pictures are damaged then."""

    left, grabs = 4, False

    def grab(self):
        self.left -= 1
        return self.left > 0 or self.grabs

    def retrieve(self):
        return super().retrieve() if self.left > 0 else (False, None)


@pytest.mark.parametrize("grabs", [False, True])
def test_a_camera_without_more_pictures_ends_the_view_by_its_name(recorded, monkeypatch, grabs):
    monkeypatch.setattr(live_view.cv2, "VideoCapture", Ending)
    monkeypatch.setattr(Ending, "grabs", grabs)
    rig = recorded[0]
    with pytest.raises(osl.OmnistereoError, match=r"camera 0 gives no picture. Check its cable"):
        list(live_pictures(Cameras([0], rig), SphereSweep(rig, GRID), "zncc"))


def test_a_video_that_is_lost_while_it_plays_ends_the_view(recorded, tmp_path):
    rig, _, videos = recorded
    copies = [shutil.copy(video, tmp_path) for video in videos]
    cameras = Cameras(copies, rig, loop=True)
    (tmp_path / "1.mkv").unlink()
    with pytest.raises(osl.OmnistereoError, match=r"1\.mkv"):
        list(live_pictures(cameras, SphereSweep(rig, GRID), "zncc"))


@pytest.mark.parametrize(
    "query", ["inf&0.1", "nan&0.1", "0.1", "", "0.1&0.1&0.1", "a&b", "1e309&0"]
)
def test_a_place_that_is_none_is_refused(picture, query):
    latest = Latest()
    latest.put(picture[1])
    with serve(latest) as address, pytest.raises(urllib.error.HTTPError, match="400"):
        urllib.request.urlopen(f"{address}depth?{query}", timeout=60)


def test_a_client_that_does_not_read_is_left(monkeypatch, picture):
    monkeypatch.setattr(live_view, "_PATIENCE_S", 0.5)
    latest, (depth, _) = Latest(), picture
    with serve(latest) as address:
        port = urlsplit(address).port
        with socket.create_connection(("127.0.0.1", port), 60) as client:
            client.sendall(b"GET /stream HTTP/1.0\r\nHost: localhost\r\n\r\n")
            assert client.recv(4) == b"HTTP"
            latest.put(LivePicture(bytes(1 << 26), depth))  # more than the system keeps for it
            deadline = time.monotonic() + 60
            while any("process_request" in thread.name for thread in threading.enumerate()):
                assert time.monotonic() < deadline, "its thread still waits"
                time.sleep(0.05)


@pytest.fixture
def viewer(monkeypatch):
    """A browser that opens the page as soon as there is one."""
    server = live_view.serve

    @contextmanager
    def serve_and_look(*arguments):
        with server(*arguments) as address, urllib.request.urlopen(address + "stream", timeout=60):
            yield address

    monkeypatch.setattr(live_view, "serve", serve_and_look)


def live(folder, videos):
    small = ["--grid", "96x24x16", "--method", "zncc"]
    return cli.main(["live", "--rig", str(folder / "rig.yaml"), "--cameras", *videos, *small])


def test_the_command_plays_videos_to_their_end(recorded, capsys, viewer):
    _, folder, videos = recorded
    assert live(folder, videos) == 0
    told = capsys.readouterr().out
    page = r"It begins when the page is open in a browser of this machine; Ctrl-C stops it.\n"
    assert re.search(page + r"http://127.0.0.1:\d+/\nThe videos have ended: [1-5] frames, ", told)


def test_the_demo_plays_the_drive_and_opens_the_browser(recorded, tmp_path, monkeypatch, capsys):
    rig, _, videos = recorded
    osl.save_rig(rig, tmp_path / "config.yaml")
    for i, video in enumerate(videos, start=1):
        capture, folder = cv2.VideoCapture(video), tmp_path / f"cam{i}"
        folder.mkdir()
        for k in range(3):
            cv2.imwrite(str(folder / f"{k:04}.jpg"), capture.read()[1])
    monkeypatch.setattr(demo_command, "DRIVE", tmp_path)
    monkeypatch.setenv("OMNISTEREO_TINY", "1")

    browsers = []

    def look(address):
        stream = urllib.request.urlopen(address + "stream", timeout=60)
        for _ in range(5):  # there and back the drive has 4 frames
            while not stream.readline().startswith(b"--x"):
                pass
        _thread.interrupt_main()

    def browser(address):
        browsers.append(threading.Thread(target=look, args=[address]))
        browsers[-1].start()

    monkeypatch.setattr(webbrowser, "open", browser)
    assert cli.main(["demo"]) == 0
    told = capsys.readouterr().out
    assert re.search(r"Stopped: [4-9]\d* frames, [\d.]+ frames/s by volumenet\.\n", told)
    browsers[0].join(60)
    monkeypatch.setattr(demo_command, "DRIVE", tmp_path / "nowhere")
    assert cli.main(["demo"]) == 2 and "the drive comes with the clone" in capsys.readouterr().err


def test_a_black_rim_is_masked(tmp_path, capsys, viewer):
    rig = scene.rig(width=200, height=192)
    osl.save_rig(osl.Rig(rig.cameras, rig.T_rig_cam, min_depth=0.6), tmp_path / "rig.yaml")
    for k, (camera, picture) in enumerate(
        zip(rig.cameras, scene.images(rig, finest=0.25), strict=True)
    ):
        v, u = np.indices(picture.shape)
        seen = np.hypot(u - camera.center[0], v - camera.center[1]) <= camera.max_radius * 160 / 220
        scene.write_video(tmp_path / f"{k}.mkv", [np.where(seen, picture, 0)])
    assert live(tmp_path, [str(tmp_path / f"{k}.mkv") for k in range(4)]) == 0
    assert "are black beyond 1" in capsys.readouterr().err


def test_ctrl_c_ends_it_with_its_own_words(recorded, capsys, monkeypatch, viewer, picture):
    def pictures(*_):
        yield picture[1]
        raise KeyboardInterrupt

    monkeypatch.setattr(live_view, "live_pictures", pictures)
    assert live(*recorded[1:]) == 0
    told = capsys.readouterr()
    assert "Stopped: 1 frames, " in told.out and "interrupted" not in told.err


def test_the_newest_value_is_what_waits():
    latest = Latest()
    latest.put(1)
    latest.put(2)
    values = iter(latest)
    assert next(values) == 2
    latest.put(3)
    latest.close()
    assert list(values) == [3]


@pytest.mark.parametrize(
    "change, message",
    [
        (["--cameras", "no.mp4", "1.mkv"], "there are 2 cameras or videos for a rig of 4"),
        (["--cameras", "no.mp4", "no.mp4", "no.mp4", "no.mp4"], "no.mp4 is not a video file"),
    ],
)
def test_what_cannot_be_shown_is_told(recorded, capsys, change, message):
    assert cli.main(["live", "--rig", str(recorded[1] / "rig.yaml"), *change]) == 2
    assert message in capsys.readouterr().err
