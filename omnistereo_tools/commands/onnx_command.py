"""Export VolumeNet for a rig as ONNX, with a script that runs it without torch.

Examples:
  omnistereo onnx --rig rig.yaml --out onnx
      then, without torch: python onnx/run_onnx.py 1.png 2.png 3.png 4.png
"""

import argparse
from pathlib import Path

from omnistereo_tools.commands.options import SAMPLE, add_grid, add_rig, check_typed, make_grid, read_rig
from omnistereo_tools.outputs import check_outputs, hold


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_rig(parser, default=SAMPLE, help="rig file or folder (default: the bundled sample)")
    add_grid(parser, width=640, height=160, spheres=192)
    parser.add_argument("--out", type=Path, default=Path("out/onnx"), help="folder for the files (default: out/onnx)")


def run(options: argparse.Namespace) -> None:
    """Write the files and say what they are."""
    import shlex

    from omnistereo_tools.onnx.onnx_export import FILES, check_installed, export_onnx

    check_typed(options)
    check_installed()
    check_outputs(options, [options.out / name for name in FILES])
    rig = read_rig(options)
    print("exporting takes about 20 s", flush=True)
    written = export_onnx(hold(options.out), rig, make_grid(options, rig))
    print(f"written to {options.out}/: {', '.join(written)}")
    script = shlex.quote(f"{options.out}/run_onnx.py")
    print(f"without torch: python {script} with one image for each of the {len(rig)} cameras")
