"""Fuse a recording into one world: the path of the rig, one mesh, and depth that the other frames
have sharpened.

Examples:
  omnistereo record --rig rig.yaml --images front/ right/ back/ left/ --out drive
  omnistereo world drive
      drive/world/index.html shows it in any browser; run it again to resume
"""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import MISSING, dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omnistereo_lib.errors import OmnistereoError
from omnistereo_tools.commands.options import warn_of
from omnistereo_tools.outputs import check_outputs, hold
from omnistereo_tools.parser import Options, option

if TYPE_CHECKING:
    from omnistereo_lib.frame import Frame
    from omnistereo_lib.geometry.pose import Pose
    from omnistereo_tools.world.build import RecordedFrames
    from omnistereo_tools.world.fusion import View, Volume
    from omnistereo_tools.world.page import PageView

_USED = 0.9  # of the frames, in a world that is called good


@dataclass(frozen=True, kw_only=True)
class WorldOptions(Options):
    """A recording, and how it is fused."""

    resumes = True

    recording: Path = option("folder that omnistereo record has written", MISSING, positional=True)
    voxel: float = option("side of a voxel in metres", 0.15, between=(0.001, 100.0))
    range: float = option(
        "distance in metres up to which depth is fused", 30.0, between=(0.1, 10_000.0)
    )
    rrd: bool = option("write world.rrd, too, which Rerun plays", False)
    video: bool = option("write flight.mp4, too: along the path, 1920 x 1080", False)


