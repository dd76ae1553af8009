"""Check the installation; with --rig, say what a rig can see, and check it against its images.

example: omnistereo doctor --rig rig.yaml --images 1.png 2.png 3.png 4.png --coverage coverage.png
"""

import argparse
from pathlib import Path

from omnistereo_tools.commands.options import add_grid, add_input, is_rig_alone, make_grid, read_input, read_rig

_NEAR = 0.5  # metres: most images show something nearer than a few times this


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_input(parser, default="check the installation instead")
    add_grid(parser, width=320, height=80, spheres=64)
    parser.add_argument("--coverage", type=Path, help="draw there how many cameras see each direction, how far apart")


def run(options: argparse.Namespace) -> int:
    """Print what is in place and what is not; return 1 if something is wrong."""
    if options.rig is None:
        from omnistereo_lib.errors import OmnistereoError
        from omnistereo_tools.installation import doctor

        for name in ("images", "masks", "frame", "unit", "coverage"):
            if getattr(options, name):
                raise OmnistereoError(f"--{name} needs --rig: the file or folder that describes the cameras")
        return 0 if doctor() else 1
    from omnistereo_lib.files import write_image
    from omnistereo_tools.coverage import Coverage
    from omnistereo_tools.doubts import same_pictures
    from omnistereo_tools.exports import check_suffixes
    from omnistereo_tools.rig_check import check_rig

    check_suffixes(coverage=options.coverage)
    alone = options.images is None and is_rig_alone(options.rig)
    rig, images, _ = (read_rig(options), None, None) if alone else read_input(options)
    low, high = rig.baselines.min(), rig.baselines.max()
    print(f"{len(rig)} cameras, {low:.3g} to {high:.3g} m apart: check that this is right.")
    coverage = Coverage.of(rig)
    print(*coverage.sentences(), sep="\n")
    if options.coverage:
        write_image(options.coverage, coverage.picture())
    if alone:
        print("With --images the poses are checked, too.")
        return 0
    if same := same_pictures(rig, images):
        print(f"FAIL  {same}")
        return 1
    # Not a depth that comes from the baselines: it would be wrong by the same factor as they are.
    check = check_rig(rig, images, make_grid(options, rig, images, _NEAR))
    for hypothesis in (check.given, *check.alternatives[:3]):
        print(f"{hypothesis.cost:.3f}  {hypothesis.name}")
    print(f"{'OK  ' if check.fits else 'FAIL'}  {check.summary()}")
    return 0 if check.fits else 1
