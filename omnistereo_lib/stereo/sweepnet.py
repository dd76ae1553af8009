"""SweepNet, the matching cost that sees whole spherical images (paper, Section III-C and Table I)."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Self

import torch
from torch import Tensor, nn
from torch.nn.functional import pad, relu_

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.stereo.learned import Features, LearnedCost, Precision, full_precision, in_strips, uses_bfloat16
from omnistereo_lib.stereo.weights import SHIPPED


def _table_one() -> dict[str, nn.Module]:
    """Return the layers of Table I by their names; 757,729 parameters."""
    layers: dict[str, nn.Module] = {"conv1": nn.Conv2d(1, 32, 5, stride=2, padding=(2, 0))}
    for k in range(2, 19):
        layers[f"conv{k}"] = nn.Conv2d(32, 32, 3, padding=1)
    layers["conv19"] = nn.Conv2d(64, 128, 3, padding=1)
    layers["deconv1"] = nn.ConvTranspose2d(128, 128, 3, stride=2, padding=1, output_padding=1)
    layers["conv20"] = nn.Conv2d(128, 128, 3, padding=1)
    # 1 × 1 convolutions look at one pixel, so they are matrix products on a list of pixels.
    layers["fc1"] = nn.Linear(128, 256)
    for k in (2, 3, 4):
        layers[f"fc{k}"] = nn.Linear(256, 256)
    layers["fc5"] = nn.Linear(256, 1)
    return layers


class SweepNet(LearnedCost):
    """The paper's network as a matching cost, called like `ZNCC`: 0 = match, 1 = no match.

    Images are gray, of zero mean and unit variance over the lens circle (`SphereSweep.prepare`), 0 where a camera
    does not see. A cost depends on 81 × 81 pixels around it: 24° at W = 1200, 91° at W = 320.

    Parameters
    ----------
    batch_norm : bool
        Batch normalisation after every layer but the last, for training. Table I has none, the authors' released
        code has it. `fold` turns a trained network with it into the plain network of Table I.
    wrap : bool
        Every layer continues around the panorama's seam. False as Table I prints it: circular columns for the
        input alone, zeros in the layers behind it, which makes the seam visible.
    precision : "auto" | "float32" | "bfloat16"
        Of the matrix products; "auto" takes bfloat16 where the processor multiplies it in hardware.
    """

    stride, reach, margin = 2, 17, 2

    def __init__(self, batch_norm: bool = False, wrap: bool = True, precision: Precision = "auto") -> None:
        super().__init__()
        self.wrap, self.precision = wrap, precision
        self.layers = nn.ModuleDict(_table_one())
        self.norms = nn.ModuleDict()
        for name, layer in self.layers.items():
            nn.init.zeros_(layer.bias)
            if name != "fc5":  # keeps the scale through ReLU layers; fc5 starts undecided
                nn.init.kaiming_normal_(layer.weight.data, nonlinearity="relu")
        if batch_norm:
            self._add_norms()

    def _add_norms(self) -> None:
        for name, layer in self.layers.items():
            if name != "fc5":
                kind = nn.BatchNorm1d if isinstance(layer, nn.Linear) else nn.BatchNorm2d
                self.norms[name] = kind(layer.bias.numel(), momentum=None)  # None: plain means, see `train`
                layer.bias = None  # the norm subtracts any bias and has its own

    @classmethod
    def load(cls, path: str | Path | None = None, precision: Precision = "auto") -> Self:
        """Return the shipped network, or the one of a file that training wrote; see `read` for errors."""
        return cls.read(SHIPPED / "sweepnet.safetensors" if path is None else path, precision)

    @property
    def config(self) -> dict[str, Any]:
        """The arguments that build this architecture."""
        return {"batch_norm": len(self.norms) > 0, "wrap": self.wrap}

    @property
    def memory_format(self) -> torch.memory_format:
        """The order in memory in which it runs fastest: channels last, but for training in float32 on a CPU.

        There the gradient of the weights would take several times as long; `bench` has a step in either order.
        """
        device = next(self.parameters()).device
        learning = self.training and device.type == "cpu" and not uses_bfloat16(self.precision, device)
        return torch.contiguous_format if learning else torch.channels_last

    def train(self, mode: bool = True) -> Self:
        """Enter or leave training, with the weights in the `memory_format` that goes with it."""
        return super().train(mode).to(memory_format=self.memory_format)

    def check_size(self, H: int, W: int) -> None:
        """Refuse panoramas that the network cannot take: half of each side must be whole."""
        if H % 2 or W % 2:
            raise OmnistereoError(f"SweepNet halves the panorama: its sides must be even, got {W} × {H}")

    def _run(self, name: str, x: Tensor, skip: Tensor | None = None) -> Tensor:
        x = self.layers[name](x)
        if name in self.norms:
            x = self.norms[name](x)
        return relu_(x if skip is None else x + skip)

    def unary(self, images: Tensor, first: int, last: int) -> Features:
        """Run conv1 … conv18 on images (M, H, W): features (M, 32, H/2, last - first)."""
        W = images.shape[-1]
        low, high = self.widened(first, last, self.reach, W // 2)
        columns = torch.arange(2 * low - 2, 2 * high + 2, device=images.device) % W  # circular column padding
        x = images[:, None].index_select(-1, columns).contiguous(memory_format=self.memory_format)
        with full_precision(x):  # an image's texture may be little beside its brightness
            x = self._run("conv1", x)
        for k in range(2, 18, 2):
            x = self._run(f"conv{k + 1}", self._run(f"conv{k}", x), skip=x)
        x = self._run("conv18", x)
        return Features(x[..., first - low : last - low], first, W // 2)

    def compare(self, left: Tensor, right: Tensor, chosen: Tensor, offset: int) -> Tensor:
        """Run conv19 … fc5 on two descriptions; the score is what the sigmoid gets. See `LearnedCost.compare`."""
        x = torch.cat([left, right], 1).contiguous(memory_format=self.memory_format)
        for name in ("conv19", "deconv1", "conv20"):
            x = self._run(name, x)
        chosen = pad(chosen, (offset, x.shape[-1] - offset - chosen.shape[-1]))
        pixels = x.permute(0, 2, 3, 1).reshape(-1, x.shape[1])[chosen.reshape(-1)]
        return self._head(pixels) if self.training else in_strips(self._head, pixels)  # norms: the mean over all

    def _head(self, x: Tensor) -> Tensor:
        for name in ("fc1", "fc2", "fc3", "fc4"):
            x = self._run(name, x)
        with full_precision(x):
            return self.layers["fc5"](x.to(self.layers["fc5"].weight.dtype))[:, 0]

    @torch.no_grad()
    def fold(self) -> SweepNet:
        """Return the network of Table I that computes what this one does in evaluation: norms become weights."""
        plain = SweepNet(False, self.wrap, self.precision)
        for name, layer in self.layers.items():
            weight, bias = layer.weight, layer.bias
            if name in self.norms:
                norm = self.norms[name]
                scale = norm.weight / (norm.running_var + norm.eps).sqrt()
                bias = norm.bias - norm.running_mean * scale
                out = 1 if isinstance(layer, nn.ConvTranspose2d) else 0
                weight = weight * scale.view([-1 if axis == out else 1 for axis in range(weight.ndim)])
            plain.layers[name].weight.copy_(weight)
            plain.layers[name].bias.copy_(bias)
        return plain.to(weight.device).eval()
