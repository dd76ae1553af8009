"""The training loop: every step is a pure function of the recipe, the data and the step before.

The samples of a step depend only on (seed, step), and the state is written atomically, so a run
that is killed at any moment resumes to exactly the weights that it would have reached. Several
processes (`torchrun`) share the micro-batches of a step and average their gradients: they compute
what one process computes.
"""

import csv
import hashlib
import json
import math
import platform
import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, distributed, nn
from torch.nn.parallel import DistributedDataParallel

from omnistereo_learn.provenance import (
    PROVENANCE,
    differences,
    kept_precision,
    notes,
    provenance,
    read_facts,
    write_facts,
)
from omnistereo_learn.recipes import Recipe
from omnistereo_learn.samples.frames import Folders, folders_of
from omnistereo_learn.samples.patches import PatchSamples
from omnistereo_learn.samples.spheres import SphereSamples
from omnistereo_learn.samples.volumes import VolumeSamples
from omnistereo_lib.errors import OmnistereoError, check_number, shortened
from omnistereo_lib.files import as_path, atomic_write, checksum, make_folder, read_bytes, read_text
from omnistereo_lib.stereo.device import number_from_environment, select_device
from omnistereo_lib.stereo.learned import Precision, autocast, choose_precision
from omnistereo_lib.stereo.weights import load_tensors, save_tensors

STATE, WEIGHTS, LOG = "state.safetensors", "weights.safetensors", "log.csv"
COLUMNS: tuple[str, ...] = ("step", "loss", "error", "learning_rate", "seconds")
COLUMNS += ("validation_loss", "validation_error")
_SAMPLES = {"sweepnet": SphereSamples, "mccnn": PatchSamples, "volumenet": VolumeSamples}
_FEW = 100  # steps, in which one may be skipped
_TRAIN, _VALIDATE, _NORMS = range(3)  # purposes of random numbers, so that no two share any


def train(
    recipe: Recipe,
    out: str | Path,
    data: Folders | None = None,
    device: torch.device | str = "cpu",
    precision: Precision = "auto",
    checkpoint_s: float = 60.0,
    init_weights: str | Path | None = None,
    on_step: Callable[[dict[str, float]], object] = lambda row: None,
) -> Path:
    """Train a network, or resume an interrupted run in the same folder; return its weights file.

    The folder gets `log.csv`, `provenance.json`, `state.safetensors` (to resume) and, at every
    validation and at the end, `weights.safetensors` (for `SweepNet.from_file`, `MCCNN.from_file`).

    Args:
        out: Folder; made where it is missing.
        data: Folders that `load_dataset` reads, with ground truth, and "endless" for worlds that
            are made up as the training goes on. Default: the training sets of data_samples that the
            recipe names.
        precision: Of the matrix products; weights, losses and sums stay float32.
        checkpoint_s: Seconds between two states.
        init_weights: Trained weights to begin with instead of random ones. Their architecture must
            be that of the recipe: training writes weights without batch norms, so `batch_norm`
            must be False.
        on_step: Called with the log row of every step: "step" from 0, "loss", "error",
            "learning_rate", "seconds" since this call, "validation_loss" and "validation_error",
            NaN between validations. An exception in it stops the run.

    Raises:
        OmnistereoError: If the data cannot be trained on, the folder belongs to a different run or
            cannot be written, the architecture of `init_weights` is not that of the recipe, there
            is no such device, the micro-batches cannot be divided among the processes, a weight is
            not finite, or the loss or its gradient is not in more than one step in a hundred. Such
            a step is skipped; its loss in the log is empty.
    """
    out = as_path(out, "out")
    stored = read_facts(out / PROVENANCE) if (out / STATE).exists() else {}
    run = _Run(
        recipe,
        folders_of(recipe) if data is None else data,
        select_device(device),
        kept_precision(precision, stored),
        init_weights,
    )
    make_folder(out)
    first, row = run.resume(out / STATE)
    for words in notes(stored, run.facts) if stored else []:
        warnings.warn(f"{words}: the last digits of the steps that follow differ", stacklevel=2)
    if run.rank == 0 and first == recipe.steps and not run.has_written(out / WEIGHTS):
        run.write_weights(out / WEIGHTS, row)
    rows = read_log(out / LOG, first)
    began = last_saved = time.perf_counter()
    for step in range(first, recipe.steps):
        row = dict.fromkeys(COLUMNS, math.nan) | run.step(step)
        done = step + 1
        skipped = math.isnan(row["loss"]) + sum(math.isnan(earlier["loss"]) for earlier in rows)
        if skipped > max(done, _FEW) / 100:
            found = f"the loss or its gradient was not finite in {skipped} of {done} steps"
            raise OmnistereoError(f"{found}. Lower learning_rate or increase warmup.")
        if done % recipe.validate_every == 0 or done == recipe.steps:
            row |= run.validate(done)
            if run.rank == 0:
                run.write_weights(out / WEIGHTS, row)
        row["seconds"] = time.perf_counter() - began
        rows.append(row)
        if run.rank == 0 and (
            done == recipe.steps or time.perf_counter() - last_saved >= checkpoint_s
        ):
            cells = (
                ["" if math.isnan(row[name]) else f"{row[name]:.6g}" for name in COLUMNS]
                for row in rows
            )
            if not stored:
                write_facts(out / PROVENANCE, run.facts)
            stored = run.facts
            write_csv(out / LOG, COLUMNS, cells)
            run.save_state(out / STATE, done, row)
            last_saved = time.perf_counter()
        on_step(row)
    if run.world > 1:
        distributed.destroy_process_group()
    return out / WEIGHTS


