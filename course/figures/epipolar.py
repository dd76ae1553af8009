"""Epipolar planes in space, and what a rig with a wrong pose makes of them on its sphere."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from course.figures.drawings import FIRST, POINT, SECOND, Point, _arrow, _camera, _canvas, _line
from omnistereo_lib.geometry.pose import Pose


def epipolar_plane() -> Figure:
    """Draw two cameras and the plane of ray x: ray y in it (left), and above it (right)."""
    fig, panels = _canvas(10, 2.7, panels=2)

    def on_floor(right: float, back: float, up: float = 0.0) -> Point:
        return np.array([right + 0.45 * back, 0.38 * back + up])

    one, two = on_floor(0, 0), on_floor(4, 0)
    for ax, up in zip(panels, (0.0, 1.0), strict=True):
        ax.add_patch(
            Polygon(
                [on_floor(*corner) for corner in ((-1, -1), (5, -1), (5, 5), (-1, 5))], color="0.92"
            )
        )
        meet, end, tip = on_floor(2.2, 3), on_floor(2.9, 3.95), on_floor(1.6, 4, 1.33 * up)
        _line(ax, one, two, color="0.4", lw=1.2)
        _arrow(ax, one, end, FIRST)
        ax.annotate("$R\\,x$", end, (6, -4), textcoords="offset points", color=FIRST)
        _arrow(ax, two, tip, SECOND)
        ax.annotate("$y$", tip, (-12, 0), textcoords="offset points", color=SECOND)
        _arrow(ax, on_floor(-0.5, 2), on_floor(-0.5, 2, 1.1), "0.35")
        ax.annotate(
            "$n = t \\times R\\,x$", on_floor(-0.5, 2, 1.15), ha="center", va="bottom", color="0.35"
        )
        ax.annotate("baseline $t$", on_floor(2, -0.2), ha="center", va="top", color="0.4")
        _camera(ax, tuple(one), "camera 1", FIRST)
        _camera(ax, tuple(two), "camera 2", SECOND)
        if up:
            _line(ax, two, on_floor(1.6, 4), color=SECOND, ls=":")
            _line(ax, tip, on_floor(1.6, 4), color=POINT, lw=2)
            middle = (tip + on_floor(1.6, 4)) / 2
            ax.annotate("miss", middle, (5, 0), textcoords="offset points", color=POINT)
        else:
            ax.plot(*meet, "o", color=POINT, zorder=3)
        ax.set(xlim=(-1.6, 7.4), ylim=(-0.6, 3.1))
    return fig


def draw_misses(
    ax: Axes, T_rig_a: Pose, T_rig_b: Pose, x: NDArray[Any], y: NDArray[Any], times: float = 10.0
) -> None:
    """Draw matched rays on the rig's sphere, over the epipolar great circles of the two cameras.

    A match is a dot where camera b sees the point, a blue line to where camera a does, and a red
    line from the dot to the great circle of ray x, lengthened.

    Args:
        T_rig_a, T_rig_b: Poses of the cameras.
        x, y: Unit rays (M, 3) of the two cameras, each in its own frame.
        times: By how much the red lines are lengthened.
    """
    baseline = T_rig_b.t - T_rig_a.t
    baseline = baseline / np.linalg.norm(baseline)
    seen_a, seen_b = x @ T_rig_a.R.T, y @ T_rig_b.R.T
    normals = np.cross(baseline, seen_a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    missed = np.arcsin(np.sum(normals * seen_b, axis=1))
    side = np.cross(baseline, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    around, along = (
        np.radians(np.arange(0, 360, 6))[:, None, None],
        np.linspace(0.02, np.pi - 0.02, 400)[:, None],
    )
    across = np.cos(around) * side + np.sin(around) * np.cross(baseline, side)
    circles = np.cos(along) * baseline + np.sin(along) * across
    ax.add_collection(LineCollection(list(_angles(circles)), color="0.85", lw=0.7, zorder=0))
    for start, end, color in (
        (seen_a, seen_b, "C0"),
        (seen_b, seen_b - normals * times * missed[:, None], "C3"),
    ):
        ax.add_collection(
            LineCollection(list(_angles(np.stack([start, end], axis=1))), color=color, lw=1)
        )
    ax.plot(*_angles(seen_b[None])[0].T, "k.", ms=3)
    ax.set(xlabel="θ [°]", ylabel="φ [°]", aspect="equal")


def _angles(lines: NDArray[Any]) -> NDArray[Any]:
    """Return θ, 0° to 360°, and φ of lines of rays (K, L, 3): (K, L, 2), NaN at the seam."""
    x, y, z = np.moveaxis(lines, -1, 0)
    theta, phi = np.degrees(np.arctan2(x, z)) % 360, np.degrees(np.arctan2(y, np.hypot(x, z)))
    jumps = np.abs(np.diff(theta, axis=1, prepend=theta[:, :1])) > 180
    return np.stack([np.where(jumps, np.nan, theta), phi], axis=-1)
