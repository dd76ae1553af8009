"""The command line: `omnistereo COMMAND`, one module per command."""

import argparse
import sys
import warnings
from collections.abc import Sequence

from omnistereo_lib.cli import calibrate, depth, doctor, evaluate, train
from omnistereo_lib.errors import OmnistereoError

COMMANDS = {"depth": depth, "calibrate": calibrate, "doctor": doctor, "train": train, "evaluate": evaluate}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; return the exit status. Bad input is one plain line, never a traceback."""
    parser = argparse.ArgumentParser(prog="omnistereo", description="Depth panoramas from a rig of fisheye cameras.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for name, module in COMMANDS.items():
        command = commands.add_parser(
            name,
            help=module.__doc__.splitlines()[0],
            description=module.__doc__,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        command.set_defaults(run=module.run)
        module.add_arguments(command)
    options = parser.parse_args(arguments)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = lambda message, *_: print(f"warning: {message}", file=sys.stderr)
            return options.run(options) or 0
    except OmnistereoError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
