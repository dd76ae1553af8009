"""Students of exercise 10.1: what its checker says, and to which answer.

Each list has (words, answer): "right", or words of the hint.
"""

import math

import numpy as np

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
