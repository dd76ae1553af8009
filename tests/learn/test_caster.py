"""The ray caster against closed forms: shapes, holes, shadows, mirrors, and the tree."""

import numpy as np
import pytest

from omnistereo_learn.endless import textures
from omnistereo_learn.endless.caster import BOX, CYLINDER, ELLIPSOID, LIGHT, PRIMITIVE, SOFT, look
from omnistereo_learn.endless.objects import Builder
from omnistereo_learn.endless.worlds import Scene
from omnistereo_lib.geometry.pose import rotation_from_axis_angle

CENTER, HALF = np.array([0.4, -0.3, 3.0]), np.array([0.5, 0.9, 0.7])
R = rotation_from_axis_angle([0.4, -0.7, 0.2])  # object → world


def primitive(shape, center=CENTER, half=HALF, R=R, **fields):
    one = np.zeros(1, PRIMITIVE)
    settings = {"shape": shape, "center": center, "half": half, "rotation": R.T}
    settings |= {"roundness": 1, "ripple": 1.0, "dark": 0.5, "light": 0.5, "scale": 1.0}
    for name, value in (settings | fields).items():
        one[name] = value
    return one


def light(**fields):
    one = np.zeros(1, LIGHT)[0]
    for name, value in fields.items():
        one[name] = value
    return one


def scene(*primitives, **of_light):
    return Scene(np.concatenate(primitives), light(**of_light))


@pytest.fixture
def rays():
    directions = np.random.default_rng(0).normal(size=(4000, 3)) * (0.5, 0.5, 0.2) + (0.1, -0.1, 1)
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def into_object(rays, origin=0):
    return (origin - CENTER) @ R, rays @ R


def nearest_root(a, b, c):
    with np.errstate(invalid="ignore"):
        return (-b - np.sqrt(b * b - a * c)) / a


def sphere(rays):
    o, d = into_object(rays)
    o, d = o / HALF, d / HALF
    return nearest_root((d * d).sum(1), d @ o, o @ o - 1)


def cylinder(rays):
    """The nearest of the points on the mantle and on both lids that lie on the cylinder."""
    o, d = into_object(rays)
    o, d = o / HALF, d / HALF
    mantle = nearest_root(
        d[:, 0] ** 2 + d[:, 2] ** 2, d[:, [0, 2]] @ o[[0, 2]], o[[0, 2]] @ o[[0, 2]] - 1
    )
    found = [np.where(np.abs(o[1] + mantle * d[:, 1]) <= 1, mantle, np.nan)]
    for lid in (-1, 1):
        t = (lid - o[1]) / d[:, 1]
        on_lid = ((o + t[:, None] * d)[:, [0, 2]] ** 2).sum(1) <= 1
        found.append(np.where(on_lid, t, np.nan))
    return np.nanmin(np.where(np.isnan(found), np.inf, found), axis=0)


def box(rays):
    """The nearest of the points on the six faces that lie on the box."""
    o, d = into_object(rays)
    found = []
    for axis in range(3):
        for side in (-1, 1):
            t = (side * HALF[axis] - o[axis]) / d[:, axis]
            inside = (np.abs(o + t[:, None] * d) <= HALF * (1 + 1e-12)) | (np.arange(3) == axis)
            found.append(np.where(inside.all(1) & (t > 0), t, np.inf))
    return np.min(found, axis=0)


@pytest.mark.parametrize(
    "shape, oracle", [(BOX, box), (ELLIPSOID, sphere), (CYLINDER, cylinder), (SOFT, sphere)]
)
def test_distances_are_those_of_the_closed_form(shape, oracle, rays):
    expected = np.nan_to_num(1 / oracle(rays), nan=0)
    found = scene(primitive(shape)).inverse_depth_along(rays)
    hit = (expected > 0) & (found > 0)
    assert 0.05 < hit.mean() < 0.9
    # A ray that only grazes a SOFT may step over it.
    assert ((expected > 0) == (found > 0)).mean() > (0.98 if shape == SOFT else 0.9999)
    assert np.abs(found - expected)[hit].max() < 1e-6


def test_bumps_lie_within_the_box_and_on_their_own_surface(rays):
    fields = {"bump": 0.4, "ripple": (3.0, 5.0, 4.0), "roundness": 3}
    found = scene(primitive(SOFT, **fields)).inverse_depth_along(rays)
    o, d = into_object(rays[found > 0])
    points = (o + d / found[found > 0, None]) / HALF
    size = (points**8).sum(1) ** (1 / 8)
    assert len(points) > 300 and np.abs(points).max() < 1 + 1e-6
    noise = [textures.noise(tuple(p * fields["ripple"]), 0) for p in points]
    assert np.median(np.abs(size - 1 + 0.4 * np.array(noise))) < 1e-4 and np.ptp(size) > 0.15


def test_from_inside_a_room_its_walls_are_seen():
    rays = np.eye(3)
    found = scene(primitive(BOX, (0.2, 0.1, -0.3), (2, 1, 4), np.eye(3))).inverse_depth_along(
        np.vstack([rays, -rays])
    )
    assert np.allclose(1 / found, [2.2, 1.1, 3.7, 1.8, 0.9, 4.3], rtol=1e-6)


