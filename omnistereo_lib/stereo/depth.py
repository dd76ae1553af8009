"""From a cost volume to depth: winner takes all, sub-index, confidence, panorama, agreement, point cloud."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_lib.stereo.zncc import ZNCC


def winner_takes_all(volume: ArrayLike | Tensor, subindex: bool = False) -> Tensor:
    """Return n* = argmin_n C(p, n) (paper, Section III-B).

    Parameters
    ----------
    volume : float tensor or array, shape (H, W, N)
        Costs; NaN cells do not compete.
    subindex : bool
        Move each winner to the vertex of the parabola through its cost and its two neighbours', by at
        most half a sphere. The index is linear in inverse depth, so the parabola is fitted where the
        spheres are evenly spaced. Winners at the ends, or beside a NaN, stay.

    Returns
    -------
    float32 tensor, shape (H, W)
        Sphere index; NaN where every cell is NaN.
    """
    volume = _as_volume(volume)
    filled = torch.where(volume.isnan(), torch.inf, volume)
    cost, winner = filled.min(-1)
    index = winner.float()
    if subindex:
        last = volume.shape[-1] - 1
        left = volume.gather(-1, (winner - 1).clamp(0)[..., None])[..., 0]
        right = volume.gather(-1, (winner + 1).clamp(max=last)[..., None])[..., 0]
        bend = left - 2 * cost + right
        inner = (winner > 0) & (winner < last) & (bend > 0)  # False beside a NaN
        index = torch.where(inner, index + (left - right) / (2 * bend), index)
    return torch.where(cost.isinf(), torch.nan, index)


def confidence(volume: ArrayLike | Tensor) -> Tensor:
    """Return how clearly the winner wins: 1 - C(n*)/C(n₂), n₂ the best sphere not next to the winner.

    This is the naive peak ratio (PKRN; Hu & Mordohai 2012) brought to [0, 1]. Its value depends on the scale
    of the volume; its order, which sparsification evaluates, hardly does.

    Parameters
    ----------
    volume : float tensor or array, shape (H, W, N)
        Costs of at least 0, raw or aggregated; NaN cells do not compete.

    Returns
    -------
    float32 tensor, shape (H, W), in [0, 1]
        NaN where every cell is NaN; 1 where nothing competes with the winner.
    """
    volume = _as_volume(volume)
    filled = torch.where(volume.isnan(), torch.inf, volume)
    first, winner = filled.min(-1)
    beside = torch.stack([winner - 1, winner, winner + 1], -1).clamp(0, volume.shape[-1] - 1)
    second = filled.scatter_(-1, beside, torch.inf).amin(-1)
    ratio = torch.where(second > 0, 1 - first / second, 0.0)
    return torch.where(first.isinf(), torch.nan, ratio)


@dataclass(frozen=True, eq=False)
class Depth:
    """A depth panorama around the sweep centre.

    Attributes
    ----------
    index : float32 array, shape (H, W)
        Sphere index n*, fractional with sub-index; NaN where no pair of cameras sees the ray.
    confidence : float32 array, shape (H, W), in [0, 1]
    sweep : SphereSweep
        The sweep that it came from, with its grid and its rig.
    """

    index: NDArray[np.float32]
    confidence: NDArray[np.float32]
    sweep: SphereSweep

    @classmethod
    def from_volume(cls, volume: ArrayLike | Tensor, sweep: SphereSweep, subindex: bool = True) -> Depth:
        """Read depth off a cost volume (H, W, N) of this sweep, raw or aggregated."""
        index = winner_takes_all(volume, subindex).cpu().numpy()
        return cls(index, confidence(volume).cpu().numpy(), sweep)

    @property
    def grid(self) -> SphereGrid:
        """The grid of rays and spheres."""
        return self.sweep.grid

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Where there is an estimate; bool, shape (H, W)."""
        return np.isfinite(self.index)

    @property
    def inverse_depth(self) -> NDArray[np.float64]:
        """Inverse depth along the ray in 1/m, shape (H, W); 0 is infinitely far, NaN unknown."""
        return self.grid.index_to_inverse_depth(self.index)

    @property
    def depth(self) -> NDArray[np.float64]:
        """Depth along the ray in metres, shape (H, W); infinite or NaN as `inverse_depth` says."""
        return self.grid.index_to_depth(self.index)

    def panorama(self, images: Sequence[ArrayLike]) -> NDArray[np.float32]:
        """Look the images up at the estimated depth: the paper's reference panorama (Fig. 1, 9).

        Parameters
        ----------
        images : one array per camera, (height, width) or (height, width, 3)

        Returns
        -------
        float32 array, shape (H, W) or (H, W, 3), in the images' range
            The mean over the cameras that see the point; NaN where none does or there is no depth. A
            wrong depth shows as a double contour.
        """
        samples = np.stack(self.sweep.warp(images, self.index))
        seen = np.isfinite(samples)
        with np.errstate(invalid="ignore"):
            return np.where(seen, samples, 0).sum(0) / seen.sum(0)

    def agreement(self, images: Sequence[ArrayLike]) -> NDArray[np.float32]:
        """Compare what the two best-placed cameras see of each estimated point: a test that needs no truth.

        Best placed are those that see the point nearest to their axes. What they see is looked up at the estimated
        depth and correlated over windows of 9 × 9 rays, so that gain and vignetting matter little.

        Parameters
        ----------
        images : one array per camera, (height, width) or (height, width, 3)

        Returns
        -------
        float32 array, shape (H, W), in [-1, 1]
            1 where they see the same, 0 in windows without texture; NaN where fewer than two cameras see the point
            or there is no depth.
        """
        gray = [image.cpu().numpy() for image in self.sweep.prepare(images)]
        samples = np.stack(self.sweep.warp(gray, self.index))
        angles = np.stack([self.sweep.off_axis(camera, self.index) for camera in range(len(gray))])
        best = np.argsort(np.where(np.isnan(samples), np.inf, angles), axis=0)[:2]
        best.sort(axis=0)  # in one order, or a window would mix the two where the better one changes
        two = torch.from_numpy(np.take_along_axis(samples, best, axis=0))
        return 1 - 2 * ZNCC()(two[:, None], [(0, 1)])[..., 0].numpy()

    def point_cloud(
        self, images: Sequence[ArrayLike] | None = None, max_depth: float = 50.0, min_confidence: float = 0.0
    ) -> tuple[NDArray[np.float64], NDArray[np.uint8] | None]:
        """Return the estimated points and their colours.

        Parameters
        ----------
        images : one array per camera, optional
            Where the colours come from, values 0 … 255 (as `panorama` averages them).
        max_depth : float
            Points further away, in metres, are left out: one index there is many metres.
        min_confidence : float
            Points below it are left out.

        Returns
        -------
        points : shape (M, 3), metres, rig frame at the sweep centre
        colors : uint8, shape (M, 3), RGB, or None without images
        """
        depth = self.depth
        keep = self.valid & (depth <= max_depth) & (self.confidence >= min_confidence)
        if images is None:
            return self.grid.rays()[keep] * depth[keep, None], None
        colors = self.panorama(images)
        colors = np.repeat(colors[..., None], 3, -1) if colors.ndim == 2 else colors
        keep &= np.isfinite(colors[..., 0])
        return self.grid.rays()[keep] * depth[keep, None], np.clip(colors[keep].round(), 0, 255).astype(np.uint8)


