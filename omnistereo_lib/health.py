"""Does this rig fit these images? Tries the usual mistakes and says which one would explain them better.

The judge is the cost that the best sphere reaches: around 0.1 where the geometry is right, around 0.3 where the
images are compared at places that have nothing to do with each other.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations

import torch
from numpy.typing import ArrayLike

from omnistereo_lib.pose import Pose
from omnistereo_lib.rig import Rig
from omnistereo_lib.sphere import SphereGrid
from omnistereo_lib.sweep import SphereSweep, check_images
from omnistereo_lib.volume import cost_volume

_BETTER = 0.75  # a mistake is reported when undoing it brings the cost below this share
_SCALES = {1000.0: "mm", 100.0: "cm", 10.0: "dm"}  # how many times too long metres are that were these


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


def matching_cost(rig: Rig, images: Sequence[ArrayLike], grid: SphereGrid) -> float:
    """Return the median over all rays of the winner's raw ZNCC cost, in [0, 1]; 0.5 where nothing is seen."""
    volume = cost_volume(SphereSweep(rig, grid), images)
    lowest = torch.where(volume.isnan(), torch.inf, volume).amin(-1)
    return float(lowest[lowest.isfinite()].median())


def check_rig(rig: Rig, images: Sequence[ArrayLike], grid: SphereGrid) -> list[Reading]:
    """Match the images with the rig as it is and with each usual mistake undone.

    Parameters
    ----------
    rig : Rig
    images : one array per camera
    grid : SphereGrid
        A small one will do, such as 320 × 80 with 32 spheres; its min_depth must suit the scene.

    Returns
    -------
    list of Reading
        The rig as given first, then the others from the best on. `verdict` puts it into words.
    """
    images = check_images(images, rig)
    given = Reading("as given", matching_cost(rig, images, grid))
    others = [Reading(name, matching_cost(other, pictures, grid)) for name, other, pictures in _mistakes(rig, images)]
    return [given, *sorted(others, key=lambda reading: reading.cost)]


def verdict(readings: list[Reading]) -> str:
    """Return one sentence on what `check_rig` found."""
    given, best = readings[0], readings[1]
    if best.cost < _BETTER * given.cost:
        return (
            f"FAIL  {best.name}: the median matching cost would fall from {given.cost:.3f} to {best.cost:.3f}. "
            "Mend the file and check again"
        )
    return (
        f"OK    the rig fits the images: median matching cost {given.cost:.3f}, the next best reading {best.cost:.3f}"
    )


def _mistakes(rig: Rig, images: list) -> Iterator[tuple[str, Rig, list]]:
    """Yield (what is wrong, the rig mended, the images in the mended order) for every mistake tried."""
    yield "the poses look inverted (rig → camera instead of camera → rig)", inverted(rig), images
    for scale, unit in _SCALES.items():
        yield f"the translations look like {unit}, not metres", scaled(rig, 1 / scale), images
        yield f"the translations look {scale:.0f} times too short", scaled(rig, scale), images
    for order in _orders(rig, images):
        names = " ".join(str(i + 1) for i in order)
        yield f"the images look swapped: cameras 1 2 3 … took images {names}", rig, [images[i] for i in order]


def inverted(rig: Rig) -> Rig:
    """Return the rig with every pose inverted."""
    return rig.with_poses([pose.inverse() for pose in rig.T_rig_cam])


def scaled(rig: Rig, factor: float) -> Rig:
    """Return the rig with every translation multiplied."""
    return rig.with_poses([Pose(pose.R, factor * pose.t) for pose in rig.T_rig_cam])


def _orders(rig: Rig, images: list) -> Iterator[tuple[int, ...]]:
    """Yield the orders of the images other than the given one: all up to four cameras, else swaps of two."""
    n = len(rig)
    same = tuple(range(n))
    for order in permutations(range(n)) if n <= 4 else _swaps(n):
        fits = all(images[i].shape == image.shape for i, image in zip(order, images, strict=True))
        if order != same and fits:
            yield order


def _swaps(n: int) -> Iterator[tuple[int, ...]]:
    for i in range(n):
        for j in range(i + 1, n):
            order = list(range(n))
            order[i], order[j] = j, i
            yield tuple(order)
