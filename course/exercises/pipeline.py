"""Checkers of notebook 13: parts of the whole method, tried on many random inputs."""

import numpy as np

from course.exercises.compare import Array, Case, Rng, checker


@checker
def check_points(rng: Rng, k: int) -> Case:
    """13.1: the points of a depth panorama, (H, W, 3)."""
    H, W = rng.integers(2, 5), rng.integers(5, 9)
    depth, theta, phi = rng.uniform(1, 20, (H, W)), rng.uniform(-3, 3, W), rng.uniform(-0.7, 0.7, H)

    def points(theta: Array, phi: Array, depth: Array = depth) -> Array:
        x = np.cos(phi)[:, None] * np.sin(theta)
        y = np.broadcast_to(np.sin(phi)[:, None], x.shape)
        return depth[..., None] * np.stack([x, y, np.cos(phi)[:, None] * np.cos(theta)], -1)

    right = points(theta, phi)
    flat = np.stack(np.broadcast_arrays(np.sin(theta), np.sin(phi)[:, None], np.cos(theta)), -1)
    return (depth, theta, phi), right, [
        (points(theta, -phi), "y points down: the sine of φ as it is"),
        (points(-theta, phi), "θ turns from z, forward, towards x, right: the sine of θ as it is"),
        (right[..., [2, 1, 0]], "x goes with the sine of θ, z with its cosine: they are swapped"),
        (depth[..., None] * flat, "x and z shrink with the cosine of φ, or the ray has not the length 1"),
        (points(theta, phi, 1 / depth), "that is with the inverse depth"),
        (right / depth[..., None], "those are the rays: multiply each by its depth"),
        (right / right[..., 2:] * depth[..., None], "depth is the distance along the ray, not z"),
        (np.moveaxis(right, -1, 0), "the coordinates come last: (H, W, 3)"),
    ]  # fmt: skip


@checker
def check_two_walks(rng: Rng, k: int) -> Case:
    """13.2: SGM along an open row in both directions, (W, N)."""

    def walk(costs: Array, p1: float, p2: float, start: Array | None = None) -> Array:
        lines: list[Array] = []
        n = np.arange(costs.shape[1])
        jump = np.abs(n[:, None] - n)
        price = np.where(
            jump == 0, 0, np.where(jump == 1, min(p1, p2), p2)
        )  # of every way from k to n: slow and certain
        for cost in costs:
            before = lines[-1] if lines else start
            lines.append(cost if before is None else cost + (before + price).min(1) - before.min())
        return np.array(lines)

    costs = rng.uniform(0, 1, (rng.integers(4, 9), rng.integers(5, 11)))
    p1, p2 = 0.1 + 0.05 * rng.uniform(), 0.3 + 0.2 * rng.uniform()
    there, back = walk(costs, p1, p2), walk(costs[::-1], p1, p2)[::-1]
    around = walk(costs, p1, p2, there[-1]) + walk(costs[::-1], p1, p2, back[0])[::-1]
    return (costs, p1, p2), there + back, [
        (there, "that is the walk to the right; add the one to the left"),
        (back, "that is the walk to the left; add the one to the right"),
        (2 * there, "walk the other way over the reversed row, not the same way twice"),
        (there + back[::-1], "turn the second walk around again before you add it"),
        (there + back - costs, "each walk keeps its own cost: add them as they are"),
        ((there + back) / 2, "that is the mean of both walks; return the sum"),
        (around, "this row is open: the first ray of a walk has nothing before it"),
        (walk(costs, p2, p1) + walk(costs[::-1], p2, p1)[::-1], "P1 is for one sphere, P2 for any jump: swapped"),
    ]  # fmt: skip
