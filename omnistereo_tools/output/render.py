"""Surfaces seen from anywhere, drawn by the processor: for films, the live view and overviews."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.depth import Depth
from omnistereo_lib.stereo.kernels.compiled import compiled
from omnistereo_tools.output.colors import BACKGROUND
from omnistereo_tools.output.mesh_export import surfaces
from omnistereo_tools.output.points import Limits

FOCAL = 0.55  # of the width of a view
_NEAREST = 0.05  # metres before the eye: triangles that reach nearer are left out
_BRIGHTER = 0.8  # power: shadows are dark
_FADE = 0.6  # of what is doubtful
_ROW = 512


def draw_surfaces(
    depth: Depth,
    panorama: NDArray[np.uint8],
    doubts: NDArray[Any],
    T_rig_view: Pose,
    size: tuple[int, int],
) -> NDArray[np.uint8]:
    """Draw the surfaces of a frame as seen from anywhere, before its sky; doubtful ones fade.

    Args:
        panorama: uint8 array, any size, RGB
        doubts: (H, W), 0 to 1
        size: (width, height), pixels

    Returns:
        uint8 array, shape (height, width, 3), RGB
    """
    limits, focal = Limits.of(depth), FOCAL * size[0]
    shown, distance = draw_triangles(*surfaces(depth, limits), T_rig_view, focal, size)
    rays, hit = view_rays(T_rig_view, focal, size), shown >= 0
    ends = rays.copy()  # the sky is so far that it is seen in the same direction from everywhere
    ends[hit] = rays[hit] * distance[hit, None] + T_rig_view.t.astype(np.float32)
    height, width = panorama.shape[:2]
    clouded = cv2.resize(doubts.astype(np.float32), (width, height))
    far = (depth.depth > limits.max_depth).astype(np.float32)
    colors = brighter(paint(panorama, depth.grid, ends, np.float32))
    hidden = np.empty_like(distance)
    hidden[hit] = np.float32(_FADE) * paint(clouded, depth.grid, ends[hit])
    hidden[~hit] = 1 - paint(far, depth.grid, rays[~hit])
    return np.asarray(colors + hidden[..., None] * (np.float32(BACKGROUND) - colors), np.uint8)


def brighter(colors: NDArray[Any]) -> NDArray[np.uint8]:
    """Return colours from 0 to 255 with their shadows lifted, as the page of a world shows them."""
    return np.asarray(255 * (colors / 255).clip(0, 1) ** np.float32(_BRIGHTER), np.uint8)


def around(distance: float, yaw: float, pitch: float) -> Pose:
    """Return the pose T_rig_view of a view from so many metres behind and above the rig, past it.

    It looks down by half as much as the rig lies below it, so that the horizon is in view.
    """
    eye = looking(np.zeros(3), yaw, pitch) @ np.array([0, 0, -distance])
    return looking(eye, yaw, pitch / 2)


def looking(eye: NDArray[Any], yaw: float, pitch: float) -> Pose:
    """Return the pose T_world_view of a view at a place, turned to the right by `yaw` from
    forward and then down by `pitch`, radians.
    """
    (s, c), (t, u) = ((np.sin(angle), np.cos(angle)) for angle in (yaw, pitch))
    right, down, ahead = (c, 0.0, -s), (-t * s, u, -t * c), (u * s, t, u * c)
    return Pose(np.stack([right, down, ahead], -1), np.asarray(eye, np.float64))


def draw_triangles(
    vertices: NDArray[Any],
    faces: NDArray[np.integer[Any]],
    T_world_view: Pose,
    focal: float,
    size: tuple[int, int],
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Return which triangle each pixel shows, and its distance along the axis.

    Triangles that are seen from behind are left out, so that no wall hides what is in front of it.

    Args:
        vertices: (V, 3), metres.
        faces: (F, 3), counter-clockwise as seen from where the surface is.
        focal: Pixels for one radian, in the middle.
        size: (width, height), pixels

    Returns:
        number of the triangle, -1 where there is none, and distance, infinite there: (height,
        width) each
    """
    width, height = size
    seen = (vertices - T_world_view.t) @ T_world_view.R
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = np.where(seen[:, 2] > _NEAREST, 1 / seen[:, 2], 0)
    corners = focal * seen[:, :2] * inverse[:, None] + [(width - 1) / 2, (height - 1) / 2]
    placed = np.column_stack([corners, inverse]).astype(np.float32)
    shown, nearness = np.full((height, width), -1, np.int32), np.zeros((height, width), np.float32)
    _fill(placed, np.ascontiguousarray(faces), shown, nearness)
    with np.errstate(divide="ignore"):
        return shown, np.float32(1) / nearness


