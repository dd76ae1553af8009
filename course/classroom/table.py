"""A class's methods, compared: `python -m course table HANDED_IN` runs every file that computes
depth.

Such files are `mine/omnistereo.py`, which the checkers write, and what students make of it: any
Python file with `depth(images, cameras, grid)`, see `omnistereo_tools.own_method`. Each runs on
three frames with exact ground truth: a street, a room, and a town from the air.
"""

import csv
import functools
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import omnistereo_lib as osl
from course import nbtools
from course.classroom import student
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import atomic_write, make_folder
from omnistereo_lib.frame import Frame
from omnistereo_lib.stereo.metrics import index_error
from omnistereo_lib.stereo.pipeline import sweep_depth
from omnistereo_tools.own_method import check_own, run_own

OUT = nbtools.ROOT / "out" / "table.csv"
SECONDS, MEMORY_GIB = 300.0, 4.0  # for each frame
SETS = ("sunny", "indoor", "aerial")
METRICS = (">1", ">3", ">5", "MAE", "RMS")
LIBRARY = "zncc+sgm"


@dataclass(frozen=True)
class Row:
    """How a method fared."""

    name: str
    errors: dict[str, float]  #: the means over the frames; empty if it did not come through
    cpu_s: float  #: for a frame
    said: str = ""  #: why it did not come through


@functools.cache
def frame_of(name: str) -> tuple[Frame, osl.SphereSweep, Any]:
    """Return a frame of a data set, the sweep of its rig, 320 × 80 × 64, and exact indices."""
    data = osl.load_dataset(nbtools.ROOT / "data_samples" / name, split="test")
    frame = data.frame(831) if name == "sunny" else data[0]
    grid = osl.SphereGrid(320, 80, (-45, 45), num_spheres=64, min_depth=data.rig.min_depth)
    return frame, osl.SphereSweep(data.rig, grid), frame.gt_index(grid)


def judged(
    name: str,
    index_of: Callable[[Frame, osl.SphereSweep], tuple[Any, float]],
    sets: tuple[str, ...] = SETS,
) -> Row:
    """Return the mean errors over the frames, given a frame's indices and CPU seconds."""
    errors, seconds = [], []
    for one in sets:
        frame, sweep, truth = frame_of(one)
        try:
            index, taken = index_of(frame, sweep)
        except OmnistereoError as error:
            return Row(name, {}, 0.0, f"{one}: {error}")
        found = index_error(index, truth, sweep.grid.num_spheres)
        errors.append([found[metric] for metric in METRICS])
        seconds.append(taken)
    means = dict(zip(METRICS, np.mean(errors, axis=0).tolist(), strict=True))
    return Row(name, means, float(np.mean(seconds)))


def by_library(frame: Frame, sweep: osl.SphereSweep) -> tuple[Any, float]:
    """Return the indices by the library's ZNCC + SGM, and the CPU seconds once warm."""
    sweep_depth(sweep, frame.images, LIBRARY)
    started = time.process_time()
    depth = sweep_depth(sweep, frame.images, LIBRARY)
    return depth.index, time.process_time() - started


def by_file(
    file: Path, start: Callable[..., int] | None = None
) -> Callable[[Frame, osl.SphereSweep], tuple[Any, float]]:
    """Return what runs a file; see `run_own`."""

    def index_of(frame: Frame, sweep: osl.SphereSweep) -> tuple[Any, float]:
        own = run_own(file, sweep, frame.images, start)
        return own.depth.index, own.cpu_s

    return index_of


def print_table(
    handed_in: Path, out: Path = OUT, seconds: float = SECONDS, memory_gib: float = MEMORY_GIB
) -> list[Row]:
    """Run the methods of a class, print and write their table, lowest mean error first."""
    files = files_of(handed_in)
    rows = [judged(f"the library's {LIBRARY}", by_library)]
    for file in files:
        name = str(file.relative_to(handed_in)) if handed_in.is_dir() else file.name
        rows.append(
            judged(
                name,
                by_file(file, functools.partial(_limited, seconds=seconds, memory_gib=memory_gib)),
            )
        )
        print(f"{name}: {rows[-1].said or 'done'}", flush=True)
    rows.sort(key=lambda row: row.errors.get("MAE", np.inf))
    print("\n".join(in_words(rows)))
    make_folder(out.parent)
    with atomic_write(out) as new, new.open("w", encoding="utf-8", newline="") as file_out:
        table = csv.writer(file_out)
        table.writerow(["method", *METRICS, "cpu_s", "said"])
        for row in rows:
            values = (
                [f"{row.errors[metric]:.3f}" for metric in METRICS]
                if row.errors
                else [""] * len(METRICS)
            )
            table.writerow([row.name, *values, f"{row.cpu_s:.2f}", row.said])
    print(f"written: {out}")
    return rows


def files_of(handed_in: Path) -> list[Path]:
    """Return the files with a function `depth`: one, or all below a folder that are not hidden."""
    if not handed_in.is_dir():
        check_own(handed_in)
        return [handed_in]
    found = []
    for file in sorted(handed_in.rglob("*.py")):
        parts = file.relative_to(handed_in).parts
        if file.is_symlink() or any(
            part.startswith(".") or part == "__pycache__" for part in parts
        ):
            continue
        try:
            check_own(file)
            found.append(file)
        except OmnistereoError:  # the functions of one notebook, or no method at all
            continue
    if not found:
        raise OmnistereoError(
            f"{handed_in} holds no file with a function `depth`, such as mine/omnistereo.py"
        )
    return found


def in_words(rows: list[Row]) -> list[str]:
    """Return the table as lines of text."""
    width = max(len(row.name) for row in rows)
    head = "".join(f"{metric:>8}" for metric in METRICS)
    lines = [
        f"{'':<{width}}{head}{'CPU s':>8}   means of {', '.join(SETS)}, 320 × 80 rays, 64 spheres"
    ]
    for row in rows:
        values = [f"{value:8.2f}" for value in row.errors.values()] + [f"{row.cpu_s:8.2f}"]
        lines.append(f"{row.name:<{width}}" + ("".join(values) if row.errors else f"   {row.said}"))
    return lines


def _limited(command: list[str], seconds: float, memory_gib: float) -> int:
    """Run a command with limits, away from clone and user's files; raise the limit it broke."""
    with tempfile.TemporaryDirectory(prefix="table-", ignore_cleanup_errors=True) as folder:
        ran = student.limited(command, Path(folder), Path(folder), seconds, memory_gib)
    if ran.broken:
        raise OmnistereoError(ran.broken)
    return ran.status
