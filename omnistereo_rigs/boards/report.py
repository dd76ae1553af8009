"""Calibration reports: reprojection errors, angular coverage, uncertainty, warnings."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Floats, Pose
from omnistereo_rigs.boards.bundle import cross, rotations
from omnistereo_rigs.boards.params import CalibrationParams, Intrinsics

_RING_DEG = 10
# Limits for warnings.
_MARGIN_DEG = 10.0  # field of view beyond the last corner
_FEW_CORNERS = 10  # in a ring
FEW_VIEWS = 10
_OFF_CENTER = 0.1  # of the image side
_NOT_SQUARE = 0.02
_LARGE_PX = 0.8  # rms in u and v


@dataclass(frozen=True)
class ReprojectionErrors:
    """Reprojection errors of some corners by the three definitions in use."""

    rms_px: float  # root mean square of all u and v residuals (Urban et al. 2015)
    rms_distance_px: float  # root mean square distance, √2 larger (OpenCV)
    mean_px: float  # mean distance (OCamCalib)

    @classmethod
    def from_residuals(cls, residuals: Floats) -> ReprojectionErrors:
        """Return the errors of residuals (..., 2), NaN ignored; NaN if there are none."""
        squares = np.sum(np.square(residuals), axis=-1).ravel()
        squares = squares[np.isfinite(squares)]
        if squares.size == 0:
            return cls(np.nan, np.nan, np.nan)
        mean = float(squares.mean())
        return cls(np.sqrt(mean / 2), np.sqrt(mean), float(np.sqrt(squares).mean()))


class _Report(ABC):
    """Reprojection errors of a report over its inliers."""

    @abstractmethod
    def inlier_residuals(self) -> Floats:
        """Return the residuals of all inliers, shape (M, 2), px."""

    @property
    def errors(self) -> ReprojectionErrors:
        """Errors of the inliers by all three definitions."""
        return ReprojectionErrors.from_residuals(self.inlier_residuals())

    @property
    def rms_px(self) -> float:
        """Root mean square of the u and v residuals, px."""
        return self.errors.rms_px

    @property
    def mean_px(self) -> float:
        """Mean distance, px."""
        return self.errors.mean_px


@dataclass(frozen=True, eq=False)
class CameraReport(_Report):
    """Result of the calibration of one camera."""

    views_used: tuple[int, ...]  #: indices of the views used
    rejected: Mapping[int, str]  #: index of each other view → reason
    #: (view, corner, px) of used views that were rejected, worst first
    outliers: tuple[tuple[int, int, float], ...]
    corners: Mapping[int, Floats]  #: view → (K, 2) px, as observed, NaN where a corner is missing
    #: view → (K, 2) px, predicted minus observed, NaN as above; with outliers
    residuals: Mapping[int, Floats]
    angles: Mapping[int, Floats]  #: view → (K,) angle of each corner from the optical axis, radians
    T_cam_board: Mapping[int, Pose]  #: view → board → camera
    #: degree → mean distance on held-out views, px, if it was chosen by them
    cv_error_px: Mapping[int, float]
    intrinsics: Intrinsics
    covariance: Floats  #: (4 + degree, 4 + degree), of `intrinsics.vector`
    sigma_px: float  #: noise of the corners in u and in v, from the residuals
    warnings: tuple[str, ...] = ()  #: what is wrong and what to do
    name: str = "camera"

    def residuals_used(self) -> dict[int, Floats]:
        """Return the residuals of each view used, (K, 2) px, NaN for outliers."""
        used = {view: self.residuals[view].copy() for view in self.views_used}
        for view, corner, _ in self.outliers:
            used[view][corner] = np.nan
        return used

    def inlier_residuals(self) -> Floats:
        """Return the residuals of all inliers, shape (M, 2), px."""
        stacked = np.concatenate(list(self.residuals_used().values()))
        return stacked[np.isfinite(stacked).all(axis=-1)]

    def inlier_angles_deg(self) -> Floats:
        """Return the angle of each inlier from the axis, (M,), degrees; in the residuals' order."""
        used = self.residuals_used()
        inlier = np.isfinite(np.concatenate(list(used.values()))).all(axis=-1)
        return np.degrees(np.concatenate([self.angles[view] for view in used])[inlier])

    def distances(self, view: int) -> Floats:
        """Return the reprojection errors of the corners of a view, px, with outliers."""
        distances = np.linalg.norm(self.residuals[view], axis=1)
        return distances[np.isfinite(distances)]

    @property
    def degree(self) -> int:
        """Degree of the polynomial."""
        return self.intrinsics.degree

    @property
    def max_corner_angle_deg(self) -> float:
        """Largest angle of an inlier from the optical axis, degrees."""
        return float(self.inlier_angles_deg().max())

    def errors_by_angle(self) -> list[tuple[int, int, ReprojectionErrors]]:
        """Return the errors in rings of 10° from the axis: (lower end, corners, errors)."""
        residuals, ring = self.inlier_residuals(), self.inlier_angles_deg() // _RING_DEG
        return [
            (
                int(i) * _RING_DEG,
                int((ring == i).sum()),
                ReprojectionErrors.from_residuals(residuals[ring == i]),
            )
            for i in np.unique(ring)
        ]

    def build_camera(self, max_fov_deg: float | None) -> tuple[OcamCamera, CameraReport]:
        """Return the camera, and the report with warnings; None: up to the last corner.

        Raises an `OmnistereoError` if the polynomial is not monotonic over the field of view.
        """
        fov_deg = 2 * self.max_corner_angle_deg if max_fov_deg is None else max_fov_deg
        camera = self.intrinsics.camera(fov_deg)
        return camera, replace(self, warnings=(*self.warnings, *_camera_warnings(self, camera)))

    def text(self, names: Sequence[str] | None = None) -> str:
        """Return the report as text; `names` are what the views are called, not their indices."""
        lines = [
            (
                f"{self.name}: {len(self.views_used)} views, {len(self.inlier_residuals())}"
                f" corners, polynomial of degree {self.degree}, up to"
                f" {self.max_corner_angle_deg:.0f}° from the axis"
            ),
            f"  error: {self.rms_px:.3f} px rms in u and v",
        ]
        if self.cv_error_px:
            errors = dict(self.cv_error_px)
            chosen = errors.pop(self.degree)
            others = ", ".join(f"degree {d}: {px / chosen:.3f}" for d, px in errors.items())
            lines.append(f"  on held-out views, relative to degree {self.degree}: {others}")
        of_rings = self.errors_by_angle()
        rings = (f"{low}-{low + _RING_DEG}°: {e.rms_px:.3f} ({n})" for low, n, e in of_rings)
        lines.append(f"  error by angle (corners): {', '.join(rings)}")
        lines += [f"  {line}" for line in _rejections(self.rejected, "view", names)]
        if self.outliers:
            worst = ", ".join(
                f"view {name_of(v, names)} corner {k}: {px:.1f} px"
                for v, k, px in self.outliers[:5]
            )
            more = f" and {len(self.outliers) - 5} more" if len(self.outliers) > 5 else ""
            lines.append(f"  corners rejected: {worst}{more}")
        return "\n".join([*lines, *(f"  warning: {warning}" for warning in self.warnings)])


