"""SweepNet by several recipes, side by side: ours, the paper's optimiser, without batch norms, and
both.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from omnistereo_learn import RECIPES, train
from omnistereo_learn.loop import LOG, read_log, write_csv
from omnistereo_learn.recipes import PAPERS

_SGD = PAPERS | {"learning_rate": 0.003, "augment": True}
VARIANTS: dict[str, dict[str, Any]] = {
    "ours": {},
    "no batch norm": {"batch_norm": False},
    "SGD": _SGD,
    "SGD and no batch norm": {**_SGD, "batch_norm": False},
}
_SHORT = ("steps=300", "validate_every=30", "validation_groups=24")


def compare_sweepnets(out: Path, settings: Sequence[str] = _SHORT) -> Path:
    """Train each variant of the teaching recipe, or resume; return variants.csv: the validation
    errors by step.
    """
    recipe = RECIPES["sweepnet"]["teaching"].with_overrides(settings)
    logs = []
    for name, changes in VARIANTS.items():
        print(name)
        run = out / re.sub(r"\W+", "_", name)
        train(replace(recipe, **changes), run)
        logs.append(read_log(run / LOG, recipe.steps))
    table = [
        [rows[0]["step"] + 1, *(f"{row['validation_error']:.4g}" for row in rows)]
        for rows in zip(*logs, strict=True)
        if not math.isnan(rows[0]["validation_error"])
    ]
    write_csv(out / "variants.csv", ["step", *VARIANTS], table)
    return out / "variants.csv"
