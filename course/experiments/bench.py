"""Speed as a ratio to a named alternative, both measured by `torch.utils.benchmark` with the same number of threads."""

from __future__ import annotations

import resource
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn.functional import pad, relu
from torch.utils.benchmark import Timer

from omnistereo_lib import reference
from omnistereo_lib.calibrate.captures import find_captures
from omnistereo_lib.calibrate.checkerboard import Checkerboard
from omnistereo_lib.calibrate.detect import detect_views
from omnistereo_lib.calibrate.joint import calibrate_rig
from omnistereo_lib.calibrate.single_camera import calibrate_camera
from omnistereo_lib.dataset import load_dataset
from omnistereo_lib.evaluate.run import DATA
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.rig import camera_pairs
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.rig_files import load_rig
from omnistereo_lib.stereo.correlation import correlate, feature_coordinates, pixels_per_degree, volume_sizes
from omnistereo_lib.stereo.depth import index_and_confidence
from omnistereo_lib.stereo.images import reduce_images
from omnistereo_lib.stereo.kernels.correlation_numba import CHANNELS, GROUPS
from omnistereo_lib.stereo.learned import LearnedCost, choose_precision
from omnistereo_lib.stereo.methods import penalties
from omnistereo_lib.stereo.pipeline import sweep_depth
from omnistereo_lib.stereo.sgm import sgm
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_lib.stereo.sweepnet import SweepNet
from omnistereo_lib.stereo.volume import cost_volume
from omnistereo_lib.stereo.zncc import ZNCC, default_window
from omnistereo_lib.train import RECIPES
from omnistereo_lib.train.spheres import SphereObjective, SphereSamples
from omnistereo_tools.memory import keep_memory

_SECONDS = 3.0  # a call is repeated for so long; one that takes longer is timed once


def compare(name: str, ours: Callable, theirs: Callable, note: Callable[[float], str] = lambda ours: "") -> None:
    """Print one comparison: milliseconds of both, their ratio, and a note on our time in seconds."""
    a, b = seconds(ours), seconds(theirs)
    print(f"{name:76} {1e3 * a:9.1f} {1e3 * b:10.1f} {a / b:6.2f}  {note(a)}", flush=True)


def seconds(call: Callable) -> float:
    """Return the median time of a call; a first one, which compiles, is not counted."""
    timer = Timer("call()", globals={"call": call}, num_threads=torch.get_num_threads())
    return timer.blocked_autorange(min_run_time=_SECONDS).median


def bench_sgm(width: int, height: int, num: int) -> None:
    """Compare `sgm` (float32, 8 paths, across the seam) with OpenCV StereoSGBM in mode HH (16-bit, 8 paths).

    Both get the same image pair and the penalties of the paper; mode HH uses only one thread. The OpenCV time includes
    single-pixel costs and argmin, ours is the aggregation; OpenCV skips the first `num` columns.
    """
    left, right = _stereo_pair(width, height, num)
    volume = torch.stack([torch.from_numpy(np.abs(left - np.roll(right, n, axis=1))) for n in range(num)], -1)
    left, right = (cv2.convertScaleAbs(image, alpha=255) for image in (left, right))
    opencv = cv2.StereoSGBM.create(
        numDisparities=num, blockSize=1, P1=round(0.1 * 255), P2=12 * 255, mode=cv2.StereoSGBM_MODE_HH
    )
    compare(
        f"SGM {width}×{height}×{num}, 8 paths, against StereoSGBM HH",
        lambda: sgm(volume),
        lambda: opencv.compute(left, right),
        lambda ours: f"{volume.numel() / ours / 1e6:.0f} M cells/s",
    )


