"""Notebook 13, the one page: the lens, the warp, the cost volume, and points from depth."""

from dataclasses import replace

import numpy as np

from course.exercises import beside
from course.exercises.compare import Answer, Array, Rng
from course.exercises.nb03 import look_up
from course.exercises.nb04 import mean_of_pairs, zncc_costs
from course.exercises.opened import Open
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose


def project(camera, points):
    """Pixels (…, 2) of points (…, 3) in the camera's frame; NaN where the camera does not see them."""
    x, y, z = np.moveaxis(points, -1, 0)
    across = np.hypot(x, y)
    t = np.arctan2(-z, across)  # the angle from the axis, less 90°
    r = np.polyval(camera.inv_poly[::-1], t)  # pixels from the centre
    x, y = r * x / across, r * y / across
    c, d, e = camera.affine
    u, v = x + e * y + camera.center[0], d * x + c * y + camera.center[1]
    width, height = camera.image_size
    inside = (u >= 0) & (v >= 0) & (u <= width - 1) & (v <= height - 1)
    visible = inside & (t <= np.radians(camera.max_fov_deg / 2 - 90))
    return np.where(visible[..., None], np.stack([u, v], axis=-1), np.nan)


def _camera() -> OcamCamera:
    inverse = [210.0, 160.0, 15.0, -9.0]
    return OcamCamera([-200.0, 0.0, 1e-3], inverse, (400.0, 380.0), (1.02, 0.01, -0.02), (800, 768), 200.0)


def _in_camera(rng: Rng, k: int) -> tuple:
    points = rng.normal(0, 1, (4, 5 + k % 3, 3))
    points[0] *= [1, 1, 0.1]  # at the edge of the field of view, and of the image
    return _camera(), points


check_project = Open(
    project,
    _in_camera,
    [
        (lambda camera, p: project(camera, p * [1, 1, -1]), "t is the angle below the xy-plane: arctan2(-z, …)"),
        (
            lambda camera, p: project(replace(camera, inv_poly=camera.inv_poly[::-1]), p),
            "np.polyval wants the highest power first",
        ),
        (lambda camera, p: project(replace(camera, affine=(1.0, 0.0, 0.0)), p), "the affine map c, d, e is missing"),
        (lambda camera, p: project(replace(camera, affine=(1.02, -0.02, 0.01)), p), "d and e are swapped: u = x + e y"),
        (lambda camera, p: project(camera, p) - camera.center, "pixels do not count from the centre: add it"),
        (
            lambda camera, p: project(replace(camera, center=camera.center[::-1]), p),
            "the centre is (u, v): its parts are swapped",
        ),
        (
            lambda camera, p: project(replace(camera, max_fov_deg=359.0), p),
            "a point outside the field of view has no pixel: t is at most half of it, less 90°",
        ),
        (lambda *inputs: np.nan_to_num(project(*inputs)), "a point that is not seen has no pixel: NaN, not 0"),
        (lambda *inputs: project(*inputs)[..., ::-1], "u first, then v: they are swapped"),
    ],
)


def warp(image, camera, pose, points):
    """Gray values (…) of an image at points (…, 3) of the rig frame; NaN where the camera does not see them (Eq. 1)."""
    in_camera = (points - pose.t) @ pose.R  # the way back from p = R q + t, for points in rows
    return look_up(image, project(camera, in_camera))


def _a_view(rng: Rng, k: int) -> tuple:
    pose = Pose.from_vector([0.1, 0.9, -0.2, 0.3, -0.1, 0.5] * rng.uniform(0.7, 1.3, 6))
    points = rng.uniform(0.8, 2.5, (3, 4 + k % 3, 3))
    points[0] = pose @ (points[0] * [1, 1, -3])  # behind the camera
    rows, columns = np.mgrid[:768, :800]
    return 100 + 50 * np.sin(rows / 40) + 40 * np.cos(columns / 30), _camera(), pose, points


def _seen(image: Array, camera: OcamCamera, points: Array) -> Array:
    return look_up(image, project(camera, points))


check_warp = Open(
    warp,
    _a_view,
    [
        (
            lambda im, c, T, p: _seen(im, c, p @ T.R.T + T.t),
            "that is camera → rig: the pose is to be undone, (p - t) R",
        ),
        (
            lambda im, c, T, p: _seen(im, c, (p - T.t) @ T.R.T),
            "the rotation is not undone: points in rows times R, not Rᵀ",
        ),
        (lambda im, c, T, p: _seen(im, c, p @ T.R - T.t), "first subtract t, then rotate: (p - t) R"),
        (lambda im, c, T, p: _seen(im, c, p @ T.R), "the translation is missing: (p - t) R"),
        (lambda im, c, T, p: _seen(im, c, p - T.t), "the rotation is missing: (p - t) R"),
        (lambda im, c, T, p: _seen(im, c, p), "the points are in the rig frame: take them to the camera's first"),
        (lambda im, c, T, p: project(c, (p - T.t) @ T.R), "those are the pixels: look the image up there"),
        (lambda *inputs: np.nan_to_num(warp(*inputs)), "what a camera does not see is NaN: it is not black"),
    ],
    picture=beside.view,
)


