"""Live view: panorama and depth of cameras or videos in the browser, as fast as it goes."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Condition, Event, Thread
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.consumer_images import split_image
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.stereo.depth import Depth
from omnistereo_lib.stereo.methods import Method
from omnistereo_lib.stereo.pipeline import sweep_depth
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_tools.input.sources import Pictures, Recording
from omnistereo_tools.judge.ray import explain, told
from omnistereo_tools.judge.trust import trust
from omnistereo_tools.output.blend import estimate_gains
from omnistereo_tools.output.colors import ColorScale
from omnistereo_tools.output.pictures import FILM, draw_frame, panes
from omnistereo_tools.record.watching import Watching

_PATIENCE_S = 10.0  # of a browser that neither asks nor reads
_LEAVING_S = 5.0  # for each of two threads: a frame that is left would end the process badly
# a name of another site may lead here, too
_HOST = re.compile(r"(localhost|127\.0\.0\.1)(:[0-9]+)?")
_PAGE = Path(__file__).parent / "output" / "page" / "live.html"
_PORT = 8765  # or any free one
PART = b"--x\r\nContent-Type: image/jpeg\r\n\r\n"  # before each picture of the stream
_FPS = 5.0  # of pictures, which do not say
_TURNS_S = 2 * np.pi / 30  # radians per second, of the eye around the rig
_EQUALISED = 16  # frames from one look at how bright the cameras are to the next


@dataclass(frozen=True, eq=False)
class LivePicture:
    """What the browser shows: surfaces, panorama and depth, a line of text and a scale."""

    jpeg: bytes
    depth: Depth

    def ray_at(self, x: float, y: float) -> tuple[int, int] | None:
        """Return row and column of the ray at a place of the picture, 0 to 1; None outside."""
        grid, (top, rows) = self.depth.grid, panes(self.depth.grid)
        down = (y * FILM[1] - top) / rows
        inside = 0 <= down < 1 and 0 <= x < 1
        return (int(down * grid.height), int(2 * x % 1 * grid.width)) if inside else None

    def depth_at(self, x: float, y: float) -> str:
        """Return the depth in words at a place of the picture."""
        if (ray := self.ray_at(x, y)) is None:
            return ""
        depth = self.depth.depth[ray]
        return "no depth here" if np.isnan(depth) else f"{told(float(depth))} along the ray"

    def why_at(self, x: float, y: float) -> str:
        """Return why the ray at a place of the picture has its depth, one sentence."""
        ray = self.ray_at(x, y)
        return "" if ray is None else explain(self.depth, column=ray[1], row=ray[0]).sentence


class Latest:
    """A value that one thread renews and others wait for; who is slow misses values."""

    def __init__(self) -> None:
        self._changed = Condition()
        self._value: Any = None
        self._number = 0
        self.closed = False
        self.watched = Event()  #: set when somebody begins to look

    def put(self, value: Any) -> None:
        """Renew the value."""
        with self._changed:
            self._value, self._number = value, self._number + 1
            self._changed.notify_all()

    def close(self) -> None:
        """Tell everybody that no value will follow."""
        with self._changed:
            self.closed = True
            self._changed.notify_all()

    @property
    def newest(self) -> Any:
        """The newest value, None before the first."""
        return self._value

    def __iter__(self) -> Iterator[Any]:
        """Yield the newest value, whenever there is a newer one, until it is closed."""
        seen = 0
        self.watched.set()
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
        sources: For each camera of the rig an index of OpenCV, such as 0, the path of a device,
            such as /dev/v4l/by-id/…, the address of a stream, such as rtsp://…, or else a video
            file. One alone gives the images of all cameras, see `split_image`.
        rig: Its image sizes are asked of the cameras.
        loop: Videos begin again when they have ended, pictures go back and forth.

    Raises:
        OmnistereoError: If there is not one source per camera, or one cannot be opened.

    Attributes:
        first: The first picture of each, RGB: what is black, how near things are and how bright the
            cameras are.
    """

    def __init__(self, sources: Sequence[int | str], rig: Rig, loop: bool = False) -> None:
        if len(sources) not in (1, len(rig)):
            raise OmnistereoError(
                f"there are {len(sources)} cameras or videos for a rig of {len(rig)}. Give one for"
                " each."
            )
        self.rig, self.loop = rig, loop
        numbers = [source for source in sources if _is_camera(source)]
        paths = [Path(str(source)) for source in sources if not _is_camera(source)]
        if numbers and paths:
            raise OmnistereoError(
                "found cameras and videos; expected either. Record the cameras, or give all videos"
            )
        # Videos play at their own speed, moment by moment; cameras set it themselves.
        self.recording = Recording.open(paths) if paths else None
        self.period = 0.0 if self.recording is None else 1 / (self.recording.fps or _FPS)
        sizes = [camera.image_size for camera in rig.cameras]
        self._names, self._alone = numbers, len(sources) < len(rig)
        self._devices = [
            _open(one, None if self._alone else size)
            for one, size in zip(numbers, sizes, strict=False)
        ]
        self.first = next(self._moments())
        self.newest = Latest()
        self._going, self._single = Event(), False
        self._going.set()

    def play(self) -> None:
        """Go on after a pause."""
        self._going.set()

    def pause(self) -> None:
        """Keep the picture: a video waits, a camera goes on unseen."""
        self._going.clear()

    def step(self) -> None:
        """Take one more picture, and pause."""
        self._single = True
        self._going.set()

    def close(self) -> None:
        """End `read`."""
        self.newest.close()
        self._going.set()

    def read(self) -> None:
        """Read until videos end, or `close`; meant for a thread."""
        due = time.monotonic()
        for images in self._moments():
            if self.period and not self._going.is_set():
                self._going.wait()
                due = time.monotonic()
            if self.newest.closed:
                break
            if self._going.is_set():
                self.newest.put(images)
            if self._single:
                self._single = False
                self._going.clear()
            due += self.period
            time.sleep(max(0.0, due - time.monotonic()))

    def _moments(self) -> Iterator[list[NDArray[np.uint8]]]:
        """Yield the images of all cameras, RGB, of one moment after the other."""
        if self.recording is not None:
            frames = list(self.recording.frames)
            if self.loop and all(isinstance(one, Pictures) for one in self.recording.sources):
                frames += frames[-2:0:-1]
            yield from self.recording.read(frames, self.rig)
            while self.loop:
                yield from self.recording.read(frames, self.rig)
        while self._devices:
            # First grab all, then decode: they are nearer in time.
            grabbed = [device.grab() for device in self._devices]
            pictures = [device.retrieve()[1] for device in self._devices]
            for name, is_there, picture in zip(self._names, grabbed, pictures, strict=True):
                if not is_there or picture is None:
                    raise OmnistereoError(
                        f"camera {name} gives no picture. Check its cable, and that nothing else"
                        " uses it."
                    )
            images = [
                np.asarray(cv2.cvtColor(one, cv2.COLOR_BGR2RGB), np.uint8) for one in pictures
            ]
            yield split_image(images[0], self.rig, str(self._names[0])) if self._alone else images


