"""Depth of a recording: a data set in the public layout that grows frame by frame, and can be
interrupted.

OUT/
  config.yaml                       the rig, with the nearest depth of the sweep
  cam1/00001.jpg …  cam2/ …         the images: links to your pictures, or frames of your videos
  confidence_640/00001.tiff         confidence of each ray, in [0, 1], as of a single frame
  trust_640/00001.tiff              the same at equal range, in [0, 1]; below 0.5 a ray is doubtful
  depth_estimate_640/00001.tiff     inverse depth, 1/m; written last, so that a frame is complete
                                    if it can be read
  poses/00001.json                  of a frame whose cameras stood otherwise, as --follow has found:
                                    its poses
  recording.json                    how the depth was computed, and its provenance
  times.json                        for each frame when it was taken, ns, where pictures or videos
                                    say so
  pictures.json                     for each frame, checksums of the pictures that its depth was
                                    computed from
  video/00001.jpg                   surfaces, panorama and depth, doubtful rays faded, with
                                    --video
"""

import json
import shutil
import warnings
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from omnistereo_learn.provenance import differences, made_of, notes, provenance, read_facts
from omnistereo_lib.dataset import read_poses, write_poses
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import atomic_write, checksum, make_folder, read_data, write_text
from omnistereo_lib.frame import read_inverse_depth, write_inverse_depth
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.lazy import lazy_property
from omnistereo_lib.parse import Section
from omnistereo_lib.pictures import read_image, write_image
from omnistereo_lib.rig_file import save_rig
from omnistereo_lib.stereo.depth import Depth
from omnistereo_lib.stereo.learned import Precision, choose_precision
from omnistereo_lib.stereo.methods import FRAME_METHOD, VIDEO_METHOD, Method
from omnistereo_lib.stereo.pipeline import sweep_depth
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_tools.input.masks import black_cameras
from omnistereo_tools.input.sources import Pictures, Recording
from omnistereo_tools.judge.trust import DOUBTFUL, trust
from omnistereo_tools.output.colors import ColorScale
from omnistereo_tools.output.pictures import FILM, draw_frame
from omnistereo_tools.output.summary import doubt_shares
from omnistereo_tools.progress import say
from omnistereo_tools.record.watching import Watching

_PENDING = 2  # frames read ahead, and frames waiting to be written: memory stays constant
OF_RAYS = ("confidence", "trust", "depth_estimate")  # panoramas of a frame, in the order of writing
SETTINGS = "recording.json"
PICTURES = "pictures.json"
TIMES = "times.json"
_SAMPLE = 4096  # bytes
# What browsers play, at a quality that can hardly be told from the pictures, of at most 20 MB a
# minute: 2.4 Mbit/s are 18.
CODECS = {
    ".mp4": (
        "libx264",
        {"crf": "20", "maxrate": "2400k", "bufsize": "1200k"},
        {"movflags": "faststart"},
    ),
    ".webm": ("libvpx-vp9", {"crf": "30", "b": "2400k", "row-mt": "1", "cpu-used": "4"}, {}),
}
_TURN = 2 * np.pi / 30  # radians per second of the video, of the eye around the rig
# FFmpeg converts RGB by the matrix of BT.601; without the tag a browser takes BT.709's.
_BT601, _VIDEO_RANGE = 6, 1
_FPS = 10.0  # of pictures, which do not say