class _Run:
    """Network, samples, loss and optimiser of one process among `world`, with number `rank`."""

    def __init__(
        self,
        recipe: Recipe,
        data: Any,
        device: torch.device,
        precision: Precision,
        init: Any = None,
    ) -> None:
        self.recipe, self.device = recipe, device
        self.precision = choose_precision(precision, device)
        self.rank, self.world = _init_distributed(recipe, device)
        with torch.random.fork_rng():
            torch.manual_seed(recipe.seed)
            self.samples = _SAMPLES[recipe.network](recipe, data, device)
        # Channels last is faster, except for the gradient of the weights in float32 on a CPU.
        slow = device.type == "cpu" and self.precision == "float32"
        layout = torch.contiguous_format if slow else torch.channels_last
        self.network = nn.utils.convert_conv2d_weight_memory_format(
            self.samples.network.to(device), layout
        ).train()
        self.init_sha256 = None
        if init is not None:
            given = type(self.network).from_file(init, **self.network.config)
            self.network.load_state_dict(given.state_dict())
            self.init_sha256 = hashlib.sha256(read_bytes(init)).hexdigest()
        self.objective = self.samples.objective
        self.parallel = (
            DistributedDataParallel(self.objective, broadcast_buffers=False)
            if self.world > 1
            else None
        )
        settings: dict[str, Any] = {"lr": recipe.learning_rate, "weight_decay": recipe.weight_decay}
        self.optimizer: torch.optim.Optimizer = (
            torch.optim.AdamW(self.network.parameters(), **settings)
            if recipe.optimizer == "adamw"
            else torch.optim.SGD(self.network.parameters(), momentum=recipe.momentum, **settings)
        )

    def micro_batch(self, purpose: int, k: int) -> Any:
        """Draw micro-batch number k: of a validation frame, or of a training frame, augmented."""
        rng = np.random.default_rng([self.recipe.seed, purpose, k])
        if purpose == _VALIDATE:
            return self.samples.micro_batch(self.samples.validation_frame(k), rng, augment=False)
        return self.samples.micro_batch(self.samples.training_frame(k), rng, self.recipe.augment)

    def loss(self, micro_batch: Any, objective: nn.Module | None = None) -> tuple[Tensor, Tensor]:
        """Return loss and error of a micro-batch, computed in the precision of the run."""
        with autocast(self.precision, self.device):
            return (objective or self.objective)(micro_batch)

    def step(self, step: int) -> dict[str, float]:
        """Do one step; return its row of the log, with the loss and error over all processes.

        Where the loss or its gradient is not finite, the weights stay and the loss is NaN.
        """
        rate = self.recipe.learning_rate_at(step)
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        mine = range(self.rank, self.recipe.frames_per_step, self.world)
        metrics = torch.zeros(2)
        self.optimizer.zero_grad()
        for k in mine:
            batch = self.micro_batch(_TRAIN, step * self.recipe.frames_per_step + k)
            last = k == mine[-1]  # the processes exchange their gradients then
            with nullcontext() if self.parallel is None or last else self.parallel.no_sync():
                loss, error = self.loss(batch, self.parallel)
                (loss / len(mine)).backward()
            metrics += torch.stack([loss.detach(), error]).cpu() / len(mine)
        if self.world > 1:
            distributed.all_reduce(metrics)
        loss, error = (metrics / self.world).tolist()
        norm = nn.utils.clip_grad_norm_(self.network.parameters(), self.recipe.clip).item()
        finite = math.isfinite(loss + norm)
        if finite:
            self.optimizer.step()
        told = loss if finite else math.nan
        return {"step": step, "loss": told, "error": error, "learning_rate": rate}

    @torch.no_grad()
    def validate(self, done: int) -> dict[str, float]:
        """Return mean loss and error of the same micro-batches of held-out frames.

        `done` steps came before.
        """
        self._update_bn(done)
        self.network.eval()
        metrics = torch.zeros(2)
        for k in range(self.recipe.validation_groups):
            metrics += (
                torch.stack(self.loss(self.micro_batch(_VALIDATE, k))).cpu()
                / self.recipe.validation_groups
            )
        self.network.train()
        return dict(zip(("validation_loss", "validation_error"), metrics.tolist(), strict=True))

    def _update_bn(self, done: int) -> None:
        """Recompute batch norm statistics: running averages would lag and differ by process."""
        norms = [
            layer
            for layer in self.network.modules()
            if isinstance(layer, nn.modules.batchnorm._BatchNorm)
        ]
        for norm in norms:
            norm.reset_running_stats()
        if norms:
            for k in range(self.recipe.validation_groups):
                self.loss(self.micro_batch(_NORMS, done * self.recipe.frames_per_step + k))

    def write_weights(self, path: Path, row: Mapping[str, float]) -> None:
        """Write the weights to use, batch norms fused, with what they come from."""
        cpu = f"{platform.machine()} {torch.backends.cpu.get_cpu_capability()}"
        processor = torch.cuda.get_device_name(self.device) if self.device.type == "cuda" else cpu
        self.network.fuse_batch_norm().save(
            path,
            recipe=self.recipe.as_dict(),
            **row,
            data=self.samples.metadata,
            init_weights=self.init_sha256,
            processes=self.world,
            processor=processor,
            threads=torch.get_num_threads(),
            precision=self.precision,
            torch=torch.__version__,
        )

    def has_written(self, path: Path) -> bool:
        """Return whether a file holds the weights of this network, whole."""
        try:
            tensors, about = load_tensors(path)
        except OmnistereoError:
            return False
        own = self.network.fuse_batch_norm().state_dict()
        same = tensors.keys() == own.keys() and all(tensors[k].equal(own[k].cpu()) for k in own)
        return same and about.get("recipe") == self.recipe.as_dict()

    @property
    def facts(self) -> dict[str, Any]:
        """What the run is made from, as `provenance.json` holds it."""
        inputs = checksum(json.dumps([self.samples.metadata, self.init_sha256]).encode())[:16]
        threads = torch.get_num_threads()
        made = provenance(None, inputs, self.recipe.network, self.precision, threads)
        return {"recipe": self.recipe.as_dict(), "provenance": made}

    def save_state(self, path: Path, step: int, row: Mapping[str, float]) -> None:
        """Write all that the next step depends on into one file, and the last row of the log."""
        tensors = {f"network.{name}": tensor for name, tensor in self.network.state_dict().items()}
        for number, memory in self.optimizer.state_dict()["state"].items():
            known = {name: value for name, value in memory.items() if value is not None}
            tensors |= {
                f"optimizer.{number}.{name}": torch.as_tensor(value)
                for name, value in known.items()
            }
        last = {name: value for name, value in row.items() if name != "seconds"}
        save_tensors(path, tensors, {"step": step, "recipe": self._identity, "row": last})

    def resume(self, path: Path) -> tuple[int, dict[str, float]]:
        """Read the state of an earlier call; return the next step, and the log's row before it."""
        if not path.exists():
            return 0, {}
        tensors, metadata = load_tensors(path)
        found = metadata.get("recipe", {})
        found = found if isinstance(found, dict) else {"network": shortened(found)}
        if other := differences(found, self._identity):
            found = f"{path} belongs to a different run: {'; '.join(other)}"
            raise OmnistereoError(f"{found}. Use another folder, or delete this one to start over.")
        try:
            self._restore(tensors)
            step = check_number(metadata.get("step"), "step", 0, self.recipe.steps, whole=True)
            return int(step), dict.fromkeys(COLUMNS, math.nan) | metadata["row"]
        except (ValueError, TypeError, KeyError, IndexError, RuntimeError) as error:
            found = f"{path} is not the state of this training: {str(error)[:500]}"
            raise OmnistereoError(f"{found}. Delete it to start over.") from None

    def _restore(self, tensors: Mapping[str, Tensor]) -> None:
        """Take network and optimiser from tensors; raise one of several types if unfit."""
        network: dict[str, Tensor] = {}
        memory: dict[int, dict[str, Tensor]] = {}
        shapes = [weight.shape for weight in self.network.parameters()]
        for name, tensor in tensors.items():
            kind, key = name.split(".", 1)
            if kind == "network":
                network[key] = tensor
                continue
            number, entry = key.split(".")
            if tensor.shape not in (torch.Size(), shapes[int(number)]):
                raise ValueError(f"{name} has shape {tuple(tensor.shape)}")
            memory.setdefault(int(number), {})[entry] = tensor
        self.network.load_state_dict(network)
        groups = self.optimizer.state_dict()["param_groups"]
        self.optimizer.load_state_dict({"state": memory, "param_groups": groups})

    @property
    def _identity(self) -> dict[str, Any]:
        """The settings in which two calls must agree to be one run."""
        data = self.samples.metadata["sha256"]
        made = {"init_weights": self.init_sha256, "data": data, "precision": self.precision}
        return self.recipe.as_dict() | made