def _is_camera(source: int | str) -> bool:
    """Return whether a source is a camera or a stream, and no file."""
    return isinstance(source, int) or "://" in source or source.startswith("/dev/")


def _open(source: int | str, image_size: tuple[int, int] | None) -> cv2.VideoCapture:
    """Open a camera, which is asked for the size of the images of the rig."""
    # OpenCV knows /dev/video0, but none of the links to it.
    is_link = str(source).startswith("/dev/")
    capture = cv2.VideoCapture(str(Path(str(source)).resolve()) if is_link else source)
    if not capture.isOpened():
        raise OmnistereoError(
            f"camera {source} cannot be opened. Check that it exists and is not in use."
        )
    if image_size is not None:
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, image_size[0])
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, image_size[1])
    return capture


def live_pictures(
    cameras: Cameras, sweep: SphereSweep, method: str | Method, watching: Watching | None = None
) -> Generator[LivePicture]:
    """Return pictures until a source ends; tables and kernels are ready when the first one is asked
    for.

    In between, the rig is looked at.
    """
    method = Method.parse(method)
    depth = sweep_depth(sweep, cameras.first, method)
    draw_frame(depth, None, depth.confidence, ColorScale.of(depth.inverse_depth), "", 0.0)
    return _play(cameras, sweep, method, watching)


