"""`overview.png`: panorama, depth, trust and point cloud on one page."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from numpy.typing import NDArray

from omnistereo_lib.stereo.depth import Depth
from omnistereo_tools.judge.trust import DOUBTFUL
from omnistereo_tools.output.pictures import ColorScale, draw_points, faded
from omnistereo_tools.output.points import PointCloud

_WIDTH = 18.8  # inches
_VIEW = (900, 506)  # px, of the points
_LETTERS = 92  # of a line of a note


def draw_overview(
    depth: Depth,
    panorama: NDArray[np.uint8],
    cloud: PointCloud,
    trust: NDArray[np.float32],
    title: str,
    notes: Sequence[str],
) -> Figure:
    """Return the page; doubtful rays and points are faded.

    Args:
        panorama: uint8 array, any size, RGB: the whole panorama, sharper than the depth
        trust: Of `trust.trust`, (H, W).
        title: What was computed and how, one line.
        notes: Sentences to stand below the trust.
    """
    first, last = depth.grid.phi_deg
    wide = _WIDTH * (last - first) / 360
    figure = Figure(figsize=(_WIDTH, 2 * wide + 8), layout="constrained")
    above, middle, below = figure.subfigures(3, 1, False, height_ratios=[wide + 0.4, wide + 1.2, 6.4])[:, 0]
    extent = (-180, 180, last, first)
    ax = above.subplots()
    ax.imshow(panorama, extent=extent)
    ax.set(title=title, xticks=range(-180, 181, 45), ylabel="elevation φ in degrees, down > 0")

    scale = ColorScale.of(depth.inverse_depth)
    ax = middle.subplots()
    ax.imshow(scale.colorize(depth, trust < DOUBTFUL), extent=extent, interpolation="nearest")
    ax.set(title="Depth along the ray; faded: doubtful, striped: unknown", xticks=range(-180, 181, 45))
    ax.set(xlabel="azimuth θ in degrees, 0 is forward", ylabel="elevation φ in degrees, down > 0")
    bar = middle.colorbar(ScalarMappable(cmap="inferno"), ax=ax, location="bottom", aspect=80, shrink=0.8)
    places, depths = zip(*scale.ticks(), strict=True)
    bar.set_ticks(places, labels=depths)

    left, right = below.subfigures(1, 2)
    sure, text = left.subplots(2, 1, height_ratios=[2, 3])
    shown = sure.imshow(trust, extent=extent, cmap="gray", vmin=0, vmax=1, interpolation="nearest")
    sure.set(title=f"Trust: confidence at equal range, below {DOUBTFUL:g} doubtful")
    sure.set(xticks=range(-180, 181, 90), ylabel="φ in degrees")
    left.colorbar(shown, ax=sure, pad=0.01)
    text.axis("off")
    text.text(0, 1, "\n\n".join(fill(note, _LETTERS) for note in notes), va="top", fontsize=11)
    view = right.subplots()
    view.imshow(draw_points(cloud.points, faded(cloud.colors, cloud.doubtful), _VIEW))
    view.set(title=f"{len(cloud.points)} points, from above and behind", xticks=[], yticks=[])
    return figure
