"""Other people's fisheye models, and how each becomes an OCam camera.

The models are functions from rays to pixels, float64, that say where they hold; `fit_ocam` samples one of
them and fits the polynomial camera, so that everything after it knows a single camera class.

References: Usenko et al. 2018, "The double sphere camera model" (double sphere and the unified models);
Kannala and Brandt 2006 (here with OpenCV's four coefficients); Mei and Rives 2007 (omni).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.camera import OcamCamera

Floats = NDArray[np.float64]
Projection = Callable[[Floats], tuple[Floats, NDArray[np.bool_]]]  # rays (..., 3) -> uv (..., 2) px, valid (...)

DEFAULT_FOV_DEG = 220.0  # the widest common lens; black corners of an unmasked picture lie beyond it
_ANGLE_STEP = np.radians(0.25)
_AZIMUTHS = np.arange(64) * (2 * np.pi / 64)
_FIT_TOLERANCE = 0.01  # px, as for any inverse polynomial
_MAX_DEGREE = 20


def double_sphere(
    rays: Floats, fx: float, fy: float, cx: float, cy: float, xi: float, alpha: float
) -> tuple[Floats, NDArray[np.bool_]]:
    """Project with the double sphere model: two unit spheres xi apart, then a shifted pinhole.

    Parameters
    ----------
    rays : array, shape (..., 3)
        Directions in the camera frame, any length.
    fx, fy, cx, cy : float
        Focal lengths and principal point, pixels.
    xi, alpha : float
        Distance of the spheres, more than -1; position of the pinhole in [0, 1): it stands alpha / (1 - alpha)
        behind the second sphere's centre.

    Returns
    -------
    uv : shape (..., 2), pixels; not finite or meaningless where not valid
    valid : bool, shape (...)
        Where the projection exists and is one to one.
    """
    x, y, z, length = _components(rays)
    shifted = xi * length + z
    second = np.sqrt(x * x + y * y + shifted * shifted)
    w1 = _unified_limit(alpha)
    w2 = (w1 + xi) / np.sqrt(2 * w1 * xi + xi * xi + 1)
    return _pinhole(x, y, alpha * second + (1 - alpha) * shifted, fx, fy, cx, cy), z > -w2 * length


def unified(
    rays: Floats, fx: float, fy: float, cx: float, cy: float, alpha: float, beta: float = 1.0
) -> tuple[Floats, NDArray[np.bool_]]:
    """Project with the (extended) unified model: an ellipsoid, then a shifted pinhole.

    Parameters
    ----------
    rays, fx, fy, cx, cy
        As for `double_sphere`, as are the values returned.
    alpha, beta : float
        Position of the pinhole in [0, 1) and shape of the ellipsoid; beta = 1 is the sphere (UCM).
    """
    x, y, z, _ = _components(rays)
    length = np.sqrt(beta * (x * x + y * y) + z * z)
    return _pinhole(x, y, alpha * length + (1 - alpha) * z, fx, fy, cx, cy), z > -_unified_limit(alpha) * length


def omni(
    rays: Floats,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    xi: float,
    k1: float = 0.0,
    k2: float = 0.0,
    p1: float = 0.0,
    p2: float = 0.0,
) -> tuple[Floats, NDArray[np.bool_]]:
    """Project with Mei's model: a unit sphere seen from xi behind its centre, then radtan distortion.

    Parameters
    ----------
    rays, fx, fy, cx, cy
        As for `double_sphere`, as are the values returned.
    xi : float
        Distance of the viewpoint from the sphere's centre, at least 0.
    k1, k2, p1, p2 : float
        OpenCV's radial and tangential coefficients on the normalised plane.
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
) -> tuple[Floats, NDArray[np.bool_]]:
    """Project with r(θ) = θ + k1 θ³ + k2 θ⁵ + k3 θ⁷ + k4 θ⁹, θ from the axis.

    Others call it OpenCV fisheye, kb4 or pinhole-equidistant. OpenCV's own code divides by z and so stops at
    90°; here θ = atan2(hypot(x, y), z) goes on.

    Parameters
    ----------
    rays, fx, fy, cx, cy
        As for `double_sphere`, as are the values returned. Valid up to where r(θ) first turns back.
    k1, k2, k3, k4 : float
        Coefficients as above.
    """
    x, y, z, length = _components(rays)
    r = Polynomial([0, 1, 0, k1, 0, k2, 0, k3, 0, k4])
    turns = r.deriv().roots()
    turns = turns[(np.abs(turns.imag) < 1e-9) & (turns.real > 0)].real
    theta = np.arctan2(np.hypot(x, y), z)
    scale = r(theta) / np.maximum(np.hypot(x, y), 1e-300)
    valid = (length > 0) & (theta < turns.min(initial=np.inf))
    return np.stack([fx * x * scale + cx, fy * y * scale + cy], -1), valid


