"""Mix-ups of poses and images, as a group: each undoes what a file, a converter or a cable may have
done.

The candidates are all combinations of the form of the poses (inverted, one half inverted, another
order of the quaternion, …), the axes of the cameras (24 rotations) and the order of the images, and
the same for one camera. One is named only if the relative poses that the images show fit it, and
the simplest of those that fit.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import permutations, product

import numpy as np
from scipy.spatial.transform import Rotation

from omnistereo_lib.geometry.pose import Floats, Pose
from omnistereo_lib.geometry.rig import Rig
from omnistereo_rigs.doctor.pictures import order_name, orders
from omnistereo_rigs.images.relative_pose import RelativePose

# A mix-up fits if the rotations, and the directions of the baselines, are within so many degrees.
_MOST_TURN_DEG, _MOST_AIM_DEG = 3.0, 30.0
# So much does a degree of direction count against a degree of rotation: directions are known less
# well.
_AIM_WEIGHT = 0.05
# A simpler mix-up fits as well if its misfit is within this factor, and these degrees, of the best.
_AS_GOOD = (1.3, 0.1)
# A mix-up is clear if its misfit is below this share of the next best that is as simple.
_CLEAR = 0.6
_MIRROR = np.diag([1.0, 1.0, -1.0])
_SIDES = (("right", "left"), ("down", "up"), ("ahead", "back"))


@dataclass(frozen=True, eq=False)
class Explanation:
    """Poses that a file may mean, and how well the images agree."""

    name: str  # what looks mixed up; "" if nothing does
    parts: int  # number of mix-ups in it
    R: Floats  # (cameras, 3, 3), camera → rig
    t: Floats  # (cameras, 3)
    order: tuple[int, ...]  # image k is of camera order[k] of the file
    turn_deg: float  # between file and images, over the pairs of cameras: 0.7 quantile
    aim_deg: float  # the same of the directions of the baselines

    @property
    def misfit(self) -> float:
        """One number for rotation and direction, degrees."""
        return self.turn_deg + _AIM_WEIGHT * self.aim_deg

    def apply(self, rig: Rig) -> Rig:
        """Return the rig with the mix-up undone, in its file's frame, ordered as the images."""
        poses = [Pose(R, t) for R, t in zip(self.R, self.t, strict=True)]
        return Rig([rig.cameras[k] for k in self.order], poses, rig.min_depth)


def as_given(rig: Rig, pairs: Mapping[tuple[int, int], RelativePose]) -> Explanation:
    """Return how well the rig as given fits relative poses."""
    return next(_explanations(rig, pairs))


def explain(
    rig: Rig, pairs: Mapping[tuple[int, int], RelativePose]
) -> tuple[Explanation, Explanation | None, bool]:
    """Return how well the rig as given fits relative poses, the simplest explanation that does, and
    if none rivals it.

    In another order of the images each is seen through another lens, which blurs the difference:
    see `check_rig`.
    """
    # The first explanation is the rig as given. Of those that fit about as well as the best, the
    # one with the fewest parts is named (Occam's razor); a rival that is as simple has to fit
    # clearly worse.
    everything = list(_explanations(rig, pairs))
    given = everything[0]
    fitting = [
        one for one in everything if one.turn_deg < _MOST_TURN_DEG and one.aim_deg < _MOST_AIM_DEG
    ]
    if not fitting:
        return given, None, False
    best = min(one.misfit for one in fitting)
    limit = _AS_GOOD[0] * best + _AS_GOOD[1]
    as_good = [one for one in fitting if one.misfit <= limit]
    chosen = min(as_good, key=lambda one: (one.parts, one.misfit))
    rivals = (one.misfit for one in everything if one.parts <= chosen.parts and one.misfit > limit)
    clear = chosen is given or best < _CLEAR * min(rivals, default=np.inf)
    return given, chosen, bool(clear)