def cost_volume(spheres, radius):
    """Costs (H, W, N) of warped images (cameras, N, H, W): the mean over the ring of neighbouring cameras (Eq. 2)."""
    layers = []
    for warped in spheres.swapaxes(0, 1):
        neighbours = np.roll(warped, -1, axis=0)
        layers.append(
            mean_of_pairs(np.stack([zncc_costs(a, b, radius) for a, b in zip(warped, neighbours, strict=True)]))
        )
    return np.stack(layers, axis=-1)


def _spheres(rng: Rng, k: int) -> tuple:
    scene = rng.normal(0, 1, (3, 10, 14 + k % 3))
    spheres = scene + rng.normal(0, 0.5, (3 + k % 3, *scene.shape))
    spheres[0, :, :, :4] = spheres[1, :, :, 5:8] = np.nan
    spheres[:, 1, :2, -1] = np.nan  # cells that no pair sees
    return spheres, 2 + k % 2


def _volume(spheres: Array, radius: int, pairs: Answer, mean: Answer = mean_of_pairs) -> Array:
    return np.stack(
        [mean(np.stack([zncc_costs(s[i], s[j], radius) for i, j in pairs(len(s))])) for s in spheres.swapaxes(0, 1)], -1
    )


def _ring(cameras: int) -> list[tuple[int, int]]:
    return [(i, (i + 1) % cameras) for i in range(cameras)]


check_cost_volume = Open(
    cost_volume,
    _spheres,
    [
        (
            lambda s, r: _volume(s, r, lambda n: _ring(n)[:-1]),
            "the ring closes: the last camera and the first are a pair",
        ),
        (lambda s, r: _volume(s, r, lambda n: _ring(n)[:1]), "all pairs of neighbours, not the first alone"),
        (
            lambda s, r: _volume(s, r, _ring, lambda c: c.mean(0)),
            "a pair that does not see the ray spoils the rest: leave it out",
        ),
        (
            lambda s, r: _volume(s, r, _ring, lambda c: np.nan_to_num(c).mean(0)),
            "divide by the number of pairs that see the ray",
        ),
        (lambda s, r: _volume(s, r, _ring, lambda c: np.nansum(c, 0)), "that is the sum over the pairs: take the mean"),
        (lambda s, r: cost_volume(s, 4), "the radius is an argument: do not write 4"),
        (lambda s, r: np.moveaxis(cost_volume(s, r), -1, 0), "the spheres are the last axis: (H, W, N)"),
        (lambda s, r: cost_volume(s, r)[..., ::-1], "the spheres are in the wrong order"),
        (
            lambda s, r: np.nan_to_num(cost_volume(s, r)),
            "a cell that no pair sees has no cost: NaN, and not a perfect 0",
        ),
    ],
)


def points_of_depth(depth, theta, phi):
    """Points (H, W, 3) in metres, rig frame, of a depth panorama (H, W); angles (W,) and (H,) in radians."""
    theta, phi = np.meshgrid(theta, phi)
    rays = np.stack([np.cos(phi) * np.sin(theta), np.sin(phi), np.cos(phi) * np.cos(theta)], axis=-1)
    return depth[..., None] * rays


def _a_depth(rng: Rng, k: int) -> tuple:
    H, W = int(rng.integers(2, 5)), int(rng.integers(5, 9))
    return rng.uniform(1, 20, (H, W)), rng.uniform(-3, 3, W), rng.uniform(-0.7, 0.7, H)


def _flat(depth: Array, theta: Array, phi: Array) -> Array:
    theta, phi = np.meshgrid(theta, phi)
    return depth[..., None] * np.stack([np.sin(theta), np.sin(phi), np.cos(theta)], -1)


check_points_of_depth = Open(
    points_of_depth,
    _a_depth,
    [
        (lambda d, theta, phi: points_of_depth(d, theta, -phi), "y points down, as φ does: no minus"),
        (lambda d, theta, phi: points_of_depth(d, -theta, phi), "θ grows from z, forward, towards x, right"),
        (lambda *inputs: points_of_depth(*inputs)[..., [2, 1, 0]], "x goes with sin θ, z with cos θ: they are swapped"),
        (_flat, "x and z shrink with cos φ, or the ray has not length 1"),
        (lambda d, theta, phi: points_of_depth(1 / d, theta, phi), "that is with the inverse depth"),
        (
            lambda d, theta, phi: points_of_depth(np.ones_like(d), theta, phi),
            "those are the rays: multiply by the depth",
        ),
        (
            lambda d, *a: d[..., None] / points_of_depth(d, *a)[..., 2:] * points_of_depth(d, *a),
            "depth is along the ray, not z",
        ),
        (lambda *inputs: np.moveaxis(points_of_depth(*inputs), -1, 0), "the coordinates come last: (H, W, 3)"),
    ],
)
