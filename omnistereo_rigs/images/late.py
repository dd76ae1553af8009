"""Which cameras show another moment than the rest, from images of a moving rig and the rig alone.

Two cameras of one moment have most matches near the epipolar planes of the rig. So the shift with
most such matches is found for each pair of cameras, and a tree of the clearest pairs gives the
lateness of all: any number of cameras may be late, and nothing is asked about which.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

from omnistereo_lib.geometry.pose import Floats, Pose
from omnistereo_lib.geometry.rig import Rig
from omnistereo_rigs.boards.bundle import cross
from omnistereo_rigs.images.features import FeatureFinder, Features, match_features
from omnistereo_rigs.images.relative_pose import depths, epipolar_residuals

FRAMES, REACH = 8, 5  # in a row that are looked at, and the largest shift
_NEAR = np.radians(0.3)  # of an epipolar plane


@dataclass(frozen=True)
class Lateness:
    """How late each camera is, in frames, and how well the images show it."""

    frames: tuple[int, ...]  #: against most of the cameras
    gain: float  #: matches near the epipolar planes, by those that there are if none is late
    clear: float  #: those of a pair of cameras by those of the next best shift, the least of all
    matches: float  #: near the epipolar planes, mean over pairs of cameras and frames


class LateCameras:
    """Counts matches of frames in a row, each when it is first asked for.

    Args:
        rig: Its poses and lenses are believed.
        images: images[frame][camera], of frames that follow each other evenly.
    """

    def __init__(self, rig: Rig, images: Sequence[Sequence[NDArray[np.uint8]]]) -> None:
        self.rig, self.images = rig, images
        self.pairs = list(combinations(range(len(rig)), 2))
        self._finders = [FeatureFinder(camera) for camera in rig.cameras]
        self._features: dict[tuple[int, int], Features] = {}
        self._counts: dict[tuple[int, int, int, int], int] = {}
        T = rig.T_rig_cam
        self._T = {(i, j): T[j].inverse() @ T[i] for i, j in self.pairs}

    def find(self, reach: int = REACH) -> Lateness:
        """Return by how many frames each camera is late."""
        reach = min(reach, len(self.images) - 1)
        cameras = len(self.rig)
        score = {pair: self.scores(pair, reach) for pair in self.pairs}
        cost, shift = np.zeros((cameras, cameras)), np.zeros((cameras, cameras), int)
        clear = np.ones((cameras, cameras))
        for (i, j), found in score.items():
            second, best = sorted(found)[-2:]
            shift[i, j] = int(np.argmax(found)) - reach
            shift[j, i] = -shift[i, j]
            cost[i, j] = 1 / max(best - second, 1e-3)
            clear[i, j] = clear[j, i] = best / max(second, 0.5)
        tree = minimum_spanning_tree(cost)
        order, parent = breadth_first_order(tree + tree.T, 0, directed=False)
        late = [0] * cameras
        for camera in order[1:]:
            late[camera] = late[parent[camera]] + int(shift[parent[camera], camera])
        # Most cameras are on time; of equally many, the first ones.
        usual = max(late, key=lambda value: (late.count(value), -late.index(value)))
        late = [value - usual for value in late]

        def total(late: Sequence[int]) -> float:
            moved = [(score[i, j], late[j] - late[i] + reach) for i, j in self.pairs]
            return float(np.mean([one[k] for one, k in moved if 0 <= k <= 2 * reach] or [0.0]))

        now, least = total(late), min(clear[parent[camera], camera] for camera in order[1:])
        return Lateness(tuple(late), now / max(total([0] * cameras), 0.5), float(least), now)

    def scores(self, pair: tuple[int, int], reach: int) -> list[float]:
        """Return the mean number of matches when the second camera's frames are moved."""
        count = len(self.images)
        return [
            float(
                np.mean(
                    [
                        self.count(pair, t, t + shift)
                        for t in range(max(0, -shift), min(count, count - shift))
                    ]
                )
            )
            for shift in range(-reach, reach + 1)
        ]

    def count(self, pair: tuple[int, int], t: int, u: int) -> int:
        """Return how many matches of two images lie near the epipolar planes, before both."""
        key = (*pair, t, u)
        if key not in self._counts:
            self._counts[key] = self._count(pair, t, u)
        return self._counts[key]

    def _count(self, pair: tuple[int, int], t: int, u: int) -> int:
        a, b = self.features(t, pair[0]), self.features(u, pair[1])
        matches = match_features(a, b)[0]
        if len(matches) == 0:
            return 0
        x, y = a.rays[matches[:, 0]], b.rays[matches[:, 1]]
        return int(near_planes(self._T[pair], x, y).sum())

    def features(self, frame: int, camera: int) -> Features:
        """Return the features of an image."""
        key = frame, camera
        if key not in self._features:
            self._features[key] = self._finders[camera].find(self.images[frame][camera])
        return self._features[key]


def near_planes(T_b_a: Pose, x: Floats, y: Floats) -> NDArray[np.bool_]:
    """Return which pairs of rays (M, 3) lie near the epipolar planes and before both cameras."""
    E = cross((T_b_a.t / np.linalg.norm(T_b_a.t))[None])[0] @ T_b_a.R
    along_x, along_y = depths(T_b_a, x, y)
    near = np.abs(epipolar_residuals(E, x, y)) < _NEAR
    return np.asarray(near & (along_x > 0) & (along_y > 0))
