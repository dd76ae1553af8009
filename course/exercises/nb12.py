"""Notebook 12: epipolar planes, eight points, RANSAC, points, which pose, weights, and who moved.

And `before_the_knock`, the rig file of which the notebook asks what has become wrong.
"""

import numpy as np

import omnistereo_lib as osl
from course.exercises.compare import Rng
from course.exercises.opened import Open
from omnistereo_rigs.doctor import rig_check
from omnistereo_rigs.images.relative_pose import decompositions


def epipolar_residual(x, y, T_21):
    """Angles (M,) in degrees of rays y (M, 3), camera 2, out of the epipolar planes of rays x (M,
    3), camera 1."""
    normals = np.cross(T_21.t, x @ T_21.R.T)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return np.degrees(np.arcsin(np.sum(normals * y, axis=1)))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _two_views(rng: Rng, count: int, noise: float = 0.0, size: float = 4.0) -> tuple:
    """Return the rays of points all around two cameras, and T_21."""
    T_21 = osl.Pose.from_vector([*rng.uniform(-1.5, 1.5, 3), *_unit(rng.normal(0, 1, 3))])
    points = rng.normal(0, size, (count, 3))
    return _unit(points), _unit(_unit(T_21 @ points) + rng.normal(0, noise, (count, 3))), T_21


def _some_rays(rng: Rng, k: int) -> tuple:
    x, y, T_21 = _two_views(rng, 6 + k % 3, 0.1)
    return x, y, osl.Pose(T_21.R, (0.3, 1.0, 2.0)[k % 3] * T_21.t)


check_epipolar_residual = Open(epipolar_residual, _some_rays).with_slips("""
    T_21.R.T → T_21.R  # the rotation is the wrong way round: R x, which for rays in rows is x @ R.T
    x @ T_21.R.T → x  # x is in camera 1's frame: rotate it into camera 2's first
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) →
    # divide the normals by their length: n is short where a ray runs along the baseline
    np.degrees(np.arcsin(np.sum(normals * y, axis=1))) → np.degrees(np.sum(normals * y, axis=1))
    # n · y is the sine of the angle: np.arcsin
    np.arcsin → np.arccos  # that is the angle to the normal: to the plane it is 90° less, np.arcsin
""")


def eight_point(x, y, weights):
    """Essential matrix (3, 3) of pairs of rays x, y (M, 3) with weights (M,); its entry largest in
    size is positive."""
    equations = (y[:, :, None] * x[:, None, :]).reshape(-1, 9)
    E = np.linalg.svd(np.sqrt(weights)[:, None] * equations)[2][-1].reshape(3, 3)
    U, _, Vt = np.linalg.svd(E)
    E = U @ np.diag([1, 1, 0]) @ Vt
    return E * np.sign(E.flat[np.abs(E).argmax()])


def _some_pairs(rng: Rng, k: int) -> tuple:
    count = 8 if k < 2 else 10 + k
    x, y, _ = _two_views(rng, count, 0.0 if k < 2 else 0.02)
    return x, y, rng.uniform(0.1, 1, count)


check_eight_point = Open(eight_point, _some_pairs, whole=("x", "y", "weights")).with_slips("""
    [2][-1] → [2][0]  # the first right singular vector is the worst solution: take the last
    [2][-1] → [2][:, -1]  # np.linalg.svd returns V transposed: the last row, not the last column
    U @ np.diag([1, 1, 0]) @ Vt → E  # no essential matrix yet: make its singular values 1, 1, 0
    np.sqrt(weights) → weights  # a row is squared in the sum: multiply it by the root of its weight
    np.linalg.svd(np.sqrt(weights)[:, None] * equations)
    → np.linalg.svd(np.sqrt(weights)[:, None] * equations, full_matrices=False)
    # eight pairs have a ninth right singular vector, the solution, and full_matrices=False leaves
    # it out
""")


