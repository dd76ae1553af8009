"""Camera models of other programs: each takes rays to a plane, which an affine map takes to pixels.

`make_camera_model` makes such a projection, `fit.fit_ocam` samples it and fits the polynomial
camera, so that the rest of the library uses a single camera class.

References: Usenko et al. 2018, "The double sphere camera model" (double sphere and the unified
models); Kannala and Brandt 2006 (here with the four coefficients of OpenCV); Mei and Rives 2007
(omni); Devernay and Faugeras 2001 (fov); the manuals of OpenCV (pinhole) and Metashape;
projectaria-tools (fisheye624), NVIDIA's DriveWorks (f-theta).
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.field_of_view import Projected, Projection
from omnistereo_lib.geometry.pose import Floats

# Full field of view; beyond it a pixel of a pinhole camera is wider than four at its centre.
MAX_PINHOLE_DEG = 120.0
_ON_AXIS = 1e-300  # from the axis, where 1 / n would overflow
PINHOLE = ("fx", "fy", "cx", "cy")
FISHEYE = ("k1", "k2", "k3", "k4")
FISHEYE624 = (*(f"k{n}" for n in range(6)), "p0", "p1", "s0", "s1", "s2", "s3")
RADTAN = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")  # in the order of OpenCV
F_THETA = tuple(f"p{k}" for k in range(1, 16))
METASHAPE = ("k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")

# x and y on the plane, and where they exist and are one to one; elsewhere they mean nothing.
Plane = tuple[Floats, Floats, NDArray[np.bool_]]


def _double_sphere(rays: Floats, xi: float, alpha: float) -> Plane:
    """Two unit spheres xi > -1 apart, then a pinhole alpha / (1 - alpha) behind the second one."""
    x, y, z, length = _components(rays)
    shifted = xi * length + z
    depth = alpha * np.sqrt(x * x + y * y + shifted * shifted) + (1 - alpha) * shifted
    w1 = _unified_limit(alpha)
    w2 = (w1 + xi) / np.sqrt(2 * w1 * xi + xi * xi + 1)
    return x / depth, y / depth, z > -w2 * length


def _unified(rays: Floats, alpha: float, beta: float = 1.0) -> Plane:
    """An ellipsoid of shape beta > 0, then a pinhole behind it; beta = 1 is the sphere (UCM)."""
    x, y, z, _ = _components(rays)
    length = np.sqrt(beta * (x * x + y * y) + z * z)
    depth = alpha * length + (1 - alpha) * z
    return x / depth, y / depth, z > -_unified_limit(alpha) * length


def _omni(rays: Floats, xi: float, **radtan: float) -> Plane:
    """A unit sphere seen from xi ≥ 0 behind its centre, then k1, k2, p1 and p2 of OpenCV."""
    x, y, z, length = _components(rays)
    x, y = _radtan(x / (z + xi * length), y / (z + xi * length), radtan)
    return x, y, z > -_unified_limit(xi / (1 + xi)) * length


def _pinhole(rays: Floats, rpmax: float = 0.0, **radtan: float) -> Plane:
    """The pinhole model of OpenCV with its distortion, valid within 120°.

    `rpmax` is the largest radius before the distortion that basalt allows; 0 sets no limit.
    """
    x, y, z, length = _components(rays)
    valid = z > np.cos(np.radians(MAX_PINHOLE_DEG / 2)) * length
    x, y = x / z, y / z
    valid &= (rpmax == 0) | (np.hypot(x, y) <= rpmax)
    return *_radtan(x, y, radtan), valid


def _field_of_view(rays: Floats, w: float) -> Plane:
    """The FOV model (ATAN): r = atan(2 tan(θ) tan(w / 2)) / w, valid below θ = 90°."""
    x, y, valid = _radial(
        rays, lambda theta: np.arctan2(2 * np.sin(theta) * np.tan(w / 2), np.cos(theta)) / w
    )
    return x, y, valid & (rays[..., 2] > 1e-9 * np.linalg.norm(rays, axis=-1))


def _kannala_brandt(rays: Floats, **k: float) -> Plane:
    """r(θ) = θ + k1 θ³ + k2 θ⁵ + k3 θ⁷ + k4 θ⁹, θ from the axis, valid as far as r increases.

    Also called OpenCV fisheye, kb4 or pinhole-equidistant. OpenCV divides by z and stops at 90°;
    θ = atan2(hypot(x, y), z) does not.
    """
    return _radial(rays, _odd([k.get(name, 0.0) for name in FISHEYE]))


# The radius on the plane at an angle from the axis, by the usual names of the projections.
RADII: dict[str, Callable[[Any], Any]] = {
    "rectilinear": lambda t: np.where(t < np.radians(MAX_PINHOLE_DEG / 2), np.tan(t), np.nan),
    "equidistant": lambda theta: theta,
    "equisolid": lambda theta: 2 * np.sin(theta / 2),
}


def _metashape(rays: Floats, projection: str, **distortion: float) -> Plane:
    """One of `RADII`, then the distortion of a pinhole camera.

    k4 is the coefficient of r⁸; p1 and p2 are the p2 and p1 of OpenCV, and grow with
    1 + p3 r² + p4 r⁴.
    """
    *k, p1, p2, p3, p4 = (distortion.get(name, 0.0) for name in METASHAPE)
    x, y, valid = _radial(rays, RADII[projection])
    r2 = x * x + y * y
    grown = 1 + p3 * r2 + p4 * r2 * r2
    return *_distorted(x, y, Polynomial([1, *k])(r2), p2 * grown, p1 * grown), valid


def _fisheye624(rays: Floats, p0: float, p1: float, **more: float) -> Plane:
    """Six radial, two tangential (p0, p1) and four thin prism terms.

    The model of Project Aria, COLMAP's RAD_TAN_THIN_PRISM_FISHEYE: r = θ + k0 θ³ + … + k5 θ¹³; then
    x += 2 x (p0 x + p1 y) + p0 r² + s0 r² + s1 r⁴, and y with p1, s2, s3.
    """
    *k, s0, s1, s2, s3 = (more[name] for name in FISHEYE624 if name not in ("p0", "p1"))
    x, y, valid = _radial(rays, _odd(k))
    r2, dot = x * x + y * y, 1 + 2 * (p0 * x + p1 * y)
    return x * dot + r2 * (p0 + s0 + s1 * r2), y * dot + r2 * (p1 + s2 + s3 * r2), valid


def _f_theta(rays: Floats, to_angle: float, **p: float) -> Plane:
    """A polynomial p1 x + p2 x² + …: θ of a radius (to_angle = 1), or r(θ), as far as it grows."""
    r = Polynomial([0, *(p.get(name, 0.0) for name in F_THETA)])
    if not to_angle:
        return _radial(rays, _increasing(r))
    radii = np.linspace(0, min(_end(r), 1e3), 1 << 17)  # linear between them: 1e-8 of a radius
    return _radial(rays, lambda theta: np.interp(theta, r(radii), radii, right=np.nan))


class _Model(NamedTuple):
    plane: Callable[..., Plane]
    needed: tuple[str, ...]
    optional: tuple[str, ...] = ()  #: 0 where they are not stated


_MODELS = {
    "ds": _Model(_double_sphere, ("xi", "alpha")),
    "kb4": _Model(_kannala_brandt, (), FISHEYE),
    "omni": _Model(_omni, ("xi",), RADTAN[:4]),
    "eucm": _Model(_unified, ("alpha", "beta")),
    "ucm": _Model(_unified, ("alpha",)),
    "pinhole": _Model(_pinhole, (), (*RADTAN, "rpmax")),
    "fov": _Model(_field_of_view, ("w",)),
    "fisheye624": _Model(_fisheye624, FISHEYE624),
    "ftheta": _Model(_f_theta, ("to_angle", "p1"), F_THETA[1:]),
}
for _name in RADII:
    _MODELS[f"metashape {_name}"] = _Model(partial(_metashape, projection=_name), (), METASHAPE)
_RANGES: dict[str, tuple[float, float]] = dict.fromkeys(("fx", "fy"), (1.0, 1e6))
_RANGES |= {"alpha": (-1e-12, 1), "beta": (0, 1e3), "xi": (-1, 1e3), "w": (0, np.pi)}


def make_camera_model(model: str, parameters: Mapping[str, Any]) -> Projection:
    """Return the projection of a named model: rays (..., 3) → pixels (..., 2), valid (...).

    `parameters` are fx, fy, cx, cy in pixels, those of the model, and `skew` and `shear` of the
    affine map u = fx x + skew y + cx, v = shear x + fy y + cy.

    Raises:
        OmnistereoError: If the model is unknown, or a parameter is missing, unknown or out of
            range.
    """
    if model not in _MODELS:
        raise OmnistereoError(
            f"camera model {model!r} is unknown; expected one of {[*_MODELS][:9]}. Recalibrate "
            "with it"
        )
    plane, needed, optional = _MODELS[model]
    needed = (*PINHOLE, *needed)
    if not set(needed) <= set(parameters) <= {*needed, *optional, "skew", "shear"}:
        raise OmnistereoError(
            f"camera model {model!r} needs the parameters {list(needed)}, found {list(parameters)}"
        )
    for name, value in parameters.items():
        low, high = _RANGES.get(name, (-1e6, 1e6))
        if not low < value < high:
            raise OmnistereoError(
                f"{name} = {value} of camera model {model!r} must lie between {low:g} and {high:g}"
            )
    return partial(_project, plane=plane, **parameters)


def _project(
    rays: Floats,
    plane: Callable[..., Plane],
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    skew: float = 0.0,
    shear: float = 0.0,
    **own: float,
) -> Projected:
    with np.errstate(all="ignore"):  # where it is not valid
        x, y, valid = plane(np.asarray(rays, np.float64), **own)
        return np.stack([fx * x + skew * y + cx, shear * x + fy * y + cy], -1), valid


def _components(rays: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    return rays[..., 0], rays[..., 1], rays[..., 2], np.linalg.norm(rays, axis=-1)


def _radial(rays: Floats, radius: Callable[[Floats], Floats]) -> Plane:
    """Return the points of the plane at radius(θ) in the direction of the rays."""
    x, y, z, _ = _components(rays)
    n = np.hypot(x, y)
    scale = radius(np.arctan2(n, z)) / np.maximum(n, _ON_AXIS)
    return x * scale, y * scale, ((n > _ON_AXIS) | (z > 0)) & np.isfinite(scale)


def _odd(k: list[float]) -> Callable[[Floats], Floats]:
    """Return θ + k[0] θ³ + k[1] θ⁵ + … as far as it increases."""
    return _increasing(Polynomial([0, 1, *(term for each in k for term in (0, each))]))


def _increasing(r: Polynomial) -> Callable[[Floats], Floats]:
    """Return a polynomial of θ as far as it increases, NaN beyond."""
    end = _end(r)
    return lambda theta: np.where(theta < end, r(theta), np.nan)


def _end(r: Polynomial) -> float:
    """Return the least positive argument at which a polynomial stops increasing, or infinity."""
    roots = r.deriv().roots()
    return float(roots[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)].real.min(initial=np.inf))


def _radtan(x: Floats, y: Floats, coefficients: Mapping[str, float]) -> tuple[Floats, Floats]:
    """Distort points of the plane with the coefficients `RADTAN`, 0 where they are not given."""
    k1, k2, p1, p2, k3, k4, k5, k6 = (coefficients.get(name, 0.0) for name in RADTAN)
    r2 = x * x + y * y
    radial = Polynomial([1, k1, k2, k3])(r2) / Polynomial([1, k4, k5, k6])(r2)
    return _distorted(x, y, radial, p1, p2)


def _distorted(x: Floats, y: Floats, radial: Any, p1: Any, p2: Any) -> tuple[Floats, Floats]:
    """Scale points of the plane, and add the tangential distortion of OpenCV."""
    r2 = x * x + y * y
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )


def _unified_limit(alpha: float) -> float:
    """Return w: rays with z > -w |ray| project one to one by sphere and shifted pinhole."""
    return alpha / (1 - alpha) if alpha <= 0.5 else (1 - alpha) / alpha
