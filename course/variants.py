"""SweepNet by several recipes, side by side: ours, the paper's optimiser, without batch norms, and both."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from omnistereo_lib.train import RECIPES, SweepNetRecipe, train
from omnistereo_lib.train.loop import LOG, read_log, write_csv
from omnistereo_lib.train.recipes import PAPERS

_SGD = PAPERS | {"learning_rate": 0.003, "augment": True}
VARIANTS: dict[str, dict[str, Any]] = {
    "ours": {},
    "no batch norm": {"batch_norm": False},
    "SGD": _SGD,
    "SGD and no batch norm": {**_SGD, "batch_norm": False},
}


def compare(out: Path, settings: Sequence[str] = (), data: Path | None = None) -> Path:
    """Train by each variant of the teaching recipe, or resume; return variants.csv, their validation errors."""
    recipe: SweepNetRecipe = RECIPES["sweepnet"]["teaching"].with_overrides(settings)
    runs = {name: out / re.sub(r"\W+", "_", name) for name in VARIANTS}
    for name, changes in VARIANTS.items():
        print(name)
        train(replace(recipe, **changes), runs[name], data)
    write_comparison(out / "variants.csv", runs, recipe.steps)
    return out / "variants.csv"


def write_comparison(path: str | Path, runs: Mapping[str, Path], steps: int) -> None:
    """Write the validation errors of finished runs (name → folder) as CSV: the step, and a column for each run."""
    curves = {name: read_log(run / LOG, steps) for name, run in runs.items()}
    validated = (rows for rows in zip(*curves.values(), strict=True) if not math.isnan(rows[0]["validation_error"]))
    table = ([rows[0]["step"] + 1, *(f"{row['validation_error']:.4g}" for row in rows)] for rows in validated)
    write_csv(path, ["step", *curves], table)
