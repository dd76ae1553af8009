"""How often late cameras are found that are planted in the bundled drives, or invented."""

from collections.abc import Sequence
from functools import cache

import numpy as np

from omnistereo_learn.evaluate.run import DATA
from omnistereo_lib.dataset import load_dataset
from omnistereo_lib.geometry.pose import Floats, Pose, rotation_from_axis_angle
from omnistereo_rigs.images.late import FRAMES, REACH, LateCameras

_DRIVES = (("drive/test", 16), ("sunny/train", 40))  # folder in DATA, frames in a row
_OFF_DEG = (0.0, 0.1)  # by which every camera of the rig is turned about an axis of its own
_SHIFTS = (-5, -2, -1, 1, 2, 5)


class _Planted(LateCameras):
    """Frames in which some cameras show others, looked up in those of the whole drive."""

    def __init__(self, whole: LateCameras, start: int, late: Floats) -> None:
        super().__init__(whole.rig, whole.images[:FRAMES])
        self._whole, self._at = whole, start - late.astype(int)

    def counts(self, pair: tuple[int, int], t: int, u: int, parts: int) -> Floats:
        return self._whole.counts(pair, t + self._at[pair[0]], u + self._at[pair[1]], parts)


def print_table(clips: int = 150) -> None:
    """Print for each drive and rig how many of some clips came out right, by late cameras.

    A clip has eight frames; a right one has the lateness of all cameras exactly.
    """
    print("| drive | rig off by | none late | one | two | three | least gain | least clear pair |")
    print("| --- | ---: |" + " ---: |" * 6)
    for folder, most in _DRIVES:
        path, split = DATA / folder.split("/")[0], folder.split("/")[1]
        frames = [frame.images for frame in load_dataset(path, split=split)[:most]]
        exact = load_dataset(path, split=split).rig
        features = LateCameras(exact, frames)._features
        for off in _OFF_DEG:
            rng = np.random.default_rng(0)
            whole = LateCameras(exact.with_poses(_turned(exact.T_rig_cam, off, rng)), frames)
            whole._features = features
            whole.counts = cache(whole.counts)  # type: ignore[method-assign]
            row = _score(whole, rng, clips)
            print(f"| {folder} | {off:g}° | {' | '.join(row)} |", flush=True)


def _score(whole: LateCameras, rng: np.random.Generator, clips: int) -> list[str]:
    right, tried = np.zeros(4, int), np.zeros(4, int)
    gains, clears = list[float](), list[float]()
    while tried.min() < clips:
        count = int(tried.argmin())
        late = np.zeros(whole.cameras)
        late[rng.choice(whole.cameras, count, replace=False)] = rng.choice(_SHIFTS, count)
        first, last = int(late.max()), len(whole.images) - FRAMES + int(min(late.min(), 0))
        if np.ptp(late) > REACH or first > last:
            continue
        found = _Planted(whole, int(rng.integers(first, last + 1)), late).find()
        right[count] += np.ptp(np.array(found.frames) - late) < 0.5
        tried[count] += 1
        clears.append(found.clear)
        gains += [found.gain] if count else []
    shares = [f"{a} of {b}" for a, b in zip(right, tried, strict=True)]
    return [*shares, f"{min(gains):.2f}", f"{min(clears):.2f}"]


def _turned(poses: Sequence[Pose], off_deg: float, rng: np.random.Generator) -> list[Pose]:
    """Return poses that are each turned about a random axis."""
    axes = rng.normal(size=(len(poses), 3))
    axes *= np.radians(off_deg) / np.linalg.norm(axes, axis=1, keepdims=True)
    return [
        Pose(rotation_from_axis_angle(axis) @ pose.R, pose.t)
        for axis, pose in zip(axes, poses, strict=True)
    ]
