"""Files of tensors: a network's weights, or the state of a training run. Safetensors, never pickle."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import atomic_write

SHIPPED = Path(__file__).resolve().parents[1] / "weights"


def save_tensors(path: str | Path, tensors: Mapping[str, Tensor], about: Mapping[str, Any]) -> None:
    """Write tensors and what there is to know about them into one file, whole or not at all.

    Parameters
    ----------
    path : path
        Ends in .safetensors.
    tensors : mapping of name to tensor
    about : mapping
        Anything that JSON can hold; for weights "architecture" and "config". It stands in the file's header,
        beside a checksum of the tensors.

    Raises
    ------
    OmnistereoError
        If it cannot be written; the file that was there before stays.
    """
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    header = {"about": json.dumps(about), "sha256": _checksum(tensors)}
    with atomic_write(path) as temporary:
        temporary.write_bytes(save(tensors, header))


def load_tensors(path: str | Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Return the tensors of a file, on the CPU, and what `save_tensors` was told about them.

    Raises
    ------
    OmnistereoError
        If the file is missing, cut short, changed since it was written, or not one of ours.
    """
    path = Path(path)
    if not path.is_file():
        raise OmnistereoError(f"{path} does not exist: expected a .safetensors file that training wrote")
    try:
        with safe_open(path, "pt") as file:
            header = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118, not a dict
    except (SafetensorError, OSError) as error:
        raise OmnistereoError(f"{path} is not a whole safetensors file: {error}. Copy it again") from None
    if not {"about", "sha256"} <= header.keys():
        raise OmnistereoError(f"{path} was not written by this library: its header says {sorted(header)}")
    if _checksum(tensors) != header["sha256"]:
        raise OmnistereoError(f"{path} has changed since it was written (checksum). Copy it again")
    return tensors, json.loads(header["about"])


def _checksum(tensors: Mapping[str, Tensor]) -> str:
    """Return the SHA-256 of all names and values."""
    digest = hashlib.sha256()
    for name in sorted(tensors):
        digest.update(name.encode())
        digest.update(tensors[name].reshape(-1).view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()