def _explanations(rig: Rig, pairs: Mapping[tuple[int, int], RelativePose]) -> Iterator[Explanation]:
    # The numbers of the file are what was mixed up, so go back to the frame of the file.
    if rig.T_rig_file is not None:
        rig = rig.transformed(rig.T_rig_file.inverse())
    R, t = np.stack([pose.R for pose in rig.T_rig_cam]), rig.centers
    same = tuple(range(len(rig)))
    # Images of different sizes cannot have been swapped.
    sizes = [camera.image_size for camera in rig.cameras]
    tried = [order for order in orders(len(rig)) if [sizes[k] for k in order] == sizes]
    # Angles read as an axis-angle vector: for each camera the length may have wrapped around or
    # not.
    angles = [
        (_EULER, lambda R, t, wraps=wraps: _angles(R, t, wraps))
        for wraps in product((0, 1), repeat=len(rig))
    ]
    # Every form of the poses in every order of the images, and in each the 24 turns of the camera
    # axes.
    for (name, form), order in (*product(_FORMS.items(), tried), *product(angles, [same])):
        R_order, t_order = (part[list(order)] for part in form(R, t))
        for axes, turn, aim in _misfits(R_order, t_order, pairs):
            parts = (*_names(name, axes), *(() if order == same else (order_name(order),)))
            yield Explanation(
                " and ".join(parts), len(parts), R_order @ _turns()[axes], t_order, order, turn, aim
            )
    # The same for the pose of one camera alone; a mirror and a chain concern all cameras.
    of_one = {
        name: form
        for name, form in _FORMS.items()
        if name != _MIRRORED and not name.startswith(_CHAIN)
    }
    for k, (name, form) in product(same, of_one.items()):
        changed = R.copy(), t.copy()
        for part, new in zip(changed, form(R, t), strict=True):
            part[k] = new[k]
        for axes, turn, aim in _misfits(*changed, pairs, k):
            if name or axes:
                whole = changed[0].copy()
                whole[k] = whole[k] @ _turns()[axes]
                parts = _names(name, axes, "its image looks")
                words = f"of camera {k + 1} alone: {' and '.join(parts)}"
                yield Explanation(words, len(parts), whole, changed[1], same, turn, aim)


def _misfits(
    R: Floats, t: Floats, pairs: Mapping[tuple[int, int], RelativePose], only: int | None = None
) -> Iterator[tuple[int, float, float]]:
    """Yield number, turn and aim in degrees for each rotation of the axes, of all or one."""
    # With poses R_k S of the turned cameras, the relative pose of i and j that the file means is
    #     R_ji = S_jᵀ R_jᵀ R_i S_i,   t_ji ∝ S_jᵀ R_jᵀ (c_i - c_j)
    # Its angle to the measured R is arccos((trace(R_jiᵀ R) - 1) / 2), for all pairs and turns at
    # once.
    S = _turns()
    none = np.broadcast_to(np.eye(3), S.shape)
    i, j = np.array(list(pairs)).T
    measured_R = np.stack([found.T_b_a.R for found in pairs.values()])
    measured_t = np.stack([found.T_b_a.t for found in pairs.values()])
    # Shapes (pairs, 24, 3, 3); if one camera is tried alone, the others are not turned.
    S_i, S_j = (np.stack([S if only in (None, k) else none for k in side]) for side in (i, j))
    back = np.swapaxes(S_j, 2, 3) @ np.swapaxes(R[j], 1, 2)[:, None]
    cosine = (np.einsum("paij,pij->pa", back @ R[i][:, None] @ S_i, measured_R) - 1) / 2
    baselines = t[i] - t[j]
    baselines = baselines / np.maximum(np.linalg.norm(baselines, axis=1, keepdims=True), 1e-12)
    aims = np.einsum("paij,pj,pi->pa", back, baselines, measured_t)
    degrees = (np.degrees(np.arccos(values.clip(-1, 1))) for values in (cosine, aims))
    # The 0.7 quantile over pairs: three in ten may be wrong relative poses.
    turn, aim = (np.quantile(values, 0.7, axis=0, method="lower") for values in degrees)
    yield from zip(range(len(S)), turn.tolist(), aim.tolist(), strict=True)


