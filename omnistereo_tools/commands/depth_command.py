"""Estimate the depth of one frame: images and a rig in; a page to look at, a viewer for the browser
and data out.

Examples:
  omnistereo depth
      the bundled sample
  omnistereo depth --rig rig.yaml --images 1.png 2.png 3.png 4.png --method sweepnet+sgm --out out
      your own images, with a method of your choice
  omnistereo depth --mesh out/scene.glb
      with a mesh that Blender and other programs open
methods: zncc, mccnn, sweepnet or volumenet; +sgm smooths; ,pairs=all and others change settings;
  or a Python file with a function `depth`, such as my_notebooks/mine/omnistereo.py
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from omnistereo_lib.errors import OmnistereoError
from omnistereo_tools.commands.options import (
    SAMPLE,
    DepthRange,
    DoctorOptions,
    FrameOptions,
    GridOptions,
    MethodOptions,
    StrictOptions,
    default_out,
    find_min_depth,
    make_grid,
    read_frame,
    warn_of,
)
from omnistereo_tools.commands.record_command import RecordOptions
from omnistereo_tools.outputs import check_outputs, hold, photo_and_colors
from omnistereo_tools.parser import as_typed, is_own, option

if TYPE_CHECKING:
    from omnistereo_lib.frame import Frame
    from omnistereo_lib.geometry.sphere import SphereGrid
    from omnistereo_lib.stereo.depth import Depth


_RADIANS = 6.3  # elevations up to this may have been meant in radians


@dataclass(frozen=True, kw_only=True)
class DepthOptions(StrictOptions, MethodOptions, DepthRange, GridOptions, FrameOptions):
    """What is written of one frame."""

    own_methods = True

    frame: int = option("frame of a data set, counted from 0", 0)
    phi: tuple[float, float] | None = option(
        "elevations in degrees, down is positive", unset="square pixels", metavar=("LOW", "HIGH")
    )
    out: Path | None = option("folder for the results", unset="out; with --rig out/depth_NAME")
    max_depth: float | None = option(
        "of points, metres", unset="the fourth sphere from infinity", between=(1e-6, 1e9)
    )
    beside: Path | None = option("another run, to compare with on the page", metavar="FOLDER")
    mesh: Path | None = option(
        "write a mesh: .glb (textured, y up) or .ply", suffixes=(".glb", ".ply")
    )
    equirectangular: Path | None = option(
        "depth as 2:1 TIFF for Blender, Nuke and GIS, pictures for viewers",
        suffixes=(".tiff", ".tif"),
    )
    crops: Path | None = option(
        "perspective crops with depth and transforms.json", metavar="FOLDER"
    )
    las: Path | None = option(
        "points for surveyors and GIS, z up; needs laspy", suffixes=(".las", ".laz")
    )
    up: Literal["z"] | None = option("of points and .ply: x forward, y left", unset="y is down")

    def __post_init__(self) -> None:
        from omnistereo_lib.geometry.sphere import SphereGrid

        super().__post_init__()
        if self.frame != 0 and self.images is not None:
            raise OmnistereoError("--frame is of a data set. Leave --frame or --images out")
        if self.phi is not None:
            SphereGrid(2, 2, self.phi)


def run(options: DepthOptions) -> int:
    """Estimate the depth of one frame, write everything, and say what came out, the verdict first;
    return 1 if --strict is given and the rig and the images do not fit.
    """
    from omnistereo_tools.progress import progress_bar, say

    say("reading the rig and the images: a few seconds")
    out = options.out or default_out("depth", options.rig)
    _check(options, out)
    if options.phi is not None and max(map(abs, options.phi)) <= _RADIANS:
        low, high = options.phi
        warn_of([f"--phi {low:g} {high:g} are degrees, a strip of {high - low:.3g}°: no radians"])
    # Read what there is before what is slow to import, and encode the images beside that.
    frame = read_frame(options, options.frame)
    from omnistereo_lib.files import make_folder
    from omnistereo_tools.output.webp import fisheye_images

    images = fisheye_images(frame.rig.cameras, frame.images)
    from omnistereo_lib.stereo.methods import FRAME_METHOD
    from omnistereo_tools.judge.coverage import Coverage
    from omnistereo_tools.judge.first_look import frame_doubts
    from omnistereo_tools.output.frame import FrameResult
    from omnistereo_tools.output.points import Limits
    from omnistereo_tools.output.viewer import read_page

    coverage = Coverage.of(frame.rig)
    min_depth = find_min_depth(options.min_depth, frame)
    grid = make_grid(options, coverage, min_depth, options.phi)
    gt_index = None if frame.gt_path is None else frame.gt_index(grid)
    # Check and say.
    doubts = frame_doubts(frame, grid)
    warn_of(doubts)
    doubt = doubts[0] if doubts else None
    hold(out)
    for file in filter(None, (options.mesh, options.equirectangular, options.las)):
        make_folder(file.parent)
    if options.crops is not None:
        make_folder(options.crops)
    method = options.method or FRAME_METHOD
    beside = None if options.beside is None else read_page(options.beside / "index.html")
    # Compute and write.
    depth = _compute(frame, grid, method, options.device)
    limits = Limits.of(depth, options.max_depth)
    result = FrameResult(depth, limits, method, gt_index, options.up, doubt, beside, images)
    if replaced := result.replaces(out):
        say(replaced)
    written = result.write(out, progress_bar())
    written += result.export(options.mesh, options.equirectangular, options.crops, options.las)
    print(*result.sentences, coverage.left_out(grid), sep="\n")
    print(f"written to {out}/: {', '.join(written)}")
    shown = {"images": tuple(frame.image_paths)} if options.frame else {}
    doctor = as_typed("doctor", DoctorOptions, options, rig=options.rig or SAMPLE, **shown)
    print(out / "index.html" if result.fits else doctor)
    return int(options.strict and not result.fits)


def _compute(frame: Frame, grid: SphereGrid, method: str, device: str) -> Depth:
    """Return the depth of a frame by a method of the library or a file; say how long it takes."""
    from omnistereo_tools.progress import progress_bar, say

    if is_own(method):
        from omnistereo_lib.stereo.sweep import SphereSweep
        from omnistereo_tools.own_method import run_own

        say(f"method: {method}, in a process of its own")
        own = run_own(Path(method), SphereSweep(frame.rig, grid, device=device), frame.images)
        say(f"it took {own.seconds:.1f} s")
        if not own.judged:
            say("it returns no confidence, so none of its depths is doubted")
        return own.depth
    from omnistereo_lib.stereo.pipeline import estimate_depth
    from omnistereo_tools.judge.pace import say_frame

    say_frame(method, frame, grid, device)
    return estimate_depth(frame, grid, method, device=device, progress=progress_bar())


def _check(options: DepthOptions, out: Path) -> None:
    """Refuse --images of a recording, and results that would replace what is read."""
    from omnistereo_tools.input.sources import of_recordings

    for path in of_recordings(options.images or ()):
        right = as_typed("record", RecordOptions, options)
        raise OmnistereoError(
            f"{path} holds many frames; expected one image per camera. For recordings: {right}"
        )
    files = [out / "overview.png", out / "index.html", options.mesh, options.las]
    files.append(options.equirectangular)
    if options.equirectangular is not None:
        files += photo_and_colors(options.equirectangular)
    folders = [out / "data"]
    if (crops := options.crops) is not None:
        files += [crops / "transforms.json", crops / "points.ply"]
        folders += [crops / "images", crops / "depth", crops / "masks"]
    check_outputs(options, files, folders)
    if options.las is not None:
        from omnistereo_tools.output.points import import_laspy

        import_laspy()