def _stereo_pair(width: int, height: int, num: int) -> tuple[NDArray, NDArray]:
    """Return two float32 images in [0, 1], right(x) = left(x + d): smooth disparity, texture, camera noise."""
    rng = np.random.default_rng(0)
    texture = cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), 1.5)
    texture = 0.5 + 0.15 * texture / texture.std()
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    disparity = num * (0.5 + 0.2 * np.sin(4 * np.pi * x / width) + 0.1 * np.cos(2 * np.pi * y / height))
    column, row = np.float32((x + disparity) % width), np.float32(y)
    right = cv2.remap(texture, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    noisy = [image + rng.normal(scale=0.01, size=image.shape) for image in (texture, right)]
    return tuple(np.clip(image, 0, 1).astype(np.float32) for image in noisy)


def bench_kernels(width: int, height: int, num: int) -> None:
    """Compare the warp, every kernel and a ZNCC + SGM frame with their definitions in `reference`, in float32."""
    sweep, images = _rig_and_images(width, height, num)
    grid, rig, pairs, spheres = sweep.grid, sweep.rig, camera_pairs("ring", sweep.rig), sweep.blocks()[0]
    window, (p1, p2) = default_window(width), penalties(width, num)
    # What each step starts from: normalised images, a block of warped ones, features and a volume.
    normalized = sweep.normalize_images(images)
    warped = sweep.warp_block(normalized, spheres).contiguous()
    size = volume_sizes(grid, rig)[0]
    reduced, _ = reduce_images(rig, images, pixels_per_degree(size))
    shapes = [(CHANNELS, -(-height // 2), -(-width // 2)) for width, height in reduced.image_sizes(len(rig))]
    features, pixels = [torch.rand(shape) for shape in shapes], feature_coordinates(reduced, grid, size)
    volume = cost_volume(sweep, images)
    rays, inverse_depths = reference.rays(width, height, grid.phi_deg), torch.from_numpy(grid.inverse_depths())

    def warp() -> list[torch.Tensor]:
        first = normalized[0], rig.cameras[0], rig.T_rig_cam[0], rays
        return [reference.warp(*first, inverse_depths[n]) for n in spheres]

    def costs() -> torch.Tensor:
        return reference.mean_over_pairs(torch.stack([reference.zncc(warped[i], warped[j], window) for i, j in pairs]))

    out = torch.empty(height, width, len(spheres))
    for name, ours, definition in (
        ("warp, one camera, one block", lambda: sweep.warp_camera(normalized[0], 0, spheres, out), warp),
        ("ZNCC, one block", lambda: ZNCC(window)(warped, pairs), costs),
        ("correlation", lambda: correlate(features, pixels), lambda: reference.correlate(features, pixels, GROUPS)),
        ("SGM", lambda: sgm(volume, p1, p2), lambda: reference.sgm(volume, p1, p2)),
        (
            "winner and confidence",
            lambda: index_and_confidence(volume, True),
            lambda: (reference.winner(volume, True), reference.confidence(volume)),
        ),
        (
            "ZNCC + SGM frame",
            lambda: sweep_depth(sweep, images, "zncc+sgm"),
            lambda: reference.estimate(normalized, rig, grid, pairs, window, p1, p2),
        ),
    ):
        compare(f"{name} {width}×{height}×{num}, against the definition", ours, definition)


def bench_volumenet(width: int, height: int, num: int) -> None:
    """Compare a whole VolumeNet frame with a ZNCC + SGM frame of this library; both have their tables ready."""
    sweep, images = _rig_and_images(width, height, num)
    methods = (partial(sweep_depth, sweep, images, name) for name in ("volumenet", "zncc+sgm"))
    compare(f"VolumeNet frame {width}×{height}×{num}, against ZNCC + SGM", *methods)


@cache
def _rig_and_images(width: int, height: int, num: int) -> tuple[SphereSweep, list[NDArray]]:
    """Return a sweep, with its lookup tables ready, and the images of a frame."""
    data = load_dataset(DATA / "sunny" / "test")
    sweep = SphereSweep(data.rig, SphereGrid(width, height, num_spheres=num, min_depth=data.rig.min_depth))
    sweep_depth(sweep, data[0].images)
    return sweep, data[0].images


def bench_sweepnet(width: int, height: int, num: int, spheres: range) -> None:
    """Compare SweepNet, in each precision of the processor, with a plain implementation on some spheres of a frame.

    Plain: in float32, every pair separately, the whole panorama, as PyTorch runs it. Weights and images are equal, the
    warp is not timed.
    """
    sweep, images = _rig_and_images(width, height, num)
    warped = sweep.warp_block(sweep.normalize_images(images), spheres)
    columns = [sweep.visible_columns(i, spheres) for i in range(len(sweep.rig))]
    pairs, network = camera_pairs("ring", sweep.rig), SweepNet.pretrained()
    for precision in ("float32", "bfloat16") if choose_precision("auto", "cpu") == "bfloat16" else ("float32",):
        compare(
            f"SweepNet {width}×{height}, {len(spheres)} of {num} spheres, {precision}, against plain float32",
            partial(LearnedCost(SweepNet.pretrained(), precision), warped, pairs, columns),
            partial(plain_sweepnet, network, warped, pairs),
        )


@torch.no_grad()
def plain_sweepnet(net: SweepNet, spherical: torch.Tensor, pairs: Sequence[tuple[int, int]]) -> torch.Tensor:
    """Return the costs of a block of spheres by Table I as printed: no crop, no shared features, no strips."""
    layers = net.layers

    def extract(image: torch.Tensor) -> torch.Tensor:
        x = relu(layers["conv1"](pad(image.nan_to_num()[None, None], (2, 2, 0, 0), mode="circular")))
        for k in range(2, 18, 2):
            x = relu(x + layers[f"conv{k + 1}"](relu(layers[f"conv{k}"](x))))
        return relu(layers["conv18"](x))

    def match(left: torch.Tensor, right: torch.Tensor) -> torch.Tensor:
        x = torch.cat([extract(left), extract(right)], 1)
        for name in ("conv19", "deconv1", "conv20"):
            x = relu(layers[name](x))
        x = x.permute(0, 2, 3, 1)
        for name in ("fc1", "fc2", "fc3", "fc4"):
            x = relu(layers[name](x))
        return torch.sigmoid(layers["fc5"](x))[0, ..., 0]

    sums, counts = torch.zeros(2, *spherical.shape[1:])
    for i, j in pairs:
        for n, (left, right) in enumerate(zip(spherical[i], spherical[j], strict=True)):  # one by one to save memory
            visible = ~(left + right).isnan()
            sums[n] += torch.where(visible, match(left, right), 0.0)
            counts[n] += visible
    return (sums / counts).permute(1, 2, 0)


def bench_training(width: int, height: int, num: int) -> None:
    """Compare a training step of SweepNet in float32 with the same step in the channels-last memory format."""
    scale = {"width": width, "height": height, "num_spheres": num, "halve": False}
    samples = SphereSamples(replace(RECIPES["sweepnet"]["shipped"], **scale), DATA / "sunny" / "train")
    batch = samples.micro_batch(samples.training[0], np.random.default_rng(0), augment=False)

    def step(network: SweepNet) -> None:
        network.zero_grad()
        SphereObjective(network)(batch)[0].backward()

    layouts = torch.contiguous_format, torch.channels_last
    networks = (SweepNet.pretrained().train().to(memory_format=layout) for layout in layouts)
    name = f"SweepNet {width}×{height}, a step of training in float32, against channels last"
    compare(name, *(partial(step, network) for network in networks))


@dataclass(frozen=True, eq=False)
class FisheyeFit:
    """Result of `cv2.fisheye.calibrate`: rms distance in px, infinite where it failed, matrix and distortion."""

    rms_px: float
    matrix: NDArray[np.float64]
    distortion: NDArray[np.float64]

    def rays(self, pixels: NDArray) -> NDArray[np.float64]:
        """Return the unit rays (K, 3) of pixels (K, 2)."""
        flat = cv2.fisheye.undistortPoints(np.asarray(pixels, np.float64)[None], self.matrix, self.distortion)[0]
        rays = np.column_stack([flat, np.ones(len(flat))])
        return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def opencv_fisheye(
    views: Sequence[NDArray], board: Checkerboard, image_size: tuple[int, int], start: OcamCamera | None = None
) -> FisheyeFit:
    """Calibrate with OpenCV on the corners (K, 2) px of complete boards within 90° of the axis, the limit of its model.

    `start` gives the initial focal length and centre; without it OpenCV mostly fails to converge.
    """
    matrix, distortion, flags = np.eye(3), np.zeros(4), cv2.CALIB_RECOMPUTE_EXTRINSIC if start else 0
    if start is not None:
        f, (u, v) = -start.poly[0], start.center
        matrix, flags = np.array([[f, 0, u], [0, f, v], [0, 0, 1]]), flags | cv2.CALIB_USE_INTRINSIC_GUESS
    points, corners = [board.points[None]] * len(views), [view[None] for view in views]
    try:
        return FisheyeFit(*cv2.fisheye.calibrate(points, corners, image_size, matrix, distortion, flags=flags)[:3])
    except cv2.error:
        return FisheyeFit(np.inf, matrix, distortion)


def bench_calibrate() -> None:
    """Calibrate a camera against `cv2.fisheye.calibrate` on the same corners; detection is not timed.

    OpenCV's model ends at 90° from the axis, so both get boards within 80°, and OpenCV our focal length to start from.
    """
    board, folder = Checkerboard((12, 10), 0.06), DATA / "calibration" / "handheld"
    captures = find_captures(folder)
    corners = [detect_views(list(captures.images(i)), board) for i in range(len(captures.cameras))]
    sizes = [camera.image_size for camera in load_rig(folder).cameras]
    start, whole = calibrate_camera(corners[0], board, sizes[0])
    near = [view for view in whole.views_used if np.nanmax(whole.angles[view]) < np.radians(80)]
    views = [whole.corners[view] for view in near if np.isfinite(whole.corners[view]).all()]
    ours_px = calibrate_camera(views, board, sizes[0])[1].errors.rms_distance_px
    theirs_px = opencv_fisheye(views, board, sizes[0], start).rms_px
    rig_s = seconds(lambda: calibrate_rig(corners, board, sizes))
    compare(
        f"calibrate a camera, {len(views)} views, against cv2.fisheye",
        lambda: calibrate_camera(views, board, sizes[0]),
        lambda: opencv_fisheye(views, board, sizes[0], start),
        lambda _: (
            f"rms distance {ours_px:.3f} px, theirs {theirs_px:.3f}; "
            f"4 cameras with {len(captures.names)} captures {rig_s:.2f} s"
        ),
    )


def run(quick: bool = False) -> None:
    """Print all comparisons; quick: only at teaching scale, in a minute. The scale of the paper takes 10 GiB."""
    keep_memory()  # as every command does
    cv2.setNumThreads(torch.get_num_threads())
    print(f"{torch.get_num_threads()} threads; medians of repeated runs\n{'':76}   ours/ms  theirs/ms  ratio")
    bench_kernels(320, 80, 64)
    for scale in [(320, 80, 64)] if quick else [(320, 80, 64), (1200, 300, 192)]:
        for comparison in (bench_sgm, bench_volumenet):
            comparison(*scale)
    if not quick:
        bench_sweepnet(320, 80, 64, range(30, 34))
        bench_sweepnet(1200, 300, 192, range(95, 96))
        bench_training(640, 160, 96)
    bench_calibrate()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"peak memory of this process, the alternatives included: {peak:.1f} GiB")
