"""One camera from views of a board: initial estimate, robust fit, degree, rejected views."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.errors import OmnistereoError, check_number, check_type
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Floats
from omnistereo_lib.parse import check_fov, parse_size
from omnistereo_lib.progress import Progress, silent
from omnistereo_rigs.boards.board import Board
from omnistereo_rigs.boards.bundle import BundleProblem, bundle_adjust
from omnistereo_rigs.boards.checkerboard import Checkerboard, edge_width, suggest_board
from omnistereo_rigs.boards.detect import detect_views
from omnistereo_rigs.boards.init import estimate_poses, initial_estimate
from omnistereo_rigs.boards.params import CalibrationParams, collect_observations
from omnistereo_rigs.boards.report import FEW_VIEWS, CameraReport
from omnistereo_rigs.boards.solution import OUTLIER, Solution
from omnistereo_rigs.formats.fit import MAX_DEGREE

# The degrees that cross-validation tries. Odd ones add little, and beyond 8 nothing was ever gained
# (notebook 01 shows it).
DEGREES = (4, 6, 8)
# A higher degree has to lower the cross-validation error by so many of its standard errors.
_SIGNIFICANT = 2.0
_FOLDS = 3
_MIN_VIEWS = 3
# Four corners determine the pose of a plane; with two more a view says whether the pose fits.
_FEWEST_CORNERS = 6
# A view is rejected if its error is so many times that of the median view.
_BAD_VIEW = 3.0
_MISDETECTED = "reprojection error {:.2f} px, usual {:.2f} px: blurred, moved or misdetected"
# The same of its edge width. Sharp views of one camera differ by a tenth.
_BLURRED = 1.5
# In pixels: no hand brings a board back as near to where it was.
_ONE_PLACE = 0.5
# Boards that are all parallel to within this angle leave the focal length open.
_PARALLEL = np.radians(5.0)

# Corners of each view, the size of the images, and the images if there are some.
BoardViews = tuple[list[Floats | None], tuple[int, int], list[NDArray[Any] | None] | None]


def calibrate_camera(
    views: Sequence[ArrayLike | None],
    board: Board,
    image_size: tuple[int, int] | None = None,
    degree: int | None = None,
    max_fov_deg: float | None = None,
    progress: Progress = silent,
    names: Sequence[str] | None = None,
) -> tuple[OcamCamera, CameraReport]:
    """Calibrate one camera: Φ and A of the paper's Section III-A, and the pose of each view.

    Args:
        views: Images of the board, (H, W) or (H, W, 3), or corners detected in them, (K, 2) px in
            the order of `board.points`, NaN where a corner is missing. None for a view without a
            board.
        image_size: Width and height, pixels; required if the views are corners.
        degree: Degree of the polynomial f, at least 4. None: chosen by cross-validation.
        max_fov_deg: Full field of view of the camera returned. None: as far as there are corners.
        progress: Called as `progress(done, total, what)` during detection, with images done and in
            all.
        names: What messages call the views, such as file names. None: their indices.

    Returns:
        camera: Its inverse polynomial agrees with the direct one to 0.01 px.

    Raises:
        OmnistereoError: If fewer than three views show the board, all views are parallel, corners
            do not fit the board, or the corners do not determine the camera.

    >>> from omnistereo_rigs import Checkerboard, calibrate_camera
    >>> board = Checkerboard((8, 6), square=0.05)
    >>> true = osl.load_rig("data_samples/sunny/test").cameras[0]
    >>> turns = [[np.sin(k) / 2, np.cos(k) / 2, 0] for k in range(8)]
    >>> vectors = [[*turn, k / 10 - 0.4, -0.1, 0.3] for k, turn in enumerate(turns)]
    >>> poses = [osl.Pose.from_vector(vector) for vector in vectors]
    >>> views = [true.project(pose @ board.points)[0] for pose in poses]  # or images of a board
    >>> camera, report = calibrate_camera(views, board, true.image_size, degree=4)
    >>> report.rms_px < 0.01 and bool(np.allclose(camera.center, true.center, atol=0.01))
    True
    """
    check_settings(degree, max_fov_deg)
    found = read_views(views, board, image_size, progress, names)
    return calibrate_corners(*found, board, degree, max_fov_deg)


def calibrate_corners(
    corners: list[Floats | None],
    image_size: tuple[int, int],
    images: Sequence[ArrayLike | None] | None,
    board: Board,
    degree: int | None = None,
    max_fov_deg: float | None = None,
    given: OcamCamera | None = None,
) -> tuple[OcamCamera, CameraReport]:
    """Calibrate one camera, as `calibrate_camera`, from detected corners.

    With a `given` camera, only the poses of the board are found.
    """
    if given is not None:
        corners = [None if view is None else _corners_in_view(view, given) for view in corners]
        max_fov_deg = given.max_fov_deg
    # Views keep their numbers among all that were given: `taken` have an image, `found` a board.
    taken = [k for k, view in enumerate(images or corners) if view is not None]
    second = _second_board(corners)
    corners = [None if k in second else view for k, view in enumerate(corners)]
    _check_input(corners, images, len(taken), board, 1 if given else _MIN_VIEWS, second)
    found = [k for k, view in enumerate(corners) if view is not None]
    views = [view for view in corners if view is not None]
    rejected = dict.fromkeys(sorted(set(taken) - set(found)), "no board found") | second
    cv_error_px: dict[int, float] = {}
    # First a rough camera, then the degree of its polynomial, then a robust fit. A given camera
    # needs the poses of the board only.
    if given is None:
        params = initial_estimate(views, board.points, image_size)
        _check_tilts(params)
        if degree is None:
            degree, cv_error_px = choose_degree(params, views, board.points)
        params = params.with_degree(degree)
    else:
        params = estimate_poses(given, views, board.points)
    observations = collect_observations([views], board.points)
    params, distance = bundle_adjust(params, observations, loss="soft_l1")
    # What does not fit is rejected, and what fits but is blurred, too; the rest gives the solution.
    typical = [np.median(distance[observations.capture == k]) for k in range(len(views))]
    bad = _far_above_usual(typical, _BAD_VIEW, _MISDETECTED)
    if images is not None and isinstance(board, Checkerboard):
        bad |= _blurred_views(images, corners, board)
    good = [k for k in range(len(found)) if k not in bad]
    if len(good) < (1 if given else _MIN_VIEWS):
        raise OmnistereoError(
            f"only {len(good)} of {len(found)} views fit one camera. Check that the board is"
            f" {board} and flat, and that all images are from one camera at the same zoom"
        )
    observations = collect_observations([[views[k] for k in good]], board.points)
    solution = Solution.solve(params.with_captures(good), observations)
    rejected |= {found[k]: why for k, why in bad.items()}
    report = solution.camera_report(0, tuple(found[k] for k in good), rejected, cv_error_px)
    return report.build_camera(max_fov_deg)


def _corners_in_view(corners: Floats, camera: OcamCamera) -> Floats | None:
    """Return the corners that a given camera sees, NaN for the others; None: too few are left."""
    seen = np.where(camera.unproject(corners)[1][:, None], corners, np.nan)
    return seen if np.isfinite(seen).all(axis=1).sum() >= _FEWEST_CORNERS else None


def read_views(
    views: Sequence[ArrayLike | None],
    board: Board,
    image_size: tuple[int, int] | None,
    progress: Progress = silent,
    names: Sequence[str] | None = None,
) -> BoardViews:
    """Return the corners of each view, the size of the images, and the images if there are some.

    Raises an `OmnistereoError` if there are no views, or corners do not fit the board or come
    without the image size.
    """
    check_type(views, Iterable, "views")
    check_type(board, Board, "board")
    arrays = [None if view is None else np.asarray(view) for view in views]
    given = [array for array in arrays if array is not None]
    if not given:
        raise OmnistereoError(
            "there are no views. Pass images of the board, or the corners detected in them"
        )
    if not all(array.ndim == 2 and array.shape[1] == 2 for array in given):
        height, width = given[0].shape[:2]
        return detect_views(arrays, board, progress, names), (width, height), arrays
    if image_size is None:
        raise OmnistereoError(
            "views are corners, so the image size is unknown. Pass image_size=(width, height)"
        )
    named = zip(map(str, range(len(arrays))) if names is None else names, arrays, strict=True)
    return (
        [_check_corners(name, array, board) for name, array in named],
        parse_size(image_size, "image_size"),
        None,
    )


def _check_corners(name: str, corners: NDArray[Any] | None, board: Board) -> Floats | None:
    if corners is None:
        return None
    if len(corners) != len(board.points):
        raise OmnistereoError(
            f"view {name}: {len(corners)} corners; expected {len(board.points)}, those of a board"
            f" {board}, in the order of its points. Put NaN for missing corners"
        )
    corners = np.where(np.isfinite(corners), corners, np.nan).astype(np.float64)
    return corners if np.isfinite(corners).all(axis=1).sum() >= _FEWEST_CORNERS else None


def check_settings(degree: int | None, max_fov_deg: float | None) -> None:
    """Raise for a degree or a field of view that cannot be, before any image is searched."""
    if degree is not None:
        check_number(degree, "degree", DEGREES[0], MAX_DEGREE, whole=True)
    if max_fov_deg is not None:
        check_fov(max_fov_deg, "max_fov_deg")


def _second_board(corners: Sequence[Floats | None]) -> dict[int, str]:
    """Return three or more views with the board at one place while it moved, and the reason."""
    found = {k: view for k, view in enumerate(corners) if view is not None}
    # For each view, all views in which more than half of the corners are at the same pixels. The
    # largest such group is the candidate.
    standing: list[int] = []
    for here in found.values():
        apart = {k: np.linalg.norm(view - here, axis=1) for k, view in found.items()}
        near = [k for k, d in apart.items() if (d < _ONE_PLACE).sum() > np.isfinite(d).sum() / 2]
        standing = near if len(near) > len(standing) else standing
    order = [k for k in found if standing and standing[0] <= k <= standing[-1]]
    # If the group follows one after the other, the board was held still, and there is no second
    # one.
    if len(standing) < _MIN_VIEWS or standing == order:
        return {}
    reason = (
        "a second board, at one place in all of them, while the board moved. Cover it and take them"
        " again"
    )
    return dict.fromkeys(standing, reason)


def _check_input(
    corners: Sequence[Floats | None],
    images: Sequence[ArrayLike | None] | None,
    taken: int,
    board: Board,
    least: int,
    second: Mapping[int, str],
) -> None:
    found = sum(view is not None for view in corners)
    # A board size given too small is found here and there as a part of the board.
    if images is not None and isinstance(board, Checkerboard) and found < min(FEW_VIEWS, taken / 2):
        shown = [view for view in images if view is not None]
        suggestion = suggest_board(shown, board, only_larger=True)
        if suggestion is not None:
            (columns, rows), count = suggestion
            raise OmnistereoError(
                f"{found} of {taken} views show a board {board}, but one of {columns} x {rows}"
                f" inner corners is found in {count} of the first images. Check that the board size"
                " counts all inner corners"
            )
    if found < least:
        others = f"; {len(second)} show {next(iter(second.values()))}" if second else ""
        raise OmnistereoError(
            f"{found} of {taken} views show the board{others}; expected at least {least}. Take 15"
            " or more, tilted every way and out to the rim"
        )


def _check_tilts(params: CalibrationParams) -> None:
    """Raise if all boards are parallel: then focal length and distance are ambiguous."""
    # The third column of R is the board's normal, seen from the camera.
    normals = np.stack([pose.R[:, 2] for pose in params.T_rig_board])
    largest = np.arccos(np.clip(normals @ normals.T, -1, 1)).max()
    if largest < _PARALLEL:
        raise OmnistereoError(
            f"all views are parallel to within {np.degrees(largest):.1f}°: the focal length and the"
            " distance of the board cannot be told apart. Tilt the board by 20° to 45°,"
            " differently in each view"
        )


def choose_degree(
    params: CalibrationParams, views: Sequence[Floats], points: Floats
) -> tuple[int, dict[int, float]]:
    """Choose the degree by 3-fold cross-validation over the views; 4 for fewer than 6 views.

    Returns:
        degree: The lowest that the next does not improve by twice the standard error over the
            views.
        cv_error_px: Degree → mean distance on held-out views, px; infinite if the polynomial is not
            monotonic.
    """
    if len(views) < 2 * _FOLDS:
        return DEGREES[0], {}
    errors = _cv_errors(params.with_degree(DEGREES[-1]), views, points)
    best = DEGREES[0]
    for degree in DEGREES[1:]:
        # The gain on each view that was held out. It has to be so much larger than its standard
        # error, s / √n, that it is no chance: otherwise the simpler polynomial is kept.
        gain = errors[best] - errors[degree]
        chance = gain.std(ddof=1) / np.sqrt(len(gain))
        if np.isfinite(gain).all() and gain.mean() > _SIGNIFICANT * chance:
            best = degree
    return best, {degree: float(error.mean()) for degree, error in errors.items()}


def _cv_errors(
    params: CalibrationParams, views: Sequence[Floats], points: Floats
) -> dict[int, Floats]:
    """Return, for each degree, the mean distance on each view, px, in a camera fitted without it.

    A distance is limited to three times the median of its view: wrong corners say nothing about the
    degree.
    """
    errors = {degree: np.zeros(len(views)) for degree in DEGREES}
    for fold in range(_FOLDS):
        held_out = np.arange(len(views)) % _FOLDS == fold
        parts = [np.flatnonzero(part).tolist() for part in (~held_out, held_out)]
        train, test = (
            BundleProblem(
                params.with_captures(part), collect_observations([[views[k] for k in part]], points)
            )
            for part in parts
        )
        for degree, error in errors.items():
            # The camera from two thirds of the views.
            options: dict[str, Any] = {"loss": "soft_l1", "tolerance": 1e-6, "degree": degree}
            fitted = train.adjust(train.initial, **options)
            distance = train.distances(fitted)
            # As far out as inliers reach, the polynomial has to be monotonic, or it is no camera.
            near = train.observations.pixels[distance <= OUTLIER * np.median(distance)]
            reach = np.arccos(fitted.intrinsics[0].rays(near)[:, 2].min())
            try:
                fitted.intrinsics[0].camera(2 * float(np.degrees(reach)))
            # not monotonic where no corners constrain it, such as around the axis of a mirror
            except OmnistereoError:
                error[:] = np.inf
                continue
            # The other third tells how well it predicts: the camera stays, only the poses of these
            # boards are found.
            posed = replace(test.initial, intrinsics=fitted.intrinsics)
            distance = test.distances(test.adjust(posed, fixed="rig", **options))
            for k, view in enumerate(parts[1]):
                here = distance[test.observations.capture == k]
                error[view] += np.minimum(here, 3 * np.median(here)).mean()
    return errors


def _blurred_views(
    images: Sequence[ArrayLike | None], corners: Sequence[Floats | None], board: Checkerboard
) -> dict[int, str]:
    """Return views with wider edges than usual: motion blur shifts corners, yet they may fit."""
    pairs = zip(images, corners, strict=True)
    found = ((a, b) for a, b in pairs if a is not None and b is not None)
    widths = [edge_width(image, view, board) for image, view in found]
    reason = "blurred: edges {:.1f} px wide, usual {:.1f} px. Check that the board was still"
    return _far_above_usual(widths, _BLURRED, reason)


def _far_above_usual(values: Sequence[Any], factor: float, reason: str) -> dict[int, str]:
    usual = np.median(values)
    return {k: reason.format(v, usual) for k, v in enumerate(values) if v > factor * usual}
