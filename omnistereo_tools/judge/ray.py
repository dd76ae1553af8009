"""Why a ray has its depth: which cameras see it, at which depths their patches agree, and one
sentence about it.

`output/page/ray.js` computes the same numbers in the browser; `tests/tools/test_viewer.py` compares
the two.
"""

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import check_number
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.depth import Depth
from omnistereo_tools.output.summary import metres

PATCH_DEG = 5.0  # side of a patch: as wide as ZNCC's window at 640 columns, 9 rays
SIDE = 11  # samples along it
TILT_DEG = 0.1  # error of one camera whose effect is told
ALIKE = 0.6  # agreement from which two patches show the same
RIVAL = 0.15  # agreement that a second depth may lack, and still be as likely
VALLEY = 0.1  # by which the agreement falls between two depths that count as two
FLAT = 2.0  # gray values, standard deviation of a patch without texture
NEARER = 0.8  # of a distance: what is this much nearer stands in front
GRAY = np.array([0.299, 0.587, 0.114])  # BT.601 luma
ON_THE_WAY = 32  # places between a point and a camera where something may stand


@dataclass(frozen=True)
class Mode:
    """A depth at which the patches of a ray agree more than at those around it."""

    sphere: int
    agreement: float  #: mean ZNCC over the pairs of cameras, in [-1, 1]


@dataclass(frozen=True, eq=False)
class Ray:
    """What the images say about one ray of a depth panorama."""

    grid: SphereGrid
    index: float  #: sphere index of the estimate, NaN unknown
    sees: NDArray[np.bool_]  #: (cameras,), whose field of view holds the estimated point
    hidden: NDArray[np.bool_]  #: (cameras,), of those, from which something nearer hides it
    patches: NDArray[
        np.float64
    ]  #: (cameras, N, side, side), gray values; a patch that leaves the view is NaN
    agreement: NDArray[np.float64]  #: (N,), mean ZNCC over the pairs of cameras; NaN below two
    alike: int  #: how many cameras show the same at the estimate
    contrast: (
        float  #: gray values, standard deviation of the patch with most texture at the estimate
    )
    #: 1/m, of the inverse depth if one camera is off by `TILT_DEG`, the worst one; NaN below two
    shift: float

    @property
    def depth(self) -> float:
        """Estimated depth in metres."""
        return float(self.grid.index_to_depth(self.index))

    @property
    def modes(self) -> list[Mode]:
        """Depths at which the patches agree, best first: the agreement falls by `VALLEY` between
        any two.
        """
        found: list[Mode] = []
        values = np.nan_to_num(self.agreement, nan=-1.0)
        for n in np.argsort(-values, kind="stable"):
            between = (
                values[min(n, mode.sphere) : max(n, mode.sphere) + 1].min() for mode in found
            )
            if values[n] > 0 and all(low < values[n] - VALLEY for low in between):
                found.append(Mode(int(n), float(values[n])))
        return found

    @property
    def chosen(self) -> float:
        """Agreement at the estimate: the best within its `tolerance`, NaN unknown."""
        near = np.abs(np.arange(len(self.agreement)) - self.index) <= tolerance(self.index)
        return (
            float(np.nanmax(self.agreement[near]))
            if np.isfinite(self.agreement[near]).any()
            else np.nan
        )

    @property
    def rival(self) -> Mode | None:
        """The depth other than the estimate at which the patches agree best."""
        return next(
            (mode for mode in self.modes if abs(mode.sphere - self.index) > tolerance(self.index)),
            None,
        )

    @property
    def kind(self) -> str:
        """Which of the `SENTENCES` is true: the first whose rule holds."""
        other = self.rival.agreement if self.rival else -1.0
        if self.sees.sum() < 2:
            return "unseen"
        if (self.sees & ~self.hidden).sum() < 2:
            return "hidden"
        if self.contrast < FLAT:
            return "flat"
        if self.chosen >= ALIKE:
            return "repeats" if other > self.chosen - RIVAL else "agrees"
        return "elsewhere" if other >= ALIKE else "unlike"

    @property
    def sentence(self) -> str:
        """Why the depth is what it is, and whether to believe it."""
        other = metres(float(self.grid.index_to_depth(self.rival.sphere))) if self.rival else ""
        return SENTENCES[self.kind].format(
            count=self.alike,
            open=int((self.sees & ~self.hidden).sum()),
            depth=metres(self.depth),
            other=other,
            chosen=self.chosen,
            rival=self.rival.agreement if self.rival else np.nan,
        )


