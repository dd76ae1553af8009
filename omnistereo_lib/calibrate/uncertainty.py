"""What a wrong rig does to depth: how far, in spheres, the winner moves along each ray.

To first order. Content that should appear at direction s of the panorama appears, in camera i's picture warped
with the wrong rig onto sphere n + δ, at s - M⁻¹(∂u/∂n δ + Δu), with M = ∂u/∂s how the camera's pixel u follows the
direction and Δu the error of the projection in pixels. Two cameras' pictures fall on each other where these agree.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.calibrate.bundle import Estimate
from omnistereo_lib.calibrate.report import RigReport, standard_deviation
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.volume import Pairs, camera_pairs

Floats = NDArray[np.float64]

_TURN = 1e-4  # radians, for derivatives by direction
_STEP = 0.05  # spheres, for derivatives by index


def index_shift(rig: Rig, wrong: Rig, grid: SphereGrid, index: float, pairs: Pairs = "ring") -> Floats:
    """Predict by how many spheres the winner moves if `wrong` is used in place of `rig`.

    Parameters
    ----------
    rig, wrong : Rig
        In the same frame, its origin the sweep centre.
    grid : SphereGrid
        Rays, and what a sphere is.
    index : float
        Where the scene truly is, in (0, N - 1].
    pairs : "ring" | "all" | sequence of (int, int)
        The pairs that vote; the result is the shift that all of them together like best.

    Returns
    -------
    array, shape (H, W), spheres; NaN where no pair sees the ray
        Positive: things seem nearer than they are. First order: true for shifts small against the texture.
    """
    return _shift(_views(rig, grid, index), wrong, grid, index, camera_pairs(pairs, rig))


def index_uncertainty(report: RigReport, grid: SphereGrid, index: float, pairs: Pairs = "ring") -> Floats:
    """Return one standard deviation, in spheres, of the winner due to what the calibration does not know.

    Parameters
    ----------
    report : RigReport
        Of `calibrate_rig`: its covariance goes through `index_shift`.
    grid, index, pairs
        As for `index_shift`.

    Returns
    -------
    array, shape (H, W), spheres
    """
    estimate = report.estimate
    nominal = Estimate(estimate.intrinsics, estimate.T_cam_rig, ())
    rig = _rig(nominal, report)
    center = rig.centers.mean(axis=0)
    views, pairs = _views(rig.centered(center), grid, index), camera_pairs(pairs, rig)

    def shift(vector: Floats) -> Floats:
        moved = _rig(nominal.with_vector(vector), report)
        return _shift(views, moved.centered(center), grid, index, pairs)

    return standard_deviation(shift, nominal.vector(), report.covariance)


def _rig(estimate: Estimate, report: RigReport) -> Rig:
    cameras = [
        intrinsics.camera(2 * camera.coverage_deg)
        for intrinsics, camera in zip(estimate.intrinsics, report.cameras, strict=True)
    ]
    return Rig(cameras, [pose.inverse() for pose in estimate.T_cam_rig])


@dataclass(frozen=True)
class _View:
    """What one camera of the right rig sees of every ray's point on a sphere."""

    pixels: Floats  # u, (H, W, 2)
    seen: NDArray[np.bool_]  # (H, W)
    to_radians: Floats  # M⁻¹, (H, W, 2, 2): from pixels to radians on the panorama
    per_sphere: Floats  # M⁻¹ ∂u/∂n, (H, W, 2)


def _views(rig: Rig, grid: SphereGrid, index: float) -> list[_View]:
    """Look up, once for any number of wrong rigs, what each camera of the right one sees."""
    rays = grid.rays()
    across = np.stack([rays[..., 2], np.zeros(grid.shape), -rays[..., 0]], axis=-1)  # along θ …
    across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-12)
    down = np.cross(rays, across)  # … and along φ
    views = []
    for i in range(len(rig)):
        u, seen = _pixels(rig, i, rays, grid, index)
        turned = [
            [_pixels(rig, i, rays + turn * axis, grid, index)[0] for turn in (_TURN, -_TURN)] for axis in (across, down)
        ]
        M = np.stack([(ahead - back) / (2 * _TURN) for ahead, back in turned], axis=-1)
        M[~seen] = np.eye(2)
        ahead, back = (_pixels(rig, i, rays, grid, index + step)[0] for step in (_STEP, -_STEP))
        inverse = np.linalg.inv(M)
        views.append(_View(u, seen, inverse, _times(inverse, (ahead - back) / (2 * _STEP))))
    return views


def _shift(views: list[_View], wrong: Rig, grid: SphereGrid, index: float, pairs: list[tuple[int, int]]) -> Floats:
    """Return the shift that all pairs together like best: least squares along each ray."""
    rays = grid.rays()
    errors = [
        _times(view.to_radians, _pixels(wrong, i, rays, grid, index)[0] - view.pixels) for i, view in enumerate(views)
    ]
    numerator, denominator = np.zeros((2, *grid.shape))
    for i, j in pairs:
        both = views[i].seen & views[j].seen
        parallax, error = views[i].per_sphere - views[j].per_sphere, errors[i] - errors[j]
        numerator -= np.where(both, np.sum(parallax * error, axis=-1), 0.0)
        denominator += np.where(both, np.sum(parallax * parallax, axis=-1), 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(denominator > 0, numerator / denominator, np.nan)


def _pixels(rig: Rig, i: int, directions: Floats, grid: SphereGrid, index: float) -> tuple[Floats, NDArray[np.bool_]]:
    """Return where camera i sees the points in some directions on a sphere, and whether it does."""
    points = directions / grid.index_to_inverse_depth(index)
    return rig.cameras[i].project(rig.T_rig_cam[i].inverse() @ points, exact=True)


def _times(matrices: Floats, vectors: Floats) -> Floats:
    return (matrices @ vectors[..., None])[..., 0]
