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
        (partial(right, axis=0), "normalised over the wrong axis: over the pixels of each camera, not over the"
         " cameras"),
        (partial(right, axis=1), "each camera has one mean, over rows and columns"),
        (partial(right, axis=2), "each camera has one mean, over rows and columns"),
        (partial(right, ddof=1), "the variance is the mean of the squares here: divide by n, not by n - 1"),
        (partial(right, power=2), "divide by the standard deviation, not by the variance"),
        (partial(right, power=0), "the mean is right; divide by the standard deviation, too"),
        (lambda x: np.where(np.isnan(x), np.nan, right(x)), "what is not visible becomes 0, the mean; a network"
         " cannot compute with NaN"),
        (lambda x: np.full_like(x, np.nan), "NaN spoils mean and deviation: take them over the visible pixels"),
        (lambda x: np.zeros_like(x), "NaN spoils mean and deviation: take them over the visible pixels"),
        (in_two_ways, "a pixel that is not visible is not black: leave it out of mean and deviation"),
        (lambda x: np.where(np.isnan(x), 0, in_two_ways(x)), "a pixel that is not visible is not black: leave it out"
         " of mean and deviation"),
        (lambda x: np.nan_to_num(x / np.nanstd(x, each, keepdims=True)), "subtract the mean first"),
        (range_of, "that runs from 0 to 1; the network wants mean 0 and variance 1"),
    ]  # fmt: skip
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
    ]  # fmt: skip
    return by((image, kernel), right, wrong)


def _refined(costs: Array, *, factor: float = 0.5, wrap: bool = False, dear: bool = False) -> Array:
    """The best sphere of each ray and the vertex of the parabola through it, ray by ray."""
    H, W, N = costs.shape
    index = np.zeros((H, W))
    for row in range(H):
        for column in range(W):
            ray = costs[row, column].astype(np.float64) * (-1 if dear else 1)
            n = int(np.argmin(ray))
            left, middle, right = ray[n - 1], ray[n], ray[(n + 1) % N]
            inside = 0 < n < N - 1 or wrap
            index[row, column] = n + (factor * (left - right) / (left - 2 * middle + right) if inside else 0)
    return index


@checker
def check_refined_index(rng: Rng, k: int) -> Case:
    """07.4: the best sphere of each ray, (H, W), refined by a parabola; whole at the first and the last sphere."""
    costs = rng.uniform(0.2, 1, (3, 4 + k % 3, 6 + k % 5)).astype(np.float32 if k % 2 else np.float64)
    costs[0, 0, 0] = costs[0, 1, -1] = 0.1
    right = _refined

    def whole(costs: Array) -> Array:
        return costs.argmin(-1).astype(np.float64)

    def at_ends(costs: Array, value: float | None) -> Array:
        best = whole(costs)
        ends = (best == 0) | (best == costs.shape[-1] - 1)
        return np.where(ends, np.clip(best, 1, costs.shape[-1] - 2) if value is None else value, right(costs))

    wrong = [
        (lambda c: 2 * whole(c) - right(c), "the sign: the vertex lies towards the cheaper neighbour"),
        (partial(right, factor=1), "the 2 below the line is missing"),
        (partial(right, factor=0.25), "the parabola's leading coefficient is half of l - 2c + r"),
        (whole, "that is the best sphere: add the offset of the parabola's vertex"),
        (lambda c: right(c) - whole(c), "that is the offset: add the best sphere"),
        (partial(right, wrap=True), "n ± 1 does not wrap: the first and the last sphere have one neighbour and stay"
         " whole"),
        (partial(at_ends, value=np.nan), "a winner at the first or last sphere is one, too: it stays whole, no NaN"),
        (partial(at_ends, value=0), "a winner at the last sphere stays there"),
        (partial(at_ends, value=None), "the first and the last sphere may win: do not move them inside"),
        (partial(right, dear=True), "that is the dearest sphere; a match costs little"),
        (lambda c: right(c) + 1, "spheres count from 0"),
        (lambda c: right(np.moveaxis(c, 0, -1)), "the wrong axis: the spheres are the last one"),
    ]  # fmt: skip
    return by((costs,), right, wrong)


def _sparsified(
    error: Array, confidence: Array, shares: Array, *, order: float = 1, fill: float | None = None, root: bool = False
) -> Array:
    known = np.isfinite(error) & np.isfinite(confidence)
    if fill is not None:
        error, known = np.where(np.isfinite(error), error, fill), np.isfinite(confidence)
    error, confidence = error[known], confidence[known]
    ranked = error[np.argsort(order * confidence)] if order else error
    rest = [ranked[int(share * len(ranked)) :] for share in shares]
    return np.array([np.sqrt(np.mean(e**2)) if root else np.mean(e) for e in rest])


@checker
def check_sparsification(rng: Rng, k: int) -> Case:
    """07.5: mean error of the rays that remain when the least confident shares are removed."""
    confidence = rng.uniform(0, 1, (5, 8 + k % 4))
    error = rng.exponential(3, confidence.shape) * (1.3 - confidence)
    error[0, :3] = confidence[1, :2] = np.nan
    shares = np.sort(rng.uniform(0.05, 0.9, 4 + k % 3))
    shares[0] = 0
    right = _sparsified

    def of_largest(error: Array, confidence: Array, shares: Array) -> Array:
        return right(error, np.where(np.isfinite(confidence), -error, np.nan), shares)

    def flat(error: Array, confidence: Array, shares: Array) -> Array:
        """NaN sorted to the end and kept."""
        ranked = error.ravel()[np.argsort(confidence.ravel())]
        return np.array([np.nanmean(ranked[int(share * ranked.size) :]) for share in shares])

    wrong = [
        (partial(right, order=-1), "that removes the most confident rays; the least confident go first"),
        (of_largest, "that removes the largest errors, which only an oracle knows: sort by confidence"),
        (partial(right, order=0), "nothing is sorted: put the rays in the order of their confidence first"),
        (lambda e, c, s: right(e, c, 1 - s - 1e-9), "those are the shares that remain; `shares` are removed"),
        (partial(right, fill=0), "a ray without an error is not a perfect one: leave it out"),
        (partial(right, root=True), "the mean of the errors, not the root of the mean square"),
        (lambda e, c, s: right(e, c, s) * (1 - s), "divide by the number of rays that remain"),
        (lambda e, c, s: right(e, c, s) / right(e, c, 0 * s), "that is relative to all rays; the error itself is"
         " asked"),
        (lambda e, c, s: np.array([np.nanmean(e[c >= x]) for x in s]), "`shares` are shares of the rays, no limits of"
         " the confidence"),
        (flat, "rays without confidence or error are ignored: they are not among those to count, either"),
        (lambda e, c, s: np.full(len(s), np.nan), "NaN spoils the mean: leave those rays out first"),
        (lambda e, c, s: right(e, c, s)[::-1], "the order of `shares` is the order of the result"),
        (lambda e, c, s: right(e, c, s).mean(), "that is one number; one for each share is asked"),
    ]  # fmt: skip
    return by((error, confidence, shares), right, wrong)
