"""Train a learned matching cost, or resume an interrupted run.

Examples:
  omnistereo train sweepnet --preset teaching --set steps=100
      a hundred steps; run it again to resume
"""

import re
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import Literal

from omnistereo_lib.errors import OmnistereoError
from omnistereo_tools.commands.options import DeviceOptions
from omnistereo_tools.outputs import check_outputs
from omnistereo_tools.parser import option, shrink


@dataclass(frozen=True, kw_only=True)
class TrainOptions(DeviceOptions):
    """Options of `omnistereo train`."""

    resumes = True

    network: Literal["sweepnet", "mccnn", "volumenet"] = option(
        "what is trained", MISSING, positional=True
    )
    preset: str = option("teaching, shipped, paper …", "teaching")
    set: tuple[str, ...] = option("change numbers of the preset", (), metavar="NAME=VALUE")
    init_weights: Path | None = option(
        "start from trained weights, not random ones", metavar="FILE"
    )
    data: tuple[Path, ...] | None = option("data sets, or endless", unset="those of the preset")
    out: Path | None = option("folder of the run", unset="out/NETWORK_PRESET_SETTINGS")


def run(options: TrainOptions) -> None:
    """Train a network to the end, with a progress bar; processes of torchrun share the work."""
    from omnistereo_learn import RECIPES, train
    from omnistereo_learn.loop import LOG, STATE, WEIGHTS
    from omnistereo_learn.provenance import PROVENANCE
    from omnistereo_lib.stereo.device import number_from_environment
    from omnistereo_tools.progress import progress_bar, say

    presets = RECIPES[options.network]
    if options.preset not in presets:
        raise OmnistereoError(
            f"{options.network} has the presets {', '.join(presets)}, not {options.preset!r}"
        )
    recipe = shrink(presets[options.preset].with_overrides(options.set))
    named = "_".join([options.network, options.preset, *sorted(options.set)])
    out = options.out or Path("out") / re.sub(r"[^\w.,=+-]", "-", named)
    check_outputs(options, [out / name for name in (LOG, STATE, WEIGHTS, PROVENANCE)])
    # of torchrun
    rank, _, _ = (number_from_environment(name, 0) for name in ("RANK", "LOCAL_RANK", "WORLD_SIZE"))
    first_process, progress = rank == 0, progress_bar("step")

    def show(row: dict[str, float]) -> None:
        if not first_process:
            return
        done = int(row["step"]) + 1
        progress(done, recipe.steps, f"loss {row['loss']:.3f} error {row['error']:.1%}")
        if row["validation_loss"] == row["validation_loss"]:  # it is measured now and then
            say(
                f"step {done}: validation {row['validation_loss']:.4f}"
                f" {row['validation_error']:.2%}"
            )

    train(
        recipe, out, options.data, options.device, init_weights=options.init_weights, on_step=show
    )
    if first_process:
        print(
            f"{recipe.steps} steps are done; in {out}/: log.csv, state.safetensors,"
            " weights.safetensors"
        )
