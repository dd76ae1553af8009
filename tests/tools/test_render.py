"""Surfaces drawn by the processor, against the box that they are of."""

import numpy as np
import pytest
import scene

import omnistereo_lib as osl
from omnistereo_tools.output.colors import BACKGROUND
from omnistereo_tools.output.render import (
    around,
    draw_surfaces,
    draw_triangles,
    looking,
    paint,
    view_rays,
)

GRID = osl.SphereGrid(160, 80, (-90.0, 90.0), num_spheres=64, min_depth=0.6)
SIZE, FOCAL = (90, 60), 50.0


@pytest.fixture(scope="module")
def depth():
    return scene.true_depth(scene.rig(width=200, height=192), GRID)


def directions():
    """A panorama whose colours are the columns and the rows."""
    row, column = np.indices((160, 320))
    return np.stack([column * 255 // 319, row * 255 // 159, 0 * row], -1).astype(np.uint8)


def test_the_nearest_triangle_is_drawn_and_none_from_behind():
    near = np.array([[-1.0, -1, 2], [1, -1, 2], [0, 1, 2]])
    vertices = np.concatenate([near, near * [2, 2, 3]])
    towards = np.array([[0, 2, 1], [3, 5, 4]])
    for faces in (towards, towards[::-1]):
        shown, distance = draw_triangles(vertices, faces, osl.Pose.identity(), FOCAL, SIZE)
        assert distance[30, 45] == pytest.approx(2) and (faces[shown[30, 45]] < 3).all()
    assert (
        draw_triangles(vertices, towards[:, ::-1], osl.Pose.identity(), FOCAL, SIZE)[0] < 0
    ).all()


def test_perspective_is_right_across_a_slanted_triangle():
    vertices = np.array([[-4.0, 1, 1], [4, 1, 1], [0, 1, 60]])  # the ground, 1 m below
    _, distance = draw_triangles(vertices, np.array([[0, 1, 2]]), osl.Pose.identity(), FOCAL, SIZE)
    down = view_rays(osl.Pose.identity(), FOCAL, SIZE)[..., 1]
    hit = np.isfinite(distance)
    assert hit.sum() > 500
    np.testing.assert_allclose(distance[hit], 1 / down[hit], rtol=1e-3)


def test_from_elsewhere_each_ray_ends_at_the_wall_and_has_its_colour(depth):
    T = looking(np.array([0.3, -0.2, 0.1]), 0.7, -0.2)
    rays = view_rays(T, 0.55 * SIZE[0], SIZE)
    forward = T.R @ [0, 0, 1]
    np.testing.assert_allclose(
        forward, [np.cos(-0.2) * np.sin(0.7), np.sin(-0.2), np.cos(-0.2) * np.cos(0.7)]
    )
    ends = T.t + rays * scene.distance(T.t, rays / np.linalg.norm(rays, axis=-1, keepdims=True))[
        ..., None
    ] / np.linalg.norm(rays, axis=-1, keepdims=True)
    expected = 255 * (paint(directions(), GRID, ends.astype(np.float32)) / 255) ** 0.8
    drawn = draw_surfaces(depth, directions(), np.zeros(GRID.shape), T, SIZE)
    off = np.abs(drawn.astype(float) - expected).max(-1)
    assert np.median(off) < 3 and (off < 12).mean() > 0.97


def test_the_sky_is_seen_and_what_no_camera_sees_is_dark(depth):
    index = depth.index.copy()
    index[:40] = 0
    open_sky = osl.Depth(index, depth.confidence, depth.sweep)
    white = np.full((160, 320, 3), 255, np.uint8)
    up = looking(np.zeros(3), 0.0, -0.8)
    assert (draw_surfaces(open_sky, white, np.zeros(GRID.shape), up, SIZE)[:20] == 255).all()
    # from behind a wall, which is not drawn, down to the ground that it hides
    beyond = around(40.0, 0.0, 0.9)
    drawn = draw_surfaces(open_sky, white, np.zeros(GRID.shape), beyond, SIZE)
    assert (drawn[-1] == BACKGROUND).all() and (drawn == 255).any()
