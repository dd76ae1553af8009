"""Calibrate a camera or a rig: images of a board in, intrinsics and poses out.

FOLDER holds one folder of images per camera; images of one capture have the same name.

Examples:
  omnistereo calibrate boards --board 12x10 --square 0.06 --max-fov 220
      a checkerboard, all of which must be visible
  omnistereo calibrate boards --board aprilgrid.yaml
      the target file of Kalibr, or a YAML file with the fields of a board: see the book
  omnistereo calibrate boards --board 12x10 --square 0.06 --rig lenses.yaml
      the poses alone, of cameras that are calibrated
  omnistereo calibrate --from-images front right back left --rig nominal.yaml
      the poses without a board, from a drive: each camera's folder, video or picture
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from omnistereo_lib.errors import OmnistereoError
from omnistereo_tools.commands import calibrate_images
from omnistereo_tools.outputs import check_outputs, hold

if TYPE_CHECKING:
    from omnistereo_lib.calibrate.board import Board


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument(
        "folder", type=Path, nargs="?", metavar="FOLDER", help="folder with one folder of images per camera"
    )
    parser.add_argument("--board", help="inner corners, columns x rows, such as 12x10, or a YAML file")
    parser.add_argument("--square", type=float, help="edge of a square of a checkerboard in metres, such as 0.06")
    parser.add_argument("--rig", type=Path, help="keep the intrinsics of this rig file or folder of cameras")
    parser.add_argument("--degree", type=int, help="polynomial degree (default: chosen by cross-validation)")
    parser.add_argument("--max-fov", type=float, help="field of view in degrees (default: as far as corners reach)")
    parser.add_argument("--corners", type=Path, help="folder with corners_*.yaml of an earlier run, edited or not")
    parser.add_argument("--out", type=Path, default=Path("out/rig"), help="folder for the results (default: out/rig)")
    calibrate_images.add_arguments(parser)


def _read_board(options: argparse.Namespace) -> Board:
    """Return the board that --board and --square name."""
    from omnistereo_lib.calibrate.captures import load_board
    from omnistereo_lib.calibrate.checkerboard import Checkerboard

    if Path(options.board).suffix in (".yaml", ".yml"):
        if options.square is not None:
            raise OmnistereoError(f"{options.board} states its sizes. Leave out --square")
        return load_board(options.board)
    size = re.fullmatch("([0-9]{1,3})x([0-9]{1,3})", options.board.lower())
    if size is None or options.square is None:
        found = f"--board {options.board}" + ("" if options.square is None else f" --square {options.square:g}")
        raise OmnistereoError(
            f"found {found}; expected columns x rows such as --board 12x10 --square 0.06, or a YAML file"
        )
    return Checkerboard((int(size[1]), int(size[2])), options.square)


def run(options: argparse.Namespace) -> int:
    """Calibrate one camera or a rig and write it and its report; return 1 if images leave the given rig as it is."""
    if options.from_images is not None:
        return calibrate_images.run(options)
    if options.folder is None or options.board is None:
        raise OmnistereoError("calibrate needs FOLDER and --board, or --from-images and --rig")
    _calibrate_boards(options)
    return 0


def _calibrate_boards(options: argparse.Namespace) -> None:
    """Calibrate one camera or a rig from images of a board; write it, its report and its detections."""
    from omnistereo_lib.calibrate.joint import calibrate_rig
    from omnistereo_lib.calibrate.single_camera import calibrate_camera, check_settings
    from omnistereo_lib.files import atomic_write
    from omnistereo_lib.rig_files.formats import load_cameras
    from omnistereo_lib.rig_files.ocam import write_ocam_txt
    from omnistereo_tools.judge.pace import progress_bar
    from omnistereo_tools.output.rig_exports import write_rig

    check_settings(options.degree, options.max_fov)
    _check_out(options)
    board = _read_board(options)
    if options.corners is None:
        cameras, names, views, sizes = _read_captures(options.folder)
    else:
        cameras, names, views, sizes = _read_corners(options.corners, board)
    out = hold(options.out)
    settings = {"degree": options.degree, "max_fov_deg": options.max_fov, "progress": progress_bar(), "names": names}
    if options.rig is not None and (len(views) == 1 or options.degree is not None):
        raise OmnistereoError("--rig keeps the intrinsics of two or more cameras. Leave it, or --degree, out")
    if len(views) == 1:
        camera, report = calibrate_camera(views[0], board, sizes and sizes[0], **settings)
        reports = [report]
        write_ocam_txt(camera, out / "ocam1.txt")
        written = ["ocam1.txt"]
    else:
        given = None if options.rig is None else load_cameras(options.rig, options.max_fov)
        rig, report = calibrate_rig(views, board, sizes, **settings, cameras=given)
        reports = report.joint
        written = write_rig(rig, out)
    text = report.text(names)
    with atomic_write(out / "report.txt") as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")
    written += ["report.txt", *_write_figures(out, cameras, reports)]
    if options.corners is None or not out.samefile(options.corners):
        written += _write_corners(out, cameras, names, reports, board)
    print(text)
    print(f"written to {out}/: {', '.join(written)}")


def _check_out(options: argparse.Namespace) -> None:
    """Raise an `OmnistereoError` if --out would write over what is read, or add a camera to FOLDER."""
    out, folder = options.out, options.folder.resolve()
    if options.corners is None and folder in (out.resolve(), out.resolve().parent):
        raise OmnistereoError(f"--out {out} would be read as images of {options.folder} the next time. Choose another.")
    read = options if options.corners is None else argparse.Namespace(**vars(options) | {"folder": None})
    names = ("*.yaml", "*.txt", "report_*.png", "colmap_*")
    check_outputs(read, (path for name in names for path in out.glob(name) if path.stem[:8] != "corners_"))


def _read_captures(folder: Path) -> tuple:
    """Return camera names, capture names, images, and no sizes."""
    from omnistereo_lib.calibrate.captures import find_captures

    captures = find_captures(folder)
    counts = ", ".join(
        f"{sum(path is not None for path in row)} of {camera}"
        for camera, row in zip(captures.cameras, captures.paths, strict=True)
    )
    print(f"images: {counts}\nafter the boards, lenses and poses take up to a minute", flush=True)
    return captures.cameras, captures.names, captures.views(), None


def _read_corners(folder: Path, board: Board) -> tuple:
    """Return what `_read_captures` does, with corners instead of images."""
    from omnistereo_lib.calibrate.captures import load_corners

    files = sorted(folder.glob("corners_*.yaml"), key=lambda path: (len(path.name), path.name))
    if not files:
        raise OmnistereoError(f"{folder} holds no corners_*.yaml: run once without --corners, which writes them")
    loaded = [load_corners(path) for path in files]
    for path, (_, detected, _) in zip(files, loaded, strict=True):
        if type(detected) is not type(board) or len(detected.points) != len(board.points):
            raise OmnistereoError(f"{path} is of a board {detected}, not {board}")
    names = tuple(sorted(set().union(*(views for views, _, _ in loaded))))
    views = [[by_name.get(name) for name in names] for by_name, _, _ in loaded]
    cameras = tuple(path.stem.removeprefix("corners_") for path in files)
    return cameras, names, views, [size for _, _, size in loaded]


def _write_figures(out: Path, cameras: Sequence[str], reports: Sequence) -> list[str]:
    """Write the figure of each camera; return what was written."""
    from omnistereo_tools.output.calibration_figures import calibration_figure
    from omnistereo_tools.output.pictures import save_figure

    for camera, report in zip(cameras, reports, strict=True):
        save_figure(out / f"report_{camera}.png", calibration_figure(report), dpi=80)
    return ["report_*.png"]


def _write_corners(
    out: Path, cameras: Sequence[str], names: Sequence[str], reports: Sequence, board: Board
) -> list[str]:
    """Write the corners of each camera, captures without a board as null; return what was written."""
    from omnistereo_lib.calibrate.captures import save_corners

    for camera, report in zip(cameras, reports, strict=True):
        views = {name: report.corners.get(k) for k, name in enumerate(names)}
        save_corners(out / f"corners_{camera}.yaml", views, board, report.intrinsics.image_size)
    return ["corners_*.yaml"]
