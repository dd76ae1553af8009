"""The rig from captures that cameras share: a spanning tree of poses, then one adjustment."""

from collections.abc import Iterator, Sequence, Sized
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

from omnistereo_lib.errors import OmnistereoError, check_type
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Floats, Pose, nearest_rotation
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.progress import Progress, silent
from omnistereo_rigs.boards.board import Board
from omnistereo_rigs.boards.bundle import bundle_adjust
from omnistereo_rigs.boards.params import (
    CalibrationParams,
    Intrinsics,
    Observations,
    collect_observations,
)
from omnistereo_rigs.boards.report import CameraReport, RigReport, name_of
from omnistereo_rigs.boards.single_camera import (
    BoardViews,
    calibrate_corners,
    check_settings,
    read_views,
)
from omnistereo_rigs.boards.solution import Solution

# Radians between the directions of a corner in two cameras: rough poses are nearer than that, gross
# errors are not.
_AGREE = 0.05
# A capture is rejected if it fits the rig so many times worse than its views fit each camera alone;
# where all do, the cameras do not move as one.
_BAD_CAPTURE = 2.0
# A camera that shares fewer captures with any other one is named in a warning.
_FEW_SHARED = 5
# So many of the rejected views are named in a message.
_SHOWN = 2
# A camera whose median error is so many times that of the others is named in a warning.
_UNLIKE = 5.0


