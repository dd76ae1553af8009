"""Groups of options that commands share, and the rig, images and grid that they name."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

import omnistereo_lib
from omnistereo_lib.errors import OmnistereoError
from omnistereo_tools.parser import Options, is_own, is_tiny, option

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from omnistereo_lib.frame import Frame
    from omnistereo_lib.geometry.rig import Rig
    from omnistereo_lib.geometry.sphere import SphereGrid
    from omnistereo_tools.judge.coverage import Coverage

SAMPLE = Path(omnistereo_lib.__file__).parent / "sample"  # travels with the package
# names that the files of many rigs have
_SHARED = ("config", "calibration", "kalibr", "opencv", "camchain")
_GRID = re.compile("([0-9]{1,9})(?:x([0-9]{1,9})(?:x([0-9]{1,9}))?)?")
_TINY = 96, 16  # columns and spheres


@dataclass(frozen=True, kw_only=True)
class LensOptions(Options):
    """How far the lenses see."""

    max_fov: float | None = option("full field of view", unset="of the rig file", metavar="DEGREES")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.max_fov is not None:
            from omnistereo_lib.parse import check_fov

            check_fov(self.max_fov, "--max-fov")


@dataclass(frozen=True, kw_only=True)
class RigOptions(Options):
    """A rig of cameras."""

    rig: Path | None = option("rig file, folder of one, or data set", unset="the bundled sample")


@dataclass(frozen=True, kw_only=True)
class FrameOptions(RigOptions):
    """The images of a rig, or a data set."""

    images: tuple[Path, ...] | None = option("one per camera, in the order of the rig", needs="rig")


@dataclass(frozen=True, kw_only=True)
class StrictOptions(Options):
    """What counts as a failure."""

    strict: bool = option("exit with 1 where the rig and the images do not fit", False)


@dataclass(frozen=True, kw_only=True)
class DepthRange(Options):
    """Where the spheres begin."""

    min_depth: float | None = option(
        "nearest depth in metres", unset="of the rig file, or found", between=(1e-6, 1e9)
    )


@dataclass(frozen=True, kw_only=True)
class GridOptions(Options):
    """A panorama and its spheres, by default those of the public data sets."""

    grid: str = option(
        "columns, rows and spheres of the panorama, such as 640x320x192; without rows all that two"
        " cameras see, without spheres 192",
        "640",
        metavar="WxHxN",
    )

    def __post_init__(self) -> None:
        from omnistereo_lib.geometry.sphere import SphereGrid

        super().__post_init__()
        if not _GRID.fullmatch(self.grid):
            raise OmnistereoError(
                f"--grid is {self.grid}; expected columns x rows x spheres, such as 640x320x192"
            )
        width, height, spheres = self.sizes
        SphereGrid(width, 2 if height is None else height, num_spheres=spheres)

    @property
    def sizes(self) -> tuple[int, int | None, int]:
        """Columns, rows and spheres of the panorama; rows are None where they are left open."""
        found = _GRID.fullmatch(self.grid)
        assert found is not None  # `__post_init__` has looked
        width, height, spheres = (int(text) if text else None for text in found.groups())
        width, spheres = width or 0, 192 if spheres is None else spheres
        if is_tiny() and width > _TINY[0]:
            height = height and max(1, round(height * _TINY[0] / width))
            return _TINY[0], height, min(spheres, _TINY[1])
        return width, height, spheres


@dataclass(frozen=True, kw_only=True)
class DoctorOptions(DepthRange, FrameOptions):
    """Options of `omnistereo doctor`."""

    rig: Path | None = option(
        "rig file, folder of one, or data set", unset="check the installation instead"
    )
    write: Path | None = option(
        "write there the rig as the images show it", suffixes=(".yaml", ".yml"), needs="rig"
    )


@dataclass(frozen=True, kw_only=True)
class DeviceOptions(Options):
    """Where to compute."""

    device: Literal["auto", "cpu", "cuda"] = option("where to compute; auto: a GPU if any", "auto")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.device == "cuda":
            import torch

            if not torch.cuda.is_available():
                raise OmnistereoError("--device cuda: PyTorch finds no CUDA GPU. Use --device cpu")


@dataclass(frozen=True, kw_only=True)
class MethodOptions(DeviceOptions):
    """How depth is computed, and where."""

    own_methods: ClassVar[bool] = False  #: whether a method may be a Python file

    method: str | None = option("see above", unset="the most exact one")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.method is None:
            return
        if is_own(self.method) and self.own_methods:
            from omnistereo_tools.own_method import check_own

            check_own(Path(self.method))
        elif is_own(self.method):
            raise OmnistereoError(
                f"--method {self.method}: only `omnistereo depth` runs a file. Name a method"
            )
        else:
            from omnistereo_lib.stereo.methods import Method

            check_method("--method", self.method, Method.parse)


def check_method(flag: str, name: str, parse: Callable[[str], object]) -> None:
    """Raise an `OmnistereoError` that names what was typed if there is no such method."""
    try:
        parse(name)
    except OmnistereoError as error:
        raise OmnistereoError(f"{flag} {name}: {str(error).removeprefix(f'{name}: ')}") from None


def read_rig(options: RigOptions, images: Sequence[Path] = ()) -> Rig:
    """Return the rig with its masks, some perhaps beside its images, and say if it was turned
    level.

    Raises an `OmnistereoError` if files are missing.
    """
    return read_rig_and_clocks(options, images)[0]


def read_rig_and_clocks(
    options: RigOptions, images: Sequence[Path] = ()
) -> tuple[Rig, tuple[float, ...] | None]:
    """Return what `read_rig` does, and the seconds to add to each camera's times, if stated."""
    from omnistereo_rigs.formats import read as formats

    file = options.rig or SAMPLE
    read = formats.read_rig(file)
    from omnistereo_tools.input.masks import with_masks
    from omnistereo_tools.judge.coverage import turn_sentence
    from omnistereo_tools.progress import say

    if not read.is_own:
        name = read.found.name
        say(f"{file} ({name}) is converted; `omnistereo rig {file} rig.yaml` does it once.")
    if turned := turn_sentence(read.rig):
        say(turned)
    return with_masks(read.rig, images), read.found.clock_offsets_s


