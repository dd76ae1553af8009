"""A rig: cameras that are fixed to each other (paper, Section III-A, Θ_i)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose

Unit = Literal["mm", "cm", "m"]


@dataclass(frozen=True, eq=False)
class Rig:
    """Two or more cameras and where they stand.

    Parameters
    ----------
    cameras : sequence of OcamCamera
    T_rig_cam : sequence of Pose
        Camera → rig, metres: the public files' direction, the inverse of the paper's Θ*.
    min_depth : float, optional
        Nearest depth in metres that the rig's file proposes for a sweep.

    Raises
    ------
    OmnistereoError
        If there are fewer than two cameras or not one pose per camera.
    """

    cameras: tuple[OcamCamera, ...]
    T_rig_cam: tuple[Pose, ...]
    min_depth: float | None = None

    load: ClassVar[Callable[..., Rig]]  # `rig_files` attaches both: geometry knows nothing of files
    save: ClassVar[Callable[..., None]]

    def __post_init__(self) -> None:
        object.__setattr__(self, "cameras", tuple(self.cameras))
        object.__setattr__(self, "T_rig_cam", tuple(self.T_rig_cam))
        if len(self.cameras) < 2 or len(self.cameras) != len(self.T_rig_cam):
            raise OmnistereoError(
                f"a rig needs two or more cameras and one pose each, got {len(self.cameras)} cameras "
                f"and {len(self.T_rig_cam)} poses"
            )

    def __len__(self) -> int:
        return len(self.cameras)

    @property
    def centers(self) -> NDArray[np.float64]:
        """Camera centres in the rig frame, shape (cameras, 3), metres."""
        return np.stack([pose.t for pose in self.T_rig_cam])

    @property
    def baselines(self) -> NDArray[np.float64]:
        """Distances between all pairs of camera centres, shape (pairs,), metres."""
        i, j = np.triu_indices(len(self), 1)
        return np.linalg.norm(self.centers[i] - self.centers[j], axis=-1)

    def moved(self, T_new_rig: Pose) -> Rig:
        """Return the same rig in another frame: T_new_rig takes rig coordinates to the new frame."""
        return Rig(self.cameras, [T_new_rig @ pose for pose in self.T_rig_cam], self.min_depth)

    def centered(self, center: ArrayLike | None = None) -> Rig:
        """Return the rig with its origin at the sweep centre, without turning it.

        Parameters
        ----------
        center : array, shape (3,), optional
            Sweep centre in the rig frame, metres; the mean of the camera centres unless given.
        """
        center = self.centers.mean(0) if center is None else np.asarray(center, np.float64)
        return self.moved(Pose(np.eye(3), -center))

    def with_poses(self, T_rig_cam: list[Pose]) -> Rig:
        """Return the same cameras at other poses."""
        return Rig(self.cameras, T_rig_cam, self.min_depth)
