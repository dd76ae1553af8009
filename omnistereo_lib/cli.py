"""The command line. Each verb parses its arguments, calls the library and prints what came out."""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from omnistereo_lib.errors import OmnistereoError

if TYPE_CHECKING:
    from omnistereo_lib.calibrate.board import Checkerboard
    from omnistereo_lib.geometry.camera import OcamCamera
    from omnistereo_lib.geometry.rig import Rig
    from omnistereo_lib.geometry.sphere import SphereGrid
    from omnistereo_lib.train import Recipe

_SAMPLE = Path(__file__).resolve().parents[1] / "data_samples" / "sunny" / "test"
_NEAR = 0.5  # metres: something in most pictures is nearer than a few times this


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb; return the process's exit status. Bad input is one plain line, never a traceback."""
    options = _parser().parse_args(arguments)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _print_warning
            return options.verb(options) or 0
    except OmnistereoError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


def _print_warning(message: Warning | str, *_: object) -> None:
    print(f"warning: {message}", file=sys.stderr)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m omnistereo_lib", description=__doc__.splitlines()[0])
    verbs = parser.add_subparsers(required=True, metavar="VERB")

    verb = verbs.add_parser("depth", help="images and a rig in, a depth panorama and a point cloud out")
    verb.set_defaults(verb=depth)
    _add_input(verb)
    _add_grid(verb, width=640, height=160, spheres=192)
    verb.add_argument("--cost", default="zncc", help="matching cost (default: zncc)")
    verb.add_argument("--pairs", default="ring", choices=["ring", "all"], help="which cameras are compared")
    verb.add_argument("--device", default="cpu", choices=["cpu", "cuda"], help="where to compute (default: cpu)")
    verb.add_argument("--out", type=Path, default=Path("out"), help="folder for the results (default: out)")

    verb = verbs.add_parser("calibrate", help="pictures of a checkerboard in, lenses and poses of the cameras out")
    verb.set_defaults(verb=calibrate)
    verb.add_argument("folder", type=Path, help="folder with a folder of pictures for each camera, captures by name")
    verb.add_argument("--board", required=True, type=_board_size, help="inner corners, columns x rows, such as 12x10")
    verb.add_argument("--square", required=True, type=float, help="edge of a square in metres, such as 0.06")
    verb.add_argument("--degree", type=int, help="of the polynomials (default: what held-back views ask for)")
    verb.add_argument("--max-fov", type=float, help="field of view in degrees (default: as far as corners were seen)")
    verb.add_argument("--corners", type=Path, help="folder with corners_*.yaml of an earlier run, edited or not")
    verb.add_argument("--out", type=Path, default=Path("out/rig"), help="folder for the results (default: out/rig)")

    verb = verbs.add_parser("doctor", help="is everything in place? With --rig: does the rig fit the images?")
    verb.set_defaults(verb=doctor)
    _add_input(verb)
    _add_grid(verb, width=320, height=80, spheres=64)

    verb = verbs.add_parser("bench", help="time the library against named alternatives, as ratios")
    verb.set_defaults(verb=bench)
    verb.add_argument("--quick", action="store_true", help="leave out the paper's scale")

    verb = verbs.add_parser("train", help="train a learned matching cost, or resume an interrupted run")
    verb.set_defaults(verb=train)
    verb.add_argument("network", choices=["sweepnet", "mccnn"])
    verb.add_argument("--preset", default="teaching", choices=["teaching", "shipped", "paper"])
    verb.add_argument("--set", nargs="+", default=[], metavar="NAME=VALUE", help="change numbers of the preset")
    verb.add_argument("--init-weights", type=Path, metavar="FILE", help="begin with trained weights instead of random")
    verb.add_argument("--data", type=Path, default=_SAMPLE.with_name("train"), help="data set with ground truth")
    verb.add_argument("--device", default="cpu", choices=["cpu", "cuda"], help="where to compute (default: cpu)")
    verb.add_argument("--precision", default="auto", choices=["auto", "float32", "bfloat16"])
    verb.add_argument("--out", type=Path, help="folder of the run (default: out/NETWORK_PRESET)")
    either = verb.add_mutually_exclusive_group()
    either.add_argument(
        "--ship", nargs="?", const="float32", choices=["float32", "float16"],
        help="when done, copy the weights and a model card to omnistereo_lib/weights; float16 halves the file",
    )  # fmt: skip
    either.add_argument("--variants", action="store_true", help="train SweepNet by several recipes and compare them")

    verb = verbs.add_parser("evaluate", help="the paper's table on any data sets; goes on where it was stopped")
    verb.set_defaults(verb=evaluate)
    verb.add_argument("--sets", nargs="+", default=["sunny", "cloudy", "sunset"], help="names or data set folders")
    verb.add_argument("--split", choices=["train", "test"], help="of the folders (default: all frames)")
    verb.add_argument("--frames", type=int, nargs="+", help="frame numbers (default: all with ground truth)")
    verb.add_argument("--methods", nargs="+", default=[], help="such as zncc sweepnet+sgm,p1=0.2 (default: all)")
    verb.add_argument("--ablations", nargs="+", default=[], help="window weights pairs wrap subindex penalties spheres")
    verb.add_argument("--scale", default="teaching", choices=["teaching", "training", "paper"])
    verb.add_argument("--shard", default="1/1", help="part i/n of the frames, for several machines (default: 1/1)")
    verb.add_argument("--weights", type=Path, help="folder of the networks' weights (default: the shipped ones)")
    verb.add_argument("--device", default="cpu", choices=["cpu", "cuda"], help="where to compute (default: cpu)")
    verb.add_argument("--precision", default="auto", choices=["auto", "float32", "bfloat16"])
    verb.add_argument("--out", type=Path, help="folder for the results (default: out/evaluation_SCALE)")
    verb.add_argument("--rig", type=Path, help="file or folder of a rig in place of the sets' own")

    return parser


