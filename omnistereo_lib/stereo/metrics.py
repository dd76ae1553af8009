"""Errors of a depth panorama (paper, Section IV, Eq. 5 and Table II)."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.arrays import as_array
from omnistereo_lib.errors import OmnistereoError, check_number

_FRACTIONS = tuple(np.linspace(0, 0.95, 20))


def error_map(index: ArrayLike, gt_index: ArrayLike, num_spheres: int) -> NDArray[np.float64]:
    """Return the error e(p) = 100/N · |n*(p) - n̂(p)| in percent of the swept range (Eq. 5).

    The ground-truth index is not rounded; only training labels are.
    """
    index, gt_index = as_array(index, "index"), as_array(gt_index, "gt_index")
    check_number(num_spheres, "num_spheres", 1, np.inf)
    if index.shape != gt_index.shape:
        raise OmnistereoError(
            f"the estimate has shape {index.shape}, the ground truth {gt_index.shape}; expected one"
        )
    return 100.0 / num_spheres * np.abs(index - gt_index)


def index_error(
    index: ArrayLike, gt_index: ArrayLike, num_spheres: int, valid: ArrayLike | None = None
) -> dict[str, float]:
    """Return the five metrics of the paper for one panorama (Table II, from the errors of Eq. 5).

    Args:
        index (array, shape (H, W)): Estimated sphere index n*; NaN is an error of 100 %.
        gt_index (array, shape (H, W)): Ground-truth index n̂, not rounded. Rays with n̂ outside [0,
            N) or NaN are not evaluated.
        num_spheres: N.
        valid (bool array, shape (H, W)): Rays to evaluate.

    Returns:
        dict: ">1", ">3", ">5": percent of rays with a larger error; "MAE", "RMS": mean and root
            mean square of the error. All NaN if there is no ray to evaluate.

    Raises:
        OmnistereoError: If index, gt_index and valid differ in shape.

    >>> metrics = osl.index_error(index=[[10, 12]], gt_index=[[10, 10]], num_spheres=100)
    >>> metrics[">1"], metrics["MAE"]
    (50.0, 1.0)
    """
    gt_index = as_array(gt_index, "gt_index")
    error = error_map(index, gt_index, num_spheres)
    # A ray without an estimate is wrong, or a method could leave out what is difficult.
    error = np.where(np.isnan(error), 100.0, error)
    valid = np.ones(error.shape, bool) if valid is None else as_array(valid, "valid") != 0
    if valid.shape != error.shape:
        raise OmnistereoError(
            f"valid has shape {valid.shape}; expected that of the panorama, {error.shape}"
        )
    error = error[valid & (gt_index >= 0) & (gt_index < num_spheres)]
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
    """Return the sparsification curve: the mean error after removing the least confident rays.

    The difference of the two areas is known as AUSE (Hu & Mordohai 2012). The areas are NaN if all
    errors are 0; everything is NaN without a finite ray.

    Args:
        error, confidence (arrays of the same shape): Rays where either is not finite are ignored.
        fractions: Fractions of rays removed, increasing, in [0, 1).

    Returns:
        curve (array, shape (len(fractions),)): Mean error of the remaining rays.
        auc: Area under the curve, divided by the area without sorting: 1 for a random confidence.
        oracle_auc: The same of an oracle that removes the largest errors first.

    Raises:
        OmnistereoError: If error and confidence differ in size.

    >>> from omnistereo_lib.stereo.metrics import sparsification
    >>> confidence = [0.1, 0.2, 0.3, 0.4]
    >>> curve, auc, oracle_auc = sparsification([4.0, 3.0, 2.0, 1.0], confidence, [0, 0.5])
    >>> curve.tolist(), auc == oracle_auc  # the confidence is as good as can be
    ([2.5, 1.5], True)
    """
    error = np.asarray(error, np.float64).ravel()
    confidence = np.asarray(confidence, np.float64).ravel()
    if error.shape != confidence.shape:
        raise OmnistereoError(
            f"there are {error.size} errors and {confidence.size} confidences; expected as many"
        )
    # Without a finite ray, or without any error, there is no area to divide by.
    finite = np.isfinite(error) & np.isfinite(confidence)
    error, confidence = error[finite], confidence[finite]
    fractions = np.asarray(fractions, np.float64)
    if not error.any():
        return np.full(len(fractions), 0.0 if len(error) else np.nan), np.nan, np.nan

    def curve(score: NDArray[np.float64]) -> NDArray[np.float64]:
        # The mean of the first k errors, for all k at once; then those k that remain.
        ordered = error[np.argsort(-score, kind="stable")]
        means = np.cumsum(ordered) / np.arange(1, len(ordered) + 1)
        return means[np.maximum(np.round((1 - fractions) * len(ordered)).astype(int), 1) - 1]

    # Areas, relative to that of a random order.
    by_confidence = curve(confidence)
    unsorted = error.mean() * (fractions[-1] - fractions[0])
    auc = np.trapezoid(by_confidence, fractions) / unsorted
    oracle_auc = np.trapezoid(curve(-error), fractions) / unsorted
    return by_confidence, float(auc), float(oracle_auc)
