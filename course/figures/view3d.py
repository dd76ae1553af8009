"""Points and meshes as images. A mesh is drawn by PyVista in a process of its own: without OpenGL
VTK crashes, and takes nobody along.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.pictures import read_image
from omnistereo_tools.output.colors import BACKGROUND

_SECONDS = 60  # a mesh takes two
_NEAREST = 0.1  # metres in front of the eye
_LARGEST = 7  # px of a point: nearer ones would hide what is behind them


def draw_points(
    points: NDArray[Any],
    colors: NDArray[Any],
    size: tuple[int, int],
    eye: tuple[float, float, float],
) -> NDArray[np.uint8]:
    """Draw a point cloud (M, 3) in metres, rig frame.

    Args:
        colors: uint8 array, shape (M, 3), RGB
        size: (width, height) in pixels
        eye: Where it is seen from, towards the sweep centre, metres; not straight above.

    Returns:
        uint8 array, shape (height, width, 3), RGB
    """
    width, height = size
    picture = np.full((height, width, 3), BACKGROUND, np.uint8)
    if len(points) == 0:
        return picture
    # The axes of a camera that looks at the sweep centre: right, down, forward, as rows.
    place = np.array(eye)
    forward = -place / np.linalg.norm(place)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(forward, right), forward])
    x, y, z = axes @ (points - place).T
    order = np.argsort(-z)
    order = order[z[order] > _NEAREST]
    focal = 0.62 * width
    u, v = width / 2 + focal * x[order] / z[order], height / 2 + focal * y[order] / z[order]
    reach = np.linalg.norm(points[order], axis=-1) / z[order]
    spacing = 2 * np.pi / np.sqrt(8 * len(points))  # about the angle between rays
    sides = np.clip(np.ceil(focal * spacing * reach), 1, _LARGEST).astype(int)
    depth = np.full((height, width), np.inf)
    left, top, far = u - sides / 2, v - sides / 2, z[order]
    for row, column in np.ndindex(_LARGEST, _LARGEST):
        some = np.flatnonzero(sides > max(row, column))
        at_u = np.floor(left[some] + column).astype(int)
        at_v = np.floor(top[some] + row).astype(int)
        drawn = (at_u >= 0) & (at_u < width) & (at_v >= 0) & (at_v < height)
        drawn[drawn] = far[some[drawn]] < depth[at_v[drawn], at_u[drawn]]
        where = at_v[drawn], at_u[drawn]  # of several points the last, and so the nearest, stays
        picture[where], depth[where] = colors[order[some[drawn]]], far[some[drawn]]
    return picture


def draw_mesh(
    path: Path, eye: tuple[float, float, float], size: tuple[int, int]
) -> NDArray[np.uint8]:
    """Draw a PLY mesh with coloured vertices; where PyVista cannot, its vertices as points.

    Args:
        path: As `write_mesh` writes it: metres, rig frame.
        eye: Where it is seen from, towards the sweep centre, metres.
        size: (width, height), pixels

    Returns:
        uint8 array, shape (height, width, 3), RGB
    """
    with tempfile.TemporaryDirectory() as folder:
        picture = Path(folder) / "mesh.png"
        command = [sys.executable, "-m", "course.figures.view3d", str(path), str(picture)]
        command += map(str, (*eye, *size, BACKGROUND))
        try:
            subprocess.run(
                command,
                env=_headless(),
                cwd=Path(__file__).parents[2],
                check=True,
                timeout=_SECONDS,
                capture_output=True,
            )
            return read_image(picture)
        except (subprocess.SubprocessError, OSError):
            import trimesh

            mesh: Any = trimesh.load(path, process=False)
            return draw_points(mesh.vertices, mesh.visual.vertex_colors[:, :3], size, eye)


def _headless() -> dict[str, str]:
    """Return the environment in which VTK renders without a display, silently."""
    if sys.platform == "linux" and "DISPLAY" not in os.environ:
        return {**os.environ, "VTK_DEFAULT_OPENGL_WINDOW": "vtkEGLRenderWindow"}
    return dict(os.environ)


def _draw(
    path: str, picture: str, eye: tuple[float, ...], size: tuple[int, ...], background: int
) -> None:
    import pyvista

    plotter = pyvista.Plotter(off_screen=True, window_size=list(size))
    plotter.background_color = pyvista.Color((background,) * 3)
    plotter.add_mesh(pyvista.read(path), scalars="RGBA", rgb=True, lighting=False, culling="back")
    # y points down in the rig frame
    plotter.camera_position = [eye, (0.0, 0.0, 0.0), (0.0, -1.0, 0.0)]
    # as `draw_points`
    plotter.camera.view_angle = 2 * np.degrees(np.arctan(size[1] / 2 / (0.62 * size[0])))
    plotter.screenshot(picture)


if __name__ == "__main__":
    mesh, target, *numbers = sys.argv[1:]
    _draw(
        mesh, target, tuple(map(float, numbers[:3])), tuple(map(int, numbers[3:5])), int(numbers[5])
    )
