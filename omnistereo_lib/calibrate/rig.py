"""The rig from captures that its cameras share: a spanning tree of relative poses, then one joint adjustment."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

from omnistereo_lib.calibrate.board import Checkerboard
from omnistereo_lib.calibrate.bundle import Bundle, Estimate, Observations, adjust, observations
from omnistereo_lib.calibrate.camera import calibrate_corners, camera_report, finish, read_views, refine, uncertainty
from omnistereo_lib.calibrate.detect import Progress
from omnistereo_lib.calibrate.report import CameraReport, RigReport
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.rig import Rig

Floats = NDArray[np.float64]

_AGREE = 0.05  # radians between where two cameras have a corner: rough poses are nearer, gross errors are not
_BAD_CAPTURE = 2.0  # times the error of its views in each camera alone
_FEW_SHARED = 5
_APART = 1.5  # the same for shared captures on the whole: then the cameras do not move as one


def calibrate_rig(
    views: Sequence[Sequence[ArrayLike | None]],
    board: Checkerboard,
    image_sizes: Sequence[tuple[int, int]] | None = None,
    degree: int | None = None,
    max_fov_deg: float | None = None,
    progress: Progress = iter,
    names: Sequence[str] | None = None,
) -> tuple[Rig, RigReport]:
    """Calibrate all cameras of a rig and where they stand: the paper's joint minimisation (Section III-A).

    Parameters
    ----------
    views : nested sequence
        views[camera][capture]: an image, or the corners detected in one, (K, 2) px; None where a camera has none.
        The views of one capture were taken at the same time; the board may move between captures only.
    board : Checkerboard
    image_sizes : sequence of (int, int), optional
        Width and height for each camera, needed where the views are corners.
    degree : int, optional
        Of the polynomials. None: as high as the most demanding camera's held-back views ask for.
    max_fov_deg : float, optional
        Full field of view of the cameras. None: as far as each saw corners.
    progress : callable
        Wraps each camera's images while boards are looked for, as `tqdm` does.
    names : sequence of str, optional
        What messages call the captures. None: their indices.

    Returns
    -------
    rig : Rig
        Camera 1's frame is the rig's.
    report : RigReport

    Raises
    ------
    OmnistereoError
        If the captures of the cameras do not match in number, a camera cannot be calibrated by itself, or
        cameras are not connected through captures that they share.
    """
    count = {len(row) for row in views}
    if len(views) < 2 or len(count) != 1:
        raise OmnistereoError(
            f"views[camera][capture] needs two or more cameras with equally many captures, None where a camera has "
            f"none; got {[len(row) for row in views]} captures"
        )
    sizes = image_sizes or [None] * len(views)
    corners, alone = [], []
    for i, (row, size) in enumerate(zip(views, sizes, strict=True), start=1):
        try:
            found, size, images = read_views(row, board, size, progress, names)
            alone.append(calibrate_corners(found, size, images, board, degree, max_fov_deg)[1])
        except OmnistereoError as error:
            raise OmnistereoError(f"camera {i}: {error}") from error
        corners.append(found)
    # What one camera could not explain is no use to the others.
    corners = [
        [row[k] if k in report.views_used else None for k in range(len(row))]
        for row, report in zip(corners, alone, strict=True)
    ]
    shared = shared_captures(corners)
    _check_distinct(corners, shared)
    T_cam_rig = _spanning_tree(shared, alone, board)
    left_out = _read_from_one_end(corners, alone, T_cam_rig, board)
    captures = [k for k in range(len(corners[0])) if k not in left_out and any(row[k] is not None for row in corners)]
    while True:
        estimate = _joint_start(corners, captures, T_cam_rig, alone)
        seen = _observe(corners, captures, board)
        estimate = adjust(estimate, seen, loss="soft_l1", tolerance=1e-6)
        bad = _bad_captures(estimate, seen, captures, alone)
        if not bad:
            break
        left_out |= bad
        captures = [k for k in captures if k not in bad]
    estimate, kept = refine(estimate, seen)
    report = _report(estimate, seen, kept, captures, alone, left_out, shared, board)
    return _finish(report, max_fov_deg)


# --- The spanning tree ------------------------------------------------------------------------------------


def shared_captures(corners: Sequence[Sequence[Floats | None]]) -> dict[tuple[int, int], list[int]]:
    """Return which captures each pair of cameras (i < j) shares; pairs without any are left out."""
    shared = {
        (i, j): [k for k, (a, b) in enumerate(zip(corners[i], corners[j], strict=True)) if a is not None is not b]
        for i, j in combinations(range(len(corners)), 2)
    }
    return {pair: captures for pair, captures in shared.items() if captures}


def _check_distinct(corners: Sequence[Sequence[Floats | None]], shared: dict[tuple[int, int], list[int]]) -> None:
    for (i, j), captures in shared.items():
        if all(np.allclose(corners[i][k], corners[j][k], rtol=0, atol=1e-3, equal_nan=True) for k in captures):
            raise OmnistereoError(
                f"cameras {i + 1} and {j + 1} have the same corners in all {len(captures)} captures that they share: "
                "they are one camera. Check that no folder of images is a copy of another"
            )


def _spanning_tree(
    shared: dict[tuple[int, int], list[int]], alone: list[CameraReport], board: Checkerboard
) -> list[Pose]:
    """Chain relative poses from camera 1 along the pairs that share most captures; returns T_cam_rig."""
    lengths = np.zeros((len(alone), len(alone)))
    for pair, captures in shared.items():
        lengths[pair] = 1 / len(captures)
    groups, label = connected_components(lengths, directed=False)
    if groups > 1:
        names = [" and ".join(str(i + 1) for i in np.flatnonzero(label == group)) for group in range(groups)]
        raise OmnistereoError(
            f"cameras {' / '.join(names)} are not connected: no capture shows the board to both groups. Hold it where "
            "a camera of one group and a camera of the other see all of it at the same time, 5 times or more. "
            "Are the captures of all cameras named alike?"
        )
    tree = minimum_spanning_tree(lengths)
    order, parents = breadth_first_order(tree + tree.T, 0, directed=False)
    T_cam_rig = [Pose.identity()] * len(alone)
    for j in order[1:]:
        i = int(parents[j])
        T_cam_rig[j] = _relative_pose(i, int(j), shared[min(i, j), max(i, j)], alone, board) @ T_cam_rig[i]
    return T_cam_rig


def _relative_pose(i: int, j: int, captures: list[int], alone: list[CameraReport], board: Checkerboard) -> Pose:
    """Return T_j_i, on which most shared captures agree: each proposes one for each reading of the board."""
    readings = range(len(board.readings))
    proposals = {(k, reading): _proposal(i, j, k, reading, alone, board) for k in captures for reading in readings}
    misfits = {
        which: np.array([min(_misfits(T, i, j, k, alone, board)) for k in captures]) for which, T in proposals.items()
    }
    best = min(misfits, key=lambda which: (-np.sum(misfits[which] < _AGREE), np.median(misfits[which])))
    agree = [k for k, misfit in zip(captures, misfits[best], strict=True) if misfit < _AGREE]
    if len(agree) < 2 <= len(captures):
        raise OmnistereoError(
            f"the {len(captures)} captures that cameras {i + 1} and {j + 1} share contradict each other: did both "
            "cameras take them at the same time, are the images of one mirrored, or captures named wrongly?"
        )
    chosen = {k: int(np.argmin(_misfits(proposals[best], i, j, k, alone, board))) for k in agree}
    return _mean_pose([proposals[which] for which in chosen.items()])


def _proposal(i: int, j: int, k: int, reading: int, alone: list[CameraReport], board: Checkerboard) -> Pose:
    """Return T_j_i if camera j read capture k's board as camera i would in that one of the board's readings."""
    T_i_board = alone[i].T_cam_board[k] @ board.turn(board.readings[reading])
    return alone[j].T_cam_board[k] @ T_i_board.inverse()


def _misfits(T_j_i: Pose, i: int, j: int, k: int, alone: list[CameraReport], board: Checkerboard) -> list[float]:
    """Return, for each reading, the angle between where camera j sees the corners and where camera i has them."""
    seen = _unit(alone[j].T_cam_board[k] @ board.points)
    there = _unit(T_j_i @ (alone[i].T_cam_board[k] @ board.points))
    return [float(np.median(np.linalg.norm(there[reading] - seen, axis=1))) for reading in board.readings]


def _unit(points: Floats) -> Floats:
    return points / np.linalg.norm(points, axis=-1, keepdims=True)


def _mean_pose(poses: list[Pose]) -> Pose:
    """Return the rotation nearest to all of them and the median translation."""
    U, _, Vt = np.linalg.svd(np.mean([pose.R for pose in poses], axis=0))
    nearest = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return Pose(nearest, np.median([pose.t for pose in poses], axis=0))


# --- Captures ---------------------------------------------------------------------------------------------


def _read_from_one_end(
    corners: list[list[Floats | None]], alone: list[CameraReport], T_cam_rig: list[Pose], board: Checkerboard
) -> dict[int, str]:
    """Reorder, in place, what a camera read from another end than the capture's first camera.

    Returns
    -------
    dict
        Capture → why it cannot be used: cameras have the board in different places.
    """
    contradictions = {}
    for k in range(len(corners[0])):
        first, *others = [i for i, row in enumerate(corners) if row[k] is not None] or [0]
        for j in others:
            misfits = _misfits(T_cam_rig[j] @ T_cam_rig[first].inverse(), first, j, k, alone, board)
            reading = board.readings[int(np.argmin(misfits))]
            corners[j][k] = corners[j][k][np.argsort(reading)]
            if min(misfits) > _AGREE:
                contradictions[k] = (
                    f"cameras {first + 1} and {j + 1} have the board {np.degrees(min(misfits)):.1f}° apart: it moved "
                    "between their exposures, was misdetected, or the captures do not belong together"
                )
    return contradictions


def _bad_captures(
    estimate: Estimate, seen: Observations, captures: list[int], alone: list[CameraReport]
) -> dict[int, str]:
    """Return the captures that fit each camera alone, but the rig much worse than others of the same cameras do."""
    distance = np.linalg.norm(Bundle(estimate, seen).residuals(estimate.vector()).reshape(-1, 2), axis=1)
    strains: dict[tuple[int, ...], dict[int, float]] = {}
    said = {}
    for k, capture in enumerate(captures):
        cameras = tuple(int(i) for i in np.unique(seen.camera[seen.capture == k]))
        if len(cameras) > 1:
            here = float(np.median(distance[seen.capture == k]))
            usual = float(np.median(np.concatenate([_distances(alone[i], capture) for i in cameras])))
            strains.setdefault(cameras, {})[capture] = here / usual
            said[capture] = (
                f"its corners are {here:.2f} px off, {usual:.2f} px in each camera alone: the board moved between the "
                f"exposures of cameras {' and '.join(str(i + 1) for i in cameras)}, or was misdetected"
            )
    bad = {}
    for group in strains.values():
        # Where most captures of the same cameras are strained, no single one is to blame.
        typical = sorted(group.values())[(len(group) - 1) // 2]
        bad |= {capture: said[capture] for capture, strain in group.items() if strain > _BAD_CAPTURE * max(1, typical)}
    return bad


def _distances(report: CameraReport, view: int) -> Floats:
    distances = np.linalg.norm(report.residuals[view], axis=1)
    return distances[np.isfinite(distances)]


def _joint_start(
    corners: list[list[Floats | None]],
    captures: list[int],
    T_cam_rig: list[Pose],
    alone: list[CameraReport],
) -> Estimate:
    """Put each capture's board where its first camera has it."""
    degree = max(report.degree for report in alone)
    boards = []
    for k in captures:
        i = next(i for i, row in enumerate(corners) if row[k] is not None)
        boards.append(T_cam_rig[i].inverse() @ alone[i].T_cam_board[k])
    intrinsics = tuple(report.intrinsics.raised(degree) for report in alone)
    return Estimate(intrinsics, tuple(T_cam_rig), tuple(boards))


