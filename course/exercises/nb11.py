"""Notebook 11: four clocks, how well images match, whose pairs are bad, shifts, and spheres.

And `envelopes`, the faults that the notebook asks for.
"""

from itertools import pairwise

import cv2
import numpy as np

import omnistereo_lib as osl
from course.exercises.compare import Rng
from course.exercises.opened import Open
from omnistereo_rigs.doctor import rig_check


def clock_offset(times_a, times_b):
    """Seconds by which clock b is ahead of clock a: the difference of two pictures' times on which
    most pairs agree."""
    differences = (times_b[:, None] - times_a).ravel()
    agree = np.abs(differences - differences[:, None]) < 0.5  # s
    return differences[np.argmax(agree.sum(axis=1))]


def _two_cards(rng: Rng, k: int) -> tuple:
    moments = np.cumsum(rng.uniform(5, 30, 20 + k))
    seen = rng.uniform(0, 1, (2, len(moments))) < 0.5
    seen[:, 3:8] = True
    seen[0, 0], seen[1, 0] = k % 2, 1 - k % 2  # the first pictures do not belong together
    jitter = rng.uniform(-0.1, 0.1, seen.shape)  # a card notes when it wrote the picture
    times = moments + jitter
    return times[0, seen[0]], times[1, seen[1]] + rng.uniform(-300, 300)


check_clock_offset = Open(clock_offset, _two_cards, within=0.5).with_slips("""
    return times_b[0] - times_a[0]
    # the first pictures need not be of one moment: take the difference that most pairs have
    return times_b.mean() - times_a.mean()
    # each camera has pictures of its own: the means need not belong together
    return np.median(times_b[:, None] - times_a)
    # most pairs are of two moments: take the most frequent difference
""")


def moments(times):
    """Numbers (total,) of the moments of all pictures, card after card: from 1, in the order of time.
    times: of each card, (K,), seconds by its own clock; more than 2 s later is another moment."""
    ahead = [0.0]  # of the clock of the first card
    for earlier, later in pairwise(times):
        ahead.append(ahead[-1] + clock_offset(earlier, later))
    seconds = np.concatenate([card - offset for card, offset in zip(times, ahead, strict=True)])
    numbers = np.zeros(len(seconds), int)
    number, before = 0, -np.inf
    for k in np.argsort(seconds):
        if seconds[k] - before > 2:
            number += 1
        numbers[k] = number
        before = seconds[k]
    return numbers


def _some_cards(rng: Rng, k: int) -> tuple:
    taken = np.cumsum(rng.uniform(6, 30, 20 + k))
    seen = rng.uniform(0, 1, (3 + k % 2, len(taken))) < 0.5
    seen[:, 3:9] = True
    times = taken + rng.uniform(-0.1, 0.1, seen.shape)
    return ([row[of] + rng.uniform(-300, 300) for row, of in zip(times, seen, strict=True)],)


check_moments = Open(moments, _some_cards, whole=("times",)).with_slips("""
    ahead[-1] + clock_offset(earlier, later) → clock_offset(earlier, later)
    # that is how far a clock is ahead of the one before: add up the offsets
    card - offset → card + offset  # a clock that is ahead shows too much: subtract its offset
    card - offset → card  # the clocks are wrong: subtract from each card how far its clock is ahead
    number, before = 0, -np.inf → number, before = -1, -np.inf  # the first moment has the number 1
    in np.argsort(seconds) → in range(len(seconds))
    # in the order of time the pictures of all cards mix: np.argsort
""")


def matching_cost(volume):
    """Median over the rays of the lowest cost on any sphere, of costs (H, W, N); NaN where no pair
    sees a ray."""
    lowest = np.where(np.isnan(volume), np.inf, volume).min(axis=-1)
    return np.median(lowest[np.isfinite(lowest)])


def _a_volume(rng: Rng, k: int) -> tuple:
    volume = rng.uniform(0, 1, (4 + k % 3, 7, 6))
    volume[rng.uniform(0, 1, volume.shape) < 0.2] = np.nan
    volume[0], volume[1, :2] = np.nan, np.nan  # rays that no pair sees
    volume[2, 0] = rng.uniform(3, 4, 6)  # one bad ray
    return (volume.astype(np.float32) if k % 2 else volume,)


check_matching_cost = Open(matching_cost, _a_volume).with_slips("""
    np.where(np.isnan(volume), np.inf, volume) → np.where(np.isnan(volume), 1, volume)
    # NaN is no evidence, and no cost of 1: leave those rays out
    return np.nanmedian(volume)  # first the best sphere of each ray, then the median of the rays
    np.median( → np.mean(  # the median: a few bad rays must not count for many
""")


def suspect(costs, usual, pairs):
    """Number of the camera whose pairs have all become worse: costs (pairs,), and those of a good
    day."""
    ratio = np.asarray(costs) / usual
    cameras = sorted({camera for pair in pairs for camera in pair})
    least = [min(ratio[k] for k, pair in enumerate(pairs) if camera in pair) for camera in cameras]
    return cameras[np.argmax(least)]