@compiled(nogil=True, error_model="numpy")
def _fill(
    corners: NDArray[np.float32],
    faces: NDArray[Any],
    shown: NDArray[np.int32],
    nearness: NDArray[np.float32],
) -> None:
    """Draw triangles whose corners are (column, row, inverse distance), 0 behind the eye."""
    height, width = shown.shape
    for number in range(len(faces)):
        a, b, c = corners[faces[number, 0]], corners[faces[number, 1]], corners[faces[number, 2]]
        if min(a[2], b[2], c[2]) <= 0:
            continue
        area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
        if area >= 0:
            continue
        left, right = max(0.0, min(a[0], b[0], c[0])), min(width - 1.0, max(a[0], b[0], c[0]))
        top, bottom = max(0.0, min(a[1], b[1], c[1])), min(height - 1.0, max(a[1], b[1], c[1]))
        for row in range(int(np.ceil(top)), int(np.floor(bottom)) + 1):
            for column in range(int(np.ceil(left)), int(np.floor(right)) + 1):
                p = ((b[0] - column) * (c[1] - row) - (c[0] - column) * (b[1] - row)) / area
                q = ((c[0] - column) * (a[1] - row) - (a[0] - column) * (c[1] - row)) / area
                # Neighbours overlap by a hair, so that nothing shines through between them.
                if min(p, q, 1 - p - q) < -1e-4:
                    continue
                near = p * a[2] + q * b[2] + (1 - p - q) * c[2]
                if near > nearness[row, column]:
                    nearness[row, column], shown[row, column] = near, number


def view_rays(T_world_view: Pose, focal: float, size: tuple[int, int]) -> NDArray[np.float32]:
    """Return the directions of all pixels, (height, width, 3) in the world, 1 along the axis."""
    (width, height), axes = size, T_world_view.R.astype(np.float32)
    right = (np.arange(width, dtype=np.float32) - (width - 1) / 2) / np.float32(focal)
    down = (np.arange(height, dtype=np.float32) - (height - 1) / 2) / np.float32(focal)
    return right[:, None] * axes[:, 0] + (down[:, None] * axes[:, 1] + axes[:, 2])[:, None]


def paint(
    panorama: NDArray[Any], grid: SphereGrid, rays: NDArray[np.float32], dtype: Any = None
) -> NDArray[Any]:
    """Return what a panorama of any size, (h, w) or (h, w, C), shows along rays (..., 3), in its
    type or another.
    """
    height, width = panorama.shape[:2]
    low, high = np.radians(grid.phi_deg).astype(np.float32)
    x, y, z = rays.reshape(-1, 3).T
    column = (np.arctan2(x, z) / np.float32(2 * np.pi) + np.float32(0.5)) * width + np.float32(0.5)
    row = (np.arctan2(y, np.hypot(x, z)) - low) * (height / (high - low)) - np.float32(0.5)
    # In rows of some length, since OpenCV takes none of more than 32767.
    count, missing = len(column), _ROW - len(column) % _ROW
    places = column, row.clip(0, height - 1)
    columns, rows = (np.pad(one, (0, missing)).reshape(-1, _ROW) for one in places)
    # A channel at a time: a panorama in float32 with its copy would take 0.2 GB.
    channels = []
    for plane in np.moveaxis(panorama.reshape(height, width, -1), -1, 0):
        wrapped = np.concatenate([plane[:, -1:], plane, plane[:, :1]], 1, dtype=dtype)
        seen = cv2.remap(wrapped, columns, rows, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
        channels.append(seen.ravel()[:count])
    return np.stack(channels, -1).reshape(*rays.shape[:-1], *panorama.shape[2:])
