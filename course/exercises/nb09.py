"""Notebook 09: two clocks, how well images match, whose pairs are bad, how far a picture is shifted, how many spheres.

And `envelopes`, the faults that the notebook asks for.
"""

from itertools import pairwise

import numpy as np

import omnistereo_lib as osl
from course.exercises.compare import Answer, Array, Rng
from course.exercises.opened import Open
from omnistereo_tools import rig_check


def clock_offset(times_a, times_b):
    """Seconds by which clock b is ahead of clock a: the difference of two pictures' times on which most pairs agree."""
    differences = (times_b[:, None] - times_a).ravel()
    agree = np.abs(differences - differences[:, None]) < 0.5  # s
    return differences[np.argmax(agree.sum(axis=1))]


def _two_cards(rng: Rng, k: int) -> tuple:
    moments = np.cumsum(rng.uniform(5, 30, 20 + k))
    seen = rng.uniform(0, 1, (2, len(moments))) < 0.5
    seen[:, 3:8] = True
    seen[0, 0], seen[1, 0] = k % 2, 1 - k % 2  # the first pictures do not belong together
    return moments[seen[0]], moments[seen[1]] + rng.uniform(-300, 300)


check_clock_offset = Open(
    clock_offset,
    _two_cards,
    [
        (lambda a, b: -clock_offset(a, b), "that is by how much it is behind: times of b minus times of a"),
        (
            lambda a, b: b[0] - a[0],
            "the first pictures need not be of one moment: take the difference that most pairs have",
        ),
        (lambda a, b: b.mean() - a.mean(), "each camera has pictures of its own: the means need not belong together"),
        (lambda a, b: np.median(b[:, None] - a), "most pairs are of two moments: take the most frequent difference"),
        (
            lambda a, b: np.abs(b[:, None] - a).min(),
            "the smallest difference is an accident: take the most frequent one",
        ),
        (lambda a, b: a + clock_offset(a, b), "those are the times by clock b: return the offset alone"),
    ],
)


def matching_cost(volume):
    """Median over the rays of the lowest cost on any sphere, of costs (H, W, N); NaN where no pair sees a ray."""
    lowest = np.where(np.isnan(volume), np.inf, volume).min(axis=-1)
    return np.median(lowest[np.isfinite(lowest)])


def _a_volume(rng: Rng, k: int) -> tuple:
    volume = rng.uniform(0, 1, (4 + k % 3, 7, 6))
    volume[rng.uniform(0, 1, volume.shape) < 0.2] = np.nan
    volume[0], volume[1, :2] = np.nan, np.nan  # rays that no pair sees
    volume[2, 0] = rng.uniform(3, 4, 6)  # one bad ray
    return (volume.astype(np.float32) if k % 2 else volume,)


def _seen(volume: Array) -> Array:
    return volume[np.isfinite(volume).any(axis=-1)]


check_matching_cost = Open(
    matching_cost,
    _a_volume,
    [
        (lambda v: np.median(v.min(axis=-1)), "where no pair sees a ray its cost is NaN: leave it out"),
        (lambda v: np.median(np.nan_to_num(v).min(axis=-1)), "NaN is no match, and no cost of 0: leave it out"),
        (
            lambda v: np.median(np.where(np.isnan(v), 1, v).min(axis=-1)),
            "NaN is no evidence, and no cost of 1: leave those rays out",
        ),
        (lambda v: np.nanmedian(v), "first the best sphere of each ray, then the median of the rays"),
        (lambda v: np.nanmin(np.nanmedian(v, axis=(0, 1))), "each ray has its own best sphere: first the minimum"),
        (lambda v: np.nanmean(np.nanmin(_seen(v), axis=-1)), "the median: a few bad rays must not count for many"),
        (lambda v: np.nanmedian(np.nanmean(_seen(v), axis=-1)), "the best sphere, not the mean over all of them"),
        (lambda v: np.nanmedian(np.nanmax(_seen(v), axis=-1)), "the best sphere is the one of the *lowest* cost"),
        (lambda v: np.nanmin(v), "the best of the best ray says nothing of the others: the median over the rays"),
    ],
)


def suspect(costs, usual, pairs):
    """Number of the camera whose pairs have all become worse: costs (pairs,), and those of a good day."""
    ratio = np.asarray(costs) / usual
    cameras = sorted({camera for pair in pairs for camera in pair})
    least = [min(ratio[k] for k, pair in enumerate(pairs) if camera in pair) for camera in cameras]
    return cameras[np.argmax(least)]


def _a_ring(rng: Rng, k: int) -> tuple:
    cameras = 4 + k % 3
    pairs = [*pairwise(range(cameras)), (cameras - 1, 0)]
    usual = rng.uniform(0.005, 0.01, cameras)
    usual[k % cameras] *= 8  # a pair that has never been good
    costs, bad = usual * rng.uniform(0.9, 1.1, cameras), (k % cameras + 2 + k % 2) % cameras
    for number, pair in enumerate(pairs):
        costs[number] *= rng.uniform(3, 6) if bad in pair else 1
    return costs, usual, pairs


def _by(worse: Answer, of_pairs: Answer = min, choose: Answer = np.argmax) -> Answer:
    def camera(costs: Array, usual: Array, pairs: list) -> int:
        values = worse(np.asarray(costs), usual)
        cameras = sorted({i for pair in pairs for i in pair})
        own = [[values[k] for k, pair in enumerate(pairs) if i in pair] for i in cameras]
        return cameras[choose([of_pairs(of_camera) for of_camera in own])]

    return camera


