"""A calibration board: corners whose places are known, and a way to find them in an image."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.errors import OmnistereoError, check_number
from omnistereo_lib.geometry.pose import Floats, Pose

Gray = NDArray[Any]  # uint8, (H, W); OpenCV's stubs do not say which integers it returns


@dataclass(frozen=True)
class Board(ABC):
    """A flat board whose corners are known.

    Every corner of it is recognised, but for `symmetries`.
    """

    @property
    @abstractmethod
    def points(self) -> Floats:
        """Corners in the board frame, shape (K, 3), metres, z = 0."""

    @property
    def symmetries(self) -> tuple[NDArray[np.int64], ...]:
        """Corner permutations, each (K,), that leave the pattern unchanged; identity first."""
        return (np.arange(len(self.points)),)

    def symmetry_pose(self, symmetry: NDArray[np.int64]) -> Pose:
        """Return the pose T with `T @ points[k] == points[symmetry[k]]`."""
        return Pose.identity()

    @abstractmethod
    def find_corners(self, gray: Gray) -> Floats | None:
        """Return the corners, (K, 2) px as `points`, NaN where not visible; None: no board."""

    def another(self, grays: Sequence[Gray]) -> str | None:
        """Return at a glance what other board the images show, if they show that, not this one."""
        return None

    def advice(self, grays: Sequence[Gray]) -> str:
        """Return what to do if none of the images shows the board."""
        return "Check columns, rows and dictionary, and that the images are sharp and evenly lit"


def check_edge(edge: Any, what: str) -> float:
    """Return an edge, 0.1 mm to 1 m, as float; a larger one is taken for another unit."""
    if isinstance(edge, (int, float)) and 1 < edge <= 1000:
        raise OmnistereoError(
            f"{what} is {edge:g}. For {edge:g} mm pass {edge / 1000:g}, for {edge:g} cm"
            f" {edge / 100:g}"
        )
    return check_number(edge, what, 1e-4, 1)


def as_gray(image: ArrayLike) -> Gray:
    """Return an image (H, W) or (H, W, 3), float in 0 to 255 or uint8, as uint8 (H, W)."""
    image = np.asarray(image)
    if (
        image.ndim not in (2, 3)
        or (image.ndim == 3 and image.shape[2] not in (3, 4))
        or min(image.shape[:2]) < 16
    ):
        raise OmnistereoError(
            f"an image has shape (H, W) or (H, W, 3), at least 16 px a side; got {image.shape}"
        )
    if image.dtype != np.uint8:
        if not np.isfinite(image).all():
            raise OmnistereoError("the image has values that are not finite")
        image = np.clip(np.round(image), 0, 255).astype(np.uint8)
    return image if image.ndim == 2 else image[..., :3].mean(axis=2).round().astype(np.uint8)