def calibrate_rig(
    views: Sequence[Sequence[ArrayLike | None]],
    board: Board,
    image_sizes: Sequence[tuple[int, int]] | None = None,
    degree: int | None = None,
    max_fov_deg: float | None = None,
    progress: Progress = silent,
    names: Sequence[str] | None = None,
    cameras: Sequence[OcamCamera] | None = None,
) -> tuple[Rig, RigReport]:
    """Calibrate all cameras and their poses: the paper's joint minimisation (Section III-A).

    A capture is all cameras at one instant, a view one image of it; the board may move between
    captures only.

    Args:
        views: views[camera][capture]: an image, or the corners detected in one, (K, 2) px; None if
            a camera has none.
        board, progress: As for `calibrate_camera`.
        image_sizes, degree, max_fov_deg: As there, sizes for each camera; the degree is the highest
            that is chosen for a camera.
        names: What messages call the captures. None: their indices.
        cameras: Given intrinsics, one camera each: they stay as they are, and only the poses are
            found.

    Returns:
        rig: The rig frame is the frame of camera 1.

    Raises:
        OmnistereoError: If the captures of the cameras do not match in number, a camera cannot be
            calibrated by itself, two cameras are the same, or cameras are not connected through
            shared captures.

    >>> from omnistereo_rigs import Checkerboard, calibrate_rig
    >>> board = Checkerboard((8, 6), square=0.05)
    >>> true = osl.load_rig("data_samples/sunny/test")
    >>> true = osl.Rig(true.cameras[:2], true.T_rig_cam[:2])
    >>> turns = [[np.sin(k) / 2, np.pi / 4 + np.cos(k) / 3, 0, 0, 0, 0] for k in range(8)]
    >>> before = osl.Pose(np.eye(3), [-0.2, -0.1, 1.0])  # where both cameras look
    >>> boards = [true.T_rig_cam[0] @ osl.Pose.from_vector(turn) @ before for turn in turns]
    >>> views = [
    ...     [camera.project(pose.inverse() @ T @ board.points)[0] for T in boards]
    ...     for camera, pose in zip(true.cameras, true.T_rig_cam)
    ... ]
    >>> sizes = [camera.image_size for camera in true.cameras]
    >>> rig, report = calibrate_rig(views, board, sizes, degree=4)
    >>> bool(abs(rig.baselines - true.baselines)[0] < 0.001)  # metres
    True
    """
    check_type(views, Sized, "views")
    check_type(board, Board, "board")
    if len(views) < 2 or len({len(row) for row in views}) != 1:
        raise OmnistereoError(
            f"views[camera][capture] has {[len(row) for row in views]} captures; expected at least"
            " two cameras with equally many captures. Put None for captures that a camera lacks"
        )
    sizes = [None] * len(views) if image_sizes is None else image_sizes
    if len(sizes) != len(views):
        raise OmnistereoError(
            f"image_sizes has {len(sizes)} entries; expected one for each of {len(views)} cameras"
        )
    check_settings(degree, max_fov_deg)
    given: Sequence[OcamCamera | None] = [None] * len(views) if cameras is None else cameras
    if len(given) != len(views):
        raise OmnistereoError(
            f"there are {len(given)} given cameras for views of {len(views)}. Give one for each"
        )
    # Each camera by itself first: this gives its lens, the pose of the board in each of its views,
    # and the views that do not fit. The boards of the next one are found while its lens is.
    detected, single = [], []

    def read(i: int) -> BoardViews:
        of_camera = _renamed(progress, f"boards of camera {i + 1} of {len(views)}")
        return read_views(views[i], board, sizes[i], of_camera, names)

    with ThreadPoolExecutor(1) as pool:
        reading = pool.submit(read, 0)
        for i, camera in enumerate(given, start=1):
            try:
                found, size, images = reading.result()
                if i < len(views):
                    reading = pool.submit(read, i)
                _check_given(camera, size)
                lens = board, degree, max_fov_deg, camera
                report = calibrate_corners(found, size, images, *lens)[1]
            except OmnistereoError as error:
                raise OmnistereoError(f"camera {i}: {error}") from error
            single.append(report)
            detected.append(found)
    # Views that the calibration of a single camera rejected are dropped.
    corners = [
        [view if k in report.views_used else None for k, view in enumerate(row)]
        for row, report in zip(detected, single, strict=True)
    ]
    # A first rig: poses of the cameras along a tree, then the corners of all cameras in one order,
    # since a board that looks the same when turned may have been numbered from another corner.
    shared = _shared_captures(corners)
    _check_connected(shared, detected, single, names)
    T_cam_rig = _spanning_tree(shared, single, board)
    corners, rejected = _resolve_board_ambiguity(corners, single, T_cam_rig, board)
    captures = [k for k in range(len(corners[0])) if any(row[k] is not None for row in corners)]
    while True:
        # The joint adjustment, as often as it leaves a capture that fits the rig much worse than
        # the others: such a one is rejected, and all others are adjusted anew.
        params = _initial_params(corners, captures, T_cam_rig, single, cameras is not None)
        used = [[row[k] for k in captures] for row in corners]
        observations = collect_observations(used, board.points)
        params, distance = bundle_adjust(params, observations, loss="soft_l1", tolerance=1e-6)
        bad = _bad_captures(distance, observations, captures, single)
        if not bad:
            break
        rejected |= bad
        captures = [k for k in captures if k not in bad]
    solution = Solution.solve(params, observations)
    kept, reports = tuple(captures), tuple(single)
    return _build_rig(solution, kept, reports, rejected, shared, max_fov_deg, cameras)


def _renamed(progress: Progress, name: str) -> Progress:
    """Return a `progress` that calls every part by a name."""
    return lambda done, total, what: progress(done, total, what and name)


def _check_given(camera: OcamCamera | None, image_size: tuple[int, int]) -> None:
    if camera is not None and camera.image_size != tuple(image_size):
        (w, h), (width, height) = image_size, camera.image_size
        raise OmnistereoError(
            f"the images are {w} × {h} px, the given camera {width} × {height}. Pass its images, "
            f"or scale the rig file by `omnistereo rig IN OUT --size {w}x{h}`"
        )


def _shared_captures(corners: list[list[Floats | None]]) -> dict[tuple[int, int], list[int]]:
    """Return the captures that both cameras of a pair (i < j) see; one camera twice is refused."""
    shared = {}
    for i, j in combinations(range(len(corners)), 2):
        views = enumerate(zip(corners[i], corners[j], strict=True))
        both = {k: (a, b) for k, (a, b) in views if a is not None and b is not None}
        if both and all(
            np.allclose(a, b, rtol=0, atol=1e-3, equal_nan=True) for a, b in both.values()
        ):
            raise OmnistereoError(
                f"cameras {i + 1} and {j + 1} have the same corners in all {len(both)} captures"
                " that they share: they are one camera. Check that no folder of images is a copy"
                " of another"
            )
        if both:
            shared[i, j] = list(both)
    return shared


