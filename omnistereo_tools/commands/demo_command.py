"""Watch a drive through the bundled streets, panorama and depth live, in the browser.

Examples:
  omnistereo demo
"""

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from omnistereo_lib.errors import OmnistereoError
from omnistereo_tools.commands import live_command
from omnistereo_tools.parser import Options

DRIVE = Path(__file__).resolve().parents[2] / "data_samples" / "drive" / "test"
_RATE = 5  # frames/s


@dataclass(frozen=True, kw_only=True)
class DemoOptions(Options):
    """`omnistereo demo` has no options."""


def run(options: DemoOptions) -> None:
    """Play the drive there and back as `omnistereo live` plays videos."""
    with TemporaryDirectory() as folder:
        videos = tuple(_videos(Path(folder)))
        live = live_command.LiveOptions(rig=DRIVE, cameras=videos, loop=True)
        live_command.run(live, open_page=True)


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
        size = pictures[0].shape[1::-1]
        video = cv2.VideoWriter(names[-1], cv2.VideoWriter.fourcc(*"MJPG"), _RATE, size)
        for picture in [*pictures, *pictures[-2:0:-1]]:
            video.write(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
        video.release()
    return names
