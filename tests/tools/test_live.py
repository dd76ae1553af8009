"""The live view, from video files, in the browser."""

import re
import socket
import threading
import time
import urllib.error
import urllib.request
from contextlib import ExitStack
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest
import scene

import omnistereo_lib as osl
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_tools import cli, live_view
from omnistereo_tools.live_view import Latest, live_pictures, serve, show

FRAMES = 5
GRID = osl.SphereGrid(96, 24, num_spheres=16, min_depth=0.6)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A rig file and one video per camera, lossless."""
    folder = tmp_path_factory.mktemp("videos")
    rig = scene.rig(width=100, height=96)
    rig = osl.Rig(rig.cameras, rig.T_rig_cam, min_depth=0.6)
    osl.save_rig(rig, folder / "rig.yaml")
    for k, picture in enumerate(scene.images(rig, finest=0.25)):
        video = cv2.VideoWriter(str(folder / f"{k}.mkv"), cv2.VideoWriter_fourcc(*"FFV1"), 20, (100, 96))
        for _ in range(FRAMES):
            video.write(np.stack([picture] * 3, -1).astype(np.uint8))
        video.release()
    return rig, folder, [str(folder / f"{k}.mkv") for k in range(4)]


def test_pictures_show_panorama_over_depth(recorded):
    rig, _, videos = recorded
    pictures = list(live_pictures(videos, SphereSweep(rig, GRID), "zncc"))
    assert 1 <= len(pictures) <= FRAMES  # who is slow misses frames
    height = pictures[-1].shape[0] - 40
    panorama, depth = pictures[-1][: height // 2], pictures[-1][height // 2 : height]
    truth = osl.estimate_depth(
        rig, [cv2.cvtColor(cv2.VideoCapture(v).read()[1], cv2.COLOR_BGR2GRAY) for v in videos], GRID, "zncc"
    )
    small = cv2.resize(depth, (96, 24), interpolation=cv2.INTER_AREA).astype(int).sum(-1)
    assert np.corrcoef(small.ravel(), truth.inverse_depth.ravel())[0, 1] > 0.9  # near is bright
    assert panorama.std() > 20 and np.ptp(panorama.astype(int), axis=-1).mean() < 3  # the scene is gray


def test_a_video_begins_to_play_when_the_first_depth_was_computed(recorded, monkeypatch):
    """Compiling and tables take longer than a short video."""
    rig, _, videos = recorded
    compute, calls = live_view.sweep_depth, []

    def slow_at_first(*arguments):
        calls.append(arguments)
        time.sleep(1.0 if len(calls) == 1 else 0.0)  # the video takes 0.25 s
        return compute(*arguments)

    monkeypatch.setattr(live_view, "sweep_depth", slow_at_first)
    first = next(iter(live_pictures(videos, SphereSweep(rig, GRID), "zncc")))
    assert len(calls) == 2 and first[: first.shape[0] // 3].std() > 20


def test_the_browser_gets_a_stream():
    latest = Latest()
    pictures = [np.full((20, 30, 3), gray, np.uint8) for gray in (10, 60, 200)]
    with serve(latest, 0) as address:
        assert '<img src="stream"' in urllib.request.urlopen(address, timeout=60).read().decode()
        stream = urllib.request.urlopen(address + "stream", timeout=60)
        assert show(iter(pictures), latest) == 3
        parts = stream.read().split(b"--x\r\n")[1:]
    assert 1 <= len(parts) <= 3
    jpeg = parts[-1].split(b"\r\n\r\n", 1)[1]
    assert np.abs(cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR) - 200.0).max() < 3


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example:8765", "", None])
def test_a_page_of_another_name_gets_no_pictures(host):
    """As of a site whose name its owner lets point here (DNS rebinding)."""
    with serve(Latest(), 0) as address:
        asked = urllib.request.Request(address, headers={} if host is None else {"Host": host})
        if host is None:  # urllib would add it
            with socket.create_connection(("127.0.0.1", urlsplit(address).port), 60) as client:
                client.sendall(b"GET / HTTP/1.0\r\n\r\n")
                assert b" 403 " in client.makefile("rb").readline()
        else:
            with pytest.raises(urllib.error.HTTPError, match="403"):
                urllib.request.urlopen(asked, timeout=60)


def test_clients_that_say_nothing_keep_nobody_out_for_long(monkeypatch, capfd):
    monkeypatch.setattr(live_view, "_PATIENCE_S", 1.0)
    with serve(Latest(), 0) as address, ExitStack() as clients:
        port = urlsplit(address).port
        silent = [clients.enter_context(socket.create_connection(("127.0.0.1", port), 60)) for _ in range(60)]
        one_too_many = silent[-1].recv(1)  # closed at once
        assert one_too_many == b"" and all(client.recv(1) == b"" for client in silent)  # after a second
        assert b"stream" in urllib.request.urlopen(address, timeout=60).read()
    assert capfd.readouterr().err == ""


def test_a_client_that_does_not_read_is_left(monkeypatch):
    monkeypatch.setattr(live_view, "_PATIENCE_S", 0.5)
    latest = Latest()
    with serve(latest, 0) as address:
        port = urlsplit(address).port
        with socket.create_connection(("127.0.0.1", port), 60) as client:
            client.sendall(b"GET /stream HTTP/1.0\r\nHost: localhost\r\n\r\n")
            assert client.recv(4) == b"HTTP"
            latest.put(bytes(1 << 26))  # more than the system keeps for it
            deadline = time.monotonic() + 60
            while any("process_request" in thread.name for thread in threading.enumerate()):
                assert time.monotonic() < deadline, "its thread still waits"
                time.sleep(0.05)


def test_the_command_plays_videos_to_their_end(recorded, capsys):
    _, folder, videos = recorded
    small = ["--width", 96, "--height", 24, "--spheres", 16, "--method", "zncc", "--port", 0]
    command = ["live", "--rig", folder / "rig.yaml", "--cameras", *videos, *small]
    assert cli.main([str(argument) for argument in command]) == 0
    told = capsys.readouterr().out
    assert re.search(r"open http://127.0.0.1:\d+/ in a browser of this machine; Ctrl-C stops\n[1-5] frames, ", told)


class Terminated(KeyboardInterrupt):
    """As the command line's own, of SIGTERM."""


@pytest.mark.parametrize("stop", [KeyboardInterrupt, Terminated])
def test_ctrl_c_ends_it_with_the_last_line(recorded, capsys, monkeypatch, stop):
    def pictures(*_):
        yield np.zeros((20, 30, 3), np.uint8)
        raise stop

    _, folder, videos = recorded
    monkeypatch.setattr(live_view, "live_pictures", pictures)
    command = ["live", "--rig", str(folder / "rig.yaml"), "--cameras", *videos, "--port", "0"]
    ended = stop is KeyboardInterrupt
    assert cli.main(command) == (0 if ended else 130)
    told = capsys.readouterr()
    assert ("1 frames, " in told.out) is ended and ("interrupted" in told.err) is not ended


@pytest.mark.parametrize("port", [-1, 65536])
def test_a_port_is_a_number_of_16_bits(port):
    with pytest.raises(osl.OmnistereoError, match=f"--port is {port}; expected 0 to 65535"), serve(Latest(), port):
        pass


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
        (["--cameras", "no.mp4", "no.mp4", "no.mp4", "no.mp4"], "no.mp4 is not a video that OpenCV can read"),
    ],
)
def test_what_cannot_be_shown_is_told(recorded, capsys, change, message):
    assert cli.main(["live", "--rig", str(recorded[1] / "rig.yaml"), *change, "--port", "0"]) == 2
    assert message in capsys.readouterr().err
