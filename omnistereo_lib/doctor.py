"""Is everything in place that the course needs? One line each, OK or FAIL with the cure."""

from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[1]
_MIN_PYTHON = (3, 11)
_MIN_MEMORY_GIB = 4
_PROBE_SECONDS = 60

_RENDER_PROBE = """
import pyvista
plotter = pyvista.Plotter(off_screen=True, window_size=(64, 64))
plotter.add_mesh(pyvista.Sphere())
assert plotter.screenshot(return_img=True).std() > 0
"""


def doctor(short: bool = False) -> None:
    """Print what `check_installation` finds: the first cell of every notebook."""
    check_installation(short)


def check_installation(short: bool = False) -> bool:
    """Print what is in place and what is missing, with the cure.

    Parameters
    ----------
    short : bool
        Only Python, the packages and the data, in one line when all is well. Otherwise OpenGL, cores and
        memory too, a line each.

    Returns
    -------
    bool
        Whether nothing failed (a missing OpenGL or a small machine is a note, not a failure).
    """
    checks = [*_python(), *_packages(), *_data()]
    failed = [line for ok, line in checks if not ok]
    if short:
        print("\n".join(f"FAIL  {line}" for line in failed) or "OK    Python, packages and data are in place")
        return not failed
    for ok, line in checks:
        print(f"{'OK  ' if ok else 'FAIL'}  {line}")
    for ok, line in [*_opengl(), *_machine()]:
        print(f"{'OK  ' if ok else 'NOTE'}  {line}")
    return not failed


def _python() -> Iterator[tuple[bool, str]]:
    version = ".".join(map(str, sys.version_info[:3]))
    if sys.version_info[:2] >= _MIN_PYTHON:
        yield True, f"Python {version}"
    else:
        yield False, f"Python {version}: install 3.11 or newer, remove .venv and run make lab again"


def _packages() -> Iterator[tuple[bool, str]]:
    """Compare what is installed with the pins of environment.txt."""
    pins = re.findall(r"^([\w-]+)==(\S+)", (_ROOT / "environment.txt").read_text(), re.MULTILINE)
    for name, wanted in pins:
        try:
            found = metadata.version(name)
        except metadata.PackageNotFoundError:
            found = "missing"
        if found.split("+")[0] == wanted:
            yield True, f"{name} {found}"
        else:
            yield (
                False,
                f"{name} is {found}, the course is tested with {wanted}: pip install -r environment.txt",
            )


def _data() -> Iterator[tuple[bool, str]]:
    """Compare data_samples with its manifest."""
    manifest = _ROOT / "data_samples" / "manifest.json"
    if not manifest.is_file():
        yield False, f"{manifest.name} is missing from data_samples: git checkout data_samples"
        return
    try:
        files = json.loads(manifest.read_text())["files"]
    except (ValueError, KeyError):
        yield False, f"{manifest.name} is broken: git checkout data_samples"
        return
    broken = [name for name, checksum in files.items() if _sha256(manifest.parent / name) != checksum]
    if broken:
        some = ", ".join(broken[:3]) + (" …" if len(broken) > 3 else "")
        yield (
            False,
            f"{len(broken)} of {len(files)} data files are missing or changed ({some}): git checkout data_samples",
        )
    else:
        yield True, f"data_samples: {len(files)} files with the right checksums"


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "missing"


def opengl_works() -> bool:
    """Return whether PyVista can draw here, tried in a process of its own: without OpenGL, VTK crashes."""
    command = [sys.executable, "-c", _RENDER_PROBE]
    try:
        probe = subprocess.run(command, capture_output=True, env=headless(), check=False, timeout=_PROBE_SECONDS)
    except subprocess.TimeoutExpired:
        return False
    return probe.returncode == 0


def headless() -> dict[str, str]:
    """Return the environment in which VTK draws without a screen, and without complaining that there is none."""
    if sys.platform == "linux" and "DISPLAY" not in os.environ:
        return {**os.environ, "VTK_DEFAULT_OPENGL_WINDOW": "vtkEGLRenderWindow"}
    return dict(os.environ)


def _opengl() -> Iterator[tuple[bool, str]]:
    if opengl_works():
        yield True, "OpenGL: PyVista draws point clouds"
    else:
        yield (
            False,
            "no OpenGL: point clouds are drawn by NumPy; on Debian: apt install libegl1 libgl1-mesa-dri",
        )


def _machine() -> Iterator[tuple[bool, str]]:
    import psutil
    import torch

    memory = psutil.virtual_memory()
    total, free = memory.total / 2**30, memory.available / 2**30
    yield True, f"{os.cpu_count()} cores"
    cure = "" if free >= _MIN_MEMORY_GIB else f": the notebooks want {_MIN_MEMORY_GIB} GiB, close other programs"
    yield free >= _MIN_MEMORY_GIB, f"{free:.1f} of {total:.1f} GiB memory free{cure}"
    gpu = torch.cuda.get_device_name() if torch.cuda.is_available() else None
    yield True, f"GPU: {gpu}" if gpu else "no CUDA GPU: everything runs on the CPU"
