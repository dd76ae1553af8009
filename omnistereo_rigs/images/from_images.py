"""A rig measured from ordinary images, without a board: what cameras share tells the poses.

`find_pairs` needs no poses at all, `measure_rig` adjusts all cameras over all frames together.
"""

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import combinations, repeat
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Floats, Pose
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.progress import Progress, counted, silent
from omnistereo_rigs.images.features import (
    FeatureFinder,
    Features,
    Tracks,
    join_tracks,
    match_features,
)
from omnistereo_rigs.images.patches import refine_tracks
from omnistereo_rigs.images.relative_pose import RelativePose, relative_pose
from omnistereo_rigs.images.track_bundle import HALF_SCALE, TrackBundle, moved_rig, pose_differences

Images = Sequence[Sequence[NDArray[np.uint8]]]  # images[frame][camera]
# what the poses are that a measurement starts from
Given = Literal["calibration", "nominal", "nothing"]

# By how much nominal centres are off, as a share of the radius of the rig (one standard deviation).
_NOMINAL_SHARE = 0.03
# The same for a calibration: its rotations in radians, its centres as a share of the radius.
_FILE_TURN, _FILE_SHARE = np.radians(0.15), 0.01
# Matches are looked for within this many degrees of the epipolar planes of the given poses.
_NOMINAL_BAND_DEG, _FILE_BAND_DEG = 6.0, 1.5
_SECTOR_DEG = 30.0
# Fewer points, or fewer cells with points, give no honest uncertainty.
_FEW_POINTS, _FEW_CELLS = 300, 60
# The error of a lens is at least this. χ² over 11 frames gave it for exact lenses and rendered
# pictures.
_LENS_PX = 0.05
# Poses cannot be found from fewer points.
_FEWEST = 30
# Centres that are known less well than this share of the radius are refused.
_MOST_CENTRE_SHARE = 0.02


@dataclass(frozen=True, eq=False)
class MeasuredRig:
    """A rig as its images have it."""

    rig: Rig  # in the frame and of the size of the given one
    # (cameras, 6) from the given rig: rotation in radians, shift in metres, see `pose_differences`
    differences: Floats
    # (6 · cameras, 6 · cameras) of the differences, the error of the lenses included
    covariance: Floats
    points: Floats  # (N, 4): unit direction from the middle of the rig, inverse distance in 1/m
    num_cells: int  # of 15° by 15° in a frame, that have a point
    sigma_px: float  # noise of the observations
    lens_px: float  # error of the lenses, pixels, that the covariance allows for

    @property
    def num_points(self) -> int:
        """Number of points that cameras share."""
        return len(self.points)

    def depth_quantile(self, share: float) -> float:
        """Return the distance in metres than which a share of the points is nearer."""
        return 1 / max(float(np.quantile(self.points[:, 3], 1 - share)), 1e-6)

    @property
    def deviations(self) -> Floats:
        """Standard deviations of rotation in degrees and of centre in metres, (cameras, 2)."""
        blocks = np.diag(self.covariance).reshape(-1, 2, 3)
        return np.sqrt(blocks.sum(axis=2)) * [180 / np.pi, 1.0]

    def more_than_a_knock(self) -> int | None:
        """Return the camera, from 0, that has moved by more than a calibration may be off; None if
        none has: beyond three standard deviations of what is supposed of a calibration.
        """
        limits = 3 * np.array([np.degrees(_FILE_TURN), _FILE_SHARE * _radius(self.rig)])
        beyond = (self.changes / limits).max(axis=1)
        return int(beyond.argmax()) if beyond.max() > 1 else None

    def unknown_centres(self) -> bool:
        """Return whether the centres of a calibration stay, since the images tell less than it."""
        before = np.sqrt(3) * _FILE_SHARE * _radius(self.rig)
        return float(self.deviations[:, 1].max()) > 0.7 * before

    @property
    def changes(self) -> Floats:
        """Rotation in degrees and shift in metres from the given rig, (cameras, 2)."""
        return np.linalg.norm(self.differences.reshape(-1, 2, 3), axis=2) * [180 / np.pi, 1.0]

    def refusals(self) -> list[str]:
        """Return what the images do not show, in words with numbers; empty if they show all."""
        found = []
        if self.num_points < _FEW_POINTS or self.num_cells < _FEW_CELLS:
            found.append(
                f"{self.num_points} points in {self.num_cells} cells of 15° are too few; expected"
                f" {_FEW_POINTS} in {_FEW_CELLS}. Give more frames, or frames with more texture"
            )
        sd, limit = self.deviations[:, 1], _MOST_CENTRE_SHARE * _radius(self.rig)
        if sd.max() > limit:
            found.append(
                f"the centre of camera {sd.argmax() + 1} is known to ±{1000 * sd.max():.2g} mm"
                f" only, the limit is {1000 * limit:.2g} mm: nine tenths of the points are beyond"
                f" {self.depth_quantile(0.1):.3g} m. Drive near things"
            )
        return found


