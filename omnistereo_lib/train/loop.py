"""The training loop: one step after another, each a pure function of the recipe, the data and what came before.

Which samples a step sees depends on (seed, step) alone, and the state is written whole or not at all, so a run that
is killed at any moment goes on to the very weights that it would have reached. Several processes (`torchrun`) share
the groups of a step and average their gradients: they compute what one process computes.
"""

from __future__ import annotations

import csv
import hashlib
import os
import platform
import time
from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, distributed, nn
from torch.nn.parallel import DistributedDataParallel

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import atomic_write, make_folder, read_bytes
from omnistereo_lib.stereo.learned import LearnedCost, Precision, uses_bfloat16
from omnistereo_lib.stereo.sweep import find_device
from omnistereo_lib.stereo.weights import load_tensors, save_tensors
from omnistereo_lib.train.frames import DATA
from omnistereo_lib.train.patches import PatchObjective, PatchSamples
from omnistereo_lib.train.recipes import Recipe, SweepNetRecipe
from omnistereo_lib.train.spheres import SphereObjective, SphereSamples

STATE, WEIGHTS, LOG = "state.safetensors", "weights.safetensors", "log.csv"
COLUMNS = ("step", "loss", "error", "learning_rate", "seconds", "validation_loss", "validation_error")
_TRAIN, _VALIDATE, _NORMS = range(3)  # what random numbers are for, so that no two uses share any


def train(
    recipe: Recipe,
    out: str | Path,
    data: str | Path = DATA,
    device: torch.device | str = "cpu",
    precision: Precision = "auto",
    checkpoint_s: float = 60.0,
    start: str | Path | None = None,
) -> Iterator[dict[str, float]]:
    """Train a network, or go on where a run in the same folder was stopped.

    The folder gets `log.csv`, `state.safetensors` (to go on) and, at every validation and at the end,
    `weights.safetensors` (to use: `SweepNet.load`, `MCCNN.load`).

    Parameters
    ----------
    recipe : Recipe
    out : path
        Folder; made where it is missing.
    data : path
        A folder that `load_dataset` reads, with ground truth.
    device : torch device
    precision : "auto" | "float32" | "bfloat16"
        Of the matrix products; weights, losses and sums stay float32.
    checkpoint_s : float
        Seconds between two states.
    start : path, optional
        Trained weights to begin with, in place of random ones. Their architecture must be the recipe's: weights that
        training wrote are without norms, so `batch_norm` is False then.

    Yields
    ------
    dict
        One row of the log for every step: "step" from 0, "loss", "error", "learning_rate", "seconds" since this
        call; "validation_loss" and "validation_error" where they were taken, else NaN.

    Raises
    ------
    OmnistereoError
        If the data cannot be trained on, the folder holds a run of another recipe or start or cannot be written,
        the start's architecture is not the recipe's, there is no such device, the processes cannot share the groups,
        or the loss is no number any more.
    """
    device = find_device(device)
    rank, world = _join_processes(recipe, device)
    out = make_folder(out)
    samples = _samples(recipe, data, device)
    samples.network.precision = precision
    network = samples.network.to(device).train()
    objective = _objective(recipe, network)
    optimizer = _optimizer(recipe, network)
    origin = None if start is None else _begin_with(Path(start), network)
    first = _resume(out / STATE, recipe, origin, network, optimizer)
    parallel = DistributedDataParallel(objective, broadcast_buffers=False) if world > 1 else objective
    made = {"data": samples.about, "start": origin, "processes": world} | _machine(network, device)
    rows = read_log(out / LOG, first)
    began = last_saved = time.perf_counter()
    for step in range(first, recipe.steps):
        for group in optimizer.param_groups:
            group["lr"] = recipe.rate(step)
        loss, error = _step(samples, parallel, optimizer, step, rank, world)
        if not np.isfinite(loss):
            raise OmnistereoError(f"the loss is {loss} at step {step}: take a lower learning_rate or more warmup")
        row = dict.fromkeys(COLUMNS, float("nan"))
        row |= {"step": step, "loss": loss, "error": error, "learning_rate": recipe.rate(step)}
        done = step + 1
        if done % recipe.validate_every == 0 or done == recipe.steps:
            row["validation_loss"], row["validation_error"] = _validate(samples, objective)
            if rank == 0:
                _export(out / WEIGHTS, recipe, network, row | made)
        row["seconds"] = time.perf_counter() - began
        rows.append(row)
        if rank == 0 and (done == recipe.steps or time.perf_counter() - last_saved >= checkpoint_s):
            _write_log(out / LOG, rows)
            _save_state(out / STATE, done, recipe, origin, network, optimizer)
            last_saved = time.perf_counter()
        yield row
    if world > 1:
        distributed.destroy_process_group()


