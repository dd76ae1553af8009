"""Figures of the notebooks: captioned, live, and the panels that they are made of.

Matplotlib, and what finds depth, are imported by the functions that need them, so that importing
this module stays fast.
"""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from course.figures import stills
from course.figures.captions import caption_output, captions
from course.figures.view3d import draw_points as draw_points
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_tools.output.calibration_figures import calibration_figure as calibration_figure
from omnistereo_tools.output.calibration_figures import draw_coverage as draw_coverage
from omnistereo_tools.output.colors import colorize_depth

if TYPE_CHECKING:
    from ipywidgets import Widget
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

    from omnistereo_lib.stereo.depth import Depth

DEPTH_COLORS = "inferno"  # the colours of `colorize_depth`
SHARP_PX = 1280  # width of the panorama in the viewer
# sharp on a screen, small enough that a notebook stays below 800 KB
DPI = {"png": 150, "jpeg": 100}


def encode(fig: Figure, kind: Literal["png", "jpeg"] = "png", tight: bool = True) -> bytes:
    """Encode a figure as a PNG of 256 colours (lines, text) or a JPEG (photographs).

    A tight figure is cropped to what is drawn, which takes a second drawing.
    """
    from PIL import Image

    drawn, encoded = io.BytesIO(), io.BytesIO()
    fig.savefig(
        drawn,
        format="png",
        dpi=DPI[kind],
        bbox_inches="tight" if tight else None,
        pil_kwargs={"compress_level": 0},  # it is read at once
    )
    image = Image.open(drawn).convert("RGB")
    if kind == "png":
        image.quantize(256, dither=Image.Dither.NONE).save(encoded, "png", optimize=True)
    else:
        image.save(
            encoded, "jpeg", quality=50, progressive=True, optimize=True, dpi=(DPI[kind],) * 2
        )
    return encoded.getvalue()


def show(fig: Figure, name: str) -> None:
    """Show a figure in a notebook, with its caption below it, and close it.

    Args:
        fig: The figure; it is closed afterwards, so that Jupyter does not show it a second time.
        name: Its entry in notebooks/captions.yaml, with
            caption: What the reader should see in it, one or two sentences of Markdown. Appears as
                "*Figure:* ...".
            alt: Text for readers who cannot see it. Stored in the two places that renderers read:
                the metadata of the
            image (nbconvert's classic template) and the plain-text form of the output (MyST,
            terminals).
            kind: "png" for drawings, "jpeg" for photographs and panoramas.

    Raises:
        KeyError: If captions.yaml has no such entry.
    """
    from IPython.display import display

    caption, alt, kind = (captions()[name][key] for key in ("caption", "alt", "kind"))
    show_picture(fig, alt, kind)
    display(caption_output(caption), raw=True)


def show_picture(fig: Figure, alt: str, kind: Literal["png", "jpeg"] = "png") -> None:
    """Show a figure with its alternative text, and close it; `kind` as in `show`."""
    import matplotlib.pyplot as plt
    from IPython import display

    mime = f"image/{kind}"
    picture = base64.b64encode(encode(fig, kind)).decode()
    plt.close(fig)
    display.display({mime: picture, "text/plain": alt}, metadata={mime: {"alt": alt}}, raw=True)


def interactive(draw: Callable[..., Figure], **sliders: Widget) -> None:
    """Show a figure that follows sliders: redrawn, as a small JPEG, whenever one of them moves.

    Notebooks are stored without it: the captioned figure before it says what it shows.

    Args:
        draw: A function of the values of the sliders, by name, that returns a figure.
        sliders: Widgets with a value, named like the arguments of `draw`.
    """
    import matplotlib.pyplot as plt
    from IPython.display import display
    from ipywidgets import Image, VBox

    def drawn(**values: Any) -> bytes:
        fig = draw(**values)
        picture = encode(fig, "jpeg", tight=stills.recording())  # a slider must answer at once
        plt.close(fig)
        return picture

    if stills.recording():
        return stills.record_sliders(lambda **values: [drawn(**values)], sliders)
    picture = Image(format="jpeg")

    def update(_: object = None) -> None:
        picture.value = drawn(**{name: slider.value for name, slider in sliders.items()})

    for name, slider in sliders.items():
        slider.description, slider.layout.width = slider.description or name, "100%"
        slider.observe(update, "value")
    update()
    display(VBox([*sliders.values(), picture]))


