"""Random things for the ray caster: surfaces, furniture, people, plants, cars, street furniture.

An object stands on y = 0 of its builder; up is -y, as y is down everywhere. Lengths are metres.
"""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from omnistereo_learn.endless import textures as tx
from omnistereo_learn.endless.caster import BOX, CYLINDER, ELLIPSOID, PRIMITIVE, SOFT
from omnistereo_lib.geometry.pose import rotation_from_axis_angle

Surface = dict[str, Any]  # fields of PRIMITIVE
_COMMON = 3 * [tx.CLOUDS] + [tx.CHECKER, tx.BRICKS, tx.BRICKS, tx.BOOKS, tx.GRAIN, tx.POSTER]


def log_uniform(rng: Generator, low: float, high: float) -> float:
    """Return a number whose logarithm is uniform: half of them lie below √(low · high)."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def any_yaw(rng: Generator) -> float:
    """Return a rotation about the vertical, radians."""
    return float(rng.uniform(0, 2 * np.pi))


def plain(gray: float, **fields: float) -> Surface:
    """Return a surface of one gray value."""
    return {"texture": tx.PLAIN, "dark": gray, "light": gray, "scale": 1.0} | fields


def surface(
    rng: Generator, size: float, texture: int | None = None, blank: float = 0.3, **fields: Any
) -> Surface:
    """Draw a surface for an object of a size in metres; `blank`: how often without texture."""
    if texture is None:
        texture = tx.PLAIN if rng.random() < blank else int(rng.choice(_COMMON))
    u = rng.uniform
    scale, pattern = {
        tx.PLAIN: (1.0, (1.0, 0.0, 0.0)),
        tx.CLOUDS: (
            log_uniform(rng, 0.7, 12) / size,
            (u(0.45, 0.95), u(0.03, 0.3), rng.choice([0, 0.5, 1])),
        ),
        tx.CHECKER: (u(1, 8) / size, (1.0, 0.0, 0.0)),
        tx.BRICKS: (u(0.8, 6) / size, (u(0.2, 1.2), u(0.005, 0.06), u(0, 0.6))),
        tx.FACADE: (u(0.25, 0.6), (u(0.8, 1.8), u(0.2, 0.42), u(0.2, 0.42))),
        tx.BOOKS: (u(2, 25) / size, (u(0.5, 20), 0.0, rng.integers(2))),
        tx.GRAIN: (u(0.5, 5) / size, (u(0.2, 1), u(0, 3), 0.0)),
        tx.POSTER: (u(1, 8) / size, (u(0.2, 0.9), 0.0, 0.0)),
    }[texture]
    dark, light = u(0.06, 0.9, 2)
    if rng.random() < 0.35:
        light = dark + (light - dark) * u(0.1, 0.4)
    dirt = rng.choice([0, u(0.02, 0.25)], p=[0.4, 0.6])
    mirror = rng.choice([0, u(0.02, 0.12)], p=[0.8, 0.2])
    skin = {"texture": texture, "dark": dark, "light": light, "scale": scale, "pattern": pattern}
    skin |= {"dirt": dirt, "dirt_scale": log_uniform(rng, 1, 12) / math.sqrt(size)}
    return skin | {"mirror": mirror} | fields


@dataclass
class Builder:
    """Adds primitives in a frame of its own: of a room, a table in it, a cup on the table."""

    rng: Generator
    primitives: list[NDArray[Any]]
    R: NDArray[Any]  # this frame → scene
    t: NDArray[Any]

    @classmethod
    def empty(cls, rng: Generator) -> "Builder":
        """Return the builder of a new scene."""
        return cls(rng, [], np.eye(3), np.zeros(3))

    def at(self, place: ArrayLike, yaw: float = 0.0, tilt: ArrayLike = (0, 0, 0)) -> "Builder":
        """Return a builder at a place, tilted by an axis-angle vector and turned by a yaw."""
        R = rotation_from_axis_angle([0, yaw, 0]) @ rotation_from_axis_angle(tilt)
        return Builder(
            self.rng, self.primitives, self.R @ R, self.R @ np.asarray(place, float) + self.t
        )

    def add(
        self, shape: int, center: ArrayLike, half: ArrayLike, skin: Surface, **fields: Any
    ) -> None:
        """Add a primitive; fields as in `PRIMITIVE`."""
        one = np.zeros(1, PRIMITIVE)
        one["shape"], one["half"], one["rotation"] = shape, half, self.R.T
        one["center"] = self.R @ np.asarray(center, float) + self.t
        one["seed"], one["roundness"], one["ripple"] = self.rng.integers(1 << 30), 1, 1.0
        for name, value in (skin | fields).items():
            one[name] = value
        self.primitives.append(one)

    def rod(self, a: ArrayLike, b: ArrayLike, radius: float, skin: Surface) -> None:
        """Add a cylinder from one point to another."""
        along = np.subtract(b, a)
        length = float(np.linalg.norm(along))
        axis = np.cross([0, 1, 0], along / length)
        angle = math.acos(np.clip(along[1] / length, -1, 1))
        tilt = axis * angle / max(float(np.linalg.norm(axis)), 1e-9)
        middle = self.at(np.add(a, b) / 2, tilt=tilt)
        middle.add(CYLINDER, (0, 0, 0), (radius, length / 2, radius), skin)

    def wire(self, a: ArrayLike, b: ArrayLike, sag: float, radius: float) -> None:
        """Add a cable that hangs between two points."""
        s = np.linspace(0, 1, 9)[:, None]
        points = (
            (1 - s) * np.asarray(a, float)
            + s * np.asarray(b, float)
            + [0, sag, 0] * (4 * s * (1 - s))
        )
        skin = plain(self.rng.uniform(0.02, 0.3))
        for start, end in pairwise(points):
            self.rod(start, end, radius, skin)


def small_thing(b: Builder, size: float) -> None:
    """Add a shape of any kind."""
    half = size * b.rng.uniform(0.4, 1.0, 3)
    bump = b.rng.choice([0, b.rng.uniform(0.05, 0.35)])
    soft = {"roundness": b.rng.integers(1, 4), "bump": bump, "ripple": b.rng.uniform(1, 7, 3)}
    b.add(
        int(b.rng.integers(4)), (0, -half[1], 0), half, surface(b.rng, 2 * size, blank=0.15), **soft
    )


def _legs(b: Builder, x: float, z: float, height: float, radius: float, skin: Surface) -> None:
    for sx in (-x, x):
        for sz in (-z, z):
            b.rod((sx, 0, sz), (sx, -height, sz), radius, skin)


def _table(b: Builder) -> None:
    u, skin = b.rng.uniform, surface(b.rng, 1.0)
    x, z, height = u(0.3, 0.9), u(0.3, 0.6), u(0.4, 0.8)
    b.add(BOX, (0, -height, 0), (x, 0.02, z), skin)
    _legs(b, x - 0.05, z - 0.05, height, u(0.01, 0.035), skin)
    for _ in range(b.rng.integers(0, 6)):
        place = u(-0.8, 0.8) * x, -height - 0.02, u(-0.8, 0.8) * z
        small_thing(b.at(place, any_yaw(b.rng)), u(0.04, 0.16))
    if b.rng.random() < 0.3:
        screen(b.at((0, -height - 0.3, 0), u(-0.5, 0.5)))


def _chair(b: Builder) -> None:
    u, skin = b.rng.uniform, surface(b.rng, 0.6)
    w, seat, back, thin = u(0.18, 0.26), u(0.4, 0.5), u(0.75, 1.05), u(0.01, 0.025)
    b.add(SOFT, (0, -seat, 0), (w, u(0.02, 0.06), w), skin, roundness=3)
    _legs(b, w - thin, w - thin, seat, thin, skin)
    if b.rng.random() < 0.6:  # slats
        for x in np.linspace(-w + thin, w - thin, b.rng.integers(2, 7)):
            b.rod((x, -seat, w), (x, -back, w + 0.06), thin, skin)
        b.rod((-w, -back, w + 0.06), (w, -back, w + 0.06), thin, skin)
    else:
        half = w, (back - seat) / 2, 0.025
        b.add(SOFT, (0, -(seat + back) / 2 - 0.08, w), half, skin, roundness=3)


def _sofa(b: Builder) -> None:
    u, skin = b.rng.uniform, surface(b.rng, 1.0, roundness=3)
    w, d, soft = u(0.5, 1.1), u(0.35, 0.9), {"bump": u(0, 0.1), "ripple": u(1, 5, 3)}
    b.add(SOFT, (0, -0.22, 0), (w, 0.25, d), skin, **soft)
    b.add(SOFT, (0, -0.42, d), (w, 0.42, 0.16), skin, **soft)
    for side in (-w, w):
        b.add(SOFT, (side, -0.3, 0), (0.13, 0.32, d), skin, **soft)


def _shelf(b: Builder) -> None:
    """Add open shelves with books."""
    u, skin = b.rng.uniform, surface(b.rng, 1.0)
    w, height, d, levels = u(0.3, 0.9), u(0.8, 2.2), u(0.12, 0.25), b.rng.integers(2, 6)
    b.add(BOX, (0, -height / 2, d), (w, height / 2, 0.01), skin)
    for side in (-w, w):
        b.add(BOX, (side, -height / 2, 0), (0.015, height / 2, d), skin)
    for y in np.linspace(-height, 0, levels + 1):
        b.add(BOX, (0, y, 0), (w, 0.012, d), skin)
        books = u(0.2, 0.9) * w
        center, half = (u(-1, 1) * (w - books), y - 0.14, 0.02), (books, 0.12, 0.7 * d)
        b.add(BOX, center, half, surface(b.rng, 0.8, tx.BOOKS))


def _plant(b: Builder) -> None:
    """Add a pot with leaves, flat discs on stalks."""
    u, height, leaf = b.rng.uniform, b.rng.uniform(0.3, 1.4), surface(b.rng, 0.3, tx.CLOUDS)
    b.add(CYLINDER, (0, -0.12, 0), (0.13, 0.13, 0.13), surface(b.rng, 0.3))
    for _ in range(b.rng.integers(8, 26)):
        tip = np.array([0.3 * b.rng.normal(), -u(0.3, 1), 0.3 * b.rng.normal()]) * height
        tip[1] -= 0.25
        b.rod((0, -0.25, 0), tip, 0.005, leaf)
        blade = b.at(tip, any_yaw(b.rng), b.rng.normal(0, 0.6, 3))
        blade.add(ELLIPSOID, (0, 0, 0), (u(0.03, 0.08), 0.004, u(0.08, 0.25)), leaf)


def _person(b: Builder) -> None:
    u, height = b.rng.uniform, b.rng.uniform(1.45, 1.9)
    cloth, trousers, stride = surface(b.rng, 0.5), surface(b.rng, 0.5), u(0, 0.25)
    for side in (-1, 1):
        b.rod((side * 0.1, 0, side * stride), (side * 0.09, -0.5 * height, 0), 0.07, trousers)
        hand = side * u(0.22, 0.4), -u(0.42, 0.8) * height, u(-0.3, 0.1)
        b.rod((side * 0.22, -0.82 * height, 0), hand, 0.045, cloth)
    soft = {"roundness": 2, "bump": 0.1, "ripple": (3, 3, 3)}
    b.add(SOFT, (0, -0.67 * height, 0), (0.23, 0.19 * height, 0.14), cloth, **soft)
    b.add(ELLIPSOID, (0, -0.93 * height, 0), (0.085, 0.12, 0.1), surface(b.rng, 0.3))


def screen(b: Builder) -> None:
    """Add a dark screen that mirrors its surroundings."""
    w = b.rng.uniform(0.2, 0.7)
    b.add(BOX, (0, 0, 0), (w, 0.6 * w, 0.02), plain(0.02, mirror=b.rng.uniform(0.03, 0.08)))
    b.rod((0, 0.6 * w, 0.03), (0, 0.3, 0.03), 0.03, plain(0.05))


def _floor_lamp(b: Builder) -> None:
    height = b.rng.uniform(0.9, 1.8)
    b.rod((0, 0, 0), (0, -height, 0), b.rng.uniform(0.008, 0.02), plain(b.rng.uniform(0.05, 0.6)))
    b.add(CYLINDER, (0, -height, 0), (0.16, 0.12, 0.16), plain(0.7, glow=b.rng.choice([0, 0.5])))


def _boxes(b: Builder) -> None:
    y = 0.0
    for _ in range(b.rng.integers(1, 4)):
        half = b.rng.uniform(0.1, 0.45, 3)
        b.at((0, y, 0), any_yaw(b.rng)).add(BOX, (0, -half[1], 0), half, surface(b.rng, 0.6))
        y -= 2 * half[1]


def railing(b: Builder, length: float = 1.5, height: float = 1.0) -> None:
    """Add a railing, a fence of bars, or one of wire mesh, along x."""
    u, skin = b.rng.uniform, surface(b.rng, 0.5, blank=0.7)
    for y in (0.08 * height, height):
        b.rod((-length, -y, 0), (length, -y, 0), u(0.012, 0.03), skin)
    for x in np.linspace(-length, length, 2 + int(length)):
        b.rod((x, 0, 0), (x, -height, 0), 0.025, skin)
    cutout, gap = b.rng.choice([tx.SOLID, tx.BARS, tx.MESH]), u(0.06, 0.2)
    if cutout != tx.SOLID:
        cut = (gap, gap * (u(0.1, 0.6) if cutout == tx.BARS else u(0.05, 0.2)), 0, 0)
        b.add(
            BOX, (0, -height / 2, 0), (length, 0.46 * height, 0.008), skin, cutout=cutout, cut=cut
        )


def tree(b: Builder) -> None:
    """Add a trunk, branches, and leaves unless it is winter."""
    u, trunk, bark = b.rng.uniform, b.rng.uniform(1.5, 4.5), surface(b.rng, 0.4, tx.CLOUDS)
    b.rod((0, 0, 0), (0.2 * b.rng.normal(), -trunk, 0), u(0.06, 0.25), bark)
    leaf = surface(
        b.rng, 0.5, tx.CLOUDS, dark=u(0.04, 0.25), light=u(0.2, 0.6), mirror=0.0, cutout=tx.LEAVES
    )
    bare = b.rng.random() < 0.2
    for _ in range(b.rng.integers(4, 12)):
        tip = np.array([0.9 * b.rng.normal(), -trunk - u(0, 1.8), 0.9 * b.rng.normal()])
        b.rod((0, -trunk * u(0.7, 1), 0), tip, u(0.015, 0.05), bark)
        half, cut = u(0.4, 1.5) * u(0.6, 1, 3), (u(4, 14), u(0.35, 0.6), 0, 0)
        for shell in () if bare else (1.0, 0.7):
            b.at(tip, any_yaw(b.rng)).add(ELLIPSOID, (0, 0, 0), shell * half, leaf, cut=cut)


def _bush(b: Builder) -> None:
    u = b.rng.uniform
    half = b.rng.uniform(0.25, 1.1, 3)
    skin = surface(b.rng, 0.4, tx.CLOUDS, mirror=0.0)
    soft = {"bump": 0.4, "ripple": u(3, 12, 3), "roundness": b.rng.integers(1, 4)}
    b.add(SOFT, (0, -0.8 * half[1], 0), half, skin, **soft)


def car(b: Builder) -> None:
    """Add a car, along z."""
    u = b.rng.uniform
    L, H, tyre, glass = u(1.7, 2.6), u(1.35, 2.2), plain(0.04), plain(u(0.02, 0.1), mirror=0.06)
    body = plain(u(0.03, 0.9), mirror=u(0.03, 0.1), dirt=0.05, dirt_scale=3.0, roundness=3)
    cabin = L * u(0.45, 0.75)
    b.add(SOFT, (0, -0.58, 0), (0.88, 0.42, L), body)
    b.add(SOFT, (0, -0.5 * (0.8 + H), 0.1), (0.78, 0.5 * (H - 0.8), cabin), glass, roundness=2)
    b.add(SOFT, (0, -H, 0.1), (0.7, 0.05, 0.7 * cabin), body)
    for x in (-0.86, 0.86):
        for z in (-0.6 * L, 0.6 * L):
            b.rod((x - 0.1, -0.32, z), (x + 0.1, -0.32, z), 0.32, tyre)


def _lamp_post(b: Builder) -> None:
    u, skin = b.rng.uniform, surface(b.rng, 0.5, blank=0.6)
    height, reach, radius = u(3, 8), u(0.3, 1.8), log_uniform(b.rng, 0.02, 0.14)
    b.rod((0, 0, 0), (0, -height, 0), radius, skin)
    b.rod((0, -height, 0), (reach, -height - 0.2, 0), 0.6 * radius, skin)
    b.add(SOFT, (reach, -height - 0.2, 0), (0.3, 0.08, 0.12), skin, roundness=2)


def _sign(b: Builder) -> None:
    """Add a traffic sign, or a bollard where its post is short."""
    u, height = b.rng.uniform, b.rng.choice([b.rng.uniform(2, 3), b.rng.uniform(0.5, 1.1)])
    b.rod((0, 0, 0), (0, -height, 0), log_uniform(b.rng, 0.02, 0.1), surface(b.rng, 0.5, blank=0.6))
    if height > 1.5:
        half = u(0.15, 0.4), u(0.15, 0.4), 0.015
        b.add(BOX, (0, -height, 0), half, surface(b.rng, 0.4, tx.POSTER))


_HOME = 2 * [_table] + 3 * [_chair] + [_sofa, _shelf, _shelf, _plant, _person, _floor_lamp]
_HOME += [_boxes, railing]
_ROADSIDE = 2 * [_lamp_post] + 2 * [_sign] + 3 * [tree] + 2 * [_person] + [_bush, _boxes, railing]


def furniture(b: Builder) -> None:
    """Add something that stands in a room."""
    _HOME[b.rng.integers(len(_HOME))](b)


def street_furniture(b: Builder) -> None:
    """Add something that stands, grows or walks beside a street."""
    _ROADSIDE[b.rng.integers(len(_ROADSIDE))](b)


def facade(b: Builder, length: float, height: float) -> None:
    """Add a house of a length along z and a height, behind x = 0, with balconies and ledges."""
    u, depth = b.rng.uniform, b.rng.uniform(4, 10)
    texture = int(b.rng.choice([tx.FACADE, tx.FACADE, tx.FACADE, tx.BRICKS, tx.CLOUDS, tx.POSTER]))
    skin = surface(b.rng, 2.5, texture, mirror=0.05)
    if texture == tx.FACADE:
        skin |= {"dark": 0.0, "light": u(0.2, 0.95)}
    b.add(BOX, (depth, -height / 2, length / 2), (depth, height / 2, length / 2), skin)
    for _ in range(b.rng.integers(0, 6)):
        y, z, w = -u(0.6, max(height - 0.5, 1)), u(0.1, 0.9) * length, u(0.4, 2.5)
        if b.rng.random() < 0.4:
            balcony = b.at((-0.6, y, z), np.pi / 2)
            balcony.add(BOX, (0, 0, 0), (w, 0.06, 0.6), plain(0.5))
            railing(balcony, w)
        else:
            b.add(BOX, (0, y, z), (u(0.1, 0.8), u(0.05, 0.6), w), surface(b.rng, 1.0))