def run(options: WorldOptions) -> None:
    """Find the path, fuse the frames, and write what comes of them."""
    from omnistereo_tools.progress import say

    say("reading the recording: a few seconds")
    from omnistereo_lib.files import checksum, read_bytes, write_text
    from omnistereo_tools.judge.first_look import image_doubts
    from omnistereo_tools.output.mesh_export import import_trimesh
    from omnistereo_tools.world.build import RecordedFrames

    import_trimesh()
    if options.rrd:
        from omnistereo_tools.world.rerun_export import import_rerun

        import_rerun()
    out = options.recording / "world"
    check_outputs(options, [out / "config.yaml"], out.glob("omnidepth_world_*"))
    frames = RecordedFrames.open(options.recording)
    refined = hold(out) / f"omnidepth_world_{frames.grid.width}"
    asked = {name: getattr(options, name) for name in ("voxel", "range", "rrd", "video")}
    asked["provenance"] = frames.provenance
    if _is_done(out, asked):
        print(f"Done already: the world is in {out}/; delete world.json there to fuse it again.")
        print(out / "index.html")
        return
    (out / "world.json").unlink(missing_ok=True)
    for k in sorted({0, len(frames.data) // 2, len(frames.data) - 1}):
        frame = frames.data[k]
        warn_of(f"frame {frame.number}: {doubt}" for doubt in image_doubts(frame, frames.grid))
    poses = frames.find_poses(out / "steps.json")
    views = dict(frames.each("colouring", poses, frames.view))
    volume = _make_volume(options, frames, views)
    frames.integrate(volume, views)
    frames.integrate(volume, views, frames.refine(volume, poses, refined))
    _write(options, frames, poses, volume, refined)
    written = {str(path.relative_to(out)): checksum(read_bytes(path)) for path in _results(out)}
    write_text(out / "world.json", json.dumps(asked | {"outputs": written}, indent=1) + "\n")


def _results(out: Path) -> list[Path]:
    """Return the files of a world, without links to images and what it knows of itself."""
    found = (path for path in out.rglob("[!.]*") if path.is_file())
    own = ("world.json", "steps.json")
    return sorted(
        p for p in found if p.name not in own and p.relative_to(out).parts[0][:3] != "cam"
    )


def _is_done(out: Path, asked: dict[str, Any]) -> bool:
    """Return whether every output is there, whole, and of these inputs; say what is not."""
    from omnistereo_learn.provenance import differences, read_facts
    from omnistereo_lib.files import checksum, read_bytes
    from omnistereo_tools.progress import say

    stored = read_facts(out / "world.json")
    outputs = stored.pop("outputs", None)
    if not isinstance(outputs, dict):
        return False
    wrong = differences(stored, asked)
    for name, sum_of in outputs.items():
        path = out / name
        if not path.is_file() or checksum(read_bytes(path)) != sum_of:
            wrong.append(f"{path} is {'not whole' if path.is_file() else 'missing'}")
    if wrong:
        say(f"the world in {out}/ is made again: {'; '.join(wrong[:5])}")
    return not wrong


def _make_volume(options: WorldOptions, frames: RecordedFrames, views: dict[int, View]) -> Volume:
    """Return an empty volume with room for all frames; refuse one that memory does not hold."""
    import numpy as np

    from omnistereo_lib.stereo.device import available_memory, select_device
    from omnistereo_tools.progress import say
    from omnistereo_tools.world.fusion import Volume, bytes_needed, touched_blocks

    keys = np.zeros(0, np.int64)
    for view in views.values():
        keys = np.union1d(keys, touched_blocks(view, frames.grid, options.voxel, options.range))
    if len(keys) == 0:
        raise OmnistereoError(
            f"no ray of {options.recording} is nearer than {options.range:g} m. Raise --range"
        )
    need, free = bytes_needed(keys, frames.channels), available_memory(select_device("cpu"))
    if need > free:
        raise OmnistereoError(
            f"not enough memory: needs {need / 2**30:.1f} GiB, {free / 2**30:.1f} GiB free. "
            "Pass a larger --voxel or a smaller --range."
        )
    say(f"fusing {len(views)} frames: {need / 2**30:.2g} GiB of memory")
    return Volume(keys, options.voxel, options.range, frames.channels)


def _write(
    options: WorldOptions,
    frames: RecordedFrames,
    poses: dict[int, Pose],
    volume: Volume,
    refined: Path,
) -> None:
    """Write the path, the meshes and the page, and what makes the refined depth a data set."""
    from omnistereo_lib.files import write_text
    from omnistereo_lib.frame import read_inverse_depth
    from omnistereo_lib.geometry.trajectory import trajectory_tum
    from omnistereo_tools.output.summary import GOOD, fits
    from omnistereo_tools.progress import say
    from omnistereo_tools.world.page import world_page, write_surface
    from omnistereo_tools.world.surface import extract_surface, seen_surface

    say("extracting the surface")
    out = refined.parent
    fused = ((T, read_inverse_depth(refined / f"{n:05}.tiff")) for n, T in poses.items())
    with ThreadPoolExecutor(1) as beside:
        views = beside.submit(_page_views, frames, poses, refined)
        surface = seen_surface(extract_surface(volume), fused, frames.grid)
    if len(surface.faces) == 0:
        raise OmnistereoError(
            f"no surface is left of {options.recording}. Pass a smaller --voxel or a larger --range"
        )
    write_surface(out, surface)
    if options.rrd:
        from omnistereo_tools.world.rerun_export import write_rrd

        write_rrd(out / "world.rrd", frames, poses, refined, surface)
    used, doubtful = len(poses) / len(frames.data), frames.doubtful_percent(poses)
    word = "Good" if used >= _USED and doubtful <= GOOD else "Fair" if fits(doubtful) else "Bad"
    which = f"all {len(poses)}" if used == 1 else f"{len(poses)} of {len(frames.data)}"
    verdict = (
        f"{word}: {which} frames fit together;"
        f" {doubtful:.0f} % of rays are doubtful and count little"
    )
    length = sum((a.inverse() @ b).magnitude()[1] for a, b in pairwise(poses.values()))
    drift, holes = frames.drift(poses), frames.holes_percent(volume, poses)
    sentences = [
        f"{holes:.0f} % of what is seen within {options.range:g} m has no surface."
        if round(holes)
        else f"Less than 1 % of what is seen within {options.range:g} m has no surface.",
        f"The path is {length:.1f} m long; where it returns it is off by {drift:.2f} m."
        if drift is not None
        else f"The path is {length:.1f} m long; its drift is unknown, as it does not return.",
    ]
    what = surface, poses, views.result(), frames.grid, options.range
    texts = {"index.html": world_page(*what, verdict, sentences)}
    texts["trajectory.txt"] = trajectory_tum(poses)
    if (times := frames.times) and times.keys() >= poses.keys():
        texts["trajectory_seconds.txt"] = trajectory_tum(poses, times)
    for name, text in texts.items():
        write_text(out / name, text)
    if options.video:
        from omnistereo_tools.record.recordings import write_film
        from omnistereo_tools.world.film import RATE, flight

        say("drawing the flight: half a second for each of its frames, 7 a metre")
        write_film(out / "flight.mp4", flight(*what), RATE)
    frames.link(out)
    print(f"{verdict}.", *sentences, f"The surface has {len(surface.faces)} triangles.", sep="\n")
    print(f"written to {out}/, which load_dataset reads")
    print(out / "index.html")


def _page_views(frames: RecordedFrames, poses: dict[int, Pose], refined: Path) -> list[PageView]:
    """Return frames along the path as the page shows them."""
    import numpy as np

    from omnistereo_lib.frame import read_inverse_depth
    from omnistereo_tools.output.pictures import sharp_panorama
    from omnistereo_tools.world.page import MOST_VIEWS, VIEW_WIDTH, PageView

    def page_view(frame: Frame, pose: Pose) -> PageView:
        after = read_inverse_depth(refined / f"{frame.number:05}.tiff")
        panorama = sharp_panorama(frames.depth(frame, after), VIEW_WIDTH)
        return PageView(frame.number, pose, panorama, frame.inverse_depth, after)

    numbers = list(poses)
    some = np.unique(np.linspace(0, len(numbers) - 1, MOST_VIEWS).astype(int))
    chosen = {numbers[k]: poses[numbers[k]] for k in some}
    return [view for _, view in frames.each("drawing", chosen, page_view)]
