"""Calibrate a camera or a rig: images of a board in, intrinsics and poses out.

FOLDER holds one folder of images per camera; images of one capture have the same name or time.
Or it holds one video per camera, of which sharp and varied frames are taken.

Examples:
  omnistereo calibrate boards --board 12x10 --square 0.06 --max-fov 220
      a checkerboard, all of which must be visible
  omnistereo calibrate boards --board aprilgrid.yaml
      the target file of Kalibr, or a YAML file with the fields of a board: see the book
  omnistereo calibrate boards --board 12x10 --square 0.06 --rig lenses.yaml
      only the poses, of cameras that are calibrated
  omnistereo calibrate --from-images front right back left --rig nominal.yaml
      the poses without a board, from a drive: each camera's folder, video or image
"""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from omnistereo_lib.errors import OmnistereoError
from omnistereo_tools.commands.options import warn_of
from omnistereo_tools.outputs import check_outputs, hold
from omnistereo_tools.parser import Options, option

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from omnistereo_lib.geometry.camera import OcamCamera
    from omnistereo_rigs.boards.board import Board

    # Names of cameras and of captures, views[camera][capture], sizes of the images.
    _Read = tuple[
        Sequence[str],
        Sequence[str],
        Sequence[Sequence[ArrayLike | None]],
        Sequence[tuple[int, int]] | None,
    ]


@dataclass(frozen=True, kw_only=True)
class CalibrateOptions(Options):
    """Options of `omnistereo calibrate`."""

    folder: Path | None = option(
        "a folder of images, or a video, per camera; or an earlier --out, whose corners_*.yaml"
        " are used, edited or not",
        positional=True,
        nargs="?",
        metavar="FOLDER",
    )
    board: str | None = option("inner corners, columns x rows, such as 12x10, or a YAML file")
    square: float | None = option(
        "edge of a square of a checkerboard in metres, such as 0.06", needs="board"
    )
    max_fov: float | None = option("field of view in degrees", unset="as far as corners reach")
    from_images: tuple[Path, ...] | None = option(
        "for each camera a folder, a video or one image", needs="rig"
    )
    rig: Path | None = option("nominal poses; with a board: cameras whose intrinsics are kept")
    baseline: float | None = option(
        "metres between cameras 1 and 2: the poses of --rig are not used",
        needs="from_images",
        between=(1e-6, 1e4),
    )
    calibrated: bool = option(
        "the poses of --rig are a calibration: they keep weight", False, needs="from_images"
    )
    out: Path = option("folder for the results", Path("out/rig"))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.from_images is not None and (self.folder is not None or self.board is not None):
            raise OmnistereoError("--from-images needs no board. Leave FOLDER and --board out")
        if self.from_images is None and (self.folder is None or self.board is None):
            raise OmnistereoError("calibrate needs FOLDER and --board, or --from-images and --rig")
        if self.baseline is not None and self.calibrated:
            raise OmnistereoError("--baseline does not use the poses. Leave --calibrated out")
        if self.max_fov is not None:
            from omnistereo_rigs.boards.single_camera import check_settings

            check_settings(None, self.max_fov)


def run(options: CalibrateOptions) -> int:
    """Calibrate one camera or a rig, write it and its report; return 1 if the given rig stays."""
    if options.folder is None or options.board is None:
        from omnistereo_tools.commands.calibrate_images import run

        return run(options)
    _calibrate_boards(options, options.folder, options.board)
    return 0


