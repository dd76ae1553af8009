"""What a rig file assumes without saying, checked for every format: frame, principal point, sizes,
positions.
"""

import logging
import warnings
from pathlib import Path

import numpy as np

from omnistereo_lib.errors import OmnistereoError, error_context
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Floats, Pose
from omnistereo_lib.geometry.rig import Rig

_log = logging.getLogger("omnistereo_lib")

_FAR = 1000.0  # metres
# of the side of the image; right calibrations, also of cropped sensors, stay below
_OFF_CENTER = 0.12
_CENTERED = 0.04
_LEVEL_DEG = 10.0  # mounted cameras lean less, frames of another convention more
_ASTRAY_DEG = 60.0  # from the mean of the other cameras, beyond which a camera is mounted rolled
_AGREE = 0.75  # length of the mean of unit vectors; all cameras may look up or down by 40°


def check_rig(rig: Rig, source: Path) -> None:
    """Refuse cameras far from the origin; warn of what `camera_doubt` finds."""
    if (far := np.abs(rig.centers).max()) > _FAR:
        raise OmnistereoError(
            f"a camera stands {far:.4g} m from the origin; expected at most {_FAR:g} m"
        )
    doubts = {
        i: doubt for i, camera in enumerate(rig.cameras, 1) if (doubt := camera_doubt(camera))
    }
    if doubts:
        i, *others = doubts
        likewise = f". Likewise camera {', '.join(map(str, others))}" if others else ""
        warnings.warn(f"{source}, camera {i}: {doubts[i]}{likewise}", UserWarning, stacklevel=2)


def warn_of_camera(camera: OcamCamera, source: Path) -> None:
    """Warn of what `camera_doubt` finds."""
    with error_context(source):
        if doubt := camera_doubt(camera):
            warnings.warn(f"{source}: {doubt}", UserWarning, stacklevel=2)


def camera_doubt(camera: OcamCamera) -> str | None:
    """Return what is wrong with a principal point far from the middle of the image, with a guess.

    Raises an `OmnistereoError` if it lies outside.
    """
    size, center = np.array(camera.image_size), np.array(camera.center)

    def off_center(point: Floats, sides: Floats) -> float:
        return float(np.abs((point + 0.5) / sides - 0.5).max())

    off = off_center(center, size)
    if off <= _OFF_CENTER or _is_one_of_two(center, size):
        return None
    guesses = {
        "Width and height, or row and column, look swapped": off_center(center, size[::-1]),
        "The camera looks calibrated at half the size of the image": off_center(2 * center, size),
        "The camera looks calibrated at twice the size of the image": off_center(center / 2, size),
    }
    guess, error = min(guesses.items(), key=lambda item: item[1])
    doubt = (
        f"the principal point is ({center[0]:.1f}, {center[1]:.1f}) in an image of {size[0]} × "
        f"{size[1]} px; expected near its middle. "
        f"{guess if error < _CENTERED else 'Check that the image size is that of the calibration'}"
    )
    if off >= 0.5:
        raise OmnistereoError(doubt.replace("near its middle", "inside it, near the middle"))
    return doubt


def _is_one_of_two(center: Floats, size: Floats) -> bool:
    """Return whether a principal point is in the middle of one half of an image that two lenses
    share.
    """
    along, across = np.sort(np.abs((center + 0.5) / size - 0.5))[::-1]
    return bool(abs(along - 0.25) < _CENTERED and across < _CENTERED)


def level(rig: Rig, source: Path) -> Rig:
    """Return a rig whose +y points down.

    Where the y axes of the cameras agree, but lean from +y by more than 10°, the rig is turned: +y
    along their mean, +z along the horizontal direction of the first camera. `Rig.T_rig_file` states
    the turn. Where they disagree, only a rig whose centres lie in a plane that is not horizontal is
    warned of.
    """
    down, agree = _down(rig)
    angle = float(np.degrees(np.arccos(np.clip(down[1], -1, 1))))
    if agree and angle > _LEVEL_DEG:
        forward = rig.T_rig_cam[0].R[:, 2]
        if abs(forward @ down) > 0.995:  # it looks up or down: the top of its image
            forward = -rig.T_rig_cam[0].R[:, 1]
        right = np.cross(down, forward)
        right /= np.linalg.norm(right)
        R = np.stack([right, down, np.cross(right, down)])
        T = Pose(R, np.zeros(3))
        _log.info(
            "%s: the cameras agree that down is %.0f° from +y of the rig: the rig is turned "
            "level, by %.0f° in all, its first camera to the front (`omnistereo rig --keep-frame` "
            "or keep_frame=True leave it)",
            source,
            angle,
            T.magnitude()[0],
        )
        return rig.transformed(T)
    tilt = _plane_tilt_deg(rig)
    if agree:
        _log.info("%s: the rig is level to %.1f°", source, angle)
    elif tilt is not None and tilt > _LEVEL_DEG:
        warnings.warn(
            f"{source}: the cameras do not agree which way is down, and their centres lie in a "
            f"plane that is {tilt:.0f}° from horizontal: the panorama may lie on its side. Its +y "
            "should point down",
            UserWarning,
            stacklevel=2,
        )
    return rig


def _down(rig: Rig) -> tuple[Floats, bool]:
    """Return the mean y axis of the cameras but those mounted rolled, in the rig frame, and whether
    they agree.
    """
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


def _plane_tilt_deg(rig: Rig) -> float | None:
    """Return the angle between the plane of the camera centres and the horizontal; None if they
    span no plane.
    """
    _, spread, axes = np.linalg.svd(rig.centers - rig.centers.mean(0))
    if len(rig) < 3 or spread[1] < 0.1 * spread[0] or spread[2] > 0.3 * spread[1]:
        return None
    return float(np.degrees(np.arccos(min(1.0, abs(axes[2, 1])))))
