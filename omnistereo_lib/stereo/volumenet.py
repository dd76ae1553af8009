"""VolumeNet, a network that sees the whole sweep volume at once, for rigs of any number of cameras.

ZNCC compares patches and SweepNet whole spheres, but each sphere by itself: nothing tells them that a blank wall has
*one* depth. VolumeNet takes the step that the field took after SweepNet (OmniMVS, ICCV 2019; GwcNet, CVPR 2019):

    features     each fisheye image → 32 feature maps at half its size
    warp         the maps onto half as many spheres, at half the size of the panorama (Eq. 1)
    correlation  in groups of four channels, over all pairs of cameras to which a cell is visible
    3-D U-net    over θ, φ and the sphere index, circular in θ
    read-out     a probability for each sphere of a ray; the index is the mean around the most probable one

Volumes are (batch, channels, W, H, N): with W first, PyTorch picks its fast CPU kernels even for one frame in float32.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any, Self
from weakref import WeakKeyDictionary

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor, nn
from torch.nn.functional import embedding_bag, interpolate, relu

from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.learned import Precision, autocast, full_precision
from omnistereo_lib.stereo.sweep import SphereSweep, reduce_images, to_gray, visible_pixels
from omnistereo_lib.stereo.volume import require_memory
from omnistereo_lib.stereo.weights import BUNDLED_WEIGHTS, StoredNetwork

CHANNELS, GROUPS = 32, 8
WIDTHS = (16, 32, 48, 64)  # channels of the U-net's levels, each half as wide, high and deep as the one before
_RADIUS = 2  # spheres on either side of the most probable one that the read-out takes in
_CELLS = 1 << 14  # of the volume whose features are correlated at a time
_BYTES = 400  # of memory for each cell of the half-size volume, measured


class FeatureNet(nn.Module):
    """Features of fisheye images, whose length says how much texture there is.

    The maps are normalised over the visible pixels of the image, not pixel by pixel: a blank wall has small features,
    so its noise does not correlate.
    """

    def __init__(self) -> None:
        super().__init__()
        self.first = nn.Conv2d(1, CHANNELS, 5, stride=2, padding=2)
        self.blocks = nn.ModuleList(
            nn.ModuleList(nn.Conv2d(CHANNELS, CHANNELS, 3, padding=d, dilation=d) for d in dilations)
            for dilations in ((1, 1), (1, 2), (4, 2))
        )
        self.last = nn.Conv2d(CHANNELS, CHANNELS, 3, padding=1)

    def forward(self, image: Tensor, visible: Tensor) -> Tensor:
        """Return the feature maps of one image.

        Parameters
        ----------
        image : tensor, shape (h, w), zero mean and unit variance over the visible pixels, 0 elsewhere
        visible : bool tensor of the same shape

        Returns
        -------
        tensor, shape (32, ⌈h / 2⌉, ⌈w / 2⌉)
            Feature pixel (x, y) is centred on the image pixel (2x, 2y).
        """
        x = relu(self.first(image[None, None]))
        for first, second in self.blocks:
            x = relu(x + second(relu(first(x))))
        return self._normalize(self.last(x)[0].float(), visible[::2, ::2])

    def _normalize(self, maps: Tensor, visible: Tensor) -> Tensor:
        """Give maps (32, h, w) zero mean per channel and unit variance per group over the visible pixels."""
        count = visible.sum().clamp(min=1)
        maps = (maps - (maps * visible).sum((1, 2), keepdim=True) / count) * visible
        power = (maps.square().sum((1, 2)) / count).view(GROUPS, -1).mean(1)
        return maps * (power + 1e-5).rsqrt().repeat_interleave(CHANNELS // GROUPS)[:, None, None]


class _PairProducts(torch.autograd.Function):
    """Σ over pairs of cameras i ≠ j of the group means of f_i f_j, without keeping a warped map for the gradient."""

    @staticmethod
    def forward(ctx: Any, cells: Sequence[tuple[Tensor, Tensor]], *tables: Tensor) -> Tensor:
        """Return the sums (cells, 8) of features (h · w, 32), sampled at `bilinear` cells of each camera."""
        total = _sample(tables[0], *cells[0])
        squares = total.square()
        for table, at in zip(tables[1:], cells[1:], strict=True):
            warped = _sample(table, *at)
            squares.addcmul_(warped, warped)
            total += warped
        ctx.save_for_backward(total, *tables)
        ctx.cells = cells
        with full_precision(total):
            return (total.square() - squares) @ _group_means(total)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        """Return the gradients of the features: ∂/∂f_i = 2 (Σ_j f_j - f_i), scattered back by the warp."""
        total, *tables = ctx.saved_tensors
        grad = 2 * grad @ _group_means(total).T
        grads = []
        for table, (index, weight) in zip(tables, ctx.cells, strict=True):
            of_cells = (total - _sample(table, index, weight)).mul_(grad)
            of_table = torch.zeros_like(table)
            for corner in range(4):
                of_table.index_add_(0, index[:, corner], of_cells * weight[:, corner, None])
            grads.append(of_table)
        return None, *grads


def _sample(table: Tensor, index: Tensor, weight: Tensor) -> Tensor:
    """Return weighted sums of rows of a table (rows, C): (cells, C) for indices and weights (cells, 4)."""
    return embedding_bag(index, table, mode="sum", per_sample_weights=weight)


def _group_means(like: Tensor) -> Tensor:
    """Return the matrix (32, 8) that averages the channels of each group."""
    size = CHANNELS // GROUPS
    return torch.eye(GROUPS, device=like.device).repeat_interleave(size, 0) / size


def bilinear(uv: Tensor, size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Return the four pixels around feature coordinates and their bilinear weights.

    Parameters
    ----------
    uv : tensor, shape (..., 2)
        Feature pixels, NaN where the camera does not see the cell.
    size : (int, int)
        Width and height of the feature maps.

    Returns
    -------
    index : int32 tensor, shape (cells, 4), row · width + column
    weight : float32 tensor, shape (cells, 4), 0 where the camera does not see the cell
    """
    w, h = size
    x, y = uv.reshape(-1, 2).nan_to_num().unbind(-1)
    column, row = x.floor().clamp(0, w - 2), y.floor().clamp(0, h - 2)
    x, y = (x - column).clamp(0, 1), (y - row).clamp(0, 1)
    index = (row * w + column).int()
    weight = torch.stack([(1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y], -1)
    weight = weight.masked_fill(uv.reshape(-1, 2)[:, :1].isnan(), 0.0)
    return torch.stack([index, index + 1, index + w, index + w + 1], -1), weight


def correlate(features: Sequence[Tensor], coordinates: Sequence[Tensor]) -> Tensor:
    """Correlate the features of all cameras to which a cell is visible, in groups of channels.

    The mean of f_i f_j over all pairs i ≠ j needs no pairs: it is ((Σ f)² - Σ f²) / (k (k - 1)), where k is the number
    of cameras to which the cell is visible. So any number of cameras will do, in any order.

    Parameters
    ----------
    features : one tensor per camera, shape (32, h, w)
    coordinates : one tensor per camera, shape (W, H, N, 2)
        See `feature_coordinates`.

    Returns
    -------
    tensor, shape (9, W, H, N)
        Eight correlations, 0 where k < 2, and k / 4.
    """
    shape = coordinates[0].shape[:3]
    tables = [maps.permute(1, 2, 0).reshape(-1, CHANNELS) for maps in features]
    columns = max(1, _CELLS // shape[1:].numel())
    parts = []
    for uvs in zip(*(uv.split(columns) for uv in coordinates), strict=True):
        cells = [bilinear(uv, maps.shape[:0:-1]) for uv, maps in zip(uvs, features, strict=True)]
        k = sum((~uv[..., 0].isnan()).flatten().float() for uv in uvs)[:, None]
        products = _PairProducts.apply(cells, *tables)
        parts.append(torch.cat([products / (k * (k - 1)).clamp(min=1), k / 4], 1))
    return torch.cat(parts).view(*shape, -1).permute(3, 0, 1, 2)


class Conv3d(nn.Module):
    """A 3 × 3 × 3 convolution, circular in θ, with batch normalisation and ReLU."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__()
        self.conv = nn.Conv3d(inputs, outputs, 3, stride, padding=(0, 1, 1), bias=False)
        self.norm = nn.BatchNorm3d(outputs, momentum=None)  # None: plain means, see `train`

    def forward(self, x: Tensor) -> Tensor:
        """Return the filtered volume (B, outputs, W, H, N), each side divided by the stride."""
        return relu(self.norm(self.conv(wrap(x))))


def wrap(x: Tensor) -> Tensor:
    """Continue a volume (B, C, W, H, N) by one column on either side of the ±180° seam."""
    return torch.cat([x[:, :, -1:], x, x[:, :, :1]], 2)


def double(x: Tensor) -> Tensor:
    """Double the three sides of a volume by trilinear interpolation, circular in θ."""
    return interpolate(wrap(x), scale_factor=2, mode="trilinear", align_corners=False)[:, :, 2:-2]


class VolumeNet(StoredNetwork):
    """Features, correlation and a 3-D U-net; see the head of the module. 518,305 parameters.

    As a matching cost it gives the whole volume at once: `cost_volume` calls `whole_volume`.

    Attributes
    ----------
    precision : "auto" | "float32" | "bfloat16"
        Of the matrix products in `whole_volume`; see `uses_bfloat16`.
    """

    precision: Precision = "auto"

    def __init__(self) -> None:
        super().__init__()
        self.features = FeatureNet()
        self.stem = nn.Sequential(Conv3d(GROUPS + 1, WIDTHS[0]), Conv3d(WIDTHS[0], WIDTHS[0]))
        steps = list(zip(WIDTHS, WIDTHS[1:], strict=False))
        self.down = nn.ModuleList(nn.Sequential(Conv3d(a, b, stride=2), Conv3d(b, b)) for a, b in steps)
        self.up = nn.ModuleList(nn.ModuleList([nn.Conv3d(b, a, 1), Conv3d(a, a)]) for a, b in steps)
        self.head = nn.Conv3d(WIDTHS[0], 1, 3, padding=(0, 1, 1))
        self._prepared: WeakKeyDictionary[SphereSweep, tuple[list[Tensor], list[Tensor]]] = WeakKeyDictionary()

    @classmethod
    def pretrained(cls) -> Self:
        """Return the bundled network, in evaluation mode."""
        return cls.from_file(BUNDLED_WEIGHTS / "volumenet.safetensors")

    def fuse_batch_norm(self) -> VolumeNet:
        """Return the network itself: its batch norms stay."""
        return self

    @property
    def config(self) -> dict[str, Any]:
        """The arguments that build this architecture: none."""
        return {}

    def correlation(self, images: Sequence[Tensor], visible: Sequence[Tensor], coordinates: Sequence[Tensor]) -> Tensor:
        """Return the correlation volume (9, W / 2, H / 2, N / 2) of one frame; see `FeatureNet` and `correlate`."""
        features = [self.features(image, mask) for image, mask in zip(images, visible, strict=True)]
        return correlate(features, coordinates)

    def forward(self, volume: Tensor) -> Tensor:
        """Run the U-net on correlation volumes (B, 9, W, H, N), sizes in multiples of 8: logits (B, W, H, N)."""
        levels = [self.stem(volume)]
        for down in self.down:
            levels.append(down(levels[-1]))
        x = levels.pop()
        for project, merge in reversed(self.up):
            x = merge(double(project(x)) + levels.pop())
        return self.head(wrap(x)).float()[:, 0]

    @torch.no_grad()
    def whole_volume(
        self, sweep: SphereSweep, images: Sequence[ArrayLike], progress: Callable[[Iterable], Iterable] = iter
    ) -> Tensor:
        """Return 1 - probability of every sphere, shape (H, W, N); NaN for rays that no two cameras share.

        Images and `progress` as in `cost_volume`; raises an `OmnistereoError` if there is not enough memory.
        """
        grid, device = sweep.grid, sweep.device
        require_memory(_BYTES * math.prod(half_size(grid)) + 4 * math.prod(grid.shape) * grid.num_spheres, grid, device)
        self.to(device)
        rig, images = reduce_images(sweep.rig, images, pixels_per_degree(grid))
        if sweep not in self._prepared:
            masks = [torch.from_numpy(visible_pixels(camera)).to(device) for camera in rig.cameras]
            self._prepared[sweep] = masks, [uv.to(device) for uv in feature_coordinates(rig, grid)]
        masks, coordinates = self._prepared[sweep]
        normalized = [normalize(torch.from_numpy(to_gray(i)).to(device), m) for i, m in zip(images, masks, strict=True)]
        with autocast(self.precision, device):
            logits = self(self.correlation(normalized, masks, coordinates)[None])
        volume = torch.empty(*grid.shape, grid.num_spheres, device=device)
        for columns in progress(torch.arange(grid.width, device=device).split(64)):
            p = resize_logits(logits, columns, grid)[0].softmax(-1)
            volume[:, columns] = (1 - p).transpose(0, 1)
        return volume


def half_size(grid: SphereGrid) -> tuple[int, int, int]:
    """Return half of a grid's width, height and number of spheres, rounded up to multiples of 8 for the U-net."""
    return tuple(8 * math.ceil(size / 16) for size in (grid.width, grid.height, grid.num_spheres))


def pixels_per_degree(grid: SphereGrid) -> float:
    """Return the resolution of the images that suits a panorama: twice its own, so that of features is the same."""
    return 2 * grid.width / 360


def normalize(image: Tensor, visible: Tensor) -> Tensor:
    """Give an image (h, w) zero mean and unit variance over the visible pixels, and 0 elsewhere."""
    values = image[visible]
    return torch.where(visible, (image - values.mean()) / values.std().clamp(min=1e-6), 0.0)


def feature_coordinates(rig: Rig, grid: SphereGrid) -> list[Tensor]:
    """Return where the cells of the half-size volume land on the feature maps of every camera (Eq. 1).

    Parameters
    ----------
    rig : Rig
        With its origin at the sweep centre.
    grid : SphereGrid
        The panorama; its half size is rounded up to multiples of 8.

    Returns
    -------
    list of float32 tensors, shape (W / 2, H / 2, N / 2, 2)
        Feature pixels, NaN where the cell is not visible to the camera.
    """
    width, height, spheres = half_size(grid)
    rays = torch.from_numpy(replace(grid, width=width, height=height).rays()).float().transpose(0, 1)
    index = (np.arange(spheres) + 0.5) * grid.num_spheres / spheres - 0.5
    inverse_depth = torch.from_numpy(grid.index_to_inverse_depth(index)).float()[:, None]
    coordinates = []
    for camera, pose in zip(rig.cameras, rig.T_rig_cam, strict=True):
        T_cam_rig = pose.inverse()
        R, t = (torch.from_numpy(a).float() for a in (T_cam_rig.R, T_cam_rig.t))
        uv, visible = camera.project((rays @ R.T)[:, :, None] + inverse_depth * t)
        coordinates.append(torch.where(visible[..., None], uv / 2, torch.nan))  # maps have every second pixel
    return coordinates


def resize_logits(logits: Tensor, columns: Tensor, grid: SphereGrid) -> Tensor:
    """Return columns of the full-size logits: (B, w, h, n) → (B, columns, H, N), interpolated, circular in θ."""
    w = logits.shape[1]
    position = (columns + 0.5) * (w / grid.width) - 0.5
    left = position.floor().long()
    weight = (position - left)[:, None, None]
    across = logits[:, left % w] * (1 - weight) + logits[:, (left + 1) % w] * weight
    return interpolate(across, (grid.height, grid.num_spheres), mode="bilinear", align_corners=False)


def local_mean(volume: Tensor) -> tuple[Tensor, Tensor]:
    """Return sphere index and confidence of costs 1 - probability (H, W, N): two float32 tensors (H, W).

    The index is the mean sphere under the probabilities of the best sphere and its two neighbours on either side, a
    local soft-argmax: the mean over all spheres would lie between two surfaces at a depth discontinuity. The confidence
    is the probability that these five have together, in [0, 1]. NaN where the cost is NaN.
    """
    best = volume.argmin(-1, keepdim=True)
    near = best + torch.arange(-_RADIUS, _RADIUS + 1, device=volume.device)
    inside = (near >= 0) & (near < volume.shape[-1])
    mass = (1 - volume.gather(-1, near.clamp(0, volume.shape[-1] - 1))) * inside
    total = mass.sum(-1)
    return (mass * near).sum(-1) / total, total
