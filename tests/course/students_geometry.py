"""Students of the exercises on lenses, rigs and spheres: what each checker says, and to which answer.

Each list has (words, answer): "right", or words of the hint.
"""

import math

import numpy as np


def metres_per_unit_loops(positions, i, j, measured):
    return measured / math.dist(positions[i].tolist(), positions[j].tolist())


METRES_PER_UNIT = [
    ("right", metres_per_unit_loops),
    ("right", lambda p, i, j, m: np.float32(m / np.sqrt(np.square(p[i] - p[j]).sum()))),
    ("metres in one unit are asked", lambda *a: 1 / metres_per_unit_loops(*a)),
    ("the measured one divided by it", lambda p, i, j, m: math.dist(p[i], p[j])),
    ("from camera to camera", lambda p, i, j, m: m / math.hypot(*p[j])),
    ("from camera i to camera j", lambda p, i, j, m: m / math.hypot(*p[i])),
    ("adds up the components", lambda p, i, j, m: m / sum(abs(p[i] - p[j]))),
    ("divides by the squared distance", lambda p, i, j, m: m / math.dist(p[i], p[j]) ** 2),
    ("not the largest alone", lambda p, i, j, m: m / max(abs(p[i] - p[j]))),
    ("y is missing", lambda p, i, j, m: m / math.dist(p[i][::2], p[j][::2])),
    ("indices from 0", lambda p, i, j, m: metres_per_unit_loops(p, i - 1, j - 1, m)),
    ("millimetres; return the ratio itself", lambda *a: 10.0 ** round(math.log10(metres_per_unit_loops(*a)))),
]


def pose_from_file(M, t_of=lambda R, t: -R.T @ t, R_of=lambda R: R.T, scale=1e-3, rows=4):
    """The inverse by parts, with one of them wrong."""
    R, t, M = M[:3, :3], M[:3, 3], M.copy()
    M[:3, :3], M[:3, 3] = R_of(R), t_of(R, t) * scale
    return M[:rows]


def pose_by_inverse(M):
    M = M.copy()
    M[:3, 3] /= 1000
    return np.linalg.inv(M)


def pose_wrong(**part):
    return lambda M: pose_from_file(M, **part)


POSE_FROM_FILE = [
    ("right", pose_by_inverse),
    ("right", pose_from_file),
    ("that is the file's matrix", lambda M: M),
    ("still in millimetres", np.linalg.inv),
    ("do not multiply", pose_wrong(scale=1e3)),
    ("the unit is right", pose_wrong(R_of=lambda R: R, t_of=lambda R, t: t)),
    ("only the translation has a unit", lambda M: np.linalg.inv(M) / 1000),
    ("only the translation has a unit", lambda M: np.linalg.inv(M / 1000)),
    ("where the rig's origin was", pose_wrong(t_of=lambda R, t: -t)),
    ("the translation untouched", pose_wrong(t_of=lambda R, t: t)),
    ("the sign", pose_wrong(t_of=lambda R, t: R.T @ t)),
    ("turn it by Rᵀ", pose_wrong(t_of=lambda R, t: -R @ t)),
    ("the rotation must be transposed, too", pose_wrong(R_of=lambda R: R)),
    ("both parts", pose_wrong(R_of=lambda R: R, t_of=lambda R, t: -t)),
    ("no inverse", np.transpose),
    ("the last row", pose_wrong(rows=3)),
]


def spheres_by_counting(baseline, nearest, width, pixels):
    """Add spheres until a step is small enough."""
    N = 2
    while baseline / (nearest * (N - 1)) * width / math.tau > pixels:
        N += 1
    return N


def spheres(turn=math.tau, up=math.ceil, more=1, ratio=lambda b, D: b / D, scale=lambda W: W, per=lambda m, x: m / x):
    """Steps between spheres, with one part wrong."""
    return lambda b, D, W, x: up(per(ratio(b, D) * scale(W) / turn, x)) + more


SPHERES_NEEDED = [
    ("right", spheres_by_counting),
    ("right", spheres(up=np.ceil)),
    ("no part of a sphere", spheres(up=float)),
    ("one too few", spheres(up=math.floor)),
    ("two too few", spheres(up=math.floor, more=0)),
    ("that is the steps", spheres(up=float, more=0)),
    ("for one pixel a sphere", spheres(per=lambda moves, x: moves)),
    ("fewer pixels a sphere need more", spheres(per=lambda moves, x: moves * x)),
    ("full circle, 2π, not π", spheres(turn=math.pi)),
    ("in radians, 2π for W pixels", spheres(turn=360)),
    ("near things move more", spheres(ratio=lambda b, D: b * D)),
    ("not the other way round", spheres(ratio=lambda b, D: D / b)),
    ("counts degrees for pixels", spheres(scale=lambda W: 360)),
    ("counts radians for pixels", spheres(scale=lambda W: math.tau)),
]

DISTANCE_FROM_Z = [
    ("right", lambda z, ray: z / math.cos(math.atan2(math.hypot(*ray[:2]), ray[2]))),
    ("right", lambda z, ray: np.linalg.norm(np.float32(z) * np.float32(ray / ray[2]))),
    ("the wrong way round", lambda z, ray: z * math.cos(math.atan2(math.hypot(*ray[:2]), ray[2]))),
    ("divide by its z", lambda z, ray: math.dist(z * ray, (0, 0, 0))),
    ("times the ray's length", lambda z, ray: z / ray[2]),
    ("stretch it", lambda z, ray: math.hypot(ray[0], ray[1], z)),
    ("distance from the axis", lambda z, ray: z * math.tan(math.atan2(math.hypot(*ray[:2]), ray[2]))),
    ("y is missing", lambda z, ray: math.hypot(z * ray[0] / ray[2], z)),
    ("off the axis is longer", lambda z, ray: z),
]
