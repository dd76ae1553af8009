"""From a cost volume to depth, confidence, panorama and point cloud (paper, Section III-B)."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from omnistereo_lib import reference
from omnistereo_lib.arrays import as_array
from omnistereo_lib.frame import Frame
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.lazy import lazy_property
from omnistereo_lib.stereo.kernels import winner_numba
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_lib.stereo.threads import map_rows
from omnistereo_lib.stereo.volume import as_volume
from omnistereo_lib.stereo.zncc import ZNCC


def winner_takes_all(volume: ArrayLike | Tensor, subindex: bool = False) -> Tensor:
    """Return the index of the best sphere, n* = argmin_n C(p, n) (paper, Section III-B).

    Args:
        volume (float tensor or array, shape (H, W, N)): Costs, N ≥ 2; NaN cells are never the best.
            Another shape raises an `OmnistereoError`.
        subindex: Refine n* to the vertex of the parabola through its cost and the costs of its two
            neighbours, by at most half a sphere. The spheres are evenly spaced in inverse depth, in
            which the index is linear. An index at either end, or next to a NaN, stays.

    Returns:
        float32 tensor, shape (H, W): Sphere index; NaN where every cell is NaN.

    >>> osl.winner_takes_all(np.array([[[0.5, 0.2, 0.1, 0.4]]]))
    tensor([[2.]])
    >>> osl.winner_takes_all(np.array([[[0.5, 0.2, 0.1, 0.4]]]), subindex=True)
    tensor([[1.7500]])
    """
    return index_and_confidence(volume, subindex)[0]


def confidence(volume: ArrayLike | Tensor) -> Tensor:
    """Return 1 - C(n*)/C(n₂), where n₂ is the best sphere that is not n* or next to it.

    This is the peak ratio (PKRN; Hu & Mordohai 2012), mapped to [0, 1]. Its value depends on the
    scale of the volume; its order hardly does.

    Args:
        volume: As for `winner_takes_all`; costs of at least 0, raw or aggregated.

    Returns:
        float32 tensor, shape (H, W), in [0, 1]: NaN where every cell is; 1 without an n₂.

    >>> osl.confidence(np.array([[[0.4, 0.2, 0.1, 0.2, 0.4]]]))  # n* = 2, n₂ = 0
    tensor([[0.7500]])
    """
    return index_and_confidence(volume)[1]


def index_and_confidence(
    volume: ArrayLike | Tensor, subindex: bool = False
) -> tuple[Tensor, Tensor]:
    """Return what `winner_takes_all` and `confidence` do, in one pass, some rows at a time."""

    def read_out(rows: Tensor) -> Tensor:  # (h, W, N) → (2, h, W)
        if rows.device.type == "cpu":
            return winner_numba.winner_and_confidence(rows.float(), subindex)
        return torch.stack(
            [reference.winner(rows.float(), subindex), reference.confidence(rows.float())]
        )

    index, ratio = map_rows(read_out, as_volume(volume))  # (H, W) each
    return index, ratio


def _unknown() -> NDArray[np.float32]:
    return np.array(np.nan, np.float32)


@dataclass(frozen=True, eq=False)
class Depth:
    """A depth panorama around the sweep centre.

    >>> frame = osl.load_dataset("data_samples/sunny", split="test")[0]
    >>> grid = osl.SphereGrid(64, 16, num_spheres=16, min_depth=1.65)
    >>> depth = osl.estimate_depth(frame, grid, "zncc+sgm")
    >>> depth.index.shape, bool(depth.valid.all()), float(depth.depth.min()) >= 1.65
    ((16, 64), True, True)
    """

    #: Sphere index n*, (H, W), fractional with sub-sphere refinement; NaN where no pair of cameras
    #: sees the ray.
    index: NDArray[np.float32]
    confidence: NDArray[np.float32]  #: (H, W), in [0, 1]
    sweep: SphereSweep  #: of the cost volume, with its grid and its rig
    #: from which the depth was estimated: a frame, or one image per camera; empty: unknown
    frame: Frame | Sequence[ArrayLike] = ()
    #: Of the inverse depth, 1/m, (H, W): two thirds of the rays (68 %) are off by at most σ,
    #: nineteen of twenty (95 %) by at most the bound. NaN without an estimate, and for a method
    #: whose errors were not measured; see `error_bars`.
    sigma: NDArray[np.float32] = field(default_factory=_unknown)
    bound: NDArray[np.float32] = field(default_factory=_unknown)
    #: Inverse depth of another surface with a tenth of the evidence, 1/m, (H, W); NaN: none.
    second: NDArray[np.float32] = field(default_factory=_unknown)

    def __post_init__(self) -> None:
        for name in ("index", "confidence", "sigma", "bound", "second"):
            given = as_array(getattr(self, name), name, None)
            values = np.broadcast_to(given, np.shape(self.index)).view()
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        if isinstance(self.frame, Frame) or len(self.frame) > 0:
            object.__setattr__(self, "frame", Frame.of(self.sweep.rig, self.frame))

    @property
    def images(self) -> Sequence[NDArray[Any]]:
        """The images of the frame, one array per camera."""
        return self.frame.images if isinstance(self.frame, Frame) else ()

    @lazy_property
    def samples(self) -> NDArray[np.float32]:
        """The images at the estimated depth, (cameras, H, W) or (cameras, H, W, 3), NaN unseen."""
        return np.stack(self.sweep.warp(self.frame, self.index))

    @property
    def grid(self) -> SphereGrid:
        """Grid of rays and spheres."""
        return self.sweep.grid

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Whether the ray has an estimate; bool, shape (H, W)."""
        return np.isfinite(self.index)

    @property
    def inverse_depth(self) -> NDArray[np.float64]:
        """Inverse depth along the ray in 1/m, shape (H, W); 0 at infinity, NaN unknown."""
        return self.grid.index_to_inverse_depth(self.index)

    @property
    def depth(self) -> NDArray[np.float64]:
        """Depth along the ray in metres, shape (H, W); may be infinite, NaN unknown."""
        return self.grid.index_to_depth(self.index)

    def panorama(self) -> NDArray[np.float32]:
        """Return the reference panorama: the images at the estimated depth (paper, Fig. 1, 9).

        Returns:
            float32 array, shape (H, W) or (H, W, 3), in the range of the images: Mean over the
                cameras to which the point is visible; NaN where there is none, or no depth. A wrong
                depth shows as a double contour.
        """
        # Each ray looks into every camera that sees its point, and takes the mean.
        visible = np.isfinite(self.samples)
        with np.errstate(invalid="ignore"):
            return np.where(visible, self.samples, 0).sum(0) / visible.sum(0, dtype=np.float32)

    def agreement(self) -> NDArray[np.float32]:
        """Return the photo-consistency of two cameras at the estimated depth: without ground truth.

        For each ray, the two cameras whose optical axes are nearest to the point are sampled at the
        estimated depth and correlated (ZNCC) over 9 × 9 rays, whatever gain and vignetting.

        Returns:
            float32 array, shape (H, W), in [-1, 1]: 1 where both show the same, 0 in windows
            without texture; NaN where fewer than two cameras see it, or without a depth.
        """
        gray = [image.cpu().numpy() for image in self.sweep.normalize_images(self.frame)]
        samples = np.stack(self.sweep.warp(gray, self.index))
        angles = np.stack(
            [self.sweep.off_axis_angles(camera, self.index) for camera in range(len(gray))]
        )
        # Of the cameras that see the point, the two whose axes are nearest to it.
        best = np.argsort(np.where(np.isnan(samples), np.inf, angles), axis=0)[:2]
        # In the order of the cameras, or a window would mix the two where the nearer one changes.
        best.sort(axis=0)
        two = torch.from_numpy(np.take_along_axis(samples, best, axis=0))
        # The cost is (1 - ZNCC) / 2, so the correlation is 1 - 2 cost.
        return 1 - 2 * ZNCC(window=9)(two[:, None], [(0, 1)])[..., 0].numpy()

    def point_cloud(
        self, max_depth: float = 50.0, min_confidence: float = 0.0
    ) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
        """Return the estimated points, and their colours in the `panorama`, for images of 0 to 255.

        Args:
            max_depth: Largest depth in metres; beyond it, one sphere index is many metres.
            min_confidence: Smallest confidence.

        Returns:
            points: shape (M, 3), metres, rig frame at the sweep centre
            colors: uint8, shape (M, 3), RGB
        """
        depth = self.depth
        keep = self.valid & (depth <= max_depth) & (self.confidence >= min_confidence)
        colors = self.panorama()
        colors = np.repeat(colors[..., None], 3, -1) if colors.ndim == 2 else colors
        keep &= np.isfinite(colors[..., 0])
        return self.grid.rays()[keep] * depth[keep, None], np.clip(
            colors[keep].round(), 0, 255
        ).astype(np.uint8)
