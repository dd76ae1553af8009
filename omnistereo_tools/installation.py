"""Check of the installation: one line per requirement, OK or FAIL with the fix."""

import os
import re
import sys
from collections.abc import Iterable, Iterator
from importlib import metadata

_MIN_PYTHON = (3, 11)
_MIN_MEMORY_GIB = 4

Check = tuple[bool, str]  # whether it passed, and the line to print


def doctor() -> bool:
    """Print what the library needs and what of it is missing, with the fix; return whether nothing
    failed.

    Cores and memory are notes, which do not count as failures.
    """
    unchecked = (
        False,
        (
            "packages and data of the course are not checked: in its clone, python -m course doctor"
            " does"
        ),
    )
    checks = [*check_python(), *_required_packages()]
    return print_checks(checks, (unchecked, *check_machine()), "Python and packages")


def print_checks(
    checks: Iterable[Check], notes: Iterable[Check], what: str, short: bool = False
) -> bool:
    """Print checks and notes, or in short only what failed; return whether no check failed."""
    checks = list(checks)
    failed = [line for passed, line in checks if not passed]
    if short:
        print("\n".join(f"FAIL  {line}" for line in failed) or f"OK    {what} are in place")
        return not failed
    count = f"{len(failed)} thing{'s' * (len(failed) > 1)} to fix, marked FAIL"
    print(count if failed else f"OK    {what} are in place")
    for passed, line in checks:
        print(f"{'OK  ' if passed else 'FAIL'}  {line}")
    for passed, line in notes:
        print(f"{'OK  ' if passed else 'NOTE'}  {line}")
    return not failed


def check_python() -> Iterator[Check]:
    """Yield whether Python is new enough."""
    version = ".".join(map(str, sys.version_info[:3]))
    passed = sys.version_info[:2] >= _MIN_PYTHON
    fix = "" if passed else ": install 3.11 or newer, remove .venv and run make lab again"
    yield passed, f"Python {version}{fix}"


def _required_packages() -> Iterator[Check]:
    """Compare the installed packages with the requirements of the distribution, without extras."""
    try:
        requirements = metadata.requires("omnistereo-lib") or []
    except metadata.PackageNotFoundError:
        yield False, "omnistereo-lib is neither installed nor in its clone: pip install it"
        return
    for requirement in requirements:
        name, minimum = re.findall(r"^([\w-]+)(?:>=([\d.]+))?", requirement)[0]
        if "extra ==" in requirement:
            continue
        found = installed_version(name)
        passed = found != "missing" and _numbers(found) >= _numbers(minimum or "0")
        fix = "" if passed else f": pip install '{requirement}'"
        yield passed, f"{name} {'is ' if fix else ''}{found}{fix}"


def installed_version(name: str) -> str:
    """Return the version of an installed distribution, or "missing"."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "missing"


def _numbers(version: str) -> list[int]:
    return [int(number) for number in re.findall(r"^[\d.]*", version)[0].split(".") if number]


def check_machine() -> Iterator[Check]:
    """Yield what is known of cores, memory and GPU."""
    import psutil
    import torch

    memory = psutil.virtual_memory()
    total, free = memory.total / 2**30, memory.available / 2**30
    yield True, f"{os.cpu_count()} cores"
    fix = (
        ""
        if free >= _MIN_MEMORY_GIB
        else f": at least {_MIN_MEMORY_GIB} GiB are needed, close other programs"
    )
    yield free >= _MIN_MEMORY_GIB, f"{free:.1f} of {total:.1f} GiB memory free{fix}"
    gpu = torch.cuda.get_device_name() if torch.cuda.is_available() else None
    yield True, f"GPU: {gpu}" if gpu else "no CUDA GPU: everything runs on the CPU"
