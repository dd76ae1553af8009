"""Notebook 03: the ray of a pixel, a sphere, the pixel of a point, the look-up, how much the cameras
disagree, and a first depth."""

import cv2
import numpy as np

from course.exercises import beside
from course.exercises.compare import Rng
from course.exercises.opened import Open
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose


def rays_of_pixels(columns, rows, width, height, phi_deg):
    """Unit rays (…, 3) of panorama pixels, rig frame: x right, y down, z forward."""
    theta = (columns + 0.5 - width / 2) * 2 * np.pi / width
    low, high = np.radians(phi_deg)
    phi = low + (rows + 0.5) * (high - low) / height
    return np.stack(
        [np.cos(phi) * np.sin(theta), np.sin(phi), np.cos(phi) * np.cos(theta)], axis=-1
    )


def _some_pixels(rng: Rng, k: int) -> tuple:
    width, height = int(rng.integers(100, 1300)), int(rng.integers(30, 300))
    columns, rows = rng.integers(0, width, 6 + k % 3), rng.integers(0, height, 6 + k % 3)
    if k % 3 == 0:
        columns, rows = np.meshgrid(columns, rows)
    return columns, rows, width, height, (-float(rng.integers(30, 50)), float(rng.integers(20, 29)))


check_rays_of_pixels = Open(rays_of_pixels, _some_pixels).with_slips("""
    - width / 2 →  # θ = 0 is in the middle: subtract W/2
    * 2 * np.pi / width → * 360 / width  # sin and cos take radians: W columns make 2π, not 360
    * 2 * np.pi / width → * np.pi / width  # W columns make 2π, not π
    np.cos(phi) * np.sin(theta), np.sin(phi), np.cos(phi) * np.cos(theta)
    → np.sin(theta), np.sin(phi), np.cos(theta)
    # cos φ belongs to x and to z: a ray has length 1
""")


def points_on_sphere(rays, n, N, min_depth):
    """Points (…, 3) in metres at which unit rays (…, 3) meet sphere n of N."""
    inverse_depth = n / (min_depth * (N - 1))  # 1/m
    return rays / max(inverse_depth, 2.0**-23)  # sphere 0 lies at infinity: 2²³ m, as in the paper


def _a_sphere(rng: Rng, k: int) -> tuple:
    rays = rng.normal(0, 1, (3, 4 + k % 3, 3))
    N = int(rng.integers(20, 200))
    n = 0 if k == 9 else int(rng.integers(2, N - 1))
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True), n, N, rng.uniform(0.4, 3)


check_points_on_sphere = Open(points_on_sphere, _a_sphere).with_slips("""
    rays / max → rays * max  # d is an inverse depth, in 1/m: divide by it
    n / (min_depth → (N - 1 - n) / (min_depth  # sphere 0 is at infinity, N - 1 the nearest
    return rays * min_depth * n / (N - 1)  # the spheres are even in inverse depth, not in depth
""")


def pixels_of_points(points, camera, T_rig_cam):
    """Pixels (…, 2) at which a camera sees points (…, 3) of the rig frame: u right, v down; NaN
    where it sees none."""
    in_camera = T_rig_cam.inverse() @ points
    pixels, visible = camera.project(in_camera)
    return np.where(visible[..., None], pixels, np.nan)


def _a_camera(rng: Rng, k: int) -> tuple:
    camera = OcamCamera(
        np.array([-200.0, 0.0, 1e-3]),
        np.array([314.159, 200.0]),
        (400.0, 380.0),
        (1.0, 0.0, 0.0),
        (800, 768),
        200.0,
    )
    pose = Pose.from_vector([0.1, 0.9, -0.2, 0.3, -0.1, 0.5] * rng.uniform(0.7, 1.3, 6))
    points = rng.uniform(0.8, 2.5, (3, 4 + k % 3, 3))
    points[0] = pose @ (points[0] * [1, 1, -3])  # behind the camera
    # behind it, and yet in its field of view of 200°
    points[1] = pose @ (points[1] * [1, 1, -0.02])
    points = {8: points[0], 9: points[1, 0]}.get(k, points)
    return points, camera, pose


check_pixels_of_points = Open(pixels_of_points, _a_camera, within=1e-3).with_slips("""
    T_rig_cam.inverse() @ points → points
    # the points are in the rig frame: take them to the camera's first
    T_rig_cam.inverse() @ points → (points - T_rig_cam.t) @ T_rig_cam.R.T
    # the rotation is not transposed: Rᵀ(p - t)
    T_rig_cam.inverse() @ points → points @ T_rig_cam.R - T_rig_cam.t
    # the inverse's translation is -Rᵀt, not -t: Rᵀ(p - t)
    visible[..., None] → in_camera[..., 2:] > 0
    # a fisheye sees behind itself, z < 0: ask `visible`
""")


def look_up(image, pixels):
    """Grey values (…) of an image (H, W) at pixels (…, 2), each a mean of the four around it; NaN
    at NaN."""
    u, v = pixels[..., 0], pixels[..., 1]
    x = np.clip(np.floor(np.nan_to_num(u)).astype(int), 0, image.shape[1] - 2)
    y = np.clip(np.floor(np.nan_to_num(v)).astype(int), 0, image.shape[0] - 2)
    a, b = u - x, v - y  # from 0, at column x and row y, to 1, at the next ones
    top = image[y, x] * (1 - a) + image[y, x + 1] * a
    bottom = image[y + 1, x] * (1 - a) + image[y + 1, x + 1] * a
    return top * (1 - b) + bottom * b


