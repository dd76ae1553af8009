"""A ray caster for scenes of simple shapes: gray images and exact depth, without a file.

A scene is an array of primitives, each a shape in a frame of its own with a surface, and a record
of its light. Rays find the first primitive along a tree of boxes. They see texture, a sun with
shadows, a lamp with shadows, a sky, and one reflection. The depth along any ray is the same
intersection, so the ground truth is exact at any size.

Frames as everywhere: y is down, lengths are metres.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omnistereo_learn.endless.textures import (
    FACADE,
    SOLID,
    Vector,
    albedo,
    clouds,
    is_hole,
    mix,
    noise,
    pane,
    ramp,
    surface_coordinates,
)
from omnistereo_lib.stereo.kernels.compiled import compiled

# a cylinder stands along its y axis; SOFT: a rounded, bumpy box or ellipsoid
BOX, ELLIPSOID, CYLINDER, SOFT = range(4)

PRIMITIVE = np.dtype(
    [
        ("shape", np.int64),
        ("rotation", np.float64, (3, 3)),  # world → object
        ("center", np.float64, (3,)),
        ("half", np.float64, (3,)),  # half sizes
        ("roundness", np.int64),  # of SOFT: 1 an ellipsoid, 2 and 3 nearer to a box
        # of SOFT: depth of the bumps as a fraction of the half sizes, below 0.5
        ("bump", np.float64),
        ("ripple", np.float64, (3,)),  # of SOFT: bumps across the object along each axis
        ("cutout", np.int64),
        ("cut", np.float64, (4,)),
        ("texture", np.int64),
        ("dark", np.float64),  # gray values between which the texture lies
        ("light", np.float64),
        ("scale", np.float64),  # 1/m
        ("pattern", np.float64, (3,)),
        ("dirt", np.float64),
        ("dirt_scale", np.float64),
        # reflectance at normal incidence: 0.04 varnish, 0.9 a mirror; 0: dull
        ("mirror", np.float64),
        ("glow", np.float64),  # light of its own
        ("seed", np.int64),
    ]
)
LIGHT = np.dtype(
    [
        ("to_sun", np.float64, (3,)),
        ("sun", np.float64),
        ("ambient", np.float64),
        ("lamp_at", np.float64, (3,)),
        ("lamp", np.float64),
        ("falloff", np.float64),  # 1/m²
        ("zenith", np.float64),
        ("horizon", np.float64),
        ("cloudiness", np.float64),
        ("seed", np.int64),
    ]
)
Tree = tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]

# In metres: hits closer to the start of a ray are its own surface.
_NEAREST = 1e-4
# Steps along a ray through a SOFT, at most.
_MARCHES = 48
_compiled = compiled(
    error_model="numpy", nogil=True, fastmath={"nnan", "nsz", "arcp", "contract", "reassoc"}
)


@_compiled
def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@_compiled
def _point(o: Vector, d: Vector, t: float) -> Vector:
    return o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2]


@_compiled
def _unit(a: Vector) -> Vector:
    s = 1 / math.sqrt(_dot(a, a) + 1e-30)
    return a[0] * s, a[1] * s, a[2] * s


@_compiled
def _rotate(R: Any, a: Vector) -> Vector:
    return (
        R[0, 0] * a[0] + R[0, 1] * a[1] + R[0, 2] * a[2],
        R[1, 0] * a[0] + R[1, 1] * a[1] + R[1, 2] * a[2],
        R[2, 0] * a[0] + R[2, 1] * a[1] + R[2, 2] * a[2],
    )


@_compiled
def _to_object(p: Any, o: Vector, d: Vector) -> tuple[Vector, Vector]:
    """Return a ray in the frame of a primitive, no component of its direction 0: all may divide."""
    c = p.center
    o = _rotate(p.rotation, (o[0] - c[0], o[1] - c[1], o[2] - c[2]))
    x, y, z = _rotate(p.rotation, d)
    tiny = 1e-12
    return o, (
        x if abs(x) > tiny else tiny,
        y if abs(y) > tiny else tiny,
        z if abs(z) > tiny else tiny,
    )


@_compiled
def _box(half: Any, o: Vector, d: Vector) -> tuple[float, float]:
    """Return where a ray enters and leaves a box; it misses where the first is larger."""
    # The slab method (Kay and Kajiya 1986): along each axis a ray is between two planes in an
    # interval, and it is inside the box where all three intervals overlap.
    enters, leaves = -np.inf, np.inf
    for k in range(3):
        middle, reach = -o[k] / d[k], half[k] / abs(d[k])
        enters, leaves = max(enters, middle - reach), min(leaves, middle + reach)
    return enters, leaves


@_compiled
def _quadratic(a: float, b: float, c: float) -> tuple[float, float]:
    """Return the roots of a t² + 2 b t + c, or an empty interval."""
    # t = (-b ± √(b² - a c)) / a
    D = b * b - a * c
    if D < 0:
        return np.inf, -np.inf
    root = math.sqrt(D)
    return (-b - root) / a, (-b + root) / a


@_compiled
def _depth_in_soft(p: Any, x: Vector) -> float:
    """Return how far a point is outside of a SOFT, as a fraction of its half sizes."""
    # A superellipsoid: (|x|ⁿ + |y|ⁿ + |z|ⁿ)^(1/n) - 1 with n = 2^roundness, by squares and square
    # roots.
    a, b, c = (x[0] / p.half[0]) ** 2, (x[1] / p.half[1]) ** 2, (x[2] / p.half[2]) ** 2
    for _ in range(p.roundness - 1):
        a, b, c = a * a, b * b, c * c
    size = a + b + c
    for _ in range(p.roundness):
        size = math.sqrt(size)
    # Bumps only cut into the smooth shape: outside of it, its own depth will do.
    if p.bump == 0 or size > 1.001:
        return size - 1
    k = p.ripple
    return (
        size
        - 1
        + p.bump
        * noise((k[0] * x[0] / p.half[0], k[1] * x[1] / p.half[1], k[2] * x[2] / p.half[2]), p.seed)
    )


@_compiled
def _march(p: Any, o: Vector, d: Vector, enters: float, leaves: float) -> float:
    """Return where a ray meets a SOFT from outside, or infinity: safe steps, then bisection."""
    # How far outside a point is, over how fast that can change along the ray, is a step that the
    # bumps allow. The least step limits how often a ray steps.
    shortest = min(p.half[0], p.half[1], p.half[2])
    steepness = 1 + p.bump * max(p.ripple[0], p.ripple[1], p.ripple[2])
    least = (leaves - enters) / _MARCHES
    t, before = enters, enters
    while t < leaves:
        outside = _depth_in_soft(p, _point(o, d, t))
        if outside < 0:
            # The surface lies between the last two points: halve twenty times.
            for _ in range(20):
                middle = 0.5 * (before + t)
                if _depth_in_soft(p, _point(o, d, middle)) < 0:
                    t = middle
                else:
                    before = middle
            return t
        before = t
        t += max(shortest * outside / steepness, least)
    return np.inf


@_compiled
def _normal(p: Any, x: Vector) -> Vector:
    """Return the outward normal of a primitive at a point of its surface, in its own frame."""
    a, b, c = x[0] / p.half[0], x[1] / p.half[1], x[2] / p.half[2]
    if p.shape == BOX:
        if abs(a) > abs(b) and abs(a) > abs(c):
            return math.copysign(1.0, a), 0.0, 0.0
        return (
            (0.0, math.copysign(1.0, b), 0.0)
            if abs(b) > abs(c)
            else (0.0, 0.0, math.copysign(1.0, c))
        )
    if p.shape == CYLINDER:
        if b * b > a * a + c * c:
            return 0.0, math.copysign(1.0, b), 0.0
        return _unit((a / p.half[0], 0.0, c / p.half[2]))
    if p.shape == ELLIPSOID:
        return _unit((a / p.half[0], b / p.half[1], c / p.half[2]))
    # The gradient of the depth, by forward differences.
    e, here = 1e-4 * min(p.half[0], p.half[1], p.half[2]), _depth_in_soft(p, x)
    a = _depth_in_soft(p, (x[0] + e, x[1], x[2])) - here
    b = _depth_in_soft(p, (x[0], x[1] + e, x[2])) - here
    return _unit((a, b, _depth_in_soft(p, (x[0], x[1], x[2] + e)) - here))


@_compiled
def _hit(p: Any, o: Vector, d: Vector, farthest: float) -> float:
    """Return the distance along a ray to a primitive, or infinity beyond `farthest`."""
    # In the frame of the primitive a box is aligned with the axes; an ellipsoid and a cylinder
    # become round once all lengths are divided by the half sizes:
    #     |o + t d|² = 1,   and for the cylinder the same in x and z, cut off where |y| = 1
    o, d = _to_object(p, o, d)
    h = p.half
    if p.shape == BOX or p.shape == SOFT:
        enters, leaves = _box(h, o, d)
    else:
        at, along = (o[0] / h[0], o[1] / h[1], o[2] / h[2]), (d[0] / h[0], d[1] / h[1], d[2] / h[2])
        if p.shape == ELLIPSOID:
            enters, leaves = _quadratic(_dot(along, along), _dot(at, along), _dot(at, at) - 1)
        else:
            a, b = along[0] ** 2 + along[2] ** 2, at[0] * along[0] + at[2] * along[2]
            enters, leaves = _quadratic(a, b, at[0] ** 2 + at[2] ** 2 - 1)
            middle, reach = -at[1] / along[1], 1 / abs(along[1])
            enters, leaves = max(enters, middle - reach), min(leaves, middle + reach)
    if not (enters <= leaves and leaves > _NEAREST and enters < farthest):
        return np.inf
    if p.shape == SOFT:
        return _march(p, o, d, max(enters, _NEAREST), min(leaves, farthest))
    # The near side first. A hole in the cutout lets the ray through to the far side.
    for t in (enters, leaves):
        if _NEAREST < t < farthest:
            x = _point(o, d, t)
            if p.cutout == SOLID or not is_hole(p, x, _normal(p, x)):
                return t
    return np.inf


@_compiled
def _first(
    prims: Any, tree: Any, o: Vector, d: Vector, farthest: float, any_will_do: bool
) -> tuple[float, int]:
    """Return distance and number of the first primitive along a ray, or of any; -1: none."""
    bounds, skip, leaf = tree
    tiny = 1e-12
    # One over the direction turns the divisions of every box into products.
    x = 1 / (d[0] if abs(d[0]) > tiny else tiny)
    y = 1 / (d[1] if abs(d[1]) > tiny else tiny)
    z = 1 / (d[2] if abs(d[2]) > tiny else tiny)
    best, number, node = farthest, -1, 0
    while node < len(skip):
        # Where the ray misses the box of a node, or enters it behind the best hit so far,
        # everything in it is skipped. Otherwise the next node is its first child, or the primitive
        # of a leaf is tried.
        b = bounds[node]
        x0, x1, y0, y1 = (b[0] - o[0]) * x, (b[3] - o[0]) * x, (b[1] - o[1]) * y, (b[4] - o[1]) * y
        z0, z1 = (b[2] - o[2]) * z, (b[5] - o[2]) * z
        enters = max(min(x0, x1), min(y0, y1), min(z0, z1))
        leaves = min(max(x0, x1), max(y0, y1), max(z0, z1))
        if enters > leaves or leaves < 0 or enters > best:
            node = skip[node]
            continue
        if leaf[node] >= 0:
            t = _hit(prims[leaf[node]], o, d, best)
            if t < best:
                best, number = t, leaf[node]
                if any_will_do:
                    break
        node += 1
    return best, number


@_compiled
def _sky(d: Vector, light: Any) -> float:
    up = -d[1]
    value = mix(light.horizon, light.zenith, ramp(-0.1, 0.8, up))
    if light.cloudiness > 0:
        # A flat layer of clouds, seen in perspective: the same noise gets denser towards the
        # horizon.
        s = 1.5 / (0.15 + abs(up))
        value = mix(
            value,
            0.95,
            light.cloudiness
            * ramp(0.45, 0.75, clouds((d[0] * s, 0.0, d[2] * s), 0.01, 0.55, light.seed)),
        )
    return value


@_compiled
def _lit(prims: Any, tree: Any, light: Any, x: Vector, normal: Vector) -> float:
    """Return the light that reaches a point of a surface, of ambience, sun and lamp."""
    # Ambient light comes more from above (y is down). Sun and lamp add their light times the cosine
    # between it and the normal (Lambert), where nothing stands in the way; the lamp fades with
    # distance.
    total = light.ambient * (0.7 - 0.3 * normal[1])
    sun = (light.to_sun[0], light.to_sun[1], light.to_sun[2])
    slope = _dot(normal, sun)
    if light.sun > 0 and slope > 0 and _first(prims, tree, x, sun, 1e6, True)[1] < 0:
        total += light.sun * slope
    if light.lamp > 0:
        to_lamp = (light.lamp_at[0] - x[0], light.lamp_at[1] - x[1], light.lamp_at[2] - x[2])
        distance = math.sqrt(_dot(to_lamp, to_lamp)) + 1e-9
        to_lamp = (to_lamp[0] / distance, to_lamp[1] / distance, to_lamp[2] / distance)
        slope = _dot(normal, to_lamp)
        if slope > 0 and _first(prims, tree, x, to_lamp, distance, True)[1] < 0:
            total += light.lamp * slope / (1 + light.falloff * distance * distance)
    return total


@_compiled
def _surface(p: Any, o: Vector, d: Vector, t: float, pixel: float) -> tuple[float, float, Vector]:
    """Return gray value, reflectance and normal, against the ray, where it meets a primitive."""
    at, along = _to_object(p, o, d)
    x = _point(at, along, t)
    normal = _normal(p, x)
    facing = _dot(normal, along)
    # How wide a pixel is on the surface, wider where it is seen flat: detail finer than that is
    # left out.
    foot = t * pixel / (0.15 + abs(facing))
    value, mirror = albedo(p, x, normal, foot), p.mirror
    if p.texture == FACADE:  # panes reflect, walls do not
        u, v, _ = surface_coordinates((x[0] * p.scale, x[1] * p.scale, x[2] * p.scale), normal)
        mirror *= pane(u, v, foot * p.scale, p.pattern)
    if facing > 0:
        normal = (-normal[0], -normal[1], -normal[2])
    return value, mirror, _rotate(p.rotation.T, normal)


@_compiled
def _look(
    prims: Any, tree: Any, light: Any, o: Vector, d: Vector, pixel: float
) -> tuple[float, float, int]:
    """Return the gray value along a unit ray, its inverse distance (0: sky), and the primitive."""
    t, number = _first(prims, tree, o, d, np.inf, False)
    if number < 0:
        return _sky(d, light), 0.0, -1
    p = prims[number]
    value, mirror, normal = _surface(p, o, d, t, pixel)
    # Shadow rays begin a little before the surface, or it would shade itself.
    x = _point(_point(o, d, t), normal, 1e-3 * (1 + 0.05 * t))
    gray = value * _lit(prims, tree, light, x, normal) + p.glow
    if mirror > 0:
        facing = min(max(-_dot(normal, d), 0.0), 1.0)
        # Schlick (1994): reflectance rises to 1 at grazing angles, R = R₀ + (1 - R₀) (1 - cos)⁵.
        # One reflection is followed; what it meets is lit, but does not reflect again.
        mirror += (1 - mirror) * (1 - facing) ** 5
        reflected = _point(d, normal, 2 * facing)
        far, other = _first(prims, tree, x, reflected, np.inf, False)
        if other < 0:
            seen = _sky(reflected, light)
        else:
            seen, _, normal = _surface(prims[other], x, reflected, far, pixel * (1 + t / far))
            behind = _point(_point(x, reflected, far), normal, 1e-3 * (1 + 0.05 * far))
            seen = seen * _lit(prims, tree, light, behind, normal) + prims[other].glow
        gray = mix(gray, seen, min(mirror, 1.0))
    return gray, 1 / t, number


@_compiled
def look(
    prims: Any, tree: Any, light: Any, origin: Any, rays: Any, visible: Any, pixel: float, gray: Any
) -> None:
    """Write the image of a camera; where an edge crosses a pixel, the mean of three rays.

    Args:
        origin, rays: Shapes (3,) and (h, w, 3), unit vectors where visible, world frame.
        visible: Bool (h, w); other pixels stay as they are.
        pixel: Angle between two rays, radians.
        gray: Output, float32 (h, w); 1 is white, brighter values are possible.
    """
    h, w = visible.shape
    o = (origin[0], origin[1], origin[2])
    number, inverse = np.full((h, w), -1), np.zeros((h, w))
    for y in range(h):
        for x in range(w):
            if visible[y, x]:
                d = (rays[y, x, 0], rays[y, x, 1], rays[y, x, 2])
                gray[y, x], inverse[y, x], number[y, x] = _look(prims, tree, light, o, d, pixel)
    for y in range(1, h - 1):
        for x in range(1, w - 1):
            # An edge crosses a pixel if its neighbours are another primitive, or much nearer or
            # farther.
            seen, same, near, far = True, True, np.inf, 0.0
            for v, u in ((y, x), (y - 1, x), (y + 1, x), (y, x - 1), (y, x + 1)):
                seen, same = seen and visible[v, u], same and number[v, u] == number[y, x]
                near, far = min(near, inverse[v, u]), max(far, inverse[v, u])
            if not seen or (same and far < 1.3 * near):
                continue
            across, down = rays[y, x + 1] - rays[y, x - 1], rays[y + 1, x] - rays[y - 1, x]
            # Two more rays, a third of a pixel before and behind along the diagonal: the neighbours
            # are two pixels apart, of which a sixth is a third of one.
            for step in (-1 / 6, 1 / 6):
                to = rays[y, x] + step * (across + down)
                d = _unit((to[0], to[1], to[2]))
                gray[y, x] += _look(prims, tree, light, o, d, 0.5 * pixel)[0]
            gray[y, x] /= 3


@_compiled
def inverse_distances(prims: Any, tree: Any, origin: Any, rays: Any, out: Any) -> None:
    """Write the inverse distance, 1/m, along unit rays (n, 3) from a point; 0: sky."""
    o = (origin[0], origin[1], origin[2])
    for k in range(len(rays)):
        t, number = _first(prims, tree, o, (rays[k, 0], rays[k, 1], rays[k, 2]), np.inf, False)
        out[k] = 1 / t if number >= 0 else 0.0


def build_tree(prims: NDArray[Any]) -> Tree:
    """Sort primitives into a tree of boxes, in the order that rays from near the origin visit.

    Returns:
        bounds: (nodes, 6), lower and upper corner of the box of each node, world frame
        skip: (nodes,), the node to go on with where a ray misses the box; otherwise the next one
        leaf: (nodes,), the primitive of a node, -1 where it has none of its own
    """
    # The box around a rotated primitive: |Rᵀ| times its half sizes.
    reach = np.einsum("nji,nj->ni", np.abs(prims["rotation"]), prims["half"]) + 1e-9
    low, high = prims["center"] - reach, prims["center"] + reach
    bounds: list[NDArray[np.float64]] = []
    skip: list[int] = []
    leaf: list[int] = []

    def add(numbers: NDArray[Any]) -> None:
        node = len(bounds)
        bounds.append(np.concatenate([low[numbers].min(0), high[numbers].max(0)]))
        skip.append(0)
        leaf.append(numbers[0] if len(numbers) == 1 else -1)
        if len(numbers) > 1:
            # Sort along the axis on which the centres spread most, cut where it is cheapest, and
            # visit the part first that is nearer to the origin, since the cameras are there.
            middle = prims["center"][numbers]
            order = numbers[np.argsort(middle[:, np.argmax(np.ptp(middle, axis=0))], kind="stable")]
            cut = _best_cut(low[order], high[order])
            for part in sorted(
                (order[:cut], order[cut:]),
                key=lambda part: _distance(low[part].min(0), high[part].max(0)),
            ):
                add(part)
        skip[node] = len(bounds)

    add(np.arange(len(prims)))
    return np.array(bounds), np.array(skip), np.array(leaf)


def _best_cut(low: NDArray[Any], high: NDArray[Any]) -> int:
    """Return how many of a row of boxes (n, 3) go to the first of two parts.

    A ray meets a part with a probability in proportion to its area, and may have to try each box.
    """
    # The surface area heuristic (MacDonald and Booth 1990): area times number of boxes, for both
    # parts.
    costs = np.zeros(len(low) - 1)
    for step in (1, -1):
        sides = np.maximum.accumulate(high[::step])[:-1] - np.minimum.accumulate(low[::step])[:-1]
        costs[::step] += (sides * sides[:, [1, 2, 0]]).sum(1) * np.arange(1, len(low))
    return int(np.argmin(costs)) + 1


def _distance(low: NDArray[Any], high: NDArray[Any]) -> float:
    """Return the distance from the origin to a box with sides along the axes."""
    return float(np.linalg.norm(np.maximum(np.maximum(low, -high), 0)))
