"""Checkers of notebooks 10 and 11 that ask for functions on arrays, each beside its usual mistakes."""

from __future__ import annotations

from functools import partial

import numpy as np

from course.exercises.compare import Array, Case, Rng, by, checker


def _seen_by(rays: Array, axes: Array, fov_deg: float) -> Array:
    """The number of cameras within half of whose field of view each ray lies, by the angle."""
    length = np.linalg.norm(rays, axis=-1)[..., None] * np.linalg.norm(axes, axis=-1)
    angle = np.degrees(np.arccos(np.clip(rays @ axes.T / length, -1, 1)))
    return np.sum(angle <= fov_deg / 2, axis=-1).astype(np.float64)


@checker
def check_seen_by(rng: Rng, k: int) -> Case:
    """10.3: how many cameras see each ray (H, W), from their axes (cameras, 3) and their full field of view."""
    cameras, fov_deg = 3 + k % 5, float(rng.uniform(150, 230))
    azimuth = 2 * np.pi * np.arange(cameras) / cameras + rng.uniform(0, 1)
    axes = np.stack([np.sin(azimuth), rng.uniform(-0.3, 0.3, cameras), np.cos(azimuth)], 1)
    axes *= rng.uniform(0.6, 1.8, (cameras, 1))
    rays = rng.normal(0, 1, (5, 9 + k % 3, 3)) * rng.uniform(0.5, 3, (5, 9 + k % 3, 1))
    right = _seen_by

    def plain(rays: Array, axes: Array, fov_deg: float) -> Array:
        return np.sum(rays @ axes.T >= np.cos(np.radians(fov_deg / 2)), axis=-1)

    def unit(vectors: Array) -> Array:
        return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)

    wrong = [
        (lambda r, a, fov: right(r, a, 2 * fov), "the field of view is the full angle: half of it on each side"),
        (lambda r, a, fov: right(r, a, fov / 2), "half the field of view on each side, not a quarter"),
        (
            lambda r, a, fov: len(a) - right(r, a, fov),
            "the wrong way round: small angles are seen, and their cosine is large",
        ),
        (lambda r, a, fov: right(-r, a, fov), "the sign: a camera looks along its axis"),
        (plain, "divide by both lengths: neither rays nor axes are unit vectors"),
        (lambda r, a, fov: plain(unit(r), a, fov), "divide by the length of the axes, too"),
        (lambda r, a, fov: plain(r, unit(a), fov), "divide by the length of the rays, too"),
        (lambda r, a, fov: right(r, a, np.radians(fov)), "degrees and radians are mixed"),
        (lambda r, a, fov: np.sum(unit(r) @ unit(a).T >= np.cos(fov / 2), -1), "degrees and radians are mixed"),
        (lambda r, a, fov: np.sum(unit(r) @ unit(a).T > 0, -1), "that counts angles below 90°, whatever the lens"),
        (lambda r, a, fov: right(r, a[:4], fov), "a rig may have more than four cameras"),
        (lambda r, a, fov: (right(r, a, fov) > 0) * 1, "that is whether one sees it; return how many do"),
        (lambda r, a, fov: right(r, a, fov) / len(a), "that is the share of the cameras; return their number"),
        (
            lambda r, a, fov: right(r, a, fov) * (right(r, a, fov) - 1) / 2,
            "that is the number of pairs; cameras are asked",
        ),
        (lambda r, a, fov: right(r, a * [1, 0, 1], fov), "the axes point up and down, too: y counts"),
    ]
    return by((rays, axes, fov_deg), right, wrong)


