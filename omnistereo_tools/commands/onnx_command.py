"""Export VolumeNet for a rig as ONNX, with a script that runs it without torch.

Examples:
  omnistereo onnx --rig rig.yaml --out onnx
      then, without torch: python onnx/run_onnx.py 1.png 2.png 3.png 4.png
"""

from dataclasses import dataclass
from pathlib import Path

from omnistereo_lib.errors import OmnistereoError
from omnistereo_tools.commands.options import GridOptions, RigOptions, make_grid, read_rig
from omnistereo_tools.outputs import check_outputs, hold
from omnistereo_tools.parser import option


@dataclass(frozen=True, kw_only=True)
class OnnxOptions(GridOptions, RigOptions):
    """Options of `omnistereo onnx`."""

    height: int | None = 160
    min_depth: float | None = option("nearest depth in metres", unset="of the rig file")
    out: Path = option("folder for the files", Path("out/onnx"))


def run(options: OnnxOptions) -> None:
    """Write the files and say what they are."""
    import shlex

    from omnistereo_tools.judge.coverage import Coverage
    from omnistereo_tools.onnx.onnx_export import FILES, check_installed, export_onnx

    check_installed()
    check_outputs(options, [options.out / name for name in FILES])
    rig = read_rig(options)
    min_depth = rig.min_depth if options.min_depth is None else options.min_depth
    if min_depth is None:
        raise OmnistereoError(f"{options.rig} states no nearest depth. Pass --min-depth, in metres")
    print("exporting takes about 20 s", flush=True)
    written = export_onnx(hold(options.out), rig, make_grid(options, Coverage.of(rig), min_depth))
    print(f"written to {options.out}/: {', '.join(written)}")
    script = shlex.quote(f"{options.out}/run_onnx.py")
    print(f"without torch: python {script} with one image for each of the {len(rig)} cameras")
