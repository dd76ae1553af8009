"""Fisheye camera models of other libraries, and their conversion to and from OCam cameras by fitting.

A model is a function from rays to pixels, float64, that also returns where it is valid. `fit_ocam` samples a model
and fits the polynomial camera, so that the rest of the library uses a single camera class.

References: Usenko et al. 2018, "The double sphere camera model" (double sphere and the unified models);
Kannala and Brandt 2006 (here with the four coefficients of OpenCV); Mei and Rives 2007 (omni).
"""

import logging
import warnings
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Floats

Projected = tuple[Floats, NDArray[np.bool_]]  # uv (..., 2) px, valid (...)
Projection = Callable[[Floats], Projected]  # of rays (..., 3)

_log = logging.getLogger("omnistereo_lib")

DEFAULT_FOV_DEG = 220.0  # the widest common lens; in images without a mask, black corners lie beyond it
_ANGLE_STEP = np.radians(0.25)
AZIMUTHS = np.arange(64) * (2 * np.pi / 64)
_FIT_TOLERANCE = 0.01  # px, as for any inverse polynomial
_MAX_DEGREE = 20
_MAX_RESIDUAL = 0.1  # px; beyond it a warning


def double_sphere(rays: Floats, fx: float, fy: float, cx: float, cy: float, xi: float, alpha: float) -> Projected:
    """Project with the double sphere model: two unit spheres xi > -1 apart, then a shifted pinhole.

    Takes rays (..., 3) of any length in the camera frame, focal lengths and principal point in pixels, and alpha in
    [0, 1): the pinhole is alpha / (1 - alpha) behind the centre of the second sphere. Returns uv (..., 2) in pixels
    and valid (...): where the projection exists and is one to one; elsewhere uv is meaningless or not finite.
    """
    x, y, z, length = _components(rays)
    shifted = xi * length + z
    second = np.sqrt(x * x + y * y + shifted * shifted)
    w1 = _unified_limit(alpha)
    w2 = (w1 + xi) / np.sqrt(2 * w1 * xi + xi * xi + 1)
    return _pinhole(x, y, alpha * second + (1 - alpha) * shifted, fx, fy, cx, cy), z > -w2 * length


def unified(rays: Floats, fx: float, fy: float, cx: float, cy: float, alpha: float, beta: float = 1.0) -> Projected:
    """Project with the (extended) unified model: an ellipsoid, then a shifted pinhole.

    As `double_sphere`, with alpha in [0, 1) the position of the pinhole and beta > 0 the shape of the ellipsoid;
    beta = 1 is the sphere (UCM).
    """
    x, y, z, _ = _components(rays)
    length = np.sqrt(beta * (x * x + y * y) + z * z)
    return _pinhole(x, y, alpha * length + (1 - alpha) * z, fx, fy, cx, cy), z > -_unified_limit(alpha) * length


def omni(
    rays: Floats, fx: float, fy: float, cx: float, cy: float, xi: float,
    k1: float = 0.0, k2: float = 0.0, p1: float = 0.0, p2: float = 0.0,
) -> Projected:  # fmt: skip
    """Project with the model of Mei and Rives: a unit sphere seen from xi behind its centre, then radtan distortion.

    As `double_sphere`, with xi ≥ 0 and the radial (k1, k2) and tangential (p1, p2) coefficients of OpenCV on the
    normalised plane.
    """
    x, y, z, length = _components(rays)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        mx, my = x / (z + xi * length), y / (z + xi * length)
        r2 = mx * mx + my * my
        radial = 1 + k1 * r2 + k2 * r2 * r2
        u = mx * radial + 2 * p1 * mx * my + p2 * (r2 + 2 * mx * mx)
        v = my * radial + p1 * (r2 + 2 * my * my) + 2 * p2 * mx * my
    return np.stack([fx * u + cx, fy * v + cy], -1), z > -_unified_limit(xi / (1 + xi)) * length


def kannala_brandt(
    rays: Floats, fx: float, fy: float, cx: float, cy: float, k1: float, k2: float, k3: float, k4: float
) -> Projected:
    """Project with r(θ) = θ + k1 θ³ + k2 θ⁵ + k3 θ⁷ + k4 θ⁹, θ from the axis.

    As `double_sphere`, valid as far as r(θ) increases. Also called OpenCV fisheye, kb4 or pinhole-equidistant.
    OpenCV divides by z and stops at 90°; θ = atan2(hypot(x, y), z) does not.
    """
    x, y, z, length = _components(rays)
    r = Polynomial([0, 1, 0, k1, 0, k2, 0, k3, 0, k4])
    maxima = r.deriv().roots()
    maxima = maxima[(np.abs(maxima.imag) < 1e-9) & (maxima.real > 0)].real
    theta = np.arctan2(np.hypot(x, y), z)
    scale = r(theta) / np.maximum(np.hypot(x, y), 1e-300)
    valid = (length > 0) & (theta < maxima.min(initial=np.inf))
    return np.stack([fx * x * scale + cx, fy * y * scale + cy], -1), valid


