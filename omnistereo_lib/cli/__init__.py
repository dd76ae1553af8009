"""The command line: `omnistereo COMMAND`, one module per command."""

import argparse
import sys
import warnings
from collections.abc import Sequence
from difflib import get_close_matches

from omnistereo_lib.cli import calibrate, depth, doctor, evaluate, train
from omnistereo_lib.errors import OmnistereoError

COMMANDS = {"depth": depth, "calibrate": calibrate, "doctor": doctor, "train": train, "evaluate": evaluate}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; return the exit status. Bad input is one plain line, never a traceback."""
    options = _parse(list(sys.argv[1:] if arguments is None else arguments))
    try:
        with warnings.catch_warnings():
            warnings.showwarning = lambda message, *_: print(f"warning: {message}", file=sys.stderr)
            return options.run(options) or 0
    except OmnistereoError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


def _parse(arguments: list[str]) -> argparse.Namespace:
    """Parse a command; without one print the help, and for a wrong name propose one that is similar."""
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
    if not arguments:
        parser.print_help()
        parser.exit()
    if not arguments[0].startswith("-") and arguments[0] not in COMMANDS:
        similar = get_close_matches(arguments[0], COMMANDS, n=1)
        guess = f"Did you mean {similar[0]}?" if similar else f"Expected one of {', '.join(COMMANDS)}."
        parser.exit(2, f"error: there is no command {arguments[0]!r}. {guess}\n")
    return parser.parse_args(arguments)
