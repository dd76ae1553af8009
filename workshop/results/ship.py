"""Bundle the weights of a finished run: the file, its learning curve and a model card."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from omnistereo_learn.loop import LOG, WEIGHTS, read_log, write_csv
from omnistereo_learn.recipes import RECIPES, MCCNNRecipe, Recipe
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import make_folder, read_bytes, write_text
from omnistereo_lib.stereo.weights import BUNDLED_WEIGHTS, load_tensors, save_tensors, signature

Rows = Sequence[dict[str, float]]  # a training log
_EVERY = 10  # steps between two rows of the curve
_CARD = """# {file}

`{network}`, SHA-256 `{sha256}`

Written by `{command}`.

- **Data:** {folder}, {frames} frames, every tenth only for validation; SHA-256 of all of them \
`{data_sha256}`. No test street is among them.
- **Machine:** {processor}, {threads} threads, {processes} process(es), {precision}, torch \
{torch}; {hours:.1f} hours.
- **Errors** on the test streets: `omnistereo evaluate`.

| step | validation loss | validation error |
|---|---|---|
{validations}

| recipe | |
|---|---|
{settings}
"""


def export_weights(
    run: str | Path, folder: str | Path = BUNDLED_WEIGHTS, half: bool = False
) -> list[Path]:
    """Copy the weights of a finished run to where `SweepNet.pretrained` and `MCCNN.pretrained` find
    them.

    Args:
        run: Folder of the run.
        folder: Where to write them.
        half: Store float16: half the file size. A network still computes in float32 or bfloat16.

    Returns:
        The paths of NAME.safetensors, NAME.csv (the loss of every tenth step) and NAME.md (the
        model card).

    Raises:
        OmnistereoError: If the run is missing, damaged or not finished, or the folder cannot be
            written.
    """
    run, folder = Path(run), make_folder(folder)
    tensors, metadata = load_tensors(run / WEIGHTS)
    settings = dict(metadata["recipe"])
    recipe = replace(RECIPES[settings.pop("network")]["shipped"], **settings)
    if metadata["step"] + 1 != recipe.steps:
        found = f"{run / WEIGHTS} holds step {metadata['step'] + 1} of {recipe.steps}"
        raise OmnistereoError(f"{found}. Train to the end first.")
    weights, curve, card = (
        folder / f"{file_name(recipe)}.{ending}" for ending in ("safetensors", "csv", "md")
    )
    rows = read_log(run / LOG, recipe.steps)
    stored = {key: x.half() if half else x for key, x in tensors.items()}
    save_tensors(weights, stored, metadata)
    write_csv(curve, ["step", "loss", "error", "validation_loss", "validation_error"], _thin(rows))
    write_text(card, _model_card(weights, recipe, metadata, rows, half))
    print(f"written: {weights}, {curve.name}, {card.name}")
    return [weights, curve, card]


def file_name(recipe: Recipe) -> str:
    """Return the name of the weights, without ending; unusual training worlds are in it."""
    name = (
        f"{recipe.network}_{recipe.variant}" if isinstance(recipe, MCCNNRecipe) else recipe.network
    )
    worlds = {*recipe.worlds.split()}
    if worlds == {*type(recipe).worlds.split()}:
        return name
    return f"{name}_{'_'.join(worlds) if len(worlds) == 1 else 'worlds'}"


def _thin(rows: Rows) -> list[list[Any]]:
    """Return the mean loss and error of each ten steps, and their last validation."""
    thin = []
    for part in (rows[k : k + _EVERY] for k in range(0, len(rows), _EVERY)):
        means = [f"{sum(row[name] for row in part) / len(part):.4g}" for name in ("loss", "error")]
        last = [
            [f"{row[name]:.4g}" for name in ("validation_loss", "validation_error")]
            for row in _validated(part)
        ]
        thin.append([part[-1]["step"] + 1, *means, *(last[-1] if last else ["", ""])])
    return thin


def _validated(rows: Rows) -> Rows:
    return [row for row in rows if not math.isnan(row["validation_loss"])]


def _hours(rows: Rows) -> float:
    """Return the total time: "seconds" starts at 0 again when a run resumes."""
    seconds = [row["seconds"] for row in rows]
    return sum(b - a if b > a else b for a, b in pairwise([0.0, *seconds])) / 3600


def _model_card(
    weights: Path, recipe: Recipe, metadata: dict[str, Any], rows: Rows, half: bool
) -> str:
    presets, settings = RECIPES[recipe.network], recipe.as_dict()
    name = next((name for name, preset in presets.items() if preset == recipe), "shipped")
    overrides = [
        f"{key}={value}"
        for key, value in settings.items()
        if presets[name].as_dict().get(key) != value
    ]
    command = f"omnistereo train {recipe.network} --preset {name}"
    command += f" --set {' '.join(overrides)}" if overrides else ""
    if metadata.get("init_weights"):
        command += f" --init-weights FILE`, FILE with SHA-256 `{metadata['init_weights']}"
    command += "`, then `python -m workshop ship" + (" --half" if half else "")
    validations = (
        f"| {row['step'] + 1} | {row['validation_loss']:.4f} |"
        f" {100 * row['validation_error']:.2f} % |"
        for row in _validated(rows)
    )
    about = {
        "file": weights.name,
        "sha256": hashlib.sha256(read_bytes(weights)).hexdigest(),
        "command": command,
        "network": signature(metadata["architecture"], metadata["config"]),
        "data_sha256": metadata["data"]["sha256"],
        "hours": _hours(rows),
        "settings": "\n".join(f"| {name} | {value} |" for name, value in settings.items()),
        "validations": "\n".join(validations),
    }
    return _CARD.format_map(metadata | metadata["data"] | about)
