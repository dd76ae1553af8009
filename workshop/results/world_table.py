"""How good a world of a rendered drive is: its path, its depth, its mesh."""

import json
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from omnistereo_learn.evaluate.run import DATA
from omnistereo_lib.dataset import Dataset, load_dataset
from omnistereo_lib.files import read_data
from omnistereo_lib.geometry.pose import Floats, Pose, nearest_rotation
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.geometry.trajectory import read_trajectory
from omnistereo_tools.output.mesh_export import import_trimesh
from omnistereo_tools.world.build import RecordedFrames
from omnistereo_tools.world.fusion import View, Volume, touched_blocks
from omnistereo_tools.world.surface import extract_surface, seen_surface
from workshop.render.city.layout import plan_district
from workshop.render.city.traffic import Traffic
from workshop.render.image_sets import SEED, SETS, true_poses

RIGHT = 0.05  # of the true depth
_WITHIN_M = (0.1, 0.2, 0.5)  # of a mesh
_POINTS = 200_000  # of each mesh, compared
# metres: half a width, and heights over the ground between which a ray sees a car
_CAR = (1.3, 0.1, 2.6)


def print_table(recording: Path, data: str) -> None:
    """Print, as JSON, the errors of the steps, the percentage of right rays before and after, and F
    of the mesh.

    Args:
        recording: Of a drive in `data_samples`, by `omnistereo record`, then `omnistereo world`.
        data: The drive, such as "sunny/train".
    """
    found, true = (
        read_trajectory(path / "trajectory.txt") for path in (recording / "world", DATA / data)
    )
    T_first_world = true[min(found)].inverse()
    true = {number: T_first_world @ true[number] for number in found}
    truth, frames = load_dataset(DATA / data, gt_width=640), RecordedFrames.open(recording)
    result: dict[str, Any] = _path_errors(found, true)
    moving = _driving_cars(data, {n: truth.frame(n).inverse_depth for n in found}, frames.grid)
    for name, folder in (("one frame", recording), ("world", recording / "world")):
        estimates = load_dataset(folder)
        shares = [
            right_rays(estimates.frame(n).inverse_depth, truth.frame(n).inverse_depth, moving[n])
            for n in found
        ]
        result[name] = {band: float(np.nanmean([s[band] for s in shares])) for band in shares[0]}
    result["mesh"] = _mesh_f(recording / "world", found, true, truth, frames.grid)
    print(json.dumps(result, indent=1))


def _path_errors(found: dict[int, Pose], true: dict[int, Pose]) -> dict[str, float]:
    steps, length = [], 0.0
    for a, b in pairwise(found):
        step = true[a].inverse() @ true[b]
        steps.append((step.inverse() @ found[a].inverse() @ found[b]).magnitude())
        length += step.magnitude()[1]
    turn, place = np.array(steps).T
    first, last = min(found), max(found)
    whole = true[first].inverse() @ true[last]
    end = (whole.inverse() @ found[first].inverse() @ found[last]).magnitude()[1]
    return {
        "steps": len(steps),
        "metres": round(length),
        "turn, rms, degrees": float(np.sqrt((turn**2).mean())),
        "place, median, cm": 100 * float(np.median(place)),
        "place, largest, cm": 100 * float(place.max()),
        "end, % of the path": 100 * end / length,
    }


def _driving_cars(
    data: str, truth: dict[int, NDArray[np.float32]], grid: SphereGrid
) -> dict[int, NDArray[np.bool_]]:
    """Return the rays of each frame, (H, W), that end in the box of a driving car."""
    traffic = Traffic(plan_district(SEED), SimpleNamespace(put=lambda *_: SimpleNamespace()))
    true_pose, (half_width, low, high), found = true_poses(SETS[data], SEED), _CAR, {}
    for number, inverse_depth in truth.items():
        T_world_rig = true_pose(number)
        traffic.show(number, T_world_rig.t[:2])
        points = T_world_rig @ (grid.rays() / np.maximum(inverse_depth, 1e-3)[..., None])
        upright = (points[..., 2] > low) & (points[..., 2] < high)
        inside = np.zeros(grid.shape, bool)
        for x, y, yaw, length in traffic.shown():
            offset = points[..., :2] - (x, y)
            along, across = (
                np.abs(offset @ [np.cos(a), np.sin(a)]) for a in (yaw, yaw + np.pi / 2)
            )
            inside |= upright & (along < length / 2 + 0.2) & (across < half_width)
        found[number] = inside
    return found