def find_features(
    cameras: Sequence[OcamCamera], images: Images, progress: Progress = silent
) -> list[list[Features]]:
    """Return the features of all images: features[frame][camera]."""
    step, found = counted(progress, len(images)), []
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        finders = [*threads.map(FeatureFinder, cameras)]
        for number, row in enumerate(images, 1):
            step(f"features of frame {number}")
            found.append([*threads.map(FeatureFinder.find, finders, row)])
    step("")
    return found


def find_pairs(features: Sequence[Sequence[Features]]) -> dict[tuple[int, int], RelativePose]:
    """Return the believable relative poses of pairs, from the matches of all frames alone."""
    # All frames vote together, since the cameras do not move against each other.
    pairs = {}
    for i, j in combinations(range(len(features[0])), 2):
        rays, ratios = [], []
        for row in features:
            matches, ratio = match_features(row[i], row[j])
            rays.append(np.stack([row[i].rays[matches[:, 0]], row[j].rays[matches[:, 1]]]))
            ratios.append(ratio)
        x, y = np.concatenate(rays, axis=1)
        found = relative_pose(x, y, np.concatenate(ratios))
        if found is not None and found.believable:
            pairs[i, j] = found
    return pairs


def relative_poses(rig: Rig) -> dict[tuple[int, int], RelativePose]:
    """Return the relative poses of all pairs of a rig, as if all matches agreed on them."""
    found = {}
    for i, j in combinations(range(len(rig)), 2):
        T = rig.T_rig_cam[j].inverse() @ rig.T_rig_cam[i]
        length = max(float(np.linalg.norm(T.t)), 1e-12)
        found[i, j] = RelativePose(Pose(T.R, T.t / length), 1000, 1000)
    return found


def chain_poses(pairs: Mapping[tuple[int, int], RelativePose], count: int) -> list[Pose]:
    """Return T_rig_cam in the frame of camera 1 from relative poses, with cameras about 1 apart.

    Rotations follow the tree of the pairs with most inliers; centres are those whose differences
    point as the pairs say, of about equal lengths where that leaves a choice.

    Raises:
        OmnistereoError: If the pairs do not connect all cameras.
    """
    # The shortest tree has the surest pairs: the more matches agree on a pose, the shorter its
    # edge.
    weight = np.zeros((count, count))
    for pair, found in pairs.items():
        weight[pair] = 1 / found.inliers
    tree = minimum_spanning_tree(weight)
    order, parents = breadth_first_order(tree + tree.T, 0, directed=False)
    if len(order) < count:
        lost = ", ".join(str(i + 1) for i in sorted(set(range(count)) - set(order.tolist())))
        raise OmnistereoError(
            f"too few matches connect camera {lost} to camera 1. Give more frames, or frames with"
            " more texture, and check that neighbouring cameras see something in common"
        )
    # Rotations along the tree: from camera i to its child j, R_j = R_i R_i←j.
    R = [np.eye(3)] * count
    for j in order[1:]:
        i = int(parents[j])
        R[j] = R[i] @ (pairs[i, j].T_b_a.R.T if i < j else pairs[j, i].T_b_a.R)
    # The unknowns are all centres, then the length of each baseline. From camera j, the centre of i
    # lies along t, so
    #     c_i - c_j - length · R_j t = 0,   and weakly (a tenth)   length = 1
    # The first three equations put camera 1 at the origin. Least squares solves all at once.
    rows, values = [np.eye(3, 3 * count + len(pairs))], [np.zeros(3)]
    for k, ((i, j), found) in enumerate(pairs.items()):
        row = np.zeros((4, 3 * count + len(pairs)))
        row[:3, 3 * i : 3 * i + 3], row[:3, 3 * j : 3 * j + 3] = np.eye(3), -np.eye(3)
        row[:3, 3 * count + k] = -R[j] @ found.T_b_a.t
        row[3, 3 * count + k] = 0.1
        rows.append(row)
        values.append(np.array([0, 0, 0, 0.1]))
    solved = np.linalg.lstsq(np.concatenate(rows), np.concatenate(values), rcond=None)[0]
    return [Pose(R[i], solved[3 * i : 3 * i + 3]) for i in range(count)]


def rig_from_pairs(
    cameras: Sequence[OcamCamera], features: Sequence[Sequence[Features]], baseline: float
) -> Rig:
    """Return a first rig, frame of camera 1, from features and a distance; see `chain_poses`."""
    # Images show everything but the size; one known length scales all centres.
    rig = Rig(cameras, chain_poses(find_pairs(features), len(cameras)))
    grown = baseline / rig.baselines[0]
    return rig.with_poses([Pose(pose.R, grown * pose.t) for pose in rig.T_rig_cam])


