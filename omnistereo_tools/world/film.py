"""A flight along the path through a world, as a film."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_tools.output.colors import BACKGROUND, ColorScale
from omnistereo_tools.output.pictures import FILM, compose, panes
from omnistereo_tools.output.render import (
    FOCAL,
    brighter,
    draw_triangles,
    looking,
    paint,
    view_rays,
)
from omnistereo_tools.world.page import PageView, panorama_with_far
from omnistereo_tools.world.surface import Surface, choose_views

RATE = Fraction(20)  # frames/s
_SPEED, _BEHIND, _TILT = 3.0, 3.0, 0.15  # m/s; metres from the rig; radians down


def flight(
    surface: Surface,
    poses: Mapping[int, Pose],
    views: Sequence[PageView],
    grid: SphereGrid,
    farthest: float,
) -> Iterator[NDArray[np.uint8]]:
    """Yield the frames, BGR: the surface seen from behind the rig, and what the nearest frame has
    seen; arguments as of `world_page`.
    """
    chosen = choose_views(surface, ((view.pose, view.refined) for view in views), grid)
    faces, plain = surface.faces, surface.color[surface.faces].mean(axis=1)
    panoramas = [panorama_with_far(view, farthest) for view in views]
    scale, size = ColorScale(0.0, 0.8 / grid.min_depth), (FILM[0], panes(grid)[0])
    for place, heading in _along(poses):
        eye = looking(place, heading, _TILT) @ np.array([0.0, 0.0, -_BEHIND])
        T, focal = looking(eye, heading, _TILT), FOCAL * size[0]
        shown, distance = draw_triangles(surface.vertices, faces, T, focal, size)
        rays = view_rays(T, focal, size)
        nearest = int(np.argmin([np.linalg.norm(view.pose.t - place) for view in views]))
        sky = paint(panoramas[nearest], grid, _turned(views[nearest].pose, rays)).astype(np.float32)
        opaque = (sky[..., 3:] - 128) / 120
        picture = np.float32(BACKGROUND) + opaque * (sky[..., :3] - BACKGROUND)
        hit = shown >= 0
        ends = (rays[hit] * distance[hit, None] + T.t).astype(np.float32)
        colors, of_view = np.empty((len(ends), 3), np.float32), chosen[shown[hit]]
        colors[:] = plain[shown[hit]]
        for k in np.unique(of_view[of_view >= 0]):
            some = of_view == k
            seen = _turned(views[k].pose, ends[some] - views[k].pose.t)
            colors[some] = paint(panoramas[k], grid, seen)[:, :3]
        picture[hit] = colors
        view = views[nearest]
        key, depth = "Striped: no depth, dark: not seen", scale.colorize(view.refined)
        note = f"frame {view.number}, with the depth of all frames. {key}"
        yield compose(brighter(picture), view.panorama, depth, scale, note)[..., ::-1]


def _turned(pose: Pose, rays: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return directions in the world as a frame has them."""
    return rays.astype(np.float32) @ pose.R.astype(np.float32)


def _along(poses: Mapping[int, Pose]) -> Iterator[tuple[NDArray[np.float64], float]]:
    """Yield place and heading along the path at an even speed."""
    places = np.stack([pose.t for pose in poses.values()])
    headings = np.unwrap([np.arctan2(pose.R[0, 2], pose.R[2, 2]) for pose in poses.values()])
    metres = np.append(0, np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1)))
    for at in np.arange(0, metres[-1], _SPEED / float(RATE)):
        place = [np.interp(at, metres, axis) for axis in places.T]
        yield np.array(place), float(np.interp(at, metres, headings))
