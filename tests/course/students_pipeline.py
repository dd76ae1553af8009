"""Students of notebook 13: what each checker says, and to which answer; see students_results."""

import numpy as np


def cloud(depth, theta, phi):
    theta, phi = np.meshgrid(theta, phi)
    rays = np.array([np.cos(phi) * np.sin(theta), np.sin(phi), np.cos(phi) * np.cos(theta)])
    return np.transpose(depth * rays, (1, 2, 0))


def one_by_one(depth, theta, phi):
    return [
        [[d * np.cos(p) * np.sin(t), d * np.sin(p), d * np.cos(p) * np.cos(t)] for t, d in zip(theta, row, strict=True)]
        for p, row in zip(phi, depth, strict=True)
    ]


def without_cosine(depth, theta, phi):
    theta, phi = np.meshgrid(theta, phi)
    return depth[..., None] * np.stack([np.sin(theta), np.sin(phi), np.cos(theta)], -1)


POINTS = [
    ("right", cloud),
    ("right", one_by_one),
    ("y points down", lambda depth, theta, phi: cloud(depth, theta, phi) * [1, -1, 1]),
    ("θ turns from z", lambda depth, theta, phi: cloud(depth, theta, phi) * [-1, 1, 1]),
    ("swapped", lambda depth, theta, phi: cloud(depth, np.pi / 2 - theta, phi)),
    ("shrink with the cosine", without_cosine),
    ("with the inverse depth", lambda depth, theta, phi: cloud(1 / depth, theta, phi)),
    ("multiply each by its depth", lambda depth, theta, phi: cloud(np.ones_like(depth), theta, phi)),
    ("not z", lambda depth, theta, phi: cloud(depth / (np.cos(phi)[:, None] * np.cos(theta)), theta, phi)),
    ("the coordinates come last", lambda depth, theta, phi: cloud(depth, theta, phi).transpose(2, 0, 1)),
]


def walk(costs, p1, p2, before=None):
    lines = []
    for cost in costs:
        if before is None:
            before = cost
        else:
            ends = np.pad(before, 1, constant_values=np.inf)
            ways = [before, ends[:-2] + p1, ends[2:] + p1, np.full(len(before), before.min() + p2)]
            before = cost + np.min(ways, axis=0) - before.min()
        lines.append(before)
    return np.array(lines)


def back(costs, p1, p2):
    return walk(costs[::-1], p1, p2)[::-1]


def both(costs, p1, p2):
    return walk(costs, p1, p2) + back(costs, p1, p2)


def around_the_seam(costs, p1, p2):
    right, left = walk(costs, p1, p2), back(costs, p1, p2)
    return walk(costs, p1, p2, right[-1]) + walk(costs[::-1], p1, p2, left[0])[::-1]


TWO_WALKS = [
    ("right", both),
    ("right", lambda costs, p1, p2: np.sum([back(costs, p1, p2), walk(costs, p1, p2)], axis=0)),
    ("add the one to the left", walk),
    ("add the one to the right", back),
    ("not the same way twice", lambda costs, p1, p2: 2 * walk(costs, p1, p2)),
    ("around again", lambda costs, p1, p2: walk(costs, p1, p2) + walk(costs[::-1], p1, p2)),
    ("keeps its own cost", lambda costs, p1, p2: both(costs, p1, p2) - costs),
    ("return the sum", lambda costs, p1, p2: both(costs, p1, p2) / 2),
    ("this row is open", around_the_seam),
    ("swapped", lambda costs, p1, p2: both(costs, p2, p1)),
]
