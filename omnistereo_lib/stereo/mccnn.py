"""MC-CNN, the learned cost of 9 × 9 patches that the paper compares with (JMLR 2016)."""

from itertools import pairwise
from typing import Any, Literal, Self

import torch
from torch import Tensor, nn
from torch.nn.functional import normalize, relu, relu_

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.stereo.learned import PairNetwork, full_precision
from omnistereo_lib.stereo.weights import BUNDLED_WEIGHTS

# In pixels: of a patch, four 3 × 3 layers without padding leave one.
PATCH = 9
_MAPS = {"fast": 64, "accurate": 112}
Variant = Literal["fast", "accurate"]


class MCCNN(PairNetwork):
    """MC-CNN: two spherical images → cost map, 0 = match, 1 = no match.

    Four 3 × 3 convolutions extract the features of a patch. "fast" compares them by their cosine,
    cost (1 - cos)/2; "accurate" by four fully connected layers of 384 and a sigmoid. Whole
    panoramas run at once, which equals patch by patch. A patch wraps around the ±180° seam; it is
    0, the mean gray value, where a camera does not see and above and below the panorama.

    Args:
        variant: 111,424 and 870,449 parameters; another one raises `OmnistereoError`.

    >>> sum(parameter.numel() for parameter in osl.MCCNN("fast").parameters())
    111424
    """

    padding = (PATCH // 2, PATCH // 2)
    tower: Any  # ModuleList; torch does not type its entries
    head: Any

    def __init__(self, variant: Variant = "fast") -> None:
        super().__init__()
        if variant not in _MAPS:
            raise OmnistereoError(f'variant = {variant!r}; expected "fast" or "accurate"')
        self.variant, maps = variant, _MAPS[variant]
        self.tower = nn.ModuleList(nn.Conv2d(1 if k == 0 else maps, maps, 3) for k in range(4))
        sizes = [2 * maps, 384, 384, 384, 384, 1] if variant == "accurate" else [0]
        self.head = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(sizes))
        for layer in [*self.tower, *self.head]:
            nn.init.zeros_(layer.bias)
            nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
        if self.head:
            # The network starts undecided.
            nn.init.normal_(self.head[-1].weight, std=0.01)

    @classmethod
    def pretrained(cls, variant: Variant = "fast") -> Self:
        """Return a bundled network, in evaluation mode."""
        return cls.from_file(BUNDLED_WEIGHTS / f"mccnn_{variant}.safetensors", variant=variant)

    @property
    def config(self) -> dict[str, Any]:
        """The arguments that build this architecture."""
        return {"variant": self.variant}

    def check_size(self, H: int, W: int) -> None:
        """Refuse panoramas smaller than a patch."""
        if min(H, W) < PATCH:
            raise OmnistereoError(
                f"panorama of {W} × {H} pixels; expected at least a patch of {PATCH} × {PATCH}"
            )

    def forward(self, left: Tensor, right: Tensor) -> Tensor:
        """Return the cost map in [0, 1] of two spherical images, (B, H, W) each, 0 unseen."""
        H, W = left.shape[1:]
        self.check_size(H, W)
        left, right = (
            self.extract_features(self.pad_columns(image, 0, W)) for image in (left, right)
        )
        return self.to_cost(self.score_pixels(self.match_features(left, right)))

    def extract_features(self, images: Tensor) -> Tensor:
        """Return features of every whole patch, of unit length if fast: (B, maps, h - 8, w - 8)."""
        x = images[:, None]
        # The texture of a patch may be faint beside its brightness.
        with full_precision(x):
            x = relu_(self.tower[0](x))
        for layer in self.tower[1:-1]:
            x = relu_(layer(x))
        x = self.tower[-1](x)
        return normalize(x.float()) if self.variant == "fast" else relu(x)

    def match_features(self, left: Tensor, right: Tensor) -> Tensor:
        """Return the cosine (fast) or both features of every pixel: (B, H, w, 1 or 2 maps)."""
        if self.variant == "fast":
            return (left * right).sum(1)[..., None]
        return torch.cat([side.permute(0, 2, 3, 1) for side in (left, right)], -1)

    def score_pixels(self, pixels: Tensor) -> Tensor:
        """Return the scores (…) of pixels (…, K): a cosine, match = 1, or a logit of mismatch."""
        if self.variant == "fast":
            return pixels[..., 0]
        for layer in self.head[:-1]:
            pixels = relu_(layer(pixels))
        with full_precision(pixels):
            return self.head[-1](pixels.to(self.head[-1].weight.dtype))[..., 0]

    def to_cost(self, score: Tensor) -> Tensor:
        """Return the cost in [0, 1] of a score."""
        return (
            torch.sigmoid(score) if self.variant == "accurate" else (0.5 - 0.5 * score).clamp(0, 1)
        )