def _calibrate_boards(options: CalibrateOptions, folder: Path, board_name: str) -> None:
    """Calibrate one camera or a rig from images of a board; write it, report and detections."""
    import numpy as np

    from omnistereo_learn.provenance import PROVENANCE, arrays_checksum, provenance, write_facts
    from omnistereo_lib.files import write_text
    from omnistereo_lib.geometry.rig import Deviation
    from omnistereo_lib.ocam_text import write_ocam_txt
    from omnistereo_lib.rig_file import save_rig
    from omnistereo_rigs.boards.captures import save_corners
    from omnistereo_rigs.boards.joint import calibrate_rig
    from omnistereo_rigs.boards.single_camera import calibrate_camera
    from omnistereo_rigs.formats.read import load_cameras
    from omnistereo_tools.output.calibration_figures import calibration_figure, where_next
    from omnistereo_tools.outputs import save_figure
    from omnistereo_tools.progress import progress_bar

    # Read the boards.
    _check_out(options, folder)
    board = read_board(board_name, options.square)
    detected = sorted(folder.glob("corners_*.yaml"), key=lambda path: (len(path.name), path.name))
    read = _read_corners(detected, board) if detected else _read_captures(folder)
    cameras, names, views, sizes = read
    if options.rig is not None and len(views) == 1:
        raise OmnistereoError("--rig keeps the intrinsics of two or more cameras. Leave it out")
    out = hold(options.out)
    # Compute lenses and poses.
    chosen = None, options.max_fov, progress_bar(), names
    if len(views) == 1:
        camera, single = calibrate_camera(
            views[0], board, None if sizes is None else sizes[0], *chosen
        )
        reports, text, rms = [single], single.text(names), single.rms_px
        lenses: Sequence[OcamCamera] = [camera]
        known = f"corners are {rms:.2g} px off, up to {single.max_corner_angle_deg:.0f}° off axis"
        warned = single.warnings
        write_ocam_txt(camera, out / "ocam1.txt")
        written = ["ocam1.txt"]
    else:
        given = None if options.rig is None else load_cameras(options.rig, options.max_fov)
        rig, joint = calibrate_rig(views, board, sizes, *chosen, given)
        reports, text = list(joint.joint), joint.text(names)
        poses = joint.pose_uncertainty()
        rig = replace(rig, deviations=[Deviation(np.radians(turn), shift) for turn, shift in poses])
        turn, shift = np.max(poses, axis=0)
        known = f"poses are known to {turn:.1g}° and {1000 * shift:.1g} mm"
        warned = (*joint.warnings, *(w for one in reports for w in one.warnings))
        lenses = rig.cameras
        save_rig(rig, out / "config.yaml")
        written = ["config.yaml"]
    # Write what was found, and say it.
    write_text(out / "report.txt", text + "\n")
    with_corners = not (detected and out.samefile(folder))
    next_places = []
    for name, one, lens in zip(cameras, reports, lenses, strict=True):
        save_figure(out / f"report_{name}.png", calibration_figure(one, lens, name), dpi=120)
        if place := where_next(one, lens):
            next_places.append(f"{name} {place}")
        if with_corners:  # captures without a board as null
            corners = {capture: one.corners.get(k) for k, capture in enumerate(names)}
            save_corners(out / f"corners_{name}.yaml", corners, board, one.intrinsics.image_size)
    seen = arrays_checksum(points for one in reports for points in one.corners.values())
    write_facts(out / PROVENANCE, {"provenance": provenance(None, seen, f"boards {board_name}")})
    written += ["report.txt", "report_*.png", *["corners_*.yaml"] * with_corners, PROVENANCE]
    # The verdict first, the next command last; all numbers are in the report.
    warn_of(warned)
    flaw = warned[0].partition(". ")[0] if warned else "parts of the images lack corners"
    print(f"Fair: {flaw}; the {known}." if warned or next_places else f"Good: the {known}.")
    left_out = {k: why for one in reports for k, why in one.rejected.items()}
    if left_out:
        first = min(left_out)
        share = f"{len(left_out)} of {len(names)}"
        print(f"Captures left out: {share}, such as {names[first]}: {left_out[first]}.")
    if next_places:
        print(f"Hold the board next, as report_*.png shows: {' | '.join(next_places)}.")
    print(f"written to {out}/: {', '.join(written)}")
    if len(views) == 1:
        print(out / "report.txt")
    else:
        print("To check the rig by one image of the scene per camera, taken at once, add --images.")
        print(shlex.join(["omnistereo", "doctor", "--rig", str(out / "config.yaml")]))


def read_board(name: str, square: float | None) -> Board:
    """Return the board of a YAML file, or the checkerboard of a size and an edge in metres."""
    from omnistereo_rigs.boards.captures import load_board
    from omnistereo_rigs.boards.checkerboard import Checkerboard

    if Path(name).suffix in (".yaml", ".yml"):
        if square is not None:
            raise OmnistereoError(f"{name} states its sizes. Leave out --square")
        return load_board(name)
    size = re.fullmatch("([0-9]{1,3})x([0-9]{1,3})", name.lower())
    if size is None or square is None:
        found = f"--board {name}" + ("" if square is None else f" --square {square:g}")
        raise OmnistereoError(
            f"found {found}; expected columns x rows such as --board 12x10 --square 0.06, or a YAML"
            " file"
        )
    return Checkerboard((int(size[1]), int(size[2])), square)


def _check_out(options: CalibrateOptions, folder: Path) -> None:
    """Refuse an --out that would write over what is read, or add a camera to FOLDER."""
    out, pictures = options.out, folder.resolve()
    own = any(folder.glob("corners_*.yaml"))
    if not own and pictures in (out.resolve(), out.resolve().parent):
        raise OmnistereoError(
            f"--out {out} would be read as images of {folder} the next time. Choose another."
        )
    names = ("*.yaml", "*.json", "*.txt", "report_*.png")
    files = {path for name in names for path in out.glob(name) if path.stem[:8] != "corners_"}
    check_outputs(options, files, unread=("folder",) if own else ())


def _read_captures(folder: Path) -> _Read:
    """Return the images, without their sizes."""
    from omnistereo_rigs.boards.captures import find_captures
    from omnistereo_tools.progress import say

    captures = find_captures(folder)
    counts = ", ".join(
        f"{sum(path is not None for path in row)} of {camera}"
        for camera, row in zip(captures.cameras, captures.paths, strict=True)
    )
    say(f"images: {counts}\nafter the boards, lenses and poses take up to a minute")
    return captures.cameras, captures.names, captures.views(), None


def _read_corners(files: Sequence[Path], board: Board) -> _Read:
    """Return corners in place of images."""
    from omnistereo_rigs.boards.captures import load_corners

    loaded = [load_corners(path) for path in files]
    for path, (_, detected, _) in zip(files, loaded, strict=True):
        if type(detected) is not type(board) or len(detected.points) != len(board.points):
            raise OmnistereoError(f"{path} is of a board {detected}, not {board}")
    names = tuple(sorted({name for by_name, _, _ in loaded for name in by_name}))
    views = [[by_name.get(name) for name in names] for by_name, _, _ in loaded]
    cameras = tuple(path.stem.removeprefix("corners_") for path in files)
    return cameras, names, views, [size for _, _, size in loaded]