def _add_input(verb: argparse.ArgumentParser) -> None:
    verb.add_argument("--rig", type=Path, help="file or folder that describes the rig; default: the shipped sample")
    verb.add_argument("--unit", choices=["mm", "cm", "m"], help="unit of the poses, where the file does not state it")
    verb.add_argument("--images", type=Path, nargs="+", help="one image for each camera, in the rig's order")
    verb.add_argument("--frame", type=int, default=0, help="which frame of a data set folder, from 0 (default: 0)")


def _add_grid(verb: argparse.ArgumentParser, width: int, height: int, spheres: int) -> None:
    verb.add_argument("--width", type=int, default=width, help=f"panorama width (default: {width})")
    verb.add_argument("--height", type=int, default=height, help=f"panorama height (default: {height})")
    verb.add_argument("--phi", type=float, nargs=2, default=(-45.0, 45.0), help="elevation range in degrees, down > 0")
    verb.add_argument("--spheres", type=int, default=spheres, help=f"number of spheres N (default: {spheres})")
    verb.add_argument("--min-depth", type=float, help="nearest depth in metres; default: what the rig's file proposes")


def depth(options: argparse.Namespace) -> None:
    """Estimate depth for one frame and write picture, panorama, point cloud and errors."""
    import numpy as np
    from tqdm import tqdm

    from omnistereo_lib import files
    from omnistereo_lib.dataset import write_inverse_depth
    from omnistereo_lib.stereo.depth import colorize_depth
    from omnistereo_lib.stereo.metrics import index_error
    from omnistereo_lib.stereo.pipeline import estimate_depth

    rig, images, frame = _read_input(options)
    grid = _grid(options, rig)
    # What can fail comes first: nobody wants to hear of it after minutes of work.
    true_index = None if frame is None else frame.gt_index(grid)
    out = files.make_folder(options.out)
    result = estimate_depth(
        rig, images, grid, options.cost, pairs=options.pairs, device=options.device,
        progress=lambda blocks: tqdm(blocks, desc="sweep", unit="block"),
    )  # fmt: skip
    files.write_image(out / "inverse_depth.png", colorize_depth(result.inverse_depth, grid))
    files.write_image(out / "panorama.jpg", np.nan_to_num(result.panorama(images)).round().astype(np.uint8))
    write_inverse_depth(out / "inverse_depth.tiff", result.inverse_depth)
    # Beyond sphere 4 one sphere more or less is a quarter of the depth: a spray of points, not a surface.
    points, colors = result.point_cloud(images, max_depth=float(grid.index_to_depth(4)))
    files.write_ply(out / "points.ply", points, colors)
    print(f"{result.valid.mean():.1%} of the rays have a depth; {len(points)} points")
    written = ["inverse_depth.png", "panorama.jpg", "inverse_depth.tiff", "points.ply"]
    (out / "errors.json").unlink(missing_ok=True)  # of another frame
    if true_index is not None:
        errors = index_error(result.index, true_index, grid.num_spheres)
        with files.replacing(out / "errors.json") as temporary:
            temporary.write_text(json.dumps(errors, indent=1) + "\n")
        print("errors in % of the range swept: " + ", ".join(f"{name} {value:.2f}" for name, value in errors.items()))
        written.append("errors.json")
    print(f"written to {out}/: {', '.join(written)}")


