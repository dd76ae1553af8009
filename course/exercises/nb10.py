"""Notebook 10: a ray caster (a box, a checker, light and shadow), depth along a ray from z, solid angles of pixels."""

import numpy as np

from course.exercises.compare import Answer, Array, Rng
from course.exercises.opened import Open


def hit_box(origins, rays, low, high):
    """Distances (…) along rays (…, 3) from points (…, 3) or (3,) to a box between two corners (3,); inf for a miss."""
    with np.errstate(divide="ignore"):  # a ray along a face never meets its plane
        to_low, to_high = (low - origins) / rays, (high - origins) / rays
    enters = np.minimum(to_low, to_high).max(axis=-1)  # inside once it is between all three pairs of planes
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
    return (inside if k % 3 == 0 else np.concatenate([outside[:-1], [inside]])), rays, low, high


def _slabs(origins: Array, rays: Array, low: Array, high: Array) -> tuple[Array, Array]:
    with np.errstate(all="ignore"):
        ends = np.stack([(low - origins) / rays, (high - origins) / rays])
    return ends.min(axis=0), ends.max(axis=0)


def _between(enters: Array, leaves: Array) -> Array:
    return np.where((enters <= leaves) & (leaves > 0), np.where(enters > 0, enters, leaves), np.inf)


def _with(ends: Answer) -> Answer:
    """The distance with other ways to enter and leave."""
    return lambda *inputs: _between(*ends(*_slabs(*inputs)))


def _unsorted(origins: Array, rays: Array, low: Array, high: Array) -> Array:
    with np.errstate(all="ignore"):
        return _between(((low - origins) / rays).max(-1), ((high - origins) / rays).min(-1))


def _any_side(*inputs: Array) -> Array:
    near, far = (ends(-1) for ends in (_slabs(*inputs)[0].max, _slabs(*inputs)[1].min))
    return np.where(near <= far, np.where(near > 0, near, far), np.inf)


def _from_outside(*inputs: Array) -> Array:
    near, far = (ends(-1) for ends in (_slabs(*inputs)[0].max, _slabs(*inputs)[1].min))
    return np.where((near <= far) & (far > 0), near, np.inf)


check_hit_box = Open(
    hit_box,
    _rays_and_box,
    [
        (_unsorted, "a ray that runs backwards along an axis meets `high` first: sort each pair of planes"),
        (_with(lambda near, far: (near.min(-1), far.min(-1))), "it is inside after the last of three entries: max"),
        (_with(lambda near, far: (near.max(-1), far.max(-1))), "it is outside after the first of three exits: min"),
        (_with(lambda near, far: (far.min(-1), far.max(-1))), "that is where the ray leaves: it sees where it enters"),
        (lambda o, *rest: hit_box(0 * o, *rest), "the planes are as far as `low - origins`: the origins are missing"),
        (_any_side, "a box behind the origin is not seen: it must leave ahead, at more than 0"),
        (_from_outside, "from inside, the entry lies behind: take the exit"),
        (
            lambda *inputs: np.where(_from_outside(*inputs) > 0, _from_outside(*inputs), np.inf),
            "from inside a box its wall is seen: take the exit",
        ),
        (
            lambda *inputs: np.where(np.isinf(hit_box(*inputs)), np.nan, hit_box(*inputs)),
            "a miss is inf: the box is farther than anything",
        ),
        (lambda *inputs: np.where(np.isinf(hit_box(*inputs)), 0, hit_box(*inputs)), "a miss is inf, not 0: 0 is near"),
        (lambda *inputs: 1 / hit_box(*inputs), "that is the inverse distance"),
    ],
)


def checker(points, size):
    """Gray values (…), 0.8 and 0.2, at points (…, 3): space in cubes of `size` metres, neighbours of different gray."""
    number = np.floor(points / size).sum(axis=-1)  # floor also rounds down below 0
    return np.where(number % 2 == 0, 0.8, 0.2)  # the cube at the origin is bright


def _some_points(rng: Rng, k: int) -> tuple:
    return rng.uniform(-4, 4, (40, 3) if k % 2 else (8, 5, 3)), rng.uniform(0.3, 0.9)


def _gray(number: Array) -> Array:
    return np.where(number % 2 == 0, 0.8, 0.2)


