"""Visual odometry of a rig: its step from one frame to the next, in metres, from images and depth
panoramas.

A feature at unit ray r of a camera at c lies at c + r / q in the frame of the rig; q is read from
the depth panorama. The step T minimises the angles between where such points of one frame should be
seen in the other, and are, both ways.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.geometry.pose import Floats, Pose, nearest_rotation, rotation_from_axis_angle
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.threads import map_threads
from omnistereo_rigs.boards.bundle import cross
from omnistereo_rigs.images.features import FeatureFinder, Features, match_features, match_near
from omnistereo_rigs.images.track_bundle import tangents

# of a feature's ray: pixels of 0.5°, and a rig that is calibrated to as much
_ANGLE_SD = np.radians(0.2)
_SPHERES_SD = 0.7  # of an inverse depth, plus half of what it varies by among its neighbours
_UNKNOWN_SD = 0.15  # 1/m
_SAMPLES, _JUDGES = 300, 300  # triples of matches tried, and matches that judge them
_KEPT = 4  # of the triples
_COARSE = 4  # one of so many features follows the last motion
_INLIER = 3.0  # standard deviations
_LEAST_INLIERS = 60
# What is far agrees with any step: on the drive, 1 to 20 m a step, false ones have up to 0.44 (five
# grids, 64 × 16 to 640 × 160), right ones of up to 5.6 m 0.48 or more.
_LEAST_SHARE = 0.45
_AHEAD = 1.1  # times the inliers of a different step: less is a draw
_FARTHEST = 1e-3  # 1/m, in place of infinity


@dataclass(frozen=True, eq=False)
class Sighting:
    """The features of all cameras in one frame, in the axes of the rig, around its centre."""

    features: Sequence[Features]  #: of each camera; rays in the axes of the rig
    inverse: Sequence[Floats]  #: (K,) each: inverse distance from the camera along the ray, 1/m
    sd: Sequence[Floats]  #: (K,) each: its standard deviation, 1/m

    def some(self, step: int) -> Sighting:
        """Return every so manieth feature of each camera."""
        features = [Features(f.rays[::step], f.descriptors[::step]) for f in self.features]
        return Sighting(features, *([x[::step] for x in xs] for xs in (self.inverse, self.sd)))


class SightingFinder:
    """Finds the features of the images of a rig, and how far they are.

    Args:
        rig: Its origin is the centre of the panoramas.
        grid: Of the panoramas.
    """

    def __init__(self, rig: Rig, grid: SphereGrid) -> None:
        self.rig, self.grid = rig, grid
        self.finders = [*map_threads(FeatureFinder, rig.cameras)]

    def find(
        self,
        images: Sequence[NDArray[np.uint8]],
        inverse_depth: NDArray[np.float32],
        rig: Rig | None = None,
    ) -> Sighting:
        """Return the features of images, at the inverse depth (H, W) around the rig's centre.

        Args:
            rig: If its cameras have turned since.
        """
        inverse_depth = np.maximum(np.nan_to_num(inverse_depth), np.float32(_FARTHEST))
        around = np.ones((3, 3))
        spread = cv2.dilate(inverse_depth, around) - cv2.erode(inverse_depth, around)
        found, inverse, sd = [], [], []
        each = map_threads(FeatureFinder.find, self.finders, images)
        for features, pose in zip(each, (rig or self.rig).T_rig_cam, strict=True):
            rays = features.rays @ pose.R.T
            distance, points = self._distances(inverse_depth, pose.t, rays)
            valid = self.grid.project(points)[1]
            found.append(Features(rays, features.descriptors))
            inverse.append(1 / distance)
            known = _SPHERES_SD * self.grid.step + self._look_up(spread, points) / 2
            sd.append(np.where(valid, known, _UNKNOWN_SD))
        return Sighting(found, inverse, sd)

    def _distances(
        self, inverse_depth: NDArray[np.float32], center: Floats, rays: Floats
    ) -> tuple[Floats, Floats]:
        """Return the distances (K,) from a camera to the surface, and the points there, (K, 3)."""
        along, distance = rays @ center, np.full(len(rays), 10.0)
        for _ in range(6):
            depth = 1 / self._look_up(inverse_depth, center + distance[:, None] * rays)
            distance = np.sqrt(np.maximum(along**2 + depth**2 - center @ center, 0.01)) - along
        distance = np.maximum(distance, 0.1)
        return distance, center + distance[:, None] * rays

    def _look_up(self, panorama: NDArray[np.float32], points: Floats) -> Floats:
        """Return the nearest values of a panorama in the directions of points (K, 3)."""
        return self.grid.look_up(panorama, points)[0].astype(np.float64)


@dataclass(frozen=True, eq=False)
class Step:
    """The motion of the rig from one frame to another."""

    T: Pose  #: of the second frame in the first
    inliers: int
    matches: int
    rival: int = 0  #: inliers of the best step that is another one

    @property
    def sure(self) -> bool:
        """Whether enough matches agree, and clearly more than on any other step."""
        enough = self.inliers >= max(_LEAST_INLIERS, _LEAST_SHARE * self.matches)
        return enough and self.inliers > _AHEAD * self.rival


@dataclass(frozen=True, eq=False)
class _End:
    """What one frame knows of M matches."""

    center: Floats  # (M, 3), of the cameras
    ray: Floats  # (M, 3)
    inverse: Floats  # (M,)
    sd: Floats  # (M,)

    @cached_property
    def basis(self) -> Floats:
        """Two unit vectors across each ray, (M, 2, 3)."""
        return np.swapaxes(tangents(self.ray), 1, 2)

    def points(self) -> Floats:
        return self.center + self.ray / np.maximum(self.inverse, _FARTHEST)[:, None]

    @classmethod
    def join(cls, ends: Sequence[_End]) -> _End:
        parts = zip(*((end.center, end.ray, end.inverse, end.sd) for end in ends), strict=True)
        return cls(*map(np.concatenate, parts))

    def select(self, chosen: NDArray[np.int64]) -> _End:
        return _End(self.center[chosen], self.ray[chosen], self.inverse[chosen], self.sd[chosen])


_Matches = tuple[_End, _End]


def step_anywhere(rig: Rig, a: Sighting, b: Sighting) -> Step:
    """Return the step T_a_b of the rig from frame a to frame b by matches found anywhere."""
    return _refine(rig, a, b, _search(_match(rig, a, b)))


def rig_step(
    rig: Rig, a: Sighting, b: Sighting, last: Pose | None = None, anywhere: Step | None = None
) -> Step:
    """Return the step T_a_b of the rig from frame a to frame b.

    Façades repeat, so the step has several optima. Two are compared by their inliers: that of
    matches found anywhere, and the one near the last motion.

    Args:
        rig: Its origin is the centre of the panoramas.
        last: The step before this one.
        anywhere: The `step_anywhere`, if it is known.
    """
    steps = [anywhere or step_anywhere(rig, a, b)]
    if last is not None:
        # Some of the features tell where it leads; where that is the same step, once is enough.
        some = a.some(_COARSE)
        near, _ = _solve(last, _match(rig, some, b, last, 8.0), (5.0, 3.0))
        if _differ(near, steps[0].T):
            steps.append(_refine(rig, a, b, near))
    best = max(steps, key=lambda step: step.inliers)
    others = [step.inliers for step in steps if _differ(step.T, best.T)]
    return Step(best.T, best.inliers, best.matches, max(others, default=0))


def _differ(T: Pose, other: Pose) -> bool:
    angle, length = (other.inverse() @ T).magnitude()
    return angle > 1.0 or length > 0.5


def _match(
    rig: Rig, a: Sighting, b: Sighting, T: Pose | None = None, gate_deg: float = 0.0
) -> _Matches:
    """Match all cameras with all, anywhere, or near where T and the depth of a put features."""
    ends_a, ends_b = _ends(rig, a), _ends(rig, b)

    def match(pair: tuple[int, int]) -> tuple[_End, _End]:
        i, j = pair
        if T is None:
            found = match_features(a.features[i], b.features[j])[0]
        else:
            toward, gates = _gates(T, ends_a[i], rig.centers[j], gate_deg)
            found = match_near(a.features[i], b.features[j], toward, gates)
        return ends_a[i].select(found[:, 0]), ends_b[j].select(found[:, 1])

    matched = [*map_threads(match, product(range(len(rig)), repeat=2))]
    return _End.join([first for first, _ in matched]), _End.join([second for _, second in matched])


def _ends(rig: Rig, frame: Sighting) -> list[_End]:
    """Return what a frame knows of the features of each camera."""
    seen = zip(rig.centers, frame.features, frame.inverse, frame.sd, strict=True)
    return [
        _End(np.broadcast_to(center, features.rays.shape), features.rays, inverse, sd)
        for center, features, inverse, sd in seen
    ]


def _gates(T: Pose, a: _End, center: Floats, gate_deg: float) -> tuple[Floats, Floats]:
    """Return the rays (M, 3) at which features of a should be seen in b, and how far off, degrees.

    A gate is wider by two standard deviations of what the depth of the feature leaves open.
    """
    toward, by_inverse = _predict(T, a, center)
    length = np.linalg.norm(toward, axis=1)
    rays = toward / length[:, None]
    doubt = a.sd * np.linalg.norm(np.cross(rays, by_inverse), axis=1) / length
    return rays, np.minimum(gate_deg + np.degrees(2 * doubt), 12.0)


class _Motion(NamedTuple):
    """Poses that are tried, unchecked; what follows from them is (K, M, …)."""

    R: Floats  # (K, 3, 3)
    t: Floats  # (K, 1, 3)


def _predict(T: Pose | _Motion, a: _End, center: Floats) -> tuple[Floats, Floats]:
    """Return where points of frame a lie as seen from `center` in frame b, times their inverse
    distance in a, and its derivatives by the inverse distance, (M, 3) each.
    """
    q = a.inverse[:, None]
    from_rig = (q * (a.center - T.t) + a.ray) @ T.R
    return from_rig - q * center, (a.center - T.t) @ T.R - center


def _seen(toward: Floats, b: _End) -> tuple[Floats, Floats]:
    """Return where b sees points, (M, 2) on its rays' tangents, and the derivatives (M, 2, 3)."""
    length = np.maximum(np.linalg.norm(toward, axis=-1), 1e-12)[..., None]
    seen = toward / length
    offset = (b.basis @ seen[..., None])[..., 0]
    return offset, (b.basis - offset[..., None] * seen[..., None, :]) / length[..., None]