def test_holes_show_what_is_behind_them():
    near = primitive(
        BOX, (0, 0, 2), (1, 1, 0.05), np.eye(3), cutout=textures.OPENING, cut=(0.2, 0.1, 0.3, 0.2)
    )
    far = primitive(BOX, (0, 0, 5), (9, 9, 1), np.eye(3))
    points = np.array(
        [(0.2, 0.1, 2), (0.45, 0.27, 2), (0.55, 0.1, 2), (0.2, 0.35, 2), (-0.9, 0.9, 2)]
    )
    found = scene(near, far).inverse_depth_along(
        points / np.linalg.norm(points, axis=1, keepdims=True)
    )
    z = points[:, 2] / np.linalg.norm(points, axis=1) / found
    assert np.allclose(z, [4, 4, 1.95, 1.95, 1.95], atol=1e-3)
    bars = primitive(
        BOX, (0, 0, 2), (1.01, 1, 1e-4), np.eye(3), cutout=textures.BARS, cut=(0.2, 0.05, 0, 0)
    )
    x = np.arange(-0.995, 1, 0.01)
    rays = np.stack([x, 0 * x, np.full(len(x), 2.0)], -1)
    solid = scene(bars).inverse_depth_along(rays / np.linalg.norm(rays, axis=1, keepdims=True)) > 0
    assert 0.2 < solid.mean() < 0.35
    assert abs(np.diff(np.flatnonzero(np.diff(solid.astype(int)) > 0)).mean() - 20) < 0.5


def many(rng, count=60):
    builder = Builder.empty(rng)
    for _ in range(count):
        place = builder.at(rng.uniform(-3, 3, 3), tilt=rng.normal(size=3))
        place.add(rng.integers(3), (0, 0, 0), rng.uniform(0.05, 0.6, 3), {"light": 0.5})
    return builder.primitives


def test_the_tree_finds_what_trying_every_primitive_finds():
    rng = np.random.default_rng(4)
    primitives, rays = many(rng), rng.normal(size=(3000, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    for origin in (np.zeros(3), np.array([2.0, -1, 0.5])):
        together = scene(*primitives).inverse_depth_along(rays, origin)
        one_by_one = np.max(
            [scene(one).inverse_depth_along(rays, origin) for one in primitives], axis=0
        )
        assert np.array_equal(together, one_by_one) and (together > 0).mean() > 0.2


def gray(world, rays):
    """The gray values along unit rays (n, 3) from the origin."""
    out = np.zeros((1, len(rays)), np.float32)
    seen = np.ones(out.shape, bool)
    look(world.primitives, world._tree, world.light, np.zeros(3), rays[None], seen, 1e-4, out)
    return out[0]


def towards(*points):
    points = np.array(points, float)
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def test_light_follows_lamberts_law_and_a_body_throws_a_shadow():
    floor = primitive(BOX, (0, 1.1, 3), (9, 0.1, 9), np.eye(3))
    ball = primitive(ELLIPSOID, (0, 0, 3), (0.3, 0.3, 0.3))
    lit, shaded = gray(
        scene(floor, ball, to_sun=(0, -1, 0), sun=0.8, ambient=0.5), towards((1, 1, 3), (0.1, 1, 3))
    )
    assert abs(lit - 0.5 * (0.5 * 1.0 + 0.8)) < 1e-6 and abs(shaded - 0.5 * 0.5) < 1e-6
    slanted = gray(scene(floor, to_sun=(0.6, -0.8, 0), sun=0.8, ambient=0.5), towards((1, 1, 3)))
    assert abs(slanted[0] - 0.5 * (0.5 + 0.8 * 0.8)) < 1e-6
    lamp = {"lamp": 2.0, "lamp_at": (1, -1, 3), "falloff": 0.25}
    lit, shaded = gray(scene(floor, ball, **lamp), towards((1, 1, 3), (-0.8, 1, 3)))
    assert abs(lit - 0.5 * 2 / (1 + 0.25 * 4)) < 1e-3 and shaded == 0


def test_a_mirror_shows_what_stands_before_it():
    mirror = primitive(BOX, (0, 0, 2.1), (1, 1, 0.1), np.eye(3), mirror=1.0)
    behind = primitive(BOX, (0, 0, -3), (9, 9, 0.1), np.eye(3), dark=0.9, light=0.9)
    world = scene(mirror, behind, ambient=1.0)
    assert abs(gray(world, towards((0.2, 0.1, 2)))[0] - 0.9 * 0.7) < 1e-3
    assert abs(1 / world.inverse_depth_along(towards((0, 0, 1)))[0] - 2) < 1e-6  # its own depth


@pytest.mark.parametrize("texture", range(8))
def test_textures_fade_to_their_mean_under_a_large_pixel(texture):
    wall = primitive(
        BOX, (0, 0, 3), (9, 9, 1), np.eye(3), texture=texture, dark=0.2, light=0.8, scale=2.0
    )
    wall["pattern"] = (0.8, 0.2, 0.3)
    x, y = np.meshgrid(np.linspace(-1, 1, 40), np.linspace(-1, 1, 40))
    world, out = scene(wall, ambient=1 / 0.7), {}
    for pixel in (1e-4, 3.0):
        values = np.zeros(x.shape, np.float32)
        points = np.stack([x, y, np.full(x.shape, 2.0)], -1)
        rays = towards(*points.reshape(-1, 3)).reshape(points.shape)
        seen = world.primitives, world._tree, world.light
        look(*seen, np.zeros(3), rays, np.ones(x.shape, bool), pixel, values)
        out[pixel] = values
    if texture == textures.PLAIN:
        assert np.ptp(out[1e-4]) < 1e-6
        return
    assert np.ptp(out[1e-4]) > 0.1 and 0.19 < out[1e-4].min() < out[1e-4].max() < 0.81
    if texture != textures.FACADE:  # its windows stay apart; streets are never seen from that far
        assert np.ptp(out[3.0]) < 0.02 and abs(out[3.0].mean() - out[1e-4].mean()) < 0.12
