"""Time of every stage against this machine's own limit and a named alternative, all measured in one
run.

The limit is the least time in which this machine could do it: for loops over the volume, the bytes
that must be moved at the speed of a triad, a = b + 2c; for networks, their multiplications at the
speed of a large matrix product. Times are medians of `torch.utils.benchmark`, all with the same
number of threads.
"""

from __future__ import annotations

import math
import resource
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.benchmark import Timer
from torch.utils.flop_counter import FlopCounterMode

from omnistereo_learn.evaluate.run import DATA
from omnistereo_lib import reference
from omnistereo_lib.dataset import load_dataset
from omnistereo_lib.frame import Frame, to_gray
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.rig import camera_pairs
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo import volumenet
from omnistereo_lib.stereo.correlation import (
    correlate,
    feature_coordinates,
    pixels_per_degree,
    volume_sizes,
)
from omnistereo_lib.stereo.depth import index_and_confidence
from omnistereo_lib.stereo.kernels.correlation_numba import CHANNELS, GROUPS
from omnistereo_lib.stereo.learned import autocast, choose_precision
from omnistereo_lib.stereo.methods import penalties
from omnistereo_lib.stereo.pipeline import sweep_depth
from omnistereo_lib.stereo.sgm import sgm
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_lib.stereo.volume import cost_volume
from omnistereo_lib.stereo.volumenet import VolumeNet
from omnistereo_lib.stereo.zncc import ZNCC, default_window
from omnistereo_rigs.boards.checkerboard import Checkerboard
from omnistereo_tools.memory import keep_memory
from workshop.results.pairs import compare_builds, growth

Call = Callable[[], object]

_SECONDS = 1.0  # a call is repeated for so long; one that takes longer is timed once
# Bytes of a cell that must be moved: costs are read, and sums read and written, along the rows,
# downwards and upwards.
_SGM, _WINNER = 3 * 4 + 5 * 4, 4
_WARP = 2 * 4 + 4  # for each camera, coordinates read and a value written


def compare(name: str, ours: Call, theirs: Call | None = None, bytes_moved: float = 0) -> None:
    """Print one line: our milliseconds, the limit's and the ratio, an alternative's and the ratio.

    Args:
        theirs: The alternative, None: there is none.
        bytes_moved: What must be read and written; 0: the limit is that of the multiplications, if
            there are any.
    """
    bandwidth, speed = machine()
    limit = bytes_moved / bandwidth or operations(ours) / speed
    a, b = seconds(ours), theirs and seconds(theirs)
    columns = [
        f"{1e3 * other:10.1f} {a / other:6.2f}" if other else " " * 17 for other in (limit, b)
    ]
    print(f"{name:76} {1e3 * a:9.1f} {' '.join(columns)}".rstrip(), flush=True)


def seconds(call: Call) -> float:
    """Return the median time of a call; a first one, which compiles, is not counted."""
    timer = Timer("call()", globals={"call": call}, num_threads=torch.get_num_threads())
    return timer.blocked_autorange(min_run_time=_SECONDS).median


@cache
def machine() -> tuple[float, float]:
    """Return this machine's bytes, and a network's operations, per second."""
    a, b, c = torch.rand(3, 1 << 24)  # far beyond the caches
    x = torch.rand(2048, 2048, dtype=getattr(torch, choose_precision("auto", "cpu")))
    triad, product = seconds(lambda: torch.add(b, c, alpha=2, out=a)), seconds(lambda: x @ x)
    return 3 * 4 * len(a) / triad, 2 * len(x) ** 3 / product


def operations(call: Call) -> int:
    """Return the multiplications and additions of a call's convolutions and matrix products."""
    # Torch's counter does not know oneDNN's fused convolutions; the plain ones multiply as often.
    plain = patch.object(volumenet, "fuses", lambda x: False)
    with plain, FlopCounterMode(display=False) as counter:
        call()
    return counter.get_total_flops()


