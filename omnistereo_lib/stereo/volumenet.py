"""VolumeNet, a network that sees the whole sweep volume at once, for rigs of any number of cameras.

ZNCC compares patches and SweepNet whole spheres, but each sphere by itself: nothing tells them that
a blank wall has *one* depth. VolumeNet takes the step that the field took after SweepNet (OmniMVS,
ICCV 2019; GwcNet, CVPR 2019)::

    features     each fisheye image → 32 feature maps at half its size
    warp         the maps onto the cells of two volumes, a coarse and a finer one (Eq. 1); see
                 `volume_sizes`
    correlation  in groups of four channels, over all pairs of cameras to which a cell is visible
    3-D U-net    over θ, φ and the sphere index, circular in θ
    read-out     a probability for each sphere of a ray; the index is the mean around the most
                 probable one

Volumes are (batch, channels, W, H, N): with W first, PyTorch picks its fast CPU kernels.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import reduce
from itertools import pairwise
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn.functional import conv3d, interpolate, relu

from omnistereo_lib import reference
from omnistereo_lib.frame import Frame
from omnistereo_lib.geometry.rig import Pair
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.progress import Progress, counted, silent
from omnistereo_lib.stereo.correlation import (
    COARSE,
    Coordinates,
    coordinates_of,
    correlate,
    feature_coordinates,
    pixels_per_degree,
    volume_cells,
    volume_sizes,
)
from omnistereo_lib.stereo.cost import Volume
from omnistereo_lib.stereo.device import takes_loops
from omnistereo_lib.stereo.kernels import correlation_numba, double_numba, read_out_numba
from omnistereo_lib.stereo.kernels.correlation_numba import CHANNELS, GROUPS
from omnistereo_lib.stereo.learned import Precision, autocast, full_precision
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_lib.stereo.weights import StoredNetwork

# Called with the name of each part before it begins.
_Step = Callable[[str], object]
# Channels of the U-net's levels. Each level is half as wide, high and deep as the one before.
WIDTHS = (16, 32, 48, 64)


def fuses(x: Tensor) -> bool:
    """Return whether oneDNN may filter and clip in one pass: on a CPU, where nothing is traced."""
    return takes_loops(x) and torch.backends.mkldnn.is_available() and not torch.is_grad_enabled()


def fused(
    x: Tensor,
    weight: Tensor,
    bias: Tensor,
    stride: Sequence[int],
    padding: Sequence[int],
    dilation: Sequence[int],
    plus: Tensor | None = None,
    after: str = "relu",
) -> Tensor:
    """Return after(convolution + plus) in one pass, where `fuses`.

    Torch takes one pass for each, and with AMX a pass takes as long as a convolution: 16 channels
    of 320 × 80 × 48 57 ms of one core with `wrap` and relu, 25 in one pass, the same bits.
    """
    dtype = torch.get_autocast_dtype("cpu") if torch.is_autocast_enabled("cpu") else x.dtype
    x, weight, bias = (one.to(dtype) for one in (x, weight, bias))
    sizes, of_onednn = (padding, stride, dilation, 1), torch.ops.mkldnn._convolution_pointwise
    if plus is None:
        return of_onednn(x, weight, bias, *sizes, after, [], "")
    return of_onednn.binary(x, plus, weight, bias, *sizes, "add", 1.0, after, [], "")


def filtered(layer: nn.Conv2d, x: Tensor, plus: Tensor | None = None) -> Tensor:
    """Return relu(layer(x) + plus)."""
    if not fuses(x):
        return relu(layer(x) if plus is None else layer(x) + plus, inplace=True)
    assert layer.bias is not None and not isinstance(layer.padding, str)
    return fused(x, layer.weight, layer.bias, layer.stride, layer.padding, layer.dilation, plus)


class ResidualBlock(nn.Sequential):
    """Two dilated 3 × 3 convolutions, whose output is added to their input."""

    def __init__(self, *dilations: int) -> None:
        super().__init__(
            *(nn.Conv2d(CHANNELS, CHANNELS, 3, padding=d, dilation=d) for d in dilations)
        )

    def forward(self, x: Tensor) -> Tensor:
        """Return the feature maps (B, 32, h, w) of feature maps."""
        first, second = cast(list[nn.Conv2d], [*self])
        return filtered(second, filtered(first, x), x)


class FeatureNet(nn.Module):
    """Features of fisheye images, whose length says how much texture there is.

    The maps are normalised over the visible pixels of the image, not pixel by pixel: a blank wall
    has small features, so its noise does not correlate.
    """

    def __init__(self) -> None:
        super().__init__()
        self.first = nn.Conv2d(1, CHANNELS, 5, stride=2, padding=2)
        self.blocks = nn.Sequential(ResidualBlock(1, 1), ResidualBlock(1, 2), ResidualBlock(4, 2))
        self.last = nn.Conv2d(CHANNELS, CHANNELS, 3, padding=1)
        # Channels last in memory: a quarter faster.
        nn.utils.convert_conv2d_weight_memory_format(self, torch.channels_last)

    def forward(self, image: Tensor, visible: Tensor) -> Tensor:
        """Return the feature maps of one image.

        Args:
            image: tensor, shape (h, w), zero mean and unit variance where visible, 0 elsewhere
            visible: bool tensor of the same shape

        Returns:
            tensor, shape (32, ⌈h / 2⌉, ⌈w / 2⌉): Feature pixel (x, y) is image pixel (2x, 2y).
        """
        # (h, w) → (1, 32, h / 2, w / 2)
        x = self.blocks(filtered(self.first, image[None, None]))
        maps, visible = self.last(x)[0].float(), visible[::2, ::2]
        # Over the visible pixels, each channel gets zero mean, each group of channels unit
        # variance. So features stay small, and do not correlate by noise, where there is little
        # texture.
        if fuses(maps):
            return correlation_numba.normalize(maps, visible)
        count = visible.sum().clamp(min=1)
        maps = (maps - (maps * visible).sum((1, 2), keepdim=True) / count) * visible
        power = (maps.square().sum((1, 2)) / count).view(GROUPS, -1).mean(1)
        return maps * (power + 1e-5).rsqrt().repeat_interleave(CHANNELS // GROUPS)[:, None, None]


class Conv3d(nn.Module):
    """A 3 × 3 × 3 convolution, circular in θ, with batch normalisation and ReLU."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__()
        self.conv = nn.Conv3d(inputs, outputs, 3, stride, padding=(0, 1, 1), bias=False)
        # Without a momentum the statistics are plain means over the batches, see `train`.
        self.norm = nn.BatchNorm3d(outputs, momentum=None)

    def forward(self, x: Tensor) -> Tensor:
        """Return the filtered volume (B, outputs, W, H, N), each side divided by the stride."""
        conv, norm = self.conv, self.norm
        if self.training:
            return relu(norm(conv(wrap(x))), inplace=True)
        assert norm.running_mean is not None and norm.running_var is not None
        # A trained normalisation is an affine map of each channel, γ (x - μ) / √(σ² + ε) + β, so it
        # can be part of the weights and the bias: the volume is read and written once less.
        scale = norm.weight / (norm.running_var + norm.eps).sqrt()
        weight = conv.weight * scale[:, None, None, None, None]
        bias = norm.bias - norm.running_mean * scale
        return filter_volume(x, weight, bias, conv.stride[0])


