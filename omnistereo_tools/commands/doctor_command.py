"""Check the installation; with --rig, say what a rig can see, and check it against its images.

Examples:
  omnistereo doctor
      the installation
  omnistereo doctor --rig rig.yaml --images 1.png 2.png 3.png 4.png --write fixed.yaml
      a rig and its images; what is wrong is put right in fixed.yaml
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from omnistereo_lib.errors import OmnistereoError
from omnistereo_tools.commands.depth_command import DepthOptions
from omnistereo_tools.commands.options import (
    DoctorOptions,
    find_min_depth,
    make_grid,
    read_frame,
    read_rig,
    warn_of,
)
from omnistereo_tools.outputs import check_outputs
from omnistereo_tools.parser import as_typed

if TYPE_CHECKING:
    from omnistereo_lib.frame import Frame
    from omnistereo_rigs.doctor.rig_check import RigCheck


def run(options: DoctorOptions) -> int:
    """Print what is in place and what is not; return 1 if something is wrong."""
    if options.rig is not None:
        return _check_rig(options, options.rig)
    from omnistereo_tools.installation import doctor

    return 0 if doctor() else 1


def _check_rig(options: DoctorOptions, rig_file: Path) -> int:
    """Say what a rig can see, and check it against its images; return 1 if it is wrong."""
    check_outputs(options, [options.write])
    has_images = options.images is not None or _is_data_set(rig_file)
    if options.write is not None and not has_images:
        raise OmnistereoError("--write needs --images: only they show what the rig is")
    # Read what there is, before what is slow to import.
    frame = read_frame(options) if has_images else None
    rig = frame.rig if frame else read_rig(options)
    from omnistereo_tools.judge.coverage import Coverage
    from omnistereo_tools.judge.first_look import rig_doubts

    coverage = Coverage.of(rig)
    min_depth = rig.min_depth if options.min_depth is None else options.min_depth
    if frame:
        min_depth = find_min_depth(min_depth, frame)
    # The panorama that `omnistereo depth` computes by default.
    grid = make_grid(DepthOptions(), coverage, min_depth)
    warn_of(rig_doubts(rig, grid.min_depth))
    found = _check_images(options, frame, grid.min_depth)
    low, high = rig.baselines.min(), rig.baselines.max()
    print(found.verdict)
    print(f"{len(rig)} cameras, {low:.3g} to {high:.3g} m apart: check that this is right.")
    print(*found.details, sep="\n", end="\n" * bool(found.details))
    # What a right rig can do is not said of a wrong one.
    if not found.verdict.startswith("Bad"):
        print(*coverage.sentences(grid.min_depth), coverage.left_out(grid), sep="\n")
    chosen = f"{grid.width}x{grid.height}x{grid.num_spheres}"
    if frame and not found.status:
        more = {"grid": chosen, "phi": grid.phi_deg, "min_depth": grid.min_depth}
        print(as_typed("depth", DepthOptions, options, **more))
    elif found.next is not None:
        print(found.next)
    return found.status


@dataclass(frozen=True)
class _Found:
    """What the images say of a rig."""

    verdict: str
    status: int  # 1 if something is wrong or open
    details: tuple[str, ...] = ()
    next: str | None = None  # a command, or what to do


def _check_images(options: DoctorOptions, frame: Frame | None, min_depth: float) -> _Found:
    """Check a rig against its images; write the rig that they show, if that is asked for."""
    if frame is None:
        return _Found(
            "Unknown: without --images nothing shows whether the poses are right.",
            0,
            next="Pass --images, one per camera: then they are checked, and a command is printed.",
        )
    from omnistereo_lib.geometry.sphere import SphereGrid
    from omnistereo_lib.rig_file import save_rig
    from omnistereo_rigs.doctor.rig_check import check_rig
    from omnistereo_tools.judge.first_look import matching_cost, picture_doubt
    from omnistereo_tools.progress import progress_bar, say

    rig, images = frame.rig, frame.images
    if doubt := picture_doubt(images):
        return _Found(f"Bad: {doubt}.", 1, next="Then run the same command again.")
    stated = rig.min_depth if options.min_depth is None else options.min_depth
    say("measuring the poses from the images takes about 15 s")
    check = check_rig(rig, images, stated, progress_bar())
    if check.cause == "late or displaced" and options.images is None:
        check = _with_frames(options, check)
    word = "Good" if check.fits else "Unknown" if check.fits is None else "Bad"
    cost = matching_cost(frame, SphereGrid(320, 80, num_spheres=64, min_depth=min_depth))
    details = [f"Median matching cost of the rig as given: {cost:.3f}; right rigs have up to 0.17."]
    if stated is None:
        details.append(
            "A wrong unit does not show, since no nearest depth is stated: check the distances"
            " between the cameras, or pass --min-depth."
        )
    go_on = None if check.fits else "Put that right, then run the same command again."
    if check.order and options.images and options.write is None:
        # Where the images are at fault, a rig file for their order would make that permanent.
        ordered = tuple(options.images[k] for k in check.order)
        go_on = as_typed("depth", DepthOptions, options, images=ordered)
    elif check.fixed is not None and not check.order and options.write is None:
        go_on = as_typed("doctor", DoctorOptions, options, write=Path("fixed.yaml"))
    elif check.fixed is not None and options.write is not None:
        save_rig(check.fixed, options.write)
        details.append(
            f"written to {options.write}: the rig as the images show it, in the order of the images"
        )
        if options.images is not None:
            go_on = as_typed("depth", DepthOptions, options, rig=options.write)
    elif options.write is not None:
        why = "there is nothing to put right" if check.fits else "no rig file puts that right"
        details.append(f"{options.write} is not written: {why}.")
    return _Found(f"{word}: {check.text}.", 0 if check.fits else 1, tuple(details), go_on)


def _with_frames(options: DoctorOptions, check: RigCheck) -> RigCheck:
    """Return the check with what the frames before and after say: whether the camera is late."""
    from omnistereo_lib.dataset import load_dataset
    from omnistereo_rigs.images.late import FRAMES, LateCameras
    from omnistereo_tools.record.sync import is_sure

    assert options.rig is not None  # the images are those of a data set
    data = load_dataset(options.rig)
    images = [data[k].images for k in range(min(FRAMES, len(data)))]
    late = LateCameras(data.rig, images).find() if len(images) > 1 else None
    if late is None or not is_sure(late):
        return check
    cameras = tuple(k for k, by in enumerate(late.frames) if abs(by) >= 0.5)
    seen = check.text.partition(". In one moment")[0]
    if not cameras:
        text = f"{seen}. Over {len(images)} frames no camera is late: it is displaced"
        return replace(check, cause="displaced", text=text)
    by = {k: f"{abs(late.frames[k]):.2g}".removesuffix(".0") for k in cameras}
    said = [
        f"camera {k + 1} is {by[k]} frame{'s' * (by[k] != '1')}"
        f" {'late' if late.frames[k] > 0 else 'early'}"
        for k in cameras
    ]
    text = f"{', '.join(said)}: {len(images)} frames show it. In this one, {seen}"
    return replace(check, cause="late", cameras=cameras, text=text)


def _is_data_set(path: Path) -> bool:
    """Return whether a path is a data set, not only a rig file or a folder of one."""
    return any((*path.glob("cam[0-9]*/"), *path.glob("[0-9]*/cam[0-9]*/")))
