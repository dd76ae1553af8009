"""Notebook 13: a ray caster (a box, a checker, light and shadow), and depth along a ray from z."""

import numpy as np

from course.exercises.compare import Rng
from course.exercises.opened import Open


def hit_box(origins, rays, low, high):
    """Distances (…) along rays (…, 3) from points (…, 3) or (3,) to a box between two corners (3,);
    inf for a miss."""
    with np.errstate(divide="ignore"):  # a ray along a face never meets its plane
        to_low, to_high = (low - origins) / rays, (high - origins) / rays
    # inside once it is between all three pairs of planes
    enters = np.minimum(to_low, to_high).max(axis=-1)
    leaves = np.maximum(to_low, to_high).min(axis=-1)  # outside once it has left one of them
    ahead = np.where(enters > 0, enters, leaves)  # from inside, only the way out lies ahead
    return np.where((enters <= leaves) & (leaves > 0), ahead, np.inf)


def _rays_and_box(rng: Rng, k: int) -> tuple:
    low = rng.uniform(-2, -0.5, 3)
    high = low + rng.uniform(1, 3, 3)
    middle, half = (low + high) / 2, (high - low) / 2
    inside = middle + 0.8 * half * rng.uniform(-1, 1, 3)
    outside = middle + half * rng.choice([-1, 1], 3) * rng.uniform(1.5, 3, (12 + k % 3, 3))
    outside[:4, 0] = inside[0]  # beside a face
    towards = middle + half * rng.uniform(-1.5, 1.5, outside.shape) - outside
    towards[6:8] *= -1  # the box lies behind
    towards[8, 1] = 0  # along a face
    rays = towards / np.linalg.norm(towards, axis=-1, keepdims=True)
    origins = inside if k % 3 == 0 else np.concatenate([outside[:-1], [inside]])
    return origins, {5: rays[0], 6: rays[:, None]}.get(k, rays), low, high


check_hit_box = Open(hit_box, _rays_and_box).with_slips("""
    np.minimum(to_low, to_high) → to_low
    np.maximum(to_low, to_high) → to_high
    # a ray that runs backwards along an axis meets `high` first: sort each pair of planes
    to_high).max(axis=-1) → to_high).min(axis=-1)
    # it is inside after the last of three entries: max
    np.maximum(to_low, to_high).min → np.maximum(to_low, to_high).max
    # it is outside after the first of three exits: min
    & (leaves > 0) →  # a box behind the origin is not seen: it must leave ahead, at more than 0
    np.where(enters > 0, enters, leaves) → enters
    # from inside, the entry lies behind: take the exit
""")


def checker(points, size):
    """Grey values (…), 0.8 and 0.2, at points (…, 3): space in cubes of `size` metres, neighbours
    of different grey."""
    number = np.floor(points / size).sum(axis=-1)  # floor also rounds down below 0
    return np.where(number % 2 == 0, 0.8, 0.2)  # the cube at the origin is bright


def _some_points(rng: Rng, k: int) -> tuple:
    return rng.uniform(-4, 4, (40, 3) if k % 2 else (8, 5, 3)), rng.uniform(0.3, 0.9)


check_checker = Open(checker, _some_points).with_slips("""
    np.floor(points / size) → (points / size).astype(int)
    # int rounds towards 0, so two cubes meet there: floor
    np.floor( → np.rint(  # the cubes begin at 0: floor, not round
    np.floor(points / size).sum(axis=-1) → np.floor((points / size).sum(axis=-1))
    # floor each coordinate first, then add
    np.floor(points / size) → np.floor(points / size)[..., [0, 2]]  # all three coordinates count
""")


