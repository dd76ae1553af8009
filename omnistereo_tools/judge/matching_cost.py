"""How well images match along the rays of a rig: the first sign of a rig that does not fit them."""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from omnistereo_lib import reference
from omnistereo_lib.geometry.rig import Pair, camera_pairs
from omnistereo_lib.stereo.cost import BlockCost
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_lib.stereo.volume import cost_volume
from omnistereo_lib.stereo.zncc import ZNCC

_WINDOW = 9  # px
_FEW_CELLS = 200_000  # are soon compared, and the fast ZNCC would first be compiled, for seconds
_NO_OVERLAP = 0.5  # cost of a patch without texture, which is no evidence for or against a match


class _PlainZNCC(BlockCost):
    """ZNCC by its definition."""

    def __call__(
        self, spherical_images: Tensor, pairs: Sequence[Pair], columns: Sequence[tuple[int, int]] | None = None
    ) -> Tensor:
        images = spherical_images.double()
        costs = torch.stack([reference.zncc(images[i], images[j], _WINDOW) for i, j in pairs])
        return reference.mean_over_pairs(costs).float().permute(1, 2, 0)


def matching_cost(sweep: SphereSweep, images: Sequence[ArrayLike], rays: NDArray[np.bool_] | None = None) -> float:
    """Return the median of the best raw ZNCC cost over rays (H, W), or all, in [0, 1]; 0.5 if no pair shares a view."""
    valid = [sweep.project_sphere(camera, 0)[1] for camera in range(len(sweep.rig))]
    if not any((valid[i] & valid[j]).any() for i, j in camera_pairs("ring", sweep.rig)):
        return _NO_OVERLAP
    few = sweep.grid.width * sweep.grid.height * sweep.grid.num_spheres < _FEW_CELLS
    volume = cost_volume(sweep, images, _PlainZNCC() if few else ZNCC(_WINDOW))
    lowest = torch.where(volume.isnan(), torch.inf, volume).amin(-1)
    chosen = lowest.isfinite() if rays is None else lowest.isfinite() & torch.from_numpy(rays)
    return float(lowest[chosen].median()) if chosen.any() else _NO_OVERLAP
