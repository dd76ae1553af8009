"""Notebook 01: the ray of a pixel, the pixel of a ray, the pose of a plane, a residual, the
polynomial of a lens."""

import numpy as np
from scipy.spatial.transform import Rotation

import omnistereo_lib as osl
from course.exercises.compare import Rng
from course.exercises.opened import Open


def unproject(pixels, poly, center):
    """Unit rays (…, 3) of pixels (…, 2), camera frame: x right, y down, z forward."""
    xy = pixels - center
    r = np.linalg.norm(xy, axis=-1, keepdims=True)
    z = -np.polyval(poly[::-1], r)  # np.polyval wants the highest coefficient first
    rays = np.concatenate([xy, z], axis=-1)
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


def _some_pixels(rng: Rng, k: int) -> tuple:
    poly = np.array([-196.0, 0.0, 1.6e-3, -1e-7]) * rng.uniform(0.8, 1.2, 4)
    pixels = rng.uniform(0, 780, (2,) if k == 9 else (2 + k % 3, 4, 2))
    center = rng.uniform(350, 420, 2)
    return pixels, poly, tuple(center) if k % 2 else center


check_unproject = Open(unproject, _some_pixels, whole=("poly", "center")).with_slips("""
    np.linalg.norm(xy, axis=-1, keepdims=True)
    → np.sum(xy**2, axis=-1, keepdims=True)
    # that is r²: r is its root, the distance from the centre
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True) → return rays
    # divide by the length: a ray is a unit vector
    norm(rays, axis=-1, keepdims=True) → norm(rays)
    # divided by one length for all: each ray has its own, over the last axis
""")


def project_rays(rays, inv_poly, center, max_deg):
    """Pixels (…, 2) of rays (…, 3) of any length: u right, v down; NaN beyond max_deg from the
    axis."""
    x, y, z = np.moveaxis(rays, -1, 0)
    n = np.hypot(x, y)
    r = np.polyval(inv_poly[::-1], np.arctan2(-z, n))
    scale = r / np.maximum(n, 1e-12)  # on the axis x and y are 0, and so is the result
    pixels = np.stack([x * scale, y * scale], axis=-1) + center
    seen = np.degrees(np.arctan2(n, z)) <= max_deg
    return np.where(seen[..., None], pixels, np.nan)


def _some_rays(rng: Rng, k: int) -> tuple:
    F, max_deg, center = (
        rng.uniform(180, 220),
        rng.uniform(95, 110),
        tuple(rng.uniform(350, 420, 2)),
    )
    in_theta = np.poly1d([-0.05 * F, rng.uniform(-8, 8), F, 0])
    inv_poly = in_theta(np.poly1d([1, np.pi / 2])).coeffs[::-1]  # in t
    theta, around = (
        np.radians(rng.uniform(3, max_deg - 2, 9 + k % 4)),
        rng.uniform(-3, 3, 9 + k % 4),
    )
    theta[-2:] = np.radians([max_deg + 5, max_deg + 30])
    theta[0] = 0 if k else theta[0]  # on the axis
    rays = np.stack(
        [np.sin(theta) * np.cos(around), np.sin(theta) * np.sin(around), np.cos(theta)], axis=-1
    )
    rays *= rng.uniform(0.5, 5, (len(rays), 1))
    return (rays[:, None] if k % 2 else rays), inv_poly, center, max_deg


check_project_rays = Open(project_rays, _some_rays, whole=("inv_poly",), within=1e-3).with_slips("""
    np.arctan2(-z, n) → np.degrees(np.arctan2(-z, n))
    # the polynomial takes t in radians, not in degrees
    np.arctan2(-z, n) → np.arctan2(z, n)
    # the sign of z: t is the angle *below* the xy-plane, atan2(-z, n)
    np.arctan2(-z, n) → np.arctan2(n, z)  # that is the angle from the axis; t is 90° less
    np.degrees(np.arctan2(n, z)) → np.arctan2(n, z)
    # beyond max_deg there is no pixel: compare the angle from the axis, in degrees
    np.degrees(np.arctan2(n, z)) <= max_deg → z > 0
    # a fisheye sees behind itself, z < 0: compare the angle with max_deg
""")


