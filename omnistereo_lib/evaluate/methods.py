"""The methods that are compared: the six of Table II, and the ablations."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.stereo.methods import Method

_COSTS = ("zncc", "mccnn", "sweepnet")
METHODS = tuple(Method(cost=cost, aggregate=aggregate) for aggregate in ("none", "sgm") for cost in _COSTS)
_ZNCC, _MCCNN, _SWEEPNET, _SGM = METHODS[::3], METHODS[1::3], METHODS[2::3], METHODS[3:]


def _varied(methods: Sequence[Method], **changes: Sequence[Any]) -> tuple[Method, ...]:
    """Return the methods with each value of one setting."""
    ((name, values),) = changes.items()
    return tuple(replace(method, **{name: value}) for method in methods for value in values)


# Each holds the method that it departs from, so that an ablation is a table by itself.
ABLATIONS = {
    "window": _varied(_ZNCC, window=(5, 9, 13)),
    "weights": _varied(_MCCNN, weights=("", "mccnn_accurate")),
    "pairs": _varied(METHODS, pairs=("ring", "all")),
    "wrap": _varied((*_SGM, _SWEEPNET[0]), wrap=(True, False)),
    "subindex": _varied(METHODS, subindex=(False, True)),
    "penalties": (*_SGM, *_varied(_varied(_SGM, p1=(0.02, 0.1, 0.5)), p2=(1.5, 4.0, 12.0, 36.0))),
    "spheres": _varied(METHODS, num_spheres=(0, 96, 48)),
}


def select_methods(names: Sequence[str] = (), ablations: Sequence[str] = ()) -> tuple[Method, ...]:
    """Return the methods of these names and ablations, each once; the six of Table II if none is given.

    Raises an `OmnistereoError` if there is no such method or ablation.
    """
    unknown = [name for name in ablations if name not in ABLATIONS]
    if unknown:
        raise OmnistereoError(f"unknown ablation {unknown[0]!r}; expected one of {', '.join(ABLATIONS)}")
    chosen = [*map(Method.parse, names), *(method for name in ablations for method in ABLATIONS[name])]
    return tuple(dict.fromkeys(chosen)) or METHODS
