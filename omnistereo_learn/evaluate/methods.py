"""The methods that are compared: the six of Table II, and the ablations."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.stereo.methods import Method


@dataclass(frozen=True, kw_only=True)
class EvaluatedMethod(Method):
    """A method on a grid of the evaluation, which has the N of the scale or another one."""

    subindex: bool | None = False  #: the paper reports integer indices
    num_spheres: int = 0  #: N instead of that of the scale; 0: that of the scale

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.num_spheres == 1 or self.num_spheres < 0:
            raise OmnistereoError(
                f"{self.name}: a sweep needs at least 2 spheres, got {self.num_spheres}"
            )

    @property
    def _used(self) -> frozenset[str]:
        return super()._used | {"num_spheres"}


METHODS = tuple(
    EvaluatedMethod(cost=cost, aggregate=aggregate)
    for aggregate in ("none", "sgm")
    for cost in ("zncc", "mccnn", "sweepnet")
)
_ZNCC, _MCCNN, _SWEEPNET, _SGM = METHODS[::3], METHODS[1::3], METHODS[2::3], METHODS[3:]


def _varied(
    methods: Sequence[EvaluatedMethod], **changes: Sequence[Any]
) -> tuple[EvaluatedMethod, ...]:
    """Return the methods with each value of one setting."""
    ((name, values),) = changes.items()
    return tuple(replace(method, **{name: value}) for method in methods for value in values)


# Each includes its baseline, so that an ablation is a table by itself.
ABLATIONS = {
    "window": _varied(_ZNCC, window=(None, 3, 9, 13)),
    "weights": _varied(_MCCNN, weights=("", "mccnn_accurate")),
    "pairs": _varied(METHODS, pairs=("ring", "all")),
    "wrap": _varied((*_SGM, _SWEEPNET[0]), wrap=(True, False)),
    "subindex": _varied(METHODS, subindex=(False, True)),
    "penalties": (*_SGM, *_varied(_varied(_SGM, p1=(0.02, 0.1, 0.5)), p2=(1.5, 4.0, 12.0, 36.0))),
    "spheres": _varied(METHODS, num_spheres=(0, 96, 48)),
}


def select_methods(
    names: Sequence[str] = (), ablations: Sequence[str] = ()
) -> tuple[EvaluatedMethod, ...]:
    """Return the methods of these names and ablations, each once; default: the six of Table II.

    Raises an `OmnistereoError` if there is no such method or ablation.
    """
    unknown = [name for name in ablations if name not in ABLATIONS]
    if unknown:
        raise OmnistereoError(
            f"unknown ablation {unknown[0]!r}; expected one of {', '.join(ABLATIONS)}"
        )
    chosen = [
        *map(EvaluatedMethod.parse, names),
        *(method for name in ablations for method in ABLATIONS[name]),
    ]
    return tuple(dict.fromkeys(chosen)) or METHODS
