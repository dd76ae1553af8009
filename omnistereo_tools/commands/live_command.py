"""Show panorama and depth live, from cameras or videos, in the browser.

Examples:
  omnistereo live --rig rig.yaml --cameras 0 1 2 3
      cameras, by their numbers
  omnistereo live --rig rig.yaml --cameras front.mp4 right.mp4 back.mp4 left.mp4
      videos
"""

from __future__ import annotations

import re
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from omnistereo_tools.commands.options import (
    DepthRange,
    GridOptions,
    MethodOptions,
    RigOptions,
    find_min_depth,
    make_grid,
    mask_circles,
    read_rig,
)
from omnistereo_tools.parser import option

if TYPE_CHECKING:
    from omnistereo_lib.stereo.sweep import SphereSweep
    from omnistereo_tools.live_view import Cameras


@dataclass(frozen=True, kw_only=True)
class LiveOptions(MethodOptions, DepthRange, GridOptions, RigOptions):
    """Options of `omnistereo live`."""

    rig: Path = option("rig file or folder", MISSING)
    cameras: tuple[str, ...] = option("number, device, rtsp://, video or folder of each", MISSING)
    grid: str = "320x80x64"
    method: str | None = option("as of omnistereo depth", unset="one that keeps pace")
    follow: bool = option("when a camera has turned, go on with its new pose", False)
    loop: bool = option(
        "videos begin again when they have ended, pictures go back and forth", False
    )


def open_cameras(options: LiveOptions) -> tuple[Cameras, SphereSweep]:
    """Open the cameras or videos; return them, and the sweep of their rig."""
    from omnistereo_lib.frame import Frame
    from omnistereo_lib.stereo.sweep import SphereSweep
    from omnistereo_tools.judge.coverage import Coverage
    from omnistereo_tools.live_view import Cameras

    rig = read_rig(options)
    sources = [
        int(source) if re.fullmatch("[0-9]{1,3}", source) else source for source in options.cameras
    ]
    cameras = Cameras(sources, rig, options.loop)
    rig = mask_circles(rig, [cameras.first])
    min_depth = find_min_depth(options.min_depth, Frame.of(rig, cameras.first))
    return cameras, SphereSweep(
        rig, make_grid(options, Coverage.of(rig), min_depth), device=options.device
    )


def run(options: LiveOptions, open_page: bool = False) -> None:
    """Show pictures as soon as somebody looks, until a video ends or Ctrl-C."""
    import webbrowser
    from time import monotonic

    from omnistereo_tools import live_view
    from omnistereo_tools.judge.pace import live_method
    from omnistereo_tools.progress import say
    from omnistereo_tools.record.watching import Watching

    count, start, ended, method = 0, monotonic(), "Stopped", options.method
    try:
        say("opening the cameras and computing tables: a few seconds")
        cameras, sweep = open_cameras(options)
        method = method or live_method(sweep, cameras.first)
        watching = Watching(sweep.rig, sweep, options.follow)
        pictures = live_view.live_pictures(cameras, sweep, method, watching)
        latest = live_view.Latest()
        with live_view.serve(latest, cameras) as address:
            print("It begins when the page is open in a browser of this machine; Ctrl-C stops it.")
            print(address, flush=True)
            if open_page:
                webbrowser.open(address)
            latest.watched.wait()
            start = monotonic()
            for count, picture in enumerate(pictures, 1):  # noqa: B007 (told at the end)
                latest.put(picture)
        ended = "The videos have ended"
    except KeyboardInterrupt:  # there is nothing to resume
        pass
    seconds = monotonic() - start
    print(f"{ended}: {count} frames, {count / seconds:.1f} frames/s by {method}.")
