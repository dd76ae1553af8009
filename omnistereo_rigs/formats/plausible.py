"""What a rig file assumes without saying, checked: frame, principal point, positions."""

import logging
import warnings
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np

from omnistereo_lib.errors import OmnistereoError, error_context
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Floats, Pose
from omnistereo_lib.geometry.rig import Rig

_log = logging.getLogger("omnistereo_lib")

# of the side of the image; right calibrations, also of cropped sensors, stay below
_OFF_CENTER = 0.12
_CENTERED = 0.04
_SQUARE = 0.1  # pixels of a sensor are as wide as high, to a few thousandths
_NEAR, _FAR = 2e-3, 30.0  # m; a telephone's lenses are further apart, a ship's bridge is no wider
_ONE_POSE_DEG, _ONE_POSE_M = 0.01, 1e-4
_LEVEL_DEG = 10.0  # mounted cameras lean less, frames of another convention more
_ASTRAY_DEG = 60.0  # from the mean of the other cameras, beyond which a camera is mounted rolled
_AGREE = 0.75  # length of the mean of unit vectors; all cameras may look up or down by 40°


def check_cameras(cameras: Sequence[OcamCamera], source: Path) -> None:
    """Warn once of what `_doubt` finds."""
    with error_context(source):
        doubts = {i: doubt for i, camera in enumerate(cameras, 1) if (doubt := _doubt(camera))}
    if doubts:
        i, *others = doubts
        likewise = f". Likewise camera {', '.join(map(str, others))}" if others else ""
        number = f", camera {i}" if len(cameras) > 1 else ""
        warnings.warn(f"{source}{number}: {doubts[i]}{likewise}", UserWarning, stacklevel=2)


def _doubt(camera: OcamCamera) -> str | None:
    """Return the doubt in pixels that are no squares, or in a principal point off the middle.

    In the middle of one half of it there are two lenses. An `OmnistereoError` refuses one outside.
    """
    if abs(camera.affine[0] - 1) > _SQUARE:
        return (
            f"fy is {camera.affine[0]:.3g} times fx (the first number of affine in OCam's files); "
            "expected about the same, as pixels are squares. Check them"
        )
    size, center = np.array(camera.image_size), np.array(camera.center)
    across, along = np.sort(np.abs((center + 0.5) / size - 0.5))
    if along <= _OFF_CENTER or (abs(along - 0.25) < _CENTERED and across < _CENTERED):
        return None
    doubt = (
        f"the principal point is ({center[0]:.1f}, {center[1]:.1f}) in an image of {size[0]} × "
        f"{size[1]} px; expected near its middle. Check that width and height, row and column are "
        "not swapped, and that the image size is that of the calibration"
    )
    if along >= 0.5:
        raise OmnistereoError(doubt.replace("near its middle", "inside it, near the middle"))
    return doubt


def check_poses(rig: Rig, source: Path) -> None:
    """Warn of positions in another unit, and of two cameras with one pose, as of a copied block."""
    apart = rig.baselines.max()
    if not _NEAR < apart < _FAR:
        warnings.warn(
            f"{source}: the cameras stand up to {apart:.3g} m apart; expected {1000 * _NEAR:g} mm "
            f"to {_FAR:g} m. Check the unit of the positions: is it millimetres?",
            UserWarning,
            stacklevel=2,
        )
    for k, m in combinations(range(len(rig)), 2):
        degrees, metres = (rig.T_rig_cam[k].inverse() @ rig.T_rig_cam[m]).magnitude()
        if degrees < _ONE_POSE_DEG and metres < _ONE_POSE_M:
            warnings.warn(
                f"{source}: cameras {k + 1} and {m + 1} have the same pose; expected another for "
                "each. Check whether one is a copy",
                UserWarning,
                stacklevel=2,
            )
            return


def level(rig: Rig, source: Path) -> Rig:
    """Return a rig whose +y points down.

    Where the y axes of the cameras agree, but lean from +y by more than 10°, the rig is turned: +y
    along their mean, +z along the horizontal direction of the first camera. `Rig.T_rig_file` states
    the turn. Where they do not agree, a rig whose centres lie in a plane stays as it is, and a
    UserWarning says so if that plane is not horizontal.
    """
    down, agree = _down(rig)
    angle = float(np.degrees(np.arccos(np.clip(down[1], -1, 1))))
    if not agree:
        _, spread, axes = np.linalg.svd(rig.centers - rig.centers.mean(0))
        is_plane = len(rig) > 2 and spread[1] > 0.1 * spread[0] and spread[2] < 0.3 * spread[1]
        if is_plane and abs(axes[2, 1]) < np.cos(np.radians(_LEVEL_DEG)):
            warnings.warn(
                f"{source}: the cameras do not agree which way is down, and their centres lie in "
                "no horizontal plane: the panorama may lie on its side. Its +y should point down",
                UserWarning,
                stacklevel=2,
            )
        return rig
    if angle <= _LEVEL_DEG:
        _log.info("%s: the rig is level to %.1f°", source, angle)
        return rig
    forward = rig.T_rig_cam[0].R[:, 2]
    if abs(forward @ down) > 0.995:  # it looks up or down: the top of its image
        forward = -rig.T_rig_cam[0].R[:, 1]
    right = np.cross(down, forward)
    right /= np.linalg.norm(right)
    T = Pose(np.stack([right, down, np.cross(right, down)]), np.zeros(3))
    _log.info(
        "%s: the cameras agree that down is %.0f° from +y of the rig: the rig is turned level, by "
        "%.0f° in all, its first camera to the front (`omnistereo rig --keep-frame` or "
        "keep_frame=True leave it)",
        source,
        angle,
        T.magnitude()[0],
    )
    return rig.transformed(T)


def _down(rig: Rig) -> tuple[Floats, bool]:
    """Return the mean y axis of the cameras not mounted rolled, rig frame; whether they agree."""
    y = np.stack([pose.R[:, 1] for pose in rig.T_rig_cam])
    kept = np.ones(len(y), bool)
    for _ in range(2):
        mean = y[kept].mean(0)
        mean /= max(float(np.linalg.norm(mean)), 1e-9)
        kept = y @ mean > np.cos(np.radians(_ASTRAY_DEG))
        if not kept.any():
            return mean, False
    mean = y[kept].mean(0)
    length = float(np.linalg.norm(mean))
    return mean / length, 2 * int(kept.sum()) > len(y) and length > _AGREE
