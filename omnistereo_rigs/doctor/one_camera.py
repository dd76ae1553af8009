"""One camera that does not fit the others: its pose, or its focal length, freed by itself, the
others held as they are.

An adjustment of all cameras spreads the error of one over all of them; freeing one at a time names
it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Floats, Pose, rotation_from_axis_angle
from omnistereo_lib.geometry.rig import Pair, Rig
from omnistereo_rigs.doctor.evidence import Evidence
from omnistereo_rigs.images.relative_pose import RelativePose
from omnistereo_rigs.images.track_bundle import mean_baseline

# In radians, the scale of the robust cost.
_NOISE = 1e-3
# In mean baselines: a camera that fits only farther off than this fits nowhere.
_FARTHEST = 1e3
# Factors of a focal length, in steps of 1 %.
_SCALES = np.exp(np.linspace(-0.35, 0.35, 71))


@dataclass(frozen=True, eq=False)
class Freed:
    """A rig with one camera put where the matches want it, or with other focal lengths."""

    rig: Rig
    cameras: tuple[int, ...]  # those that were freed
    score: float  # matches explained, of all pairs
    scale: float = 1.0  # of the focal length


def free_poses(evidence: Evidence, rig: Rig, pairs: dict[Pair, RelativePose]) -> list[Freed]:
    """Return for each camera the rig with its pose freed, the best first."""
    found = [_free_pose(evidence, rig, k, pairs) for k in range(len(rig))]
    return sorted(found, key=lambda one: -one.score)


def free_focal_lengths(evidence: Evidence, rig: Rig) -> list[Freed]:
    """Return the rig with each focal length freed, and with all alike, the best first."""
    everyone = tuple(range(len(rig)))
    found = []
    for cameras in (*((k,) for k in everyone), everyone):
        tried = []
        for scale in _SCALES:
            lenses = [
                scaled_lens(c, scale) if k in cameras else c for k, c in enumerate(rig.cameras)
            ]
            other = replace(rig, cameras=tuple(lenses))
            score = float(evidence.counts(other).sum() / 2)
            tried.append(Freed(other, cameras, score, float(scale)))
        found.append(max(tried, key=lambda one: one.score))
    return sorted(found, key=lambda one: -one.score)


def scaled_lens(camera: OcamCamera, scale: float) -> OcamCamera:
    """Return a camera whose focal length is multiplied by a factor."""
    powers = np.arange(len(camera.poly))
    return replace(
        camera, poly=camera.poly * scale ** (1.0 - powers), inv_poly=camera.inv_poly * scale
    )


def _free_pose(evidence: Evidence, rig: Rig, k: int, pairs: dict[Pair, RelativePose]) -> Freed:
    """Return the rig with camera k where its matches with the others want it."""
    # Its rays in its own axes, those of the others in the rig's: only the pose of camera k is
    # unknown.
    others = [j for j in range(len(rig)) if j != k]
    seen = []  # rays of camera k, rays of the other in the rig frame, centre of the other
    for j in others:
        x, y = evidence.rays(rig.cameras, (min(j, k), max(j, k)))
        mine, its = (x, y) if k < j else (y, x)
        R, t = rig.T_rig_cam[j].R, rig.T_rig_cam[j].t
        seen.append((mine, its @ R.T, np.broadcast_to(t, mine.shape)))
    x, y, c = (np.concatenate(part) for part in zip(*seen, strict=True))
    best = Freed(rig, (k,), float(evidence.counts(rig).sum() / 2))
    if len(x) < 12:
        return best
    # From the pose as given, and from where relative poses put it; matches explained tell which is
    # best.
    for start in [rig.T_rig_cam[k], *_starts(rig, k, pairs)]:
        pose = _fit(start, x, y, c)
        if np.abs(pose.t - rig.centers).max() > _FARTHEST * mean_baseline(rig.centers):
            continue
        moved = rig.with_poses([pose if i == k else T for i, T in enumerate(rig.T_rig_cam)])
        score = float(evidence.counts(moved).sum() / 2)
        if score > best.score:
            best = Freed(moved, (k,), score)
    return best


def _starts(rig: Rig, k: int, pairs: dict[Pair, RelativePose]) -> list[Pose]:
    """Return poses of camera k from its relative poses: rotations, and where their lines meet."""
    rotations, A, b = [], 1e-3 * np.eye(3), 1e-3 * rig.T_rig_cam[k].t
    for pair, found in pairs.items():
        if k in pair:
            j = sum(pair) - k
            T = found.T_b_a if pair[0] == k else found.T_b_a.inverse()  # camera k → camera j
            R = rig.T_rig_cam[j].R
            rotations.append((found.inliers, R @ T.R))
            line = R @ T.t / max(float(np.linalg.norm(T.t)), 1e-12)
            # The centre lies on a line through camera j. Minimise Σ w |(I - l lᵀ) (c - c_j)|² over
            # all lines; a little weight on the given centre decides where all lines are parallel.
            across = found.inliers * (np.eye(3) - np.outer(line, line))
            A, b = A + across, b + across @ rig.T_rig_cam[j].t
    rotations.sort(key=lambda one: -one[0])
    return [Pose(R, np.asarray(np.linalg.solve(A, b), np.float64)) for _, R in rotations[:2]]


def _fit(start: Pose, x: Floats, y: Floats, c: Floats) -> Pose:
    """Return the pose of a camera whose rays x (M, 3) meet rays y from centres c, rig frame."""

    def pose(p: Floats) -> Pose:
        return Pose(rotation_from_axis_angle(p[:3]) @ start.R, start.t + p[3:])

    def residuals(p: Floats) -> Floats:
        now = pose(p)
        seen, baseline = x @ now.R.T, now.t - c
        u = baseline / np.maximum(np.linalg.norm(baseline, axis=1, keepdims=True), 1e-9)
        # As in `off_plane`, with the baseline from each other camera to this one.
        shorter = np.minimum(*(np.linalg.norm(np.cross(u, ray), axis=1) for ray in (seen, y)))
        volume = np.einsum("mi,mi->m", np.cross(seen, y), u)
        return np.asarray(volume / np.maximum(shorter, 1e-3) / _NOISE)

    return pose(least_squares(residuals, np.zeros(6), loss="cauchy", max_nfev=40).x)


def fitted_share(evidence: Evidence, rig: Rig, without: Sequence[int]) -> tuple[float, float]:
    """Return the shares of matches explained in pairs with and in pairs without some cameras."""
    counts, totals = evidence.counts(rig), evidence.totals()
    with_them = np.zeros(counts.shape, bool)
    with_them[list(without)] = with_them[:, list(without)] = True
    return _share(counts, totals, with_them), _share(counts, totals, ~with_them)


def _share(counts: Floats, totals: Floats, which: NDArray[np.bool_]) -> float:
    return float(counts[which].sum() / max(totals[which].sum(), 1.0))