def find_tracks(rig: Rig, features: Sequence[Sequence[Features]], band_deg: float) -> Tracks:
    """Return the tracks of matches near the epipolar planes of the rig's poses."""
    T, pairs = rig.T_rig_cam, list(combinations(range(len(rig)), 2))

    def match(row: Sequence[Features], pair: tuple[int, int]) -> NDArray[np.int64]:
        i, j = pair
        return match_features(row[i], row[j], T[j].inverse() @ T[i], band_deg)[0]

    with ThreadPoolExecutor(os.cpu_count()) as threads:
        found = [threads.map(match, repeat(row), pairs) for row in features]
    matches = [dict(zip(pairs, one, strict=True)) for one in found]
    return join_tracks(rig.cameras, features, matches)


def measure_rig(
    rig: Rig,
    images: Images,
    given: Given = "calibration",
    features: Sequence[Sequence[Features]] | None = None,
    free_lenses: bool = False,
    sectors: Literal["all", "even"] = "all",
    progress: Progress = silent,
) -> MeasuredRig:
    """Measure the poses of a rig from images of one or more moments.

    Args:
        rig: Its lenses are believed, its poses according to `given`; its frame and its size stay.
        images: images[frame][camera]; the frames should differ in place.
        given: "calibration": a prior, within 0.15° and 1 % of the radius. "nominal": within about
            5°, and a prior of 3 % of the radius for the centres. "nothing": start from here, within
            about 1°, as `chain_poses` finds it.
        features: Of `find_features`, if they are known.
        free_lenses: Adjust the centre and the focal length of each lens, too; its shape cannot be
            told from one moment and stays.
        sectors: "even": leave out every second sector of 30° around the y axis, see
            `in_odd_sector`.

    Raises:
        OmnistereoError: If there are hardly any matches.
    """
    features = find_features(rig.cameras, images, progress) if features is None else features
    band = _NOMINAL_BAND_DEG if given == "nominal" else _FILE_BAND_DEG
    tracks = find_tracks(rig, features, band)
    if sectors == "even":
        tracks = tracks.select(~in_odd_sector(TrackBundle(rig, tracks).points[:, :3])[tracks.point])
    # Given centres pull on the adjustment as a prior; without any, it finds them up to scale.
    share = {"nominal": _NOMINAL_SHARE, "calibration": _FILE_SHARE}.get(given)
    centre_sd = None if share is None else share * _radius(rig)
    bundle = adjust_tracks(rig, tracks, images, centre_sd, free_lenses, progress)
    covariance, lens_px = _covariance(bundle)
    found = bundle.adjusted_rig()
    # Now place the result: what is common to all cameras stays as given, and the lenses are the
    # adjusted.
    differences = pose_differences(found, rig)
    if given == "calibration":
        differences, covariance = _with_prior(differences, covariance)
    placed = replace(moved_rig(rig, differences), cameras=found.cameras)
    num_cells = int(bundle.cells().max()) + 1
    return MeasuredRig(
        placed, differences, covariance, bundle.points, num_cells, bundle.sigma_px, lens_px
    )


def in_odd_sector(directions: Floats) -> NDArray[np.bool_]:
    """Return whether directions (..., 3) are in odd ones of twelve sectors around the y axis."""
    around = np.degrees(np.arctan2(directions[..., 0], directions[..., 2]))
    return np.asarray(np.floor(around / _SECTOR_DEG) % 2 == 1)


def adjust_tracks(
    rig: Rig,
    tracks: Tracks,
    images: Images,
    centre_sd: float | None = None,
    free_lenses: bool = False,
    progress: Progress = silent,
) -> TrackBundle:
    """Adjust a rig to tracks, from a wide robust scale to a narrow one, then patches twice."""
    step = counted(progress, 3)
    if tracks.num_points < _FEWEST:
        raise OmnistereoError(
            f"the images have {tracks.num_points} matches between their cameras; expected hundreds."
            " Check that all are of one moment, and that there is texture where two cameras look"
        )
    step("poses")
    bundle = TrackBundle(rig, tracks, centre_sd, free_lenses)
    # From far away most tracks misfit. A wide scale lets them all pull; narrower ones then trust
    # those that agree, and leave out the wrong matches.
    for scale in (20.0, 10.0, 5.0, 2.5, 1.2):
        bundle.solve(scale, 6)
    bundle.rescale()
    bundle.solve(1.2, 8)
    for number in (1, 2):
        step(f"patches, pass {number} of 2")
        # Drop what misfits by more than four deviations, then match patches anew at the better
        # poses.
        good = bundle.misfits() < 16
        bundle = _continued(bundle, bundle.tracks.select(good[bundle.tracks.point]))
        bundle.solve(1.0, 2)
        bundle = _continued(bundle, refine_tracks(bundle, images))
        for scale in (2.5, 1.0, 0.5):
            bundle.solve(scale, 5)
        for scale in (4.0, 3.0, 2.5):
            bundle.rescale()
            bundle.solve(scale, 6)
    step("")
    return bundle


