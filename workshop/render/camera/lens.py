"""The lens: Blender's polynomial θ(r), and OCam's of the same rays. NumPy alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

# the sensor in pixels for which lens numbers are given
REFERENCE_WIDTH, REFERENCE_HEIGHT = 800, 768
_MIDDLE = (np.array([REFERENCE_WIDTH, REFERENCE_HEIGHT]) - 1) / 2
SENSOR_MM = 36.0  # Blender's sensor width; any value would do
MAX_FOV_DEG = 220.0
# beyond the field of view, so that the last valid pixels still have neighbours
_RENDERED_MARGIN_DEG = 6.0
_FIT_TOLERANCE_PX = 2e-3
_MAX_DEGREE = 12


@dataclass(frozen=True)
class Lens:
    """A fisheye with θ(r) = k₁ r + k₃ r³ + k₄ r⁴, θ in radians from the axis, r in pixels of the
    800 × 768 sensor.

    There is no r² term: it would give the OCam polynomial a linear term, which its definition
    excludes.

    Args:
        k: k₁, k₃, k₄.
        centre: Where the axis meets the sensor, (u, v) in pixels, integers being pixel centres.
        max_fov_deg: Field of view, the full angle.
    """

    k: tuple[float, float, float]
    center: tuple[float, float]
    max_fov_deg: float = MAX_FOV_DEG

    @property
    def rendered_fov_deg(self) -> float:
        """Full angle that is rendered: the field of view and a margin."""
        return self.max_fov_deg + _RENDERED_MARGIN_DEG

    def theta(self, r: ArrayLike) -> NDArray[np.float64]:
        """Return the angle from the axis in radians at r pixels from the centre."""
        r, (k1, k3, k4) = np.asarray(r, np.float64), self.k
        return r * (k1 + r * r * (k3 + r * k4))

    def radius(self, theta: ArrayLike) -> NDArray[np.float64]:
        """Return the distance from the centre, px: the inverse of `theta`, by Newton."""
        theta, (k1, k3, k4) = np.asarray(theta, np.float64), self.k
        r = theta / k1
        for _ in range(20):
            r = r - (self.theta(r) - theta) / (k1 + 3 * k3 * r**2 + 4 * k4 * r**3)
        return r

    def blender_coefficients(self) -> tuple[float, ...]:
        """Return fisheye_polynomial_k0 … k4: −θ by r in millimetres on the sensor."""
        px_per_mm = REFERENCE_WIDTH / SENSOR_MM
        k1, k3, k4 = self.k
        return 0.0, -k1 * px_per_mm, 0.0, -k3 * px_per_mm**3, -k4 * px_per_mm**4

    def blender_shift(self) -> tuple[float, float]:
        """Return the camera's shift_x, shift_y that put the axis at `centre`, in widths and heights
        of the picture.

        Blender's manual has both in units of the longer side; of a panoramic camera that is not so.
        """
        u, v = self.center
        return ((REFERENCE_WIDTH - 1) / 2 - u) / REFERENCE_WIDTH, (
            v - (REFERENCE_HEIGHT - 1) / 2
        ) / REFERENCE_HEIGHT


@dataclass(frozen=True)
class OcamFit:
    """OCam parameters of a lens at one image size, in its pixels; low to high order."""

    poly: NDArray[np.float64]
    inv_poly: NDArray[np.float64]
    center: tuple[float, float]  # (u, v)
    residual_px: float  # worst error of `poly`, as far as images go
    inverse_residual_px: float  # worst error of `inv_poly`


def random_lens(rng: np.random.Generator) -> Lens:
    """Draw a lens like the published ones: a₀ about −196.66 px, 110° at about 377 px.

    k₃ is the one that an OCam polynomial of the usual degree 4 follows to 0.06 px.
    """
    focal = 196.66 + rng.normal(0, 0.5)
    edge = 377.0 + rng.normal(0, 0.5)
    linear = edge / focal
    cubic = 0.3325 + 3.8 * (1.9170 - linear)
    quartic = np.radians(MAX_FOV_DEG / 2) - linear - cubic
    center = tuple((_MIDDLE + rng.normal(0, (1.5, 1.152))).tolist())
    return Lens((float(linear / edge), float(cubic / edge**3), float(quartic / edge**4)), center)


def random_fisheye(rng: np.random.Generator, fov_deg: float) -> Lens:
    """Draw a lens of a field of view, the full angle in degrees; its mapping is unlike that of any
    other draw.

    The mappings lie around the equidistant one, between a flatter and a steeper rim, as those of
    real lenses do.
    """
    half = np.radians(fov_deg / 2)
    edge = 373.0 + rng.uniform(-6.0, 6.0)
    linear = half * rng.uniform(0.9, 1.08)
    quartic = -rng.uniform(0.0, 0.35)
    cubic = half - linear - quartic
    center = tuple((_MIDDLE + rng.normal(0, (2.0, 1.5))).tolist())
    return Lens(
        (float(linear / edge), float(cubic / edge**3), float(quartic / edge**4)),
        center,
        float(fov_deg),
    )


def fit_ocam(lens: Lens, width: int = REFERENCE_WIDTH) -> OcamFit:
    """Fit direct and inverse OCam polynomials to a lens, for images `width` pixels wide.

    The degrees grow until the residual is below 0.002 px over the whole rendered field.
    """
    scale = width / REFERENCE_WIDTH
    theta = np.radians(np.linspace(0.02, lens.rendered_fov_deg / 2, 2000))
    r = lens.radius(theta) * scale
    center = tuple((c + 0.5) * scale - 0.5 for c in lens.center)
    for degree in range(4, _MAX_DEGREE + 1):
        poly, residual = _fit_direct(theta, r, degree)
        if residual < _FIT_TOLERANCE_PX:
            break
    for degree in range(6, _MAX_DEGREE + 4):
        inv_poly, inverse_residual = _fit_inverse(theta, r, degree)
        if inverse_residual < _FIT_TOLERANCE_PX:
            break
    return OcamFit(poly, inv_poly, center, residual, inverse_residual)


def _fit_direct(theta: NDArray, r: NDArray, degree: int) -> tuple[NDArray[np.float64], float]:
    """Fit −r / tan θ = a₀ + a₂ r² + …, weighted so that the error is one of pixels."""
    unit = r.max()
    powers = np.array([0, *range(2, degree + 1)])
    basis = (r[:, None] / unit) ** powers
    depth = -r / np.tan(theta)
    dr_dtheta = np.gradient(r, theta)
    # a change of depth by 1 moves the pixel by this much
    weight = np.sin(theta) ** 2 / r * dr_dtheta
    solution = np.linalg.lstsq(basis * weight[:, None], depth * weight, rcond=None)[0]
    error = np.abs(np.arctan2(r, -basis @ solution) - theta) * dr_dtheta
    poly = np.zeros(degree + 1)
    poly[powers] = solution / unit**powers
    return poly, float(error.max())


def _fit_inverse(theta: NDArray, r: NDArray, degree: int) -> tuple[NDArray[np.float64], float]:
    """Fit r = b₀ + b₁ t + … with t = θ − π/2."""
    fit = np.polynomial.Polynomial.fit(theta - np.pi / 2, r, degree)
    return fit.convert().coef, float(np.abs(fit(theta - np.pi / 2) - r).max())