_LENSES: dict[str, tuple[Callable[..., tuple[Floats, NDArray[np.bool_]]], tuple[str, ...]]] = {
    "ds": (double_sphere, ("fx", "fy", "cx", "cy", "xi", "alpha")),
    "kb4": (kannala_brandt, ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")),
    "omni": (omni, ("fx", "fy", "cx", "cy", "xi", "k1", "k2", "p1", "p2")),
    "eucm": (unified, ("fx", "fy", "cx", "cy", "alpha", "beta")),
    "ucm": (unified, ("fx", "fy", "cx", "cy", "alpha")),
}
_RANGES = {
    "fx": (0, np.inf),
    "fy": (0, np.inf),
    "alpha": (-1e-12, 1),
    "beta": (0, np.inf),
    "xi": (-1, np.inf),
}


def make_lens(model: str, parameters: dict[str, float]) -> Projection:
    """Return the projection of a named model with its parameters.

    Parameters
    ----------
    model : "ds" | "kb4" | "omni" | "eucm" | "ucm"
    parameters : dict
        The keyword arguments of the model's function, all of them.

    Raises
    ------
    OmnistereoError
        If the model is unknown, or a parameter is missing, unknown or out of range.
    """
    if model not in _LENSES:
        raise OmnistereoError(
            f"no lens model {model!r} here, known are {sorted(_LENSES)}; recalibrate with one of them"
        )
    function, names = _LENSES[model]
    if set(parameters) != set(names):
        raise OmnistereoError(f"lens model {model!r} needs the parameters {list(names)}, found {list(parameters)}")
    for name, value in parameters.items():
        low, high = _RANGES.get(name, (-np.inf, np.inf))
        if not low < value < high:
            raise OmnistereoError(f"{name} = {value} of lens model {model!r} must lie between {low:g} and {high:g}")
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


def fit_ocam(
    project: Projection,
    image_size: tuple[int, int],
    max_fov_deg: float | None = None,
    mask: NDArray[np.bool_] | None = None,
) -> tuple[OcamCamera, float]:
    """Fit an OCam camera to another model's projection.

    Rays are sampled on rings around the axis. On each ring the first Fourier coefficients over the azimuth
    give the ring's centre and its 2 × 2 map; over all rings the maps are one affine map times a radius (their
    best rank-1 approximation), which is the least-squares answer. The two polynomials then follow the radii.

    Parameters
    ----------
    project : function
        Rays (..., 3) → pixels (..., 2), valid (...), such as `functools.partial(double_sphere, fx=..., ...)`.
    image_size : (int, int)
        Width and height, pixels.
    max_fov_deg : float, optional
        Widest full field of view wanted, degrees. None: what the mask leaves, or 220° without a mask.
        The camera's is the smallest of this, the model's limit and the widest that a usable pixel sees.
    mask : bool array, shape (height, width), optional
        True where the picture is usable.

    Returns
    -------
    camera : OcamCamera
    residual : float
        Largest distance in pixels between the model and either polynomial's projection over the field.

    Raises
    ------
    OmnistereoError
        If the model projects nothing into the image.
    """
    half = _half_field(project, image_size, max_fov_deg, mask)
    theta = np.linspace(0.0, half, 257)[1:]
    rays, uv = _rings(project, theta)
    center = uv.mean((0, 1))
    harmonics = np.stack([np.cos(_AZIMUTHS), np.sin(_AZIMUTHS)], -1)
    maps = np.einsum("rai,aj->rij", uv, harmonics) * (2 / len(_AZIMUTHS))
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
    errors = [np.linalg.norm(camera.project(rays, exact=exact)[0] - uv, axis=-1).max() for exact in (False, True)]
    return camera, float(max(errors))


def _rings(project: Projection, theta: Floats) -> tuple[Floats, Floats]:
    """Return rays (rings, azimuths, 3) at angles θ from the axis and their pixels; NaN where not valid."""
    sine, cosine = np.sin(theta)[:, None], np.cos(theta)[:, None]
    rays = np.stack(
        np.broadcast_arrays(sine * np.cos(_AZIMUTHS), sine * np.sin(_AZIMUTHS), cosine * np.ones_like(_AZIMUTHS)),
        -1,
    )
    uv, valid = project(rays)
    return rays, np.where(valid[..., None], uv, np.nan)


def _half_field(
    project: Projection,
    image_size: tuple[int, int],
    max_fov_deg: float | None,
    mask: NDArray[np.bool_] | None,
) -> float:
    """Return the half field of view in radians, as `fit_ocam` chooses it."""
    theta = np.arange(0.0, np.pi, _ANGLE_STEP)
    _, uv = _rings(project, theta)
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
            f"the lens projects nothing into the image of {width} × {height} px; check its parameters"
        )
    seen = theta[inside.any(1)].max() + _ANGLE_STEP
    wanted = np.pi if mask is not None else np.radians(DEFAULT_FOV_DEG) / 2
    wanted = wanted if max_fov_deg is None else np.radians(max_fov_deg) / 2
    return float(min(seen, theta.max(), wanted))


def _fit_inverse(radius: Floats, t: Floats) -> Floats:
    """Fit r(t), zero on the axis, raising the degree until it is good; low to high."""
    limits = [-np.pi / 2, t[-1]]
    scaled = (t - limits[0]) / (limits[1] - limits[0])
    for degree in range(3, _MAX_DEGREE + 1):
        powers = scaled[:, None] ** np.arange(1, degree + 1)
        b = np.linalg.lstsq(powers, radius, rcond=None)[0]
        if np.abs(powers @ b - radius).max() < _FIT_TOLERANCE:
            break
    return Polynomial([0, *b], domain=limits, window=[0, 1]).convert().coef


def _fit_direct(radius: Floats, t: Floats) -> Floats:
    """Fit f(r) with f(r) cos t = r sin t and a1 = 0, raising the degree until it is good; low to high."""
    scaled = radius / radius[-1]
    for degree in range(4, _MAX_DEGREE + 1):
        exponents = np.array([0, *range(2, degree + 1)])
        powers = scaled[:, None] ** exponents * np.cos(t)[:, None]
        a = np.linalg.lstsq(powers, radius * np.sin(t), rcond=None)[0]
        if np.abs(powers @ a - radius * np.sin(t)).max() < _FIT_TOLERANCE:
            break
    poly = np.zeros(degree + 1)
    poly[exponents] = a / radius[-1] ** exponents
    return poly
