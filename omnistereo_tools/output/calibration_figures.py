"""Figures by which a calibration is judged."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from omnistereo_lib.geometry.camera import OcamCamera

if TYPE_CHECKING:
    from omnistereo_rigs.boards.report import CameraReport

_FEW = 10  # corners in a part of the image
# Parts of the image: rings from the axis, in degrees, and eight sectors.
_RINGS = {"halfway out": (30.0, 60.0), "near the rim": (60.0, 180.0)}
_SECTORS = ["right", "lower right", "bottom", "lower left"]
_SECTORS += ["left", "upper left", "top", "upper right"]


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
    ax.set(
        aspect="equal",
        xlabel="u error in px",
        ylabel="v error in px",
        title=f"rms {report.rms_px:.3f} px",
    )
    limit = 5 * report.sigma_px
    ax.set(xlim=(-limit, limit), ylim=(limit, -limit))


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
    ax.legend(loc="upper left")


def draw_error_directions(ax: Axes, report: CameraReport) -> None:
    """Draw every corner, coloured by its residual's direction: one colour nearby is a bias."""
    corners = np.concatenate([report.corners[view] for view in report.views_used])
    residuals = np.concatenate(list(report.residuals_used().values()))
    direction = np.degrees(np.arctan2(residuals[:, 1], residuals[:, 0]))
    known = np.isfinite(direction)
    u, v = corners[known].T
    dots = ax.scatter(
        u, v, c=direction[known], s=9, linewidths=0, cmap="twilight", vmin=-180, vmax=180
    )
    bar = ax.figure.colorbar(dots, ax=ax, fraction=0.04)
    bar.set_ticks(range(-180, 181, 90), labels=["left", "up", "right", "down", "left"])
    _frame_of_image(ax, report, "direction of the error")


def uncovered(report: CameraReport, camera: OcamCamera) -> list[tuple[str, int]]:
    """Return the parts of the image, (ring, sector), in which fewer than ten corners were seen."""
    corners = np.concatenate([report.corners[view] for view in report.views_used])
    angles = np.degrees(np.concatenate([report.angles[view] for view in report.views_used]))
    x, y = (corners - camera.center).T
    sectors = np.round(np.arctan2(y, x) / (np.pi / 4)) % 8
    found = []
    for ring, (low, high) in _RINGS.items():
        within = (angles >= low) & (angles < high)
        for sector in range(8):
            if (within & (sectors == sector)).sum() < _FEW and _is_in_image(camera, ring, sector):
                found.append((ring, sector))
    return found


def where_next(report: CameraReport, camera: OcamCamera) -> str:
    """Return where to hold the board for the next pictures, in words; "" where all was covered."""
    parts = uncovered(report, camera)
    places = {
        ring: [_SECTORS[sector] for found, sector in parts if found == ring] for ring in _RINGS
    }
    return "; ".join(
        f"{ring}: " + ("all around" if len(names) == 8 else ", ".join(names))
        for ring, names in places.items()
        if names
    )


def _outline(camera: OcamCamera, ring: str, sector: int) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels along the outline of a part of the image, (N, 2), and which are in view."""
    low, high = _RINGS[ring]
    middle, half = np.pi / 4 * sector, np.pi / 8
    turn = np.linspace(middle - half, middle + half, 12)
    inner, outer = (np.radians(min(end, camera.max_fov_deg / 2 - 0.5)) for end in (low, high))
    theta = np.concatenate([np.full(12, inner), np.full(12, outer)])
    azimuth = np.concatenate([turn, turn[::-1]])
    sine = np.sin(theta)
    rays = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(theta)], -1)
    return camera.project(rays)


def _is_in_image(camera: OcamCamera, ring: str, sector: int) -> bool:
    """Return whether more than half of the outline of a part is in view."""
    inner = _RINGS[ring][0]
    return bool(_outline(camera, ring, sector)[1].mean() > 0.5) and inner < camera.max_fov_deg / 2


def draw_coverage(ax: Axes, report: CameraReport, camera: OcamCamera | None = None) -> None:
    """Draw all corners in the image, a colour for each view, with circles of 30°, 60°, 90°; of a
    calibrated camera also the parts without corners, shaded.
    """
    if camera is not None:
        _draw_uncovered(ax, report, camera)
    for view in report.views_used:
        u, v = report.corners[view].T
        ax.scatter(u, v, s=5, linewidths=0)
    reach = report.max_corner_angle_deg
    camera = report.intrinsics.camera(2 * reach)
    azimuth = np.linspace(0, 2 * np.pi, 120)
    for theta in np.radians(np.append(np.arange(30, reach, 30), reach)):
        rays = np.stack([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth)], axis=-1)
        circle, _ = camera.project(np.column_stack([rays, np.full(len(rays), np.cos(theta))]))
        ax.plot(*circle.T, color="0.4", lw=0.8)
        ax.annotate(f"{np.degrees(theta):.0f}°", circle[15], fontsize=8)
    _frame_of_image(ax, report, f"{len(report.views_used)} boards, up to {reach:.0f}°")


def _draw_uncovered(ax: Axes, report: CameraReport, camera: OcamCamera) -> None:
    for ring, sector in uncovered(report, camera):
        around, inside = _outline(camera, ring, sector)
        ax.fill(*around[inside].T, color="C1", alpha=0.25, lw=0)
        ax.annotate("here next", around[inside].mean(0), fontsize=8, ha="center", color="C3")


def _frame_of_image(ax: Axes, report: CameraReport, title: str) -> None:
    width, height = report.intrinsics.image_size
    ax.set(
        xlim=(0, width),
        ylim=(height, 0),
        aspect="equal",
        title=title,
        xlabel="u in px",
        ylabel="v in px",
    )


def calibration_figure(
    report: CameraReport, camera: OcamCamera | None = None, name: str = ""
) -> Figure:
    """Return what a calibration is judged by: coverage, residuals, by angle, directions; see
    `draw_coverage`. With the name of the camera its title says what is found, and what to do.
    """
    figure = Figure(figsize=(11, 9), layout="constrained")
    axes = figure.subplots(2, 2)
    draw_coverage(axes[0, 0], report, camera)
    draw_residuals(axes[0, 1], report)
    draw_error_by_angle(axes[1, 0], report)
    draw_error_directions(axes[1, 1], report)
    if name and camera is not None:
        reach, most = report.max_corner_angle_deg, camera.max_fov_deg / 2
        todo = (
            "hold the board where it is shaded" if uncovered(report, camera) else "all is covered"
        )
        found = f"rms {report.rms_px:.2f} px, corners up to {reach:.0f}° of {most:.0f}°"
        figure.suptitle(f"{name}: {found}; {todo}", fontsize=14)
        axes[0, 1].set_title("every error; circles of one, two and three σ")
        axes[1, 0].set_title("a mean off zero: the lens model is too simple there")
        axes[1, 1].set_title("direction of the error; one colour nearby: a bias")
    return figure
