"""Matches between the pictures of one moment, kept as pixels: the evidence for or against any
hypothesis.

Any lens, pose, order or rotation of a picture explains some of them, and how many is its score.

Nothing is matched again for a hypothesis. SIFT does not care about rotations, so a picture that is
turned by 180° has the same matches at other pixels; only for mirrored pictures there is a second
set, found when it is first asked for.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Floats, Pose
from omnistereo_lib.geometry.rig import Pair, Rig
from omnistereo_rigs.images.features import FeatureFinder, Features, match_features
from omnistereo_rigs.images.from_images import find_features
from omnistereo_rigs.images.relative_pose import RelativePose, relative_pose

# A match is explained if it is within this sine of its epipolar plane.
LIMIT = float(
    np.sin(np.radians(0.3))
)  # of the angle to an epipolar plane; lenses of real files are off by about as much
# A cosine: rays that meet at more than 120° are not of one thing that both could match.
_NARROWEST = -0.5
# The usual error of a match, as a sine.
_USUAL = float(np.sin(np.radians(0.1)))
# The unit cube is cut into so many cells along each axis. Matches within one are not independent.
_CELL = 4


@dataclass(frozen=True, order=True)
class Flip:
    """How a picture was mirrored left to right, and then rotated, in quarter turns clockwise."""

    quarters: int = 0
    mirrored: bool = False

    @property
    def name(self) -> str:
        """In words, "" if nothing was done."""
        words = ["mirrored"] * self.mirrored + [f"turned by {90 * self.quarters}°"] * (
            self.quarters > 0
        )
        return " and ".join(words)

    def undo(self, pixels: Floats, size: tuple[int, int]) -> Floats:
        """Return where pixels (..., 2) lie in the picture that the camera took."""
        # About the centre of the picture: turn back by quarters, then mirror back. This is the
        # reverse order of the changes.
        middle = (np.array(size) - 1) / 2
        x, y = np.moveaxis(pixels - middle, -1, 0)
        for _ in range(self.quarters):
            x, y = y, -x
        return np.stack([-x if self.mirrored else x, y], axis=-1) + middle


def flips(size: tuple[int, int]) -> list[Flip]:
    """Return what may have been done to a picture that leaves its size, nothing first."""
    quarters = range(4) if size[0] == size[1] else (0, 2)
    return [Flip(quarter, mirrored) for mirrored in (False, True) for quarter in quarters]


@dataclass(frozen=True, eq=False)
class Matches:
    """Matches of two pictures: pixels (M, 2) in each, and how sure they are (low is sure)."""

    first: Floats
    second: Floats
    ratio: Floats


@dataclass(eq=False)
class Evidence:
    """What pictures of one moment have in common."""

    cameras: Sequence[OcamCamera]
    images: Sequence[NDArray[np.uint8]]
    features: list[Features] = field(init=False)

    def __post_init__(self) -> None:
        self.features = find_features(self.cameras, [self.images])[0]
        # Rays that were computed once are kept by camera, pair and side, since many hypotheses
        # share them.
        self._rays: dict[tuple[int, Pair, int], tuple[OcamCamera, Floats]] = {}
        self._pixels = [
            c.project(f.rays)[0] for c, f in zip(self.cameras, self.features, strict=True)
        ]

    @cached_property
    def plain(self) -> dict[Pair, Matches]:
        """Matches of each pair of pictures as they are."""
        return {(i, j): self._match(self.features[i], self._pixels[i], j) for i, j in self._pairs}

    @cached_property
    def mirrored(self) -> dict[Pair, Matches]:
        """Matches of each pair of pictures if one of the two is mirrored."""
        found: dict[Pair, Matches] = {}
        # The first picture of each pair is mirrored before its features are found, and their pixels
        # are then counted in the picture as it was given.
        for i, camera in enumerate(self.cameras[:-1]):
            features = FeatureFinder(camera).find(np.ascontiguousarray(self.images[i][:, ::-1]))
            pixels = Flip(mirrored=True).undo(camera.project(features.rays)[0], camera.image_size)
            found |= {
                (i, j): self._match(features, pixels, j) for j in range(i + 1, len(self.cameras))
            }
        return found

    @property
    def _pairs(self) -> list[Pair]:
        return list(combinations(range(len(self.cameras)), 2))

    def _match(self, features: Features, pixels: Floats, other: int) -> Matches:
        matches, ratio = match_features(features, self.features[other])
        return Matches(pixels[matches[:, 0]], self._pixels[other][matches[:, 1]], ratio)

    def relative_poses(self) -> dict[Pair, RelativePose]:
        """Return the believable relative poses of pairs of cameras, without any prior."""
        # RANSAC without any prior; pairs that agree on nothing are left out.
        found = {
            pair: relative_pose(*self.rays(self.cameras, pair), self.plain[pair].ratio)
            for pair in self._pairs
        }
        return {pair: pose for pair, pose in found.items() if pose is not None and pose.believable}

    def rays(self, cameras: Sequence[OcamCamera], pair: Pair) -> tuple[Floats, Floats]:
        """Return the unit rays (M, 3) of a pair's matches, seen through these cameras."""
        i, j = pair
        return self._seen(cameras[i], pair, 0), self._seen(cameras[j], pair, 1)

    def _seen(self, camera: OcamCamera, pair: Pair, side: int) -> Floats:
        known, key = self._rays, (id(camera), pair, side)
        if key not in known or known[key][0] is not camera:
            found = self.plain[pair]
            known[key] = camera, unit_rays(camera, (found.first, found.second)[side])
        return known[key][1]

    def counts(self, rig: Rig) -> Floats:
        """Return how many matches of each pair a rig explains, (cameras, cameras), symmetric."""
        table = np.zeros((len(rig), len(rig)))
        for i, j in self._pairs:
            x, y = self.rays(rig.cameras, (i, j))
            table[i, j] = table[j, i] = explained(rig.T_rig_cam[i], rig.T_rig_cam[j], x, y).sum()
        return table

    def preference(self, rig: Rig, other: Rig) -> float:
        """Return by how many standard errors the matches, one a cell, prefer another rig."""
        gain, cells = [], []
        for k, (i, j) in enumerate(self._pairs):
            x, y = self.rays(rig.cameras, (i, j))
            # How well a match fits, from 1 at no error to 0: 1 / (1 + (error / usual)²), so gross
            # errors hardly differ between the rigs.
            costs = [
                1 / (1 + (off_plane(one.T_rig_cam[i], one.T_rig_cam[j], x, y) / _USUAL) ** 2)
                for one in (rig, other)
            ]
            gain.append(costs[1] - costs[0])
            cells.append(np.column_stack([np.full(len(x), k), np.floor(_CELL * x)]))
        # Sums over cells of the pair's rays. If the two rigs were equally good, the sums would be
        # of either sign, and their total would have the standard error √Σ sum².
        of_cells = np.unique(np.concatenate(cells), axis=0, return_inverse=True)[1].ravel()
        sums = np.bincount(of_cells, np.concatenate(gain))
        return float(sums.sum() / max(float(np.sqrt((sums**2).sum())), 1e-12))

    def totals(self) -> Floats:
        """Return the number of matches of each pair, (cameras, cameras), symmetric."""
        table = np.zeros((len(self.cameras), len(self.cameras)))
        for (i, j), found in self.plain.items():
            table[i, j] = table[j, i] = len(found.ratio)
        return table