def _edges(
    index: Array, jump: float, *, seam: str = "wrap", ends: str = "edge", directions: int = 4, signed: bool = False
) -> Array:
    """1 where one of the neighbours is further away than `jump`, else 0; NaN compares as False."""
    around = np.pad(np.pad(index.astype(np.float64), ((0, 0), (1, 1)), seam), ((1, 1), (0, 0)), ends)
    H, W = index.shape
    result = np.zeros((H, W))
    for i, j in [(0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (-1, -1), (1, -1), (-1, 1)][:directions]:
        difference = around[1 + i : 1 + i + H, 1 + j : 1 + j + W] - index
        result[(difference if signed else np.abs(difference)) > jump] = 1
    return result


@checker
def check_depth_edges(rng: Rng, k: int) -> Case:
    """10.4: 1 where the index of a ray and of one of its four neighbours differ by more than `jump`, else 0."""
    H, W = 5 + k % 3, 10 + k % 4
    index = 30 + np.cumsum(rng.normal(0, 0.3, (H, W)), axis=1)
    index[1:3, 3:6] += 12
    index[:, 0] = index[:, -1] + rng.choice([0, 8], H)  # at the seam
    index[-1] += 6
    index[H // 2, 7], index[0, 5] = np.nan, index[0, 4] + 4
    index[1, 7:10], index[2, 8], index[1, 8] = index[0, 8] - 2, index[0, 8] - 2, index[0, 8] - 4
    index = np.round(index * 64) / 64
    jump = 4.0
    if k % 2:
        index = index.astype(np.float32)
    right = _edges

    def with_nan(index: Array, jump: float) -> Array:
        return np.maximum(right(np.where(np.isnan(index), 1e6, index), jump), np.isnan(index))

    def larger(index: Array, jump: float) -> Array:
        return right(index, np.nextafter(jump, 0))

    def central(index: Array, jump: float) -> Array:
        across = np.abs(np.roll(index, -1, 1) - np.roll(index, 1, 1)) / 2
        return ((across > jump) | (np.abs(np.gradient(index, axis=0)) > jump)) * 1.0

    wrong = [
        (partial(right, seam="edge"), "around the seam the first column is the neighbour of the last one"),
        (partial(right, ends="wrap"), "rows do not wrap: the first and the last row have three neighbours"),
        (partial(right, signed=True), "both sides of a jump are at the edge: take the absolute value"),
        (partial(right, directions=1), "all four neighbours count: left and right, above and below"),
        (partial(right, directions=2), "both sides of a jump are at the edge: look to the left and up, too"),
        (partial(right, directions=8), "four neighbours; the diagonal ones do not count"),
        (lambda i, x: right(i, x / 2), "a difference of `jump`, not of half of it"),
        (larger, "by exactly `jump` is not more than `jump`"),
        (central, "that is half the difference of the left and the right neighbour: compare the ray with each"),
        (with_nan, "a ray without an index has no edge, and makes none beside it"),
        (lambda i, x: np.where(np.isnan(i), np.nan, right(i, x)), "a ray without an index gets 0, not NaN"),
        (lambda i, x: 1 - right(i, x), "the wrong way round: an edge is 1"),
        (lambda i, x: np.sum(right(i, x)), "that is the number of rays at edges; return the whole mask"),
    ]
    return by((index, jump), right, wrong)


@checker
def check_most_confident(rng: Rng, k: int) -> Case:
    """11.2: for each ray the index (H, W) of the method that is most confident of those with an estimate."""
    methods = 2 + k % 4
    index = rng.uniform(0, 60, (methods, 4, 7 + k % 3))
    confidence = rng.uniform(0, 1, index.shape)
    index[rng.uniform(0, 1, index.shape) < 0.25] = np.nan
    index[:, 0, 0], index[:, 0, 1] = np.nan, rng.uniform(0, 60, methods)
    confidence[0, 1, :2], index[0, 1, :2], index[1, 1, :2] = 2, np.nan, 7  # sure of nothing

    def chosen(index: Array, score: Array) -> Array:
        return np.take_along_axis(index, score.argmax(0)[None], 0)[0]

    def right(index: Array, confidence: Array) -> Array:
        return chosen(index, np.where(np.isnan(index), -1, confidence))

    def numbers(index: Array, confidence: Array) -> Array:
        return np.where(np.isnan(index), -1, confidence).argmax(0).astype(np.float64)

    def one_for_all(index: Array, confidence: Array) -> Array:
        return index[np.argmax(confidence.mean((1, 2)))]

    wrong = [
        (chosen, "a method without an estimate may still be confident: leave it out at that ray"),
        (lambda i, c: chosen(i, np.where(np.isnan(i), -1, -c + 5)), "that is the least confident method"),
        (lambda i, c: chosen(i, np.where(np.isnan(i), -1, i)), "that is the nearest estimate: choose by confidence"),
        (numbers, "that is the number of the method; return the sphere index it gives"),
        (one_for_all, "that is one method for all rays: each ray has its own"),
        (lambda i, c: np.nanmean(i, 0), "that is the mean of the methods, which lies between two surfaces"),
        (
            lambda i, c: np.nansum(i * c, 0) / np.sum(c * np.isfinite(i), 0),
            "that is a weighted mean, which lies between two surfaces",
        ),
        (lambda i, c: np.nanmedian(i, 0), "that is the median of the methods: choose by confidence"),
        (lambda i, c: np.nan_to_num(right(i, c)), "a ray without any estimate stays NaN, and is not at infinity"),
        (
            lambda i, c: np.where(np.isnan(i).any(0), np.nan, right(i, c)),
            "one method without an estimate does not hinder the others",
        ),
        (lambda i, c: np.where(np.isnan(i), -1, c).max(0), "that is the confidence; return the index"),
        (lambda i, c: i[0], "that is the first method: choose by confidence"),
    ]
    return by((index, confidence), right, wrong)


def _blend(images: Array, angles: Array, half_fov: float, *, power: float = 1, far: bool = False) -> Array:
    """The weighted mean, camera by camera."""
    total, weights = np.zeros(images.shape[1:]), np.zeros(images.shape[1:])
    for image, angle in zip(images, angles, strict=True):
        weight = np.where(np.isnan(image), 0, (angle if far else half_fov - angle) ** power)
        total += weight * np.nan_to_num(image)
        weights += weight
    return np.where(weights > 0, total / weights, np.nan)


@checker
def check_blend(rng: Rng, k: int) -> Case:
    """11.3: a panorama (H, W) from warped images, weighted by how far inside each field of view the ray lies."""
    half_fov = rng.uniform(95, 110)
    images, angles = rng.uniform(0, 255, (2, 3 + k % 4, 5, 6 + k % 4))
    angles = np.clip(angles / 255 * 1.6 * half_fov, 1, 160)
    angles[:, 0], angles[1, 0, 1], angles[1, 0, 2] = half_fov + 5, half_fov - 9, half_fov - 0.1  # one, and hardly
    images[angles >= half_fov] = np.nan
    images[0, 1, :2], angles[0, 1, :2], images[1, 1, :2], angles[1, 1, :2] = np.nan, 20, 90, 60  # under a mask
    right = _blend

    def weights(images: Array, angles: Array, half_fov: float) -> Array:
        return np.maximum(half_fov - angles, 0)

    def nearest(images: Array, angles: Array, half_fov: float) -> Array:
        closest = np.where(np.isnan(images), np.inf, angles).argmin(0)
        return np.take_along_axis(images, closest[None], 0)[0]

    wrong = [
        (partial(right, power=0), "that is the plain mean: the camera that looks there more directly counts more"),
        (partial(right, far=True), "the wrong way round: the weight is largest on the axis, and 0 at the rim"),
        (partial(right, power=2), "the weight falls evenly to the rim: do not square it"),
        (nearest, "that is the camera closest to the ray alone, which leaves seams: blend all that see it"),
        (
            lambda i, a, h: np.sum(weights(i, a, h) * i, 0) / weights(i, a, h).sum(0),
            "a camera that does not see the ray is NaN and spoils the others: leave it out",
        ),
        (
            lambda i, a, h: np.nansum(weights(i, a, h) * i, 0) / weights(i, a, h).sum(0),
            "a camera whose image is NaN there must not be among the weights to divide by, either",
        ),
        (lambda i, a, h: np.nansum(weights(i, a, h) * i, 0), "divide by the sum of the weights"),
        (
            lambda i, a, h: np.nansum(weights(i, a, h) * i, 0) / np.isfinite(i).sum(0),
            "divide by the sum of the weights, not by the number of cameras",
        ),
        (
            lambda i, a, h: right(i, a, 180),
            "the weight is 0 at the rim of the lens, `half_fov` from the axis, not at 180°",
        ),
        (lambda i, a, h: right(i, a, h / 2), "`half_fov` is half already: the weight is `half_fov` minus the angle"),
        (lambda i, a, h: np.nan_to_num(right(i, a, h)), "what nobody sees stays NaN; it is not black"),
        (lambda i, a, h: right(i[:4], a[:4], h), "a rig may have more than four cameras"),
        (lambda i, a, h: np.nanmax(i, 0), "that is the brightest camera: blend all that see the ray"),
    ]
    return by((images, angles, half_fov), right, wrong)
