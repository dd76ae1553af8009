"""Errors of a depth panorama, as the paper's table prints them (Section IV, Eq. 5)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.errors import OmnistereoError

_FRACTIONS = tuple(np.linspace(0, 0.95, 20))


def error_map(index: ArrayLike, gt_index: ArrayLike, num_spheres: int) -> NDArray[np.float64]:
    """Return e(p) = 100/N · |n*(p) - n̂(p)| (Eq. 5): percent of the range swept, same shape as the maps.

    The ground-truth index is not rounded; rounding is for training labels only.
    """
    index, gt_index = np.asarray(index, np.float64), np.asarray(gt_index, np.float64)
    if index.shape != gt_index.shape:
        raise OmnistereoError(f"the estimate has shape {index.shape}, the ground truth {gt_index.shape}")
    return 100.0 / num_spheres * np.abs(index - gt_index)


def index_error(
    index: ArrayLike, gt_index: ArrayLike, num_spheres: int, valid: ArrayLike | None = None
) -> dict[str, float]:
    """Return the paper's five figures for one panorama.

    Parameters
    ----------
    index : array, shape (H, W)
        Estimated sphere index n*; NaN where there is no estimate, which counts as the largest error, N.
    gt_index : array, shape (H, W)
        Ground-truth index n̂, not rounded. Rays outside 0 ≤ n̂ < N or NaN are not evaluated.
    num_spheres : int
        N.
    valid : bool array, shape (H, W), optional
        Rays to evaluate among those.

    Returns
    -------
    dict
        ">1", ">3", ">5": percent of rays whose error exceeds that; "MAE", "RMS": mean and root mean square
        of the error. All NaN where no ray is valid.

    Raises
    ------
    OmnistereoError
        If the maps differ in shape.
    """
    gt_index = np.asarray(gt_index, np.float64)
    error = error_map(index, gt_index, num_spheres)
    error = np.where(np.isnan(error), 100.0, error)
    evaluated = (gt_index >= 0) & (gt_index < num_spheres)
    if valid is not None:
        evaluated &= np.asarray(valid, bool)
    error = error[evaluated]
    if error.size == 0:
        return dict.fromkeys((">1", ">3", ">5", "MAE", "RMS"), np.nan)
    return {
        **{f">{limit}": 100.0 * float(np.mean(error > limit)) for limit in (1, 3, 5)},
        "MAE": float(error.mean()),
        "RMS": float(np.sqrt(np.mean(error**2))),
    }


def sparsification(
    error: ArrayLike, confidence: ArrayLike, fractions: ArrayLike = _FRACTIONS
) -> tuple[NDArray[np.float64], float, float]:
    """Judge a confidence: the mean error that is left when the least confident rays are removed.

    Parameters
    ----------
    error, confidence : arrays of the same shape
        Rays where either is NaN are left out.
    fractions : sequence of float
        Shares of rays removed, growing, in [0, 1).

    Returns
    -------
    curve : array, shape (len(fractions),)
        Mean error of the remaining rays.
    area, best : float
        Area under the curve over the fractions, and the area that sorting by the error itself would
        give, both divided by the area without sorting: 1 is a useless confidence, `best` the limit.
        (Hu & Mordohai 2012; the area between the two is known as AUSE.)
    """
    error, confidence = np.asarray(error, np.float64).ravel(), np.asarray(confidence, np.float64).ravel()
    if error.shape != confidence.shape:
        raise OmnistereoError(f"{error.size} errors and {confidence.size} confidences: the shapes must agree")
    known = np.isfinite(error) & np.isfinite(confidence)
    error, confidence = error[known], confidence[known]
    fractions = np.asarray(fractions, np.float64)

    def curve(score: NDArray[np.float64]) -> NDArray[np.float64]:
        kept = error[np.argsort(-score, kind="stable")]
        means = np.cumsum(kept) / np.arange(1, len(kept) + 1)
        return means[np.maximum(np.round((1 - fractions) * len(kept)).astype(int), 1) - 1]

    by_confidence = curve(confidence)
    flat = error.mean() * (fractions[-1] - fractions[0])
    area = np.trapezoid(by_confidence, fractions) / flat
    best = np.trapezoid(curve(-error), fractions) / flat
    return by_confidence, float(area), float(best)