def pick_ray(draw: Callable[..., Figure], panorama: NDArray[Any], row: int, column: int) -> None:
    """Show a panorama to click on and, below it, the figure of the ray at the cross.

    Two sliders move the cross as well, by keyboard and in programs that do not support clicks.
    Notebooks are stored without it: the captioned figure before it says what it shows.

    Args:
        draw: A function of the `row` and the `column` of a ray that returns a figure.
        panorama (array, shape (H, W) or (H, W, 3)): Grey values or colours, 0 to 255; NaN becomes
        grey. row, column: Initial position of the cross.
    """
    from ipyevents import Event
    from IPython.display import display
    from ipywidgets import Image, IntSlider, Layout

    height, width = panorama.shape[:2]
    rows, columns = IntSlider(row, 0, height - 1), IntSlider(column, 0, width - 1)
    if stills.recording():
        return stills.record_sliders(
            lambda row, column: [
                _with_cross(panorama, row, column),
                encode(draw(row=row, column=column), "jpeg"),
            ],
            {"row": rows, "column": columns},
        )
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
    interactive(draw, row=rows, column=columns)


def _with_cross(panorama: NDArray[Any], row: int, column: int) -> bytes:
    """Encode a panorama as a JPEG, at three times its size, with an open cross around a ray."""
    import cv2

    gray = np.where(np.isfinite(panorama), panorama, 185).clip(0, 255).astype(np.uint8)
    picture = np.repeat(np.repeat(gray if gray.ndim == 3 else np.stack([gray] * 3, -1), 3, 0), 3, 1)
    x, y = 3 * column + 1, 3 * row + 1
    # dark around bright is visible on any background
    for color, thickness in (((0, 0, 0), 5), ((255, 255, 0), 2)):
        for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            cv2.line(
                picture, (x + 8 * dx, y + 8 * dy), (x + 22 * dx, y + 22 * dy), color, thickness
            )
    return cv2.imencode(".jpg", picture[..., ::-1])[1].tobytes()


def explore(depth: Depth, max_depth: float, min_confidence: float = 0.0) -> None:
    """Show a depth panorama: its points to rotate, tilt and zoom, its image to look around in.

    Notebooks are stored without it: the captioned figure before it says what it shows.

    Args:
        max_depth, min_confidence: Rays up to this depth in metres, and with at least this
        confidence, become points.
    """
    from IPython.display import display
    from ipywidgets import HTML

    from omnistereo_tools.output.pictures import sharp_panorama
    from omnistereo_tools.output.points import Limits
    from omnistereo_tools.output.viewer import page_of, viewer_data

    panorama = sharp_panorama(depth, SHARP_PX)
    limits = Limits(max_depth, min_confidence)
    data = viewer_data(depth, panorama, limits, "Drag to turn and tilt", mode="points")
    if stills.recording():
        return stills.record_view(data)
    page = html.escape(page_of(data))
    display(
        HTML(
            f'<iframe srcdoc="{page}" title="{stills.VIEW}" style="width: 100%; height:'
            ' 800px"></iframe>'
        )
    )


def explain_ray(
    depth: Depth,
    column: int,
    row: int,
    gt_index: NDArray[Any] | None = None,
    volumes: Mapping[str, NDArray[Any]] | None = None,
) -> Figure:
    """Return a figure of why a ray has its depth: the agreement of the cameras along it, their
    patches, their images.

    The agreement is that of the images. What a method made of it, such as the probabilities of a
    network, or costs before and after SGM, is drawn with it, each curve from its least value, 0, to
    its greatest, 1.

    Args:
        depth: With the images from which it was estimated.
        column, row: Of the ray.
        gt_index: Exact sphere indices (H, W), if they are known.
        volumes: Of the method, (H, W, N), each by its name in the legend.
    """
    import matplotlib.pyplot as plt

    from omnistereo_tools.judge import ray
    from omnistereo_tools.output.summary import metres

    one, cameras = ray.explain(depth, column, row), len(depth.sweep.rig)
    rows: list[Any] = [["along"] * cameras]
    rows += [[f"{kind} {i}" for i in range(cameras)] for kind in ("patch", "image")]
    fig, axes = plt.subplot_mosaic(
        rows,
        figsize=(1.6 * cameras, 4.0),
        height_ratios=[1.2, 0.8, 1],
        layout="constrained",
    )
    fig.suptitle(one.sentence, fontsize=10, wrap=True)
    along, nearest = axes["along"], 0 if np.isnan(one.index) else round(one.index)
    along.plot(one.agreement, color="C1", label="agreement")
    modes = one.modes[:3]
    along.plot([m.sphere for m in modes], [m.agreement for m in modes], "o", color="C1")
    for k, (name, volume) in enumerate((volumes or {}).items()):
        values = np.asarray(volume[row, column], float)
        low, high = np.nanmin(values), np.nanmax(values)
        label = f"{name}, {low:.2f} to {high:.2f}"
        along.plot((values - low) / max(high - low, 1e-9), color=f"C{3 + k}", lw=1, label=label)
    # a fraction of a sphere is kilometres there
    far = "beyond 100 m" if one.depth > 100 else metres(one.depth)
    along.axvline(one.index, color="C0", label=f"estimate, {far}")
    if gt_index is not None:
        along.axvline(gt_index[row, column], color="C2", ls="--", label="exact")
    along.set(xlabel="sphere, from far to near", ylim=(-0.2, 1.05))
    along.legend(fontsize=8)
    inverse_depths = depth.grid.index_to_inverse_depth(np.arange(depth.grid.num_spheres))
    for i, (camera, image) in enumerate(zip(depth.sweep.rig.cameras, depth.images, strict=True)):
        axes[f"patch {i}"].imshow(one.patches[i, nearest], cmap="gray", vmin=0, vmax=255)
        label = "hidden" if one.hidden[i] else "" if one.sees[i] else "not in view"
        axes[f"patch {i}"].set(title=f"camera {i + 1}", xlabel=label, xticks=[], yticks=[])
        T_cam_rig = depth.sweep.rig.T_rig_cam[i].inverse()
        points = depth.grid.rays()[row, column] @ T_cam_rig.R.T
        uv, valid = camera.project(points + inverse_depths[:, None] * T_cam_rig.t)
        axes[f"image {i}"].imshow(np.asarray(image).clip(0, 255).astype(np.uint8), cmap="gray")
        axes[f"image {i}"].plot(*np.where(valid[:, None], uv, np.nan).T, color="yellow", lw=1)
        if valid[nearest]:
            axes[f"image {i}"].plot(*uv[nearest], "+", color="red", ms=14, mew=2)
        axes[f"image {i}"].axis("off")
    return fig


