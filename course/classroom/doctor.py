"""Check of the clone, by the standard library alone: pinned packages, and the data."""

import hashlib
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path

from omnistereo_tools.installation import (
    Check,
    check_machine,
    check_python,
    installed_version,
    print_checks,
)

_ROOT = Path(__file__).resolve().parents[2]


def doctor(short: bool = False) -> None:
    """Print the result of `check_clone`: the first cell of every notebook."""
    check_clone(short)


def check_clone(short: bool = False) -> bool:
    """Print what is installed and what is missing, with the fix; return whether nothing failed.

    Args:
        short: Print one line if nothing failed. Otherwise one line for each check, and notes on
            cores and memory, which do not count as failures.
    """
    checks = [*check_python(), *_pinned_packages(), *_data()]
    can_look = "missing" not in map(installed_version, ("psutil", "torch"))
    notes = check_machine() if can_look and not short else ()
    return print_checks(checks, notes, "Python, packages and data", short)


def _pinned_packages() -> Iterator[Check]:
    """Compare the installed packages with environment.txt."""
    environment = _ROOT / "environment.txt"
    if not environment.is_file():
        yield False, f"{environment.name} is missing: git checkout {environment.name}"
        return
    pins = re.findall(r"^([\w-]+)==(\S+)", environment.read_text(encoding="utf-8"), re.MULTILINE)
    installed = {name: installed_version(name) for name, _ in pins}
    if {*installed.values()} == {"missing"}:
        yield (
            False,
            (
                f"none of the {len(pins)} packages of environment.txt is installed for"
                f" {sys.executable}: make lab"
            ),
        )
        return
    for name, pinned in pins:
        found = installed[name]
        if found.split("+")[0] == pinned:
            yield True, f"{name} {found}"
        else:
            fix = f"{sys.executable} -m pip install -r environment.txt"
            yield False, f"{name} is {found}, the course is tested with {pinned}: {fix}"


def _data() -> Iterator[Check]:
    """Compare data_samples with its manifest."""
    manifest = _ROOT / "data_samples" / "manifest.json"
    fix = "git checkout data_samples"
    if not manifest.is_file():
        yield False, f"{manifest.name} is missing from data_samples: {fix}"
        return
    try:
        files = dict(json.loads(manifest.read_bytes())["files"])
    except (LookupError, TypeError, ValueError, RecursionError):
        yield False, f"{manifest.name} is broken: {fix}"
        return
    broken = [name for name, sha in files.items() if _sha256(manifest.parent / name) != sha]
    if broken:
        some = ", ".join(broken[:3]) + (" …" if len(broken) > 3 else "")
        found = f"{len(broken)} of {len(files)} data files are missing or changed"
        yield False, f"{found} ({some}): {fix}"
    else:
        yield True, f"data_samples: {len(files)} files with the right checksums"


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "missing"