def _init_distributed(recipe: Recipe, device: torch.device) -> tuple[int, int]:
    """Return rank and world size, above 1 where `torchrun` started the processes."""
    world = number_from_environment("WORLD_SIZE", 1)
    if world == 1:
        return 0, 1
    if recipe.frames_per_step % world:
        frames = recipe.frames_per_step
        fitting = " or ".join(str(n) for n in range(1, frames + 1) if frames % n == 0)
        raise OmnistereoError(
            f"frames_per_step = {frames} is not divisible by {world} processes; expected {fitting}"
            " of them. Start so many, or change the recipe: --set"
            f" frames_per_step={world * math.ceil(frames / world)}"
        )
    if not distributed.is_initialized():
        try:
            distributed.init_process_group("nccl" if device.type == "cuda" else "gloo")
        except ValueError as error:  # a variable of torchrun's is missing
            raise OmnistereoError(
                f"WORLD_SIZE is {world}, but {error}. Unset it, or start by torchrun."
            ) from None
    return distributed.get_rank(), world


def read_log(path: Path, stop: int) -> list[dict[str, float]]:
    """Return the rows of a log before step `stop`; refuse a missing or damaged one."""
    if stop == 0 or not path.is_file():
        return []
    header, *lines = [*csv.reader(read_text(path).splitlines()), []][: stop + 1]
    try:
        rows = [
            {name: float(cell or "nan") for name, cell in zip(COLUMNS, line, strict=True)}
            for line in lines
        ]
        if tuple(header) != COLUMNS or [row["step"] for row in rows] != list(range(stop)):
            raise ValueError(
                f"expected the columns {', '.join(COLUMNS)} and the steps 0 to {stop - 1}"
            )
    except (ValueError, csv.Error) as error:
        raise OmnistereoError(
            f"{path} is damaged: {error}. Put a copy back, or delete it to begin it anew."
        ) from None
    return [row | {"step": step} for step, row in enumerate(rows)]


def write_csv(path: str | Path, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a table, atomically."""
    with atomic_write(path) as temporary, temporary.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *rows])