def _check_connected(
    shared: dict[tuple[int, int], list[int]],
    detected: list[list[Floats | None]],
    single: list[CameraReport],
    names: Sequence[str] | None,
) -> None:
    """Raise if captures do not connect all cameras, and name views that were rejected."""
    # Cameras are the nodes of a graph, shared captures its edges: it has to be in one piece.
    adjacent = np.zeros((len(single), len(single)))
    for pair in shared:
        adjacent[pair] = 1
    groups, label = connected_components(adjacent, directed=False)
    if groups == 1:
        return
    cameras = [" and ".join(map(str, 1 + np.flatnonzero(label == k))) for k in range(groups)]
    # If not, some views that were rejected might have joined the pieces. They are worth a message.
    lost = []
    for k, views in enumerate(zip(*detected, strict=True)):
        seen = [i for i, view in enumerate(views) if view is not None]
        if len({int(label[i]) for i in seen}) > 1:  # it would connect them
            lost += [(i, k, single[i].rejected[k]) for i in seen if k in single[i].rejected]
    remedy = (
        "Hold it 5 times or more where a camera of each group sees all of it, and check that file"
        " names match between cameras"
    )
    if lost:
        some = "; ".join(f"camera {i + 1}, {name_of(k, names)}: {w}" for i, k, w in lost[:_SHOWN])
        remedy = (
            f"{len(lost)} views that would connect them were rejected, such as {some}. Take them"
            " again"
        )
    raise OmnistereoError(
        f"cameras {' / '.join(cameras)} are not connected: no capture shows the board to both"
        f" groups. {remedy}"
    )


def _spanning_tree(
    shared: dict[tuple[int, int], list[int]], single: list[CameraReport], board: Board
) -> list[Pose]:
    """Chain poses from camera 1 along the pairs that share most captures; return T_cam_rig."""
    # The more captures a pair shares, the shorter its edge; the shortest tree takes the best pairs.
    lengths = np.zeros((len(single), len(single)))
    for pair, captures in shared.items():
        lengths[pair] = 1 / len(captures)
    tree = minimum_spanning_tree(lengths)
    order, parents = breadth_first_order(tree + tree.T, 0, directed=False)
    T_cam_rig = [Pose.identity()] * len(single)
    for j in order[1:]:
        i = int(parents[j])
        # From the parent i to its child j: T_j_rig = T_j_i T_i_rig.
        T_j_i = _relative_pose(i, int(j), shared[min(i, j), max(i, j)], single, board)
        T_cam_rig[j] = T_j_i @ T_cam_rig[i]
    return T_cam_rig


def _relative_pose(
    i: int, j: int, captures: list[int], single: list[CameraReport], board: Board
) -> Pose:
    """Return T_j_i, on which most captures agree: each proposes one for each board symmetry."""
    if len(captures) == 1 < len(board.symmetries):
        raise OmnistereoError(
            f"cameras {i + 1} and {j + 1} share one capture, and the board looks the same from "
            "another end, so it does not show how they stand to each other. Hold the board more "
            "often where both see it, in different places"
        )
    # In capture k both cameras see one board, so T_j_i = T_j_board (T_i_board S)⁻¹ if the corners
    # of camera j are those of camera i in the symmetry S of the board.
    symmetries = [board.symmetry_pose(symmetry) for symmetry in board.symmetries]
    proposals = {
        (k, s): single[j].T_cam_board[k] @ (single[i].T_cam_board[k] @ S).inverse()
        for k in captures
        for s, S in enumerate(symmetries)
    }
    # Each proposal is tried on all captures: the angle by which it misses each, in the best
    # symmetry.
    errors = {
        key: np.array([min(_direction_errors(T, i, j, k, single, board)) for k in captures])
        for key, T in proposals.items()
    }
    # The one on which most captures agree; of equally many, the one with the least median error.
    best = min(errors, key=lambda k: (-np.count_nonzero(errors[k] < _AGREE), np.median(errors[k])))
    agree = [k for k, error in zip(captures, errors[best], strict=True) if error < _AGREE]
    if len(agree) < 2 <= len(captures):
        raise OmnistereoError(
            f"the {len(captures)} captures shared by cameras {i + 1} and {j + 1} give inconsistent"
            " relative poses. Check that the cameras were synchronised, no image is mirrored and"
            " file names match"
        )
    T = proposals[best]
    chosen = [(k, int(np.argmin(_direction_errors(T, i, j, k, single, board)))) for k in agree]
    # The rotation nearest to all of them, and the median translation.
    poses = [proposals[key] for key in chosen]
    nearest = nearest_rotation(np.mean([pose.R for pose in poses], axis=0))
    return Pose(nearest, np.median([pose.t for pose in poses], axis=0))


