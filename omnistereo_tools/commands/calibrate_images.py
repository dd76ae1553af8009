"""The part of `omnistereo calibrate` that needs no board: poses from ordinary images of the rig."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from omnistereo_learn.provenance import PROVENANCE, arrays_checksum, provenance, write_facts
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import write_text
from omnistereo_lib.frame import Frame, load_images
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.progress import Progress
from omnistereo_lib.rig_file import save_rig
from omnistereo_rigs.doctor.rig_check import find_mixup
from omnistereo_rigs.formats.read import load_cameras, read_any_rig
from omnistereo_rigs.images import varied
from omnistereo_rigs.images.from_images import (
    Given,
    Images,
    MeasuredRig,
    find_features,
    in_odd_sector,
    measure_rig,
    rig_from_pairs,
)
from omnistereo_tools.commands.depth_command import DepthOptions
from omnistereo_tools.commands.options import DoctorOptions
from omnistereo_tools.commands.record_command import RecordOptions
from omnistereo_tools.input.masks import with_masks
from omnistereo_tools.input.sources import Pictures, Recording, of_recordings
from omnistereo_tools.judge.first_look import lowest_costs
from omnistereo_tools.outputs import check_outputs, hold
from omnistereo_tools.parser import Options, as_typed
from omnistereo_tools.progress import progress_bar, say

if TYPE_CHECKING:
    from omnistereo_tools.commands.calibrate_command import CalibrateOptions

_CANDIDATES, _FRAMES = 24, 6  # frames that are looked at, and used
_STILL = 3.0  # gray values by which frames of a moving rig differ, in the mean
_CHECKED = 3  # frames on which the matching cost is compared
_AS_GOOD = 1.01  # times the cost
_FALLS = 2.0  # standard errors by which the held-out cost of each frame must fall


def run(options: CalibrateOptions) -> int:
    """Measure a rig from images, write it and its report; return 1 if the given rig stays."""
    out, recorded = options.out, options.from_images or ()
    names = ("config.yaml", "report.txt", PROVENANCE)
    check_outputs(options, [out / name for name in names])
    images, rig, given = _read(options, recorded)
    say(f"measuring the poses from {len(images)} frames takes about {10 + 8 * len(images)} s")
    if given == "calibration" and (found := find_mixup(Frame.of(rig, images[0]))):
        return _stays(options, recorded, "Bad", f"the rig and the images do not fit: {found}", [])
    measured, why_not, details = _measure(options, rig, given, images, progress_bar())
    refusals = "; ".join(measured.refusals())
    if refusals and given != "calibration":
        raise OmnistereoError(refusals)
    why_not = refusals or why_not
    report = [*_report(measured, len(images), given), *details]
    if why_not:
        # Whether all that the images show of the given rig is within what they cannot tell.
        holds = (measured.changes <= 2 * measured.deviations).all() and not refusals
        word = "Good" if holds else "Bad" if measured.more_than_a_knock() is not None else "Fair"
        return _stays(options, recorded, word, why_not, report)
    hold(out)
    save_rig(measured.rig, out / "config.yaml")
    write_text(out / "report.txt", "\n".join(report) + "\n")
    seen = arrays_checksum(image for frame in images for image in frame)
    write_facts(out / PROVENANCE, {"provenance": provenance(rig, seen, f"images, {given}")})
    turn_sd, shift_sd = measured.deviations.max(axis=0)
    print(f"Good: the poses are known to {turn_sd:.2g}° and {1000 * shift_sd:.2g} mm.")
    if given == "calibration" and measured.unknown_centres():
        print("The images do not show where the centres are: they stay as given, all is far away.")
    print(f"written to {out}/: {', '.join(names)}")
    print(_next(options, recorded, out / "config.yaml"))
    return 0


def _stays(
    options: CalibrateOptions, recorded: Sequence[Path], word: str, why: str, report: Sequence[str]
) -> int:
    """Say that the given rig stays and why; return 1."""
    print(f"{word}: the given rig stays, nothing is written: {why}.", *report, sep="\n")
    print(as_typed("doctor", DoctorOptions, options, images=_first_pictures(recorded) or None))
    return 1


def _first_pictures(recorded: Sequence[Path]) -> tuple[Path, ...]:
    """Return one picture of each camera, of one moment; none if they lie in videos."""
    if not of_recordings(recorded):
        return tuple(recorded)
    recording = Recording.open(recorded)
    first = recording.frames[min(recording.frames)]
    folders = [source for source in recording.sources if isinstance(source, Pictures)]
    return tuple(one.files[first] for one in folders) if len(folders) == len(recorded) else ()


def _next(options: CalibrateOptions, recorded: Sequence[Path], rig: Path) -> str:
    """Return the command that computes depth with a rig."""
    kind, name = (RecordOptions, "record") if of_recordings(recorded) else (DepthOptions, "depth")
    typed: type[Options] = kind
    return as_typed(name, typed, options, rig=rig, images=tuple(recorded), out=None)


def _read(options: CalibrateOptions, recorded: Sequence[Path]) -> tuple[Images, Rig, Given]:
    """Return the frames chosen, the rig, and what its poses are."""
    assert options.rig is not None  # `CalibrateOptions` wants it
    if options.baseline is None:
        rig = read_any_rig(options.rig, None, options.max_fov, keep_frame=True)
    else:
        cameras = load_cameras(options.rig, options.max_fov)
        rig = Rig(cameras, [Pose.identity()] * len(cameras))
    rig = with_masks(rig, recorded)
    if of_recordings(recorded):
        images = _choose_frames(Recording.open(recorded), rig)
    else:
        images = [load_images(recorded, rig)]
    if options.calibrated and len(images) == 1:
        raise OmnistereoError(
            "one frame does not replace a calibration. Give several, or leave out --calibrated"
        )
    if options.baseline is None:
        return images, rig, "calibration" if options.calibrated else "nominal"
    say("finding the poses without any to start from")
    features = find_features(rig.cameras, images)
    return images, rig_from_pairs(rig.cameras, features, options.baseline), "nothing"


def _choose_frames(recording: Recording, rig: Rig) -> Images:
    """Return frames of a recording that are sharp and differ most."""
    numbers = varied.candidates(sorted(recording.frames), _CANDIDATES)
    frames = list(recording.read(numbers, rig))
    chosen = varied.choose([varied.look(images) for images in frames], _FRAMES, _STILL)
    used = ", ".join(str(numbers[k]) for k in chosen)
    say(f"frames {used} of {len(recording.frames)} are used")
    return [frames[k] for k in chosen]


def _measure(
    options: CalibrateOptions, rig: Rig, given: Given, images: Images, progress: Progress
) -> tuple[MeasuredRig, str | None, list[str]]:
    """Return the rig measured, why it is not better than the one given, if so, and details."""
    features = find_features(rig.cameras, images, progress)
    measured = measure_rig(rig, images, given, features, progress=progress)
    if given == "nothing":
        return measured, None, []
    half = measure_rig(rig, images, given, features, sectors="even", progress=progress)
    checked = images if given == "calibration" else images[:_CHECKED]
    falls = np.array([_held_out(rig, half.rig, row) for row in checked])
    said = ", ".join(f"{before:.4f} → {after:.4f}" for before, after, _ in falls)
    details = [
        "matching cost where images were held out, with the given rig → with one measured"
        f" elsewhere: {said}"
    ]
    if given == "nominal":
        worse = falls[:, 1].mean() > _AS_GOOD * falls[:, 0].mean()
        why = "the held-out parts of the images do not match better with the one measured"
        return measured, why if worse else None, details
    if (k := measured.more_than_a_knock()) is not None:
        turn, shift = measured.changes[k]
        return (
            measured,
            f"camera {k + 1} is {turn:.2g}° and {1000 * shift:.2g} mm off, more than a knock: "
            "either it was mounted anew, or the images are not of one moment",
            details,
        )
    unclear = int((falls[:, 2] < _FALLS).sum())
    why = (
        f"in {unclear} of {len(falls)} frames the held-out parts do not match better with the one"
        " measured by more than their scatter"
    )
    return measured, why if unclear else None, details


def _held_out(rig: Rig, other: Rig, images: Sequence[NDArray[np.uint8]]) -> tuple[float, ...]:
    """Return the median matching cost of a frame with one rig and with another, in the sectors that
    "even" leaves out, and by how many standard errors of 15° cells it falls.
    """
    nearest = rig.min_depth or 2 * float(rig.baselines.max())
    grid = SphereGrid(320, 80, (-45, 45), 64, nearest)
    before, after = (lowest_costs(Frame.of(one, images), grid) for one in (rig, other))
    rays = grid.rays()
    both = in_odd_sector(rays) & np.isfinite(before) & np.isfinite(after)
    if not both.any():
        return 0.5, 0.5, 0.0
    angles = np.degrees(
        [np.arctan2(rays[..., 0], rays[..., 2])[both], np.arcsin(rays[..., 1].clip(-1, 1))[both]]
    )
    cells = np.unique(np.floor(angles / 15), axis=1, return_inverse=True)[1].ravel()
    fall = np.bincount(cells, (before - after)[both]) / np.bincount(cells)
    error = fall.std(ddof=1) / np.sqrt(len(fall)) if len(fall) > 1 else np.inf
    standard_errors = float(fall.mean() / max(error, 1e-12))
    return float(np.median(before[both])), float(np.median(after[both])), standard_errors


def _report(measured: MeasuredRig, frames: int, given: Given) -> list[str]:
    """Return the report, a line for each camera."""
    start = {
        "nothing": "no poses were given",
        "nominal": "the given poses were a start",
        "calibration": "the given poses are a calibration, and keep weight",
    }[given]
    lines = [
        (
            f"rig: {len(measured.rig)} cameras, {frames} frame{'s' if frames > 1 else ''},"
            f" {measured.num_points} points in {measured.num_cells} cells of 15°, noise"
            f" {measured.sigma_px:.2f} px; {start}"
        ),
        (
            f"  half of the points are within {measured.depth_quantile(0.5):.3g} m, nine tenths"
            f" beyond {measured.depth_quantile(0.1):.3g} m; the lenses are off by about"
            f" {measured.lens_px:.2f} px"
        ),
    ]
    for k, ((turn, shift), (turn_sd, shift_sd)) in enumerate(
        zip(measured.changes, measured.deviations, strict=True), 1
    ):
        known = f"pose known to {turn_sd:.3f}° and {1000 * shift_sd:.2g} mm"
        change = (
            ""
            if given == "nothing"
            else f"; turned by {turn:.3f}° and moved by {1000 * shift:.2g} mm"
        )
        lines.append(f"  camera {k}: {known}{change}")
    lines.append("  the size of the rig is the one given: images do not tell a metre")
    return lines
