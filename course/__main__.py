"""`python -m course COMMAND`: to study or teach; `workshop` makes data and book."""

from __future__ import annotations  # the doctor also answers an older Python

import argparse
import sys
from importlib import import_module
from pathlib import Path

# The library has the same words, but the doctor must do without it.
_EXIT_STATUS = (
    "exit status: 0 done, 1 a check failed or the program has a defect, 2 bad input,"
    " 130 interrupted"
)
OUT = Path(__file__).resolve().parents[1] / "out"


class Commands:
    """Commands of a package: each calls a function of a module, with its options as arguments."""

    def __init__(self, package: str, description: str | None) -> None:
        self.package = package
        self.parser = argparse.ArgumentParser(
            prog=f"python -m {package}", description=description, epilog=_EXIT_STATUS
        )
        self._commands = self.parser.add_subparsers(required=True, metavar="COMMAND")

    def add(self, name: str, calls: str, text: str) -> argparse.ArgumentParser:
        """Add a command; `calls` names module and function within the package, or with another."""
        command = self._commands.add_parser(name, help=text, description=text, epilog=_EXIT_STATUS)
        command.set_defaults(calls=calls if calls.startswith("course.") else self._full(calls))
        return command

    def _full(self, calls: str) -> str:
        return f"{self.package}.{calls}"

    def run(self, arguments: list[str] | None = None) -> int:
        """Run one command; return the exit status. Bad input is one plain line."""
        options = vars(self.parser.parse_args(arguments))
        # A module is imported only when it is used.
        module, function = options.pop("calls").rsplit(".", 1)
        try:
            result = getattr(import_module(module), function)(**options)
        except ModuleNotFoundError as error:
            print(
                f"error: {error}. {sys.executable} -m course doctor says what to install",
                file=sys.stderr,
            )
            return 2
        except ValueError as error:
            from omnistereo_lib.errors import OmnistereoError  # needs packages, the doctor must not

            if not isinstance(error, OmnistereoError):
                raise
            print(f"error: {error}", file=sys.stderr)
            return 2
        except KeyboardInterrupt:
            print("interrupted", file=sys.stderr)
            return 130
        if isinstance(result, bool):
            return int(not result)
        return result if isinstance(result, int) else 0


def main(arguments: list[str] | None = None) -> int:
    """Run one command of the course; return the exit status."""
    commands = Commands("course", __doc__)
    add = commands.add
    lab = add(
        "lab",
        "classroom.lab.start",
        "open JupyterLab on working copies of the notebooks, in my_notebooks",
    )
    lab.add_argument("options", nargs="*", help="of JupyterLab, after --, such as -- --no-browser")
    fresh = add(
        "fresh",
        "classroom.lab.renew",
        "a fresh working copy of one notebook; yours is kept beside it",
    )
    fresh.add_argument("name", help="such as 03")
    add(
        "doctor",
        "classroom.doctor.check_clone",
        "check Python, the packages of environment.txt and the data",
    )
    check = add(
        "check",
        "classroom.handin.check",
        "check handed-in notebooks; this runs their code, see book/teaching.md",
    )
    check.add_argument("path", type=Path, help="a notebook, or a folder of a class")
    check.add_argument(
        "--out", type=Path, default=OUT / "checked", help="folder of the score sheets"
    )
    check.add_argument("--seconds", type=float, default=600, help="time for each notebook")
    check.add_argument(
        "--memory",
        dest="memory_gib",
        type=float,
        default=4,
        help="memory for each notebook, in GiB",
    )
    table = add(
        "table",
        "classroom.table.print_table",
        "compare the methods of a class by error and time; this runs their code",
    )
    table.add_argument(
        "handed_in", type=Path, help="a folder of files such as mine/omnistereo.py, or one"
    )
    table.add_argument("--out", type=Path, default=OUT / "table.csv", help="the table as CSV")
    table.add_argument("--seconds", type=float, default=300, help="time for each frame")
    table.add_argument(
        "--memory", dest="memory_gib", type=float, default=4, help="memory for each frame, in GiB"
    )
    solve = add(
        "solve",
        "classroom.solve.main",
        "run the notebooks with every exercise solved, into out/solutions",
    )
    solve.add_argument(
        "names", nargs="*", help="numbers of notebooks, such as 04; all unless given"
    )
    progress = add(
        "progress",
        "classroom.progress.write_progress",
        "write a page on what is right in the working copies",
    )
    progress.add_argument("out", nargs="?", type=Path, default=OUT / "progress.html")
    return commands.run(arguments)


if __name__ == "__main__":
    sys.exit(main())
