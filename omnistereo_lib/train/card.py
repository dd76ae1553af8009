"""From a finished run to weights that ship: the file, its learning curve, and a card that says where it comes from."""

from __future__ import annotations

import csv
import hashlib
import shutil
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import atomic_write, make_folder
from omnistereo_lib.stereo.weights import SHIPPED, load_tensors, save_tensors
from omnistereo_lib.train.loop import LOG, WEIGHTS, read_log
from omnistereo_lib.train.recipes import RECIPES, MCCNNRecipe, Recipe

_EVERY = 10  # steps between two rows of the curve that ships


def ship(run: str | Path, recipe: Recipe, folder: str | Path = SHIPPED, half: bool = False) -> list[Path]:
    """Put a finished run's weights where `SweepNet.load` and `MCCNN.load` look for them.

    Parameters
    ----------
    run : path
        Folder of the run.
    recipe : Recipe
        What was trained.
    folder : path
        Gets NAME.safetensors, NAME.csv (the loss of every tenth step) and NAME.md (the card).
    half : bool
        Store float16, for half the file; a network computes with the float32 or bfloat16 of it.

    Returns
    -------
    list of path
        The files written.

    Raises
    ------
    OmnistereoError
        If the run is of another recipe or not finished, or the folder cannot be written.
    """
    run, folder = Path(run), make_folder(folder)
    tensors, about = load_tensors(run / WEIGHTS)
    if about["recipe"] != recipe.as_dict() or about["step"] + 1 != recipe.steps:
        raise OmnistereoError(
            f"{run / WEIGHTS} is not what {recipe.steps} steps of this recipe gave: train to the end first"
        )
    name = f"mccnn_{recipe.variant}" if isinstance(recipe, MCCNNRecipe) else recipe.network
    rows = read_log(run / LOG, recipe.steps)
    files = [folder / f"{name}.{ending}" for ending in ("safetensors", "csv", "md")]
    if half:
        save_tensors(files[0], {key: value.half() for key, value in tensors.items()}, about)
    else:
        with atomic_write(files[0]) as temporary:
            shutil.copyfile(run / WEIGHTS, temporary)
    with atomic_write(files[1]) as temporary, temporary.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["step", "loss", "error", "validation_loss", "validation_error"])
        writer.writerows(_thinned(rows))
    with atomic_write(files[2]) as temporary:
        temporary.write_text(_card(files[0], recipe, about, rows, half), encoding="utf-8")
    return files


def _thinned(rows: Sequence[dict[str, float]]) -> list[list[Any]]:
    """Return the mean loss and error of every ten steps, and each validation."""
    thin = []
    for k in range(0, len(rows), _EVERY):
        part = rows[k : k + _EVERY]
        means = [f"{sum(row[name] for row in part) / len(part):.4g}" for name in ("loss", "error")]
        checked = [row for row in part if row["validation_loss"] == row["validation_loss"]]
        last = [f"{checked[-1][name]:.4g}" for name in ("validation_loss", "validation_error")] if checked else ["", ""]
        thin.append([part[-1]["step"] + 1, *means, *last])
    return thin


def _hours(rows: Sequence[dict[str, float]]) -> float:
    """Return the time that all calls took together: "seconds" starts anew with each."""
    seconds = [row["seconds"] for row in rows]
    return sum(b - a if b > a else b for a, b in pairwise([0.0, *seconds])) / 3600


def _card(weights: Path, recipe: Recipe, about: dict[str, Any], rows: Sequence[dict[str, float]], half: bool) -> str:
    data, preset = about["data"], RECIPES[recipe.network]["shipped"].as_dict()
    changed = [f"{name}={value}" for name, value in recipe.as_dict().items() if preset.get(name) != value]
    command = f"python -m omnistereo_lib train {recipe.network} --preset shipped"
    command += f" --set {' '.join(changed)}" if changed else ""
    origin = f" --start FILE`, FILE with SHA-256 `{about['start']}" if about.get("start") else ""
    numbers = "\n".join(f"| {name} | {value} |" for name, value in recipe.as_dict().items())
    checks = "\n".join(
        f"| {row['step'] + 1} | {row['validation_loss']:.4f} | {100 * row['validation_error']:.2f} % |"
        for row in rows
        if row["validation_loss"] == row["validation_loss"]
    )
    return f"""# {weights.name}

`{about["architecture"]}({", ".join(f"{key}={value!r}" for key, value in about["config"].items())})`, \
SHA-256 `{hashlib.sha256(weights.read_bytes()).hexdigest()}`

Written by `{command} --ship{" float16" if half else ""}{origin}`.

- **Data:** {data["folder"]}, {data["frames"]} frames, every tenth for validation alone; \
SHA-256 of all of them `{data["sha256"]}`. No test street among them.
- **Machine:** {about["processor"]}, {about["threads"]} threads, {about["processes"]} process(es), \
{about["precision"]}, torch {about["torch"]}; {_hours(rows):.1f} hours.
- **Errors** on the test streets: `python -m omnistereo_lib evaluate`.

| step | validation loss | validation error |
|---|---|---|
{checks}

| recipe | |
|---|---|
{numbers}
"""
