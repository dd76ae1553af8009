"""The mesh as an image: PyVista and the renderer of points agree on where things are."""

import sys

import numpy as np
import pytest

from course.figures.view3d import draw_mesh

RED, SIZE = (200, 30, 20), (120, 80)


@pytest.fixture
def square(tmp_path):
    """A red square one metre wide, three metres in front of the eye, that faces the rig."""
    corners = np.array([[-0.5, -0.5, 2], [0.5, -0.5, 2], [-0.5, 0.5, 2], [0.5, 0.5, 2]])
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.Trimesh(corners, [[0, 2, 1], [1, 2, 3]], vertex_colors=[RED] * 4, process=False)
    mesh.export(tmp_path / "square.ply")
    return tmp_path / "square.ply"


def middle(picture):
    rows, columns = np.nonzero((picture == RED).all(-1))
    return columns.mean(), rows.mean()


def test_a_mesh_is_where_its_points_are(square, monkeypatch):
    drawn = draw_mesh(square, (0.2, -0.3, -1.0), SIZE)
    monkeypatch.setattr(sys, "executable", "/bin/false")  # as where VTK crashes
    points = draw_mesh(square, (0.2, -0.3, -1.0), SIZE)
    assert drawn.shape == points.shape == (80, 120, 3)
    np.testing.assert_allclose(middle(drawn), middle(points), atol=2)
