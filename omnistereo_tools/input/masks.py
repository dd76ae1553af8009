"""Masks of the cameras: from files, or by the image circle."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.consumer_images import DARK
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.pictures import read_gray
from omnistereo_tools.judge.coverage import Coverage

_NAME = "mask.png"  # beside the images of a camera
FRAMES = 5  # of a recording, over which the brightest value of each pixel is taken
_SIDE = 800  # px; larger images are reduced
_BLACK = 24  # gray value; the corners of an image with a brighter darkest hundredth are not black
_LIT = 0.1  # of the way from black to the median of the lit pixels; vignetting ends above it
_RUN = 4  # px that are lit in a row: less is noise or a reflection
_LEAST_SHARE = 0.3  # of the directions that show the edge of the circle inside the image
# of the radius, median distance of the edge from a circle; a dark floor is less round
_ROUND = 0.015
_OFF_CENTER = 0.2  # of the radius, from the principal point
_INSIDE_DEG = 3.0  # from the end of the stated field of view; less is blur
_SHRINK = 0.99  # of the radius: the edge itself is blurred


def with_masks(rig: Rig, images: Sequence[Path]) -> Rig:
    """Return the rig with masks from files: mask.png in the folder of the images of a camera,
    bright where the image is valid, if each camera has a folder of its own.

    Args:
        rig: Cameras of which the rig file has a mask keep it.
        images: One path per camera; its folder is where mask.png is looked for.

    Raises:
        OmnistereoError: If a mask cannot be read, has another size or hides all.
    """
    folders = [path if path.is_dir() else path.parent for path in images]
    if len(set(folders)) < len(rig) or len(folders) != len(rig):
        return rig
    cameras = []
    for camera, folder in zip(rig.cameras, folders, strict=True):
        path = folder / _NAME
        if camera.mask is None and path.is_file():
            camera = replace(camera, mask=read_gray(path, camera.image_size) >= 128)
            if not camera.visible_pixels().any():
                raise OmnistereoError(
                    f"{path} hides the whole image; expected bright where it is valid. Invert it."
                )
        cameras.append(camera)
    return replace(rig, cameras=tuple(cameras))


def black_cameras(images: Sequence[NDArray[Any]]) -> str | None:
    """Return in words which cameras of a frame show nothing, if any; every 16th pixel is read."""
    found = [k for k, image in enumerate(images, 1) if np.quantile(image[::4, ::4], 0.99) < DARK]
    many = len(found) > 1
    said = f"camera{'s' * many} {' and '.join(map(str, found))} show{'s' * (not many)} black"
    return said if found else None


@dataclass(frozen=True)
class ImageCircle:
    """The circle that a lens lights on its sensor."""

    center: tuple[float, float]  #: (u, v), px
    radius: float  #: px

    def mask(self, image_size: tuple[int, int]) -> NDArray[np.bool_]:
        """Return which pixels lie inside, but for the blurred edge, shape (height, width)."""
        u, v = np.meshgrid(np.arange(image_size[0]), np.arange(image_size[1]))
        return np.hypot(u - self.center[0], v - self.center[1]) <= _SHRINK * self.radius


def measure_circle(
    images: Sequence[NDArray[np.uint8]], center: tuple[float, float]
) -> ImageCircle | None:
    """Return the image circle of one camera, or None if its images do not show one.

    Args:
        images: One or more of the camera, of one size; the more, the fewer dark things look like
            its edge.
        center: About the centre of the circle (u, v), px, such as the principal point.
    """
    lit = np.max([image if image.ndim == 2 else image.max(-1) for image in images], axis=0)
    scale = min(1.0, _SIDE / max(lit.shape))
    if scale < 1:
        lit = cv2.resize(lit, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    black = float(np.quantile(lit, 0.01))
    if black > _BLACK:
        return None
    bright = lit[lit > black + 2]
    threshold = black + _LIT * (float(np.median(bright)) - black) if bright.size else 255
    edge = _edge_points(lit > threshold, (np.array(center) + 0.5) * scale - 0.5)
    if len(edge) < _LEAST_SHARE * 360:
        return None
    middle, radius = _fit_circle(edge)
    is_round = np.median(np.abs(np.linalg.norm(edge - middle, axis=1) - radius)) <= _ROUND * radius
    u, v = (middle + 0.5) / scale - 0.5
    if not is_round or np.hypot(u - center[0], v - center[1]) > _OFF_CENTER * radius / scale:
        return None
    return ImageCircle((float(u), float(v)), radius / scale)


def _edge_points(lit: NDArray[np.bool_], center: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the outermost lit pixel in each of 360 directions that end black, (N, 2)."""
    height, width = lit.shape
    azimuth, radii = np.radians(np.arange(360)), np.arange(float(np.hypot(height, width)))
    u = center[0] + np.cos(azimuth)[:, None] * radii
    v = center[1] + np.sin(azimuth)[:, None] * radii
    inside = (u >= 0) & (u <= width - 1) & (v >= 0) & (v <= height - 1)
    values = (
        inside
        & lit[v.round().astype(int).clip(0, height - 1), u.round().astype(int).clip(0, width - 1)]
    )
    run = np.all(np.lib.stride_tricks.sliding_window_view(values, _RUN, axis=1), axis=-1)
    # outermost end of a lit run
    last = run.shape[1] - 1 - np.argmax(run[:, ::-1], axis=1) + _RUN - 1
    found = run.any(1) & (last < inside.sum(1) - _RUN)
    return np.column_stack([u[found, last[found]], v[found, last[found]]])


