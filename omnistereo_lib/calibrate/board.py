"""Calibration boards: their corners, and the symmetries of a checkerboard."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError, check_number
from omnistereo_lib.geometry.pose import Pose


@dataclass(frozen=True)
class Board(ABC):
    """A flat board whose corners are known. Every corner of it is recognised, but for `symmetries`."""

    @property
    @abstractmethod
    def points(self) -> NDArray[np.float64]:
        """Corners in the board frame, shape (K, 3), metres, z = 0."""

    @property
    def symmetries(self) -> tuple[NDArray[np.int64], ...]:
        """Corner permutations that leave the pattern unchanged, each of shape (K,); identity first."""
        return (np.arange(len(self.points)),)

    def symmetry_pose(self, symmetry: NDArray[np.int64]) -> Pose:
        """Return the pose T with `T @ points[k] == points[symmetry[k]]`."""
        return Pose.identity()

    def find_corners(self, gray: NDArray[Any]) -> NDArray[np.float64] | None:
        """Return the corners of the board in an image, (K, 2) px, NaN where they are not visible, or None."""
        raise NotImplementedError


@dataclass(frozen=True)
class Checkerboard(Board):
    """A flat checkerboard.

    Board frame, seen from the front: origin at the first corner, x right, y down, z into the board.

    Raises:
        OmnistereoError: If a count is not an integer of 3 to 200, or the square is not 0.1 mm to 100 m long.

    >>> board = osl.Checkerboard((8, 6), square=0.05)
    >>> board.points[[1, 8]]  # the second corner of the first row, the first of the second
    array([[0.05, 0.  , 0.  ],
           [0.  , 0.05, 0.  ]])
    """

    #: Inner corners, columns and rows: where four squares meet. A board of 13 x 11 squares has 12 x 10.
    corners: tuple[int, int]
    square: float  #: edge of a square, metres

    def __post_init__(self) -> None:
        counts = list(self.corners) if isinstance(self.corners, Sequence) else []
        if len(counts) != 2 or not all(isinstance(n, Real) and 3 <= n <= 200 and n % 1 == 0 for n in counts):
            raise OmnistereoError(
                f"board corners are {self.corners}; expected two integers of 3 to 200, inner columns and rows"
            )
        object.__setattr__(self, "corners", (int(counts[0]), int(counts[1])))
        object.__setattr__(self, "square", check_number(self.square, "the square (its edge in metres)", 1e-4, 100))

    def __str__(self) -> str:
        columns, rows = self.corners
        return f"of {columns} x {rows} inner corners, squares of {1000 * self.square:g} mm"

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """Corners in the board frame, shape (K, 3), metres, row by row, columns fastest."""
        x, y = np.meshgrid(np.arange(self.corners[0]), np.arange(self.corners[1]))
        return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]).astype(np.float64) * self.square

    @cached_property
    def symmetries(self) -> tuple[NDArray[np.int64], ...]:
        """Corner permutations that leave the pattern unchanged, each of shape (K,); identity first.

        Boards with both counts even or both odd look the same after 180°, square ones perhaps after 90°.
        """
        columns, rows = self.corners
        order = np.arange(columns * rows).reshape(rows, columns)
        rotated = [np.rot90(order, quarter) for quarter in (range(4) if columns == rows else (0, 2))]
        # Keep only rotations that map black squares to black squares.
        parity = [sum(divmod(int(grid[:2, :2].min()), columns)) % 2 for grid in rotated]
        return tuple(grid.ravel() for grid, odd in zip(rotated, parity, strict=True) if odd == 0)

    def symmetry_pose(self, symmetry: NDArray[np.int64]) -> Pose:
        """Return the pose T with `T @ points[k] == points[symmetry[k]]`."""
        points = self.points[symmetry]
        x = (points[1] - points[0]) / self.square
        y = (points[self.corners[0]] - points[0]) / self.square
        return Pose(np.column_stack([x, y, np.cross(x, y)]), points[0])
