"""Notebook 03: the ray of a pixel, a sphere, the pixel of a point, the look-up, and how much the cameras disagree."""

import numpy as np

from course.exercises import beside
from course.exercises.compare import Answer, Array, Rng
from course.exercises.opened import Open
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose


def rays_of_pixels(columns, rows, width, height, phi_deg):
    """Unit rays (…, 3) of panorama pixels, rig frame: x right, y down, z forward."""
    theta = (columns + 0.5 - width / 2) * 2 * np.pi / width
    low, high = np.radians(phi_deg)
    phi = low + (rows + 0.5) * (high - low) / height
    return np.stack([np.cos(phi) * np.sin(theta), np.sin(phi), np.cos(phi) * np.cos(theta)], axis=-1)


def _some_pixels(rng: Rng, k: int) -> tuple:
    width, height = int(rng.integers(100, 1300)), int(rng.integers(30, 300))
    columns, rows = rng.integers(0, width, 6 + k % 3), rng.integers(0, height, 6 + k % 3)
    if k % 3 == 0:
        columns, rows = np.meshgrid(columns, rows)
    return columns, rows, width, height, (-float(rng.integers(30, 50)), float(rng.integers(20, 29)))


def _too_long(*inputs: Array) -> Array:
    x, y, z = np.moveaxis(rays_of_pixels(*inputs), -1, 0)
    return np.stack([x / np.hypot(x, z), y, z / np.hypot(x, z)], -1)


check_rays_of_pixels = Open(
    rays_of_pixels,
    _some_pixels,
    [
        (lambda c, r, *rest: rays_of_pixels(c - 0.5, r - 0.5, *rest), "a ray goes through a pixel's middle: add ½"),
        (lambda c, r, W, *rest: rays_of_pixels(c + W / 2, r, W, *rest), "θ = 0 is in the middle: subtract W/2"),
        (lambda c, r, W, *rest: rays_of_pixels(W - 1 - c, r, W, *rest), "θ is mirrored: it grows to the right"),
        (lambda c, r, W, H, phi: rays_of_pixels(c, H - 1 - r, W, H, phi), "φ is mirrored: it grows downwards"),
        (
            lambda c, r, W, H, phi: rays_of_pixels(c, r, W, H, np.degrees(phi)),
            "phi_deg is in degrees: NumPy wants radians",
        ),
        (
            lambda c, r, W, H, _: rays_of_pixels(c, r, W, H, (-90, 90)),
            "the rows run from φ₀ to φ₁, not from -90° to 90°",
        ),
        (lambda c, r, W, *rest: rays_of_pixels((c + W / 2 - 0.5) / 2, r, W, *rest), "W columns make 2π, not π"),
        (lambda *inputs: rays_of_pixels(*inputs)[..., ::-1], "that is the ρ of print, rotated by 90° and mirrored"),
        (lambda *inputs: rays_of_pixels(*inputs)[..., [1, 0, 2]], "y goes down with φ; x and z go around with θ"),
        (_too_long, "cos φ belongs to x and to z: a ray has length 1"),
        (lambda *inputs: np.moveaxis(rays_of_pixels(*inputs), -1, 0), "x, y, z are the last axis: stack with axis=-1"),
    ],
)


def points_on_sphere(rays, n, N, min_depth):
    """Points (…, 3) in metres at which unit rays (…, 3) meet sphere n of N."""
    inverse_depth = n / (min_depth * (N - 1))  # 1/m
    return rays / max(inverse_depth, 2.0**-23)  # sphere 0 lies at infinity: 2²³ m, as in the paper


def _a_sphere(rng: Rng, k: int) -> tuple:
    rays = rng.normal(0, 1, (3, 4 + k % 3, 3))
    N = int(rng.integers(20, 200))
    n = 0 if k == 9 else int(rng.integers(2, N - 1))
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True), n, N, rng.uniform(0.4, 3)