SENTENCES = {
    "unseen": "Fewer than two cameras see this direction: no stereo can know its depth.",
    "hidden": (
        "Something nearer hides this from all cameras but {open}: no stereo can know its depth."
    ),
    "flat": "There is no texture here: the depth comes from the rays beside it.",
    "agrees": "{count} cameras agree at {depth}, and at no other depth.",
    "repeats": (
        "{count} cameras agree at {depth} ({chosen:.2f}), and nearly as well at {other}"
        " ({rival:.2f}): the texture repeats."
    ),
    "elsewhere": (
        "The cameras agree best at {other} ({rival:.2f}), but the rays beside it speak for {depth}."
    ),
    "unlike": (
        "The cameras agree at no depth: they see this from too different sides, or something stands"
        " between."
    ),
}


def for_the_page() -> dict[str, Any]:
    """Return what the viewer's script has to know of this module."""
    return {
        "patchDeg": PATCH_DEG,
        "side": SIDE,
        "tiltDeg": TILT_DEG,
        "alike": ALIKE,
        "rival": RIVAL,
        "valley": VALLEY,
        "flat": FLAT,
        "nearer": NEARER,
        "onTheWay": ON_THE_WAY,
        "sentences": SENTENCES,
    }


def tolerance(index: float) -> float:
    """Return how many spheres an index may be off and still be right: two, or a tenth of the
    depth.
    """
    return max(2.0, 0.1 * index)


def explain(depth: Depth, column: int, row: int) -> Ray:
    """Return what the images of a depth panorama say about one of its rays.

    Args:
        depth: With the images from which it was estimated.
        column, row: Of the ray.

    Raises:
        OmnistereoError: If there is no such ray.
    """
    grid, rig = depth.grid, depth.sweep.rig
    column = int(check_number(column, "column", 0, grid.width - 1, whole=True))
    row = int(check_number(row, "row", 0, grid.height - 1, whole=True))
    ray, index = grid.rays()[row, column], float(depth.index[row, column])
    visible = depth.sweep.keep(
        "visible", lambda: [camera.visible_pixels() for camera in rig.cameras]
    )
    patches = np.stack(
        [
            patches_of(camera, mask, pose.inverse(), np.asarray(image), ray, grid.inverse_depths())
            for camera, mask, pose, image in zip(
                rig.cameras, visible, rig.T_rig_cam, depth.images, strict=True
            )
        ]
    )  # (cameras, N, side, side)
    pairs = list(combinations(range(len(rig)), 2))
    scores = np.stack([zncc(patches[i], patches[j]) for i, j in pairs])  # (pairs, N)
    nearest = 0 if np.isnan(index) else round(index)
    at = scores[:, nearest]
    alike = {
        camera for pair, score in zip(pairs, at, strict=True) if score >= ALIKE for camera in pair
    }
    spreads = np.std(patches[:, nearest], axis=(1, 2))
    sees = ~np.isnan(spreads) & np.isfinite(index)
    hidden = sees & np.array(
        [is_hidden(depth.depth, grid, ray, index, center) for center in rig.centers]
    )
    counted = np.isfinite(scores).sum(0)
    return Ray(
        grid,
        index,
        sees,
        hidden,
        patches,
        np.where(counted, np.nansum(scores, axis=0) / np.maximum(counted, 1), np.nan),
        len(alike),
        float(np.nanmax(spreads)) if sees.any() else 0.0,
        tilt_shift(ray, float(grid.index_to_inverse_depth(index)), rig.centers[sees & ~hidden]),
    )


