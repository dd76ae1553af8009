"""Estimate depth: images and a rig in, a depth panorama and a point cloud out.

example: omnistereo depth --rig rig.yaml --images 1.png 2.png 3.png 4.png --method sweepnet+sgm
"""

import argparse
import json
from pathlib import Path

from omnistereo_lib.cli.inputs import add_device, add_grid, add_input, make_grid, read_input


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_input(parser)
    add_grid(parser, width=640, height=160, spheres=192)
    parser.add_argument(
        "--method", default="volumenet", help="such as zncc+sgm or sweepnet+sgm,pairs=all (default: volumenet)"
    )
    add_device(parser, precision=False)
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder for the results (default: out)")


def run(options: argparse.Namespace) -> None:
    """Estimate depth for one frame and write depth, panorama, point cloud and errors."""
    import numpy as np
    from tqdm import tqdm

    from omnistereo_lib import files
    from omnistereo_lib.dataset import write_inverse_depth
    from omnistereo_lib.stereo.depth import colorize_depth
    from omnistereo_lib.stereo.metrics import index_error
    from omnistereo_lib.stereo.pipeline import estimate_depth

    rig, images, frame = read_input(options)
    grid = make_grid(options, rig)
    gt_index = None if frame is None else frame.gt_index(grid)  # fail fast: read the ground truth, make the folder
    out = files.make_folder(options.out)
    result = estimate_depth(
        rig, images, grid, options.method, device=options.device,
        progress=lambda blocks: tqdm(blocks, desc="sweep", unit="block"),
    )  # fmt: skip
    files.write_image(out / "inverse_depth.png", colorize_depth(result.inverse_depth, grid))
    files.write_image(out / "panorama.jpg", np.nan_to_num(result.panorama(images)).round().astype(np.uint8))
    write_inverse_depth(out / "inverse_depth.tiff", result.inverse_depth)
    # Beyond sphere 4 one sphere more or less is a quarter of the depth: a spray of points, not a surface.
    points, colors = result.point_cloud(images, max_depth=float(grid.index_to_depth(4)))
    files.write_ply(out / "points.ply", points, colors)
    print(f"{result.valid.mean():.1%} of the rays have a depth; {len(points)} points")
    written = ["inverse_depth.png", "panorama.jpg", "inverse_depth.tiff", "points.ply"]
    (out / "errors.json").unlink(missing_ok=True)  # of another frame
    if gt_index is not None:
        errors = index_error(result.index, gt_index, grid.num_spheres)
        with files.atomic_write(out / "errors.json") as temporary:
            temporary.write_text(json.dumps(errors, indent=1) + "\n")
        print("errors in % of the range swept: " + ", ".join(f"{name} {value:.2f}" for name, value in errors.items()))
        written.append("errors.json")
    print(f"written to {out}/: {', '.join(written)}")
