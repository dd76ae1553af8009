"""Files: captures as one folder per camera with equal file names, detected corners as YAML."""

import json
import re
import warnings
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError, check_number, error_context
from omnistereo_lib.files import read_data, write_text
from omnistereo_lib.geometry.pose import Floats
from omnistereo_lib.parse import Section, parse_floats, parse_size
from omnistereo_lib.pictures import find_pictures, read_image
from omnistereo_rigs.boards.board import Board
from omnistereo_rigs.boards.checkerboard import Checkerboard
from omnistereo_rigs.boards.marker_boards import AprilGrid, CharucoBoard

# not TIFF: data sets keep ground truth in it
_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".webp"}


@dataclass(frozen=True, eq=False)
class Captures:
    """Images of a board by one or more cameras."""

    cameras: tuple[str, ...]  # names of their folders, in the order of their numbers
    names: tuple[str, ...]  # of the captures, sorted
    # paths[camera][capture], None if a camera has no image of a capture
    paths: tuple[tuple[Path | None, ...], ...]

    def images(self, camera: int) -> list[NDArray[np.uint8] | None]:
        """Read the images of one camera, which have one size; None where it has none."""
        images: list[NDArray[np.uint8] | None] = []
        size = None
        for path in self.paths[camera]:
            image = None if path is None else read_image(path, size)
            size = size if image is None else (image.shape[1], image.shape[0])
            images.append(image)
        return images

    def views(self) -> list[list[NDArray[np.uint8] | None]]:
        """Read all images: views[camera][capture], as `calibrate_rig` takes it."""
        return [self.images(camera) for camera in range(len(self.cameras))]


