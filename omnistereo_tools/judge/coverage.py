"""Coverage of a rig: cameras and baseline in every direction, depth resolution."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.geometry.sphere import SphereGrid

_COVERED = 0.95  # of the rays of a row, or of those that see far away, have depth: the rest is rims
_COARSE = SphereGrid(60, 30, (-90, 90), 2, 1.0)
# Cosine of 30°, the widest angle between two views of a patch that is matched (Moreels and Perona
# 2007: 25° to 30°). In a world of boxes VolumeNet was right on 80 % of the rays up to 25° and on 45
# % beyond 30°; ZNCC lasts until 50°.
_COS_WIDEST = np.cos(np.radians(30))
_TOGETHER = 1e-9  # metres; a rig in millimetres that is read as metres is merely small
_FEW = 0.1  # of the directions: the public rigs state nearest depths within 10 % of this
_STEP, _STEPS = 1.05, 100  # depths, from 130 times as far as the outermost camera inwards
_SECTORS = {"ahead": 0, "right": 90, "behind": 180, "left": -90}  # degrees of azimuth
_SPHERES = (32, 256)
_ANY_ROWS = (-45.0, 45.0)  # degrees, where no row has depth all around


def turn_sentence(rig: Rig) -> str | None:
    """Return by how much a rig was turned from the frame of its file, or None if it was not."""
    degrees = 0.0 if rig.T_rig_file is None else rig.T_rig_file.magnitude()[0]
    return (
        f"The rig was turned level, by {degrees:.0f}° (`omnistereo rig --keep-frame` leaves it)."
        if degrees > 1e-6
        else None
    )


@dataclass(frozen=True)
class Coverage:
    """What the cameras of a rig see on a panorama of the whole sphere, of things far away."""

    rig: Rig  # centred on the mean of its cameras, as the sweep is
    grid: SphereGrid
    cameras: NDArray[np.int64]  # (H, W), how many see a ray
    # (H, W), metres: the widest of those cameras across the ray; NaN below two cameras
    baseline: NDArray[np.float64]
    pixels_per_degree: float  # of the coarsest camera, on its axis

    @classmethod
    def of(cls, rig: Rig, width: int = 360) -> Coverage:
        """Compute the coverage of a rig."""
        rig = rig.recentered()
        grid = SphereGrid(width, width // 2, (-90, 90), 2, 1.0)
        seen, rays = _visible(rig, grid, np.inf), grid.rays()
        baseline = np.full(grid.shape, np.nan)
        for i, j in combinations(range(len(rig)), 2):
            across = np.linalg.norm(np.cross(rays, rig.centers[j] - rig.centers[i]), axis=-1)
            baseline = np.where(seen[i] & seen[j], np.fmax(baseline, across), baseline)
        half = np.radians(0.5)
        axis = np.array([[np.sin(-half), 0, np.cos(half)], [np.sin(half), 0, np.cos(half)]])
        resolution = min(
            float(np.linalg.norm(np.diff(camera.project(axis)[0], axis=0)))
            for camera in rig.cameras
        )
        return cls(rig, grid, seen.sum(0), baseline, resolution)

    def share(self, cameras: int) -> float:
        """Return the share of all directions, by solid angle, that at least so many cameras see."""
        weights = np.cos(self.grid.phis())[:, None] * np.ones(self.grid.shape)
        return float(np.sum(weights * (self.cameras >= cameras)) / np.sum(weights))

    def depth_resolution(self, depth: float) -> NDArray[np.float64]:
        """Return by how many metres a depth in metres is off, (H, W), if a match is off by one
        pixel: d² α / b.

        α is the angle of a pixel in radians, b the baseline across the ray.
        """
        return depth**2 * np.radians(1 / self.pixels_per_degree) / self.baseline

    def rows(self) -> tuple[float, float] | None:
        """Return the elevations, degrees, between which two cameras see all around, or None."""
        full = np.mean(self.cameras >= 2, axis=1) >= _COVERED
        low = high = len(full) // 2
        if not full[low]:
            return None
        while low > 0 and full[low - 1]:
            low -= 1
        while high < len(full) - 1 and full[high + 1]:
            high += 1
        edges = np.linspace(-90, 90, len(full) + 1)
        return float(edges[low]), float(edges[high + 1])

    def propose(
        self,
        width: int | None = None,
        height: int | None = None,
        phi_deg: tuple[float, float] | None = None,
        num_spheres: int | None = None,
        min_depth: float | None = None,
    ) -> SphereGrid:
        """Return the recommended grid: what is given stays, and what is None uses the images fully.

        One column is a pixel, and one sphere moves a match by a pixel (median over rays). Pixels
        are square: the elevations are those of `rows`, or with a height those around the horizon.
        The nearest depth is `nearest`.

        Raises:
            OmnistereoError: If all cameras are at one place.
        """
        if width is None:
            width = 8 * round(360 * self.pixels_per_degree / 8)
        if phi_deg is None and height is not None:
            half = min(180 * height / width, 90.0)
            phi_deg = -half, half
        elif phi_deg is None:
            phi_deg = self.rows() or _ANY_ROWS
        if height is None:
            height = max(8, 8 * round(width * (phi_deg[1] - phi_deg[0]) / 360 / 8))
        if min_depth is None:
            min_depth = self.nearest
        if num_spheres is None:
            num_spheres = int(
                np.clip(8 * np.ceil((1 + self._farthest(phi_deg) / min_depth) / 8), *_SPHERES)
            )
        return SphereGrid(width, height, phi_deg, num_spheres, min_depth)

    def _between(self, phi_deg: tuple[float, float]) -> slice:
        """Return the rows between two elevations, at least one."""
        first, stop = np.rint((np.array(phi_deg) + 90) * self.grid.height / 180).astype(int)
        return slice(min(first, self.grid.height - 1), max(stop, first + 1))

    def _farthest(self, phi_deg: tuple[float, float]) -> float:
        """Return the depth in metres beyond which a pixel off is infinitely far (median)."""
        baseline = self.baseline[self._between(phi_deg)]
        return float(np.median(baseline[baseline > 0])) / np.radians(1 / self.pixels_per_degree)

    @cached_property
    def good_from(self) -> NDArray[np.float64]:
        """Depth in metres from which on the points of each ray can be measured, on a coarse
        panorama of the sphere.

        There, two cameras see a point from directions at most 30° apart: from wider apart, a patch
        of a surface looks too different to be matched. Infinite where no two cameras ever do.

        Raises:
            OmnistereoError: If all cameras are at one place.
        """
        if (reach := float(np.linalg.norm(self.rig.centers, axis=1).max())) < _TOGETHER:
            raise OmnistereoError(
                "all cameras are at one place: they see no depth. Check their translations"
            )
        rays = _COARSE.rays()
        good, measured = np.full(_COARSE.shape, np.inf), np.ones(_COARSE.shape, bool)
        for depth in reach * _STEP ** np.arange(_STEPS, 0, -1):
            seen = _visible(self.rig, _COARSE, depth)
            views = depth * rays - self.rig.centers[:, None, None]
            views /= np.linalg.norm(views, axis=-1, keepdims=True)
            similar = np.zeros(_COARSE.shape, bool)
            for i, j in combinations(range(len(self.rig)), 2):
                similar |= seen[i] & seen[j] & (np.sum(views[i] * views[j], axis=-1) >= _COS_WIDEST)
            measured &= similar
            good[measured] = depth
        return good

    @property
    def nearest(self) -> float:
        """Nearest depth for a sweep in metres, rounded: that from which on a tenth of the
        directions are measured.

        Nearer spheres would be spent on few rays, see `good_from`. Directions that no two cameras
        see do not count.
        """
        known = np.isfinite(self.good_from)
        if not known.any():
            return 1.0  # no depth at all, as `sentences` says
        weights = (np.cos(_COARSE.phis())[:, None] * known)[known]
        nearest = np.quantile(self.good_from[known], _FEW, weights=weights, method="inverted_cdf")
        return float(f"{nearest:.2g}")

    def left_out(self, grid: SphereGrid) -> str:
        """Return what a grid shows, and what it leaves out of what the cameras see."""
        seen = np.sum(self.cameras >= 2, axis=1) * np.cos(self.grid.phis())  # by solid angle
        inside = seen[self._between(grid.phi_deg)].sum() / seen.sum() if seen.any() else 1.0
        outside = 100 * (1 - inside)
        width = self.propose(phi_deg=grid.phi_deg, num_spheres=2, min_depth=grid.min_depth).width
        parts = []
        if outside >= 1:
            first, last = np.flatnonzero(seen)[[0, -1]]
            low, high = np.linspace(-90, 90, len(seen) + 1)[[first, last + 1]]
            parts.append(
                f"{outside:.0f} % of the directions that two cameras see ({low:g}° to {high:g}°)"
            )
        if width > grid.width:
            parts.append(f"detail (--grid {width} uses the images fully)")
        return (
            f"{grid.width} × {grid.height} rays from {grid.phi_deg[0]:g}° to {grid.phi_deg[1]:g}°,"
            f" {grid.num_spheres} spheres from {grid.min_depth:g} m. Left out:"
            f" {' and '.join(parts) or 'nothing'}."
        )

    def sentences(self, min_depth: float | None = None) -> list[str]:
        """Return what the rig can see and how exact its depth can be; see `propose`."""
        rig, lines = self.rig, []
        shares = ", ".join(
            f"{k} or more {100 * self.share(k):.0f} %" for k in range(1, len(rig) + 1)
        )
        lines.append(f"Cameras that see a direction, as a share of the whole sphere: {shares}.")
        if not self.share(2):
            return [*lines, "No two cameras see the same direction: there is no depth."]
        off = ", ".join(
            f"{float(np.nanmedian(self.depth_resolution(depth))):.2g} m at {depth:g} m"
            for depth in (1.0, 5.0, 20.0)
        )
        lines.append(f"A match that is off by one pixel puts a depth off by {off}.")
        lines.append(self._good_sentence())
        if self.rows() is None:
            return [*lines, "No row of the panorama has depth all around: choose --phi."]
        grid = self.propose(min_depth=min_depth)
        farthest = float(f"{self._farthest(grid.phi_deg):.2g}")
        lines.append(
            f"The images can fill a panorama of {grid.width} × {grid.height} from"
            f" {grid.phi_deg[0]:g}° to {grid.phi_deg[1]:g}° with {grid.num_spheres} spheres, from"
            f" {grid.min_depth:g} m; beyond {farthest:g} m all looks infinitely far."
        )
        return lines

    def _good_sentence(self) -> str:
        """Return from where on depth can be measured in each direction around the horizon."""
        rows = np.abs(np.degrees(_COARSE.phis())) < 45
        found = {}
        for name, azimuth in _SECTORS.items():
            off = (np.degrees(_COARSE.thetas()) - azimuth + 180) % 360 - 180
            sector = self.good_from[rows][:, np.abs(off) < 45]
            known = sector[np.isfinite(sector)]
            share = 100 * known.size / sector.size
            some = f" on {share:.0f} % of it" if share < 99 else ""
            found[name] = f"from {np.median(known):.2g} m on{some}" if known.size else "nowhere"
        same = len({*found.values()}) == 1
        parts = [found["ahead"]] if same else [f"{name} {words}" for name, words in found.items()]
        return (
            f"Depth can be measured {', '.join(parts)}. Nearer, only one camera sees a surface, or"
            " two do from more than 30° apart."
        )


def _visible(rig: Rig, grid: SphereGrid, depth: float) -> NDArray[np.bool_]:
    """Return which cameras see the point of each ray at a depth in metres, (cameras, H, W)."""
    return rig.sees(grid.rays(), 1 / depth)