@cache
def _turns() -> Floats:
    """Return the 24 rotations that take axes to axes, the identity first, shape (24, 3, 3)."""
    # Permutation matrices with signs, 48 in all; half of them are rotations, the other half
    # mirrors.
    found = [
        np.eye(3)[list(order)] * np.array(signs)[:, None]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
    return np.stack([S for S in found if np.linalg.det(S) > 0])


@cache
def _names(form: str, axes: int, images: str = "all images look") -> tuple[str, ...]:
    """Return the names of a form and of a rotation of the camera axes, if they are any."""
    S = _turns()[axes]
    if form == _MIRRORED and (np.diag(S) == [-1, 1, -1]).all():
        return (f"{images} mirrored",)
    if form == _MIRRORED and (np.diag(S) == [1, -1, -1]).all():
        return (f"{images} mirrored and upside down",)
    # Row by row: which side of the camera its new axis points to.
    sides = [_SIDES[int(np.abs(row).argmax())][int(row.sum() < 0)] for row in S]
    words = f"the camera axes look like x {sides[0]}, y {sides[1]}, z {sides[2]}"
    if S[2, 2] == 1:
        angle = round(float(np.degrees(np.arctan2(S[1, 0], S[0, 0])))) % 360
        words = f"{images} turned by {angle}° (or {words})"
    elif np.array_equal(S, np.diag([1.0, -1.0, -1.0])):
        words += ", as in OpenGL"
    return tuple(part for part in (form, words if axes else "") if part)


# rotations (n, 3, 3) and centres (n, 3), undone
Form = Callable[[Floats, Floats], tuple[Floats, Floats]]
_MIRRORED = "the frame looks left-handed: z of rig and cameras is mirrored"


def _inverse(R: Floats, t: Floats) -> tuple[Floats, Floats]:
    # (R, t)⁻¹ = (Rᵀ, -Rᵀ t)
    back = np.swapaxes(R, 1, 2)
    return back, -np.einsum("nij,nj->ni", back, t)


def _there(form: Form) -> Form:
    """Return a form of the poses rig → camera, whatever the file holds."""
    return lambda R, t: _inverse(*form(*_inverse(R, t)))


def _quaternion(to_first: bool) -> Form:
    """Return the form that moves the real part of a quaternion to the other end."""

    def undo(R: Floats, t: Floats) -> tuple[Floats, Floats]:
        # SciPy's order is x y z w. Rolling by one makes w x y z of it, and back.
        q = np.roll(Rotation.from_matrix(R).as_quat(), 1 if to_first else -1, axis=1)
        return Rotation.from_quat(q).as_matrix(), t

    return undo


def _angles(R: Floats, t: Floats, wraps: Sequence[int]) -> tuple[Floats, Floats]:
    """Take the axis-angle numbers for the angles of rotations about x, then y, then z.

    Numbers of a length above 180° cannot be told from others below: `wraps` says which cameras have
    them.
    """
    numbers = Rotation.from_matrix(R).as_rotvec()
    angle = np.maximum(np.linalg.norm(numbers, axis=1, keepdims=True), 1e-9)
    # A vector of length a and one of length a - 2π along it are the same rotation.
    numbers = numbers * (1 - np.array(wraps)[:, None] * 2 * np.pi / angle)
    return Rotation.from_euler("xyz", numbers).as_matrix(), t


def _chained(R: Floats, t: Floats) -> tuple[Floats, Floats]:
    """Take each pose after the first for one in the frame of the camera before."""
    chained_R, chained_t = [R[0]], [t[0]]
    for turn, shift in zip(R[1:], t[1:], strict=True):
        chained_t.append(chained_R[-1] @ shift + chained_t[-1])
        chained_R.append(chained_R[-1] @ turn)
    return np.stack(chained_R), np.stack(chained_t)


def _only_rotations(R: Floats, t: Floats) -> tuple[Floats, Floats]:
    return np.swapaxes(R, 1, 2), t


_ROTATIONS = "the rotations look inverted, the translations do not"
_CENTRES = (
    "the translations look like those of the other direction (the position C of a camera, or T ="
    " -R C)"
)
_FIRST, _LAST = (
    f"the quaternions look like {a}, read as {b}"
    for a, b in (("w x y z", "x y z w"), ("x y z w", "w x y z"))
)
_EULER = "the axis-angle numbers look like angles about x, y and z"
_CHAIN = "each pose looks relative to the camera before"
_FORMS: dict[str, Form] = {
    "": lambda R, t: (R, t),
    "the poses look inverted (rig → camera instead of camera → rig)": _inverse,
    _ROTATIONS: _only_rotations,
    f"{_ROTATIONS} (of the poses rig → camera)": _there(_only_rotations),
    _CENTRES: lambda R, t: (R, -np.einsum("nji,nj->ni", R, t)),
    f"{_CENTRES}, rotated by the inverse": lambda R, t: (R, -np.einsum("nij,nj->ni", R, t)),
    "the translations look negated": lambda R, t: (R, -t),
    _FIRST: _quaternion(False),
    f"{_FIRST} (of the poses rig → camera)": _there(_quaternion(False)),
    _LAST: _quaternion(True),
    f"{_LAST} (of the poses rig → camera)": _there(_quaternion(True)),
    _CHAIN: _chained,
    f"{_CHAIN} (of the poses rig → camera)": _there(_chained),
    _MIRRORED: lambda R, t: (_MIRROR @ R @ _MIRROR, t @ _MIRROR),
}
