"""Live view: panorama and depth of cameras or videos, as fast as the machine goes, in the browser."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import BoundedSemaphore, Condition, Thread
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import decoder_messages
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.stereo.methods import Method
from omnistereo_lib.stereo.pipeline import sweep_depth
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_tools.pictures import BACKGROUND, ColorScale
from omnistereo_tools.sources import open_video

_WIDTH = 1280  # px of the picture, if the panorama is smaller
_PATIENCE_S = 10.0  # of a camera that gives no picture, and of a browser that neither asks nor reads
_CLIENTS = 16  # connections at a time; a page has two
_HOST = re.compile(r"(localhost|127\.0\.0\.1)(:[0-9]+)?")  # a name of another site may lead here, too
_PAGE = b"""<!doctype html><title>omnistereo live</title>
<body style="margin:0;background:#202020"><img src="stream" alt="panorama over depth" style="width:100%">"""


class Latest:
    """A value that one thread renews and others wait for; who is slow misses values, and nobody is held up."""

    def __init__(self) -> None:
        self._changed = Condition()
        self._value, self._number = None, 0
        self.closed = False

    def put(self, value: object) -> None:
        """Renew the value."""
        with self._changed:
            self._value, self._number = value, self._number + 1
            self._changed.notify_all()

    def close(self) -> None:
        """Tell everybody that no value will follow."""
        with self._changed:
            self.closed = True
            self._changed.notify_all()

    def __iter__(self) -> Iterator:
        """Yield the newest value, whenever there is a newer one, until it is closed."""
        seen = 0
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._number > seen or self.closed)  # noqa: B023
                if self._number == seen:
                    return
                seen, value = self._number, self._value
            yield value


class Cameras:
    """The newest images of several cameras or videos, taken together.

    Args:
        sources: For each camera of the rig an index of OpenCV, such as 0, or a video file.
        rig: Its image sizes are asked of the cameras.

    Raises:
        OmnistereoError: If a source cannot be opened.
    """

    def __init__(self, sources: Sequence[int | str], rig: Rig) -> None:
        self.captures = [
            _open_camera(source, camera.image_size) if isinstance(source, int) else open_video(Path(source))
            for source, camera in zip(sources, rig.cameras, strict=False)
        ]
        rates = [capture.get(cv2.CAP_PROP_FPS) for capture in self.captures]
        # Videos play at their own speed, cameras set it themselves.
        self.period = 1 / rates[0] if isinstance(sources[0], str) and rates[0] > 0 else 0.0
        self.newest = Latest()

    def read(self) -> None:
        """Read until a source ends; meant for a thread."""
        due = time.monotonic()
        while not self.newest.closed:
            grabbed = [capture.grab() for capture in self.captures]  # first all, then decode: they are nearer in time
            if not all(grabbed):
                break
            self.newest.put([capture.retrieve()[1] for capture in self.captures])
            due += self.period
            time.sleep(max(0.0, due - time.monotonic()))
        self.newest.close()


def _open_camera(number: int, image_size: tuple[int, int]) -> cv2.VideoCapture:
    with decoder_messages():
        capture = cv2.VideoCapture(number)
    if not capture.isOpened():
        raise OmnistereoError(f"camera {number} cannot be opened. Check that it exists and is not in use.")
    capture.set(cv2.CAP_PROP_FRAME_WIDTH, image_size[0])
    capture.set(cv2.CAP_PROP_FRAME_HEIGHT, image_size[1])
    return capture


def live_pictures(
    sources: Sequence[int | str], sweep: SphereSweep, method: str | Method
) -> Iterator[NDArray[np.uint8]]:
    """Return pictures, panorama over depth, BGR, until a source ends; see `Cameras`, which also says what raises."""
    cameras, method = Cameras(sources, sweep.rig), Method.parse(method)
    blank = [np.zeros(camera.image_size[::-1], np.uint8) for camera in sweep.rig.cameras]
    sweep_depth(sweep, blank, method).panorama(blank)  # warm up tables and kernels
    return _play(cameras, sweep, method)


def _play(cameras: Cameras, sweep: SphereSweep, method: Method) -> Iterator[NDArray[np.uint8]]:
    scale = ColorScale(0.0, 0.8 / sweep.grid.min_depth)
    reader = Thread(target=cameras.read, daemon=True)
    reader.start()
    before = time.monotonic()
    try:
        for frames in cameras.newest:
            images = [cv2.cvtColor(frame, cv2.COLOR_BGR2RGB) for frame in frames]
            depth = sweep_depth(sweep, images, method)
            panorama = np.nan_to_num(depth.panorama(images)).round().astype(np.uint8)
            now = time.monotonic()
            note = f"{1 / (now - before):.1f} frames/s, median {np.nanmedian(depth.depth):.1f} m"
            before = now
            yield cv2.cvtColor(_draw(panorama, scale.colorize(depth), note), cv2.COLOR_RGB2BGR)
    finally:
        cameras.newest.close()
        reader.join(_PATIENCE_S)


def _draw(panorama: NDArray[np.uint8], colors: NDArray[np.uint8], note: str) -> NDArray[np.uint8]:
    factor = max(1, round(_WIDTH / panorama.shape[1]))
    size = (panorama.shape[1] * factor, panorama.shape[0] * factor)
    pictures = [cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR) for picture in (panorama, colors)]
    line = np.full((40, size[0], 3), BACKGROUND, np.uint8)
    cv2.putText(line, note, (12, 28), (0xE8,) * 3, cv2.FontFace("sans"), 22, 400)
    return np.vstack([*pictures, line])


def show(pictures: Iterator[NDArray[np.uint8]], latest: Latest) -> int:
    """Give pictures to a server of `serve` until they end or Ctrl-C is pressed; return how many there were."""
    count = 0
    try:
        for picture in pictures:
            latest.put(cv2.imencode(".jpg", picture)[1].tobytes())
            count += 1
    except KeyboardInterrupt as stop:
        if type(stop) is not KeyboardInterrupt:  # SIGTERM, a class of its own in the command line, ends the command
            raise
    finally:
        latest.close()
    return count


class _Server(ThreadingHTTPServer):
    """A server of few clients at a time; who is one too many is turned away at once."""

    daemon_threads = True

    def __init__(self, *arguments: Any) -> None:
        self._free = BoundedSemaphore(_CLIENTS)
        super().__init__(*arguments)

    def verify_request(self, *_: object) -> bool:
        return self._free.acquire(blocking=False)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, *_: object) -> None:
        """Leave a client that went away or waited too long."""


@contextmanager
def serve(latest: Latest, port: int) -> Iterator[str]:
    """Serve JPEG pictures to browsers of this machine as a stream; yield the address.

    Raises an `OmnistereoError` if the port is in use or none.
    """
    if not 0 <= port <= 65535:
        raise OmnistereoError(f"--port is {port}; expected 0 to 65535. Choose another, or 0 for any.")

    class Handler(BaseHTTPRequestHandler):
        timeout = _PATIENCE_S

        def do_GET(self) -> None:
            if not _HOST.fullmatch(self.headers.get("Host", "")):
                self.send_error(403)
                return
            is_stream = self.path == "/stream"
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=x" if is_stream else "text/html")
            self.end_headers()
            self._stream() if is_stream else self.wfile.write(_PAGE)

        def _stream(self) -> None:
            for jpeg in latest:
                head = f"--x\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
                self.wfile.write(head.encode() + jpeg + b"\r\n")

        def log_message(self, *_: object) -> None:
            pass

    try:
        server = _Server(("127.0.0.1", port), Handler)
    except OSError:
        raise OmnistereoError(f"port {port} is in use. Choose another --port, or 0 for any.") from None
    Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/"
    finally:
        server.shutdown()
        server.server_close()
