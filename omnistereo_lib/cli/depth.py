"""Estimate depth: images and a rig in; a page to look at, a viewer for the browser and data out.

Examples:
  omnistereo depth
      the bundled sample
  omnistereo depth --rig rig.yaml --images 1.png 2.png 3.png 4.png --method sweepnet+sgm --out out
      your own images, with a method of your choice
  omnistereo depth --mesh out/scene.glb
      with a mesh that Blender and other programs open
methods: zncc, mccnn, sweepnet or volumenet; +sgm smooths; ,pairs=all and others change settings
"""

import argparse
from pathlib import Path

from omnistereo_lib.cli.inputs import add_device, add_grid, add_input, make_grid, read_input


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_input(parser)
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


def run(options: argparse.Namespace) -> None:
    """Estimate depth for one frame, write everything, and say what came out."""
    from tqdm import tqdm

    from omnistereo_lib.files import make_folder
    from omnistereo_lib.stereo.pipeline import estimate_depth
    from omnistereo_tools.exports import check_suffixes, export_frame
    from omnistereo_tools.frame import FrameResult
    from omnistereo_tools.points import Limits

    check_suffixes(options.mesh, options.equirectangular)
    rig, images, frame = read_input(options)
    grid = make_grid(options, rig, images)
    gt_index = None if frame is None else frame.gt_index(grid)  # fail fast: read the ground truth, make the folder
    out = make_folder(options.out)
    depth = estimate_depth(
        rig, images, grid, options.method, device=options.device,
        progress=lambda blocks: tqdm(blocks, desc="sweep", unit="block"),
    )  # fmt: skip
    limits = Limits.of(depth, options.max_depth, options.min_confidence)
    result = FrameResult(depth, images, limits, options.method, gt_index)
    written = result.write(out)
    written += export_frame(result, options.mesh, options.mesh_faces, options.equirectangular)
    print("\n".join(result.sentences()))
    print(f"written to {out}/: {', '.join(written)}")
