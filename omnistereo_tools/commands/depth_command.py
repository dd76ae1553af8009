"""Estimate depth: images and a rig in; a page to look at, a viewer for the browser and data out.

Examples:
  omnistereo depth
      the bundled sample
  omnistereo depth --rig rig.yaml --images 1.png 2.png 3.png 4.png --method sweepnet+sgm --out out
      your own images, with a method of your choice
  omnistereo depth --mesh out/scene.glb
      with a mesh that Blender and other programs open
  omnistereo depth --rig rig.yaml --images front/ right/ back/ left/ --out recording --video recording/depth.mp4
      every frame of folders of pictures, or of videos; run it again to resume
methods: zncc, mccnn, sweepnet or volumenet; +sgm smooths; ,pairs=all and others change settings
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from omnistereo_lib.errors import OmnistereoError, check_number
from omnistereo_tools.commands.options import (
    SPHERES,
    WIDTH,
    add_device,
    add_grid,
    add_images,
    add_rig,
    check_typed,
    make_grid,
    mask_circles,
    read_frame,
    read_masked_rig,
)
from omnistereo_tools.outputs import check_outputs, hold

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from omnistereo_lib.geometry.rig import Rig
    from omnistereo_lib.geometry.sphere import SphereGrid
    from omnistereo_tools.input.sources import Recording

# Options of one kind of input; None where they are not given.
_OF_FRAMES = ("frame", "max_depth", "min_confidence", "mesh", "mesh_faces", "equirectangular", "crops", "all_crops")
_SHARED = ("config", "calibration", "kalibr", "opencv", "camchain")  # names that the files of many rigs have
_OF_RECORDINGS = ("start", "stop", "step", "skip_bad", "cluster", "depth_format", "video")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_rig(parser, help="rig file, folder of one, or data set (default: the bundled sample)")
    add_images(parser, each="image, folder of images or video")
    add_grid(parser, width=WIDTH, height=None, spheres=SPHERES)
    parser.add_argument("--method", help="default: for a frame the most exact, for a recording one that keeps pace")
    add_device(parser, precision=False)
    parser.add_argument("--out", type=Path, help="folder for the results (default: out; with --rig out/depth_NAME)")
    frame = parser.add_argument_group("one frame")
    frame.add_argument("--max-depth", type=float, help="of points, metres (default: the fourth sphere from infinity)")
    frame.add_argument("--min-confidence", type=float, help="of points (default: 0; doubtful ones are marked)")
    frame.add_argument("--mesh", type=Path, metavar="FILE", help="write a mesh as well: .glb (textured, y up) or .ply")
    frame.add_argument("--mesh-faces", type=int, metavar="N", help="decimate the mesh to N triangles")
    frame.add_argument("--equirectangular", type=Path, metavar="FILE", help="write depth as 2:1 TIFF, for 360° viewers")
    frame.add_argument("--crops", type=Path, metavar="FOLDER", help="perspective crops with depth and transforms.json")
    frame.add_argument("--all-crops", action="store_true", default=None, help="crops up to the rim, above and below")
    recording = parser.add_argument_group("recordings")
    recording.add_argument("--start", type=int, metavar="N", help="first frame number (default: 0)")
    recording.add_argument("--stop", type=int, metavar="N", help="frame number to stop before (default: the end)")
    recording.add_argument("--step", type=int, metavar="N", help="every N-th frame (default: 1)")
    recording.add_argument(
        "--skip-bad", action="store_true", default=None, help="leave out frames that cannot be read; reads all first"
    )
    recording.add_argument("--cluster", metavar="ADDRESS", help="of a Dask scheduler, to use many machines")
    recording.add_argument("--depth-format", choices=["tiff", "png"], help="float32 (default), or 16 bits")
    recording.add_argument("--video", type=Path, metavar="FILE", help="panorama over depth: .mp4, or browsers' .webm")


def run(options: argparse.Namespace) -> None:
    """Estimate the depth of one frame or of a recording."""
    print("reading the rig and the images: a few seconds", flush=True)
    from omnistereo_tools.input.sources import is_recording

    check_typed(options)
    options.out = options.out or _default_out(options.rig)
    if options.images is not None and is_recording(options.images):
        _refuse(options, _OF_FRAMES, "one frame; --images are folders or videos")
        _run_recording(options)
    else:
        _refuse(options, _OF_RECORDINGS, "recordings; expected --images with a folder or a video per camera")
        _run_frame(options)


def _default_out(rig: Path | None) -> Path:
    """Return a folder for the results of a rig, so that no rig overwrites those of another, or of the sample."""
    if rig is None:
        return Path("out")
    rig = rig.resolve()
    if rig.name in ("train", "test"):
        return Path("out", f"depth_{rig.parent.name}-{rig.name}")
    return Path("out", f"depth_{rig.parent.name if rig.stem in _SHARED and rig.suffix else rig.stem}")


def _refuse(options: argparse.Namespace, names: Sequence[str], purpose: str) -> None:
    """Raise an `OmnistereoError` if one of the options is given: it would be ignored."""
    for name in names:
        if getattr(options, name) is not None:
            raise OmnistereoError(f"--{name.replace('_', '-')} is for {purpose}. Leave it out, or change --images.")


def _run_frame(options: argparse.Namespace) -> None:
    """Estimate depth for one frame, write everything, and say what came out."""
    from omnistereo_lib.stereo.methods import FRAME_METHOD
    from omnistereo_lib.stereo.pipeline import estimate_depth
    from omnistereo_tools.judge.pace import progress_bar, say_frame
    from omnistereo_tools.output.exports import export_frame
    from omnistereo_tools.output.frame import FrameResult
    from omnistereo_tools.output.points import Limits

    _check_frame_options(options)
    _check_frame_outputs(options)
    frame = read_frame(options)
    grid = _choose_grid(options, frame.rig, frame.images)
    # Fail fast: read the ground truth and make the folders.
    gt_index = None if frame.gt_path is None else frame.gt_index(grid)
    _make_folders(options)
    method = options.method or FRAME_METHOD
    say_frame(method, grid, options.device)
    depth = estimate_depth(frame, grid, method, device=options.device, progress=progress_bar())
    result = FrameResult(depth, Limits.of(depth, options.max_depth, options.min_confidence), method, gt_index)
    written = result.write(options.out, progress_bar())
    written += export_frame(
        result, options.mesh, options.mesh_faces, options.equirectangular, options.crops, bool(options.all_crops)
    )
    print("\n".join(result.sentences()))
    print(f"written to {options.out}/: {', '.join(written)}")


def _make_folders(options: argparse.Namespace) -> None:
    from omnistereo_lib.files import make_folder

    hold(options.out)
    files = (options.mesh, options.equirectangular)
    for folder in (options.crops, *(file and file.parent for file in files)):
        if folder is not None:
            make_folder(folder)


def _check_frame_options(options: argparse.Namespace) -> None:
    """Raise an `OmnistereoError` if an option of a frame has a value that it cannot have."""
    from omnistereo_tools.output.exports import check_suffixes

    check_suffixes(mesh=options.mesh, equirectangular=options.equirectangular)
    if options.max_depth is not None:
        check_number(options.max_depth, "--max-depth", 1e-6, 1e9)
    if options.min_confidence is not None:
        check_number(options.min_confidence, "--min-confidence", 0, 1)
    if options.all_crops and options.crops is None:
        raise OmnistereoError("--all-crops says which crops; found no --crops. Add --crops FOLDER, or leave it out.")
    if options.mesh_faces is not None:
        check_number(options.mesh_faces, "--mesh-faces", 1, 10**9, whole=True)
        if options.mesh is None:
            raise OmnistereoError("--mesh-faces decimates a mesh; found no --mesh. Add --mesh FILE, or leave it out.")


def _check_frame_outputs(options: argparse.Namespace) -> None:
    """Raise an `OmnistereoError` if a file of the results would replace one that is read."""
    out, crops = options.out, options.crops
    files = [out / "overview.png", out / "index.html", options.mesh, options.equirectangular]
    folders = [out / "data"]
    if crops is not None:
        files.append(crops / "transforms.json")
        folders += [crops / "images", crops / "depth", crops / "masks"]
    check_outputs(options, files, folders)


def _choose_grid(options: argparse.Namespace, rig: Rig, images: Sequence[NDArray[np.uint8]]) -> SphereGrid:
    """Return the recommended grid, say what it leaves out, and warn of doubtful input."""
    from omnistereo_tools.judge.coverage import Coverage
    from omnistereo_tools.judge.doubts import image_doubts, rig_doubts

    grid = make_grid(options, rig, images)
    print(Coverage.of(rig).left_out(grid))
    for doubt in (*rig_doubts(rig, grid.min_depth), *image_doubts(rig, images, grid)):
        warnings.warn(doubt, stacklevel=2)
    return grid


def _skip_bad(recording: Recording, rig: Rig) -> Recording:
    """Return a recording without the frames that cannot be read; name them."""
    print(f"reading {len(recording.frames)} frames: a few seconds for a hundred", flush=True)
    bad = recording.unreadable(rig)
    for number, why in bad.items():
        print(f"frame {number} is left out: {why}")
    frames = {number: key for number, key in recording.frames.items() if number not in bad}
    if not frames:
        raise OmnistereoError("no frame is left: none can be read. See above why")
    return replace(recording, frames=frames)


def _run_recording(options: argparse.Namespace) -> None:
    """Estimate depth for all frames that are not done yet, and write the video."""
    from tqdm import tqdm

    from omnistereo_lib.files import make_folder
    from omnistereo_lib.geometry.sphere import SphereGrid
    from omnistereo_lib.stereo.methods import FRAME_METHOD, VIDEO_METHOD
    from omnistereo_tools.input.image_circle import FRAMES
    from omnistereo_tools.input.sources import Recording, check_steps
    from omnistereo_tools.judge.pace import say_recording
    from omnistereo_tools.output.exports import check_suffixes
    from omnistereo_tools.record.recordings import (
        OF_RAYS,
        SETTINGS,
        DepthWriter,
        check_layout,
        stored_min_depth,
        write_video,
    )

    check_suffixes(video=options.video)
    start, step = options.start or 0, 1 if options.step is None else options.step
    check_steps(start, step)
    if options.phi is not None:
        low, high = options.phi
        height = options.height or round(options.width * (high - low) / 360)
        check_layout(SphereGrid(options.width, height, (low, high), options.spheres, 1.0))
    options.resumes = True
    out = options.out
    filled = [out / "video", *out.glob("cam[0-9]*"), *(out / f"{kind}_{options.width}" for kind in OF_RAYS)]
    check_outputs(options, [options.video, out / "config.yaml", out / SETTINGS], filled)
    rig = read_masked_rig(options)
    recording = Recording.open(options.images, start, options.stop, step)
    for path, names in recording.missing.items():
        some = ", ".join(map(str, names[:8])) + " …" * (len(names) > 8)
        print(f"{path} lacks {len(names)} frames that other cameras have; they are left out: {some}")
    if options.skip_bad:
        recording = _skip_bad(recording, rig)
    if options.method is None:
        print(f"method: {VIDEO_METHOD}, which keeps pace; --method {FRAME_METHOD} has lower errors and takes longer")
    if options.min_depth is None:
        options.min_depth = stored_min_depth(options.out)
    first = list(recording.read(sorted(recording.frames)[:FRAMES], rig))
    rig = mask_circles(rig, first)
    if options.height is None and options.phi is None:  # a public layout, which keeps pace
        options.height = options.width // 4
    grid = _choose_grid(options, rig, first[0])
    suffix = f".{options.depth_format or 'tiff'}"
    writer = DepthWriter.open(
        options.out,
        recording,
        rig,
        grid,
        options.method or VIDEO_METHOD,
        suffix=suffix,
        with_video=options.video is not None,
        device=options.device,
    )
    left, total = writer.left(), len(recording.frames)
    recording.check(left, rig)  # fail fast, here and below, before anything is written
    if options.cluster is not None:
        from omnistereo_tools.record.cluster import connect, depth_on_cluster

        connect(options.cluster).close()
    if options.video is not None:
        make_folder(options.video.parent)
    hold(options.out)
    for number, picture in writer.changed().items():
        print(f"frame {number} is computed again: {picture} has changed")
    writer.prepare(rig)
    if options.cluster is None:
        say_recording(writer.sweep, first[0], len(left), writer.method.name, [VIDEO_METHOD, FRAME_METHOD])
    done = writer.run(left) if options.cluster is None else depth_on_cluster(options.cluster, writer, options.device)
    for _ in tqdm(done, "depth", total, initial=total - len(left), unit="frame"):
        pass
    print(writer.doubt_sentence())
    print(f"{total} frames are in {options.out}/, which load_dataset reads")
    if options.video is not None:
        write_video(options.video, writer)
        print(f"written to {options.video}")
