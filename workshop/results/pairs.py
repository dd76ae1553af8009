"""Two builds side by side: the commands and the frames of this clone and of another, run by turns.

Each row is the least of several runs of either clone, and their ratio; the goal stands beside it.
And how time and memory of a frame grow with its columns, spheres and cameras, with exponents; and
the memory that `depth` states beside what it takes, of rigs and sizes that were not fitted.
"""

import math
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from omnistereo_lib.dataset import load_dataset
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.rig_file import save_rig

ROOT = Path(__file__).parents[2]
_DRIVE, _SUNNY = "data_samples/drive/test", "data_samples/sunny/test"
_RECORDING = " ".join(f"{_DRIVE}/cam{k}" for k in (1, 2, 3, 4))
_PICTURES = " ".join(f"{_SUNNY}/cam{k}/0706.jpg" for k in (1, 2, 3, 4))
# Name, goals of the ratios of wall, CPU and memory, and the command; OUT: a folder of its own.
_COMMANDS: list[tuple[str, tuple[float, ...], str]] = [
    ("depth, the sample", (0.5, 0.65, 0.7), "depth --out OUT/depth"),
    (
        "record 320, VolumeNet",
        (0.67,),
        f"record --rig {_DRIVE} --images {_RECORDING} --grid 320 --method volumenet"
        " --out OUT/record",
    ),
    ("world of it", (0.5,), "world OUT/record"),
    ("doctor, images", (0.6,), f"doctor --rig {_SUNNY} --images {_PICTURES}"),
    (
        "calibrate, 4 cameras",
        (),
        "calibrate data_samples/calibration/handheld --board 12x10 --square 0.06 --max-fov 220"
        " --out OUT/rig",
    ),
]
# By method and number of cameras, panoramas of runs that the numbers in `pace` were not fitted to.
_NOT_FITTED = {
    "volumenet": {2: "800x400x96", 3: "1000x250x64", 6: "480x240x192", 8: "1280x640x64"},
    "zncc+sgm": {2: "640x320x128", 3: "800x200x192", 6: "640x160x96", 8: "480x240x64"},
}
_FRAMES = [
    ("VolumeNet frame", "volumenet", 640, 160, 192, 0.7),
    ("ZNCC + SGM frame", "zncc+sgm", 320, 80, 64, 0.7),
    ("ZNCC + SGM frame", "zncc+sgm", 1200, 300, 192, 0.6),
]
# Prints wall and CPU seconds of a frame, the least of several, and the peak memory in bytes. It
# runs in either clone, so it imports what both have.
_FRAME = """
import resource, sys, time
from omnistereo_tools.memory import keep_memory
keep_memory()
from omnistereo_lib.dataset import load_dataset
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.pipeline import sweep_depth
from omnistereo_lib.stereo.sweep import SphereSweep
import numpy as np
method, (width, height, spheres, cameras, times) = sys.argv[1], map(int, sys.argv[2:])
data = load_dataset("data_samples/sunny", split="test")
rig, images, min_depth = data.rig, data[0].images, data.rig.min_depth
turns = [Pose.from_vector((0, 0.2 * (k // 4), 0, 0, 0, 0)) for k in range(cameras)]
rig = Rig([rig.cameras[k % 4] for k in range(cameras)],
          [turns[k] @ rig.T_rig_cam[k % 4] for k in range(cameras)])
grid = SphereGrid(width, height, num_spheres=spheres, min_depth=min_depth)
sweep = SphereSweep(rig, grid)
def frame():
    wall, cpu = time.perf_counter(), time.process_time()
    sweep_depth(sweep, [images[k % 4] for k in range(cameras)], method)
    return time.perf_counter() - wall, time.process_time() - cpu
frame()
print(*map(min, zip(*(frame() for _ in range(times)))),
      1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def compare_builds(other: Path, runs: int = 3) -> None:
    """Print wall, CPU and peak memory of this clone, of another one, and their ratios."""
    clones = [ROOT, other.resolve()]
    print(f"\nthis clone against {other}, the least of {runs} by turns: wall s, CPU s, peak GB")
    with tempfile.TemporaryDirectory() as folder:
        outs = [Path(folder, str(k)) for k in range(len(clones))]
        for name, goals, command in _COMMANDS:

            def run(clone: Path, command: str = command) -> list[float]:
                return _run_command(clone, command, outs[clones.index(clone)])

            _print_pair(name, goals, _least(run, clones, runs))
    for name, method, width, height, spheres, goal in _FRAMES:
        sizes = width, height, spheres, 4, 3

        def run_frame(
            clone: Path, method: str = method, sizes: Sequence[int] = sizes
        ) -> list[float]:
            return _frame(clone, method, sizes)

        title = f"{name} {width}×{height}×{spheres}"
        # Each run is the least of three frames already.
        _print_pair(title, (goal,), _least(run_frame, clones, runs - 1))


def _least(
    run: Callable[[Path], list[float]], clones: Sequence[Path], runs: int
) -> list[list[float]]:
    """Return the least wall, CPU and memory of each clone, run by turns."""
    found = [[run(clone) for clone in clones] for _ in range(runs)]
    return [[min(x) for x in zip(*of_clone, strict=True)] for of_clone in zip(*found, strict=True)]


def _print_pair(name: str, goals: Sequence[float], both: Sequence[Sequence[float]]) -> None:
    ours, theirs = both
    numbers = [f"{a:6.2f} / {b:6.2f} = {a / b:4.2f}" for a, b in zip(ours, theirs, strict=True)]
    goal = f"  goal {', '.join(map(str, goals))}" if goals else ""
    print(f"{name:34} {'   '.join(numbers)}{goal}", flush=True)


def _python(clone: Path) -> str:
    return str(clone / ".venv" / "bin" / "python")


def _run_command(clone: Path, command: str, out: Path) -> list[float]:
    """Run a command in a clone: wall and CPU seconds, peak memory in GB."""
    # What they would resume goes first.
    for name, made in (("record", "record"), ("world", "record/world")):
        if command.startswith(name):
            shutil.rmtree(out / made, ignore_errors=True)
    out.mkdir(exist_ok=True)
    if (clone / "omnistereo_lib" / "calibrate").is_dir():  # as 34d45a7, the build of the goals
        command = command.replace("--grid", "--width")
    typed = command.replace("OUT", str(out)).split()
    start, log = time.perf_counter(), out / "log.txt"
    with log.open("wb") as file:
        child = subprocess.Popen(
            [_python(clone), "-m", "omnistereo_tools", *typed], cwd=clone, stdout=file, stderr=file
        )
        _, status, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode not in (0, 1):  # 1: a check of the doctor failed
        said = log.read_text(encoding="utf-8", errors="replace")[-300:]
        sys.exit(f"{clone}: omnistereo {' '.join(typed)} ends with {child.returncode}: {said}")
    return [time.perf_counter() - start, used.ru_utime + used.ru_stime, used.ru_maxrss / 2**20]


def _frame(clone: Path, method: str, sizes: Sequence[int]) -> list[float]:
    """Return wall and CPU seconds of a frame in a clone, and the peak memory in GB."""
    command = [_python(clone), "-c", _FRAME, method, *map(str, sizes)]
    printed = subprocess.run(command, cwd=clone, check=True, capture_output=True, text=True).stdout
    wall, cpu, peak = map(float, printed.split())
    return [wall, cpu, peak / 2**30]


def growth() -> None:
    """Print how time and memory of a frame grow, with the exponents from the first to the last."""
    print("\ngrowth of a frame: wall s and peak GB; the exponents are from the first to the last")
    for method in ("zncc+sgm", "volumenet"):
        for what, values, sizes in (
            ("columns", (320, 640, 1280), lambda w: (w, w // 4, 96, 4, 2)),
            ("spheres", (48, 96, 192), lambda n: (640, 160, n, 4, 2)),
            ("cameras", (2, 4, 8, 16), lambda k: (640, 160, 96, k, 2)),
        ):
            measured = [_frame(ROOT, method, sizes(value)) for value in values]
            steps = math.log(values[-1] / values[0])
            time_, memory = (math.log(measured[-1][k] / measured[0][k]) / steps for k in (0, 2))
            cells = [
                f"{value}: {wall:.2f} s, {peak:.2f} GB"
                for value, (wall, _, peak) in zip(values, measured, strict=True)
            ]
            print(
                f"{method:10} {what:8} {'; '.join(cells)}; exponents {time_:.2f}, {memory:.2f}",
                flush=True,
            )
    print("\nmemory of `depth`, none of these runs fitted: stated before, and the peak, GiB")
    runs = [(*run, method) for method, of in _NOT_FITTED.items() for run in of.items()]
    for cameras, grid, method in runs:
        with tempfile.TemporaryDirectory() as folder:
            command = (
                f"depth {_write_rig(folder, cameras)} --method {method} --grid {grid} --out OUT"
            )
            peak = _run_command(ROOT, command, Path(folder))[2]
            said = re.search(r"and ([0-9.]+) GiB", Path(folder, "log.txt").read_text())
        assert said is not None
        off = float(said[1]) / peak - 1
        print(f"{cameras} cameras, {method} {grid}: {said[1]}, {peak:.2f} ({off:+.0%})", flush=True)


def _write_rig(folder: str, cameras: int) -> str:
    """Write a rig of so many of the cameras of a sample, from five on anew 0.4 m higher, and return
    the options that read it.
    """
    frame = load_dataset(ROOT / "data_samples/sunny", split="test")[0]
    higher = [Pose.from_vector((0, 0, 0, 0, -0.4 * (k // 4), 0)) for k in range(cameras)]
    poses = [pose @ frame.rig.T_rig_cam[k % 4] for k, pose in enumerate(higher)]
    save_rig(Rig([frame.rig.cameras[k % 4] for k in range(cameras)], poses), Path(folder, "r.yaml"))
    images = " ".join(str(frame.image_paths[k % 4].resolve()) for k in range(cameras))
    return f"--rig {folder}/r.yaml --images {images} --min-depth 1.65"
