"""Learned costs: `PairNetwork` is a network written plainly, `LearnedCost` runs it fast.

`LearnedCost` extracts the features of each camera once, however many pairs it is in, and matches
two cameras only in the columns that both see, with a halo for what the convolutions read beyond
them. Both are exact: what is left out cannot change a cost that is kept.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import torch
from torch import Tensor
from torch.nn.functional import pad

from omnistereo_lib.errors import OmnistereoError, check_type
from omnistereo_lib.frame import Frame
from omnistereo_lib.geometry.rig import Pair
from omnistereo_lib.progress import Progress, silent
from omnistereo_lib.stereo.columns import common_columns, split_at_seam
from omnistereo_lib.stereo.cost import BlockCost
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_lib.stereo.weights import StoredNetwork

Precision = Literal["auto", "float32", "bfloat16"]


def choose_precision(
    precision: Precision, device: torch.device | str
) -> Literal["float32", "bfloat16"]:
    """Return in which precision a device multiplies; sums, first and last layers stay float32.

    "auto": bfloat16 where the GPU or the CPU says that it has instructions for it. A trial would
    give other numbers under load. (Two cores with AVX-512 BF16: VolumeNet's frame 0.81 s, in
    float32 1.23.)

    Raises:
        OmnistereoError: If the precision is none of the three.
    """
    if precision not in ("auto", "float32", "bfloat16"):
        raise OmnistereoError(
            f'precision = {precision!r}; expected "auto", "float32" or "bfloat16"'
        )
    if precision != "auto":
        return precision
    if torch.device(device).type == "cuda":
        return "bfloat16" if torch.cuda.is_bf16_supported(including_emulation=False) else "float32"
    flags = torch.cpu.get_capabilities()
    return "bfloat16" if flags.get("amx_bf16") or flags.get("avx512_bf16") else "float32"


def autocast(precision: Precision, device: torch.device) -> torch.autocast:
    """Return the context in which matrix products run in a precision; see `choose_precision`."""
    return torch.autocast(
        device.type, torch.bfloat16, enabled=choose_precision(precision, device) == "bfloat16"
    )


def full_precision(x: Tensor) -> torch.autocast:
    """Return the context in which nothing runs in bfloat16: for a first or a last layer."""
    return torch.autocast(x.device.type, enabled=False)


class PairNetwork(StoredNetwork, ABC):
    """A network that maps two spherical images to a cost map; see `SweepNet` and `MCCNN`.

    Its `forward` is composed of `extract_features`, `match_features`, `score_pixels` and `to_cost`,
    which know nothing of the panorama around what they are given. Strips of columns can therefore
    run by themselves, if they carry a halo that is cut off afterwards:

        | halo |  columns start … stop - 1  | halo |

    """

    # So many columns of the panorama make one column of features.
    stride: ClassVar[int] = 1
    # `extract_features` takes so many rows (of 0) and columns off each side, in pixels.
    padding: ClassVar[tuple[int, int]]
    # So many columns of features at each side are wrong after `extract_features`, since the
    # convolutions look for what lies beyond the strip.
    feature_halo: ClassVar[int] = 0
    # The same after `match_features`.
    match_halo: ClassVar[int] = 0
    # Whether every layer continues around the ±180° seam.
    wrap: bool = True

    def volume(
        self, sweep: SphereSweep, frame: Frame, pairs: Sequence[Pair], progress: Progress = silent
    ) -> Tensor:
        """Return the cost volume, as `LearnedCost` computes it; see `Cost`."""
        return LearnedCost(self).volume(sweep, frame, pairs, progress)

    def check_size(self, H: int, W: int) -> None:
        """Refuse panoramas that the network cannot take."""

    @abstractmethod
    def extract_features(self, images: Tensor) -> Tensor:
        """Return the features (B, C, h, w) of padded images, 0 where unseen."""

    @abstractmethod
    def match_features(self, left: Tensor, right: Tensor) -> Tensor:
        """Return K numbers per pixel, (B, H, columns, K), of the features of two images."""

    @abstractmethod
    def score_pixels(self, pixels: Tensor) -> Tensor:
        """Return the scores (…) of pixels (…, K)."""

    def to_cost(self, score: Tensor) -> Tensor:
        """Return the cost in [0, 1] of a score, here the logit of a mismatch."""
        return torch.sigmoid(score)

    def pad_columns(self, images: Tensor, start: int, stop: int) -> Tensor:
        """Cut feature columns start … stop - 1, around the seam, out of panoramas, with padding."""
        # Columns are counted around the panorama: a strip may begin before the seam.
        rows, columns = self.padding
        index = torch.arange(
            self.stride * start - columns, self.stride * stop + columns, device=images.device
        )
        return pad(images.index_select(-1, index % images.shape[-1]), (0, 0, rows, rows))

    def add_halo(self, start: int, stop: int, halo: int, total: int) -> tuple[int, int]:
        """Widen a strip of feature columns: around the seam, or without `wrap` up to the seam."""
        return (
            (start - halo, stop + halo)
            if self.wrap
            else (max(start - halo, 0), min(stop + halo, total))
        )

    def extract_columns(self, images: Tensor, columns: tuple[int, int]) -> Features:
        """Extract what matching in columns (start, width) needs of panoramas (M, H, W)."""
        # From pixels to columns of features: the first is rounded down and the last one up.
        total = images.shape[-1] // self.stride
        start, stop = columns[0] // self.stride, -(-sum(columns) // self.stride)
        start, stop = self.add_halo(start, stop, self.match_halo, total)
        # With its halo the strip goes all the way around, or the network knows nothing of the seam:
        # then the whole panorama is one strip.
        if stop - start >= total or not self.wrap:
            start, stop = 0, total
        # A halo goes in with the strip, and the columns that come out wrong are cut off.
        low, high = self.add_halo(start, stop, self.feature_halo, total)
        maps = self.extract_features(
            self.pad_columns(images.masked_fill(images.isnan(), 0.0), low, high)
        )
        return Features(maps[..., start - low : stop - low], start, total)

    def match_columns(self, left: Features, right: Features, start: int, stop: int) -> Tensor:
        """Run `match_features` on the feature columns start … stop - 1: (B, H, pixels, K)."""
        # The same for matching; here a column of features is `stride` columns of pixels again.
        low, high = self.add_halo(start, stop, self.match_halo, left.total)
        pixels = self.match_features(
            left.wrapped_columns(low, high), right.wrapped_columns(low, high)
        )
        return pixels[:, :, self.stride * (start - low) : self.stride * (stop - low)]

    def shared_strips(
        self, a: tuple[int, int], b: tuple[int, int], W: int
    ) -> Iterator[tuple[int, int]]:
        """Yield (start, stop) of the feature columns that two cameras see, given (start, width)."""
        for first, width in common_columns(a, b, W):
            start, stop = first // self.stride, -(-(first + width) // self.stride)
            yield from (
                [(start, stop)]
                if self.wrap
                else split_at_seam(start, stop - start, W // self.stride)
            )


@dataclass(frozen=True, eq=False)
class Features:
    """Features (B, C, h, columns) of a camera, from column `start` of `total` around the seam."""

    maps: Tensor
    start: int
    total: int

    def wrapped_columns(self, start: int, stop: int) -> Tensor:
        """Return the features of columns start … stop - 1, which may lie beyond the seam."""
        index = (torch.arange(start, stop, device=self.maps.device) - self.start) % self.total
        if self.maps.stride(1) > 1:
            return self.maps.index_select(-1, index)
        # stays channels last
        return self.maps.permute(0, 2, 3, 1).index_select(2, index).permute(0, 3, 1, 2)


class LearnedCost(BlockCost):
    """A network as a matching cost, called like `ZNCC`: its own costs, many times faster.

    Args:
        network: Put into channels-last memory; if it is in training mode or on another device than
            the sweep, a copy computes.
        precision: Of the matrix products; see `choose_precision`.

    >>> from omnistereo_lib.stereo.learned import LearnedCost
    >>> frame = osl.load_dataset("data_samples/sunny", split="test")[0]
    >>> sweep = osl.SphereSweep(frame.rig, osl.SphereGrid(64, 16, num_spheres=4, min_depth=1.65))
    >>> osl.cost_volume(sweep, frame.images, LearnedCost(osl.MCCNN.pretrained())).shape
    torch.Size([16, 64, 4])
    """

    def __init__(self, network: PairNetwork, precision: Precision = "auto") -> None:
        check_type(network, PairNetwork, "network")
        choose_precision(precision, "cpu")
        self.network = network.ready(next(network.parameters()).device)
        # Torch's hints lack it.
        self.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.precision = precision

    def volume(
        self, sweep: SphereSweep, frame: Frame, pairs: Sequence[Pair], progress: Progress = silent
    ) -> Tensor:
        """Return the cost volume, one block of spheres at a time; see `Cost`."""
        self.network = self.network.ready(sweep.device)
        return super().volume(sweep, frame, pairs, progress)

    @torch.no_grad()
    def __call__(
        self,
        spherical_images: Tensor,
        pairs: Sequence[Pair],
        columns: Sequence[tuple[int, int]] | None = None,
    ) -> Tensor:
        """Return the mean cost over camera pairs of a block of spheres, (H, W, B); see `BlockCost`.

        Images and network are on one device. Raises an `OmnistereoError` if the network cannot take
        a panorama of this size.
        """
        cameras, B, H, W = spherical_images.shape
        device = spherical_images.device
        self.network.check_size(H, W)
        columns = columns if columns is not None else [(0, W)] * cameras
        # The mean over pairs (Eq. 2): sums of costs and of visibility, divided at the end.
        total = torch.zeros(B, H, W, dtype=torch.float32, device=device)
        count = torch.zeros_like(total)
        # On a CPU so few spheres that their features stay in a core's cache; a GPU has to be
        # filled.
        spheres = max(1, (1 << 14 if device.type == "cpu" else 1 << 22) // (H * W))
        with autocast(self.precision, device):
            for first in range(0, B, spheres):
                block = slice(first, first + spheres)
                self._add_costs(
                    spherical_images[:, block], pairs, columns, total[block], count[block]
                )
        # 0/0 is NaN, where no pair sees the ray.
        return (total / count).permute(1, 2, 0)

    def _add_costs(
        self,
        images: Tensor,
        pairs: Sequence[Pair],
        columns: Sequence[tuple[int, int]],
        total: Tensor,
        count: Tensor,
    ) -> None:
        """Add the costs and the visibility of all pairs to total and count (B, H, W)."""
        network, W, device = self.network, images.shape[-1], images.device
        # Each camera's features are computed once, however many pairs it is in; cameras that see
        # nothing of this block are left out.
        cameras = {i for pair in pairs for i in pair if columns[i][1]}
        features = {i: network.extract_columns(images[i], columns[i]) for i in cameras}
        # Pixels are scored in chunks, of a size chosen as that of the spheres above.
        chunk = 1 << 11 if device.type == "cpu" else 1 << 19
        for i, j in pairs:
            for start, stop in network.shared_strips(columns[i], columns[j], W):
                # Where both cameras see: NaN in either image makes the sum NaN. To score only these
                # cannot change their costs: the last layers look at one pixel.
                strip = (
                    torch.arange(network.stride * start, network.stride * stop, device=device) % W
                )
                visible = ~(
                    images[i].index_select(-1, strip) + images[j].index_select(-1, strip)
                ).isnan()
                pixels = network.match_columns(features[i], features[j], start, stop)[visible]
                scores = torch.cat([network.score_pixels(part) for part in pixels.split(chunk)])
                cost = torch.zeros(visible.shape, dtype=torch.float32, device=device)
                cost[visible] = network.to_cost(scores)
                total[..., strip] += cost
                count[..., strip] += visible
