"""Watch a drive through the bundled streets, panorama and depth live, in the browser.

Examples:
  omnistereo demo
"""

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from omnistereo_lib.errors import OmnistereoError
from omnistereo_tools.commands import live_command
from omnistereo_tools.parser import Options, option
from omnistereo_tools.tiny import shrink

DRIVE = Path(__file__).resolve().parents[2] / "data_samples" / "sunny" / "train"
_RATE = 5  # frames/s


@dataclass(frozen=True, kw_only=True)
class DemoOptions(Options):
    """Options of `omnistereo demo`."""

    port: int = option("of the page for the browser, 0: any free one", 0, between=(0, 65535))


def run(options: DemoOptions) -> None:
    """Play the drive as `omnistereo live` plays videos."""
    with TemporaryDirectory() as folder:
        videos = tuple(_videos(Path(folder)))
        live = live_command.LiveOptions(rig=DRIVE, cameras=videos, port=options.port, open=True)
        live_command.run(shrink(live))


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
        video = cv2.VideoWriter(names[-1], cv2.VideoWriter.fourcc(*"MJPG"), _RATE, pictures[0].shape[1::-1])
        for picture in pictures:
            video.write(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR))
        video.release()
    return names
