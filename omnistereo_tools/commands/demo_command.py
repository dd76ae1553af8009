"""Watch a drive through the bundled streets, panorama and depth live, in the browser.

Examples:
  omnistereo demo
"""

from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic

from omnistereo_lib.errors import OmnistereoError
from omnistereo_tools.commands import live_command
from omnistereo_tools.parser import Options, option, shrink

DRIVE = Path(__file__).resolve().parents[2] / "data_samples" / "drive" / "test"
_RATE = 5  # frames/s
# method and columns
_BEST_FIRST = (("volumenet", 640), ("volumenet", 320), ("zncc+sgm", 640), ("zncc+sgm", 320))


@dataclass(frozen=True, kw_only=True)
class DemoOptions(Options):
    """Options of `omnistereo demo`."""

    port: int = option("of the page for the browser, 0: any free one", 0, between=(0, 65535))


def run(options: DemoOptions) -> None:
    """Play the drive there and back as `omnistereo live` plays videos, by the best method that
    keeps its pace.
    """
    with TemporaryDirectory() as folder:
        videos = tuple(_videos(Path(folder)))
        print("timing the methods: a few seconds", flush=True)
        live = live_command.LiveOptions(
            rig=DRIVE, cameras=videos, port=options.port, open=True, loop=True
        )
        *better, plain = [
            shrink(replace(live, method=method, width=width, height=width // 4))
            for method, width in _BEST_FIRST
        ]
        live = next((live for live in better if _rate(live) >= _RATE), plain)
        print(
            f"{live.width} × {live.height} rays by {live.method}, the best that keeps {_RATE}"
            " frames/s here"
        )
        live_command.run(live)


def _rate(live: live_command.LiveOptions) -> float:
    """Return how many pictures a second the videos get by a method, up to the 20 that are read;
    timed for a second.
    """
    from omnistereo_tools.live_view import live_pictures

    cameras, sweep = live_command.open_cameras(live)
    cameras.period = 1 / (4 * _RATE)
    pictures = live_pictures(cameras, sweep, live.method or "")
    next(pictures)
    start, seconds, count = monotonic(), 0.0, 0
    while seconds < 1.0:
        next(pictures)
        seconds, count = monotonic() - start, count + 1
    pictures.close()
    return count / seconds


def _videos(folder: Path) -> list[str]:
    """Write the pictures of each camera, there and back, as a video; return their names."""
    import cv2

    from omnistereo_lib.pictures import read_image

    if not (cameras := sorted(DRIVE.glob("cam*"))):
        raise OmnistereoError(
            f"{DRIVE} has no pictures; the drive comes with the clone. Run the demo there."
        )
    names = []
    for camera in cameras:
        pictures = [read_image(path) for path in sorted(camera.iterdir())]
        names.append(str(folder / f"{camera.name}.avi"))
        video = cv2.VideoWriter(
            names[-1], cv2.VideoWriter.fourcc(*"MJPG"), _RATE, pictures[0].shape[1::-1]
        )
        for picture in [*pictures, *pictures[-2:0:-1]]:
            video.write(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
        video.release()
    return names
