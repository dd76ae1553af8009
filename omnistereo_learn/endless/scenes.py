"""Random scenes: rooms, streets, and things in the air, each of 50 to 700 simple shapes.

A scene is there to be matched, not to be lived in: variety of depths, outlines, textures and light
helps a network more than likeness does. Rooms and streets are built with the floor at y = 0, up is
-y, and moved so that the rig is at the origin. Each function returns the builder, the light, and a
radius in metres for the rig.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from omnistereo_learn.endless import objects
from omnistereo_learn.endless import textures as tx
from omnistereo_learn.endless.caster import BOX, CYLINDER, ELLIPSOID, LIGHT, SOFT
from omnistereo_learn.endless.objects import Builder, any_yaw, log_uniform, plain, surface
from omnistereo_lib.geometry.pose import rotation_from_axis_angle

Drawn = tuple[Builder, NDArray[Any], float]


def _around(rng: Generator, position: ArrayLike) -> Builder:
    """Return the builder of a place in which the rig is at a position, in any direction."""
    yaw = any_yaw(rng)
    return Builder.empty(rng).at(
        -rotation_from_axis_angle([0, yaw, 0]) @ np.asarray(position, float), yaw
    )


def _sun_and_sky(rng: Generator) -> NDArray[Any]:
    """Draw light without a lamp."""
    light = np.zeros(1, LIGHT)[0]
    height, azimuth = np.radians(rng.uniform(8, 75)), any_yaw(rng)
    light["to_sun"] = (
        math.cos(height) * math.cos(azimuth),
        -math.sin(height),
        math.cos(height) * math.sin(azimuth),
    )
    light["sun"] = rng.uniform(0.3, 1.2) if rng.random() < 0.65 else 0.0
    light["ambient"] = rng.uniform(0.3, 0.8)
    light["falloff"] = 0.1
    light["seed"] = rng.integers(1 << 30)
    light["zenith"], light["horizon"] = rng.uniform(0.35, 0.95, 2)
    light["cloudiness"] = rng.choice([0, 1, rng.random()])
    return light


def room(rng: Generator) -> Drawn:
    """Draw a room or a corridor, furnished, with the rig anywhere in it."""
    u = rng.uniform
    X, Z, H = log_uniform(rng, 1.1, 7), log_uniform(rng, 1.1, 6), u(2.2, 4.6)
    if rng.random() < 0.2:  # a corridor
        X, Z = u(0.8, 1.4), u(4, 15)
    b = _around(
        rng, (u(-0.7, 0.7) * (X - 0.4), -u(0.4, min(1.8, H - 0.5)), u(-0.7, 0.7) * (Z - 0.4))
    )
    b.add(BOX, (0, 0.05, 0), (X + 2, 0.05, Z + 2), surface(rng, 3.0, blank=0.15))
    ceiling = surface(rng, 3.0, blank=0.7, dark=u(0.5, 0.95))
    b.add(BOX, (0, -H - 0.05, 0), (X + 0.1, 0.05, Z + 0.1), ceiling)
    # distance, half length, yaw
    walls = [(X, Z, 0.5 * np.pi), (X, Z, -0.5 * np.pi), (Z, X, 0.0), (Z, X, np.pi)]
    if rng.random() < 0.15:  # a curved wall in place of three, seen from inside
        half = math.hypot(X, 0.6 * Z), 2 * H, math.hypot(Z, 0.6 * X)
        b.add(CYLINDER, (0, -H / 2, 0), half, surface(rng, 3.0, blank=0.5))
        walls = walls[:1]
    for distance, half_length, yaw in walls:
        _wall(b.at((0, 0, 0), yaw).at((0, 0, distance)), half_length, H)
    for _ in range(rng.integers(2, 5 + int(min(4 * X * Z, 26)))):
        yaw = rng.choice([any_yaw(rng), 0, np.pi / 2, np.pi])
        objects.furniture(b.at((u(-0.92, 0.92) * X, 0, u(-0.92, 0.92) * Z), yaw))
    for _ in range(rng.integers(0, 4)):  # pillars and pipes
        x, z = u(-0.92, 0.92) * X, u(-0.92, 0.92) * Z
        b.rod((x, 0, z), (x, -H, z), log_uniform(rng, 0.015, 0.25), surface(rng, 0.8))
    for _ in range(rng.integers(0, 4)):  # lamps and cables under the ceiling
        y, size = u(0.05, 0.5) - H, u(0.05, 0.5, 3) * (1, 0.2, 1)
        place = u(-0.9, 0.9) * X, y, u(-0.9, 0.9) * Z
        b.add(BOX, place, size, surface(rng, 0.5), glow=rng.choice([0, 0.6]))
        b.wire((-X, y, u(-1, 1) * Z), (X, y, u(-1, 1) * Z), u(0, 0.3), u(0.005, 0.02))
    if rng.random() < 0.4:
        _view_from_windows(b, X + Z)
    light = _sun_and_sky(rng)
    light["sun"] *= rng.random() < 0.5
    light["ambient"], light["falloff"] = u(0.15, 0.7), u(0.02, 0.3)
    light["lamp"] = u(0.3, 1.5) if rng.random() < 0.75 else 0.0
    light["lamp_at"] = b.R @ np.array([u(-0.6, 0.6) * X, 0.3 - H, u(-0.6, 0.6) * Z]) + b.t
    return b, light, log_uniform(rng, 0.03, 0.35)


def _wall(b: Builder, half: float, H: float) -> None:
    """Add a wall along x at z = 0, the room at z < 0, and what hangs on it; some are open."""
    rng, u = b.rng, b.rng.uniform
    if rng.random() < 0.05:
        return
    window = {}
    if rng.random() < 0.35:
        w, h = u(0.3, min(1.2, half)), u(0.4, 0.38 * H)
        window = {"cutout": tx.OPENING, "cut": (u(-1, 1) * (half - w), u(-0.3, 0.1), w, h)}
    skin = surface(rng, 3.0, blank=0.6)
    b.add(BOX, (0, -H / 2, 0.05), (half + 0.1, H / 2 + 0.05, 0.05), skin, **window)
    for _ in range(rng.integers(0, 5)):
        x, y, w, h = u(-0.9, 0.9) * half, -u(0.35, 0.8) * H, u(0.1, 0.8), u(0.1, 0.6)
        kind = rng.choice(
            ["picture", "mirror", "screen", "door", "curtain", "box"],
            p=[0.5, 0.08, 0.08, 0.1, 0.12, 0.12],
        )
        if kind == "picture":
            b.add(BOX, (x, y, 0), (w, h, u(0.01, 0.05)), surface(rng, 0.6, blank=0.1))
        elif kind == "mirror":
            b.add(BOX, (x, y, 0), (w, h, 0.015), plain(0.1, mirror=u(0.5, 0.95)))
        elif kind == "screen":
            objects.screen(b.at((x, y, -0.06)))
        elif kind == "door":
            b.add(BOX, (x, -1.0, 0), (0.45, 1.0, 0.03), surface(rng, 1.0, blank=0.5))
        elif kind == "curtain":
            skin = surface(rng, 1.0, roundness=3, bump=0.3, ripple=(u(4, 16) * w, 0.3, 0.5))
            b.add(SOFT, (x, -H / 2, -0.1), (w, 0.48 * H, 0.1), skin)
        else:
            b.add(BOX, (x, y, -0.1), (w, h, u(0.1, 0.2)), surface(rng, 0.8))


def _view_from_windows(b: Builder, distance: float) -> None:
    """Add ground, trees and houses outside of a room."""
    rng, u = b.rng, b.rng.uniform
    drop = rng.choice([0.15, u(2, 20)])
    b.add(BOX, (0, drop + 0.1, 0), (150, 0.1, 150), surface(rng, 5.0, blank=0.1))
    for _ in range(rng.integers(2, 14)):
        yaw, away = any_yaw(rng), distance + log_uniform(rng, 3, 80)
        place = b.at((away * math.sin(yaw), drop, away * math.cos(yaw)), yaw)
        if rng.random() < 0.5:
            objects.tree(place)
        else:
            place.add(BOX, (0, -5, 0), u(3, 10, 3), surface(rng, 3.0, tx.FACADE))


def street(rng: Generator) -> Drawn:
    """Draw a street with houses, cars, trees, poles and people, with the rig on the road."""
    u = rng.uniform
    width = u(3.5, 12)
    side = u(-0.5, 0.5) * width
    b = _around(rng, (side, -u(0.8, 2.6), 0))
    asphalt = surface(rng, 1.5, tx.CLOUDS, dark=u(0.1, 0.4), light=u(0.2, 0.5))
    b.add(BOX, (0, 0.1, 0), (300, 0.1, 300), asphalt)
    for z in np.arange(-72.0, 72, 6):
        b.add(BOX, (0, 0, z), (0.08, 0.004, 1.5), plain(0.8))
    for yaw in (0, np.pi):
        side_of_street = b.at((0, 0, 0), yaw)
        side_of_street.add(BOX, (width + 4, 0, 0), (4, 0.12, 200), surface(rng, 1.0, tx.BRICKS))
        z = -120.0
        while z < 120:
            length = u(5, 25)
            if rng.random() < 0.85:
                objects.facade(
                    side_of_street.at((width + u(2.5, 5), 0, z)), length, log_uniform(rng, 3, 30)
                )
            z += length
    for _ in range(rng.integers(3, 20)):
        x, z = rng.choice([-1, 1]) * u(0.4, 0.95) * width, 20 * rng.normal()
        if abs(z) > 5 or abs(x - side) > 2.6:
            objects.car(b.at((x, 0, z), 0.05 * rng.normal()))
    for _ in range(rng.integers(8, 40)):
        x, z = rng.choice([-1, 1]) * (width + u(0.2, 2.5)), 25 * rng.normal()
        objects.street_furniture(
            b.at((x, -0.12, z), rng.choice([0, np.pi / 2, np.pi, any_yaw(rng)]))
        )
    if rng.random() < 0.3:
        fence = b.at((rng.choice([-1, 1]) * (width + 0.3), -0.12, 6 * rng.normal()), np.pi / 2)
        objects.railing(fence, u(3, 12), u(0.6, 2))
    for _ in range(rng.integers(0, 6)):
        z, y = u(-40, 40), u(4.5, 9)
        b.wire((-width - 3, -y, z), (width + 3, -y, z + 8 * rng.normal()), u(0, 1.2), u(0.01, 0.04))
    return b, _sun_and_sky(rng), log_uniform(rng, 0.06, 0.9)


def things(rng: Generator) -> Drawn:
    """Draw objects in the air around the rig, with or without ground and something all around."""
    u, b = rng.uniform, Builder.empty(rng)
    if rng.random() < 0.55:
        size = log_uniform(rng, 5, 40)
        shell = b.at(u(-0.2, 0.2, 3) * size, tilt=rng.normal(size=3))
        half = (size, size * u(0.4, 1), size)
        shell.add(rng.choice([BOX, ELLIPSOID]), (0, 0, 0), half, surface(rng, size / 2, blank=0.15))
    if rng.random() < 0.5:
        ground = b.at((0, u(0.6, 3), 0), tilt=rng.normal(0, 0.05, 3))
        ground.add(BOX, (0, 0.1, 0), (200, 0.1, 200), surface(rng, 4.0, blank=0.1))
    for _ in range(rng.integers(12, 110)):
        distance, towards = log_uniform(rng, 0.5, 25), rng.normal(size=3) * (1, 0.6, 1)
        place = b.at(distance * towards / np.linalg.norm(towards), tilt=rng.normal(0, 1.5, 3))
        _thing_in_the_air(place, distance * log_uniform(rng, 0.03, 0.3))
    light = _sun_and_sky(rng)
    if rng.random() < 0.3:
        light["lamp"], light["lamp_at"] = u(0.3, 2), rng.normal(size=3)
    return b, light, log_uniform(rng, 0.03, 0.5)


def _thing_in_the_air(b: Builder, size: float) -> None:
    """Add a bar, a plate, a ball of leaves, a grating or a shape of any kind."""
    rng, u = b.rng, b.rng.uniform
    kind = rng.choice(["bar", "leaves", "grating", "any"], p=[0.15, 0.04, 0.06, 0.75])
    if kind == "bar":
        bar = size * rng.permutation([log_uniform(rng, 0.02, 0.1), rng.choice([0.05, 1]), 2.0])
        b.add(BOX, (0, 0, 0), bar, surface(rng, 2 * size))
    elif kind == "leaves":
        cut = (u(2, 6) / size, 0.5, 0, 0)
        b.add(
            ELLIPSOID, (0, 0, 0), (size, size, size), surface(rng, size), cutout=tx.LEAVES, cut=cut
        )
    elif kind == "grating":
        cut = (size / u(2, 6), size * u(0.03, 0.1), 0, 0)
        half = (size, size, 0.05 * size)
        b.add(
            BOX, (0, 0, 0), half, surface(rng, size), cutout=rng.choice([tx.BARS, tx.MESH]), cut=cut
        )
    else:
        objects.small_thing(b, size)


SCENES: tuple[Callable[[Generator], Drawn], ...] = (room, room, street, things)
