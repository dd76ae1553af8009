"""Train a learned matching cost, or resume an interrupted run.

Examples:
  omnistereo train sweepnet --preset teaching --set steps=100
      a hundred steps; run it again to resume
"""

import argparse
import re
from pathlib import Path

from omnistereo_lib.errors import OmnistereoError
from omnistereo_tools.commands.options import add_device, check_typed
from omnistereo_tools.outputs import check_outputs
from omnistereo_tools.tiny import shrink


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("network", choices=["sweepnet", "mccnn", "volumenet"])
    parser.add_argument("--preset", default="teaching", help="teaching, shipped, paper … (default: teaching)")
    parser.add_argument("--set", nargs="+", default=[], metavar="NAME=VALUE", help="change numbers of the preset")
    parser.add_argument("--init-weights", type=Path, metavar="FILE", help="start from trained weights, not random ones")
    parser.add_argument("--data", type=Path, nargs="+", help="data sets, or endless (default: those of the preset)")
    add_device(parser)
    parser.add_argument("--out", type=Path, help="folder of the run (default: out/NETWORK_PRESET_SETTINGS)")
    parser.set_defaults(resumes=True)


def run(options: argparse.Namespace) -> None:
    """Train a network to the end, with a progress bar; several processes under torchrun share the work."""
    from tqdm import tqdm

    from omnistereo_lib.stereo.device import number_from_environment
    from omnistereo_lib.train import RECIPES, train
    from omnistereo_lib.train.loop import LOG, STATE, WEIGHTS

    check_typed(options)
    presets = RECIPES[options.network]
    if options.preset not in presets:
        raise OmnistereoError(f"{options.network} has the presets {', '.join(presets)}, not {options.preset!r}")
    recipe = shrink(presets[options.preset].with_overrides(options.set))
    named = "_".join([options.network, options.preset, *sorted(options.set)])
    out = options.out or Path("out") / re.sub(r"[^\w.,=+-]", "-", named)
    check_outputs(options, [out / name for name in (LOG, STATE, WEIGHTS)])
    rank, _, _ = (number_from_environment(name, 0) for name in ("RANK", "LOCAL_RANK", "WORLD_SIZE"))  # of torchrun
    first_process = rank == 0  # the one that prints
    bar = None

    def show(row: dict[str, float]) -> None:
        nonlocal bar
        if bar is None:  # the time left counts from the first step of this call
            bar = tqdm(total=recipe.steps, initial=row["step"], desc="train", unit="step", disable=not first_process)
        bar.set_postfix(loss=f"{row['loss']:.3f}", error=f"{row['error']:.1%}", refresh=False)
        bar.update()
        if first_process and row["validation_loss"] == row["validation_loss"]:
            bar.write(f"step {row['step'] + 1}: validation {row['validation_loss']:.4f} {row['validation_error']:.2%}")

    train(
        recipe,
        out,
        options.data,
        options.device,
        options.precision,
        init_weights=options.init_weights,
        on_step=show,
    )
    if bar is not None:
        bar.close()
    if first_process:
        print(f"{recipe.steps} steps are done; in {out}/: log.csv, state.safetensors, weights.safetensors")
