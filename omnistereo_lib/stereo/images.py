"""Images as the sweep and the networks take them: gray, blurred, reduced."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.frame import check_images
from omnistereo_lib.geometry.rig import Rig


def to_gray(image: NDArray[Any]) -> NDArray[np.float32]:
    """Return an image (height, width) or RGB (height, width, 3) in gray, float32 (BT.601 luma)."""
    image = np.ascontiguousarray(image, np.float32)
    return (
        image
        if image.ndim == 2
        else np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.float32)
    )


def blur_px(spacing: float) -> float:
    """Return σ of the Gaussian that keeps samples `spacing` pixels apart from aliasing, in pixels;
    0: none is needed.

    The usual choice is half the spacing. An image is about as sharp as its pixels allow, σ = 0.5,
    and variances add.
    """
    return 0.5 * math.sqrt(spacing**2 - 1) if spacing > 1.1 else 0.0


def blur(image: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    """Blur an image by a Gaussian; σ = 0 returns it as it is."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), np.float32) if sigma else image


def reduce_images(
    rig: Rig, images: Sequence[ArrayLike], pixels_per_degree: float
) -> tuple[Rig, list[NDArray[Any]]]:
    """Return cameras and images of about a resolution, if theirs is higher: pixels are averaged in
    whole blocks.

    Args:
        images: one array per camera, (height, width) or (height, width, 3)
        pixels_per_degree: Image width over field of view; equal sizes stay equal.

    Raises:
        OmnistereoError: If the images do not fit the rig.
    """
    cameras, reduced = [], []
    widest = max(camera.max_fov_deg for camera in rig.cameras)
    for camera, image in zip(rig.cameras, check_images(images, rig), strict=True):
        # A whole factor, so that each new pixel is the mean of a block; what is left at the rim is
        # cut off.
        factor = max(1, round(camera.image_size[0] / widest / pixels_per_degree))
        width, height = (size // factor for size in camera.image_size)
        cut = image[: height * factor, : width * factor]
        reduced.append(cv2.resize(cut, (width, height), interpolation=cv2.INTER_AREA))
        cameras.append(camera.reduced(factor))
    return replace(rig, cameras=tuple(cameras)), reduced
