"""MC-CNN, the learned cost of 9 × 9 patches that the paper compares with (Žbontar & LeCun, JMLR 2016)."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, Self

import torch
from torch import Tensor, nn
from torch.nn.functional import normalize, pad, relu, relu_

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.stereo.learned import Features, LearnedCost, Precision, full_precision, in_strips
from omnistereo_lib.stereo.weights import SHIPPED

PATCH = 9  # pixels: four 3 × 3 layers without padding leave one
_MAPS = {"fast": 64, "accurate": 112}


class MCCNN(LearnedCost):
    """MC-CNN as a matching cost, called like `ZNCC`: 0 = match, 1 = no match.

    Both variants describe a patch by four 3 × 3 convolutions. "fast" compares descriptions by their cosine,
    cost (1 - cos)/2; "accurate" by four fully connected layers of 384 and a sigmoid. Whole panoramas are described
    at once, which equals patch by patch. A patch wraps around the panorama's seam; where a camera does not see, and
    above and below the panorama, it is 0, the mean gray value.

    Parameters
    ----------
    variant : "fast" | "accurate"
        111,424 and 870,449 parameters.
    precision : "auto" | "float32" | "bfloat16"
        Of the matrix products; "auto" takes bfloat16 where the processor multiplies it in hardware.

    Raises
    ------
    OmnistereoError
        If there is no such variant.
    """

    stride, reach, margin = 1, PATCH // 2, 0

    def __init__(self, variant: Literal["fast", "accurate"] = "fast", precision: Precision = "auto") -> None:
        super().__init__()
        if variant not in _MAPS:
            raise OmnistereoError(f'variant must be "fast" or "accurate", got {variant!r}')
        self.variant, self.precision = variant, precision
        maps = _MAPS[variant]
        self.tower = nn.ModuleList(nn.Conv2d(1 if k == 0 else maps, maps, 3) for k in range(4))
        sizes = [2 * maps, 384, 384, 384, 384, 1] if variant == "accurate" else [0]
        self.head = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(sizes))
        for layer in [*self.tower, *self.head]:
            nn.init.zeros_(layer.bias)
            nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
        if self.head:
            nn.init.normal_(self.head[-1].weight, std=0.01)  # starts undecided
        self.to(memory_format=torch.channels_last)

    @classmethod
    def load(
        cls,
        path: str | Path | None = None,
        precision: Precision = "auto",
        variant: Literal["fast", "accurate"] = "fast",
    ) -> Self:
        """Return a shipped network, or the one of a file that training wrote; see `read` for errors."""
        return cls.read(SHIPPED / f"mccnn_{variant}.safetensors" if path is None else path, precision)

    @property
    def config(self) -> dict[str, Any]:
        """The arguments that build this architecture."""
        return {"variant": self.variant}

    def check_size(self, H: int, W: int) -> None:
        """Refuse panoramas smaller than a patch."""
        if min(H, W) < PATCH:
            raise OmnistereoError(f"patches of {PATCH} × {PATCH} do not fit a panorama of {W} × {H} pixels")

    def describe_patches(self, patches: Tensor) -> Tensor:
        """Describe images (M, H, W) at every pixel that has a whole patch around it: (M, maps, H - 8, W - 8)."""
        x = patches[:, None].contiguous(memory_format=torch.channels_last)
        with full_precision(x):  # a patch's texture may be little beside its brightness
            x = relu_(self.tower[0](x))
        for layer in self.tower[1:-1]:
            x = relu_(layer(x))
        x = self.tower[-1](x)
        return normalize(x.float()) if self.variant == "fast" else relu(x)

    def unary(self, images: Tensor, first: int, last: int) -> Features:
        """Describe the columns first … last - 1 of images (M, H, W): features (M, maps, H, last - first)."""
        W = images.shape[-1]
        columns = torch.arange(first - self.reach, last + self.reach, device=images.device) % W
        x = pad(images.index_select(-1, columns), (0, 0, self.reach, self.reach))
        return Features(self.describe_patches(x), first, W)

    def compare(self, left: Tensor, right: Tensor, chosen: Tensor, offset: int) -> Tensor:
        """Return cosines, or what the sigmoid gets, of the chosen pixels; see `LearnedCost.compare`."""
        if self.variant == "fast":
            return (left * right).sum(1)[chosen]
        pixels = torch.cat([side.permute(0, 2, 3, 1)[chosen] for side in (left, right)], -1)
        return in_strips(self._score, pixels)

    def _score(self, x: Tensor) -> Tensor:
        for layer in self.head[:-1]:
            x = relu_(layer(x))
        with full_precision(x):
            return self.head[-1](x.to(self.head[-1].weight.dtype))[:, 0]

    def cost_of(self, score: Tensor) -> Tensor:
        """Return the cost in [0, 1] of a score."""
        return torch.sigmoid(score) if self.variant == "accurate" else (0.5 - 0.5 * score).clamp(0, 1)