def bench_sgm(width: int, height: int, num: int) -> None:
    """Compare `sgm` (float32, 8 paths, across the seam) with OpenCV StereoSGBM in mode HH (16-bit,
    8 paths).

    Both get the same image pair and the penalties of the paper; mode HH uses only one thread. The
    OpenCV time includes single-pixel costs and argmin, ours is the aggregation; OpenCV skips the
    first `num` columns.
    """
    image = load_dataset(DATA / "sunny" / "test")[0].images[0]
    left = cv2.resize(to_gray(image).round().astype(np.uint8), (width, height))
    right = np.roll(left, -num // 2, axis=1)
    shifted = [cv2.absdiff(left, np.roll(right, n, axis=1)) for n in range(num)]
    volume = torch.from_numpy(np.stack(shifted, -1)).float() / 255
    opencv = cv2.StereoSGBM.create(
        numDisparities=num,
        blockSize=1,
        P1=round(0.1 * 255),
        P2=12 * 255,
        mode=cv2.StereoSGBM_MODE_HH,
    )
    compare(
        f"SGM {width}×{height}×{num}, 8 paths, against StereoSGBM HH",
        lambda: sgm(volume),
        lambda: opencv.compute(left, right),
        _SGM * volume.numel(),
    )


def bench_kernels(width: int, height: int, num: int) -> None:
    """Compare warp, kernels and a ZNCC + SGM frame with their definitions, in float32."""
    sweep, images = _rig_and_images(width, height, num)
    grid, rig, spheres = sweep.grid, sweep.rig, sweep.blocks()[0]
    pairs = camera_pairs("ring", rig)
    window, (p1, p2) = default_window(width), penalties(width, num)
    # What each step starts from: normalised images, a block of warped ones, features and a volume.
    normalized = sweep.normalize_images(images)
    warped = sweep.warp_block(normalized, spheres).contiguous()
    size = volume_sizes(grid, rig)[0]
    frame = Frame.of(rig, images)
    reduced = frame.reduced(pixels_per_degree(size)).rig
    shapes = [(CHANNELS, -(-h // 2), -(-w // 2)) for w, h in reduced.image_sizes(len(rig))]
    features = [torch.rand(shape) for shape in shapes]
    pixels = feature_coordinates(reduced, grid, size)
    volume = cost_volume(sweep, images)
    cameras, cells, of_block = len(rig), volume.numel(), warped[0].numel()
    rays, inverse_depths = (
        reference.rays(width, height, grid.phi_deg),
        torch.from_numpy(grid.inverse_depths()),
    )

    def warp() -> list[torch.Tensor]:
        first = normalized[0], rig.cameras[0], rig.T_rig_cam[0], rays
        return [reference.warp(*first, inverse_depths[n]) for n in spheres]

    def costs() -> torch.Tensor:
        return reference.mean_over_pairs(
            torch.stack([reference.zncc(warped[i], warped[j], window) for i, j in pairs])
        )

    def winner() -> tuple[torch.Tensor, torch.Tensor]:
        return reference.winner(volume, True), reference.confidence(volume)

    out = torch.empty(height, width, len(spheres))
    of_frame = (_zncc_bytes(cameras) + _SGM + _WINNER) * cells
    of_correlation = 4 * (2 * cameras + GROUPS + 1) * math.prod(size)

    def against(name: str, bytes_moved: float, ours: Call, definition: Call) -> None:
        compare(
            f"{name} {width}×{height}×{num}, against the definition", ours, definition, bytes_moved
        )

    ours = partial(sweep.warp_camera, normalized[0], 0, spheres, out)
    against("warp, one camera, one block", _WARP * of_block, ours, warp)
    against(
        "ZNCC, one block", 4 * (cameras + 1) * of_block, partial(ZNCC(window), warped, pairs), costs
    )
    definition = partial(reference.correlate, features, pixels, GROUPS)
    against("correlation", of_correlation, partial(correlate, features, pixels), definition)
    against(
        "SGM", _SGM * cells, partial(sgm, volume, p1, p2), partial(reference.sgm, volume, p1, p2)
    )
    elect = partial(index_and_confidence, volume, True)
    against("winner and confidence", _WINNER * cells, elect, winner)
    definition = partial(reference.estimate, normalized, rig, grid, pairs, window, p1, p2)
    against(
        "ZNCC + SGM frame", of_frame, partial(sweep_depth, sweep, images, "zncc+sgm"), definition
    )


def _zncc_bytes(cameras: int) -> int:
    """Return the bytes of a cell: warped images written and read, costs written."""
    return (_WARP + 4) * cameras + 4


def bench_volumenet(width: int, height: int, num: int) -> None:
    """Time the ZNCC volume, the parts of VolumeNet, and its frame against ZNCC + SGM."""
    sweep, images = _rig_and_images(width, height, num)
    scale, network = f"{width}×{height}×{num}", VolumeNet.pretrained()
    bytes_moved = _zncc_bytes(len(sweep.rig)) * width * height * num
    compare(f"ZNCC volume {scale}", lambda: cost_volume(sweep, images), None, bytes_moved)
    # Features of a camera, and the U-net, of the finest volume.
    size = volume_sizes(sweep.grid, sweep.rig)[-1]
    frame = Frame.of(sweep.rig, images).reduced(pixels_per_degree(size))
    visible = torch.from_numpy(frame.rig.cameras[0].visible_pixels())
    with torch.no_grad(), autocast("auto", visible.device):
        features = network.features_of(sweep, frame)
        correlation = network.correlation_at(sweep, frame, size, features)
        compare(
            f"VolumeNet {scale}: features of one camera",
            lambda: network.features(visible.float(), visible),
        )
        compare(f"VolumeNet {scale}: U-net", lambda: network(correlation[None]))
    ours, theirs = (partial(sweep_depth, sweep, images, name) for name in ("volumenet", "zncc+sgm"))
    compare(f"VolumeNet frame {scale}, against ZNCC + SGM", ours, theirs)


@cache
def _rig_and_images(width: int, height: int, num: int) -> tuple[SphereSweep, list[NDArray[Any]]]:
    """Return a sweep, with its lookup tables ready, and the images of a frame."""
    data = load_dataset(DATA / "sunny" / "test")
    grid = SphereGrid(width, height, num_spheres=num, min_depth=data.rig.min_depth)
    sweep = SphereSweep(data.rig, grid)
    sweep_depth(sweep, data[0].images)
    return sweep, data[0].images


@dataclass(frozen=True, eq=False)
class FisheyeFit:
    """Result of `cv2.fisheye.calibrate`: rms px, infinite if it failed, matrix, distortion."""

    rms_px: float
    matrix: NDArray[np.float64]
    distortion: NDArray[np.float64]

    def rays(self, pixels: NDArray[Any]) -> NDArray[np.float64]:
        """Return the unit rays (K, 3) of pixels (K, 2)."""
        flat = cv2.fisheye.undistortPoints(
            np.asarray(pixels, np.float64)[None], self.matrix, self.distortion
        )[0]
        rays = np.column_stack([flat, np.ones(len(flat))])
        return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def opencv_fisheye(
    views: Sequence[NDArray[Any]],
    board: Checkerboard,
    image_size: tuple[int, int],
    start: OcamCamera | None = None,
) -> FisheyeFit:
    """Calibrate with OpenCV on the corners (K, 2) px of complete boards within 90° of the axis, the
    limit of its model.

    `start` gives the initial focal length and centre; without it OpenCV begins from an equidistant
    lens of 180° across the image, and may stop with an error, which is returned as infinite. Poses
    are always found again in each step (CALIB_RECOMPUTE_EXTRINSIC): on `calibration/handheld`
    within 80° a good start ends at 0.09 px with it, and at 3.8 px without.
    """
    matrix, distortion, flags = np.eye(3), np.zeros(4), cv2.CALIB_RECOMPUTE_EXTRINSIC
    if start is not None:
        f, (u, v) = -start.poly[0], start.center
        matrix = np.array([[f, 0, u], [0, f, v], [0, 0, 1]])
        flags |= cv2.CALIB_USE_INTRINSIC_GUESS
    points, corners = [board.points[None]] * len(views), [view[None] for view in views]
    try:
        fit: Any = cv2.fisheye.calibrate(
            points, corners, image_size, matrix, distortion, flags=flags
        )[:3]
        return FisheyeFit(*fit)
    except cv2.error:
        return FisheyeFit(np.inf, matrix, distortion)


def run(quick: bool = False, against: Path | None = None) -> None:
    """Print all comparisons; quick: in five minutes, without growth and the paper's scale, 10 GiB.

    against: another clone with an environment in `.venv`, whose commands are run by turns.
    """
    if against is not None:
        compare_builds(against, runs=2 if quick else 3)
    keep_memory()  # as every command does
    cv2.setNumThreads(torch.get_num_threads())
    bandwidth, speed = (value / 1e9 for value in machine())
    limits = (
        f"triad {bandwidth:.0f} GB/s, matrix product {speed:.0f} GFLOP/s in"
        f" {choose_precision('auto', 'cpu')}"
    )
    print(
        f"{torch.get_num_threads()} threads: {limits}\n{'':76}   ours/ms   limit/ms  ratio "
        " theirs/ms  ratio"
    )
    bench_kernels(320, 80, 64)
    for scale in [(320, 80, 64), (640, 160, 192)] + [(1200, 300, 192)] * (not quick):
        bench_sgm(*scale)
        bench_volumenet(*scale)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    if not quick:
        growth()
    print(f"peak memory of this process, the alternatives included: {peak:.1f} GiB")
