"""Files of tensors: a network's weights, or the state of a training. Safetensors, no pickle."""

import hashlib
import json
import struct
from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any, ClassVar, Self

import torch
from safetensors.torch import load, save
from torch import Tensor, nn

from omnistereo_lib.errors import OmnistereoError, shortened
from omnistereo_lib.files import atomic_write, parse_json, read_bytes

# Types of tensors, as safetensors calls them.
_TYPES = ("F16", "BF16", "F32", "F64", "I64")
# Dimensions of a tensor; torch computes with up to 64.
_MAX_SIDES = 8
# In bytes; the header of a training state has 30,000.
_MAX_HEADER = 1 << 20
BUNDLED_WEIGHTS = Path(__file__).resolve().parents[1] / "weights"


class StoredNetwork(nn.Module):
    """A network that a file of weights describes completely."""

    # Name of the file of the bundled weights, without .safetensors.
    bundled: ClassVar[str]

    @property
    def config(self) -> dict[str, Any]:
        """The arguments that build this architecture."""
        return {}

    @classmethod
    def pretrained(cls) -> Self:
        """Return the bundled network, in evaluation mode."""
        return cls.from_file(BUNDLED_WEIGHTS / f"{cls.bundled}.safetensors")

    def ready(self, device: torch.device | str) -> Self:
        """Return the network in evaluation mode on a device: itself, or a copy if it trains."""
        device = torch.device(device)
        training = any(module.training for module in self.modules())
        elsewhere = any(weight.device != device for weight in self.parameters())
        return deepcopy(self).eval().to(device) if training or elsewhere else self

    def fuse_batch_norm(self) -> nn.Module:
        """Return the network to store: itself, unless its batch norms fold into its layers."""
        return self

    def save(self, path: str | Path, **metadata: Any) -> None:
        """Write the weights with the architecture and other metadata; raises as `save_tensors`."""
        about = {"architecture": type(self).__name__, "config": self.config, **metadata}
        save_tensors(path, self.state_dict(), about)

    @classmethod
    def from_file(cls, path: str | Path, **expected: Any) -> Self:
        """Build a network with the weights of a file that training wrote, in evaluation mode.

        Entries that the `config` in the file must have can be given, such as variant="accurate".

        Raises:
            OmnistereoError: If the file is missing or damaged, holds another architecture or
                config, or values that are not finite.
        """
        tensors, metadata = load_tensors(path)
        name, config = metadata.get("architecture", "a training state"), metadata.get("config", {})
        if not isinstance(config, dict):
            raise OmnistereoError(
                f"{path}: config is {shortened(config)}; expected the arguments of a network"
            )
        if name != cls.__name__ or config != config | expected:
            wanted = signature(cls.__name__, expected)
            raise OmnistereoError(
                f"{path}: holds {signature(name, config)}; expected {wanted}. Pass another file."
            )
        # Build the network of the file, and take its tensors.
        try:
            # Whatever the default type of torch is.
            network = cls(**config).float()
            like = network.state_dict()
            # counts may be stored as either
            floating = [key for key in like if like[key].is_floating_point()]
            if wrong := [key for key in floating if not tensors[key].is_floating_point()]:
                raise TypeError(f"{wrong[0]} is of type {tensors[wrong[0]].dtype}")
            network.load_state_dict(tensors)
        except (RuntimeError, TypeError, KeyError) as error:
            message = (
                f"{path} does not fit {signature(name, config)}: {str(error)[:500]}. Pass another"
                " file."
            )
            raise OmnistereoError(message) from None
        return network.eval()


def signature(name: str, config: Mapping[str, Any]) -> str:
    """Return the call that builds an architecture."""
    return (
        f"{name}({', '.join(f'{key}={value!r}' for key, value in config.items())})"
        if config
        else name
    )


def save_tensors(
    path: str | Path, tensors: Mapping[str, Tensor], metadata: Mapping[str, Any]
) -> None:
    """Write tensors and metadata (as JSON) into one file; equal content gives equal bytes.

    The file header holds the metadata under "about", beside a checksum of the tensors.

    Raises:
        OmnistereoError: If a tensor is not finite or the file cannot be written.
    """
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    _check_finite(path, tensors)
    content = save(tensors, {"about": json.dumps(metadata), "sha256": _checksum(tensors)})
    (length,) = struct.unpack("<Q", content[:8])
    # safetensors' order varies
    header = json.dumps(parse_json(content[8 : 8 + length], path), sort_keys=True).encode()
    header += b" " * (-len(header) % 8)  # the tensors stay aligned
    with atomic_write(path) as temporary:
        temporary.write_bytes(struct.pack("<Q", len(header)) + header + content[8 + length :])


def load_tensors(path: str | Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Return the tensors of a file, on the CPU, and the metadata written with them.

    Raises:
        OmnistereoError: If the file is missing, truncated, changed since it was written, not
            finite, or not from this library.
    """
    content = read_bytes(path)
    try:
        header = _read_header(path, content)
        tensors = load(content)
    except Exception as error:  # safetensors and struct raise several types
        found = f"{path} is not a complete safetensors file: {str(error)[:300]}"
        raise OmnistereoError(f"{found}. Copy it again, or make it by training.") from None
    # A file that is whole may still be another's, or changed.
    if not {"about", "sha256"} <= header.keys():
        raise OmnistereoError(
            f"{path} was not written by this library: its header has {sorted(header)}"
        )
    if _checksum(tensors) != header["sha256"]:
        raise OmnistereoError(f"{path} has changed since it was written (checksum). Copy it again.")
    _check_finite(path, tensors)
    about = parse_json(header["about"], path)
    if not isinstance(about, dict):
        raise OmnistereoError(
            f"{path}: what is stored about the tensors is {shortened(about)}; expected settings"
        )
    return tensors, about


def _read_header(path: str | Path, content: bytes) -> dict[str, Any]:
    """Return the metadata of a safetensors file whose tensors all have types of networks."""
    (length,) = struct.unpack("<Q", content[:8])
    if length > _MAX_HEADER:
        raise ValueError(f"its header has {length} bytes")
    header = parse_json(content[8 : 8 + length], path)
    metadata = header.pop("__metadata__", None) or {}
    if other := {entry["dtype"] for entry in header.values()} - {*_TYPES}:
        raise ValueError(
            f"it holds tensors of type {shortened(other)}; expected {', '.join(_TYPES)}"
        )
    if any(len(entry["shape"]) > _MAX_SIDES for entry in header.values()):
        raise ValueError(f"it holds tensors of more than {_MAX_SIDES} dimensions")
    return metadata


def _check_finite(path: str | Path, tensors: Mapping[str, Tensor]) -> None:
    for name, tensor in tensors.items():
        if not tensor.isfinite().all():
            raise OmnistereoError(
                f"{path}: {name} is NaN or infinite; expected finite weights. Lower learning_rate."
            )


def _checksum(tensors: Mapping[str, Tensor]) -> str:
    """Return the SHA-256 of all names and values."""
    digest = hashlib.sha256()
    for name in sorted(tensors):
        digest.update(name.encode())
        digest.update(tensors[name].reshape(-1).view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()
