"""Estimate the depth of a recording: a folder of images or a video per camera in, a data set with
depth out.

Examples:
  omnistereo record --rig rig.yaml --images front/ right/ back/ left/ --out walk
      every frame of folders of images; run it again to resume
  omnistereo record --rig rig.yaml --images front.mp4 right.mp4 back.mp4 left.mp4 --out drive
  --video drive/depth.mp4
      videos, with a video of surfaces, panorama and depth
methods: those of omnistereo depth
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import MISSING, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from omnistereo_lib.errors import OmnistereoError
from omnistereo_tools.commands.options import (
    DepthRange,
    FrameOptions,
    GridOptions,
    MethodOptions,
    RigOptions,
    StrictOptions,
    default_out,
    find_min_depth,
    mask_circles,
    read_rig_and_clocks,
    warn_of,
)
from omnistereo_tools.outputs import check_outputs, hold
from omnistereo_tools.parser import as_typed, option

if TYPE_CHECKING:
    from omnistereo_lib.geometry.rig import Rig
    from omnistereo_lib.stereo.depth import Depth
    from omnistereo_tools.input.sources import Recording
    from omnistereo_tools.record.recordings import DepthWriter
    from omnistereo_tools.record.watching import Watching

_FRAMES = re.compile("([0-9]{0,9}):([0-9]{0,9})(?::([1-9][0-9]{0,8})?)?")


@dataclass(frozen=True, kw_only=True)
class RecordOptions(StrictOptions, MethodOptions, DepthRange, GridOptions, RigOptions):
    """A recording, and what is written of it."""

    resumes = True

    rig: Path = option("rig file or folder", MISSING)
    images: tuple[Path, ...] = option(
        "one folder or video per camera, in the order of the rig", MISSING
    )
    grid: str = option(
        "columns, rows and spheres of the panorama; without rows a quarter of the columns", "640"
    )
    method: str | None = option("see above", unset="the best within 2 s a frame")
    frames: str | None = option(
        "numbers from START, without STOP, every STEP-th", unset="all", metavar="START:STOP:STEP"
    )
    skip_bad: bool = option("leave out frames that cannot be read; reads all first", False)
    sync: bool = option("measure how late each camera is from the images, and match by that", False)
    follow: bool = option("when a camera has turned, go on with its new pose", False)
    cluster: str | None = option("of a Dask scheduler, to use many machines", metavar="ADDRESS")
    out: Path | None = option("folder for the results", unset="out/record_NAME")
    video: Path | None = option(
        "surfaces, panorama and depth, 1920 x 1080, at most 20 MB a minute",
        suffixes=(".mp4", ".webm"),
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.frames is not None and not _FRAMES.fullmatch(self.frames):
            raise OmnistereoError(
                f"--frames is {self.frames}; expected START:STOP:STEP, such as 0:100, or ::5"
            )

    @property
    def chosen(self) -> tuple[int, int | None, int]:
        """First frame number, the one to stop before, and the step."""
        found = _FRAMES.fullmatch(self.frames or ":")
        assert found is not None  # `__post_init__` has looked
        start, stop, step = found.groups()
        return int(start or 0), int(stop) if stop else None, int(step or 1)


def run(options: RecordOptions) -> int:
    """Estimate depth for all frames that are not done yet, and write the video; return 1 if
    --strict is given and the rig and the images do not fit.
    """
    from omnistereo_tools.progress import progress_bar, say

    say("reading the rig and the first frames: a few seconds")
    from omnistereo_learn.provenance import kept_precision, read_facts
    from omnistereo_lib.frame import Frame
    from omnistereo_lib.stereo.methods import FRAME_METHOD, Method
    from omnistereo_lib.stereo.sweep import SphereSweep
    from omnistereo_tools.input.masks import FRAMES
    from omnistereo_tools.judge.coverage import Coverage
    from omnistereo_tools.judge.first_look import frame_doubts
    from omnistereo_tools.judge.pace import say_recording
    from omnistereo_tools.judge.trust import DOUBTFUL
    from omnistereo_tools.output.summary import fits, verdict
    from omnistereo_tools.record.recordings import (
        SETTINGS,
        DepthWriter,
        stored_method,
        stored_min_depth,
        write_video,
    )
    from omnistereo_tools.record.watching import Watching

    out = options.out or default_out("record", options.rig)
    _check(options, out)
    # Read: the rig, which frames there are, and the first of them.
    rig, clocks = read_rig_and_clocks(options, options.images)
    late, told = _late(options, out, rig, clocks)
    recording = _open_recording(options, rig, late)
    first = list(recording.read(sorted(recording.frames)[:FRAMES], rig))
    rig = mask_circles(rig, first)
    frame, coverage = Frame.of(rig, first[0]), Coverage.of(rig)
    stated = stored_min_depth(out) if options.min_depth is None else options.min_depth
    width, height, spheres = options.sizes
    # Stored as a data set, whose pixels are square, around the horizon.
    rows, min_depth = height or width // 4, find_min_depth(stated, frame)
    grid = coverage.propose(width, rows, num_spheres=spheres, min_depth=min_depth)
    # Check and say, before anything is written.
    doubts = frame_doubts(frame, grid)
    warn_of(doubts)
    doubt = told or (doubts[0] if doubts else None)
    sweep = SphereSweep(rig, grid, device=options.device)
    method = options.method or stored_method(out)
    first_method, with_video = Method.parse(method or FRAME_METHOD), options.video is not None
    precision = kept_precision("auto", read_facts(out / SETTINGS))
    writer = DepthWriter(out, recording, sweep, first_method, with_video, precision)
    writer.check_out()
    left, total = writer.left(), len(recording.frames)
    recording.check(left, rig)
    known: dict[int, Depth] = {}
    if options.cluster is None:
        method, found = say_recording(sweep, first[:2], len(left), method, precision)
        writer = replace(writer, method=Method.parse(method))
        known = dict(zip(sorted(recording.frames), found, strict=False))
    _prepare(options, writer, rig)
    if not left:
        say(f"all {total} frames are there already")
    # Compute and write.
    progress = progress_bar("frame")
    watching = Watching(rig, sweep, options.follow, out)
    numbers = _frames_done(options, writer, left, watching, known)
    for done, number in enumerate(numbers, total - len(left) + 1):
        progress(done, total, f"frame {number}")
    watching.close()
    share, of_near = writer.doubt_shares()
    print(verdict(share, grid.width, f" over {total} frames", doubt))
    print(
        f"Of the nearest tenth of rays of each frame, {of_near:.0f} % are doubtful. Doubtful rays"
        f" stay in the files, with values below {DOUBTFUL:g} in {writer.path('trust', 0).parent}/."
    )
    print(coverage.left_out(grid))
    print(f"{total} frames are in {out}/, which load_dataset reads")
    if options.video is not None:
        seconds = write_video(options.video, writer)
        print(f"written to {options.video}: {total} frames, {seconds:.1f} s")
    fitting = fits(share) and not doubt
    print(_next(options, out, fitting, bool(told)))
    return int(options.strict and not fitting)


def _next(options: RecordOptions, out: Path, fitting: bool, is_late: bool) -> str:
    """Return the command to go on with: `world`, or what helps where something is wrong."""
    if is_late:
        other = out.with_name(f"{out.name}_sync")
        return as_typed("record", RecordOptions, options, sync=True, out=other)
    if not fitting:
        from omnistereo_tools.commands.options import DoctorOptions

        return as_typed("doctor", DoctorOptions, options, rig=out, images=None)
    return str(options.video or shlex.join(["omnistereo", "world", str(out)]))


def _check(options: RecordOptions, out: Path) -> None:
    """Refuse --images of one frame, and results that would replace what is read."""
    from omnistereo_lib.parse import MAX_CAMERAS
    from omnistereo_tools.input.sources import of_recordings
    from omnistereo_tools.record.recordings import OF_RAYS, SETTINGS

    if not of_recordings(options.images):
        right = as_typed("depth", FrameOptions, options)
        raise OmnistereoError(
            f"{options.images[0]} is neither a folder nor a video. For one frame: {right}"
        )
    filled = [
        out / "video",
        *(out / f"cam{k}" for k in range(1, MAX_CAMERAS + 1)),
        *(out / f"{kind}_{options.sizes[0]}" for kind in OF_RAYS),
    ]
    check_outputs(options, [options.video, out / "config.yaml", out / SETTINGS], filled)


def _late(
    options: RecordOptions, out: Path, rig: Rig, clocks: Sequence[float] | None
) -> tuple[list[int], str | None]:
    """Return by how much the times of each camera are late, ns, and which are late still.

    A recording goes on with what it began with. Otherwise the rig file counts, then the images.
    """
    from omnistereo_rigs.images.moments import SECOND, in_words
    from omnistereo_tools.input.sources import Recording
    from omnistereo_tools.progress import say
    from omnistereo_tools.record.recordings import SETTINGS
    from omnistereo_tools.record.sync import check_moments, measure_late, stored_late

    if (out / SETTINGS).exists() and not (options.sync and not stored_late(out)):
        return stored_late(out), None
    late = list[int]()
    if clocks is not None and max(clocks) > min(clocks):
        late = [round(SECOND * (clocks[0] - shift)) for shift in clocks]
        told = ", ".join(in_words(-one) for one in late)
        if Recording.open(options.images).shared:
            say(f"the shifts of the clocks in the rig file are added to the times: {told}")
        else:
            say(f"the shifts of the clocks in the rig file are not used, as no times are: {told}")
            late = []
    if options.sync:
        say("measuring from the images how late each camera is: a minute")
        return measure_late(options.images, rig, late), None
    found, open_ = check_moments(options.images, rig, late)
    warn_of([f"{found}. Match by the images: --sync"] if found else [open_] if open_ else [])
    return late, found


def _open_recording(options: RecordOptions, rig: Rig, late: Sequence[int]) -> Recording:
    """Return the frames chosen, and say which are left out, with --skip-bad the unreadable, too."""
    from omnistereo_tools.input.sources import Recording
    from omnistereo_tools.progress import say

    recording = Recording.open(options.images, *options.chosen, late)
    for said in recording.said:
        say(said)
    for path, names in recording.missing.items():
        some = ", ".join(map(str, names[:8])) + " …" * (len(names) > 8)
        count = f"{len(names)} frame{'s' * (len(names) > 1)}"
        say(f"{path} lacks {count} that other cameras have; left out: {some}")
    if not options.skip_bad:
        return recording
    say(f"reading {len(recording.frames)} frames: a few seconds for a hundred")
    bad = recording.unreadable(rig)
    for number, why in bad.items():
        say(f"frame {number} is left out: {why}")
    frames = {number: key for number, key in recording.frames.items() if number not in bad}
    if not frames:
        raise OmnistereoError("no frame is left: none can be read. See above why")
    return replace(recording, frames=frames)


def _prepare(options: RecordOptions, writer: DepthWriter, rig: Rig) -> None:
    """Make the folders, and say which frames are computed again; the cluster must answer before."""
    from omnistereo_lib.files import make_folder
    from omnistereo_lib.stereo.device import check_memory
    from omnistereo_tools.progress import say

    # All costs of a frame are held at once, but for those of VolumeNet.
    if writer.method.cost != "volumenet":
        check_memory(len(rig), writer.sweep.grid, writer.sweep.device)
    if options.cluster is not None:
        from omnistereo_tools.record.cluster import connect

        connect(options.cluster).close()
    if options.video is not None:
        make_folder(options.video.parent)
    hold(writer.out)
    writer.check_settings(rig)
    for number, picture in writer.changed().items():
        say(f"frame {number} is computed again: {picture} has changed")
    writer.prepare(rig)


def _frames_done(
    options: RecordOptions,
    writer: DepthWriter,
    left: Sequence[int],
    watching: Watching,
    known: dict[int, Depth],
) -> Iterator[int]:
    """Compute the frames that are left, here or on the cluster; yield the number of each."""
    if options.cluster is None:
        return writer.run(left, watching, known)
    from omnistereo_tools.record.cluster import depth_on_cluster

    return depth_on_cluster(options.cluster, writer, options.device)
