"""Captures on disk: a folder for each camera, pictures of one moment by the same name."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import read_image

_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".webp"}  # not TIFF: data sets keep ground truth in it


@dataclass(frozen=True, eq=False)
class Captures:
    """Pictures of a board by one or more cameras.

    Attributes
    ----------
    cameras : tuple of str
        Names of the cameras' folders, in the order of their numbers.
    names : tuple of str
        Names of the captures, sorted.
    paths : tuple of tuples
        paths[camera][capture], None where a camera has no picture of a capture.
    """

    cameras: tuple[str, ...]
    names: tuple[str, ...]
    paths: tuple[tuple[Path | None, ...], ...]

    def images(self, camera: int) -> list[NDArray[np.uint8] | None]:
        """Read one camera's pictures, None where it has none."""
        return [None if path is None else read_image(path) for path in self.paths[camera]]

    def views(self) -> list[list[NDArray[np.uint8] | None]]:
        """Read everything: views[camera][capture], as `calibrate_rig` takes it."""
        return [self.images(camera) for camera in range(len(self.cameras))]


def find_captures(folder: str | Path) -> Captures:
    """Find the images in a folder: of several cameras in subfolders, or of one camera.

    A view is a file that ends in .png, .jpg, .jpeg, .bmp, .pgm or .webp. Other files (ground truth as TIFF, corners
    as YAML, notes), hidden files and hidden folders are ignored. Warns where no two cameras have an image of the
    same name.

    Raises
    ------
    OmnistereoError
        If there is no image, or two images of a camera differ only in their ending.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise OmnistereoError(f"{folder} is no folder: give one with a folder of pictures for each camera")
    found = {path.name: _pictures(path) for path in folder.iterdir() if path.is_dir() and path.name[0] != "."}
    found = {name: pictures for name, pictures in found.items() if pictures} or {folder.name: _pictures(folder)}
    cameras = sorted(found, key=_natural)
    if not any(found.values()):
        raise OmnistereoError(
            f"{folder} holds no pictures ({', '.join(sorted(_SUFFIXES))}): expected cam1/0001.png, cam2/0001.png …"
        )
    names = sorted(set().union(*found.values()), key=_natural)
    if len(cameras) > 1 and sum(map(len, found.values())) == len(names):
        examples = ", ".join(f"{camera}/{min(found[camera])}" for camera in cameras)
        warnings.warn(
            f"no two cameras have a picture of the same name ({examples}): pictures that were taken at the same "
            "time need one name in all folders",
            stacklevel=2,
        )
    paths = tuple(tuple(found[camera].get(name) for name in names) for camera in cameras)
    return Captures(tuple(cameras), tuple(names), paths)


def _pictures(folder: Path) -> dict[str, Path]:
    files = [path for path in sorted(folder.iterdir()) if path.suffix.lower() in _SUFFIXES and path.name[0] != "."]
    found: dict[str, Path] = {}
    for path in files:
        if path.stem in found:
            raise OmnistereoError(
                f"{folder} has {found[path.stem].name} and {path.name}; expected one image per capture. "
                "Keep one of them"
            )
        found[path.stem] = path
    return found


def _natural(name: str) -> list[tuple[int, str]]:
    """Sort by the numbers in a name, so that cam10 comes after cam2."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]
