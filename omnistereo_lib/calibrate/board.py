"""The checkerboard: where its corners are, and in how many ways it can be read."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.pose import Pose


@dataclass(frozen=True)
class Checkerboard:
    """A flat checkerboard.

    Board frame: x along the columns to the right, y along the rows down, z into the board, as seen from its front;
    the origin is the first corner.

    Parameters
    ----------
    corners : (int, int)
        Inner corners, columns and rows: where four squares meet. A board of 13 x 11 squares has 12 x 10.
    square : float
        Edge of a square, metres.

    Raises
    ------
    OmnistereoError
        If a count is not a whole number from 3 up, or the square's edge not a positive length.
    """

    corners: tuple[int, int]
    square: float

    def __post_init__(self) -> None:
        if len(self.corners) != 2 or not all(count % 1 == 0 and count >= 3 for count in self.corners):
            raise OmnistereoError(
                f"a board's corners are two whole numbers from 3 up, inner columns and rows, got {self.corners}"
            )
        if not (np.isfinite(self.square) and self.square > 0):
            raise OmnistereoError(f"the edge of a square must be a positive length in metres, got {self.square}")
        object.__setattr__(self, "corners", (int(self.corners[0]), int(self.corners[1])))

    def __str__(self) -> str:
        columns, rows = self.corners
        return f"of {columns} x {rows} inner corners, squares of {1000 * self.square:g} mm"

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """Corners in the board frame, shape (K, 3), metres, row by row, columns fastest."""
        x, y = np.meshgrid(np.arange(self.corners[0]), np.arange(self.corners[1]))
        return self.square * np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])

    @cached_property
    def readings(self) -> tuple[NDArray[np.int64], ...]:
        """Orders in which the corners can be read that no picture tells apart, each (K,) indices; first as they are.

        A turn of the board that carries black squares onto black ones. By half a turn, that is a board whose counts
        are both even or both odd; a square board can be turned by a quarter, too.
        """
        columns, rows = self.corners
        order = np.arange(columns * rows).reshape(rows, columns)
        quarters = range(4) if columns == rows else (0, 2)
        turned = [np.rot90(order, quarter) for quarter in quarters]
        # The square within the first four corners: is it, in this reading, as dark as in the first?
        parity = [sum(divmod(int(reading[:2, :2].min()), columns)) % 2 for reading in turned]
        return tuple(reading.ravel() for reading, odd in zip(turned, parity, strict=True) if odd == 0)

    def turn(self, reading: NDArray[np.int64]) -> Pose:
        """Return the turn of the board that carries each point onto the one that a reading puts in its place."""
        points = self.points[reading]
        x = (points[1] - points[0]) / self.square
        y = (points[self.corners[0]] - points[0]) / self.square
        return Pose(np.column_stack([x, y, np.cross(x, y)]), points[0])
