"""Point clouds as pages of HTML on which they turn: cloud.html with the points in it. They need no network."""

import base64
import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

PAGE = Path(__file__).with_name("cloud.html")
MAX_POINTS = 30_000  # twelve letters each


def thinned(points: NDArray, colors: NDArray) -> tuple[NDArray, NDArray]:
    """Return at most `MAX_POINTS` points and their colours, chosen at random, always the same ones."""
    if len(points) <= MAX_POINTS:
        return points, colors
    chosen = np.random.default_rng(0).choice(len(points), MAX_POINTS, replace=False)
    return points[chosen], colors[chosen]


def cloud_page(points: NDArray, colors: NDArray, eye: tuple[float, float, float]) -> str:
    """Return the page of a point cloud.

    Args:
        points: array, shape (M, 3), metres, rig frame
        colors: uint8 array, shape (M, 3), RGB
        eye: Where it is looked at from at first, metres, rig frame; towards the sweep centre.
    """
    low, high = (points.min(0), points.max(0)) if len(points) else (np.zeros(3), np.ones(3))
    step = np.maximum(high - low, 1e-6) / 65535
    places = np.round((points - low) / step).astype("<u2")
    distance = float(np.linalg.norm(eye))
    start = {"azimuth": np.arctan2(eye[0], -eye[2]), "tilt": np.arcsin(-eye[1] / distance), "distance": distance}
    parts = {
        "label": f"A point cloud of {len(points)} points",
        "start": json.dumps(start),
        "low": json.dumps(low.tolist()),
        "step": json.dumps(step.tolist()),
        "data": base64.b64encode(places.tobytes() + np.asarray(colors, np.uint8).tobytes()).decode(),
    }
    page = PAGE.read_text(encoding="utf-8")
    for name, part in parts.items():
        page = page.replace(f"{{{name}}}", part)
    return page
