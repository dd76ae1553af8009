"""Polynomial fisheye camera Π (paper, Section III-A; Scaramuzza 2006, Urban 2015).

The direct polynomial f maps a pixel to a ray, the inverse polynomial r maps a ray to a pixel::

    ray(x, y) ∝ (x, y, -f(r)),  r = hypot(x, y)   pixels from the centre, before the affine map A
    r(t) = b0 + b1 t + b2 t² + ...                t = atan2(-Z, hypot(X, Y)), below the xy-plane

The angle from the optical axis is t + π/2. Nothing is divided by Z, so 180° are nothing special.

Camera frame: x right, y down, z along the optical axis. Pixels: (u right, v down), integers are
pixel centres, (0, 0) is the centre of the top-left pixel. Files store (row, column).
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from types import ModuleType
from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyder
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.arrays import as_array
from omnistereo_lib.errors import OmnistereoError, check_number
from omnistereo_lib.lazy import lazy_property

# A NumPy array or a torch tensor: both have every operation used here.
Array = Any

# Of an image, in pixels.
MAX_SIDE = 100_000
# In pixels, the tolerance of OCamCalib.
INVERSE_TOLERANCE = 0.01
# In pixels; keeps the corner pixels inside the image after the rounding of a round trip.
EDGE = 1e-6
# Starting from 1024 samples, the error falls 1e-3 → 1e-6 → 1e-12 → rounding.
_NEWTON_STEPS = 4


@dataclass(frozen=True, eq=False)
class OcamCamera:
    """A fisheye camera with polynomial distortion.

    Raises an `OmnistereoError` if a parameter is not finite, of the wrong shape or out of range.

    >>> camera = osl.load_rig("data_samples/sunny/test").cameras[0]
    >>> # ahead, to the right, behind
    >>> uv, valid = camera.project([[0, 0, 1], [1, 0, 0], [0, 0, -1]])
    >>> uv.round(1)
    array([[400.4, 383. ],
           [702.2, 383. ],
           [400.4, 383. ]])
    >>> valid
    array([ True,  True, False])
    >>> bool(np.allclose(camera.unproject(uv[1])[0], [1, 0, 0]))
    True
    """

    #: direct polynomial f, coefficients from low to high, pixels; f(0) < 0
    poly: NDArray[np.float64]
    #: inverse polynomial r(t), likewise; see `fit_inverse_polynomial`
    inv_poly: NDArray[np.float64]
    center: tuple[float, float]  #: image of the optical axis (u, v), pixels
    #: c, d, e of A as in the files: u = x + e y + u0, v = d x + c y + v0
    affine: tuple[float, float, float]
    image_size: tuple[int, int]  #: width and height, pixels
    #: full field of view in (0, 360]; rays beyond half of it from the axis are invalid
    max_fov_deg: float = 220.0
    #: (height, width), of any numeric type, stored as bool: non-zero where the image is valid;
    #: None: everywhere
    mask: NDArray[np.bool_] | None = None
    max_radius: float = field(init=False, repr=False)  # of the field of view, px before A

    def __post_init__(self) -> None:
        object.__setattr__(self, "poly", np.array(self.poly, np.float64))
        object.__setattr__(self, "inv_poly", np.array(self.inv_poly, np.float64))
        if self.mask is not None:
            object.__setattr__(self, "mask", as_array(self.mask, "mask", None) != 0)
        self._check()
        for array in (self.poly, self.inv_poly, self.mask):
            if array is not None:
                array.setflags(write=False)
        # plain, not NumPy scalars
        for name, number in (("center", float), ("affine", float), ("image_size", int)):
            object.__setattr__(self, name, tuple(map(number, getattr(self, name))))
        object.__setattr__(self, "max_fov_deg", float(self.max_fov_deg))
        object.__setattr__(self, "max_radius", float(_horner(self.inv_poly, self._max_t)))

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what is kept: a copy in another process makes its own."""
        return {one.name: getattr(self, one.name) for one in fields(self)}

    def _check(self) -> None:
        for name in ("poly", "inv_poly"):
            coefficients = getattr(self, name)
            if (
                coefficients.ndim != 1
                or not 2 <= len(coefficients) <= 64
                or not np.isfinite(coefficients).all()
            ):
                raise OmnistereoError(
                    f"{name} is {str(coefficients.tolist())[:200]}; expected 2 to 64 finite"
                    " coefficients"
                )
        width, height = (
            check_number(side, "image_size", 2, MAX_SIDE, whole=True)
            for side in _all(self.image_size, 2)
        )
        check_number(self.max_fov_deg, "max_fov_deg", 1, 360)
        for name, count, most in (("center", 2, 10 * MAX_SIDE), ("affine", 3, 100)):
            for number in _all(getattr(self, name), count):
                check_number(number, name, -most, most)
        if abs(np.linalg.det(self._A)) < 1e-6:
            raise OmnistereoError(
                f"the affine map c, d, e = {self.affine} is singular; expected about (1, 0, 0)"
            )
        if self.poly[0] >= 0:
            raise OmnistereoError(
                f"poly starts with {self.poly[0]}; expected a0 < 0 (minus the focal length in px)"
            )
        if self.mask is not None and self.mask.shape != (height, width):
            raise OmnistereoError(
                f"mask has shape {self.mask.shape}; expected (height, width) = {(height, width)}"
            )

        with np.errstate(all="ignore"):
            radii = _horner(self.inv_poly, np.linspace(-np.pi / 2, self._max_t, 64))
        if not (np.abs(radii) < 100 * MAX_SIDE).all():
            raise OmnistereoError(
                f"inv_poly reaches {np.abs(radii).max():.3g} px; expected radii as in an image"
            )
        if radii.min() > self._reach:
            raise OmnistereoError(
                f"inv_poly starts at {radii.min():.3g} px; expected 0 on the optical axis"
            )

    @property
    def _A(self) -> NDArray[np.float64]:
        c, d, e = self.affine
        return np.array([[1.0, e], [d, c]])

    @property
    def _reach(self) -> float:
        """Return the distance of the farthest corner of the image from the centre, px before A."""
        width, height = self.image_size
        corners = np.array([[0, 0], [width, 0], [0, height], [width, height]]) - 0.5 - self.center
        return float(np.linalg.norm(corners @ np.linalg.inv(self._A).T, axis=-1).max())

    @property
    def _max_t(self) -> float:
        return float(np.radians(self.max_fov_deg / 2) - np.pi / 2)

    @property
    def pixels_per_degree(self) -> float:
        """Mean resolution of the lens from its axis to the rim of the field of view."""
        return self.max_radius / (self.max_fov_deg / 2)

    def project(self, points: Array, use_direct_poly: bool = False) -> tuple[Array, Array]:
        """Project points to pixels: A(Π(X; Φ)) (paper, Section III-A).

        Args:
            points (array or torch tensor, shape (..., 3)): Points in the camera frame; only their
                direction matters, at any length between 1e-150 and 1e150.
            use_direct_poly: False: evaluate the inverse polynomial, as every released code does.
                True: find the root of the direct polynomial, for files whose two polynomials
                disagree; of tensors, on the CPU only.

        Returns:
            uv (shape (..., 2), pixels): Meaningful where valid; finite elsewhere, so that it can be
            interpolated. valid (bool, shape (...)): In the field of view, in the image, on the
            mask; False for undefined directions.

        Raises:
            OmnistereoError: If points has another shape, or the direct polynomial ends earlier.
        """
        points, xp = _as_array(points, 3)
        x, y, z = points[..., 0], points[..., 1], points[..., 2]
        # The angle below the xy-plane, t = atan2(-Z, n), and the radius r(t). NumPy's hypot would
        # take as long as all the rest.
        n = xp.sqrt(x * x + y * y)
        t = xp.arctan2(-z, n)
        finite = xp.isfinite(n) & xp.isfinite(z) & ((n > 0) | (z != 0))
        in_view = finite & (t <= self._max_t + 1e-12)
        # The polynomial is undefined further out.
        t = xp.where(in_view, t, self._max_t)
        if use_direct_poly:
            r = xp.asarray(self._radius_by_root(t, self._max_t), dtype=t.dtype)
        else:
            r = _horner(self.inv_poly, t)
        # Points on the axis project to the centre.
        off_axis = finite & (n > 0)
        n = xp.where(off_axis, n, 1.0)
        # Divide first: r / n can overflow close to the axis.
        x, y = (xp.where(off_axis, side, 0.0) / n * r for side in (x, y))
        c, d, e = self.affine
        uv = xp.stack([x + e * y + self.center[0], d * x + c * y + self.center[1]], -1)
        return uv, in_view & self.contains(uv)

    def sees(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return `valid` of `project`; quickly where the whole field of view is in the image."""
        if not self._whole_view:
            return self.project(points)[1]
        x, y, z = points[..., 0], points[..., 1], points[..., 2]
        # The angle atan2(-Z, n) is at most t where -Z cos t ≤ n sin t, which takes no arctangent.
        n, t = np.sqrt(x * x + y * y), self._max_t + 1e-12
        finite = np.isfinite(n) & np.isfinite(z) & ((n > 0) | (z != 0))
        return finite & (-z * np.cos(t) <= n * np.sin(t))

    @lazy_property
    def _whole_view(self) -> bool:
        """Whether every ray of the field of view meets the image, a hundredth of a pixel inside."""
        r = float(np.abs(_horner(self.inv_poly, np.linspace(-np.pi / 2, self._max_t, 1024))).max())
        reach = (r + 0.01) * np.linalg.norm(self._A, axis=1)  # (2,): of a circle through A
        low, high = self.center - reach, self.center + reach
        return self.mask is None and bool(
            (low >= 0).all() and (high <= np.subtract(self.image_size, 1)).all()
        )

    def unproject(
        self, uv: ArrayLike, use_direct_poly: bool = False
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return the unit rays of pixels: the inverse of `project` with the same `use_direct_poly`.

        Args:
            uv: array, shape (..., 2), pixels
            use_direct_poly: False: invert the inverse polynomial. True: use the direct one.

        Returns:
            rays: shape (..., 3), unit length, camera frame
            valid (bool, shape (...)): In the image, on the mask, in the field of view; the
            polynomial is monotonic.
        """
        pixels, _ = _as_array(as_array(uv, "uv"), 2)
        finite = np.isfinite(pixels).all(-1)
        u, v = np.moveaxis(np.where(finite[..., None], pixels, 0.0) - self.center, -1, 0)
        # Undo A, then go from the radius to the angle t by one of the two polynomials.
        (i00, i01), (i10, i11) = np.linalg.inv(self._A)
        x, y = i00 * u + i01 * v, i10 * u + i11 * v
        r = np.sqrt(x * x + y * y)
        if use_direct_poly:
            t = np.arctan2(_horner(self.poly, r), r)
            max_radius, _ = _branch_end(self.poly, self._max_t, 3 * max(self.image_size))
        else:
            t, max_radius = self._angle_by_root(r), self.max_radius
        # The sine of the angle from the axis, t + π/2: the ray is (x/r cos t, y/r cos t, -sin t).
        sine = np.cos(t)
        safe_r = np.where(r > 0, r, 1.0)
        rays = np.stack([x / safe_r * sine, y / safe_r * sine, -np.sin(t)], -1)
        rays = np.where((r > 0)[..., None], rays, [0.0, 0.0, 1.0])
        return rays, finite & self.contains(pixels) & (t <= self._max_t + 1e-9) & (
            r <= max_radius + 1e-6
        )

    def contains(self, uv: Array) -> Array:
        """Return whether pixels (..., 2) lie inside the image and on the mask: (...)."""
        width, height = self.image_size
        u, v = uv[..., 0], uv[..., 1]
        low, right, bottom = -EDGE, width - 1 + EDGE, height - 1 + EDGE
        inside = (u >= low) & (u <= right) & (v >= low) & (v <= bottom)
        if self.mask is None:
            return inside
        _, xp = _as_array(uv, 2)
        column = xp.where(inside, u, xp.zeros_like(u)).round()
        row = xp.where(inside, v, xp.zeros_like(v)).round()
        if xp is np:
            return inside & self.mask[row.astype(int), column.astype(int)]
        return inside & xp.tensor(self.mask, device=uv.device)[row.long(), column.long()]

    def visible_pixels(self) -> NDArray[np.bool_]:
        """Return which pixels lie on the image circle and the mask, shape (height, width)."""
        return self._visible_pixels.copy()

    @lazy_property
    def _visible_pixels(self) -> NDArray[np.bool_]:
        width, height = self.image_size
        u, v = np.arange(width) - self.center[0], np.arange(height)[:, None] - self.center[1]
        # As in `unproject`, without the angles: they take most of its time. And without a product
        # of (height, width, 2) and (2, 2), which NumPy does slowly.
        (a, b), (c, d) = np.linalg.inv(self._A)
        inside = (a * u + b * v) ** 2 + (c * u + d * v) ** 2 <= (self.max_radius + 1e-6) ** 2
        return inside if self.mask is None else inside & self.mask

    def reduced(self, factor: int) -> OcamCamera:
        """Return the camera of images whose blocks of factor × factor pixels are averaged."""
        if factor == 1:
            return self
        if factor not in self._reduced:
            self._reduced[factor] = self._of_blocks(factor)
        return self._reduced[factor]

    @lazy_property
    def _reduced(self) -> dict[int, OcamCamera]:
        return {}

    def _of_blocks(self, factor: int) -> OcamCamera:
        width, height = (size // factor for size in self.image_size)
        mask = self.mask
        if mask is not None:
            blocks = mask[: height * factor, : width * factor].reshape(
                height, factor, width, factor
            )
            mask = np.all(blocks, axis=(1, 3))
        return replace(
            self,
            # f(r) = factor f'(r / factor)
            poly=self.poly * float(factor) ** np.arange(-1, len(self.poly) - 1),
            inv_poly=self.inv_poly / factor,
            center=((self.center[0] + 0.5) / factor - 0.5, (self.center[1] + 0.5) / factor - 0.5),
            image_size=(width, height),
            mask=mask,
        )

    def inverse_poly_error_px(self) -> float:
        """Return the largest distance in pixels between `poly` and `inv_poly`, where it sees.

        Raises an `OmnistereoError` if the direct polynomial does not reach as far.
        """
        t = np.linspace(-np.pi / 2 + 1e-6, self._max_t, 2000)
        radii = _horner(self.inv_poly, t)
        inside = radii <= self._reach
        return float(np.abs(self._radius_by_root(t[inside], t[inside][-1]) - radii[inside]).max())

    def _radius_by_root(self, t: ArrayLike, max_t: float) -> NDArray[np.float64]:
        """Find the smallest root r > 0 of f(r) cos t = r sin t, t ≤ max_t, by Newton's method."""
        # A ray at angle t meets f(r) where tan t = f(r) / r. Written without a quotient it has no
        # pole, and Newton's method starts from samples of the branch.
        radii, angles = _monotone_branch(self.poly, max_t, 3 * max(self.image_size))
        slope = polyder(self.poly)
        t = np.asarray(t, np.float64)
        r, cosine, sine = np.interp(t, angles, radii), np.cos(t), np.sin(t)
        for _ in range(_NEWTON_STEPS):
            r = r - (_horner(self.poly, r) * cosine - r * sine) / (
                _horner(slope, r) * cosine - sine
            )
        return r

    def _angle_by_root(self, r: NDArray[np.float64]) -> NDArray[np.float64]:
        """Solve r(t) = r for t by Newton's method, clipped to the field of view."""
        angles = np.linspace(-np.pi / 2, self._max_t, 1024)
        radii = _horner(self.inv_poly, angles)
        slope = polyder(self.inv_poly)
        t = np.interp(r, np.maximum.accumulate(radii), angles)
        for _ in range(_NEWTON_STEPS):
            step = (_horner(self.inv_poly, t) - r) / _horner(slope, t)
            t = np.clip(t - step, -np.pi / 2, self._max_t)
        return t


def fit_inverse_polynomial(
    poly: ArrayLike, max_fov_deg: float, max_radius: float, tolerance: float = INVERSE_TOLERANCE
) -> NDArray[np.float64]:
    """Fit the inverse polynomial r(t) with the lowest degree that reaches the tolerance.

    Args:
        poly: Direct polynomial, low to high, pixels.
        max_fov_deg: Full field of view to cover.
        max_radius: Upper bound of the radius in pixels, such as three times the image's side.
        tolerance: Largest error in pixels.

    Returns:
        array, shape (degree + 1,), low to high

    Raises:
        OmnistereoError: If a0 ≥ 0, the direct polynomial is not monotonic up to the end of the
            field of view, or no degree up to 25 fits.

    >>> from omnistereo_lib.geometry.camera import fit_inverse_polynomial
    >>> fit_inverse_polynomial([-200, 0, 1e-3], max_fov_deg=180, max_radius=500).round(1)
    array([447.2, 499.6, 275.6, 150.1,  62.3,  18.8,   2.6])
    """
    # Sample the direct polynomial, then fit degree after degree until one is near enough.
    max_t = np.radians(max_fov_deg / 2) - np.pi / 2
    radii, angles = _monotone_branch(np.asarray(poly, np.float64), max_t, max_radius)
    for degree in range(3, 26):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", np.exceptions.RankWarning)  # the error says it
            fit = np.polynomial.Polynomial.fit(angles, radii, degree)
        error = np.abs(fit(angles) - radii).max()
        if error < tolerance:
            return np.asarray(fit.convert().coef, np.float64)
    raise OmnistereoError(
        f"poly {np.asarray(poly)}: the inverse polynomial of degree 25 has an error of {error:.3g}"
        f" px; expected at most {tolerance} px. Lower max_fov_deg = {max_fov_deg} to the field of"
        " view of the lens."
    )


def _branch_end(poly: NDArray[np.float64], max_t: float, max_radius: float) -> tuple[float, float]:
    """Return the radius and the angle t up to which the angle grows with the radius, or max_t."""
    radii = np.linspace(0.0, max_radius, 4096)
    angles = np.arctan2(_horner(poly, radii), radii)
    # stops at NaN from overflow as well
    growing = int(np.argmin(np.append(np.diff(angles) > 0, False)))
    end = min(int(np.searchsorted(angles[: growing + 1], max_t)), growing)
    return float(radii[end]), float(angles[end])


def _monotone_branch(
    poly: NDArray[np.float64], max_t: float, max_radius: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Sample radii and angles t of the direct polynomial up to max_t; refuse if it ends before."""
    if poly[0] >= 0:
        raise OmnistereoError(
            f"poly starts with {poly[0]}; expected a0 < 0 (minus the focal length in px)"
        )
    radius, angle = _branch_end(poly, max_t, max_radius)
    if angle < max_t:
        raise OmnistereoError(
            f"the direct polynomial {poly.tolist()} is monotonic only up to"
            f" {np.degrees(2 * angle) + 180:.1f}° of field of view (within {max_radius:.0f} px);"
            f" expected {np.degrees(2 * max_t) + 180:.1f}°. Lower max_fov_deg or check the"
            " coefficients."
        )
    # Sampled again, densely: the angle is steep in r near the axis of long lenses.
    radii = np.linspace(0.0, radius, 1024)
    return radii, np.arctan2(_horner(poly, radii), radii)


def _horner(coefficients: NDArray[np.floating], x: Array) -> Array:
    """Evaluate a polynomial, coefficients from low to high."""
    value = x * 0.0 + float(coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        value = value * x
        value += float(coefficient)
    return value


def _all(values: Any, count: int) -> tuple[Any, ...]:
    if not isinstance(values, Sequence | np.ndarray) or len(values) != count:
        raise OmnistereoError(f"found {values!r}; expected {count} numbers")
    return tuple(values)


def _namespace(a: Array) -> ModuleType:
    """Return torch for a tensor, NumPy for anything else; torch is not imported."""
    torch = sys.modules.get("torch")
    return torch if torch is not None and isinstance(a, torch.Tensor) else np


def _as_array(a: Any, width: int) -> tuple[Array, ModuleType]:
    xp = _namespace(a)
    a = as_array(a, "the array") if xp is np else a
    if a.ndim < 1 or a.shape[-1] != width:
        raise OmnistereoError(f"the array has shape {tuple(a.shape)}; expected (..., {width})")
    return a, xp
