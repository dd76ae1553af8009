"""What the learned costs share: a network called like `ZNCC`, evaluated where two cameras see and nowhere else.

A learned cost has two halves. `unary` describes each warped image by itself, so it runs once for a camera and a
sphere, however many pairs that camera is in. `compare` matches two descriptions, so it runs on the columns that
both cameras see, with a margin for what its convolutions read beyond them. Both are exact: what is left out could
not have changed a cost that is kept.

Splitting the first layer after the concatenation by camera, A f_i + B f_j, is exact as well, but once pairs are
cropped it pays nowhere: a ring pair shares 31 % of the rays, and each half would run on the 56 % that one camera
sees, twice for every camera.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import torch
from torch import Tensor, nn

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.stereo.sweep import split_at_seam
from omnistereo_lib.stereo.weights import load_tensors, save_tensors
from omnistereo_lib.stereo.zncc import common_columns

Precision = Literal["auto", "float32", "bfloat16"]

# How many panorama pixels go through the convolutions together, and how many through the layers that look at one
# pixel: on a CPU few, whose features stay in a core's cache; a GPU wants to be filled.
_PIXELS = {"cpu": 1 << 14}
_ROWS = {"cpu": 1 << 11}
_GPU_PIXELS, _GPU_ROWS = 1 << 22, 1 << 19


def uses_bfloat16(precision: Precision, device: torch.device | str) -> bool:
    """Say whether a device should compute in bfloat16 (weights, sums, the first and the last layer stay float32).

    "auto": where the hardware multiplies bfloat16 itself, AMX or AVX-512 BF16 on a CPU. Elsewhere it is emulated,
    up to hundreds of times slower than float32.

    Raises
    ------
    OmnistereoError
        If the precision is none of the three.
    """
    if precision not in ("auto", "float32", "bfloat16"):
        raise OmnistereoError(f'precision must be "auto", "float32" or "bfloat16", got {precision!r}')
    if precision != "auto":
        return precision == "bfloat16"
    if torch.device(device).type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    flags = torch.cpu.get_capabilities()
    return bool(flags.get("amx_bf16") or flags.get("avx512_bf16"))


def full_precision(x: Tensor) -> torch.autocast:
    """Return the context in which nothing runs in bfloat16: for a network's first layer and its last."""
    return torch.autocast(x.device.type, enabled=False)


def in_strips(layers: Callable[[Tensor], Tensor], pixels: Tensor) -> Tensor:
    """Run layers that look at one pixel each on a list of pixels (M, C), some at a time: (M,)."""
    return torch.cat([layers(part) for part in pixels.split(_ROWS.get(pixels.device.type, _GPU_ROWS))])


@dataclass(frozen=True, eq=False)
class Features:
    """What `unary` says of the images of one camera: maps (B, C, h, columns), the columns from `first` on.

    A whole panorama has `total` columns of features.
    """

    maps: Tensor
    first: int
    total: int

    def columns(self, first: int, last: int) -> Tensor:
        """Return the maps of columns first … last - 1, which may count on beyond the seam."""
        index = (torch.arange(first, last, device=self.maps.device) - self.first) % self.total
        # Channels last, as the maps lie in memory where no gradient is asked for.
        return self.maps.permute(0, 2, 3, 1).index_select(2, index).permute(0, 3, 1, 2)