def read_frame(options: FrameOptions, number: int = 0) -> Frame:
    """Return the images and the rig with its masks, with the ground truth of a data set that has
    one, of which a frame is counted from 0.

    Raises an `OmnistereoError` if files are missing or broken.
    """
    from omnistereo_lib.dataset import load_dataset
    from omnistereo_lib.files import unpack
    from omnistereo_lib.frame import Frame, load_images

    if options.images is not None:
        rig = read_rig(options, options.images)
        images = load_images(options.images, rig)
        return Frame.of(mask_circles(rig, [images]), images)
    folder = options.rig or SAMPLE
    unpack(folder)
    if not folder.is_dir():
        raise OmnistereoError(
            f"{folder} is not a data set folder. Give --images, one per camera of the rig"
        )
    own = ("config.yaml", "ocam*.txt", "[0-9]*/cam[0-9]*")
    converted = None if any(next(folder.glob(name), None) for name in own) else read_rig(options)
    data = load_dataset(folder, rig=converted)
    if not -len(data) <= number < len(data):
        raise OmnistereoError(f"{folder} has frames 0 to {len(data) - 1}, not {number}")
    from omnistereo_tools.input.masks import with_masks

    return replace(data[number], rig=with_masks(data.rig, data[number].image_paths))


def mask_circles(rig: Rig, images: Sequence[Sequence[NDArray[np.uint8]]]) -> Rig:
    """Return the rig with what is black in images[frame][camera] masked, and warn of it."""
    from omnistereo_tools.input.masks import with_circles

    rig, found = with_circles(rig, images)
    warn_of([found] if found else [])
    return rig


def warn_of(doubts: Iterable[str]) -> None:
    """Warn of each."""
    for doubt in doubts:
        warnings.warn(doubt, stacklevel=2)


def find_min_depth(stated: float | None, frame: Frame) -> float:
    """Return the nearest depth in metres: as stated, of the rig file, or a look at the images."""
    if (known := frame.rig.min_depth if stated is None else stated) is not None:
        return known
    from omnistereo_tools.judge.first_look import propose_min_depth
    from omnistereo_tools.progress import say

    proposed = propose_min_depth(frame)
    say(
        "The rig file states no nearest depth: a coarse look at the images proposes --min-depth"
        f" {proposed:g}."
    )
    return proposed


def make_grid(
    options: GridOptions,
    coverage: Coverage,
    min_depth: float | None,
    phi_deg: tuple[float, float] | None = None,
) -> SphereGrid:
    """Return the panorama that the options ask for; `Coverage.propose` fills in the rest."""
    width, height, spheres = options.sizes
    return coverage.propose(width, height, phi_deg, spheres, min_depth)


def default_out(command: str, rig: Path | None) -> Path:
    """Return a folder for the results of a rig, another one for each rig."""
    if rig is None:
        return Path("out")
    rig = rig.resolve()
    if rig.name in ("train", "test"):
        return Path("out", f"{command}_{rig.parent.name}-{rig.name}")
    name = rig.parent.name if rig.stem in _SHARED and rig.suffix else rig.stem
    return Path("out", f"{command}_{name}")
