"""Other camera models as OCam cameras: the polynomials are fitted to sampled rays."""

import logging
import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.camera import INVERSE_TOLERANCE, OcamCamera
from omnistereo_lib.geometry.field_of_view import (
    ANGLE_STEP,
    AZIMUTHS,
    Projection,
    field_of_view_deg,
    one_to_one,
    ring_rays,
)
from omnistereo_lib.geometry.pose import Floats
from omnistereo_lib.ocam_text import MAX_ERROR_PX
from omnistereo_rigs.formats.camera_models import make_camera_model

_log = logging.getLogger("omnistereo_lib")

MAX_DEGREE = 20
# px; beyond it an error: a lens of another model than the one that is stated
_ANOTHER_LENS = 10.0
_LOST = 0.005  # share of the pixels; beyond it a warning


class Lens(NamedTuple):
    """A camera as a file states it, before it is fitted."""

    source: str  #: the file and the camera, for messages
    model: str  #: of `camera_models`
    parameters: Mapping[str, Any]
    size: tuple[int, int]  #: width and height, pixels
    mask: NDArray[np.bool_] | None = None  #: (height, width), True where the image is valid
    #: Full field of view in degrees within which the program that wrote the file can have measured
    #: the lens: fisheyes of OpenCV, Kalibr and others divide by z, and mirror or drop what lies
    #: beyond 90° from the axis. A lens of 220° fitted within 84° was off by 0.6 px at 95° and by
    #: 7 px, 2°, at 110°.
    measured_deg: float | None = None


def fit_lens(lens: Lens, max_fov_deg: float | None) -> tuple[OcamCamera, float]:
    """Return the OCam camera of a lens, up to `max_fov_deg`, and its largest residual, pixels.

    A UserWarning reports a residual above 0.1 px, and pixels beyond the angle at which the model
    stops being one to one; an `OmnistereoError` refuses one above 10 px.
    """
    source, model, parameters, size, mask, measured = lens
    limit = measured if max_fov_deg is None else max_fov_deg
    try:
        with np.errstate(all="ignore"):  # absurd parameters overflow before they are refused
            project = make_camera_model(model, parameters)
            camera, residual = fit_ocam(project, size, limit, mask)
            degrees, lost = _pixels_beyond(project, size, mask)
    except np.linalg.LinAlgError:
        raise OmnistereoError(f"no camera fits {model} with {parameters}. Check them") from None
    fov = camera.max_fov_deg
    _log.info("%s: %s fitted by OCam, %.1f° seen, residual %.2g px", source, model, fov, residual)
    follows = f"{source}: an OCam camera follows the {model} model in the file to {residual:.2f} px"
    if not residual < _ANOTHER_LENS:
        raise OmnistereoError(
            f"{follows} only: no lens is like that. Check the model; k1 k2 k3 k4 of a fisheye "
            "are called plumb_bob by some drivers (T265): then write distortion_model: fisheye"
        )
    if residual > MAX_ERROR_PX:
        warnings.warn(
            f"{follows} only: it has no tangential distortion. Where that is too much, lower "
            "max_fov_deg (`omnistereo rig --max-fov`)",
            UserWarning,
            stacklevel=2,
        )
    if lost > _LOST and 2 * degrees < fov + 1:
        warnings.warn(
            f"{source}: the {model} model is one to one within {2 * degrees:.0f}° (a pinhole is "
            f"used within 120°): {100 * lost:.0f} % of the pixels lie beyond and are not used. "
            "Check its coefficients",
            UserWarning,
            stacklevel=2,
        )
    return camera, residual


