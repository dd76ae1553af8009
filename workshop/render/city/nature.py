"""Trees, hedges and people: everything that grows. Feet at z = 0."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from workshop.render.surfaces.mesh_builder import Mesh, points


def tree(rng: Generator, height: float, crown: float) -> Mesh:
    """Return a tree `height` metres tall, its crown within `crown` metres of the trunk."""
    mesh, fork = Mesh(), 0.42 * height
    up = (-0.1, 0.5 * fork, fork, 0.75 * height)
    trunk = points((0, 0.02, 0, 0.04), (0, 0.01, 0.03, 0), up)
    mesh.tube(trunk, [0.16, 0.13, 0.11, 0.04], "bark", 9)
    blobs = []
    for k in range(9):
        angle = 2.4 * k + rng.uniform(-0.4, 0.4)
        up = fork + (height - fork) * rng.uniform(0.2, 0.85)
        size = crown * rng.uniform(0.42, 0.58)
        bulge = np.sin(np.pi * (up - 0.7 * fork) / (height * 1.1 - 0.7 * fork))
        reach = (crown - size) * rng.uniform(0.75, 1.0) * bulge
        tip = np.array([reach * np.cos(angle), reach * np.sin(angle), up])
        root = np.array([0, 0.02, fork + 0.3 * (up - fork)])
        mesh.tube([root, (root + tip) / 2 + (0, 0, 0.12), tip], [0.05, 0.035, 0.012], "bark", 5)
        blobs.append((tip, size))
    blobs.append((np.array([0, 0, 0.88 * height]), 0.5 * crown))
    for center, size in blobs:
        _foliage(mesh, center, np.array([size, size, 0.8 * size]), int(420 * size**2) + 60, rng)
    return mesh


def _foliage(mesh: Mesh, center: NDArray, radii: NDArray, count: int, rng: Generator) -> None:
    """Scatter leaves through an ellipsoid, denser towards its skin."""
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    at = center + direction * radii * rng.uniform(0.35, 1.0, (count, 1)) ** 0.6
    a, b = rng.normal(size=(2, count, 3))
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    b = np.cross(a, b)
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    a = a * 0.075 * rng.uniform(0.9, 2.0, (count, 1))
    b = b * 0.075 * rng.uniform(0.7, 1.4, (count, 1))
    shine = np.clip(0.5 + 0.35 * direction[:, 2] + rng.normal(0, 0.15, count), 0, 1)
    mesh.add(np.stack([at - a, at + b * 0.8, at + a, at - b * 0.8], axis=1), "leaf", shine)


def hedge(length: float, rng: Generator) -> Mesh:
    """Return a clipped hedge along x, 1.1 m high."""
    mesh, n = Mesh(), int(700 * length)
    mesh.box((0, -0.22, 0), (length, 0.22, 0.95), "soil")
    x, y = rng.uniform(0, length, n), rng.uniform(-0.36, 0.36, n)
    at = points(x, y, rng.uniform(0.02, 1.12, n))
    a, b = rng.normal(0, 0.045, (2, n, 3))
    mesh.add(np.stack([at - a, at + b, at + a, at - b], axis=1), "leaf", rng.random(n))
    return mesh


def person(rng: Generator, walking: bool) -> Mesh:
    """Return somebody between 1.55 and 1.9 m tall, standing or in mid-stride along +x."""
    mesh, h = Mesh(), rng.uniform(1.55, 1.9)
    stride = 0.17 * h if walking else 0.02
    coat, trousers, shoes = rng.random(), rng.random(), 0.03
    for side, step in ((-1, stride), (1, -stride)):
        across, up = side * h * np.array([0.05, 0.055, 0.06]), h * np.array([0.5, 0.27, 0.04])
        leg = points((0, step * 0.6, step), across, up)  # hip, knee, ankle
        mesh.tube(leg, [0.05 * h, 0.036 * h, 0.026 * h], "fabric", 10, trousers)
        foot, radii = leg[2] + (0.03 * h, 0, -0.01 * h), (0.075 * h, 0.028 * h, 0.028 * h)
        mesh.ball(foot, radii, "fabric", 6, shoes)
        across, up = side * h * np.array([0.12, 0.145, 0.14]), h * np.array([0.8, 0.64, 0.48])
        arm = points((0, -step * 0.4, -step * 0.6 + 0.05), across, up)  # shoulder, elbow, hand
        mesh.tube(arm, [0.034 * h, 0.027 * h, 0.02 * h], "fabric", 8, coat)
        mesh.ball(arm[2], (0.02 * h, 0.015 * h, 0.035 * h), "skin", 5)
    heights = np.array([0.46, 0.52, 0.6, 0.7, 0.78, 0.83]) * h
    wide = np.array([0.09, 0.1, 0.088, 0.11, 0.12, 0.05]) * h
    deep = np.array([0.065, 0.07, 0.06, 0.075, 0.065, 0.04]) * h
    angle = np.linspace(0, 2 * np.pi, 15)
    across, along = wide[:, None] * np.sin(angle), deep[:, None] * np.cos(angle)
    rings = points(along, across, heights[:, None])
    mesh.sheet(rings, "fabric", coat)
    mesh.add(rings[[0, -1], :-1], "fabric", coat)
    mesh.tube([(0, 0, 0.8 * h), (0, 0, 0.88 * h)], 0.03 * h, "skin", 8)
    mesh.ball((0.01 * h, 0, 0.925 * h), (0.052 * h, 0.043 * h, 0.065 * h), "skin", 8)
    at, radii = (-0.008 * h, 0, 0.95 * h), (0.056 * h, 0.05 * h, 0.052 * h)
    mesh.ball(at, radii, "fabric", 7, rng.choice([0.0, 0.65, 0.35]))  # hair
    if rng.random() < 0.5:
        mesh.box((-0.18, -0.14, 0.55 * h), (-0.06, 0.14, 0.78 * h), "fabric", rng.random())
    return mesh
