"""`python -m course COMMAND`: a check of the clone, and what makes the notebooks, the book and the report."""

import argparse
import sys
from pathlib import Path

from course import nbtools
from omnistereo_lib.errors import OmnistereoError


def main(arguments: list[str] | None = None) -> int:
    """Run one command; return the exit status. Bad input is one plain line."""
    parser = argparse.ArgumentParser(prog="python -m course", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, text in (
        ("run", "run notebooks from fresh kernels, clean and store them"),
        ("clean", "remove what should not be stored: ids, timings, widget state"),
        ("lint", "check notebooks against the course's rules"),
        ("stills", "run notebooks and store what their live figures show, for the website and the slides"),
    ):
        commands.add_parser(name, help=text).add_argument("notebooks", nargs="+", type=Path)
    commands.add_parser("doctor", help="check Python, the packages of environment.txt and the data")
    check = commands.add_parser("check", help="check handed-in notebooks; this runs their code, see book/teaching.md")
    check.add_argument("path", type=Path, help="a notebook, or a folder of a class")
    check.add_argument("--out", type=Path, default=nbtools.ROOT / "out" / "checked", help="folder of the score sheets")
    check.add_argument("--seconds", type=float, default=600, help="time for each notebook")
    check.add_argument("--memory", type=float, default=4, metavar="GIB", help="memory for each notebook, in GiB")
    commands.add_parser("readme", help="update the README's table of notebooks and its picture")
    solved = commands.add_parser("solve", help="run the notebooks with every exercise solved, into out/solutions")
    solved.add_argument("numbers", nargs="*", help="of the notebooks, such as 04; all unless given")
    for name, text in (("book", "build the website"), ("slides", "build the slides")):
        folder = nbtools.ROOT / "out" / name
        commands.add_parser(name, help=text).add_argument("folder", nargs="?", type=Path, default=folder)
    bench = commands.add_parser("bench", help="time the library against named alternatives, as ratios")
    bench.add_argument("--quick", action="store_true", help="leave out the scale of the paper")
    commands.add_parser("reproduction", help="compute the verdicts of book/reproduction.md from the stored results")
    ship = commands.add_parser("ship", help="bundle the weights of a finished training run, with curve and card")
    ship.add_argument("run", type=Path, help="folder of the run")
    ship.add_argument("--half", action="store_true", help="store float16: half the file")
    for name, network in (("variants", "SweepNet"), ("volume-variants", "VolumeNet")):
        variants = commands.add_parser(name, help=f"train {network} in several ways and compare them")
        variants.add_argument("--out", type=Path, default=nbtools.ROOT / "out" / name)
        variants.add_argument("--set", nargs="+", default=[], metavar="NAME=VALUE", help="change numbers of the recipe")
    commands.add_parser(
        "snapshots", help="train SweepNet's decision and store what it makes of one frame while it learns"
    )
    try:
        return run(parser.parse_args(arguments))
    except OmnistereoError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130


def run(options: argparse.Namespace) -> int:
    """Do what the command line asks for; each tool is imported only when it is used."""
    match options.command:
        case "solve":
            from course.solve import main

            main(options.numbers)
            return 0
        case "stills":
            for path in options.notebooks:
                nbtools.record_stills(path)
            return 0
        case "readme":
            from course.readme import main

            main()
            return 0
        case "check":
            from course.handin import check

            check(options.path, options.out, options.seconds, options.memory)
            return 0
        case "book":
            from course.website import build

            return build(options.folder)
        case "slides":
            from course.slides import make_slides

            make_slides(options.folder)
            return 0
        case "doctor":
            from course.doctor import check_clone

            return 0 if check_clone() else 1
        case "bench":
            from course import bench

            bench.run(options.quick)
            return 0
        case "ship":
            from course.ship import export_weights

            print(f"written: {', '.join(map(str, export_weights(options.run, half=options.half)))}")
            return 0
        case "variants":
            from course.variants import compare

            print(f"written: {compare(options.out, options.set)}")
            return 0
        case "volume-variants":
            from course.volume_variants import compare_volumes

            print(f"written: {compare_volumes(options.out, options.set)}")
            return 0
        case "snapshots":
            from course.snapshots import take_snapshots

            print(f"written: {take_snapshots()}")
            return 0
        case "reproduction":
            from course.reproduction import renew_report

            renew_report()
            return 0
        case _:
            return nbtools.main(options.command, getattr(options, "notebooks", []))


if __name__ == "__main__":
    sys.exit(main())