def _an_image(rng: Rng, k: int) -> tuple:
    H, W = 6 + k % 3, 9 + k % 4
    pixels = rng.uniform([0, 0], [W - 1, H - 1], (3, 5, 2))
    pixels[0, :2] = (W - 1, 2.3), (1.6, H - 1)  # on the last column, on the last row
    pixels[1, 2:4] = np.nan
    return rng.uniform(0, 255, (H, W)).astype([np.float64, np.uint8, np.float32][k % 3]), pixels


check_look_up = Open(
    look_up, _an_image, whole=("image",), real=beside.between, within=0.01
).with_slips("""
    a, b = u - x, v - y → a, b = 0 * u, 0 * v  # decimals are cut off: mix four pixels
    a, b = u - x, v - y → a, b = 1 - u + x, 1 - v + y
    # the nearer pixel counts more: weights swapped
    a, b = u - x, v - y → a, b = v - y, u - x  # u mixes left and right, v above and below
    image[y, x] * (1 - a) + image[y, x + 1] * a → image[y, x] + a * (image[y, x + 1] - image[y, x])
    image[y + 1, x] * (1 - a) + image[y + 1, x + 1] * a
    → image[y + 1, x] + a * (image[y + 1, x + 1] - image[y + 1, x])
    # 3 - 5 is 254 in whole numbers of 8 bits: turn the image into floats first
""")


def disagreement(warped):
    """Standard deviation (H, W) between the cameras that see a ray, of (cameras, H, W); NaN where
    fewer than two do."""
    seen = np.isfinite(warped)
    count = seen.sum(axis=0)
    mean = np.where(seen, warped, 0).sum(axis=0) / np.maximum(count, 1)
    squares = np.where(seen, (warped - mean) ** 2, 0).sum(axis=0)
    return np.where(count >= 2, np.sqrt(squares / np.maximum(count, 1)), np.nan)


def _warped(rng: Rng, k: int) -> tuple:
    warped = rng.uniform(0, 255, (3 + k % 3, 4, 6 + k % 3))
    warped[rng.uniform(0, 1, warped.shape) < 0.3] = np.nan
    # rays that no camera, one, and two see
    warped[:, 0, 0] = warped[1:, 0, 1] = warped[2:, 0, 2] = np.nan
    warped[0, 0, 1], warped[:2, 0, 2] = 80, (90, 120)
    return (warped,)


check_disagreement = Open(
    disagreement, _warped, real=lambda: (beside.gray(),), within=0.01
).with_slips("""
    np.sqrt(squares / np.maximum(count, 1)) → np.sqrt(squares / np.maximum(count - 1, 1))
    # divide by their number, not by one less
    np.sqrt(squares / np.maximum(count, 1)) → np.nanmax(warped, axis=0) - np.nanmin(warped, axis=0)
    # that is the range, largest minus smallest: take the root of the mean square
    (warped - mean) ** 2 → np.abs(warped - mean)
    np.sqrt(squares / np.maximum(count, 1)) → squares / np.maximum(count, 1)
    # that is the mean absolute difference: square, take the mean, then the root
""")


def first_depth(images, cameras, T_rig_cam, rays, N, min_depth, window):
    """Sphere (H, W) on which the cameras disagree least about each ray: the mean disagreement over a
    window of so many rays a side is lowest. Where fewer than two cameras see, they disagree by 255.
    """
    lowest = np.full(rays.shape[:-1], np.inf)
    index = np.zeros(rays.shape[:-1], int)
    for n in range(N):
        points = points_on_sphere(rays, n, N, min_depth)
        warped = []
        for image, camera, T in zip(images, cameras, T_rig_cam, strict=True):
            pixels = pixels_of_points(points, camera, T)
            warped.append(look_up(image, pixels))
        apart = disagreement(np.stack(warped))
        apart = np.where(np.isnan(apart), 255, apart)
        cost = cv2.blur(apart, (window, window))
        better = cost < lowest
        index[better] = n
        lowest[better] = cost[better]
    return index


def _a_small_rig(rng: Rng, k: int) -> tuple:
    rows, columns = np.mgrid[:96, :100]
    waves = rng.uniform(3, 9, (3, 2))
    images = [127 + 80 * np.sin(rows / a) + 47 * np.cos(columns / b) for a, b in waves]
    poly, inverse = np.array([-25.0, 0.0, 8e-3]), np.array([40.0, 26.0])
    lens = OcamCamera(
        poly, inverse, (50.0, 48.0), (1.0, 0.0, 0.0), (100, 96), (200.0, 150.0)[k % 2]
    )
    poses = [Pose.from_vector([0, 2 * i, 0, *rng.normal(0, 0.4, 3)]) for i in range(3)]
    shape = 9, 15 + k % 3
    rays = rng.normal(0, 1, (*shape, 3)) * [1, 0.4, 1]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    return images, [lens] * 3, poses, rays, 5 + k % 4, rng.uniform(0.8, 1.5), (1, 3)[k % 2]


check_first_depth = Open(
    first_depth, _a_small_rig, whole=("images", "cameras", "T_rig_cam", "rays")
).with_slips("""
    lowest[better] = cost[better] → pass
    # keep the lowest cost, too, or every later sphere is better
    np.where(np.isnan(apart), 255, apart) → np.nan_to_num(apart)
    # where fewer than two cameras see, 0 would win: put 255
    cost = cv2.blur(apart, (window, window)) → cost = apart
    # a single ray says little: take the mean over the window, cv2.blur
    cv2.blur(apart, (window, window)) → cv2.blur(apart, (9, 9))
    # the window is an argument: do not write 9
    points_on_sphere(rays, n, N, min_depth) → points_on_sphere(rays, n + 1, N, min_depth)
    # the first sphere has the number 0
""")
