"""The methods that are compared: the paper's six, and one line for each ablation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.stereo.learned import LearnedCost, PairNetwork, Precision
from omnistereo_lib.stereo.mccnn import MCCNN
from omnistereo_lib.stereo.sweepnet import SweepNet
from omnistereo_lib.stereo.volume import Cost
from omnistereo_lib.stereo.zncc import ZNCC

COSTS = {"zncc": "ZNCC", "mccnn": "MC-CNN", "sweepnet": "SweepNet"}  # in the order of the paper's table
_NETWORKS: dict[str, type[PairNetwork]] = {"mccnn": MCCNN, "sweepnet": SweepNet}
_SHIPPED = {"mccnn": "mccnn_fast", "sweepnet": "sweepnet"}


@dataclass(frozen=True, kw_only=True)
class Method:
    """A way from images to sphere indices; the defaults are the paper's but for the pairs.

    Parameters
    ----------
    cost : "zncc" | "mccnn" | "sweepnet"
    aggregate : "none" | "sgm"
        The winner of the raw cost volume, or after semi-global matching.
    window : int
        Side of ZNCC's window, pixels.
    weights : str
        Name of a network's file without .safetensors; "": the shipped one.
    pairs : "ring" | "all"
        See `camera_pairs`.
    p1, p2 : float
        SGM's penalties.
    wrap : bool
        False: SGM stops at the panorama's seam, and so does every layer of SweepNet.
    subindex : bool
        See `winner_takes_all`; the paper's results are whole indices.
    num_spheres : int
        N in place of the scale's; 0: the scale's.

    Raises
    ------
    OmnistereoError
        If a value is out of its range, or changed where the method does not use it: a method has one name only.
    """

    cost: Literal["zncc", "mccnn", "sweepnet"]
    aggregate: Literal["none", "sgm"] = "none"
    window: int = 9
    weights: str = ""
    pairs: Literal["ring", "all"] = "ring"
    p1: float = 0.1
    p2: float = 12.0
    wrap: bool = True
    subindex: bool = False
    num_spheres: int = 0

    def __post_init__(self) -> None:
        for name, choices in (("cost", tuple(COSTS)), ("aggregate", ("none", "sgm")), ("pairs", ("ring", "all"))):
            if getattr(self, name) not in choices:
                raise OmnistereoError(f"{name} must be one of {', '.join(choices)}, got {getattr(self, name)!r}")
        useless = self._changed.keys() - self._used
        if useless:
            raise OmnistereoError(f"{self.name}: {self._base} does not use {', '.join(sorted(useless))}, leave it out")
        if not 0 <= self.p1 <= self.p2 < float("inf"):
            raise OmnistereoError(f"{self.name}: expected 0 ≤ p1 ≤ p2, got {self.p1} and {self.p2}")
        if self.num_spheres == 1 or self.num_spheres < 0:
            raise OmnistereoError(f"{self.name}: a sweep needs at least 2 spheres, got {self.num_spheres}")
        if set(self.weights) & set(",/\\"):
            raise OmnistereoError(f"weights is the name of a file without folder and ending, got {self.weights!r}")
        ZNCC(self.window)  # refuses windows that are none

    @property
    def name(self) -> str:
        """What `parse` reads, such as "zncc+sgm,p1=0.2": the cost, and what differs from the defaults."""
        return ",".join([self._base, *(f"{name}={_text(value)}" for name, value in self._changed.items())])

    @property
    def label(self) -> str:
        """The row of a table, such as "ZNCC + SGM, p1 = 0.2"."""
        base = COSTS[self.cost] + (" + SGM" if self.aggregate == "sgm" else "")
        return ", ".join([base, *(f"{name} = {_text(value)}" for name, value in self._changed.items())])

    @property
    def order(self) -> tuple:
        """Sorts methods as the paper's table does: without SGM first, then by cost."""
        return self.aggregate, list(COSTS).index(self.cost), tuple(self._changed.items())

    @property
    def volume(self) -> Method:
        """What the cost volume depends on: methods that agree in it share their volumes."""
        wrap = self.wrap or self.cost != "sweepnet"
        return replace(self, aggregate="none", p1=Method.p1, p2=Method.p2, subindex=False, wrap=wrap)

    @property
    def _base(self) -> str:
        return self.cost + ("+sgm" if self.aggregate == "sgm" else "")

    @property
    def _changed(self) -> dict[str, Any]:
        """The settings that differ from their defaults."""
        settings = {field.name: getattr(self, field.name) for field in fields(self)[2:]}
        return {name: value for name, value in settings.items() if value != getattr(Method, name)}

    @property
    def _used(self) -> set[str]:
        """The settings that make a difference."""
        of_cost = {"zncc": {"window"}, "mccnn": {"weights"}, "sweepnet": {"weights", "wrap"}}[self.cost]
        of_sgm = {"p1", "p2", "wrap"} if self.aggregate == "sgm" else set()
        return {"pairs", "subindex", "num_spheres"} | of_cost | of_sgm

    @classmethod
    def parse(cls, name: str) -> Method:
        """Return the method of a name.

        Raises
        ------
        OmnistereoError
            If there is no such method.
        """
        base, *settings = name.split(",")
        cost, _, aggregate = base.partition("+")
        values: dict[str, Any] = {}
        known = {field.name: type(field.default) for field in fields(cls)[2:]}
        for setting in settings:
            key, _, value = setting.partition("=")
            if key not in known:
                raise OmnistereoError(f"{name}: a method has no {key!r}, it has {', '.join(known)}")
            try:
                values[key] = {"true": True, "false": False}[value] if known[key] is bool else known[key](value)
            except (ValueError, KeyError):
                raise OmnistereoError(f"{name}: {key} must be of type {known[key].__name__}, got {value!r}") from None
        return cls(cost=cost, aggregate=aggregate or "none", **values)

    def weights_file(self, folder: Path) -> Path | None:
        """Return the file of the network's weights in a folder; None for a method without."""
        return folder / f"{self.weights or _SHIPPED[self.cost]}.safetensors" if self.cost in _NETWORKS else None

    def load_cost(self, folder: Path, precision: Precision = "auto") -> Cost:
        """Return the matching cost, a network with its weights from a folder.

        Raises
        ------
        OmnistereoError
            If the file is missing, damaged, or holds another architecture.
        """
        path = self.weights_file(folder)
        if path is None:
            return ZNCC(self.window)
        network = _NETWORKS[self.cost].from_file(path)
        network.wrap = network.wrap and self.wrap
        return LearnedCost(network, precision)


