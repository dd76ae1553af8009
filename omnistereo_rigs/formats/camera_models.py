"""Camera models of other libraries.

A model is a function from rays to pixels, float64, that also returns where it is valid.
`fit.fit_ocam` samples it and fits the polynomial camera, so that the rest of the library uses a
single camera class.

References: Usenko et al. 2018, "The double sphere camera model" (double sphere and the unified
models); Kannala and Brandt 2006 (here with the four coefficients of OpenCV); Mei and Rives 2007
(omni); Devernay and Faugeras 2001 (fov); the manuals of OpenCV (pinhole), Metashape and Hugin;
projectaria-tools (fisheye624), NVIDIA's DriveWorks (ftheta).
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.field_of_view import Projected, Projection
from omnistereo_lib.geometry.pose import Floats

# full field of view; beyond it a pixel of a pinhole camera is wider than four at its centre
MAX_PINHOLE_DEG = 120.0


def double_sphere(
    rays: Floats, fx: float, fy: float, cx: float, cy: float, xi: float, alpha: float
) -> Projected:
    """Project with the double sphere model: two unit spheres xi > -1 apart, then a shifted pinhole.

    Takes rays (..., 3) of any length in the camera frame, focal lengths and principal point in
    pixels, and alpha in [0, 1): the pinhole is alpha / (1 - alpha) behind the centre of the second
    sphere. Returns uv (..., 2) in pixels
    and valid (...): where the projection exists and is one to one; elsewhere uv is meaningless or
    not finite.
    """
    x, y, z, length = _components(rays)
    shifted = xi * length + z
    second = np.sqrt(x * x + y * y + shifted * shifted)
    w1 = _unified_limit(alpha)
    w2 = (w1 + xi) / np.sqrt(2 * w1 * xi + xi * xi + 1)
    return _pinhole(x, y, alpha * second + (1 - alpha) * shifted, fx, fy, cx, cy), z > -w2 * length


def unified(
    rays: Floats, fx: float, fy: float, cx: float, cy: float, alpha: float, beta: float = 1.0
) -> Projected:
    """Project with the (extended) unified model: an ellipsoid, then a shifted pinhole.

    As `double_sphere`, with alpha in [0, 1) the position of the pinhole and beta > 0 the shape of
    the ellipsoid; beta = 1 is the sphere (UCM).
    """
    x, y, z, _ = _components(rays)
    length = np.sqrt(beta * (x * x + y * y) + z * z)
    return _pinhole(x, y, alpha * length + (1 - alpha) * z, fx, fy, cx, cy), z > -_unified_limit(
        alpha
    ) * length


def omni(
    rays: Floats,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    xi: float,
    skew: float = 0.0,
    **radtan: float,
) -> Projected:
    """Project with the model of Mei and Rives: a unit sphere seen from xi behind its centre, then
    radtan distortion.

    As `double_sphere`, with xi ≥ 0 and the coefficients k1, k2, p1 and p2 of OpenCV on the
    normalised plane; u = fx x + skew y + cx.
    """
    x, y, z, length = _components(rays)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        x, y = _radtan(x / (z + xi * length), y / (z + xi * length), **radtan)
        return _to_pixels(x, y, fx, fy, cx, cy, skew), z > -_unified_limit(xi / (1 + xi)) * length


def pinhole(
    rays: Floats,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    skew: float = 0.0,
    rpmax: float = 0.0,
    **radtan: float,
) -> Projected:
    """Project with the pinhole model of OpenCV and its distortion `RADTAN`, valid within 120°.

    `rpmax` is the largest radius on the normalised plane that basalt allows; 0 sets no limit.
    """
    x, y, z, length = _components(rays)
    valid = z > np.cos(np.radians(MAX_PINHOLE_DEG / 2)) * length
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        x, y = x / z, y / z
        valid &= (rpmax == 0) | (np.hypot(x, y) <= rpmax)
        x, y = _radtan(x, y, **radtan)
        return _to_pixels(x, y, fx, fy, cx, cy, skew), valid


def field_of_view(rays: Floats, fx: float, fy: float, cx: float, cy: float, w: float) -> Projected:
    """Project with the FOV model (ATAN): r = atan(2 tan(θ) tan(w / 2)) / w, valid below θ = 90°."""
    x, y, z, length = _components(rays)
    n = np.hypot(x, y)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.arctan2(2 * n * np.tan(w / 2), z) / w / np.maximum(n, 1e-300)
    return _to_pixels(x * scale, y * scale, fx, fy, cx, cy), z > 1e-9 * length


def kannala_brandt(
    rays: Floats, fx: float, fy: float, cx: float, cy: float, skew: float = 0.0, **k: float
) -> Projected:
    """Project with r(θ) = θ + k1 θ³ + k2 θ⁵ + k3 θ⁷ + k4 θ⁹, θ from the axis.

    As `double_sphere`, valid as far as r(θ) increases. Also called OpenCV fisheye, kb4 or
    pinhole-equidistant. OpenCV divides by z and stops at 90°; θ = atan2(hypot(x, y), z) does not. u
    = fx x + skew y + cx.
    """
    x, y, z, length = _components(rays)
    r = Polynomial([0, 1, *(part for name in FISHEYE for part in (0, k.get(name, 0.0)))])
    theta = np.arctan2(np.hypot(x, y), z)
    scale = r(theta) / np.maximum(np.hypot(x, y), 1e-300)
    valid = (length > 0) & (theta < _first_maximum(r))
    return _to_pixels(x * scale, y * scale, fx, fy, cx, cy, skew), valid


# The radius on the normalised plane at an angle from the axis, by the usual names of the
# projections.
RADII: dict[str, Callable[[Any], Any]] = {
    "rectilinear": lambda theta: np.where(
        theta < np.radians(MAX_PINHOLE_DEG / 2), np.tan(theta), np.nan
    ),
    "equidistant": lambda theta: theta,
    "equisolid": lambda theta: 2 * np.sin(theta / 2),
    "stereographic": lambda theta: 2 * np.tan(theta / 2),
    "orthographic": lambda theta: np.where(theta < np.pi / 2, np.sin(theta), np.nan),
}


def metashape(
    rays: Floats,
    projection: str,
    f: float,
    cx: float,
    cy: float,
    b1: float = 0.0,
    b2: float = 0.0,
    **distortion: float,
) -> Projected:
    """Project with the model of Metashape: one of `RADII`, then the distortion of a pinhole camera.

    Of k1 … k4 and p1 … p4, k4 is the coefficient of r⁸; p1 and p2 are the p2 and p1 of OpenCV, and
    grow with 1 + p3 r² + p4 r⁴. u = (f + b1) x + b2 y + cx.
    """
    k1, k2, k3, k4, p1, p2, p3, p4 = (dict.fromkeys(_METASHAPE, 0.0) | distortion).values()
    x, y, z, length = _components(rays)
    n = np.hypot(x, y)
    scale = RADII[projection](np.arctan2(n, z)) / np.maximum(n, 1e-300)
    x, y = x * scale, y * scale
    r2 = x * x + y * y
    decentring = 1 + p3 * r2 + p4 * r2 * r2
    x, y = _distorted(x, y, Polynomial([1, k1, k2, k3, k4])(r2), p2 * decentring, p1 * decentring)
    return _to_pixels(x, y, f + b1, f, cx, cy, b2), (length > 0) & np.isfinite(scale)


def hugin(
    rays: Floats,
    projection: str,
    v: float,
    w: float,
    h: float,
    a: float = 0.0,
    b: float = 0.0,
    c: float = 0.0,
    d: float = 0.0,
    e: float = 0.0,
) -> Projected:
    """Project with the lens model of Hugin: one of `RADII` times f, then r (a ρ³ + b ρ² + c ρ + 1 -
    a - b - c).

    ρ = r / half the shorter side; f follows from the horizontal field of view v, degrees. The
    centre is d, e from the middle of the image of w × h pixels, whose corner, not its first pixel,
    is (0, 0).
    """
    x, y, z, length = _components(rays)
    n, half = np.hypot(x, y), min(w, h) / 2
    f = w / 2 / float(RADII[projection](np.radians(v / 2)))
    rho = f / half * RADII[projection](np.arctan2(n, z))
    scale = half * Polynomial([0, 1 - a - b - c, c, b, a])(rho) / np.maximum(n, 1e-300)
    uv = _to_pixels(x * scale, y * scale, 1.0, 1.0, w / 2 - 0.5 + d, h / 2 - 0.5 + e)
    return uv, (length > 0) & np.isfinite(scale)


def fisheye624(
    rays: Floats, fx: float, fy: float, cx: float, cy: float, **distortion: float
) -> Projected:
    """Project with six radial (k0 … k5), two tangential (p0, p1) and four thin prism terms (s0 …
    s3).

    The model of Project Aria, COLMAP's RAD_TAN_THIN_PRISM_FISHEYE: r = θ + k0 θ³ + … + k5 θ¹³; then
    x += 2 x (p0 x + p1 y) + p0 r² + s0 r² + s1 r⁴, and y with p1, s2, s3.
    """
    k0, k1, k2, k3, k4, k5, p0, p1, s0, s1, s2, s3 = (distortion[name] for name in FISHEYE624)
    x, y, z, length = _components(rays)
    n = np.hypot(x, y)
    r = Polynomial([0, 1, 0, k0, 0, k1, 0, k2, 0, k3, 0, k4, 0, k5])
    theta = np.arctan2(n, z)
    scale = r(theta) / np.maximum(n, 1e-300)
    x, y = x * scale, y * scale
    r2, dot = x * x + y * y, 2 * (p0 * x + p1 * y)
    u = x + x * dot + r2 * (p0 + s0 + s1 * r2)
    v = y + y * dot + r2 * (p1 + s2 + s3 * r2)
    valid = (length > 0) & (theta < _first_maximum(r))
    return _to_pixels(u, v, fx, fy, cx, cy), valid


def ftheta(
    rays: Floats,
    cx: float,
    cy: float,
    to_angle: float,
    c: float = 1.0,
    d: float = 0.0,
    e: float = 0.0,
    **p: float,
) -> Projected:
    """Project with an f-theta polynomial p0 + p1 x + …: θ of a radius in pixels (to_angle = 1), or
    r(θ).

    u = c x + d y + cx, v = e x + y + cy; valid as far as the radius grows with the angle.
    """
    x, y, z, length = _components(rays)
    n = np.hypot(x, y)
    theta, poly = np.arctan2(n, z), Polynomial([p.get(f"p{k}", 0.0) for k in range(16)])
    end = _first_maximum(poly)
    if to_angle:
        radii = np.linspace(0, min(end, 1e5), 1 << 14)
        angles = poly(radii)
        r = np.interp(theta, angles, radii, right=np.nan)
        for _ in range(3):  # Newton; from a step of 6 px at most it doubles the digits
            r = r - (poly(r) - theta) / poly.deriv()(r)
    else:
        r = np.where(theta < end, poly(theta), np.nan)
    scale = r / np.maximum(n, 1e-300)
    x, y = x * scale, y * scale
    return np.stack([c * x + d * y + cx, e * x + y + cy], -1), (length > 0) & np.isfinite(r)


PINHOLE = ("fx", "fy", "cx", "cy")
FISHEYE = ("k1", "k2", "k3", "k4")
FISHEYE624 = (*(f"k{n}" for n in range(6)), "p0", "p1", "s0", "s1", "s2", "s3")
RADTAN = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")  # in the order of OpenCV
_METASHAPE = ("k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")
# Each model with its parameters: those that it needs, and those that are 0 where they are not
# stated.
_MODELS: dict[str, tuple[Callable[..., Projected], tuple[str, ...], tuple[str, ...]]] = {
    "ds": (double_sphere, (*PINHOLE, "xi", "alpha"), ()),
    "kb4": (kannala_brandt, PINHOLE, (*FISHEYE, "skew")),
    "omni": (omni, (*PINHOLE, "xi"), ("k1", "k2", "p1", "p2", "skew")),
    "eucm": (unified, (*PINHOLE, "alpha", "beta"), ()),
    "ucm": (unified, (*PINHOLE, "alpha"), ()),
    "pinhole": (pinhole, PINHOLE, (*RADTAN, "skew", "rpmax")),
    "fov": (field_of_view, (*PINHOLE, "w"), ()),
    "fisheye624": (fisheye624, (*PINHOLE, *FISHEYE624), ()),
    "ftheta": (
        ftheta,
        ("cx", "cy", "to_angle", "p1"),
        ("c", "d", "e", *(f"p{k}" for k in range(16))),
    ),
}
for _name in RADII:
    _MODELS[f"metashape {_name}"] = (
        partial(metashape, projection=_name),
        ("f", "cx", "cy"),
        (*_METASHAPE, "b1", "b2"),
    )
    _MODELS[f"hugin {_name}"] = partial(hugin, projection=_name), ("v", "w", "h"), tuple("abcde")
_RANGES: dict[str, tuple[float, float]] = dict.fromkeys(("fx", "fy", "f"), (0.0, 1e6))
_RANGES |= {"alpha": (-1e-12, 1), "beta": (0, 1e3), "xi": (-1, 1e3), "w": (0, 1e6), "v": (1, 360)}


def make_camera_model(model: str, parameters: dict[str, float]) -> Projection:
    """Return the projection of a named model, one of `_MODELS`; `parameters` are keyword arguments
    of its function.

    Raises:
        OmnistereoError: If the model is unknown, or a parameter is missing, unknown or out of
    range.
    """
    if model not in _MODELS:
        raise OmnistereoError(
            f"camera model {model!r} is unknown; expected one of {[*_MODELS][:9]}. Recalibrate "
            "with it"
        )
    function, names, optional = _MODELS[model]
    if not set(names) <= set(parameters) <= {*names, *optional}:
        raise OmnistereoError(
            f"camera model {model!r} needs the parameters {list(names)}, found {list(parameters)}"
        )
    for name, value in parameters.items():
        low, high = _RANGES.get(name, (-1e6, 1e6))
        high = np.pi if (model, name) == ("fov", "w") else high
        if not low < value < high:
            raise OmnistereoError(
                f"{name} = {value} of camera model {model!r} must lie between {low:g} and {high:g}"
            )
    return partial(function, **parameters)


def _components(rays: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    rays = np.asarray(rays, np.float64)
    return rays[..., 0], rays[..., 1], rays[..., 2], np.linalg.norm(rays, axis=-1)


def _radtan(x: Floats, y: Floats, **coefficients: float) -> tuple[Floats, Floats]:
    """Distort points of the normalised plane with the coefficients `RADTAN`, 0 where they are not
    given.
    """
    k1, k2, p1, p2, k3, k4, k5, k6 = (dict.fromkeys(RADTAN, 0.0) | coefficients).values()
    r2 = x * x + y * y
    return _distorted(
        x, y, Polynomial([1, k1, k2, k3])(r2) / Polynomial([1, k4, k5, k6])(r2), p1, p2
    )


def _distorted(
    x: Floats, y: Floats, radial: Floats, p1: float | Floats, p2: float | Floats
) -> tuple[Floats, Floats]:
    """Scale points of the normalised plane, and add the tangential distortion of OpenCV."""
    r2 = x * x + y * y
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )


def _to_pixels(
    x: Floats, y: Floats, fx: float, fy: float, cx: float, cy: float, skew: float = 0.0
) -> Floats:
    return np.stack([fx * x + skew * y + cx, fy * y + cy], -1)


def _pinhole(
    x: Floats, y: Floats, depth: Floats, fx: float, fy: float, cx: float, cy: float
) -> Floats:
    with np.errstate(divide="ignore", invalid="ignore"):
        return _to_pixels(x / depth, y / depth, fx, fy, cx, cy)


def _first_maximum(r: Polynomial) -> float:
    """Return the smallest positive argument at which a polynomial stops increasing, or infinity."""
    roots = r.deriv().roots()
    return float(roots[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)].real.min(initial=np.inf))


def _unified_limit(alpha: float) -> float:
    """Return w: rays with z > -w |ray| project one to one through the sphere and the shifted
    pinhole.
    """
    return alpha / (1 - alpha) if alpha <= 0.5 else (1 - alpha) / alpha
