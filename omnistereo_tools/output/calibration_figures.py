"""Figures by which a calibration is judged."""

from __future__ import annotations

from textwrap import wrap
from typing import TYPE_CHECKING

import cv2
import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from omnistereo_lib.geometry.camera import OcamCamera

if TYPE_CHECKING:
    from omnistereo_rigs.boards.report import CameraReport

# A part of the image is covered if of three quarters of its directions a corner is near. Of 20
# pictures held all over a lens of 220°, a part of the rim lacks 19 % at most, any other 9 %.
_NEAR_DEG = 8.0
_LACKS = 0.25
# Parts of the image: the middle, and eight sectors of two rings; degrees from the axis.
_CENTRE = "in the centre"
_RINGS = {_CENTRE: (0.0, 20.0), "halfway out": (20.0, 60.0), "near the rim": (60.0, 180.0)}
_SECTORS = ["right", "lower right", "bottom", "lower left"]
_SECTORS += ["left", "upper left", "top", "upper right"]
_LIGHTNESS, _CHROMA = 65, 36  # of directions, in Lab: all their colours are in sRGB


def draw_residuals(ax: Axes, report: CameraReport) -> None:
    """Draw every corner's residual from one origin, with circles of one, two and three sigma."""
    residuals = report.inlier_residuals()
    ax.scatter(residuals[:, 0], residuals[:, 1], s=5, alpha=0.4, linewidths=0)
    angle = np.linspace(0, 2 * np.pi, 100)
    for sigmas in (1, 2, 3):
        ax.plot(
            *(sigmas * report.sigma_px * np.array([np.cos(angle), np.sin(angle)])),
            color="0.4",
            lw=0.8,
        )
    limit = 5 * report.sigma_px
    ax.set(aspect="equal", xlim=(-limit, limit), ylim=(limit, -limit))
    ax.set(xlabel="u error in px", ylabel="v error in px")
    ax.set_title(f"rms {report.rms_px:.3f} px; circles: 1, 2, 3 σ")


def draw_error_by_angle(ax: Axes, report: CameraReport) -> None:
    """Draw the radial residual of every corner against its angle from the axis, and its mean over
    each 10°.

    A mean that leaves zero is a polynomial of too low a degree.
    """
    angles = np.degrees(np.concatenate([report.angles[view] for view in report.views_used]))
    corners = np.concatenate([report.corners[view] for view in report.views_used])
    residuals = np.concatenate(list(report.residuals_used().values()))
    outwards = corners - report.intrinsics.vector[:2]
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    radial = np.sum(residuals * outwards, axis=1)
    known = np.isfinite(radial)
    ax.scatter(angles[known], radial[known], s=5, alpha=0.4, linewidths=0)
    ring = angles[known] // 10
    rings = np.unique(ring)
    ax.plot(
        10 * rings + 5,
        [radial[known][ring == i].mean() for i in rings],
        "o-",
        color="C1",
        label="mean over 10°",
    )
    limit = 6 * report.sigma_px
    ax.set(
        xlabel="angle from the axis in degrees", ylabel="radial error in px", ylim=(-limit, limit)
    )
    ax.legend(loc="upper left", fontsize="small")
    ax.set_title("flat on 0: the lens model fits")


def draw_error_directions(ax: Axes, report: CameraReport) -> None:
    """Draw every corner, coloured by its residual's direction: one colour nearby is a bias. A ring
    in the lower right corner has the colour of each direction.
    """
    corners = np.concatenate([report.corners[view] for view in report.views_used])
    residuals = np.concatenate(list(report.residuals_used().values()))
    direction = np.arctan2(residuals[:, 1], residuals[:, 0])
    known = np.isfinite(direction)
    u, v = corners[known].T
    ax.scatter(u, v, c=direction_colors(direction[known]), s=9, linewidths=0)
    _frame_of_image(ax, report, "one colour nearby: a bias")
    around = np.linspace(0, 2 * np.pi, 72)
    places = 0.91 + 0.06 * np.cos(around), 0.09 - 0.06 * np.sin(around)  # v points down
    ax.scatter(*places, c=direction_colors(around), s=30, lw=0, transform=ax.transAxes)