def _step(
    samples: SphereSamples | PatchSamples,
    parallel: nn.Module,
    optimizer: torch.optim.Optimizer,
    step: int,
    rank: int,
    world: int,
) -> tuple[float, float]:
    """Do one step on this process's groups; return loss and error of all groups."""
    recipe, network = samples.recipe, samples.network
    mine = range(rank, recipe.frames_per_step, world)
    figures = torch.zeros(2)
    optimizer.zero_grad()
    for k in mine:
        number = step * recipe.frames_per_step + k
        rng = np.random.default_rng([recipe.seed, _TRAIN, number])
        group = samples.group(samples.training_frame(number), rng, recipe.augment)
        exchange = nullcontext() if world == 1 or k == mine[-1] else parallel.no_sync()
        with exchange:
            with network.autocast(next(network.parameters()).device):
                loss, error = parallel(group)
            (loss / len(mine)).backward()
        figures += torch.stack([loss.detach(), error]).cpu() / len(mine)
    torch.nn.utils.clip_grad_norm_(network.parameters(), recipe.clip)
    optimizer.step()
    if world > 1:
        distributed.all_reduce(figures)
    return tuple((figures / world).tolist())


@torch.no_grad()
def _validate(samples: SphereSamples | PatchSamples, objective: nn.Module) -> tuple[float, float]:
    """Return mean loss and error of the same groups every time, of frames never trained on."""
    _renew_norms(samples, objective)
    network = samples.network.eval()
    figures = torch.zeros(2)
    for k in range(samples.recipe.validation_groups):
        frame = samples.validation[k % len(samples.validation)]
        group = samples.group(frame, np.random.default_rng([samples.recipe.seed, _VALIDATE, k]), augment=False)
        with network.autocast(next(network.parameters()).device):
            figures += torch.stack(objective(group)).cpu() / samples.recipe.validation_groups
    network.train()
    return tuple(figures.tolist())


@torch.no_grad()
def _renew_norms(samples: SphereSamples | PatchSamples, objective: nn.Module) -> None:
    """Take the means and variances of batch normalisation anew over some training groups.

    Running averages would lag behind the weights and differ between processes; these do neither.
    """
    norms = [layer for layer in samples.network.modules() if isinstance(layer, nn.modules.batchnorm._BatchNorm)]
    if not norms:
        return
    for norm in norms:
        norm.reset_running_stats()
    for k in range(samples.recipe.validation_groups):
        rng = np.random.default_rng([samples.recipe.seed, _NORMS, k])
        group = samples.group(samples.training_frame(k), rng, samples.recipe.augment)
        with samples.network.autocast(next(samples.network.parameters()).device):
            objective(group)


def _join_processes(recipe: Recipe, device: torch.device) -> tuple[int, int]:
    """Return this process's number and how many there are; more than one where `torchrun` started them."""
    world = int(os.environ.get("WORLD_SIZE", "1"))
    if world == 1:
        return 0, 1
    if recipe.frames_per_step % world:
        raise OmnistereoError(
            f"{world} processes cannot share {recipe.frames_per_step} frames a step evenly: change frames_per_step"
        )
    if not distributed.is_initialized():
        distributed.init_process_group("nccl" if device.type == "cuda" else "gloo")
    return distributed.get_rank(), world


def _samples(recipe: Recipe, data: str | Path, device: torch.device) -> SphereSamples | PatchSamples:
    with torch.random.fork_rng():
        torch.manual_seed(recipe.seed)
        kind = SphereSamples if isinstance(recipe, SweepNetRecipe) else PatchSamples
        return kind(recipe, data, device)


def _objective(recipe: Recipe, network: nn.Module) -> nn.Module:
    return SphereObjective(network) if isinstance(recipe, SweepNetRecipe) else PatchObjective(network, recipe.margin)


def _optimizer(recipe: Recipe, network: nn.Module) -> torch.optim.Optimizer:
    if recipe.optimizer == "adamw":
        return torch.optim.AdamW(network.parameters(), recipe.learning_rate, weight_decay=recipe.weight_decay)
    return torch.optim.SGD(
        network.parameters(), recipe.learning_rate, recipe.momentum, weight_decay=recipe.weight_decay
    )


