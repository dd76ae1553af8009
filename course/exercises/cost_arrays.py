"""Checkers of notebooks 04 and 05 that ask for functions on arrays, each beside its usual mistakes."""

from __future__ import annotations

from functools import partial

import numpy as np

from course.exercises.compare import Array, Case, Rng, by, checker


@checker
def check_unit_features(rng: Rng, k: int) -> Case:
    """05.4: features (C, H, W) divided by their length at each pixel; zeros stay zeros."""
    features = rng.normal(0.3, 1, (6 + k % 5, 3, 4 + k % 3)).astype(np.float32 if k % 2 else np.float64)
    features[:, 1, 2] = 0

    def right(f: Array, axis: int | tuple[int, ...] = 0, zero: float = 0, power: float = 0.5) -> Array:
        length = np.broadcast_to(np.sum(f.astype(np.float64) ** 2, axis=axis, keepdims=True) ** power, f.shape)
        return np.where(length > 0, f / length, zero)

    wrong = [
        (partial(right, axis=1), "normalised over the wrong axis: the channels of a pixel are the first one"),
        (partial(right, axis=2), "normalised over the wrong axis: the channels of a pixel are the first one"),
        (partial(right, axis=(1, 2)), "that is one length for each channel; each pixel has its own"),
        (partial(right, axis=(0, 1, 2)), "that is one length for all pixels; each has its own"),
        (partial(right, zero=np.nan), "a pixel whose features are all 0 has no direction: it stays 0, not NaN"),
        (partial(right, power=1), "the length is the root of the sum of squares"),
        (lambda f: f / np.maximum(np.abs(f).sum(0), 1e-9), "the length is the root of the sum of squares, not the sum"
         " of the sizes"),
        (lambda f: f / np.maximum(np.abs(f).max(0), 1e-9), "divide by the length, not by the largest channel"),
        (lambda f: right(f) * np.sqrt(len(f)), "the sum of the squares under the root, not their mean"),
        (lambda f: right(f - f.mean(0)), "that subtracts the mean, as ZNCC does; the cosine does not"),
        (lambda f: np.sqrt(np.sum(f**2, axis=0)), "those are the lengths: divide by them"),
        (lambda f: np.abs(right(f)), "the signs stay: a direction has them"),
        (lambda f: np.moveaxis(right(f), 0, -1), "the channels stay first: (C, H, W)"),
    ]  # fmt: skip
    return by((features,), right, wrong)


def _patches(
    panorama: Array, rows: Array, columns: Array, half: int, *, wrap: bool = True, above: str = "zero", shift: int = 0
) -> Array:
    """Patches one pixel after the other; `above` says what lies beyond the rows."""
    H, W = panorama.shape
    patches = np.zeros((len(rows), 2 * half + 1, 2 * half + 1))
    for n, (row, column) in enumerate(zip(rows, columns, strict=True)):
        for i in range(2 * half + 1):
            for j in range(2 * half + 1):
                y, x = row - half + i + shift, column - half + j + shift
                if 0 <= y < H or above != "zero":
                    y = y % H if above == "wrap" else min(max(y, 0), H - 1)
                    patches[n, i, j] = panorama[y, x % W if wrap else min(max(x, 0), W - 1)]
    return patches


@checker
def check_patches(rng: Rng, k: int) -> Case:
    """05.5: patches (K, s, s) around pixels, s = 2 half + 1, columns wrapped, zeros above and below the panorama."""
    H, W, half = 9 + k % 3, 14 + k % 4, 1 + k % 3
    panorama = rng.normal(0, 1, (H, W)).astype(np.float32 if k % 2 else np.float64)
    rows, columns = rng.integers(0, H, 6), rng.integers(0, H, 6)
    rows[:4], columns[:4] = (0, H - 1, 4, 4), (half, W // 2, 0, W - 1)
    right = _patches

    def black_seam(panorama: Array, rows: Array, columns: Array, half: int) -> Array:
        seam = np.pad(panorama, ((0, 0), (half, half)))
        return right(seam, rows, columns + half, half)

    wrong = [
        (partial(right, wrap=False), "around the seam the first column follows the last one: take columns modulo W"),
        (black_seam, "around the seam the first column follows the last one: no zeros there"),
        (partial(right, above="edge"), "above and below the panorama there is nothing: zeros, not the first row again"),
        (partial(right, above="wrap"), "rows do not wrap: above the first one there is nothing, zeros"),
        (partial(right, shift=1), "one pixel too far to the right and down: the patch runs from -half to +half"),
        (partial(right, shift=-1), "one pixel too far to the left and up: the patch runs from -half to +half"),
        (lambda p, r, c, h: right(p, r + h, c + h, h), "shifted by half a patch: the pixel is its middle, not its"
         " corner"),
        (lambda p, r, c, h: right(p, r, c, h)[:, :-1, :-1], "from -half to +half, both ends with it, are 2 half + 1"),
        (lambda p, r, c, h: right(p, c, r, h), "rows and columns are swapped"),
        (lambda p, r, c, h: right(p, r, c, h).swapaxes(1, 2), "the patches are transposed: rows first, then columns"),
        (lambda p, r, c, h: right(p, r, c, h)[:, ::-1], "the patches are upside down"),
        (lambda p, r, c, h: right(p, r, c, h)[:, :, ::-1], "the patches are mirrored"),
        (lambda p, r, c, h: right(p, r, c, h).reshape(len(r), -1), "a patch keeps its two axes: (K, s, s)"),
        (lambda p, r, c, h: np.moveaxis(right(p, r, c, h), 0, -1), "the patches come first: (K, s, s)"),
        (lambda p, r, c, h: right(p, r, c, h)[0], "that is the first patch alone; all are asked"),
    ]  # fmt: skip
    return by((panorama, rows, columns, half), right, wrong)
