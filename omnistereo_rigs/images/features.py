"""Features of fisheye images as rays, matches, and tracks of points through several images.

SIFT runs on tangent views of the sphere, so any lens and any rotation between the cameras will do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Floats, Pose
from omnistereo_rigs.boards.params import Ints

# The whole sphere is seen in so many views: no direction is more than 28° from the middle of one.
_VIEWS = 32
# Beyond those 28° a view has room for a descriptor.
_HALF_VIEW_DEG = 34.0
_MOST_PER_VIEW = 250
# The resolution of a view. More pixels cost time, and `patches` returns to the image anyway.
_MAX_PX_PER_DEG = 4.0
# The best descriptor has to be so much nearer than the second best that is somewhere else.
_RATIO = 0.85
# The same among those near a predicted direction.
_RATIO_NEAR = 0.9
# Two descriptors nearer than this are of one thing, and no rivals.
_SAME_DEG = 1.5
# The largest parallax of a match between cameras with poses.
_FARTHEST_DEG = 40.0


@dataclass(frozen=True, eq=False)
class Features:
    """What was found in one image."""

    rays: Floats  # (K, 3), unit, camera frame
    # (K, 128), unit: square roots of SIFT's (Arandjelović, Zisserman 2012)
    descriptors: NDArray[np.float32]


def in_gray(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return an image, (H, W[, 3]) uint8, in gray."""
    if image.ndim == 2:
        return image
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY), np.uint8)


class FeatureFinder:
    """Finds features in the images of one camera, which it looks at through tangent views.

    Args:
        camera: Its mask and field of view are kept.
    """

    def __init__(self, camera: OcamCamera) -> None:
        self.camera = camera
        resolution = min(1.1 * camera.pixels_per_degree, _MAX_PX_PER_DEG)
        self.focal = np.degrees(resolution)  # pixels
        self.middle = np.ceil(self.focal * np.tan(np.radians(_HALF_VIEW_DEG)))
        pixels = np.stack(np.meshgrid(*[np.arange(2 * self.middle + 1)] * 2), -1)
        rays = np.moveaxis(self._rays(pixels, np.eye(3)), -1, 0)  # (3, h, w), axes of a view
        axes = _sphere_directions(_VIEWS)
        # rotation view → camera, pixels in the image, where they are valid and no view sees better
        self.views = []
        for axis in axes:
            R = _rotation_to(axis)
            uv, valid = camera.project(np.moveaxis(np.tensordot(R, rays, 1), 0, -1))
            if valid.mean() > 0.02:
                # Only views whose axes are less than twice 28° away have a border with it.
                rivals = axes[axes @ axis > np.cos(np.radians(57))] - axis
                nearest = (np.tensordot(rivals @ R, rays, 1).max(0) <= 1e-12).astype(np.uint8)
                # no edge of the image
                inside = cv2.erode(valid.astype(np.uint8), np.ones((9, 9)), borderValue=0)
                if (inside & nearest).any():
                    self.views.append((R, uv.astype(np.float32), inside & nearest))

    def find(self, image: NDArray[np.uint8]) -> Features:
        """Return the features of an image, (H, W[, 3]) uint8, each by its best view."""
        gray = in_gray(image)
        sift: Any = cv2.SIFT_create(  # type: ignore[attr-defined]  # OpenCV's stubs lack it
            _MOST_PER_VIEW,
            contrastThreshold=0.008,
            # or keypoints lie a quarter of a pixel to the right and below
            enable_precise_upscale=True,
        )
        rays, descriptors = [np.zeros((0, 3))], [np.zeros((0, 128), np.float32)]
        # None: with an empty array in its place OpenCV 5.0 samples nonsense in other modes
        no_second: Any = None
        for R, uv, inside in self.views:
            # Cubic moves a ramp by up to .048 px (OpenCV 5.0: a = -.75), linear by nothing, yet its
            # poses are not clearly better. In 18 frames of seven samples, in the same time, it has
            # 1.15 × the matches, and smaller errors of rotation in 51 of 95 pairs, 7 of 10 measured
            # rigs, and 7 of 15 steps of a drive; a B-spline (SciPy 1.17), in 1.36 × the time, 54, 7
            # and 7.
            view = cv2.remap(gray, uv, no_second, cv2.INTER_CUBIC)
            keypoints, found = sift.detectAndCompute(view, inside)
            if keypoints:
                rays.append(self._rays(np.array([k.pt for k in keypoints]), R))
                # RootSIFT: square roots of descriptors of sum 1 have length 1, so their dot product
                # tells their distance, |a - b|² = 2 - 2 a · b.
                descriptors.append(np.sqrt(found / found.sum(axis=1, keepdims=True)))
        return Features(np.concatenate(rays), np.concatenate(descriptors))

    def _rays(self, pixels: Floats, R: Floats) -> Floats:
        """Return the unit rays of pixels (..., 2) of a view."""
        xy = (pixels - self.middle) / self.focal
        rays = np.concatenate([xy, np.ones((*xy.shape[:-1], 1))], axis=-1) @ R.T
        return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