def unit_rays(camera: OcamCamera, pixels: Floats) -> Floats:
    """Return the rays (M, 3) of pixels; NaN outside the image."""
    return np.asarray(camera.unproject(pixels)[0], np.float64)


def explained(a: Pose, b: Pose, x: Floats, y: Floats) -> NDArray[np.bool_]:
    """Return which matched rays (M, 3) of two cameras meet in front of both, within `LIMIT`."""
    return off_plane(a, b, x, y) < LIMIT


def off_plane(a: Pose, b: Pose, x: Floats, y: Floats) -> Floats:
    """Return the sines (M,) by which matched rays (M, 3) of two cameras, T_rig_cam, miss each
    other's epipolar plane.

    Of the two angles the larger; 1 if the rays do not meet in front of both cameras.
    """
    # In the rig's axes, with u the unit baseline: (x × y) · u is the volume that x, y and u span.
    # It is 0 if they lie in one plane, and divided by |u × x| it is the sine of the angle of y to
    # the plane of u and x. The shorter of |u × x| and |u × y| gives the larger sine.
    x, y = x @ a.R.T, y @ b.R.T
    baseline = b.t - a.t
    length = max(float(np.linalg.norm(baseline)), 1e-12)
    u, cosine = baseline / length, np.einsum("mi,mi->m", x, y)
    shorter = np.minimum(*(np.linalg.norm(np.cross(u, ray), axis=1) for ray in (x, y)))
    sines = np.abs(np.cross(x, y) @ u) / np.maximum(shorter, 1e-9)
    along_x, along_y = x @ u, y @ u
    # Where the rays are nearest to each other, times a positive factor; far points may lie just
    # behind.
    ahead = (along_x - cosine * along_y > -LIMIT) & (cosine * along_x - along_y > -LIMIT)
    return np.asarray(np.where(ahead & (cosine > _NARROWEST), sines, 1.0))
