"""Notebook 06, the one page: the lens, the warp, the cost volume, and points from depth."""

import numpy as np

from course.exercises import beside
from course.exercises.compare import Array, Rng
from course.exercises.nb03 import look_up
from course.exercises.nb04 import mean_of_pairs
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
    poly, inverse = np.array([-200.0, 0.0, 1e-3]), np.array([210.0, 160.0, 15.0, -9.0])
    return OcamCamera(poly, inverse, (400.0, 380.0), (1.02, 0.01, -0.02), (800, 768), 200.0)


def _in_camera(rng: Rng, k: int) -> tuple:
    points = rng.normal(0, 1, (4, 5 + k % 3, 3))
    points[0] *= [1, 1, 0.1]  # at the edge of the field of view, and of the image
    return _camera(), points[k % 2] if k % 3 == 1 else points


check_project = Open(project, _in_camera).with_slips("""
    np.arctan2(-z, across) → np.arctan2(z, across)
    # t is the angle below the xy-plane: arctan2(-z, …)
    camera.inv_poly[::-1] → camera.inv_poly  # np.polyval wants the highest power first
    x + e * y + camera.center[0], d * x + c * y → c * x + d * y + camera.center[0], e * x + y
    # u goes with x and v with y: u = x + e y, v = d x + c y
    camera.center[0], d * x + c * y + camera.center[1]
    → camera.center[1], d * x + c * y + camera.center[0]
    # the centre is (u, v): its parts are swapped
    inside & (t <= np.radians(camera.max_fov_deg / 2 - 90)) → inside
    # a point outside the field of view has no pixel: t is at most half of it, less 90°
""")


def warp(image, camera, pose, points):
    """Grey values (…) of an image at points (…, 3) of the rig frame; NaN where the camera does not
    see them (Eq. 1)."""
    in_camera = (points - pose.t) @ pose.R  # the way back from p = R q + t, for points in rows
    return look_up(image, project(camera, in_camera))


def _a_view(rng: Rng, k: int) -> tuple:
    pose = Pose.from_vector([0.1, 0.9, -0.2, 0.3, -0.1, 0.5] * rng.uniform(0.7, 1.3, 6))
    points = rng.uniform(0.8, 2.5, (3, 4 + k % 3, 3))
    points[0] = pose @ (points[0] * [1, 1, -3])  # behind the camera
    rows, columns = np.mgrid[:768, :800]
    return 100 + 50 * np.sin(rows / 40) + 40 * np.cos(columns / 30), _camera(), pose, points


check_warp = Open(warp, _a_view, whole=("image",), real=beside.view).with_slips("""
    @ pose.R → @ pose.R.T  # the rotation is not undone: points in rows times R, not Rᵀ
    (points - pose.t) @ pose.R → points @ pose.R - pose.t
    # first subtract t, then rotate: (p - t) R
    points - pose.t → points  # the translation is missing: (p - t) R
    (points - pose.t) @ pose.R → points
    # the points are in the rig frame: take them to the camera's first
""")


def cost_volume(images, cameras, poses, theta, phi, radii, pair_cost):
    """Costs (H, W, N) of the rays of a panorama on the spheres around the middle of the cameras,
    radii (N,) in metres: the mean over the ring of neighbouring cameras (Eq. 2).

    theta (W,), phi (H,): angles of the columns and rows, radians. pair_cost: from two warped images
    (H, W) to costs (H, W), NaN where not both see."""
    theta, phi = np.meshgrid(theta, phi)
    rays = [np.cos(phi) * np.sin(theta), np.sin(phi), np.cos(phi) * np.cos(theta)]
    rays = np.stack(rays, axis=-1)
    center = np.mean([pose.t for pose in poses], axis=0)
    volume = []
    for radius in radii:
        warped = []
        for image, camera, pose in zip(images, cameras, poses, strict=True):
            warped.append(warp(image, camera, pose, center + radius * rays))
        # the last camera and the first are neighbours, too
        neighbours = [*warped[1:], warped[0]]
        costs = [pair_cost(a, b) for a, b in zip(warped, neighbours, strict=True)]
        volume.append(mean_of_pairs(np.stack(costs)))
    return np.stack(volume, axis=-1)


def _a_rig(rng: Rng, k: int) -> tuple:
    rows, columns = np.mgrid[:768, :800]
    count = 3 + k % 2
    images = [np.sin(rows / rng.uniform(30, 60)) + np.cos(columns / 30 + i) for i in range(count)]
    poses = [
        Pose.from_vector([0, 2 * np.pi * i / count, 0, *rng.normal(0, 0.4, 3)])
        for i in range(count)
    ]
    theta, phi = rng.uniform(-3, 3, 7 + k % 3), np.sort(rng.uniform(-0.7, 0.7, 4))
    radii = rng.uniform(1.5, 6, 3)
    return images, [_camera()] * count, poses, theta, phi, radii, _apart


def _apart(a: Array, b: Array) -> Array:
    return abs(a - b) / 4


check_cost_volume = Open(
    cost_volume, _a_rig, whole=("images", "cameras", "poses", "theta", "phi")
).with_slips("""
    neighbours = [*warped[1:], warped[0]] → neighbours = warped[1:]; warped = warped[:-1]
    # the ring closes: the last camera and the first are a pair
    mean_of_pairs(np.stack(costs)) → np.mean(costs, axis=0)
    # a pair that does not see the ray is NaN, and must not count: mean_of_pairs
    mean_of_pairs(np.stack(costs)) → np.nansum(costs, axis=0)
    # that is the sum over the pairs: take the mean
    center + radius * rays → radius * rays
    # the spheres are around the middle of the cameras: center + radius * rays
    center + radius * rays → pose.t + radius * rays
    # all cameras are warped onto the same sphere, around the middle of them
""")


def points_of_depth(depth, theta, phi):
    """Points (H, W, 3) in metres, rig frame, of a depth panorama (H, W); angles (W,) and (H,) in
    radians."""
    theta, phi = np.meshgrid(theta, phi)
    rays = np.stack(
        [np.cos(phi) * np.sin(theta), np.sin(phi), np.cos(phi) * np.cos(theta)], axis=-1
    )
    return depth[..., None] * rays


def _a_depth(rng: Rng, k: int) -> tuple:
    H, W = int(rng.integers(2, 5)), int(rng.integers(5, 9))
    return rng.uniform(1, 20, (H, W)), rng.uniform(-3, 3, W), rng.uniform(-0.7, 0.7, H)


check_points_of_depth = Open(points_of_depth, _a_depth).with_slips("""
    np.cos(phi) * np.sin(theta), np.sin(phi), np.cos(phi) * np.cos(theta)
    → np.sin(theta), np.sin(phi), np.cos(theta)
    # x and z shrink with cos φ, or the ray has not length 1
    depth[..., None] * rays → depth[..., None] * rays / rays[..., 2:]
    # depth is along the ray, not z
""")
