"""Check the installation; with --rig, check a rig against its images.

example: omnistereo doctor --rig rig.yaml --images 1.png 2.png 3.png 4.png
"""

import argparse

from omnistereo_lib.cli.inputs import add_grid, add_input, make_grid, read_input

_NEAR = 0.5  # metres: most images show something nearer than a few times this


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_input(parser)
    add_grid(parser, width=320, height=80, spheres=64)


def run(options: argparse.Namespace) -> int:
    """Print what is in place and what is not; return 1 if something is wrong."""
    if options.rig is None and options.images is None:
        from omnistereo_lib.doctor import doctor

        return 0 if doctor() else 1
    from omnistereo_lib.rig_check import check_rig

    rig, images, _ = read_input(options)
    low, high = rig.baselines.min(), rig.baselines.max()
    print(f"{len(rig)} cameras, {low:.3g} … {high:.3g} m apart: is that right?")
    # Not a depth that comes from the baselines: it would be wrong by the same factor as they are.
    check = check_rig(rig, images, make_grid(options, rig, images, _NEAR))
    for hypothesis in (check.given, *check.alternatives[:3]):
        print(f"{hypothesis.cost:.3f}  {hypothesis.name}")
    print(f"{'OK  ' if check.fits else 'FAIL'}  {check.summary()}")
    return 0 if check.fits else 1
