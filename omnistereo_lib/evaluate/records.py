"""Evaluation results: one JSON file per frame and method, with checksums of its inputs so that runs can be merged."""

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from omnistereo_lib.errors import OmnistereoError, check_number, shortened
from omnistereo_lib.evaluate.methods import EvaluatedMethod
from omnistereo_lib.evaluate.regions import METRICS, REGIONS, SUMS
from omnistereo_lib.files import atomic_write, make_folder, read_data

Record = dict[str, Any]  # nested, with strings as keys; what JSON holds
_INPUTS = ("config", "methods", "data", "weights")


def checksum(content: bytes) -> str:
    """Return the SHA-256 of a file's content."""
    return hashlib.sha256(content).hexdigest()


def config_checksum(results: Record) -> str:
    """Return the SHA-256 of the settings, as compact JSON with sorted keys."""
    settings = {name: results[name] for name in ("config", "methods")}
    return checksum(json.dumps(settings, sort_keys=True, separators=(",", ":")).encode())


def write_record(path: Path, record: Record) -> None:
    """Write a record atomically as compact JSON with sorted keys."""
    make_folder(path.parent)
    with atomic_write(path) as temporary:
        text = json.dumps(record, sort_keys=True, separators=(",", ":"), allow_nan=False)
        temporary.write_text(text + "\n", encoding="utf-8")


def read_record(path: Path) -> Record:
    """Read a record; an `OmnistereoError` says that the file is missing or not one of `write_record`."""
    record = read_data(path)
    if not isinstance(record, dict) or not {*_INPUTS, "frames"} <= record.keys():
        raise OmnistereoError(f"{path} has no results of an evaluation. Delete it, or choose another folder.")
    try:
        _check_results(record)
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        found = f"{path} is damaged ({type(error).__name__}: {str(error)[:300]})"
        raise OmnistereoError(f"{found}. Delete it and evaluate again.") from None
    return record


def _check_results(record: Record) -> None:
    """Raise one of several types if settings or results are not of the form that `write_record` is given."""
    for name in ("width", "height", "num_spheres"):
        check_number(record["config"][name], name, 1, 1_000_000, whole=True)
    if not isinstance(record["config"]["rig"], str) or not all(isinstance(record[part], dict) for part in _INPUTS):
        raise TypeError(f"rig is {shortened(record['config']['rig'])}")
    names = {name: EvaluatedMethod(**settings).name for name, settings in record["methods"].items()}
    if names != {name: name for name in names}:
        raise ValueError(f"the settings of {shortened(names)} are of other methods")
    if not (names and record["frames"] and all(record["frames"].values())):
        raise KeyError("no methods or no frames")
    for results in (frame for of_set in record["frames"].values() for frame in of_set.values()):
        if results.keys() != names.keys():
            raise KeyError(f"the methods of a frame are {sorted(results)}")
        for errors in results.values():
            for metric in METRICS:
                value = errors["figures"][metric]
                value is None or check_number(value, metric, 0, 1e9)
            if not errors["strata"].keys() >= {*REGIONS}:
                raise KeyError("a region is missing")
            for region, sums in errors["strata"].items():
                rays = check_number(sums["rays"], f"rays of {region}", 0, min(1e12, errors["strata"]["all"]["rays"]))
                for key in SUMS:  # an error is at most 100 % of N
                    check_number(sums[key], f"{region} {key}", 0, 1e4 * rays)


def check_record(path: Path, expected: Record) -> Record:
    """Read a record; an `OmnistereoError` names each setting or checksum that differs from the expected record."""
    record = read_record(path)
    found = [f for part in _INPUTS for f in _differences(record[part], expected.get(part, {}), part)]
    if found:
        more = f" and {len(found) - 6} more" if len(found) > 6 else ""
        raise OmnistereoError(
            f"{path} belongs to a different evaluation ({'; '.join(found[:6])}{more}). "
            "Use another output folder, or delete this one to start over."
        )
    return record


def _differences(there: Any, here: Any, name: str) -> Iterator[str]:
    """Yield the contradictions of two records as text; a key of only one of them is not a contradiction."""
    if isinstance(there, dict) and isinstance(here, dict):
        for key in sorted(there.keys() & here.keys()):
            yield from _differences(there[key], here[key], f"{name} {key}")
    elif there != here:
        short = [f"{text[:12]}…" if len(text) == 64 else text for text in (str(there), str(here))]  # 64: checksums
        yield f"{name} = {short[0]} there, {short[1]} here"


def add_record(total: Record, record: Record) -> None:
    """Merge a record into another one, in place."""
    for key, value in record.items():
        if isinstance(value, dict):
            add_record(total.setdefault(key, {}), value)
        else:
            total[key] = value
