"""How far the depth of a ray is trusted: its confidence, judged at equal range, and whether cameras
saw anything.
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from omnistereo_lib.stereo.depth import Depth
from omnistereo_lib.stereo.methods import Method
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_tools.output.blend import BRIGHTEST, DARKEST
from omnistereo_tools.output.mesh_export import is_connected
from omnistereo_tools.own_method import is_own

DOUBTFUL = 0.5  # trust below which a depth is about as likely wrong as right
# from infinity on: two spheres, of which the confidence of a network speaks, are a tenth of the
# depth
_SPHERES = 20
_AROUND = 5  # rays
_LOOKED_AT = 16  # spheres, where a ray is looked up in the cameras: their views end smoothly
_FLOATING_SIZE, _FLOATING_TRUST = 0.01, 0.7  # of all rays; mean
_ALL_AROUND = 0.85  # of the edge of a thing, if that thing is in front
_RATIO_SPHERES = 4  # the same for the ratio of costs, which speaks of no distance
# Times of ten that a ray is right, off by at most two spheres or a tenth of the depth, and the
# trust in percent from which on it is; on 9 frames with exact depth, sunny, indoor and aerial.
_ODDS_OF_NETWORK = ((6, 78), (7, 95), (8, 98), (9, 100))
_ODDS_OF_COSTS = ((6, 35), (7, 50), (8, 67), (9, 87))


def trust(depth: Depth, method: str | Method) -> NDArray[np.float32]:
    """Return how far each ray's depth is trusted, in [0, 1], shape (H, W); below `DOUBTFUL` it is
    doubtful.

    A confidence says how sure the *sphere* is. Near the rig a sphere more or less hardly changes
    the depth, so the same confidence means a better depth there, and what is near is seldom
    confident: it shows in few cameras, from very different sides. Trust is 1 - (1 - confidence)^x,
    where x grows with the number of spheres between the ray's and infinity. x is chosen so that on
    frames with ground truth about half of what is just doubtful is off by more than two spheres and
    a tenth of the depth, at all ranges.

    Trust is 0 where there is no evidence: where fewer than two cameras see anything but black or
    white, on the last two spheres, since things may be nearer still, and where there is no depth.
    It is halved where a nearer thing could not be found, since fewer than two cameras would see it,
    and for small things in mid-air of which no part is trusted much, see `_floating`.
    """
    grid = depth.grid
    spheres = depth.inverse_depth / grid.step
    exponent = (
        np.sqrt(np.maximum(spheres / _SPHERES, 1))
        if _is_network(method)
        else spheres / _RATIO_SPHERES
    )
    evidence = depth.valid & (depth.index <= grid.num_spheres - 3) & _is_lit(depth)
    found = np.where(evidence, 1 - (1 - depth.confidence.clip(0, 1)) ** exponent, 0)
    doubtful = _floating(depth, found) | may_be_nearer(depth)
    return np.where(doubtful, DOUBTFUL * found, found).astype(np.float32)


def odds(method: str | Method) -> tuple[tuple[int, int], ...]:
    """Return pairs of how many times of ten a ray is right, and from which trust in percent on."""
    return _ODDS_OF_NETWORK if _is_network(method) else _ODDS_OF_COSTS


def _is_network(method: str | Method) -> bool:
    """Whether the confidence is a network's; that of a method of one's own is taken for a ratio of
    costs.
    """
    return not (isinstance(method, str) and is_own(method)) and Method.parse(method).reads_out


def may_be_nearer(depth: Depth) -> NDArray[np.bool_]:
    """Return where a nearer sphere is seen by fewer than two cameras, so that a thing there is not
    found, (H, W).
    """
    unseen = depth.sweep.keep("unseen", lambda: _nearest_unseen(depth.sweep))
    return np.nan_to_num(depth.index, nan=np.inf) < unseen


def _nearest_unseen(sweep: SphereSweep) -> NDArray[np.float64]:
    """Return the number of the nearest sphere on which fewer than two cameras see a ray, -1 without
    any, (H, W).
    """
    nearest = np.full(sweep.grid.shape, -1.0)
    for n in np.linspace(0, sweep.grid.num_spheres - 1, _LOOKED_AT):
        seen = sum(
            sweep.project_sphere(camera, n)[1].astype(int) for camera in range(len(sweep.rig))
        )
        nearest = np.where(seen < 2, n, nearest)
    return nearest


def _floating(depth: Depth, found: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which rays belong to a small thing before its surroundings all around, of little
    trust, shape (H, W).

    Wires, birds and lamps are such things, but are trusted more; of what is left, most is off by
    more than two spheres and a tenth of the depth.
    """
    rays, index, depths = (
        np.arange(found.size).reshape(found.shape),
        depth.index.ravel(),
        depth.depth.ravel(),
    )
    # neighbours, around the seam, too
    across, down = (rays, np.roll(rays, -1, 1)), (rays[:-1], rays[1:])
    a, b = (
        np.concatenate([first.ravel(), second.ravel()])
        for first, second in zip(across, down, strict=True)
    )
    connected = is_connected(np.stack([depths[a], depths[b]]), np.stack([index[a], index[b]]))
    links = coo_array(
        (connected[connected], (a[connected], b[connected])), (found.size, found.size)
    )
    count, thing = connected_components(links, directed=False)
    edge = thing[a] != thing[b]
    ahead = index[a[edge]] > index[b[edge]]  # False beside an unknown ray
    before, behind = np.where(ahead, a[edge], b[edge]), np.where(ahead, b[edge], a[edge])
    in_front, hidden = (np.bincount(thing[rays], minlength=count) for rays in (before, behind))
    size = np.bincount(thing)
    small = (size <= _FLOATING_SIZE * found.size) & (
        np.bincount(thing, found.ravel()) < _FLOATING_TRUST * size
    )
    return (small & (in_front > _ALL_AROUND * (in_front + hidden)))[thing].reshape(found.shape)


def _is_lit(depth: Depth) -> NDArray[np.bool_]:
    """Return where two cameras see neither black nor saturated pixels, for most rays around a ray,
    shape (H, W).
    """
    samples = np.stack(depth.sweep.warp(depth.images, depth.index))
    samples = samples.reshape(*samples.shape[:3], -1)  # (cameras, H, W, channels)
    # False where NaN
    lit = ((samples.max(-1) >= DARKEST) & (samples.min(-1) <= BRIGHTEST)).sum(0) >= 2
    return cv2.medianBlur(lit.astype(np.uint8), _AROUND) > 0