def _board_size(text: str) -> tuple[int, int]:
    columns, _, rows = text.lower().partition("x")
    try:
        return int(columns), int(rows)
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected columns x rows such as 12x10, got {text!r}") from None


def calibrate(options: argparse.Namespace) -> None:
    """Calibrate one camera or a rig and write it, its report and its detections."""
    from omnistereo_lib.calibrate.board import Checkerboard
    from omnistereo_lib.calibrate.camera import calibrate_camera
    from omnistereo_lib.calibrate.rig import calibrate_rig
    from omnistereo_lib.files import make_folder, replacing

    board = Checkerboard(options.board, options.square)
    if options.corners is None:
        cameras, names, views, sizes, progress = _read_captures(options.folder)
    else:
        cameras, names, views, sizes, progress = _read_corners(options.corners, board)
    out = make_folder(options.out)
    settings = {"degree": options.degree, "max_fov_deg": options.max_fov, "progress": progress}
    if len(views) == 1:
        camera, report = calibrate_camera(views[0], board, sizes and sizes[0], **settings)
        reports = [report]
        written = _write_camera(out, camera)
    else:
        rig, report = calibrate_rig(views, board, sizes, **settings)
        reports = report.cameras
        written = _write_rig(out, rig)
    text = report.text(names)
    with replacing(out / "report.txt") as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")
    _write_reports(out, cameras, names, reports, board)
    print(text)
    print(f"written to {out}/: {', '.join([*written, 'report.txt', 'report_*.png', 'corners_*.yaml'])}")


def _read_captures(folder: Path) -> tuple:
    """Return cameras, captures, images, no sizes, and a progress bar over the images."""
    from functools import partial

    from tqdm import tqdm

    from omnistereo_lib.calibrate.captures import find_captures

    captures = find_captures(folder)
    counts = ", ".join(
        f"{sum(path is not None for path in row)} of {camera}"
        for camera, row in zip(captures.cameras, captures.paths, strict=True)
    )
    print(f"pictures: {counts}")
    return captures.cameras, captures.names, captures.views(), None, partial(tqdm, desc="boards", unit="image")


def _read_corners(folder: Path, board: Checkerboard) -> tuple:
    """Return what `_read_captures` does, with corners instead of images."""
    from omnistereo_lib.calibrate.detect import load_corners

    files = sorted(folder.glob("corners_*.yaml"), key=lambda path: (len(path.name), path.name))
    if not files:
        raise OmnistereoError(f"{folder} holds no corners_*.yaml: run once without --corners, which writes them")
    loaded = [load_corners(path) for path in files]
    for path, (_, detected, _) in zip(files, loaded, strict=True):
        if detected.corners != board.corners:
            raise OmnistereoError(f"{path} is of a board {detected}, not {board}")
    names = tuple(sorted(set().union(*(views for views, _, _ in loaded))))
    views = [[by_name.get(name) for name in names] for by_name, _, _ in loaded]
    cameras = tuple(path.stem.removeprefix("corners_") for path in files)
    return cameras, names, views, [size for _, _, size in loaded], iter


