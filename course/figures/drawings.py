"""Line drawings for the notebooks, to scale where scale matters."""

from itertools import pairwise
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle, Polygon, Rectangle
from numpy.typing import ArrayLike

from omnistereo_lib.geometry.camera import OcamCamera

# x and y of a place, as a tuple or an array: Matplotlib takes both, and its types the tuple only.
Point = Any
# cameras 1 and 2, as everywhere; the point, the spheres
FIRST, SECOND, POINT, SPHERE = "C0", "C1", "C3", "0.75"
CENTERED: dict[str, Any] = {"ha": "center", "va": "center"}


def _canvas(width: float, height: float, panels: int = 1) -> tuple[Figure, list[Axes]]:
    fig = plt.figure(figsize=(width, height), layout="constrained")
    axes = fig.subplots(1, panels, squeeze=False)[0]
    for ax in axes:
        ax.set_aspect("equal")
        ax.set_axis_off()
    return fig, list(axes)


def _beside(ax: Axes, place: Point, text: str, offset: Point, **style: Any) -> None:
    """Write a text so many points beside a place."""
    ax.annotate(text, place, offset, textcoords="offset points", **style)


def _arrow(ax: Axes, start: Point, end: Point, color: str, text: str = "", **at: Any) -> None:
    style = {"arrowstyle": "-|>", "color": color, "lw": 1.6, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", end, start, arrowprops=style)
    if text:
        _beside(ax, (np.array(start) + end) / 2, text, **({"offset": (6, 4), "color": color} | at))


def _camera(ax: Axes, place: Point, name: str, color: str, offset: Point = (0, -14)) -> None:
    ax.plot(*place, "o", ms=10, color=color)
    _beside(ax, place, name, offset, **CENTERED, color=color)


def _text(ax: Axes, place: Point, text: str, **style: Any) -> None:
    x, y = place
    ax.text(x, y, text, **style)


def _line(ax: Axes, start: Point, end: Point, **style: Any) -> None:
    ax.plot(*zip(start, end, strict=True), **style)


def aliasing() -> Figure:
    """A fine wave, sampled as it is and after a blur."""
    fig, axes = plt.subplots(1, 2, figsize=(10, 2.6), layout="constrained", sharey=True)
    x, samples = np.linspace(0, 40, 2000), np.arange(0, 41, 3.6)
    waves = (1.0, "sampled as they are"), (0.04, "blurred first")
    for ax, (amplitude, name) in zip(axes, waves, strict=True):
        stripes, at = (amplitude * np.cos(2 * np.pi * places / 3.1) for places in (x, samples))
        ax.plot(x, stripes, color=SPHERE, lw=1)
        ax.plot(samples, at, "o-", color=POINT, lw=2, ms=6)
        ax.set(title=name, xlabel="image [px]", ylim=(-1.3, 1.3))
    axes[0].set_ylabel("brightness")
    return fig


def panorama_angles(theta_deg: float, phi_deg: float) -> Figure:
    """The angles θ and φ of one ray, on the unit sphere and on the panorama that unrolls it."""
    fig = plt.figure(figsize=(10, 3.6), layout="constrained")
    left = fig.add_subplot(1, 2, 1, projection="3d", computed_zorder=False)
    right = fig.add_subplot(1, 2, 2)

    def ray(theta: ArrayLike, phi: ArrayLike) -> list[Any]:
        """x, z and -y, so that Matplotlib's third axis, which points up, shows y pointing down."""
        theta, phi = np.broadcast_arrays(np.radians(theta), np.radians(phi))
        return [np.cos(phi) * np.sin(theta), np.cos(phi) * np.cos(theta), -np.sin(phi)]

    around = np.linspace(-180, 180, 181)
    for phi in (-45, 0, 45):
        left.plot(*ray(around, phi), color=SPHERE, lw=1.6 if phi == 0 else 0.8)
    for theta in range(-180, 180, 45):
        left.plot(*ray(theta, np.linspace(-45, 45, 40)), color=SPHERE, lw=0.8)
    axes = ((1.5, 0, 0), "x, right"), ((0, 1.5, 0), "z, forward"), ((0, 0, -1.1), "y, down")
    for end, name in axes:
        left.plot(*zip((0, 0, 0), end, strict=True), color="0.2", lw=1.2)
        left.text(*np.multiply(1.12, end), name, color="0.2", ha="center")
    left.plot(*zip((0, 0, 0), ray(theta_deg, phi_deg), strict=True), color=POINT, lw=2.5)
    left.plot(*ray(np.linspace(0, theta_deg, 40), 0), color=FIRST, lw=2.5)
    left.plot(*ray(theta_deg, np.linspace(0, phi_deg, 20)), color=SECOND, lw=2.5)
    left.text(*np.multiply(1.25, ray(0.55 * theta_deg, 0)), "θ", color=FIRST, fontsize=13)
    beside = np.multiply(1.15, ray(theta_deg + 12, 0.9 * phi_deg))
    left.text(*beside, "φ", color=SECOND, fontsize=13)
    left.view_init(28, -62)
    left.set_box_aspect((1, 1, 0.75), zoom=1.45)
    left.set_axis_off()
    right.axhline(0, color=SPHERE)
    right.axvline(0, color=SPHERE)
    right.plot([0, theta_deg], [0, 0], color=FIRST, lw=2.5)
    right.plot([theta_deg] * 2, [0, phi_deg], color=SECOND, lw=2.5)
    right.plot(theta_deg, phi_deg, "o", color=POINT)
    right.text(0.5 * theta_deg, -3, "θ", color=FIRST, fontsize=13, ha="center")
    right.text(theta_deg + 4, 0.5 * phi_deg, "φ", color=SECOND, fontsize=13, va="center")
    right.set(xlim=(-180, 180), ylim=(45, -45), aspect="equal", ylabel="φ [°], rows down")
    right.set(xticks=range(-180, 181, 90), yticks=(-45, 0, 45))
    right.set_xlabel("θ [°], columns to the right")
    return fig


def chain(steps: list[tuple[str, str]]) -> Figure:
    """A row of boxes, each with a name above it and numbers in it, and arrows between them."""
    fig, (ax,) = _canvas(10, 1.5)
    for k, (name, numbers) in enumerate(steps):
        color = plt.cm.viridis(0.35 + 0.13 * k)
        ax.add_patch(Rectangle((3 * k, 0), 2.3, 1.1, facecolor=color, alpha=0.45, edgecolor="none"))
        ax.text(3 * k + 1.15, 0.55, numbers, **CENTERED, fontsize=9)
        ax.text(3 * k + 1.15, 1.3, name, ha="center", fontsize=9, color="0.3")
        if k:
            _arrow(ax, (3 * k - 0.65, 0.55), (3 * k - 0.05, 0.55), "0.3")
    ax.set(xlim=(-0.2, 3 * len(steps) - 0.5), ylim=(-0.1, 1.7))
    return fig


def sphere_sweep() -> Figure:
    """Two cameras, one ray, three circles: the pictures agree on one of them only."""
    fig, axes = _canvas(10, 3.9, 2)
    first, second, car = (-0.6, 0.0), (0.6, 0.0), np.array([1.3, 2.6])
    radius = np.hypot(*car)
    spheres = (1.55, "the wrong sphere"), (1.0, "the right sphere")
    for ax, (tried, verdict) in zip(axes, spheres, strict=True):
        for r in (0.62 * radius, radius, 1.55 * radius):
            ax.add_patch(Circle((0, 0), r, fill=False, color=SPHERE, lw=1))
        ax.add_patch(Rectangle(tuple(car - (0.5, 0)), 1.0, 0.42, color="0.6", zorder=2))
        asked = tried * car
        _line(ax, (0, 0), 1.62 * car, color=POINT, lw=1, ls=":")
        for place, name, color in ((first, "camera 1", FIRST), (second, "camera 2", SECOND)):
            _line(ax, place, asked, color=color, lw=1.4, zorder=3)
            _camera(ax, place, name, color, (-8 if color == FIRST else 10, -14))
        ax.plot(*asked, "o", color=POINT, ms=7, zorder=4)
        ax.plot(0, 0, "+", color="0.2")
        ax.set(xlim=(-2.2, 4.2), ylim=(-0.6, 4.6), title=verdict)
    axes[0].text(1.95, 2.62, "the cameras look at\ntwo places of the car", fontsize=9, va="center")
    axes[1].text(1.95, 2.62, "both look at the same\nplace of the car", fontsize=9, va="center")
    return fig


def lens_section(camera: OcamCamera) -> Figure:
    """The lens from the side, to scale: the surface (r, -f(r)), and three rays through it."""
    fig, (ax,) = _canvas(8, 4.2)
    r = np.linspace(0, 372, 200)
    f = np.polynomial.polynomial.polyval(r, camera.poly)
    ax.plot(np.r_[-r[::-1], r], -np.r_[f[::-1], f], color="0.3", lw=2)
    for radius, color in ((110, FIRST), (230, POINT), (352, SECOND)):
        height = -np.polynomial.polynomial.polyval(radius, camera.poly)
        direction = np.array([radius, height]) / np.hypot(radius, height)
        _arrow(ax, (0, 0), tuple(430 * direction), color)
        ax.plot(radius, height, "o", color=color)
        _line(ax, (radius, 0), (radius, height), color=color, lw=0.8, ls=":")
        angle = np.degrees(np.arctan2(radius, height))
        _text(ax, 445 * direction, f"θ = {angle:.0f}°", color=color, va="center")
        ax.text(radius + 4, -24, f"r = {radius}", color=color, fontsize=9)
        if color == FIRST:
            ax.text(radius + 5, float(height / 2), "−f(r)", color=color, fontsize=9)
    _arrow(ax, (0, 0), (0, 400), "0.2", "the axis, z", offset=(-70, 80))
    _line(ax, (-385, 0), (470, 0), color="0.6", lw=0.8)
    ax.text(478, 0, "90° from the axis", color="0.4", fontsize=9, va="center")
    ax.set(xlim=(-390, 640), ylim=(-190, 430))
    return fig


def board_triangle() -> Figure:
    """Two cameras and a board as frames, a pose to each arrow: two are known, one follows."""
    fig, (ax,) = _canvas(8, 3.6)
    places = {
        "camera 1": ((0, 0), FIRST, 25),
        "camera 2": ((4, 0), SECOND, -15),
        "board": ((2, 2.2), POINT, 60),
    }
    for name, ((x, y), color, turned) in places.items():
        c, s = 0.55 * np.cos(np.radians(turned)), 0.55 * np.sin(np.radians(turned))
        for dx, dy, axis in ((c, s, "x"), (-s, c, "z")):
            _arrow(ax, (x, y), (x + dx, y + dy), color)
            ax.text(x + 1.2 * dx, y + 1.2 * dy, axis, color=color, **CENTERED, fontsize=9)
        ax.text(x, y - 0.28, name, ha="center", color=color)
    at_left, found = {"ha": "right", "offset": (-8, 4)}, r"$T_{12} = T_{1b} \star T_{2b}^{-1}$"
    _arrow(ax, (1.75, 1.95), (0.25, 0.25), "0.35", r"$T_{1b}$, from picture 1", **at_left)
    _arrow(ax, (2.25, 1.95), (3.75, 0.25), "0.35", r"$T_{2b}$, from picture 2", offset=(8, 4))
    _arrow(ax, (3.7, -0.05), (0.9, -0.05), "0.2", found, offset=(-44, -18))
    ax.set(xlim=(-1.6, 6), ylim=(-0.75, 3))
    return fig


def line_of_sight() -> Figure:
    """Where an image of a thing appears on two spheres, and on one with a wrong pose."""
    fig, axes = _canvas(10, 3.9, 2)
    camera, arc = np.array([1.0, 0.0]), np.radians(np.linspace(20, 110, 90))
    far, near, thing_deg = 3.4, 2.1, 62
    thing = far * np.array([np.cos(np.radians(thing_deg)), np.sin(np.radians(thing_deg))])

    def meets(turn_deg: float, radius: float) -> Point:
        """Where the line of sight, rotated about the camera, meets a sphere."""
        c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
        along = np.array([[c, -s], [s, c]]) @ (thing - camera) / np.hypot(*(thing - camera))
        b = camera @ along
        return camera + along * (-b + np.sqrt(b**2 - camera @ camera + radius**2))

    for ax, turn_deg, end, name, title in (
        (axes[0], 0, meets(0, near), "p", "right pose, true sphere and next sphere"),
        (axes[1], 16, meets(16, far), "e", "wrong pose, true sphere"),
    ):
        for radius in (far, near):
            ax.plot(radius * np.cos(arc), radius * np.sin(arc), color=SPHERE, lw=1.2)
        _line(ax, (0, 0), tuple(thing), color="0.3", lw=1, ls=":")
        _line(ax, (0, 0), tuple(end), color=POINT, lw=1, ls=":")
        _line(ax, tuple(camera), tuple(meets(turn_deg, far)), color=FIRST, lw=1.6)
        ax.plot(*thing, "s", color="0.3", ms=9)
        ax.plot(*end, "o", color=POINT, ms=7, zorder=4)
        end_deg = np.degrees(np.arctan2(end[1], end[0]))
        between = np.radians(np.linspace(thing_deg, end_deg, 30))
        ax.plot(1.45 * np.cos(between), 1.45 * np.sin(between), color=POINT, lw=2)
        middle = np.radians((thing_deg + end_deg) / 2)
        place = 1.2 * np.cos(middle), 1.2 * np.sin(middle)
        ax.text(*place, name, color=POINT, fontsize=14, **CENTERED)
        _camera(ax, tuple(camera), "camera", FIRST)
        ax.plot(0, 0, "k+", ms=12)
        _beside(ax, (0, 0), "sweep centre", (0, -14), **CENTERED)
        ax.set(xlim=(-1.9, 3.6), ylim=(-0.4, 3.8), title=title)
    return fig


def shift_along_parallax() -> Figure:
    """Two images of a thing on the panorama with a wrong pose, and how a sphere moves them."""
    fig, (ax,) = _canvas(9, 3.2)
    places, steps = np.array([[[0.0, 0.0], [3.4, 0.95]], [[0.5, 0.06], [-0.6, -0.04]]])
    e, p = places[0] - places[1], steps[0] - steps[1]
    met = places - (p @ e) / (p @ p) * steps
    for k, (color, side) in enumerate(((FIRST, [0, -0.3]), (SECOND, [0, 0.2]))):
        _line(ax, places[k], met[k], color=color, lw=0.8, ls=":")
        _arrow(ax, tuple(places[k]), tuple(places[k] + steps[k]), color)
        ax.plot(*places[k], "s", ms=12, color=color)
        ax.plot(*met[k], "s", ms=12, mfc="none", mec=color, mew=1.6)
        _text(ax, places[k] + side, f"image {k + 1}", color=color, ha="center")
        tip = places[k] + 0.9 * steps[k] + side
        _text(ax, tip, rf"$p_{k + 1}$", color=color, fontsize=12, ha="center")
    _arrow(ax, tuple(places[1] + 0.03 * e), tuple(places[1] + 0.97 * e), "0.5")
    ax.text(0.75, 0.35, r"$e = e_1 - e_2$", color="0.4", ha="right")
    style = {"arrowstyle": "<->", "color": POINT, "lw": 1.6, "shrinkA": 7, "shrinkB": 7}
    ax.annotate("", tuple(met[0]), tuple(met[1]), arrowprops=style)
    ax.text(1.9, 0.42, "what is left across:\nno sphere closes it", color=POINT, va="center")
    ax.set(xlim=(-0.9, 4.4), ylim=(-0.5, 1.4))
    return fig


def window_problems() -> Figure:
    """Three windows that match wrongly: no texture, an edge along the search, an outline."""
    fig, axes = _canvas(10, 2.6, 3)
    rng = np.random.default_rng(3)
    for ax in axes:
        ax.add_patch(Rectangle((0, 0), 6, 3, facecolor="0.8", edgecolor="none"))
        ax.set(xlim=(-0.1, 6.1), ylim=(-0.9, 3.1))
    axes[1].add_patch(Rectangle((0, 0), 6, 1.4, facecolor="0.45"))
    axes[2].add_patch(Rectangle((0, 0), 3.1, 3, facecolor="0.45"))
    dots = rng.uniform((0.1, 0.1), (3, 2.9), (60, 2))
    axes[2].scatter(dots[:, 0], dots[:, 1], s=9, color="0.2")
    titles = (
        "no texture: alike everywhere",
        "an edge along the search:\nalike all the way",
        "an outline: the near side decides",
    )
    windows = (0.8, 2.3, 3.8), (0.8, 2.3, 3.8), (2.4,)
    for ax, places, title in zip(axes, windows, titles, strict=True):
        for k, x in enumerate(places):
            lw, ls = (2, "-") if k == 0 else (1, ":")
            ax.add_patch(Rectangle((x, 0.7), 1.4, 1.4, fill=False, edgecolor=POINT, lw=lw, ls=ls))
        ax.set_title(title, fontsize=10)
    axes[2].plot(3.5, 1.4, "+", color=POINT, ms=8)
    wrong = "this ray, on the\nfar side, gets\nthe near depth"
    axes[2].text(4.0, 1.4, wrong, fontsize=8, color=POINT, va="center")
    for ax in axes[:2]:
        _arrow(ax, (1.5, -0.4), (4.9, -0.4), "0.2")
        ax.text(3.2, -0.75, "search", ha="center", fontsize=9)
    return fig


def volume_box() -> Figure:
    """The cost volume as a box of columns, spheres and rows, with the cut at one row."""
    fig, (ax,) = _canvas(8, 2.9)
    w, n, h, slant = 6.0, 1.9, 1.5, np.array([0.55, 0.6])  # width, spheres (into the page), height

    def at(column: float, sphere: float, row: float) -> Point:
        return np.array([column, -row]) + sphere * slant

    corners = [(0, 0), (w, 0), (w, n), (0, n)]
    for row, style in ((0, "-"), (h, ":")):
        face = [at(*corner, row) for corner in corners]
        ax.add_patch(Polygon(face, fill=False, edgecolor="0.4", ls=style))
    for corner in corners:
        _line(ax, at(*corner, 0), at(*corner, h), color="0.4", ls=":" if corner == (0, n) else "-")
    cut = [at(*corner, h / 2) for corner in corners]
    ax.add_patch(Polygon(cut, facecolor=FIRST, alpha=0.3))
    ray = np.array([at(3.8, sphere, h / 2) for sphere in (0, n)])
    ax.plot(*ray.T, color=POINT, lw=2.5)
    _beside(ax, ray.mean(0), "one ray: a cost curve", (8, -2), color=POINT, fontsize=9)
    _text(ax, at(0.15, 0.1, 0.9 * h / 2), "the cut", color=FIRST, fontsize=9)
    _text(ax, at(w / 2, 0, h + 0.35), "W columns, θ", ha="center")
    _text(ax, at(-0.15, 0, h / 2), "H rows, φ", ha="right", va="center")
    _text(ax, at(w + 0.25, n / 2, h), "N spheres, n", va="center")
    ax.set(xlim=(-1.6, 9), ylim=(-2.0, 1.3))
    return fig


def sgm_paths() -> Figure:
    """The eight paths that end at a ray, and the panorama as the cylinder that they go around."""
    fig, (left, right) = _canvas(9.5, 3.0, 2)
    for angle in np.radians(np.arange(0, 360, 45)):
        x, y = np.cos(angle), np.sin(angle)
        _arrow(left, (1.1 * x, 1.1 * y), (0.13 * x, 0.13 * y), FIRST)
    left.plot(0, 0, "o", color=POINT, ms=9)
    left.set(xlim=(-1.3, 1.3), ylim=(-1.3, 1.3), title="eight paths end at every ray")
    around = np.linspace(0, 2 * np.pi, 200)
    # seen from slightly above; the front has depth > 0
    x, depth = 2 * np.sin(around), 0.35 * np.cos(around)
    for y in (-0.8, 0.8):
        right.plot(x, y - depth, color="0.4", lw=1)
    for side in (-2, 2):
        _line(right, (side, -0.8), (side, 0.8), color="0.4", lw=1)
    _line(right, (0, -0.8 + 0.35), (0, 0.8 + 0.35), color=POINT, lw=1.5, ls="--")
    right.text(0.08, 0.62, "the seam", color=POINT, fontsize=9)
    for rise, color in ((0.0, SECOND), (0.17, FIRST)):
        for front in (False, True):
            part = (np.cos(around) > 0) == front
            y = np.where(part, -0.15 - depth + rise * (around - np.pi), np.nan)
            right.plot(np.where(part, x, np.nan), y, color=color, lw=2, ls="-" if front else ":")
    right.set(xlim=(-2.3, 2.3), ylim=(-1.4, 1.4))
    right.set_title("the panorama closes behind us: no path ends at the seam")
    return fig


def slanted_window() -> Figure:
    """A window on the road seen from the side: it lies on one sphere, the road crosses three."""
    fig, (ax,) = _canvas(8.5, 3.4)
    angles = np.radians(np.linspace(2, 62, 100))
    radii = 1 / np.linspace(1 / 2.0, 1 / 9.0, 8)
    for radius in radii:
        ax.plot(radius * np.cos(angles), -radius * np.sin(angles), color=SPHERE, lw=1)
    _line(ax, (0.6, -1.6), (9.4, -1.6), color="0.3", lw=2)
    ax.text(7.2, -1.95, "the road", color="0.3")
    middle, half = np.arcsin(1.6 / radii[4]), np.radians(5)
    patch = np.linspace(middle - half, middle + half, 20)
    ax.plot(radii[4] * np.cos(patch), -radii[4] * np.sin(patch), color=POINT, lw=4)
    swept = "the window, as the sweep sees it:\none sphere for all its rays"
    ax.text(radii[4] + 0.15, -1.05, swept, color=POINT, fontsize=9)
    for angle in (middle - half, middle + half):
        end = 1.6 / np.sin(angle)
        _line(ax, (0, 0), (end * np.cos(angle), -1.6), color=FIRST, lw=1, ls=":")
    left, right = (1.6 / np.tan(angle) for angle in (middle + half, middle - half))
    _line(ax, (left, -1.6), (right, -1.6), color=FIRST, lw=4)
    ax.text((left + right) / 2, -2.05, "what it really shows", color=FIRST, ha="center", fontsize=9)
    _camera(ax, (0, 0), "the rig", "0.2", (0, 12))
    ax.set(xlim=(-0.5, 9.6), ylim=(-2.4, 0.5))
    return fig


def patch_tower() -> Figure:
    """The fast network as squares: each 3 × 3 convolution takes the rim away from 9 × 9."""
    fig, (ax,) = _canvas(9, 2.9)
    x = 0.0
    for size, channels in ((9, 1), (7, 64), (5, 64), (3, 64), (1, 64)):
        for k in range(min(channels, 5), -1, -1):
            fill = plt.cm.viridis(0.25 + 0.1 * k) if channels > 1 else "0.8"
            if k < min(channels, 5):
                place = (x + 0.16 * k, -size / 2 + 0.16 * k)
                ax.add_patch(Rectangle(place, size, size, facecolor=fill, edgecolor="w", lw=0.8))
        what = f"{channels} channels" if channels > 1 else "grey values"
        ax.text(x + size / 2, -5.6, f"{size} × {size}\n{what}", ha="center", va="top", fontsize=9)
        if size > 1:
            _arrow(ax, (x + size + 1.0, 0), (x + size + 3.0, 0), "0.3", "3 × 3", offset=(-12, 5))
        x += size + 3.6
    ax.set(xlim=(-1, x), ylim=(-8, 6))
    return fig


def sweepnet() -> Figure:
    """Table I as boxes: features of two cameras, their comparison, one block below."""
    fig, (ax,) = _canvas(10, 4.2)
    ax.set_aspect("auto")
    images, features = "image\n1 × H × W", "conv1 … conv18\n32 × H/2 × W/2"
    columns = (0.0, images), (1.7, features)
    boxes = [(x, y, text, c) for x, text in columns for y, c in ((1.0, FIRST), (0.0, SECOND))]
    boxes += [
        (3.4, 0.5, "stacked\n64 × H/2 × W/2", SPHERE),
        (5.1, 0.5, "conv19\n128 × H/2 × W/2", SPHERE),
        (6.8, 0.5, "deconv1, conv20\n128 × H × W", SPHERE),
        (8.5, 0.5, "fc1 … fc5, sigmoid\n1 × H × W", SPHERE),
    ]
    boxes += [(x, -1.3, name, FIRST) for x, name in ((3.4, "conv2, ReLU"), (5.1, "conv3"))]
    for x, y, text, color in boxes:
        ax.add_patch(Rectangle((x - 0.72, y - 0.19), 1.44, 0.38, color=color, alpha=0.4, lw=0))
        ax.text(x, y, text, **CENTERED, fontsize=8)
    for y in (1, 0):
        _arrow(ax, (0.72, y), (0.98, y), "0.3")
        _arrow(ax, (2.42, y), (2.68, 0.5 + 0.1 * (2 * y - 1)), "0.3")
    for x in (4.12, 5.82, 7.52):
        _arrow(ax, (x, 0.5), (x + 0.26, 0.5), "0.3")
    ax.text(0.85, 1.32, "once for each camera, with the same weights", ha="center")
    ax.text(6.0, 0.85, "once for each pair", ha="center")
    for start, end in ((2.3, 2.68), (4.12, 4.38), (5.82, 6.3), (6.6, 7.0)):
        _arrow(ax, (start, -1.3), (end, -1.3), "0.3")
    ax.plot([2.45, 2.45, 6.45], [-1.3, -0.85, -0.85], color=POINT)
    _arrow(ax, (6.45, -0.85), (6.45, -1.2), POINT)
    for x, text in ((1.4, "a block, such as"), (6.45, "+"), (7.35, "ReLU")):
        ax.text(x, -1.3, text, **CENTERED)
    ax.text(4.25, -0.8, "the shortcut", color=POINT, ha="center")
    ax.set(xlim=(-0.8, 9.3), ylim=(-1.6, 1.5))
    return fig


def bootstrap(values: np.ndarray, ends: np.ndarray) -> Figure:
    """The values of the frames, three resamples with means, and the means of ten thousand."""
    rng = np.random.default_rng(0)
    fig, (left, right) = plt.subplots(1, 2, figsize=(10, 3.0), layout="constrained")
    ranks = np.argsort(np.argsort(values))
    # so that equal values are two dots
    left.plot(values, np.where(ranks % 2, 0.15, -0.15), "o", color="0.2")
    left.text(values.max(), 0.3, "the frames", color="0.2", ha="right")
    for row in (1, 2, 3):
        taken, counts = np.unique(rng.choice(values, len(values)), return_counts=True)
        left.scatter(taken, np.full(len(taken), -row), s=28 * counts, color="0.6")
        left.plot(np.repeat(taken, counts).mean(), -row, "|", ms=22, mew=2.5, color=POINT)
    left.set(yticks=[], ylim=(-3.6, 0.8))
    left.set_title("drawn with replacement: larger dots are drawn more often")
    right.hist(rng.choice(values, (10_000, len(values))).mean(axis=1), 60, color="0.7")
    for end in ends:
        right.axvline(end, color=POINT, ls="--")
    right.set(yticks=[], title="the means of 10,000 such draws")
    for ax in (left, right):
        ax.axvline(0, color="k", lw=0.8)
        ax.set_xlabel("difference [points]")
        ax.spines[["left", "top", "right"]].set_visible(False)
    return fig


def slabs() -> Figure:
    """Two rays and a box of two pairs of lines: one ray is between both for a while."""
    fig, (ax,) = _canvas(8, 3.9)
    low, high = np.array([2.0, 0.6]), np.array([4.2, 2.2])
    for place in (low[0], high[0]):
        ax.axvline(place, color=FIRST, lw=1, ls=":")
    for place in (low[1], high[1]):
        ax.axhline(place, color=SECOND, lw=1, ls=":")
    ax.add_patch(Rectangle(tuple(low), *(high - low), facecolor="0.93", edgecolor="0.3", lw=1.5))
    for ray, inside in ((np.array([0.91, 0.42]), True), (np.array([0.55, 0.835]), False)):
        ends = np.sort(np.stack([low / ray, high / ray]), axis=0)  # entry and exit of each pair
        _arrow(ax, (0, 0), 6.1 * ray if inside else 3.9 * ray, "0.4")
        enters, leaves = ends[0].max(), ends[1].min()
        if inside:
            style = {"color": POINT, "lw": 5, "solid_capstyle": "butt", "zorder": 3}
            _line(ax, enters * ray, leaves * ray, **style)
        for axis, color in enumerate((FIRST, SECOND)):
            for end, face in zip(ends[:, axis], (color, "w"), strict=True):
                ax.plot(*(end * ray), "o", mfc=face, mec=color, ms=8, mew=1.8, zorder=4)
    ax.text(4.35, 2.95, "● enters the pair,  ○ leaves it", color="0.3", fontsize=9)
    ax.text(low[0], 3.3, "low", color=FIRST, ha="right", fontsize=9)
    ax.text(high[0], 3.3, "high", color=FIRST, ha="right", fontsize=9)
    ax.text(6.9, low[1] + 0.05, "low", color=SECOND, ha="right", fontsize=9)
    ax.text(6.9, high[1] + 0.05, "high", color=SECOND, ha="right", fontsize=9)
    _camera(ax, (0, 0), "origin", "0.2", (4, -14))
    ax.set(xlim=(-0.4, 7), ylim=(-0.5, 3.5))
    return fig


def depth_triangle() -> Figure:
    """Depth along the axis against distance along the ray, for one pixel of a flat face."""
    fig, (ax,) = _canvas(7.5, 3.3)
    _line(ax, (3, -1.5), (3, 2.2), color="0.3", lw=2)
    ax.text(3.08, -1.35, "a wall", color="0.3")
    _line(ax, (1, -0.6), (1, 0.8), color="0.6", lw=1.5)
    ax.text(1.05, -0.55, "image plane", color="0.45", fontsize=9)
    for tan, color in ((0.0, FIRST), (0.55, POINT)):
        _arrow(ax, (0, 0), (3, 3 * tan), color)
        ax.plot(1, tan, "s", color=color, ms=6)
    ax.text(1.9, -0.22, "z", color=FIRST, fontsize=13)
    ax.text(1.75, 1.25, "distance along the ray = z / cos α", color=POINT, ha="right")
    ax.add_patch(Arc((0, 0), 1.2, 1.2, theta1=0, theta2=np.degrees(np.arctan(0.55))))
    ax.text(0.66, 0.14, "α")
    _camera(ax, (0, 0), "camera", "0.2", (-4, -14))
    ax.set(xlim=(-0.6, 4), ylim=(-1.6, 2.3))
    return fig


def doubled_contour() -> Figure:
    """Why a wrong depth doubles a contour: each camera paints the pole elsewhere."""
    fig, (ax,) = _canvas(8, 3.8)
    pole, radius = np.array([0.3, 2.7]), 1.6
    arc = np.radians(np.linspace(30, 150, 60))
    ax.plot(radius * np.cos(arc), radius * np.sin(arc), color=POINT, lw=2)
    ax.text(1.45, 0.75, "the estimated depth, too near", color=POINT, fontsize=9)
    cameras = ((-0.7, 0.0), "camera 1", FIRST, -1), ((0.7, 0.0), "camera 2", SECOND, 1)
    for place, name, color, side in cameras:
        along = (pole - place) / np.hypot(*(pole - place))
        b = np.dot(place, along)
        meets = place + along * (-b + np.sqrt(b**2 - np.dot(place, place) + radius**2))
        _line(ax, place, pole, color=color, lw=1.4)
        ax.plot(*meets, "s", color=color, ms=9, zorder=4)
        offset, align = ((24, 10), "left") if side > 0 else ((-24, 16), "right")
        style = {"color": color, "fontsize": 9, "ha": align, "va": "center"}
        _beside(ax, meets, f"here {name}\npaints the pole", offset, **style)
        _camera(ax, place, name, color)
    ax.plot(*pole, "s", color="0.3", ms=11)
    _beside(ax, pole, "the pole", (14, 6), va="center", color="0.3")
    ax.set(xlim=(-2.6, 3.6), ylim=(-0.5, 3.1))
    return fig


def method_flow(width: int, height: int, spheres: int) -> Figure:
    """The five steps of the method as boxes, with the shape of what goes from one to the next."""
    fig, (ax,) = _canvas(10, 2.2)
    boxes = ("images, lenses,\nposes", "sweep", "matching cost", "SGM", "winner")
    volume = f"{height} × {width} × {spheres}"
    between = ("4 × 768 × 800", f"4 × {spheres} × {height} × {width}", volume, volume)
    for k, name in enumerate(boxes):
        color = plt.cm.viridis(0.35 + 0.13 * k)
        ax.add_patch(Rectangle((3.2 * k, 0), 2.0, 1.1, color=color, alpha=0.45, lw=0))
        ax.text(3.2 * k + 1.0, 0.55, name, **CENTERED, fontsize=9)
        if k:
            _arrow(ax, (3.2 * k - 1.15, 0.55), (3.2 * k - 0.05, 0.55), "0.3")
            ax.text(3.2 * k - 0.6, 1.3, between[k - 1], ha="center", fontsize=8, color="0.3")
    ax.text(14.8, 1.3, f"{height} × {width} indices", ha="center", fontsize=8, color="0.3")
    for k, notebook in enumerate(("01, 02", "03", "04, 07, 08", "05", "05")):
        ax.text(3.2 * k + 1.0, -0.35, notebook, ha="center", fontsize=8, color="0.3")
    ax.set(xlim=(-0.3, 16), ylim=(-0.6, 1.7))
    return fig


def unet() -> Figure:
    """VolumeNet's U-net as boxes, with channels and columns × rows × spheres."""
    widths = (16, 32, 48, 64)
    sides = [f"{160 // 2**k} × {40 // 2**k} × {32 // 2**k}" for k in range(len(widths))]
    last = len(widths) - 1
    levels = [0, *range(last + 1), *reversed(range(last)), 0]
    channels = [9, *widths, *reversed(widths[:-1]), 1]
    fig, (ax,) = _canvas(10, 3.6)
    ax.set_aspect("auto")
    ax.set(xlim=(-0.5, len(levels) - 0.5), ylim=(-last - 0.3, 0.35))
    for x, (level, count) in enumerate(zip(levels, channels, strict=True)):
        color = plt.cm.viridis(0.4 + 0.18 * level)
        ax.add_patch(Rectangle((x - 0.4, -level - 0.25), 0.8, 0.5, color=color, alpha=0.5))
        ax.text(x, -level, f"{count} channels\n{sides[level]}", **CENTERED, fontsize=7.5)
    for x, (level, after) in enumerate(pairwise(levels)):
        start = (x + 0.4, -level) if after == level else (x, -level + np.sign(level - after) * 0.25)
        ax.annotate("", (x + 0.6, -after), start, arrowprops={"arrowstyle": "->"})
    for level in range(last):
        style, y = {"arrowstyle": "->", "ls": ":", "color": "C3"}, -level - 0.1
        ax.annotate("", (len(levels) - 2.4 - level, y), (level + 1.4, y), arrowprops=style)
    return fig


def board_rays() -> Figure:
    """A board from the side: what its pose consists of, and the rays to its corners."""
    fig, (ax,) = _canvas(8, 3.6)
    origin, along = np.array([-0.9, 1.9]), np.array([0.95, -0.31])
    for k in range(6):
        corner = origin + 0.62 * k * along
        _line(ax, (0, 0), tuple(corner), color=SPHERE, lw=1)
        ax.plot(*corner, "o", color="0.3", ms=6)
        _arrow(ax, (0, 0), tuple(corner / np.hypot(*corner)), FIRST)
    ax.text(1.05, 0.25, "rays b, of length 1", color=FIRST)
    _arrow(ax, (0, 0), tuple(origin), POINT)
    ax.text(-0.75, 1.0, "t", color=POINT, fontsize=13)
    side, last = origin + np.array([0.1, 0.25]), origin + 3.1 * along
    _arrow(ax, tuple(side), tuple(side + along), SECOND)
    _text(ax, side + 0.55 * along + 0.08, r"$\mathbf{r}_1$, of length 1", color=SECOND, fontsize=11)
    combined = r"a corner: $X\,\mathbf{r}_1 + Y\,\mathbf{r}_2 + \mathbf{t}$"
    _text(ax, last + 0.1, combined, color="0.3")
    style = {"ha": "right", "va": "center", "color": "0.3", "fontsize": 9}
    _text(ax, origin - (0.1, 0), "the board's origin", **style)
    _camera(ax, (0, 0), "camera", "0.2")
    ax.set(xlim=(-2.6, 4.4), ylim=(-0.35, 2.6))
    return fig
