"""Images of consumer cameras: two lenses in one image, and panoramas, which have no depth."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.rig import Rig

NO_DEPTH = (
    "It is stitched as if seen from one point, and depth needs two: pass the images of the single"
    " lenses, before stitching, with their calibration"
)
# GoPro's files hold the two halves of one cube map.
_STITCHED = (".360",)
# The sides of a panorama meet if its first and last column differ by less than this share of the
# difference of columns half an image apart.
_SIDES_MEET = 0.25
# The first row of a panorama is one point: it varies less than this share of the whole image.
_EVEN = 0.35
# Lenses that share an image have principal points farther apart than this share of its longer side.
_APART = 0.2
# A gray value: the first row of an image circle is darker, and all of an image that shows nothing.
DARK = 8.0


def check_not_stitched(path: str | Path) -> None:
    """Refuse a file whose name says that it is a panorama."""
    if Path(path).suffix.lower() in _STITCHED:
        raise OmnistereoError(f"{path} is a panorama of a 360° camera. {NO_DEPTH}")


def split_image(image: NDArray[np.uint8], rig: Rig, path: str | Path) -> list[NDArray[np.uint8]]:
    """Return the images of all cameras out of one, which they share, or side by side in it.

    Raises an `OmnistereoError` if the image is neither, with the reason if it is a panorama.
    """
    height, width = image.shape[:2]
    sizes = [camera.image_size for camera in rig.cameras]
    widths, heights = zip(*sizes, strict=True)
    if is_equirectangular(image):
        raise OmnistereoError(
            f"{path} looks like an equirectangular panorama: 2 to 1, its sides meet. {NO_DEPTH}"
        )
    centers = np.array([camera.center for camera in rig.cameras])
    if set(sizes) == {(width, height)} and np.ptp(centers, axis=0).max() > _APART * max(
        width, height
    ):
        return [image] * len(sizes)
    if (sum(widths), set(heights)) == (width, {height}):
        return np.split(image, np.cumsum(widths)[:-1], axis=1)
    if (set(widths), sum(heights)) == ({width}, height):
        return np.split(image, np.cumsum(heights)[:-1], axis=0)
    raise OmnistereoError(
        f"{path} is one image of {width} × {height} px for {len(sizes)} cameras of {sizes};"
        " expected one image per camera in rig order, or all of them in one, of the size of each,"
        " side by side or above each other"
    )


def is_equirectangular(image: NDArray[np.uint8]) -> bool:
    """Return whether an image is 2 to 1, its sides meet, and its first row is one point."""
    height, width = image.shape[:2]
    if width != 2 * height:
        return False
    gray = image.astype(np.float32) if image.ndim == 2 else image.mean(-1, dtype=np.float32)
    seam = np.abs(gray[:, 0] - gray[:, -1]).mean()
    apart = np.abs(gray - np.roll(gray, width // 2, axis=1)).mean()
    top = gray[0]
    return bool(top.mean() > DARK and seam < _SIDES_MEET * apart and top.std() < _EVEN * gray.std())
