"""What `mine/omnistereo.py` has around the student's functions: from the images of a rig to depth.

`omnistereo depth --method FILE.py` calls `depth`; see `omnistereo_tools.own_method`.
"""

import cv2
import numpy as np

from course.exercises.nb01 import project_rays
from course.exercises.nb03 import look_up, points_on_sphere, rays_of_pixels
from course.exercises.nb04 import mean_of_pairs, winner, zncc_costs
from course.exercises.nb05 import refined, sum_of_paths

# the paths of SGM: rows down and columns to the right
EIGHT = [(y, x) for y in (-1, 0, 1) for x in (-1, 0, 1) if y or x]


def depth(images, cameras, grid):
    """Sphere indices and confidences, (H, W) each: ZNCC on each sphere, SGM, and the cheapest
    sphere.

    Args:
        images: One per camera, (height, width) or (height, width, 3).
        cameras: With inv_poly, center, affine, max_fov_deg as in OCamCalib's files, `valid`, where
            an image shows something, (height, width), and R, t from the camera to the rig, metres,
            rig centre at 0.
        grid: With width, height, phi_deg, num_spheres, min_depth, and the `pairs` of neighbours.
    """
    W, H, N = grid.width, grid.height, grid.num_spheres
    rays = rays_of_pixels(*np.meshgrid(np.arange(W), np.arange(H)), W, H, grid.phi_deg)
    smooth = [
        blurred(gray(image), camera, W) for image, camera in zip(images, cameras, strict=True)
    ]
    radius = max(round((9 * min(W / 1200, 1) ** 0.5 - 1) / 2), 2)  # the window of notebook 05
    volume = np.empty((H, W, N), np.float32)
    for n in range(N):
        points = points_on_sphere(rays, n, N, grid.min_depth)
        warped = [
            warp(image, camera, points) for image, camera in zip(smooth, cameras, strict=True)
        ]
        costs = [zncc_costs(warped[i], warped[j], radius) for i, j in grid.pairs]
        volume[:, :, n] = mean_of_pairs(np.stack(costs)).clip(0, 1)
    return read_out(volume, *penalties(W, N))


def gray(image):
    """An image in grey (height, width), as bright as red, green and blue look to us."""
    return image.astype(float) if image.ndim == 2 else image @ [0.299, 0.587, 0.114]


def blurred(image, camera, W):
    """The image without detail that is finer than a panorama of W columns; mean 0 and variance 1
    where it is valid."""
    rim = np.polyval(camera.inv_poly[::-1], np.radians(camera.max_fov_deg / 2 - 90))
    step = rim / (camera.max_fov_deg / 2) * 360 / W  # pixels from ray to ray
    if step > 1.1:
        sigma = 0.5 * np.sqrt(step**2 - 1)
        weight = cv2.GaussianBlur(camera.valid.astype(float), (0, 0), sigma)
        image = cv2.GaussianBlur(image * camera.valid, (0, 0), sigma) / np.maximum(weight, 1e-6)
    inside = image[camera.valid]
    # or rounding would be the pattern of a white wall
    return (image - inside.mean()) / max(inside.std(), 1e-9)


def warp(image, camera, points):
    """Grey values (H, W) of an image at points (H, W, 3) of the rig frame; NaN where the camera
    does not see them."""
    in_camera = (points - camera.t) @ camera.R
    x, y = np.moveaxis(
        project_rays(in_camera, camera.inv_poly, (0, 0), camera.max_fov_deg / 2), -1, 0
    )
    c, d, e = camera.affine
    u, v = x + e * y + camera.center[0], d * x + c * y + camera.center[1]
    height, width = image.shape
    with np.errstate(invalid="ignore"):
        seen = (u >= 0) & (v >= 0) & (u <= width - 1) & (v <= height - 1)
    u, v = np.where(seen, u, 0), np.where(seen, v, 0)
    seen &= camera.valid[np.rint(v).astype(int), np.rint(u).astype(int)]
    return np.where(seen, look_up(image, np.stack([u, v], axis=-1)), np.nan)


def penalties(W, N):
    """P1 and P2 for a panorama of W columns and N spheres: the rule of notebook 05."""
    scale = min(W / 1200, 1)
    p2 = 12 * min(scale**2 * 192 / N, 1)
    return min(0.1 * scale**0.5, p2), p2


def read_out(volume, p1, p2):
    """Refined indices and confidences, (H, W) each, of a cost volume (H, W, N) with NaN where no
    pair sees."""
    unknown = np.isnan(volume)
    count = np.maximum((~unknown).sum(axis=-1, keepdims=True), 1)
    mean = np.where(unknown, 0, volume).sum(axis=-1, keepdims=True) / count
    costs = sum_of_paths(
        np.where(unknown, mean, volume), p1, p2, EIGHT
    )  # neither match nor mismatch
    costs = np.where(unknown, np.nan, costs)
    best = winner(costs)
    # Beside a sphere that no pair sees there is no parabola.
    n = np.nan_to_num(best).astype(int)[..., None]
    N = volume.shape[-1]
    lone = (
        sum(np.take_along_axis(unknown, np.clip(n + k, 0, N - 1), axis=-1)[..., 0] for k in (-1, 1))
        > 0
    )
    with np.errstate(invalid="ignore"):
        fine = refined(np.where(unknown, np.inf, costs))
    # How much cheaper the winner is than the best sphere that is not next to it.
    others = np.where(unknown | (np.abs(np.arange(N) - n) <= 1), np.inf, costs).min(axis=-1)
    lowest = np.take_along_axis(costs, n, axis=-1)[..., 0]
    confidence = np.where(np.isnan(best), np.nan, 1 - lowest / np.maximum(others, 1e-9))
    return np.where(np.isnan(best) | lone, best, fine), confidence
