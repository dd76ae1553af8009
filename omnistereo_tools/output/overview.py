"""`overview.png`: panorama, depth, trust and surfaces on one page.

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
from omnistereo_tools.output.colors import ColorScale
from omnistereo_tools.output.pictures import AWAY
from omnistereo_tools.output.render import around, draw_surfaces

_WIDTH, _GAP = 1800, 40  # px, of the page, and between what is on it
_LEFT, _RIGHT = 1010, 580  # px, of pictures in the two columns
# px, of letters: the verdict and the notes are legible 390 px wide, where they are 14 and 8 px
_TEXT, _NAME, _NOTE, _TITLE = 28, 36, 38, 64
_DEGREES = 100  # px, of degrees beside a panorama
_LETTERS = {_NOTE: 84, _TITLE: 50}  # of a line
_HEAD = 50  # px, from the name of a picture to it
_FROM = 0.35, 0.4  # turn and tilt of the eye, radians


def draw_overview(
    depth: Depth,
    panorama: NDArray[np.uint8],
    trust: NDArray[np.float32],
    title: str,
    notes: Sequence[str],
) -> NDArray[np.uint8]:
    """Return the page, uint8 RGB, in two columns; what is doubtful is faded. Elevations
    are positive upwards, as a reader expects.

    Args:
        panorama: uint8 array, any size, RGB: the whole panorama, sharper than the depth
        trust: Of `trust.trust`, (H, W).
        title: What was computed and how, one line.
        notes: The verdict, which is the heading, and sentences.
    """
    page, scale, phi_deg = _Page(), ColorScale.of(depth.inverse_depth), depth.grid.phi_deg
    row = page.write((_GAP, 24), fill(notes[0], _LETTERS[_TITLE]), "la", _TITLE)
    top = page.write((_GAP, row + 12), title, "la", _NAME) + 24
    # Left: panorama, depth, and the colours of the depth.
    left = _GAP + _DEGREES
    row = page.panorama(
        panorama, (left, top), _LEFT, phi_deg, "What the cameras see", cv2.INTER_AREA
    )
    colors = scale.colorize(depth.inverse_depth, trust < DOUBTFUL)
    name = "Depth along the ray (faded: doubtful, striped: unknown)"
    row = page.panorama(colors, (left, row), _LEFT, phi_deg, name)
    page.paste(np.repeat(scale.bar(_LEFT), 16, 0), (left, row))
    for place, label in scale.ticks():
        page.write((left + place * _LEFT, row + 22), label, "mt")
    bottom = row + 80
    # Right: the surfaces, as high as the rest leaves room for, and trust.
    right, row = _WIDTH - _GAP - _RIGHT, top
    page.write((right, row), "Surfaces, from above", "la", _NAME)
    low = round(_RIGHT * (phi_deg[1] - phi_deg[0]) / 360)
    size = _RIGHT, max(_RIGHT // 2, bottom - top - low - 2 * _HEAD - 60)
    larger = round(1.5 * _RIGHT), round(1.5 * size[1])
    eye = around(AWAY * depth.grid.min_depth, *_FROM)
    view = draw_surfaces(depth, panorama, trust < DOUBTFUL, eye, larger)
    small = np.asarray(cv2.resize(view, size, interpolation=cv2.INTER_AREA), np.uint8)
    page.paste(small, (right, row + _HEAD))
    row += _HEAD + size[1] + 20
    gray = np.repeat((255 * np.nan_to_num(trust)).astype(np.uint8)[..., None], 3, -1)
    name = f"Likely right (below {DOUBTFUL:g}: doubtful)"
    row = page.panorama(gray, (right, row), _RIGHT, phi_deg, name, degrees=False)
    # Below both: the notes.
    text = fill(" ".join(notes[1:]), _LETTERS[_NOTE])
    return page.cut(page.write((_GAP, max(bottom, row)), text, "la", _NOTE) + 30)


class _Page:
    """White paper to paste pictures on and write beside them; places are (column, row), px."""

    def __init__(self) -> None:
        self._image = Image.new("RGB", (_WIDTH, 3 * _WIDTH), "white")
        self._draw = ImageDraw.Draw(self._image)
        self._font = str(
            distribution("matplotlib").locate_file("matplotlib/mpl-data/fonts/ttf/DejaVuSans.ttf")
        )

    def paste(self, pixels: NDArray[np.uint8], corner: tuple[int, int]) -> None:
        """Paste a picture (height, width, 3), its upper left corner at a place, framed."""
        (left, top), (height, width) = corner, pixels.shape[:2]
        frame = (left - 1, top - 1, left + width, top + height)
        self._draw.rectangle(frame, outline="black")
        self._image.paste(Image.fromarray(pixels), corner)

    def panorama(
        self,
        pixels: NDArray[np.uint8],
        corner: tuple[int, int],
        width: int,
        phi_deg: tuple[float, float],
        name: str,
        resize: int = cv2.INTER_NEAREST,
        degrees: bool = True,
    ) -> int:
        """Paste a panorama of some width below its name, with degrees; return the row below."""
        (left, top), (first, last) = corner, phi_deg
        self.write((left, top), name, "la", _NAME)
        scale, top = width / 360, top + _HEAD  # px per degree
        height = max(1, round(scale * (last - first)))
        fitted = cv2.resize(pixels, (width, height), interpolation=resize)
        self.paste(fitted.astype(np.uint8), (left, top))
        if not degrees:
            return top + height + 20
        for down in range(30 * int(np.ceil(first / 30)), int(last) + 1, 30):
            self.write((left - 8, top + scale * (down - first)), f"{-down}°", "rm")
        for azimuth in range(-180, 181, 45):
            # The first one begins at the edge: beside it may be the lowest elevation.
            anchor = {-180: "lt", 180: "rt"}.get(azimuth, "mt")
            self.write((left + scale * (azimuth + 180), top + height + 6), f"{azimuth}°", anchor)
        return top + height + 60

    def write(self, place: tuple[float, float], text: str, anchor: str, size: int = _TEXT) -> int:
        """Write text at a place, which is at its `anchor` (see Pillow); return the row below it."""
        font = ImageFont.truetype(self._font, size)
        self._draw.text(place, text, "black", font, anchor)
        return int(self._draw.textbbox(place, text, font, anchor)[3])

    def cut(self, height: int) -> NDArray[np.uint8]:
        """Return the upper part of the page, (height, width, 3)."""
        return np.asarray(self._image.crop((0, 0, _WIDTH, height)))