def _begin_with(path: Path, network: LearnedCost) -> str:
    """Give the network the weights of a file; return the file's SHA-256."""
    given = type(network).read(path)
    if given.config != network.config:
        raise OmnistereoError(
            f"{path} holds weights for {given.config}, the recipe trains {network.config}: start with others, or "
            "change the recipe"
        )
    network.load_state_dict(given.state_dict())
    return hashlib.sha256(read_bytes(path)).hexdigest()


def _save_state(
    path: Path, step: int, recipe: Recipe, origin: str | None, network: nn.Module, optimizer: torch.optim.Optimizer
) -> None:
    """Write all that the next step depends on into one file."""
    tensors = {f"network.{name}": tensor for name, tensor in network.state_dict().items()}
    for number, memory in optimizer.state_dict()["state"].items():
        known = {name: value for name, value in memory.items() if value is not None}
        tensors |= {f"optimizer.{number}.{name}": torch.as_tensor(value) for name, value in known.items()}
    save_tensors(path, tensors, {"step": step, "recipe": recipe.as_dict() | {"start": origin}})


def _resume(
    path: Path, recipe: Recipe, origin: str | None, network: nn.Module, optimizer: torch.optim.Optimizer
) -> int:
    """Read the state that a run of this recipe and start left, if any; return the step that comes next."""
    if not path.is_file():
        return 0
    tensors, about = load_tensors(path)
    found, asked = about.get("recipe", {}), recipe.as_dict() | {"start": origin}
    if found != asked:
        changed = [
            f"{name} = {found.get(name)} there, {value} here"
            for name, value in asked.items()
            if found.get(name) != value
        ]
        raise OmnistereoError(
            f"{path} is of another recipe ({'; '.join(changed)}): choose another folder, or delete it to start anew"
        )
    split = [(*name.split(".", 1), tensor) for name, tensor in tensors.items()]
    network.load_state_dict({name: tensor for kind, name, tensor in split if kind == "network"})
    memory: dict[int, dict[str, Tensor]] = {}
    for kind, name, tensor in split:
        if kind == "optimizer":
            number, entry = name.split(".", 1)
            memory.setdefault(int(number), {})[entry] = tensor
    optimizer.load_state_dict({"state": memory, "param_groups": optimizer.state_dict()["param_groups"]})
    return about["step"]


def _export(path: Path, recipe: Recipe, network: nn.Module, about: dict[str, Any]) -> None:
    """Write the weights to use, with what they came from; norms become part of them."""
    plain = network.fold() if isinstance(recipe, SweepNetRecipe) else network
    plain.save(path, recipe=recipe.as_dict(), **about)


def _machine(network: LearnedCost, device: torch.device) -> dict[str, Any]:
    """Say what computes: two machines give two sets of weights, however alike."""
    cuda = device.type == "cuda"
    return {
        "processor": torch.cuda.get_device_name(device) if cuda else _processor(),
        "threads": torch.get_num_threads(),
        "precision": "bfloat16" if uses_bfloat16(network.precision, device) else "float32",
        "torch": torch.__version__,
    }


def _processor() -> str:
    return f"{platform.machine()} {torch.backends.cpu.get_cpu_capability()}"


def read_log(path: Path, first: int) -> list[dict[str, float]]:
    """Return the rows of a log up to the step that comes next."""
    if first == 0 or not path.is_file():
        return []
    with path.open(newline="") as file:
        rows = [{name: float(value or "nan") for name, value in row.items()} for row in csv.DictReader(file)]
    return [row | {"step": int(row["step"])} for row in rows if row["step"] < first]


def write_comparison(path: str | Path, runs: Mapping[str, Path], steps: int) -> None:
    """Write the validation errors of several runs side by side, as CSV: the step, and a column for each run.

    Parameters
    ----------
    path : path
        Of the file.
    runs : mapping of name to folder
        Finished runs with the same validations.
    steps : int
        Of each run.
    """
    curves = {name: read_log(run / LOG, steps) for name, run in runs.items()}
    checked = [row["step"] for row in next(iter(curves.values())) if row["validation_loss"] == row["validation_loss"]]
    with atomic_write(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["step", *curves])
        for step in checked:
            writer.writerow([step + 1, *(f"{rows[step]['validation_error']:.4g}" for rows in curves.values())])


def _write_log(path: Path, rows: list[dict[str, float]]) -> None:
    with atomic_write(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        for row in rows:
            writer.writerow({name: "" if value != value else f"{value:.6g}" for name, value in row.items()})
