"""Evaluate methods on data sets, as Table II of the paper does, or resume an interrupted evaluation.

Examples:
  omnistereo evaluate --sets sunny indoor --methods zncc+sgm sweepnet+sgm --scale teaching
      two methods on two of the bundled sets; run it again to resume
"""

import argparse
from functools import partial
from pathlib import Path

from omnistereo_tools.commands.options import add_device, add_max_fov, check_typed
from omnistereo_tools.outputs import check_outputs
from omnistereo_tools.tiny import is_tiny, shrink


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("--sets", nargs="+", default=["sunny", "cloudy", "sunset"], help="names or data set folders")
    parser.add_argument("--split", choices=["train", "test"], help="(default: test of a bundled name, all of a folder)")
    parser.add_argument("--frames", type=int, nargs="+", help="frame numbers (default: all with ground truth)")
    parser.add_argument("--methods", nargs="+", default=[], help="such as zncc sweepnet+sgm,p1=0.2 (default: all)")
    ablations = "window weights pairs wrap subindex penalties spheres"
    parser.add_argument("--ablations", nargs="+", default=[], metavar="NAME", help=ablations)
    parser.add_argument("--scale", default="teaching", choices=["teaching", "training", "paper"])
    parser.add_argument("--weights", type=Path, help="folder of weights files (default: the bundled ones)")
    parser.add_argument("--cluster", metavar="ADDRESS", help="of a Dask scheduler, to use many machines")
    add_max_fov(parser)
    add_device(parser)
    parser.add_argument("--out", type=Path, help="folder for the results (default: out/evaluation_SCALE)")
    parser.add_argument("--rig", type=Path, help="rig file or folder to use instead of the rigs of the data sets")
    parser.set_defaults(resumes=True)


def run(options: argparse.Namespace) -> None:
    """Evaluate methods on data sets, merge the results and print the table."""
    from tqdm import tqdm

    from omnistereo_lib.evaluate import SCALES, Evaluation, errors_table, find_sets, select_methods, write_results
    from omnistereo_lib.stereo.weights import BUNDLED_WEIGHTS

    check_typed(options)
    out = options.out or Path("out") / f"evaluation_{options.scale}"
    tables = (out / f"{name}.{suffix}" for name in ("errors", "regions") for suffix in ("txt", "md", "csv"))
    check_outputs(options, [out / "results.json", *tables], [out / "frames"])
    arguments = {
        "out": out,
        "scale": shrink(SCALES[options.scale]),
        "methods": select_methods(options.methods, options.ablations),
        "sets": find_sets(options.sets, options.split),
        "split": options.split,
        "frames": options.frames,
        "weights": options.weights or BUNDLED_WEIGHTS,
        "device": options.device,
        "precision": options.precision,
        "rig": options.rig,
        "max_fov_deg": options.max_fov,
    }
    evaluation = Evaluation(**arguments)
    if is_tiny():  # one frame of each set
        first = {job.data: job.frame for job in reversed(evaluation.jobs)}
        evaluation.jobs = [job for job in evaluation.jobs if job.frame == first[job.data]]
    run_jobs = evaluation.run
    if options.cluster is not None:
        from omnistereo_tools.record.cluster import evaluate_on_cluster

        run_jobs = partial(evaluate_on_cluster, options.cluster, arguments)
    total = len(evaluation.jobs)
    with tqdm(total=total, initial=total - len(evaluation.missing()), desc="evaluate", unit="result") as bar:
        for job in run_jobs(evaluation.jobs):
            bar.set_postfix_str(f"{job.data} {job.frame} {job.method.name}", refresh=False)
            bar.update()
    results = evaluation.results()
    written = write_results(evaluation.out, results)
    print(errors_table(results).text(), end="")
    print(f"written to {evaluation.out}/: {', '.join(written)}")
