"""How far a command is, on the terminal."""

import sys

from tqdm import tqdm

from omnistereo_lib.progress import Progress

tqdm.monitor_interval = 0  # its thread would outlive the command


def progress_bar(unit: str = "part") -> Progress:
    """Return a `progress` that shows a bar with what is said of each part, until all are done."""
    bar: tqdm | None = None

    def show(done: int, total: int, what: str) -> None:
        nonlocal bar
        if bar is None:  # the time left counts from the first part of this call
            bar = tqdm(total=total, initial=done, desc=what, unit=unit, leave=False)
        bar.set_description(what, refresh=False)
        bar.update(done - bar.n)
        bar.refresh()
        if done == total:
            bar.close()
            bar = None

    return show


def say(line: str) -> None:
    """Print what is going on above the bar, on stderr: stdout is for the result, verdict first."""
    tqdm.write(line, file=sys.stderr)