def _observe(corners: list[list[Floats | None]], captures: list[int], board: Checkerboard) -> Observations:
    return observations([[row[k] for k in captures] for row in corners], board.points)


# --- What goes out ----------------------------------------------------------------------------------------


def _report(
    estimate: Estimate,
    seen: Observations,
    kept: NDArray[np.bool_],
    captures: list[int],
    alone: list[CameraReport],
    left_out: dict[int, str],
    shared: dict[tuple[int, int], list[int]],
    board: Checkerboard,
) -> RigReport:
    sigma, spread = uncertainty(estimate, seen.where(kept))
    cameras = tuple(
        camera_report(
            estimate, seen, kept, i, tuple(captures), len(board.points), spread, sigma,
            left_out=report.left_out, held_back=report.held_back, name=f"camera {i + 1}",
        )
        for i, report in enumerate(alone)
    )  # fmt: skip
    used = {pair: len(set(numbers) - set(left_out)) for pair, numbers in shared.items()}
    return RigReport(cameras, tuple(alone), tuple(captures), left_out, used, estimate, spread, sigma)


def _finish(report: RigReport, max_fov_deg: float | None) -> tuple[Rig, RigReport]:
    cameras, reports = [], []
    for alone in report.cameras:
        camera, finished = finish(alone, max_fov_deg)
        cameras.append(camera)
        reports.append(finished)
    rig = Rig(cameras, [pose.inverse() for pose in report.estimate.T_cam_rig])
    report = replace(report, cameras=tuple(reports))
    return rig, replace(report, warnings=tuple(_warnings(report)))


def _warnings(report: RigReport) -> Iterator[str]:
    for i, camera in enumerate(report.cameras):
        together = max((count for pair, count in report.shared.items() if i in pair), default=0)
        if together < _FEW_SHARED:
            yield (
                f"camera {i + 1} shares only {together} captures with any other: hold the board between two cameras "
                "more often, in different places"
            )
        common = [k for k in camera.views_used if sum(k in other.views_used for other in report.cameras) > 1]
        if common:
            joint, single = (
                float(np.median(np.concatenate([_distances(one, k) for k in common])))
                for one in (camera, report.alone[i])
            )
            if joint > _APART * single:
                yield (
                    f"camera {i + 1} is {joint:.2f} px off in captures that it shares, {single:.2f} px alone: were "
                    "the pictures of a capture taken at the same time, and did no camera move on the rig?"
                )