def _camera_warnings(report: CameraReport, camera: OcamCamera) -> Iterator[str]:
    last, half = report.max_corner_angle_deg, camera.max_fov_deg / 2
    if half > last + _MARGIN_DEG:
        yield (
            f"no corner beyond {last:.0f}° from the axis, but the field of view ends at"
            f" {half:.0f}°: the camera model is extrapolated. Hold the board closer to the rim"
        )
    if last > half + _MARGIN_DEG:
        yield (
            f"corners reach {last:.0f}° from the axis, but the field of view ends at {half:.0f}°:"
            f" the rim is cut off. Pass max_fov_deg = {2 * np.floor(last):.0f} (--max-fov), or none"
        )
    edges = np.arange(0.0, last, _RING_DEG)
    sparse = np.histogram(report.inlier_angles_deg(), edges)[0] < _FEW_CORNERS
    steps = np.diff(np.concatenate([[0], sparse.astype(int), [0]]))
    for low, high in zip(
        edges[np.flatnonzero(steps == 1)], edges[np.flatnonzero(steps == -1)], strict=True
    ):
        yield (
            f"hardly any corners constrain the polynomial {low:.0f}° to {high:.0f}° from the axis."
            " Cover every ring"
        )
    if len(report.views_used) < FEW_VIEWS:
        by_accident = len(report.rejected) > 2 * len(report.views_used)
        check = (
            ". Check the board size: another one is found here and there by accident"
            if by_accident
            else ""
        )
        yield f"only {len(report.views_used)} views. Take 15 or more, tilted every way{check}"
    size = np.array(camera.image_size)
    offset = np.array(camera.center) - (size - 1) / 2
    if (np.abs(offset) > _OFF_CENTER * size).any():
        yield (
            f"the optical axis is {np.linalg.norm(offset):.0f} px from the image centre. Check"
            " whether the images are cropped; a crop is fine if it is the same in every image"
        )
    if abs(camera.affine[0] - 1) > _NOT_SQUARE:
        yield (
            f"pixels are {camera.affine[0]:.3f} times as high as wide. Check that the images were"
            " not resized by different factors and that the squares of the board are square"
        )
    if report.rms_px > _LARGE_PX:
        yield (
            f"the error of {report.rms_px:.2f} px rms is large. Check that the board is flat and"
            " all images are from one camera with fixed focus and zoom"
        )


