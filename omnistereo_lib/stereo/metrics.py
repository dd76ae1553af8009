"""Errors of a depth panorama (paper, Section IV, Eq. 5 and Table II)."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.arrays import as_array
from omnistereo_lib.errors import OmnistereoError, check_number


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
