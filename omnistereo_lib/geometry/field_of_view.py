"""How far a lens sees: as far as its projection is one to one and pixels of the image see it."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.pose import Floats

# Pixels (..., 2), and whether they are valid (...).
Projected = tuple[Floats, NDArray[np.bool_]]
# Takes rays (..., 3).
Projection = Callable[[Floats], Projected]

# The widest common lens; in images without a mask, black corners lie beyond it.
DEFAULT_FOV_DEG = 220.0
ANGLE_STEP = np.radians(0.25)
AZIMUTHS = np.arange(64) * (2 * np.pi / 64)


def ring_rays(theta: Floats) -> Floats:
    """Return unit rays (rings, azimuths, 3) at angles θ from the axis."""
    sine, cosine = np.sin(theta)[:, None], np.cos(theta)[:, None]
    x, y = sine * np.cos(AZIMUTHS), sine * np.sin(AZIMUTHS)
    return np.stack(np.broadcast_arrays(x, y, cosine), -1)


def field_of_view_deg(
    project: Projection,
    image_size: tuple[int, int],
    max_fov_deg: float | None = None,
    mask: NDArray[np.bool_] | None = None,
) -> float:
    """Return the full field of view of a lens in degrees: where the model is one to one and seen.

    Args:
        project, image_size, mask: As for `fit_ocam`.
        max_fov_deg: Limit, degrees. None: none with a mask, 220° without a mask.
    """
    theta, uv, _ = one_to_one(project)
    width, height = image_size
    with np.errstate(invalid="ignore"):
        inside = np.asarray(((uv >= 0) & (uv <= (width - 1, height - 1))).all(-1))
    if mask is not None:
        column, row = np.where(inside[..., None], uv, 0).round().astype(int).transpose(2, 0, 1)
        inside &= mask[row, column]
    if not inside[theta > 0].any():
        raise OmnistereoError(
            f"the camera model projects nothing into the image of {width} × {height} px. Check its"
            " parameters"
        )
    visible = theta[inside.any(1)].max() + ANGLE_STEP
    default = 360.0 if mask is not None else DEFAULT_FOV_DEG
    limit = np.radians(default if max_fov_deg is None else max_fov_deg) / 2
    return float(np.degrees(2 * min(visible, theta.max(), limit)))


def one_to_one(project: Projection) -> tuple[Floats, Floats, Floats]:
    """Return the angles θ up to which radii grow, pixels (rings, azimuths, 2), and their radii."""
    theta = np.arange(0.0, np.pi, ANGLE_STEP)
    uv, valid = project(ring_rays(theta))
    uv = np.where(valid[..., None], uv, np.nan)
    radius = np.linalg.norm(uv - uv[0].mean(0), axis=-1)
    # NaN is not > 0
    kept = np.append(True, (np.diff(radius, axis=0) > 0).all(1)).cumprod().astype(bool)
    return theta[kept], uv[kept], radius[kept]
