"""Which cameras show another moment than the rest, from images of a moving rig and the rig alone.

Two cameras of one moment have most matches near the epipolar planes of the rig. So the shift with
most such matches is found for each pair of cameras, and a tree of the clearest pairs gives the
lateness of all: any number of cameras may be late, and nothing is asked about which.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

from omnistereo_lib.geometry.pose import Floats, Pose
from omnistereo_lib.geometry.rig import Rig
from omnistereo_rigs.boards.bundle import cross
from omnistereo_rigs.images.features import FeatureFinder, Features, match_features
from omnistereo_rigs.images.relative_pose import depths, epipolar_residuals, relative_pose

# So many frames in a row are looked at, and shifts up to this one are tried.
FRAMES, REACH = 8, 5
# A match this near to the epipolar plane may be of one moment.
_NEAR = np.radians(0.3)
# Finer than a frame, shifts are tried in tenths of the way from one frame to the next.
_PARTS = np.arange(10) / 10
# In frames: as far to either side of the best shift, others are as good for its sake.
_PEAK = 1.5
# In frames: cameras that differ by less are equally late, and pairs whose shifts differ by less
# agree.
_SAME = 0.25


@dataclass(frozen=True)
class Lateness:
    """How late each camera is, and how well the images show it."""

    frames: tuple[float, ...]  #: against most of the cameras
    gain: float  #: matches near the epipolar planes, of pairs that differ, by those if none did
    clear: float  #: those of a pair by those of the next best shift, of the worst pair needed
    matches: float  #: those of a pair, mean over the frames, of the worst pair needed


class LateCameras:
    """Looks for late cameras in some frames of a recording.

    Args:
        rig: Its poses and lenses are believed.
        images: images[frame][camera], of frames that follow each other evenly.
    """

    def __init__(self, rig: Rig, images: Sequence[Sequence[NDArray[np.uint8]]]) -> None:
        self.rig, self.images, self.cameras, T = rig, images, len(rig), rig.T_rig_cam
        self.pairs = list(combinations(range(len(rig)), 2))
        self._T = {(i, j): T[j].inverse() @ T[i] for i, j in self.pairs}
        # Each is asked for many times.
        self._features: Callable[[int, int], Features] = cache(self.features)
        self._rays = cache(self.rays)
        self._next = cache(self.next)
        self._finder = cache(lambda camera: FeatureFinder(rig.cameras[camera]))

    def find(self, reach: int = REACH, fine: bool = False) -> Lateness:
        """Return by how many frames each camera is late.

        Args:
            reach: Of the shifts that are tried, frames.
            fine: In tenths of a frame: between frames, what is seen is taken to move evenly.
        """
        # Two moments at least are compared at each shift.
        reach = min(reach, max(len(self.images) - 2 - fine, 1))
        parts = _PARTS if fine else _PARTS[:1]
        # All shifts that are tried, and for each pair of cameras the matches near the planes at
        # each shift.
        shifts = np.add.outer(np.arange(-reach, reach + 1), parts).ravel()
        frames = range(len(self.images))
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            # A camera a thread: what is kept is computed once.
            list(pool.map(lambda c: [self._features(t, c) for t in frames], range(self.cameras)))
            scores = pool.map(lambda pair: self._scores(pair, reach, parts), self.pairs)
        score = dict(zip(self.pairs, scores, strict=True))
        cost, shift = np.zeros((self.cameras,) * 2), np.zeros((self.cameras,) * 2)
        clear, weight = np.ones((self.cameras,) * 2), np.zeros((self.cameras,) * 2)
        for (i, j), found in score.items():
            # The second best is looked for elsewhere: the neighbours of a peak are the same peak.
            best, away = found.max(), np.abs(shifts - shifts[found.argmax()])
            second = found[away > min(_PEAK, reach - 0.1)].max(initial=0.0)
            # The middle of the peak, where several tenths of a frame are about as good.
            top = (found >= 0.9 * best) & (away < 0.5)
            shift[i, j] = np.average(shifts[top], weights=found[top] + 1e-9)
            shift[j, i] = -shift[i, j]
            # The clearer a pair shows its shift, the sooner the tree takes it.
            cost[i, j] = 1 / max(best - second, 1e-3)
            clear[i, j] = clear[j, i] = best / max(second, 0.5)
            weight[i, j] = weight[j, i] = best
        # Along the tree of the clearest pairs, each camera is as late as its parent plus their
        # shift.
        tree = minimum_spanning_tree(cost)
        order, parent = breadth_first_order(tree + tree.T, 0, directed=False)
        late = np.zeros(self.cameras)
        for camera in order[1:]:
            late[camera] = late[parent[camera]] + shift[parent[camera], camera]
        late = self._adjusted(late, shift, weight)
        # Most cameras are on time; of equally many, those of the first one.
        alike = np.abs(late - late[:, None]) < _SAME
        late = late - np.mean(late[alike[alike.sum(axis=1).argmax()]])

        # How much the pairs of which one is late gain by that, and the worst of the tree.
        gain, apart = 1.0, late - late[:, None]
        moved = [pair for pair in self.pairs if abs(apart[pair]) > _SAME]
        if moved:
            there, at_zero = (
                sum(score[pair][np.abs(shifts - k * apart[pair]).argmin()] for pair in moved)
                for k in (1, 0)
            )
            gain = float(there / max(at_zero, 0.5))
        of_tree = [
            float(min(table[parent[camera], camera] for camera in order[1:]))
            for table in (clear, weight)
        ]
        return Lateness(tuple(late.round(2).tolist()), gain, *of_tree)

    def moved(self, late: Sequence[int]) -> LateCameras:
        """Return the same look with each camera's frames moved by how late it is."""
        # Frames at the ends are lost: only those stay for which all cameras have an image.
        first, last = -min(late), len(self.images) - max(late)
        images = [[self.images[t + k][c] for c, k in enumerate(late)] for t in range(first, last)]
        other = LateCameras(self.rig, images)
        other._features = lambda frame, camera: self._features(frame + first + late[camera], camera)
        return other

    def _adjusted(self, late: Floats, shift: Floats, weight: Floats) -> Floats:
        """Return the lateness on which all pairs that agree with the tree agree best."""
        # Least squares over the pairs, weighted by their matches: late_j - late_i = shift_ij.
        apart = late - late[:, None]
        agree = [(i, j) for i, j in self.pairs if abs(shift[i, j] - apart[i, j]) < _SAME]
        rows = np.array([weight[i, j] * np.eye(self.cameras)[j] for i, j in agree])
        rows -= np.array([weight[i, j] * np.eye(self.cameras)[i] for i, j in agree])
        values = np.array([weight[i, j] * shift[i, j] for i, j in agree])
        return np.asarray(np.linalg.lstsq(rows, values, rcond=None)[0], np.float64)

    def _scores(self, pair: tuple[int, int], reach: int, parts: Floats) -> Floats:
        """Return the mean number of matches for each shift of the second camera and part of it."""
        count, scores = len(self.images), []
        for shift in range(-reach, reach + 1):
            # Only moments for which both cameras have a frame can be compared.
            last = count - (len(parts) > 1)  # between frames, the next one is looked at, too
            slots = range(max(0, -shift), min(count, last - shift))
            found = [self.counts(pair, t, t + shift, len(parts)) for t in slots]
            scores.append(np.mean(found, axis=0) if found else np.zeros(len(parts)))
        return np.concatenate(scores)

    def counts(self, pair: tuple[int, int], t: int, u: int, parts: int) -> Floats:
        """Return how many matches of frame t and of frame u, and on from there, are near planes."""
        x, y, later = self._rays(pair, t, u, parts > 1)
        counts = np.zeros(parts)
        for k in range(parts):
            there = y + _PARTS[k] * (later - y)
            there = there / np.linalg.norm(there, axis=1, keepdims=True)
            counts[k] = near_planes(self._T[pair], x, there).sum()
        return counts

    def rays(
        self, pair: tuple[int, int], t: int, u: int, follow: bool
    ) -> tuple[Floats, Floats, Floats]:
        """Return matched rays of two images, (M, 3) each, and the second's a frame on: `next`."""
        a, b = self._features(t, pair[0]), self._features(u, pair[1])
        matches = match_features(a, b)[0]
        # A feature that is lost in the next frame is left out at every part, so that the counts
        # compare.
        later = self._next(u, pair[1]) if follow else b.rays
        kept = matches[np.isfinite(later[matches[:, 1], 0])]
        return a.rays[kept[:, 0]], b.rays[kept[:, 1]], later[kept[:, 1]]

    def next(self, frame: int, camera: int) -> Floats:
        """Return where the points of the features of an image are in the next frame, (K, 3).

        In units of their distance now, so that they move straight; NaN where not known.
        """
        a = self._features(frame, camera)
        moved = np.full_like(a.rays, np.nan)
        b = self._features(frame + 1, camera)
        matches, ratio = match_features(a, b)
        i, j = matches.T
        found = relative_pose(a.rays[i], b.rays[j], ratio)
        if found is None or not found.believable:
            return moved
        near = near_planes(found.T_b_a, a.rays[i], b.rays[j])
        i, j, T = i[near], j[near], found.T_b_a
        # A point at d x in the first frame is at d R x + t = d' y in the second. The cross products
        # with t leave d (R x × t) = d' (y × t).
        both = a.rays[i] @ T.R.T, b.rays[j]
        now, then = (np.linalg.norm(np.cross(rays, T.t), axis=1) for rays in both)
        moved[i] = (now / np.maximum(then, 1e-9)).clip(0.2, 5.0)[:, None] * b.rays[j]
        return moved

    def features(self, frame: int, camera: int) -> Features:
        """Return the features of an image."""
        return self._finder(camera).find(self.images[frame][camera])


def near_planes(T_b_a: Pose, x: Floats, y: Floats) -> NDArray[np.bool_]:
    """Return which pairs of rays (M, 3) lie near the epipolar planes and before both cameras."""
    # The essential matrix E = [t]ₓ R of the rig's own poses judges the matches.
    E = cross((T_b_a.t / np.linalg.norm(T_b_a.t))[None])[0] @ T_b_a.R
    along_x, along_y = depths(T_b_a, x, y)
    near = np.abs(epipolar_residuals(E, x, y)) < _NEAR
    return np.asarray(near & (along_x > 0) & (along_y > 0))
