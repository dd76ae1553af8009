"""Files: captures as a folder of pictures or a video per camera, detected corners as YAML."""

import json
import re
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
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
from omnistereo_rigs.images.moments import match_moments, match_times, read_names
from omnistereo_rigs.images.varied import candidates, choose, look
from omnistereo_rigs.images.videos import VIDEOS, moments_of_videos, open_videos

# not TIFF: data sets keep ground truth in it
_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".webp"}


# Of videos: frames looked at and used, for each camera; gray values apart.
_CANDIDATES, _MOST, _STILL = 80, 20, 2.0


@dataclass(frozen=True, eq=False)
class Captures:
    """Images of a board by one or more cameras."""

    cameras: tuple[str, ...]  # names of their folders or videos, in the order of their numbers
    names: tuple[str, ...]  # of the captures, sorted
    # paths[camera][capture], None if a camera has no image of a capture; of the video, if it is one
    paths: tuple[tuple[Path | None, ...], ...]
    frames: tuple[tuple[int, ...], ...] = ()  # frames[camera][capture] of videos

    def images(self, camera: int) -> list[NDArray[np.uint8] | None]:
        """Read the images of one camera; None where it has none.

        Where sizes differ, those of the rarer ones are left out with a warning.
        """
        if self.frames:
            path = self.paths[camera][0]
            assert path is not None  # all cameras have all frames
            return list(open_videos(path)[0].read(self.frames[camera]))
        images = [None if path is None else read_image(path) for path in self.paths[camera]]
        sizes = Counter(image.shape[1::-1] for image in images if image is not None)
        for k, (path, image) in enumerate(zip(self.paths[camera], images, strict=True)):
            if image is not None and image.shape[1::-1] != (usual := sizes.most_common(1)[0])[0]:
                found, expected = (f"{w} × {h} px" for w, h in (image.shape[1::-1], usual[0]))
                warnings.warn(
                    f"{path} is left out: it is {found}, {usual[1]} of {sizes.total()} pictures of "
                    f"this camera are {expected}",
                    stacklevel=2,
                )
                images[k] = None
        return images

    def views(self) -> list[list[NDArray[np.uint8] | None]]:
        """Read all images: views[camera][capture], as `calibrate_rig` takes it."""
        return [self.images(camera) for camera in range(len(self.cameras))]


