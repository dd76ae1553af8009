"""`python -m course COMMAND`: a check of the clone, and what makes the notebooks, the book and the
stored results.
"""

from __future__ import annotations  # the doctor also answers an older Python

import argparse
import sys
from importlib import import_module
from pathlib import Path

# The library has the same words, but the doctor must do without it.
_EXIT_STATUS = (
    "exit status: 0 done, 1 a check failed or the program has a defect, 2 bad input, 130"
    " interrupted"
)
OUT = Path(__file__).resolve().parents[1] / "out"


def main(arguments: list[str] | None = None) -> int:
    """Run one command; return the exit status. Bad input is one plain line, and so is a package
    that is missing.
    """
    options = vars(_parser().parse_args(arguments))
    module, function = options.pop("calls").rsplit(".", 1)  # imported only when it is used
    try:
        result = getattr(import_module(f"course.{module}"), function)(**options)
    except ModuleNotFoundError as error:
        print(
            f"error: {error}. {sys.executable} -m course doctor says what to install",
            file=sys.stderr,
        )
        return 2
    except ValueError as error:
        # needs packages, which the doctor must not
        from omnistereo_lib.errors import OmnistereoError

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


def _parser() -> argparse.ArgumentParser:
    """Return the parser; a command calls a function of a module, with its options as keyword
    arguments.
    """
    parser = argparse.ArgumentParser(
        prog="python -m course", description=__doc__, epilog=_EXIT_STATUS
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def add(name: str, calls: str, text: str) -> argparse.ArgumentParser:
        command = commands.add_parser(name, help=text, description=text, epilog=_EXIT_STATUS)
        command.set_defaults(calls=calls)
        return command

    for name, calls, text in (
        ("run", "publish.kernels.run", "run notebooks from fresh kernels, clean and store them"),
        (
            "clean",
            "nbtools.clean_stored",
            "remove what should not be stored: ids, timings, widget state",
        ),
        ("lint", "publish.rules.lint", "check notebooks against the course's rules"),
        (
            "stills",
            "publish.kernels.record_stills",
            "run notebooks and store what their live figures show, for the website and the slides",
        ),
    ):
        add(name, calls, text).add_argument("paths", nargs="+", type=Path, metavar="NOTEBOOK")
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
    solve = add(
        "solve",
        "classroom.solve.main",
        "run the notebooks with every exercise solved, into out/solutions",
    )
    solve.add_argument(
        "names", nargs="*", help="numbers of notebooks, such as 04; all unless given"
    )
    for name, calls, text in (
        ("book", "publish.website.build", "build the website"),
        ("slides", "publish.slides.make_slides", "build the slides"),
        (
            "progress.html",
            "classroom.progress.write_progress",
            "write a page on what is right in the working copies",
        ),
    ):
        add(name.partition(".")[0], calls, text).add_argument(
            "out", nargs="?", type=Path, default=OUT / name
        )
    add(
        "pages",
        "publish.pages.main",
        "update the lists and pictures of the README and the book's pages",
    )
    add(
        "questions",
        "experiments.questions.write_page",
        "trace the ten questions of CONTRIBUTING.md again, and write their table",
    )
    add(
        "reproduction",
        "publish.reproduction.renew_report",
        "compute book/reproduction.md from the stored results",
    )
    results = add(
        "results",
        "experiments.stored_results.compute_results",
        "compute the stored results again: hours, but it resumes",
    )
    results.add_argument(
        "options", nargs="*", help="of every evaluation, after --, such as -- --cluster ADDRESS"
    )
    for name, calls, text in (
        ("variants", "experiments.variants.compare_sweepnets", "train variants of SweepNet"),
        (
            "volume-variants",
            "experiments.volume_variants.compare_volumenets",
            "train variants of VolumeNet",
        ),
        (
            "volume-worlds",
            "experiments.volume_variants.compare_worlds",
            "train VolumeNet on shipped worlds, endless ones and both",
        ),
    ):
        add(name, calls, text).set_defaults(out=OUT / name)
    add(
        "rig-sizes",
        "experiments.rig_sizes.print_table",
        "how many rays are right at which distance, by size of rig",
    )
    world = add(
        "world-table",
        "experiments.world_table.print_table",
        "judge what `omnistereo world` made of a rendered drive",
    )
    world.add_argument("recording", type=Path, help="folder of the recording")
    world.add_argument(
        "data",
        nargs="?",
        default="sunny/train",
        help="the drive, or drive/test (default: %(default)s)",
    )
    add(
        "snapshots",
        "experiments.snapshots.take_snapshots",
        "store what SweepNet makes of one frame while it learns",
    )
    ship = add(
        "ship",
        "experiments.ship.export_weights",
        "bundle the weights of a finished training run, with curve and card",
    )
    ship.add_argument("run", type=Path, help="folder of the run")
    ship.add_argument("--half", action="store_true", help="store float16: half the file")
    bench = add(
        "bench", "experiments.bench.run", "time the library against named alternatives, as ratios"
    )
    bench.add_argument("--quick", action="store_true", help="leave out the scale of the paper")
    return parser


if __name__ == "__main__":
    sys.exit(main())