def _a_ring(rng: Rng, k: int) -> tuple:
    cameras = 4 + k % 3
    pairs = [*pairwise(range(cameras)), (cameras - 1, 0)]
    usual = rng.uniform(0.005, 0.01, cameras)
    bad, other = k % cameras, (k + 2) % cameras  # they share no pair
    usual[[bad in pair for pair in pairs]] *= (1, 0.5)[k % 2]
    usual[[other in pair for pair in pairs]] *= (40, 8)[k % 2]  # pairs that have never been good
    costs = usual * np.where([bad in pair for pair in pairs], rng.uniform(3, 6, cameras), 1.1)
    if cameras > 4:
        costs[(bad + 2) % cameras] *= 50  # one pair of others is off by far
    return costs, usual, pairs


check_suspect = Open(suspect, _a_ring).with_slips("""
    sorted({camera for pair in pairs for camera in pair}) → range(4)
    # not every rig has four cameras: take them from the pairs
    np.asarray(costs) / usual → np.asarray(costs)
    # some pairs cost more even on a good day: compare each with its own usual cost
    np.asarray(costs) / usual → np.asarray(costs) - usual
    # a dear pair rises by more without being worse: now over usual, a ratio
    min(ratio[k] for k, pair in enumerate(pairs) if camera in pair)
    → max(ratio[k] for k, pair in enumerate(pairs) if camera in pair)
    # one bad pair accuses two cameras, by its maximum, its mean and its product: *all* pairs of the
    # culprit are bad
""")


def shift_between(first, second):
    """Columns and rows, (2,), by which the second picture (H, W) shows the same further right and
    down."""
    H, W = first.shape
    fade = np.outer(np.hanning(H), np.hanning(W))  # the edges of a picture match nothing
    a, b = (np.fft.fft2(fade * (picture - picture.mean())) for picture in (first, second))
    cross = np.conj(a) * b
    peak = np.fft.ifft2(cross / np.maximum(np.abs(cross), 1e-12)).real
    row, column = np.unravel_index(np.argmax(peak), peak.shape)
    # beyond half way: to the left, up
    return np.array([(column + W // 2) % W - W // 2, (row + H // 2) % H - H // 2])


def _two_pictures(rng: Rng, k: int) -> tuple:
    H, W = 40 + 2 * k, 50 + 3 * (k % 4)
    picture = cv2.GaussianBlur(rng.uniform(0, 120, (H + 30, W + 30)), (0, 0), 1)
    column, row = [(4, -3), (-5, 0), (3, 6), (-2, -4)][k % 4]
    both = (
        picture[15 : 15 + H, 15 : 15 + W],
        picture[15 - row : 15 - row + H, 15 - column : 15 - column + W],
    )
    lamp = 6 * np.hypot(*np.indices((H, W)))  # from one side, and it does not move
    first, second = (one + lamp + rng.normal(0, 1, (H, W)) for one in both)
    return first, second


check_shift_between = Open(shift_between, _two_pictures, within=0.5).with_slips("""
    np.array([(column + W // 2) % W - W // 2, (row + H // 2) % H - H // 2])
    → np.array([column, row])
    # the spectrum goes around: a place beyond half way is a shift to the left, or up
    cross / np.maximum(np.abs(cross), 1e-12) → cross
    # divide by the absolute value, so that each frequency counts alike: else what is broad and
    # bright decides
    return np.zeros(2)  # 0 in all: a picture's own mean, or its edge, matches best. Subtract it
""")


def spheres_needed(baseline, nearest, width, pixels):
    """Fewest spheres with which a match moves by at most so many panorama pixels from one to the
    next; an integer."""
    parallax = baseline / nearest * width / (2 * np.pi)  # px, from infinity to the nearest sphere
    return int(np.ceil(parallax / pixels)) + 1  # one more than there are steps


def _a_plan(rng: Rng, k: int) -> tuple:
    return (
        rng.uniform(0.1, 0.9),
        rng.uniform(0.4, 2),
        int(rng.integers(300, 1300)),
        rng.uniform(0.2, 0.9),
    )


check_spheres_needed = Open(spheres_needed, _a_plan).with_slips("""
    np.ceil( → round(  # rounded, a step may be too long: np.ceil
    np.ceil(parallax / pixels)) + 1 → np.ceil(parallax / pixels))
    # one is missing: there is one sphere more than there are steps, and the steps are rounded up
    (2 * np.pi) → np.pi  # W pixels are the full circle, 2π, not π
    (2 * np.pi) → 360  # b / D is in radians: 2π of them for W pixels
""")


# --- What is in the envelopes


def envelopes(rig: osl.Rig, images: list, later: list) -> dict[str, tuple[osl.Rig, list]]:
    """Return five rigs with their images, each spoiled in one way; `later` are the images of
    another moment."""
    return {
        "A": (rig_check.invert_poses(rig), images),
        "B": (rig_check.rotate_camera(rig, 2, [0, 0, np.radians(5)]), images),
        "C": (rig, [images[1], images[0], *images[2:]]),
        "D": (rig, [*images[:3], later[3]]),
        "E": (rig, [*images[1:], images[0]]),
    }