def find_captures(folder: str | Path) -> Captures:
    """Find the images in a folder: of several cameras in subfolders, or of one camera.

    A view is a file that ends in .png, .jpg, .jpeg, .bmp, .pgm or .webp. Other files (ground truth
    as TIFF, corners as YAML, notes), hidden files and hidden folders are ignored. Warns where no
    two cameras have an image of the same name.

    Raises:
        OmnistereoError: If there is no image, or two images of a camera differ only in their
            ending.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise OmnistereoError(
            f"{folder} is not a folder. Pass a folder with one subfolder of images per camera"
        )
    found = {
        path.name: find_pictures(path, _SUFFIXES)
        for path in folder.iterdir()
        if path.is_dir() and path.name[0] != "."
    }
    found = {name: images for name, images in found.items() if images} or {
        folder.name: find_pictures(folder, _SUFFIXES)
    }
    cameras = sorted(found, key=_natural)
    if not any(found.values()):
        raise OmnistereoError(
            f"{folder} has no images ({', '.join(sorted(_SUFFIXES))}); expected cam1/0001.png, …"
        )
    names = sorted(set().union(*found.values()), key=_natural)
    if len(cameras) > 1 and sum(map(len, found.values())) == len(names):
        examples = ", ".join(f"{camera}/{min(found[camera])}" for camera in cameras)
        warnings.warn(
            f"no two cameras have an image of the same name ({examples}). Give images of one"
            " capture the same name in all folders",
            stacklevel=2,
        )
    paths = tuple(tuple(found[camera].get(name) for name in names) for camera in cameras)
    return Captures(tuple(cameras), tuple(names), paths)


def _natural(name: str) -> list[tuple[int, str]]:
    """Sort by the numbers in a name, so that cam10 comes after cam2."""
    return [
        (int(part), "") if re.fullmatch("[0-9]+", part) else (-1, part)
        for part in re.split("([0-9]{1,18})", name)
    ]


def save_corners(
    path: str | Path, views: dict[str, Floats | None], board: Board, image_size: tuple[int, int]
) -> None:
    """Write detections as YAML that a person can edit: a line for each corner, null for views
    without a board.

    Args:
        views: Name of each image → corners (K, 2) px, NaN where one is missing, or None.
        image_size: Width and height of the images.
    """
    lines = [
        f"board: {json.dumps(asdict(board))}  # metres",
        f"image_size: [{image_size[0]}, {image_size[1]}]  # width, height",
        "views:  # pixels (u, v), row by row; [.nan, .nan] omits a corner, null a view",
    ]
    for name, corners in views.items():
        lines.append(f"  {json.dumps(name)}:{' null' if corners is None else ''}")
        lines += [
            f"  - [{u:.4f}, {v:.4f}]".replace("nan", ".nan")
            for u, v in ([] if corners is None else corners)
        ]
    write_text(path, "\n".join(lines) + "\n")


def load_corners(path: str | Path) -> tuple[dict[str, Floats | None], Board, tuple[int, int]]:
    """Read what `save_corners` wrote: views, board, image size.

    Raises an `OmnistereoError` if the file is missing, not YAML or incomplete; the message names
    the view.
    """
    with error_context(path):
        content = Section(read_data(path))
        board = parse_board(content.section("board"))
        image_size = parse_size(content.require("image_size"), "image_size")
        found = content.section("views").values
        views = {name: _corners_of(value, name, board, image_size) for name, value in found.items()}
    return views, board, image_size


def parse_board(found: Section) -> Board:
    """Return the board of a mapping: ours, by its fields, or the target of a Kalibr file.

    Raises an `OmnistereoError` for a key that is not read, which would be another board.
    """
    board = _parse_board(found)
    if unread := [key for _, key in found.unread()]:
        raise OmnistereoError(
            f"{', '.join(unread)}: no such property of a board {board} is read. Delete it, or "
            "print a board without it"
        )
    return board


def _first_tag(found: Section, key: str) -> int:
    return int(check_number(found.number(key, default=0), key, 0, 586, whole=True))


def _parse_board(found: Section) -> Board:
    target = found.word("target_type")
    if target == "aprilgrid":
        family = found.word("tagFamily", default="36h11")
        if not family.endswith("36h11"):
            raise OmnistereoError(f"tagFamily is {family}; expected 36h11. Print such tags")
        tags = found.require("tagCols"), found.require("tagRows")
        size, spacing = found.number("tagSize"), found.number("tagSpacing")
        return AprilGrid(tags, size, spacing, _first_tag(found, "startId"))
    if target == "checkerboard":
        corners = found.require("targetCols"), found.require("targetRows")
        columns = found.number("colSpacingMeters")
        rows = found.number("rowSpacingMeters", default=columns)
        if not np.isclose(rows, columns, rtol=1e-6):
            raise OmnistereoError(
                f"rowSpacingMeters is {rows:g} and colSpacingMeters {columns:g}; expected squares. "
                "If the printer has stretched the board, print it again, or on another printer"
            )
        return Checkerboard(corners, columns)
    if target:
        raise OmnistereoError(
            f"target_type is {target}; expected aprilgrid or checkerboard. Print one of them"
        )
    if "tags" in found.values:
        start = _first_tag(found, "start")
        return AprilGrid(
            found.require("tags"), found.number("size"), found.number("spacing"), start
        )
    if "squares" in found.values:
        dictionary = str(found.get("dictionary", default="DICT_4X4_50"))
        square, marker = found.number("square"), found.number("marker")
        return CharucoBoard(found.require("squares"), square, marker, dictionary)
    return Checkerboard(found.require("corners"), found.number("square"))


def load_board(path: str | Path) -> Board:
    """Read a board from YAML: the target file of Kalibr, or the fields of one of our boards."""
    with error_context(path):
        return parse_board(Section(read_data(path)))


def _corners_of(value: Any, name: str, board: Board, image_size: tuple[int, int]) -> Floats | None:
    if value is None:
        return None
    corners = parse_floats(value, f"view {name}", 2 * len(board.points), may_be_nan=True).reshape(
        -1, 2
    )
    outside = (corners < -1) | (corners > image_size)
    if outside.any():
        corner = corners[outside.any(1)][0].tolist()
        raise OmnistereoError(
            f"view {name}: corner {corner} lies outside the image of {image_size} px. Write .nan"
        )
    return corners