def match_features(
    a: Features, b: Features, T_b_a: Pose | None = None, band_deg: float = 1.5
) -> tuple[Ints, Floats]:
    """Return pairs of indices (M, 2) into two sets, and ratios to the second best, low is sure.

    Each is the other's best match, and the second best, somewhere else, is clearly worse.

    Args:
        T_b_a: If given, the poses: a match is at most `band_deg` from its epipolar plane.
    """
    none = np.zeros((0, 2), np.int64), np.zeros(0)
    if min(len(a.rays), len(b.rays)) < 8:
        return none
    similar = a.descriptors @ b.descriptors.T
    if T_b_a is not None:
        # The epipolar plane of a ray x holds R x and t, so its normal is R x × t. Only what is near
        # the plane may match, and nothing that would need more parallax than there can be.
        there = a.rays @ T_b_a.R.T
        normals = np.cross(there, T_b_a.t)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        off_plane = np.abs((normals @ b.rays.T).astype(np.float32)) > np.sin(np.radians(band_deg))
        angles = (there @ b.rays.T).astype(np.float32)
        too_far = angles < np.cos(np.radians(_FARTHEST_DEG + band_deg))
        similar[off_plane | too_far] = -1.0
    # The best match of the best match has to be where we came from, if not the same feature.
    best, back = similar.argmax(axis=1), similar.argmax(axis=0)
    limit = np.cos(np.radians(_SAME_DEG))
    mutual = np.einsum("ki,ki->k", a.rays[back[best]], a.rays) > limit
    first = np.flatnonzero(mutual)
    similar, best = similar[first], best[first]
    # The second best among the next four: the others may be the same thing at another scale.
    rows = np.arange(len(first))
    candidates, values = np.zeros((len(rows), 5), np.int64), np.zeros((len(rows), 5), np.float32)
    for k in range(5):
        candidates[:, k] = similar.argmax(axis=1) if k else best
        values[:, k] = similar[rows, candidates[:, k]]
        similar[rows, candidates[:, k]] = -2.0
    same = np.einsum("kci,ki->kc", b.rays[candidates], b.rays[best]) > limit
    second = np.where(same, -1.0, values).max(axis=1)
    # Lowe's ratio test (2004), with the rival somewhere else.
    both = values[:, 0], np.maximum(second, 0)
    distance, rival = (np.sqrt(np.maximum(2 - 2 * value, 0)) for value in both)
    ratio = distance / np.maximum(rival, 1e-9)
    chosen = np.flatnonzero((ratio < _RATIO) & (values[:, 0] > 0))
    # One match for each feature of b.
    chosen = chosen[np.argsort(ratio[chosen], kind="stable")]
    chosen = chosen[np.unique(best[chosen], return_index=True)[1]]
    return np.stack([first[chosen], best[chosen]], axis=1), ratio[chosen]


