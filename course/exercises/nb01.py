"""Notebook 01: the ray of a pixel, the pixel of a ray, the pose of a plane, a residual, the polynomial of a lens."""

import numpy as np
from scipy.spatial.transform import Rotation

import omnistereo_lib as osl
from course.exercises.compare import Answer, Array, Rng
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
    return pixels, poly, rng.uniform(350, 420, 2)


def _over(axis: int | None) -> Answer:
    """Rays divided by lengths over the wrong axis."""

    def rays(pixels: Array, poly: Array, center: Array) -> Array:
        long = unproject(pixels, poly, center)
        long = long / long[..., :1] * (pixels - center)[..., :1]
        return long / np.linalg.norm(long, axis=axis, keepdims=axis is not None)

    return rays


def _long(pixels: Array, poly: Array, center: Array) -> Array:
    rays = unproject(pixels, poly, center)
    return rays / rays[..., :1] * (pixels - center)[..., :1]


check_unproject = Open(
    unproject,
    _some_pixels,
    [
        (lambda *inputs: unproject(*inputs) * [1, 1, -1], "the ray is (x, y, -f(r)): f is negative in front"),
        (lambda p, f, c: unproject(p, f, 0 * c), "x and y count from the centre: subtract it"),
        (lambda *inputs: unproject(*inputs) * [-1, -1, 1], "x and y are the pixel minus the centre, not the reverse"),
        (lambda p, f, c: unproject(p, f, c[::-1]), "the centre is (u0, v0): its parts are swapped"),
        (lambda p, f, c: unproject(p[..., ::-1], f, c), "pixels are (u, v): yours are taken as (v, u)"),
        (lambda p, f, c: unproject(p, f[::-1], c), "poly runs from low to high; np.polyval wants the highest first"),
        (lambda p, f, c: unproject(p, f[:1], c), "the whole polynomial at r, not its first coefficient alone"),
        (_long, "divide by the length: a ray is a unit vector"),
        (_over(None), "divided by one length for all: each ray has its own, over the last axis"),
        (lambda p, f, c: unproject(p + 0.5, f, c), "half a pixel off: whole numbers are pixel centres, add nothing"),
        (lambda p, f, c: unproject(np.rint(p), f, c), "do not round the pixels"),
        (lambda *inputs: np.moveaxis(unproject(*inputs), -1, 0)[..., None], "x, y, z are the last axis: (…, 3)"),
    ],
)


def project_rays(rays, inv_poly, center, max_deg):
    """Pixels (…, 2) of rays (…, 3) of any length: u right, v down; NaN beyond max_deg from the axis."""
    x, y, z = np.moveaxis(rays, -1, 0)
    n = np.hypot(x, y)
    r = np.polyval(inv_poly[::-1], np.arctan2(-z, n))
    scale = r / np.maximum(n, 1e-12)  # on the axis x and y are 0, and so is the result
    pixels = np.stack([x * scale, y * scale], axis=-1) + center
    seen = np.degrees(np.arctan2(n, z)) <= max_deg
    return np.where(seen[..., None], pixels, np.nan)


def _some_rays(rng: Rng, k: int) -> tuple:
    F, max_deg, center = rng.uniform(180, 220), rng.uniform(95, 110), rng.uniform(350, 420, 2)
    in_theta = np.poly1d([-0.05 * F, rng.uniform(-8, 8), F, 0])
    inv_poly = in_theta(np.poly1d([1, np.pi / 2])).coeffs[::-1]  # in t
    theta, around = np.radians(rng.uniform(3, max_deg - 2, 9 + k % 4)), rng.uniform(-3, 3, 9 + k % 4)
    theta[-2:] = np.radians([max_deg + 5, max_deg + 30])
    theta[0] = 0 if k else theta[0]  # on the axis
    rays = np.stack([np.sin(theta) * np.cos(around), np.sin(theta) * np.sin(around), np.cos(theta)], axis=-1)
    return rays * rng.uniform(0.5, 5, (len(rays), 1)), inv_poly, center, max_deg


def _at(change: Answer) -> Answer:
    """A projection with another angle in the place of t."""

    def pixels(rays: Array, inv_poly: Array, center: Array, max_deg: float) -> Array:
        t = change(rays[:, 2], np.hypot(rays[:, 0], rays[:, 1]))
        other = np.stack([rays[:, 0], rays[:, 1]], 1) / np.maximum(np.hypot(rays[:, 0], rays[:, 1]), 1e-12)[:, None]
        seen = np.isfinite(project_rays(rays, inv_poly, center, max_deg))
        return np.where(seen, other * np.polyval(inv_poly[::-1], t)[:, None] + center, np.nan)

    return pixels