def _direction_errors(
    T_j_i: Pose, i: int, j: int, k: int, single: list[CameraReport], board: Board
) -> list[float]:
    """Return, for each symmetry, the angle between the corners of both cameras, radians."""
    # The corners as camera j sees them, and where the pose of camera i puts them.
    seen = _unit(single[j].T_cam_board[k] @ board.points)
    expected = _unit(T_j_i @ (single[i].T_cam_board[k] @ board.points))
    return [
        float(np.median(np.linalg.norm(expected[symmetry] - seen, axis=1)))
        for symmetry in board.symmetries
    ]


def _unit(points: Floats) -> Floats:
    return points / np.linalg.norm(points, axis=-1, keepdims=True)


def _resolve_board_ambiguity(
    corners: list[list[Floats | None]],
    single: list[CameraReport],
    T_cam_rig: list[Pose],
    board: Board,
) -> tuple[list[list[Floats | None]], dict[int, str]]:
    """Reorder corners to match the first camera of each capture.

    Returns:
        corners: None in captures that are rejected.
        rejected: Capture → reason: two cameras have the board in different places.
    """
    corners, rejected = [list(row) for row in corners], {}
    for k in range(len(corners[0])):
        views = {i: view for i, row in enumerate(corners) if (view := row[k]) is not None}
        first, *others = views or [0]
        for j in others:
            # The symmetry in which the corners of both cameras have about the same directions is
            # the right one; its inverse, argsort, puts those of camera j into the order of the
            # first camera.
            T_j_first = T_cam_rig[j] @ T_cam_rig[first].inverse()
            errors = _direction_errors(T_j_first, first, j, k, single, board)
            corners[j][k] = views[j][np.argsort(board.symmetries[int(np.argmin(errors))])]
            if min(errors) > _AGREE:
                rejected[k] = (
                    f"cameras {first + 1} and {j + 1} see the board {np.degrees(min(errors)):.1f}°"
                    " apart: it moved between their exposures, was misdetected, or the captures do"
                    " not belong together"
                )
    for row in corners:
        row[:] = [None if k in rejected else view for k, view in enumerate(row)]
    return corners, rejected


