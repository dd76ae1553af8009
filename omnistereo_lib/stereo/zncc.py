"""ZNCC, the matching cost without training (paper, Section III-B and IV)."""

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import ClassVar

import torch
from torch import Tensor

from omnistereo_lib import reference
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.rig import Pair
from omnistereo_lib.stereo.cost import BlockCost
from omnistereo_lib.stereo.kernels import zncc_numba


@dataclass(frozen=True)
class ZNCC(BlockCost):
    """Zero-mean normalised cross-correlation as a cost (1 - ZNCC)/2 in [0, 1] (paper, Section IV).

    A patch holds the pixels of the window that are visible to both cameras; it continues across the
    ±180° seam. A patch without texture costs 0.5: neither match nor mismatch.

    Raises:
        OmnistereoError: If the window is not None or an odd number of at least 3.

    >>> import torch
    >>> image = torch.rand(16, 64, 1)  # (H, W, spheres): two cameras that see the same
    >>> float(osl.ZNCC(window=5)(torch.stack([image.permute(2, 0, 1)] * 2), [(0, 1)]).max()) < 1e-3
    True
    """

    #: side of the window in pixels, odd, at least 3; None: that of `default_window`
    window: int | None = None
    one_thread: ClassVar[bool] = True

    def __post_init__(self) -> None:
        window = self.window
        if window is not None and (
            not isinstance(window, Integral) or window < 3 or window % 2 == 0
        ):
            raise OmnistereoError(
                f"the ZNCC window is {window!r}; expected an odd number of at least 3"
            )

    def __call__(
        self,
        spherical_images: Tensor,
        pairs: Sequence[Pair],
        columns: Sequence[tuple[int, int]] | None = None,
    ) -> Tensor:
        """Return the mean cost over camera pairs of a block of spheres, (H, W, B); see `BlockCost`.

        Raises an `OmnistereoError` if the window is larger than the panorama.
        """
        H, W = spherical_images.shape[-2:]
        window = default_window(W) if self.window is None else self.window
        if window > min(H, W):
            raise OmnistereoError(
                f"the ZNCC window is {window}; expected at most the panorama size {W} × {H}. Use a"
                " smaller window."
            )
        if spherical_images.device.type == "cpu":
            return zncc_numba.mean_costs(spherical_images, pairs, window, columns)
        # In float64: in float32 the variance of a bright, flat patch would be rounding error.
        views = ((spherical_images[i].double(), spherical_images[j].double()) for i, j in pairs)
        costs = [reference.zncc(left, right, window).float() for left, right in views]
        return reference.mean_over_pairs(torch.stack(costs)).permute(1, 2, 0)


def default_window(width: int) -> int:
    """Return the side of ZNCC's window for W columns: the paper's 9 at 1200, 7 at 640, 5 at 320.

    It is the odd number nearest to 9 √(W / 1200), at least 5 and never larger than the paper's. A
    window of 9 would be 10° wide at 320 columns, and hold more than one depth. Chosen on held-out
    frames of the training sets; see notebook 05.
    """
    side = 9 * min(width / 1200, 1.0) ** 0.5
    return max(2 * round((side - 1) / 2) + 1, 5)
