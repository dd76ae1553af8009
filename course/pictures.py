"""The book's pictures: as they are on a white page, and with their paper dark on a dark one."""

import hashlib
import html
import io
from functools import reduce
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

FOLDER = "pictures"
CSS_PX_PER_INCH = 93  # letters of figures are then as large as the text
PAPER, INK = (19, 20, 22), 225  # the theme's dark page; what was black on white
_LEAST = 0.7  # of that width: on a telephone a figure scrolls before its letters are too small
_WHITE = 235  # from here on a pixel is paper
_SOLID, _FILLED = 0.6, 0.7  # of its bounding box, of its inside: then a shape is a photograph or a map, not lines
_SHADES = np.round(np.linspace(PAPER, (INK,) * 3, 256)).astype(np.uint8)[:, None]


def picture(data: bytes, alt: str, folder: Path, up: str = "", scale: float = 0.0) -> str:
    """Write a picture and its dark twin into `folder`/pictures; return the HTML that shows the one that fits.

    Args:
        data: A PNG or JPEG file.
        alt: What it shows, for somebody who cannot see it.
        up: From the page to `folder`: "../" or nothing.
        scale: CSS pixels for one of its pixels, where there is room; follows from its resolution unless given.
    """
    image = Image.open(io.BytesIO(data))
    name = hashlib.sha256(data).hexdigest()[:16]
    light, dark = (Path(folder, FOLDER, f"{name}.{end}") for end in (image.format.lower(), "dark.webp"))
    light.parent.mkdir(parents=True, exist_ok=True)
    light.write_bytes(data)
    Image.fromarray(for_dark_page(np.asarray(image.convert("RGB")))).save(dark, quality=80, method=2)
    scale = scale or CSS_PX_PER_INCH / image.info.get("dpi", (150, 150))[0]
    width, height = round(scale * image.width), round(scale * image.height)
    size = f'width="{width}" height="{height}" alt="{html.escape(alt)}"'
    shown = (
        f'<img class="only-{mode}" src="{up}{FOLDER}/{path.name}" {size} loading="lazy">'
        for mode, path in (("light", light), ("dark", dark))
    )
    return f'<div class="picture" style="--least: {_LEAST * width:.0f}px">{"".join(shown)}</div>'


def for_dark_page(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a figure (H, W, 3) with light ink on dark paper; hues, photographs and maps stay as they are."""
    low, high = (reduce(each, cv2.split(rgb)) for each in (cv2.min, cv2.max))
    turned = rgb + cv2.merge([255 - high - low] * 3)  # lightness turned over, hue kept; modulo 256
    dark = cv2.LUT(turned, _SHADES)
    ink = (low < _WHITE).astype(np.uint8)
    for contour in cv2.findContours(ink, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0]:
        x, y, width, height = cv2.boundingRect(contour)
        if height < 40 or (width < 40 and height < 100):  # letters and lines, but not a colour bar
            continue
        inside = cv2.drawContours(np.zeros((height, width), np.uint8), [contour], 0, 1, -1, offset=(-x, -y))
        place = np.s_[y : y + height, x : x + width]
        if inside.mean() > _SOLID and cv2.mean(ink[place], inside)[0] > _FILLED:
            cv2.copyTo(rgb[place], inside, dark[place])
    return dark
