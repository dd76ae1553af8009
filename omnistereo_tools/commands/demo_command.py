"""Watch a drive through the bundled streets, panorama and depth live, in the browser.

Examples:
  omnistereo demo
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

from omnistereo_lib.errors import OmnistereoError, check_number
from omnistereo_tools.commands import live_command
from omnistereo_tools.tiny import shrink

DRIVE = Path(__file__).resolve().parents[2] / "data_samples" / "sunny" / "train"
_RATE = 5  # frames/s


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("--port", type=int, default=0, help="of the page for the browser (default: any free one)")


def run(options: argparse.Namespace) -> None:
    """Play the drive as `omnistereo live` plays videos."""
    check_number(options.port, "--port", 0, 65535, whole=True)
    live = argparse.ArgumentParser()
    live_command.add_arguments(live)
    with TemporaryDirectory() as folder:
        videos = _videos(Path(folder))
        words = ["--rig", str(DRIVE), "--cameras", *videos, "--port", str(options.port), "--open"]
        live_command.run(shrink(live.parse_args(words)))


def _videos(folder: Path) -> list[str]:
    """Write the pictures of each camera as a video; return their names."""
    import cv2

    from omnistereo_lib.files import read_image

    if not (cameras := sorted(DRIVE.glob("cam*"))):
        raise OmnistereoError(f"{DRIVE} has no pictures; the drive comes with the clone. Run the demo there.")
    names = []
    for camera in cameras:
        pictures = [read_image(path) for path in sorted(camera.iterdir())]
        names.append(str(folder / f"{camera.name}.avi"))
        video = cv2.VideoWriter(names[-1], cv2.VideoWriter_fourcc(*"MJPG"), _RATE, pictures[0].shape[1::-1])
        for picture in pictures:
            video.write(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR))
        video.release()
    return names
