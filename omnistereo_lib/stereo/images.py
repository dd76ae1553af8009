"""Images as the sweep and the networks take them: checked, gray, blurred, reduced."""

import math
from collections.abc import Sequence, Sized
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from omnistereo_lib.errors import OmnistereoError, shortened
from omnistereo_lib.geometry.rig import Rig


def check_images(images: Sequence[ArrayLike], rig: Rig) -> list[NDArray[Any]]:
    """Return the images as arrays, checked against the cameras of the rig.

    Raises:
        OmnistereoError: If there is not one image per camera, or one has the wrong size, shape or type or is not
            finite.
    """
    if not isinstance(images, Sized):  # arrays and tensors are sequences, too
        raise OmnistereoError(f"images is {shortened(images)}; expected one array per camera")
    # Arrays in this machine's byte order, whatever they come as.
    arrays = [np.asarray(image.detach().cpu() if isinstance(image, Tensor) else image) for image in images]
    arrays = [image.astype(image.dtype.newbyteorder("="), copy=False) for image in arrays]
    for i, (image, (width, height)) in enumerate(zip(arrays, rig.image_sizes(len(arrays)), strict=True)):
        if image.shape not in [(height, width), (height, width, 3)]:
            raise OmnistereoError(
                f"image {i + 1} has shape {image.shape}; camera {i + 1} expects ({height}, {width}) or "
                f"({height}, {width}, 3). Pass the image as captured: not resized, cropped or rotated."
            )
        if image.dtype != np.uint8 and not np.issubdtype(image.dtype, np.floating):
            raise OmnistereoError(f"image {i + 1} has type {image.dtype}; expected uint8 or float")
        if image.dtype != np.uint8 and not np.isfinite(image).all():
            raise OmnistereoError(f"image {i + 1} has NaN or infinite values; expected finite gray values")
    # Gray and colour images together are all in colour.
    if len({image.ndim for image in arrays}) > 1:
        arrays = [np.repeat(image[..., None], 3, -1) if image.ndim == 2 else image for image in arrays]
    return arrays


def to_gray(image: NDArray[Any]) -> NDArray[np.float32]:
    """Return an image (height, width) or RGB (height, width, 3) in gray, float32 (BT.601 luma)."""
    image = np.ascontiguousarray(image, np.float32)
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.float32)


def blur_px(spacing: float) -> float:
    """Return σ of the Gaussian that keeps samples `spacing` pixels apart from aliasing, in pixels; 0: none is needed.

    The usual choice is half the spacing. An image is about as sharp as its pixels allow, σ = 0.5, and variances add.
    """
    return 0.5 * math.sqrt(spacing**2 - 1) if spacing > 1.1 else 0.0


def blur(image: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    """Blur an image by a Gaussian; σ = 0 returns it as it is."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), np.float32) if sigma else image


def reduce_images(rig: Rig, images: Sequence[ArrayLike], pixels_per_degree: float) -> tuple[Rig, list[NDArray[Any]]]:
    """Return cameras and images of about a resolution, if theirs is higher: pixels are averaged in whole blocks.

    Args:
        images: one array per camera, (height, width) or (height, width, 3)
        pixels_per_degree: Image width over field of view; equal sizes stay equal.

    Raises:
        OmnistereoError: If the images do not fit the rig.
    """
    cameras, reduced = [], []
    widest = max(camera.max_fov_deg for camera in rig.cameras)
    for camera, image in zip(rig.cameras, check_images(images, rig), strict=True):
        factor = max(1, round(camera.image_size[0] / widest / pixels_per_degree))
        width, height = (size // factor for size in camera.image_size)
        cut = image[: height * factor, : width * factor]
        reduced.append(cv2.resize(cut, (width, height), interpolation=cv2.INTER_AREA))
        cameras.append(camera.reduced(factor))
    return replace(rig, cameras=tuple(cameras)), reduced
