"""Show panorama and depth live, from cameras or videos, in the browser.

Examples:
  omnistereo live --rig rig.yaml --cameras 0 1 2 3
      cameras, by their numbers
  omnistereo live --rig rig.yaml --cameras front.mp4 right.mp4 back.mp4 left.mp4
      videos
"""

import argparse
import re
from pathlib import Path

from omnistereo_lib.errors import check_number
from omnistereo_tools.commands.options import (
    add_device,
    add_grid,
    add_rig,
    check_typed,
    make_grid,
    mask_circles,
    read_rig,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_rig(parser, required=True, help="rig file or folder")
    parser.add_argument("--cameras", nargs="+", required=True, help="one camera number or video file per camera")
    parser.add_argument("--masks", type=Path, nargs="+", help="one per camera, bright = valid")
    add_grid(parser, width=320, height=80, spheres=64)
    parser.add_argument("--method", help="as of omnistereo depth (default: one that keeps pace)")
    add_device(parser, precision=False)
    parser.add_argument("--port", type=int, default=8765, help="of the page for the browser, 0: any (default: 8765)")
    parser.add_argument("--open", action="store_true", help="open the page in the browser")


def run(options: argparse.Namespace) -> None:
    """Show pictures as soon as somebody looks, until a video ends, Ctrl-C or SIGTERM."""
    import webbrowser
    from time import monotonic

    from omnistereo_lib.stereo.methods import VIDEO_METHOD
    from omnistereo_lib.stereo.sweep import SphereSweep
    from omnistereo_tools import live_view
    from omnistereo_tools.input.masks import with_masks

    check_typed(options)
    check_number(options.port, "--port", 0, 65535, whole=True)
    count, start, ended = 0, monotonic(), "stopped"
    try:
        print("opening the cameras and computing tables: a few seconds", flush=True)
        rig = with_masks(read_rig(options), options.masks, [])
        sources = [int(source) if re.fullmatch("[0-9]{1,3}", source) else source for source in options.cameras]
        cameras = live_view.Cameras(sources, rig)
        rig = mask_circles(rig, [cameras.first])
        sweep = SphereSweep(rig, make_grid(options, rig, cameras.first), device=options.device)
        pictures = live_view.live_pictures(cameras, sweep, options.method or VIDEO_METHOD)
        latest = live_view.Latest()
        with live_view.serve(latest, options.port) as address:
            print(f"open {address} in a browser of this machine: it begins then. Ctrl-C stops", flush=True)
            if options.open:
                webbrowser.open(address)
            latest.watched.wait()
            start = monotonic()
            for count, picture in enumerate(pictures, 1):  # noqa: B007 (told at the end)
                latest.put(picture)
        ended = "the videos have ended"
    except KeyboardInterrupt:  # SIGTERM, too: there is nothing to resume
        pass
    seconds = monotonic() - start
    print(f"{ended}: {count} frames, {count / seconds:.1f} frames/s")
