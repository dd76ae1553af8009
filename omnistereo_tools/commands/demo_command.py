"""Watch a drive through the bundled streets, panorama and depth live, in the browser.

Examples:
  omnistereo demo
"""

from dataclasses import dataclass
from pathlib import Path

from omnistereo_lib.errors import OmnistereoError
from omnistereo_tools.commands import live_command
from omnistereo_tools.parser import Options

DRIVE = Path(__file__).resolve().parents[2] / "data_samples" / "drive" / "test"


@dataclass(frozen=True, kw_only=True)
class DemoOptions(Options):
    """`omnistereo demo` has no options."""


def run(options: DemoOptions) -> None:
    """Play the drive there and back, by the method with the lowest errors."""
    from omnistereo_lib.stereo.methods import FRAME_METHOD

    if not (cameras := sorted(DRIVE.glob("cam*"))):
        raise OmnistereoError(
            f"{DRIVE} has no images; the drive comes with the clone. Run the demo there."
        )
    folders = tuple(map(str, cameras))
    live = live_command.LiveOptions(rig=DRIVE, cameras=folders, loop=True, method=FRAME_METHOD)
    live_command.run(live, open_page=True)
