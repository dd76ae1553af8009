"""Point clouds: to turn in a notebook, and as pictures, drawn by PyVista, or by NumPy where there is no OpenGL."""

from __future__ import annotations

import html
import os
from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from course import stills
from course.doctor import headless, opengl_works
from omnistereo_lib.stereo.depth import Depth
from omnistereo_tools.pictures import sharp_panorama
from omnistereo_tools.points import Limits
from omnistereo_tools.viewer import page_of, viewer_data

_BACKGROUND = 0x20  # colours stand out, and gaps between points do not dazzle
_POINT_SIZE = 5  # pixels
_UP = (0.0, -1.0, 0.0)  # y points down in the rig frame
_VIEW_DEG = 30.0  # PyVista's angle of view, from top to bottom
_NEAREST = 0.1  # metres in front of the eye
_SHARP = 1280  # px, width of the panorama that is looked around in


def draw_points(
    points: NDArray, colors: NDArray, eye: tuple[float, float, float], size: tuple[int, int] = (900, 500)
) -> NDArray[np.uint8]:
    """Draw a point cloud as a picture.

    Args:
        points: array, shape (M, 3), metres, rig frame
        colors: uint8 array, shape (M, 3), RGB
        eye: Where it is looked at from, metres, rig frame; towards the sweep centre.
        size: (width, height), pixels

    Returns:
        uint8 array, shape (height, width, 3), RGB
    """
    if len(points) == 0:
        return np.full((size[1], size[0], 3), _BACKGROUND, np.uint8)  # PyVista refuses to draw nothing
    return _draw_pyvista(points, colors, eye, size) if _has_opengl() else _draw_numpy(points, colors, eye, size)


def explore(depth: Depth, images: Sequence[ArrayLike], max_depth: float, min_confidence: float = 0.0) -> None:
    """Show a depth panorama in a notebook: its points to turn, tilt and zoom, its picture to look around in.

    Notebooks are stored without it: the captioned figure before it says what it shows.

    Args:
        images: What the cameras saw, as for `Depth.panorama`.
        max_depth, min_confidence: Rays up to so many metres, and from that confidence on, become points.
    """
    from IPython.display import display
    from ipywidgets import HTML

    panorama = sharp_panorama(depth, images, _SHARP)
    data = viewer_data(depth, panorama, Limits(max_depth, min_confidence), "Drag to turn and tilt", mode="points")
    if stills.recording():
        return stills.record_view(data)
    page = html.escape(page_of(data))
    display(HTML(f'<iframe srcdoc="{page}" title="{stills.VIEW}" style="width: 100%; height: 800px"></iframe>'))


@cache
def _has_opengl() -> bool:
    return opengl_works()


def _draw_pyvista(points: NDArray, colors: NDArray, eye: tuple, size: tuple[int, int]) -> NDArray[np.uint8]:
    os.environ.update(headless())
    import pyvista

    plotter = pyvista.Plotter(off_screen=True, window_size=size)
    plotter.background_color = [_BACKGROUND] * 3
    plotter.add_points(points.astype(np.float32), scalars=colors, rgb=True, point_size=_POINT_SIZE)
    plotter.camera_position = [eye, (0.0, 0.0, 0.0), _UP]
    picture = plotter.screenshot(return_img=True)
    plotter.close()
    return picture


def _draw_numpy(points: NDArray, colors: NDArray, eye: tuple, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Project the points by a pinhole from where PyVista would look, and paint them as squares, the far ones first."""
    width, height = size
    forward = -np.asarray(eye) / np.linalg.norm(eye)
    right = np.cross(forward, _UP if abs(forward[1]) < 0.999 else (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    x, y, z = np.stack([right, np.cross(forward, right), forward]) @ (points - eye).T
    order = np.argsort(-z)
    order = order[z[order] > _NEAREST]
    focal = height / 2 / np.tan(np.radians(_VIEW_DEG / 2))
    square = np.arange(_POINT_SIZE) - _POINT_SIZE // 2
    u = np.floor(width / 2 + focal * x[order] / z[order]).astype(int)[:, None, None] + square
    v = np.floor(height / 2 + focal * y[order] / z[order]).astype(int)[:, None, None] + square[:, None]
    u, v = np.broadcast_arrays(u, v)
    seen = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    picture = np.full((height, width, 3), _BACKGROUND, np.uint8)
    picture[v[seen], u[seen]] = np.broadcast_to(colors[order][:, None, None], (*u.shape, 3))[seen]  # the last one stays
    return picture