def fit_ocam(
    project: Projection,
    image_size: tuple[int, int],
    max_fov_deg: float | None = None,
    mask: NDArray[np.bool_] | None = None,
) -> tuple[OcamCamera, float]:
    """Fit an OCam camera to the projection of another model.

    Rays are sampled on rings around the axis. On each ring the first Fourier coefficients over the
    azimuth give the centre and the 2 × 2 map of the ring; over all rings the maps are one affine
    map times a radius (their best rank-1 approximation, the least-squares solution). The two
    polynomials are then fitted to the radii.

    Args:
        project: Rays (..., 3) → pixels (..., 2), valid (...), such as
            `functools.partial(double_sphere, fx=..., ...)`.
        image_size: Width and height, pixels. OmnistereoError if the model projects nothing into the
            image.
        max_fov_deg: As for `field_of_view_deg`.
        mask (bool array, shape (height, width)): True where the image is valid.

    Returns:
        residual: Largest distance in pixels, inside the image and on the mask, between the model
    and the projection.
    """
    fov = field_of_view_deg(project, image_size, max_fov_deg, mask)
    theta = np.linspace(0.0, np.radians(fov / 2), 257)[1:]
    rays = ring_rays(theta)
    uv = project(rays)[0]
    center = uv.mean((0, 1))
    harmonics = np.stack([np.cos(AZIMUTHS), np.sin(AZIMUTHS)], -1)
    maps = np.einsum("rai,aj->rij", uv, harmonics) * (2 / len(AZIMUTHS))
    A = np.linalg.svd(maps.reshape(-1, 4), full_matrices=False)[2][0].reshape(2, 2)
    A /= A[0, 0]
    radius = np.einsum("rij,ij->r", maps, A) / (A * A).sum()
    camera = OcamCamera(
        poly=fit_direct_polynomial(radius, theta - np.pi / 2),
        inv_poly=_fit_inverse(radius, theta - np.pi / 2),
        center=tuple(center.tolist()),
        affine=(float(A[1, 1]), float(A[1, 0]), float(A[0, 1])),
        image_size=image_size,
        max_fov_deg=fov,
        mask=mask,
    )
    errors = np.linalg.norm(camera.project(rays)[0] - uv, axis=-1)
    return camera, float(errors[camera.contains(uv)].max(initial=0.0))


def _pixels_beyond(
    project: Projection, image_size: tuple[int, int], mask: NDArray[np.bool_] | None
) -> tuple[float, float]:
    """Return the angle, degrees, up to which a model is one to one, the share of pixels beyond."""
    theta, uv, _ = one_to_one(project)
    width, height = image_size
    within = np.zeros((height, width), np.uint8)
    ring = np.clip(uv[-1], -1e4, 1e5).round().astype(np.int32)
    cv2.fillPoly(within, [ring], 1)
    seen = within if mask is None else within[mask]
    ends = theta[-1] < np.pi - 2 * ANGLE_STEP
    return float(np.degrees(theta[-1])), 1 - float(seen.mean()) if ends and seen.size else 0.0


def _fit_inverse(radius: Floats, t: Floats) -> Floats:
    """Fit r(t), zero on the axis; coefficients low to high."""
    limits = [-np.pi / 2, t[-1]]
    scaled = (t - limits[0]) / (limits[1] - limits[0])
    b = _fit_lowest_degree(scaled[:, None] ** np.arange(1, MAX_DEGREE + 1), radius, 3)
    return np.asarray(Polynomial([0, *b], domain=limits, window=[0, 1]).convert().coef)


def fit_direct_polynomial(radius: Floats, t: Floats) -> Floats:
    """Fit f(r) cos t = r sin t, a1 = 0, to 0.01 px; radii (N,) px, coefficients low to high."""
    exponents = np.array([0, *range(2, MAX_DEGREE + 1)])
    to_px = np.cos(t) * np.gradient(radius, t) / radius  # of the difference of both sides
    powers = (radius / radius[-1])[:, None] ** exponents * (np.cos(t) * to_px)[:, None]
    a = _fit_lowest_degree(powers, radius * np.sin(t) * to_px, 4)
    a /= radius[-1] ** exponents[: len(a)]
    return np.array([a[0], 0.0, *a[1:]])


def _fit_lowest_degree(powers: Floats, values: Floats, terms: int) -> Floats:
    """Return least-squares coefficients of the fewest columns, from `terms`, to the tolerance."""
    fit: Floats = np.zeros(0)
    for count in range(terms, powers.shape[1] + 1):
        fit = np.asarray(np.linalg.lstsq(powers[:, :count], values, rcond=None)[0], np.float64)
        if np.abs(powers[:, :count] @ fit - values).max() < INVERSE_TOLERANCE:
            break
    return fit
