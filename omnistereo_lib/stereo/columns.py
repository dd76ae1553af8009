"""Ranges of columns of a panorama, (start, width), which may go on beyond the ±180° seam."""

import numpy as np
from numpy.typing import NDArray


def circular_span(visible: NDArray[np.bool_]) -> tuple[int, int]:
    """Return the shortest (start, width) around the circle that covers every True of a row."""
    columns = np.flatnonzero(visible)
    if len(columns) == 0:
        return 0, 0
    # The widest gap between two columns, around the circle, is what the span leaves out.
    gaps = np.diff(np.append(columns, columns[0] + len(visible)))
    widest = int(np.argmax(gaps))
    start = int(columns[(widest + 1) % len(columns)])
    return start, len(visible) - int(gaps[widest]) + 1


def split_at_seam(start: int, width: int, total: int) -> list[tuple[int, int]]:
    """Split the columns [start, start + width) around the seam into ranges [first, stop)."""
    ranges = [(start, min(start + width, total)), (0, start + width - total)]
    return [(first, stop) for first, stop in ranges if stop > first]


def common_columns(a: tuple[int, int], b: tuple[int, int], W: int) -> list[tuple[int, int]]:
    """Return the (start, width) strips in the intersection of two ranges of W columns."""
    column = np.arange(W)
    common = ((column - a[0]) % W < a[1]) & ((column - b[0]) % W < b[1])
    if common.all():
        return [(0, W)]
    # A strip starts where the column before is not common, and ends where the next one is not.
    starts = np.flatnonzero(common & ~np.roll(common, 1))
    ends = np.flatnonzero(common & ~np.roll(common, -1))
    return [(int(s), int(((ends - s) % W).min()) + 1) for s in starts]
