"""From initial values to a solution: robust fit, inliers, covariance, reports of the cameras."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.pose import Floats
from omnistereo_rigs.boards.bundle import BundleProblem, estimate_covariance
from omnistereo_rigs.boards.params import CalibrationParams, Observations
from omnistereo_rigs.boards.report import CameraReport

# times the median distance: 6 σ, of which the median of a two-dimensional normal error is 1.177
OUTLIER = 6.0 / 1.177


def refine(
    problem: BundleProblem, params: CalibrationParams
) -> tuple[CalibrationParams, NDArray[np.bool_]]:
    """Minimise squares over the inliers of a robust fit: within six times a view's noise.

    Returns:
        inlier_mask: bool array, shape (M,)
    """
    seen = problem.observations
    _, view = np.unique(np.stack([seen.camera, seen.capture]), axis=1, return_inverse=True)
    params = problem.adjust(params, loss="soft_l1")
    # The second round recovers inliers that outliers had biased in the first fit.
    for _ in range(2):
        distance = problem.distances(params)
        typical = np.array([np.median(distance[view == k]) for k in range(view.max() + 1)])
        inlier_mask = distance <= OUTLIER * np.maximum(typical[view], np.median(distance))
        params = problem.adjust(params, inlier_mask)
    return params, inlier_mask


@dataclass(frozen=True, eq=False)
class Solution:
    """Parameters with their uncertainty."""

    params: CalibrationParams
    observations: Observations  # all corners of the captures used
    residuals: Floats  # predicted minus observed pixels, shape (M, 2)
    inlier_mask: NDArray[np.bool_]  # (M,), corners that the fit used; the others are outliers
    sigma_px: float  # noise of the corners in u and in v
    covariance: Floats  # of intrinsics and camera poses, (num_rig_params, num_rig_params)

    @classmethod
    def solve(cls, params: CalibrationParams, observations: Observations) -> Solution:
        """Refine initial values and estimate their covariance.

        Raises an `OmnistereoError` if the corners do not determine all unknowns.
        """
        problem = BundleProblem(params, observations)
        params, inlier_mask = refine(problem, params)
        residuals = problem.residuals(params.to_vector()).reshape(-1, 2)
        inliers = residuals[inlier_mask]
        # The noise of one coordinate: √(Σ r² / (numbers - unknowns)).
        free = max(inliers.size - params.num_params + params.num_fixed, 1)
        sigma_px = float(np.sqrt((inliers**2).sum() / free))
        try:
            covariance = estimate_covariance(problem, params, sigma_px, inlier_mask)
        except np.linalg.LinAlgError as error:
            raise OmnistereoError(
                "the corners do not determine all intrinsics and poses. Add views that differ in"
                " tilt and position"
            ) from error
        return cls(params, observations, residuals, inlier_mask, sigma_px, covariance)

    def camera_report(
        self,
        i: int,
        captures: tuple[int, ...],
        rejected: Mapping[int, str],
        cv_error_px: Mapping[int, float],
        name: str = "camera",
    ) -> CameraReport:
        """Return the report of camera i (from 0); `captures` are the caller's numbers of them."""
        mine = self.observations.camera == i
        observed = self.observations.select(mine)
        residuals = self.residuals[mine]
        rays = self.params.intrinsics[i].rays(observed.pixels)
        angle = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])
        table = np.full((len(captures), len(self.observations.board_points), 5), np.nan)
        of_corners = np.column_stack([observed.pixels, residuals, angle])
        table[observed.capture, observed.corner] = of_corners
        views = {captures[k]: k for k in np.unique(observed.capture)}
        distance = np.where(self.inlier_mask[mine], 0.0, np.linalg.norm(residuals, axis=1))
        worst_first = np.argsort(-distance)[: np.count_nonzero(distance)]
        width = len(self.params.intrinsics[i].vector)
        own = slice(i * width, (i + 1) * width)
        return CameraReport(
            views_used=tuple(views),
            rejected=rejected,
            outliers=tuple(
                (captures[observed.capture[m]], int(observed.corner[m]), float(distance[m]))
                for m in worst_first
            ),
            corners={view: table[k, :, :2] for view, k in views.items()},
            residuals={view: table[k, :, 2:4] for view, k in views.items()},
            angles={view: table[k, :, 4] for view, k in views.items()},
            T_cam_board={
                view: self.params.T_cam_rig[i] @ self.params.T_rig_board[k]
                for view, k in views.items()
            },
            cv_error_px=cv_error_px,
            intrinsics=self.params.intrinsics[i],
            covariance=self.covariance[own, own],
            sigma_px=self.sigma_px,
            name=name,
        )
