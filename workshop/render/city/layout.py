"""Where things stand: a district's streets, blocks and building lots. NumPy alone.

World frame of the city: x east, y north, z up, metres; the carriageway is z = 0.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

LANE = 1.7  # from the street's centre line to the middle of a lane
PARKING = 4.5  # to the middle of the row of parked cars
HALF_STREET = 5.6  # to the kerb
KERB_HEIGHT = 0.14
CORNER_RADIUS = 4.0
OUTSKIRTS = 70.0  # length of the streets beyond the last crossing
STREETS = 5  # streets in each direction; one more row of blocks than streets


@dataclass(frozen=True)
class Rectangle:
    """An axis-parallel rectangle on the ground."""

    x0: float
    y0: float
    x1: float
    y1: float

    @property
    def size(self) -> tuple[float, float]:
        """Extent along x and y."""
        return self.x1 - self.x0, self.y1 - self.y0

    @property
    def center(self) -> NDArray[np.float64]:
        """Middle point, shape (2,)."""
        return np.array([self.x0 + self.x1, self.y0 + self.y1]) / 2

    def inset(self, margin: float) -> Rectangle:
        """Return the rectangle smaller by `margin` on every side."""
        return Rectangle(self.x0 + margin, self.y0 + margin, self.x1 - margin, self.y1 - margin)

    def sides(self) -> list[tuple[NDArray[np.float64], NDArray[np.float64], float]]:
        """Return start, direction (2,) and length of the sides, counter-clockwise from south."""
        (w, h), x, y = self.size, np.array([1.0, 0.0]), np.array([0.0, 1.0])
        return [
            (np.array([self.x0, self.y0]), x, w),
            (np.array([self.x1, self.y0]), y, h),
            (np.array([self.x1, self.y1]), -x, w),
            (np.array([self.x0, self.y1]), -y, h),
        ]

    def rounded(self, radius: float, steps: int = 8) -> NDArray[np.float64]:
        """Return the outline with round corners, counter-clockwise, shape (n, 2)."""
        angle = np.linspace(0, np.pi / 2, steps)
        arc = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        turn = np.array([[0.0, 1.0], [-1.0, 0.0]])  # row vectors: a quarter turn counter-clockwise
        inner = self.inset(radius)
        x0, y0, x1, y1 = inner.x0, inner.y0, inner.x1, inner.y1
        corners = [(x1, y1), (x0, y1), (x0, y0), (x1, y0)]
        return np.concatenate(
            [corner + arc @ np.linalg.matrix_power(turn, i) for i, corner in enumerate(corners)]
        )


@dataclass(frozen=True)
class Block:
    """What stands between four streets, out to the kerb."""

    kerb: Rectangle
    pavement: float  # width, metres
    kind: str  # "houses" | "park"
    number: int

    @property
    def building_line(self) -> Rectangle:
        """The rectangle that buildings may fill."""
        return self.kerb.inset(self.pavement)


@dataclass(frozen=True)
class Lot:
    """One building's ground, with the sides that are open to the air (south, east, north, west)."""

    ground: Rectangle
    open_sides: tuple[bool, bool, bool, bool]
    street_sides: tuple[bool, bool, bool, bool]
    empty: bool


@dataclass(frozen=True)
class District:
    """A grid of streets: x of those that run north, y of those that run east; its blocks."""

    seed: int
    xs: NDArray[np.float64]
    ys: NDArray[np.float64]
    blocks: tuple[Block, ...]

    @property
    def extent(self) -> Rectangle:
        """The rectangle around all blocks."""
        kerbs = [block.kerb for block in self.blocks]
        return Rectangle(
            min(k.x0 for k in kerbs),
            min(k.y0 for k in kerbs),
            max(k.x1 for k in kerbs),
            max(k.y1 for k in kerbs),
        )


def plan_district(seed: int) -> District:
    """Lay out a district of 5 × 5 streets, the same for the same seed."""
    rng = np.random.default_rng([seed, 1])
    xs, ys = (np.cumsum(rng.uniform(62, 86, STREETS)) for _ in range(2))
    xs, ys = xs - xs.mean(), ys - ys.mean()
    bounds = [
        np.concatenate([[line[0] - OUTSKIRTS], line, [line[-1] + OUTSKIRTS]]) for line in (xs, ys)
    ]
    inner = [(i, j) for i in range(1, STREETS) for j in range(1, STREETS)]
    parks = {inner[k] for k in rng.choice(len(inner), 2, replace=False)}
    blocks = []
    for i in range(STREETS + 1):
        for j in range(STREETS + 1):
            (x0, x1), (y0, y1) = bounds[0][i : i + 2], bounds[1][j : j + 2]
            kerb = Rectangle(x0, y0, x1, y1).inset(HALF_STREET)
            kind = "park" if (i, j) in parks else "houses"
            blocks.append(Block(kerb, rng.uniform(3.8, 4.8), kind, len(blocks)))
    return District(seed, xs, ys, tuple(blocks))


def split_lots(block: Block, rng: np.random.Generator) -> list[Lot]:
    """Cut a block into two rows of lots, back to back; now and then a lot stays empty."""
    area = block.building_line
    middle = (area.y0 + area.y1) / 2
    lots = []
    for south, (y0, y1) in ((True, (area.y0, middle)), (False, (middle, area.y1))):
        cuts = _cut(area.x0, area.x1, rng)
        # The corners are always built on: an empty corner looks like a mistake of the planner.
        empty = [0 < k < len(cuts) - 2 and rng.random() < 0.12 for k in range(len(cuts) - 1)]
        for k, (x0, x1) in enumerate(itertools.pairwise(cuts)):
            east, west = k == len(cuts) - 2, k == 0
            street = (south, east, not south, west)
            beside = (k + 1 < len(empty) and empty[k + 1], k > 0 and empty[k - 1])
            sides = (south, east or beside[0], not south, west or beside[1])
            lots.append(Lot(Rectangle(x0, y0, x1, y1), sides, street, empty[k]))
    return lots


def _cut(low: float, high: float, rng: np.random.Generator) -> NDArray[np.float64]:
    widths = rng.uniform(10, 21, max(2, round((high - low) / 15.5)))
    return low + np.concatenate([[0], np.cumsum(widths)]) * (high - low) / widths.sum()
