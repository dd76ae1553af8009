"""The paper's formulas as printed, beside the library's: each returns how far the two are apart on random input."""

from __future__ import annotations

from functools import cache
from itertools import product

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.calibrate.board import Checkerboard
from omnistereo_lib.calibrate.bundle import BundleProblem
from omnistereo_lib.calibrate.params import CalibrationParams, Intrinsics, Observations
from omnistereo_lib.dataset import load_dataset
from omnistereo_lib.evaluate.run import DATA
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.rig import Rig, camera_pairs
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.depth import winner_takes_all
from omnistereo_lib.stereo.metrics import index_error
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_lib.stereo.sweepnet import SweepNet
from omnistereo_lib.stereo.volume import cost_volume
from omnistereo_lib.train.spheres import SphereBatch, SphereObjective, Strip


def _difference(ours: ArrayLike, printed: ArrayLike) -> float:
    """Return the largest difference, relative to the largest value; NaN agrees with NaN alone."""
    ours, printed = np.asarray(ours, np.float64), np.asarray(printed, np.float64)
    if not np.array_equal(np.isnan(ours), np.isnan(printed)):
        return float("nan")
    return float(np.nanmax(np.abs(ours - printed)) / np.nanmax(np.abs(printed)))


@cache
def _rig() -> Rig:
    return load_dataset(DATA / "sunny" / "test").rig.recentered()


def _sweep(width: int, height: int, num_spheres: int) -> SphereSweep:
    return SphereSweep(_rig(), SphereGrid(width, height, num_spheres=num_spheres, min_depth=_rig().min_depth))


def projection() -> float:
    """A(Π(X; Φ)), from the pixel's ray (x, y, -f(r)) of Scaramuzza's model and back."""
    camera = _rig().cameras[0]
    pixels = np.random.default_rng(0).uniform(0, min(camera.image_size) - 1, (200, 2))
    c, d, e = camera.affine
    x, y = np.linalg.inv([[1, e], [d, c]]) @ (pixels - camera.center).T
    found, seen = camera.project(
        np.stack([x, y, -np.polyval(camera.poly[::-1], np.hypot(x, y))], -1), use_direct_poly=True
    )
    return _difference(found[seen], pixels[seen])


