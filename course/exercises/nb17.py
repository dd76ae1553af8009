"""Notebook 17: the rig's step, signed distances of one frame, the way back along a ray, and which
depth to believe."""

import numpy as np
from scipy.optimize import least_squares

import omnistereo_lib as osl
from course.exercises.compare import Rng
from course.exercises.opened import Open


def step_residual(T_ab, start, x, distance, end, y):
    """Angles (M,) in degrees between rays y (M, 3), frame b, and directions to points on rays x (M,
    3), frame a."""
    points = start + distance[:, None] * x
    toward = T_ab.inverse() @ points - end
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    return np.degrees(np.arccos(np.clip(np.sum(toward * y, axis=1), -1, 1)))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _some_sights(rng: Rng, k: int) -> tuple:
    T_ab = osl.Pose.from_vector([*rng.normal(0, 0.3, 3), *rng.normal(0, 2, 3)])
    start, end = rng.normal(0, 0.8, (2, 6 + k % 3, 3))
    x, distance = _unit(rng.normal(0, 1, start.shape)), rng.uniform(2, 9, len(start))
    y = _unit(T_ab.inverse() @ (start + distance[:, None] * x) - end)
    return T_ab, start, x, distance, end, _unit(y + rng.normal(0, 0.1, y.shape))


check_step_residual = Open(step_residual, _some_sights).with_slips("""
    T_ab.inverse() @ points → (points - T_ab.t) @ T_ab.R.T
    # for points in rows R⁻¹ p is p @ R, and p @ R.T is R p
    - end →  # the ray y begins at its camera, not in the middle of the rig: subtract end
    start + →  # the ray x begins at its camera, not in the middle of the rig: add start
    distance[:, None] * x → x / distance[:, None]
    # the point is that far along its ray: distance times x
    toward /= np.linalg.norm(toward, axis=1, keepdims=True) →
    # the product of two vectors is the cosine only if both have length 1: divide by the length
""")


def best_step(guesses, start, x, distance, end, y):
    """Of the steps found from each guess the one on which most matches agree: its vector (6,), and
    two counts, (8,).

    A match agrees within 0.5°. The counts: how many matches agree with that step, and with the next
    best (0 if there is only one guess)."""
    vectors, counts = [], []
    for guess in guesses:
        vector = guess.as_vector()
        for scale in (3, 0.3):  # degrees: first far, then near
            vector = least_squares(
                lambda v: step_residual(osl.Pose.from_vector(v), start, x, distance, end, y),
                vector,
                loss="cauchy",
                f_scale=scale,
                x_scale="jac",
            ).x
        vectors.append(vector)
        counts.append(
            np.sum(step_residual(osl.Pose.from_vector(vector), start, x, distance, end, y) < 0.5)
        )
    second = sorted(counts)[-2] if len(counts) > 1 else 0
    return np.array([*vectors[np.argmax(counts)], max(counts), second])


def _two_optima(rng: Rng, k: int) -> tuple:
    """Some matches of the true step, some of a shorter one, as where windows repeat."""
    T_ab = osl.Pose.from_vector([*rng.normal(0, 0.02, 3), *rng.normal(0, 0.1, 2), 6 + 0.1 * k])
    short = osl.Pose(T_ab.R, T_ab.t - np.array([0, 0, 5.0]))
    start, end = np.tile(rng.normal(0, 0.5, (2, 1, 3)), (1, 30, 1))
    x, distance = _unit(rng.normal(0, 1, start.shape) * (1, 0.3, 1)), rng.uniform(4, 12, len(start))
    points = start + distance[:, None] * x
    y = _unit(T_ab.inverse() @ points - end)
    some = rng.permutation(30)[: 9 + k % 4]
    y[some] = _unit(short.inverse() @ points[some] - end[some])
    y = _unit(y + rng.normal(0, 0.002, y.shape))
    guesses = [
        osl.Pose(np.eye(3), np.array([0, 0, z]))
        for z in ((0.0, 6.0), (6.5, 0.5), (1.0,), (0.0, 3.0, 7.0))[k % 4]
    ]
    return guesses, start, x, distance, end, y


check_best_step = Open(
    best_step, _two_optima, whole=("guesses", "start", "x", "distance", "end", "y")
).with_slips(
    """
    vectors[np.argmax(counts)] → vectors[0]
    # that is the first guess: take the step on which most matches agree
    for scale in (3, 0.3): → for scale in (3,):
    # once more with a scale of 0.3, from where the first one has led
    < 0.5 → < 0.3
    # a match agrees within 0.5°
"""
)


def integrate(distance, weight, points, T_world_rig, depth, confidence, grid, band):
    """Mean signed distances and sums of weights, (V,) each, at points (V, 3) of the world, with one
    more frame."""
    seen = T_world_rig.inverse() @ points
    pixels, valid = grid.project(seen)
    column, row = np.rint(pixels).astype(int).T
    ray = row.clip(0, grid.height - 1), column % grid.width
    s = np.minimum(depth[ray] - np.linalg.norm(seen, axis=1), band)
    known = valid & (s > -band)
    w = np.where(known, confidence[ray], 0)
    total = weight + w
    return (weight * distance + w * np.where(known, s, 0)) / np.maximum(total, 1e-9), total


