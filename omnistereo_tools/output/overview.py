"""`overview.png`: panorama, depth, trust and surfaces on one page.

Drawn by Pillow: loading Matplotlib and laying out a figure would take longer than the depth.
"""

from collections.abc import Sequence
from textwrap import fill

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from omnistereo_lib.stereo.depth import Depth
from omnistereo_tools.judge.trust import DOUBTFUL
from omnistereo_tools.output.colors import ColorScale
from omnistereo_tools.output.pictures import AWAY, FONT
from omnistereo_tools.output.render import around, draw_surfaces

_WIDTH, _GAP = 1400, 40  # px, of the page, and between what is on it
_WIDE, _HALF = 1210, 640  # px, of pictures
# px, of letters: all are legible 390 px wide, where they are 11 px or more
_TEXT, _NAME, _TITLE = 40, 44, 68
_DEGREES = 110  # px, of degrees beside a panorama
_LETTERS = 36  # of a line of the verdict
_FACT, _LINE = 520, 54  # px, from a name to its value, and to the next
_HEAD = 58  # px, from the name of a picture to it
_FROM = 0.35, 0.4  # turn and tilt of the eye, radians


def draw_overview(
    depth: Depth,
    panorama: NDArray[np.uint8],
    trust: NDArray[np.float32],
    title: str,
    verdict: str,
    facts: Sequence[tuple[str, str]],
) -> NDArray[np.uint8]:
    """Return the page, uint8 RGB; what is doubtful is faded. Elevations are positive upwards, as a
    reader expects.

    Args:
        panorama: uint8 array, any size, RGB: the whole panorama, sharper than the depth
        trust: Of `trust.trust`, (H, W).
        title: What was computed and how, one line.
        verdict: The heading.
        facts: Names and values, the table at the foot.
    """
    page, scale, phi_deg = _Page(), ColorScale.of(depth.inverse_depth), depth.grid.phi_deg
    row = page.write((_GAP, 24), fill(verdict, _LETTERS), "la", _TITLE)
    row = page.write((_GAP, row + 12), title, "la", _TEXT) + 24
    # Above: panorama, depth, and the colours of the depth.
    left = _GAP + _DEGREES
    name = "What the cameras see"
    row = page.panorama(panorama, (left, row), _WIDE, phi_deg, name, cv2.INTER_AREA, around=False)
    colors = scale.colorize(depth.inverse_depth, trust < DOUBTFUL)
    name = "Depth along the ray (faded: doubtful)"
    name = name if depth.valid.all() else name.replace(")", ", striped: unknown)")
    row = page.panorama(colors, (left, row), _WIDE, phi_deg, name)
    labels, free = scale.ticks()[::-1], 2.0
    row = page.bar(scale.bar(_WIDE), (left, row))
    for place, label in labels:
        if free - place > 0.13:
            # the last one ends where the colours do
            anchor, free = ("rt", place - 0.05) if place > 0.95 else ("mt", place)
            page.write((left + place * _WIDE, row), label, anchor)
    # Below, right: trust and its grays; left: the surfaces, as high as both.
    top, right = row + 70, _WIDTH - _GAP - _HALF
    gray = np.repeat((255 * np.nan_to_num(trust)).astype(np.uint8)[..., None], 3, -1)
    row = page.panorama(gray, (right, top), _HALF, phi_deg, "Likely right", up=False, around=False)
    ramp = np.repeat(np.linspace(0, 255, _HALF).astype(np.uint8)[None, :, None], 3, -1)
    row = page.bar(ramp, (right, row))
    page.write((right, row), "0", "lt")
    page.write((right + _HALF / 2 * DOUBTFUL, row), "doubtful", "mt")
    page.write((right + _HALF * DOUBTFUL, row), f"{DOUBTFUL:g}", "mt")
    bottom = page.write((right + _HALF, row), "1", "rt")
    page.write((_GAP, top), "Surfaces (black: not seen)", "la", _NAME)
    size = _HALF, bottom - top - _HEAD
    eye = around(AWAY * depth.grid.min_depth, *_FROM)
    larger = round(1.5 * size[0]), round(1.5 * size[1])
    view = draw_surfaces(depth, panorama, trust < DOUBTFUL, eye, larger)
    small = np.asarray(cv2.resize(view, size, interpolation=cv2.INTER_AREA), np.uint8)
    page.paste(small, (_GAP, top + _HEAD))
    # At the foot: the numbers.
    for row, (name, value) in enumerate(facts):
        down = bottom + 30 + _LINE * row
        page.write((_GAP, down), name, "la")
        page.write((_GAP + _FACT, down), value, "la")
    return page.cut(bottom + 50 + _LINE * len(facts))


class _Page:
    """White paper to paste pictures on and write beside them; places are (column, row), px."""

    def __init__(self) -> None:
        self._image = Image.new("RGB", (_WIDTH, 3 * _WIDTH), "white")
        self._draw = ImageDraw.Draw(self._image)

    def paste(self, pixels: NDArray[np.uint8], corner: tuple[int, int]) -> None:
        """Paste a picture (height, width, 3), its upper left corner at a place, framed."""
        (left, top), (height, width) = corner, pixels.shape[:2]
        frame = (left - 1, top - 1, left + width, top + height)
        self._draw.rectangle(frame, outline="black")
        self._image.paste(Image.fromarray(pixels), corner)

    def bar(self, row: NDArray[np.uint8], corner: tuple[int, int]) -> int:
        """Paste the colours of a scale, (1, width, 3); return the row of its labels."""
        self.paste(np.repeat(row, 20, 0), corner)
        return corner[1] + 30

    def panorama(
        self,
        pixels: NDArray[np.uint8],
        corner: tuple[int, int],
        width: int,
        phi_deg: tuple[float, float],
        name: str,
        resize: int = cv2.INTER_NEAREST,
        up: bool = True,
        around: bool = True,
    ) -> int:
        """Paste a panorama of some width below its name, with its degrees `up` and `around`; return
        the row below.
        """
        (left, top), (first, last) = corner, phi_deg
        self.write((left, top), name, "la", _NAME)
        scale, top = width / 360, top + _HEAD  # px per degree
        height = max(1, round(scale * (last - first)))
        fitted = cv2.resize(pixels, (width, height), interpolation=resize)
        self.paste(fitted.astype(np.uint8), (left, top))
        for down in range(30 * int(np.ceil(first / 30)), int(last) + 1, 30) if up else ():
            self.write((left - 8, top + scale * (down - first)), f"{-down}°", "rm")
        if not around:
            return top + height + 20
        for azimuth in range(-180, 181, 90):
            # The first one begins at the edge: beside it may be the lowest elevation.
            anchor = {-180: "lt", 180: "rt"}.get(azimuth, "mt")
            self.write((left + scale * (azimuth + 180), top + height + 6), f"{azimuth}°", anchor)
        return top + height + 70

    def write(self, place: tuple[float, float], text: str, anchor: str, size: int = _TEXT) -> int:
        """Write text at a place, which is at its `anchor` (see Pillow); return the row below it."""
        font = ImageFont.truetype(FONT, size)
        self._draw.text(place, text, "black", font, anchor)
        return int(self._draw.textbbox(place, text, font, anchor)[3])

    def cut(self, height: int) -> NDArray[np.uint8]:
        """Return the upper part of the page, (height, width, 3)."""
        return np.asarray(self._image.crop((0, 0, _WIDTH, height)))
