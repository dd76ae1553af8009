"""The drive: where the rig is in each frame. NumPy alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.geometry.pose import Pose
from workshop.render.city.layout import LANE, District

_RIGHT_TURN, _LEFT_TURN = 8.0, 9.0  # radii of the arcs at crossings, metres
_RIG_HEIGHT = 1.9  # on the roof of a minivan
# Crossings where the drive begins, turns and ends, as (street running north, street running east):
# right and left turns, no street twice. Training passes no crossing that the test passes, so it
# never drives where the test does.
ROUTES = {
    "train": ((4, 3), (4, 4), (0, 4), (0, 0), (2, 0), (2, 1), (4, 1), (4, 0), (3, 0)),
    "test": ((1, 1), (1, 3), (3, 3), (3, 2), (4, 2)),
}


@dataclass(frozen=True)
class Drive:
    """A path on the right-hand lanes, sampled at equal distances: one sample for each frame."""

    points: NDArray[np.float64]  # (frames, 2)
    headings: NDArray[np.float64]  # radians, counter-clockwise from east
    seed: int

    def pose(self, index: int) -> Pose:
        """Return T_world_rig of frame `index` (from 0), with the sway of a van on its springs."""
        rng = np.random.default_rng([self.seed, 7, index])
        yaw = self.headings[index] + rng.normal(0, np.radians(0.6))
        level = level_rig(yaw)
        sway = Pose.from_vector([*rng.normal(0, np.radians(0.7), 3) * (1, 0, 1), 0, 0, 0])
        at = np.array([*self.points[index], _RIG_HEIGHT + rng.normal(0, 0.015)])
        return Pose(level @ sway.R, at)


def level_rig(yaw: float) -> NDArray[np.float64]:
    """Return R_world_rig of a level rig along `yaw`: columns are right, down, forward."""
    forward = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    down = np.array([0.0, 0.0, -1.0])
    return np.stack([np.cross(down, forward), down, forward], axis=1)


def plan_drive(district: District, route: str, frames: int) -> Drive:
    """Return the drive along `ROUTES[route]` in so many frames."""
    nodes = np.array([(district.xs[i], district.ys[j]) for i, j in ROUTES[route]])
    path = _fine_path(nodes)
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    # Leave out the very ends, which lie in the middle of a crossing.
    s = np.linspace(14.0, length[-1] - 14.0, frames)
    points = np.stack([np.interp(s, length, path[:, k]) for k in range(2)], axis=1)
    ahead = np.stack([np.interp(s + 0.5, length, path[:, k]) for k in range(2)], axis=1) - points
    return Drive(points, np.arctan2(ahead[:, 1], ahead[:, 0]), district.seed)


def _fine_path(nodes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points every few centimetres: straight lanes, joined by arcs at the crossings."""
    legs = np.diff(nodes, axis=0)
    legs /= np.linalg.norm(legs, axis=1, keepdims=True)
    right = np.stack([legs[:, 1], -legs[:, 0]], axis=1) * LANE
    corners = [nodes[0] + right[0]]
    for k in range(1, len(legs)):
        corners.append(nodes[k] + right[k - 1] + right[k])
    corners.append(nodes[-1] + right[-1])
    pieces = [np.array([corners[0]])]
    for k in range(1, len(legs)):
        pieces.append(_arc(corners[k], legs[k - 1], legs[k]))
    pieces.append(np.array([corners[-1]]))
    return np.concatenate(pieces)


def _arc(corner: NDArray, before: NDArray, after: NDArray) -> NDArray[np.float64]:
    """Return the quarter circle that rounds a corner between two directions at right angles."""
    turns_left = before[0] * after[1] - before[1] * after[0] > 0
    radius = _LEFT_TURN if turns_left else _RIGHT_TURN
    center = corner + radius * (after - before)
    t = np.linspace(0, np.pi / 2, 200)[:, None]
    return center - radius * np.cos(t) * after + radius * np.sin(t) * before
