"""How well images match along the rays of a rig: the first sign of a rig that does not fit them."""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.geometry.rig import Pairs, camera_pairs
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_lib.stereo.volume import cost_volume
from omnistereo_lib.stereo.zncc import ZNCC

_NO_OVERLAP = 0.5  # cost of a patch without texture, which is no evidence for or against a match


def matching_cost(
    sweep: SphereSweep, images: Sequence[ArrayLike], pairs: Pairs = "ring", rays: NDArray[np.bool_] | None = None
) -> float:
    """Return the median of the best raw ZNCC cost over rays (H, W), or all, in [0, 1]; 0.5 if no pair shares a view."""
    valid = [sweep.project_sphere(camera, 0)[1] for camera in range(len(sweep.rig))]
    if not any((valid[i] & valid[j]).any() for i, j in camera_pairs(pairs, sweep.rig)):
        return _NO_OVERLAP
    volume = cost_volume(sweep, images, ZNCC(window=9), pairs)
    lowest = torch.where(volume.isnan(), torch.inf, volume).amin(-1)
    chosen = lowest.isfinite() if rays is None else lowest.isfinite() & torch.from_numpy(rays)
    return float(lowest[chosen].median()) if chosen.any() else _NO_OVERLAP
