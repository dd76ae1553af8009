"""Rig check: does a rig fit its images, and if not, what is wrong with which camera.

What may have happened is tried as hypotheses: pictures rotated, mirrored or swapped, poses mixed
up, one camera elsewhere, lenses with another focal length. Each is scored by the matches that it
explains, and the simplest that explains most is named. Small errors are measured by all cameras
together; whom to accuse is then a question of which single camera explains the change.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chdtri  # `chi2.isf` of scipy.stats, which is slow to import

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.frame import Frame, check_images
from omnistereo_lib.geometry.pose import Floats, Pose, nearest_rotation, rotation_from_axis_angle
from omnistereo_lib.geometry.rig import Pair, Rig
from omnistereo_lib.progress import Progress, counted, silent
from omnistereo_rigs.doctor.evidence import Evidence
from omnistereo_rigs.doctor.mixups import as_given, explain
from omnistereo_rigs.doctor.one_camera import fitted_share, free_focal_lengths, free_poses
from omnistereo_rigs.doctor.pictures import picture_mixups
from omnistereo_rigs.images.from_images import MeasuredRig, chain_poses, measure_rig, relative_poses
from omnistereo_rigs.images.relative_pose import RelativePose
from omnistereo_rigs.images.track_bundle import (
    by_moving,
    mean_baseline,
    pose_differences,
    whitening,
)

# These decide between hypotheses by their scores. They were set while looking at planted mistakes
# of seeds below 50, see workshop/results/planted_mistakes.py; the book reports the seeds from 50
# on.
# Another hypothesis has to explain at least so many times the matches of the rig as given …
_CLEARER = 1.12
# … and at least so many more.
_MORE = 10
# A share of the score: so much better must a freed pose, or a focal length, be than a mix-up.
_FREED, _LENS = 0.08, 0.04
# Matches for each camera that agree on something. Fewer show nothing.
_FEW = 15
# Of the matches of each camera: if the rig explains such a share, nothing else is looked for.
_SHOWS_ALL = 0.45
# A pose or a focal length that is right fits at least so many times the others' share of matches.
_AS_WELL = 0.5
# A camera that shows something else fits at most so many times the share of the others' matches …
_ALIEN = 0.4
# … if that share is at least so large. Where the others hardly agree either, nobody is accused.
_AGREE = 0.3
# From here on, numbers for the measured poses. First, how probably a right camera is accused.
_BY_CHANCE = 1e-4
# By so many standard errors must the matches themselves prefer the measured rig.
_PREFERRED = 2.0
# Less is not worth saying. The shift is a share of the mean baseline.
_LEAST_TURN_DEG, _LEAST_SHIFT = 0.02, 0.005
# Less does no harm: a turn in pixels, a shift as above.
_WRONG_PX, _WRONG_SHIFT = 0.5, 0.02
# If a turn has a larger standard deviation, the images say nothing about the rig.
_UNKNOWN_DEG = 1.0
# A camera that is off by more than this share of the radius may as well show another moment.
_LATE_SHARE = 0.3
# In metres: cameras whose mean baseline is shorter are all at one place.
_TOGETHER = 1e-9
# If file and images differ by less, the measurement begins at the poses of the file.
_NEAR_DEG = 1.0
_UNITS = {1000: "m read as mm", 100: "m read as cm", 10: "cm read as mm"}


@dataclass(frozen=True, eq=False)
class RigCheck:
    """Result of `check_rig`."""

    fits: bool | None  #: None: the images do not show it
    text: str  #: the result in sentences, the verdict first
    cause: str  #: in a word or two: "nothing wrong", "turned", "late or displaced", …
    cameras: tuple[int, ...] = ()  #: those that are accused, from 0
    #: if this rig is wrong and the images show the right one: that, in their order
    fixed: Rig | None = None
    measured: MeasuredRig | None = None
    order: tuple[int, ...] = ()  #: in which the images are to be given, if only that is wrong


@dataclass(frozen=True, eq=False)
class _Hypothesis:
    """What may be wrong, and how many matches are explained once it is undone."""

    cause: str
    score: float
    penalty: float  # share of the score
    rig: Rig
    cameras: tuple[int, ...] = ()
    text: str = ""
    scale: float = 1.0  # of focal lengths
    order: tuple[int, ...] = ()

    @property
    def worth(self) -> float:
        return self.score * (1 - self.penalty)


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
            False,
            "all cameras are at one place: they see no depth. Check their translations",
            "one place",
        )
    step = counted(progress, 2)
    step("matches")
    evidence = _evidence(rig, images)
    found = _best(evidence, rig)
    check = _mixup(evidence, rig, found)
    if check is None:
        step("poses")
        try:
            check = _measured(evidence, rig, found, images, min_depth)
        except OmnistereoError as error:
            check = _odd(evidence, rig, found) or _open(str(error))
    step("")
    return check


def find_mixup(frame: Frame) -> str | None:
    """Return what is mixed up, in words, or None; a quick look, without measuring poses."""
    evidence = _evidence(frame.rig, frame.images)
    found = _mixup(evidence, frame.rig, _best(evidence, frame.rig))
    return found.text if found and found.fits is False else None


def _evidence(rig: Rig, images: Sequence[ArrayLike]) -> Evidence:
    return Evidence(
        rig.cameras,
        [image.round().clip(0, 255).astype(np.uint8) for image in check_images(images, rig)],
    )


def _open(why: str) -> RigCheck:
    return RigCheck(None, f"the images do not show whether the rig fits: {why}", "cannot tell")


def _best(evidence: Evidence, rig: Rig) -> _Hypothesis:
    """Return what explains most matches: the rig as given, unless another is clearly better."""
    # If the rig as given explains nearly half of the matches of every camera, and enough of them,
    # nothing else is looked for.
    counts, totals = evidence.counts(rig), evidence.totals()
    given = _Hypothesis("nothing wrong", float(counts.sum() / 2), 0.0, rig)
    if (
        counts.sum(axis=0) >= _SHOWS_ALL * np.maximum(totals.sum(axis=0), 1)
    ).all() and given.score >= _FEW * len(rig):
        return given
    # Another hypothesis has to explain clearly more: by a factor, and by some matches at least. Of
    # those, the one with the most matches after the penalty for its parts is taken.
    clear = [
        one
        for one in _hypotheses(evidence, rig)
        if one.score >= max(_CLEARER * given.score, given.score + _MORE)
    ]
    return max(clear, key=lambda one: one.worth, default=given)


def _hypotheses(evidence: Evidence, rig: Rig) -> Iterator[_Hypothesis]:
    # Pictures first: mirrored, rotated, or in another order.
    for one in picture_mixups(evidence, rig)[:1]:
        moved = enumerate(zip(one.order, one.flips, strict=True))
        changed = tuple(k for k, (place, flip) in moved if place != k or flip.name)
        fixed, order = rig, tuple[int, ...]()
        if not any(flip.name for flip in one.flips):
            lenses, poses = [rig.cameras[k] for k in one.order], rig.T_rig_cam
            fixed = Rig(lenses, [poses[k] for k in one.order], rig.min_depth)
            order = tuple(np.argsort(one.order).tolist())
        facts = one.cause, one.score, 0.04 * one.parts, fixed, changed, one.name
        yield _Hypothesis(*facts, order=order)
    pairs = evidence.relative_poses()
    if len(pairs) >= len(rig) - 1 and not _lost(rig, pairs):
        given, found, _ = explain(rig, pairs)
        if found is not None and found.parts:
            fixed = found.apply(rig)
            said = (
                f"{found.name}. With this undone, file and images agree to {found.turn_deg:.1f}° in"
                f" rotation and {found.aim_deg:.0f}° in the direction of the baselines, where they"
                f" differ by {given.turn_deg:.0f}° and {given.aim_deg:.0f}°"
            )
            score = float(evidence.counts(fixed).sum() / 2)
            yield _Hypothesis("poses mixed up", score, 0.04 * found.parts + 0.03, fixed, (), said)
    for freed in [*free_poses(evidence, rig, pairs)[:1], *free_focal_lengths(evidence, rig)[:1]]:
        scale, cameras = freed.scale, freed.cameras
        cause, penalty = ("turned or moved", _FREED) if scale == 1 else ("lens", _LENS)
        # The right pose or focal length fits as well as those of the others.
        mine, others = fitted_share(evidence, freed.rig, freed.cameras)
        if mine >= _AS_WELL * others and freed.score >= _FEW * len(rig):
            yield _Hypothesis(cause, freed.score, penalty, freed.rig, cameras, scale=scale)


def _lost(rig: Rig, pairs: dict[Pair, RelativePose]) -> set[int]:
    return set(range(len(rig))) - {camera for pair in pairs for camera in pair}


def _mixup(evidence: Evidence, rig: Rig, found: _Hypothesis) -> RigCheck | None:
    """Return what a hypothesis says that needs no measurement, or None."""
    if found.cause == "lens":
        k, percent = found.cameras[0], 100 * (1 / found.scale - 1)
        whose = (
            f"the lens of camera {k + 1} does not fit its image"
            if len(found.cameras) == 1
            else "the lenses do not fit the images"
        )
        way = "long" if percent > 0 else "short"
        text = (
            f"{whose}: the focal length looks {abs(percent):.0f} % too {way}. Check for which"
            " camera and size it is"
        )
        return RigCheck(False, text, "lens", found.cameras)
    if found.text:
        # Only poses and the order are put right by a rig file; a picture has to be rotated back.
        fixed = None if found.rig is rig else found.rig
        return RigCheck(False, found.text, found.cause, found.cameras, fixed, order=found.order)
    if found.cause == "nothing wrong":
        if (odd := _odd(evidence, rig, found)) is not None:
            return odd
        if found.score < _FEW * len(rig) and len(evidence.relative_poses()) < len(rig) - 1:
            return _open(
                f"only {found.score:.0f} matches between their cameras agree with it, or with any"
                f" other rig; expected {_FEW * len(rig)}. Give a frame with more texture, and check"
                " that neighbouring cameras see something in common"
            )
    return None


def _odd(evidence: Evidence, rig: Rig, found: _Hypothesis) -> RigCheck | None:
    """Return which camera shows something else than the others, if those agree; None if none."""
    if len(rig) < 3:
        return None
    # For each camera: the share of its matches that fit, and that of the matches without it. The
    # camera whose share is the smallest against the others' may be the odd one.
    shares = [fitted_share(evidence, found.rig, [k]) for k in range(len(rig))]
    k = int(np.argmin([mine / max(others, 1e-9) for mine, others in shares]))
    mine, others = shares[k]
    few = evidence.counts(found.rig).sum() / 2 < _FEW * (len(rig) - 1)
    if mine > _ALIEN * others or few:
        return None
    if others < _AGREE:
        return _open(
            f"{100 * mine:.0f} % of the matches of image {k + 1} fit the rig, and only"
            f" {100 * others:.0f} % of the others'. Give a frame with more texture"
        )
    text = (
        f"image {k + 1} does not show what the others show: {100 * mine:.0f} % of its matches fit"
        f" the rig, {100 * others:.0f} % of the others'. Its camera is late or displaced, or the"
        " image is of another rig: give the images before and after"
    )
    return RigCheck(False, text, "late or displaced", (k,))


def _measured(
    evidence: Evidence,
    rig: Rig,
    found: _Hypothesis,
    images: Sequence[NDArray[np.uint8]],
    min_depth: float | None,
) -> RigCheck:
    """Measure the poses of all cameras together, and return how the rig differs from them."""
    start, chained = found.rig, False
    if found.cause == "nothing wrong":
        pairs = evidence.relative_poses()
        if pairs and as_given(rig, pairs).turn_deg > _NEAR_DEG:
            start, chained = _chained(rig, pairs), True
    measured = measure_rig(start, [images], "nothing", [evidence.features])
    # All cameras together are more exact than pairs, and may name what those leave open.
    if chained:
        _, mixup, clear = explain(rig, relative_poses(measured.rig))
        if mixup is not None and mixup.parts and clear:
            return RigCheck(False, mixup.name, "poses mixed up", (), mixup.apply(rig), measured)
    return _compared(evidence, rig, measured, min_depth, found.cameras)


def _chained(rig: Rig, pairs: dict[Pair, RelativePose]) -> Rig:
    """Return the rig with the poses of the images, of the size and about in the given place."""
    # The chain is in the frame of camera 1 and of any size: scale, turn and shift it onto the given
    # rig.
    poses = chain_poses(pairs, len(rig))
    found = rig.with_poses(poses)
    scale = mean_baseline(rig.centers) / mean_baseline(found.centers)
    common = nearest_rotation(
        np.sum([a.R @ b.R.T for a, b in zip(rig.T_rig_cam, poses, strict=True)], axis=0)
    )
    offset = rig.centers.mean(axis=0) - scale * common @ found.centers.mean(axis=0)
    return rig.with_poses([Pose(common @ T.R, scale * common @ T.t + offset) for T in poses])


def _compared(
    evidence: Evidence,
    rig: Rig,
    measured: MeasuredRig,
    min_depth: float | None,
    freed: Sequence[int],
) -> RigCheck:
    """Return how the poses differ from those measured; `freed` are cameras known to be off."""
    differences = pose_differences(measured.rig, rig)
    turn_sd, shift_sd = measured.deviations.T
    limits = [f"Not all is shown: {refusal}" for refusal in measured.refusals()]
    # First whether the images show anything; then the unit, which needs no poses.
    unknown_deg = _UNKNOWN_DEG * (10 if freed else 1)
    if not np.isfinite(turn_sd).all() or turn_sd.max() > unknown_deg:
        text = ". ".join(["the images do not show how the cameras are placed", *limits])
        return RigCheck(None, text, "cannot tell", (), None, measured)
    if (unit := _unit(measured, min_depth)) is not None:
        return RigCheck(False, unit, "unit", (), None, measured)
    # Whom to accuse: a camera freed already, or those whose poses explain the differences. What is
    # too small to matter accuses nobody, and the matches themselves have to prefer the measured
    # rig.
    turns = np.degrees(np.linalg.norm(differences[:, :3], axis=1))
    shifts = np.linalg.norm(differences[:, 3:], axis=1)
    size = mean_baseline(rig.centers)
    small = turns.max() < _LEAST_TURN_DEG and shifts.max() < _LEAST_SHIFT * size
    accused = tuple(freed) or (() if small else _accused(rig, measured, differences))
    if accused and not freed and evidence.preference(rig, measured.rig) < _PREFERRED:
        accused = ()
    if not accused:
        k = int(turns.argmax())
        text = (
            f"the rig fits its images: no camera is off by more than {turns[k]:.2g}° ±"
            f" {turn_sd[k]:.1g}° and {_length(shifts.max())} ± {_length(shift_sd.max())}"
        )
        return RigCheck(True, ". ".join([text, *limits]), "nothing wrong", (), None, measured)
    # Then, camera by camera, how far it is off, whether that does any harm, and whether it is so
    # far that its picture may as well be of another moment.
    said, poses, harmless, late = [], list(rig.T_rig_cam), True, False
    radius = float(np.linalg.norm(rig.centers - rig.centers.mean(axis=0), axis=1).mean())
    for k, pose in _put_right(rig, measured.rig, accused).items():
        turn = (rig.T_rig_cam[k].inverse() @ pose).as_vector()[:3]
        degrees = float(np.degrees(np.linalg.norm(turn)))
        shift = float(np.linalg.norm(pose.t - rig.T_rig_cam[k].t))
        poses[k] = pose
        late |= shift > _LATE_SHARE * radius
        harmless &= degrees < _WRONG_PX / rig.cameras[k].pixels_per_degree
        harmless &= shift < _WRONG_SHIFT * size
        # By how many times its deviation, or what is worth saying, each is off.
        turned = degrees / max(_LEAST_TURN_DEG, 3 * turn_sd[k])
        moved = shift / max(_LEAST_SHIFT * size, 3 * shift_sd[k])
        parts = []
        if turned > 1 or turned >= moved:
            parts.append(
                f"is turned by {_degrees(degrees)} ± {turn_sd[k]:.1g}° ({_yaw_pitch_roll(turn)})"
            )
        if moved > 1 or moved > turned:
            parts.append(f"is {_length(shift)} ± {_length(shift_sd[k])} from where the rig has it")
        said.append(f"camera {k + 1} {' and '.join(parts)}")
    text = f"{', '.join(said)}, against the other cameras"
    if late and len(accused) == 1:
        k = accused[0]
        text = (
            f"camera {k + 1} is late or displaced: it {said[0].split(' ', 2)[2]}, against the other"
            " cameras. In one moment the two look alike: give the images before and after"
        )
        return RigCheck(
            False, ". ".join([text, *limits]), "late or displaced", accused, None, measured
        )
    if harmless:
        text = f"the rig fits its images to {_WRONG_PX:g} pixel: {text}"
    cause = "turned" if "turned" in text else "displaced"
    fixed = rig.with_poses(poses)
    return RigCheck(
        harmless,
        ". ".join([text, *limits]),
        cause if not harmless else "nothing wrong",
        () if harmless else accused,
        None if harmless else fixed,
        measured,
    )


def _accused(rig: Rig, measured: MeasuredRig, differences: Floats) -> tuple[int, ...]:
    """Return the cameras, as few as possible, whose poses explain how a rig differs from its
    images; () if none need.

    χ² is that of the differences without what cannot be seen. An innocent camera differs as well,
    since a common rotation, shift and scale are taken away, but freeing the culprit leaves nothing
    over.
    """
    # If the rig is right, the sum of the squares of its whitened differences is χ² distributed.
    white = whitening(measured.covariance)
    z = white @ differences.ravel()
    total = float(z @ z)
    if total < chdtri(len(z), _BY_CHANCE):
        return ()
    count = len(rig)
    # Greedily: free the camera whose free pose leaves least of χ², until chance or a tenth of it is
    # left.
    J = [white @ by_moving(rig, k) for k in range(count)]
    chosen: list[int] = []
    while len(chosen) < max(1, (count - 1) // 2) or count == 2:
        left = {}
        for k in set(range(count)) - set(chosen):
            A = np.concatenate([J[i] for i in (*chosen, k)], axis=1)
            rest = z - A @ np.linalg.lstsq(A, z, rcond=None)[0]
            left[k] = float(rest @ rest)
        best = min(left, key=left.__getitem__)
        chosen.append(best)
        if count == 2 or left[best] < max(
            chdtri(max(len(z) - 6 * len(chosen), 1), _BY_CHANCE), 0.1 * total
        ):
            return tuple(sorted(chosen))
    return tuple(range(count))


def _put_right(rig: Rig, found: Rig, accused: Sequence[int]) -> dict[int, Pose]:
    """Return the poses of the accused cameras, once the others lie on those given."""
    # A similarity (rotation, scale, shift) brings the innocent cameras of the measured rig onto the
    # given ones; it then tells where the accused cameras belong. Of two cameras the first stays.
    others = [k for k in range(len(rig)) if k not in accused] or list(range(len(rig)))
    if len(rig) == 2:
        others = [0]
    common = nearest_rotation(
        np.sum([rig.T_rig_cam[k].R @ found.T_rig_cam[k].R.T for k in others], axis=0)
    )
    over = others if len(others) > 1 else list(range(len(rig)))
    scale = mean_baseline(rig.centers[over]) / max(mean_baseline(found.centers[over]), 1e-12)
    offset = rig.centers[others].mean(axis=0) - scale * common @ found.centers[others].mean(axis=0)
    return {
        k: Pose(common @ found.T_rig_cam[k].R, scale * common @ found.centers[k] + offset)
        for k in (accused if len(rig) > 2 else (1,))
    }


def _yaw_pitch_roll(turn: Floats) -> str:
    """Return a rotation (3,) about the camera's axes in words, the largest part first."""
    names = (
        ("pitch", "up", "down"),
        ("yaw", "right", "left"),
        ("roll", "clockwise", "anticlockwise"),
    )
    degrees = np.degrees(turn)
    size = np.abs(degrees)
    order = [k for k in np.argsort(-size) if size[k] > 0.2 * size.max()]
    return ", ".join(
        f"{names[k][0]} {_degrees(abs(degrees[k]))} {names[k][1 if degrees[k] > 0 else 2]}"
        for k in order
    )


def _degrees(angle: float) -> str:
    return f"{angle:.2g}°" if angle < 10 else f"{angle:.0f}°"


def _length(metres: float) -> str:
    return f"{1000 * metres:.2g} mm" if metres < 0.1 else f"{metres:.2g} m"


def _unit(measured: MeasuredRig, min_depth: float | None) -> str | None:
    """Return what the nearest points say about the unit, if it cannot be right."""
    if min_depth is None:
        return None
    # One point in a hundred is nearer. If the rig is read in the wrong unit, all depths are wrong
    # by it.
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
    return rig.with_poses(
        [
            (
                Pose(pose.R @ rotation_from_axis_angle(np.asarray(axis_angle, np.float64)), pose.t)
                if i == camera
                else pose
            )
            for i, pose in enumerate(rig.T_rig_cam)
        ]
    )
