"""Export VolumeNet for a rig as ONNX, with a script that runs it without torch.

Examples:
  omnistereo onnx --rig rig.yaml --out onnx
      then, without torch: python onnx/run_onnx.py 1.png 2.png 3.png 4.png
"""

from dataclasses import dataclass
from pathlib import Path

from omnistereo_tools.commands.options import GridOptions, RigOptions, make_grid, read_rig
from omnistereo_tools.outputs import check_outputs, hold
from omnistereo_tools.parser import option


@dataclass(frozen=True, kw_only=True)
class OnnxOptions(GridOptions, RigOptions):
    """Options of `omnistereo onnx`."""

    grid: str = "640x160x192"
    out: Path = option("folder for the files", Path("out/onnx"))


def run(options: OnnxOptions) -> None:
    """Write the files and say what they are."""
    import shlex

    from omnistereo_tools.judge.coverage import Coverage
    from omnistereo_tools.onnx.onnx_export import FILES, check_installed, export_onnx
    from omnistereo_tools.progress import say

    check_installed()
    check_outputs(options, [options.out / name for name in FILES])
    rig = read_rig(options)
    grid = make_grid(options, Coverage.of(rig), rig.min_depth)
    say("exporting takes about 20 s")
    written = export_onnx(hold(options.out), rig, grid)
    print(f"Good: VolumeNet for {len(rig)} cameras, {grid.width} × {grid.height} rays.")
    print(f"written to {options.out}/: {', '.join(written)}. Then, without torch:")
    images = " ".join(f"{k}.png" for k in range(1, len(rig) + 1))
    print(f"python {shlex.quote(f'{options.out}/run_onnx.py')} {images}")
