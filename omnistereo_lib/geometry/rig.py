"""Rigs of fixed cameras and the camera pairs that are matched (paper, Section III-A and III-B)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from numbers import Integral
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.errors import OmnistereoError, check_number, check_type
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose

Unit = Literal["mm", "cm", "m"]
Pair = tuple[int, int]
# Inverse depth in 1/m of the sphere at infinity in the paper.
D0 = 2.0**-23
Pairs = Literal["ring", "all"] | Sequence[Pair]


class Deviation(NamedTuple):
    """Standard deviations of a camera against the others: how far its calibration may be off."""

    rotation: float = 0.0  #: radians, about all axes together
    center: float = 0.0  #: metres, along all axes together
    lens: float = 0.0  #: radians, of the ray of a pixel, in either direction across it


@dataclass(frozen=True, eq=False)
class Rig:
    """Two or more cameras and their poses.

    Raises an `OmnistereoError` if there are fewer than two cameras or not one pose per camera.

    >>> rig = osl.load_rig("data_samples/sunny/test")
    >>> len(rig), rig.min_depth
    (4, 1.65)
    >>> rig.baselines.round(2)
    array([0.86, 1.2 , 0.84, 0.86, 1.2 , 0.84])
    """

    cameras: Sequence[OcamCamera]
    #: camera → rig, metres: as in the public files, the inverse of Θ* in the paper
    T_rig_cam: Sequence[Pose]
    #: nearest depth in metres that the rig file proposes for a sweep
    min_depth: float | None = None
    #: from the frame of the file that it was read from to the rig frame
    T_rig_file: Pose | None = None
    #: How far each camera may be off, one for each; empty: the rig does not say.
    deviations: Sequence[Deviation] = ()

    def __post_init__(self) -> None:
        for name in ("cameras", "T_rig_cam", "deviations"):
            check_type(getattr(self, name), Iterable, name)
            object.__setattr__(self, name, tuple(getattr(self, name)))
        if len(self.cameras) < 2 or len(self.cameras) != len(self.T_rig_cam):
            raise OmnistereoError(
                f"the rig has {len(self.cameras)} cameras and {len(self.T_rig_cam)} poses; "
                "expected at least 2 cameras and one pose per camera"
            )
        for i, (camera, pose) in enumerate(zip(self.cameras, self.T_rig_cam, strict=True), 1):
            if not (isinstance(camera, OcamCamera) and isinstance(pose, Pose)):
                raise OmnistereoError(
                    f"camera {i} is {camera!r:.40}, {pose!r:.40}; expected an OcamCamera and a Pose"
                )
            what = f"the distance of camera {i} from the origin, metres,"
            check_number(float(np.abs(pose.t).max()), what, 0, 1e7)
        if self.min_depth is not None:
            what = "the nearest depth in metres (min_depth, omnimvs_sweep_min_depth)"
            check_number(self.min_depth, what, 1e-6, 1e6)
        if len(self.deviations) not in (0, len(self)):
            raise OmnistereoError(
                f"the rig has {len(self)} cameras and {len(self.deviations)} deviations; expected "
                "one for each camera, or none"
            )
        for name, most in (("rotation", np.pi), ("center", 1e7), ("lens", np.pi)):
            for i, one in enumerate(self.deviations, 1):
                check_number(getattr(one, name), f"the {name} deviation of camera {i}", 0, most)

    def __len__(self) -> int:
        return len(self.cameras)

    @property
    def centers(self) -> NDArray[np.float64]:
        """Camera centres in the rig frame, shape (cameras, 3), metres."""
        return np.stack([pose.t for pose in self.T_rig_cam])

    def image_sizes(self, count: int) -> list[tuple[int, int]]:
        """Return (width, height) of every camera; refuse `count` images if not one per camera."""
        if count != len(self):
            raise OmnistereoError(
                f"there are {count} images for {len(self)} cameras. Pass one image per camera, in"
                " rig order."
            )
        return [camera.image_size for camera in self.cameras]

    def towards(
        self, camera: int, rays: NDArray[np.float64], inverse_depth: ArrayLike = 0.0
    ) -> NDArray[np.float64]:
        """Return the points ρ/d of rays (..., 3) in the frame of a camera, times d (..., 3).

        M(Θ*) ρ/d is R ρ/d + t. Times d it is R ρ + d t: a projection needs only its direction, and
        nothing is divided by 0 at infinity, where d is 2⁻²³ as in the paper's code.
        """
        T_cam_rig = self.T_rig_cam[camera].inverse()
        turned, d = rays @ T_cam_rig.R.T, np.maximum(inverse_depth, D0)
        # Side by side in memory: NumPy is slow across a last axis of 3.
        sides = np.empty((3, *np.broadcast_shapes(turned.shape[:-1], d.shape)))
        for k, side in enumerate(sides):
            np.add(turned[..., k], d * T_cam_rig.t[k], out=side)
        return np.moveaxis(sides, 0, -1)

    def sees(self, rays: NDArray[np.float64], inverse_depth: ArrayLike = 0.0) -> NDArray[np.bool_]:
        """Return which cameras see the points of rays at inverse depths in 1/m: (cameras, ...)."""
        cameras = enumerate(self.cameras)
        return np.stack([c.sees(self.towards(i, rays, inverse_depth)) for i, c in cameras])

    @property
    def baselines(self) -> NDArray[np.float64]:
        """Distances between all pairs of camera centres, shape (pairs,), metres."""
        i, j = np.triu_indices(len(self), 1)
        return np.linalg.norm(self.centers[i] - self.centers[j], axis=-1)

    def transformed(self, T_new_rig: Pose) -> Rig:
        """Return the rig in another frame: T_new_rig maps rig coordinates to the new frame."""
        check_type(T_new_rig, Pose, "T_new_rig")
        T_new_file = T_new_rig if self.T_rig_file is None else T_new_rig @ self.T_rig_file
        poses = [T_new_rig @ pose for pose in self.T_rig_cam]
        return replace(self, T_rig_cam=poses, T_rig_file=T_new_file)

    def recentered(self, center: ArrayLike | None = None) -> Rig:
        """Return the rig with its origin moved to the sweep centre, axes unchanged.

        Args:
            center ((3,), metres): Sweep centre in the rig frame. Default: the mean of the cameras.
        """
        center = self.centers.mean(0) if center is None else np.asarray(center, np.float64)
        return self.transformed(Pose(np.eye(3), -center))

    def with_poses(self, T_rig_cam: Sequence[Pose]) -> Rig:
        """Return the same cameras with other poses."""
        return replace(self, T_rig_cam=T_rig_cam)


def camera_pairs(pairs: Pairs, rig: Rig) -> list[Pair]:
    """Return the camera pairs to match, as indices (paper, Section III-B).

    Args:
        pairs: "ring": each camera with its neighbour to the right, by the azimuth of the optical
            axes. For the rig of the paper: (0, 1), (1, 2), (2, 3), (3, 0), as in the released code.
            "all": every unordered pair, as in the text of the paper.

    Raises:
        OmnistereoError: If a pair names a missing camera, or one camera twice.

    >>> from omnistereo_lib.geometry.rig import camera_pairs
    >>> rig = osl.load_rig("data_samples/sunny/test")
    >>> camera_pairs("ring", rig)
    [(0, 1), (1, 2), (2, 3), (3, 0)]
    >>> camera_pairs("all", rig)
    [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    """
    check_type(rig, Rig, "rig")
    if isinstance(pairs, str) and pairs == "ring":
        return _neighbours(rig)
    if isinstance(pairs, str) and pairs == "all":
        return list(combinations(range(len(rig)), 2))
    if isinstance(pairs, str):
        raise OmnistereoError(
            f'pairs is {pairs!r}; expected "ring", "all" or a list of camera pairs'
        )
    chosen: list[Any] = list(pairs) if isinstance(pairs, Sequence | np.ndarray) else [pairs]
    for pair in chosen:
        two = isinstance(pair, Sequence | np.ndarray) and len(pair) == 2 and pair[0] != pair[1]
        if not (two and all(isinstance(i, Integral) and i in range(len(rig)) for i in pair)):
            raise OmnistereoError(
                f"pairs has {pair!r}; expected two different cameras of 0 to {len(rig) - 1}"
            )
    if not chosen:
        raise OmnistereoError("pairs is empty; expected at least one camera pair")
    return [(int(i), int(j)) for i, j in chosen]


def _neighbours(rig: Rig) -> list[Pair]:
    """Return the ring of cameras by the azimuth θ of their optical axes, starting at camera 0."""
    # The third column of R is the optical axis, z, in the rig frame.
    axes = np.stack([pose.R[:, 2] for pose in rig.T_rig_cam])
    azimuth = np.arctan2(axes[:, 0], axes[:, 2])
    around = np.argsort((azimuth - azimuth[0] + 1e-6) % (2 * np.pi), kind="stable").tolist()
    if len(around) == 2:
        return [(0, 1)]
    return list(zip(around, around[1:] + around[:1], strict=True))
