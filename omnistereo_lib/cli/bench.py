"""Time the library against named alternatives, as ratios.

example: omnistereo bench --quick
"""

from __future__ import annotations

import argparse


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("--quick", action="store_true", help="leave out the scale of the paper")


def run(options: argparse.Namespace) -> None:
    """Print the table of ratios."""
    from omnistereo_lib import bench

    bench.run(quick=options.quick)