def _undirected(rays: Array, inv_poly: Array, center: Array, max_deg: float) -> Array:
    n = np.hypot(rays[:, :1], rays[:, 1:2])
    return (project_rays(rays, inv_poly, center, max_deg) - center) * n + center


def _divided(rays: Array, *rest: Array) -> Array:
    return np.where(np.hypot(rays[:, :1], rays[:, 1:2]) > 0, project_rays(rays, *rest), np.nan)


check_project_rays = Open(
    project_rays,
    _some_rays,
    [
        (_divided, "on the axis hypot(x, y) is 0: do not divide by it there, that ray goes to the centre"),
        (_at(lambda z, n: np.arctan2(z, n)), "the sign of z: t is the angle *below* the xy-plane, atan2(-z, n)"),
        (_at(lambda z, n: np.arctan2(n, z)), "that is the angle from the axis; t is 90° less"),
        (_at(lambda z, n: np.degrees(np.arctan2(-z, n))), "the polynomial takes t in radians"),
        (
            lambda r, b, c, m: project_rays(r, b[::-1], c, m),
            "inv_poly runs from low to high; np.polyval wants it reversed",
        ),
        (
            lambda *inputs: project_rays(*inputs)[:, ::-1],
            "pixels are (u, v), right first, then down: yours are swapped",
        ),
        (lambda r, b, c, m: project_rays(r[:, [1, 0, 2]], b, c, m), "u goes with x and v with y: they are swapped"),
        (lambda r, b, c, m: project_rays(r, b, 0 * c, m), "x and y count from the centre: add it"),
        (lambda r, b, c, m: project_rays(r, b, c, 180), "beyond max_deg the lens sees nothing: NaN for both numbers"),
        (lambda r, b, c, m: project_rays(r, b, c, m / 2), "max_deg counts from the axis: do not halve it"),
        (lambda *inputs: np.nan_to_num(project_rays(*inputs)), "a ray beyond max_deg has no pixel: NaN, not 0"),
        (_undirected, "x and y give the direction only: divide them by hypot(x, y)"),
        (lambda r, b, c, m: project_rays(r, b, c, m) + 0.5, "half a pixel off: whole numbers are pixel centres"),
        (lambda *inputs: np.rint(project_rays(*inputs)), "do not round: a ray falls between pixels"),
        (lambda *inputs: project_rays(*inputs).T, "u and v are the last axis: (…, 2)"),
    ],
)


def planar_pose(rays, points):
    """T_cam_board of a flat board, from unit rays (K, 3) to its corners (K, 3), which are in metres with Z = 0."""
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
    pose = osl.Pose.from_vector([*rng.uniform(-0.6, 0.6, 3), *rng.uniform(-1, 1, 2), rng.uniform(-0.3, 0.8)])
    rays = pose @ points + rng.normal(0, 1e-6, points.shape)
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True), points


def _unscaled(rays: Array, points: Array) -> osl.Pose:
    pose = planar_pose(rays, points)
    return osl.Pose(pose.R, pose.t / np.sqrt(2 + pose.t @ pose.t))


def _at_the_middle(rays: Array, points: Array) -> osl.Pose:
    pose = planar_pose(rays, points)
    return osl.Pose(pose.R, pose @ points.mean(axis=0))


def _transposed(rays: Array, points: Array) -> osl.Pose:
    pose = planar_pose(rays, points)
    return osl.Pose(pose.R.T, pose.t)


check_planar_pose = Open(
    planar_pose,
    _a_board,
    [
        (lambda rays, points: planar_pose(-rays, points), "H and -H both solve A h = 0: take the one along the rays"),
        (_unscaled, "h has length 1, and H must not: scale it so that r1 and r2 have length 1, t with them"),
        (lambda *inputs: planar_pose(*inputs).inverse(), "that is T_board_cam, the way back"),
        (_transposed, "r1, r2 and r3 are the columns of R, not its rows"),
        (lambda rays, points: planar_pose(rays, points[:, [1, 0, 2]]), "X belongs to r1 and Y to r2: they are swapped"),
        (_at_the_middle, "t leads to the board's origin, not to the middle of its corners"),
    ],
)


def residuals(lens, pose, points, found):
    """Predicted minus found corners (K, 2) in px, NaN where none was found; lens: k1 … k4, u0, v0; pose: 6 numbers."""
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