def planar_pose(rays, points):
    """T_cam_board of a flat board, from unit rays (K, 3) to its corners (K, 3), which are in metres
    with Z = 0."""
    plane = np.column_stack([points[:, :2], np.ones(len(points))])  # p = (X, Y, 1)
    cross = np.cross(np.eye(3), rays[:, None])  # (K, 3, 3): times a vector, b × that vector
    A = (cross[..., None] * plane[:, None, None]).reshape(-1, 9)  # b × H p = A h
    H = np.linalg.svd(A, full_matrices=False)[2][-1].reshape(3, 3)
    H *= 2 / np.linalg.norm(H[:, :2], axis=0).sum()  # r1 and r2 have length 1
    H *= np.sign(np.sum(rays * (plane @ H.T)))  # the corners lie along their rays, not against them
    U, _, Vt = np.linalg.svd(H[:, :2], full_matrices=False)
    r1, r2 = (U @ Vt).T  # the nearest that are perpendicular
    return osl.Pose(np.column_stack([r1, r2, np.cross(r1, r2)]), H[:, 2])


def _a_board(rng: Rng, k: int) -> tuple:
    points = np.zeros((20 + k, 3))
    points[:, :2] = rng.uniform(0, 1, (20 + k, 2)) * [0.7, 0.5]
    pose = osl.Pose.from_vector(
        [*rng.uniform(-0.6, 0.6, 3), *rng.uniform(-1, 1, 2), rng.uniform(-0.3, 0.8)]
    )
    rays = pose @ points + rng.normal(0, 2e-5, points.shape)  # R is one to 1e-5, by step 3 only
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True), points


check_planar_pose = Open(planar_pose, _a_board, within=5e-4).with_slips("""
    H *= np.sign(np.sum(rays * (plane @ H.T))) →
    # H and -H both solve A h = 0: take the one along the rays
    np.sign(np.sum(rays * (plane @ H.T))) → np.sign(H[2, 2])
    # the origin may lie behind this lens, t_z < 0: take the H along the rays
    H *= 2 / np.linalg.norm(H[:, :2], axis=0).sum() →
    # h has length 1, and H must not: scale it so that r1 and r2 have length 1, t with them
    H[:, 2]) → H[:, 2]).inverse()  # that is T_board_cam, the way back
    np.column_stack([r1, r2, np.cross → np.stack([r1, r2, np.cross
    # r1, r2 and r3 are the columns of R, not its rows
""")


def plane_misfits(corners, points, middle, focal_lengths):
    """Misfits (F,) in px if the lens is r = f θ, for each f of focal_lengths (F,), px: the median over
    the views of how far, rms, the rays are from the plane that fits them best, times f.

    corners: of each view, (K, 2) px, NaN where not found; points (K, 3): on the board, m; middle
    (2,): of the image, px."""
    misfits = []
    for f in focal_lengths:
        of_views = []
        for found in corners:
            seen = np.isfinite(found[:, 0])
            offset = found[seen] - middle
            r = np.linalg.norm(offset, axis=1, keepdims=True)
            rays = np.hstack([offset / r * np.sin(r / f), np.cos(r / f)])
            on_plane = planar_pose(rays, points[seen]) @ points[seen]
            on_plane /= np.linalg.norm(on_plane, axis=1, keepdims=True)
            apart = np.sum((on_plane - rays) ** 2, axis=1)
            of_views.append(f * np.sqrt(np.mean(apart)))
        misfits.append(np.median(of_views))
    return np.array(misfits)


def _some_views(rng: Rng, k: int) -> tuple:
    points = np.zeros((24, 3))
    points[:, :2] = np.mgrid[:6, :4].reshape(2, -1).T * 0.1
    middle, corners = rng.uniform(300, 400, 2), []
    for _ in range(3 + k % 3):
        tilt, place = rng.uniform(-0.5, 0.5, 3), rng.uniform([-0.6, -0.5, 0.2], [0.2, 0.1, 0.8])
        x, y, z = (osl.Pose.from_vector([*tilt, *place]) @ points).T
        r = 190 * np.arctan2(np.hypot(x, y), z) / np.hypot(x, y)
        found = middle + np.stack([r * x, r * y], axis=1) + rng.normal(0, 0.2, (24, 2))
        found[rng.permutation(24)[: k % 4]] = np.nan
        corners.append(found)
    return corners, points, middle, np.sort(rng.uniform(140, 300, 4))


