"""Checkers of notebook 10 that ask for functions on arrays, each beside its usual mistakes."""

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