def _seen(lens: Array, in_camera: Array, found: Array) -> Array:
    """Residuals of points in the camera's frame."""
    return residuals(lens, np.zeros(6), in_camera, found)


def _by_angle(angle: Answer) -> Answer:
    """Residuals with another angle in the place of θ."""

    def of(lens: Array, pose: Array, points: Array, found: Array) -> Array:
        x, y, z = (osl.Pose.from_vector(pose) @ points).T
        n = np.hypot(x, y)
        r = np.polyval([*lens[3::-1], 0], angle(n, z))
        return np.stack([x / n * r, y / n * r], 1) + lens[4:] - found

    return of


def _moved(change: Answer) -> Answer:
    """Residuals of points that another motion takes to the camera."""
    return lambda lens, pose, points, found: _seen(lens, change(osl.Pose.from_vector(pose), points), found)


check_residuals = Open(
    residuals,
    _a_view,
    [
        (lambda *inputs: -residuals(*inputs), "predicted minus found, not found minus predicted"),
        (_moved(lambda T, points: T.inverse() @ points), "the pose takes the board to the camera: R X + t, no inverse"),
        (_moved(lambda T, points: points @ T.R + T.t), "the rotation is transposed: R X + t"),
        (_moved(lambda T, points: points @ T.R.T), "the translation is missing: R X + t"),
        (_moved(lambda T, points: points + T.t), "the rotation is missing: R X + t"),
        (_by_angle(lambda n, z: np.arctan(n / z)), "behind the lens arctan(n / z) is negative: use arctan2(n, z)"),
        (_by_angle(lambda n, z: np.arctan2(z, n)), "θ counts from the axis: arctan2(n, z)"),
        (_by_angle(lambda n, z: np.degrees(np.arctan2(n, z))), "the polynomial takes θ in radians"),
        (lambda k, *rest: residuals(k * [1, 0, 0, 0, 1, 1], *rest), "k1 alone is an equidistant lens: add k2, k3, k4"),
        (lambda k, *rest: residuals(k[[3, 2, 1, 0, 4, 5]], *rest), "k1 belongs to θ, k4 to θ⁴: they are reversed"),
        (
            lambda k, *rest: residuals(k * [1, 1, 1, 1, 0, 0], *rest),
            "x and y count from the centre: add it",
        ),
        (lambda *inputs: np.nan_to_num(residuals(*inputs)), "a corner that was not found has no residual: NaN, not 0"),
        (lambda *inputs: np.linalg.norm(residuals(*inputs), axis=1), "those are distances: return both components"),
    ],
)


def ocam_polynomial(r, theta, degree):
    """a0, 0, a2 … (degree + 1,), low to high, for which f(r) is nearest to -r / tan θ; r in px, θ in radians, (K,)."""
    powers = [0, *range(2, degree + 1)]
    a = np.linalg.lstsq(r[:, None] ** powers, -r / np.tan(theta), rcond=None)[0]
    return np.insert(a, 1, 0)


def _a_lens(rng: Rng, k: int) -> tuple:
    theta = np.radians(np.linspace(2, 105, 40 + k))
    r = theta * rng.uniform(0.8, 1.2) + theta**2 * rng.uniform(0.05, 0.1) - theta**4 * rng.uniform(0.02, 0.04)
    return r, theta, 3 + k % 3


def _with_a1(r: Array, theta: Array, degree: int) -> Array:
    return np.polyfit(r, -r / np.tan(theta), degree)[::-1]


check_ocam_polynomial = Open(
    ocam_polynomial,
    _a_lens,
    [
        (lambda r, theta, M: -ocam_polynomial(r, theta, M), "f(r) = -r / tan θ: it is negative in front of the lens"),
        (_with_a1, "there is no a1: without it f has no kink on the axis. Leave r¹ out, and put a 0 for it"),
        (lambda *inputs: ocam_polynomial(*inputs)[::-1], "the coefficients run from low to high"),
        (lambda *inputs: np.delete(ocam_polynomial(*inputs), 1), "put a 0 for a1: np.insert"),
        (lambda r, theta, M: ocam_polynomial(r, theta, M + 1), "the highest power is r to the degree"),
        (lambda r, theta, M: ocam_polynomial(r, theta, M - 1), "the highest power is r to the degree: one is missing"),
        (lambda r, theta, M: ocam_polynomial(r, np.degrees(theta), M), "θ is in radians, as np.tan wants it"),
        (lambda r, theta, M: ocam_polynomial(r, np.pi / 2 - theta, M), "that is -r tan θ: divide by the tangent"),
    ],
)