def _voxels(rng: Rng, k: int) -> tuple:
    grid = osl.SphereGrid(16, 4, (-45, 45), num_spheres=8, min_depth=1.0)
    T_world_rig = osl.Pose.from_vector([*rng.normal(0, 0.3, 3), *rng.normal(0, 1, 3)])
    depth, confidence = rng.uniform(3, 5, grid.shape), rng.uniform(0.2, 1, grid.shape)
    points = _unit(rng.normal(0, 1, (40, 3)) * (1, 0.4, 1)) * rng.uniform(2, 6, (40, 1))
    depth[:, k % 5 :: 5] = np.nan
    return (
        rng.uniform(-0.8, 0.8, 40),
        rng.uniform(0, 1, 40),
        T_world_rig @ points,
        T_world_rig,
        depth,
        confidence,
        grid,
        0.8,
    )


check_integrate = Open(integrate, _voxels, whole=("depth", "confidence", "grid")).with_slips("""
    depth[ray] - np.linalg.norm(seen, axis=1) → np.linalg.norm(seen, axis=1) - depth[ray]
    # positive in front of the surface: the depth minus how far away the point is
    np.linalg.norm(seen, axis=1) → seen[:, 2]
    # depth is the length along the ray, not z: np.linalg.norm
    np.minimum(depth[ray] - np.linalg.norm(seen, axis=1), band)
    → depth[ray] - np.linalg.norm(seen, axis=1)
    # truncate: free space far in front of the surface counts as the band, np.minimum
    valid & (s > -band) → valid & np.isfinite(s)
    # a point far behind the surface is hidden, and the frame knows nothing of it: s > -band
    (weight * distance + w * np.where(known, s, 0)) / np.maximum(total, 1e-9)
    → np.where(known, s, distance)
    # the frames before count, too: the mean, weighted by weight and w
""")


def march(distance, radii):
    """Depth (…) at which rays first meet a surface from its free side, of signed distances (…, S)
    at radii (S,)."""
    before, after = distance[..., :-1], distance[..., 1:]
    crossed = (before > 0) & (after <= 0)
    k = np.argmax(crossed, axis=-1)
    a, b = (np.take_along_axis(some, k[..., None], axis=-1)[..., 0] for some in (before, after))
    found = radii[k] + (radii[k + 1] - radii[k]) * a / np.maximum(a - b, 1e-9)
    return np.where(crossed.any(axis=-1), found, np.nan)


def _some_walks(rng: Rng, k: int) -> tuple:
    radii = 1 + np.cumsum(rng.uniform(0.1, 0.3, 12 + k % 4))
    distance = rng.uniform(0.1, 0.5, (7, len(radii)))
    distance[:, 7:9] *= -1  # a surface, its back, and for some a second one
    distance[:2, 10] *= -1
    distance[2, :3] *= -1  # the ray begins behind a surface and comes out
    distance[3, 5:7] = np.nan  # nobody has seen what lies before the surface
    distance[4] = np.abs(distance[4])
    distance[5, :2] = np.nan
    return distance, radii


check_march = Open(march, _some_walks, whole=("radii",)).with_slips("""
    (before > 0) & (after <= 0) → (before > 0) != (after > 0)
    # from minus to plus the ray comes out at the back of a surface: only from plus to minus
    (before > 0) & →
    # a minus after what nobody has seen, NaN, is no surface: before it there has to be a plus
    np.argmax(crossed, axis=-1) → crossed.shape[-1] - 1 - np.argmax(crossed[..., ::-1], axis=-1)
    # the first surface hides the others: np.argmax finds the first True
    + (radii[k + 1] - radii[k]) * a / np.maximum(a - b, 1e-9) →
    # the distance is 0 between two radii: a / (a - b) of the way from one to the other
    * a / → * -b /  # a large a is far from the surface, and the way to it is longer: a / (a - b)
""")


def mix(own, fused, other):
    """Inverse depth (H, W): the fused one, but the frame's own where that is better; `other` is
    where grey differs."""
    apart = np.abs(own - fused)
    near = (own > 1 / 8) & (apart < 0.1 * own)
    moved = other & (apart > 0.1 * own)
    return np.where(np.isnan(fused) | near | moved, own, fused)


def _two_depths(rng: Rng, k: int) -> tuple:
    own = rng.uniform(0.02, 0.4, (5, 8 + k % 4))
    fused = own * rng.choice([0.6, 0.905, 0.95, 1.05, 1.105, 1.5], own.shape)
    fused[rng.uniform(0, 1, own.shape) < 0.2] = np.nan
    return own, fused, rng.uniform(0, 1, own.shape) < 0.5


check_mix = Open(mix, _two_depths).with_slips("""
    own > 1 / 8 → own > 8  # own is an inverse depth: nearer than 8 m is more than 1/8
    own > 1 / 8 → own < 1 / 8  # inverse depth grows towards us: nearer than 8 m is more than 1/8
    & (apart < 0.1 * own) →
    # near, but only where both agree: where they do not, the other frames know better
    np.isnan(fused) | →  # where the world has a hole, NaN, the frame keeps its own depth
    other & →
    # a disagreement alone is an error of the depth; what has moved looks otherwise, too: other
""")
