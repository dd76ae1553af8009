"""Check the installation; with --rig, say what a rig can see, and check it against its images.

Examples:
  omnistereo doctor
      the installation
  omnistereo doctor --rig rig.yaml --images 1.png 2.png 3.png 4.png --write fixed.yaml
      a rig and its images; what is wrong is put right in fixed.yaml
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from omnistereo_lib.errors import OmnistereoError
from omnistereo_tools.commands.depth_command import DepthOptions
from omnistereo_tools.commands.options import (
    FrameOptions,
    GridOptions,
    find_min_depth,
    make_grid,
    read_frame,
    read_rig,
    warn_of,
)
from omnistereo_tools.outputs import check_outputs
from omnistereo_tools.parser import as_typed, flag, option

if TYPE_CHECKING:
    from omnistereo_lib.frame import Frame
    from omnistereo_lib.geometry.sphere import SphereGrid


@dataclass(frozen=True, kw_only=True)
class DoctorOptions(GridOptions, FrameOptions):
    """Options of `omnistereo doctor`; the panorama is the one on which images are matched."""

    rig: Path | None = option(
        "rig file, folder of one, or data set", unset="check the installation instead"
    )
    width: int = 320
    height: int | None = 80
    spheres: int = 64
    write: Path | None = option(
        "write there the rig as the images show it", suffixes=(".yaml", ".yml")
    )
    coverage: Path | None = option(
        "draw there how many cameras see what", suffixes=(".png", ".jpg", ".jpeg")
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rig is None and (given := set(self.given()) - {"width", "height", "spheres"}):
            raise OmnistereoError(
                f"{flag(min(given))} needs --rig: the file or folder that describes the cameras"
            )


def run(options: DoctorOptions) -> int:
    """Print what is in place and what is not; return 1 if something is wrong."""
    if options.rig is not None:
        return _check_rig(options, options.rig)
    from omnistereo_tools.installation import doctor

    return 0 if doctor() else 1


def _check_rig(options: DoctorOptions, rig_file: Path) -> int:
    """Say what a rig can see and what depth to ask for, and check it against its images; return 1
    if it is wrong.
    """
    check_outputs(options, [options.coverage, options.write])
    has_images = options.images is not None or _is_data_set(rig_file)
    if options.write is not None and not has_images:
        raise OmnistereoError("--write needs --images: only they show what the rig is")
    # Read what there is, before what is slow to import.
    frame = read_frame(options) if has_images else None
    rig = frame.rig if frame else read_rig(options)
    from omnistereo_tools.judge.coverage import Coverage
    from omnistereo_tools.judge.first_look import rig_doubts
    from omnistereo_tools.outputs import save_figure

    low, high = rig.baselines.min(), rig.baselines.max()
    print(f"{len(rig)} cameras, {low:.3g} to {high:.3g} m apart: check that this is right.")
    coverage = Coverage.of(rig)
    min_depth = rig.min_depth if options.min_depth is None else options.min_depth
    if frame:
        min_depth = find_min_depth(min_depth, frame)
    # The panorama that `omnistereo depth` computes by default.
    grid = coverage.propose(
        DepthOptions.width, DepthOptions.height, options.phi, DepthOptions.spheres, min_depth
    )
    print(*coverage.sentences(grid.min_depth), sep="\n")
    if options.coverage is not None:
        save_figure(options.coverage, coverage.figure())
    status = (
        _check_images(options, frame, make_grid(options, coverage, grid.min_depth)) if frame else 0
    )
    if not frame:
        warn_of(rig_doubts(rig, grid.min_depth))
        print(coverage.left_out(grid))
        print("With --images the poses are checked, too, and the command for depth is printed.")
    elif status == 0:
        chosen = {
            "width": grid.width,
            "height": grid.height,
            "phi": grid.phi_deg,
            "spheres": grid.num_spheres,
        }
        print(f"{coverage.left_out(grid)} Ready to run:")
        print(as_typed("depth", DepthOptions, options, **chosen, min_depth=grid.min_depth))
    return status


def _check_images(options: DoctorOptions, frame: Frame, grid: SphereGrid) -> int:
    """Check a rig against its images, whose matching cost is that on a grid; return 1 if it is
    wrong.
    """
    from omnistereo_lib.rig_file import save_rig
    from omnistereo_rigs.doctor.rig_check import check_rig
    from omnistereo_tools.judge.first_look import matching_cost, rig_doubts, same_pictures
    from omnistereo_tools.progress import progress_bar

    rig, images = frame.rig, frame.images
    if same := same_pictures(images):
        print(f"FAIL  {same}")
        return 1
    stated = rig.min_depth if options.min_depth is None else options.min_depth
    warn_of(rig_doubts(rig, grid.min_depth))
    print("Measuring the poses from the images takes about 15 s:", flush=True)
    check = check_rig(rig, images, stated, progress_bar())
    print(f"Median matching cost of the rig as given: {matching_cost(rig, images, grid):.3f}")
    print(f"{'OK  ' if check.fits else 'OPEN' if check.fits is None else 'FAIL'}  {check.text}")
    if options.write is not None and check.fixed is not None:
        save_rig(check.fixed, options.write)
        print(
            f"written to {options.write}: the rig as the images show it, in the order of the images"
        )
    elif options.write is not None:
        print(
            f"{options.write} is not written:"
            f" {'there is nothing to put right' if check.fits else 'see above'}"
        )
    if stated is None:
        print(
            "A wrong unit does not show, since no nearest depth is stated: check the distances"
            " between the cameras above, or pass --min-depth."
        )
    return 0 if check.fits else 1


def _is_data_set(path: Path) -> bool:
    """Return whether a path is a data set, not only a rig file or a folder of one."""
    return any((*path.glob("cam[0-9]*/"), *path.glob("[0-9]*/cam[0-9]*/")))
