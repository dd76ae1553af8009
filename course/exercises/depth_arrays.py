"""Checkers of notebooks 06 and 07 that ask for functions on arrays, each beside its usual mistakes."""

from __future__ import annotations

from functools import partial

import numpy as np

from course.exercises.compare import Array, Case, Rng, by, checker


@checker
def check_normalized_images(rng: Rng, k: int) -> Case:
    """06.3: images (cameras, H, W), each with mean 0 and variance 1 over its visible pixels, 0 elsewhere."""
    images = rng.normal(0, 1, (3 + k % 4, 5, 6 + k % 3))
    images = 90 + 40 * rng.normal(0, 1, (len(images), 1, 1)) + 25 * rng.uniform(0.5, 2, (len(images), 1, 1)) * images
    images[rng.uniform(0, 1, images.shape) < 0.25] = np.nan
    if k == 3:
        images = images.astype(np.float32)
    each = (1, 2)

    def right(images: Array, axis: int | tuple | None = each, ddof: int = 0, power: float = 1) -> Array:
        centred = images - np.nanmean(images, axis=axis, keepdims=True)
        return np.nan_to_num(centred / np.nanstd(images, axis=axis, ddof=ddof, keepdims=True) ** power)

    def in_two_ways(images: Array) -> Array:
        """What is not visible taken as black."""
        black = np.nan_to_num(images)
        return (black - black.mean(each, keepdims=True)) / black.std(each, keepdims=True)

    def range_of(images: Array) -> Array:
        low, high = np.nanmin(images, each, keepdims=True), np.nanmax(images, each, keepdims=True)
        return np.nan_to_num((images - low) / (high - low))

    wrong = [
        (partial(right, axis=None), "one mean for all cameras: each has its own exposure"),
        (
            partial(right, axis=0),
            "normalised over the wrong axis: over the pixels of each camera, not over the cameras",
        ),
        (partial(right, axis=1), "each camera has one mean, over rows and columns"),
        (partial(right, axis=2), "each camera has one mean, over rows and columns"),
        (partial(right, ddof=1), "the variance is the mean of the squares here: divide by n, not by n - 1"),
        (partial(right, power=2), "divide by the standard deviation, not by the variance"),
        (partial(right, power=0), "the mean is right; divide by the standard deviation, too"),
        (
            lambda x: np.where(np.isnan(x), np.nan, right(x)),
            "what is not visible becomes 0, the mean; a network cannot compute with NaN",
        ),
        (lambda x: np.full_like(x, np.nan), "NaN spoils mean and deviation: take them over the visible pixels"),
        (lambda x: np.zeros_like(x), "NaN spoils mean and deviation: take them over the visible pixels"),
        (in_two_ways, "a pixel that is not visible is not black: leave it out of mean and deviation"),
        (
            lambda x: np.where(np.isnan(x), 0, in_two_ways(x)),
            "a pixel that is not visible is not black: leave it out of mean and deviation",
        ),
        (lambda x: np.nan_to_num(x / np.nanstd(x, each, keepdims=True)), "subtract the mean first"),
        (range_of, "that runs from 0 to 1; the network wants mean 0 and variance 1"),
    ]
    return by((images,), right, wrong)


def _convolve(image: Array, kernel: Array, *, columns: str = "wrap", rows: str = "constant", shift: int = 0) -> Array:
    """One convolution layer; `columns` and `rows` say how the borders are padded, in the words of np.pad."""
    half = len(kernel) // 2
    padded = np.pad(np.pad(image.astype(np.float64), ((half, half), (0, 0)), rows), ((0, 0), (half, half)), columns)
    padded = np.roll(padded, -shift, axis=(0, 1))
    windows = np.lib.stride_tricks.sliding_window_view(padded, kernel.shape)
    return np.einsum("hwij,ij->hw", windows, kernel)


@checker
def check_convolution(rng: Rng, k: int) -> Case:
    """06.5: one convolution of a panorama (H, W), columns wrapped around the seam, zeros above and below."""
    size = (3, 5)[k % 2]
    image, kernel = rng.normal(0.5, 1, (6 + k % 3, 9 + k % 4)), rng.normal(0.1, 1, (size, size))
    right = _convolve
    half = size // 2

    wrong = [
        (lambda i, w: right(i, w[::-1, ::-1]), "the kernel is flipped, as in mathematics; a network does not flip it"),
        (lambda i, w: right(i, w.T), "the kernel is transposed: its first axis goes with the rows"),
        (partial(right, columns="constant"), "zeros at the seam: the first column follows the last one"),
        (partial(right, columns="edge"), "the last column again at the seam: the first one follows it"),
        (partial(right, columns="reflect"), "mirrored at the seam: the first column follows the last one"),
        (partial(right, rows="wrap"), "rows do not wrap: zeros above the first and below the last one"),
        (partial(right, rows="edge"), "zeros above the first and below the last row, not the row again"),
        (partial(right, rows="wrap", columns="constant"), "rows and columns are swapped: the columns wrap"),
        (lambda i, w: right(i, w)[half:-half], "the panorama keeps its size: zeros above and below"),
        (lambda i, w: right(i, w)[:, half:-half], "the panorama keeps its size: wrap the columns first"),
        (lambda i, w: right(i, w)[half:-half, half:-half], "the panorama keeps its size: pad by half a kernel"),
        (partial(right, shift=1), "shifted by one pixel: the middle of the kernel belongs to the pixel itself"),
        (partial(right, shift=-1), "shifted by one pixel: the middle of the kernel belongs to the pixel itself"),
        (lambda i, w: right(i, w) / w.size, "the sum of the products, not their mean"),
        (lambda i, w: i * w.sum(), "each neighbour has its own weight"),
        (lambda i, w: np.maximum(right(i, w), 0), "no ReLU yet: the sum alone"),
    ]
    return by((image, kernel), right, wrong)
