"""Checkers of notebook 02."""

from __future__ import annotations

from course.exercises.compare import Case, Rng, checker
from omnistereo_lib.geometry.pose import Pose


@checker
def check_relative_pose(rng: Rng, k: int) -> Case:
    """02.1: T_2_1, camera 1 → camera 2, of two cameras that see one board at T_1_board and T_2_board."""
    T_1_board, T_2_board = map(Pose.from_vector, rng.uniform(-1, 1, (2, 6)))
    mistakes = [
        (T_1_board @ T_2_board.inverse(), "that is T_1_2, the way back: from camera 1 to the board, then to camera 2"),
        (
            T_1_board.inverse() @ T_2_board,
            "read the indices: T_board_1 takes to the board, T_2_board from there, so it stands on the left",
        ),
        (
            T_2_board.inverse() @ T_1_board,
            "the inverse belongs to camera 1's pose, and the order turns: the board is between the two",
        ),
        (T_2_board @ T_1_board, "the inner indices do not meet: camera 1 → board is the inverse of T_1_board"),
        (T_1_board @ T_2_board, "the inner indices do not meet: camera 1 → board is the inverse of T_1_board"),
    ]
    right = (T_2_board @ T_1_board.inverse()).as_vector()
    return (T_1_board, T_2_board), right, [(T.as_vector(), hint) for T, hint in mistakes]


@checker
def check_count_unknowns(rng: Rng, k: int) -> Case:
    """02.2: unknowns of the joint adjustment, given cameras, captures and the degree M of the polynomials."""
    cameras, captures, degree = (int(rng.integers(*limits)) for limits in ((3, 9), (20, 60), (3, 9)))
    lenses, poses = cameras * (4 + degree), 6 * (cameras - 1 + captures)
    mistakes = [
        (lenses + 6 * (cameras + captures), "camera 1 is the rig's frame: its pose is no unknown"),
        (lenses + 6 * (cameras - 1), "each capture's board has a pose, too: six numbers more for each"),
        (
            lenses + 6 * (cameras - 1 + cameras * captures),
            "a board has one pose for each capture, not one for each"
            " camera that sees it: that is what ties the cameras together",
        ),
        (cameras * (5 + degree) + poses, "degree M has M coefficients: a0, then a2 … aM; a1 is zero"),
        (cameras * (6 + degree) + poses, "there is no a1, and d = e count once: 4 + M for each camera"),
        (poses, "the lenses are adjusted with the poses: 4 + M numbers for each camera"),
        (4 + degree + poses, "each camera has a lens of its own"),
        (lenses + 3 * (cameras - 1 + captures), "a pose has six numbers: three of rotation, three of translation"),
    ]
    return (cameras, captures, degree), lenses + poses, mistakes


@checker
def check_depth_error(rng: Rng, k: int) -> Case:
    """02.4: metres of depth that one sphere more or less makes, to first order, given depth, N and D_min."""
    depth, N, nearest = rng.uniform(4, 12), int(rng.integers(60, 200)), rng.uniform(0.4, 0.9)
    step = 1 / (nearest * (N - 1))
    mistakes = [
        (depth * step, "inverse depth is 1/ρ: its derivative is -1/ρ², so the depth enters squared"),
        (step, "that is one step in inverse depth, 1/m; in metres it grows with ρ²"),
        (depth**2 / (nearest * N), "N - 1 steps lead from infinity to D_min, not N"),
        (nearest / (N - 1), "the spheres are even in inverse depth, not in depth"),
        (1 / step, "that is 1 over the step in inverse depth: the depth of sphere 1"),
        (
            1 / (1 / depth - step) - depth,
            "that is the exact difference one sphere further out; return ρ² times the step, its limit for small steps",
        ),
        (
            depth - 1 / (1 / depth + step),
            "that is the exact difference one sphere nearer; return ρ² times the step, its limit for small steps",
        ),
    ]
    return (depth, N, nearest), depth**2 * step, mistakes
