"""What determines a trained network, besides the data: every number of a training run, each with its reason."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, ClassVar, Literal, Self

from omnistereo_lib.errors import OmnistereoError


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """What both networks' recipes have in common. A step is some groups of samples, each of one frame."""

    network: ClassVar[str]  # name of the network that the recipe is for

    # Scale: a network is free of scale through D_min, but not of the field of view of its receptive field.
    width: int = 320  # W; the teaching scale, where a frame takes seconds on two cores
    height: int = 80  # H, -45° … 45°
    num_spheres: int = 64  # N

    # Steps
    steps: int = 1000
    frames_per_step: int = 2  # groups; processes share them, so their number bounds the processes
    augment: bool = True  # turn, mirror, swap a pair: the geometry allows it; gain and gamma: cameras differ
    seed: int = 0

    # Optimiser
    optimizer: Literal["adamw", "sgd"] = "adamw"  # sgd is the papers'; it needs far more steps
    learning_rate: float = 2e-3
    schedule: Literal["cosine", "drop"] = "cosine"  # drop: a tenth after 11 of 14 epochs, as in both papers
    warmup: int = 100  # steps of rising rate: Adam's estimates are poor at first
    momentum: float = 0.9  # of sgd
    weight_decay: float = 1e-4
    clip: float = 1.0  # largest norm of the gradient; a bad batch moves the weights no further

    # What is looked at
    validate_every: int = 100  # steps; frames of every tenth are never trained on
    validation_groups: int = 12  # groups of samples, the same ones every time

    def __post_init__(self) -> None:
        for name in ("steps", "frames_per_step", "validate_every", "validation_groups", "learning_rate", "clip"):
            if not getattr(self, name) > 0:
                raise OmnistereoError(f"{name} must be positive, got {getattr(self, name)}")
        for name, choices in (("optimizer", ("adamw", "sgd")), ("schedule", ("cosine", "drop"))):
            if getattr(self, name) not in choices:
                raise OmnistereoError(f"{name} must be one of {', '.join(choices)}, got {getattr(self, name)!r}")

    def changed(self, settings: Sequence[str]) -> Self:
        """Return the recipe with some numbers changed, given as "name=value".

        Raises
        ------
        OmnistereoError
            If the recipe has no such number or it does not take such a value.
        """
        changes: dict[str, Any] = {}
        for setting in settings:
            name, _, value = setting.partition("=")
            if name not in asdict(self):
                raise OmnistereoError(f"a {self.network} recipe has no {name!r}, it has {', '.join(asdict(self))}")
            kind = type(getattr(self, name))
            try:
                changes[name] = {"true": True, "false": False}[value.lower()] if kind is bool else kind(value)
            except (ValueError, KeyError):
                raise OmnistereoError(f"{name} must be of type {kind.__name__}, got {value!r}") from None
        return replace(self, **changes)

    def rate(self, step: int) -> float:
        """Return the learning rate of a step, counted from 0."""
        rising = min(1.0, (step + 1) / self.warmup) if self.warmup else 1.0
        if self.schedule == "drop":
            return self.learning_rate * rising * (0.1 if step >= self.steps * 11 // 14 else 1.0)
        return self.learning_rate * rising * 0.5 * (1 + math.cos(math.pi * step / self.steps))

    def as_dict(self) -> dict[str, Any]:
        """Return the recipe as JSON can hold it."""
        return {"network": self.network, **asdict(self)}


@dataclass(frozen=True, kw_only=True)
class SweepNetRecipe(Recipe):
    """How SweepNet is trained. A group is some spheres of one frame with all their camera pairs."""

    network: ClassVar[str] = "sweepnet"

    batch_norm: bool = True  # as in the authors' released code; Table I has none
    wrap: bool = True  # no seam in any layer; Table I pads the input alone
    halve: bool = False  # every other group, at random, on half of W, H and N: what it learns must fit any width
    spheres_per_frame: int = 2  # twice as many where the panorama is halved
    min_positives: int = 32  # the paper discards spheres with fewer
    any_sphere: float = 0.2  # share of groups that show spheres with fewer, or none, as well: negatives alone
    far_end: float = 0.0  # share of groups that show the sky: half of them sphere 0, half one below N / 6
    max_positives: int = 1024  # of a pair on a sphere: the sky fills sphere 0, and neighbours say much the same
    negatives: int = 4  # for each positive, weighted to balance; the paper has 1. Negatives are free and many
    min_negatives: int = 512  # of a pair on a sphere, however few positives: where nothing is, nothing matches

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("any_sphere", "far_end"):
            if not 0 <= getattr(self, name) <= 1:
                raise OmnistereoError(f"{name} is a share, expected 0 … 1, got {getattr(self, name)}")


@dataclass(frozen=True, kw_only=True)
class MCCNNRecipe(Recipe):
    """How MC-CNN is trained. A group is some rays of one frame, each with a matching and a non-matching patch pair.

    Distances are pixels between what the two cameras see of one point: one sphere index is a fraction of that.
    """

    network: ClassVar[str] = "mccnn"
    variant: Literal["fast", "accurate"] = "fast"
    rays_per_frame: int = 64  # the papers' batches of 128 and 256 pairs are 1 and 2 frames of these
    positive_px: float = 0.5  # matches lie up to so far off, as estimates on whole spheres do (MC-CNN: 0.5 … 1)
    negative_low_px: float = 1.5  # non-matches from here (MC-CNN: 1.5 … 4)
    negative_high_px: float = 6.0  # to here (MC-CNN: 6; the accurate variant 18)
    margin: float = 0.2  # of the hinge loss, fast variant

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.positive_px < self.negative_low_px < self.negative_high_px:
            raise OmnistereoError(
                "expected 0 ≤ positive_px < negative_low_px < negative_high_px, got "
                f"{self.positive_px}, {self.negative_low_px}, {self.negative_high_px}"
            )


_PAPERS = {"optimizer": "sgd", "schedule": "drop", "warmup": 0, "weight_decay": 0.0, "augment": False, "clip": 1e9}

# teaching: minutes on two cores, enough to see it learn. shipped: what made omnistereo_lib/weights.
# paper: the papers' figures, for a GPU and their data; steps = 14 epochs.
# 640 × 160 samples pictures of 400 × 384 as finely as the paper's 1200 × 300 samples those of 800 × 768, and with 96
# spheres a sphere is as many pixels as there. The notebooks' 320 × 80 is the other half: there, what a cost sees is
# higher than the panorama, and a network that knew nothing else would learn where its upper and lower edges are.
_FINE = {"width": 640, "height": 160, "num_spheres": 96}
RECIPES: dict[str, dict[str, Recipe]] = {
    "sweepnet": {
        "teaching": SweepNetRecipe(steps=150, warmup=30, validate_every=30, validation_groups=8),
        "shipped": SweepNetRecipe(**_FINE, halve=True, spheres_per_frame=1, steps=4000, validate_every=250),
        # 350 frames × 192 spheres × 14 epochs at 16 spheres a step; the paper does not state its batch.
        "paper": SweepNetRecipe(
            width=600, height=150, num_spheres=192, learning_rate=0.003, steps=58800, validate_every=2000,
            frames_per_step=8, batch_norm=False, wrap=False, negatives=1, max_positives=90000,
            any_sphere=0.0, min_negatives=0, **_PAPERS,
        ),
    },
    "mccnn": {
        "teaching": MCCNNRecipe(steps=400, warmup=50, validate_every=50),
        "shipped": MCCNNRecipe(**_FINE, steps=6000, validate_every=500),
        # 40 million pairs × 14 epochs at 256 a step.
        "paper": MCCNNRecipe(
            variant="accurate", negative_high_px=18.0, width=600, height=150, num_spheres=192, learning_rate=0.003,
            steps=2187500, validate_every=20000, **_PAPERS,
        ),
    },
}  # fmt: skip

# SweepNet's recipe with optimiser, normalisation or both turned into the paper's: `train sweepnet --variants`.
_SGD = _PAPERS | {"learning_rate": 0.003, "augment": True}
VARIANTS: dict[str, dict[str, Any]] = {
    "ours": {},
    "no batch norm": {"batch_norm": False},
    "SGD": _SGD,
    "SGD and no batch norm": {**_SGD, "batch_norm": False},
}
