"""The paths of SGM on a GPU, in Triton: one program per scanline, its message in registers.

A scanline is one path over the panorama: a row, or a line that starts in the first (or last) row
and moves by 0 or ±1 column per row. Scanlines of one direction never share a pixel, so a launch per
direction adds to S without atomics.
"""

import torch
import triton
import triton.language as tl
from torch import Tensor


@triton.jit
def _step(cost, message, sphere, p1, p2, BLOCK: tl.constexpr):
    """Extend a path by one pixel: L = C + M and the next message (the recurrence of `sgm`)."""
    # Infinite beyond the last sphere, whose cost is.
    path = cost + message
    lowest = tl.min(path, 0)
    # L(n - 1) and L(n + 1), which are infinite beyond either end.
    below = tl.where(sphere > 0, tl.gather(path, tl.maximum(sphere - 1, 0), 0), float("inf"))
    above = tl.where(
        sphere < BLOCK - 1, tl.gather(path, tl.minimum(sphere + 1, BLOCK - 1), 0), float("inf")
    )
    following = tl.minimum(path, tl.minimum(tl.minimum(below, above) + p1, lowest + p2)) - lowest
    return path, following


@triton.jit
def _scan_rows(cost, total, W, N, p1, p2, laps, leftward: tl.constexpr, BLOCK: tl.constexpr):
    """Add the L of one row: laps around the panorama until the message repeats, then one counts.

    cost, total: pointers to (H, W, N); program k scans row k.
    """
    sphere = tl.arange(0, BLOCK)
    inside = sphere < N
    row = tl.program_id(0).to(tl.int64) * W * N
    message = tl.zeros([BLOCK], tl.float32)
    # Laps that only carry the message around.
    lap, changed = 1, 1
    while (lap < laps) & (changed > 0):
        before = message
        for i in range(W):
            x = W - 1 - i if leftward else i
            c = tl.load(cost + row + x * N + sphere, inside, float("inf"))
            _, message = _step(c, message, sphere, p1, p2, BLOCK)
        changed = tl.max(tl.where(message != before, 1, 0), 0)
        lap += 1
    # The lap whose path counts.
    for i in range(W):
        x = W - 1 - i if leftward else i
        cell = row + x * N + sphere
        path, message = _step(
            tl.load(cost + cell, inside, float("inf")), message, sphere, p1, p2, BLOCK
        )
        tl.store(total + cell, tl.load(total + cell, inside) + path, inside)


@triton.jit
def _scan_lines(
    cost,
    total,
    H,
    W,
    N,
    p1,
    p2,
    up: tl.constexpr,
    slope: tl.constexpr,
    wrap: tl.constexpr,
    BLOCK: tl.constexpr,
):
    """Add the L of one line from the first row down (or up), `slope` columns right per row."""
    sphere = tl.arange(0, BLOCK)
    inside = sphere < N
    message = tl.zeros([BLOCK], tl.float32)
    x = tl.program_id(0).to(tl.int64)
    for step in range(H):
        y = H - 1 - step if up else step
        cell = (y * W + x) * N + sphere
        path, message = _step(
            tl.load(cost + cell, inside, float("inf")), message, sphere, p1, p2, BLOCK
        )
        tl.store(total + cell, tl.load(total + cell, inside) + path, inside)
        x = (x + W + slope) % W
        # a line that leaves the flat image enters it on the other side as a new one
        if not wrap and slope != 0:
            message = tl.where(x == (0 if slope > 0 else W - 1), 0.0, message)


def sum_paths(cost: Tensor, p1: float, p2: float, paths: int, wrap: bool, max_laps: int) -> Tensor:
    """Return Σ_r L_r of known, finite costs (H, W, N) on a GPU; arguments as in `sgm`."""
    total = torch.zeros_like(cost)
    H, W, N = cost.shape
    BLOCK = triton.next_power_of_2(N)
    # A reduction within a warp needs no barrier.
    one = {"num_warps": 1}
    for leftward in (False, True):
        _scan_rows[(H,)](cost, total, W, N, p1, p2, max_laps if wrap else 1, leftward, BLOCK, **one)
    for up in (False, True):
        for slope in (0, 1, -1) if paths == 8 else (0,):
            _scan_lines[(W,)](cost, total, H, W, N, p1, p2, up, slope, wrap, BLOCK, **one)
    return total