def _residuals(T: Pose | _Motion, a: _End, b: _End) -> tuple[Floats, Floats, _End]:
    """Return residuals (M, 2) in standard deviations, what whitens them, (M, 2, 2), and a as both
    frames see it.

    The error of the depth moves the prediction along a line; it is part of the covariance of the
    residual. Where on this line a point most likely lies follows in closed form.
    """
    toward, by_inverse = _predict(T, a, b.center)
    offset, d_seen = _seen(toward, b)
    line = np.einsum("...ki,...i->...k", d_seen, by_inverse) * a.sd[:, None]
    variance = (line**2).sum(axis=-1)
    shrink = (1 / np.sqrt(1 + variance / _ANGLE_SD**2) - 1) / np.maximum(variance, 1e-20)
    outer = shrink[..., None, None] * line[..., None] * line[..., None, :]
    whiten = (np.eye(2) + outer) / _ANGLE_SD
    along = (line * offset).sum(axis=-1) / (variance + _ANGLE_SD**2)
    inverse = np.maximum(a.inverse - a.sd * along.clip(-_INLIER, _INLIER), _FARTHEST)
    residuals = np.einsum("...kj,...j->...k", whiten, offset)
    # Behind, where the tangents do not tell.
    ahead = np.einsum("...i,...i->...", toward, b.ray)
    residuals[ahead < 0.2 * np.linalg.norm(toward, axis=-1)] = 1e3
    return residuals, whiten, replace(a, inverse=inverse)