check_checker = Open(
    checker,
    _some_points,
    [
        (lambda p, size: _gray((p / size).astype(int).sum(-1)), "int rounds towards 0, so two cubes meet there: floor"),
        (lambda p, size: _gray(np.rint(p / size).sum(-1)), "the cubes begin at 0: floor, not round"),
        (lambda p, size: checker(p, 1 / size), "divide by the size: larger cubes, fewer of them"),
        (lambda p, size: checker(p, 1.0), "the size is an argument"),
        (lambda p, size: _gray(np.floor((p / size).sum(-1))), "floor each coordinate first, then add"),
        (lambda p, size: _gray(np.floor(p / size)[..., [0, 2]].sum(-1)), "all three coordinates count"),
        (lambda p, size: _gray(np.floor(p / size).prod(-1)), "add the numbers of the cube: a product is mostly even"),
        (lambda p, size: 1 - checker(p, size), "the cube at the origin is bright: 0.8 where the sum is even"),
        (lambda p, size: (checker(p, size) - 0.2) / 0.6, "gray values are 0.8 and 0.2, not 1 and 0"),
        (lambda p, size: _gray(np.floor(p / size)), "one gray value for a point: add its three numbers"),
    ],
)


def light(points, normals, to_sun, boxes):
    """Light (…), 0.4 from the sky and up to 0.8 from the sun, on points and unit normals (…, 3); boxes (n, 2, 3)."""
    slope = np.maximum(normals @ to_sun, 0)  # Lambert: the cosine, and nothing from behind
    above = points + 1e-6 * normals  # so that a face does not shade itself
    free = np.isinf(np.min([hit_box(above, to_sun, *box) for box in boxes], axis=0))
    return 0.4 + 0.8 * slope * free  # the sky, and the sun


def _points_on_boxes(rng: Rng, k: int) -> tuple:
    low = rng.uniform(-3, 2, (4, 3)) * [1, 0.3, 1]
    boxes = np.stack([low, low + rng.uniform(0.5, 2.5, (4, 3))], axis=1)
    boxes[0] = (-9, 2.5, -9), (9, 3, 9)  # the ground, y is down
    number, axis, side = rng.integers([[4], [3], [2]], size=(3, 40 + k))
    points = boxes[number, 0] + rng.uniform(0.05, 0.95, (40 + k, 3)) * np.diff(boxes, axis=1)[number, 0]
    points[range(40 + k), axis] = boxes[number, side, axis]
    normals = np.eye(3)[axis] * (2 * side - 1)[:, None]
    points -= 1e-12 * normals  # where rounding may put them
    ground = np.tile([0.0, -1, 0], (12, 1))
    slanting = rng.normal(0, 1, (8, 3))  # of other shapes, in the air
    normals = np.concatenate([normals, ground, slanting / np.linalg.norm(slanting, axis=1, keepdims=True)])
    points = np.concatenate([points, rng.uniform(-4, 4, (20, 3)) * [1, 0, 1] + [0, 2.5, 0]])
    points[-8:, 1] = -4
    to_sun = np.array([rng.uniform(-0.7, 0.7), -1, rng.uniform(-0.7, 0.7)])
    return points, normals, to_sun / np.linalg.norm(to_sun), boxes


def _free(start: Array, rays: Array, boxes: Array) -> Array:
    return np.isinf(np.min([hit_box(start, rays, *box) for box in boxes], axis=0))


def _lit(change: Answer) -> Answer:
    """The light with another cosine and other shadows, both of the right ones."""

    def changed(points: Array, normals: Array, to_sun: Array, boxes: Array) -> Array:
        return change(normals @ to_sun, _free(points + 1e-6 * normals, to_sun, boxes))

    return changed


check_light = Open(
    light,
    _points_on_boxes,
    [
        (
            _lit(lambda cosine, free: 0.4 + 0.8 * np.maximum(cosine, 0)),
            "a box in the way takes the sun: add shadows",
        ),
        (_lit(lambda cosine, free: 0.4 + 0.8 * cosine * free), "a face turned away gets no sun, and not less: maximum"),
        (_lit(lambda cosine, free: 0.4 + 0.8 * np.abs(cosine) * free), "a face turned away gets no sun: no abs"),
        (_lit(lambda cosine, free: 0.4 + 0.8 * free), "a slanting face gets less sun: times the cosine"),
        (_lit(lambda cosine, free: (0.4 + 0.8 * np.maximum(cosine, 0)) * free), "a shadow is not black: the sky stays"),
        (_lit(lambda cosine, free: 0.8 * np.maximum(cosine, 0) * free), "the light of the sky, 0.4, is missing"),
        (_lit(lambda cosine, free: 0.4 + 0.8 * np.maximum(cosine, 0) * ~free), "light and shadow are swapped"),
        (lambda p, n, sun, boxes: light(p, n, -sun, boxes), "to_sun leads to the sun, and not from it"),
        (
            lambda p, n, sun, boxes: 0.4 + 0.8 * np.maximum(n @ sun, 0) * _free(p, sun, boxes),
            "a face may shade itself: start a millionth of a metre above it",
        ),
        (
            lambda p, n, sun, boxes: 0.4 + 0.8 * np.maximum(n @ sun, 0) * _free(p + 1e-6 * n, n, boxes),
            "the shadow is cast along the way to the sun, not along the normal",
        ),
        (lambda p, n, sun, boxes: light(p, n, sun, boxes[:1]), "any box may be in the way, not the first only"),
    ],
)


