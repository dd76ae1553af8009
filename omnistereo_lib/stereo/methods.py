"""Methods by name, such as "zncc+sgm" or "sweepnet+sgm,p1=0.2": one vocabulary for code, command line and tables.

A name is a matching cost, "+sgm" where the cost volume is smoothed, and the settings that differ from their defaults.
A new cost joins `COSTS`, and every command knows it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal

from torch import Tensor

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.stereo.depth import index_and_confidence
from omnistereo_lib.stereo.learned import LearnedCost, PairNetwork, Precision
from omnistereo_lib.stereo.mccnn import MCCNN
from omnistereo_lib.stereo.sgm import sgm
from omnistereo_lib.stereo.sweepnet import SweepNet
from omnistereo_lib.stereo.volume import Cost
from omnistereo_lib.stereo.volumenet import VolumeNet, local_mean
from omnistereo_lib.stereo.weights import BUNDLED_WEIGHTS, StoredNetwork
from omnistereo_lib.stereo.zncc import ZNCC

FRAME_METHOD = "volumenet"  # default for a single frame: the lowest errors, at seconds a frame
VIDEO_METHOD = "zncc+sgm"  # default for many frames, recorded or live: the fastest that is smooth


@dataclass(frozen=True)
class CostEntry:
    """A matching cost in the vocabulary of methods."""

    label: str  # row of a table
    load: Callable[[Method, Path | None, Precision], Cost]  # with the weights file, if there is one
    settings: frozenset[str]  # of `Method` that change this cost
    weights: str = ""  # bundled weights file without .safetensors; "" for a cost without weights
    p1: float = 0.1  # SGM penalties that suit this cost at the paper's scale; see `penalties`
    p2: float = 12.0
    # Raw volume (H, W, N) → index and confidence (H, W), in place of `winner_takes_all` and `confidence`.
    read_out: Callable[[Tensor], tuple[Tensor, Tensor]] | None = None


@cache
def _read_once(architecture: type[StoredNetwork], path: Path, wrap: bool, precision: Precision, _: int) -> Cost:
    network = architecture.from_file(path)
    if isinstance(network, PairNetwork):
        network.wrap = network.wrap and wrap
        return LearnedCost(network, precision)
    network.precision = precision
    return network


def _network(architecture: type[StoredNetwork]) -> Callable[[Method, Path, Precision], Cost]:
    """Return what loads a network as a cost: a file is read once per process, and again after it was rewritten."""

    def load(method: Method, path: Path, precision: Precision) -> Cost:
        written = path.stat().st_mtime_ns if path.is_file() else 0
        return _read_once(architecture, path, method.volume_key.wrap, precision, written)

    return load


COSTS = {  # in the order of Table II
    "zncc": CostEntry("ZNCC", lambda method, path, precision: ZNCC(method.window), frozenset({"window", "pairs"})),
    "mccnn": CostEntry("MC-CNN", _network(MCCNN), frozenset({"weights", "pairs"}), "mccnn_fast"),
    "sweepnet": CostEntry("SweepNet", _network(SweepNet), frozenset({"weights", "pairs", "wrap"}), "sweepnet"),
    "volumenet": CostEntry("VolumeNet", _network(VolumeNet), frozenset({"weights"}), "volumenet", read_out=local_mean),
}


_TYPES = {  # of the settings in a name
    "window": int, "weights": str, "pairs": str, "p1": float, "p2": float, "wrap": bool, "subindex": bool,
    "num_spheres": int,
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Method:
    """A way from images to sphere indices; the defaults are the paper's at its scale, except for the pairs.

    Raises:
        OmnistereoError: If a value is out of range, or is set although the method does not use it: a method has one
            name.
    """

    cost: str  #: a key of `COSTS`
    aggregate: Literal["none", "sgm"] = "none"  #: read depth from the raw cost volume, or after semi-global matching
    window: int = 9  #: side of the ZNCC window, pixels
    weights: str = ""  #: name of the weights file of a network, without .safetensors; "": the bundled one
    pairs: Literal["ring", "all"] = "ring"  #: see `camera_pairs`
    p1: float | None = None  #: SGM penalties; None: those of `penalties` for the size of the volume
    p2: float | None = None
    wrap: bool = True  #: False: SGM stops at the ±180° seam, and so does every layer of SweepNet
    subindex: bool = False  #: refine the index, see `winner_takes_all`; the paper reports integer indices
    num_spheres: int = 0  #: N instead of the N of the grid; 0: that of the grid

    def __post_init__(self) -> None:
        for name, choices in (("cost", tuple(COSTS)), ("aggregate", ("none", "sgm")), ("pairs", ("ring", "all"))):
            if getattr(self, name) not in choices:
                raise OmnistereoError(f"{name} must be one of {', '.join(choices)}, got {getattr(self, name)!r}")
        if unused := self._changed.keys() - self._used:
            raise OmnistereoError(f"{self.name}: {self._base} does not use {', '.join(sorted(unused))}. Leave it out")
        p1, p2 = self.p1 or 0.0, math.inf if self.p2 is None else self.p2
        if not (0 <= p1 <= p2 and p1 < math.inf and self.p2 != math.inf):
            raise OmnistereoError(f"{self.name}: expected 0 ≤ p1 ≤ p2, got {self.p1} and {self.p2}")
        if self.num_spheres == 1 or self.num_spheres < 0:
            raise OmnistereoError(f"{self.name}: a sweep needs at least 2 spheres, got {self.num_spheres}")
        if set(self.weights) & set(",/\\"):
            raise OmnistereoError(f"weights is a file name without folder and ending, got {self.weights!r}")
        ZNCC(self.window)  # raises if this is not a window

    @classmethod
    def parse(cls, name: str | Method) -> Method:
        """Return the method of a name; a method is returned as it is.

        Raises an `OmnistereoError` if there is no such method.
        """
        if isinstance(name, Method):
            return name
        if not isinstance(name, str):
            raise OmnistereoError(f"method is {name!r}; expected a name such as 'zncc+sgm'")
        base, *settings = name.split(",")
        cost, _, aggregate = base.partition("+")
        values: dict[str, Any] = {}
        for setting in settings:
            key, _, value = setting.partition("=")
            if key not in _TYPES:
                raise OmnistereoError(f"{name}: unknown setting {key!r}; expected one of {', '.join(_TYPES)}")
            try:
                values[key] = {"true": True, "false": False}[value] if _TYPES[key] is bool else _TYPES[key](value)
            except (ValueError, KeyError):
                raise OmnistereoError(f"{name}: {key} must be of type {_TYPES[key].__name__}, got {value!r}") from None
        return cls(cost=cost, aggregate=aggregate or "none", **values)

    @property
    def name(self) -> str:
        """The name that `parse` reads, such as "zncc+sgm,p1=0.2"."""
        return ",".join([self._base, *(f"{name}={_text(value)}" for name, value in self._changed.items())])

    @property
    def label(self) -> str:
        """Row of a table, such as "ZNCC + SGM, p1 = 0.2"."""
        base = COSTS[self.cost].label + (" + SGM" if self.aggregate == "sgm" else "")
        return ", ".join([base, *(f"{name} = {_text(value)}" for name, value in self._changed.items())])

    @property
    def sort_key(self) -> tuple:
        """Order of Table II: methods without SGM first, then by cost."""
        return self.aggregate, list(COSTS).index(self.cost), tuple(self._changed.items())

    @property
    def volume_key(self) -> Method:
        """The method reduced to what its cost volume depends on; methods with equal keys share their volumes."""
        wrap = self.wrap or "wrap" not in COSTS[self.cost].settings
        return replace(self, aggregate="none", p1=None, p2=None, subindex=False, wrap=wrap)

    @property
    def _base(self) -> str:
        return self.cost + ("+sgm" if self.aggregate == "sgm" else "")

    @property
    def _changed(self) -> dict[str, Any]:
        """Settings that differ from their defaults."""
        defaults = {field.name: field.default for field in fields(self)[2:]}
        return {name: getattr(self, name) for name, default in defaults.items() if getattr(self, name) != default}

    @property
    def _used(self) -> set[str]:
        """Settings that make a difference."""
        of_sgm = {"p1", "p2", "wrap"} if self.aggregate == "sgm" else set()
        of_winner = set() if self._reads_out else {"subindex"}
        return {"num_spheres"} | COSTS[self.cost].settings | of_sgm | of_winner

    @property
    def _reads_out(self) -> bool:
        return self.aggregate == "none" and COSTS[self.cost].read_out is not None

    def weights_file(self, folder: Path = BUNDLED_WEIGHTS) -> Path | None:
        """Return the weights file in a folder, or None for a cost without weights."""
        bundled = COSTS[self.cost].weights
        return folder / f"{self.weights or bundled}.safetensors" if bundled else None

    def load_cost(self, folder: Path = BUNDLED_WEIGHTS, precision: Precision = "auto") -> Cost:
        """Return the matching cost, a network with its weights from a folder.

        Raises an `OmnistereoError` if the weights file is missing, damaged, or holds another architecture.
        """
        return COSTS[self.cost].load(self, self.weights_file(folder), precision)

    def smooth(self, volume: Tensor) -> Tensor:
        """Return the volume (H, W, N) from which depth is read: after SGM where the method has it."""
        if self.aggregate == "none":
            return volume
        cost = COSTS[self.cost]
        p1, p2 = penalties(*volume.shape[1:], cost.p1, cost.p2)
        p2 = max(p2, self.p1 or 0) if self.p2 is None else self.p2
        p1 = min(p1, p2) if self.p1 is None else self.p1
        return sgm(volume, p1, p2, wrap=self.wrap)

    def read_out(self, volume: Tensor, subindex: bool = False) -> tuple[Tensor, Tensor]:
        """Return index and confidence (H, W) of a smoothed volume; with `subindex` or the setting between spheres."""
        if self._reads_out:
            return COSTS[self.cost].read_out(volume)
        return index_and_confidence(volume, subindex or self.subindex)


def penalties(width: int, num_spheres: int, p1: float = 0.1, p2: float = 12.0) -> tuple[float, float]:
    """Return SGM's penalties for a panorama of W columns and N spheres from those for the paper's 1200 and 192.

    A surface covers fewer pixels of a coarser panorama, so fewer costs speak for it against the same penalties; and
    among more spheres its slope is more steps a pixel, each of which is paid. The powers were chosen on held-out frames
    of the training sets; see notebook 07. Neither penalty exceeds that of the paper's scale.
    """
    scale = min(width / 1200, 1.0)
    p2 *= min(scale**2 * 192 / num_spheres, 1.0)
    return min(p1 * scale**0.5, p2), p2


def _text(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
