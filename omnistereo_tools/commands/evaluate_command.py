"""Evaluate methods on data sets, as Table II of the paper does, or resume an interrupted
evaluation.

Examples:
  omnistereo evaluate --sets sunny indoor --methods zncc+sgm sweepnet+sgm --scale teaching
      two methods on two of the bundled sets; run it again to resume
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

from omnistereo_tools.commands.options import DeviceOptions, check_method
from omnistereo_tools.outputs import check_outputs
from omnistereo_tools.parser import is_tiny, option, shrink

_MEAN_ERRORS = slice(3, None, 5)  # of the metrics of each set


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions(DeviceOptions):
    """Options of `omnistereo evaluate`."""

    resumes = True

    sets: tuple[str, ...] = option("names or data set folders", ("sunny", "cloudy", "sunset"))
    frames: tuple[int, ...] | None = option("frame numbers", unset="all with ground truth")
    methods: tuple[str, ...] = option("such as zncc sweepnet+sgm,p1=0.2", (), unset="all")
    ablations: tuple[str, ...] = option(
        "window weights pairs wrap subindex penalties spheres", (), metavar="NAME"
    )
    scale: Literal["teaching", "training", "paper"] = option("size of the panoramas", "teaching")
    weights: Path | None = option("folder of weights files", unset="the bundled ones")
    cluster: str | None = option("of a Dask scheduler, to use many machines", metavar="ADDRESS")
    out: Path | None = option("folder for the results", unset="out/evaluation_SCALE")
    rig: Path | None = option("rig file or folder to use instead of the rigs of the data sets")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.methods:
            from omnistereo_learn.evaluate.methods import EvaluatedMethod

            for name in self.methods:
                check_method("--methods", name, EvaluatedMethod.parse)


def run(options: EvaluateOptions) -> None:
    """Evaluate methods on data sets, merge the results and print the table."""
    from omnistereo_learn.evaluate import (
        SCALES,
        Evaluation,
        errors_table,
        find_sets,
        select_methods,
        write_results,
    )
    from omnistereo_lib.stereo.weights import BUNDLED_WEIGHTS
    from omnistereo_tools.progress import progress_bar

    out = options.out or Path("out") / f"evaluation_{options.scale}"
    tables = (
        out / f"{name}.{suffix}"
        for name in ("errors", "regions")
        for suffix in ("txt", "md", "csv")
    )
    check_outputs(options, [out / "results.json", *tables], [out / "frames"])
    arguments: dict[str, Any] = {
        "out": out,
        "scale": shrink(SCALES[options.scale]),
        "methods": select_methods(options.methods, options.ablations),
        "sets": find_sets(options.sets),
        "frames": options.frames,
        "weights": options.weights or BUNDLED_WEIGHTS,
        "device": options.device,
        "rig": options.rig,
    }
    evaluation = Evaluation(**arguments)
    if is_tiny():  # one frame of each set
        first = {job.data: job.frame for job in reversed(evaluation.jobs)}
        evaluation.jobs = [job for job in evaluation.jobs if job.frame == first[job.data]]
    run_jobs = evaluation.run
    if options.cluster is not None:
        from omnistereo_tools.record.cluster import evaluate_on_cluster

        run_jobs = partial(evaluate_on_cluster, options.cluster, arguments)
    total, left, progress = len(evaluation.jobs), len(evaluation.missing()), progress_bar("result")
    for done, job in enumerate(run_jobs(evaluation.jobs), total - left + 1):
        progress(done, total, f"{job.data} {job.frame} {job.method.name}")
    results = evaluation.results()
    written = write_results(evaluation.out, results)
    table = errors_table(results)
    errors = {words[0]: cells[_MEAN_ERRORS, 0].mean() for words, cells in table.rows}
    best = min(errors, key=lambda name: errors[name])
    print(f"{best} has the lowest mean error, {errors[best]:.2g} % of the range swept.")
    print(table.text(), end="")
    print(f"written to {evaluation.out}/: {', '.join(written)}")
    print(evaluation.out / "errors.md")
