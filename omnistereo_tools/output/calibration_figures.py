"""Figures by which a calibration is judged."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from omnistereo_rigs.boards.report import CameraReport


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


def draw_coverage(ax: Axes, report: CameraReport) -> None:
    """Draw all corners in the image, a colour for each view, with circles of 30°, 60°, 90°."""
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


def calibration_figure(report: CameraReport) -> Figure:
    """Return what a calibration is judged by: coverage, residuals, by angle, directions."""
    figure = Figure(figsize=(11, 9), layout="constrained")
    axes = figure.subplots(2, 2)
    draw_coverage(axes[0, 0], report)
    draw_residuals(axes[0, 1], report)
    draw_error_by_angle(axes[1, 0], report)
    draw_error_directions(axes[1, 1], report)
    return figure
