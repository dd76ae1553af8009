"""Results on disk: each a small file that says what it depends on, so that any of them can be put together.

A record holds one method's errors in one frame, the settings, and the checksums of all files that went in. The
results of many are the union of their records, and a contradiction between two is found by taking it.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import atomic_write, make_folder, read_bytes

Record = dict[str, Any]  # nested, with strings as keys; what JSON holds
_DEPENDS_ON = ("config", "methods", "data", "weights")


def checksum(content: bytes) -> str:
    """Return the SHA-256 of a file's content."""
    return hashlib.sha256(content).hexdigest()


def config_checksum(results: Record) -> str:
    """Return the SHA-256 of the settings, as compact JSON with sorted keys."""
    settings = {name: results[name] for name in ("config", "methods")}
    return checksum(json.dumps(settings, sort_keys=True, separators=(",", ":")).encode())


def write_record(path: Path, record: Record) -> None:
    """Write a record as JSON with sorted keys, whole or not at all; an object of plain values takes one line."""
    make_folder(path.parent)
    text = json.dumps(record, indent=1, sort_keys=True, allow_nan=False)
    text = re.sub(r"\{[^{}]*\}", lambda found: re.sub(r"\n *", " ", found[0]), text)  # no text holds a newline itself
    with atomic_write(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def read_record(path: Path) -> Record:
    """Read a record.

    Raises
    ------
    OmnistereoError
        If the file is missing or not what `write_record` writes.
    """
    try:
        record = json.loads(read_bytes(path))
    except ValueError as error:
        raise OmnistereoError(f"{path} is damaged ({error}): delete it, and it is computed anew") from None
    if not isinstance(record, dict) or not {*_DEPENDS_ON, "frames"} <= record.keys():
        raise OmnistereoError(f"{path} holds no results of an evaluation: delete it, or choose another folder")
    return record


def check_record(path: Path, expected: Record) -> Record:
    """Read a record and compare what it depends on with what the results of today depend on.

    Raises
    ------
    OmnistereoError
        If a setting or a checksum that both state differs; the message names each.
    """
    record = read_record(path)
    found = [f for part in _DEPENDS_ON for f in _differences(record[part], expected.get(part, {}), part)]
    if found:
        more = f" and {len(found) - 6} more" if len(found) > 6 else ""
        raise OmnistereoError(
            f"{path} is of another evaluation ({'; '.join(found[:6])}{more}): "
            "choose another folder, or delete this one to start anew"
        )
    return record


def _differences(there: Any, here: Any, name: str) -> Iterator[str]:
    """Yield in words where two records contradict each other; what only one of them states is no contradiction."""
    if isinstance(there, dict) and isinstance(here, dict):
        for key in sorted(there.keys() & here.keys()):
            yield from _differences(there[key], here[key], f"{name} {key}")
    elif there != here:
        yield f"{name} = {_short(there)} there, {_short(here)} here"


def _short(value: Any) -> str:
    """Return a value as text, checksums by their first digits."""
    text = str(value)
    return f"{text[:12]}…" if len(text) == 64 else text


def add_record(total: Record, record: Record) -> None:
    """Add to a record what another one states."""
    for key, value in record.items():
        if isinstance(value, dict):
            add_record(total.setdefault(key, {}), value)
        else:
            total[key] = value
