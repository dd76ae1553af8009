"""The command line: `omnistereo COMMAND`, one module per command."""

import argparse
import os
import re
import sys
import traceback
import warnings
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import fields
from difflib import get_close_matches
from io import TextIOWrapper
from types import ModuleType
from typing import NoReturn, get_type_hints

from omnistereo_lib.errors import EXIT_STATUS, OmnistereoError, one_line
from omnistereo_tools.commands import (
    board_command,
    calibrate_command,
    demo_command,
    depth_command,
    doctor_command,
    evaluate_command,
    live_command,
    onnx_command,
    record_command,
    rig_command,
    start_command,
    train_command,
    world_command,
)
from omnistereo_tools.outputs import let_go
from omnistereo_tools.parser import Options, add_options, flag, is_tiny

# Of libraries whose errors have no type in common.
_EXHAUSTED = re.compile("(allocate|insufficient|out of) memory|CUDA error", re.IGNORECASE)
COMMANDS = {
    "demo": demo_command,
    "start": start_command,
    "board": board_command,
    "depth": depth_command,
    "record": record_command,
    "world": world_command,
    "calibrate": calibrate_command,
    "rig": rig_command,
    "doctor": doctor_command,
    "train": train_command,
    "evaluate": evaluate_command,
    "live": live_command,
    "onnx": onnx_command,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; return the exit status. All that goes wrong but a defect is one line."""
    # What OpenCV and its FFmpeg would print of a damaged file: our own words say it.
    os.environ |= {"OPENCV_LOG_LEVEL": "SILENT", "OPENCV_FFMPEG_LOGLEVEL": "-8"}
    os.environ["MPLBACKEND"] = "agg"
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")  # where the terminal is not UTF-8
    options = None
    try:
        try:
            module, options = _parse(list(sys.argv[1:] if arguments is None else arguments))
            if is_tiny():
                _say("OMNISTEREO_TINY is set: the results are too small to mean anything")
            said = set[str]()  # a warning that two parts of a command have is told once
            with warnings.catch_warnings():
                warnings.showwarning = lambda message, *_: _warn(f"warning: {message}", said)
                return module.run(options) or 0
        finally:
            let_go()
            print(end="", flush=True)
    except OmnistereoError as error:
        return _stop(f"error: {error}", 2)
    except KeyboardInterrupt:
        resumes = "; run the same command to resume" if options and options.resumes else ""
        return _stop(f"interrupted{resumes}", 130)
    except BrokenPipeError:  # a reader such as `head` has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except OSError as error:
        place = error.filename or "the output"
        return _stop(f"error: {place} cannot be read or written: {error.strerror}", 2)
    except Exception as error:
        if isinstance(error, MemoryError) or _EXHAUSTED.search(str(error)):
            lack = "the machine has too little memory or GPU left"
            return _stop(f"error: {lack} ({error}). Ask for less of it.", 2)
        traceback.print_exc()
        return _stop("error: this is a defect of the program: please report what stands above", 1)


def _say(line: str) -> None:
    bars = getattr(sys.modules.get("tqdm"), "tqdm", None)  # one may stand in the line
    with bars.external_write_mode(sys.stderr) if bars else nullcontext():
        print(one_line(line), file=sys.stderr, flush=True)


def _warn(line: str, said: set[str]) -> None:
    if line not in said:
        said.add(line)
        _say(line)


def _stop(line: str, status: int) -> int:
    from omnistereo_lib.files import remove_empty_folders

    remove_empty_folders()
    if tqdm := sys.modules.get("tqdm"):
        for bar in [*tqdm.tqdm._instances]:  # it would be drawn once more, below the line
            bar.close()
    _say(line)
    return status


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are not as long as what it was given."""

    def error(self, message: str) -> NoReturn:
        super().error(one_line(message))


def _parse(arguments: list[str]) -> tuple[ModuleType, Options]:
    """Return the module of a command and its options; without one print the help, and for a wrong
    name a similar one.

    The options are of the class that `run` takes.
    """
    about = "Depth panoramas from a rig of fisheye cameras."
    parser = _Parser(prog="omnistereo", description=about, epilog=EXIT_STATUS)
    commands = parser.add_subparsers(required=True, metavar="COMMAND", dest="command")
    for name, module in COMMANDS.items():
        command = commands.add_parser(
            name,
            help=" ".join((module.__doc__ or name).partition("\n\n")[0].split()),
            description=module.__doc__,
            epilog=EXIT_STATUS,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        if name in arguments[:1]:
            add_options(command, _options_of(module))
    if not arguments:
        parser.print_help()
        parser.exit()
    if not arguments[0].startswith("-") and arguments[0] not in COMMANDS:
        similar = get_close_matches(arguments[0], COMMANDS, n=1)
        names = ", ".join(COMMANDS)
        guess = f"Did you mean {similar[0]}?" if similar else f"Expected one of {names}."
        parser.exit(2, f"error: there is no command {arguments[0]!r}. {guess}\n")
    known, unknown = parser.parse_known_args(arguments)
    typed = vars(known)
    module = COMMANDS[name := typed.pop("command")]
    if unknown:
        # By the option, whether it has no flag.
        options = {
            flag(one.name): one.metadata.get("positional") for one in fields(_options_of(module))
        }
        similar = get_close_matches(wrong := unknown[0].partition("=")[0], options, n=1)
        guess = f". Did you mean {similar[0]}?" if similar else ""
        if similar and options[similar[0]]:
            guess = f". Leave out the word {wrong}, not what follows it"
        commands.choices[name].error(f"unrecognized arguments: {' '.join(unknown)}{guess}")
    values = {
        name: tuple(value) if isinstance(value, list) else value for name, value in typed.items()
    }
    return module, _options_of(module)(**values)


def _options_of(module: ModuleType) -> type[Options]:
    kind: type[Options] = get_type_hints(module.run)["options"]
    return kind
