"""The kind of a slip, recognised from its values: a sign, a mirror, a shift, a factor."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from itertools import combinations, permutations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.geometry.pose import Pose

Array = NDArray[np.float64]

FACTORS = {
    -1.0: "that is the right value with the other sign",
    2.0: "that is twice the right value: look for a 2",
    0.5: "that is half the right value: look for a 2",
    4.0: "that is four times the right value: a sum in place of a mean?",
    100.0: "that is 100 times the right value: is something in centimetres, or in percent?",
    0.01: "that is a hundredth of the right value: is something in centimetres, or in percent?",
    180 / np.pi: "that is 180/π times the right value: are there degrees in place of radians?",
    np.pi / 180: "that is π/180 times the right value: are there radians in place of degrees?",
}
ALIKE: dict[str, Callable[[Any], Any]] = {
    "the right value upside down, 1 divided by it": lambda x: 1 / x,
    "1 minus the right value": lambda x: 1 - x,
    "100 minus the right value": lambda x: 100 - x,
    "the right value squared": np.square,
    "the root of the right value": np.sqrt,
    "the right value without its sign": np.abs,
    "the right value rounded": np.rint,
    "the right value rounded down": np.floor,
}
ARGUMENTS: dict[str, Callable[[Any], Any]] = {
    "had the other sign": np.negative,
    "were in radians: convert it": np.degrees,
    "were in degrees: convert it once": np.radians,
    "were larger by 1: is a 1 missing, or one too many?": lambda x: x + 1,
    "were smaller by 1: is a 1 missing, or one too many?": lambda x: x - 1,
    "were larger by ½: is a ½ missing, or one too many?": lambda x: x + 0.5,
    "were smaller by ½: is a ½ missing, or one too many?": lambda x: x - 0.5,
    "were twice as large: look for a 2": lambda x: 2 * x,
    "were half as large: look for a 2": lambda x: x / 2,
    "were 1 divided by it": lambda x: 1 / x,
    "were 1: is it used?": np.ones_like,
    "were 0: is it used?": np.zeros_like,
    "had 0 in the place of NaN: leave NaN out": np.nan_to_num,
    "were rounded": np.rint,
}


REDUCED: dict[str, Callable[..., Any]] = {
    "mean": np.nanmean,
    "sum": np.nansum,
    "largest": np.nanmax,
    "smallest": np.nanmin,
}


def same(found: ArrayLike, value: ArrayLike, within: float = 1e-6) -> bool:
    """Tell whether two arrays hold the same numbers, to four digits or within a tolerance."""
    return np.shape(found) == np.shape(value) and np.allclose(
        found, value, rtol=1e-4, atol=within, equal_nan=True
    )


def form(values: Array) -> str:
    """Return the shape of an array in words."""
    return f"numbers of shape {values.shape}" if values.ndim else "one number"


def of_values(found: Array, right: Array) -> Iterator[str]:
    """Yield in words what turns the right values into those that were found."""
    if not right.size or not found.size:
        return
    if found.shape != right.shape:
        yield from _of_shape(found, right)
        return
    yield from _of_gaps(found, right)
    yield from (words for words, named in _of_number(found, right) if named)
    for words, change in ALIKE.items():
        if same(found, change(right)):
            yield f"that is {words}"
    for axis, size in enumerate(right.shape):
        for order in permutations(range(size)) if size < 4 else ():
            if same(found, right.take(order, axis)):
                yield f"swapped: along axis {axis} the components come in the order {list(order)}"
        if size > 3 and same(found, np.flip(right, axis)):
            yield f"mirrored along axis {axis}: the first comes last"
        for step in (1, -1) if size > 3 else ():
            inner = (*[slice(None)] * axis, slice(1, -1))
            moved = np.roll(right, step, axis)[inner]
            if np.isfinite(moved).sum() > 1 and same(found[inner], moved):
                yield f"shifted by one along axis {axis}"
    yield from _of_shape(found, right)


def of_part(found: Array, right: Array) -> Iterator[str]:
    """Yield what is wrong in a few places, or by a nameless factor: it proves less."""
    if found.shape != right.shape:
        return
    yield from (words for words, _ in _of_number(found, right) if right.size > 1)
    known = np.isfinite(found) & np.isfinite(right)
    apart = np.abs(found - right, where=known, out=np.zeros_like(right))
    if (
        np.array_equal(known, np.isfinite(right))
        and known.any()
        and apart.max() < 0.01 * np.ptp(right[known])
    ):
        yield (
            f"nearly right, off by at most {apart.max():.2g}: is a small number added, or something"
            " rounded?"
        )
    for axis, size in enumerate(right.shape):
        wrong = [k for k in range(size) if not same(found.take(k, axis), right.take(k, axis))]
        which = ", ".join(map(str, wrong))
        if 0 < 2 * len(wrong) <= size + 1 < 8:
            why = next(of_values(found.take(wrong, axis), right.take(wrong, axis)), "")
            yield f"wrong only in number {which} along axis {axis}, counted from 0" + (
                f": {why}" if why else ""
            )
        elif size >= 7 and wrong and set(wrong) <= {0, 1, size - 2, size - 1}:
            yield (
                f"wrong only at {which} along axis {axis}: look at the first and the last, or at"
                " the seam"
            )


def _of_shape(found: Array, right: Array) -> Iterator[str]:
    # not the first, as it is
    for order in permutations(range(right.ndim)) if right.ndim == found.ndim else ():
        if same(found, right.transpose(order)):
            yield "transposed: the axes are in another order"
    if right.ndim == 2 and found.ndim == 1 and same(found, np.diag(right)):
        yield "that is the diagonal alone: return the whole"
    if found.size == right.size and same(found.ravel(), right.ravel()):
        yield "the numbers are right, their shape is not"
    for axis in (None, *range(right.ndim)):
        over = "all" if axis is None else f"axis {axis}"
        for name, reduce in REDUCED.items():
            if same(found, reduce(right, axis)):
                yield f"that is the {name} over {over}: each keeps its own"
        if right.ndim and same(
            found, np.linalg.norm(right if axis is not None else right.ravel(), axis=axis)
        ):
            yield f"that is the length over {over}: return the components"
        for name, place in (
            {"first": 0, "last": -1}.items() if axis is not None and right.shape[axis] else ()
        ):
            if same(found, right.take(place, axis)) or same(found, right.take([place], axis)):
                yield f"that is the {name} along axis {axis} alone: return all"
            if same(found, np.delete(right, place, axis)):
                yield f"the {name} along axis {axis} is missing"


def _of_gaps(found: Array, right: Array) -> Iterator[str]:
    """What is NaN or infinite in one of them only, if all the rest is right."""
    lost, filled = (
        np.isfinite(right) & ~np.isfinite(found),
        ~np.isfinite(right) & (found != right) & ~np.isnan(found),
    )
    filled |= np.isinf(right) & np.isnan(found)
    if not same(np.where(lost | filled, 0, found), np.where(lost | filled, 0, right)):
        return
    if lost.any() and not filled.any():
        yield (
            "NaN or infinity where a number is right: a division by zero, or NaN that is not left"
            " out"
        )
    if filled.any() and not lost.any():
        values = np.unique(found[filled])
        gap = "infinity" if np.isinf(right[filled]).all() else "NaN"
        what = f"{values[0]:g}" if len(values) == 1 else "a number"
        yield f"{what} where {gap} is right" + (
            ": what is not seen, or not known, is NaN" if gap == "NaN" else ""
        )


def _of_number(found: Array, right: Array) -> Iterator[tuple[str, bool]]:
    """One factor or one summand between all of them, and whether it has a name."""
    known = np.isfinite(right) & np.isfinite(found)
    if not known.any() or not same(np.where(known, 0, found), np.where(known, 0, right)):
        return
    values, rights = found[known], right[known]
    if same(values, rights):
        return
    largest = np.argmax(np.abs(rights))
    factor, offset = values[largest] / rights[largest], values[largest] - rights[largest]
    if same(values, factor * rights):
        words = next(
            (words for number, words in FACTORS.items() if np.isclose(factor, number, rtol=1e-4)),
            "",
        )
        yield words or f"that is {factor:.4g} times the right value everywhere", bool(words)
    if same(values, rights + offset):
        words = f"too {'large' if offset > 0 else 'small'} by {abs(offset):.4g} everywhere"
        yield words, np.isclose(abs(offset), [0.5, 1]).any()


def of_arguments(answer: Callable, inputs: tuple, found: Array, numbers: Callable) -> Iterator[str]:
    """Yield in words which other arguments would make the found values right."""
    names = list(inspect.signature(answer).parameters)

    def gives(changed: dict[int, Any]) -> bool:
        try:
            # before LAPACK complains, for all to read
            with np.errstate(divide="raise", invalid="raise"):
                value = numbers(answer(*(changed.get(k, x) for k, x in enumerate(inputs))))
        except Exception:  # not every change makes sense
            return False
        return value is not None and same(found, value)

    floats = {k: x for k, x in enumerate(inputs) if getattr(x, "dtype", None) == np.float64}
    if gives({k: x.astype(np.float32) for k, x in floats.items()}):
        yield "that is what single precision gives: compute in float64"
    for i, j in combinations(range(len(inputs)), 2):
        if type(inputs[i]) is type(inputs[j]) and gives({i: inputs[j], j: inputs[i]}):
            yield f"that would be right if `{names[i]}` and `{names[j]}` were swapped"
    for k, x in enumerate(inputs):
        for words, change in _changes(x):
            if gives({k: change}):
                yield f"that would be right if `{names[k]}` {words}"
    for i, j in combinations(
        [k for k, x in enumerate(inputs) if isinstance(x, np.ndarray) and x.ndim], 2
    ):
        if inputs[i].shape == inputs[j].shape:
            for (words, one), (_, other) in zip(
                _changes(inputs[i]), _changes(inputs[j]), strict=False
            ):
                if gives({i: one, j: other}):
                    yield f"that would be right if `{names[i]}` and `{names[j]}` {words}"


def _changes(x: Any) -> Iterator[tuple[str, Any]]:
    """Yield other arguments in the place of one, and in words what became of it."""
    if isinstance(x, Pose):
        yield "were its inverse", x.inverse()
    if isinstance(x, list) and x and isinstance(x[0], Pose):
        yield "were their inverses", [T.inverse() for T in x]
    try:
        values = np.asarray(x.detach() if hasattr(x, "detach") else x)
    except (TypeError, ValueError, RuntimeError):
        return
    if values.dtype.kind not in "iuf":
        return
    back = (lambda a: x.new_tensor(a)) if hasattr(x, "new_tensor") else (lambda a: a)
    for words, change in ARGUMENTS.items():
        yield words, back(change(values))
    for axis, size in enumerate(values.shape):
        yield f"were reversed along axis {axis}", back(np.flip(values, axis).copy())
        half = size // 2
        yield (
            f"were rolled by half along axis {axis}: is half a turn missing?",
            back(np.roll(values, half, axis)),
        )
        # such as the rotation and the translation of a pose
        if values.ndim == 1 and size in (4, 6):
            behind = np.arange(size) >= half
            for words, used in (("first", behind), ("last", ~behind)):
                yield f"had 0 in its {words} {half}: are they used?", back(values * used)
        for order in (
            permutations(range(size)) if axis == values.ndim - 1 and size in (2, 3) else ()
        ):
            yield f"had its components in the order {list(order)}", back(values.take(order, axis))
