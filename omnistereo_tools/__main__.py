"""`omnistereo COMMAND` and `python -m omnistereo_tools COMMAND`."""

import gc
import os
import signal
from types import FrameType


def start() -> int:
    """Run the command line; a process that is stopped while modules load, or after the command,
    ends quietly.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _leave)
    # Modules make hundreds of thousands of objects that stay: looking through them for garbage took
    # 0.3 s while they load and 0.5 s at the end (`depth`, 7.0 s; two cores, warm).
    gc.set_threshold(100_000, 20, 20)
    from omnistereo_tools.cli import main

    status = main()
    gc.freeze()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)
    return status


def _leave(number: int, frame: FrameType | None) -> None:
    """End at once: an exception would go through modules that are half loaded, and come out as
    another one.
    """
    os.write(2, b"interrupted\n")
    os._exit(128 + number)


if __name__ == "__main__":
    raise SystemExit(start())
