"""Notebook 00: the depth of a sphere, the error of an index, the share of bad rays, a panorama from
all cameras."""

import numpy as np

from course.exercises import beside
from course.exercises.compare import Rng
from course.exercises.opened import Open


def depth_of_index(index, N, min_depth):
    """Depths in metres of sphere indices, of any shape, among N spheres; infinite at index 0."""
    inverse_depth = index / (min_depth * (N - 1))
    with np.errstate(divide="ignore"):
        return 1 / inverse_depth


def _some_indices(rng: Rng, k: int) -> tuple:
    N = int(rng.integers(50, 200))
    index = rng.uniform(0.5, N - 1, (3, 4 + k % 3))
    index[0, 0] = 0
    index = {8: np.array(5.5), 9: np.arange(1, N)}.get(k, index)
    return index, N, rng.uniform(0.4, 3)


check_depth_of_index = Open(
    depth_of_index, _some_indices, real=lambda: (np.arange(6, 96), 96, 0.5)
).with_slips("""
    index / ( → (N - 1 - index) / (  # sphere 0 is at infinity, sphere N - 1 the nearest
    return min_depth * index / (N - 1)  # the spheres are even in inverse depth, not in depth
""")


def index_errors(index, gt_index, N):
    """Errors e (H, W) in percent of the N spheres; 100 without an estimate, NaN without a ground
    truth."""
    e = 100 / N * np.abs(index - gt_index)
    e = np.where(np.isnan(index), 100, e)
    return np.where(np.isnan(gt_index), np.nan, e)


def _two_maps(rng: Rng, k: int) -> tuple:
    N = int(rng.integers(8, 40)) * 4
    gt_index = rng.uniform(0, N - 1, (4, 6 + k % 3))
    index = gt_index + rng.normal(0, 0.05 * N, gt_index.shape)
    gt_index[1, :2] = index[1, 1:3] = np.nan
    return (index.astype(np.float32) if k % 2 else index), gt_index, N


check_index_errors = Open(index_errors, _two_maps).with_slips("""
    e = np.where(np.isnan(index), 100, e) →
    # a ray without an estimate is NaN: count it as an error of 100
    np.abs(index - gt_index) → (index - gt_index)  # too near is as wrong as too far: np.abs
    100 / N * →  # in percent of the N spheres: times 100 / N
""")


def share_above(errors, limit):
    """Percentage of the rays whose error is larger than a limit, of those with an error that is
    known (not NaN)."""
    known = errors[np.isfinite(errors)]
    return 100 * np.mean(known > limit)


def _some_errors(rng: Rng, k: int) -> tuple:
    errors = np.round(rng.exponential(3, (5, 7 + k % 4)) * 4) / 4
    errors[0, :3] = np.nan
    errors[1, :3] = 1, 3, 5
    return errors, (1, 3.0, np.float64(5))[k % 3]


check_share_above = Open(share_above, _some_errors).with_slips("""
    known > limit → known >= limit  # an error of exactly the limit is not above it
    100 * np.mean → np.sum  # that is their number: divide by the number of rays that are known
    return np.nanmean(errors)  # that is the mean error: count the rays above the limit
""")


def stitched(warped):
    """Mean panorama (H, W, 3) of the cameras that see each ray, of (cameras, H, W, 3); NaN where
    none does."""
    seen = np.isfinite(warped)
    count = seen.sum(axis=0)
    total = np.where(seen, warped, 0).sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _panoramas(rng: Rng, k: int) -> tuple:
    warped = rng.uniform(0, 255, (3 + k % 3, 4, 6 + k % 3, 3))
    warped[rng.uniform(0, 1, warped.shape[:3]) < 0.4] = np.nan
    warped[:, 0, 0] = np.nan  # a ray that no camera sees
    warped[0, 0, 1:] = 120
    return (warped.astype(np.float32) if k % 2 else warped,)


check_stitched = Open(stitched, _panoramas, real=lambda: (beside.warped(),)).with_slips("""
    return np.nansum(warped, axis=0)
    # that is the sum: divide by the number of cameras that see the ray
""")


def view(panorama, phi_deg, yaw_deg, fov_deg, size):
    """What a pinhole camera sees of a panorama (H, W, 3) with rows from phi_deg[0] to phi_deg[1]:
    (size, size, 3), NaN above and below; it looks to the azimuth yaw_deg, level."""
    H, W = panorama.shape[:2]
    reach = np.tan(np.radians(fov_deg / 2))
    across = reach * ((2 * np.arange(size) + 1) / size - 1)
    x, y = np.meshgrid(across, across)  # of the ray (x, y, 1) of each pixel
    theta = np.arctan2(x, 1) + np.radians(yaw_deg)
    phi = np.degrees(np.arctan2(y, np.hypot(x, 1)))
    # the pixel of the panorama in which each ray lies: columns go around, rows end
    column = np.floor((theta / (2 * np.pi) + 0.5) * W).astype(int) % W
    row = np.floor((phi - phi_deg[0]) / (phi_deg[1] - phi_deg[0]) * H).astype(int)
    known = (row >= 0) & (row < H)
    picture = np.full((size, size, 3), np.nan)
    picture[known] = panorama[row[known], column[known]]
    return picture


def _a_window(rng: Rng, k: int) -> tuple:
    H, W = 8 + k % 3, 24 + k
    panorama = rng.uniform(0, 255, (H, W, 3))
    low, high = float(rng.uniform(-60, -30)), float(rng.uniform(20, 50))
    return panorama, (low, high), float(rng.uniform(-180, 180)), float(rng.uniform(60, 120)), 9 + k


check_view = Open(view, _a_window, whole=("panorama",)).with_slips("""
    fov_deg / 2 → fov_deg  # half the field of view lies on each side
    np.arctan2(y, np.hypot(x, 1)) → np.arctan2(y, 1)
    # the elevation is the angle above the horizontal part of the ray, √(x² + 1), not above z
    .astype(int) % W → .astype(int).clip(0, W - 1)
    # the panorama is a circle: columns modulo W
    (row >= 0) & (row < H) → (row < H)  # a negative row counts from the end: it is above
    (2 * np.arange(size) + 1) / size - 1 → 2 * np.arange(size) / (size - 1) - 1
    # pixels have a width: the first one's centre is half a pixel inside
""")
