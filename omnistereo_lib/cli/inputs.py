"""What several commands share: the device, and who prints."""

import argparse
import os


def add_device(parser: argparse.ArgumentParser, precision: bool = True) -> None:
    """Add the option that says where to compute, and in which precision."""
    parser.add_argument("--device", default="cpu", choices=["cpu", "cuda"], help="where to compute (default: cpu)")
    if precision:
        parser.add_argument("--precision", default="auto", choices=["auto", "float32", "bfloat16"])


def is_first_process() -> bool:
    """Return whether this is the process that prints and writes: rank 0 under torchrun, or the only one."""
    return os.environ.get("RANK", "0") == "0"
