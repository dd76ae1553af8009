"""Does this rig fit these images? Tries the usual mistakes and says which one would explain them better.

The judge is the cost that the best sphere reaches: below 0.1 where the geometry is right, 0.3 and more where the
images are compared at places that have nothing to do with each other.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import cv2
import torch
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.sweep import SphereSweep, check_images
from omnistereo_lib.stereo.volume import camera_pairs, cost_volume

_BETTER = 0.75  # a mistake is reported when undoing it brings the cost below this share,
_NOISE = 0.01  # and by more than this
_HOPELESS = 0.25  # a median cost above this means that nothing tried fits
_NO_VIEW = 0.5  # what a patch without texture costs: nothing speaks for a match, nothing against it
_UNITS = {1000: ("mm", "m"), 100: ("cm", "m"), 10: ("mm", "cm")}  # by what factor one is shorter than the other


@dataclass(frozen=True)
class Reading:
    """One way to read a rig, and how well the images then match.

    Attributes
    ----------
    name : str
        "as given", or the mistake that it undoes.
    cost : float
        Median over the rays of the best sphere's matching cost, in [0, 1].
    """

    name: str
    cost: float


def check_rig(rig: Rig, images: Sequence[ArrayLike], grid: SphereGrid) -> list[Reading]:
    """Match the images with the rig as it is and with each usual mistake undone.

    The images are first made as small as the panorama, without which their fine detail is noise.

    Images alone do not tell how long a metre is: a rig that is too large sees the same things further away. What
    tells it is `min_depth`, the nearest thing in metres, and the number of spheres, whose steps are too wide for
    such a rig; more spheres tell it less clearly, fewer suspect a right rig in a wide place.

    Parameters
    ----------
    rig : Rig
    images : one array per camera
    grid : SphereGrid
        A small one, such as 320 × 80 with 64 spheres.

    Returns
    -------
    list of Reading
        The rig as given first, then the others from the best on. `verdict` puts it into words.

    Raises
    ------
    OmnistereoError
        If the images do not fit the cameras.
    """
    rig, images = _shrunk(rig, check_images(images, rig), grid)
    sweep = SphereSweep(rig, grid)
    others = [Reading(name, matching_cost(SphereSweep(other, grid), images)) for name, other in _other_poses(rig, grid)]
    for order in _other_orders(images):
        name = f"the images look swapped (give them in the order {' '.join(str(i + 1) for i in order)})"
        others.append(Reading(name, matching_cost(sweep, [images[i] for i in order])))
    given = Reading("as given", matching_cost(sweep, images))
    return [given, *sorted(others, key=lambda reading: reading.cost)]


def matching_cost(sweep: SphereSweep, images: Sequence[ArrayLike]) -> float:
    """Return the median over all rays of the winner's raw ZNCC cost, in [0, 1]; 0.5 where no cameras share a view."""
    seen = [sweep.pixels(camera, 0)[1] for camera in range(len(sweep.rig))]
    if not any((seen[i] & seen[j]).any() for i, j in camera_pairs("ring", sweep.rig)):
        return _NO_VIEW
    volume = cost_volume(sweep, images)
    lowest = torch.where(volume.isnan(), torch.inf, volume).amin(-1)
    return float(lowest[lowest.isfinite()].median())


def verdict(readings: list[Reading]) -> tuple[bool, str]:
    """Return whether the rig is right, and a sentence on what `check_rig` found."""
    given, best = readings[0], readings[1]
    if best.cost < min(_BETTER * given.cost, given.cost - _NOISE):
        change = f"the median matching cost would fall from {given.cost:.3f} to {best.cost:.3f}"
        return False, f"{best.name}: {change}. Mend the file and check again"
    if given.cost > _HOPELESS:
        return False, (
            f"neither the rig as given nor any usual mistake explains the images: the median matching cost is "
            f"{given.cost:.3f}, below 0.1 is usual. Are they of one moment, and the calibration of these cameras?"
        )
    return True, (
        f"the rig fits the images: the median matching cost is {given.cost:.3f}, "
        f"that of the next best reading {best.cost:.3f}"
    )


def inverted(rig: Rig) -> Rig:
    """Return the rig with every pose inverted."""
    return rig.with_poses([pose.inverse() for pose in rig.T_rig_cam])


def scaled(rig: Rig, factor: float) -> Rig:
    """Return the rig with every translation multiplied."""
    return rig.with_poses([Pose(pose.R, factor * pose.t) for pose in rig.T_rig_cam])


def _other_poses(rig: Rig, grid: SphereGrid) -> Iterator[tuple[str, Rig]]:
    """Yield (what is wrong with the poses, the rig with that undone)."""
    yield "the poses look inverted (rig → camera instead of camera → rig)", inverted(rig)
    for factor, (small, large) in _UNITS.items():
        far = f"or nothing is nearer than {factor * grid.min_depth:g} m (then raise min_depth)"
        yield (
            f"the translations look {factor} times too long ({small} read as {large}?), {far}",
            scaled(rig, 1 / factor),
        )
        yield f"the translations look {factor} times too short ({large} read as {small}?)", scaled(rig, factor)


def _other_orders(images: list[NDArray]) -> Iterator[tuple[int, ...]]:
    """Yield the orders of the images other than the given one: all up to four cameras, else swaps of two."""
    n = len(images)
    for order in permutations(range(n)) if n <= 4 else _swaps(n):
        if order != tuple(range(n)) and all(images[i].shape == images[k].shape for k, i in enumerate(order)):
            yield order


def _swaps(n: int) -> Iterator[tuple[int, ...]]:
    for i in range(n):
        for j in range(i + 1, n):
            order = list(range(n))
            order[i], order[j] = j, i
            yield tuple(order)


def _shrunk(rig: Rig, images: list[NDArray], grid: SphereGrid) -> tuple[Rig, list[NDArray]]:
    """Return cameras and images with about one pixel for each of the panorama's; equal sizes stay equal."""
    cameras, pictures = [], []
    widest = max(camera.max_fov_deg for camera in rig.cameras)
    for camera, image in zip(rig.cameras, images, strict=True):
        factor = max(1, round(camera.image_size[0] / widest / (grid.width / 360)))
        camera = _shrunk_camera(camera, factor)
        width, height = camera.image_size
        image = image[: height * factor, : width * factor]
        cameras.append(camera)
        pictures.append(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA))
    return Rig(cameras, rig.T_rig_cam), pictures


def _shrunk_camera(camera: OcamCamera, factor: int) -> OcamCamera:
    """Return the camera of images whose squares of factor × factor pixels were averaged to one."""
    width, height = (size // factor for size in camera.image_size)
    mask = camera.mask
    if mask is not None:
        squares = mask[: height * factor, : width * factor].reshape(height, factor, width, factor)
        mask = squares.all((1, 3))
    return replace(
        camera,
        poly=[a * float(factor) ** (k - 1) for k, a in enumerate(camera.poly)],  # f(r) = factor f'(r / factor)
        inv_poly=camera.inv_poly / factor,
        center=tuple((c + 0.5) / factor - 0.5 for c in camera.center),
        image_size=(width, height),
        mask=mask,
    )