def _continued(bundle: TrackBundle, tracks: Tracks) -> TrackBundle:
    """Return the bundle of other tracks, at the poses found; priors stay where they were."""
    if tracks.num_points < _FEWEST:
        raise OmnistereoError(
            f"only {tracks.num_points} matches fit any poses of the cameras. Check that all images"
            " are of one moment and the lenses are those of the file"
        )
    return bundle.with_tracks(tracks)


def _covariance(bundle: TrackBundle) -> tuple[Floats, float]:
    """Return the covariance of the poses, and the error of the lenses in pixels that it allows for.

    Noise is independent from cell to cell. The error of a lens is not: it stays at its place in the
    image, and poses from one part of the image differ from those of another. By how much more than
    noise halves of the points disagree, up and down, near and far, in odd and in even sectors, of
    early and of late frames, tells how large it is; what it does to the poses follows from the
    adjustment, so that it is marginalised with the right correlations. Lenses that are adjusted,
    too, are unknowns: nothing of them is left over.
    """
    if bundle.free_lenses:
        return bundle.covariance(), 0.0
    # A covariance from the residuals knows noise only. Four ways to halve the points, in which an
    # error of a lens shows differently, tell about the rest.
    noise, lens = bundle.covariance(), bundle.by_lenses()
    u, inverse, frame = bundle.points[:, :3], bundle.points[:, 3], bundle.tracks.point_frame
    halves = [
        u[:, 1] > np.median(u[:, 1]),
        inverse > np.median(inverse),
        in_odd_sector(u),
        frame > frame.max() / 2,
    ]
    # The two halves differ by noise and by the lens error e, in pixels:
    #     E[difference²] = noise₁ + noise₂ + e² |∂pose₁/∂lens - ∂pose₂/∂lens|²
    # Summed over halves and cameras, this is solved for e², for rotations and centres apart.
    apart, by_noise, by_lens = np.zeros(2), np.zeros(2), np.zeros(2)
    for half in halves:
        tracks = [bundle.tracks.select(part[bundle.tracks.point]) for part in (half, ~half)]
        counts = [np.bincount(one.camera, minlength=len(bundle.rig)) for one in tracks]
        if np.min(counts) < _FEWEST:
            continue  # a camera that hardly any point is left for
        first, second = (bundle.with_tracks(one) for one in tracks)
        # The noise is that of all points: a half is too small to estimate its own.
        for one in (first, second):
            one.sigma_px = bundle.sigma_px
            one.solve(HALF_SCALE, 8)
        difference = pose_differences(first.adjusted_rig(), second.adjusted_rig())
        apart += _by_kind(difference.ravel() ** 2)
        by_noise += _by_kind(np.diag(first.covariance() + second.covariance()))
        by_lens += _by_kind(((first.by_lenses() - second.by_lenses()) ** 2).sum(axis=1))
    # Of rotations and centres the larger error, and at least that of exact lenses.
    squared = (apart - by_noise) / np.maximum(by_lens, 1e-30)
    error_px = float(np.sqrt(np.maximum(squared, _LENS_PX**2).max()))
    return noise + error_px**2 * lens @ lens.T, error_px


def _by_kind(values: Floats) -> Floats:
    """Return the sums of values (6 · cameras,) of rotations and of centres, (2,)."""
    return values.reshape(-1, 2, 3).sum(axis=(0, 2))


def _with_prior(differences: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Return differences and covariance when the rotations are those of a calibration, about known.

    What the file says of the centres is in the adjustment already: where all is far away they stay.
    """
    # Two measurements of one thing: 0 with information K from the file, and d with covariance C
    # from the images. Together they have covariance (C⁻¹ + K)⁻¹ = (I + C K)⁻¹ C and mean (I + C
    # K)⁻¹ d.
    known = np.tile(np.repeat([_FILE_TURN**-2, 0.0], 3), len(differences))
    kept = np.linalg.inv(np.eye(len(known)) + covariance * known)
    return (kept @ differences.ravel()).reshape(-1, 6), kept @ covariance


def _radius(rig: Rig) -> float:
    """Return the mean distance of the cameras from their middle, metres."""
    return float(np.linalg.norm(rig.centers - rig.centers.mean(axis=0), axis=1).mean())
