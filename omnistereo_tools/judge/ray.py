"""Why a ray has its depth: which cameras see it, at which depths their patches agree, and one
sentence about it.

`output/page/ray.js` computes the same numbers in the browser; `tests/tools/test_viewer.py` compares
the two.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.errors import check_number
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.sensitivity import inverse_depth_shifts
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.depth import Depth
from omnistereo_lib.stereo.error_bars import WITHIN
from omnistereo_tools.judge.trust import likely

PATCH_DEG = 5.0  # side of a patch: as wide as ZNCC's window at 640 columns, 9 rays
SIDE = 11  # samples along it
TILT_DEG = 0.1  # error of one camera whose effect is told
SURE = 0.9  # how likely a depth is right, from its error bars, that is told without a doubt
ALIKE = 0.5  # of the agreement of the best two cameras: others that agree, too
CLEAR = 0.8  # of the agreement at the estimate: a second depth that is below stands no comparison
WEAK = 0.25  # agreement that is none
VALLEY = 0.1  # by which the agreement falls between two depths that count as two
WIDE = 4.0  # tolerances that a plateau reaches from the estimate: then the curve decides nothing
FLAT = 2.0  # gray values, standard deviation of a patch without texture
NEARER = 0.8  # of a distance: what is this much nearer stands in front
AROUND_DEG = 3.4  # how far around a ray the depths beside it are looked up
# In tolerances: a tenth of the depths around, and the nearest of all, are within and beyond that of
# another depth at which the patches agree. Then a surface is there, or it only looks alike.
BESIDE, NOWHERE = 0.5, 5.0
# In tolerances, between neighbouring rays: less is a slope, such as the road, and no edge.
JUMP = 1.0
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
    likely: float  #: how likely that is right, see `trust.likely`; NaN without error bars
    nearest: float  #: metres, at the near end of the 95 % bound; NaN without error bars
    #: (rows, columns), sphere indices of the estimates around the ray, NaN unknown
    around: NDArray[np.float64]
    sees: NDArray[np.bool_]  #: (cameras,), whose field of view holds the estimated point
    hidden: NDArray[np.bool_]  #: (cameras,), of those, from which something nearer hides it
    #: (cameras, N, side, side), gray values; a patch that leaves the view is NaN
    patches: NDArray[np.float64]
    scores: NDArray[np.float64]  #: (pairs, N), ZNCC of each pair of cameras; NaN if one is NaN
    #: gray values, standard deviation of the patch with most texture at the estimate
    contrast: float
    #: 1/m, of the inverse depth if one camera is off by `TILT_DEG`, the worst one; NaN below two
    shift: float

    @property
    def depth(self) -> float:
        """Estimated depth in metres."""
        return float(self.grid.index_to_depth(self.index))

    @cached_property
    def agreement(self) -> NDArray[np.float64]:
        """Mean of the scores over the pairs of cameras, (N,); NaN below two cameras."""
        counted = np.isfinite(self.scores).sum(0)
        total = np.nansum(self.scores, axis=0)
        return np.where(counted, total / np.maximum(counted, 1), np.nan)

    @cached_property
    def modes(self) -> list[Mode]:
        """Depths at which the patches agree, best first, with a `VALLEY` between any two."""
        found: list[Mode] = []
        values = np.nan_to_num(self.agreement, nan=-1.0)
        for n in np.argsort(-values, kind="stable"):
            between = (
                values[min(n, mode.sphere) : max(n, mode.sphere) + 1].min() for mode in found
            )
            if values[n] > 0 and all(low < values[n] - VALLEY for low in between):
                found.append(Mode(int(n), float(values[n])))
        return found

    @cached_property
    def peak(self) -> Mode | None:
        """Where the patches agree best within the `tolerance` of the estimate; None: unknown."""
        off = np.abs(np.arange(len(self.agreement)) - self.index)
        near = np.where(off <= tolerance(self.index), self.agreement, np.nan)
        if np.isnan(near).all():
            return None
        return Mode(n := int(np.nanargmax(near)), float(near[n]))

    @property
    def chosen(self) -> float:
        """Agreement at the `peak`, NaN unknown."""
        return self.peak.agreement if self.peak else np.nan

    @property
    def alike(self) -> int:
        """How many cameras agree at the peak: in the best pair, and in pairs nearly as good."""
        if self.peak is None:
            return 0
        at, pairs = self.scores[:, self.peak.sphere], combinations(range(len(self.sees)), 2)
        least = ALIKE * np.nanmax(at)
        good = [pair for pair, score in zip(pairs, at, strict=True) if score >= least]
        return len({camera for pair in good for camera in pair})

    @cached_property
    def plateau(self) -> tuple[int, int]:
        """First and last sphere around the peak up to which the agreement falls by no `VALLEY`."""
        if self.peak is None:
            return 0, -1
        lower = np.flatnonzero(~(self.agreement >= self.peak.agreement - VALLEY))
        place = int(np.searchsorted(lower, self.peak.sphere))
        first, last = [-1, *lower, len(self.agreement)][place : place + 2]
        return int(first) + 1, int(last) - 1

    @property
    def is_wide(self) -> bool:
        """Whether the plateau is wide, or higher beyond the tolerance of the estimate."""
        first, last = self.plateau
        reach = np.abs(np.subtract(self.plateau, self.index)).max()
        higher = (self.agreement[first : last + 1] > self.chosen).any()
        return bool(higher or reach > WIDE * tolerance(self.index))

    @cached_property
    def rival(self) -> Mode | None:
        """The depth beside the plateau of the estimate at which the patches agree best."""
        (first, last), least = self.plateau, tolerance(self.index)
        others = (mode for mode in self.modes if not first <= mode.sphere <= last)
        return next((mode for mode in others if abs(mode.sphere - self.index) > least), None)

    @property
    def kind(self) -> str:
        """Which of the `SENTENCES` is true: the first whose rule holds."""
        other, sure = self.rival.agreement if self.rival else -1.0, self.likely >= SURE
        agrees = self.chosen >= WEAK  # False where it is NaN
        if np.isnan(self.agreement).all():
            return "unseen"
        if self.sees.any() and self.contrast < FLAT:
            return "flat"
        if not agrees and other < WEAK:
            return "unlike"
        if agrees and self.is_wide:
            return "wide"
        if agrees and other < CLEAR * self.chosen:
            return "agrees" if sure else "weak"
        if sure:
            return "decided"
        return "either" if agrees and CLEAR * other <= self.chosen else "elsewhere"

    @property
    def note(self) -> str:
        """Which of the `NOTES` is added to the sentence."""
        if self.kind == "weak":
            return "nearest" if np.isfinite(self.nearest) else ""
        if self.kind not in ("decided", "either", "elsewhere") or self.rival is None:
            return ""
        # Repetition and an edge differ by what is around, and hardly by which cameras agree.
        known = self.around[np.isfinite(self.around)]
        off = np.sort(np.abs(known - self.rival.sphere) / tolerance(known))
        if off[len(off) // 10] <= BESIDE:
            return "edge" if self.jump > JUMP * tolerance(self.index) else ""
        return "look-alike" if off[0] > NOWHERE else ""

    @property
    def jump(self) -> float:
        """Spheres by which rays around differ at most, between the estimate and the rival."""
        rival = self.rival.sphere if self.rival else self.index
        between = self.around.clip(min(self.index, rival), max(self.index, rival))
        steps = [np.abs(np.diff(between, axis=axis)).ravel() for axis in (0, 1)]
        return float(np.nanmax(np.concatenate(steps), initial=0.0))

    @property
    def sentence(self) -> str:
        """Why the depth is what it is, and whether to believe it."""
        spheres = [self.rival.sphere if self.rival else 0, *self.plateau]
        other, farther, nearer = (told(float(self.grid.index_to_depth(n))) for n in spheres)
        return (SENTENCES[self.kind] + NOTES[self.note]).format(
            count=self.alike,
            depth=told(self.depth),
            other=other,
            nearest=told(self.nearest),
            nearer=nearer,
            farther=farther,
        )


# `python -m workshop ray-sentences` measures how often each is right: book/own_cameras.md.
SENTENCES = {
    "unseen": "Fewer than two cameras see this direction: no stereo can know its depth.",
    "flat": "There is no texture here: the depth comes from the rays beside it.",
    "agrees": "{count} cameras agree around {depth}, clearly better than elsewhere.",
    "weak": "{count} cameras agree best around {depth}, but it is not certain.",
    "wide": (
        "The cameras agree about as well anywhere from {nearer} to {farther}: {depth} comes from"
        " the rays beside it."
    ),
    "decided": (
        "Everything around it speaks for {depth}; the cameras agree about as well, or better, at"
        " {other}."
    ),
    "either": "{count} cameras agree at {depth}, and about as well at {other}: it may be either.",
    "elsewhere": (
        "The cameras agree better at {other}, and the rays beside it speak for {depth}: doubtful."
    ),
    "unlike": "The cameras hardly agree at any depth: {depth} comes from the rays beside it.",
}
NOTES = {
    "": "",
    "nearest": " It is unlikely to be nearer than {nearest}.",
    "edge": " Perhaps there is an edge, with something at {other} beside it.",
    "look-alike": " Nothing around it is at {other}, so {depth} is likelier.",
}


def told(depth: float) -> str:
    """Return a depth as everything on the page tells it, such as "5.89 m", "12.8 m"."""
    if not depth <= 1e6:
        return "infinitely far" if depth > 1e6 else "unknown"
    return f"{depth:.{0 if depth >= 100 else 1 if depth >= 10 else 2}f} m"


def for_the_page() -> dict[str, Any]:
    """Return what the viewer's script has to know of this module."""
    return {
        "patchDeg": PATCH_DEG,
        "side": SIDE,
        "tiltDeg": TILT_DEG,
        "within": WITHIN,
        "sure": SURE,
        "alike": ALIKE,
        "clear": CLEAR,
        "weak": WEAK,
        "valley": VALLEY,
        "wide": WIDE,
        "flat": FLAT,
        "nearer": NEARER,
        "onTheWay": ON_THE_WAY,
        "aroundDeg": AROUND_DEG,
        "beside": BESIDE,
        "nowhere": NOWHERE,
        "jump": JUMP,
        "sentences": SENTENCES,
        "notes": NOTES,
    }