check_plane_misfits = Open(
    plane_misfits, _some_views, whole=("corners", "points", "middle"), within=1e-2
).with_slips("""
    np.median(of_views) → np.mean(of_views)
    # a view whose corners are wrong pulls the mean along: take the median
    on_plane /= np.linalg.norm(on_plane, axis=1, keepdims=True) →
    # rays have length 1, points on the plane do not: compare directions
    f * np.sqrt(np.mean(apart)) → np.sqrt(np.mean(apart))
    # that is an angle: times f it is in pixels, and small f are not favoured
    found[seen] - middle → found[seen]
    # r and θ count from the middle of the image: subtract it
    np.sin(r / f), np.cos(r / f) → r / f, np.ones_like(r)
    # that is a pinhole: at an angle θ = r / f from the axis a ray is (…, sin θ, cos θ)
""")


def residuals(lens, pose, points, found):
    """Predicted minus found corners (K, 2) in px, NaN where none was found; lens: k1 … k4, u0, v0;
    pose: 6 numbers."""
    x, y, z = (Rotation.from_rotvec(pose[:3]).apply(points) + pose[3:]).T
    n = np.hypot(x, y)
    r = np.polyval([*lens[3::-1], 0], np.arctan2(n, z))
    predicted = np.stack([x / n * r, y / n * r], axis=-1) + lens[4:]
    return predicted - found


def _a_view(rng: Rng, k: int) -> tuple:
    lens = np.array([195.0, 6.0, -9.0, -2.0, 400.0, 384.0]) * rng.uniform(0.8, 1.2, 6)
    pose = np.array([*rng.uniform(0.2, 0.7, 3), *rng.uniform(0.2, 0.5, 2), -0.3 if k % 2 else 0.3])
    points = np.zeros((12 + k, 3))
    points[:, :2] = rng.uniform(0.2, 0.9, (12 + k, 2))
    found = rng.uniform(300, 700, (12 + k, 2))
    found[2:4] = np.nan
    return lens, pose, points, found


check_residuals = Open(residuals, _a_view, whole=("lens", "pose"), within=1e-3).with_slips("""
    np.arctan2(n, z) → np.arctan(n / z)
    # behind the lens arctan(n / z) is negative: use arctan2(n, z)
    [*lens[3::-1], 0] → lens[3::-1]
    # k1 belongs to θ: np.polyval ends with the power 0, whose coefficient is 0
    [*lens[3::-1], 0] → [lens[3], 0, lens[2], 0, lens[1], 0, lens[0], 0]
    # all powers from θ to θ⁴, not the odd ones alone
    x / n * r, y / n * r → x * r, y * r  # x and y give the direction only: divide them by n
    x / n * r, y / n * r → y / n * r, x / n * r  # u goes with x and v with y: they are swapped
""")


def ocam_polynomial(r, theta, degree):
    """a0, 0, a2 … (degree + 1,), low to high, for which f(r) is nearest to -r / tan θ; r in px, θ
    in radians, (K,)."""
    powers = np.array([0, *range(2, degree + 1)])
    # powers of r / far are 1 at most; r⁶ in pixels is 10¹⁵, beside which lstsq loses the others
    far = r.max()
    a = np.linalg.lstsq((r[:, None] / far) ** powers, -r / np.tan(theta), rcond=None)[0]
    return np.insert(a / far**powers, 1, 0)


def _a_lens(rng: Rng, k: int) -> tuple:
    theta = np.radians(np.linspace(2, 105, 40 + k))
    r = (
        theta * rng.uniform(0.8, 1.2)
        + theta**2 * rng.uniform(0.05, 0.1)
        - theta**4 * rng.uniform(0.02, 0.04)
    )
    return (200 * r if k % 2 else r), theta, 3 + k % 6  # in pixels, too


check_ocam_polynomial = Open(ocam_polynomial, _a_lens).with_slips("""
    return np.polyfit(r, -r / np.tan(theta), degree)[::-1]
    # there is no a1: without it f has no kink on the axis. Leave r¹ out, and put a 0 for it
    return np.insert(a / far**powers, 1, 0) → return a / far**powers  # put a 0 for a1: np.insert
    -r / np.tan → -r * np.tan  # that is -r tan θ: divide by the tangent
    (r[:, None] / far) ** powers → r[:, None] ** powers
    a / far**powers → a
    # in pixels r⁶ is 10¹⁵, and lstsq takes the rest for 0: fit powers of r / r.max(), then divide
    # by those of
    # r.max()
""")