check_points_on_sphere = Open(
    points_on_sphere,
    _a_sphere,
    [
        (lambda rays, n, N, D: rays / np.float64(n / (D * (N - 1))), "sphere 0: do not divide by 0, but by 2**-23"),
        (lambda rays, n, N, D: rays * (n / (D * (N - 1))), "d is an inverse depth, in 1/m: divide by it"),
        (lambda rays, n, N, D: points_on_sphere(rays, n, N + 1, D), "N spheres have N - 1 steps between them"),
        (lambda rays, n, N, D: points_on_sphere(rays, n + 1, N, D), "the spheres count from 0: n, not n + 1"),
        (lambda rays, n, N, D: points_on_sphere(rays, N - 1 - n, N, D), "sphere 0 is at infinity, N - 1 the nearest"),
        (lambda rays, n, N, D: points_on_sphere(rays, n, N, 1), "the nearest sphere is min_depth metres away"),
        (lambda rays, n, N, D: points_on_sphere(rays, n, N, 1 / D), "min_depth belongs below the line"),
        (lambda rays, n, N, D: rays * D * n / (N - 1), "the spheres are even in inverse depth, not in depth"),
        (lambda *inputs: np.linalg.norm(points_on_sphere(*inputs), axis=-1), "that is the depth: walk along the rays"),
    ],
)


def pixels_of_points(points, camera, T_rig_cam):
    """Pixels (…, 2) at which a camera sees points (…, 3) of the rig frame: u right, v down; NaN where it sees none."""
    in_camera = T_rig_cam.inverse() @ points
    pixels, visible = camera.project(in_camera)
    return np.where(visible[..., None], pixels, np.nan)


def _a_camera(rng: Rng, k: int) -> tuple:
    camera = OcamCamera([-200.0, 0.0, 1e-3], [314.159, 200.0], (400.0, 380.0), (1.0, 0.0, 0.0), (800, 768), 200.0)
    pose = Pose.from_vector([0.1, 0.9, -0.2, 0.3, -0.1, 0.5] * rng.uniform(0.7, 1.3, 6))
    points = rng.uniform(0.8, 2.5, (3, 4 + k % 3, 3))
    points[0] = pose @ (points[0] * [1, 1, -3])  # behind the camera
    return points, camera, pose


def _seen(points: Array, camera: OcamCamera) -> Array:
    return pixels_of_points(points, camera, Pose.identity())


check_pixels_of_points = Open(
    pixels_of_points,
    _a_camera,
    [
        (lambda p, camera, T: _seen(T @ p, camera), "T_rig_cam leads from the camera to the rig: take its .inverse()"),
        (lambda p, camera, T: _seen(p, camera), "the points are in the rig frame: take them to the camera's first"),
        (lambda p, camera, T: _seen((p - T.t) @ T.R.T, camera), "the rotation is not transposed: Rᵀ(p - t)"),
        (lambda p, camera, T: _seen(p @ T.R - T.t, camera), "the inverse's translation is -Rᵀt, not -t: Rᵀ(p - t)"),
        (lambda p, camera, T: _seen(p @ T.R, camera), "the translation is missing: Rᵀ(p - t)"),
        (lambda p, camera, T: _seen(p - T.t, camera), "the rotation is missing: Rᵀ(p - t)"),
        (lambda p, camera, T: camera.project(T.inverse() @ p)[0], "NaN where `visible` is False"),
        (lambda *inputs: np.nan_to_num(pixels_of_points(*inputs)), "a point that is not seen has no pixel: NaN, not 0"),
        (lambda *inputs: pixels_of_points(*inputs)[..., ::-1], "pixels are (u, v), right first, then down: swapped"),
        (lambda *inputs: np.rint(pixels_of_points(*inputs)), "do not round: a point falls between pixels"),
        (lambda *inputs: pixels_of_points(*inputs) + 0.5, "whole numbers are pixel centres here: add no ½"),
    ],
)


def look_up(image, pixels):
    """Gray values (…) of an image (H, W) at pixels (…, 2), each a mean of the four around it; NaN at NaN."""
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