def ransac(x, y, samples, limit):
    """Numbers (K,) of the matches that agree: |epipolar residual| < limit degrees.

    samples (S, 8): eight matches each. The best sample's agreeing matches make one more matrix,
    which decides. Samples end early once one of eight right matches has been among them with a
    probability of 99 %."""
    best = np.zeros(len(x), bool)
    for tried, eight in enumerate(samples, start=1):
        # one of four: all have the same planes
        T = decompositions(eight_point(x[eight], y[eight], np.ones(8)))[0]
        agree = np.abs(epipolar_residual(x, y, T)) < limit
        if agree.sum() > best.sum():
            best = agree
        all_right = np.mean(best) ** 8  # the probability that eight matches agree
        if (1 - all_right) ** tried < 0.01:
            break
    T = decompositions(eight_point(x[best], y[best], np.ones(best.sum())))[0]
    return np.flatnonzero(np.abs(epipolar_residual(x, y, T)) < limit)


def _some_matches(rng: Rng, k: int) -> tuple:
    x, y = _two_views(rng, 60 + k, noise=0.002)[:2]
    wrong = rng.permutation(len(x))[: 8 + 2 * k]
    y[wrong] = _unit(y[wrong] + rng.normal(0, 0.4, (len(wrong), 3)))
    samples = np.array([rng.choice(len(x), 8, replace=False) for _ in range(60)])
    samples[:2, 0] = wrong[0]  # begins with wrong ones
    return x, y, samples, 0.3


check_ransac = Open(ransac, _some_matches, whole=("x", "y", "samples")).with_slips("""
    if agree.sum() > best.sum(): → if True:
    # keep the sample with which the most matches agree, not the last one
    return np.flatnonzero(np.abs(epipolar_residual(x, y, T)) < limit) → return np.flatnonzero(best)
    # those agree with a matrix of eight matches: make one of all that agree, and ask again
    if (1 - all_right) ** tried < 0.01: → if all_right > 0.01:
    # with the probability p that a sample is right, none of n is with (1 - p)ⁿ: stop below 0.01
    np.mean(best) ** 8 → np.mean(best)
    # all eight must be right: the share to the power of 8
""")


def triangulate(x, y, T_21):
    """Points (M, 4) where rays x and y meet, camera 1's frame: unit direction u, to the side of x,
    and 1/distance."""
    T_12 = T_21.inverse()
    rows = []
    for v, c in ((x, np.zeros(3)), (y @ T_12.R.T, T_12.t)):
        across = np.eye(3) - v[:, :, None] * v[:, None, :]
        rows.append(np.concatenate([across, -(across @ c)[:, :, None]], axis=2))
    A = np.concatenate(rows, axis=1)
    points = np.linalg.eigh(A.swapaxes(1, 2) @ A)[1][:, :, 0]
    points *= np.sign(np.sum(points[:, :3] * x, axis=1, keepdims=True))
    return points / np.linalg.norm(points[:, :3], axis=1, keepdims=True)


def _some_sights(rng: Rng, k: int) -> tuple:
    x, y, T_21 = _two_views(rng, 6 + k % 3, 0.02)
    x[0], y[0] = -x[0], -y[0]  # a point behind both cameras
    y[1] = T_21.R @ x[1]  # at infinity
    return x, y, osl.Pose(T_21.R, rng.uniform(0.5, 2) * T_21.t)


check_triangulate = Open(triangulate, _some_sights).with_slips("""
    [:, :, 0] → [:, 0]  # the eigenvectors are the columns: [:, :, 0]
    [:, :, 0] → [:, :, -1]
    # np.linalg.eigh sorts from small to large, and the sum of squares is to be small: the first
    T_12.t → T_21.t  # in camera 1's frame camera 2 is at T_21.inverse().t
    y @ T_12.R.T → y  # y is in camera 2's frame: rotate it into camera 1's
    points *= np.sign(np.sum(points[:, :3] * x, axis=1, keepdims=True)) →
    # an eigenvector may have either sign: choose it so that u is to the side of x, u · x > 0
""")