def draw_panorama(
    ax: Axes, picture: NDArray[Any], grid: SphereGrid, title: str = "", **imshow: Any
) -> AxesImage:
    """Draw a panorama with its angles: θ to the right, φ down, in degrees.

    Args:
        picture (array, shape (H, W) or (H, W, 3)): Grey values, colours from 0 to 255, or anything
            `imshow` takes; NaN is grey.
        imshow: Further arguments of Matplotlib's imshow.
    """
    picture = np.asarray(picture)
    if picture.ndim == 3:
        picture = np.where(np.isfinite(picture), picture, 185).clip(0, 255).astype(np.uint8)
    low, high = grid.phi_deg
    ax.set_facecolor("0.73")
    image = ax.imshow(
        picture, extent=(-180, 180, high, low), aspect="equal", **{"cmap": "gray", **imshow}
    )
    ax.set_xticks(range(-180, 181, 90))
    ax.set_yticks([low, 0, high] if low < 0 < high else [low, high])
    ax.set_xlabel("θ [°]")
    ax.set_ylabel("φ [°]")
    ax.set_title(title, loc="left", fontsize=10)
    return image


def draw_depth(
    ax: Axes, inverse_depth: NDArray[Any], grid: SphereGrid, title: str = ""
) -> AxesImage:
    """Draw a panorama of inverse depth (H, W), 1/m, a bar in metres; unknown is striped."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    image = draw_panorama(ax, colorize_depth(inverse_depth, grid), grid, title)
    colors = ScalarMappable(Normalize(0, 1 / grid.min_depth), DEPTH_COLORS)
    bar = ax.figure.colorbar(colors, ax=ax, fraction=0.02, pad=0.01)
    ticks = [share / grid.min_depth for share in (0, 0.25, 0.5, 1)]
    bar.set_ticks(ticks, labels=["∞" if tick == 0 else f"{1 / tick:.3g} m" for tick in ticks])
    return image


def draw_rig(ax: Axes, rig: Rig, fov_deg: float | None = None) -> None:
    """Draw a rig from above: z up, x to the right, an arrow and a wedge of view for each camera.

    Args:
        fov_deg: Opening angle of the wedges; default: the field of view of each camera.
    """
    from matplotlib.patches import Wedge

    reach = 1.2 * float(rig.baselines.max())
    for i, (pose, camera) in enumerate(zip(rig.T_rig_cam, rig.cameras, strict=True)):
        (x, _, z), (forward_x, _, forward_z) = pose.t, pose.R[:, 2]
        color = f"C{i}"
        half = (fov_deg or camera.max_fov_deg) / 2
        direction = np.degrees(np.arctan2(forward_z, forward_x))
        ax.add_patch(
            Wedge((x, z), reach, direction - half, direction + half, color=color, alpha=0.08)
        )
        dx, dz = 0.3 * reach * forward_x, 0.3 * reach * forward_z
        ax.arrow(x, z, dx, dz, color=color, head_width=0.05 * reach)
        ax.plot(x, z, "o", color=color)
        ax.annotate(
            f"camera {i + 1}", (x, z), textcoords="offset points", xytext=(8, 6), color=color
        )
    center = rig.centers.mean(0)
    ax.plot(center[0], center[2], "k+", markersize=12)
    ax.annotate("sweep centre", (center[0], center[2]), textcoords="offset points", xytext=(6, -12))
    ax.set_aspect("equal")
    ax.autoscale_view()
    ax.set_xlabel("x (right) [m]")
    ax.set_ylabel("z (forward) [m]")
