"""The path of a rig in a file: a pose for each frame, in the format of the TUM RGB-D benchmark."""

from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path

import numpy as np

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import read_text
from omnistereo_lib.geometry.pose import Pose, quaternion_from_rotation, quaternion_pose


def trajectory_tum(poses: Mapping[int, Pose], times: Mapping[int, int] | None = None) -> str:
    """Return TUM's format: for each frame its number, or with `times` in ns its time in seconds,
    the position, and the unit quaternion x y z w.
    """
    stamp = "frame" if times is None else "seconds"
    lines = [
        f"# {stamp} tx ty tz qx qy qz qw: rig -> world, metres; x right, y down, z forward in the"
        " first frame"
    ]
    for number, pose in poses.items():
        first = str(number) if times is None else f"{Decimal(times[number]).scaleb(-9):.9f}"
        values = [*pose.t, *quaternion_from_rotation(pose.R)]
        lines.append(" ".join([first, *(f"{value:.9f}" for value in values)]))
    return "\n".join(lines) + "\n"


def read_trajectory(path: Path) -> dict[int, Pose]:
    """Read TUM's format: the pose rig → world of each frame, by its number.

    Raises:
        OmnistereoError: If a line is not a whole number and seven more, or the quaternion has not
            length 1.
    """
    poses = {}
    for line in read_text(path).splitlines():
        if line.strip() and not line.startswith("#"):
            try:
                number, *values = line.split()
                numbers = np.array(values, np.float64)
                poses[int(number)] = quaternion_pose(numbers[[6, 3, 4, 5]], numbers[:3])
            except (ValueError, IndexError, OmnistereoError):
                raise OmnistereoError(
                    f"{path} has the line {line!r}; expected frame tx ty tz qx qy qz qw"
                ) from None
    return poses
