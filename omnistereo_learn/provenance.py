"""What made a number: a block of facts in each folder of results, and how two of them differ.

In `provenance.json`, or beside the settings in `recording.json` and `world.json`:

provenance:
  version     of this library
  rig         checksum of lenses, masks, poses and nearest depth
  inputs      checksum of what was computed from: images, corners, files of data
  method      by its name
  precision   of the products of a network, where there is one
  threads     that computed, where the last digits depend on them: networks add in other orders
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from omnistereo_lib.errors import OmnistereoError, shortened
from omnistereo_lib.files import checksum, parse_json, read_text, write_text
from omnistereo_lib.geometry.rig import Rig

Precision = Literal["auto", "float32", "bfloat16"]  # see `choose_precision`
PROVENANCE = "provenance.json"
_SUMS = ("rig", "inputs")  # whose checksums say nothing to a reader
_NOTED = ("version", "threads")  # may differ between parts of one result, by last digits


def provenance(
    rig: Rig | str | None,
    inputs: str,
    method: str,
    precision: str | None = None,
    threads: int | None = None,
) -> dict[str, Any]:
    """Return the block of a result; see the module. What is None is left out.

    Args:
        rig: The rig, or the checksum of its files.
        inputs: Checksum, such as `arrays_checksum`.
    """
    of_rig = rig_checksum(rig) if isinstance(rig, Rig) else rig
    facts: dict[str, Any] = {"version": _version(), "rig": of_rig, "inputs": inputs}
    facts |= {"method": method, "precision": precision, "threads": threads}
    return {name: fact for name, fact in facts.items() if fact is not None}


def _version() -> str:
    with suppress(metadata.PackageNotFoundError):
        return metadata.version("omnistereo-lib")
    return "unknown"


def rig_checksum(rig: Rig) -> str:
    """Return a checksum of what depth depends on: lenses, masks, poses and the nearest depth."""
    content = repr(rig.min_depth).encode()
    for lens, pose in zip(rig.cameras, rig.T_rig_cam, strict=True):
        names = ("poly", "inv_poly", "center", "affine", "image_size", "max_fov_deg")
        # A fit has other last digits elsewhere.
        for values in (*(getattr(lens, name) for name in names), pose.R, pose.t):
            content += np.asarray(values, np.float32).tobytes()
        content += b"" if lens.mask is None else lens.mask.tobytes()
    return checksum(content)[:16]


def arrays_checksum(arrays: Iterable[ArrayLike]) -> str:
    """Return a checksum of arrays: their types, shapes and values."""
    each = map(np.asarray, arrays)
    content = (f"{a.dtype.str} {a.shape}".encode() + a.tobytes() for a in each)
    return checksum(b"".join(content))[:16]


def write_facts(path: Path, facts: Mapping[str, Any]) -> None:
    """Write facts as JSON, atomically."""
    write_text(path, json.dumps(facts, indent=1) + "\n")


def read_facts(path: Path) -> dict[str, Any]:
    """Return what an earlier run has stored in a JSON file; nothing if it cannot be read."""
    with suppress(OmnistereoError):
        if isinstance(stored := parse_json(read_text(path), path), dict):
            return stored
    return {}


def made_of(facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return the block of provenance of what is stored; nothing if it has none."""
    made = facts.get("provenance")
    return made if isinstance(made, dict) else {}


def kept_precision(asked: Precision, stored: Mapping[str, Any]) -> Precision:
    """Return the precision asked for; of "auto" that in which the stored result was begun."""
    began = made_of(stored).get("precision")
    return began if asked == "auto" and began in ("float32", "bfloat16") else asked


def differences(there: Mapping[str, Any], here: Mapping[str, Any]) -> list[str]:
    """Return in words how two sets of facts differ: "method: zncc+sgm there, volumenet here".

    The facts of a block of provenance count by themselves; version and threads are `notes`.
    """
    return [words for name, words in _compared(there, here) if name not in _NOTED]


def notes(there: Mapping[str, Any], here: Mapping[str, Any]) -> list[str]:
    """Return in words which of version and threads differ: they change the last digits."""
    return [words for name, words in _compared(there, here) if name in _NOTED]


def _compared(there: Mapping[str, Any], here: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    old, new = _flat(there), _flat(here)
    for name in dict.fromkeys([*new, *old]):
        if old.get(name) != new.get(name):
            found = (
                shortened(one[name]).strip("'") if name in one else "nothing" for one in (old, new)
            )
            yield (
                name,
                f"other {name}" if name in _SUMS else "{}: {} there, {} here".format(name, *found),
            )


def _flat(facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return facts without nesting, by their own names."""
    flat: dict[str, Any] = {}
    for name, fact in facts.items():
        flat |= _flat(fact) if isinstance(fact, dict) else {name: fact}
    return flat
