"""`overview.png`: panorama, depth, confidence and point cloud on one page."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import wrap

import cv2
import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.stereo.depth import Depth
from omnistereo_tools.pictures import BACKGROUND, ColorScale, draw_points, write_text

_WIDTH = 1800  # px of the panoramas
_MARGIN = 40
_LINE = 44  # px, base line of a title
_SPACING = 28  # px between the lines of a note
_LETTERS = 84  # of a line of a note


def draw_overview(
    depth: Depth, panorama: NDArray[np.uint8], points: NDArray, colors: NDArray, title: str, notes: Sequence[str]
) -> NDArray[np.uint8]:
    """Return the page as an RGB picture, 1880 px wide.

    Args:
        panorama: uint8 array, any size, RGB: the whole panorama, sharper than the depth
        points, colors: arrays of shape (M, 3): the point cloud in metres, and uint8 RGB
        title: What was computed and how, one line.
        notes: Sentences to stand below the confidence.
    """
    scale = ColorScale.of(depth.inverse_depth)
    half = (_WIDTH - _MARGIN) // 2
    confidence = np.nan_to_num(depth.confidence)
    strength = np.repeat((255 * confidence / max(confidence.max(), 1e-6)).astype(np.uint8)[..., None], 3, -1)
    strength = _fit(strength, half)
    used = len(strength)
    cloud = draw_points(points, colors, (half, max(half * 9 // 16, strength.shape[0])))
    strength = np.pad(strength, ((0, len(cloud) - len(strength)), (0, 0), (0, 0)), constant_values=BACKGROUND)
    lines = [line for note in notes for line in ["", *wrap(note, _LETTERS)]]
    for number, line in enumerate(lines[: (len(cloud) - used) // _SPACING]):
        write_text(strength, line, (0, used + _SPACING * (number + 1)), size=20)
    left = _titled(f"Confidence: white {confidence.max():.2g}, black 0", strength)
    right = _titled(f"{len(points)} points, from above and behind", cloud)
    parts = [
        _titled(title, _fit(panorama, _WIDTH), bold=True),
        _titled("Depth along the ray; striped: unknown", _fit(scale.colorize(depth), _WIDTH)),
        _color_bar(scale),
        np.hstack([left, np.full((len(left), _MARGIN, 3), BACKGROUND, np.uint8), right]),
    ]
    return np.pad(np.vstack(parts), ((0, _MARGIN), (_MARGIN, _MARGIN), (0, 0)), constant_values=BACKGROUND)


def _fit(picture: NDArray[np.uint8], width: int) -> NDArray[np.uint8]:
    """Resize a picture to a width: averaged where it shrinks, without invented values where it grows."""
    height = round(picture.shape[0] * width / picture.shape[1])
    shrinks = picture.shape[1] > width
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_NEAREST)


def _titled(title: str, picture: NDArray[np.uint8], bold: bool = False) -> NDArray[np.uint8]:
    line = np.full((_LINE + 12, picture.shape[1], 3), BACKGROUND, np.uint8)
    write_text(line, title, (0, _LINE), bold=bold)
    return np.vstack([line, np.full((10, picture.shape[1], 3), BACKGROUND, np.uint8), picture])


def _color_bar(scale: ColorScale) -> NDArray[np.uint8]:
    bar = np.full((84, _WIDTH, 3), BACKGROUND, np.uint8)
    bar[14:38] = scale.bar(_WIDTH)
    for at, label in scale.ticks():
        column = round(at * (_WIDTH - 1))
        bar[38:46, max(column - 1, 0) : column + 1] = 0xE8
        write_text(bar, label, (min(max(column - 6 * len(label), 0), _WIDTH - 13 * len(label)), 70))
    return bar
