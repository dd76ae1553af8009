"""Rays of the panorama and the concentric spheres of the sweep (paper, Section III-B)."""

from dataclasses import dataclass
from numbers import Real
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.arrays import as_array
from omnistereo_lib.errors import OmnistereoError, check_number

Sampling = Literal["center", "sweepnet", "omnimvs"]
_NEAREST = (1e-6, 1e9)  # m
_MAX_SIDE = 1_000_000


class _Sampling(NamedTuple):
    column_offset: float
    row_offset: float
    extra_rows: int  # φ is divided into height + extra_rows steps


# The published codes differ by half a pixel, which is half a degree at W = 320.
_SAMPLINGS = {
    "center": _Sampling(0.5, 0.5, 0),
    "sweepnet": _Sampling(1, 1, 0),
    "omnimvs": _Sampling(0, 0, -1),
}


@dataclass(frozen=True)
class SphereGrid:
    """Directions θ, φ of a panorama and inverse depths d_n of N spheres (paper, Section III-B).

    A ray is ρ(θ, φ) = (cosφ sinθ, sinφ, cosφ cosθ): the centre of the panorama looks along +z,
    right is +x, down is +y. The paper's (cosφ cosθ, sinφ, cosφ sinθ) is turned by 90° and mirrored.

    Raises:
        OmnistereoError: If a size is not an integer, or one, an angle or a depth is out of range.

    >>> grid = osl.SphereGrid(640, 160, num_spheres=192, min_depth=0.55)
    >>> grid.index_to_depth([0, 1, 191]).round(2)
    array([   inf, 105.05,   0.55])
    >>> grid.rays().shape
    (160, 640, 3)
    >>> pixel, valid = grid.project([0, 0, 1])  # straight ahead
    >>> pixel.tolist(), bool(valid)
    ([319.5, 79.5], True)
    """

    width: int  #: panorama size W in pixels; θ spans the full circle over the columns
    height: int  #: panorama size H in pixels
    #: first and last elevation φ in degrees, down positive, within ±90
    phi_deg: tuple[float, float] = (-45.0, 45.0)
    num_spheres: int = 192  #: N, at least 2
    min_depth: float = 0.55  #: D_min in metres: the radius of sphere N - 1
    max_depth: float = np.inf  #: radius of sphere 0 in metres; the paper's is infinite
    #: Ray of a pixel. "center": the ray through the pixel centre. "sweepnet", as the released
    #: MATLAB code and its ground truth: θ = (column + 1 - W/2) 2π/W, φ likewise. "omnimvs", as
    #: that code: θ = (column - W/2) 2π/W, φ from the first to the last elevation, both included.
    sampling: Sampling = "center"

    def __post_init__(self) -> None:
        for name in ("width", "height", "num_spheres"):
            number = check_number(getattr(self, name), name, 2, _MAX_SIDE, whole=True)
            object.__setattr__(self, name, number)
        # A list would make the grid unhashable.
        phi = tuple(np.atleast_1d(self.phi_deg).tolist())
        are_two = len(phi) == 2 and all(isinstance(angle, Real) for angle in phi)
        if not (are_two and -90 <= phi[0] < phi[1] <= 90):
            expected = "two angles, -90 ≤ first < last ≤ 90 (down > 0)"
            raise OmnistereoError(f"phi_deg is {self.phi_deg}; expected {expected}")
        object.__setattr__(self, "phi_deg", phi)
        near, far = self.min_depth, self.max_depth
        are_real = isinstance(near, Real) and isinstance(far, Real)
        if not (are_real and 0 < near < far and _NEAREST[0] <= near <= _NEAREST[1]):
            raise OmnistereoError(
                f"min_depth is {near} and max_depth {far}; expected metres with 0 < min_depth <"
                f" max_depth, at most {_NEAREST[1]:g}. Pass the nearest depth, such as"
                " min_depth=rig.min_depth where the rig file has one."
            )
        if self.sampling not in _SAMPLINGS:
            raise OmnistereoError(
                f"sampling is {self.sampling!r}; expected one of {', '.join(_SAMPLINGS)}"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """Panorama shape (H, W)."""
        return self.height, self.width

    def thetas(self) -> NDArray[np.float64]:
        """Return θ of every column, shape (W,), radians, in [-π, π]."""
        offset = _SAMPLINGS[self.sampling].column_offset
        columns = np.arange(self.width, dtype=np.float64) + offset
        return (columns - self.width / 2) * (2 * np.pi / self.width)

    def phis(self) -> NDArray[np.float64]:
        """Return φ of every row, shape (H,), radians, down positive."""
        _, offset, extra_rows = _SAMPLINGS[self.sampling]
        low, high = np.radians(self.phi_deg)
        return low + (np.arange(self.height) + offset) * (high - low) / (self.height + extra_rows)

    def rays(self) -> NDArray[np.float64]:
        """Return ρ(p) of every pixel, (H, W, 3), unit vectors (paper, Section III-B)."""
        theta, phi = self.thetas(), self.phis()[:, None]
        x, y, z = np.cos(phi) * np.sin(theta), np.sin(phi), np.cos(phi) * np.cos(theta)
        return np.stack(np.broadcast_arrays(x, y, z), -1)

    def project(self, points: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Project points to panorama pixels: the inverse of `rays`.

        Args:
            points (array, shape (..., 3)): Points in the rig frame with its origin at the sweep
                centre; only their direction matters.

        Returns:
            pixels (shape (..., 2)): (column, row); the column is in [-0.5, W - 0.5).
            valid (bool, shape (...)): The row is in [-0.5, H - 0.5].

        Raises:
            OmnistereoError: If points has another shape, or holds something else than numbers.
        """
        points = as_array(points, "points")
        if points.shape[-1:] != (3,):
            raise OmnistereoError(f"points has shape {points.shape}; expected (..., 3)")
        theta = np.arctan2(points[..., 0], points[..., 2])
        phi = np.arctan2(points[..., 1], np.hypot(points[..., 0], points[..., 2]))
        column_offset, row_offset, extra_rows = _SAMPLINGS[self.sampling]
        low, high = np.radians(self.phi_deg)
        # The inverses of `thetas` and `phis`, the columns then moved into [-0.5, W - 0.5).
        column = theta * self.width / (2 * np.pi) + self.width / 2 - column_offset
        column = (column + 0.5) % self.width - 0.5
        row = (phi - low) * (self.height + extra_rows) / (high - low) - row_offset
        return np.stack([column, row], -1), (row >= -0.5) & (row <= self.height - 0.5)

    def look_up(
        self, panorama: NDArray[Any], points: ArrayLike
    ) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Return the pixels of a panorama (H, W, …) nearest to points (..., 3), and `valid`.

        Beyond the first and the last row, where `valid` is False, they are those of that row.
        """
        pixels, valid = self.project(points)
        column, row = np.moveaxis(np.rint(pixels).astype(int), -1, 0)
        return panorama[row.clip(0, self.height - 1), column % self.width], valid

    @property
    def _inverse_range(self) -> tuple[float, float]:
        return 1.0 / self.max_depth, 1.0 / self.min_depth

    @property
    def step(self) -> float:
        """Difference of the inverse depths of two neighbouring spheres, 1/m."""
        low, high = self._inverse_range
        return (high - low) / (self.num_spheres - 1)

    def inverse_depths(self) -> NDArray[np.float64]:
        """Return d_n = n / (D_min (N - 1)), shape (N,), 1/m (paper, Section III-B).

        With a finite max_depth, evenly spaced from 1/max_depth to 1/min_depth.
        """
        return np.linspace(*self._inverse_range, self.num_spheres)

    def index_to_inverse_depth(self, index: ArrayLike) -> NDArray[np.float64]:
        """Return the inverse depth in 1/m of a sphere index, integer or fractional; same shape."""
        low, high = self._inverse_range
        return low + as_array(index, "index") * (high - low) / (self.num_spheres - 1)

    def inverse_depth_to_index(self, inverse_depth: ArrayLike) -> NDArray[np.float64]:
        """Return the fractional index n̂ of an inverse depth in 1/m; any, beyond the spheres."""
        low, high = self._inverse_range
        inverse_depth = as_array(inverse_depth, "inverse_depth")
        return (inverse_depth - low) * (self.num_spheres - 1) / (high - low)

    def index_to_depth(self, index: ArrayLike) -> NDArray[np.float64]:
        """Return the depth in metres of a sphere index; may be infinite."""
        with np.errstate(divide="ignore", over="ignore"):
            return 1.0 / self.index_to_inverse_depth(index)

    def depth_to_index(self, depth: ArrayLike) -> NDArray[np.float64]:
        """Return the fractional index n̂ of a depth in metres, which may be infinite."""
        with np.errstate(divide="ignore"):
            return self.inverse_depth_to_index(1.0 / as_array(depth, "depth"))