class LearnedCost(nn.Module):
    """A network as a matching cost in [0, 1]; see `SweepNet` and `MCCNN`.

    Attributes
    ----------
    precision : "auto" | "float32" | "bfloat16"
        See `uses_bfloat16`.
    wrap : bool
        Whether every layer continues around the panorama's seam.
    """

    stride: ClassVar[int] = 1  # columns of the panorama for one column of features
    reach: ClassVar[int] = 0  # columns of features to each side that a column's features depend on
    margin: ClassVar[int] = 0  # columns of features to each side that a comparison reads
    wrap: bool = True
    precision: Precision = "auto"

    @property
    @abstractmethod
    def config(self) -> dict[str, Any]:
        """The arguments that build this architecture."""

    @abstractmethod
    def check_size(self, H: int, W: int) -> None:
        """Refuse panoramas that the network cannot take."""

    @abstractmethod
    def unary(self, images: Tensor, first: int, last: int) -> Features:
        """Describe images (M, H, W), 0 where unseen, in the columns of features first … last - 1."""

    @abstractmethod
    def compare(self, left: Tensor, right: Tensor, chosen: Tensor, offset: int) -> Tensor:
        """Score pixels of two descriptions.

        Parameters
        ----------
        left, right : tensors, shape (B, C, h, w)
            Features with their margin.
        chosen : bool tensor, shape (B, H, columns)
            Which pixels; its first column is number `offset` of the features', in pixels.

        Returns
        -------
        float32 tensor, shape (number chosen,)
            In the order of `chosen`; `cost_of` makes costs of them.
        """

    def cost_of(self, score: Tensor) -> Tensor:
        """Return the cost in [0, 1] of a score."""
        return torch.sigmoid(score)

    def forward(
        self,
        spherical: Tensor,
        pairs: Sequence[tuple[int, int]],
        columns: Sequence[tuple[int, int]] | None = None,
    ) -> Tensor:
        """Return the mean cost over camera pairs (Eq. 2) for a block of spheres; everything as in `ZNCC`.

        Raises
        ------
        OmnistereoError
            If the network cannot take a panorama of this size.
        """
        _, B, H, W = spherical.shape
        self.check_size(H, W)
        self.to(spherical.device)
        columns = columns if columns is not None else [(0, W)] * len(spherical)
        total = torch.zeros(B, H, W, device=spherical.device)
        count = torch.zeros_like(total)
        with torch.no_grad(), self.autocast(spherical.device):
            for part in torch.arange(B).split(max(1, _PIXELS.get(spherical.device.type, _GPU_PIXELS) // (H * W))):
                block = slice(int(part[0]), int(part[-1]) + 1)
                self._add_costs(spherical[:, block], pairs, columns, total[block], count[block])
        return (total / count).permute(1, 2, 0)  # 0/0 = NaN where no pair sees the ray

    def autocast(self, device: torch.device) -> torch.autocast:
        """Return the context in which matrix products run in the precision chosen."""
        return torch.autocast(device.type, torch.bfloat16, enabled=uses_bfloat16(self.precision, device))

    def describe(self, images: Tensor, columns: tuple[int, int]) -> Features:
        """Run `unary` on the columns (start, width) that a camera sees of panoramas (M, H, W), NaN where unseen."""
        total = images.shape[-1] // self.stride
        first, last = 0, total
        if self.wrap:
            first, last = columns[0] // self.stride, -(-(columns[0] + columns[1]) // self.stride)
            first, last = self.widened(first, last, self.margin, total)
        if last - first >= total:
            first, last = 0, total
        return self.unary(images.masked_fill(images.isnan(), 0.0), first, last)

    def strips(self, a: tuple[int, int], b: tuple[int, int], W: int) -> Iterator[tuple[int, int]]:
        """Yield (first, last + 1) of the columns of features that two cameras share, given their columns a and b."""
        for start, width in common_columns(a, b, W):
            first, last = start // self.stride, -(-(start + width) // self.stride)
            yield from [(first, last)] if self.wrap else split_at_seam(first, last - first, W // self.stride)

    def score(self, a: Features, b: Features, first: int, last: int, chosen: Tensor) -> Tensor:
        """Run `compare` on one strip of feature columns, first … last - 1; chosen (B, H, its pixels)."""
        low, high = self.widened(first, last, self.margin, a.total)
        return self.compare(a.columns(low, high), b.columns(low, high), chosen, (first - low) * self.stride)

    def widened(self, first: int, last: int, by: int, total: int) -> tuple[int, int]:
        """Widen a strip of feature columns: around the seam, or up to it and no further."""
        return (first - by, last + by) if self.wrap else (max(first - by, 0), min(last + by, total))

    def _add_costs(
        self,
        spherical: Tensor,
        pairs: Sequence[tuple[int, int]],
        columns: Sequence[tuple[int, int]],
        total: Tensor,
        count: Tensor,
    ) -> None:
        """Add the costs of all pairs to total and count (B, H, W)."""
        features = {i: self.describe(spherical[i], columns[i]) for i in {i for pair in pairs for i in pair}}
        W = spherical.shape[-1]
        for i, j in pairs:
            for first, last in self.strips(columns[i], columns[j], W):
                strip = torch.arange(first * self.stride, last * self.stride, device=spherical.device) % W
                seen = ~(spherical[i].index_select(-1, strip) + spherical[j].index_select(-1, strip)).isnan()
                cost = torch.zeros(seen.shape, device=spherical.device)
                cost[seen] = self.cost_of(self.score(features[i], features[j], first, last, seen))
                total[..., strip] += cost
                count[..., strip] += seen

    def save(self, path: str | Path, **about: Any) -> None:
        """Write the weights, with what else there is to know about them; see `save_tensors`."""
        save_tensors(path, self.state_dict(), {"architecture": type(self).__name__, "config": self.config, **about})

    @classmethod
    def read(cls, path: str | Path, precision: Precision = "auto") -> Self:
        """Build the network that a file describes, with its weights.

        Raises
        ------
        OmnistereoError
            If the file is missing, damaged, or holds another architecture.
        """
        tensors, about = load_tensors(path)
        if about.get("architecture") != cls.__name__:
            found = about.get("architecture", "a training state")
            raise OmnistereoError(f"{path} holds weights of {found}, expected {cls.__name__}")
        uses_bfloat16(precision, "cpu")
        network = cls(**about["config"])
        network.precision = precision
        try:
            network.load_state_dict(tensors)
        except RuntimeError as error:
            raise OmnistereoError(f"{path} does not fit {cls.__name__}{about['config']}: {error}") from None
        return network.eval()
