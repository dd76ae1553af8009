"""Semi-global matching of a cost volume, across the ±180° seam (H. Hirschmüller, TPAMI 2008).

A cost volume states how badly each sphere n fits each ray p, independently of the other rays.
Neighbouring rays mostly see the same surface, so SGM follows straight paths r over the panorama,
and every pixel passes on the costs collected along the path (paper, Section III-B and IV)::

    L_r(p, n) = C(p, n) + min(L_r(p−r, n), L_r(p−r, n±1) + P1, min_k L_r(p−r, k) + P2) − min_k
    L_r(p−r, k)
    S(p, n)   = Σ_r L_r(p, n)

P1 is the price of one step in n (a slanted surface), P2 that of any jump (an edge). The code writes
the right-hand side as C(p, n) + M(n), where M is the *message* from p−r: 0 at the best sphere, at
most P2. A path starts with M = 0.

An unknown cell (NaN) has no data term. In the recurrence it takes the mean cost of the known cells
of its ray: it is neither better nor worse than the other spheres, and the messages decide. A ray
without known cells is like one of constant cost. Unknown cells are NaN in S, never the best sphere.
"""

from numbers import Real

import numpy as np
import torch
from torch import Tensor

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.stereo.kernels import sgm_numba
from omnistereo_lib.stereo.kernels.sgm_numba import LARGEST
from omnistereo_lib.stereo.volume import as_volume


def sgm(
    volume: Tensor | np.ndarray,
    p1: float = 0.1,
    p2: float = 12.0,
    paths: int = 8,
    wrap: bool = True,
) -> Tensor:
    """Aggregate a cost volume by semi-global matching: S = Σ_r L_r (paper, Section III-B).

    Args:
        volume (shape (H, W, N)): Matching cost C, lower is better; NaN is unknown. In float32.
        p1, p2: Penalties for a step of one sphere and for any larger jump, in units of the cost,
            0 ≤ p1 ≤ p2.
        paths: 4 (along rows and columns) or 8 (diagonals as well).
        wrap: True: column 0 follows column W−1, for diagonals as well. A row then has no first
            pixel. It runs in laps around the panorama, starting at column 0 (leftward: W−1) with M
            = 0, each lap with the last message of the lap before, until a lap changes nothing.
            Images take two or three laps, of which the later ones end early. The laps stop after
            ``MAX_LAPS``: a row with hardly any texture may take P2 / (gap between the best and the
            next cost) of them, and a row of a few pixels may alternate for ever. False: the flat
            image of the textbook.

    Returns:
        (H, W, N) float32 tensor on the device of the volume: S, with C ≤ L_r ≤ C + P2 for each
        path, not divided by the number of paths; NaN where the volume is NaN.

    Note:
        The CPU version uses ``torch.get_num_threads()`` threads; results do not depend on their
        number. It needs one more volume of memory. The volume of a GPU goes to the CPU and back.

    Raises:
        OmnistereoError: If the volume is not 3-D, has fewer than 2 spheres or infinite costs, or
            p1, p2 or paths is out of range.

    >>> volume = np.ones((5, 8, 6), np.float32)
    >>> volume[..., 3] = 0  # every ray at sphere 3,
    >>> volume[2, 4, 3], volume[2, 4, 0] = 0.5, 0.4  # but for noise at one
    >>> int(volume[2, 4].argmin()), int(osl.sgm(volume, p1=0.1, p2=1.0)[2, 4].argmin())
    (0, 3)
    """
    volume = as_volume(volume)
    if paths not in (4, 8):
        raise OmnistereoError(f"sgm: paths is {paths!r}; expected 4 or 8")
    if not (isinstance(p1, Real) and isinstance(p2, Real) and 0 <= p1 <= p2 < LARGEST):
        raise OmnistereoError(
            f"sgm: penalties are p1 = {p1!r}, p2 = {p2!r}; expected finite numbers, 0 ≤ p1 ≤ p2"
        )
    cost = volume.to("cpu", torch.float32).contiguous().numpy()
    total, too_large = sgm_numba.sum_paths(cost, np.float32(p1), np.float32(p2), paths, wrap)
    if too_large:
        raise OmnistereoError(
            f"sgm: a cost is infinite, or {LARGEST:g} or more. Set unknown cells to NaN."
        )
    return total.to(volume.device)