def _text(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _varied(methods: Sequence[Method], **changes: Sequence[Any]) -> tuple[Method, ...]:
    """Return the methods with each value of one setting."""
    ((name, values),) = changes.items()
    return tuple(replace(method, **{name: value}) for method in methods for value in values)


METHODS = tuple(Method(cost=cost, aggregate=aggregate) for aggregate in ("none", "sgm") for cost in COSTS)
_ZNCC, _MCCNN, _SWEEPNET, _SGM = METHODS[::3], METHODS[1::3], METHODS[2::3], METHODS[3:]

# Each holds the method that it departs from, so that an ablation is a table by itself.
ABLATIONS = {
    "window": _varied(_ZNCC, window=(5, 9, 13)),
    "weights": _varied(_MCCNN, weights=("", "mccnn_accurate")),
    "pairs": _varied(METHODS, pairs=("ring", "all")),
    "wrap": _varied((*_SGM, _SWEEPNET[0]), wrap=(True, False)),
    "subindex": _varied(METHODS, subindex=(False, True)),
    "penalties": _varied(_varied(_SGM, p1=(0.02, 0.1, 0.5)), p2=(1.5, 4.0, 12.0, 36.0)),
    "spheres": _varied(METHODS, num_spheres=(0, 96, 48)),
}


def select_methods(names: Sequence[str] = (), ablations: Sequence[str] = ()) -> tuple[Method, ...]:
    """Return the methods of these names and of these ablations, each once; the paper's six where none is given.

    Raises
    ------
    OmnistereoError
        If there is no such method or ablation.
    """
    unknown = [name for name in ablations if name not in ABLATIONS]
    if unknown:
        raise OmnistereoError(f"there is no ablation {unknown[0]!r}: choose from {', '.join(ABLATIONS)}")
    chosen = [*map(Method.parse, names), *(method for name in ablations for method in ABLATIONS[name])]
    return tuple(dict.fromkeys(chosen)) or METHODS