@dataclass(frozen=True, eq=False)
class DepthWriter:
    """Writes the frames of one recording into a data set folder: nothing before `prepare`."""

    out: Path
    recording: Recording
    sweep: SphereSweep
    method: Method
    with_video: bool  #: keep a picture of every frame for `write_video`
    precision: Precision = "auto"  #: of networks; see `kept_precision`

    def path(self, kind: str, number: int) -> Path:
        """Return where a panorama is stored: "depth_estimate", "confidence" or "trust"."""
        return self.out / f"{kind}_{self.sweep.grid.width}" / f"{number:05}.tiff"

    def picture_path(self, number: int) -> Path:
        """Return where the video frame of a frame is stored."""
        return self.out / "video" / f"{number:05}.jpg"

    def is_done(self, number: int) -> bool:
        """Return whether all that is stored of a frame can be read."""
        try:
            whole = all(self.read(kind, number).shape == self.sweep.grid.shape for kind in OF_RAYS)
            read_poses(self.out, number)
            return whole and (not self.with_video or self.picture(number).shape[1::-1] == FILM)
        except OmnistereoError:
            return False

    @property
    def rate(self) -> Fraction:
        """Frames of the video in a second."""
        return Fraction(self.recording.fps or _FPS).limit_denominator(65535)

    def read(self, kind: str, number: int) -> NDArray[np.float32]:
        """Read a panorama of a frame, (H, W); see `path`."""
        return read_inverse_depth(self.path(kind, number))

    def picture(self, number: int) -> NDArray[np.uint8]:
        """Read the video frame of a frame, BGR."""
        picture = read_image(self.picture_path(number))
        return np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), np.uint8)

    def left(self) -> list[int]:
        """Return the frames that are not done yet, or whose pictures have changed since."""
        changed = self.changed()
        return [n for n in self.recording.frames if n in changed or not self.is_done(n)]

    def changed(self) -> dict[int, Path]:
        """Return the frames whose pictures have changed, and a picture that differs."""
        stored = read_facts(self.out / PICTURES)
        pairs = [(n, stored.get(str(n), marks), marks) for n, marks in self._marks.items()]
        return {n: self._pictures(n)[_first_other(old, new)] for n, old, new in pairs if old != new}

    def _pictures(self, number: int) -> list[Path]:
        key = self.recording.frames[number]
        return [s.files[key] if isinstance(s, Pictures) else s.path for s in self.recording.sources]

    @lazy_property
    def _marks(self) -> dict[int, list[str]]:
        """For each frame what tells its pictures, or videos, from others of the same names."""
        mark = cache(_mark)  # a video is the same for all frames
        return {number: list(map(mark, self._pictures(number))) for number in self.recording.frames}

    def run(
        self,
        numbers: Sequence[int],
        watching: Watching | None = None,
        known: dict[int, Depth] | None = None,
    ) -> Iterator[int]:
        """Estimate and write the depth of some frames, in ascending order; yield their numbers.

        Reading, computing and writing overlap; memory does not grow with the number of frames. The
        rig is looked at in between.

        Args:
            known: Depth of frames that is there already, by the method and the sweep; is emptied.

        Raises:
            OmnistereoError: If a frame cannot be read, does not fit the rig, or cannot be written.
        """
        images_of = self.recording.read(numbers, self.sweep.rig)
        with ThreadPoolExecutor(1) as reader, ThreadPoolExecutor(1) as pool:
            read = deque(reader.submit(next, images_of) for _ in numbers[:_PENDING])
            written = deque[Future[None]]()
            for k, number in enumerate(numbers):
                images = read.popleft().result()
                if k + _PENDING < len(numbers):
                    read.append(reader.submit(next, images_of))
                if told := black_cameras(images):
                    say(f"frame {number}: {told}")
                sweep = self.sweep if watching is None else watching.sweep_of(number, images)
                depth = known.pop(number, None) if known else None  # and free its memory
                if depth is None or depth.sweep is not sweep:
                    depth = sweep_depth(sweep, images, self.method, precision=self.precision)
                written.append(pool.submit(self.write, number, images, depth))
                if len(written) > _PENDING:
                    written.popleft().result()
                yield number
            for writing in written:
                writing.result()

    def check_out(self) -> None:
        """Raise an `OmnistereoError` if a rig file is there that no recording has written."""
        if (self.out / "config.yaml").exists() and not (self.out / SETTINGS).exists():
            raise OmnistereoError(
                f"{self.out} holds a config.yaml but no {SETTINGS}; expected a new folder or that"
                " of a recording. Choose another --out."
            )

    def settings(self, rig: Rig) -> dict[str, Any]:
        """Return what decides the numbers of a recording, as it is stored with them."""
        grid, network = self.sweep.grid, self.method.has_weights
        sizes: dict[str, Any] = {"width": grid.width, "height": grid.height}
        sizes["spheres"] = grid.num_spheres
        precision = choose_precision(self.precision, self.sweep.device) if network else None
        threads = torch.get_num_threads() if network else None
        pictures, method = self.recording.checksum, self.method.name
        made = provenance(rig, pictures, method, precision, threads)
        if any(self.recording.late):
            sizes["late_s"] = [late / 1e9 for late in self.recording.late]
        return sizes | {"min_depth": grid.min_depth, "depth": ".tiff", "provenance": made}

    def check_settings(self, rig: Rig) -> None:
        """Raise an `OmnistereoError` if `out` holds a recording with other settings."""
        settings, path = self.settings(rig), self.out / SETTINGS
        stored = read_facts(path) if path.exists() else settings
        if other := differences(stored, settings):
            raise OmnistereoError(
                f"{path} is of a recording with other settings: {'; '.join(other)}."
                " Choose another --out, or the same rig, images and options as there."
            )
        for words in notes(stored, settings):
            warnings.warn(
                f"{words}: the last digits of the frames that follow may differ", stacklevel=2
            )

    def prepare(self, rig: Rig) -> None:
        """Make the folder `out`, or continue the recording that is in it: see `check_settings`.

        Raises an `OmnistereoError` if it cannot be written to.
        """
        if not (make_folder(self.out) / SETTINGS).exists():
            write_text(self.out / SETTINGS, json.dumps(self.settings(rig), indent=1) + "\n")
        cameras = [self.out / f"cam{k}" for k in range(1, len(rig) + 1)]
        for folder in (*cameras, *(self.path(kind, 0).parent for kind in OF_RAYS)):
            make_folder(folder)
        if self.with_video:
            make_folder(self.out / "video")
        save_rig(replace(rig, min_depth=self.sweep.grid.min_depth), self.out / "config.yaml")
        for number in self.changed():
            self.path(OF_RAYS[-1], number).unlink(missing_ok=True)  # so that the frame is not done
        marks = read_facts(self.out / PICTURES) | {
            str(number): marks for number, marks in self._marks.items()
        }
        write_text(self.out / PICTURES, json.dumps(marks) + "\n")
        if own := {str(number): time for number, time in self.recording.times.items()}:
            times = read_facts(self.out / TIMES) | own
            write_text(self.out / TIMES, json.dumps(times) + "\n")

    def write(self, number: int, images: list[NDArray[np.uint8]], depth: Depth) -> None:
        """Write images, video frame and depth of one frame."""
        sources = self.recording.sources
        for k, image in enumerate(images, 1):
            folder, source = self.out / f"cam{k}", sources[min(k, len(sources)) - 1]
            if isinstance(source, Pictures) and len(sources) == len(images):
                _link(source.files[self.recording.frames[number]], folder, number)
            else:
                write_image(folder / f"{number:05}.jpg", image)
        own = depth.sweep.rig.T_rig_cam
        write_poses(self.out, number, None if own == self.sweep.rig.T_rig_cam else own)
        trusted = trust(depth)
        if self.with_video:
            note = f"{self.out.name}, frame {number}, {self.method.name}"
            # the same colours in all frames
            scale = ColorScale(0.0, 0.8 / self.sweep.grid.min_depth)
            turn = _TURN * list(self.recording.frames).index(number) / self.rate
            picture = draw_frame(depth, None, trusted, scale, note, float(turn))
            write_image(self.picture_path(number), picture)
        write_inverse_depth(self.path("confidence", number), depth.confidence)
        write_inverse_depth(self.path("trust", number), trusted)
        write_inverse_depth(self.path("depth_estimate", number), depth.inverse_depth)

    def doubt_shares(self) -> tuple[float, float]:
        """Return how many percent of all rays are doubtful, and of each frame's nearest tenth."""
        shares = []
        for number in self.recording.frames:
            with np.errstate(divide="ignore"):
                depth = 1 / self.read("depth_estimate", number)
            shares.append(doubt_shares(depth, self.read("trust", number) < DOUBTFUL)[:2])
        share, of_near = np.mean(shares, axis=0)
        return float(share), float(of_near)


