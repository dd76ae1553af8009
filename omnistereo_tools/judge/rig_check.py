"""Rig check against the images: inverted poses, a wrong unit, swapped or mirrored images, a rotated camera.

Each usual mistake is undone, and the rig is wrong if the images then match much better. The measure is the matching
cost of the best sphere: below 0.1 where the geometry is right, above 0.3 where unrelated places are compared. One wrong
picture of four lies between: half of the pairs are right.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations, product

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.rig import Pairs, Rig, camera_pairs
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.progress import Progress, counted, silent
from omnistereo_lib.stereo.images import reduce_images
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_lib.stereo.volume import cost_volume
from omnistereo_lib.stereo.zncc import ZNCC

_BETTER = 0.75  # a mistake is reported if undoing it brings the cost below this fraction,
_NOISE = 0.01  # and by more than this
_BETTER_ROTATED = 0.9  # the same for one camera; right rigs about 1, 2° off 0.3 to 0.8 on the sample sets
_ROTATION_PX = 1.5  # panorama pixels by which a camera is rotated; less than one is not resolved
_FITS = 0.1  # below this median cost no other order is tried; a few right rigs cost up to 0.17
_CLEAR = 0.94  # these cost below this fraction of any alternative; 0.63 to 0.933, with one wrong picture 0.949 and more
_HOPELESS = 0.25  # above this median cost no hypothesis fits, and no rotated camera is looked for
_NO_OVERLAP = 0.5  # cost of a patch without texture, which is no evidence for or against a match
_UNITS = {1000: ("mm", "m"), 100: ("cm", "m"), 10: ("mm", "cm")}  # large unit / small unit: (small, large)


@dataclass(frozen=True)
class RigHypothesis:
    """A rig with one mistake undone, and how well the images then match."""

    name: str  # "as given", or the mistake that is undone
    cost: float  # median over the rays of the matching cost of the best sphere, in [0, 1]
    given_cost: float  # the same for the rig as given


@dataclass(frozen=True)
class RigCheck:
    """Result of `check_rig`."""

    given: RigHypothesis
    alternatives: list[RigHypothesis]  # mistakes of the whole rig undone, best first
    # One camera rotated, costs over its own pairs, largest improvement first. Empty for fewer than 3 cameras, or if
    # the rig is wrong already.
    rotated: list[RigHypothesis]

    @property
    def mistake(self) -> RigHypothesis | None:
        """The hypothesis that explains the images much better than the rig as given, if there is one."""
        best = self.alternatives[0]
        if best.cost < min(_BETTER * best.given_cost, best.given_cost - _NOISE):
            return best
        return next((one for one in self.rotated[:1] if one.cost < _BETTER_ROTATED * one.given_cost), None)

    @property
    def fits(self) -> bool:
        """Whether the rig is right."""
        highest = max(_FITS, min(_CLEAR * self.alternatives[0].cost, _HOPELESS))
        return self.mistake is None and self.given.cost <= highest

    def summary(self) -> str:
        """Return the result as a sentence."""
        mistake, cost = self.mistake, self.given.cost
        if mistake is not None:
            change = f"the median matching cost would fall from {mistake.given_cost:.3f} to {mistake.cost:.3f}"
            if mistake in self.rotated and mistake.cost > _FITS:  # the right rotation would fit
                return f"{mistake.name}, or its image is of another moment: {change}, where below 0.1 fits. Check both"
            return f"{mistake.name}: {change}. Fix the file and check again"
        if not self.fits:
            return (
                f"neither the rig as given nor any usual mistake explains the images: the median matching cost is "
                f"{cost:.3f}, expected below 0.1. Check that the images were taken at the same time by these cameras"
            )
        return (
            f"the rig fits the images: the median matching cost is {cost:.3f}, "
            f"that of the next best hypothesis {self.alternatives[0].cost:.3f}"
        )


def check_rig(
    rig: Rig, images: Sequence[ArrayLike], grid: SphereGrid, progress: Progress = silent, with_units: bool = True
) -> RigCheck:
    """Match the images with the rig as given and with each usual mistake undone.

    The images are first reduced to the resolution of the panorama, below which their detail is noise.

    Images do not tell the length of a metre: a rig that is too large sees the same scene further away. `min_depth`,
    the nearest depth in metres, tells it, and the number of spheres, whose steps are too wide for such a rig; more
    spheres tell it less clearly, fewer suspect a right rig in a wide place.

    Args:
        images: one array per camera
        grid: A small one, such as 320 × 80 with 64 spheres. A rotated camera is found from about one pixel on, 1.1°
            here.
        progress: Called as `progress(done, total, what)`: for the mistakes, then for the cameras that may be rotated.
        with_units: Whether to try other units. False where `min_depth` comes from the rig: it scales with the rig.

    Raises:
        OmnistereoError: If the images do not fit the cameras.
    """
    rig, images = reduce_images(rig, images, grid.width / 360)
    sweep = SphereSweep(rig, grid)
    cost = matching_cost(sweep, images)
    given = RigHypothesis("as given", cost, cost)
    tried = [(name, other.T_rig_cam, images) for name, other in _other_poses(rig, grid, with_units)]
    tried += [(name, None, changed) for name, changed in _other_images(images)]
    others = []
    step = counted(progress, len(tried))
    for name, poses, pictures in tried:
        step("mistakes")
        other = matching_cost(sweep if poses is None else sweep.with_poses(poses), pictures)
        others.append(RigHypothesis(name, other, cost))
    step("")
    check = RigCheck(given, sorted(others, key=lambda one: one.cost), [])
    if check.mistake is not None or cost > _HOPELESS or len(rig) < 3:
        return check
    rotated = []
    step = counted(progress, len(rig))
    for camera in range(len(rig)):
        step(f"camera {camera + 1} of {len(rig)}")
        rotated.append(_rotated_camera(sweep, images, camera))
    step("")
    return replace(check, rotated=sorted(rotated, key=lambda one: one.cost / max(one.given_cost, 1e-9)))


def other_order(rig: Rig, images: Sequence[ArrayLike], grid: SphereGrid) -> str | None:
    """Return what to do if the images match much better in another order, or one of them mirrored; a quick look.

    Raises an `OmnistereoError` if the images do not fit the cameras.
    """
    rig, images = reduce_images(rig, images, grid.width / 360)
    sweep = SphereSweep(rig, grid)
    given = matching_cost(sweep, images)
    if given <= _FITS:
        return None
    cost, name = min((matching_cost(sweep, changed), name) for name, changed in _other_images(images))
    return name if cost < min(_BETTER * given, given - _NOISE) else None


def matching_cost(sweep: SphereSweep, images: Sequence[ArrayLike], pairs: Pairs = "ring") -> float:
    """Return the median over all rays of the best raw ZNCC cost, in [0, 1]; 0.5 where no pair shares a view."""
    valid = [sweep.project_sphere(camera, 0)[1] for camera in range(len(sweep.rig))]
    if not any((valid[i] & valid[j]).any() for i, j in camera_pairs(pairs, sweep.rig)):
        return _NO_OVERLAP
    volume = cost_volume(sweep, images, ZNCC(window=9), pairs)  # the limits above are of this window
    lowest = torch.where(volume.isnan(), torch.inf, volume).amin(-1)
    return float(lowest[lowest.isfinite()].median())


def invert_poses(rig: Rig) -> Rig:
    """Return the rig with every pose inverted."""
    return rig.with_poses([pose.inverse() for pose in rig.T_rig_cam])


def scale_translations(rig: Rig, factor: float) -> Rig:
    """Return the rig with every translation multiplied by a factor."""
    return rig.with_poses([Pose(pose.R, factor * pose.t) for pose in rig.T_rig_cam])


def rotate_camera(rig: Rig, camera: int, axis_angle: ArrayLike) -> Rig:
    """Return the rig with one camera rotated about its own axes; axis-angle (3,) in radians."""
    rotation = Pose.from_vector([*np.asarray(axis_angle), 0.0, 0.0, 0.0])
    return rig.with_poses([pose @ rotation if i == camera else pose for i, pose in enumerate(rig.T_rig_cam)])


def _rotated_camera(sweep: SphereSweep, images: Sequence[ArrayLike], camera: int) -> RigHypothesis:
    """Return a camera with the rotation that its own pairs prefer: about one axis, or a Newton step about all three.

    Costs of different pairs are not comparable: in a room they differ by a factor of four with the right rig, while
    a rotation by 2° raises them by a fifth. So each camera is compared with itself.
    """
    rig, pixel = sweep.rig, 2 * np.pi / sweep.grid.width
    angle = _ROTATION_PX * pixel
    pairs = [pair for pair in camera_pairs("all", rig) if camera in pair]

    def cost(axis_angle: NDArray) -> float:
        return matching_cost(sweep.with_poses(rotate_camera(rig, camera, axis_angle).T_rig_cam), images, pairs)

    given_cost = matching_cost(sweep, images, pairs)
    steps = angle * np.concatenate([np.eye(3), -np.eye(3)])
    costs = np.array([cost(step) for step in steps])
    slopes, curvatures = (costs[:3] - costs[3:]) / 2, costs[:3] + costs[3:] - 2 * given_cost
    newton = angle * (-slopes / np.maximum(curvatures, 1e-9)).clip(-1, 1)
    newton *= np.linalg.norm(newton) >= pixel  # less may match better by chance
    lowest, step = min((cost(newton), newton), (costs.min(), steps[costs.argmin()]), key=lambda pair: pair[0])
    name = f"camera {camera + 1} looks rotated by about {np.degrees(np.linalg.norm(step)):.1f}°"
    return RigHypothesis(name, float(lowest), given_cost)


def _other_poses(rig: Rig, grid: SphereGrid, with_units: bool) -> Iterator[tuple[str, Rig]]:
    """Yield (what is wrong with the poses, the rig with that undone)."""
    yield "the poses look inverted (rig → camera instead of camera → rig)", invert_poses(rig)
    for factor, (small, large) in _UNITS.items() if with_units else ():
        far = f"or nothing is nearer than {factor * grid.min_depth:g} m (then raise min_depth)"
        long = f"the translations look {factor} times too long ({small} read as {large}?), {far}"
        yield long, scale_translations(rig, 1 / factor)
        short = f"the translations look {factor} times too short ({large} read as {small}?)"
        yield short, scale_translations(rig, factor)
    for camera, degrees in product(range(len(rig)), (90, 180, 270)):
        name = f"camera {camera + 1} looks rolled by {degrees}° (clockwise as it looks)"
        yield name, rotate_camera(rig, camera, [0, 0, np.radians(degrees)])


def _other_images(images: list[NDArray]) -> Iterator[tuple[str, list[NDArray]]]:
    """Yield (what is wrong with the images, the images with that undone)."""
    for order in _other_orders(images):
        name = f"the images look swapped (give them in the order {' '.join(str(i + 1) for i in order)})"
        yield name, [images[i] for i in order]
    for k, image in enumerate(images):
        yield f"image {k + 1} looks mirrored", [*images[:k], np.fliplr(image), *images[k + 1 :]]


def _other_orders(images: list[NDArray]) -> Iterator[tuple[int, ...]]:
    """Yield the other orders of the images: all of them up to four cameras, else swaps of two."""
    n = len(images)
    swaps = (tuple({i: j, j: i}.get(k, k) for k in range(n)) for i, j in combinations(range(n), 2))
    for order in permutations(range(n)) if n <= 4 else swaps:
        if order != tuple(range(n)) and all(images[i].shape == images[k].shape for k, i in enumerate(order)):
            yield order