def direction_colors(radians: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return a colour of the same lightness for each direction, (N,) → (N, 3) RGB in [0, 1]."""
    a, b = _CHROMA * np.cos(radians), _CHROMA * np.sin(radians)
    lab = np.stack([np.full_like(a, _LIGHTNESS), a, b], -1).astype(np.float32)
    return np.asarray(cv2.cvtColor(lab[None], cv2.COLOR_LAB2RGB)[0], np.float32)


def uncovered(report: CameraReport, camera: OcamCamera) -> list[tuple[str, int]]:
    """Return the parts of the image, (ring, sector), large areas of which no corner is near."""
    corners = np.concatenate([report.corners[view] for view in report.views_used])
    seen = cKDTree(camera.unproject(corners[np.isfinite(corners).all(1)])[0])
    found = []
    for ring in _RINGS:
        for sector in range(1 if ring == _CENTRE else 8):
            rays = _part(camera, ring, sector)
            inside = camera.project(rays)[1]
            far = seen.query(rays[inside])[0] > 2 * np.sin(np.radians(_NEAR_DEG) / 2)
            if inside.mean() > 0.5 and far.mean() > _LACKS:
                found.append((ring, sector))
    return found


def where_next(report: CameraReport, camera: OcamCamera) -> str:
    """Return where to hold the board for the next pictures, in words; "" where all was covered."""
    places: dict[str, list[str]] = {}
    for ring, sector in uncovered(report, camera):
        places.setdefault(ring, []).append(_SECTORS[sector])
    return "; ".join(
        ring
        if ring == _CENTRE
        else f"{ring}: " + ("all around" if len(names) == 8 else ", ".join(names))
        for ring, names in places.items()
    )


def _part(camera: OcamCamera, ring: str, sector: int) -> NDArray[np.float64]:
    """Return rays of a part of the image, even by area, from its inner edge out: (24, 24, 3)."""
    low, high = np.cos(np.radians(np.minimum(_RINGS[ring], camera.max_fov_deg / 2 - 0.5)))
    half = np.pi if ring == _CENTRE else np.pi / 8
    cosine = np.linspace(low, high, 24)[:, None]
    azimuth = np.pi / 4 * sector + np.linspace(-half, half, 24)
    across = np.sqrt(1 - cosine**2)
    return np.stack(
        np.broadcast_arrays(across * np.cos(azimuth), across * np.sin(azimuth), cosine), -1
    )


def draw_coverage(ax: Axes, report: CameraReport, camera: OcamCamera | None = None) -> None:
    """Draw all corners in the image, a colour for each view, with circles of 30°, 60°, 90°; of a
    calibrated camera also the parts without corners, shaded.
    """
    if camera is not None:
        _draw_uncovered(ax, report, camera)
    for view in report.views_used:
        u, v = report.corners[view].T
        ax.scatter(u, v, s=5, linewidths=0)
    corners = np.concatenate([report.corners[view] for view in report.views_used])
    tree = cKDTree(corners[np.isfinite(corners).all(1)])
    reach = report.max_corner_angle_deg
    camera = report.intrinsics.camera(2 * reach)
    azimuth = np.linspace(0, 2 * np.pi, 120)
    for theta in np.radians(np.append(np.arange(30, reach, 30), reach)):
        rays = np.stack([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth)], axis=-1)
        circle, _ = camera.project(np.column_stack([rays, np.full(len(rays), np.cos(theta))]))
        ax.plot(*circle.T, color="0.4", lw=0.8)
        # its degrees where corners are farthest
        inside = circle[((circle >= 0) & (circle < report.intrinsics.image_size)).all(1)]
        for u, v in inside[np.argsort(tree.query(inside)[0])[-1:]]:
            halo = [withStroke(linewidth=3, foreground="white")]
            text = f"{np.degrees(theta):.0f}°"
            ax.text(u, v, text, size="small", ha="center", va="center", path_effects=halo)
    _frame_of_image(ax, report, f"{len(report.views_used)} boards, up to {reach:.0f}°")


def _draw_uncovered(ax: Axes, report: CameraReport, camera: OcamCamera) -> None:
    for ring, sector in uncovered(report, camera):
        inner, *_, outer = _part(camera, ring, sector)
        around, inside = camera.project(np.concatenate([inner, outer[::-1]]))
        ax.fill(*around[inside].T, color="C1", alpha=0.35, lw=0)


def _frame_of_image(ax: Axes, report: CameraReport, title: str) -> None:
    width, height = report.intrinsics.image_size
    ax.set(xlim=(0, width), ylim=(height, 0), aspect="equal", title=title)
    ax.set(xlabel="u in px", ylabel="v in px")


def calibration_figure(
    report: CameraReport, camera: OcamCamera | None = None, name: str = ""
) -> Figure:
    """Return what a calibration is judged by: coverage, residuals, by angle, directions; see
    `draw_coverage`. With the name of the camera its title is the verdict, and what to do.
    """
    # read on a telephone, too
    with rc_context(
        {"font.size": 14, "axes.titlesize": 14, "figure.constrained_layout.hspace": 0.06}
    ):
        figure = Figure(figsize=(8.8, 10.4), layout="compressed")
        axes = figure.subplots(2, 2)
        draw_coverage(axes[0, 0], report, camera)
        draw_residuals(axes[0, 1], report)
        draw_error_by_angle(axes[1, 0], report)
        draw_error_directions(axes[1, 1], report)
        # on one grid of squares, whatever the shape of the image
        u, v = (side / 2 for side in report.intrinsics.image_size)
        half = max(u, v)
        for ax in (axes[0, 0], axes[1, 1]):
            ax.set(xlim=(u - half, u + half), ylim=(v + half, v - half))
        names = ["corners found", "error of every corner"]
        names += ["radial error by angle", "direction of the error"]
        for ax, quantity in zip(axes.flat, names, strict=True):
            ax.set(box_aspect=1, adjustable="datalim")
            ax.locator_params(nbins=5)
            # what is drawn, and smaller how to read it
            ax.text(0, 1.03, ax.get_title(), size="small", color="0.35", transform=ax.transAxes)
            ax.set_title("")
            ax.set_title(quantity, loc="left", pad=26)
        if name and camera is not None:
            lines = "\n".join(verdict(report, camera, name))
            figure.suptitle(lines, x=0.02, ha="left", linespacing=1.4)
    return figure


def verdict(report: CameraReport, camera: OcamCamera, name: str) -> list[str]:
    """Return lines: how good the calibration of a camera is, and where to hold the board next."""
    reach, most = report.max_corner_angle_deg, camera.max_fov_deg / 2
    reached = f"corners reach {reach:.0f}° from the axis; the lens is stated to {most:.0f}°"
    missing = bool(uncovered(report, camera))
    good = f"{report.rms_px:.2g} px rms"
    flaw = report.warnings[0].partition(". ")[0] if report.warnings else good
    word = "Fair" if report.warnings or missing else "Good"
    todo = "hold the board next where it is shaded" if missing else "corners in all parts"
    return [*wrap(f"{word}: {name}, {flaw}", 62), reached, todo]
