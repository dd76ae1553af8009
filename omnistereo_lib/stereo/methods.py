"""Methods by name, such as "zncc+sgm" or "sweepnet+sgm,p1=0.2": one vocabulary everywhere.

A name is a matching cost, "+sgm" where the cost volume is smoothed, and the settings that differ
from their defaults. A new cost joins `COSTS`, and every command knows it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, Self, TypeVar, get_args, get_type_hints

from torch import Tensor, nn

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.stereo.cost import Cost, Volume
from omnistereo_lib.stereo.depth import index_and_confidence
from omnistereo_lib.stereo.learned import LearnedCost, Precision
from omnistereo_lib.stereo.mccnn import MCCNN
from omnistereo_lib.stereo.sgm import sgm
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_lib.stereo.sweepnet import SweepNet
from omnistereo_lib.stereo.volumenet import VolumeNet, local_mean
from omnistereo_lib.stereo.weights import BUNDLED_WEIGHTS
from omnistereo_lib.stereo.zncc import ZNCC

# The default for a single frame: the lowest errors, at seconds a frame.
FRAME_METHOD = "volumenet"
# The default for many frames, recorded or live: the fastest that is smooth.
VIDEO_METHOD = "zncc+sgm"
_Volume = TypeVar("_Volume", bound=Volume)


@dataclass(frozen=True, eq=False)
class CostEntry:
    """A matching cost in the vocabulary of methods.

    A cost of your own is a class with one method, from images warped onto a block of spheres to
    costs; see `BlockCost`. With an entry in `COSTS`, every method name, command and table knows it:

    >>> import torch
    >>> from omnistereo_lib.stereo.cost import BlockCost
    >>> class Difference(BlockCost):
    ...     def __call__(self, spherical_images, pairs, columns=None):
    ...         images = spherical_images
    ...         costs = [(images[i] - images[j]).abs().clamp(max=1) for i, j in pairs]
    ...         return torch.stack(costs).nanmean(0).permute(1, 2, 0)  # (B, H, W) → (H, W, B)
    >>> COSTS["difference"] = CostEntry("Difference", lambda method, path, precision: Difference())
    >>> Method.parse("difference+sgm,p1=0.2").label
    'Difference + SGM, p1 = 0.2'
    """

    label: str  # row of a table
    # with the path of the weights file, where the cost has weights
    load: Callable[[Method, Path, Precision], Cost]
    # Those settings of `Method` that change this cost.
    settings: frozenset[str] = frozenset()
    weights: str = ""  # bundled weights file without .safetensors; "" for a cost without weights
    # Raw volume (H, W, N) → index and confidence (H, W), in place of those of lowest costs.
    read_out: Callable[[Tensor], tuple[Tensor, Tensor]] | None = None


def _load_mccnn(method: Method, path: Path, precision: Precision) -> Cost:
    return LearnedCost(MCCNN.from_file(path), precision)


def _load_sweepnet(method: Method, path: Path, precision: Precision) -> Cost:
    network = SweepNet.from_file(path)
    network.wrap = network.wrap and method.wrap
    return LearnedCost(network, precision)


def _load_volumenet(method: Method, path: Path, precision: Precision) -> Cost:
    network = VolumeNet.from_file(path)
    network.precision = precision
    return network


# In the order of Table II.
COSTS = {
    "zncc": CostEntry(
        "ZNCC", lambda method, path, precision: ZNCC(method.window), frozenset({"window", "pairs"})
    ),
    "mccnn": CostEntry("MC-CNN", _load_mccnn, frozenset({"weights", "pairs"}), "mccnn_fast"),
    "sweepnet": CostEntry(
        "SweepNet", _load_sweepnet, frozenset({"weights", "pairs", "wrap"}), "sweepnet"
    ),
    "volumenet": CostEntry(
        "VolumeNet", _load_volumenet, frozenset({"weights"}), "volumenet", read_out=local_mean
    ),
}


@dataclass(frozen=True, kw_only=True)
class Method:
    """A way from images to sphere indices; the defaults are the paper's, except for the pairs.

    Raises:
        OmnistereoError: If a value is out of range, or set although the method does not use it.

    >>> from omnistereo_lib.stereo.methods import Method
    >>> method = Method.parse("zncc+sgm,p1=0.2")
    >>> method.cost, method.aggregate, method.p1, method.pairs
    ('zncc', 'sgm', 0.2, 'ring')
    """

    cost: str  #: a key of `COSTS`
    #: read depth from the raw cost volume, or after semi-global matching
    aggregate: Literal["none", "sgm"] = "none"
    #: side of the ZNCC window, pixels; None: that of `default_window` for the width
    window: int | None = None
    #: name of the weights file of a network, without .safetensors; "": the bundled one
    weights: str = ""
    pairs: Literal["ring", "all"] = "ring"  #: see `camera_pairs`
    p1: float | None = None  #: SGM penalties; None: those of `penalties` for the size of the volume
    p2: float | None = None
    wrap: bool = True  #: False: SGM stops at the ±180° seam, and so does every layer of SweepNet
    #: refine the index, see `winner_takes_all`; None: whoever reads it out decides
    subindex: bool | None = None

    def __post_init__(self) -> None:
        words = {"cost": tuple(COSTS), "aggregate": ("none", "sgm"), "pairs": ("ring", "all")}
        for name, choices in words.items():
            if (given := getattr(self, name)) not in choices:
                similar = get_close_matches(str(given), choices, n=1)
                guess = f". Did you mean {similar[0]}?" if similar else ""
                raise OmnistereoError(
                    f"{name} must be one of {', '.join(choices)}, got {given!r}{guess}"
                )
        if unused := self._changed.keys() - self._used:
            raise OmnistereoError(
                f"{self.name}: {self.base} does not use {', '.join(sorted(unused))}. Leave it out"
            )
        p1, p2 = self.p1 or 0.0, math.inf if self.p2 is None else self.p2
        if not (0 <= p1 <= p2 and p1 < math.inf and self.p2 != math.inf):
            raise OmnistereoError(f"{self.name}: expected 0 ≤ p1 ≤ p2, got {self.p1} and {self.p2}")
        if set(self.weights) & set(",/\\"):
            raise OmnistereoError(
                f"weights is a file name without folder and ending, got {self.weights!r}"
            )
        ZNCC(self.window)  # raises if this is not a window

    @classmethod
    def parse(cls, name: str | Self) -> Self:
        """Return the method of a name; a method is returned as it is.

        Raises an `OmnistereoError` if there is no such method.
        """
        if isinstance(name, cls):
            return name
        if not isinstance(name, str):
            raise OmnistereoError(f"method is {name!r}; expected a name such as 'zncc+sgm'")
        # Cost and aggregation, then settings such as "p1=0.2", each of the type that its field has.
        base, *settings = name.split(",")
        cost, _, aggregate = base.partition("+")
        values: dict[str, Any] = {}
        types = _types_of_settings(cls)
        for setting in settings:
            key, _, value = setting.partition("=")
            if key not in types:
                raise OmnistereoError(
                    f"{name}: unknown setting {key!r}; expected one of {', '.join(types)}"
                )
            if key in values:
                raise OmnistereoError(f"{name}: {key} is set twice; expected once. Leave one out")
            kind = types[key]
            try:
                values[key] = {"true": True, "false": False}[value] if kind is bool else kind(value)
            except (ValueError, KeyError):
                raise OmnistereoError(
                    f"{name}: {key} must be of type {kind.__name__}, got {value!r}"
                ) from None
        values |= {"cost": cost, "aggregate": aggregate or "none"}
        return cls(**values)

    @property
    def name(self) -> str:
        """The name that `parse` reads, such as "zncc+sgm,p1=0.2"."""
        return ",".join([self.base, *self._settings("=")])

    @property
    def label(self) -> str:
        """Row of a table, such as "ZNCC + SGM, p1 = 0.2"."""
        base = COSTS[self.cost].label + (" + SGM" if self.aggregate == "sgm" else "")
        return ", ".join([base, *self._settings(" = ")])

    def _settings(self, equals: str) -> list[str]:
        return [f"{name}{equals}{_text(value)}" for name, value in self._changed.items()]

    @property
    def sort_key(self) -> tuple[Any, ...]:
        """Order of Table II: methods without SGM first, then by cost."""
        return self.aggregate, list(COSTS).index(self.cost), tuple(self._changed.items())

    @property
    def volume_key(self) -> Self:
        """The method reduced to what its cost volume depends on: equal keys, one volume."""
        wrap = self.wrap or "wrap" not in COSTS[self.cost].settings
        return replace(
            self, aggregate="none", p1=None, p2=None, subindex=type(self).subindex, wrap=wrap
        )

    @property
    def base(self) -> str:
        """The name without settings, such as "zncc+sgm"."""
        return self.cost + ("+sgm" if self.aggregate == "sgm" else "")

    @property
    def _changed(self) -> dict[str, Any]:
        """Settings that differ from their defaults."""
        values = ((field, getattr(self, field.name)) for field in fields(self)[2:])
        return {field.name: value for field, value in values if value != field.default}

    @property
    def _used(self) -> frozenset[str]:
        """Settings that make a difference."""
        of_sgm = {"p1", "p2", "wrap"} if self.aggregate == "sgm" else set()
        of_winner = set() if self.reads_out else {"subindex"}
        return COSTS[self.cost].settings | of_sgm | of_winner

    @property
    def reads_out(self) -> bool:
        """Whether index and confidence are the cost's own, see `CostEntry.read_out`."""
        return self.aggregate == "none" and COSTS[self.cost].read_out is not None

    @property
    def has_weights(self) -> bool:
        """Whether the cost is a network, with a file of weights."""
        return COSTS[self.cost].weights != ""

    def weights_file(self, folder: Path = BUNDLED_WEIGHTS) -> Path:
        """Return the path of the weights file in a folder."""
        return folder / f"{self.weights or COSTS[self.cost].weights}.safetensors"

    def load_cost(self, folder: Path = BUNDLED_WEIGHTS, precision: Precision = "auto") -> Cost:
        """Return the matching cost, a network with its weights from a folder.

        Raises an `OmnistereoError` if the weights file is missing, damaged, or of another network.
        """
        return COSTS[self.cost].load(self, self.weights_file(folder), precision)

    def cost_of(self, sweep: SphereSweep, precision: Precision = "auto") -> Cost:
        """Return the matching cost, loaded once for a sweep."""

        def load() -> Cost:
            cost = self.load_cost(precision=precision)
            if isinstance(network := getattr(cost, "network", cost), nn.Module):
                network.to(sweep.device)
            return cost

        return sweep.keep((COSTS[self.cost], self.volume_key, precision), load)

    def smooth(self, volume: _Volume) -> _Volume | Tensor:
        """Return the volume (H, W, N) from which depth is read: after SGM where there is SGM."""
        if self.aggregate == "none":
            return volume
        # Where only one penalty is given, the other one's default gives way, so that p1 ≤ p2.
        p1, p2 = penalties(*volume.shape[1:])
        p2 = max(p2, self.p1 or 0) if self.p2 is None else self.p2
        p1 = min(p1, p2) if self.p1 is None else self.p1
        return sgm(volume[:], p1, p2, wrap=self.wrap)

    def read_out(self, volume: Tensor, subindex: bool = False) -> tuple[Tensor, Tensor]:
        """Return index and confidence (H, W); the setting of the method outranks `subindex`."""
        own = COSTS[self.cost].read_out if self.reads_out else None
        refine = subindex if self.subindex is None else self.subindex
        return index_and_confidence(volume, refine) if own is None else own(volume)


def _types_of_settings(cls: type) -> dict[str, type]:
    """Return the types of the settings of a `Method`: of `int | None` int, of a choice str."""
    found = {}
    for name, hint in list(get_type_hints(cls).items())[2:]:
        choices = get_args(hint)
        found[name] = hint if not choices else choices[0] if isinstance(choices[0], type) else str
    return found


def penalties(width: int, num_spheres: int) -> tuple[float, float]:
    """Return SGM's penalties for W columns and N spheres: the paper's 0.1 and 12 at 1200 and 192.

    A surface covers fewer pixels of a coarser panorama, so fewer costs speak for it against the
    same penalties; and among more spheres its slope is more steps a pixel, each of which is paid.
    The powers were chosen on held-out frames of the training sets; see notebook 05. Neither penalty
    exceeds that of the paper's scale.
    """
    # P2 = 12 (W / 1200)² 192 / N and P1 = 0.1 √(W / 1200), both at most those of the paper.
    scale = min(width / 1200, 1.0)
    p2 = 12.0 * min(scale**2 * 192 / num_spheres, 1.0)
    return min(0.1 * scale**0.5, p2), p2


def _text(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
