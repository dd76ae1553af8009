"""Images as WebP in data URIs; nothing here loads torch, so that it can run while torch loads."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from io import BytesIO
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, WebPImagePlugin

from omnistereo_lib.geometry.camera import OcamCamera

_IMAGE_WIDTH, _IMAGE_BYTES = 800, 40_000  # of a fisheye image, at most
Fisheye = tuple[OcamCamera, str]


def fisheye_images(
    cameras: Iterable[OcamCamera], images: Iterable[NDArray[Any]]
) -> list[Future[Fisheye]]:
    """Begin to encode images in a thread: each with its camera, both reduced if wide, transparent
    where the camera is blind.
    """
    pool = ThreadPoolExecutor(1)
    pairs = zip(cameras, images, strict=False)
    return [pool.submit(_encoded, camera, image) for camera, image in pairs]


def _encoded(camera: OcamCamera, image: NDArray[Any]) -> Fisheye:
    factor = -(-camera.image_size[0] // _IMAGE_WIDTH)
    width, height = (side // factor for side in camera.image_size)
    pixels = np.asarray(image).clip(0, 255).astype(np.uint8)[: height * factor, : width * factor]
    colors = pixels if pixels.ndim == 3 else cv2.cvtColor(pixels, cv2.COLOR_GRAY2RGB)
    colors = cv2.resize(colors, (width, height), interpolation=cv2.INTER_AREA)
    camera = camera.reduced(factor)
    visible = np.where(camera.visible_pixels(), 255, 0)
    return camera, _webp_of_at_most(np.dstack([colors, visible]).astype(np.uint8), _IMAGE_BYTES)


def webp(pixels: NDArray[np.uint8], quality: int) -> str:
    """Return an image in RGB or RGBA as a data URI."""
    # OpenCV cannot ask for method 2, which takes half the time of its 4 for 3 % more bytes.
    form = WebPImagePlugin.WebPImageFile.format  # for its bare name Pillow loads all it can write
    Image.fromarray(pixels).save(encoded := BytesIO(), form, quality=quality, method=2)
    return "data:image/webp;base64," + base64.b64encode(encoded.getvalue()).decode()


def _webp_of_at_most(pixels: NDArray[np.uint8], most: int) -> str:
    """Return an image as `webp`, in the best quality that takes at most so many bytes."""
    # Files grow with their quality, so half of those left are ruled out by each try.
    found, low, high = "", 1, 9
    while low <= high:
        middle = (low + high + 1) // 2
        tried = webp(pixels, 10 * middle)
        if len(tried) * 3 / 4 <= most:
            found, low = tried, middle + 1
        else:
            high = middle - 1
    return found or webp(pixels, 10)