def colorize_depth(inverse_depth: ArrayLike, grid: SphereGrid) -> NDArray[np.uint8]:
    """Colour a panorama of inverse depth: near is bright and warm, far is dark, unknown is striped grey.

    Parameters
    ----------
    inverse_depth : array, shape (H, W), 1/m, NaN unknown
    grid : SphereGrid
        Its nearest sphere is the brightest colour.

    Returns
    -------
    uint8 array, shape (H, W, 3), RGB
    """
    inverse_depth = np.asarray(inverse_depth)
    level = np.clip(256 * np.nan_to_num(inverse_depth) * grid.min_depth, 0, 255).astype(np.uint8)
    # Inferno is even in lightness, so it reads in grey print and to colour-blind eyes.
    colors = cv2.cvtColor(cv2.applyColorMap(level, cv2.COLORMAP_INFERNO), cv2.COLOR_BGR2RGB)
    rows, columns = np.indices(inverse_depth.shape)
    stripes = np.where((rows + columns) // 4 % 2, 170, 200)[..., None]
    return np.where(np.isfinite(inverse_depth)[..., None], colors, stripes).astype(np.uint8)


def _as_volume(volume: ArrayLike | Tensor) -> Tensor:
    volume = torch.as_tensor(volume)
    if volume.ndim != 3 or volume.shape[-1] < 2:
        raise OmnistereoError(f"a cost volume has shape (H, W, N) with N ≥ 2, got {tuple(volume.shape)}")
    return volume.float()