def tolerance(index: ArrayLike) -> NDArray[np.float64]:
    """Return how many spheres off an index is still right: two, or a tenth of the depth."""
    return np.maximum(2.0, 0.1 * np.asarray(index, np.float64))


def depths_around(depth: Depth, column: int, row: int) -> NDArray[np.float64]:
    """Return the sphere indices of the rays within `AROUND_DEG`, (rows, columns); NaN unknown."""
    reach = max(1, round(AROUND_DEG * depth.grid.width / 360))
    rows = slice(max(0, row - reach), row + reach + 1)
    columns = np.arange(column - reach, column + reach + 1) % depth.grid.width
    return np.asarray(depth.index[rows, columns], np.float64)


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
    sigma, bound = depth.sigma[row, column], depth.bound[row, column]
    visible = depth.sweep.keep("visible", lambda: [one.visible_pixels() for one in rig.cameras])
    views = zip(rig.cameras, visible, rig.T_rig_cam, depth.images, strict=True)
    patches = np.stack(
        [
            patches_of(camera, mask, pose.inverse(), np.asarray(image), ray, grid.inverse_depths())
            for camera, mask, pose, image in views
        ]
    )  # (cameras, N, side, side)
    pairs = list(combinations(range(len(rig)), 2))
    scores = np.stack([zncc(patches[i], patches[j]) for i, j in pairs])  # (pairs, N)
    spreads = np.std(patches[:, 0 if np.isnan(index) else round(index)], axis=(1, 2))
    sees = ~np.isnan(spreads) & np.isfinite(index)
    hidden = sees & np.array(
        [is_hidden(depth.depth, grid, ray, index, center) for center in rig.centers]
    )
    return Ray(
        grid,
        index,
        float(likely(tolerance(index) * grid.step, sigma, bound)),
        1 / float(depth.inverse_depth[row, column] + bound),
        depths_around(depth, column, row),
        sees,
        hidden,
        patches,
        scores,
        float(np.nanmax(spreads)) if sees.any() else 0.0,
        tilt_shift(ray, float(grid.index_to_inverse_depth(index)), rig.centers, sees & ~hidden),
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
    """Return the samples of a patch across a unit ray, to the right and down, (side, side, 3)."""
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
    ray: NDArray[np.float64],
    inverse_depth: float,
    centers: NDArray[np.float64],
    sees: NDArray[np.bool_],
) -> float:
    """Return by how much an error of `TILT_DEG` of one camera moves the inverse depth of a ray,
    1/m, at the worst; NaN below two cameras. See `inverse_depth_shifts`.
    """
    shifts = inverse_depth_shifts(ray, np.array(inverse_depth), centers, sees)
    return float(np.radians(TILT_DEG) * shifts.max())
