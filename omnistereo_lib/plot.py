"""Pictures for the notebooks. The only module that draws; Matplotlib is imported when it does."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.calibrate.report import CameraReport
from omnistereo_lib.rig import Rig
from omnistereo_lib.sphere import SphereGrid

if TYPE_CHECKING:
    from ipywidgets import Widget
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

DEPTH_COLORS = "inferno"  # even in lightness, so that it reads in gray and to colour-blind eyes
DPI = 80  # sharp enough to read, small enough that a notebook stays below 500 KB


def encode(fig: Figure, kind: Literal["png", "jpeg"] = "png", tight: bool = True) -> bytes:
    """Encode a figure as a PNG (lines, text, flat colours) or a JPEG (photographs) at 80 dots per inch.

    A tight one is cut to what is drawn, for which it is drawn twice.
    """
    buffer = io.BytesIO()
    # Matplotlib writes its version into a PNG: without it the file depends on the picture alone.
    extra = {"metadata": {"Software": None}} if kind == "png" else {}
    pil = {"optimize": True} if kind == "png" else {"quality": 78, "optimize": True}
    fig.savefig(buffer, format=kind, dpi=DPI, bbox_inches="tight" if tight else None, pil_kwargs=pil, **extra)
    return buffer.getvalue()


def show(fig: Figure, caption: str, alt: str, kind: Literal["png", "jpeg"] = "png") -> None:
    """Show a figure in a notebook, with a caption below it, and close it.

    Parameters
    ----------
    fig
        The figure; it is closed afterwards, so that Jupyter does not show it a second time.
    caption
        What the reader should see in it, one or two sentences of Markdown. Appears as "*Figure:* ...".
    alt
        What the picture shows, for somebody who cannot see it. Stored in both places that renderers look
        at: the image's metadata (nbconvert's classic template) and the output's plain-text form (MyST,
        terminals). JupyterLab 4 reads neither; there the caption speaks.
    kind
        "png" for drawings, "jpeg" for photographs and panoramas.
    """
    import matplotlib.pyplot as plt
    from IPython.display import display

    mime = f"image/{kind}"
    picture = base64.b64encode(encode(fig, kind)).decode()
    plt.close(fig)
    display({mime: picture, "text/plain": alt}, metadata={mime: {"alt": alt}}, raw=True)
    display({"text/markdown": f"*Figure:* {caption}", "text/plain": caption}, raw=True)


def live(draw: Callable[..., Figure], **sliders: Widget) -> None:
    """Show a figure that follows sliders, drawn anew as a small JPEG whenever one of them moves.

    Notebooks are stored without it: the captioned figure before it says what it shows.

    Parameters
    ----------
    draw : callable
        Takes the sliders' values by name, returns a figure.
    sliders : ipywidgets
        Widgets with a value, named as the arguments of `draw`.
    """
    import matplotlib.pyplot as plt
    from IPython.display import display
    from ipywidgets import Image, VBox

    picture = Image(format="jpeg")

    def update(_: object = None) -> None:
        fig = draw(**{name: slider.value for name, slider in sliders.items()})
        picture.value = encode(fig, "jpeg", tight=False)  # a slider is to answer at once
        plt.close(fig)

    for name, slider in sliders.items():
        slider.description = slider.description or name
        slider.observe(update, "value")
    update()
    display(VBox([*sliders.values(), picture]))


def explore(draw: Callable[[int, int], Figure], panorama: NDArray, row: int, column: int) -> None:
    """Show a panorama to click on and, below it, the figure of the ray at the cross.

    Two sliders move the cross as well: by the keyboard, and in programs that know no clicks.
    Notebooks are stored without it: the captioned figure before it says what it shows.

    Parameters
    ----------
    draw : callable
        Takes the row and the column of a ray by these names, returns a figure.
    panorama : array, shape (H, W) or (H, W, 3)
        Gray values or colours of 0 … 255; NaN becomes gray.
    row, column : int
        Where the cross is at first.
    """
    from ipyevents import Event
    from IPython.display import display
    from ipywidgets import Image, IntSlider, Layout

    height, width = panorama.shape[:2]
    rows, columns = IntSlider(row, 0, height - 1), IntSlider(column, 0, width - 1)
    picture = Image(format="jpeg", layout=Layout(width="100%"))

    def mark(_: object = None) -> None:
        picture.value = _with_cross(panorama, rows.value, columns.value)

    def move(event: dict[str, Any]) -> None:
        rows.value = int(height * event["relativeY"] / event["boundingRectHeight"])
        columns.value = int(width * event["relativeX"] / event["boundingRectWidth"])

    for slider in (rows, columns):
        slider.observe(mark, "value")
    Event(source=picture, watched_events=["click"]).on_dom_event(move)
    mark()
    display(picture)
    live(draw, row=rows, column=columns)


def _with_cross(panorama: NDArray, row: int, column: int) -> bytes:
    """Encode a panorama, three pixels for one, with an open cross around a ray, as a JPEG."""
    import cv2

    gray = np.where(np.isfinite(panorama), panorama, 185).clip(0, 255).astype(np.uint8)
    picture = np.repeat(np.repeat(gray if gray.ndim == 3 else np.stack([gray] * 3, -1), 3, 0), 3, 1)
    x, y = 3 * column + 1, 3 * row + 1
    for color, thickness in (((0, 0, 0), 5), ((255, 255, 0), 2)):  # dark around bright: seen on any ground
        for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            cv2.line(picture, (x + 8 * dx, y + 8 * dy), (x + 22 * dx, y + 22 * dy), color, thickness)
    return cv2.imencode(".jpg", picture[..., ::-1])[1].tobytes()


def depth_picture(inverse_depth: NDArray, grid: SphereGrid) -> NDArray[np.uint8]:
    """Colour a panorama of inverse depth: near is bright and warm, far is dark, unknown is striped gray.

    Parameters
    ----------
    inverse_depth : array, shape (H, W), 1/m, NaN unknown
    grid : SphereGrid
        Its nearest sphere is the brightest colour.

    Returns
    -------
    uint8 array, shape (H, W, 3), RGB
    """
    from matplotlib import colormaps

    colors = 255 * colormaps[DEPTH_COLORS](np.nan_to_num(inverse_depth) * grid.min_depth)[..., :3]
    rows, columns = np.indices(inverse_depth.shape)
    stripes = np.where((rows + columns) // 4 % 2, 170, 200)[..., None]
    return np.where(np.isfinite(inverse_depth)[..., None], colors, stripes).round().astype(np.uint8)


def draw_panorama(ax: Axes, picture: NDArray, grid: SphereGrid, title: str = "", **imshow: Any) -> AxesImage:
    """Draw a panorama with its angles: θ to the right, φ down, in degrees.

    Parameters
    ----------
    ax : Matplotlib axes
    picture : array, shape (H, W) or (H, W, 3)
        Gray values and colours of 0 … 255 or anything `imshow` takes; NaN stays gray.
    grid : SphereGrid
    title : str
    imshow
        Further arguments of Matplotlib's imshow.
    """
    picture = np.asarray(picture)
    if picture.ndim == 3:
        picture = np.where(np.isfinite(picture), picture, 185).clip(0, 255).astype(np.uint8)
    low, high = grid.phi_deg
    ax.set_facecolor("0.73")
    image = ax.imshow(picture, extent=(-180, 180, high, low), aspect="equal", **{"cmap": "gray", **imshow})
    ax.set_xticks(range(-180, 181, 90))
    ax.set_yticks([low, 0, high] if low < 0 < high else [low, high])
    ax.set_xlabel("θ [°]")
    ax.set_ylabel("φ [°]")
    ax.set_title(title, loc="left", fontsize=10)
    return image


def draw_depth(ax: Axes, inverse_depth: NDArray, grid: SphereGrid, title: str = "") -> AxesImage:
    """Draw a panorama of inverse depth (H, W) in 1/m with a colour bar in metres; unknown rays are striped."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    image = draw_panorama(ax, depth_picture(inverse_depth, grid), grid, title)
    colors = ScalarMappable(Normalize(0, 1 / grid.min_depth), DEPTH_COLORS)
    bar = ax.figure.colorbar(colors, ax=ax, fraction=0.02, pad=0.01)
    ticks = np.array([0, 0.25, 0.5, 1]) / grid.min_depth
    bar.set_ticks(ticks, labels=["∞" if tick == 0 else f"{1 / tick:.3g} m" for tick in ticks])
    return image


