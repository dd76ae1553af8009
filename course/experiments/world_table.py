"""How good a world is that `omnistereo world` made of our training drive: its path, and depth before and after."""

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.dataset import load_dataset
from omnistereo_lib.evaluate.run import DATA
from omnistereo_lib.geometry.pose import Pose
from render.city.drive import plan_drive
from render.city.layout import plan_district

RIGHT = 0.05  # of the true depth
FRAMES = 700  # of the drive, of which the clone has every fifth


def print_table(recording: Path) -> None:
    """Print, as JSON, the errors of the steps and the percentage of right rays, of one frame alone and of the world.

    Args:
        recording: Of `data_samples/sunny/train`, by `omnistereo record`, then `omnistereo world --kitti`.
    """
    drive, numbers = (
        plan_drive(plan_district(2019), "train", FRAMES),
        np.loadtxt(recording / "world/trajectory.txt")[:, 0],
    )
    rows = np.loadtxt(recording / "world/trajectory_kitti.txt").reshape(-1, 3, 4)
    found, true = [Pose(row[:, :3], row[:, 3]) for row in rows], [drive.pose(int(n) - 1) for n in numbers]
    steps, length = [], 0.0
    for (a, b), (true_a, true_b) in zip(pairwise(found), pairwise(true), strict=True):
        step = true_a.inverse() @ true_b
        steps.append((step.inverse() @ a.inverse() @ b).magnitude())
        length += step.magnitude()[1]
    turn, place = np.array(steps).T
    end = ((true[0].inverse() @ true[-1]).inverse() @ found[0].inverse() @ found[-1]).magnitude()[1]
    result: dict[str, Any] = {
        "steps": len(steps),
        "metres": round(length),
        "turn, rms, degrees": float(np.sqrt((turn**2).mean())),
    }
    result |= {"place, median, cm": 100 * float(np.median(place)), "place, largest, cm": 100 * float(place.max())}
    result["end, % of the path"] = 100 * end / length
    truth = load_dataset(DATA / "sunny" / "train", gt_width=640)
    for name, folder in (("one frame", recording), ("world", recording / "world")):
        data = load_dataset(folder)
        shares = [right_rays(data.frame(int(n)).inverse_depth, truth.frame(int(n)).inverse_depth) for n in numbers]
        result[name] = {band: float(np.nanmean([share[band] for share in shares])) for band in shares[0]}
    print(json.dumps(result, indent=1))


def right_rays(inverse_depth: NDArray[np.float32], truth: NDArray[np.float32]) -> dict[str, float]:
    """Return the percentage of rays within 5 % of the true depth up to 25 m, by distance and at edges."""
    with np.errstate(divide="ignore"):
        depth = 1 / truth
        right = np.abs(np.nan_to_num(1 / inverse_depth, nan=np.inf) / depth - 1) < RIGHT
    bands = {"all": depth < 25, "at edges": (depth < 25) & _edges(truth), "nearer than 8 m": depth < 8}
    bands |= {"8 to 15 m": (depth >= 8) & (depth < 15), "15 to 25 m": (depth >= 15) & (depth < 25)}
    return {name: 100 * float(right[mask].mean()) if mask.any() else np.nan for name, mask in bands.items()}


def _edges(truth: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return the rays within 2 pixels of a jump of 10 %, and of 0.015/m; (H, W)."""
    right, below = np.roll(truth, -1, 1), np.vstack([truth[1:], truth[-1:]])
    jumps = [(np.abs(truth - x) > 0.015) & (np.maximum(truth, x) > 1.1 * np.minimum(truth, x)) for x in (right, below)]
    marked = jumps[0] | np.roll(jumps[0], 1, 1) | jumps[1] | np.vstack([jumps[1][:1] & False, jumps[1][:-1]])
    return cv2.dilate(marked.astype(np.uint8), np.ones((3, 3))).astype(bool)
