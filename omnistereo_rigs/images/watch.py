"""Whether a camera has moved since a recording began.

The file of the rig is no reference: a real lens always contradicts it a little. The first looks at
the rig are, and by how much they disagree with each other raises the deviations of all.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import fdtrc

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.pose import Floats
from omnistereo_lib.geometry.rig import Rig
from omnistereo_rigs.images.from_images import Images, measure_rig
from omnistereo_rigs.images.track_bundle import by_moving, mean_baseline, moved_rig, whitening

REFERENCE = 4  # looks that later ones are compared with
# looks whose mean is compared: one shows at once what is large, several what is small
_TOGETHER = (1, 2, 4)
# probability that a camera of a rig that has not moved is named; two looks in a row must name the
# same
_SURE = 1e-3
_AT_M = 10.0  # the distance that a warning speaks of


@dataclass(frozen=True, eq=False)
class Look:
    """The rig as a few frames show it: `MeasuredRig.differences` and their covariance."""

    frame: int  # number of its first frame
    differences: Floats  # (cameras, 6): radians, metres
    covariance: Floats  # (6 · cameras, 6 · cameras)


@dataclass(frozen=True, eq=False)
class Turned:
    """The camera whose turn explains best how a rig has changed."""

    camera: int  # from 0
    turn: Floats  # (3,) axis times angle in radians, rig frame
    covariance: Floats  # (3, 3)
    p_value: float  # that a rig that has not moved would look like this by chance
    since: int  # number of the first frame that shows it

    @property
    def degrees(self) -> tuple[float, float]:
        """The angle and its standard deviation."""
        angle = float(np.linalg.norm(self.turn))
        axis = self.turn / max(angle, 1e-12)
        return float(np.degrees(angle)), float(np.degrees(np.sqrt(axis @ self.covariance @ axis)))


def look_at(rig: Rig, frame: int, images: Images) -> Look | None:
    """Measure a rig in images[moment][camera]; None if they show too little."""
    try:
        measured = measure_rig(rig, images, "nominal")
    except OmnistereoError:  # hardly any matches
        return None
    return None if measured.refusals() else Look(frame, measured.differences, measured.covariance)


class Watch:
    """Looks at a rig again and again, and warns once of each camera that has turned.

    Args:
        rig: As the depth is computed with.
    """

    def __init__(self, rig: Rig) -> None:
        self.rig, self.looks = rig, list[Look]()
        self.turned: dict[int, Turned] = {}  # cameras that were warned of
        self._suspect: Turned | None = None

    def add(self, look: Look) -> str | None:
        """Compare the last looks with the first; warn when a camera is named twice in a row."""
        self.looks.append(look)
        before, self._suspect = self._suspect, self._who()
        now = self._suspect
        if (
            before is None
            or now is None
            or before.camera != now.camera
            or now.camera in self.turned
        ):
            return None
        self.turned[now.camera] = now
        angle, deviation = now.degrees
        off = np.radians(angle) * _AT_M**2 / mean_baseline(self.rig.centers)
        return (
            f"camera {now.camera + 1} has turned by {angle:.2f}° ± {deviation:.2f}° since about"
            f" frame {now.since}: depth at {_AT_M:g} m is off by about {off:.1g} m where it looks"
        )

    def _who(self) -> Turned | None:
        """Return the camera that has turned beyond doubt, by one look or the mean of several."""
        groups = [self.looks[-n:] for n in _TOGETHER if len(self.looks) - n >= REFERENCE]
        found = [who_turned(self.rig, *self.change(group), group[0].frame) for group in groups]
        best = min(found, key=lambda one: one.p_value, default=None)
        return best if best is not None and best.p_value * len(found) < _SURE else None

    def change(self, looks: Sequence[Look]) -> tuple[Floats, Floats]:
        """Return how looks differ from the first ones, (cameras, 6), and the covariance of that."""
        first = self.looks[:REFERENCE]
        # By how much more than their covariances say the first looks differ.
        apart = []
        for a, b in combinations(first, 2):
            z = whitening(a.covariance + b.covariance) @ (a.differences - b.differences).ravel()
            apart.append(z @ z / len(z))
        raised = max(float(np.mean(apart)), 1.0) if apart else 1.0
        (now, now_covariance), (then, then_covariance) = _mean(looks), _mean(first)
        return now - then, raised * (now_covariance + then_covariance)

    @property
    def can_compare(self) -> bool:
        """Whether there are more looks than the first ones."""
        return len(self.looks) > REFERENCE

    def turns(self, look: Look) -> Floats:
        """Return each camera's turn in a look and its deviation, degrees (cameras, 2)."""
        change, covariance = self.change([look])
        blocks = np.diag(covariance).reshape(-1, 2, 3)[:, 0].sum(axis=1)
        turns = np.linalg.norm(change[:, :3], axis=1)
        return np.degrees(np.stack([turns, np.sqrt(blocks)], axis=1))

    def rig_now(self) -> Rig:
        """Return the rig with the cameras turned that were warned of."""
        differences = np.zeros((len(self.rig), 6))
        for camera, found in self.turned.items():
            differences[camera, :3] = found.turn
        return moved_rig(self.rig, differences)


def who_turned(rig: Rig, change: Floats, covariance: Floats, since: int = 0) -> Turned:
    """Return the camera whose turn explains a change (cameras, 6) best."""
    white = whitening(covariance)
    # numbers that tell how much the first looks disagree
    known = (REFERENCE - 1) * len(white)
    found = []
    for camera in range(len(rig)):
        A = white @ by_moving(rig, camera)[:, :3]
        inverse = np.asarray(np.linalg.inv(A.T @ A), np.float64)
        turn = inverse @ A.T @ white @ change.ravel()
        gain = float(turn @ A.T @ A @ turn)
        found.append(
            (
                gain,
                Turned(
                    camera,
                    turn,
                    inverse,
                    min(1.0, len(rig) * float(fdtrc(3, known, gain / 3))),
                    since,
                ),
            )
        )
    return max(found, key=lambda one: one[0])[1]


def _mean(looks: Sequence[Look]) -> tuple[Floats, Floats]:
    """Return the mean differences of looks and their covariance."""
    covariance = np.sum([one.covariance for one in looks], axis=0) / len(looks) ** 2
    return np.mean([one.differences for one in looks], axis=0), covariance