def look(origin, rays, boxes, to_sun, paint):
    """Grey values (…) along rays (…, 3) from a point: paint(points) times the light, 0.4 from the
    sky and up to 0.8 from the sun; 0.9 where a ray meets none of the boxes (n, 2, 3)."""
    distances = np.stack([hit_box(origin, rays, *box) for box in boxes])
    distance, number = distances.min(axis=0), distances.argmin(axis=0)
    hit = np.isfinite(distance)
    points = origin + distance[hit][:, None] * rays[hit]
    # the face is that of the axis along which the point is farthest out
    middle, half = boxes.mean(axis=1), (boxes[:, 1] - boxes[:, 0]) / 2
    out = (points - middle[number[hit]]) / half[number[hit]]
    normals = np.sign(out) * (np.arange(3) == np.abs(out).argmax(axis=-1)[..., None])
    # Lambert's cosine, where no box is in the way to the sun; a face must not shade itself
    slope = np.maximum(normals @ to_sun, 0)
    above = points + 1e-6 * normals
    free = np.isinf(np.min([hit_box(above, to_sun, *box) for box in boxes], axis=0))
    gray = np.full(distance.shape, 0.9)
    gray[hit] = paint(points) * (0.4 + 0.8 * slope * free)
    return gray


def _two_checkers(points):
    return (checker(points, 0.7) + checker(points + 0.1, 0.31)) / 2


def _a_view(rng: Rng, k: int) -> tuple:
    low = rng.uniform([-4, -3, -4], [3, 1, 3], (5, 3))
    low[np.all(np.abs(low) < 1.2, axis=1)] -= 3  # nobody stands in a box
    boxes = np.stack([low, low + rng.uniform(0.4, 1.0, low.shape)], axis=1)
    boxes[0] = (-9, 2.5, -9), (9, 3, 9)  # the ground, y is down
    to_sun = np.array([0.48, -0.64, -0.6])
    middle = boxes.mean(axis=1)
    shadow = middle + to_sun * ((2.5 - middle[:, 1:2]) / to_sun[1])
    rays = rng.normal(0, 1, (5, 8 + k % 3, 3))
    rays[0] = middle[np.arange(rays.shape[1]) % 5] + rng.normal(0, 0.1, rays[0].shape)
    rays[1] = shadow[1 + np.arange(rays.shape[1]) % 4] + rng.normal(0, 0.1, rays[0].shape)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    return np.zeros(3), rays, boxes, to_sun, _two_checkers


check_look = Open(look, _a_view, whole=("origin", "boxes", "to_sun")).with_slips("""
    distance, number = distances.min(axis=0), distances.argmin(axis=0)
    → distance, number = distances[0], np.zeros(distances.shape[1:], int)
    # that is the first box: a ray shows the nearest of all that it meets
    np.sign(out) * → 1.0 *
    # a normal points out of its box: to the side on which the point is, np.sign
    (points - middle[number[hit]]) / half[number[hit]] → points - middle[number[hit]]
    # boxes are not cubes: divide by their half sizes before you ask which axis is farthest out
    (0.4 + 0.8 * slope * free) → (0.4 + 0.8 * slope) * free  # a shadow is not black: the sky stays
    points + 1e-6 * normals → points
    # a face may shade itself: start a millionth of a metre above it
""")


def distances_from_z(z, rays):
    """Distances (…) along rays (…, 3) of any length, from depths z (…) along the axis, which is the
    z of the rays."""
    return z * np.linalg.norm(rays, axis=-1) / rays[..., 2]


def _depths(rng: Rng, k: int) -> tuple:
    rays = rng.uniform([-1.5, -1, 0.5], [1.5, 1, 2], (3, 4 + k % 3, 3))
    rays = rays[0] if k % 2 else rays
    return rng.uniform(2, 9, rays.shape[:-1]), rays


check_distances_from_z = Open(distances_from_z, _depths).with_slips("""
    return z / np.linalg.norm(rays, axis=-1) * rays[..., 2]
    # the wrong way round: the ray is longer than its z
    / rays[..., 2] →  # the rays do not end at z = 1: divide by their z
    * np.linalg.norm(rays, axis=-1) →
    # that many rays long it is: times the ray's length gives metres
    norm(rays, axis=-1) → norm(rays)  # one length for each ray: axis=-1
""")