def _play(
    cameras: Cameras, sweep: SphereSweep, method: Method, watching: Watching | None
) -> Generator[LivePicture]:
    """Read, compute depth and draw at the same time, each the newest there is."""
    scale, computed = ColorScale(0.0, 0.8 / sweep.grid.min_depth), Latest()
    failed = list[Exception]()

    def compute() -> None:
        for number, images in enumerate(cameras.newest):
            now = watching.sweep_of(number, images) if watching else sweep
            computed.put(sweep_depth(now, images, method))

    def work(part: Callable[[], None], made: Latest) -> None:
        """Do a part, to its end or its failure: who waits for what it makes is told."""
        try:
            part()
        except Exception as error:
            failed.append(error)
        finally:
            made.close()

    parts = (cameras.read, cameras.newest), (compute, computed)
    threads = [Thread(target=work, args=part, daemon=True) for part in parts]
    for thread in threads:
        thread.start()
    began = before = time.monotonic()
    try:
        for number, depth in enumerate(computed):
            if number % _EQUALISED == 0:
                gains = estimate_gains(depth)
            now = time.monotonic()
            note = f"{method.label}: {1 / (now - before):.1f} frames/s"
            before = now
            turn = _TURNS_S * (now - began)
            yield draw_picture(depth, gains, trust(depth), scale, note, turn)
        if failed:
            raise failed[0]
    finally:
        cameras.close()
        # Daemons: a frame that takes longer is left.
        for thread in threads:
            thread.join(_LEAVING_S)
        if watching is not None:
            watching.close(wait=False)


def draw_picture(
    depth: Depth,
    gains: NDArray[Any],
    trusted: NDArray[np.float32],
    scale: ColorScale,
    note: str,
    turn: float = 0.0,
) -> LivePicture:
    """Return `draw_frame` as the browser gets it."""
    picture = draw_frame(depth, gains, trusted, scale, note, turn)
    jpeg = cv2.imencode(".jpg", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))[1].tobytes()
    return LivePicture(jpeg, depth)


class _Server(ThreadingHTTPServer):
    def handle_error(self, *_: object) -> None:
        """Leave a client that went away or waited too long."""


def _place(query: str) -> tuple[float, float] | None:
    """Return the two coordinates of a query; None if it has others."""
    with suppress(ValueError):
        x, y = map(float, query.split("&"))
        return (x, y) if abs(x) < 1e6 and abs(y) < 1e6 else None
    return None


@contextmanager
def serve(latest: Latest, cameras: Cameras | None = None) -> Iterator[str]:
    """Serve live pictures to browsers of this machine as a stream of JPEG; yield the address.

    Browsers may pause the cameras, if there are any.
    """
    actions = (cameras.play, cameras.pause, cameras.step) if cameras else ()
    controls = {f"/{action.__name__}": ("text/plain", action) for action in actions}

    class Handler(BaseHTTPRequestHandler):
        timeout = _PATIENCE_S

        def do_GET(self) -> None:
            name, _, query = self.path.partition("?")
            of_other_sites = self.headers.get("Sec-Fetch-Site", "none") not in (
                "same-origin",
                "none",
            )
            host = self.headers.get("Host", "")
            of_other_sites |= self.headers.get("Origin", f"http://{host}") != f"http://{host}"
            if not _HOST.fullmatch(host) or (name != "/" and of_other_sites):
                self.send_error(403)
            elif name in ("/depth", "/why") and _place(query) is None:
                self.send_error(400)
            else:
                self._answer(name, _place(query))

        def _answer(self, name: str, place: tuple[float, float] | None) -> None:
            content, send = {
                "/stream": ("multipart/x-mixed-replace; boundary=x", self._stream),
                "/depth": (
                    "text/plain; charset=utf-8",
                    lambda: self._tell(LivePicture.depth_at, place),
                ),
                "/why": (
                    "text/plain; charset=utf-8",
                    lambda: self._tell(LivePicture.why_at, place),
                ),
                "/top": ("text/plain", self._top),
                **controls,
            }.get(name, ("text/html", lambda: self.wfile.write(_PAGE.read_bytes())))
            self.send_response(200)
            self.send_header("Content-Type", content)
            # no page of another site shows it
            self.send_header("Cross-Origin-Resource-Policy", "same-origin")
            self.end_headers()
            send()

        def _tell(self, words: Callable[..., str], place: tuple[float, float] | None) -> None:
            picture = latest.newest  # none before the first
            if picture is not None and place is not None:
                self.wfile.write(words(picture, *place).encode())

        def _top(self) -> None:
            """Tell the first row of the panoramas, when there is a picture."""
            self.wfile.write(str(panes(next(iter(latest)).depth.grid)[0]).encode())

        def _stream(self) -> None:
            self.wfile.write(PART)
            for picture in latest:
                # A browser shows a picture when the head of the next one has come.
                self.wfile.write(picture.jpeg + b"\r\n" + PART)

        def log_message(self, *_: object) -> None:
            pass

    try:
        server = _Server(("127.0.0.1", _PORT), Handler)
    except OSError:  # another live view has it
        server = _Server(("127.0.0.1", 0), Handler)
    Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/"
    finally:
        latest.close()
        server.shutdown()
        server.server_close()
