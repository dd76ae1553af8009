"""Files of results: one per frame and method, and `results.json` of them all."""

import json
from pathlib import Path
from typing import Any

from omnistereo_learn.evaluate.methods import EvaluatedMethod
from omnistereo_learn.evaluate.regions import METRICS, REGIONS, SUMS
from omnistereo_lib.errors import OmnistereoError, check_number, shortened
from omnistereo_lib.files import checksum, make_folder, read_data, write_text

# nested, as JSON holds it; its keys "figures" and "strata" are the metrics and the regions
Record = dict[str, Any]
_INPUTS = ("config", "methods", "data", "weights")


def config_checksum(results: Record, *more: str) -> str:
    """Return the SHA-256 of settings and inputs, as compact JSON with sorted keys."""
    settings = {name: results[name] for name in ("config", "methods", *more)}
    return checksum(json.dumps(settings, sort_keys=True, separators=(",", ":")).encode())


def write_record(path: Path, record: Record) -> None:
    """Write a record atomically as compact JSON with sorted keys."""
    make_folder(path.parent)
    write_text(
        path, json.dumps(record, sort_keys=True, separators=(",", ":"), allow_nan=False) + "\n"
    )


def rounded(errors: Any) -> Any:
    """Return nested results with five decimals, which is more than they mean."""
    if isinstance(errors, dict):
        return {key: rounded(value) for key, value in errors.items()}
    return round(errors, 5) if isinstance(errors, float) else errors


def read_errors(path: Path, inputs_sha256: str) -> Record | None:
    """Read the errors of a method on a frame; None where there are none, or none that are whole.

    Raises an `OmnistereoError` if they are of other inputs.
    """
    if path.is_dir():
        raise OmnistereoError(f"{path} is a folder; expected a file of results, or none. Remove it")
    try:
        record = read_data(path)
        other = record["inputs"] != inputs_sha256
        if not other:
            _check_errors(record["errors"])
    except (KeyError, TypeError, AttributeError, ValueError):
        return None
    if other:
        raise OmnistereoError(
            f"{path} comes from another scale, rig or precision, from other data or other weights. "
            "Use another output folder, or delete this one to start over."
        )
    return record["errors"]


def read_record(path: Path) -> Record:
    """Read a results.json; an `OmnistereoError` if it is missing, damaged or something else."""
    record = read_data(path)
    if not isinstance(record, dict) or not {*_INPUTS, "frames"} <= record.keys():
        raise OmnistereoError(
            f"{path} has no results of an evaluation. Delete it, or choose another folder."
        )
    try:
        _check_results(record)
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        found = f"{path} is damaged ({type(error).__name__}: {str(error)[:300]})"
        raise OmnistereoError(f"{found}. Delete it and evaluate again.") from None
    return record


def _check_results(record: Record) -> None:
    """Raise one of several types if settings or results are not as `write_record` gets them."""
    for name in ("width", "height", "num_spheres"):
        check_number(record["config"][name], name, 1, 1_000_000, whole=True)
    if not isinstance(record["config"]["rig"], str) or not all(
        isinstance(record[part], dict) for part in _INPUTS
    ):
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
            _check_errors(errors)


def _check_errors(errors: Record) -> None:
    """Raise one of several types if errors are not as `evaluate_frame` gives them."""
    for metric in METRICS:
        if errors["figures"][metric] is not None:
            check_number(errors["figures"][metric], metric, 0, 1e9)
    if not errors["strata"].keys() >= {*REGIONS}:
        raise KeyError("a region is missing")
    for region, sums in errors["strata"].items():
        rays = check_number(
            sums["rays"], f"rays of {region}", 0, min(1e12, errors["strata"]["all"]["rays"])
        )
        for key in SUMS:  # an error is at most 100 % of N
            check_number(sums[key], f"{region} {key}", 0, 1e4 * rays)
