"""Every function × every slip that students have made: it is refused, and in words that help.

A slip is a change of the solution, as in `course.exercises`; behind it stands what the check has to say of it.
"""

import numpy as np
import pytest

from course import exercises, nbtools
from course.exercises.compare import RIGHT, numbers
from course.exercises.opened import Open, changed

OPENED = {
    f.name: f for path in nbtools.notebooks() for f in exercises.functions(nbtools.number(path))
}
each = pytest.mark.parametrize("function", OPENED.values(), ids=OPENED)
# What was met besides those that the exercises name, each kind twice; "example": the smallest one is shown.
SLIPS = """
index_errors
    100 / N → 100 / (N - 1)  # `N` were smaller by 1
    index - gt_index → np.rint(index) - np.rint(gt_index)  # `index` and `gt_index` were rounded
share_above
    > limit → <= limit  # 100 minus the right value
stitched
    total / np.maximum(count, 1), np.nan → total / np.maximum(count, 1), 0  # 0 where NaN is right
unproject
    - center → - center[::-1]  # `center` were reversed
    pixels - center → pixels - 0.5 - center  # `pixels` were smaller by ½
    - center →  # `center` were 0
    poly[::-1], r) → poly[::-1], r**2)  # that is r²
project_rays
    + center → + center[::-1]  # `center` were reversed
    np.degrees(np.arctan2(n, z)) → np.degrees(np.arctan2(-z, n))  # compare the angle from the axis
    -z, n)) → -z, n) * 180 / np.pi)  # in radians
    np.maximum(n, 1e-12) → n  # a division by zero
planar_pose
    r1, r2 = (U @ Vt).T → r1, r2 = H[:, :2].T  # R is not a rotation
residuals
    predicted - found → found - predicted  # other sign
    .apply(points) + pose[3:] → .apply(points)  # `pose` had 0 in its last 3
ocam_polynomial
    np.tan(theta) → np.tan(np.degrees(theta))  # `theta` were in radians
relative_pose
    < 0.02 → < 20  # within 0.02 m
sphere_shift
    return -above → return above  # other sign
rays_of_pixels
    np.radians(phi_deg) → phi_deg  # `phi_deg` were in radians
pixels_of_points
    T_rig_cam.inverse() → T_rig_cam  # `T_rig_cam` were its inverse
    pixels, np.nan → pixels, 0  # 0 where NaN is right
look_up
    pixels[..., 0], pixels[..., 1] → pixels[..., 0] + 0.5, pixels[..., 1] + 0.5  # `pixels` were larger by ½
disagreement
    return np.std(np.nan_to_num(warped), axis=0)  # `warped` had 0 in the place of NaN
zncc
    if deviations > 1e-12 → if b.std() > 1e-6  # a flat patch divides 0 by 0
window_sums
    image, ((0, 0) → image.T, ((0, 0)
    sums[:, radius:-radius] → sums[:, radius:-radius].T  # the other way round
    mode="wrap" → mode="edge"  # example
tower
    return x / → x = x.detach(); return x /  # PyTorch cannot differentiate it
    return x / x.norm(dim=1, keepdim=True).clamp(min=1e-6)
    → x = x.detach().numpy(); return x / np.linalg.norm(x, axis=1, keepdims=True).clip(1e-6)
    # PyTorch cannot differentiate it
hinge
    margin + non_match - match → margin + match - non_match  # `match` and `non_match` were swapped
adam_step
    mean = 0.9 * mean + 0.1 * gradient → mean.mul_(0.9).add_(0.1 * gradient)  # overwrites its argument number 2
    + 1e-8 →  # a division by zero
    weight - rate → weight + rate  # `rate` had the other sign
balanced_loss
    score, -score → -score, score  # `score` had the other sign
step
    lowest + p2) → lowest + p1)  # swapped
sum_of_paths
    path if down else path.swapaxes(0, 1) → path  # stopped with ValueError
    return total → volume += 1; return total  # overwrites its argument number 1
refined
    n + offset, n) → n + offset, np.nan)  # NaN or infinity where a number is right
metrics
    100 * np.mean(e > limit) → np.mean(e > limit)  # a hundredth of the right value
moments
    > 2: → > 2000:  # example
suspect
    min(ratio[k] for k, pair in enumerate(pairs) if camera in pair)
    → np.mean([r for r, pair in zip(ratio, pairs) if camera in pair])  # *all* pairs
    min(ratio[k] for k, pair in enumerate(pairs) if camera in pair)
    → np.prod([r for r, pair in zip(ratio, pairs) if camera in pair])  # *all* pairs
verdict
    return np.where(near, 2 → return np.where(near, 2.0  # whole numbers
epipolar_residual
    np.degrees(np.arcsin(np.sum(normals * y, axis=1))) → np.arcsin(np.sum(normals * y, axis=1))  # π/180 times
    return np.degrees → return np.abs(np.degrees(np.arcsin(np.sum(normals * y, axis=1)))); np.degrees
    # without its sign
eight_point
    y[:, :, None] * x[:, None, :] → x[:, :, None] * y[:, None, :]  # transposed
    np.sqrt(weights)[:, None] * equations → equations  # `weights` were 1
triangulate
    return points / np.linalg.norm(points[:, :3], axis=1, keepdims=True) → return points  # example
    T_21.inverse() → T_21  # `T_21` were its inverse
share_ahead
    np.mean((points → np.sum((points  # 30 times
robust_weight
    / scale →  # `scale` were 1
step_residual
    np.degrees(np.arccos(np.clip(np.sum(toward * y, axis=1), -1, 1))) → np.arccos(np.sum(toward * y, axis=1))
    # π/180 times
integrate
    w * np.where(known, s, 0) → w * s  # NaN or infinity where a number is right
march
    np.where(crossed.any(axis=-1), found, np.nan) → found  # a number where NaN is right
two_best
    angles, axis=0)[:2] → -angles, axis=0)[:2]  # the two smallest angles
behind
    .clip(0, H - 1) →  # stopped with IndexError
    0.5) * W → 0) * W  # half a turn
"""


