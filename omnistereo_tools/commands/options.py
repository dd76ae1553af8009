"""Options that several commands share, and the rig, images and grid that they name."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import omnistereo_lib
from omnistereo_lib.errors import OmnistereoError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from omnistereo_lib.frame import Frame
    from omnistereo_lib.geometry.rig import Rig
    from omnistereo_lib.geometry.sphere import SphereGrid

WIDTH, SPHERES = 640, 192  # of a panorama: the size of the public data sets
SAMPLE = Path(omnistereo_lib.__file__).parent / "sample"  # travels with the package


def add_rig(parser: argparse.ArgumentParser, **rig: object) -> None:
    """Add the options that name a rig; keyword arguments are those of --rig."""
    parser.add_argument("--rig", type=Path, **rig)
    parser.add_argument("--unit", choices=["mm", "cm", "m"], help="unit of the poses, if the file does not state it")
    add_max_fov(parser)
    parser.add_argument("--keep-frame", action="store_true", help="do not turn the rig level")


def add_max_fov(parser: argparse.ArgumentParser) -> None:
    """Add the option that limits the field of view of rigs."""
    parser.add_argument(
        "--max-fov", type=float, metavar="DEGREES", help="full field of view (default: of the rig file)"
    )


def add_images(parser: argparse.ArgumentParser, each: str = "image") -> None:
    """Add the options that name the images of a rig, or the frame of a data set."""
    parser.add_argument("--images", type=Path, nargs="+", help=f"one {each} per camera, in the order of the rig")
    parser.add_argument("--masks", type=Path, nargs="+", help="one per camera, bright = valid (default: mask.png)")
    parser.add_argument("--frame", type=int, help="frame of a data set, counted from 0 (default: 0)")


def add_grid(parser: argparse.ArgumentParser, width: int, height: int | None, spheres: int) -> None:
    """Add the options of the panorama and its spheres; without a height it shows all that two cameras see."""
    rows = "all that two cameras see" if height is None else str(height)
    parser.add_argument("--width", type=int, default=width, help=f"panorama width (default: {width})")
    parser.add_argument("--height", type=int, default=height, help=f"panorama height (default: {rows})")
    parser.add_argument(
        "--phi", type=float, nargs=2, help="elevation range in degrees, down is positive (default: square pixels)"
    )
    parser.add_argument("--spheres", type=int, default=spheres, help=f"number of spheres N (default: {spheres})")
    parser.add_argument("--min-depth", type=float, help="nearest depth in metres (default: of the rig file, or found)")


def add_device(parser: argparse.ArgumentParser, precision: bool = True) -> None:
    """Add the option that says where to compute, and in which precision."""
    parser.add_argument("--device", default="cpu", choices=["cpu", "cuda"], help="where to compute (default: cpu)")
    if precision:
        parser.add_argument("--precision", default="auto", choices=["auto", "float32", "bfloat16"])


def check_typed(options: argparse.Namespace) -> None:
    """Raise an `OmnistereoError` if a number, method or device that was typed cannot be; no file is opened."""
    from omnistereo_lib.geometry.sphere import SphereGrid
    from omnistereo_lib.rig_files.parse import check_fov
    from omnistereo_lib.stereo.device import select_device
    from omnistereo_lib.stereo.methods import Method

    typed = vars(options)
    if typed.get("method") is not None:
        Method.parse(options.method)
    if "device" in typed:
        select_device(options.device)
    if typed.get("max_fov") is not None:
        check_fov(options.max_fov, "max_fov_deg")
    if "spheres" in typed:
        phi_deg, min_depth = options.phi or (-45, 45), 1.0 if options.min_depth is None else options.min_depth
        SphereGrid(options.width, options.height or 2, phi_deg, options.spheres, min_depth)


def read_rig(options: argparse.Namespace) -> Rig:
    """Return the rig, and say if it was turned level; an `OmnistereoError` if files are missing or --rig is."""
    from omnistereo_lib.rig_files import load_rig
    from omnistereo_tools.output.summary import turn_sentence

    if options.rig is None:
        raise OmnistereoError("--images needs --rig: the file or folder that describes the cameras")
    rig = load_rig(options.rig, options.unit, options.max_fov, options.keep_frame)
    if turned := turn_sentence(rig):
        print(turned)
    return rig


def read_masked_rig(options: argparse.Namespace) -> Rig:
    """Return the rig with the masks of --masks, or those beside its images, see `read_rig`."""
    from omnistereo_tools.input.masks import with_masks

    return with_masks(read_rig(options), options.masks, options.images or [])


def mask_circles(rig: Rig, images: Sequence[Sequence[NDArray[np.uint8]]]) -> Rig:
    """Return the rig with what is black in images[frame][camera] masked, and warn of it, see `image_circle`."""
    import warnings

    from omnistereo_tools.input.image_circle import with_circles

    rig, found = with_circles(rig, images)
    if found is not None:
        warnings.warn(found, stacklevel=2)
    return rig


def read_frame(options: argparse.Namespace) -> Frame:
    """Return the images and the rig with its masks, with the ground truth of a data set that has one.

    Raises an `OmnistereoError` if files are missing or broken, or --images comes without --rig.
    """
    from omnistereo_lib.dataset import load_dataset
    from omnistereo_lib.frame import Frame, load_images
    from omnistereo_tools.input.masks import with_masks

    if options.images is not None:
        rig = read_masked_rig(options)
        images = load_images(options.images, rig)
        return Frame.of(mask_circles(rig, [images]), images)
    folder = options.rig or SAMPLE
    if not folder.is_dir():
        raise OmnistereoError(f"{folder} is not a data set folder. Give --images, one per camera of the rig")
    data = load_dataset(folder, None, options.unit, None, options.max_fov, options.keep_frame)
    number = options.frame or 0
    if not -len(data) <= number < len(data):
        raise OmnistereoError(f"{folder} has frames 0 to {len(data) - 1}, not {number}")
    return replace(data[number], rig=with_masks(data.rig, options.masks, data[number].image_paths))


def make_grid(options: argparse.Namespace, rig: Rig, images: Sequence[NDArray[np.uint8]] = ()) -> SphereGrid:
    """Return the recommended grid, in which the user's options stay; see `Coverage.propose` and `propose_min_depth`."""
    from omnistereo_lib.stereo.device import check_memory, select_device
    from omnistereo_tools.input.nearest import propose_min_depth
    from omnistereo_tools.judge.coverage import Coverage

    min_depth = rig.min_depth if options.min_depth is None else options.min_depth
    if min_depth is None and not images:
        raise OmnistereoError(f"{options.rig} states no nearest depth. Pass --min-depth, in metres")
    if min_depth is None:
        min_depth = propose_min_depth(rig, images)
        print(f"The rig file states no nearest depth: a coarse look at the images proposes --min-depth {min_depth:g}.")
    phi = options.phi and tuple(options.phi)
    grid = Coverage.of(rig).propose(options.width, options.height, phi, options.spheres, min_depth)
    check_memory(len(rig), grid, select_device(getattr(options, "device", "cpu")))
    return grid
