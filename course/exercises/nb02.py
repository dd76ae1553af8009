"""Notebook 02: the pose on which captures agree, the poses of a rig, the residuals of a bundle, covariance, shift."""

import numpy as np

import omnistereo_lib as osl
from course.exercises.compare import Answer, Array, Rng
from course.exercises.opened import Open

Poses = list[osl.Pose]


def relative_pose(T_1_board, T_2_board, half_turn):
    """T_12 (camera 2 → camera 1) on which most captures agree, from the same boards' poses in both cameras, lists."""
    proposals = []
    for T_1b, T_2b in zip(T_1_board, T_2_board, strict=True):
        proposals += [T_1b @ T_2b.inverse(), T_1b @ half_turn @ T_2b.inverse()]
    t = np.array([T.t for T in proposals])
    agree = np.linalg.norm(t - t[:, None], axis=-1) < 0.02  # m
    return proposals[np.argmax(agree.sum(axis=1))]


def _a_pose(rng: Rng, size: float = 1.0) -> osl.Pose:
    return osl.Pose.from_vector(rng.uniform(-size, size, 6))


def _two_cameras(rng: Rng, k: int) -> tuple:
    half_turn, T_12 = osl.Pose(np.diag([-1.0, -1.0, 1.0]), [0.66, 0.54, 0.0]), _a_pose(rng)
    boards = [_a_pose(rng) for _ in range(5 + k % 3)]
    other_end = rng.permutation(len(boards)) < (0, 2, 3, 7)[k % 4]  # as camera 2 has read them
    seen = [T @ half_turn if other else T for T, other in zip(boards, other_end, strict=True)]
    boards[0] = _a_pose(rng)  # moved between the two exposures
    return boards, [T_12.inverse() @ T for T in seen], half_turn


def _voted(propose: Answer) -> Answer:
    """The most frequent of other proposals."""

    def pose(T_1_board: Poses, T_2_board: Poses, half_turn: osl.Pose) -> osl.Pose:
        pairs = zip(T_1_board, T_2_board, strict=True)
        proposals = [T for T_1b, T_2b in pairs for T in propose(T_1b, T_2b, half_turn)]
        t = np.array([T.t for T in proposals])
        return proposals[np.argmax((np.linalg.norm(t - t[:, None], axis=-1) < 0.02).sum(axis=1))]

    return pose


check_relative_pose = Open(
    relative_pose,
    _two_cameras,
    [
        (lambda *inputs: relative_pose(*inputs).inverse(), "that is T_21, camera 1 → camera 2: the way back"),
        (
            lambda a, b, half: a[0] @ b[0].inverse(),
            "that is the first capture alone: take the pose that most of them propose",
        ),
        (
            _voted(lambda a, b, half: [a @ b.inverse()]),
            "either camera may have read a board from the other end: half_turn",
        ),
        (_voted(lambda a, b, half: [a @ half @ b.inverse()]), "not every board was read from two ends: propose both"),
        (
            _voted(lambda a, b, half: [half @ a @ b.inverse(), a @ b.inverse()]),
            "the half turn takes the board to itself: it belongs between the board's two poses",
        ),
        (_voted(lambda a, b, half: [a @ b, a @ half @ b]), "the indices must meet: from camera 2 to the board, T_2b⁻¹"),
        (
            _voted(lambda a, b, half: [a.inverse() @ b, a.inverse() @ half @ b]),
            "the inverse belongs to camera 2's pose: from camera 2 to the board, from there to camera 1",
        ),
    ],
)


def poses_of_cameras(links, cameras):
    """T_rig_cam of all cameras, a list, in camera 0's frame; links: {(i, j): T_ij}, those of most captures first."""
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
    return links | {(0, 2): _a_pose(rng), (cameras - 1, 0): _a_pose(rng)}, cameras  # few captures, and wrong


def _in_passes(links: dict, cameras: int) -> Poses:
    poses = {0: osl.Pose.identity()}
    while len(poses) < cameras:
        for (i, j), T in links.items():
            if i in poses and j not in poses:
                poses[j] = poses[i] @ T
            elif j in poses and i not in poses:
                poses[i] = poses[j] @ T.inverse()
    return [poses[i] for i in range(cameras)]


def _with(step: Answer) -> Answer:
    """The same tree, with another step to the next camera."""

    def found(links: dict, cameras: int) -> Poses:
        poses, both = {0: osl.Pose.identity()}, links | {(j, i): T.inverse() for (i, j), T in links.items()}
        while len(poses) < cameras:
            i, j = next((i, j) for i, j in links if (i in poses) != (j in poses))
            i, j = (i, j) if i in poses else (j, i)
            poses[j] = step(poses[i], both[i, j])
        return [poses[i] for i in range(cameras)]

    return found


