"""Options that several commands share, and the rig, images and grid that they name."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import omnistereo_lib
from omnistereo_lib.errors import OmnistereoError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from omnistereo_lib.dataset import Frame
    from omnistereo_lib.geometry.rig import Rig
    from omnistereo_lib.geometry.sphere import SphereGrid

SAMPLE = Path(omnistereo_lib.__file__).parent / "sample"  # travels with the package


def add_input(parser: argparse.ArgumentParser, recordings: bool = False, default: str = "the bundled sample") -> None:
    """Add the options that name a rig and its images; `default` says what is done without --rig."""
    parser.add_argument("--rig", type=Path, help=f"rig file, folder of one, or data set (default: {default})")
    parser.add_argument("--unit", choices=["mm", "cm", "m"], help="unit of the poses, if the file does not state it")
    each = "image, folder of images or video" if recordings else "image"
    parser.add_argument("--images", type=Path, nargs="+", help=f"one {each} per camera, in the order of the rig")
    parser.add_argument("--masks", type=Path, nargs="+", help="one per camera, bright = valid (default: mask.png)")
    parser.add_argument("--frame", type=int, default=0, help="frame of a data set, counted from 0 (default: 0)")


def add_grid(parser: argparse.ArgumentParser, width: int, height: int, spheres: int) -> None:
    """Add the options of the panorama and its spheres."""
    parser.add_argument("--width", type=int, default=width, help=f"panorama width (default: {width})")
    parser.add_argument("--height", type=int, default=height, help=f"panorama height (default: {height})")
    parser.add_argument(
        "--phi", type=float, nargs=2, default=(-45.0, 45.0), help="elevation range in degrees, down is positive"
    )
    parser.add_argument("--spheres", type=int, default=spheres, help=f"number of spheres N (default: {spheres})")
    parser.add_argument("--min-depth", type=float, help="nearest depth in metres (default: of the rig file, or found)")


def read_input(options: argparse.Namespace) -> tuple[Rig, list[NDArray], Frame | None]:
    """Return the rig with its masks, the images and, if there is ground truth, the frame.

    Raises an `OmnistereoError` if files are missing or broken, or --images comes without --rig.
    """
    from omnistereo_lib.dataset import load_dataset, load_images
    from omnistereo_tools.masks import with_masks

    if options.images is not None:
        rig = read_rig(options)
        return rig, load_images(options.images, rig), None
    folder = options.rig or SAMPLE
    if not folder.is_dir():
        raise OmnistereoError(f"{folder} is not a data set folder. Give --images, one per camera of the rig")
    data = load_dataset(folder, unit=options.unit)
    if not -len(data) <= options.frame < len(data):
        raise OmnistereoError(f"{folder} has frames 0 … {len(data) - 1}, not {options.frame}")
    frame = data[options.frame]
    rig = with_masks(data.rig, options.masks, frame.image_paths)
    return rig, frame.images, frame if frame.gt_path else None


def read_rig(options: argparse.Namespace) -> Rig:
    """Return the rig with its masks; an `OmnistereoError` if files are missing or --rig is."""
    from omnistereo_lib.rig_files import load_rig
    from omnistereo_tools.masks import with_masks

    if options.rig is None:
        raise OmnistereoError("--images needs --rig: the file or folder that describes the cameras")
    return with_masks(load_rig(options.rig, options.unit), options.masks, options.images or [])


def is_rig_alone(path: Path) -> bool:
    """Return whether a path is a rig file or a folder of one, not a data set."""
    return not any((*path.glob("cam[0-9]*/"), *path.glob("[0-9]*/cam[0-9]*/")))


def make_grid(
    options: argparse.Namespace, rig: Rig, images: Sequence[NDArray], default: float | None = None
) -> SphereGrid:
    """Return the grid; its nearest depth is the user's, else the rig file's, the default, or what the images show.

    Warns of what computes but can mean nothing, see `doubts`.
    """
    import warnings

    from omnistereo_lib.geometry.sphere import SphereGrid
    from omnistereo_tools.doubts import image_doubts, rig_doubts

    proposals = (options.min_depth, rig.min_depth, default)
    min_depth = next((depth for depth in proposals if depth is not None), None)
    if min_depth is None:
        from omnistereo_tools.nearest import propose_min_depth

        min_depth = propose_min_depth(rig, images, tuple(options.phi))
        print(f"The rig file states no nearest depth: a coarse look at the images proposes --min-depth {min_depth:g}.")
    grid = SphereGrid(options.width, options.height, tuple(options.phi), options.spheres, min_depth)
    for doubt in (*rig_doubts(rig, min_depth), *image_doubts(rig, images, grid)):
        warnings.warn(doubt, stacklevel=2)
    return grid


def add_device(parser: argparse.ArgumentParser, precision: bool = True) -> None:
    """Add the option that says where to compute, and in which precision."""
    parser.add_argument("--device", default="cpu", choices=["cpu", "cuda"], help="where to compute (default: cpu)")
    if precision:
        parser.add_argument("--precision", default="auto", choices=["auto", "float32", "bfloat16"])
