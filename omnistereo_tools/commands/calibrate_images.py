"""The part of `omnistereo calibrate` that needs no board: poses from ordinary images of the rig."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import write_text
from omnistereo_lib.frame import load_images
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.progress import Progress
from omnistereo_rigs.formats.read import load_cameras, read_any_rig
from omnistereo_rigs.formats.write import write_rig
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
from omnistereo_tools.commands.options import ImagesOptions
from omnistereo_tools.input.masks import with_masks
from omnistereo_tools.input.sources import Recording, of_recordings
from omnistereo_tools.judge.first_look import matching_cost
from omnistereo_tools.outputs import check_outputs, hold, save_figure
from omnistereo_tools.progress import progress_bar

_CANDIDATES = 24  # frames that are looked at
_STILL = 3.0  # gray values by which frames of a moving rig differ, in the mean
_CHECKED = 3  # frames on which the matching cost is compared
_AS_GOOD = 1.01  # times the cost


def run(options: ImagesOptions, recorded: Sequence[Path]) -> int:
    """Measure a rig from images, write it and its report; return 1 if the given rig is better and
    stays.
    """
    out = options.out
    names = (
        "config.yaml",
        "report.txt",
        "report_points.png",
        "poses.txt",
        "kalibr.yaml",
        "opencv.yaml",
        "transforms.json",
        "colmap/rig_config.json",
    )
    check_outputs(options, [out / name for name in names])
    images, rig, given = _read(options, recorded)
    print(
        f"measuring the poses from {len(images)} frames takes about {10 + 8 * len(images)} s",
        flush=True,
    )
    measured, better, costs = _measure(options, rig, given, images, progress_bar())
    if refusals := measured.refusals():
        raise OmnistereoError("; ".join(refusals))
    text = "\n".join([*_report(measured, len(images), given), *costs])
    print(text)
    if not better:
        print(
            "The held-out parts of the images do not match better: the given rig stays, nothing is"
            " written."
        )
        return 1
    hold(out)
    written = write_rig(measured.rig, out)
    write_text(out / "report.txt", text + "\n")
    save_figure(out / "report_points.png", _figure(measured), dpi=80)
    print(f"written to {out}/: {', '.join([*written, 'report.txt', 'report_points.png'])}")
    return 0


def _read(options: ImagesOptions, recorded: Sequence[Path]) -> tuple[Images, Rig, Given]:
    """Return the frames chosen, the rig, and what its poses are."""
    if options.lenses is None:
        assert options.rig is not None  # `ImagesOptions` wants one of them
        rig = read_any_rig(options.rig, options.unit, options.max_fov, keep_frame=True)
    else:
        cameras = load_cameras(options.lenses, options.max_fov)
        rig = Rig(cameras, [Pose.identity()] * len(cameras))
    rig = with_masks(rig, None, recorded)
    if of_recordings(recorded):
        images = _choose_frames(Recording.open(recorded), rig, options.frames)
    else:
        images = [load_images(recorded, rig)]
    if options.calibrated and len(images) == 1:
        raise OmnistereoError(
            "one frame does not replace a calibration. Give several, or leave out --calibrated"
        )
    if options.rig is not None:
        return images, rig, "calibration" if options.calibrated else "nominal"
    print("finding the poses without any to start from", flush=True)
    features = find_features(rig.cameras, images)
    return (
        images,
        rig_from_pairs(rig.cameras, features, options.baseline, options.radius),
        "nothing",
    )


def _choose_frames(recording: Recording, rig: Rig, count: int) -> Images:
    """Return frames of a recording that are sharp and differ most."""
    numbers = varied.candidates(sorted(recording.frames), _CANDIDATES)
    frames = list(recording.read(numbers, rig))
    chosen = varied.choose([varied.look(images) for images in frames], count, _STILL)
    used = ", ".join(str(numbers[k]) for k in chosen)
    print(f"frames {used} of {len(recording.frames)} are used")
    return [frames[k] for k in chosen]


def _measure(
    options: ImagesOptions, rig: Rig, given: Given, images: Images, progress: Progress
) -> tuple[MeasuredRig, bool, list[str]]:
    """Return the rig measured, whether it matches held-out parts better than the one given, and by
    how much.
    """
    features = find_features(rig.cameras, images, progress)
    measured = measure_rig(rig, images, given, features, options.free_lenses, progress=progress)
    if given == "nothing":
        return measured, True, []
    half = measure_rig(rig, images, given, features, options.free_lenses, "even", progress)
    before, after = _held_out_costs(rig, images), _held_out_costs(half.rig, images)
    said = ", ".join(f"{a:.4f} → {b:.4f}" for a, b in zip(before, after, strict=True))
    line = (
        "matching cost where images were held out, with the given rig → with one measured"
        f" elsewhere: {said}"
    )
    return measured, float(np.mean(after)) <= _AS_GOOD * float(np.mean(before)), [line]


def _held_out_costs(rig: Rig, images: Images) -> list[float]:
    """Return the matching cost of some frames in the sectors that "even" leaves out."""
    nearest = rig.min_depth or 2 * float(rig.baselines.max())
    grid = SphereGrid(320, 80, (-45, 45), 64, nearest)
    held_out = in_odd_sector(grid.rays())
    return [matching_cost(rig, row, grid, held_out) for row in images[:_CHECKED]]


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
            f" beyond {measured.depth_quantile(0.1):.3g} m; regions of the images disagree:"
            f" deviations × {measured.lens_noise:.1f}"
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


def _figure(measured: MeasuredRig) -> Figure:
    """Return a figure of where the points are, and how far."""
    u, depth = measured.points[:, :3], 1 / np.maximum(measured.points[:, 3], 1e-3)
    figure = Figure(figsize=(11, 5), layout="constrained")
    axes = figure.subplots()
    azimuth, elevation = (
        np.degrees(np.arctan2(u[:, 0], u[:, 2])),
        np.degrees(np.arcsin(u[:, 1].clip(-1, 1))),
    )
    drawn = axes.scatter(azimuth, elevation, c=np.log10(depth), s=6, cmap="viridis_r")
    figure.colorbar(drawn, ax=axes, label="distance, log10 of metres")
    axes.set(
        xlim=(-180, 180),
        ylim=(90, -90),
        xlabel="azimuth in degrees",
        ylabel="elevation in degrees, down > 0",
    )
    axes.set_title(f"{len(u)} points that cameras share: where there are none, nothing is known")
    return figure
