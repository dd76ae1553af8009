"""The share of rays with the right depth by distance, for one rig at several sizes."""

from itertools import pairwise

import numpy as np

from omnistereo_learn.endless.scenes import street, things
from omnistereo_learn.endless.worlds import Scene, develop, without_obstacles
from omnistereo_learn.evaluate.run import DATA
from omnistereo_lib.dataset import load_dataset
from omnistereo_lib.frame import Frame
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.stereo.pipeline import estimate_depth
from omnistereo_tools.judge.coverage import Coverage

SIZES = (0.05, 0.2, 0.6, 1.2, 4.0)  # metres between opposite cameras
EDGES = (0.5, 1, 2, 4, 8, 16, 32, 64)  # metres
RIGHT = 0.1  # of the true distance
KINDS, WORLDS = (things, street), 2  # of each


def print_table(method: str = "zncc+sgm") -> None:
    """Print for each size the nearest sphere, and the share of right rays by distance."""
    bands = [f"{low:g} to {high:g} m" for low, high in pairwise(EDGES)]
    print(
        f"| largest distance between cameras | nearest sphere | {' | '.join(bands)}"
        f" |\n|{' ---: |' * (2 + len(bands))}"
    )
    for size in SIZES:
        nearest, right = shares(size, method)
        print(
            f"| {size:g} m | {nearest:.2g} m |"
            f" {' | '.join(f'{100 * share:.0f} %' for share in right)} |",
            flush=True,
        )


def shares(size: float, method: str) -> tuple[float, list[float]]:
    """Return the nearest depth proposed for a size, and the share of right rays in each band."""
    like = load_dataset(DATA / "sunny", split="train").rig.recentered()
    scale = size / np.ptp(like.centers, axis=0).max()
    rig = like.with_poses([Pose(pose.R, scale * pose.t) for pose in like.T_rig_cam])
    grid = Coverage.of(rig).propose(320, 80, num_spheres=96)
    found, true = [], []
    for kind in KINDS:
        for number in range(WORLDS):
            rng = np.random.default_rng(number)
            builder, light, _ = kind(rng)
            scene = Scene(without_obstacles(np.concatenate(builder.primitives), rig, 0.05), light)
            views = list(map(scene.image, rig.cameras, rig.T_rig_cam))
            depth = estimate_depth(Frame.of(rig, develop(views, rig.cameras, rng)), grid, method)
            found.append(depth.inverse_depth)
            true.append(scene.inverse_depth_along(grid.rays()))
    ratio = np.array(found) / np.maximum(true, 1e-9)
    is_right = (ratio > 1 / (1 + RIGHT)) & (ratio < 1 + RIGHT)
    bands = np.digitize(1 / np.maximum(true, 1e-9), EDGES)
    return grid.min_depth, [float(is_right[bands == k].mean()) for k in range(1, len(EDGES))]