def _bad_captures(
    distance: Floats, observations: Observations, captures: list[int], single: list[CameraReport]
) -> dict[int, str]:
    """Return captures that fit each camera, but the rig much worse than others of the same ones."""
    ratios: dict[tuple[int, ...], dict[int, float]] = {}
    reasons = {}
    for k, capture in enumerate(captures):
        cameras = tuple(int(i) for i in np.unique(observations.camera[observations.capture == k]))
        if len(cameras) > 1:
            # Its error in the rig, against the error of the same views in each camera by itself.
            joint = float(np.median(distance[observations.capture == k]))
            alone = [single[i].distances(capture) for i in cameras]
            usual = float(np.median(np.concatenate(alone)))
            ratios.setdefault(cameras, {})[capture] = joint / usual
            reasons[capture] = (
                f"reprojection error {joint:.2f} px, {usual:.2f} px in each camera by itself: the"
                " board moved between the exposures of cameras"
                f" {' and '.join(str(i + 1) for i in cameras)}, or was misdetected"
            )
    bad: dict[int, str] = {}
    for group in ratios.values():
        # If most captures of the same cameras have a high ratio, no single one is to blame.
        typical = sorted(group.values())[(len(group) - 1) // 2]
        bad |= {
            capture: reasons[capture]
            for capture, r in group.items()
            if r > _BAD_CAPTURE * max(1, typical)
        }
    return bad


def _initial_params(
    corners: list[list[Floats | None]],
    captures: list[int],
    T_cam_rig: list[Pose],
    single: list[CameraReport],
    fixed_intrinsics: bool,
) -> CalibrationParams:
    """Take each board pose from the first camera of the capture."""
    degree = max(report.degree for report in single)
    boards = []
    for k in captures:
        i = next(i for i, row in enumerate(corners) if row[k] is not None)
        boards.append(T_cam_rig[i].inverse() @ single[i].T_cam_board[k])
    intrinsics = tuple(report.intrinsics.with_degree(degree) for report in single)
    return CalibrationParams(intrinsics, tuple(T_cam_rig), tuple(boards), fixed_intrinsics)


def _build_rig(
    solution: Solution,
    captures: tuple[int, ...],
    single: tuple[CameraReport, ...],
    rejected: dict[int, str],
    shared: dict[tuple[int, int], list[int]],
    max_fov_deg: float | None,
    given: Sequence[OcamCamera] | None,
) -> tuple[Rig, RigReport]:
    cameras, joint = [], []
    for i, before in enumerate(single):
        name = f"camera {i + 1}"
        found = solution.camera_report(i, captures, before.rejected, before.cv_error_px, name)
        camera, camera_report = found.build_camera(given[i].max_fov_deg if given else max_fov_deg)
        cameras.append(camera)
        joint.append(camera_report)
    params = solution.params
    counts = {pair: len(set(numbers) - set(rejected)) for pair, numbers in shared.items()}
    known = tuple(joint), single, captures, rejected, counts
    report = RigReport(*known, params, solution.covariance, solution.sigma_px)
    T_rig_cam = [pose.inverse() for pose in params.T_cam_rig]
    if given:
        # The optimiser turns each camera about its axis so that A is symmetric (see `params`).
        # Given cameras stay as they are, so their poses are turned back.
        rolls = [Intrinsics.of_camera(camera)[1] for camera in given]
        cameras = list(given)
        first = rolls[0].inverse()
        T_rig_cam = [first @ T @ roll for T, roll in zip(T_rig_cam, rolls, strict=True)]
    rig = Rig(cameras, T_rig_cam)
    return rig, replace(report, warnings=tuple(_rig_warnings(report)))


def _median_px(report: CameraReport, views: Sequence[int]) -> float:
    """Return the median error in some views of a camera."""
    return float(np.median(np.concatenate([report.distances(view) for view in views])))


def _rig_warnings(report: RigReport) -> Iterator[str]:
    own = [_median_px(single, single.views_used) for single in report.single_camera]
    for i, error in enumerate(own):
        usual = float(np.median(own[:i] + own[i + 1 :]))
        if error >= _UNLIKE * usual:
            yield (
                f"camera {i + 1} has a median error of {error:.2f} px by itself,"
                f" {error / usual:.0f} times that of the others ({usual:.2f} px). Check its images"
                " for a second board, blur, and another focus or zoom"
            )
    # of each camera: how many captures it shares with the one with which it shares most
    most = [max(n for pair, n in report.shared.items() if i in pair) for i in range(len(own))]
    if few := [i for i, count in enumerate(most) if count < _FEW_SHARED]:
        cameras = ", ".join(str(i + 1) for i in few)
        whose = f"cameras {cameras} share" if len(few) > 1 else f"camera {cameras} shares"
        yield (
            f"{whose} at most {max(most[i] for i in few)} captures with any other. Hold the board"
            " more often where two cameras see it, in different places"
        )
    for i, (camera, single) in enumerate(zip(report.joint, report.single_camera, strict=True)):
        # Only captures that two cameras see can show that the cameras moved against each other.
        others = [one.views_used for one in report.joint if one is not camera]
        common = [k for k in camera.views_used if any(k in views for views in others)]
        if common:
            joint, usual = _median_px(camera, common), _median_px(single, common)
            if joint > _BAD_CAPTURE * usual:
                yield (
                    f"camera {i + 1} has a reprojection error of {joint:.2f} px in shared captures,"
                    f" {usual:.2f} px by itself. Check that the images of a capture were taken at"
                    " the same time and no camera moved"
                )
