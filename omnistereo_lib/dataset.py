"""Data sets in the public layout of the Urban, OmniThings and OmniHouse releases, and ours.

folder/
  config.yaml | ocam*.txt + poses.txt | calibration.json     the rig, any dialect of `load_rig`
  cam1/0001.jpg …  cam2/ …                                   one folder per camera, files by frame number
  omnidepth_gt_640/00001.tiff                                inverse depth from the rig centre, 1/m
  train/ test/                                               or one such folder for each split
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import atomic_write, read_bytes, read_image, read_pixels
from omnistereo_lib.geometry.rig import Rig, Unit
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.rig_files import load_rig

_IMAGE_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff"}

# First and last training frame, first and last test frame, as the releases count them.
_PUBLISHED_SPLITS = {
    "sunny": ((1, 700), (701, 1000)),
    "cloudy": ((1, 700), (701, 1000)),
    "sunset": ((1, 700), (701, 1000)),
    "omnihouse": ((1, 2048), (2049, 2560)),
    "omnithings": ((1, 4096), (4097, 5120)),
}


@dataclass(frozen=True, eq=False)
class Frame:
    """What the cameras saw at one moment.

    Attributes
    ----------
    number : int
        Frame number, as in the file names.
    image_paths : list of paths, one for each camera
    truth_path : path or None
        Ground truth, where there is one.
    min_depth : float or None
        Metres; the 16-bit PNG ground truth of the first release is a fraction of 1/min_depth.
    """

    number: int
    image_paths: list[Path]
    truth_path: Path | None = None
    min_depth: float | None = None

    @cached_property
    def images(self) -> list[NDArray[np.uint8]]:
        """One array per camera, (height, width) or (height, width, 3) in RGB; read on first use."""
        return load_images(self.image_paths)

    @cached_property
    def inverse_depth(self) -> NDArray[np.float32]:
        """Ground truth, 1/m from the rig centre along each ray, 0 = sky, NaN unknown; read on first use.

        Raises
        ------
        OmnistereoError
            If the frame has none.
        """
        if self.truth_path is None:
            raise OmnistereoError(f"frame {self.number} has no ground truth beside {self.image_paths[0].parent}")
        return read_inverse_depth(self.truth_path, self.min_depth)

    def gt_index(self, grid: SphereGrid) -> NDArray[np.float64]:
        """Return the ground-truth sphere index n̂ on a grid, not rounded; NaN where it is unknown.

        As in all published sets, the ground truth's pixels are square and its middle is the horizon: 640 × 160
        reaches from -45° to 45°. Its half-pixel rule is the grid's. It is looked up at the nearest ray, since a
        mean over a depth edge is no depth.
        """
        truth = self.inverse_depth
        height, width = truth.shape
        highest = 180.0 * height / width
        truth_grid = SphereGrid(width, height, (-highest, highest), sampling=grid.sampling)
        nearest, inside = truth_grid.pixel(grid.rays())
        column, row = np.rint(nearest).astype(int).reshape(-1, 2).T
        found = truth[row.clip(0, height - 1), column % width].reshape(grid.shape)
        return grid.inverse_depth_to_index(np.where(inside, found, np.nan))


class Dataset(Sequence[Frame]):
    """Frames of one rig; see `load_dataset`."""

    def __init__(self, folder: Path, rig: Rig, frames: list[Frame]) -> None:
        self.folder, self.rig, self._frames = folder, rig, frames

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, i: int | slice) -> Frame | Dataset:
        if isinstance(i, slice):
            return Dataset(self.folder, self.rig, self._frames[i])
        return replace(self._frames[i])  # a new one, so that what it has read goes when it goes

    def frame(self, number: int) -> Frame:
        """Return the frame of a number, as in the file names.

        Raises
        ------
        OmnistereoError
            If the data set has no such frame.
        """
        for i, frame in enumerate(self._frames):
            if frame.number == number:
                return self[i]
        numbers = ", ".join(str(frame.number) for frame in self._frames[:12])
        raise OmnistereoError(f"{self.folder} has no frame {number}, it has {numbers}{' …' * (len(self) > 12)}")

    def __repr__(self) -> str:
        with_truth = sum(frame.truth_path is not None for frame in self._frames)
        width, height = self.rig.cameras[0].image_size
        return (
            f"Dataset({self.folder.name}: {len(self)} frames, {with_truth} with ground truth, "
            f"{len(self.rig)} cameras of {width} × {height})"
        )


def load_dataset(
    folder: str | Path, split: str | None = None, unit: Unit | None = None, truth_width: int | None = None
) -> Dataset:
    """Open a data set in the public layout (see the module's docstring); images are read when asked for.

    Parameters
    ----------
    folder : path
    split : "train" | "test" | None
        A folder of that name inside `folder`; for the published sets the frame numbers of their releases.
        None: every frame.
    unit : "mm" | "cm" | "m", optional
        Unit of the poses, for rig files that do not state it.
    truth_width : int, optional
        Which ground truth to take where there are several widths; the widest unless given.

    Raises
    ------
    OmnistereoError
        If the folder, the rig or the frames are missing, or a camera lacks a frame that the others have.
    """
    folder = Path(folder)
    if split is not None and (folder / split).is_dir():
        folder, split = folder / split, None
    rig = load_rig(folder, unit)
    cameras = sorted(folder.glob("cam[0-9]*"), key=lambda path: int(re.sub(r"\D", "", path.name) or -1))
    cameras = [path for path in cameras if path.is_dir()]
    if len(cameras) != len(rig):
        found = ", ".join(path.name for path in cameras) or "none"
        raise OmnistereoError(
            f"{folder} has camera folders {found}, its rig has {len(rig)} cameras: expected cam1, cam2 …"
        )
    images = [dict(_numbered(camera, _IMAGE_SUFFIXES)) for camera in cameras]
    truths = _truths(_truth_folder(folder), truth_width)
    frames = []
    for number in sorted(set().union(*images)):
        for camera, files in zip(cameras, images, strict=True):
            if number not in files:
                raise OmnistereoError(
                    f"{camera} has no image of frame {number}, other cameras have: complete the frame"
                )
        paths = [files[number] for files in images]
        frames.append(Frame(number, paths, truths.get(number), rig.min_depth))
    if split is not None:
        frames = _published_split(folder, split, frames)
    if not frames:
        raise OmnistereoError(
            f"{folder} holds no frames{f' of split {split}' if split else ''}: expected cam1/0001.png …"
        )
    return Dataset(folder, rig, frames)


def load_images(paths: Sequence[str | Path]) -> list[NDArray[np.uint8]]:
    """Read one picture for each camera, in the rig's order; see `read_image` for shapes and errors."""
    return [read_image(path) for path in paths]


def read_inverse_depth(path: str | Path, min_depth: float | None = None) -> NDArray[np.float32]:
    """Read a ground-truth panorama of inverse depth in 1/m; 0 is infinitely far, NaN unknown.

    Float TIFF holds it as it is; two-page files of the current releases carry a thumbnail first, which is
    passed over. 16-bit PNG of the first release holds it in steps of 1/(65500 min_depth).

    Raises
    ------
    OmnistereoError
        If the file is neither, or is a PNG and min_depth is not given.
    """
    path = Path(path)
    truth = _read_png16(path, min_depth) if path.suffix.lower() == ".png" else _read_float_tiff(path)
    return np.where(np.isfinite(truth) & (truth >= 0), truth, np.nan).astype(np.float32)


def write_inverse_depth(path: str | Path, inverse_depth: NDArray) -> None:
    """Write a panorama of inverse depth in 1/m as a deflated float32 TIFF."""
    import tifffile

    with atomic_write(path) as temporary:
        tifffile.imwrite(temporary, np.asarray(inverse_depth, np.float32), compression="deflate")


def _read_float_tiff(path: Path) -> NDArray[np.float32]:
    import tifffile

    read_bytes(path)  # a missing file is said in our words
    try:
        with tifffile.TiffFile(path) as tiff:
            pages = [page.asarray() for page in tiff.pages if page.ndim == 2 and page.dtype.kind == "f"]
    except Exception as error:  # the library raises whatever a broken file makes it raise
        raise OmnistereoError(f"{path} is not a whole TIFF file: {error}. Copy it again") from None
    if len(pages) != 1:
        raise OmnistereoError(f"{path} has {len(pages)} float pages, expected one of inverse depth in 1/m")
    return pages[0]


def _read_png16(path: Path, min_depth: float | None) -> NDArray[np.float64]:
    import cv2

    steps = read_pixels(path, cv2.IMREAD_UNCHANGED)
    if steps.ndim != 2 or steps.dtype != np.uint16:
        raise OmnistereoError(
            f"{path} holds {steps.dtype} of shape {steps.shape}, expected 16-bit gray steps of inverse depth"
        )
    if min_depth is None:
        raise OmnistereoError(f"{path} counts inverse depth in units of 1/min_depth: the rig's file must state it")
    return steps / (65500.0 * min_depth)


def _truth_folder(folder: Path) -> Path:
    """Return where the ground truth lies: beside the pictures, or where config.yaml's `dataset: truth` points.

    Our sets of one drive in several lights share the ground truth of one of them.
    """
    import yaml

    config = folder / "config.yaml"
    content = yaml.safe_load(read_bytes(config)) if config.is_file() else None
    dataset = content.get("dataset") if isinstance(content, dict) else None
    elsewhere = dataset.get("truth") if isinstance(dataset, dict) else None
    if elsewhere is None:
        return folder
    if not (folder / str(elsewhere)).is_dir():
        raise OmnistereoError(f"{config} says that the ground truth is in {elsewhere}: there is no such folder")
    return folder / str(elsewhere)


def _truths(folder: Path, width: int | None) -> dict[int, Path]:
    """Return the ground-truth files of a folder by frame number, of the widest size or of the one asked for.

    The first release kept one ground truth for all weathers, beside their folders, split in train and test.
    """
    parents = [*folder.glob("omnidepth_gt_*"), *folder.glob("depth_*")] or folder.parent.glob("depth_t*_*")
    by_width: dict[int, list[Path]] = {}
    for path in parents:
        size = path.name.rsplit("_", 1)[1]
        if size.isdigit():
            by_width.setdefault(int(size), []).append(path)
    if width is not None and width not in by_width:
        raise OmnistereoError(f"{folder} has ground truth of widths {sorted(by_width)}, not of {width}")
    chosen = by_width[width or max(by_width)] if by_width else []
    return dict(file for path in chosen for file in _numbered(path, {".tiff", ".tif", ".png"}))


def _numbered(folder: Path, suffixes: set[str]) -> Iterator[tuple[int, Path]]:
    """Yield (number, path) of the files whose name is a number; 0001 and 00001 are the same frame."""
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() in suffixes and path.stem.isdigit():
            yield int(path.stem), path


def _published_split(folder: Path, split: str, frames: list[Frame]) -> list[Frame]:
    ranges = _PUBLISHED_SPLITS.get(folder.name.lower())
    if ranges is None or split not in ("train", "test"):
        raise OmnistereoError(
            f"{folder} has no split {split!r}: expected a folder of that name, or one of the published sets "
            f"{', '.join(_PUBLISHED_SPLITS)} with train or test"
        )
    first, last = ranges[split == "test"]
    return [frame for frame in frames if first <= frame.number <= last]