def _one_way(T: Pose, a: _End, b: _End) -> tuple[Floats, Floats]:
    """Return residuals (M, 2) in standard deviations, and their derivatives (M, 2, 6) by the step.

    Derivatives are taken where the points most likely lie: at the measured depth, its errors would
    shorten the step.
    """
    residuals, whiten, fitted = _residuals(T, a, b)
    toward, _ = _predict(T, fitted, b.center)
    # By the step: T becomes T Exp(rotation, shift).
    q = fitted.inverse[:, None]
    from_rig = (q * (fitted.center - T.t) + fitted.ray) @ T.R
    by_point = whiten @ _seen(toward, b)[1]
    return residuals, np.concatenate([by_point @ cross(from_rig), -q[:, None] * by_point], axis=2)


def _both_ways(T: Pose, matches: _Matches) -> tuple[Floats, Floats]:
    """Return residuals (2M, 2) and derivatives (2M, 2, 6): a's points seen in b, then b's in a."""
    a, b = matches
    forth, d_forth = _one_way(T, a, b)
    back, d_back = _one_way(T.inverse(), b, a)
    # (T Exp(ξ))⁻¹ = T⁻¹ Exp(-Ad ξ)
    adjoint = np.zeros((6, 6))
    adjoint[:3, :3] = adjoint[3:, 3:] = T.R
    adjoint[3:, :3] = cross(T.t[None])[0] @ T.R
    return np.concatenate([forth, back]), np.concatenate([d_forth, -d_back @ adjoint])


