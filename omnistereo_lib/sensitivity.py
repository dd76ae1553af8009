"""What a wrong rig does to depth: how far, in spheres, the winner moves along each ray.

To first order. Content that should appear at direction s of the panorama appears, in camera i's picture warped
with the wrong rig onto sphere n + δ, at s - M⁻¹(∂u/∂n δ + Δu), with M = ∂u/∂s how the camera's pixel u follows the
direction and Δu the error of the projection in pixels. Two cameras' pictures fall on each other where these agree.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.calibrate.bundle import Estimate
from omnistereo_lib.calibrate.report import RigReport, standard_deviation
from omnistereo_lib.rig import Rig
from omnistereo_lib.sphere import SphereGrid
from omnistereo_lib.volume import Pairs, camera_pairs

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
    rays = grid.rays()
    moves = [_apparent_moves(rig, wrong, i, rays, grid, index) for i in range(len(rig))]
    numerator, denominator = np.zeros((2, *grid.shape))
    for i, j in camera_pairs(pairs, rig):
        (per_sphere_i, error_i, seen_i), (per_sphere_j, error_j, seen_j) = moves[i], moves[j]
        both = seen_i & seen_j
        parallax, error = per_sphere_i - per_sphere_j, error_i - error_j
        numerator -= np.where(both, np.sum(parallax * error, axis=-1), 0.0)
        denominator += np.where(both, np.sum(parallax * parallax, axis=-1), 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(denominator > 0, numerator / denominator, np.nan)


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

    def shift(vector: Floats) -> Floats:
        moved = _rig(nominal.with_vector(vector), report)
        return index_shift(rig.centered(center), moved.centered(center), grid, index, pairs)

    return standard_deviation(shift, nominal.vector(), report.covariance)


def _rig(estimate: Estimate, report: RigReport) -> Rig:
    cameras = [
        intrinsics.camera(2 * camera.coverage_deg)
        for intrinsics, camera in zip(estimate.intrinsics, report.cameras, strict=True)
    ]
    return Rig(cameras, [pose.inverse() for pose in estimate.T_cam_rig])


def _apparent_moves(
    rig: Rig, wrong: Rig, i: int, rays: Floats, grid: SphereGrid, index: float
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return, for camera i, M⁻¹ ∂u/∂n and M⁻¹ Δu, each (H, W, 2) radians on the panorama, and where it sees."""
    across = np.stack([rays[..., 2], np.zeros(grid.shape), -rays[..., 0]], axis=-1)  # along θ …
    across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-12)
    down = np.cross(rays, across)  # … and along φ

    def pixels(which: Rig, directions: Floats, n: float) -> tuple[Floats, NDArray[np.bool_]]:
        points = directions / grid.index_to_inverse_depth(n)
        return which.cameras[i].project(which.T_rig_cam[i].inverse() @ points, exact=True)

    u, seen = pixels(rig, rays, index)
    turns = [
        (pixels(rig, rays + _TURN * axis, index)[0] - pixels(rig, rays - _TURN * axis, index)[0]) / (2 * _TURN)
        for axis in (across, down)
    ]
    M = np.stack(turns, axis=-1)
    by_index = (pixels(rig, rays, index + _STEP)[0] - pixels(rig, rays, index - _STEP)[0]) / (2 * _STEP)
    error = pixels(wrong, rays, index)[0] - u
    M[~seen] = np.eye(2)
    moves = np.linalg.solve(M, np.stack([by_index, error], axis=-1))
    return moves[..., 0], moves[..., 1], seen
