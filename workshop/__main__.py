"""`python -m workshop COMMAND`: what makes the notebooks, the book, the slides and the tables."""

import sys
from pathlib import Path

from course.__main__ import OUT, Commands


def main(arguments: list[str] | None = None) -> int:
    """Run one command of the workshop; return the exit status."""
    commands = Commands("workshop", __doc__)
    add = commands.add
    for name, calls, text in (
        ("run", "course.kernels.run", "run notebooks from fresh kernels, clean and store them"),
        (
            "clean",
            "course.nbtools.clean_stored",
            "remove what should not be stored: ids, timings, widget state",
        ),
        ("lint", "course.rules.lint", "check notebooks against the course's rules"),
        (
            "stills",
            "course.kernels.record_stills",
            "run notebooks and store what their live figures show, for the website and the slides",
        ),
    ):
        add(name, calls, text).add_argument("paths", nargs="+", type=Path, metavar="NOTEBOOK")
    for name, calls, text in (
        ("book", "publish.website.build", "build the website"),
        ("slides", "publish.slides.make_slides", "build the slides"),
    ):
        command = add(name, calls, text)
        command.add_argument("out", nargs="?", type=Path, default=OUT / name)
    command.add_argument("--notebook", help="of one notebook alone, such as 03")
    command.add_argument("--pdf", action="store_true", help="as PDF, too; needs Chromium")
    add(
        "pages",
        "publish.pages.main",
        "update the lists and pictures of the README and the book's pages",
    )
    answers = add("answers", "publish.answers.renew", "run the worked answers of book/answers.md")
    answers.add_argument("numbers", nargs="+", metavar="NUMBER", help="of a notebook, such as 03")
    add(
        "reproduction",
        "publish.reproduction.renew_report",
        "compute book/reproduction.md from the stored results",
    )
    results = add(
        "results",
        "results.stored_results.compute_results",
        "compute the stored results again: hours, but it resumes",
    )
    results.add_argument(
        "options", nargs="*", help="of every evaluation, after --, such as -- --cluster ADDRESS"
    )
    add(
        "rig-sizes",
        "results.rig_sizes.print_table",
        "how many rays are right at which distance, by size of rig",
    )
    add(
        "late-table",
        "results.late_table.print_table",
        "how often late cameras are found that are planted in the bundled drives",
    )
    planted = add(
        "planted-mistakes",
        "results.planted_mistakes.run",
        "plant mistakes in rigs and pictures, and count what the rig check says of them",
    )
    planted.add_argument("seed", type=int, help="from 50 on the book gets the table")
    planted.add_argument("--count", type=int, default=66, help="of cases (default: %(default)s)")
    world = add(
        "world-table",
        "results.world_table.print_table",
        "judge what `omnistereo world` made of a rendered drive",
    )
    world.add_argument("recording", type=Path, help="folder of the recording")
    world.add_argument(
        "data",
        nargs="?",
        default="sunny/train",
        help="the drive, or drive/test (default: %(default)s)",
    )
    bars = add(
        "error-bars",
        "results.error_bars.run",
        "fit the error bars of depth on some frames and judge them on others: minutes, resumes",
    )
    bars.add_argument("methods", nargs="*", metavar="METHOD", help="default: all that have any")
    bars.add_argument("--out", type=Path, default=OUT / "error_bars", help="what was measured")
    rays = add(
        "ray-sentences",
        "results.ray_sentences.run",
        "how often the sentence about a ray is right, and the book's table of it: minutes",
    )
    rays.add_argument("rays", type=int, nargs="?", default=60, help="of each frame")
    add(
        "snapshots",
        "results.snapshots.take_snapshots",
        "store what SweepNet makes of one frame while it learns",
    )
    ship = add(
        "ship",
        "results.ship.export_weights",
        "bundle the weights of a finished training run, with curve and card",
    )
    ship.add_argument("run", type=Path, help="folder of the run")
    ship.add_argument("--half", action="store_true", help="store float16: half the file")
    bench = add("bench", "results.bench.run", "time the library against named alternatives")
    bench.add_argument(
        "--quick",
        action="store_true",
        help="five minutes: without growth, nor the scale of the paper",
    )
    bench.add_argument(
        "--against", type=Path, metavar="CLONE", help="another clone, compared by turns"
    )
    return commands.run(arguments)


if __name__ == "__main__":
    sys.exit(main())
