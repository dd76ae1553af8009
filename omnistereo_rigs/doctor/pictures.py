"""Pictures that were rotated, mirrored or given in another order, also in combination."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, permutations, product

import numpy as np

from omnistereo_lib.geometry.rig import Rig
from omnistereo_rigs.doctor.evidence import Evidence, Flip, Matches, explained, flips, unit_rays

# For up to so many cameras all orders are tried …
_MOST = 4
# … and beyond so many the order is believed.
_MANY = 8
# A hypothesis with one more part must be better by this share of its score.
_PART = 0.04


@dataclass(frozen=True)
class PictureMixup:
    """What may have been done to pictures, and how many matches are explained if it is undone."""

    order: tuple[int, ...]  # picture k is of camera order[k]
    flips: tuple[Flip, ...]  # of each picture
    score: float  # matches explained

    @property
    def parts(self) -> int:
        """How many things have gone wrong."""
        done = [flip for flip in self.flips if flip != Flip()]
        same = len(done) == len(self.flips) and len(set(done)) == 1
        swapped = sum(k != place for k, place in enumerate(self.order))
        # That all were, is rarer than one mistake in the file of the poses, which may look alike.
        return (swapped > 0) + (2 if same else len(done))

    @property
    def cause(self) -> str:
        """The kind of mistake: "swapped", "mirrored" or "rotated", joined by "and"."""
        done = [
            "swapped" if self.order != tuple(range(len(self.order))) else "",
            "mirrored" if any(flip.mirrored for flip in self.flips) else "",
            "rotated" if any(flip.quarters for flip in self.flips) else "",
        ]
        return " and ".join(filter(None, done))

    @property
    def name(self) -> str:
        """What was done, in words; "" if nothing was."""
        said = []
        if self.order != tuple(range(len(self.order))):
            said.append(order_name(self.order))
        done = [flip for flip in self.flips if flip != Flip()]
        if len(done) == len(self.flips) and len(set(done)) == 1:
            return " and ".join([*said, f"all images look {done[0].name}"])
        said += [
            f"image {k} looks {flip.name}" for k, flip in enumerate(self.flips, 1) if flip != Flip()
        ]
        return " and ".join(said)


def picture_mixups(evidence: Evidence, rig: Rig) -> list[PictureMixup]:
    """Return what may have been done to the pictures, best first; simple ones get a start."""
    count, sizes = len(rig), [camera.image_size for camera in rig.cameras]
    known = [[*flips(size)] for size in sizes]
    scores = _Scores(evidence, rig)
    found = []
    for order in orders(count) if count <= _MANY else [tuple(range(count))]:
        if [sizes[k] for k in order] == sizes:
            for done in _patterns(known):
                found.append(PictureMixup(order, done, scores.total(order, done)))
    return sorted(found, key=lambda one: -one.score * (1 - _PART * one.parts))


def orders(count: int) -> Iterator[tuple[int, ...]]:
    """Yield the orders of images: the given one, then all up to four, else swaps and cycles."""
    same = tuple(range(count))
    if count <= _MOST:
        yield from permutations(same)
        return
    yield same
    for i, j in combinations(same, 2):
        yield tuple({i: j, j: i}.get(k, k) for k in same)
    for k in same[1:]:
        yield same[k:] + same[:k]


def order_name(order: Sequence[int]) -> str:
    """Return in words that images were given in another order."""
    give = " ".join(str(k + 1) for k in np.argsort(order))
    return f"the images look swapped (give them in the order {give})"


def _patterns(known: Sequence[Sequence[Flip]]) -> Iterator[tuple[Flip, ...]]:
    """Yield what was done to each picture: nothing, something to one or two, the same to all."""
    none = tuple(Flip() for _ in known)
    yield none
    for cameras in (*combinations(range(len(known)), 1), *combinations(range(len(known)), 2)):
        for some in product(*(known[k][1:] for k in cameras)):
            done = dict(zip(cameras, some, strict=True))
            yield tuple(done.get(k, Flip()) for k in range(len(known)))
    for flip in known[0][1:]:
        if len(known) > 2 and all(flip in one for one in known):
            yield tuple(flip for _ in known)


class _Scores:
    """Matches explained by pair, order and flips, each computed once."""

    def __init__(self, evidence: Evidence, rig: Rig) -> None:
        self.evidence, self.rig = evidence, rig
        self._known: dict[tuple[object, ...], int] = {}
        self._rays: dict[tuple[object, ...], np.ndarray] = {}

    def total(self, order: Sequence[int], done: Sequence[Flip]) -> float:
        """Return how many matches are explained, over all pairs."""
        return sum(
            self._pair(i, j, order[i], order[j], done[i], done[j])
            for i, j in combinations(range(len(order)), 2)
        )

    def _pair(self, i: int, j: int, place_i: int, place_j: int, a: Flip, b: Flip) -> int:
        key = i, j, place_i, place_j, a, b
        if key not in self._known:
            # If one picture of the two is mirrored, their matches are those of the second set.
            odd = a.mirrored != b.mirrored
            found = (self.evidence.mirrored if odd else self.evidence.plain)[i, j]
            x = self._seen(found, (i, j, odd), 0, place_i, a)
            y = self._seen(found, (i, j, odd), 1, place_j, b)
            T = self.rig.T_rig_cam
            self._known[key] = int(explained(T[place_i], T[place_j], x, y).sum())
        return self._known[key]

    def _seen(
        self, found: Matches, pair: tuple[object, ...], side: int, place: int, flip: Flip
    ) -> np.ndarray:
        key = *pair, side, place, flip
        if key not in self._rays:
            camera, pixels = self.rig.cameras[place], (found.first, found.second)[side]
            self._rays[key] = unit_rays(camera, flip.undo(pixels, camera.image_size))
        return self._rays[key]
