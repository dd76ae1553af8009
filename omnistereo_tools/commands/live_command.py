"""Show panorama and depth live, from cameras or videos, in a window or in the browser.

Examples:
  omnistereo live --rig rig.yaml --cameras 0 1 2 3
  omnistereo live --rig rig.yaml --cameras front.mp4 right.mp4 back.mp4 left.mp4
"""

import argparse
from pathlib import Path

from omnistereo_tools.commands.options import add_device, add_grid


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("--rig", type=Path, required=True, help="rig file or folder")
    parser.add_argument("--unit", choices=["mm", "cm", "m"], help="unit of the poses, if the file does not state it")
    parser.add_argument("--cameras", nargs="+", required=True, help="one camera number or video file per camera")
    parser.add_argument("--masks", type=Path, nargs="+", help="one per camera, bright = valid")
    add_grid(parser, width=320, height=80, spheres=64)
    parser.add_argument("--method", default="zncc+sgm", help="as of omnistereo depth (default: zncc+sgm)")
    add_device(parser, precision=False)
    parser.add_argument("--browser", action="store_true", help="even where OpenCV could open a window")
    parser.add_argument("--port", type=int, default=8765, help="of the page for the browser, 0: any (default: 8765)")


def run(options: argparse.Namespace) -> None:
    """Show pictures until a camera ends, the window is closed by Escape, or Ctrl-C."""
    from time import monotonic

    from omnistereo_lib.errors import OmnistereoError
    from omnistereo_lib.geometry.sphere import SphereGrid
    from omnistereo_lib.rig_files import load_rig
    from omnistereo_lib.stereo.sweep import SphereSweep, select_device
    from omnistereo_tools import live_view
    from omnistereo_tools.masks import with_masks

    rig = with_masks(load_rig(options.rig, options.unit), options.masks, [])
    min_depth = rig.min_depth if options.min_depth is None else options.min_depth
    if min_depth is None:
        raise OmnistereoError(f"{options.rig} states no nearest depth. Pass --min-depth, in metres")
    grid = SphereGrid(options.width, options.height, tuple(options.phi), options.spheres, min_depth)
    sources = [int(source) if source.isdigit() else source for source in options.cameras]
    if len(sources) != len(rig):
        raise OmnistereoError(f"there are {len(sources)} cameras or videos for a rig of {len(rig)}. Give one for each.")
    sweep = SphereSweep(rig, grid, device=select_device(options.device))
    pictures, start = live_view.live_pictures(sources, sweep, options.method), monotonic()
    if live_view.has_window() and not options.browser:
        count = live_view.show_in_window(pictures)
    else:
        latest = live_view.Latest()
        with live_view.serve(latest, options.port) as address:
            print(f"open {address} in a browser of this machine; Ctrl-C stops", flush=True)
            count = live_view.show_in_browser(pictures, latest)
    print(f"{count} frames, {count / (monotonic() - start):.1f} frames/s")
