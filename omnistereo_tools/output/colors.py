"""Depth in colours. Light to import, for notebooks: it knows grids, not how depth is found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.geometry.sphere import SphereGrid

BACKGROUND = 0x20  # colours stand out, and what no camera sees does not dazzle
_FADE, _GRAY = 0.65, 0x80  # of what is doubtful, towards
_GAMMA = 0.6


def colorize_depth(inverse_depth: ArrayLike, grid: SphereGrid) -> NDArray[np.uint8]:
    """Return a colour image of inverse depth: near is bright and warm, far is dark, unknown is
    striped grey.

    Args:
        inverse_depth: array, shape (H, W), 1/m, NaN unknown
        grid: The nearest sphere has the brightest colour.

    Returns:
        uint8 array, shape (H, W, 3), RGB
    """
    inverse_depth = np.asarray(inverse_depth)
    level = np.clip(256 * np.nan_to_num(inverse_depth) * grid.min_depth, 0, 255).astype(np.uint8)
    # The lightness of Inferno is monotonic, so it works in grey print and for colour-blind readers.
    colors = cv2.cvtColor(cv2.applyColorMap(level, cv2.COLORMAP_INFERNO), cv2.COLOR_BGR2RGB)
    rows, columns = np.nonzero(~np.isfinite(inverse_depth))
    colors[rows, columns] = np.where((rows + columns) // 4 % 2, 170, 200)[:, None]
    return np.asarray(colors, np.uint8)


def faded(
    colors: NDArray[np.uint8], doubtful: NDArray[Any], towards: int = BACKGROUND
) -> NDArray[np.uint8]:
    """Return colours (..., 3), drawn towards a gray value as they are doubtful (...), 0 to 1."""
    return (colors + (_FADE * doubtful[..., None]) * (np.float32(towards) - colors)).astype(
        np.uint8
    )


@dataclass(frozen=True)
class ColorScale:
    """Range of inverse depth in 1/m that the colours of a depth picture are stretched to."""

    low: float
    high: float

    @classmethod
    def of(cls, inverse_depth: NDArray[Any]) -> ColorScale:
        """Return the range without the outermost percent on either side."""
        known = inverse_depth[np.isfinite(inverse_depth)]
        low, high = np.percentile(known, [1, 99]) if known.size else (0.0, 1.0)
        low = 0.0 if low < 0.02 * high else float(low)  # the sky is part of the scale
        return cls(low, float(max(high, low + 1e-3)))

    def colorize(
        self, inverse_depth: NDArray[Any], doubtful: NDArray[Any] | None = None
    ) -> NDArray[np.uint8]:
        """Return inverse depth (H, W) in colours, (H, W, 3) RGB, doubtful rays faded."""
        level = (inverse_depth - self.low) / (self.high - self.low)
        # Gamma brightens what is far: by inverse depth all beyond some ten metres would be black.
        colors = colorize_depth(np.clip(level, 0, 1) ** _GAMMA, SphereGrid(2, 2, min_depth=1.0))
        return colors if doubtful is None else faded(colors, doubtful, _GRAY)

    def bar(self, width: int) -> NDArray[np.uint8]:
        """Return the colours from `low` to `high` as a picture of one row, (1, width, 3) RGB."""
        return self.colorize(np.linspace(self.low, self.high, width)[None])

    def ticks(self) -> list[tuple[float, str]]:
        """Return places in [0, 1] and labels in metres, far to near, at least a tenth apart."""
        depths = [
            np.inf,
            *(digit * 10.0**k for k in (2, 1, 0, -1, -2) for digit in (7, 5, 4, 3, 2, 1.5, 1)),
        ]
        chosen: list[tuple[float, str]] = []
        for depth in depths:
            at = (1 / depth - self.low) / (self.high - self.low)
            if -1e-6 <= at <= 1 and (not chosen or at - chosen[-1][0] > 1 / 10):
                chosen.append((float(at), "∞" if depth == np.inf else f"{depth:g} m"))
        # the near end, which what is nearer shows, too
        if not chosen or chosen[-1][0] < 0.85:
            chosen.append((1.0, f"{1 / self.high:.2g} m"))
        return chosen
