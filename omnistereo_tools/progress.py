"""How far a command is, on the terminal."""

import sys

from tqdm import tqdm

from omnistereo_lib.progress import Progress

tqdm.monitor_interval = 0  # its thread would outlive the command
_APART = 10.0  # seconds between two bars in a log, where each takes its own place


def progress_bar(unit: str = "part") -> Progress:
    """Return a `progress` that shows a bar with what is said of each part, until all are done."""
    bar: tqdm | None = None
    watched = sys.stderr.isatty()

    def show(done: int, total: int, what: str) -> None:
        nonlocal bar
        if bar is None:  # the time left counts from the first part of this call
            apart = 0.1 if watched else _APART
            bar = tqdm(
                total=total, initial=done, desc=what, unit=unit, leave=False, mininterval=apart
            )
        bar.set_description(what, refresh=False)
        bar.update(done - bar.n)
        if watched:
            bar.refresh()
        if done == total:
            bar.close()
            bar = None

    return show


def say(line: str) -> None:
    """Print what is going on above the bar, on stderr: stdout is for the result, verdict first."""
    tqdm.write(line, file=sys.stderr)
