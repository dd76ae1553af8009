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

import argparse
from collections.abc import Mapping
from pathlib import Path

from omnistereo_lib.errors import OmnistereoError, check_number
from omnistereo_tools.commands.options import add_device, add_grid, add_input, make_grid, read_input, read_rig

_OF_FRAMES = {"frame": 0}  # options and their defaults
_OF_FRAMES |= dict.fromkeys(["max_depth", "min_confidence", "mesh", "mesh_faces", "equirectangular", "crops"])
_OF_RECORDINGS = {"start": 0, "stop": None, "step": 1, "cluster": None, "depth_format": "tiff", "video": None}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_input(parser, recordings=True)
    add_grid(parser, width=640, height=160, spheres=192)
    parser.add_argument("--method", default="volumenet", help="see above (default: volumenet)")
    add_device(parser, precision=False)
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder for the results (default: out)")
    parser.add_argument("--max-depth", type=float, help="of points, metres (default: the fourth sphere from infinity)")
    parser.add_argument("--min-confidence", type=float, help="of points (default: all but the least confident tenth)")
    parser.add_argument("--mesh", type=Path, metavar="FILE", help="write a mesh as well: .glb (textured, y up) or .ply")
    parser.add_argument("--mesh-faces", type=int, metavar="N", help="decimate the mesh to N triangles")
    parser.add_argument(
        "--equirectangular", type=Path, metavar="FILE", help="write depth as 2:1 TIFF, for 360° viewers"
    )
    parser.add_argument("--crops", type=Path, metavar="FOLDER", help="perspective crops with depth and transforms.json")
    of_recording = parser.add_argument_group("recordings")
    of_recording.add_argument("--start", type=int, default=0, metavar="N", help="first frame number (default: 0)")
    of_recording.add_argument("--stop", type=int, metavar="N", help="frame number to stop before (default: the end)")
    of_recording.add_argument("--step", type=int, default=1, metavar="N", help="every N-th frame (default: 1)")
    of_recording.add_argument("--cluster", metavar="ADDRESS", help="of a Dask scheduler, to use many machines")
    of_recording.add_argument("--depth-format", default="tiff", choices=["tiff", "png"], help="float32, or 16 bits")
    of_recording.add_argument(
        "--video", type=Path, metavar="FILE", help="panorama over depth: .mp4, or .webm for browsers"
    )


def run(options: argparse.Namespace) -> None:
    """Estimate the depth of one frame or of a recording."""
    from omnistereo_tools.sources import is_recording

    if options.images is not None and is_recording(options.images):
        _refuse(options, _OF_FRAMES, "one frame; --images are folders or videos")
        _run_recording(options)
    else:
        _refuse(options, _OF_RECORDINGS, "recordings; expected --images with a folder or a video per camera")
        _run_frame(options)


def _refuse(options: argparse.Namespace, defaults: Mapping, purpose: str) -> None:
    """Raise an `OmnistereoError` if an option has another value than its default: it would be ignored."""
    for name, default in defaults.items():
        if getattr(options, name) != default:
            raise OmnistereoError(f"--{name.replace('_', '-')} is for {purpose}. Leave it out, or change --images.")


def _run_frame(options: argparse.Namespace) -> None:
    """Estimate depth for one frame, write everything, and say what came out."""
    from tqdm import tqdm

    from omnistereo_lib.files import make_folder
    from omnistereo_lib.stereo.pipeline import estimate_depth
    from omnistereo_tools.exports import check_suffixes, export_frame
    from omnistereo_tools.frame import FrameResult
    from omnistereo_tools.points import Limits

    check_suffixes(mesh=options.mesh, equirectangular=options.equirectangular)
    if options.max_depth is not None:
        check_number(options.max_depth, "--max-depth", 1e-6, 1e9)
    if options.min_confidence is not None:
        check_number(options.min_confidence, "--min-confidence", 0, 1)
    if options.mesh_faces is not None:
        check_number(options.mesh_faces, "--mesh-faces", 1, 10**9, whole=True)
        if options.mesh is None:
            raise OmnistereoError("--mesh-faces decimates a mesh; found no --mesh. Add --mesh FILE, or leave it out.")
    rig, images, frame = read_input(options)
    grid = make_grid(options, rig, images)
    gt_index = None if frame is None else frame.gt_index(grid)  # fail fast: read the ground truth, make the folders
    for folder in (*(file.parent for file in (options.mesh, options.equirectangular) if file), options.crops):
        if folder is not None:
            make_folder(folder)
    out = make_folder(options.out)
    depth = estimate_depth(
        rig, images, grid, options.method, device=options.device,
        progress=lambda blocks: tqdm(blocks, desc="sweep", unit="block"),
    )  # fmt: skip
    limits = Limits.of(depth, options.max_depth, options.min_confidence)
    result = FrameResult(depth, images, limits, options.method, gt_index)
    written = result.write(out)
    written += export_frame(result, options.mesh, options.mesh_faces, options.equirectangular, options.crops)
    print("\n".join(result.sentences()))
    print(f"written to {out}/: {', '.join(written)}")


def _run_recording(options: argparse.Namespace) -> None:
    """Estimate depth for all frames that are not done yet, and write the video."""
    from tqdm import tqdm

    from omnistereo_lib.files import make_folder
    from omnistereo_tools.exports import check_suffixes
    from omnistereo_tools.recordings import DepthWriter, stored_min_depth, write_video
    from omnistereo_tools.sources import Recording

    check_suffixes(video=options.video)
    rig = read_rig(options)
    recording = Recording.open(options.images, options.start, options.stop, options.step)
    for path, names in recording.missing.items():
        some = ", ".join(map(str, names[:8])) + " …" * (len(names) > 8)
        print(f"{path} lacks {len(names)} frames that other cameras have; they are left out: {some}")
    if options.min_depth is None:
        options.min_depth = stored_min_depth(options.out)
    grid = make_grid(options, rig, next(recording.read([min(recording.frames)], rig)))
    writer = DepthWriter.open(
        options.out, recording, rig, grid, options.method, f".{options.depth_format}", options.video is not None,
        options.device,
    )  # fmt: skip
    if options.cluster is not None:
        from omnistereo_tools.cluster import connect, depth_on_cluster

        connect(options.cluster).close()  # fail fast, before anything is written
    if options.video is not None:
        make_folder(options.video.parent)
    writer.prepare(rig)
    left, total = writer.left(), len(recording.frames)
    done = writer.run(left) if options.cluster is None else depth_on_cluster(options.cluster, writer, options.device)
    for _ in tqdm(done, "depth", total, initial=total - len(left), unit="frame"):
        pass
    print(f"{len(recording.frames)} frames are in {options.out}/, which load_dataset reads")
    if options.video is not None:
        write_video(options.video, writer)
        print(f"written to {options.video}")