def filter_volume(
    x: Tensor, weight: Tensor, bias: Tensor, stride: int = 1, after: str = "relu"
) -> Tensor:
    """Return conv3d of a volume (B, C, W, H, N), circular in θ, and "relu" or "none" after it."""
    if not fuses(x):
        y = conv3d(wrap(x), weight, bias, stride, (0, 1, 1))
        return relu(y, inplace=True) if after == "relu" else y
    # Without a copy that is two columns wider: first as if nothing lay beyond the seam, then the
    # columns at the seam again.
    sides, once = (stride,) * 3, (1, 1, 1)
    y = fused(x, weight, bias, sides, once, once, after=after)
    seam = torch.cat([x[:, :, stride - 3 :], x[:, :, :2]], 2)
    ends = fused(seam, weight, bias, sides, (0, 1, 1), once, after=after)
    y[:, :, 0] = ends[:, :, -1]
    if stride == 1:
        y[:, :, -1] = ends[:, :, 0]
    return y


def wrap(x: Tensor) -> Tensor:
    """Continue a volume (B, C, W, H, N) by one column on either side of the ±180° seam."""
    # The last column goes before the first, and the first behind the last.
    return torch.cat([x[:, :, -1:], x, x[:, :, :1]], 2)


def double(x: Tensor) -> Tensor:
    """Double the three sides of a volume by trilinear interpolation, circular in θ."""
    # The two columns that continue the volume are four after doubling: cut two off each side.
    return interpolate(wrap(x), scale_factor=2, mode="trilinear", align_corners=False)[:, :, 2:-2]