def patches_of(
    camera: OcamCamera,
    visible: NDArray[np.bool_],
    T_cam_rig: Pose,
    image: NDArray[Any],
    ray: NDArray[np.float64],
    inverse_depths: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return what a camera sees of a square that faces the rig, at each depth along a ray, (N,
    side, side).

    Args:
        visible: (height, width), of `OcamCamera.visible_pixels`.
        image: (height, width) or (height, width, 3), RGB.
        ray: (3,), unit length, rig frame.
        inverse_depths: (N,), 1/m.

    Returns:
        Gray values, sampled bilinearly: NaN for a square of which a sample touches a pixel that is
        not visible.
    """
    square = ray + offsets(ray)  # (side, side, 3), as large as it looks from the sweep centre
    # Times the inverse depth, to stay finite.
    points = square @ T_cam_rig.R.T + inverse_depths[:, None, None, None] * T_cam_rig.t
    uv, valid = camera.project(points)
    height, width = image.shape[:2]
    corner = np.floor(uv).astype(int).clip(0, (width - 2, height - 2))
    part = uv - corner
    column, row, x, y = corner[..., 0], corner[..., 1], part[..., 0], part[..., 1]
    value, valid = np.zeros(x.shape), valid & (part >= 0).all(-1) & (part <= 1).all(-1)
    for down, right in np.ndindex(2, 2):
        weight = (y if down else 1 - y) * (x if right else 1 - x)
        pixels = image[row + down, column + right]
        value += weight * (pixels @ GRAY if image.ndim == 3 else pixels)
        valid &= visible[row + down, column + right]
    return np.where(valid.all((1, 2), keepdims=True), value, np.nan)


def offsets(ray: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the samples of a patch around a unit ray, across it: to the right and down, (side,
    side, 3).
    """
    theta = np.arctan2(ray[0], ray[2])
    right = np.array([np.cos(theta), 0.0, -np.sin(theta)])
    down = np.cross(ray, right)
    steps = np.radians(PATCH_DEG) * (np.arange(SIDE) / (SIDE - 1) - 0.5)
    return steps[:, None, None] * down + steps[None, :, None] * right


def zncc(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the zero-mean normalised cross-correlation of patches (N, side, side), in [-1, 1]; NaN
    if one is NaN.

    0 where a patch is constant.
    """
    a, b = (patch - patch.mean((1, 2), keepdims=True) for patch in (a, b))
    product, power = (a * b).sum((1, 2)), (a * a).sum((1, 2)) * (b * b).sum((1, 2))
    return product / np.sqrt(np.maximum(power, 1e-6))


def is_hidden(
    depths: NDArray[np.float64],
    grid: SphereGrid,
    ray: NDArray[np.float64],
    index: float,
    center: NDArray[np.float64],
) -> bool:
    """Return whether the panorama shows something much nearer on the way from the point of a ray to
    a camera.

    Args:
        depths: (H, W), metres.
        center: Of the camera, (3,), metres.
    """
    if not index > 0:
        return False
    share = (np.arange(ON_THE_WAY) + 0.5)[:, None] / ON_THE_WAY
    places = (1 - share) * ray * float(grid.index_to_depth(index)) + share * center
    surface, inside = grid.look_up(depths, places)
    return bool(np.any(inside & (surface < NEARER * np.linalg.norm(places, axis=-1))))


def tilt_shift(
    ray: NDArray[np.float64], inverse_depth: float, centers: NDArray[np.float64]
) -> float:
    """Return by how much an error of `TILT_DEG` of one camera moves the inverse depth of a ray,
    1/m, at the worst.

    A point that moves along the ray moves in camera i by v_i radians per 1/m, a vector. If camera i
    is rotated by ε, the inverse depth that fits all pairs by least squares moves by ε |Σ_j (v_i -
    v_j)| / Σ |v_i - v_j|²: of two cameras with a baseline b across the ray, by ε / b. NaN below two
    cameras.
    """
    if len(centers) < 2 or np.isnan(inverse_depth):
        return np.nan
    towards = ray - inverse_depth * centers  # (cameras, 3): to the point, times its inverse depth
    length = np.linalg.norm(towards, axis=-1, keepdims=True)
    unit = towards / length
    moves = (unit * (unit * centers).sum(-1, keepdims=True) - centers) / length
    between = moves[:, None] - moves[None]  # (cameras, cameras, 3)
    pull = np.linalg.norm(between.sum(1), axis=-1).max()
    return float(np.radians(TILT_DEG) * pull / (np.square(between).sum() / 2))