def share_ahead(poses, x, y):
    """Shares (poses,) of pairs of rays x, y (M, 3) that meet ahead of both cameras, for each pose
    T_21 of a list."""
    shares = []
    for T_21 in poses:
        points = triangulate(x, y, T_21)
        from_2 = points[:, :3] @ T_21.R.T + points[:, 3:] * T_21.t
        shares.append(np.mean((points[:, 3] > 0) & (np.sum(from_2 * y, axis=1) > 0)))
    return np.array(shares)


def _some_poses(rng: Rng, k: int) -> tuple:
    x, y, T_21 = _two_views(rng, 30, 0.02, 1.0)
    t_x = np.cross(np.eye(3), T_21.t).T
    poses = [*decompositions(t_x @ T_21.R), _two_views(rng, 1)[2]]
    return [poses[i] for i in rng.permutation(5)], x, y


check_share_ahead = Open(share_ahead, _some_poses).with_slips("""
    & (np.sum(from_2 * y, axis=1) > 0) →
    # ahead of camera 2, too: y against the point in camera 2's frame
    (points[:, 3] > 0) & →  # ahead of camera 1, too: 1/distance > 0, since u is to the side of x
    (points[:, 3] > 0) → (points[:, 2] * points[:, 3] > 0)
    np.sum(from_2 * y, axis=1) > 0 → from_2[:, 2] * points[:, 3] > 0
    # a fisheye sees behind itself, z < 0: ahead means along the ray
""")


def robust_weight(residuals, scale):
    """Weights (…) of Geman and McClure: 1 for a residual of 0, a quarter at the scale, and soon
    next to nothing."""
    return (1 + (residuals / scale) ** 2) ** -2


def _some_residuals(rng: Rng, k: int) -> tuple:
    scale = rng.uniform(0.1, 3)
    return scale * rng.normal(0, 2, (8, (5, 3))[k % 2]), scale


check_robust_weight = Open(
    robust_weight, _some_residuals, real=lambda: (np.linspace(-3, 3, 121), 0.5)
).with_slips("""
    (residuals / scale) ** 2 → np.abs(residuals / scale)  # the ratio is squared
    (residuals / scale) ** 2 → residuals**2 / scale
    # divide before you square: the scale is an angle, too
    return np.exp(-((residuals / scale) ** 2))
    # that is a bell, 0.37 at the scale: 1 / (1 + (r/s)²)²
    return np.where(np.abs(residuals) < scale, 1.0, 0.0)
    # that is a threshold: the weight falls smoothly
""")


def who_moved(turns, sd):
    """What is left (cameras,) without that camera: rms of the others' turns (cameras, 3) about
    their mean, in sd."""
    left = []
    for k in range(len(turns)):
        others = np.arange(len(turns)) != k
        common = np.average(turns[others], axis=0, weights=sd[others] ** -2)
        apart = np.linalg.norm(turns[others] - common, axis=1) / sd[others]
        left.append(np.sqrt(np.mean(apart**2)))
    return np.array(left)


def _some_turns(rng: Rng, k: int) -> tuple:
    cameras = 4 + k % 3
    sd = rng.uniform(0.005, 0.03, cameras)
    turns = sd[:, None] * rng.normal(0, 0.6, (cameras, 3)) + rng.normal(0, 0.5, 3)
    turns[k % cameras] += rng.uniform(0.2, 1) * _unit(rng.normal(0, 1, 3))
    return turns, sd


check_who_moved = Open(who_moved, _some_turns).with_slips("""
    turns[others] - common → turns[others]
    # all others may share one turn, that of the whole rig: subtract their mean, and see what is
    # left
    others = np.arange(len(turns)) != k → others = np.arange(len(turns)) >= 0
    # leave camera k out: if only it moved, the others agree among each other
    weights=sd[others] ** -2 → weights=None
    # a camera that is known less well counts less: 1 / sd² in the mean
    weights=sd[others] ** -2 → weights=1 / sd[others]  # the weight of a mean is 1 / sd², not 1 / sd
""")


# --- What has been knocked


def before_the_knock(rig: osl.Rig) -> osl.Rig:
    """Return the rig as its file has it: from before somebody knocked one of its cameras."""
    return rig_check.rotate_camera(rig, 2, np.radians([0.9, 0.96, -0.72]))
