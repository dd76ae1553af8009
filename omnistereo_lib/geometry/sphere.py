"""The panorama's rays and the concentric spheres that are swept (paper, Section III-B)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.errors import OmnistereoError

# Where a pixel's ray stands within the range of angles: (column offset, row offset, rows to divide by
# instead of the height). The published codes differ by half a pixel, which is half a degree at W = 320.
_SAMPLINGS = {"center": (0.5, 0.5, 0), "sweepnet": (1.0, 1.0, 0), "omnimvs": (0.0, 0.0, -1)}


@dataclass(frozen=True)
class SphereGrid:
    """Directions θ, φ of a panorama and inverse depths d_n of N spheres.

    A ray is ρ(θ, φ) = (cosφ sinθ, sinφ, cosφ cosθ): the centre of the panorama looks along +z, right is
    +x, down is +y. The paper prints (cosφ cosθ, sinφ, cosφ sinθ), which is this turned by 90° and mirrored.

    Parameters
    ----------
    width, height : int
        Panorama size W × H in pixels; θ spans the full circle over the columns.
    phi_deg : (float, float)
        First and last elevation φ in degrees, down is positive, within ±90.
    num_spheres : int
        N, at least 2.
    min_depth : float
        D_min in metres: the radius of sphere N - 1.
    max_depth : float
        Radius of sphere 0 in metres; the paper's is infinite.
    sampling : "center" | "sweepnet" | "omnimvs"
        Which ray a pixel stands for: its centre, or the rule of a released code (`released` docstring).

    Raises
    ------
    OmnistereoError
        If a size, an angle or a depth is out of its range.
    """

    width: int
    height: int
    phi_deg: tuple[float, float] = (-45.0, 45.0)
    num_spheres: int = 192
    min_depth: float = 0.55
    max_depth: float = np.inf
    sampling: Literal["center", "sweepnet", "omnimvs"] = "center"

    def __post_init__(self) -> None:
        if self.width < 2 or self.height < 2:
            raise OmnistereoError(f"a panorama needs at least 2 × 2 pixels, got {self.width} × {self.height}")
        if self.num_spheres < 2:
            raise OmnistereoError(f"a sweep needs at least 2 spheres, got num_spheres = {self.num_spheres}")
        low, high = self.phi_deg
        if not -90 <= low < high <= 90:
            raise OmnistereoError(f"phi_deg must rise within -90 … 90 (down is positive), got {self.phi_deg}")
        if not 0 < self.min_depth < self.max_depth or not np.isfinite(self.min_depth):
            raise OmnistereoError(
                f"depths must satisfy 0 < min_depth < max_depth, got {self.min_depth} m and {self.max_depth} m"
            )
        if self.sampling not in _SAMPLINGS:
            raise OmnistereoError(f"sampling must be one of {sorted(_SAMPLINGS)}, got {self.sampling!r}")

    @classmethod
    def released(cls, code: Literal["sweepnet", "omnimvs"], *args: object, **kwargs: object) -> SphereGrid:
        """Return a grid with the half-pixel rule of a released code and its ground truth.

        "sweepnet" (MATLAB): θ = (column + 1 - W/2) 2π/W, φ likewise. "omnimvs": θ = (column - W/2) 2π/W and φ
        from end to end, both ends included. The remaining arguments are the class's.
        """
        return cls(*args, sampling=code, **kwargs)

    @property
    def shape(self) -> tuple[int, int]:
        """Panorama shape (H, W)."""
        return self.height, self.width

    def thetas(self) -> NDArray[np.float64]:
        """Return θ of every column, shape (W,), radians, in [-π, π]."""
        offset = _SAMPLINGS[self.sampling][0]
        return (np.arange(self.width) + offset - self.width / 2) * (2 * np.pi / self.width)

    def phis(self) -> NDArray[np.float64]:
        """Return φ of every row, shape (H,), radians, down positive."""
        _, offset, fewer = _SAMPLINGS[self.sampling]
        low, high = np.radians(self.phi_deg)
        return low + (np.arange(self.height) + offset) * (high - low) / (self.height + fewer)

    def rays(self) -> NDArray[np.float64]:
        """Return ρ(p) for every pixel, shape (H, W, 3), unit vectors in the rig frame."""
        theta, phi = np.meshgrid(self.thetas(), self.phis())
        return np.stack([np.cos(phi) * np.sin(theta), np.sin(phi), np.cos(phi) * np.cos(theta)], -1)

    def pixel(self, points: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return where directions fall in the panorama: the inverse of `rays`.

        Parameters
        ----------
        points : array, shape (..., 3)
            Directions or points seen from the sweep centre, rig frame.

        Returns
        -------
        pixels : shape (..., 2)
            (column, row); the column is in [-0.5, W - 0.5).
        valid : bool, shape (...)
            The row lies within half a pixel of the panorama.
        """
        points = np.asarray(points, np.float64)
        theta = np.arctan2(points[..., 0], points[..., 2])
        phi = np.arctan2(points[..., 1], np.hypot(points[..., 0], points[..., 2]))
        offset, row_offset, fewer = _SAMPLINGS[self.sampling]
        low, high = np.radians(self.phi_deg)
        column = theta * self.width / (2 * np.pi) + self.width / 2 - offset
        column = (column + 0.5) % self.width - 0.5
        row = (phi - low) * (self.height + fewer) / (high - low) - row_offset
        return np.stack([column, row], -1), (row >= -0.5) & (row <= self.height - 0.5)

    @property
    def _inverse_range(self) -> tuple[float, float]:
        return 1.0 / self.max_depth, 1.0 / self.min_depth

    def inverse_depths(self) -> NDArray[np.float64]:
        """Return d_n = n / (D_min (N - 1)), shape (N,), 1/m; with a max_depth, evenly from 1/max_depth."""
        return np.linspace(*self._inverse_range, self.num_spheres)

    def index_to_inverse_depth(self, index: ArrayLike) -> NDArray[np.float64]:
        """Return the inverse depth in 1/m of a sphere index, which may be fractional; same shape."""
        low, high = self._inverse_range
        return low + np.asarray(index, np.float64) * (high - low) / (self.num_spheres - 1)

    def inverse_depth_to_index(self, inverse_depth: ArrayLike) -> NDArray[np.float64]:
        """Return n̂, not rounded, of an inverse depth in 1/m; outside [0, N - 1] beyond the range swept."""
        low, high = self._inverse_range
        return (np.asarray(inverse_depth, np.float64) - low) * (self.num_spheres - 1) / (high - low)

    def index_to_depth(self, index: ArrayLike) -> NDArray[np.float64]:
        """Return the depth in metres along the ray of a sphere index; infinite at index 0 of the paper's range."""
        with np.errstate(divide="ignore", over="ignore"):
            return 1.0 / self.index_to_inverse_depth(index)

    def depth_to_index(self, depth: ArrayLike) -> NDArray[np.float64]:
        """Return n̂, not rounded, of a depth in metres (infinity allowed)."""
        with np.errstate(divide="ignore"):
            return self.inverse_depth_to_index(1.0 / np.asarray(depth, np.float64))
