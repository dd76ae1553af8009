"""How likely the depth of a ray is right: from its error bars, and whether cameras saw anything."""

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.stereo.depth import Depth
from omnistereo_lib.stereo.error_bars import WITHIN
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_tools.output.blend import BRIGHTEST, DARKEST
from omnistereo_tools.output.mesh_export import is_connected

DOUBTFUL = 0.5  # trust below which a depth is about as likely wrong as right
_AROUND = 5  # rays
_LOOKED_AT = 16  # spheres, where a ray is looked up in the cameras: their views end smoothly
_PARTS = 32
_FLOATING_SIZE, _FLOATING_TRUST = 0.01, 0.7  # of all rays; mean
_ALL_AROUND = 0.85  # of the edge of a thing, if that thing is in front


def trust(depth: Depth) -> NDArray[np.float32]:
    """Return how likely the depth of each ray is right, in [0, 1], (H, W); below `DOUBTFUL` it is
    doubtful.

    Right is what is off by at most two spheres, or a tenth of the depth: `likely` from the error
    bars. A depth without error bars has its confidence in their place.

    Trust is 0 where there is no evidence: where fewer than two cameras see anything but black or
    white, on the last two spheres, since things may be nearer still, and where there is no depth.
    It is halved where a nearer thing could not be found, since fewer than two cameras would see it,
    and for small things in mid-air of which no part is trusted much, see `_floating`.
    """
    evidence = depth.valid & (depth.index <= depth.grid.num_spheres - 3) & _is_lit(depth)
    right = np.maximum(2 * depth.grid.step, 0.1 * depth.inverse_depth)
    sure, by_bars = np.nan_to_num(depth.confidence), likely(right, depth.sigma, depth.bound)
    probability = np.where(np.isnan(depth.sigma), sure.clip(0, 1), by_bars)
    found = np.where(evidence, probability, 0)
    doubtful = _floating(depth, found) | may_be_nearer(depth)
    return np.where(doubtful, DOUBTFUL * found, found).astype(np.float32)


def likely(off: ArrayLike, sigma: ArrayLike, bound: ArrayLike) -> NDArray[np.float64]:
    """Return how likely an error is at most so large, given its error bars, all in one unit.

    P = 1 - exp(-(off / a)^b): the curve of two numbers, Weibull's, on which σ and the bound lie.
    """
    low, high = (-np.log(1 - share) for share in WITHIN)
    sigma = np.maximum(np.asarray(sigma, np.float64), 1e-12)
    power = np.log(high / low) / np.log(np.maximum(bound / sigma, 1.02))
    with np.errstate(over="ignore"):
        return np.asarray(1 - np.exp(-low * (off / sigma) ** power))


def may_be_nearer(depth: Depth) -> NDArray[np.bool_]:
    """Return where fewer than two cameras see a nearer sphere, so that nothing is found, (H, W)."""
    unseen = depth.sweep.keep("unseen", lambda: _nearest_unseen(depth.sweep))
    return np.nan_to_num(depth.index, nan=np.inf) < unseen


def _nearest_unseen(sweep: SphereSweep) -> NDArray[np.float64]:
    """Return the nearest sphere on which fewer than two cameras see a ray, or -1, (H, W)."""
    grid, spheres = sweep.grid, np.linspace(0, sweep.grid.num_spheres - 1, _LOOKED_AT)
    depths = grid.index_to_inverse_depth(spheres)[:, None, None]
    # Some rows at a time, which stay in the cache of a core.
    parts = (sweep.rig.sees(rows, depths).sum(0) for rows in np.array_split(grid.rays(), _PARTS))
    return np.vstack([np.where(seen < 2, spheres[:, None, None], -1.0).max(0) for seen in parts])


def _floating(depth: Depth, found: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which rays belong to a small thing before its surroundings all around, of little
    trust, shape (H, W).

    Wires, birds and lamps are such things, but are trusted more; of what is left, most is off by
    more than two spheres and a tenth of the depth.
    """
    rays = np.arange(found.size).reshape(found.shape)
    index, depths = depth.index.ravel(), depth.depth.ravel()
    # neighbours, around the seam, too
    across, down = (rays, np.roll(rays, -1, 1)), (rays[:-1], rays[1:])
    a, b = (np.concatenate([x.ravel(), y.ravel()]) for x, y in zip(across, down, strict=True))
    connected = is_connected(np.stack([depths[a], depths[b]]), np.stack([index[a], index[b]]))
    links = connected[: found.size].reshape(found.shape), connected[found.size :]
    thing = _things(*links).ravel()
    count = thing.max() + 1
    edge = thing[a] != thing[b]
    ahead = index[a[edge]] > index[b[edge]]  # False beside an unknown ray
    before, behind = np.where(ahead, a[edge], b[edge]), np.where(ahead, b[edge], a[edge])
    in_front, hidden = (np.bincount(thing[rays], minlength=count) for rays in (before, behind))
    size = np.bincount(thing)
    small = size <= _FLOATING_SIZE * found.size
    small &= np.bincount(thing, found.ravel()) < _FLOATING_TRUST * size
    return (small & (in_front > _ALL_AROUND * (in_front + hidden)))[thing].reshape(found.shape)


def _things(across: NDArray[np.bool_], down: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Return the number of the thing that each ray belongs to, (H, W), given which rays are
    connected to the next one of their row, around the seam, (H, W), and of their column.

    SciPy's graphs would take longer to load than this takes.
    """
    # A picture of the rays at every second row and column, and of their links between them.
    height, width = across.shape
    lattice = np.zeros((2 * height, 2 * width), np.uint8)
    lattice[::2, ::2], lattice[::2, 1::2] = 1, across
    lattice[1:-1:2, ::2] = down.reshape(height - 1, width)
    labels = cv2.connectedComponents(lattice, connectivity=4)[1]
    # OpenCV knows no seam: links in the last column are joined to the first one.
    names, (rows,) = np.arange(labels.max() + 1), np.nonzero(lattice[:, -1])
    for last, first in {*zip(labels[rows, -1].tolist(), labels[rows, 0].tolist(), strict=True)}:
        names[names == names[last]] = names[first]
    return names[labels[::2, ::2]].astype(np.int32)


def _is_lit(depth: Depth) -> NDArray[np.bool_]:
    """Return where two cameras see neither black nor white, for most rays around, (H, W)."""
    samples = depth.samples.reshape(*depth.samples.shape[:3], -1)  # (cameras, H, W, channels)
    channels = np.ascontiguousarray(np.moveaxis(samples, -1, 0))  # NumPy is slow across the last
    # False where NaN
    lit = ((channels.max(0) >= DARKEST) & (channels.min(0) <= BRIGHTEST)).sum(0) >= 2
    return cv2.medianBlur(lit.astype(np.uint8), _AROUND) > 0