class Up(nn.ModuleList):
    """A step up in the U-net: project, double the size, add the finer level, filter."""

    def __init__(self, finer: int, coarser: int) -> None:
        super().__init__([nn.Conv3d(coarser, finer, 1), Conv3d(finer, finer)])

    def forward(self, x: Tensor, level: Tensor) -> Tensor:
        """Return the finer level (B, C, W, H, N), given the coarser and that of the way down."""
        project, merge = self
        x = project(x)
        # Into the finer level, which no gradient needs then: the largest array of the U-net less.
        if fuses(level) and x.dtype == torch.bfloat16:
            return merge(double_numba.add_doubled(level, x))
        doubled = double(x)
        x = level.add_(doubled) if fuses(level) else doubled.add_(level)
        del doubled
        return merge(x)


class VolumeNet(StoredNetwork):
    """Features, correlation and a 3-D U-net; see the head of the module. 518,305 parameters.

    As a matching cost it computes the whole volume at once, from all cameras.

    Attributes:
        precision: Of the matrix products in `volume`; see `choose_precision`. Another number of
            threads adds in another order: 1, 2 and 4 threads differ by 1e-5 spheres in float32,
            in bfloat16 by 7e-4 on average, 1.7 at most (320 × 80 × 64).

    >>> sum(parameter.numel() for parameter in osl.VolumeNet().parameters())
    518305
    """

    bundled = "volumenet"
    precision: Precision = "auto"

    def __init__(self) -> None:
        super().__init__()
        # The stem takes eight correlations and the share of cameras; a step down halves all three
        # sides, a step up adds the level of its size; the head leaves one logit per cell.
        self.features = FeatureNet()
        self.stem = nn.Sequential(Conv3d(GROUPS + 1, WIDTHS[0]), Conv3d(WIDTHS[0], WIDTHS[0]))
        steps = list(pairwise(WIDTHS))
        self.down = nn.ModuleList(
            nn.Sequential(Conv3d(a, b, stride=2), Conv3d(b, b)) for a, b in steps
        )
        self.up = nn.ModuleList(Up(a, b) for a, b in steps)
        self.head = nn.Conv3d(WIDTHS[0], 1, 3, padding=(0, 1, 1))

    def correlation(
        self, images: Sequence[Tensor], visible: Sequence[Tensor], coordinates: Sequence[Tensor]
    ) -> Tensor:
        """Return the correlation volume (9, W, H, N) of one frame; see `FeatureNet`."""
        features = [self.features(image, mask) for image, mask in zip(images, visible, strict=True)]
        with full_precision(features[0]):
            return self.compare(features, coordinates)

    def compare(
        self, features: Sequence[Tensor], coordinates: Sequence[Tensor] | Sequence[Coordinates]
    ) -> Tensor:
        """Return the volume that the U-net sees, its last channel k / 4; see `correlate`."""
        return correlate(features, coordinates)

    def forward(self, volume: Tensor) -> Tensor:
        """Run the U-net on (B, 9, W, H, N), sizes in multiples of 8: logits (B, W, H, N)."""
        return self.run_unet(self.prepare(volume))

    def prepare(self, volume: Tensor) -> Tensor:
        """Return the volume (B, 9, W, H, N) in the layout and precision of the U-net."""
        # Channels last, a layout that every layer keeps: twice as fast. oneDNN's blocked and
        # prepacked forms take as long: 10.7 to 12.4 ms of one core for 16 channels of 160 × 40 ×
        # 48, 390 GFLOP/s; only the head's single channel has 25.
        kind = volume.device.type
        half = not self.training and torch.is_autocast_enabled(kind)
        dtype = torch.get_autocast_dtype(kind) if half else volume.dtype
        return volume.to(dtype, memory_format=torch.channels_last_3d)

    def run_unet(self, volume: Tensor) -> Tensor:
        """Return the logits (B, W, H, N) of a volume from `prepare`."""
        # One by one: each volume goes as soon as the next is there.
        for layer in self.stem:
            volume = layer(volume)
        levels = [volume]
        del volume
        # Down: every level is kept for the way up. Then up from the coarsest one.
        for down in self.down:
            levels.append(down(levels[-1]))
        x = levels.pop()
        for up in reversed(self.up):
            x = up(x, levels.pop())
        assert self.head.bias is not None
        return filter_volume(x, self.head.weight, self.head.bias, after="none").float()[:, 0]

    @torch.no_grad()
    def volume(
        self,
        sweep: SphereSweep,
        frame: Frame,
        pairs: Sequence[Pair] = (),
        progress: Progress = silent,
    ) -> Volume:
        """Return 1 - probability of every sphere, (H, W, N); NaN where no two cameras see the ray.

        See `Cost`. The pairs are not used: `correlate` compares all cameras.
        """
        if (network := self.ready(sweep.device)) is not self:
            return network.volume(sweep, frame, pairs, progress)
        grid, device, sizes = sweep.grid, sweep.device, volume_sizes(sweep.grid, sweep.rig)
        # Volumes that suit one resolution of the images share their features.
        frames = [frame.reduced(pixels_per_degree(size)) for size in sizes]
        step = counted(progress, 3 * len(sizes) + len(sweep.rig) * len({*map(id, frames)}))
        # The logits of every cell, from a coarse volume and a finer one.
        logits, features = [], list[Tensor]()  # (1, w, h, n) each
        for size, small, following in zip(sizes, frames, [*frames[1:], None], strict=True):
            with autocast(self.precision, device):
                features = features or self.features_of(sweep, small, step)
                # (9, w, h, n)
                correlation = self.correlation_at(sweep, small, size, features, step)
                features = features if following is small else []
                # The last channel is k / 4, so 0.5 for two cameras.
                shared = (correlation[-1] > 0.3).any(-1).float()[None, None]
                step("U-net")
                # Channels last already: the strides of a plain `[None]` would take a copy.
                prepared = [self.prepare(correlation.movedim(0, -1)[None].movedim(-1, 1))]
                del correlation  # before the U-net, whose levels take the most memory
                logits.append(self.run_unet(prepared.pop()) / len(sizes))
        # Rays that fewer than two cameras see in every cell have no cost.
        hidden = interpolate(shared, grid.shape[::-1], mode="nearest")[0, 0].T == 0  # (H, W)
        step("")
        return costs_of(logits, hidden, grid)

    def features_of(
        self, sweep: SphereSweep, frame: Frame, step: _Step = lambda what: None
    ) -> list[Tensor]:
        """Return the feature maps of the images of a frame; keep masks."""
        cameras, device = frame.rig.cameras, sweep.device

        def find_visible() -> list[Tensor]:
            return [torch.from_numpy(camera.visible_pixels()).to(device) for camera in cameras]

        key, features = (VolumeNet, *(camera.image_size for camera in cameras)), []
        masks = sweep.keep(key, find_visible) if sweep.keep_tables else find_visible()
        with autocast(self.precision, device):
            for k, (image, mask) in enumerate(zip(frame.gray, masks, strict=True), 1):
                step(f"camera {k} of {len(cameras)}")
                normalized = normalize(torch.from_numpy(image).to(device), mask)
                features.append(self.features(normalized, mask))
        return features

    def correlation_at(
        self,
        sweep: SphereSweep,
        frame: Frame,
        size: tuple[int, int, int],
        features: Sequence[Tensor],
        step: _Step = lambda what: None,
    ) -> Tensor:
        """Return the correlation volume at a size of `features_of` a frame; keep coordinates."""
        rig = replace(sweep.rig, cameras=frame.rig.cameras)

        def project() -> Sequence[Tensor] | Sequence[Coordinates]:
            if sweep.keep_tables or sweep.device.type != "cpu":
                return feature_coordinates(rig, sweep.grid, size, sweep.device)
            # Read once: 80 MB less are held, and what is projected is still in the cache.
            return coordinates_of(rig, *volume_cells(sweep.grid, size))

        # What depends on the rig and the grid alone.
        step("tables")
        coordinates = sweep.keep((VolumeNet, size), project) if sweep.keep_tables else project()
        # Not in the precision of the products, unless they are to follow at once, as in `volume`.
        step("correlation")
        return self.compare(features, coordinates)


