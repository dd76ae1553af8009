"""What a calibration says about itself: errors, coverage, uncertainty, and what to do about them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.calibrate.bundle import Estimate, Intrinsics
from omnistereo_lib.geometry.pose import Pose

Floats = NDArray[np.float64]

_BIN_DEG = 10


@dataclass(frozen=True)
class Errors:
    """Reprojection errors of some corners, in the three ways that people quote.

    Attributes
    ----------
    rms_px : float
        Root mean square of all u and v residuals (Urban et al. 2015).
    rms_distance_px : float
        Root mean square distance, √2 larger (OpenCV's figure).
    mean_px : float
        Mean distance (OCamCalib's figure).
    """

    rms_px: float
    rms_distance_px: float
    mean_px: float

    @classmethod
    def of(cls, residuals: Floats) -> Errors:
        """Return the errors of residuals (..., 2), NaN left out; NaN where there are none."""
        squares = np.sum(np.square(residuals), axis=-1).ravel()
        squares = squares[np.isfinite(squares)]
        if squares.size == 0:
            return cls(np.nan, np.nan, np.nan)
        mean = float(squares.mean())
        return cls(np.sqrt(mean / 2), np.sqrt(mean), float(np.sqrt(squares).mean()))


@dataclass(frozen=True, eq=False)
class CameraReport:
    """How one camera was calibrated and how far it can be trusted.

    Attributes
    ----------
    views_used : tuple of int
        Indices of the views that the result stands on.
    left_out : dict
        Index of each other view → why, in words.
    outliers : tuple of (view, corner, distance in px)
        Single corners of used views that were left out, worst first.
    corners : dict
        View → (K, 2) px, as observed, NaN where a corner is missing.
    residuals : dict
        View → (K, 2) px, predicted minus observed, NaN where a corner is missing; outliers included.
    angles : dict
        View → (K,) angle of each corner from the optical axis, radians.
    T_cam_board : dict
        View → board → camera.
    held_back : dict
        Degree of the polynomial → mean distance in px on views that were not used in the fit, where it was chosen.
    intrinsics : Intrinsics
        The parameters that were adjusted.
    covariance : array, shape (4 + degree, 4 + degree)
        Of these parameters.
    sigma_px : float
        Noise of the corners, each coordinate, that the residuals show.
    warnings : tuple of str
        What to know, and what to do.
    """

    views_used: tuple[int, ...]
    left_out: Mapping[int, str]
    outliers: tuple[tuple[int, int, float], ...]
    corners: Mapping[int, Floats]
    residuals: Mapping[int, Floats]
    angles: Mapping[int, Floats]
    T_cam_board: Mapping[int, Pose]
    held_back: Mapping[int, float]
    intrinsics: Intrinsics
    covariance: Floats
    sigma_px: float
    warnings: tuple[str, ...] = ()
    name: str = "camera"

    def counted(self) -> dict[int, Floats]:
        """Return the residuals of each view that was used, (K, 2) px, NaN for outliers too."""
        counted = {view: self.residuals[view].copy() for view in self.views_used}
        for view, corner, _ in self.outliers:
            counted[view][corner] = np.nan
        return counted

    def inliers(self) -> Floats:
        """Return all residuals that count, shape (M, 2), px."""
        stacked = np.concatenate(list(self.counted().values()))
        return stacked[np.isfinite(stacked).all(axis=-1)]

    @property
    def errors(self) -> Errors:
        """All three error figures of the corners that count."""
        return Errors.of(self.inliers())

    @property
    def rms_px(self) -> float:
        """Root mean square of the u and v residuals, px."""
        return self.errors.rms_px

    @property
    def mean_px(self) -> float:
        """Mean distance, px."""
        return self.errors.mean_px

    @property
    def degree(self) -> int:
        """Degree of the polynomial."""
        return self.intrinsics.degree

    @property
    def coverage_deg(self) -> float:
        """The largest angle from the optical axis at which corners were seen, degrees."""
        return float(np.degrees(max(np.nanmax(self.angles[view]) for view in self.views_used)))

    def by_angle(self) -> list[tuple[int, int, Errors]]:
        """Return the errors in rings of 10° from the axis: (lower end in degrees, corners, errors)."""
        residuals = np.concatenate(list(self.counted().values()))
        ring = np.degrees(np.concatenate([self.angles[view] for view in self.views_used])) // _BIN_DEG
        ring[~np.isfinite(residuals).all(axis=1)] = np.nan
        rings = np.unique(ring[np.isfinite(ring)])
        return [(int(i) * _BIN_DEG, int((ring == i).sum()), Errors.of(residuals[ring == i])) for i in rings]

    def ray_uncertainty_deg(self, angles_deg: Floats, azimuths: int = 12) -> Floats:
        """Return the standard deviation of rays at some angles from the axis, degrees, worst azimuth.

        The pixels are where the nominal camera sees those angles; the covariance moves what they mean.
        """
        camera = self.intrinsics.camera(2.0 * min(float(np.max(angles_deg)) + 0.1, 179.0))
        theta, phi = np.meshgrid(np.radians(angles_deg), np.linspace(0, 2 * np.pi, azimuths, endpoint=False))
        rays = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
        pixels = camera.project(rays, exact=True)[0]

        def directions(vector: Floats) -> Floats:
            return Intrinsics(vector, self.intrinsics.image_size).rays(pixels)

        spread = standard_deviation(directions, self.intrinsics.vector, self.covariance)
        return np.degrees(np.linalg.norm(spread, axis=-1).max(axis=0))

    def text(self, names: Sequence[str] | None = None) -> str:
        """Return the report in words; `names` are what the views are called instead of their indices."""
        e = self.errors
        lines = [
            f"{self.name}: {len(self.views_used)} views, {len(self.inliers())} corners, polynomial of degree "
            f"{self.degree}, up to {self.coverage_deg:.0f}° from the axis",
            f"  error: {e.rms_px:.3f} px rms in u and v, {e.rms_distance_px:.3f} px rms distance, "
            f"{e.mean_px:.3f} px mean distance",
        ]
        if self.held_back:
            table = ", ".join(f"degree {degree}: {error:.3f} px" for degree, error in self.held_back.items())
            lines.append(f"  on views held back: {table}")
        rings = ", ".join(f"{low}-{low + _BIN_DEG}°: {e.mean_px:.3f} ({count})" for low, count, e in self.by_angle())
        lines.append(f"  mean distance in px by angle (corners): {rings}")
        lines += [f"  {line}" for line in _reasons(self.left_out, "view", names)]
        if self.outliers:
            worst = ", ".join(f"view {_name(v, names)} corner {k}: {px:.1f} px" for v, k, px in self.outliers[:5])
            more = f" and {len(self.outliers) - 5} more" if len(self.outliers) > 5 else ""
            lines.append(f"  corners left out: {worst}{more}")
        return "\n".join([*lines, *(f"  warning: {warning}" for warning in self.warnings)])


@dataclass(frozen=True, eq=False)
class RigReport:
    """How a rig was calibrated and how far it can be trusted.

    Attributes
    ----------
    cameras : tuple of CameraReport
        Each camera in the joint solution; views are captures.
    alone : tuple of CameraReport
        Each camera calibrated by itself, before.
    captures_used : tuple of int
        Captures in the joint solution.
    left_out : dict
        Capture → why, in words.
    shared : dict
        (camera, camera) → how many captures both saw.
    estimate : Estimate
        All unknowns of the joint solution; captures in the order of `captures_used`.
    covariance : array, shape (rig_size, rig_size)
        Of the first `estimate.rig_size` unknowns: intrinsics and the poses of cameras 2 ….
    sigma_px : float
        Noise of the corners, each coordinate.
    warnings : tuple of str
    """

    cameras: tuple[CameraReport, ...]
    alone: tuple[CameraReport, ...]
    captures_used: tuple[int, ...]
    left_out: Mapping[int, str]
    shared: Mapping[tuple[int, int], int]
    estimate: Estimate
    covariance: Floats
    sigma_px: float
    warnings: tuple[str, ...] = field(default=())

    @property
    def errors(self) -> Errors:
        """All three error figures over all cameras."""
        return Errors.of(np.concatenate([camera.inliers() for camera in self.cameras]))

    @property
    def rms_px(self) -> float:
        """Root mean square of the u and v residuals, px."""
        return self.errors.rms_px

    @property
    def mean_px(self) -> float:
        """Mean distance, px."""
        return self.errors.mean_px

    def pose_uncertainty(self) -> list[tuple[float, float]]:
        """Return one standard deviation of each camera's pose against camera 1: (degrees, metres)."""
        spread = np.sqrt(np.diag(self.covariance))
        poses = spread[sum(len(i.vector) for i in self.estimate.intrinsics) :].reshape(-1, 6)
        return [(0.0, 0.0)] + [
            (float(np.degrees(np.linalg.norm(row[:3]))), float(np.linalg.norm(row[3:]))) for row in poses
        ]

    def text(self, names: Sequence[str] | None = None) -> str:
        """Return the report in words; `names` are what the captures are called instead of their indices."""
        e = self.errors
        lines = [
            f"rig: {len(self.cameras)} cameras, {len(self.captures_used)} captures, {e.rms_px:.3f} px rms in u and v, "
            f"{e.mean_px:.3f} px mean distance"
        ]
        for number, (camera, alone, (angle, shift)) in enumerate(
            zip(self.cameras, self.alone, self.pose_uncertainty(), strict=True), start=1
        ):
            pose = "" if number == 1 else f"; pose known to {angle:.3f}° and {1000 * shift:.2f} mm"
            lines.append(f"  camera {number}: {camera.rms_px:.3f} px rms ({alone.rms_px:.3f} px alone){pose}")
        pairs = ", ".join(f"{i + 1}-{j + 1}: {count}" for (i, j), count in sorted(self.shared.items()))
        lines.append(f"  captures shared by cameras {pairs}")
        lines += [f"  {line}" for line in _reasons(self.left_out, "capture", names)]
        lines += [f"  warning: {warning}" for warning in self.warnings]
        return "\n".join([*lines, *(camera.text(names) for camera in self.cameras)])


def _name(view: int, names: Sequence[str] | None) -> str:
    return str(view) if names is None else names[view]


def _reasons(left_out: Mapping[int, str], noun: str, names: Sequence[str] | None) -> list[str]:
    """Return one line for each reason, with all that were left out for it."""
    reasons: dict[str, list[str]] = {}
    for view, why in sorted(left_out.items()):
        reasons.setdefault(why, []).append(_name(view, names))
    return [
        f"{noun}{'s' if len(which) > 1 else ''} {', '.join(which)} left out: {why}" for why, which in reasons.items()
    ]


def standard_deviation(function: Callable[[Floats], Floats], x: Floats, covariance: Floats) -> Floats:
    """Return the standard deviation of everything a function returns, to first order: √diag(J Σ Jᵀ).

    The derivatives are taken numerically along the principal axes of Σ, with steps of one standard deviation.
    Along single parameters they would mean nothing: coefficients of a polynomial are known together far better
    than each by itself.

    Parameters
    ----------
    function : callable
        From parameters (n,) to an array of any shape.
    x : array, shape (n,)
    covariance : array, shape (n, n)
        Of the parameters.
    """
    scale = np.sqrt(np.diag(covariance))
    variances, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
    steps = (scale[:, None] * axes * np.sqrt(variances.clip(0.0))).T
    variance = sum(np.square((function(x + step) - function(x - step)) / 2.0) for step in steps)
    return np.sqrt(variance)
