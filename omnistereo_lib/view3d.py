"""Point clouds: pictures of them by PyVista, or by Matplotlib where there is no OpenGL, and PLY files."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.doctor import headless, opengl_works
from omnistereo_lib.files import replacing

_BACKGROUND = "#202020"  # colours stand out, and gaps between points do not dazzle
_UP = (0.0, -1.0, 0.0)  # y points down in the rig frame


def draw_points(
    points: NDArray, colors: NDArray, eye: tuple[float, float, float], size: tuple[int, int] = (900, 500)
) -> NDArray[np.uint8]:
    """Draw a point cloud as a picture.

    Parameters
    ----------
    points : array, shape (M, 3), metres, rig frame
    colors : uint8 array, shape (M, 3), RGB
    eye : (x, y, z)
        Where it is looked at from, metres, rig frame; towards the sweep centre.
    size : (width, height), pixels

    Returns
    -------
    uint8 array, shape (height, width, 3), RGB
    """
    if len(points) == 0:
        return np.full((size[1], size[0], 3), 0x20, np.uint8)  # PyVista refuses to draw nothing
    return _draw_pyvista(points, colors, eye, size) if _has_opengl() else _draw_matplotlib(points, colors, eye, size)


def write_ply(path: str | Path, points: NDArray, colors: NDArray | None = None) -> None:
    """Write a point cloud (M, 3) in metres, with uint8 RGB colours (M, 3) if given, as binary PLY."""
    import pyvista

    colors = colors if len(points) else None  # PyVista refuses colours of nothing
    with replacing(path) as temporary:
        pyvista.PolyData(points.astype(np.float32)).save(temporary, texture=colors)


@cache
def _has_opengl() -> bool:
    return opengl_works()


def _draw_pyvista(points: NDArray, colors: NDArray, eye: tuple, size: tuple[int, int]) -> NDArray[np.uint8]:
    os.environ.update(headless())
    import pyvista

    plotter = pyvista.Plotter(off_screen=True, window_size=size)
    plotter.background_color = _BACKGROUND
    plotter.add_points(points.astype(np.float32), scalars=colors, rgb=True, point_size=5)
    plotter.camera_position = [eye, (0.0, 0.0, 0.0), _UP]
    picture = plotter.screenshot(return_img=True)
    plotter.close()
    return picture


def _draw_matplotlib(points: NDArray, colors: NDArray, eye: tuple, size: tuple[int, int]) -> NDArray[np.uint8]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    some = np.random.default_rng(0).permutation(len(points))[:30_000]  # more only takes longer
    figure = Figure(figsize=(size[0] / 100, size[1] / 100), dpi=100, facecolor=_BACKGROUND)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1), projection="3d")
    x, y, z = points[some].T
    axes.scatter(x, z, -y, c=colors[some] / 255.0, s=1)  # Matplotlib's up is its third axis
    distance = float(np.linalg.norm(eye))
    axes.view_init(elev=np.degrees(np.arcsin(-eye[1] / distance)), azim=np.degrees(np.arctan2(eye[2], eye[0])))
    axes.set_axis_off()
    axes.patch.set_facecolor(_BACKGROUND)
    axes.set_aspect("equal")
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()