_PINHOLE = ("fx", "fy", "cx", "cy")
_MODELS: dict[str, tuple[Callable[..., Projected], tuple[str, ...]]] = {
    "ds": (double_sphere, (*_PINHOLE, "xi", "alpha")),
    "kb4": (kannala_brandt, (*_PINHOLE, "k1", "k2", "k3", "k4")),
    "omni": (omni, (*_PINHOLE, "xi", "k1", "k2", "p1", "p2")),
    "eucm": (unified, (*_PINHOLE, "alpha", "beta")),
    "ucm": (unified, (*_PINHOLE, "alpha")),
}
_OPTIONAL = {"k1", "k2", "p1", "p2"}  # of omni
_RANGES = {"fx": (0, 1e6), "fy": (0, 1e6), "alpha": (-1e-12, 1), "beta": (0, 1e3), "xi": (-1, 1e3)}


def make_camera_model(model: str, parameters: dict[str, float]) -> Projection:
    """Return the projection of a named model: "ds", "kb4", "omni", "eucm" or "ucm".

    `parameters` are all keyword arguments of the model function; the distortion of "omni" may be omitted.

    Raises:
        OmnistereoError: If the model is unknown, or a parameter is missing, unknown or out of range.
    """
    if model not in _MODELS:
        raise OmnistereoError(
            f"camera model {model!r} is unknown; expected one of {sorted(_MODELS)}. Recalibrate with it"
        )
    function, names = _MODELS[model]
    optional = _OPTIONAL if model == "omni" else set()
    if not set(names) - optional <= set(parameters) <= set(names):
        raise OmnistereoError(f"camera model {model!r} needs the parameters {list(names)}, found {list(parameters)}")
    for name, value in parameters.items():
        low, high = _RANGES.get(name, (-1e6, 1e6))
        if not low < value < high:
            raise OmnistereoError(f"{name} = {value} of camera model {model!r} must lie between {low:g} and {high:g}")
    return partial(function, **parameters)