def normalize(image: Tensor, visible: Tensor) -> Tensor:
    """Give an image (h, w) zero mean and unit variance over the visible pixels, and 0 elsewhere."""
    # By sums: to pick the visible pixels takes five times as long.
    count = visible.sum()
    centered = (image - (image * visible).sum() / count.clamp(min=1)) * visible
    deviation = (centered.square().sum() / (count - 1).clamp(min=1)).sqrt()
    return centered / deviation.clamp(min=1e-6)


def costs_of(logits: Sequence[Tensor], hidden: Tensor, grid: SphereGrid) -> Volume:
    """Return 1 - probability (H, W, N) of logits (1, w, h, n); NaN where hidden (H, W)."""
    if hidden.device.type == "cpu":
        levels = [one[0] @ along_rays(one, grid.num_spheres) for one in logits]
        return read_out_numba.Costs(levels, hidden)
    # The mean logits at full size become probabilities, some columns at a time.
    parts = []
    for columns in torch.arange(grid.width, device=hidden.device).split(64):
        mean = reduce(torch.add, (resize_logits(one, columns, grid)[0] for one in logits))
        parts.append((1 - mean.softmax(-1)).transpose(0, 1))
    return torch.cat(parts, 1).masked_fill_(hidden[..., None], torch.nan)