check_poses_of_cameras = Open(
    poses_of_cameras,
    _a_graph,
    [
        (_in_passes, "start again at the first link after each step: a weak one must wait while a better one leads on"),
        (_with(lambda T, step: step @ T), "the indices must meet: T_0i @ T_ij"),
        (_with(lambda T, step: T @ step.inverse()), "T_ij takes camera j to camera i: invert it to go the other way"),
        (_with(lambda T, step: step), "those are the links: multiply by the pose of the camera that is known"),
        (
            lambda *inputs: [T.inverse() for T in poses_of_cameras(*inputs)],
            "those are T_cam_rig: a rig stores T_rig_cam",
        ),
        (lambda *inputs: poses_of_cameras(*inputs)[1:], "camera 0 belongs to it: the identity comes first"),
    ],
)


def bundle_residuals(T_rig_cam, T_rig_board, camera, capture, found, lenses, points):
    """Predicted minus found corners (V, K, 2) in px, NaN where none was found; view v: board capture[v], camera[v]."""
    residuals = []
    for i, k, corners in zip(camera, capture, found, strict=True):
        in_camera = T_rig_cam[i].inverse() @ T_rig_board[k] @ points
        predicted, _ = lenses[i].project(in_camera)
        residuals.append(predicted - corners)
    return np.stack(residuals)


def _some_views(rng: Rng, k: int) -> tuple:
    lenses = [
        osl.OcamCamera([-200.0, 0.0, 1e-3], [314.0, 200.0], tuple(center), (1.0, 0.0, 0.0), (800, 768), 220.0)
        for center in rng.uniform(350, 420, (3, 2))
    ]
    T_rig_cam = [osl.Pose.identity(), _a_pose(rng, 0.3), _a_pose(rng, 0.3)]
    T_rig_board = [osl.Pose.from_vector([*rng.uniform(-0.3, 0.3, 5), 1.0]) for _ in range(4)]
    camera, capture = rng.integers(0, 3, 6 + k % 3), rng.integers(0, 4, 6 + k % 3)
    camera[:3], capture[:3] = (0, 1, 2), (3, 2, 0)
    points = np.column_stack([rng.uniform(0, 0.6, (5 + k % 2, 2)), np.zeros(5 + k % 2)])
    found = rng.uniform(300, 500, (len(camera), len(points), 2))
    found[1, 2:4] = np.nan
    return T_rig_cam, T_rig_board, camera, capture, found, lenses, points


def _seen(into_camera: Answer) -> Answer:
    """Residuals of points that another way takes to the camera."""

    def residuals(
        T_cam: Poses, T_board: Poses, camera: Array, capture: Array, found: Array, lenses: list, points: Array
    ) -> Array:
        views = zip(camera, capture, found, strict=True)
        return np.stack([lenses[i].project(into_camera(T_cam[i], T_board[k], points))[0] - uv for i, k, uv in views])

    return residuals


check_bundle_residuals = Open(
    bundle_residuals,
    _some_views,
    [
        (lambda *inputs: -bundle_residuals(*inputs), "predicted minus found, not found minus predicted"),
        (_seen(lambda T, board, points: T @ board @ points), "T_rig_cam leads to the rig: take its .inverse()"),
        (_seen(lambda T, board, points: board @ T.inverse() @ points), "first from the board to the rig, then on"),
        (
            _seen(lambda T, board, points: T.inverse() @ board.inverse() @ points),
            "T_rig_board leads to the rig already",
        ),
        (
            _seen(lambda T, board, points: T.inverse() @ points),
            "the points are on the board: take them to the rig first",
        ),
        (_seen(lambda T, board, points: board @ points), "from the rig to the camera: T_rig_cam[i].inverse()"),
        (
            lambda *inputs: bundle_residuals(*inputs[:5], inputs[5][:1] * 3, inputs[6]),
            "each camera has its own lens: lenses[i]",
        ),
        (lambda *inputs: np.nan_to_num(bundle_residuals(*inputs)), "a corner that was not found is no error of 0: NaN"),
        (
            lambda *inputs: np.linalg.norm(bundle_residuals(*inputs), axis=-1),
            "those are distances: return both components",
        ),
        (lambda *inputs: bundle_residuals(*inputs).reshape(-1, 2), "one array for each view: np.stack, (V, K, 2)"),
    ],
)


def covariance(J, residuals):
    """Covariance (n, n) of the unknowns at the minimum: Jacobian J (m, n), residuals (m,) in px."""
    m, n = J.shape
    variance = residuals @ residuals / (m - n)  # of one residual: n of them are used up by the unknowns
    return variance * np.linalg.inv(J.T @ J)


def _a_minimum(rng: Rng, k: int) -> tuple:
    m, n = 12 + k, 3 + k % 3
    return rng.normal(0, 3, (m, n)), rng.normal(0, 0.5, m)


def _variance(J: Array, r: Array) -> float:
    return r @ r / (len(r) - J.shape[1])


