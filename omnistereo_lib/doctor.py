"""Check of the installation: one line per requirement, OK or FAIL with the fix."""

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

Check = tuple[bool, str]  # whether it passed, and the line to print


def doctor(short: bool = False) -> None:
    """Print the result of `check_installation`: the first cell of every notebook."""
    check_installation(short)


def check_installation(short: bool = False) -> bool:
    """Print what is installed and what is missing, with the fix; return whether nothing failed.

    In a clone the packages are compared with the pins of environment.txt, and the data with its manifest. Elsewhere
    the packages are compared with the requirements of the installed distribution.

    Args:
        short: Only Python, the packages and the data, in one line if nothing failed. Otherwise one line for each, and
            notes on OpenGL, cores and memory, which do not count as failures.
    """
    in_clone = (_ROOT / "environment.txt").is_file()
    checks = [*_python(), *(_pinned_packages() if in_clone else _required_packages())]
    if in_clone:
        checks += _data()
    failed = [line for passed, line in checks if not passed]
    if short:
        found = "Python, packages and data are" if in_clone else "Python and packages are"
        print("\n".join(f"FAIL  {line}" for line in failed) or f"OK    {found} in place")
        return not failed
    for passed, line in checks:
        print(f"{'OK  ' if passed else 'FAIL'}  {line}")
    if not in_clone:
        print("NOTE  installed without the course: data_samples is not checked")
    for passed, line in [*(_opengl() if in_clone else ()), *_machine()]:
        print(f"{'OK  ' if passed else 'NOTE'}  {line}")
    return not failed


def _python() -> Iterator[Check]:
    version = ".".join(map(str, sys.version_info[:3]))
    passed = sys.version_info[:2] >= _MIN_PYTHON
    fix = "" if passed else ": install 3.11 or newer, remove .venv and run make lab again"
    yield passed, f"Python {version}{fix}"


def _pinned_packages() -> Iterator[Check]:
    """Compare the installed packages with environment.txt."""
    pins = re.findall(r"^([\w-]+)==(\S+)", (_ROOT / "environment.txt").read_text(), re.MULTILINE)
    for name, pinned in pins:
        found = _installed_version(name)
        if found.split("+")[0] == pinned:
            yield True, f"{name} {found}"
        else:
            fix = "pip install -r environment.txt"
            yield False, f"{name} is {found}, the course is tested with {pinned}: {fix}"


def _required_packages() -> Iterator[Check]:
    """Compare the installed packages with the requirements of the distribution, its extras aside."""
    try:
        requirements = metadata.requires("omnistereo-lib") or []
    except metadata.PackageNotFoundError:
        yield False, "omnistereo-lib is neither installed nor in its clone: pip install it"
        return
    for requirement in requirements:
        name, minimum = re.fullmatch(r"([\w-]+)(?:>=([\d.]+))?.*", requirement).groups()
        if "extra ==" in requirement:
            continue
        found = _installed_version(name)
        passed = found != "missing" and _numbers(found) >= _numbers(minimum or "0")
        fix = "" if passed else f": pip install '{requirement}'"
        yield passed, f"{name} {'is ' if fix else ''}{found}{fix}"


def _installed_version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "missing"


def _numbers(version: str) -> list[int]:
    return [int(number) for number in re.match(r"[\d.]*", version)[0].split(".") if number]


def _data() -> Iterator[Check]:
    """Compare data_samples with its manifest."""
    manifest = _ROOT / "data_samples" / "manifest.json"
    fix = "git checkout data_samples"
    if not manifest.is_file():
        yield False, f"{manifest.name} is missing from data_samples: {fix}"
        return
    try:
        files = json.loads(manifest.read_text())["files"]
    except (ValueError, KeyError):
        yield False, f"{manifest.name} is broken: {fix}"
        return
    broken = [name for name, checksum in files.items() if _sha256(manifest.parent / name) != checksum]
    if broken:
        some = ", ".join(broken[:3]) + (" …" if len(broken) > 3 else "")
        yield False, f"{len(broken)} of {len(files)} data files are missing or changed ({some}): {fix}"
    else:
        yield True, f"data_samples: {len(files)} files with the right checksums"


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "missing"


def opengl_works() -> bool:
    """Return whether PyVista can render here, tried in a separate process: without OpenGL, VTK crashes."""
    command = [sys.executable, "-c", _RENDER_PROBE]
    try:
        probe = subprocess.run(command, capture_output=True, env=headless(), check=False, timeout=_PROBE_SECONDS)
    except subprocess.TimeoutExpired:
        return False
    return probe.returncode == 0


def headless() -> dict[str, str]:
    """Return the environment in which VTK renders without a display and without a warning about it."""
    if sys.platform == "linux" and "DISPLAY" not in os.environ:
        return {**os.environ, "VTK_DEFAULT_OPENGL_WINDOW": "vtkEGLRenderWindow"}
    return dict(os.environ)


def _opengl() -> Iterator[Check]:
    passed = opengl_works()
    fix = "no OpenGL: point clouds are drawn by NumPy; on Debian: apt install libegl1 libgl1-mesa-dri"
    yield passed, "OpenGL: PyVista draws point clouds" if passed else fix


def _machine() -> Iterator[Check]:
    import psutil
    import torch

    memory = psutil.virtual_memory()
    total, free = memory.total / 2**30, memory.available / 2**30
    yield True, f"{os.cpu_count()} cores"
    fix = "" if free >= _MIN_MEMORY_GIB else f": at least {_MIN_MEMORY_GIB} GiB are needed, close other programs"
    yield free >= _MIN_MEMORY_GIB, f"{free:.1f} of {total:.1f} GiB memory free{fix}"
    gpu = torch.cuda.get_device_name() if torch.cuda.is_available() else None
    yield True, f"GPU: {gpu}" if gpu else "no CUDA GPU: everything runs on the CPU"