def _fit_circle(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Return centre and radius by least squares, without points beyond three median distances."""
    kept = np.ones(len(points), bool)
    for _ in range(5):
        x, y = points[kept].T
        solution = np.linalg.lstsq(
            np.column_stack([2 * x, 2 * y, np.ones(len(x))]), x * x + y * y, rcond=None
        )[0]
        middle = solution[:2]
        radius = float(np.sqrt(max(solution[2] + middle @ middle, 0.0)))
        off = np.abs(np.linalg.norm(points - middle, axis=1) - radius)
        kept = off <= 3 * np.median(off) + 0.5
    return middle, radius


def seen_fov_deg(camera: OcamCamera, circle: ImageCircle) -> float:
    """Return the full field of view inside an image circle, degrees, at most the camera's."""
    azimuth = np.radians(np.arange(0, 360, 5))
    outward = np.stack([np.cos(azimuth), np.sin(azimuth)], -1)
    edge = np.array(circle.center) + circle.radius * outward
    width, height = camera.image_size
    inside = ((edge >= 0) & (edge <= (width - 1, height - 1))).all(-1)
    rays, valid = camera.unproject(edge)
    angle = np.degrees(np.arccos(rays[..., 2].clip(-1, 1)))
    if not inside.any():
        return camera.max_fov_deg
    return 2 * float(np.median(np.where(valid, angle, camera.max_fov_deg / 2)[inside]))


def with_circles(rig: Rig, images: Sequence[Sequence[NDArray[np.uint8]]]) -> tuple[Rig, str | None]:
    """Return the rig with the image circles as masks where there are none, and what that changes,
    in a sentence.

    Args:
        images: images[frame][camera]
    """
    cameras, seen = list(rig.cameras), {}
    for k, camera in enumerate(rig.cameras):
        if camera.mask is not None:
            continue
        circle = measure_circle([frame[k] for frame in images], camera.center)
        if circle is None:
            continue
        fov = seen_fov_deg(camera, circle)
        if fov < camera.max_fov_deg - 2 * _INSIDE_DEG:
            seen[k] = fov
            cameras[k] = replace(camera, mask=circle.mask(camera.image_size))
    if not seen:
        return rig, None
    masked = replace(rig, cameras=tuple(cameras))
    before, after = (f"{100 * Coverage.of(each, 180).share(2):.0f} %" for each in (rig, masked))
    numbers = ", ".join(str(k + 1) for k in seen)
    fields = f"{min(seen.values()):.0f}°"
    loss = "" if after == before else f": two cameras see {after} of the sphere, not {before}"
    return masked, (
        f"the images of camera {numbers} are black beyond {fields} of the"
        f" {rig.cameras[min(seen)].max_fov_deg:.0f}° stated{loss}. The image circle is taken as"
        f" mask; `omnistereo rig --max-fov {np.floor(min(seen.values())):.0f}` states it"
    )
