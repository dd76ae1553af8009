"""Pictures of point clouds, with and without OpenGL."""

import numpy as np
import pytest

from course import view3d

RNG = np.random.default_rng(0)
POINTS = RNG.uniform(-2, 2, (500, 3))
COLORS = RNG.integers(0, 256, (500, 3), np.uint8)


@pytest.fixture(params=[True, False], ids=["PyVista", "NumPy"])
def drawer(request, monkeypatch):
    """Both ways to draw; the first only where there is OpenGL."""
    if request.param and not view3d._has_opengl():
        pytest.skip("no OpenGL here")
    monkeypatch.setattr(view3d, "_has_opengl", lambda: request.param)


def cloud(center, color):
    return RNG.normal(center, 0.1, (300, 3)), np.tile(np.uint8(color), (300, 1))


def test_a_picture_has_its_size_and_colours_and_down_is_down(drawer):
    """Red 1 m down (+y), green 1 m to the right (+x), seen from behind: y points down in the rig frame."""
    red, green = cloud((0, 1, 0), (255, 0, 0)), cloud((1, 0, 0), (0, 255, 0))
    points, colors = (np.concatenate(both) for both in zip(red, green, strict=True))
    picture = view3d.draw_points(points, colors, eye=(0, 0, -4), size=(300, 200)).astype(int)
    assert picture.shape == (200, 300, 3)
    saturated = [(picture[..., c] - picture.sum(-1) + picture[..., c] > 100).nonzero() for c in (0, 1)]
    (red_rows, red_columns), (green_rows, green_columns) = saturated
    assert len(red_rows) > 20 and len(green_rows) > 20
    assert red_rows.mean() > green_rows.mean() + 20
    assert green_columns.mean() > red_columns.mean() + 20
    assert (picture[:10] == 32).all()  # dark around it


def test_an_empty_cloud_is_an_empty_picture(drawer):
    picture = view3d.draw_points(POINTS[:0], COLORS[:0], eye=(0, -2, -4), size=(60, 40))
    assert picture.shape == (40, 60, 3) and (picture == 32).all()


@pytest.mark.parametrize("eye", [(0, -1, -6), (5, -3, 2), (-4, 2, 4)])
def test_without_opengl_the_picture_is_the_same(monkeypatch, eye):
    """A red, a green and a blue cloud lie at the same pixels, whoever draws them, and as many of them are seen."""
    if not view3d._has_opengl():
        pytest.skip("no OpenGL here")
    clouds = [cloud(center, 255 * np.eye(3)[k]) for k, center in enumerate([(1, 0, 0.5), (-1, 0.5, 0), (0, -0.6, 1)])]
    points, colors = (np.concatenate(each) for each in zip(*clouds, strict=True))
    seen = []
    for opengl in (True, False):
        monkeypatch.setattr(view3d, "_has_opengl", lambda opengl=opengl: opengl)
        picture = view3d.draw_points(points, colors, eye, size=(300, 200)).astype(int)
        places = [np.argwhere(2 * picture[..., c] - picture.sum(-1) > 100) for c in range(3)]
        seen.append([(*place.mean(axis=0), len(place) ** 0.5) for place in places])
    np.testing.assert_allclose(seen[1], seen[0], atol=1.5)


def test_from_straight_above(monkeypatch):
    """The world's z points up in the picture: red 1 m ahead (+z), green 1 m to the right (+x)."""
    monkeypatch.setattr(view3d, "_has_opengl", lambda: False)
    red, green = cloud((0, 0, 1), (255, 0, 0)), cloud((1, 0, 0), (0, 255, 0))
    points, colors = (np.concatenate(both) for both in zip(red, green, strict=True))
    picture = view3d.draw_points(points, colors, eye=(0, -4, 0), size=(200, 200))
    rows, columns = (picture[..., 0] == 255).nonzero()
    assert rows.mean() < 80 and 90 < columns.mean() < 110
    rows, columns = (picture[..., 1] == 255).nonzero()
    assert 90 < rows.mean() < 110 and columns.mean() > 120


def test_points_behind_the_eye_are_not_drawn(monkeypatch):
    monkeypatch.setattr(view3d, "_has_opengl", lambda: False)
    points, colors = cloud((0, 0, -8), (255, 0, 0))
    assert (view3d.draw_points(points, colors, eye=(0, 0, -4), size=(60, 40)) == 32).all()