def resize_logits(logits: Tensor, columns: Tensor, grid: SphereGrid) -> Tensor:
    """Return columns of the full-size logits, around the seam: (B, w, h, n) → (B, columns, H, N).

    Linear across rays, cubic along them: linear, the most probable sphere of a ray would be in the
    middle of a cell.
    """
    w, n = logits.shape[1], logits.shape[3]
    # The centre of column x lies at (x + ½) w / W - ½ of the coarse volume, between columns `left`
    # and `left` + 1, counted around the seam.
    position = (columns + 0.5) * (w / grid.width) - 0.5
    left = position.floor().long()
    weight = (position - left)[:, None, None]
    across = logits[:, left % w] * (1 - weight) + logits[:, (left + 1) % w] * weight
    rays = interpolate(across, (grid.height, n), mode="bilinear", align_corners=False)
    with full_precision(rays):
        return rays @ along_rays(logits, grid.num_spheres)


def along_rays(logits: Tensor, num_spheres: int) -> Tensor:
    """Return the matrix (n, N) whose product with logits (…, n) resizes rays to N spheres."""
    # Cubic interpolation along the ray is linear in the logits: that of the unit vectors.
    n = logits.shape[-1]
    cells = torch.eye(n, dtype=logits.dtype, device=logits.device)[None, None]
    return interpolate(cells, (n, num_spheres), mode="bicubic", align_corners=False)[0, 0]


def local_mean(volume: Tensor) -> tuple[Tensor, Tensor]:
    """Return sphere index and confidence (H, W), float32, of costs 1 - probability (H, W, N).

    The index is the mean sphere around the most probable one, within a cell of the coarse volume,
    at least one sphere, on either side; see `reference.local_mean`. The confidence is the
    probability that these spheres have together, in [0, 1]. NaN where the cost is NaN.
    """
    return (read_out_numba if takes_loops(volume) else reference).local_mean(volume, COARSE[1])
