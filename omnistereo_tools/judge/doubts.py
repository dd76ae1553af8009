"""Doubts about input that computes but may mean nothing: poses in a wrong unit, one image twice, swapped images."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.frame import Frame
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.images import reduce_images
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_tools.judge.matching_cost import matching_cost

_TOGETHER = 1e-3  # m
_FAR_APART = 100.0  # m
_MATCHES = 0.1  # median matching cost below which nothing is looked for; a few right rigs cost up to 0.17
_OUTSIDE = 1.5  # times the nearest depth; rigs of the public sets and of the course stay below 0.5


def rig_doubts(rig: Rig, min_depth: float) -> Iterator[str]:
    """Yield what cannot be right with the poses of a rig whose sweep begins at a depth in metres."""
    pairs = list(combinations(range(1, len(rig) + 1), 2))
    together = [f"{i} and {j}" for (i, j), apart in zip(pairs, rig.baselines, strict=True) if apart < _TOGETHER]
    if together:
        yield f"cameras {', '.join(together)} are at one place: they see no depth. Check their translations"
    reach = float(np.linalg.norm(rig.recentered().centers, axis=1).max())
    if rig.baselines.max() > _FAR_APART:
        yield f"the cameras are up to {rig.baselines.max():.3g} m apart. Check the unit of the translations"
    elif reach > _OUTSIDE * min_depth:
        yield (
            f"the cameras are up to {reach:.3g} m from their centre, but the spheres begin at {min_depth:.3g} m, "
            "inside the rig. Check the unit of the translations and the nearest depth"
        )


def same_pictures(images: Sequence[NDArray[Any]]) -> str | None:
    """Return which images of a rig are the same picture, if any are; one that two cameras share is no mistake."""
    same = [
        f"{i} and {j}"
        for (i, a), (j, b) in combinations(enumerate(images, 1), 2)
        if a is not b and np.array_equal(a, b)
    ]
    return f"images {', '.join(same)} are the same picture. Check their paths" if same else None


def image_doubts(frame: Frame, grid: SphereGrid) -> Iterator[str]:
    """Yield what cannot be right with the images of a frame: one coarse cost volume if all is well."""
    if same := same_pictures(frame.images):
        yield same
        return
    coarse = replace(grid, width=160, height=40, num_spheres=16)
    small, reduced = reduce_images(frame.rig, frame.images, coarse.width / 360)
    if matching_cost(SphereSweep(small, coarse), reduced) > _MATCHES:
        from omnistereo_tools.judge.rig_check import find_mixup

        if found := find_mixup(frame):
            yield f"{found}. `omnistereo doctor` with the same rig and images says more"
