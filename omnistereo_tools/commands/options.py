"""Groups of options, most of which several commands share, and the rig, images and grid that they
name.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

import omnistereo_lib
from omnistereo_lib.errors import OmnistereoError
from omnistereo_tools.parser import Options, flag, is_own, option

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
class RigOptions(LensOptions):
    """A rig of cameras."""

    rig: Path | None = option("rig file, folder of one, or data set", unset="the bundled sample")
    unit: Literal["mm", "cm", "m"] | None = option(
        "unit of the poses, if the file does not state it"
    )
    masks: tuple[Path, ...] | None = option(
        "one per camera, bright = valid", unset="mask.png beside its images"
    )
    keep_frame: bool = option("do not turn the rig level", False)


@dataclass(frozen=True, kw_only=True)
class FrameOptions(RigOptions):
    """The images of a rig, or the frame of a data set."""

    images: tuple[Path, ...] | None = option("one per camera, in the order of the rig", needs="rig")
    frame: int | None = option("frame of a data set, counted from 0", unset="0")


@dataclass(frozen=True, kw_only=True)
class StrictOptions(Options):
    """What counts as a failure."""

    strict: bool = option("exit with 1 where the rig and the images do not fit", False)


@dataclass(frozen=True, kw_only=True)
class GridOptions(Options):
    """A panorama and its spheres, by default those of the public data sets."""

    width: int = option("columns", 640)
    height: int | None = option("rows", unset="all that two cameras see")
    phi: tuple[float, float] | None = option(
        "elevations in degrees, down is positive", unset="square pixels"
    )
    spheres: int = option("number of spheres N", 192)
    min_depth: float | None = option("nearest depth in metres", unset="of the rig file, or found")

    def __post_init__(self) -> None:
        from omnistereo_lib.geometry.sphere import SphereGrid

        super().__post_init__()
        height = 2 if self.height is None else self.height
        SphereGrid(
            self.width,
            height,
            self.phi or (-45, 45),
            self.spheres,
            1.0 if self.min_depth is None else self.min_depth,
        )


@dataclass(frozen=True, kw_only=True)
class DoctorOptions(GridOptions, FrameOptions):
    """Options of `omnistereo doctor`; the panorama is the one on which images are matched."""

    rig: Path | None = option(
        "rig file, folder of one, or data set", unset="check the installation instead"
    )
    width: int = 320
    height: int | None = 80
    spheres: int = 64
    write: Path | None = option(
        "write there the rig as the images show it", suffixes=(".yaml", ".yml")
    )
    coverage: Path | None = option(
        "draw there how many cameras see what", suffixes=(".png", ".jpg", ".jpeg")
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rig is None and (given := set(self.given()) - {"width", "height", "spheres"}):
            raise OmnistereoError(
                f"{flag(min(given))} needs --rig: the file or folder that describes the cameras"
            )


@dataclass(frozen=True, kw_only=True)
class ImagesOptions(Options):
    """Options of a calibration from images alone."""

    from_images: tuple[Path, ...] | None = option(
        "for each camera a folder, a video or one picture"
    )
    rig: Path | None = option("nominal poses; with a board: cameras whose intrinsics are kept")
    unit: Literal["mm", "cm", "m"] | None = option(
        "unit of the poses of --rig, if it does not state it", needs="rig"
    )
    lenses: Path | None = option(
        "rig file or folder of lens files: poses are not needed", needs="from_images"
    )
    baseline: float | None = option(
        "metres between cameras 1 and 2", needs="lenses", between=(1e-6, 1e4)
    )
    radius: float | None = option(
        "mean metres from the cameras' middle", needs="lenses", between=(1e-6, 1e4)
    )
    calibrated: bool = option(
        "the poses of --rig are a calibration: they keep weight", False, needs="rig"
    )
    free_lenses: bool = option(
        "adjust the lenses, too: a better fit, often a worse depth", False, needs="from_images"
    )
    frames: int = option("how many frames are chosen", 6, needs="from_images", between=(1, 1e4))
    max_fov: float | None = option(
        "field of view in degrees", unset="as far as corners reach, or of the lenses"
    )
    out: Path = option("folder for the results", Path("out/rig"))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.from_images is None:
            return
        if (self.rig is None) == (self.lenses is None):
            raise OmnistereoError(
                "--from-images needs --rig with nominal poses, or --lenses and one length"
            )
        if self.lenses is not None and (self.baseline is None) == (self.radius is None):
            raise OmnistereoError(
                "--lenses needs one length, because images do not tell a metre: --baseline or"
                " --radius"
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

            try:
                Method.parse(self.method)
            except OmnistereoError as error:
                raise OmnistereoError(f"--method {self.method}: {error}") from None


@dataclass(frozen=True, kw_only=True)
class PrecisionOptions(DeviceOptions):
    """Where networks are run, and in which precision."""

    precision: Literal["auto", "float32", "bfloat16"] = option("of networks", "auto")


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
    read = formats.read_rig(file, options.unit, options.max_fov, options.keep_frame)
    if not read.is_own:
        unit = f" --unit {options.unit}" if options.unit else ""
        once = f"omnistereo rig {file} rig.yaml{unit}"
        print(f"{file} ({read.dialect}) is converted; `{once}` does it once.")
    rig = read.rig
    # These load torch, which takes seconds: a rig that cannot be read is named before.
    from omnistereo_tools.input.masks import with_masks
    from omnistereo_tools.output.summary import turn_sentence
    from omnistereo_tools.progress import say

    if turned := turn_sentence(rig):
        say(turned)
    return with_masks(rig, options.masks, images), read.clock_offsets_s


def read_frame(options: FrameOptions) -> Frame:
    """Return the images and the rig with its masks, with the ground truth of a data set that has
    one.

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
    data = load_dataset(folder, None, options.unit, None, options.max_fov, converted)
    number = options.frame or 0
    if not -len(data) <= number < len(data):
        raise OmnistereoError(f"{folder} has frames 0 to {len(data) - 1}, not {number}")
    from omnistereo_tools.input.masks import with_masks

    return replace(data[number], rig=with_masks(data.rig, options.masks, data[number].image_paths))


def mask_circles(rig: Rig, images: Sequence[Sequence[NDArray[np.uint8]]]) -> Rig:
    """Return the rig with what is black in images[frame][camera] masked, and warn of it, see
    `with_circles`.
    """
    from omnistereo_tools.input.masks import with_circles

    rig, found = with_circles(rig, images)
    warn_of([found] if found else [])
    return rig


def warn_of(doubts: Iterable[str]) -> None:
    """Warn of each."""
    for doubt in doubts:
        warnings.warn(doubt, stacklevel=2)


def find_min_depth(stated: float | None, frame: Frame) -> float:
    """Return the nearest depth of the sweep in metres: as stated, else of the rig file, else a look
    at the images.
    """
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


def make_grid(options: GridOptions, coverage: Coverage, min_depth: float) -> SphereGrid:
    """Return the panorama that the options ask for; what they leave open is as `Coverage.propose`
    recommends.
    """
    return coverage.propose(options.width, options.height, options.phi, options.spheres, min_depth)


def default_out(command: str, rig: Path | None) -> Path:
    """Return a folder for the results of a rig, so that no rig overwrites those of another, or of
    the sample.
    """
    if rig is None:
        return Path("out")
    rig = rig.resolve()
    if rig.name in ("train", "test"):
        return Path("out", f"{command}_{rig.parent.name}-{rig.name}")
    return Path(
        "out", f"{command}_{rig.parent.name if rig.stem in _SHARED and rig.suffix else rig.stem}"
    )
