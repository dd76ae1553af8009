"""Check the installation; with --rig, say what a rig can see, and check it against its images.

Examples:
  omnistereo doctor
      the installation
  omnistereo doctor --rig rig.yaml --images 1.png 2.png 3.png 4.png --write fixed.yaml
      a rig and its images; what is wrong is put right in fixed.yaml
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from omnistereo_lib.errors import OmnistereoError
from omnistereo_tools.commands.options import (
    SPHERES,
    WIDTH,
    add_grid,
    add_images,
    add_rig,
    check_typed,
    make_grid,
    read_frame,
    read_masked_rig,
)
from omnistereo_tools.outputs import check_outputs

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from omnistereo_lib.geometry.rig import Rig
    from omnistereo_lib.geometry.sphere import SphereGrid


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_rig(parser, help="rig file, folder of one, or data set (default: check the installation instead)")
    add_images(parser)
    add_grid(parser, width=320, height=80, spheres=64)
    parser.add_argument("--write", type=Path, metavar="FIXED.yaml", help="write there the rig as the images show it")
    parser.add_argument("--coverage", type=Path, help="draw there how many cameras see each direction, how far apart")


def run(options: argparse.Namespace) -> int:
    """Print what is in place and what is not; return 1 if something is wrong."""
    check_typed(options)
    if options.rig is not None:
        return _check_rig(options)
    from omnistereo_tools.installation import doctor

    for name in ("images", "masks", "frame", "unit", "max_fov", "write", "coverage"):
        if getattr(options, name) is not None:
            raise OmnistereoError(
                f"--{name.replace('_', '-')} needs --rig: the file or folder that describes the cameras"
            )
    return 0 if doctor() else 1


def _check_rig(options: argparse.Namespace) -> int:
    """Say what a rig can see and what depth to ask for, and check it against its images; return 1 if it is wrong."""
    from omnistereo_tools.judge.coverage import Coverage
    from omnistereo_tools.output.exports import check_suffixes
    from omnistereo_tools.output.pictures import save_figure

    check_suffixes(coverage=options.coverage, write=options.write)
    check_outputs(options, [options.coverage, options.write])
    has_images = options.images is not None or _is_data_set(options.rig)
    if options.write is not None and not has_images:
        raise OmnistereoError("--write needs --images: only they show what the rig is")
    frame = read_frame(options) if has_images else None
    rig, images = (frame.rig, frame.images) if frame else (read_masked_rig(options), [])
    low, high = rig.baselines.min(), rig.baselines.max()
    print(f"{len(rig)} cameras, {low:.3g} to {high:.3g} m apart: check that this is right.")
    coverage = Coverage.of(rig)
    grid = _recommended(options, rig, images)
    print(*coverage.sentences(grid.min_depth), sep="\n")
    if options.coverage is not None:
        save_figure(options.coverage, coverage.figure())
    status = _check_images(options, rig, images, grid.min_depth) if has_images else 0
    if not has_images:
        _warn_of_doubts(rig, grid.min_depth)
        print(coverage.left_out(grid))
        print("With --images the poses are checked, too, and the command for depth is printed.")
    elif status == 0:
        print(f"{coverage.left_out(grid)} Ready to run:\n{_depth_command(options, grid)}")
    return status


def _recommended(options: argparse.Namespace, rig: Rig, images: Sequence[NDArray[np.uint8]]) -> SphereGrid:
    """Return the grid that `omnistereo depth` takes by default; without images the nearest depth is the rig's."""
    if images:
        chosen = argparse.Namespace(**vars(options) | {"width": WIDTH, "height": None, "spheres": SPHERES})
        return make_grid(chosen, rig, images)
    from omnistereo_tools.judge.coverage import Coverage

    min_depth = rig.min_depth if options.min_depth is None else options.min_depth
    return Coverage.of(rig).propose(WIDTH, None, options.phi and tuple(options.phi), SPHERES, min_depth)


def _depth_command(options: argparse.Namespace, grid: SphereGrid) -> str:
    """Return the command line that computes the depth of a grid from the same rig and images."""
    import shlex

    words = ["omnistereo", "depth"]
    for name in ("rig", "unit", "max_fov", "keep_frame", "images", "masks", "frame"):
        value = getattr(options, name)
        if value is not None and value is not False:
            words.append(f"--{name.replace('_', '-')}")
            words += [] if value is True else map(str, value) if isinstance(value, list) else [str(value)]
    low, high = (f"{angle:g}" for angle in grid.phi_deg)
    words += ["--width", str(grid.width), "--height", str(grid.height), "--phi", low, high]
    return shlex.join([*words, "--spheres", str(grid.num_spheres), "--min-depth", f"{grid.min_depth:g}"])


def _check_images(options: argparse.Namespace, rig: Rig, images: Sequence[NDArray[np.uint8]], min_depth: float) -> int:
    """Check a rig against its images, on spheres from the nearest depth of the sweep; return 1 if it is wrong."""
    from omnistereo_lib.rig_files import save_rig
    from omnistereo_lib.stereo.images import reduce_images
    from omnistereo_lib.stereo.sweep import SphereSweep
    from omnistereo_tools.judge.doubts import same_pictures
    from omnistereo_tools.judge.pace import progress_bar
    from omnistereo_tools.judge.rig_check import check_rig, matching_cost

    if same := same_pictures(images):
        print(f"FAIL  {same}")
        return 1
    grid = make_grid(argparse.Namespace(**vars(options) | {"min_depth": min_depth}), rig)
    stated = rig.min_depth if options.min_depth is None else options.min_depth
    _warn_of_doubts(rig, grid.min_depth)
    print("Measuring the poses from the images takes about 15 s:", flush=True)
    check = check_rig(rig, images, stated, progress_bar())
    small = reduce_images(rig, images, grid.width / 360)
    print(f"Median matching cost of the rig as given: {matching_cost(SphereSweep(small[0], grid), small[1]):.3f}")
    print(f"{'OK  ' if check.fits else 'OPEN' if check.fits is None else 'FAIL'}  {check.text}")
    if options.write is not None and check.fixed is not None:
        save_rig(check.fixed, options.write)
        print(f"written to {options.write}: the rig as the images show it, in the order of the images")
    elif options.write is not None:
        print(f"{options.write} is not written: {'there is nothing to put right' if check.fits else 'see above'}")
    if stated is None:
        print(
            "A wrong unit does not show, since no nearest depth is stated: check the distances between the cameras "
            "above, or pass --min-depth."
        )
    return 0 if check.fits else 1


def _warn_of_doubts(rig: Rig, min_depth: float) -> None:
    import warnings

    from omnistereo_tools.judge.doubts import rig_doubts

    for doubt in rig_doubts(rig, min_depth):
        warnings.warn(doubt, stacklevel=2)


def _is_data_set(path: Path) -> bool:
    """Return whether a path is a data set, not only a rig file or a folder of one."""
    return any((*path.glob("cam[0-9]*/"), *path.glob("[0-9]*/cam[0-9]*/")))
