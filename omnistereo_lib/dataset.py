"""Data sets in the public layout of the Urban, OmniThings and OmniHouse releases, and ours.

folder/
  config.yaml | ocam*.txt + poses.txt   the rig, as `load_rig` reads it
  cam1/0001.jpg …  cam2/ …              one folder per camera, files by frame number
  omnidepth_gt_640/00001.tiff           ground truth: inverse depth from the rig centre, 1/m
  omnidepth_gt_1200/00001.tiff          the same frames at another panorama width
  omnidepth_world_640/00001.tiff        in their place: as `omnistereo world` has refined it
  poses/00001.json                      of a frame with other poses than the rig: `write_poses`
  train/ test/                          or one such folder for each split
  0001/ 0002/ …                         or one such folder for each rig

A folder may also lie packed, as folder.zip; see `files.unpack`.

The number in the name of a ground-truth folder is its panorama width in pixels: the releases have
640 × 160, our sets also 1200 × 300, the panorama size of the paper. Of several widths
`load_dataset` reads one.

In our training worlds every frame has its own rig: `things/train/0001/` is a folder in this layout
with one frame. They form one data set whose frames carry their rigs, `Frame.rig`; `Dataset.rig` is
for sets in which all frames share one. In a recording whose cameras have turned on the way,
`Frame.rig` is as the frame's depth was computed with.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import overload

import numpy as np

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import (
    as_path,
    make_folder,
    path_within,
    read_data,
    read_text,
    unpack,
    write_text,
)
from omnistereo_lib.frame import Frame
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.rig import Rig, Unit
from omnistereo_lib.rig_file import load_rig

_CAMERA = r"cam([0-9]+)"
_RIG_FOLDER = r"([0-9]+)"
_IMAGE = r"([0-9]+)\.(?i:png|jpe?g|bmp|tiff?)"
_GT = r"([0-9]+)\.(?i:png|tiff?)"
_GT_FOLDER = r"(?:omnidepth_gt|omnidepth_world|depth)_(?:.*_)?([0-9]+)"

_POSES = "poses"

# Last training frame and last test frame of the releases; the first frame is 1.
_PUBLISHED_SPLITS = dict.fromkeys(("sunny", "cloudy", "sunset"), (700, 1000))
_PUBLISHED_SPLITS |= {"omnihouse": (2048, 2560), "omnithings": (4096, 5120)}


class Dataset(Sequence[Frame]):
    """Frames of one rig, or of a rig each (`rig` is None); see `load_dataset`."""

    def __init__(self, folder: Path, rig: Rig | None, frames: list[Frame]) -> None:
        self.folder, self._rig, self._frames = folder, rig, frames

    @property
    def rig(self) -> Rig:
        """The rig of all frames; an `OmnistereoError` if every frame has its own."""
        if self._rig is None:
            raise OmnistereoError(
                f"{self.folder} has a rig for each frame; expected one rig. Use frame.rig."
            )
        return self._rig

    def __len__(self) -> int:
        return len(self._frames)

    @overload
    def __getitem__(self, i: int) -> Frame: ...
    @overload
    def __getitem__(self, i: slice) -> Dataset: ...
    def __getitem__(self, i: int | slice) -> Frame | Dataset:
        if isinstance(i, slice):
            return Dataset(self.folder, self._rig, self._frames[i])
        # A copy, so that cached images are freed with it.
        return replace(self._frames[i])

    def frame(self, number: int) -> Frame:
        """Return the frame of a number; an `OmnistereoError` lists those there are."""
        numbers = [frame.number for frame in self._frames]
        if number not in numbers:
            known = ", ".join(map(str, numbers[:12])) + " …" * (len(numbers) > 12)
            raise OmnistereoError(f"{self.folder} has no frame {number}; expected one of {known}")
        return self[numbers.index(number)]

    def __repr__(self) -> str:
        with_gt = sum(frame.gt_path is not None for frame in self._frames)
        cameras = "a rig for each frame"
        if self._rig is not None:
            width, height = self.rig.cameras[0].image_size
            cameras = f"{len(self.rig)} cameras of {width} × {height}"
        return (
            f"Dataset({self.folder.name}: {len(self)} frames, {with_gt} with ground truth,"
            f" {cameras})"
        )


def load_dataset(
    folder: str | Path,
    split: str | None = None,
    unit: Unit | None = None,
    gt_width: int | None = None,
    max_fov_deg: float | None = None,
    rig: Rig | None = None,
) -> Dataset:
    """Open a data set in the public layout (see the module); images are read on first use.

    Args:
        split: A folder of that name inside `folder`; for the published sets the frame numbers of
            their releases. None: every frame.
        unit: Unit of the poses, for rig files that do not state it.
        gt_width: Panorama width in pixels of the ground truth to read; default: the widest.
        max_fov_deg: As for `load_rig`.
        rig: The rig, where its file in the folder is of another program.

    Raises:
        OmnistereoError: If the folder, the rig or the frames are missing, a camera lacks a frame,
            or two files have one number.

    >>> dataset = osl.load_dataset("data_samples/sunny", split="test")
    >>> dataset
    Dataset(test: 8 frames, 8 with ground truth, 4 cameras of 800 × 768)
    >>> dataset[0].number, dataset[0].inverse_depth.shape
    (706, (300, 1200))
    """
    folder = as_path(folder, "folder")
    unpack(folder if split is None else folder / split)
    # False also for a name that no file can have.
    if not os.path.isdir(folder):
        raise OmnistereoError(f"{folder} cannot be read: there is no such folder. Check the path.")
    if split is not None and (folder / split).is_dir():
        folder, split = folder / split, None
    folders = [path for path in folder.glob("*") if path.is_dir()]
    cameras = _by_number(folders, _CAMERA)
    rigs = {} if cameras else _by_number(folders, _RIG_FOLDER)
    if rigs:
        rig = None
        of_rigs = [load_dataset(path, None, unit, gt_width, max_fov_deg) for path in rigs.values()]
        frames = [frame for of_rig in of_rigs for frame in of_rig]
        if len({frame.number for frame in frames}) < len(frames):
            raise OmnistereoError(
                f"{folder} has two frames of one number; expected different numbers. Rename one."
            )
    else:
        rig = load_rig(folder, unit, max_fov_deg) if rig is None else rig
        frames = _read_frames(folder, rig, cameras, gt_width)
    if split is not None:
        frames = _published_split(folder, split, frames)
    if not frames:
        of_split = f" of split {split}" if split else ""
        raise OmnistereoError(f"{folder} has no frames{of_split}; expected cam1/0001.png …")
    return Dataset(folder, rig, frames)


def _read_frames(
    folder: Path, rig: Rig, cameras: dict[int, Path], gt_width: int | None
) -> list[Frame]:
    if len(cameras) != len(rig):
        found = ", ".join(path.name for path in cameras.values()) or "none"
        raise OmnistereoError(
            f"{folder} has camera folders {found}; expected cam1 to cam{len(rig)}, as its rig has"
        )
    images = [_by_number(camera.iterdir(), _IMAGE) for camera in cameras.values()]
    numbers = sorted(set().union(*images))
    for camera, files in zip(cameras.values(), images, strict=True):
        if missing := [number for number in numbers if number not in files]:
            raise OmnistereoError(
                f"{camera} has no image of frame {missing[0]}, other cameras have. Complete it."
            )
    gt = _find_gt(_gt_root(folder), gt_width)
    return [
        Frame(_rig_of(folder, n, rig), [one[n] for one in images], n, gt.get(n)) for n in numbers
    ]


def write_poses(folder: Path, number: int, T_rig_cam: Sequence[Pose] | None) -> None:
    """Store the poses of a frame beside the rig of its data set; None: those of the rig."""
    path = _poses_path(folder, number)
    if T_rig_cam is None:
        path.unlink(missing_ok=True)
        return
    rows = [[*pose.R.ravel().tolist(), *pose.t.tolist()] for pose in T_rig_cam]
    make_folder(path.parent)
    write_text(path, json.dumps({"T_rig_cam": rows}) + "\n")


def read_poses(folder: Path, number: int) -> list[Pose] | None:
    """Return the poses of a frame that differ from those of the rig; None if there are none.

    Raises an `OmnistereoError` if the file is damaged.
    """
    path = _poses_path(folder, number)
    if not path.exists():
        return None
    try:
        rows = np.array(read_data(path)["T_rig_cam"], np.float64).reshape(-1, 12)
        return [Pose(row[:9].reshape(3, 3), row[9:]) for row in rows]
    except (TypeError, LookupError, ValueError) as error:
        raise OmnistereoError(f"{path} holds no poses ({error}). Record the frame again.") from None


def _poses_path(folder: Path, number: int) -> Path:
    return folder / _POSES / f"{number:05}.json"


def _rig_of(folder: Path, number: int, rig: Rig) -> Rig:
    """Return the rig as it was in a frame."""
    poses = read_poses(folder, number)
    return rig if poses is None else rig.with_poses(poses)


def _gt_root(folder: Path) -> Path:
    """Return the folder of the ground truth: this one, or that of `dataset: truth` in config.yaml.

    Our sets of one drive in several lights share the ground truth of one of them.
    """
    config = folder / "config.yaml"
    # a set with a rig for each frame has many such files
    if not config.is_file() or "truth:" not in read_text(config):
        return folder
    data = read_data(config)
    settings = data.get("dataset") if isinstance(data, dict) else None
    truth = settings.get("truth") if isinstance(settings, dict) else None
    if truth is None:  # `truth:` is not under `dataset`
        return folder
    # such as sunny/test beside cloudy/test
    root = path_within(folder, truth, config, folder.resolve().parent.parent)
    if not root.is_dir():
        raise OmnistereoError(
            f"{config} names {root} as the ground-truth folder; there is no such folder"
        )
    return root


def _find_gt(folder: Path, width: int | None) -> dict[int, Path]:
    """Return the ground-truth files by frame number, of one panorama width (None: the widest).

    The first release keeps one ground truth for all weathers beside their folders, in splits.
    """
    found = _gt_by_width(folder.glob("*depth_*")) or _gt_by_width(folder.parent.glob("depth_t*_*"))
    if width is not None and width not in found:
        raise OmnistereoError(
            f"{folder} has no ground truth of width {width}; expected one of {sorted(found)}"
        )
    return found[width or max(found)] if found else {}


def _gt_by_width(folders: Iterable[Path]) -> dict[int, dict[int, Path]]:
    """Return the ground-truth files by panorama width and frame number; none for empty folders."""
    paths: dict[int, list[Path]] = {}
    for folder in folders:
        match = re.fullmatch(_GT_FOLDER, folder.name)
        if match and folder.is_dir():
            paths.setdefault(int(match[1]), []).extend(folder.iterdir())
    return {width: files for width in paths if (files := _by_number(paths[width], _GT))}


def _by_number(paths: Iterable[Path], pattern: str) -> dict[int, Path]:
    """Return the paths whose names match, by the number in them (0001 is 00001), ascending."""
    found: dict[int, Path] = {}
    for path in sorted(paths):
        if match := re.fullmatch(pattern, path.name):
            other = found.setdefault(int(match[1]), path)
            if other != path:
                raise OmnistereoError(
                    f"{other} and {path} have the same number; expected one of them. Remove one."
                )
    return dict(sorted(found.items()))


def _published_split(folder: Path, split: str, frames: list[Frame]) -> list[Frame]:
    last = _PUBLISHED_SPLITS.get(folder.name.lower())
    if last is None or split not in ("train", "test"):
        known = f"one of the published sets {', '.join(_PUBLISHED_SPLITS)} with train or test"
        raise OmnistereoError(
            f"{folder} has no split {split!r}; expected a folder of that name, or {known}"
        )
    numbers = range(1, last[0] + 1) if split == "train" else range(last[0] + 1, last[1] + 1)
    return [frame for frame in frames if frame.number in numbers]
