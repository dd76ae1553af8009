"""The generated parts of the README: its image and its table of notebooks. `python -m course readme`."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

import omnistereo_lib as osl
from course import nbtools
from course.plot import DEPTH_COLORS
from omnistereo_tools.pictures import colorize_depth, draw_points

if TYPE_CHECKING:
    from matplotlib.figure import Figure

README = nbtools.ROOT / "README.md"
TABLE = re.compile(r"(?<=<!-- notebooks -->\n).*(?=<!-- /notebooks -->)", re.DOTALL)
PICTURE = nbtools.NOTEBOOKS / "omnistereo.jpg"
WIDTH_PX, DPI = 2000, 100
GROUND = "#202020"  # the background of the points
FRAME = 831
SAME = 0.2  # gray levels, mean difference: 0.03 with another number of threads, 9 with another method
EYE = (-4.0, -3.0, -5.2)  # metres, rig frame


def main() -> None:
    """Update the table and the image."""
    nbtools.store(README, with_table(README.read_text(encoding="utf-8"), nbtools.notebooks()))
    data = osl.load_dataset(nbtools.ROOT / "data_samples" / "sunny", split="test")
    grid = osl.SphereGrid(width=1280, height=320, phi_deg=(-45, 45), num_spheres=192, min_depth=data.rig.min_depth)
    frame = data.frame(FRAME)
    depth = osl.estimate_depth(data.rig, frame.images, grid, method="volumenet")
    points, colors = depth.point_cloud(frame.images, max_depth=30)
    fig = picture(depth.panorama(frame.images), depth.inverse_depth, grid, points, colors)
    drawn = io.BytesIO()
    fig.savefig(drawn, format="jpeg", dpi=DPI, facecolor=GROUND, pil_kwargs={"quality": 85, "optimize": True})
    renew(PICTURE, drawn.getvalue())


def readme_table(paths: list[Path]) -> str:
    """Return the table of notebooks, from their own metadata."""
    rows = ["| notebook | what you learn | you write | to read | needs |", "|---|---|---|---|---|"]
    for path in paths:
        nb = nbtools.read_notebook(path)
        facts, number = nb.metadata["omnistereo"], len(nbtools.open_functions(nb))
        write = f"{number} functions" if number else "exercises"
        rows.append(
            f"| [{nbtools.number(path)} {facts['title']}](notebooks/{path.name}) | {facts['learn']} "
            f"| {write} | {facts['minutes_to_read']} min | {facts['needs']} |"
        )
    return "\n".join(rows) + "\n"


def with_table(readme: str, paths: list[Path]) -> str:
    """Return the README's text with the table between its two markers renewed."""
    if not TABLE.search(readme):
        raise SystemExit("README.md has no lines <!-- notebooks --> and <!-- /notebooks --> for the table")
    return TABLE.sub(lambda _: readme_table(paths), readme, count=1)


def renew(path: Path, picture: bytes) -> None:
    """Write an image unless the file shows the same already.

    On another processor, or with another number of threads, the last digits of the network differ, and some bytes.
    """
    old, new = (cv2.imdecode(np.frombuffer(data, np.uint8), 1) for data in (path.read_bytes(), picture))
    if old.shape != new.shape or cv2.absdiff(old, new).mean() > SAME:
        path.write_bytes(picture)


def picture(
    panorama: NDArray, inverse_depth: NDArray, grid: osl.SphereGrid, points: NDArray, colors: NDArray
) -> Figure:
    """Draw a panorama, its depth below it with a scale in metres, and its points on the right.

    Args:
        panorama: array, shape (H, W, 3), RGB, 0 to 255
        inverse_depth: array, shape (H, W), 1/m
        grid: Grid of both, four times as wide as high (±45°).
        points: array, shape (M, 3), metres, rig frame
        colors: uint8 array, shape (M, 3), RGB
    """
    import matplotlib.pyplot as plt
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    gap, wide, scale = 10, 1320, 46  # pixels; the scale is below the depth
    high = wide // 4
    height = 2 * high + gap + scale
    right = WIDTH_PX - wide - gap
    fig = plt.figure(figsize=(WIDTH_PX / DPI, height / DPI))

    def place(left: int, bottom: int, width: int, height_px: int) -> plt.Axes:
        return fig.add_axes((left / WIDTH_PX, bottom / height, width / WIDTH_PX, height_px / height))

    panels = {
        (0, scale + high + gap, wide, high): panorama.clip(0, 255).astype(np.uint8),
        (0, scale, wide, high): colorize_depth(inverse_depth, grid),
        (wide + gap, 0, right, height): draw_points(points, colors, (right, height), EYE),
    }
    for where, image in panels.items():
        ax = place(*where)
        ax.imshow(image, aspect="auto", interpolation="lanczos")
        ax.axis("off")
    bar = fig.colorbar(
        ScalarMappable(Normalize(0, 1 / grid.min_depth), DEPTH_COLORS),
        cax=place(wide // 20, scale - 14, wide * 9 // 10, 8),
        orientation="horizontal",
    )
    metres = [np.inf, 20, 10, 5, 3, 2]
    bar.set_ticks([1 / m for m in metres], labels=["∞" if np.isinf(m) else f"{m} m" for m in metres])
    bar.ax.tick_params(colors="white", labelsize=15, length=3, pad=1)
    bar.outline.set_visible(False)
    return fig