def _write_camera(out: Path, camera: OcamCamera) -> list[str]:
    from omnistereo_lib.rig_files.dialects import write_ocam_txt

    write_ocam_txt(camera, out / "ocam1.txt")
    return ["ocam1.txt"]


def _write_rig(out: Path, rig: Rig) -> list[str]:
    from omnistereo_lib.rig_files.dialects import save_rig, write_ocam_folder
    from omnistereo_lib.rig_files.export import write_for_others

    save_rig(rig, out / "config.yaml")
    write_ocam_folder(rig, out)
    residual = max(write_for_others(rig, out))
    print(f"kalibr.yaml, opencv.yaml and colmap_*: their lens model follows ours to {residual:.2f} px at worst")
    return ["config.yaml", "ocam*.txt", "poses.txt", "kalibr.yaml", "opencv.yaml", "colmap_*"]


def _write_reports(
    out: Path, cameras: Sequence[str], names: Sequence[str], reports: Sequence, board: Checkerboard
) -> None:
    """Write each camera's pictures and its corners, those without a board as null."""
    from omnistereo_lib.calibrate.detect import save_corners
    from omnistereo_lib.calibrate.figures import save_figure

    for camera, report in zip(cameras, reports, strict=True):
        save_figure(out / f"report_{camera}.png", report)
        views = {name: report.corners.get(k) for k, name in enumerate(names)}
        save_corners(out / f"corners_{camera}.yaml", views, board, report.intrinsics.image_size)


def doctor(options: argparse.Namespace) -> int:
    """Check the installation, or with --rig whether a rig fits its images."""
    if options.rig is None:
        from omnistereo_lib.doctor import check_installation

        return 0 if check_installation() else 1
    from omnistereo_lib.rig_check import check_rig, verdict

    rig, images, _ = _read_input(options)
    low, high = rig.baselines.min(), rig.baselines.max()
    print(f"{len(rig)} cameras, {low:.3g} … {high:.3g} m apart: is that so?")
    # Not a depth that comes from the baselines: it would be wrong by the same factor as they are.
    readings = check_rig(rig, images, _grid(options, rig, _NEAR))
    for reading in readings[:4]:
        print(f"{reading.cost:.3f}  {reading.name}")
    fits, sentence = verdict(readings)
    print(f"{'OK  ' if fits else 'FAIL'}  {sentence}")
    return 0 if fits else 1


def bench(options: argparse.Namespace) -> None:
    """Time the library against named alternatives."""
    from omnistereo_lib.bench import run

    run(quick=options.quick)


def train(options: argparse.Namespace) -> None:
    """Train a network, or one by each variant of its recipe; several processes under torchrun share the work."""
    from omnistereo_lib.train import RECIPES, VARIANTS, export_weights, write_comparison

    recipe = RECIPES[options.network][options.preset].with_overrides(options.set)
    out = options.out or Path("out") / f"{options.network}_{options.preset}"
    first_process = os.environ.get("RANK", "0") == "0"
    if options.variants:
        if options.network != "sweepnet":
            raise OmnistereoError("there are variants of SweepNet's recipe alone: train sweepnet --variants")
        runs = {name: out / re.sub(r"\W+", "_", name) for name in VARIANTS}
        for name, changes in VARIANTS.items():
            _train(replace(recipe, **changes), runs[name], options, name)
        if first_process:
            write_comparison(out / "variants.csv", runs, recipe.steps)
            print(f"written to {out}/: variants.csv, the validation errors side by side")
        return
    _train(recipe, out, options, "train")
    if first_process:
        print(f"{recipe.steps} steps are done; in {out}/: log.csv, state.safetensors, weights.safetensors")
    if first_process and options.ship:
        files = export_weights(out, recipe, half=options.ship == "float16")
        print(f"exported: {', '.join(map(str, files))}")


