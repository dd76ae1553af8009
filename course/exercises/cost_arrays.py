"""Checkers of notebooks 04 and 05 that ask for functions on arrays, each beside its usual mistakes."""

from __future__ import annotations

from functools import partial

import numpy as np

from course.exercises.compare import Array, Case, Rng, by, checker


@checker
def check_winner(rng: Rng, k: int) -> Case:
    """04.3: the index of the cheapest sphere of each ray, (H, W), NaN where no sphere has a cost."""
    costs = rng.uniform(0, 1, (4, 5 + k % 3, 7 + k % 5)).astype(np.float32 if k % 2 else np.float64)
    costs[rng.uniform(0, 1, costs.shape) < 0.2] = np.nan
    costs[0, :2], costs[1, 0] = np.nan, 0.5  # nobody sees two rays; all spheres cost the same on a third
    costs[2, :2] = rng.uniform(0.3, 1, costs[2, :2].shape)
    costs[2, 0, -1], costs[2, 1, 0] = 0.1, 0.2  # the last sphere wins, and the first

    def best(filled: Array, costs: Array) -> Array:
        return np.where(np.isnan(costs).all(-1), np.nan, filled.argmin(-1))

    def right(costs: Array) -> Array:
        return best(np.where(np.isnan(costs), np.inf, costs), costs)

    wrong = [
        (lambda c: np.argmin(c, -1), "np.argmin takes NaN for the smallest number of all: leave NaN out"),
        (lambda c: best(c, c), "a cost that is not known must not win: np.argmin takes NaN, like 0, for the smallest"),
        (lambda c: np.nan_to_num(right(c)), "a ray that nobody sees has no index: NaN, and not sphere 0"),
        (lambda c: best(np.where(np.isnan(c), np.inf, -c), c), "that is the dearest sphere; a match costs little"),
        (lambda c: right(c) + 1, "spheres count from 0"),
        (lambda c: c.shape[-1] - 1 - right(c[..., ::-1]), "of equal costs the first wins, as in np.argmin"),
        (lambda c: c.shape[-1] - 1 - right(c), "sphere 0 is the one at infinity: the wrong way round"),
        (lambda c: np.fmin.reduce(c, axis=-1), "that is the lowest cost; return the sphere that has it"),
        (lambda c: right(np.moveaxis(c, 0, -1)), "the wrong axis: the spheres are the last one"),
        (lambda c: right(np.swapaxes(c, 1, 2)), "the wrong axis: the spheres are the last one"),
        (lambda c: right(c.reshape(-1)), "that is one number: each ray has its own winner"),
    ]  # fmt: skip
    return by((costs,), right, wrong)


def _correlations(a: Array, b: Array, *, ddof: int = 0, power: float = 1, mean: bool = True, flat: float = 0) -> Array:
    """ZNCC of each patch of a with each of b, one by one."""
    result = np.zeros((len(a), len(b)))
    for i, p in enumerate(a.astype(np.float64)):
        for j, q in enumerate(b.astype(np.float64)):
            p0, q0 = (p - p.mean(), q - q.mean()) if mean else (p, q)
            scale = np.sqrt(np.mean(p0**2) * np.mean(q0**2)) ** power
            result[i, j] = np.sum(p0 * q0) / (len(p) - ddof) / scale if np.ptp(p) * np.ptp(q) else flat
    return result


@checker
def check_zncc_matrix(rng: Rng, k: int) -> Case:
    """04.5: ZNCC of each of K patches with each of M others, (K, M); a flat patch has 0 with all."""
    K, M, size = 3 + k % 3, 5 + k % 2, (9, 25)[k % 2]
    a, b = rng.normal(80, 30, (K, size)), rng.normal(90, 20, (M, size))
    b[:K] += 0.7 * a
    a[1], b[0] = 12, 200
    if k % 3 == 0:
        a, b = np.rint(a).clip(0, 255).astype(np.uint8), np.rint(b).clip(0, 255).astype(np.uint8)
    right = _correlations

    def over(a: Array, b: Array, axis: int | None) -> Array:
        """With the means and lengths over another axis, or one for all."""
        a, b = (x - x.mean(axis, keepdims=True) for x in (a.astype(np.float64), b.astype(np.float64)))
        a, b = (x / np.sqrt(np.mean(x**2, axis, keepdims=True)) for x in (a, b))
        return a @ b.T / a.shape[1]

    wrong = [
        (lambda a, b: right(a, b).T, "one row for each patch of a, one column for each of b: (K, M)"),
        (lambda a, b: np.diag(right(a, b)), "each with each: (K, M), not the pairs alone"),
        (partial(right, mean=False), "subtract the mean of each patch first (the Z of ZNCC)"),
        (partial(over, axis=0), "normalised over the wrong axis: the mean of a patch is over its pixels, the last one"),
        (partial(over, axis=None), "one mean for all patches: each has its own"),
        (partial(right, power=0), "divide by both standard deviations (the N of ZNCC)"),
        (partial(right, power=2), "divide by the standard deviations, not by the variances"),
        (partial(right, ddof=1), "mean and sum are mixed: n in the covariance and in the deviations"),
        (lambda a, b: right(a, b) * a.shape[1], "divide the sum of the products by the number of pixels"),
        (lambda a, b: (1 - right(a, b)) / 2, "that is the cost; return ZNCC itself"),
        (partial(right, flat=np.nan), "a flat patch has no pattern: its ZNCC is 0, not NaN"),
        (partial(right, flat=1), "a flat patch is like nothing: its ZNCC is 0, not 1"),
        (lambda a, b: np.abs(right(a, b)), "the sign counts: a negative is no match"),
        (lambda a, b: right(a, b) ** 2, "that is the square"),
        (lambda a, b: right(a, b).mean(1), "that is the mean over the patches of b; each pair is asked"),
    ]  # fmt: skip
    return by((a, b), right, wrong)


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