def find_captures(folder: str | Path) -> Captures:
    """Find the images in a folder: of several cameras in subfolders, or of one camera.

    A view is a file that ends in .png, .jpg, .jpeg, .bmp, .pgm or .webp. Other files (ground truth
    as TIFF, corners as YAML, notes), hidden files and hidden folders are ignored. Views of several
    cameras are matched by time where their names state one, within half of the time between two;
    else by equal names; else by the numbers in them. Where there are no views but a video for each
    camera, sharp and varied frames of them are taken.

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
    if not any(found.values()):
        return _of_videos(folder)
    cameras = sorted(found, key=_natural)
    rows = [list(found[camera]) for camera in cameras]
    captures = _by_moments(rows) if len(cameras) > 1 else None
    if captures is None:
        every = sorted(set().union(*found.values()), key=_natural)
        captures = [[name if name in row else None for row in rows] for name in every]
    if len(cameras) > 1 and all(len(one) - one.count(None) < 2 for one in captures):
        examples = ", ".join(f"{camera}/{min(found[camera])}" for camera in cameras)
        warnings.warn(
            f"no two cameras have an image of the same name or time ({examples}). Give images of "
            "one capture the same name in all folders",
            stacklevel=2,
        )
    names = tuple(next(name for name in one if name is not None) for one in captures)
    paths = tuple(
        tuple(None if one[k] is None else found[camera][one[k] or ""] for one in captures)
        for k, camera in enumerate(cameras)
    )
    return Captures(tuple(cameras), names, paths)


def _by_moments(rows: Sequence[Sequence[str]]) -> list[list[str | None]] | None:
    """Return for each capture the name of each camera's picture, by times or numbers in them.

    None where names are equal, or state neither.
    """
    named = read_names(rows)
    equal = set(rows[0]).intersection(*rows[1:])
    if named is None or (equal and any(one.times is None for one, _ in named)):
        return None
    moments: list[tuple[int, list[str | None]]] = []
    # Boards are not filmed at an even rate: the shortest time between two pictures counts.
    steps = [b - a for one, _ in named for a, b in pairwise(one.times or ())]
    period = min(steps, default=0)
    for camera, (one, names) in enumerate(named):
        moments.sort(key=lambda moment: moment[0])
        times = list(one.numbers if one.times is None else one.times)
        pairs = match_times([time for time, _ in moments], times, period / 2)
        partners = {b: a for a, b in pairs.items()}
        for k, (time, name) in enumerate(zip(times, names, strict=True)):
            if k in partners:
                moments[partners[k]][1][camera] = name
            else:
                moments.append((time, [None] * camera + [name] + [None] * (len(rows) - camera - 1)))
    return [row for _, row in sorted(moments, key=lambda moment: moment[0])]


def _of_videos(folder: Path) -> Captures:
    """Choose sharp and varied frames of the videos in a folder, or in its subfolders."""
    files = sorted(
        (path for path in (*folder.glob("*"), *folder.glob("*/*")) if _is_video(path)),
        key=lambda path: _natural(str(path.relative_to(folder))),
    )
    videos = [open_videos(path)[0] for path in files]
    chapters = {chapter for video in videos for chapter, _ in video.chapters[1:]}
    videos = [video for video in videos if video.path not in chapters]
    if not videos:
        raise OmnistereoError(
            f"{folder} has no images ({', '.join(sorted(_SUFFIXES))}) and no videos; expected "
            "cam1/0001.png, …, or cam1.mp4, …"
        )
    matched = match_moments(moments_of_videos(videos)[0])
    common = sorted(set.intersection(*(set(pairs) for pairs in matched.pairs)))
    if not common:
        names = ", ".join(str(video.path) for video in videos)
        raise OmnistereoError(f"{names} have no moment in common. Check that all ran at once")
    tried = candidates(common, len(videos) * _CANDIDATES)
    read = [
        video.read([pairs[number] for number in tried])
        for video, pairs in zip(videos, matched.pairs, strict=True)
    ]
    chosen = choose([look(row) for row in zip(*read, strict=True)], len(videos) * _MOST, _STILL)
    numbers = [tried[k] for k in chosen]
    return Captures(
        tuple(v.path.stem if v.path.parent == folder else v.path.parent.name for v in videos),
        tuple(f"{number:05}" for number in numbers),
        tuple((video.path,) * len(numbers) for video in videos),
        tuple(tuple(pairs[number] for number in numbers) for pairs in matched.pairs),
    )


def _is_video(path: Path) -> bool:
    return path.suffix.lower() in VIDEOS and path.name[0] != "." and path.parent.name[0] != "."


def _natural(name: str) -> list[tuple[int, str]]:
    """Sort by the numbers in a name, so that cam10 comes after cam2."""
    return [
        (int(part), "") if re.fullmatch("[0-9]+", part) else (-1, part)
        for part in re.split("([0-9]{1,18})", name)
    ]


def save_corners(
    path: str | Path, views: dict[str, Floats | None], board: Board, image_size: tuple[int, int]
) -> None:
    """Write detections as YAML to edit: a line for each corner, null for views without a board.

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
        size, spacing = found.number("size"), found.number("spacing")
        return AprilGrid(found.require("tags"), size, spacing, start)
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
    count = 2 * len(board.points)
    corners = parse_floats(value, f"view {name}", count, may_be_nan=True).reshape(-1, 2)
    outside = (corners < -1) | (corners > image_size)
    if outside.any():
        corner = corners[outside.any(1)][0].tolist()
        raise OmnistereoError(
            f"view {name}: corner {corner} lies outside the image of {image_size} px. Write .nan"
        )
    return corners
