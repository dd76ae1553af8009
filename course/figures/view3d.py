"""A mesh as an image, drawn by PyVista in a process of its own: without OpenGL VTK crashes, and
takes nobody along.
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

_SECONDS = 60  # a mesh takes two


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
    # Here, since it brings torch along, which the other process can do without.
    from omnistereo_tools.output.colors import BACKGROUND
    from omnistereo_tools.output.points import draw_points

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
    """Return the environment in which VTK renders without a display and without a warning about
    it.
    """
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