check_suspect = Open(
    suspect,
    _a_ring,
    [
        (_by(lambda now, usual: now), "some pairs cost more even on a good day: compare each with its own usual cost"),
        (
            _by(lambda now, usual: now / usual, max),
            "one bad pair accuses two cameras: *all* pairs of the culprit are bad",
        ),
        (_by(lambda now, usual: usual / now), "that is better, not worse: now over usual"),
        (_by(lambda now, usual: now / usual, min, np.argmin), "that is the camera least to blame"),
        (lambda *inputs: suspect(*inputs) + 1, "the cameras count from 0 here"),
        (
            lambda now, usual, pairs: int(np.argmax(now / usual)),
            "that is the number of a pair: return the camera that the bad pairs share",
        ),
    ],
)


def shift_between(first, second):
    """Columns and rows, (2,), by which the second picture (H, W) shows the same further right and down."""
    H, W = first.shape
    fade = np.outer(np.hanning(H), np.hanning(W))  # the edges of a picture match nothing
    a, b = (np.fft.fft2(fade * (picture - picture.mean())) for picture in (first, second))
    cross = np.conj(a) * b
    peak = np.fft.ifft2(cross / np.maximum(np.abs(cross), 1e-12)).real
    row, column = np.unravel_index(np.argmax(peak), peak.shape)
    return np.array([(column + W // 2) % W - W // 2, (row + H // 2) % H - H // 2])  # beyond half way: to the left, up


def _two_pictures(rng: Rng, k: int) -> tuple:
    H, W = 40 + 2 * k, 50 + 3 * (k % 4)
    picture = rng.uniform(0, 255, (H + 30, W + 30))
    column, row = [(4, -3), (-5, 0), (3, 6), (-2, -4)][k % 4]
    return picture[15 : 15 + H, 15 : 15 + W], picture[15 - row : 15 - row + H, 15 - column : 15 - column + W]


def _unfolded(first: Array, second: Array) -> Array:
    return shift_between(first, second) % first.shape[::-1]


check_shift_between = Open(
    shift_between,
    _two_pictures,
    [
        (lambda a, b: -shift_between(a, b), "that is the way back: from the second picture to the first"),
        (lambda a, b: shift_between(a, b)[::-1], "columns first, then rows"),
        (_unfolded, "the spectrum goes around: a place beyond half way is a shift to the left, or up"),
        (lambda a, b: np.linalg.norm(shift_between(a, b)), "that is its length: along and across are asked"),
        (
            lambda a, b: 0 * shift_between(a, b),
            "0 in all: a picture's own mean, or its edge, matches best. Subtract it",
        ),
    ],
)


def spheres_needed(baseline, nearest, width, pixels):
    """Fewest spheres with which a match moves by at most so many panorama pixels from one to the next; an integer."""
    parallax = baseline / nearest * width / (2 * np.pi)  # px, from infinity to the nearest sphere
    return int(np.ceil(parallax / pixels)) + 1  # one more than there are steps


def _a_plan(rng: Rng, k: int) -> tuple:
    return rng.uniform(0.1, 0.9), rng.uniform(0.4, 2), int(rng.integers(300, 1300)), rng.uniform(0.2, 0.9)


def _steps(baseline: float, nearest: float, width: int, pixels: float, around: float = 2 * np.pi) -> float:
    return baseline / nearest * width / around / pixels


check_spheres_needed = Open(
    spheres_needed,
    _a_plan,
    [
        (
            lambda *plan: spheres_needed(*plan) - 1,
            "one is missing: there is one sphere more than there are steps, and the steps are rounded up",
        ),
        (lambda *plan: round(_steps(*plan)) + 1, "rounded, a step may be too long: np.ceil"),
        (lambda *plan: _steps(*plan) + 1, "there is no part of a sphere: np.ceil"),
        (lambda b, D, W, x: spheres_needed(b, D, W, 1), "for one pixel a sphere: divide by `pixels`"),
        (lambda b, D, W, x: spheres_needed(b, D, W, 1 / x), "fewer pixels a sphere need more spheres: divide by them"),
        (lambda *plan: int(np.ceil(_steps(*plan, around=np.pi))) + 1, "W pixels are the full circle, 2π, not π"),
        (lambda *plan: int(np.ceil(_steps(*plan, around=360))) + 1, "b / D is in radians: 2π of them for W pixels"),
        (lambda b, D, W, x: spheres_needed(b, 1 / D, W, x), "near things move more: baseline / nearest"),
        (lambda b, D, W, x: int(np.ceil(b / D / x)) + 1, "that counts radians as pixels: W pixels make 2π"),
    ],
)


# --- What is in the envelopes ---------------------------------------------------------------------------------


def envelopes(rig: osl.Rig, images: list, later: list) -> dict[str, tuple[osl.Rig, list]]:
    """Return five rigs with their images, each spoiled in one way; `later` are the images of another moment."""
    return {
        "A": (rig_check.invert_poses(rig), images),
        "B": (rig_check.rotate_camera(rig, 2, [0, 0, np.radians(5)]), images),
        "C": (rig, [images[1], images[0], *images[2:]]),
        "D": (rig, [*images[:3], later[3]]),
        "E": (rig, [*images[1:], images[0]]),
    }