def _link(picture: Path, folder: Path, number: int) -> None:
    """Link a picture into the data set; copy it where the file system has no links."""
    target = folder / f"{number:05}{picture.suffix}"
    if target.exists() and target.samefile(picture):
        return
    try:
        target.unlink(missing_ok=True)  # a link to what is no longer there, or a copy
        target.symlink_to(picture.resolve())
    except OSError:
        with atomic_write(target) as temporary:
            shutil.copyfile(picture, temporary)


def _mark(path: Path) -> str:
    """Return a checksum of a file's name, size and time, and of samples of its content."""
    status, sample = path.stat(), b""
    if path.is_file():  # a pipe would wait for its other end
        with path.open("rb") as file:
            for place in (0, status.st_size // 2, max(0, status.st_size - _SAMPLE)):
                file.seek(place)
                sample += file.read(_SAMPLE)
    return checksum(f"{path.name} {status.st_size} {status.st_mtime_ns}".encode() + sample)[:16]


def _first_other(old: object, new: list[str]) -> int:
    """Return the place of the first mark that differs; what is stored may be anything."""
    known = old if isinstance(old, list) and len(old) == len(new) else [None] * len(new)
    return next(k for k, (one, other) in enumerate(zip(known, new, strict=True)) if one != other)


def stored_min_depth(out: Path) -> float | None:
    """Return the nearest depth of the recording in a folder; None if there is none."""
    try:
        return Section(read_data(out / SETTINGS)).number("min_depth")
    except OmnistereoError:  # what is damaged is named when the settings are compared
        return None


def stored_method(out: Path) -> str | None:
    """Return the method of the recording in a folder, if it is a default; else None."""
    found = made_of(read_facts(out / SETTINGS)).get("method")
    return found if found in (FRAME_METHOD, VIDEO_METHOD) else None


def write_video(path: Path, writer: DepthWriter) -> float:
    """Write the pictures of a recording as a video; return how many seconds it plays."""
    pictures = map(writer.picture, writer.recording.frames)
    return write_film(path, pictures, writer.rate)


def write_film(path: Path, pictures: Iterable[NDArray[np.uint8]], rate: Fraction) -> float:
    """Write pictures (H, W, 3), BGR, as a video: H.264 in .mp4, VP9 in .webm, tagged with its
    matrix, its index in front, so that browsers show its colours at once.

    Return how many seconds it plays.

    Raises an `OmnistereoError` if it cannot be written; a video that was there is kept then.
    """
    import av

    codec, quality, front = CODECS[path.suffix.lower()]
    with atomic_write(path) as temporary:
        try:
            with av.open(str(temporary), "w", options=front) as container:
                stream = container.add_stream(codec, rate=rate, options=quality)
                assert isinstance(stream, av.VideoStream)
                context = stream.codec_context
                context.colorspace = context.color_primaries = context.color_trc = _BT601
                context.color_range = _VIDEO_RANGE
                for k, picture in enumerate(pictures):
                    if k == 0:
                        stream.height, stream.width = picture.shape[:2]
                        stream.pix_fmt = "yuv420p"
                    frame = av.VideoFrame.from_ndarray(picture, "bgr24")
                    frame.pts, frame.time_base = k, 1 / rate
                    container.mux(stream.encode(frame))
                container.mux(stream.encode())
        except (OSError, ValueError) as error:  # what av raises are both
            raise OmnistereoError(f"{path} cannot be written: {error}") from None
    return float((k + 1) / rate)
