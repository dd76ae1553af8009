"""The command line: `omnistereo COMMAND`, one module per command."""

import argparse
import json
import os
import re
import signal
import sys
import threading
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from difflib import get_close_matches
from io import TextIOWrapper
from pathlib import Path
from types import FrameType, ModuleType
from typing import NoReturn, get_type_hints

from omnistereo_lib.errors import EXIT_STATUS, OmnistereoError, one_line, shortened
from omnistereo_tools.commands import (
    calibrate_command,
    demo_command,
    depth_command,
    doctor_command,
    evaluate_command,
    live_command,
    onnx_command,
    record_command,
    rig_command,
    train_command,
    world_command,
)
from omnistereo_tools.memory import check_address_space, keep_memory
from omnistereo_tools.outputs import let_go
from omnistereo_tools.parser import Options, add_options, is_tiny, shrink

# Of libraries whose errors have no type in common.
_EXHAUSTED = re.compile(
    r"can't start new thread|(allocate|insufficient|out of) memory|CUDA error", re.IGNORECASE
)
_ABOUT = "Depth panoramas from a rig of fisheye cameras."
COMMANDS = {
    "demo": demo_command,
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
    """Run one command; return the exit status. Whatever goes wrong is one plain line, never a
    traceback.
    """
    _open_streams()
    keep_memory()
    options = None
    try:
        try:
            check_address_space()
            _check_environment()
            module, options = _parse(list(sys.argv[1:] if arguments is None else arguments))
            if is_tiny():
                options = shrink(options)
                _say("OMNISTEREO_TINY is set: the results are too small to mean anything")
            with _stoppable(), warnings.catch_warnings():
                warnings.showwarning = lambda message, *_: _say(f"warning: {message}")
                return module.run(options) or 0
        finally:
            let_go()
            print(end="", flush=True)
    except OmnistereoError as error:
        return _stop(f"error: {error}", 2)
    except (KeyboardInterrupt, SystemError) as error:  # the latter where Ctrl-C met a library in C
        stop = error if isinstance(error, KeyboardInterrupt) else error.__cause__
        if not isinstance(stop, KeyboardInterrupt):
            raise
        return _interrupted(options, stop)
    except OSError as error:
        # it is the output; what it has not taken would fail again at exit
        if error.filename is None:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):  # a reader such as `head` has seen enough
            return 141
        return _stop(
            f"error: {error.filename or 'the output'} cannot be read or written: {error.strerror}",
            2,
        )
    except Exception as error:
        if not (isinstance(error, MemoryError) or _EXHAUSTED.search(str(error))):
            raise
        return _stop(
            f"error: the machine has too little memory, threads or GPU left ({error}). Ask for less"
            " of it.",
            2,
        )


def _open_streams() -> None:
    """Open the streams that the parent has closed: a file would get their numbers, and what C
    prints into them.
    """
    for number in range(3):
        with suppress(OSError):
            os.fstat(number)
            continue
        os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free
    sys.stdout, sys.stderr = (
        stream or os.fdopen(k, "w") for k, stream in ((1, sys.stdout), (2, sys.stderr))
    )
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")  # where the terminal is not UTF-8


class _Terminated(KeyboardInterrupt):
    """SIGTERM, as `kill` and batch systems send it."""


@contextmanager
def _stoppable() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM end a command alike, at once while it loads modules; only the main
    thread can.
    """

    def stop(number: int, frame: FrameType | None) -> None:
        while frame is not None:
            if frame.f_code.co_filename.startswith("<frozen importlib"):
                _say("interrupted")
                os._exit(128 + number)  # an exception would go through modules that are half loaded
            frame = frame.f_back
        raise _Terminated if number == signal.SIGTERM else KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _check_environment() -> None:
    """Raise an `OmnistereoError` for what libraries answer with a traceback when they are loaded;
    draw into files.
    """
    os.environ |= {"MPLBACKEND": "agg", "MATPLOTLIBRC": os.devnull}
    threads = os.environ.get("NUMBA_NUM_THREADS", "1")
    if not re.fullmatch("[1-9][0-9]{0,3}", threads):
        raise OmnistereoError(
            f"NUMBA_NUM_THREADS in the environment is {shortened(threads)}; expected 1 to 9999"
        )
    if any(name.startswith("TQDM_") for name in os.environ):
        try:
            import tqdm  # noqa: F401  # it reads them when it is imported, as torch does
        except ValueError as error:
            raise OmnistereoError(
                f"{error}. Check the variables TQDM_… of the environment"
            ) from None
    try:
        os.getcwd()
    except OSError:
        raise OmnistereoError(
            "the working folder is not there any more. Change to another one"
        ) from None
    if os.path.exists("matplotlibrc"):  # Matplotlib reads it before the one of the variable
        import matplotlib

        matplotlib.rcdefaults()


def _say(line: str) -> None:
    bars = getattr(sys.modules.get("tqdm"), "tqdm", None)  # one may stand in the line
    try:
        with bars.external_write_mode(sys.stderr) if bars else nullcontext():
            print(one_line(line), file=sys.stderr, flush=True)
    except OSError:  # it is full or closed; what it has not taken would fail again at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())


def _stop(line: str, status: int) -> int:
    from omnistereo_lib.files import remove_empty_folders

    remove_empty_folders()
    if tqdm := sys.modules.get("tqdm"):
        for bar in [*tqdm.tqdm._instances]:  # it would be drawn once more, below the line
            bar.close()
    # torchrun ends with what it finds there
    if (file := os.environ.get("TORCHELASTIC_ERROR_FILE")) is not None:
        when = {"timestamp": str(int(time.time()))}
        Path(file).write_text(
            json.dumps({"message": {"message": one_line(line), "extraInfo": when}})
        )
    if os.environ.get("RANK", "0") == "0" or file is None:
        _say(line)
    return status


def _interrupted(options: Options | None, stop: KeyboardInterrupt) -> int:
    resumes = "; run the same command to resume" if options and options.resumes else ""
    return _stop(f"interrupted{resumes}", 143 if isinstance(stop, _Terminated) else 130)


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are not as long as what it was given."""

    def error(self, message: str) -> NoReturn:
        super().error(one_line(message))


def _parse(arguments: list[str]) -> tuple[ModuleType, Options]:
    """Return the module of a command and its options; without one print the help, and for a wrong
    name a similar one.

    The options are of the class that `run` takes.
    """
    parser = _Parser(prog="omnistereo", description=_ABOUT, epilog=EXIT_STATUS)
    commands = parser.add_subparsers(required=True, metavar="COMMAND", dest="command")
    for name, module in COMMANDS.items():
        command = commands.add_parser(
            name,
            help=(module.__doc__ or name).splitlines()[0],  # PYTHONOPTIMIZE=2 drops it
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
        guess = (
            f"Did you mean {similar[0]}?" if similar else f"Expected one of {', '.join(COMMANDS)}."
        )
        parser.exit(2, f"error: there is no command {arguments[0]!r}. {guess}\n")
    typed = vars(parser.parse_args(arguments))
    module = COMMANDS[typed.pop("command")]
    values = {
        name: tuple(value) if isinstance(value, list) else value for name, value in typed.items()
    }
    return module, _options_of(module)(**values)


def _options_of(module: ModuleType) -> type[Options]:
    kind: type[Options] = get_type_hints(module.run)["options"]
    return kind