check_covariance = Open(
    covariance,
    _a_minimum,
    [
        (lambda J, r: np.linalg.inv(J.T @ J), "that is for corners of 1 px noise: multiply by their variance"),
        (lambda J, r: _variance(J, r) * (J.T @ J), "a steep valley is known well: invert JᵀJ"),
        (lambda J, r: covariance(J, r) * (len(r) - J.shape[1]) / len(r), "divide by m - n, not by m"),
        (lambda J, r: covariance(J, r) * (len(r) - J.shape[1]), "the mean of the squares, not their sum"),
        (lambda J, r: covariance(J, r) / np.sqrt(_variance(J, r)), "σ² belongs there, not σ"),
        (lambda J, r: np.var(r) * np.linalg.inv(J.T @ J), "their mean is not subtracted: r · r / (m - n)"),
        (lambda J, r: np.diag(covariance(J, r)), "those are the variances alone: return the whole matrix"),
        (lambda J, r: np.sqrt(np.diag(covariance(J, r))), "those are the deviations: return the whole matrix"),
        (lambda J, r: _variance(J, r) / (J.T @ J), "1 / a matrix divides number by number: np.linalg.inv"),
    ],
)


def sphere_shift(parallax, errors, pairs):
    """Spheres δ (H, W) by which the best match moves; NaN where no pair sees the ray.

    parallax, errors: how far each camera's image moves by one sphere, and by the wrong pose; (cameras, H, W, 2) in
    radians, NaN where a camera does not see the ray.
    """
    p = np.array([parallax[i] - parallax[j] for i, j in pairs])
    e = np.array([errors[i] - errors[j] for i, j in pairs])
    above, below = np.nansum(p * e, axis=(0, -1)), np.nansum(p * p, axis=(0, -1))
    return -above / np.where(below > 0, below, np.nan)


def _some_images(rng: Rng, k: int) -> tuple:
    pairs, shape = [(0, 1), (1, 2), (2, 3), (3, 0)], (4, 3, 4 + k % 3, 2)
    parallax, errors = rng.normal(0, 0.01, shape), rng.normal(0, 0.02, shape)
    unseen = rng.uniform(0, 1, shape[:3]) < 0.2
    unseen[:3, 0, 0] = unseen[::2, 0, 1] = True  # no pair is left
    unseen[:, 1, 0] = False
    parallax[unseen] = errors[unseen] = np.nan
    return parallax, errors, pairs


def _pairs_of(values: Array, pairs: list) -> Array:
    return np.array([values[i] - values[j] for i, j in pairs])


def _by_pairs(shift: Answer) -> Answer:
    """A shift from the differences of all pairs, NaN where no pair sees the ray."""

    def found(parallax: Array, errors: Array, pairs: list) -> Array:
        p, e = _pairs_of(parallax, pairs), _pairs_of(errors, pairs)
        return np.where(np.isfinite(p).any(axis=(0, -1)), shift(p, e), np.nan)

    return found


check_sphere_shift = Open(
    sphere_shift,
    _some_images,
    [
        (lambda *inputs: -sphere_shift(*inputs), "the shift has to undo the error: minus"),
        (
            _by_pairs(lambda p, e: np.nanmean(-np.sum(p * e, -1) / np.sum(p * p, -1), 0)),
            "one δ for all pairs: add up over the pairs first, then divide",
        ),
        (
            _by_pairs(lambda p, e: np.nanmean(-e / p, axis=(0, -1))),
            "two equations, one unknown: do not divide number by number, but Σ p·e by Σ p·p",
        ),
        (
            _by_pairs(lambda p, e: -np.sum(p * e, axis=(0, -1)) / np.sum(p * p, axis=(0, -1))),
            "a pair that does not see the ray is NaN and spoils the others: leave it out, np.nansum",
        ),
        (lambda *inputs: np.nan_to_num(sphere_shift(*inputs)), "where no pair sees the ray, nothing is known: NaN"),
        (
            _by_pairs(lambda p, e: -np.sqrt(np.nansum(e * e, axis=(0, -1)) / np.nansum(p * p, axis=(0, -1)))),
            "that compares lengths: only the part of e along p can be undone",
        ),
        (lambda p, e, pairs: sphere_shift(p[..., :1], e[..., :1], pairs), "both directions, along θ and along φ"),
        (lambda p, e, pairs: sphere_shift(p, e, [(i, j) for i in range(4) for j in range(i)]), "only the given pairs"),
        (
            _by_pairs(lambda p, e: -np.nansum(p * e, axis=(0, -1)) / np.sqrt(np.nansum(p * p, axis=(0, -1)))),
            "divide by Σ p·p, not by its root: that is a length in radians, not a number of spheres",
        ),
        (
            lambda p, e, pairs: np.where(
                np.isfinite(sphere_shift(p, e, pairs)),
                -np.nansum(p * e, axis=(0, -1)) / np.nansum(p * p, axis=(0, -1)),
                np.nan,
            ),
            "one image alone has nothing to meet: take the differences of pairs",
        ),
    ],
)
