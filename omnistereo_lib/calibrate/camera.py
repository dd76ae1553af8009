"""One camera from pictures of a board: start, robust fit, degree of the polynomial, outliers, report."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.calibrate.board import Checkerboard
from omnistereo_lib.calibrate.bundle import Bundle, Estimate, Observations, adjust, covariance, observations
from omnistereo_lib.calibrate.detect import Progress, detect_views, edge_width, find_with_model, suggest_board
from omnistereo_lib.calibrate.report import CameraReport
from omnistereo_lib.calibrate.start import first_estimate
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.camera import OcamCamera

Floats = NDArray[np.float64]

DEGREES = (4, 6, 8)  # odd ones add little; beyond 8 nothing was ever gained (notebook 01 shows it)
_SURE = 2.0  # standard errors by which a higher degree has to explain held-back views better
_FOLDS = 3
_LEAST_VIEWS = 3
_OUTLIER_SIGMAS = 6.0
_BAD_VIEW = 3.0  # times the median view's error
_BLURRED = 1.5  # times the median view's edge width; sharp views of one camera differ by a tenth
_PARALLEL = np.radians(5.0)

# What is worth a warning.
_MARGIN_DEG = 10.0  # of field of view beyond the last corner
_RING_DEG, _FEW_CORNERS = 10.0, 10
_FEW_VIEWS = 10
_SQUARE = 0.02
_LARGE_PX = 1.0


def calibrate_camera(
    views: Sequence[ArrayLike | None],
    board: Checkerboard,
    image_size: tuple[int, int] | None = None,
    degree: int | None = None,
    max_fov_deg: float | None = None,
    progress: Progress = iter,
    names: Sequence[str] | None = None,
) -> tuple[OcamCamera, CameraReport]:
    """Calibrate one camera: Φ and A of the paper's Section III-A, with every view's pose.

    Parameters
    ----------
    views : sequence
        Images of the board, (H, W) or (H, W, 3), or corners that were detected in them, (K, 2) px in the order
        of `board.points`, NaN where single ones are missing. None for a view without a board.
    board : Checkerboard
    image_size : (int, int), optional
        Width and height, needed where the views are corners.
    degree : int, optional
        Of the polynomial f, 4 or more. None: the lowest that views left out of the fit ask for.
    max_fov_deg : float, optional
        Full field of view of the camera returned. None: as far as corners were seen.
    progress : callable
        Wraps the images while boards are looked for, as `tqdm` does.
    names : sequence of str, optional
        What messages call the views, such as file names. None: their indices.

    Returns
    -------
    camera : OcamCamera
        Its inverse polynomial agrees with the direct one to 0.01 px.
    report : CameraReport

    Raises
    ------
    OmnistereoError
        If fewer than three views show the board, all views are parallel, corners do not fit the board, or the
        corners do not determine the camera.
    """
    return calibrate_corners(*read_views(views, board, image_size, progress, names), board, degree, max_fov_deg)


def calibrate_corners(
    corners: list[Floats | None],
    image_size: tuple[int, int],
    images: Sequence[ArrayLike | None] | None,
    board: Checkerboard,
    degree: int | None = None,
    max_fov_deg: float | None = None,
) -> tuple[OcamCamera, CameraReport]:
    """Do what `calibrate_camera` does with corners that have been detected.

    Where the images are given, too, boards that were missed in them are looked for once more and filled in.
    """
    if degree is not None and not (degree % 1 == 0 and degree >= DEGREES[0]):
        raise OmnistereoError(f"degree is {degree}; expected an integer of at least {DEGREES[0]}, or None to choose it")
    shown = [k for k, view in enumerate(corners) if view is not None]
    given = [k for k, view in enumerate(images or corners) if view is not None]
    if images is not None and len(shown) < min(_FEW_VIEWS, len(given) / 2):
        _check_whole_board(images, board, f"{len(shown)} of {len(given)}")
    if len(shown) < _LEAST_VIEWS:
        raise OmnistereoError(
            f"{len(shown)} of {len(given)} views show the board; a camera needs {_LEAST_VIEWS} at the very least, "
            f"and 15 or more, tilted every way and out to the rim, for a good result{_another_size(images, board)}"
        )
    estimate = first_estimate([corners[k] for k in shown], board.points, image_size)
    _check_tilts(estimate)
    if images is not None and len(shown) < len(given):
        estimate, shown = _second_pass(estimate, shown, corners, images, board)
    left_out = dict.fromkeys(sorted(set(given) - set(shown)), "no board found")
    held_back: dict[int, float] = {}
    kept = [corners[k] for k in shown]
    if degree is None:
        degree, held_back = choose_degree(estimate, kept, board.points)
    estimate = adjust(with_degree(estimate, degree), observations([kept], board.points), loss="soft_l1")
    bad = _bad_views(estimate, kept, board.points)
    if images is not None:
        bad |= _blurred_views([images[k] for k in shown], kept, board)
    left_out |= {shown[k]: why for k, why in bad.items()}
    good = [k for k in range(len(shown)) if k not in bad]
    if len(good) < _LEAST_VIEWS:
        raise OmnistereoError(
            f"only {len(good)} of {len(shown)} views fit one camera. Is the board {board} the one in the pictures, "
            "flat, and are all pictures from the same camera at the same zoom?"
        )
    estimate = Estimate(estimate.intrinsics, estimate.T_cam_rig, tuple(estimate.T_rig_board[k] for k in good))
    used = tuple(shown[k] for k in good)
    seen = observations([[corners[k] for k in used]], board.points)
    estimate, kept = refine(estimate, seen)
    sigma, spread = uncertainty(estimate, seen.where(kept))
    report = camera_report(
        estimate, seen, kept, 0, used, len(board.points), spread, sigma, left_out=left_out, held_back=held_back
    )
    return finish(report, max_fov_deg)


# --- What comes in ----------------------------------------------------------------------------------------


def read_views(
    views: Sequence[ArrayLike | None],
    board: Checkerboard,
    image_size: tuple[int, int] | None,
    progress: Progress = iter,
    names: Sequence[str] | None = None,
) -> tuple[list[Floats | None], tuple[int, int], list | None]:
    """Return corners for each view, the images' width and height, and the images if that is what came.

    Raises
    ------
    OmnistereoError
        If there are no views, or corners do not fit the board or come without the images' size.
    """
    arrays = [None if view is None else np.asarray(view) for view in views]
    given = [array for array in arrays if array is not None]
    if not given:
        raise OmnistereoError("there are no views: give images of the board, or the corners detected in them")
    if all(array.ndim == 2 and array.shape[1] == 2 for array in given):
        named = zip(range(len(arrays)) if names is None else names, arrays, strict=True)
        return [_checked(name, array, board) for name, array in named], _checked_size(image_size), None
    return detect_views(arrays, board, progress, names), (given[0].shape[1], given[0].shape[0]), arrays


def _another_size(images: Sequence[ArrayLike | None] | None, board: Checkerboard) -> str:
    fits = suggest_board([image for image in images if image is not None], board) if images is not None else None
    return "" if fits is None else f". A board of {fits[0][0]} x {fits[0][1]} inner corners would fit {fits[1]} views"


def _check_whole_board(images: Sequence[ArrayLike | None], board: Checkerboard, count: str) -> None:
    """Raise if a larger board fits: one given too small is found here and there as a part of it."""
    fits = suggest_board([image for image in images if image is not None], board, only_larger=True)
    if fits is not None:
        (columns, rows), found = fits
        raise OmnistereoError(
            f"{count} views show a board {board}, but one of {columns} x {rows} inner corners is found in {found} "
            "of the first images. Check that the board size counts all inner corners (columns x rows)"
        )


def _checked(name: str | int, corners: NDArray | None, board: Checkerboard) -> Floats | None:
    if corners is None:
        return None
    if len(corners) != len(board.points):
        columns, rows = board.corners
        raise OmnistereoError(
            f"view {name}: {len(corners)} corners; expected {columns} x {rows} = {len(board.points)}, the board's "
            "inner corners, columns first. Put NaN for missing corners"
        )
    corners = corners.astype(np.float64)
    return corners if np.isfinite(corners).all(axis=1).sum() >= 6 else None


def _checked_size(image_size: tuple[int, int] | None) -> tuple[int, int]:
    if image_size is None:
        raise OmnistereoError("corners alone do not say how large the images were: give image_size=(width, height)")
    return int(image_size[0]), int(image_size[1])


def _check_tilts(estimate: Estimate) -> None:
    """Boards that are all parallel leave the focal length and their distances open."""
    normals = np.stack([pose.R[:, 2] for pose in estimate.T_rig_board])
    spread = np.arccos(np.clip(normals @ normals.T, -1, 1)).max()
    if spread < _PARALLEL:
        raise OmnistereoError(
            f"all views are parallel to within {np.degrees(spread):.1f}°: the focal length and the board's distance "
            "cannot be told apart. Tilt the board by 20° to 45°, differently in each view"
        )


def _second_pass(
    estimate: Estimate, shown: list[int], corners: list, images: list, board: Checkerboard
) -> tuple[Estimate, list[int]]:
    """Look for the boards that were missed, straightened by the first model; returns what is shown now."""
    seen = observations([[corners[k] for k in shown]], board.points)
    estimate, kept = refine(estimate, seen)
    camera = _as_camera(estimate, seen.where(kept))
    if camera is None:
        return estimate, shown
    for k, image in enumerate(images):
        if image is not None and corners[k] is None:
            corners[k] = find_with_model(image, board, camera)
    shown = [k for k, view in enumerate(corners) if view is not None]
    return first_estimate([corners[k] for k in shown], board.points, estimate.intrinsics[0].image_size), shown


# --- The fit ----------------------------------------------------------------------------------------------


def with_degree(estimate: Estimate, degree: int) -> Estimate:
    """Return the estimate with polynomials of a degree at least as high as before."""
    raised = tuple(intrinsics.raised(max(degree, intrinsics.degree)) for intrinsics in estimate.intrinsics)
    return Estimate(raised, estimate.T_cam_rig, estimate.T_rig_board)


def refine(estimate: Estimate, seen: Observations) -> tuple[Estimate, NDArray[np.bool_]]:
    """Adjust with squares, on the corners that are within six times the noise of their view in a robust fit.

    Returns
    -------
    estimate : Estimate
    kept : bool array
        Which corners counted.
    """
    estimate = adjust(estimate, seen, loss="soft_l1")
    for _ in range(2):  # what the wrong corners still pulled along in the robust fit comes back in the second round
        kept = _within_noise(estimate, seen)
        estimate = adjust(estimate, seen.where(kept))
    return estimate, kept


def _as_camera(estimate: Estimate, seen: Observations) -> OcamCamera | None:
    """Return the first camera as far as corners reach; None where its polynomial is no lens there.

    Where no corners hold a polynomial of high degree, such as around the axis of a mirror, it may swing.
    """
    rays = estimate.intrinsics[0].rays(seen.pixels)
    try:
        return estimate.intrinsics[0].camera(2 * float(np.degrees(np.arccos(rays[:, 2].min()))))
    except OmnistereoError:
        return None


def _within_noise(estimate: Estimate, seen: Observations) -> NDArray[np.bool_]:
    distance = _distances(estimate, seen)
    _, view = np.unique(np.stack([seen.camera, seen.capture]), axis=1, return_inverse=True)
    typical = np.array([np.median(distance[view == k]) for k in range(view.max() + 1)])
    # Of a two-dimensional normal error the median distance is 1.177 σ.
    return distance <= _OUTLIER_SIGMAS * np.maximum(typical[view], np.median(distance)) / 1.177


def _distances(estimate: Estimate, seen: Observations) -> Floats:
    return np.linalg.norm(Bundle(estimate, seen).residuals(estimate.vector()).reshape(-1, 2), axis=-1)


def choose_degree(estimate: Estimate, views: Sequence[Floats], points: Floats) -> tuple[int, dict[int, float]]:
    """Fit without every third view, then let that camera explain those: the degree that does it best.

    Every view is held back once; only its pose is fitted to it. With too few views the degree stays 4.

    Returns
    -------
    degree : int
        The lowest that the next does not beat by twice the standard error over the views, or cannot be inverted.
    held_back : dict
        Degree → mean distance on views held back, px; infinite where the polynomial is no lens.
    """
    if len(views) < 2 * _FOLDS:
        return DEGREES[0], {}
    errors = {degree: _held_back_errors(with_degree(estimate, degree), views, points) for degree in DEGREES}
    best = DEGREES[0]
    for degree in DEGREES[1:]:
        gain = errors[best] - errors[degree]
        if np.isfinite(gain).all() and gain.mean() > _SURE * gain.std(ddof=1) / np.sqrt(len(gain)):
            best = degree
    return best, {degree: float(error.mean()) for degree, error in errors.items()}


def _held_back_errors(estimate: Estimate, views: Sequence[Floats], points: Floats) -> Floats:
    """Return each view's mean distance, px, in the camera that was fitted without it.

    Distances count as three times the view's median at most: wrong corners say nothing about the degree.
    """
    errors = np.empty(len(views))
    poses = np.array(estimate.T_rig_board, object)
    for fold in range(_FOLDS):
        held = np.arange(len(views)) % _FOLDS == fold
        seen, unseen = (observations([[views[k] for k in np.flatnonzero(part)]], points) for part in (~held, held))
        train = Estimate(estimate.intrinsics, estimate.T_cam_rig, tuple(poses[~held]))
        fitted = adjust(train, seen, loss="soft_l1", tolerance=1e-6)
        if _as_camera(fitted, seen) is None:
            return np.full(len(views), np.inf)
        test = Estimate(fitted.intrinsics, estimate.T_cam_rig, tuple(poses[held]))
        test = adjust(test, unseen, loss="soft_l1", fixed="rig", tolerance=1e-6)
        distance = _distances(test, unseen)
        for k, view in enumerate(np.flatnonzero(held)):
            here = distance[unseen.capture == k]
            errors[view] = np.minimum(here, 3 * np.median(here)).mean()
    return errors


def _bad_views(estimate: Estimate, views: Sequence[Floats], points: Floats) -> dict[int, str]:
    """Return the views whose typical corner is off by several times what is usual."""
    seen = observations([views], points)
    distance = _distances(estimate, seen)
    typical = np.array([np.median(distance[seen.capture == k]) for k in range(len(views))])
    usual = np.median(typical)
    return {
        k: f"its corners are {error:.2f} px off where {usual:.2f} px are usual: blurred, moved or misdetected"
        for k, error in enumerate(typical)
        if error > _BAD_VIEW * usual
    }


def _blurred_views(images: Sequence[ArrayLike], views: Sequence[Floats], board: Checkerboard) -> dict[int, str]:
    """Return the views whose edges are wider than usual: their corners may fit, and lie where the board was not."""
    widths = np.array([edge_width(image, corners, board) for image, corners in zip(images, views, strict=True)])
    usual = np.median(widths)
    return {
        k: f"it is blurred: edges {width:.1f} px wide where {usual:.1f} are usual. Did the board move?"
        for k, width in enumerate(widths)
        if width > _BLURRED * usual
    }


# --- What goes out ----------------------------------------------------------------------------------------


def uncertainty(estimate: Estimate, kept: Observations) -> tuple[float, Floats]:
    """Return the noise of the corners (px, in u and v) and the covariance of lenses and rig that follows from it.

    Raises
    ------
    OmnistereoError
        If the corners do not determine all unknowns.
    """
    residuals = Bundle(estimate, kept).residuals(estimate.vector())
    sigma = float(np.sqrt((residuals**2).sum() / max(len(residuals) - estimate.size, 1)))
    try:
        return sigma, covariance(estimate, kept, sigma)
    except np.linalg.LinAlgError as error:
        raise OmnistereoError(
            "the corners do not determine all lenses and poses: add views that differ in tilt and place"
        ) from error


def camera_report(
    estimate: Estimate,
    seen: Observations,
    kept: NDArray[np.bool_],
    i: int,
    captures: tuple[int, ...],
    corners: int,
    spread: Floats,
    sigma_px: float,
    **facts: object,
) -> CameraReport:
    """Return the report of camera i in a settled estimate.

    Parameters
    ----------
    estimate : Estimate
    seen : Observations
        All corners of the captures that were used.
    kept : bool array
        Which of them counted; the others become the report's outliers.
    i : int
        The camera, from 0.
    captures : tuple of int
        The number of each of the estimate's captures in what the user gave.
    corners : int
        How many the board has.
    spread : array
        Covariance of lenses and rig.
    sigma_px : float
    facts
        The report's remaining fields.
    """
    mine = seen.camera == i
    residuals = Bundle(estimate, seen).residuals(estimate.vector()).reshape(-1, 2)[mine]
    rays = estimate.intrinsics[i].rays(seen.pixels[mine])
    angle = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])
    capture, corner = seen.capture[mine], seen.corner[mine]
    table = np.full((len(captures), corners, 3), np.nan)
    table[capture, corner] = np.column_stack([residuals, angle])
    pixels = np.full((len(captures), corners, 2), np.nan)
    pixels[capture, corner] = seen.pixels[mine]
    views = np.unique(capture)
    wrong = np.flatnonzero(~kept[mine])
    distance = np.linalg.norm(residuals, axis=1)
    first, width = i * len(estimate.intrinsics[0].vector), len(estimate.intrinsics[0].vector)
    return CameraReport(
        views_used=tuple(captures[k] for k in views),
        outliers=tuple(
            (captures[capture[m]], int(corner[m]), float(distance[m])) for m in wrong[np.argsort(-distance[wrong])]
        ),
        corners={captures[k]: pixels[k] for k in views},
        residuals={captures[k]: table[k, :, :2] for k in views},
        angles={captures[k]: table[k, :, 2] for k in views},
        T_cam_board={captures[k]: estimate.T_cam_rig[i] @ estimate.T_rig_board[k] for k in views},
        intrinsics=estimate.intrinsics[i],
        covariance=spread[first : first + width, first : first + width],
        sigma_px=sigma_px,
        **facts,
    )


def finish(report: CameraReport, max_fov_deg: float | None) -> tuple[OcamCamera, CameraReport]:
    """Return the camera, and the report with its warnings.

    Raises
    ------
    OmnistereoError
        If the polynomial does not reach as far as the field of view that is asked for.
    """
    reach = report.coverage_deg
    camera = report.intrinsics.camera(2 * reach if max_fov_deg is None else max_fov_deg)
    return camera, replace(report, warnings=(*report.warnings, *_warnings(report, camera)))


def _warnings(report: CameraReport, camera: OcamCamera) -> Iterator[str]:
    reach, half = report.coverage_deg, camera.max_fov_deg / 2
    if half > reach + _MARGIN_DEG:
        yield (
            f"no corner beyond {reach:.0f}° from the axis, but a field of view up to {half:.0f}°: results there are "
            "extrapolated. Hold the board closer to the rim"
        )
    for low, high in _bare_rings(report):
        yield (
            f"hardly any corners between {low:.0f}° and {high:.0f}° from the axis: the lens is not measured there, "
            "and its polynomial of no use where nothing holds it. Cover every ring"
        )
    if len(report.views_used) < _FEW_VIEWS:
        yield f"only {len(report.views_used)} views: 15 or more, tilted every way, make the result firm"
    size = np.array(camera.image_size)
    offset = np.array(camera.center) - (size - 1) / 2
    if (np.abs(offset) > 0.1 * size).any():
        yield (
            f"the optical axis lies {np.linalg.norm(offset):.0f} px from the middle of the image: are the pictures "
            "cropped? A crop is fine as long as every picture has the same one"
        )
    if abs(camera.affine[0] - 1) > _SQUARE:
        yield (
            f"pixels are {camera.affine[0]:.3f} times as high as wide in the image: were the pictures resized by "
            "different factors, or are the board's squares not square?"
        )
    if report.mean_px > _LARGE_PX:
        yield (
            f"a mean error of {report.mean_px:.2f} px is large: is the board flat, and are all pictures from one "
            "camera with fixed focus and zoom?"
        )


def _bare_rings(report: CameraReport) -> Iterator[tuple[float, float]]:
    """Yield from where to where there are rings of 10° with fewer than ten corners, degrees."""
    edges = np.arange(0.0, report.coverage_deg, _RING_DEG)
    angles = np.degrees(np.concatenate([report.angles[view] for view in report.views_used]))
    bare = np.histogram(angles[np.isfinite(angles)], edges)[0] < _FEW_CORNERS
    steps = np.diff(np.concatenate([[0], bare.astype(int), [0]]))
    yield from zip(edges[np.flatnonzero(steps == 1)], edges[np.flatnonzero(steps == -1)], strict=True)
