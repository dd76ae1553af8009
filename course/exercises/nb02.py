"""Notebook 02: the pose on which captures agree, the poses of a rig, the residuals of a bundle, its
minimum, covariance, shift."""

import numpy as np

import omnistereo_lib as osl
from course.exercises.compare import Rng
from course.exercises.opened import Open
from course.figures.uncertainty import shown_beside

Poses = list[osl.Pose]


def relative_pose(T_1_board, T_2_board, half_turn):
    """T_12 (camera 2 → camera 1) on which most captures agree, from the same boards' poses in both
    cameras, lists."""
    proposals = []
    for T_1b, T_2b in zip(T_1_board, T_2_board, strict=True):
        proposals += [T_1b @ T_2b.inverse(), T_1b @ half_turn @ T_2b.inverse()]
    t = np.array([T.t for T in proposals])
    agree = np.linalg.norm(t - t[:, None], axis=-1) < 0.02  # m
    return proposals[np.argmax(agree.sum(axis=1))]


def _a_pose(rng: Rng, size: float = 1.0) -> osl.Pose:
    return osl.Pose.from_vector(rng.uniform(-size, size, 6))


def _two_cameras(rng: Rng, k: int) -> tuple:
    half_turn, T_12 = (
        osl.Pose(np.diag([-1.0, -1.0, 1.0]), np.array([0.66, 0.54, 0.0])),
        _a_pose(rng),
    )
    boards = [_a_pose(rng) for _ in range(5 + k % 3)]
    if k % 4:
        # boards that face along an axis of camera 1: read from the other end, T_12 has the same z, x or y
        turn = osl.Pose(np.roll(np.eye(3), k % 4 - 1, axis=0), np.zeros(3))
        facing = [osl.Pose.from_vector([0, 0, *rng.uniform(-1, 1, 4)]) for _ in boards]
        boards = [turn @ T for T in facing]
    # as camera 2 has read them
    other_end = rng.permutation(len(boards)) < (0, 2, 3, 7)[(k + k // 4) % 4]
    seen = [T @ half_turn if other else T for T, other in zip(boards, other_end, strict=True)]
    boards[0] = _a_pose(rng)  # moved between the two exposures
    shaken = [T @ osl.Pose.from_vector(rng.normal(0, 1e-3, 6)) for T in seen]  # corners have noise
    return boards, [T_12.inverse() @ T for T in shaken], half_turn


check_relative_pose = Open(relative_pose, _two_cameras, within=0.02).with_slips("""
    [T_1b @ T_2b.inverse(), T_1b @ half_turn @ T_2b.inverse()] → [T_1b @ T_2b.inverse()]
    # either camera may have read a board from the other end: half_turn, between the board's two
    # poses
    return T_1_board[0] @ T_2_board[0].inverse()
    # that is the first capture: take the pose that most propose, within 0.02 m of each other
    T_1b @ T_2b.inverse(), T_1b @ half_turn @ T_2b.inverse()
    → T_1b.inverse() @ T_2b, T_1b.inverse() @ half_turn @ T_2b
    # the inverse belongs to camera 2's pose: from camera 2 to the board, from there to camera 1
""")


def poses_of_cameras(links, cameras):
    """T_rig_cam of all cameras, a list, in camera 0's frame; links: {(i, j): T_ij}, those of most
    captures first."""
    poses = {0: osl.Pose.identity()}
    while len(poses) < cameras:
        i, j = next((i, j) for i, j in links if (i in poses) != (j in poses))
        if i in poses:
            poses[j] = poses[i] @ links[i, j]
        else:
            poses[i] = poses[j] @ links[i, j].inverse()
    return [poses[i] for i in range(cameras)]


def _a_graph(rng: Rng, k: int) -> tuple:
    cameras = 4 + k % 3
    poses = [_a_pose(rng) for _ in range(cameras)]
    pairs = [(i, i + 1) if rng.uniform() < 0.5 else (i + 1, i) for i in range(cameras - 1)]
    pairs = [(2, 1), pairs[0], (2, 3), *pairs[3:]]  # the first one is not camera 0's
    links = {(i, j): poses[i].inverse() @ poses[j] for i, j in pairs}
    # few captures, and wrong
    return links | {(0, 2): _a_pose(rng), (cameras - 1, 0): _a_pose(rng)}, cameras


check_poses_of_cameras = Open(poses_of_cameras, _a_graph).with_slips("""
    poses = {0: osl.Pose.identity()}
    while len(poses) < cameras:
        for (i, j), T in links.items():
            if i in poses and j not in poses:
                poses[j] = poses[i] @ T
            elif j in poses and i not in poses:
                poses[i] = poses[j] @ T.inverse()
    return [poses[i] for i in range(cameras)]
    # start again at the first link after each step: a weak one must wait while a better one leads
    # on
    for i, j in links if (i in poses) != (j in poses)
    → for k in poses for i, j in links if k in (i, j) and not {i, j} <= set(poses)
    # breadth first, a weak link of camera 0 comes early: take the first link of the list that leads
    # on
    poses[i] @ links[i, j] → links[i, j] @ poses[i]
    poses[j] @ links[i, j].inverse() → links[i, j].inverse() @ poses[j]
    # the indices must meet: T_0i @ T_ij
    links[i, j].inverse() → links[i, j]
    # T_ij takes camera j to camera i: invert it to go the other way
    [poses[i] for → [poses[i].inverse() for  # those are T_cam_rig: a rig stores T_rig_cam
""")


def bundle_residuals(T_rig_cam, T_rig_board, camera, capture, found, lenses, points):
    """Predicted minus found corners (V, K, 2) in px, NaN where none was found; view v: board
    capture[v], camera[v]."""
    residuals = []
    for i, k, corners in zip(camera, capture, found, strict=True):
        in_camera = T_rig_cam[i].inverse() @ T_rig_board[k] @ points
        predicted, _ = lenses[i].project(in_camera)
        residuals.append(predicted - corners)
    return np.stack(residuals)


def _some_views(rng: Rng, k: int) -> tuple:
    poly, inverse = np.array([-200.0, 0.0, 1e-3]), np.array([314.0, 200.0])
    lenses = [
        osl.OcamCamera(poly, inverse, tuple(center), (1.0, 0.0, 0.0), (800, 768), 220.0)
        for center in rng.uniform(350, 420, (3, 2))
    ]
    T_rig_cam = [osl.Pose.identity(), _a_pose(rng, 0.3), _a_pose(rng, 0.3)]
    T_rig_board = [osl.Pose.from_vector([*rng.uniform(-0.3, 0.3, 5), 1.0]) for _ in range(4)]
    camera, capture = rng.integers(0, 3, 6 + k % 3), rng.integers(0, 4, 6 + k % 3)
    camera[:3], capture[:3] = (0, 1, 2), (3, 2, 0)
    points = np.column_stack([rng.uniform(0, 0.6, (5 + k % 2, 2)), np.zeros(5 + k % 2)])
    found = rng.uniform(300, 500, (len(camera), len(points), 2))
    found[1, 2:4] = np.nan
    return T_rig_cam, T_rig_board, camera, capture, found, tuple(lenses), points


check_bundle_residuals = Open(bundle_residuals, _some_views, within=1e-3).with_slips("""
    T_rig_cam[i].inverse() @ T_rig_board[k] → T_rig_board[k] @ T_rig_cam[i].inverse()
    # first from the board to the rig, then on
    T_rig_board[k] @ →  # the points are on the board: take them to the rig first
    T_rig_cam[i].inverse() @ →  # from the rig to the camera: T_rig_cam[i].inverse()
    lenses[i] → lenses[0]  # each camera has its own lens: lenses[i]
""")


def jacobian(misfit, x, depends):
    """Derivatives (m, n) of residuals misfit(x) (m,) by the unknowns x (n,), six for each pose.

    depends (kinds, m): the pose of each kind, such as camera and board, on which a residual
    depends; no other counts."""
    h, rows = 1e-6, np.arange(depends.shape[1])
    J = np.zeros((depends.shape[1], len(x)))
    for poses in depends:  # all poses of a kind move at once: each residual notices only its own
        for number in range(6):
            step = np.zeros((len(x) // 6, 6))
            step[poses, number] = h
            change = misfit(x + step.ravel()) - misfit(x - step.ravel())
            J[rows, 6 * poses + number] = change / (2 * h)
    return J


def _a_bundle(rng: Rng, k: int, m: int = 80) -> tuple:
    """Residuals like those of a bundle: smooth, and each depends on one of 2 cameras and one of 2 +
    k % 2 boards."""
    boards = 2 + k % 2
    depends = np.array([rng.integers(0, 2, m), 2 + rng.integers(0, boards, m)])
    depends[:, :4] = [[0, 0, 1, 1], [2, 3, 2, 3]]
    slopes, target = rng.normal(0, 1, (2, m, 6)), rng.normal(0, 0.3, m)

    def misfit(x):
        poses = x.reshape(-1, 6)[depends]  # (2, m, 6)
        return np.sum(slopes * poses + 0.1 * slopes**2 * np.sin(poses), axis=(0, 2)) - target

    return misfit, rng.normal(0, 0.1, 6 * (2 + boards)), depends


check_jacobian = Open(jacobian, _a_bundle, whole=("x", "depends")).with_slips("""
    change / (2 * h) → change / h  # the two places are 2 h apart
    misfit(x + step.ravel()) - misfit(x - step.ravel())
    → misfit(x - step.ravel()) - misfit(x + step.ravel())
    # after minus before: the step forward comes first
    # a residual depends on a board, too: on each row of depends
    for poses in depends: → for poses in depends[:1]:
    # six unknowns for each pose: 6 * poses + number
    J[rows, 6 * poses + number] → J[rows, 6 * number + poses]
""")


def gauss_newton(misfit, x, depends, held, steps):
    """Unknowns (n,) and the rms of the residuals before each step and after the last, (n + steps +
    1,) in one array.

    misfit, x, depends: as in `jacobian`. The first `held` unknowns stay as they are.
    """
    x, sizes = x.copy(), []
    for _ in range(steps):
        r = misfit(x)
        J = jacobian(misfit, x, depends)[:, held:]
        sizes.append(np.sqrt(np.mean(r**2)))
        x[held:] -= np.linalg.solve(J.T @ J, J.T @ r)
    sizes.append(np.sqrt(np.mean(misfit(x) ** 2)))
    return np.concatenate([x, sizes])


def _a_descent(rng: Rng, k: int) -> tuple:
    return *_a_bundle(rng, k), 12, 1 + k % 3


check_gauss_newton = Open(gauss_newton, _a_descent, whole=("x", "depends")).with_slips("""
    x[held:] -= → x[held:] +=  # that goes uphill: subtract the solution
    x[held:] -= np.linalg.solve(J.T @ J, J.T @ r) → x[held:] -= J.T @ r
    # the gradient alone says the direction, not how far: solve (JᵀJ) ε = Jᵀ r
    sizes.append(np.sqrt(np.mean(misfit(x) ** 2))) → sizes.append(sizes[-1])
    # the last rms is that after the last step: compute the residuals once more
    # the residuals change with each step: compute them again
    r = misfit(x) → r = misfit(x) if not sizes else r
""")


def covariance(J, residuals):
    """Covariance (n, n) of the unknowns at the minimum: Jacobian J (m, n), residuals (m,) in px."""
    m, n = J.shape
    # of one residual: n of them are used up by the unknowns
    variance = residuals @ residuals / (m - n)
    return variance * np.linalg.inv(J.T @ J)


def _a_minimum(rng: Rng, k: int) -> tuple:
    m, n = 12 + k, 3 + k % 3
    return rng.normal(0, 3, (m, n)), rng.normal(0, 0.5, m)


check_covariance = Open(covariance, _a_minimum, whole=("J", "residuals")).with_slips("""
    return variance * → return  # that is for corners of 1 px noise: multiply by their variance
    np.linalg.inv(J.T @ J) → (J.T @ J)  # a steep valley is known well: invert JᵀJ
    np.linalg.inv(J.T @ J) → (1 / (J.T @ J))  # 1 / a matrix divides number by number: np.linalg.inv
    / (m - n) → / m  # divide by m - n, not by m
    return variance → return np.sqrt(variance)  # σ² belongs there, not σ
""")


def sphere_shift(rig, wrong_rig, grid, index, pairs):
    """Spheres δ (H, W) by which the best match of things on sphere index (H, W) moves, if wrong_rig
    is taken for rig; NaN where no pair of cameras sees the ray."""
    depth = grid.index_to_depth(index)
    next_depth = grid.index_to_depth(index + 1)
    points = grid.rays() * depth[..., None]
    p, e = [], []
    for camera, T, wrong in zip(rig.cameras, rig.T_rig_cam, wrong_rig.T_rig_cam, strict=True):
        p.append(shown_beside(camera, T, T, points, next_depth))
        e.append(shown_beside(camera, T, wrong, points, depth))
    # of the pairs; NaN, what a camera does not see, drops out of the sums
    p = np.array([p[i] - p[j] for i, j in pairs])
    e = np.array([e[i] - e[j] for i, j in pairs])
    above = np.nansum(p * e, axis=(0, -1))
    below = np.nansum(p * p, axis=(0, -1))
    return -above / np.where(below > 0, below, np.nan)


def _two_rigs(rng: Rng, k: int) -> tuple:
    poly, inverse = np.array([-200.0, 0.0, 1e-3]), np.array([314.0, 200.0])
    # with the narrow ones no pair sees some rays
    fov = (220.0, 150.0)[k % 2]
    lens = osl.OcamCamera(poly, inverse, (400.0, 384.0), (1.0, 0.0, 0.0), (800, 768), fov)
    poses = [
        osl.Pose.from_vector([0, i * np.pi / 2, 0, 0.4 * np.sin(i), rng.normal(0, 0.1), np.cos(i)])
        for i in range(4)
    ]
    rig = osl.Rig([lens] * 4, poses)
    wrong = rig.with_poses([T @ osl.Pose.from_vector(rng.normal(0, 0.01, 6)) for T in poses])
    grid = osl.SphereGrid(9 + k % 3, 4, (-45, 45), 32, 1.6)
    return rig, wrong, grid, rng.uniform(1, 20, grid.shape), [(0, 1), (1, 2), (2, 3), (3, 0)]


check_sphere_shift = Open(
    sphere_shift, _two_rigs, whole=("rig", "wrong_rig", "grid", "index")
).with_slips("""
    return -above / np.where(below > 0, below, np.nan)
    → return np.nanmean(-np.sum(p * e, -1) / np.sum(p * p, -1), 0)
    # one δ for all pairs: add up over the pairs first, then divide
    return -above / np.where(below > 0, below, np.nan) → return np.nanmean(-e / p, axis=(0, -1))
    # two equations, one unknown: do not divide number by number, but Σ p·e by Σ p·p
    camera, T, wrong, points, depth → camera, T, wrong, points, next_depth
    # e is on the sphere on which the thing really is: depth, not next_depth
    camera, T, wrong → camera, wrong, T
    # the camera is where rig has it; what is wrong is the pose that is used
    p[i] - p[j] → p[i]
    e[i] - e[j] → e[i]
    # one image alone has nothing to meet: take the differences of pairs
""")