def _solve(T: Pose, matches: _Matches, scales: Sequence[float]) -> tuple[Pose, float]:
    """Minimise Geman and McClure's cost by Gauss-Newton; return step and cost, at most 1."""
    cost = np.inf
    for scale in scales if len(matches[0].ray) > 2 else ():
        for _ in range(8):
            residuals, J = _both_ways(T, matches)
            squares = (residuals**2).sum(axis=1) / scale**2
            weights = (1 + squares) ** -2
            cost = float((squares / (1 + squares)).mean())
            weighted = (J * weights[:, None, None]).reshape(-1, 6).T
            H = weighted @ J.reshape(-1, 6) + 1e-6 * np.eye(6)
            d = -np.linalg.solve(H, weighted @ residuals.ravel())
            turn, shift = np.linalg.norm(d.reshape(2, 3), axis=1) + 1e-9
            d *= min(1.0, float(0.5 / turn), float(4.0 / shift))
            T = T @ Pose(rotation_from_axis_angle(d[:3]), d[3:])
            if np.abs(d).max() < 1e-5:
                break
    return T, cost


def _search(matches: _Matches) -> Pose:
    """Find the step without a guess: triples of points laid onto each other, the best adjusted."""
    a, b = matches
    if len(a.ray) < 3:
        return Pose.identity()
    rng = np.random.default_rng(0)
    # points whose place is known
    near = np.minimum(a.inverse / a.sd, b.inverse / b.sd).clip(0.01, 30.0)
    judges = rng.integers(0, len(a.ray), _JUDGES)
    judging = a.select(judges), b.select(judges)
    points, other = a.points(), b.points()
    triples = rng.choice(len(near), (_SAMPLES, 3), p=near / near.sum())
    x, y = points[triples], other[triples]
    to, of = x.mean(axis=1), y.mean(axis=1)
    turns = nearest_rotation(np.swapaxes(x - to[:, None], 1, 2) @ (y - of[:, None]))
    shifts = np.stack([p - R @ q for R, p, q in zip(turns, to, of, strict=True)])
    squares = (_residuals(_Motion(turns, shifts[:, None]), *judging)[0] ** 2).sum(axis=-1) / 10.0**2
    tried = np.argsort((squares / (1 + squares)).mean(axis=1), kind="stable")[:_KEPT]
    best = (_solve(Pose(turns[k], shifts[k]), judging, (30.0, 10.0)) for k in tried)
    return min(best, key=lambda found: found[1])[0]


def _refine(rig: Rig, a: Sighting, b: Sighting, T: Pose) -> Step:
    """Match again near where a step puts the features, and adjust it."""
    matches = _match(rig, a, b, T, 3.0)
    T, _ = _solve(T, matches, (5.0, 3.0))
    inlier = (_both_ways(T, matches)[0] ** 2).sum(axis=1) < _INLIER**2
    return Step(T, int(inlier.reshape(2, -1).all(axis=0).sum()), len(matches[0].ray))
