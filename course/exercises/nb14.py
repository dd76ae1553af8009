"""Notebook 14: what is hidden from a camera, solid angles of pixels, and the patches that can bear
witness."""

import numpy as np

from course.exercises import beside
from course.exercises.compare import Rng
from course.exercises.opened import Open


def behind(center, points, inverse_depth, phi_deg, t):
    """How far lines of sight get behind surfaces (…): the largest ratio of a place's distance from
    the rig to the depth of the surface in its direction, at the fractions t (steps,) of the way
    from a camera (3,) to points (…, 3)."""
    # of the surface, 1/m, by a panorama whose rows go from phi_deg[0] to phi_deg[1]
    H, W = inverse_depth.shape
    places = center + np.multiply.outer(t, points - center)  # (steps, …, 3)
    x, y, z = np.moveaxis(places, -1, 0)
    theta, phi = np.arctan2(x, z), np.degrees(np.arctan2(y, np.hypot(x, z)))
    column = np.floor((theta / (2 * np.pi) + 0.5) * W).astype(int) % W
    row = np.floor((phi - phi_deg[0]) / (phi_deg[1] - phi_deg[0]) * H).astype(int).clip(0, H - 1)
    return (np.linalg.norm(places, axis=-1) * inverse_depth[row, column]).max(axis=0)


def _a_scene(rng: Rng, k: int) -> tuple:
    H, W = 8 + k % 3, 20 + 2 * (k % 5)
    points = rng.normal(0, 3, (3, 4 + k % 3, 3))
    points[0] = [-0.05, 0.2, -2.5] + 0.1 * rng.normal(size=points[0].shape)  # at the seam
    points[1, :2] = [0, 4, 1], [0.3, -4, 1]  # below and above the panorama
    t = np.sort(rng.uniform(0.1, 0.9, 6 + k % 2))
    return rng.normal(0, 0.4, 3), points, rng.uniform(0.1, 0.8, (H, W)), (-40.0, 45.0 + k), t


check_behind = Open(behind, _a_scene, whole=("inverse_depth",), real=beside.sight).with_slips("""
    norm(places, → norm(places - center,
    # the distance from the rig, not from the camera: the panorama holds depths from the rig
    (np.linalg.norm(places, axis=-1) * inverse_depth[row, column]).max
    → (1 / (np.linalg.norm(places, axis=-1) * inverse_depth[row, column])).max
    # the place's distance over the depth of the surface, not the other way round
    np.floor( → np.rint(  # pixel k reaches from k to k + 1: floor, not round
""")


def solid_angles(width, height, phi_deg):
    """Solid angles (height, width) in steradians of the pixels of a panorama with edges at
    elevations phi_deg."""
    low, high = np.radians(phi_deg)
    edges = np.linspace(low, high, height + 1)  # of the rows
    bands = 2 * np.pi * np.diff(np.sin(edges))  # the area of the unit sphere between two elevations
    return np.tile(bands[:, None] / width, width)


def _a_panorama(rng: Rng, k: int) -> tuple:
    return (
        int(rng.integers(5, 12)),
        int(rng.integers(3, 8)),
        (float(rng.uniform(-85, -20)), float(rng.uniform(10, 70))),
    )


check_solid_angles = Open(solid_angles, _a_panorama).with_slips("""
    np.diff(np.sin(edges)) → np.diff(edges)
    # a row near a pole is short: its area goes with cos φ, or with the difference of sin φ
    np.diff(np.sin(edges)) → np.cos((edges[1:] + edges[:-1]) / 2)
    # that is the cosine: the height of a row in radians is missing
    np.sin( → np.cos(  # sin φ at the edges, not cos φ
    / width, width → , width  # that is the area of whole rows: divide by the columns
""")


def witnesses(inverse_depth, warped, pairs):
    """Contrasts (pairs, H, W) in grey levels of patches of 5 × 5 rays, the smaller one of a pair's
    two; NaN where a patch is not seen or not on one surface."""

    def windows(panorama):  # (H, W, 25): columns go around, beyond the rows stands the last one
        padded = np.pad(panorama, ((0, 0), (2, 2)), mode="wrap")
        padded = np.pad(padded, ((2, 2), (0, 0)), mode="edge")
        return np.lib.stride_tricks.sliding_window_view(padded, (5, 5)).reshape(*panorama.shape, 25)

    around = windows(inverse_depth)
    least, most = around.min(axis=-1), around.max(axis=-1)
    one_surface = (least > 0) & (most < 1.15 * least)  # no sky, no edge
    contrasts = []
    for image in warped:
        contrast = windows(image).std(axis=-1)  # NaN if one of the 25 is
        contrasts.append(np.where(one_surface, contrast, np.nan))
    return np.stack([np.minimum(contrasts[i], contrasts[j]) for i, j in pairs])


def _some_views(rng: Rng, k: int) -> tuple:
    H, W = 9 + k % 3, 14 + k
    inverse_depth = np.full((H, W), 0.1 + 0.02 * k)
    inverse_depth[:, 3 : 5 + k % 4] = 0.5  # something near
    inverse_depth *= rng.uniform(0.96, 1.04, (H, W))
    inverse_depth[0, W // 2 :] = 0  # sky
    warped = rng.normal(100, 20, (4, H, W)) * rng.uniform(0.7, 1.5, (4, 1, 1))
    for image in warped:
        image[rng.integers(H), rng.integers(W)] = np.nan
    warped[k % 4, :, W - 3 :] = np.nan
    return inverse_depth, warped, ((0, 1), (1, 2), (2, 3), (3, 0))


check_witnesses = Open(witnesses, _some_views, whole=("warped", "pairs")).with_slips("""
    mode="wrap" → mode="edge"
    # the panorama is a circle: columns go around, np.pad with mode="wrap"
    (least > 0) & (most < 1.15 * least) → most - least < 0.15
    # it is a ratio: the nearest of the 25 rays is less than 15 % nearer than the farthest
    windows(image).std(axis=-1) → np.nanstd(windows(image), axis=-1)
    # the whole patch must be seen: NaN if one of its rays is
    windows(image).std(axis=-1) → windows(image).var(axis=-1)
    # that is the variance: its root is in grey levels
    np.minimum(contrasts[i], contrasts[j]) → np.maximum(contrasts[i], contrasts[j])
    # a pair needs texture in both images: the smaller contrast
""")
