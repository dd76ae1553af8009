"""The data: a procedural city, a room, training worlds and boards, rendered with Blender as a
Python module.

Blender runs in an environment of its own (environment-render.txt), because it needs an older NumPy;
`main` finds it. Blender is under the GNU General Public License, and its makers take scripts that
import `bpy` to be covered by it: whoever passes on the modules of this folder that do should treat
them so. Nothing outside this folder imports bpy.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from omnistereo_lib.errors import EXIT_STATUS, OmnistereoError
from omnistereo_lib.files import unpack
from workshop.render.boards.board_captures import is_captured, render_captures
from workshop.render.boards.positions import CAPTURES
from workshop.render.image_sets import (
    SEED,
    SETS,
    forget_partial,
    is_complete,
    pack,
    render_set,
    select_shard,
    write_manifest,
)
from workshop.render.worlds import WORLDS, is_rendered, render_worlds

_ALL = SETS | WORLDS | CAPTURES
_HELP = """\
Render data sets with Blender: sunny/test, unless others are named.

Frames that are there already are skipped, which in a clone are all of them: with --out they are
rendered again.
A frame of four images of 800 × 768 pixels takes about half a minute on two cores.

Examples:
  python -m workshop.render sunny/test --frames 706 --out out/render
      one frame
  python -m workshop.render indoor/test calibration/van --out out/render
      all frames of two sets
"""
_ROOT = Path(__file__).resolve().parents[2]
_BLENDER_PYTHON = (
    _ROOT / ".venv-render" / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `python -m workshop.render`; return the exit status. Bad input is one plain line."""
    sets = ", ".join(f"{name} ({len(_ALL[name].shipped)})" for name in _ALL)
    parser = argparse.ArgumentParser(
        prog="python -m workshop.render",
        description=_HELP,
        epilog=EXIT_STATUS,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "sets",
        nargs="*",
        metavar="SET",
        help=f"sets and their frames: {sets} (default: sunny/test)",
    )
    parser.add_argument(
        "--frames", type=int, nargs="+", help="frame or capture numbers (default: those that ship)"
    )
    parser.add_argument(
        "--shard", default="1/1", help="part i/n of the frames, for several machines (default: 1/1)"
    )
    parser.add_argument(
        "--seed", type=int, default=SEED, help=f"of the city and the rig (default: {SEED})"
    )
    parser.add_argument(
        "--out", type=Path, default=_ROOT / "data_samples", help="default: data_samples"
    )
    try:
        return render(**vars(parser.parse_args(arguments)))
    except OmnistereoError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted; run the same command to resume", file=sys.stderr)
        return 130


def render(sets: list[str], frames: list[int] | None, shard: str, seed: int, out: Path) -> int:
    """Render the frames that are missing, here or in Blender's environment; return the exit status.

    Raises:
        OmnistereoError: If a set, a frame or a shard does not exist, or Blender's environment is
            missing.
    """
    wanted = {name: select_shard(_numbers(name, frames), shard) for name in sets or ["sunny/test"]}
    if seed < 0:
        raise OmnistereoError(f"a seed is a whole number from 0 up, got {seed}")
    if importlib.util.find_spec("bpy") is None:
        command = [_find_blender_python(), "-m", "workshop.render", *sets]
        command += ["--frames", *map(str, frames)] if frames else []
        command += ["--shard", shard, "--seed", str(seed), "--out", out.absolute()]
        return subprocess.run(command, cwd=_ROOT, check=False).returncode
    for name, numbers in wanted.items():
        unpack(out.absolute() / name)
        _render(out.absolute() / name, name, numbers, seed)
    for folder in [archive.with_suffix("") for archive in out.rglob("*.zip")]:
        if any((out / name).is_relative_to(folder) for name in wanted):
            pack(folder)
    there = " ".join(name for name in _ALL if (out / name).is_dir())
    write_manifest(out, seed, f"python -m workshop.render {there} --seed {seed}")
    return 0


def _numbers(name: str, frames: list[int] | None) -> tuple[int, ...]:
    if name not in _ALL:
        raise OmnistereoError(f"there is no image set {name!r}: choose from {', '.join(_ALL)}")
    images = _ALL[name]
    for number in frames or ():
        if not images.first <= number < images.first + images.count:
            last = images.first + images.count - 1
            raise OmnistereoError(f"{name} has the frames {images.first} to {last}, not {number}")
    return tuple(dict.fromkeys(frames)) if frames else images.shipped


def _render(folder: Path, name: str, numbers: tuple[int, ...], seed: int) -> None:
    from tqdm import tqdm

    missing = [number for number in numbers if not _is_done(folder, name, number, seed)]
    there = len(numbers) - len(missing)
    with tqdm(total=len(numbers), initial=there, desc=name, unit="frame") as bar:
        for _ in _render_here(folder, name, numbers, seed):
            bar.update()


def _is_done(folder: Path, name: str, number: int, seed: int) -> bool:
    if name in CAPTURES:
        return is_captured(folder, CAPTURES[name], number, seed)
    if name in WORLDS:
        return is_rendered(folder, number)
    return is_complete(folder, SETS[name], number)


def _render_here(folder: Path, name: str, numbers: tuple[int, ...], seed: int) -> Iterator[int]:
    if name in CAPTURES:
        return render_captures(folder, CAPTURES[name], numbers, seed)
    if name in WORLDS:
        return render_worlds(folder, WORLDS[name], numbers, seed)
    forget_partial(folder, SETS[name], numbers)
    return render_set(folder, SETS[name], numbers, seed)


def _find_blender_python() -> Path:
    environment = _BLENDER_PYTHON.parents[1]
    if not _BLENDER_PYTHON.is_file() or Path(sys.prefix).resolve() == environment.resolve():
        raise OmnistereoError(
            f"Blender's environment is missing or unfinished ({environment.name}): run make render,"
            " or python3.11 -m venv .venv-render and .venv-render/bin/pip install -r"
            " environment-render.txt"
        )
    return _BLENDER_PYTHON
