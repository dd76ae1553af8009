"""Figures of the page on notation, drawn from the sample data."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import omnistereo_lib as osl
from course.figures.plot import draw_panorama, draw_rig, encode
from omnistereo_lib.dataset import Dataset

SAMPLE = Path(__file__).resolve().parents[2] / "data_samples" / "sunny"
COLORS = "petroff6"  # a style of Matplotlib whose colours colour-blind readers can tell apart
SPHERES = 9
Point = tuple[float, float]


def draw_figures() -> dict[str, bytes]:
    """Return the figures as files, by name: PNG for lines, JPEG for photographs."""
    data = osl.load_dataset(SAMPLE, split="test")
    with style.context(COLORS):
        return {
            "rig.png": encode(_rig(data)),
            "camera.jpg": encode(_camera(data), "jpeg"),
            "panorama.jpg": encode(_panorama(data), "jpeg"),
            "spheres.png": encode(_spheres(data)),
        }


def _rig(data: Dataset) -> Figure:
    """Draw the rig from above, with its axes at the sweep centre."""
    fig, ax = _figure(7, 6)
    draw_rig(ax, data.rig.recentered())
    _axis(ax, (0, 0), (0.3, 0), "+x", "C5")
    _axis(ax, (0, 0), (0, 0.3), "+z", "C5")
    _inwards(ax, (0, 0), "+y", (-30, -20), "C5")
    ax.set(xlim=(-1.4, 1.4), ylim=(-1.4, 1.4))
    return fig


def _camera(data: Dataset) -> Figure:
    """Draw a fisheye image with the camera axes at its centre and the pixel axes at its corner."""
    camera, image = data.rig.cameras[0], data[0].images[0]
    fig, ax = _figure(7, 6.4)
    ax.imshow(image)
    _axis(ax, camera.center, (180, 0), "x", "w")
    _axis(ax, camera.center, (0, 180), "y", "w")
    _inwards(ax, camera.center, "z", (-28, 8), "w")
    _axis(ax, (0, 0), (160, 0), "u", "C1")
    _axis(ax, (0, 0), (0, 160), "v", "C1")
    ax.set(xlabel="u [px]", ylabel="v [px]")
    return fig


def _panorama(data: Dataset) -> Figure:
    """Draw the panorama at infinity with the axes of the rig and the directions of the cameras."""
    grid = osl.SphereGrid(1280, 320, (-45, 45), SPHERES, data.rig.min_depth)
    sweep = osl.SphereSweep(data.rig, grid)
    fig, ax = _figure(7, 2.6)
    draw_panorama(ax, np.nanmean(sweep.warp(data[0].images, 0), axis=0), grid)
    for theta, axis in ((-180, "−z"), (-90, "−x"), (0, "+z"), (90, "+x"), (180, "−z")):
        box = {"fc": "0.1", "ec": "none", "pad": 2}
        ax.text(theta, -38, axis, color="w", ha="center", va="center", bbox=box)
    _axis(ax, (0, 0), (0, 35), "+y", "w")
    for number, pose in enumerate(data.rig.T_rig_cam, start=1):
        x, y, z = pose.R[:, 2]
        theta, phi = np.degrees([np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))])
        ax.plot(theta, phi, "o", color=f"C{number - 1}", mec="w")
        ax.annotate(f"camera {number}", (theta, phi), (8, 8), textcoords="offset points", color="w")
    return fig


def _spheres(data: Dataset) -> Figure:
    """Draw a few spheres around the rig, from above."""
    grid = osl.SphereGrid(320, 80, num_spheres=SPHERES, min_depth=data.rig.min_depth)
    fig, ax = _figure(7, 6)
    ax.plot(*data.rig.recentered().centers[:, [0, 2]].T, "ko", ms=4)
    ax.plot(0, 0, "k+", ms=12)
    around = np.linspace(0, 2 * np.pi, 361)
    for n in range(2, SPHERES):
        # numbers along a spiral, so that none is hidden
        radius, angle = grid.index_to_depth(n), (n - 2) * np.pi / 3
        ax.plot(radius * np.sin(around), radius * np.cos(around), color="C0", lw=1)
        at = (radius * np.sin(angle), radius * np.cos(angle))
        ax.text(*at, str(n), ha="center", va="center", bbox={"fc": "w", "ec": "none", "pad": 1.5})
    reach = 1.05 * grid.index_to_depth(2)
    ax.set(aspect="equal", xlim=(-reach, reach), ylim=(-reach, reach))
    ax.set(xlabel="x (right) [m]", ylabel="z (forward) [m]")
    return fig


def _figure(width: float, height: float) -> tuple[Figure, Axes]:
    fig = Figure(figsize=(width, height), layout="constrained")
    return fig, fig.subplots()


def _axis(ax: Axes, start: Point, along: Point, name: str, color: str) -> None:
    """Draw an arrow and write its name at the tip."""
    tip = (start[0] + along[0], start[1] + along[1])
    style = {"arrowstyle": "-|>", "color": color, "lw": 2, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", tip, start, arrowprops=style)
    _name(ax, tip, name, (6, 6), color)


def _inwards(ax: Axes, at: Point, name: str, offset: Point, color: str) -> None:
    """Draw the tail of an arrow that points into the page."""
    ax.plot(*at, "o", ms=13, mfc="none", mec=color, mew=1.5)
    ax.plot(*at, "x", ms=8, color=color)
    _name(ax, at, name, offset, color)


def _name(ax: Axes, at: Point, name: str, offset: Point, color: str) -> None:
    style: dict[str, Any] = {"color": color, "fontsize": 13, "weight": "bold"}
    ax.annotate(name, at, offset, textcoords="offset points", **style)