def match_near(a: Features, b: Features, predicted: Floats, gates_deg: Floats) -> Ints:
    """Return pairs of indices (M, 2) that are each other's best match near a predicted direction.

    Only what lies in the gates is compared, so that thousands of features take milliseconds.

    Args:
        predicted: Where the features of a should be seen: unit rays (K, 3) in the frame of b.
        gates_deg: How far from there at most, (K,).
    """
    if min(len(a.rays), len(b.rays)) == 0:
        return np.zeros((0, 2), np.int64)
    # The tree knows straight distances: two unit vectors at angle γ are 2 sin(γ/2) apart.
    chords = 2 * np.sin(np.radians(gates_deg) / 2)
    near = cKDTree(b.rays).query_ball_point(predicted, chords)
    i = np.repeat(np.arange(len(near)), [len(one) for one in near])
    j = np.fromiter(chain.from_iterable(near), np.int64, len(i))
    cosine = np.einsum("kd,kd->k", a.descriptors[i], b.descriptors[j])
    distance = np.sqrt(np.maximum(2 - 2 * cosine, 0))
    # The best of each feature of a, and the second best somewhere else.
    order = np.lexsort((distance, i))
    i, j, distance = i[order], j[order], distance[order]
    first = np.flatnonzero(np.diff(i, prepend=-1))
    best = np.repeat(first, np.diff(np.append(first, len(i))))
    same = np.einsum("kd,kd->k", b.rays[j], b.rays[j[best]]) > np.cos(np.radians(_SAME_DEG))
    rival = np.full(len(a.rays), np.sqrt(2.0))
    np.minimum.at(rival, i[~same], distance[~same])
    # The best of each feature of b.
    back = np.full(len(b.rays), np.inf)
    np.minimum.at(back, j, distance)
    mutual = distance[first] <= back[j[first]]
    chosen = first[mutual & (distance[first] < _RATIO_NEAR * rival[i[first]])]
    return np.stack([i[chosen], j[chosen]], axis=1)


@dataclass(frozen=True, eq=False)
class Tracks:
    """M observations of points, each by two cameras or more at one moment."""

    camera: Ints  # (M,), as the next two: indices from 0
    frame: Ints
    point: Ints
    pixels: Floats  # (M, 2)

    @property
    def num_points(self) -> int:
        """Number of points."""
        return int(self.point.max(initial=-1)) + 1

    @property
    def point_frame(self) -> Ints:
        """The frame of each point, shape (points,)."""
        frames = np.zeros(self.num_points, np.int64)
        frames[self.point] = self.frame
        return frames

    def select(self, keep: NDArray[np.bool_]) -> Tracks:
        """Return observations where `keep` (M,), of points that still have two, numbered anew."""
        counts = np.bincount(self.point[keep], minlength=self.num_points)
        keep = keep & (counts[self.point] > 1)
        points = np.unique(self.point[keep], return_inverse=True)[1]
        return Tracks(self.camera[keep], self.frame[keep], points, self.pixels[keep])


def join_tracks(
    cameras: Sequence[OcamCamera],
    features: Sequence[Sequence[Features]],
    matches: Sequence[Mapping[tuple[int, int], Ints]],
) -> Tracks:
    """Join pairwise matches to tracks; one that has two features of one camera is dropped.

    Args:
        features: features[frame][camera]
        matches: For each frame, (camera, camera) → pairs of indices (M, 2).
    """
    parts, first_point = [], 0
    for frame, (found, pairs) in enumerate(zip(features, matches, strict=True)):
        # All features of a frame get one numbering. Matches are the edges of a graph, and each of
        # its connected pieces is a track.
        start = np.concatenate([[0], np.cumsum([len(one.rays) for one in found])])
        edges = np.concatenate(
            [np.zeros((0, 2), int), *(m + start[[i, j]] for (i, j), m in pairs.items())]
        )
        graph = coo_matrix((np.ones(len(edges)), edges.T), (start[-1], start[-1]))
        label = connected_components(graph, directed=False)[1]
        camera = np.repeat(np.arange(len(found)), np.diff(start))
        # One number per track and camera: a track that has a number twice would see a point at two
        # places.
        slot, count = np.unique(label * len(found) + camera, return_counts=True)
        twice = np.isin(label, slot[count > 1] // len(found))
        used = (np.bincount(label)[label] > 1) & ~twice
        seen = [c.project(one.rays)[0] for c, one in zip(cameras, found, strict=True)]
        pixels = np.concatenate(seen)
        point = np.unique(label[used], return_inverse=True)[1] + first_point
        first_point = point.max(initial=first_point - 1) + 1
        parts.append((camera[used], np.full(used.sum(), frame), point, pixels[used]))
    return Tracks(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _sphere_directions(count: int) -> Floats:
    """Return evenly spread directions (count, 3): a Fibonacci spiral, from ahead to behind."""
    k = np.arange(count)
    z = 1 - (2 * k + 1) / count
    angle = np.pi * (1 + np.sqrt(5)) * k
    n = np.sqrt(1 - z**2)
    return np.stack([n * np.cos(angle), n * np.sin(angle), z], axis=1)


def _rotation_to(axis: Floats) -> Floats:
    """Return a rotation whose third column is a unit vector."""
    x = np.cross([0.0, 1.0, 0.0] if abs(axis[1]) < 0.9 else [0.0, 0.0, 1.0], axis)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x), axis], axis=1)
