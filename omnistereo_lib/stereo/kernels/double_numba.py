"""A step up in VolumeNet's U-net on a CPU: doubled and added in one pass, in bfloat16."""

from functools import partial
from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor

from omnistereo_lib.stereo.kernels.compiled import compiled
from omnistereo_lib.stereo.threads import map_threads


def add_doubled(level: Tensor, x: Tensor) -> Tensor:
    """Add `volumenet.double` of x (B, C, w, h, n) to a level (B, C, 2w, 2h, 2n) in place.

    Both are bfloat16, the level channels last in memory. Torch's copy, interpolation and sum have
    the same bits; they take three times as long: 16 channels of 320 × 80 × 48 90 ms of one core, 33
    here.
    """
    # As oneDNN returns it; where it is switched off, this is a copy.
    x = x.contiguous(memory_format=torch.channels_last_3d)
    for fine, coarse in zip(level, x, strict=True):
        # the bits, as they lie in memory: (2w, 2h, 2n · C) and (w, h, n · C)
        into, of = (
            one.permute(1, 2, 3, 0).view(torch.uint16).view(*one.shape[1:3], -1).numpy()
            for one in (fine, coarse)
        )
        list(map_threads(partial(_add_column, into, of, len(fine)), range(len(into))))
    return level


@numba.njit(forceinline=True)
def _float(bits: Any) -> Any:
    """Return the float32 of a bfloat16."""
    return np.uint32(np.uint32(bits) << np.uint32(16)).view(np.float32)


@numba.njit(forceinline=True)
def _rounded(x: Any) -> Any:
    """Return the bfloat16 nearest to a float32, the even one of two."""
    bits = np.float32(x).view(np.uint32)
    half = np.uint32(0x7FFF) + (bits >> np.uint32(16) & np.uint32(1))
    return np.uint16((bits + half) >> np.uint32(16))


@compiled(nogil=True, error_model="numpy", fastmath={"contract"})
def _add_column(level: Any, x: Any, C: int, column: int) -> None:
    """Add a column of doubled x; between two cells, three quarters are of the nearer one."""
    (w, h, size), near, far = x.shape, np.float32(0.75), np.float32(0.25)
    # Circular in θ; in φ and along the ray the cells at the ends continue.
    a, side = column // 2, 2 * (column % 2) - 1
    b, ray = (a + side) % w, np.empty(size + 2 * C, np.float32)
    for y in range(2 * h):
        i = y // 2
        j = min(max(i + 2 * (y % 2) - 1, 0), h - 1)
        p, q, r, s, out = x[a, i], x[b, i], x[a, j], x[b, j], level[column, y]
        for k in range(size):
            upper = near * _float(p[k]) + far * _float(q[k])
            lower = near * _float(r[k]) + far * _float(s[k])
            ray[C + k] = near * upper + far * lower
        ray[:C], ray[size + C :] = ray[C : 2 * C], ray[size : size + C]
        for k in range(0, size, C):
            before, at, after = ray[k : k + C], ray[k + C : k + 2 * C], ray[k + 2 * C : k + 3 * C]
            even, odd = out[2 * k : 2 * k + C], out[2 * k + C : 2 * k + 2 * C]
            for c in range(C):
                # rounded twice, as torch does
                middle = near * at[c]
                one, other = _rounded(middle + far * before[c]), _rounded(middle + far * after[c])
                even[c] = _rounded(_float(even[c]) + _float(one))
                odd[c] = _rounded(_float(odd[c]) + _float(other))
