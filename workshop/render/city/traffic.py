"""Cars that drive: where they are in each frame, out of the rig's way."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.geometry.pose import Floats
from workshop.render.city import vehicles
from workshop.render.city.layout import HALF_STREET, LANE, District

# a car that would come nearer than this to the rig's centre is not there in that frame
_CLEARANCE = 3.0


class Traffic:
    """Cars on the right-hand lanes of all streets.

    A lane's cars share one speed, so none runs into another.
    """

    def __init__(self, district: District, stage: Any) -> None:
        self._district, self._cars = district, []
        rng = np.random.default_rng([district.seed, 6])
        e = district.extent
        for along_x, lines in ((True, district.ys), (False, district.xs)):
            low, high = (e.x0, e.x1) if along_x else (e.y0, e.y1)
            for line in lines:
                for sign in (-1, 1):
                    speed, s = rng.uniform(0.9, 1.6), low
                    while (s := s + rng.uniform(11, 34)) < high - 8:
                        kind = str(rng.choice(list(vehicles.BODIES)))
                        paint = vehicles.PAINTS[rng.integers(len(vehicles.PAINTS))]
                        item = stage.put(kind, (0, 0, 0), 0.0, paint)
                        lane, run = (along_x, line, sign), (low, s - low, speed, high - low)
                        self._cars.append((item, lane, run, vehicles.BODIES[kind].length))

    def show(self, frame: int, rig_at: ArrayLike) -> None:
        """Move all cars to where they are in `frame`; hide those in the rig's way."""
        rig = np.asarray(rig_at, float)
        for item, (along_x, line, sign), (low, s, speed, length), car_length in self._cars:
            along = low + (s + sign * speed * frame) % length
            center, yaw = lane_point(along_x, line, sign, along)
            item.location, item.rotation_euler = (*center, 0.0), (0.0, 0.0, yaw)
            direction = np.array([np.cos(yaw), np.sin(yaw)])
            near = distance_to_car(rig, center, direction, car_length) < _CLEARANCE
            crossing = np.abs(self._district.ys - along).min() < HALF_STREET + car_length / 2
            item.hide_render = item.hide_viewport = bool(near or (crossing and not along_x))

    def shown(self) -> list[tuple[float, float, float, float]]:
        """Return x, y, heading in radians, and length of the cars that are there."""
        cars = [(item, length) for item, *_, length in self._cars if not item.hide_render]
        return [(*item.location[:2], item.rotation_euler[2], length) for item, length in cars]


def lane_point(along_x: bool, line: float, sign: int, along: float) -> tuple[Floats, float]:
    """Return the middle of the right-hand lane, shape (2,), and its heading."""
    if along_x:
        return np.array([along, line - sign * LANE]), 0.0 if sign > 0 else np.pi
    return np.array([line + sign * LANE, along]), np.pi / 2 * sign


def distance_to_car(
    point: NDArray, center: NDArray, direction: NDArray, length: float, width: float = 1.95
) -> float:
    """Return the distance on the ground from a point to a car's outline, 0 inside."""
    offset = point - center
    along, across = abs(offset @ direction), abs(offset @ (-direction[1], direction[0]))
    return float(np.hypot(max(along - length / 2, 0), max(across - width / 2, 0)))