def _mesh_f(
    world: Path, found: dict[int, Pose], true: dict[int, Pose], truth: Dataset, grid: SphereGrid
) -> dict[str, float]:
    """Return F of the mesh, laid on the true path, against that of the exact depth."""
    settings, views = read_data(world / "world.json"), []
    for number, pose in true.items():
        inverse_depth = truth.frame(number).inverse_depth
        views.append(
            View.of(pose, inverse_depth, np.ones(grid.shape), np.zeros(grid.shape), grid.step)
        )
    voxel, reach = settings["voxel"], settings["range"]
    keys = np.unique(np.concatenate([touched_blocks(view, grid, voxel, reach) for view in views]))
    volume = Volume(keys, voxel, reach, 1)
    for view in views:
        volume.integrate(view, grid)
    seen = ((view.T_world_rig, view.inverse_depth) for view in views)
    exact = seen_surface(extract_surface(volume), seen, grid).vertices.astype(np.float64)
    mesh = import_trimesh().load(world / "mesh.ply", process=False)
    scores = f_scores(_laid_on(list(found.values()), list(true.values())) @ mesh.vertices, exact)
    return {f"F at {100 * d:.0f} cm": score for d, score in zip(_WITHIN_M, scores, strict=True)}


def _laid_on(path: list[Pose], true: list[Pose]) -> Pose:
    """Return the motion that lays a path on another, by positions and, at 3 m, axes."""
    a, b = (np.array([pose.t for pose in poses]) for poses in (path, true))
    turns = sum((9 * y.R @ x.R.T for x, y in zip(path, true, strict=True)), np.zeros((3, 3)))
    R = nearest_rotation((b - b.mean(axis=0)).T @ (a - a.mean(axis=0)) + turns)
    return Pose(R, b.mean(axis=0) - R @ a.mean(axis=0))


def f_scores(found: Floats, true: Floats) -> list[float]:
    """Return the F of points (M, 3) and (N, 3), in percent, at 10, 20 and 50 cm."""
    rng = np.random.default_rng(0)
    one, other = (points[rng.permutation(len(points))[:_POINTS]] for points in (found, true))
    off, missed = cKDTree(other).query(one)[0], cKDTree(one).query(other)[0]
    shares = [((off < d).mean(), (missed < d).mean()) for d in _WITHIN_M]
    return [200 * float(p * r / max(p + r, 1e-9)) for p, r in shares]


def right_rays(
    inverse_depth: NDArray[np.float32], truth: NDArray[np.float32], moving: NDArray[np.bool_]
) -> dict[str, float]:
    """Return the percentage of rays within 5 % up to 25 m: of what stands, of what moves."""
    with np.errstate(divide="ignore"):
        depth = 1 / truth
        right = np.abs(np.nan_to_num(1 / inverse_depth, nan=np.inf) / depth - 1) < RIGHT
    near = (depth < 25) & ~moving
    bands = {"all that stands": near, "at edges": near & _edges(truth)}
    bands |= {"nearer than 8 m": near & (depth < 8)}
    bands |= {"8 to 15 m": near & (depth >= 8) & (depth < 15), "15 to 25 m": near & (depth >= 15)}
    bands["driving cars"] = (depth < 25) & moving
    return {
        k: 100 * float(right[mask].mean()) if mask.any() else np.nan for k, mask in bands.items()
    }


def _edges(truth: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return the rays within 2 pixels of a jump of 10 %, and of 0.015/m; (H, W)."""
    right, below = np.roll(truth, -1, 1), np.vstack([truth[1:], truth[-1:]])
    jumps = [
        (np.abs(truth - x) > 0.015) & (np.maximum(truth, x) > 1.1 * np.minimum(truth, x))
        for x in (right, below)
    ]
    across, down = jumps
    marked = across | np.roll(across, 1, 1) | down | np.vstack([down[:1] & False, down[:-1]])
    return cv2.dilate(marked.astype(np.uint8), np.ones((3, 3))).astype(bool)
