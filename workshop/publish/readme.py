"""The README's picture, its animation and its viewer, which `python -m workshop pages` updates."""

from __future__ import annotations

import io
import tempfile
import warnings
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from matplotlib import patheffects
from numpy.typing import ArrayLike, NDArray

import omnistereo_lib as osl
from course import nbtools
from course.figures.plot import DEPTH_COLORS
from course.figures.view3d import draw_mesh
from omnistereo_lib.files import write_text
from omnistereo_lib.stereo.depth import Depth
from omnistereo_tools import cli
from omnistereo_tools.commands.options import SAMPLE
from omnistereo_tools.judge.ray import for_the_page
from omnistereo_tools.output.colors import colorize_depth
from omnistereo_tools.output.mesh_export import write_mesh
from omnistereo_tools.output.points import Limits
from omnistereo_tools.output.viewer import data_of, page_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PICTURE = nbtools.NOTEBOOKS / "omnistereo.webp"
SWEEP = nbtools.NOTEBOOKS / "sweep.webp"
STREET = nbtools.ROOT / "book" / "street.html"
WIDTH_PX, DPI = 1600, 100
# gray levels, mean difference: 0.03 with another number of threads, 9 with another method
SAME = 0.2
EYE = (-6.5, -1.7, 2.0)  # metres, rig frame
GAMMA = 0.7  # the street is in shadow; less than 1 makes it brighter
STEPS, STEP_MS = 32, 130


def update_pictures() -> None:
    """Update the picture, the animation and the viewer."""
    frame = osl.load_dataset(SAMPLE)[0]
    grid = osl.SphereGrid(
        width=1280, height=320, phi_deg=(-45, 45), num_spheres=192, min_depth=frame.rig.min_depth
    )
    depth = osl.estimate_depth(frame, grid, method="volumenet")
    drawn = io.BytesIO()
    fig = picture(depth)
    fig.savefig(
        drawn, format="webp", dpi=DPI, facecolor="white", pil_kwargs={"quality": 75, "method": 6}
    )
    if renew(PICTURE, drawn.getvalue()):
        SWEEP.write_bytes(animation(depth))
        with tempfile.TemporaryDirectory() as folder:
            cli.main(["depth", "--out", folder])
            page = Path(folder, "index.html").read_text(encoding="utf-8")
    else:  # the same depth on the page as it is now
        page = page_of(data_of(STREET.read_text(encoding="utf-8")) | {"ray": for_the_page()})
    write_text(STREET, page)


def renew(path: Path, picture: bytes) -> bool:
    """Write an image unless the file shows the same already; return whether it was written.

    On another processor, or with another number of threads, the last digits of the network differ,
    and some bytes.
    """
    files = path.read_bytes(), picture
    old, new = (cv2.imdecode(np.frombuffer(file, np.uint8), 1) for file in files)
    same = old.shape == new.shape and cv2.absdiff(old, new).mean() <= SAME
    if not same:
        path.write_bytes(picture)
    return not same


def picture(depth: Depth) -> Figure:
    """Draw fisheye images, panorama, depth with a scale in metres, and surfaces, in a column."""
    import matplotlib.pyplot as plt
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    gap, scale, grid = 8, 64, depth.grid  # pixels
    side, high, surfaces = (WIDTH_PX - 3 * gap) // 4, WIDTH_PX // 4, 600
    height = side + 2 * high + scale + surfaces + 3 * gap
    panorama = brighter(depth.panorama())
    with tempfile.TemporaryDirectory() as folder:
        mesh = Path(folder) / "street.ply"
        write_mesh(mesh, depth, panorama, Limits(max_depth=40, min_confidence=0))
        # below is the road that no camera sees
        view = draw_mesh(mesh, EYE, (WIDTH_PX, 960))[60 : 60 + surfaces]
    fig = plt.figure(figsize=(WIDTH_PX / DPI, height / DPI))

    def place(left: int, top: int, width: int, height_px: int) -> Axes:
        bottom = height - top - height_px
        return fig.add_axes(
            (left / WIDTH_PX, bottom / height, width / WIDTH_PX, height_px / height)
        )

    def draw(
        image: NDArray[Any], left: int, top: int, width: int, height_px: int, label: str = ""
    ) -> None:
        ax = place(left, top, width, height_px)
        ax.imshow(image, aspect="auto", interpolation="lanczos")
        ax.axis("off")
        style: dict[str, Any] = {"color": "white", "fontsize": 30, "weight": "bold", "va": "top"}
        style["path_effects"] = [patheffects.withStroke(linewidth=6, foreground="black")]
        ax.text(14 / width, 1 - 12 / height_px, label, transform=ax.transAxes, **style)

    for k, (camera, image) in enumerate(zip(depth.sweep.rig.cameras, depth.images, strict=True)):
        disc = np.where(camera.visible_pixels()[..., None], brighter(image), 255).astype(np.uint8)
        draw(disc, k * (side + gap), 0, side, side, "fisheyes" if k == 0 else "")
    top = side + gap
    draw(panorama, 0, top, WIDTH_PX, high, "panorama")
    draw(colorize_depth(depth.inverse_depth, grid), 0, top + high + gap, WIDTH_PX, high, "depth")
    draw(view, 0, top + 2 * (high + gap) + scale, WIDTH_PX, surfaces, "surfaces")
    bar = fig.colorbar(
        ScalarMappable(Normalize(0, 1 / grid.min_depth), DEPTH_COLORS),
        cax=place(50, top + 2 * high + gap + 8, WIDTH_PX - 100, 12),
        orientation="horizontal",
    )
    metres = [np.inf, 20, 10, 5, 3, 2]
    labels = ["∞" if np.isinf(m) else f"{m} m" for m in metres]
    bar.set_ticks([1 / m for m in metres], labels=labels)
    bar.ax.tick_params(labelsize=24, length=3, pad=1)
    bar.outline.set_visible(False)
    return fig


def brighter(image: ArrayLike) -> NDArray[np.uint8]:
    """Return an image in [0, 255] with its shadows lifted."""
    return (255 * (np.nan_to_num(image).clip(0, 255) / 255) ** GAMMA).astype(np.uint8)


def animation(depth: Depth) -> bytes:
    """Return an animated WebP: the sphere sweeps inwards, what it touches is in focus, and the
    depth grows.

    Above the mean of all cameras on the sphere, below the depth of the rays whose surface the
    sphere has passed.
    """
    from PIL import Image

    grid = replace(depth.grid, width=640, height=160)
    sweep = osl.SphereSweep(depth.sweep.rig, grid)
    index, colors = depth.index[::2, ::2], colorize_depth(depth.inverse_depth, depth.grid)[::2, ::2]
    frames = []
    for n in np.linspace(0, grid.num_spheres - 1, STEPS):
        with np.errstate(invalid="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # rays that no camera sees
            mean = brighter(np.nanmean(np.stack(sweep.warp(depth.images, n)), 0))
        passed = np.where((index <= n)[..., None], colors, 32).astype(np.uint8)
        frames.append(Image.fromarray(np.concatenate([mean, passed])))
    written = io.BytesIO()
    times = [STEP_MS] * (STEPS - 1) + [2500]  # the last one stays
    frames[0].save(
        written,
        "webp",
        save_all=True,
        append_images=frames[1:],
        duration=times,
        loop=0,
        quality=24,
        method=6,
    )
    return written.getvalue()
