"""Rig check: measure the relative poses from images, compare them with those of the rig, and name
what is wrong.

Nothing is named that does not fit what was measured.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.frame import Frame, check_images
from omnistereo_lib.geometry.pose import Floats, Pose, nearest_rotation
from omnistereo_lib.geometry.rig import Pair, Rig
from omnistereo_lib.progress import Progress, counted, silent
from omnistereo_rigs.doctor.mixups import as_given, explain
from omnistereo_rigs.images.features import FeatureFinder, Features
from omnistereo_rigs.images.from_images import (
    MeasuredRig,
    chain_poses,
    find_features,
    find_pairs,
    measure_rig,
    relative_poses,
)
from omnistereo_rigs.images.relative_pose import RelativePose
from omnistereo_rigs.images.track_bundle import mean_baseline, pose_differences

# deviations; of the length of a turn about three axes, passed by chance once in thousands
_SURE = 2.5
# less is not worth saying; the shift is a share of the mean baseline
_LEAST_TURN_DEG, _LEAST_SHIFT = 0.02, 0.005
_WRONG_PX, _WRONG_SHIFT = 0.5, 0.02  # less does no harm: of a turn in pixels, of a shift as above
_CLEARER = 0.5  # times the misfit
# standard deviation of a turn; images that show no more say nothing about the rig
_UNKNOWN_DEG = 1.0
_LARGE_TURN_DEG = 20.0  # of one camera: hardly a mount that gave way
_TOGETHER = 1e-9  # metres
_NEAR_DEG = 1.0  # of file and images: then the file is where the measurement begins
_UNITS = {1000: "m read as mm", 100: "m read as cm", 10: "cm read as mm"}


@dataclass(frozen=True, eq=False)
class RigCheck:
    """Result of `check_rig`."""

    fits: bool | None  #: None: the images do not show it
    text: str  #: the result in sentences
    fixed: Rig | None = (
        None  #: if this rig is wrong, the one that the images show, in the order of the images
    )
    measured: MeasuredRig | None = None


def check_rig(
    rig: Rig,
    images: Sequence[NDArray[np.uint8]],
    min_depth: float | None = None,
    progress: Progress = silent,
) -> RigCheck:
    """Measure the poses of a rig from the images of one moment and compare them.

    Images do not tell the length of a metre: a rig that is too large sees the same scene further
    away. Only a stated nearest depth tells it.

    Args:
        images: one array per camera, uint8
        min_depth: Depth in metres than which hardly anything is nearer; None: the unit is not
            checked.
        progress: Called as `progress(done, total, what)`.

    Raises:
        OmnistereoError: If the images do not fit the cameras.
    """
    if mean_baseline(rig.centers) < _TOGETHER:
        return RigCheck(
            False, "all cameras are at one place: they see no depth. Check their translations"
        )
    step = counted(progress, 2)
    step("matches")
    features, pairs = _matches(rig, images)
    wrong = _mixup(rig, images, features, pairs)
    if wrong is None:
        step("poses")
        try:
            chained = _chained(rig, pairs)
            start = rig if as_given(rig, pairs).turn_deg < _NEAR_DEG else chained
            measured = measure_rig(start, [images], "nothing", [features])
            # All cameras together are more exact than pairs, and may name what those leave open.
            wrong = _mixup(rig, images, features, relative_poses(measured.rig)) or _compared(
                rig, measured, min_depth
            )
        except OmnistereoError as error:
            wrong = RigCheck(None, f"the images do not show whether the rig fits: {error}")
    step("")
    return wrong


def find_mixup(frame: Frame) -> str | None:
    """Return what is mixed up, in words, or None if nothing is; a quick look, at pairs of cameras
    only.
    """
    found = _mixup(frame.rig, frame.images, *_matches(frame.rig, frame.images))
    return found.text if found else None


def _matches(
    rig: Rig, images: Sequence[NDArray[np.uint8]]
) -> tuple[list[Features], dict[Pair, RelativePose]]:
    """Return the features of the images, and what pairs of them say about their poses."""
    as_stored = [image.round().clip(0, 255).astype(np.uint8) for image in check_images(images, rig)]
    features = find_features(rig.cameras, [as_stored])
    return features[0], find_pairs(features)


def _mixup(
    rig: Rig,
    images: Sequence[NDArray[Any]],
    features: list[Features],
    pairs: dict[Pair, RelativePose],
) -> RigCheck | None:
    """Return what is wrong with the images or mixed up in the poses, or None."""
    lost = sorted(set(range(len(rig))) - {camera for pair in pairs for camera in pair})
    if mirrored := _mirrored(rig, images, features, lost):
        names = " and ".join(str(k + 1) for k in mirrored)
        return RigCheck(
            False,
            f"image {names} looks mirrored: it matches the others once it is flipped. Flip it",
        )
    if lost or len(pairs) < len(rig) - 1:
        return None
    given, found, clear = explain(rig, pairs)
    if found is None or not found.parts:
        return None
    if not clear:  # with each image seen through its own lens it must fit much better
        right = found.apply(rig)
        again = as_given(right, _matches(right, images)[1])
        if again.turn_deg > _NEAR_DEG or again.misfit > _CLEARER * found.misfit:
            return None
        found = replace(found, turn_deg=again.turn_deg, aim_deg=again.aim_deg)
    return RigCheck(
        False,
        f"{found.name}. With this undone, file and images agree to {found.turn_deg:.1f}° in"
        f" rotation and {found.aim_deg:.0f}° in the direction of the baselines, where they differ"
        f" by {given.turn_deg:.0f}° and {given.aim_deg:.0f}°",
        found.apply(rig),
    )


def _mirrored(
    rig: Rig, images: Sequence[NDArray[np.uint8]], features: Sequence[Features], lost: Sequence[int]
) -> list[int]:
    """Return those of some cameras whose images match the others once they are mirrored."""
    found = []
    for k in lost:
        again = list(features)
        again[k] = FeatureFinder(rig.cameras[k]).find(np.fliplr(images[k]))
        if any(k in pair for pair in find_pairs([again])):
            found.append(k)
    return found


def _chained(rig: Rig, pairs: dict[Pair, RelativePose]) -> Rig:
    """Return the rig with the poses of the images, of the size and about in the place of the given
    one.
    """
    poses = chain_poses(pairs, len(rig))
    found = rig.with_poses(poses)
    scale = mean_baseline(rig.centers) / mean_baseline(found.centers)
    common = nearest_rotation(
        np.sum([a.R @ b.R.T for a, b in zip(rig.T_rig_cam, poses, strict=True)], axis=0)
    )
    offset = rig.centers.mean(axis=0) - scale * common @ found.centers.mean(axis=0)
    return rig.with_poses(
        [Pose(common @ pose.R, scale * common @ pose.t + offset) for pose in poses]
    )


def _compared(rig: Rig, measured: MeasuredRig, min_depth: float | None) -> RigCheck:
    """Return how the poses of the rig differ from those measured, in words."""
    differences = pose_differences(measured.rig, rig)
    turn_sd, shift_sd = measured.deviations.T
    turns, shifts = (
        np.degrees(np.linalg.norm(differences[:, :3], axis=1)),
        np.linalg.norm(differences[:, 3:], axis=1),
    )
    wrong = turns > np.maximum(_SURE * turn_sd, _LEAST_TURN_DEG)
    least_shift = _LEAST_SHIFT * mean_baseline(rig.centers)
    moved = shifts > np.maximum(_SURE * shift_sd, least_shift)
    limits = [f"Not all is shown: {refusal}" for refusal in measured.refusals()]
    unit = _unit(measured, min_depth)
    if unit is not None:
        return RigCheck(False, unit, None, measured)
    if turn_sd.max() > _UNKNOWN_DEG:
        return RigCheck(
            None,
            f"the images do not show how the cameras stand. {'. '.join(limits)}",
            None,
            measured,
        )
    k = int(turns.argmax())
    if not wrong.any() and not moved.any():
        text = (
            f"the rig fits its images: no camera is off by more than {turns[k]:.2g}° ±"
            f" {turn_sd[k]:.1g}°"
        )
        return RigCheck(
            True,
            ". ".join([f"{text} and {_length(shifts.max())} ± {_length(shift_sd.max())}", *limits]),
            None,
            measured,
        )
    found = []
    only = _only_camera(measured.rig, rig)
    if wrong.any() and only is not None:
        k, turn = only
        degrees = float(np.degrees(np.linalg.norm(turn)))
        said = (
            f"camera {k + 1} is turned by {_degrees(degrees)} ± {turn_sd[k]:.1g}° about its"
            f" {_axis_name(turn)}"
        )
        if degrees > _LARGE_TURN_DEG:
            # In a scene that stands still, an image of another moment shows the place and turn of
            # its own.
            said += f" and off by about {shifts[k]:.1g} m, or its image is of another moment"
            moved[:] = False
        found.append(said)
    elif wrong.any():
        found += [
            f"camera {k + 1} is turned by {_degrees(turns[k])} ± {turn_sd[k]:.1g}°"
            for k in np.flatnonzero(wrong)
        ]
    found += [
        f"the centre of camera {k + 1} is off by {_length(shifts[k])} ± {_length(shift_sd[k])}"
        for k in np.flatnonzero(moved)
    ]
    text = f"against the other cameras, {', '.join(found)}"
    wrong_deg = _WRONG_PX / min(camera.pixels_per_degree for camera in rig.cameras)
    harmless = (
        turns[wrong].max(initial=0) < wrong_deg
        and shifts[moved].max(initial=0) < _WRONG_SHIFT / _LEAST_SHIFT * least_shift
    )
    if harmless:
        text = f"the rig fits its images to {_WRONG_PX:g} pixel: {text}"
    return RigCheck(bool(harmless), ". ".join([text, *limits]), measured.rig, measured)


def _only_camera(measured: Rig, rig: Rig) -> tuple[int, Floats] | None:
    """Return the one camera that is turned against all others, if there is one, and its turn about
    its own axes.
    """
    if len(rig) < 3:
        return None
    best: tuple[float, int, Floats] = np.inf, 0, np.zeros(3)
    R, R0 = (np.stack([pose.R for pose in one.T_rig_cam]) for one in (measured, rig))
    for k in range(len(rig)):
        others = [i for i in range(len(rig)) if i != k]
        common = nearest_rotation(np.einsum("nij,nkj->ik", R[others], R0[others]))
        turns = [
            Pose(R0[i].T @ common.T @ R[i], np.zeros(3)).as_vector()[:3] for i in range(len(rig))
        ]
        rest = max(float(np.linalg.norm(turns[i])) for i in others)
        if rest < best[0]:
            best = rest, k, turns[k]
    rest, k, turn = best
    return (k, turn) if rest < 0.3 * np.linalg.norm(turn) else None


def _degrees(angle: float) -> str:
    return f"{angle:.2g}°" if angle < 10 else f"{angle:.0f}°"


def _axis_name(turn: Floats) -> str:
    axis = turn / np.linalg.norm(turn)
    largest = int(np.abs(axis).argmax())
    if abs(axis[largest]) > 0.95:
        return f"{'xyz'[largest]} axis"
    return f"axis ({', '.join(f'{value:.2f}' for value in axis)})"


def _length(metres: float) -> str:
    return f"{1000 * metres:.2g} mm" if metres < 0.1 else f"{metres:.2g} m"


def _unit(measured: MeasuredRig, min_depth: float | None) -> str | None:
    """Return what the nearest points say about the unit of the translations, if it cannot be
    right.
    """
    if min_depth is None:
        return None
    nearest = measured.depth_quantile(0.01)
    for factor, unit in _UNITS.items():
        for short in (True, False):
            ratio = min_depth / nearest if short else nearest / min_depth
            # Nothing may be near; nothing nearer than the nearest cannot be.
            if ratio > (factor / 3 if short else factor / 2) and (short or factor > 10):
                words = unit if short else " read as ".join(reversed(unit.split(" read as ")))
                return (
                    f"the translations look {factor} times too {'short' if short else 'long'}"
                    f" ({words}?): with them the nearest things are {nearest:.2g} m away, and the"
                    f" nearest depth is stated as {min_depth:.2g} m"
                )
    return None


def invert_poses(rig: Rig) -> Rig:
    """Return the rig with every pose inverted."""
    return rig.with_poses([pose.inverse() for pose in rig.T_rig_cam])


def scale_translations(rig: Rig, factor: float) -> Rig:
    """Return the rig with every translation multiplied by a factor."""
    return rig.with_poses([Pose(pose.R, factor * pose.t) for pose in rig.T_rig_cam])


def rotate_camera(rig: Rig, camera: int, axis_angle: ArrayLike) -> Rig:
    """Return the rig with one camera rotated about its own axes; axis-angle (3,) in radians."""
    rotation = Pose.from_vector([*np.asarray(axis_angle), 0.0, 0.0, 0.0])
    return rig.with_poses(
        [pose @ rotation if i == camera else pose for i, pose in enumerate(rig.T_rig_cam)]
    )