def draw_rig(ax: Axes, rig: Rig, fov_deg: float | None = None) -> None:
    """Draw a rig from above: z up, x to the right, an arrow and a wedge of view for each camera.

    Parameters
    ----------
    ax : Matplotlib axes
    rig : Rig
    fov_deg : float, optional
        Opening of the wedges; the cameras' field of view unless given.
    """
    from matplotlib.patches import Wedge

    reach = 1.2 * float(rig.baselines.max())
    for i, (pose, camera) in enumerate(zip(rig.T_rig_cam, rig.cameras, strict=True)):
        (x, _, z), (forward_x, _, forward_z) = pose.t, pose.R[:, 2]
        color = f"C{i}"
        half = (fov_deg or camera.max_fov_deg) / 2
        direction = np.degrees(np.arctan2(forward_z, forward_x))
        ax.add_patch(Wedge((x, z), reach, direction - half, direction + half, color=color, alpha=0.08))
        ax.arrow(x, z, 0.3 * reach * forward_x, 0.3 * reach * forward_z, color=color, head_width=0.05 * reach)
        ax.plot(x, z, "o", color=color)
        ax.annotate(f"camera {i + 1}", (x, z), textcoords="offset points", xytext=(8, 6), color=color)
    center = rig.centers.mean(0)
    ax.plot(center[0], center[2], "k+", markersize=12)
    ax.annotate("sweep centre", (center[0], center[2]), textcoords="offset points", xytext=(6, -12))
    ax.set_aspect("equal")
    ax.autoscale_view()
    ax.set_xlabel("x (right) [m]")
    ax.set_ylabel("z (forward) [m]")


