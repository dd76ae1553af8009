"""`overview.png`: panorama, depth, trust and point cloud on one page.

Drawn by Pillow: loading Matplotlib and laying out a figure would take longer than the depth.
"""

from collections.abc import Sequence
from importlib.metadata import distribution
from textwrap import fill

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from omnistereo_lib.stereo.depth import Depth
from omnistereo_tools.judge.trust import DOUBTFUL
from omnistereo_tools.output.pictures import ColorScale, draw_points, faded
from omnistereo_tools.output.points import PointCloud

_WIDTH, _LEFT = 1880, 70  # px, of the page and of its margin
_TEXT, _TITLE = 14, 17  # px, of letters
_LETTERS = 118  # of a line of a note
_VIEW = (900, 506)  # px, of the points
_AXES = "azimuth from left to right, 0° is ahead; elevation, down is positive"
_TICKS = 30  # px, at least between two elevations


def draw_overview(
    depth: Depth,
    panorama: NDArray[np.uint8],
    cloud: PointCloud,
    trust: NDArray[np.float32],
    title: str,
    notes: Sequence[str],
) -> NDArray[np.uint8]:
    """Return the page, uint8 RGB; doubtful rays and points are faded.

    Args:
        panorama: uint8 array, any size, RGB: the whole panorama, sharper than the depth
        trust: Of `trust.trust`, (H, W).
        title: What was computed and how, one line.
        notes: Sentences to stand below the trust.
    """
    page, scale, phi_deg = _Page(), ColorScale.of(depth.inverse_depth), depth.grid.phi_deg
    wide, half = _WIDTH - 2 * _LEFT, _VIEW[0]
    # Above each other: panorama, depth, and the colours of the depth.
    row = page.panorama(panorama, (_LEFT, 40), wide, phi_deg, f"{title}; {_AXES}", cv2.INTER_AREA)
    name = "Depth along the ray; faded: doubtful, striped: unknown"
    colors = scale.colorize(depth.inverse_depth, trust < DOUBTFUL)
    row = page.panorama(colors, (_LEFT, row + 40), wide, phi_deg, name)
    page.paste(np.repeat(scale.bar(wide), 16, 0), (_LEFT, row + 10))
    for place, label in scale.ticks():
        page.text((_LEFT + place * wide, row + 32), label, "mt")
    # Below, left: trust and notes. Right: the points.
    below, right = row + 90, _WIDTH - 10 - half
    page.paste(
        draw_points(cloud.points, faded(cloud.colors, cloud.doubtful), _VIEW), (right, below)
    )
    page.title((right + half / 2, below), f"{len(cloud.points)} points, from above and behind")
    gray = np.repeat((255 * np.nan_to_num(trust)).astype(np.uint8)[..., None], 3, -1)
    name = f"Trust: confidence at equal range, 0 black, 1 white; below {DOUBTFUL:g} doubtful"
    row = page.panorama(gray, (_LEFT, below), right - 2 * _LEFT, phi_deg, name)
    end = page.text((10, row + 20), "\n\n".join(fill(note, _LETTERS) for note in notes), "la")
    return page.cut(max(end, below + _VIEW[1]) + 20)


class _Page:
    """White paper to paste pictures on and write beside them; places are (column, row) in
    pixels.
    """

    def __init__(self) -> None:
        self._image = Image.new("RGB", (_WIDTH, 3 * _WIDTH), "white")
        self._draw = ImageDraw.Draw(self._image)
        font = distribution("matplotlib").locate_file(
            "matplotlib/mpl-data/fonts/ttf/DejaVuSans.ttf"
        )
        self._text, self._title = (ImageFont.truetype(str(font), size) for size in (_TEXT, _TITLE))

    def paste(self, pixels: NDArray[np.uint8], corner: tuple[int, int]) -> None:
        """Paste a picture (height, width, 3), its upper left corner at a place, with a thin
        frame.
        """
        height, width = pixels.shape[:2]
        self._draw.rectangle(
            (corner[0] - 1, corner[1] - 1, corner[0] + width, corner[1] + height), outline="black"
        )
        self._image.paste(Image.fromarray(pixels), corner)

    def panorama(
        self,
        pixels: NDArray[np.uint8],
        corner: tuple[int, int],
        width: int,
        phi_deg: tuple[float, float],
        title: str,
        resize: int = cv2.INTER_NEAREST,
    ) -> int:
        """Paste a panorama, resized to a width, with a title and degrees at its edges; return the
        row below them.
        """
        (left, top), (first, last) = corner, phi_deg
        scale = width / 360  # px per degree
        height = max(1, round(scale * (last - first)))
        self.paste(
            cv2.resize(pixels, (width, height), interpolation=resize).astype(np.uint8), corner
        )
        self.title((left + width / 2, top), title)
        step = next((step for step in (1, 2, 5, 10, 15, 30) if scale * step >= _TICKS), 45)
        for degrees in range(step * int(np.ceil(first / step)), int(last) + 1, step):
            self.text((left - 6, top + scale * (degrees - first)), f"{degrees}°", "rm")
        for degrees in range(-180, 181, 45):
            self.text((left + scale * (degrees + 180), top + height + 6), f"{degrees}°", "mt")
        return top + height + 6 + _TEXT

    def title(self, place: tuple[float, float], line: str) -> None:
        """Write a line above a place, centred."""
        self._draw.text((place[0], place[1] - 8), line, "black", self._title, "ms")

    def text(self, place: tuple[float, float], text: str, anchor: str) -> int:
        """Write text at a place, which is at its `anchor` (see Pillow); return the row below it."""
        self._draw.text(place, text, "black", self._text, anchor)
        return int(self._draw.textbbox(place, text, self._text, anchor)[3])

    def cut(self, height: int) -> NDArray[np.uint8]:
        """Return the upper part of the page, (height, width, 3)."""
        return np.asarray(self._image.crop((0, 0, _WIDTH, height)))