def table():
    """Yield each slip of the table as a test's parameters."""
    function, text = None, {}
    for line in SLIPS.strip().splitlines():
        if line in OPENED:
            function = line
        text[function] = text.get(function, "") + (line + "\n" if line != function else "")
    for name, lines in text.items():
        for k, slip in enumerate(
            Open(OPENED[name].answer, OPENED[name].draw).with_slips(lines).slips
        ):
            yield pytest.param(OPENED[name], *slip, id=f"{name} {k}")


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize(("function", "slip", "words"), list(table()))
def test_a_slip_that_was_met_is_refused_with_words_that_help(function, slip, words):
    said = function.check(changed(function.answer, slip))
    assert words in said and said != RIGHT


@each
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_usual_slips_are_named(function):
    assert len(function.slips) <= 5
    for slip, hint in function.mistaken:
        assert function.check(slip) == f"not yet: {hint}"


KINDS = [
    (lambda x: -x, "other sign"),
    (lambda x: 2 * x, "twice the right value"),
    (np.degrees, "180/π times"),
    (lambda x: x + 1, "too large by 1"),
    (lambda x: x[::-1], "mirrored|swapped|reversed"),
    (lambda x: np.roll(x, 1, -1), "shifted by one|swapped"),
    (lambda x: x.T, "transposed"),
    (lambda x: np.nan_to_num(x, posinf=0), "0 where"),
]


@each
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_kinds_of_slips_are_recognised(function):
    named = {RIGHT, *(f"not yet: {hint}" for _, hint in function.slips)}
    for change, words in KINDS:

        def slipped(*inputs, change=change):
            right = numbers(function.answer(*inputs))
            return change(right) if right.ndim else change(right[None])[0]

        said = function.check(slipped)
        assert said in named or any(
            word in said for word in ("the value is right", *words.split("|"))
        ), words