# --- Calibration ------------------------------------------------------------------------------------------


def draw_residuals(ax: Axes, report: CameraReport) -> None:
    """Draw every corner's residual from one origin, with circles of one, two and three sigma: it should be a cloud."""
    residuals = report.inliers()
    ax.scatter(*residuals.T, s=5, alpha=0.4, linewidths=0)
    angle = np.linspace(0, 2 * np.pi, 100)
    for sigmas in (1, 2, 3):
        ax.plot(*(sigmas * report.sigma_px * np.array([np.cos(angle), np.sin(angle)])), color="0.4", lw=0.8)
    ax.set(aspect="equal", xlabel="u error in px", ylabel="v error in px", title=f"rms {report.rms_px:.3f} px")
    limit = 5 * report.sigma_px
    ax.set(xlim=(-limit, limit), ylim=(limit, -limit))


def draw_error_by_angle(ax: Axes, report: CameraReport) -> None:
    """Draw the radial residual of every corner against its angle from the axis, and its mean over each 10°.

    A mean that leaves zero is a polynomial of too low a degree.
    """
    angles = np.degrees(np.concatenate([report.angles[view] for view in report.views_used]))
    corners = np.concatenate([report.corners[view] for view in report.views_used])
    residuals = np.concatenate(list(report.counted().values()))
    outwards = corners - report.intrinsics.vector[:2]
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    radial = np.sum(residuals * outwards, axis=1)
    known = np.isfinite(radial)
    ax.scatter(angles[known], radial[known], s=5, alpha=0.4, linewidths=0)
    ring = angles[known] // 10
    rings = np.unique(ring)
    ax.plot(10 * rings + 5, [radial[known][ring == i].mean() for i in rings], "o-", color="C1", label="mean over 10°")
    limit = 6 * report.sigma_px
    ax.set(xlabel="angle from the axis in degrees", ylabel="radial error in px", ylim=(-limit, limit))
    ax.legend(loc="upper left")


def draw_error_directions(ax: Axes, report: CameraReport) -> None:
    """Draw every corner in the image, coloured by its residual's direction: neighbours of one colour are a bias."""
    corners = np.concatenate([report.corners[view] for view in report.views_used])
    residuals = np.concatenate(list(report.counted().values()))
    direction = np.degrees(np.arctan2(residuals[:, 1], residuals[:, 0]))
    known = np.isfinite(direction)
    ax.scatter(*corners[known].T, c=direction[known], cmap="twilight", vmin=-180, vmax=180, s=9, linewidths=0)
    _frame_of_image(ax, report, "direction of the error")


def draw_coverage(ax: Axes, report: CameraReport) -> None:
    """Draw all corners in the image, a colour for each view, with circles at 30°, 60°, 90° from the axis."""
    for view in report.views_used:
        ax.scatter(*report.corners[view].T, s=5, linewidths=0)
    reach = report.coverage_deg
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
    ax.set(xlim=(0, width), ylim=(height, 0), aspect="equal", title=title, xlabel="u in px", ylabel="v in px")


def calibration_figure(report: CameraReport) -> Figure:
    """Return the four pictures that a calibration is judged by: coverage, residuals, by angle, directions."""
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(2, 2, figsize=(11, 9), layout="constrained")
    draw_coverage(axes[0, 0], report)
    draw_residuals(axes[0, 1], report)
    draw_error_by_angle(axes[1, 0], report)
    draw_error_directions(axes[1, 1], report)
    return fig
