"""Boards of coded markers: the AprilGrid of Kalibr and the ChArUco board of OpenCV.

Each corner is known by its marker, so that a part of the board is enough: at the rim of a wide lens
there is no more.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError, check_number
from omnistereo_lib.geometry.pose import Floats
from omnistereo_lib.lazy import lazy_property
from omnistereo_rigs.boards.board import Board, check_edge
from omnistereo_rigs.boards.checkerboard import LEAST_WINDOW, SMALL_WINDOW

_STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-4)
_BORDERS = (2, 1)  # bits of a tag's black border: Kalibr prints two, others one
_LARGE, _ENLARGED = 1600, 2  # px of the longer side; smaller images are enlarged


@dataclass(frozen=True)
class AprilGrid(Board):
    """A grid of AprilTags (36h11), as Kalibr prints it, numbered from the bottom left.

    Board frame, seen from the front: origin at the top-left corner of the top-left tag, x right, y
    down, z into the board. The corners of a tag are in the order top left, top right, bottom right,
    bottom left.
    """

    tags: tuple[int, int]  #: columns and rows
    size: float  #: edge of a tag, metres
    spacing: float  #: gap between tags, as a fraction of their edge: tagSpacing of Kalibr
    start: int = 0  #: number of the tag at the bottom left: startId of Kalibr

    def __post_init__(self) -> None:
        columns, rows = (
            check_number(n, "the tags of an AprilGrid", 1, 24, whole=True) for n in self.tags
        )
        object.__setattr__(self, "tags", (int(columns), int(rows)))
        check_edge(self.size, "the edge of a tag in metres")
        last = 587 - columns * rows  # 36h11 has 587 tags
        first = check_number(self.start, "the first tag of an AprilGrid", 0, last, whole=True)
        object.__setattr__(self, "start", int(first))
        if not 0.1 <= check_number(self.spacing, "the gap between tags", 1e-4, 1000) <= 2:
            ratio = self.spacing / self.size
            hint = f". If it is in metres, pass {ratio:.3g}" if 0.1 <= ratio <= 2 else ""
            raise OmnistereoError(
                f"the gap between tags is {self.spacing:g}; expected a fraction of their edge, 0.1"
                f" to 2{hint}"
            )

    def __str__(self) -> str:
        return f"of {self.tags[0]} x {self.tags[1]} AprilTags of {1000 * self.size:g} mm"

    @lazy_property
    def points(self) -> Floats:
        """Corners in the board frame, shape (4 tags, 3), metres, by the number of the tag."""
        number = np.arange(self.tags[0] * self.tags[1])
        row, column = self.tags[1] - 1 - number // self.tags[0], number % self.tags[0]
        first = self.size * (1 + self.spacing) * np.stack([column, row, 0 * row], -1)
        return np.asarray(
            (
                first[:, None] + self.size * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
            ).reshape(-1, 3)
        )

    def find_corners(self, gray: NDArray[Any]) -> Floats | None:
        """Find the corners of all tags that are visible, NaN for the others."""
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
        scale = _ENLARGED if max(gray.shape) <= _LARGE else 1
        large = cv2.resize(gray, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        found: dict[int, Floats] = {}
        for border in _BORDERS:
            quads, ids, _ = cv2.aruco.ArucoDetector(dictionary, _parameters(border)).detectMarkers(
                large
            )
            numbers = [] if ids is None else [int(number) - self.start for number in ids.ravel()]
            small: list[Floats] = [
                (quad.reshape(4, 2).astype(np.float64) + 0.5) / scale - 0.5 for quad in quads
            ]
            pairs = zip(numbers, small, strict=True)
            known = {n: quad for n, quad in pairs if 0 <= 4 * n < len(self.points)}
            found = known if len(known) > len(found) else found
        first = self._first_corner(found)
        if first is None:
            return None
        corners = np.full((len(self.points), 2), np.nan)
        for number, quad in found.items():
            corners[4 * number : 4 * number + 4] = np.roll(
                _refined(gray, quad, self.spacing), -first, axis=0
            )
        return corners

    def _first_corner(self, quads: dict[int, Floats]) -> int | None:
        """Return which of OpenCV's four corners is the top left: by the next tag to the right."""
        votes = np.zeros(4)
        for number, quad in quads.items():
            neighbor = quads.get(number + 1)
            if neighbor is not None and (number + 1) % self.tags[0]:
                right = (neighbor - quad).mean(0)
                edges = np.roll(quad, -1, axis=0) - quad
                votes[np.argmax(edges @ right / np.linalg.norm(edges, axis=1))] += 1
        return int(votes.argmax()) if votes.any() else None