def poses() -> float:
    """M(Θ_j ⋆ Θ_k⁻¹), R(r) as the exponential of the cross-product matrix."""
    from scipy.linalg import expm

    def M(theta: NDArray) -> NDArray:
        cross = np.cross(theta[:3], -np.eye(3))
        return np.block([[expm(cross), theta[3:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])

    a, b = np.random.default_rng(0).normal(size=(2, 6))
    pose = Pose.from_vector(a) @ Pose.from_vector(b).inverse()
    return _difference(np.column_stack([pose.R, pose.t]), (M(a) @ np.linalg.inv(M(b)))[:3])


def reprojection() -> float:
    """Σ ‖x̃ − A_i(Π(M(Θ_i ⋆ Θ_k) X; Φ_i))‖² of two cameras and one board."""
    lens = Intrinsics(np.array([400.0, 384.0, 1.01, 0.002, -0.5, 0.2, 0.05]), (800, 768))
    vectors = [[0.1, -0.2, 0.05, 0.01, 0.02, 0.1], [-0.1, 0.5, 0.1, -0.2, 0.0, 0.03]]
    board, second = map(Pose.from_vector, vectors)
    poses, points = (Pose.identity(), second), Checkerboard((12, 10), 0.06).points
    board = Pose(board.R, np.array([-0.3, -0.3, 0.6]))
    predicted = np.concatenate(
        [lens.camera(200.0).project((pose @ board) @ points, use_direct_poly=True)[0] for pose in poses]
    )
    seen = predicted + np.random.default_rng(0).normal(size=predicted.shape)
    camera, corner = np.divmod(np.arange(len(predicted)), len(points))
    corners = Observations(camera, np.zeros_like(camera), corner, seen, points)
    params = CalibrationParams((lens, lens), poses, (board,))
    residuals = BundleProblem(params, corners).residuals(params.to_vector())
    return _difference(np.sum(residuals**2), np.sum((seen - predicted) ** 2))


def rays() -> float:
    """ρ(θ, φ) as printed; the θ of print is π/2 less ours, which mirrors and turns the panorama."""
    grid = SphereGrid(48, 12)
    theta, phi = np.meshgrid(np.pi / 2 - grid.thetas(), grid.phis())
    return _difference(
        grid.rays(), np.stack([np.cos(phi) * np.cos(theta), np.sin(phi), np.cos(phi) * np.sin(theta)], -1)
    )


def spheres() -> float:
    """d_n = n / (D_min (N − 1))."""
    grid = SphereGrid(48, 12)
    n = np.arange(grid.num_spheres)
    return _difference(grid.inverse_depths(), n / (grid.min_depth * (grid.num_spheres - 1)))


def spherical_images() -> float:
    """S_{i,n}(p) = I_i(Π_i(M(Θ*_i) [ρ(p)/d_n; 1])) of images that are linear, so that any interpolation is exact."""
    sweep = _sweep(40, 10, 5)
    grid, rig = sweep.grid, sweep.rig
    images = [
        np.add.outer(2.0 * np.arange(camera.image_size[1]), np.arange(camera.image_size[0])) for camera in rig.cameras
    ]
    ours, printed = [], []
    for n in range(grid.num_spheres):
        d = n / (grid.min_depth * (grid.num_spheres - 1)) or 2.0**-23
        ours += sweep.warp(images, n)
        for camera, T_rig_cam in zip(rig.cameras, rig.T_rig_cam, strict=True):
            uv, seen = camera.project(T_rig_cam.inverse() @ (grid.rays() / d))
            printed.append(np.where(seen, uv @ [1.0, 2.0], np.nan))
    return _difference(ours, printed)


def mean_cost() -> float:
    """C(p, n) = mean_ij (1 − ZNCC)/2, where each pair sees all of the 9 × 9 patch or nothing of its middle."""
    sweep, rng = _sweep(28, 11, 2), np.random.default_rng(0)
    images = [rng.random(camera.image_size[::-1]) for camera in sweep.rig.cameras]
    spherical = sweep.warp_block(sweep.normalize_images(images), range(2)).double().numpy()
    volume, ours, printed = cost_volume(sweep, images).numpy(), [], []
    for y, x, n in product(range(4, 7), range(28), range(2)):
        patches = spherical[:, n, y - 4 : y + 5][..., np.arange(x - 4, x + 5) % 28].reshape(-1, 81)
        both = [patches[[i, j]] for i, j in camera_pairs("ring", sweep.rig)]
        both = [pair for pair in both if np.isfinite(pair[:, 40]).all()]
        if both and np.isfinite(both).all():
            ours.append(volume[y, x, n])
            printed.append(np.mean([(1 - np.corrcoef(pair)[0, 1]) / 2 for pair in both]))
    return _difference(ours, printed)


def winner() -> float:
    """n* = argmin_n C(p, n)."""
    volume = np.random.default_rng(0).random((6, 8, 10), np.float32)
    return _difference(winner_takes_all(volume), volume.argmin(-1))


def true_index() -> float:
    """n̂ = round(D_min (N − 1) / D)."""
    grid = SphereGrid(48, 12)
    depth = np.random.default_rng(0).uniform(grid.min_depth, 50, 1000)
    return _difference(np.rint(grid.depth_to_index(depth)), np.round(grid.min_depth * (grid.num_spheres - 1) / depth))


def loss() -> float:
    """L = mean of −(ŷ log y + (1 − ŷ) log(1 − y)) over as many positives as negatives."""
    with torch.random.fork_rng(), torch.no_grad():
        torch.manual_seed(0)
        network = SweepNet().eval()
        images = torch.randn(2, 1, 8, 16)
        label = torch.arange(128.0) % 2
        strip = Strip(0, 1, 0, 8, torch.ones(1, 8, 16, dtype=torch.bool), label)
        ours, _ = SphereObjective(network)(SphereBatch(images, [strip]))
        y = network(*images).reshape(-1)
    return _difference(ours, torch.where(label == 1, -y.log(), -(1 - y).log()).mean())


def errors() -> float:
    """e(p) = 100/N |n*(p) − n̂(p)|, and the five figures made of it."""
    estimate, truth = np.random.default_rng(0).uniform(0, 191, (2, 30, 40))
    estimate[:20] = truth[:20].round()
    e = 100 / 192 * np.abs(estimate - truth)
    printed = [*(100 * np.mean(e > limit) for limit in (1, 3, 5)), e.mean(), np.sqrt(np.mean(e**2))]
    return _difference(list(index_error(estimate, truth, 192).values()), printed)