def _components(rays: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    rays = np.asarray(rays, np.float64)
    return rays[..., 0], rays[..., 1], rays[..., 2], np.linalg.norm(rays, axis=-1)


def _pinhole(x: Floats, y: Floats, depth: Floats, fx: float, fy: float, cx: float, cy: float) -> Floats:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.stack([fx * x / depth + cx, fy * y / depth + cy], -1)


def _unified_limit(alpha: float) -> float:
    """Return w: rays with z > -w |ray| project one to one through the sphere and the shifted pinhole."""
    return alpha / (1 - alpha) if alpha <= 0.5 else (1 - alpha) / alpha


def fit_camera(
    source: str,
    model: str,
    parameters: dict[str, float],
    image_size: tuple[int, int],
    max_fov_deg: float | None,
    mask: NDArray[np.bool_] | None = None,
) -> OcamCamera:
    """Return the OCam camera of a named model in a file; parameters as `make_camera_model` and `fit_ocam`.

    `source`, the file and the camera, is for messages. A UserWarning reports a residual above 0.1 px, which
    tangential distortion causes.
    """
    try:
        with np.errstate(all="ignore"):  # absurd parameters overflow before they are refused
            camera, residual = fit_ocam(make_camera_model(model, parameters), image_size, max_fov_deg, mask)
    except np.linalg.LinAlgError:
        raise OmnistereoError(f"no camera fits the {model} parameters {parameters}. Check them") from None
    _log.info("%s: %s fitted by OCam, %.1f° seen, worst residual %.2g px", source, model, camera.max_fov_deg, residual)
    if residual > _MAX_RESIDUAL:
        warnings.warn(
            f"{source}: the OCam polynomials are up to {residual:.2f} px away from the {model} model in the file, by "
            "tangential distortion or a model that is not monotonic. Lower max_fov_deg, or calibrate an OCam model.",
            UserWarning,
            stacklevel=2,
        )
    return camera


def fit_ocam(
    project: Projection,
    image_size: tuple[int, int],
    max_fov_deg: float | None = None,
    mask: NDArray[np.bool_] | None = None,
) -> tuple[OcamCamera, float]:
    """Fit an OCam camera to the projection of another model.

    Rays are sampled on rings around the axis. On each ring the first Fourier coefficients over the azimuth
    give the centre and the 2 × 2 map of the ring; over all rings the maps are one affine map times a radius (their
    best rank-1 approximation, the least-squares solution). The two polynomials are then fitted to the radii.

    Args:
        project: Rays (..., 3) → pixels (..., 2), valid (...), such as `functools.partial(double_sphere, fx=..., ...)`.
        image_size: Width and height, pixels. OmnistereoError if the model projects nothing into the image.
        max_fov_deg: Limit of the full field of view, degrees. None: none with a mask, 220° without a mask. The result
            is the smallest of this, the limit of the model and the widest angle of a valid pixel.
        mask (bool array, shape (height, width)): True where the image is valid.

    Returns:
        residual: Largest distance in pixels between the model and the projection by either polynomial.
    """
    half = _half_field(project, image_size, max_fov_deg, mask)
    theta = np.linspace(0.0, half, 257)[1:]
    rays = ring_rays(theta)
    uv = project(rays)[0]
    center = uv.mean((0, 1))
    harmonics = np.stack([np.cos(AZIMUTHS), np.sin(AZIMUTHS)], -1)
    maps = np.einsum("rai,aj->rij", uv, harmonics) * (2 / len(AZIMUTHS))
    A = np.linalg.svd(maps.reshape(-1, 4), full_matrices=False)[2][0].reshape(2, 2)
    A /= A[0, 0]
    radius = np.einsum("rij,ij->r", maps, A) / (A * A).sum()
    camera = OcamCamera(
        poly=_fit_direct(radius, theta - np.pi / 2),
        inv_poly=_fit_inverse(radius, theta - np.pi / 2),
        center=tuple(center.tolist()),
        affine=(float(A[1, 1]), float(A[1, 0]), float(A[0, 1])),
        image_size=image_size,
        max_fov_deg=float(np.degrees(2 * half)),
        mask=mask,
    )
    errors = [
        np.linalg.norm(camera.project(rays, use_direct_poly=exact)[0] - uv, axis=-1).max() for exact in (False, True)
    ]
    return camera, float(max(errors))


def ring_rays(theta: Floats) -> Floats:
    """Return unit rays (rings, azimuths, 3) at angles θ from the axis."""
    sine, cosine = np.sin(theta)[:, None], np.cos(theta)[:, None]
    x, y = sine * np.cos(AZIMUTHS), sine * np.sin(AZIMUTHS)
    return np.stack(np.broadcast_arrays(x, y, cosine), -1)


def _half_field(
    project: Projection, image_size: tuple[int, int], max_fov_deg: float | None, mask: NDArray[np.bool_] | None
) -> float:
    """Return the half field of view in radians, as `fit_ocam` chooses it."""
    theta = np.arange(0.0, np.pi, _ANGLE_STEP)
    uv, valid = project(ring_rays(theta))
    uv = np.where(valid[..., None], uv, np.nan)
    radius = np.linalg.norm(uv - uv[0].mean(0), axis=-1)
    one_to_one = np.append(True, (np.diff(radius, axis=0) > 0).all(1)).cumprod().astype(bool)  # NaN is not > 0
    theta, uv = theta[one_to_one], uv[one_to_one]
    width, height = image_size
    with np.errstate(invalid="ignore"):
        inside = ((uv >= 0) & (uv <= (width - 1, height - 1))).all(-1)
    if mask is not None:
        column, row = np.where(inside[..., None], uv, 0).round().astype(int).transpose(2, 0, 1)
        inside &= mask[row, column]
    if not inside[theta > 0].any():
        raise OmnistereoError(
            f"the camera model projects nothing into the image of {width} × {height} px. Check its parameters"
        )
    visible = theta[inside.any(1)].max() + _ANGLE_STEP
    default = 360.0 if mask is not None else DEFAULT_FOV_DEG
    limit = np.radians(default if max_fov_deg is None else max_fov_deg) / 2
    return float(min(visible, theta.max(), limit))


def _fit_inverse(radius: Floats, t: Floats) -> Floats:
    """Fit r(t), zero on the axis; coefficients low to high."""
    limits = [-np.pi / 2, t[-1]]
    scaled = (t - limits[0]) / (limits[1] - limits[0])
    b = _fit_lowest_degree(scaled[:, None] ** np.arange(1, _MAX_DEGREE + 1), radius, 3)
    return Polynomial([0, *b], domain=limits, window=[0, 1]).convert().coef


def _fit_direct(radius: Floats, t: Floats) -> Floats:
    """Fit f(r) with f(r) cos t = r sin t and a1 = 0; coefficients low to high."""
    exponents = np.array([0, *range(2, _MAX_DEGREE + 1)])
    powers = (radius / radius[-1])[:, None] ** exponents * np.cos(t)[:, None]
    a = _fit_lowest_degree(powers, radius * np.sin(t), 4)
    a /= radius[-1] ** exponents[: len(a)]
    return np.array([a[0], 0.0, *a[1:]])


def _fit_lowest_degree(powers: Floats, values: Floats, terms: int) -> Floats:
    """Return the least-squares coefficients of the fewest columns, at least `terms`, that meet the tolerance."""
    for count in range(terms, powers.shape[1] + 1):
        fit = np.linalg.lstsq(powers[:, :count], values, rcond=None)[0]
        if np.abs(powers[:, :count] @ fit - values).max() < _FIT_TOLERANCE:
            break
    return fit