def _mixed(image: Array, pixels: Array, change: Answer) -> Array:
    """The look-up with other fractions a, b of a pixel."""
    corner = np.clip(np.floor(np.nan_to_num(pixels)), 0, np.array(image.shape[::-1]) - 2)
    return look_up(image, corner + np.stack(change(*np.moveaxis(pixels - corner, -1, 0)), -1))


check_look_up = Open(
    look_up,
    _an_image,
    [
        (lambda *inputs: _mixed(*inputs, lambda a, b: (np.rint(a), np.rint(b))), "that is the nearest pixel: mix four"),
        (lambda *inputs: _mixed(*inputs, lambda a, b: (0 * a, 0 * b)), "decimals are cut off: mix four pixels"),
        (lambda *inputs: _mixed(*inputs, lambda a, b: (a, 0 * b)), "that mixes left and right only"),
        (lambda *inputs: _mixed(*inputs, lambda a, b: (0 * a, b)), "that mixes above and below only"),
        (lambda *inputs: _mixed(*inputs, lambda a, b: (1 - a, 1 - b)), "the nearer pixel counts more: weights swapped"),
        (lambda *inputs: _mixed(*inputs, lambda a, b: (b, a)), "u mixes left and right, v above and below"),
        (lambda image, pixels: look_up(image, pixels - 0.5), "whole numbers are pixel centres: add and subtract no ½"),
        (lambda *inputs: np.nan_to_num(look_up(*inputs)), "what a camera does not see is NaN: it is not black"),
        (lambda *inputs: np.rint(look_up(*inputs)), "a mean of gray values is not an integer: compute with floats"),
    ],
    picture=lambda: (beside.image(), beside.pixels()),
)


def disagreement(warped):
    """Standard deviation (H, W) between the cameras that see a ray, of (cameras, H, W); NaN where fewer than two do."""
    seen = np.isfinite(warped)
    count = seen.sum(axis=0)
    mean = np.where(seen, warped, 0).sum(axis=0) / np.maximum(count, 1)
    squares = np.where(seen, (warped - mean) ** 2, 0).sum(axis=0)
    return np.where(count >= 2, np.sqrt(squares / np.maximum(count, 1)), np.nan)


def _warped(rng: Rng, k: int) -> tuple:
    warped = rng.uniform(0, 255, (3 + k % 3, 4, 6 + k % 3))
    warped[rng.uniform(0, 1, warped.shape) < 0.3] = np.nan
    warped[:, 0, 0] = warped[1:, 0, 1] = warped[2:, 0, 2] = np.nan  # rays that no camera, one, and two see
    warped[0, 0, 1], warped[:2, 0, 2] = 80, (90, 120)
    return (warped,)


def _count(warped: Array) -> Array:
    return np.maximum(np.isfinite(warped).sum(0), 2)


check_disagreement = Open(
    disagreement,
    _warped,
    [
        (lambda w: np.std(w, axis=0), "a camera that does not see the ray is NaN and spoils the rest: leave it out"),
        (lambda w: np.std(np.nan_to_num(w), axis=0), "what a camera does not see is not black: leave it out"),
        (lambda w: np.nanstd(w, axis=0), "one camera cannot disagree: NaN where fewer than two see the ray"),
        (lambda w: np.nan_to_num(disagreement(w)), "where fewer than two see the ray, nothing is known: NaN, not 0"),
        (lambda w: disagreement(w) ** 2, "that is the variance: take the root"),
        (lambda w: disagreement(w) * np.sqrt(_count(w) / (_count(w) - 1)), "divide by their number, not by one less"),
        (lambda w: disagreement(w) * np.sqrt(_count(w) / len(w)), "divide by the number of cameras that see the ray"),
        (lambda w: disagreement(w) + np.nanmax(w, 0) * 0 + 0 * w[0], "leave a camera out only where it sees nothing"),
        (lambda w: np.nanstd(w, axis=(1, 2)), "the cameras are the first axis: compare them at each ray"),
        (lambda w: np.nanmean(disagreement(w)), "that is one number: each ray has its own"),
    ],
    picture=lambda: (beside.gray(),),
)