@dataclass(frozen=True, eq=False)
class RigReport(_Report):
    """Result of the calibration of a rig."""

    joint: tuple[CameraReport, ...]  #: each camera in the joint solution; views are captures
    single_camera: tuple[CameraReport, ...]  #: each camera calibrated by itself, before
    captures_used: tuple[int, ...]  #: captures in the joint solution
    rejected: Mapping[int, str]  #: capture → reason
    shared: Mapping[tuple[int, int], int]  #: (camera, camera) → number of captures that both see
    #: all unknowns of the joint solution; captures in the order of `captures_used`
    params: CalibrationParams
    #: of its first `num_rig_params` unknowns: intrinsics and the poses of cameras 2 …
    covariance: Floats
    sigma_px: float  #: noise of the corners in u and in v
    warnings: tuple[str, ...] = ()

    def inlier_residuals(self) -> Floats:
        """Return the residuals of all inliers of all cameras, shape (M, 2), px."""
        return np.concatenate([camera.inlier_residuals() for camera in self.joint])

    def pose_uncertainty(self) -> list[tuple[float, float]]:
        """Return the deviations of each camera's pose against camera 1: (degrees, metres)."""
        poses = np.array([pose.as_vector() for pose in self.params.T_cam_rig[1:]])
        blocks = self.covariance[-poses.size :, -poses.size :].reshape(len(poses), 6, len(poses), 6)
        found = [(0.0, 0.0)]
        turns = rotations(poses[:, :3])[1]
        for k, (J, across) in enumerate(zip(turns, cross(poses[:, 3:]), strict=True)):
            # by δr and δt
            turn, shift = np.hstack([J, np.zeros((3, 3))]), np.hstack([across @ J, np.eye(3)])
            angle, metres = (np.sqrt(np.trace(A @ blocks[k, :, k] @ A.T)) for A in (turn, shift))
            found.append((float(np.degrees(angle)), float(metres)))
        return found

    def text(self, names: Sequence[str] | None = None) -> str:
        """Return the report as text; `names` are what captures are called, not their indices."""
        lines = [
            f"rig: {len(self.joint)} cameras, {len(self.captures_used)} captures,"
            f" {self.rms_px:.3f} px rms in u and v"
        ]
        for number, (camera, single, (angle, shift)) in enumerate(
            zip(self.joint, self.single_camera, self.pose_uncertainty(), strict=True), start=1
        ):
            pose = "" if number == 1 else f"; pose known to {angle:.3f}° and {1000 * shift:.2f} mm"
            lines.append(
                f"  camera {number}: {camera.rms_px:.3f} px rms ({single.rms_px:.3f} px by"
                f" itself){pose}"
            )
        pairs = ", ".join(f"{i + 1}-{j + 1}: {n}" for (i, j), n in sorted(self.shared.items()))
        lines.append(f"  captures shared by cameras {pairs}")
        centers = [pose.inverse().t for pose in self.params.T_cam_rig]
        apart = (
            f"{i + 1}-{j + 1}: {np.linalg.norm(centers[i] - centers[j]):.3f}"
            for i, j in combinations(range(len(centers)), 2)
        )
        lines.append(f"  distances in metres between cameras {', '.join(apart)}")
        lines += [f"  {line}" for line in _rejections(self.rejected, "capture", names)]
        lines += [f"  warning: {warning}" for warning in self.warnings]
        return "\n".join([*lines, *(camera.text(names) for camera in self.joint)])


def name_of(view: int, names: Sequence[str] | None) -> str:
    """Return what a view or capture is called: its name, or its index where there are no names."""
    return str(view) if names is None else names[view]


def _rejections(rejected: Mapping[int, str], noun: str, names: Sequence[str] | None) -> list[str]:
    """Return one line for each reason, with all views that were rejected for it."""
    reasons: dict[str, list[str]] = {}
    for view, why in sorted(rejected.items()):
        reasons.setdefault(why, []).append(name_of(view, names))
    return [
        f"{noun}{'s' if len(of) > 1 else ''} {', '.join(of)} rejected: {why}"
        for why, of in reasons.items()
    ]