@dataclass(frozen=True)
class CharucoBoard(Board):
    """A checkerboard with markers in its white squares.

    Board frame: as `Checkerboard`, its inner corners in order.
    """

    squares: tuple[int, int]  #: columns and rows
    square: float  #: edge of a square, metres
    marker: float  #: edge of a marker, metres
    dictionary: str = "DICT_4X4_50"  #: of OpenCV, such as DICT_5X5_100

    def __post_init__(self) -> None:
        columns, rows = (
            check_number(n, "the squares of a ChArUco board", 3, 100, whole=True)
            for n in self.squares
        )
        object.__setattr__(self, "squares", (int(columns), int(rows)))
        check_edge(self.square, "the square (its edge in metres)")
        check_number(self.marker, "the marker (its edge in metres)", 1e-5, 0.99 * self.square)
        if not isinstance(getattr(cv2.aruco, self.dictionary, None), int):
            raise OmnistereoError(
                f"dictionary is {self.dictionary!r}; expected one of OpenCV, such as DICT_4X4_50"
            )

    def __str__(self) -> str:
        columns, rows = self.squares
        return (
            f"of {columns} x {rows} ChArUco squares of {1000 * self.square:g} mm, {self.dictionary}"
        )

    @lazy_property
    def points(self) -> Floats:
        """Inner corners in the board frame, shape (K, 3), metres, row by row."""
        return np.asarray(self._board(legacy=False).getChessboardCorners(), np.float64)

    def _board(self, legacy: bool) -> Any:
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        board = cv2.aruco.CharucoBoard(self.squares, self.square, self.marker, dictionary)
        # of OpenCV before 4.6: boards with an even number of rows differ
        board.setLegacyPattern(legacy)
        return board

    def find_corners(self, gray: NDArray[Any]) -> Floats | None:
        """Find the inner corners beside visible markers, NaN for the others."""
        corners = np.full((len(self.points), 2), np.nan)
        for legacy in (False, True):
            found, ids, _, _ = cv2.aruco.CharucoDetector(self._board(legacy)).detectBoard(gray)
            if ids is not None and len(ids) > np.isfinite(corners[:, 0]).sum():
                corners[:] = np.nan
                corners[ids.ravel()] = found.reshape(-1, 2)
        return corners if np.isfinite(corners).any() else None


def _parameters(border: int) -> Any:
    """Return settings that part tags from the black squares that touch their corners."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = border
    parameters.adaptiveThreshConstant = 20
    parameters.adaptiveThreshWinSizeMin, parameters.adaptiveThreshWinSizeMax = 3, 43
    parameters.adaptiveThreshWinSizeStep = 4
    return parameters


def _refined(gray: NDArray[Any], quad: Floats, spacing: float) -> Floats:
    """Refine the corners of a tag in windows that stay between the tag and its neighbours."""
    edge = np.linalg.norm(np.roll(quad, -1, axis=0) - quad, axis=1).min()
    half = int(np.clip(0.5 * min(spacing, 0.2) * edge, LEAST_WINDOW, SMALL_WINDOW))
    start = quad.reshape(-1, 1, 2).astype(np.float32)
    refined: Floats = (
        cv2.cornerSubPix(gray, start, (half, half), (-1, -1), _STOP)
        .reshape(4, 2)
        .astype(np.float64)
    )
    return np.where(np.linalg.norm(refined - quad, axis=1, keepdims=True) < half, refined, np.nan)
