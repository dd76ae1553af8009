"""Check the installation; with --rig, say what a rig can see, and check it against its images.

example: omnistereo doctor --rig rig.yaml --images 1.png 2.png 3.png 4.png --coverage coverage.png
"""

import argparse
from pathlib import Path

from omnistereo_lib.errors import OmnistereoError
from omnistereo_tools.commands.options import add_grid, add_images, add_rig, make_grid, read_frame, read_masked_rig

_NEAR = 0.5  # metres: most images show something nearer than a few times this


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_rig(parser, help="rig file, folder of one, or data set (default: check the installation instead)")
    add_images(parser)
    add_grid(parser, width=320, height=80, spheres=64)
    parser.add_argument("--coverage", type=Path, help="draw there how many cameras see each direction, how far apart")


def run(options: argparse.Namespace) -> int:
    """Print what is in place and what is not; return 1 if something is wrong."""
    if options.rig is not None:
        return _check_rig(options)
    from omnistereo_tools.installation import doctor

    for name in ("images", "masks", "frame", "unit", "max_fov", "coverage"):
        if getattr(options, name) is not None:
            raise OmnistereoError(
                f"--{name.replace('_', '-')} needs --rig: the file or folder that describes the cameras"
            )
    return 0 if doctor() else 1


def _check_rig(options: argparse.Namespace) -> int:
    """Say what a rig can see, and check it against its images, if there are any; return 1 if something is wrong."""
    import warnings

    from omnistereo_tools.coverage import Coverage
    from omnistereo_tools.doubts import rig_doubts, same_pictures
    from omnistereo_tools.exports import check_suffixes
    from omnistereo_tools.pictures import save_figure
    from omnistereo_tools.rig_check import check_rig

    check_suffixes(coverage=options.coverage)
    has_images = options.images is not None or _is_data_set(options.rig)
    rig, images, _ = read_frame(options) if has_images else (read_masked_rig(options), [], None)
    low, high = rig.baselines.min(), rig.baselines.max()
    print(f"{len(rig)} cameras, {low:.3g} to {high:.3g} m apart: check that this is right.")
    coverage = Coverage.of(rig)
    print(*coverage.sentences(), sep="\n")
    if options.coverage is not None:
        save_figure(options.coverage, coverage.figure())
    if not has_images:
        print("With --images the poses are checked, too.")
        return 0
    if same := same_pictures(images):
        print(f"FAIL  {same}")
        return 1
    # Not a depth that comes from the baselines: it would be wrong by the same factor as they are.
    grid = make_grid(options, rig, _NEAR)
    for doubt in rig_doubts(rig, grid.min_depth):
        warnings.warn(doubt, stacklevel=2)
    check = check_rig(rig, images, grid)
    for hypothesis in (check.given, *check.alternatives[:3]):
        print(f"{hypothesis.cost:.3f}  {hypothesis.name}")
    print(f"{'OK  ' if check.fits else 'FAIL'}  {check.summary()}")
    return 0 if check.fits else 1


def _is_data_set(path: Path) -> bool:
    """Return whether a path is a data set, not only a rig file or a folder of one."""
    return any((*path.glob("cam[0-9]*/"), *path.glob("[0-9]*/cam[0-9]*/")))
