"""Images of the book in light and dark mode: paper becomes dark, photographs stay."""

import hashlib
import html
import io
from functools import reduce
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

FOLDER = "pictures"
CSS_PX_PER_INCH = 93  # the text of figures is then as large as that of the page
PAPER, INK = (19, 20, 22), 225  # the dark page of the theme, and what black becomes on it
LEAST = 0.7  # fraction of the width: on a telephone a figure scrolls before its text is too small
_WHITE = 235  # a pixel at least this bright is paper
# A shape that fills its bounding box and its inside to these fractions is a photograph or a map,
# not lines.
_SOLID, _FILLED = 0.6, 0.7
_SHADES = np.round(np.linspace(PAPER, (INK,) * 3, 256)).astype(np.uint8)[:, None]


def picture(
    data: bytes, alt: str, folder: Path, up: str = "", scale: float = 0.0, least: float = LEAST
) -> str:
    """Write an image and its dark version into `folder`/pictures; return HTML that shows the one
    for the mode.

    Args:
        data: A PNG or JPEG file.
        alt: Text for readers who cannot see it.
        up: Path from the page to `folder`: "../" or nothing.
        scale: CSS pixels per image pixel, at most; default: from the resolution of the file.
        least: Fraction of the width below which it scrolls.
    """
    image = Image.open(io.BytesIO(data))
    name = hashlib.sha256(data).hexdigest()[:16]
    light, dark = (
        Path(folder, FOLDER, f"{name}.{end}") for end in (image.format.lower(), "dark.webp")
    )
    light.parent.mkdir(parents=True, exist_ok=True)
    light.write_bytes(data)
    Image.fromarray(for_dark_page(np.asarray(image.convert("RGB")))).save(
        dark, quality=80, method=2
    )
    scale = scale or CSS_PX_PER_INCH / image.info.get("dpi", (150, 150))[0]
    width, height = round(scale * image.width), round(scale * image.height)
    size = f'width="{width}" height="{height}" alt="{html.escape(alt)}"'
    shown = (
        f'<img class="only-{mode}" src="{up}{FOLDER}/{path.name}" {size} loading="lazy">'
        for mode, path in (("light", light), ("dark", dark))
    )
    return f'<div class="picture" style="--least: {least * width:.0f}px">{"".join(shown)}</div>'


def for_dark_page(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a figure (H, W, 3) with light ink on dark paper; hues and photographs stay."""
    low, high = (reduce(each, cv2.split(rgb)) for each in (cv2.min, cv2.max))
    inverted = rgb + cv2.merge([255 - high - low] * 3)  # invert lightness, keep hue; modulo 256
    dark: NDArray[Any] = cv2.LUT(inverted, _SHADES)
    ink = (low < _WHITE).astype(np.uint8)
    for contour in cv2.findContours(ink, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0]:
        x, y, width, height = cv2.boundingRect(contour)
        if height < 40 or (width < 40 and height < 100):  # letters and lines, but no colour bar
            continue
        inside = cv2.drawContours(
            np.zeros((height, width), np.uint8), [contour], 0, 1, -1, offset=(-x, -y)
        )
        place = np.s_[y : y + height, x : x + width]
        if inside.mean() > _SOLID and cv2.mean(ink[place], inside)[0] > _FILLED:
            cv2.copyTo(rgb[place], inside, dark[place])
    return dark
