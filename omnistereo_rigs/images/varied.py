"""Frames of a recording that are sharp and differ most: a still one repeats its errors."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.frame import to_gray

_THUMBNAIL = 48  # pixels
_BLURRED = 0.7  # of the median sharpness


def candidates(numbers: Sequence[int], count: int) -> list[int]:
    """Return at most `count` of some frames, evenly spread."""
    places = np.linspace(0, len(numbers) - 1, count).round().astype(int)
    return [numbers[k] for k in np.unique(places)]


def look(images: Sequence[NDArray[np.uint8]]) -> tuple[NDArray[np.float32], float]:
    """Return small images of all cameras, (cameras, 48, 48), and the median of their sharpness."""
    grays = [to_gray(image) for image in images]
    small = [cv2.resize(g, (_THUMBNAIL, _THUMBNAIL), interpolation=cv2.INTER_AREA) for g in grays]
    sharpness = [float(cv2.Laplacian(gray, cv2.CV_32F).std()) for gray in grays]
    return np.stack(small).astype(np.float32), float(np.median(sharpness))


def choose(
    looks: Sequence[tuple[NDArray[np.float32], float]], count: int, still: float
) -> list[int]:
    """Return the places of at most `count` frames, each the one that differs most from the others.

    Args:
        looks: See `look`.
        count: How many are chosen.
        still: Gray values by which a camera's frames must differ in the mean.
    """
    sharpness = np.array([sharp for _, sharp in looks])
    left = [k for k in range(len(looks)) if sharpness[k] >= _BLURRED * np.median(sharpness)]
    chosen = [max(left, key=lambda k: sharpness[k])]
    while len(chosen) < count:
        apart = {
            k: min(float(np.abs(looks[k][0] - looks[c][0]).mean((1, 2)).max()) for c in chosen)
            for k in left
            if k not in chosen
        }
        if not apart or max(apart.values()) < still:
            break
        chosen.append(max(apart, key=apart.__getitem__))
    return sorted(chosen)