def _train(recipe: Recipe, out: Path, options: argparse.Namespace, label: str) -> None:
    """Train by one recipe to the end, with a progress bar."""
    from tqdm import tqdm

    from omnistereo_lib.train import train as run

    first_process = os.environ.get("RANK", "0") == "0"
    bar = None

    def progress(row: dict[str, float]) -> None:
        nonlocal bar
        if bar is None:  # the time left counts from the first step of this call
            bar = tqdm(total=recipe.steps, initial=row["step"], desc=label, unit="step", disable=not first_process)
        bar.set_postfix(loss=f"{row['loss']:.3f}", error=f"{row['error']:.1%}", refresh=False)
        bar.update()
        if first_process and row["validation_loss"] == row["validation_loss"]:
            bar.write(f"step {row['step'] + 1}: validation {row['validation_loss']:.4f} {row['validation_error']:.2%}")

    run(
        recipe, out, options.data, options.device, options.precision, init_weights=options.init_weights,
        progress=progress,
    )  # fmt: skip
    if bar is not None:
        bar.close()


def evaluate(options: argparse.Namespace) -> None:
    """Evaluate methods on data sets; the process that finds all results there merges them and prints the table."""
    from tqdm import tqdm

    from omnistereo_lib.evaluate import SCALES, Evaluation, errors_table, find_sets, select_methods, write_results
    from omnistereo_lib.stereo.weights import BUNDLED_WEIGHTS

    evaluation = Evaluation(
        options.out or Path("out") / f"evaluation_{options.scale}", find_sets(options.sets),
        select_methods(options.methods, options.ablations), SCALES[options.scale], options.split, options.frames,
        options.weights or BUNDLED_WEIGHTS, options.device, options.precision, options.rig,
    )  # fmt: skip
    mine = evaluation.share(options.shard)
    done = len(mine) - len(evaluation.missing(mine))
    first_process = os.environ.get("RANK", "0") == "0"
    with tqdm(total=len(mine), initial=done, desc="evaluate", unit="result", disable=not first_process) as bar:
        for job in evaluation.run(mine):
            bar.set_postfix_str(f"{job.data} {job.frame} {job.method.name}", refresh=False)
            bar.update()
    missing = evaluation.missing()
    if missing:
        there = len(evaluation.jobs) - len(missing)
        print(f"{there} of {len(evaluation.jobs)} results are in {evaluation.out}/; other shards have the rest")
        return
    results = evaluation.results()
    written = write_results(evaluation.out, results)
    print(errors_table(results).text(), end="")
    print(f"written to {evaluation.out}/: {', '.join(written)}")


def _read_input(options: argparse.Namespace) -> tuple:
    """Return the rig, the images and, where there is ground truth, its frame."""
    from omnistereo_lib.dataset import load_dataset, load_images
    from omnistereo_lib.rig_files import load_rig

    if options.images is not None:
        if options.rig is None:
            raise OmnistereoError("--images needs --rig: the file or folder that describes the cameras")
        return load_rig(options.rig, options.unit), load_images(options.images), None
    folder = options.rig or _SAMPLE
    if not folder.is_dir():
        raise OmnistereoError(f"{folder} is not a data set folder: give --images, one for each camera of the rig")
    data = load_dataset(folder, unit=options.unit)
    if not -len(data) <= options.frame < len(data):
        raise OmnistereoError(f"{folder} has frames 0 … {len(data) - 1}, not {options.frame}")
    frame = data[options.frame]
    return data.rig, frame.images, frame if frame.truth_path else None


def _grid(options: argparse.Namespace, rig: Rig, default: float | None = None) -> SphereGrid:
    """Return the grid asked for. Its nearest depth: the user's, the rig file's, the default, twice a baseline."""
    from omnistereo_lib.geometry.sphere import SphereGrid

    proposals = (options.min_depth, rig.min_depth, default)
    min_depth = next((depth for depth in proposals if depth is not None), None)
    if min_depth is None:
        min_depth = 2 * float(rig.baselines.min())
        print(f"the rig's file proposes no nearest depth: taking twice the shortest baseline, {min_depth:.2f} m")
    return SphereGrid(options.width, options.height, tuple(options.phi), options.spheres, min_depth)