def distances_from_z(z, rays):
    """Distances (…) along rays (…, 3) of any length, from depths z (…) along the axis, which is the z of the rays."""
    return z * np.linalg.norm(rays, axis=-1) / rays[..., 2]


def _depths(rng: Rng, k: int) -> tuple:
    rays = rng.uniform([-1.5, -1, 0.5], [1.5, 1, 2], (3, 4 + k % 3, 3))
    return rng.uniform(2, 9, rays.shape[:2]), rays


check_distances_from_z = Open(
    distances_from_z,
    _depths,
    [
        (lambda z, rays: z**2 / distances_from_z(z, rays), "the wrong way round: the ray is longer than its z"),
        (lambda z, rays: z * np.linalg.norm(rays, axis=-1), "the rays do not end at z = 1: divide by their z"),
        (lambda z, rays: z / rays[..., 2], "that many rays long it is: times the ray's length gives metres"),
        (lambda z, rays: np.hypot(z, np.linalg.norm(rays[..., :2], axis=-1)), "stretch x and y to the depth first"),
        (
            lambda z, rays: z * np.linalg.norm(rays[..., :2], axis=-1) / rays[..., 2],
            "that is the distance from the axis: z counts as well",
        ),
        (
            lambda z, rays: z * np.hypot(rays[..., 0], rays[..., 2]) / rays[..., 2],
            "y is missing: a ray goes up or down as well",
        ),
        (lambda z, rays: z, "z is the part along the axis: the ray to a point off the axis is longer"),
        (lambda z, rays: z / rays[..., 2] * np.linalg.norm(rays), "one length for each ray: axis=-1"),
        (lambda z, rays: (z / rays[..., 2])[..., None] * rays, "those are the points: how long is the way to them?"),
    ],
)


def solid_angles(width, height, phi_deg):
    """Solid angles (height, width) in steradians of the pixels of a panorama with edges at elevations phi_deg."""
    low, high = np.radians(phi_deg)
    edges = np.linspace(low, high, height + 1)  # of the rows
    bands = 2 * np.pi * np.diff(np.sin(edges))  # the area of the unit sphere between two elevations
    return np.tile(bands[:, None] / width, width)


def _a_panorama(rng: Rng, k: int) -> tuple:
    return int(rng.integers(5, 12)), int(rng.integers(3, 8)), (float(rng.uniform(-85, -20)), float(rng.uniform(10, 70)))


def _bands(width: int, height: int, phi_deg: tuple, area: Answer) -> Array:
    edges = np.linspace(*np.radians(phi_deg), height + 1)
    return np.tile(2 * np.pi / width * area(edges)[:, None], width)


check_solid_angles = Open(
    solid_angles,
    _a_panorama,
    [
        (
            lambda W, H, phi: _bands(W, H, phi, np.diff),
            "a row near a pole is short: its area goes with cos φ, or with the difference of sin φ",
        ),
        (
            lambda W, H, phi: _bands(W, H, phi, lambda e: np.cos((e[1:] + e[:-1]) / 2)),
            "that is the cosine: the height of a row in radians is missing",
        ),
        (lambda W, H, phi: _bands(W, H, phi, lambda e: np.diff(np.cos(e))), "sin φ at the edges, not cos φ"),
        (
            lambda W, H, phi: _bands(W, H, np.degrees(phi), lambda e: np.diff(np.sin(e))),
            "phi_deg is in degrees: NumPy wants radians",
        ),
        (lambda W, H, phi: W * solid_angles(W, H, phi), "that is the area of whole rows: divide by the columns"),
        (
            lambda W, H, phi: solid_angles(W, H, phi) / solid_angles(W, H, phi).sum(),
            "those are shares of the panorama: in steradians, all the sphere is 4π",
        ),
        (lambda W, H, phi: solid_angles(W, H, phi) / (4 * np.pi), "those are shares of the sphere, which has 4π"),
        (lambda W, H, phi: solid_angles(W, H, phi) / (2 * np.pi), "once around is 2π: it is missing"),
        (lambda W, H, phi: solid_angles(W, H, (-90, 90)), "the rows run from phi_deg's first to its second"),
        (lambda W, H, phi: solid_angles(W, H, phi)[:, 0], "one value for each pixel (height, width), not for each row"),
        (lambda W, H, phi: solid_angles(W, H, phi).T, "rows first: (height, width)"),
    ],
)
