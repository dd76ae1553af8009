"""How often late cameras are found that are planted in the bundled drives, or invented."""

from collections import Counter
from collections.abc import Sequence
from functools import cache

import numpy as np

from omnistereo_learn.evaluate.run import DATA
from omnistereo_lib.dataset import load_dataset
from omnistereo_lib.geometry.pose import Floats, Pose, rotation_from_axis_angle
from omnistereo_rigs.images.late import FRAMES, REACH, LateCameras
from omnistereo_tools.record.sync import QUICK, is_on_time, is_sure, small

_DRIVES = (("drive", "test", 16), ("sunny", "train", 40))  # set, split, frames in a row
_OFF_DEG = (0.0, 0.1)  # by which every camera of the rig is turned about an axis of its own
_SHIFTS = (-5, -2, -1, 1, 2, 5)


class _Planted(LateCameras):
    """Frames in which some cameras show others, looked up in those of the whole drive."""

    def __init__(self, whole: LateCameras, start: int, late: Floats, frames: int = FRAMES) -> None:
        super().__init__(whole.rig, whole.images[:frames])
        self._whole, self._at = whole, start - late.astype(int)

    def counts(self, pair: tuple[int, int], t: int, u: int, parts: int) -> Floats:
        return self._whole.counts(pair, t + self._at[pair[0]], u + self._at[pair[1]], parts)


def print_table(clips: int = 150) -> None:
    """Print for each drive, rig and number of late cameras what is said of some clips.

    A clip has eight frames; it is right if the lateness of all cameras is, exactly.
    """
    print("| drive | rig off by | late cameras | clips | right | wrong | cannot be told |")
    print("| --- |" + " ---: |" * 6)
    for name, split, most in _DRIVES:
        data = load_dataset(DATA / name, split=split)
        frames = [data[k].images for k in range(most)]
        looks = LateCameras(data.rig, frames), LateCameras(*small(data.rig, frames))
        for off in _OFF_DEG:
            rng = np.random.default_rng(0)
            poses, turned = _turned(data.rig.T_rig_cam, off, rng), []
            for look in looks:
                turned.append(LateCameras(look.rig.with_poses(poses), look.images))
                turned[-1]._features = look._features
                turned[-1].counts = cache(turned[-1].counts)  # type: ignore[method-assign]
            for late in range(len(data.rig)):
                said = _said(turned[0], turned[1], rng, late, clips)
                row = " | ".join(str(said[key]) for key in ("right", "wrong", "open"))
                print(f"| {name} | {off:g}° | {late} | {clips} | {row} |", flush=True)


def _said(
    whole: LateCameras, first_look: LateCameras, rng: np.random.Generator, count: int, clips: int
) -> Counter[str]:
    """Return how often clips with some late cameras come out right, wrong and open."""
    said = Counter[str]()
    while said.total() < clips:
        late = np.zeros(whole.cameras)
        late[rng.choice(whole.cameras, count, replace=False)] = rng.choice(_SHIFTS, count)
        first, last = int(late.max()), len(whole.images) - FRAMES + int(min(late.min(), 0))
        if np.ptp(late) > REACH or first > last:
            continue
        start = int(rng.integers(first, last + 1))
        # As `record` does: a first look at few frames and pixels, then one at more.
        found = _Planted(first_look, start, late, QUICK).find(reach=1)
        if not is_on_time(found):
            found = _Planted(whole, start, late).find()
            if not is_sure(found):
                said["open"] += 1
                continue
        # If most cameras are late, it is the others that are early.
        said["right" if np.ptp(np.array(found.frames) - late) < 0.5 else "wrong"] += 1
    return said


def _turned(poses: Sequence[Pose], off_deg: float, rng: np.random.Generator) -> list[Pose]:
    """Return poses that are each turned about a random axis."""
    axes = rng.normal(size=(len(poses), 3))
    axes *= np.radians(off_deg) / np.linalg.norm(axes, axis=1, keepdims=True)
    return [
        Pose(rotation_from_axis_angle(axis) @ pose.R, pose.t)
        for axis, pose in zip(axes, poses, strict=True)
    ]
