"""Recipes: every number that determines a trained network, with its reason."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from numbers import Integral, Real
from typing import Any, ClassVar, Literal, Self

from omnistereo_lib.errors import OmnistereoError

ENDLESS = "endless"
_CHOICES = {
    "optimizer": ("adamw", "sgd"),
    "schedule": ("cosine", "drop"),
    "variant": ("fast", "accurate"),
}
_FRACTIONS = {"momentum", "any_sphere"}
_MAY_BE_ZERO = {
    *("seed", "warmup", "weight_decay", "positive_px", "margin"),
    *("min_positives", "negatives", "min_negatives"),
}


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """Settings that all recipes share; one out of its range raises `OmnistereoError`.

    A step is some micro-batches of samples, each of one frame.
    """

    network: ClassVar[str]  # name of the network that the recipe is for
    # training sets of data_samples, unless others are given; "endless": see `EndlessWorlds`
    worlds: str = "sunny"
    # endless frames with what is wrong with real rigs: see `draw_frame`
    faults: bool = False

    # Scale: a network is free of scale through D_min, but not of the field of view of its receptive
    # field.
    width: int = 320  # W; the teaching scale, where a frame takes seconds on two cores
    height: int = 80  # H, -45° to 45°
    num_spheres: int = 64  # N

    # Steps
    steps: int = 1000
    frames_per_step: int = 2  # micro-batches; a multiple of the number of processes
    # rotate, flip, swap a pair: the geometry allows it; gain and gamma: cameras differ
    augment: bool = True
    seed: int = 0

    # Optimiser sgd is the optimiser of the papers; it needs far more steps
    optimizer: Literal["adamw", "sgd"] = "adamw"
    learning_rate: float = 2e-3
    # drop: a tenth after 11 of 14 epochs, as in both papers
    schedule: Literal["cosine", "drop"] = "cosine"
    warmup: int = 100  # steps of rising learning rate: Adam's estimates are poor at first
    momentum: float = 0.9  # sgd only
    weight_decay: float = 1e-4
    clip: float = 1.0  # largest norm of the gradient; a bad batch moves the weights no further

    # Validation
    validate_every: int = 100  # steps; every tenth frame is never trained on
    validation_groups: int = 12  # micro-batches, the same ones every time

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if name in _CHOICES:
                valid, wanted = value in _CHOICES[name], f"one of {', '.join(_CHOICES[name])}"
            elif isinstance(value, bool):
                continue
            elif name == "worlds":
                valid, wanted = value.split() != [], "names of folders in data_samples, or endless"
            elif name in _FRACTIONS:
                valid, wanted = 0 <= value <= 1, "a fraction in [0, 1]"
            else:
                kind = (
                    Integral if isinstance(self.__dataclass_fields__[name].default, int) else Real
                )
                number = float(value) if isinstance(value, kind) else math.nan
                most = 2**31 if kind is Integral else math.inf  # torch takes no larger seed
                valid = 0 <= number < most and (number > 0 or name in _MAY_BE_ZERO)
                below = ", below 2^31" if kind is Integral else ""
                wanted = f"a finite number {'≥' if name in _MAY_BE_ZERO else '>'} 0{below}"
            if not valid:
                raise OmnistereoError(
                    f"{self.network} recipe: {name} = {value!r}; expected {wanted}"
                )

    def with_overrides(self, settings: Sequence[str]) -> Self:
        """Return the recipe with settings changed by "name=value"; refuse bad ones."""
        changes: dict[str, Any] = {}
        for setting in settings:
            name, _, value = setting.partition("=")
            if name not in asdict(self):
                raise OmnistereoError(
                    f"{setting}: unknown setting {name!r}; a {self.network} recipe has"
                    f" {', '.join(asdict(self))}"
                )
            kind = type(getattr(self, name))
            try:
                changes[name] = (
                    {"true": True, "false": False}[value.lower()] if kind is bool else kind(value)
                )
            except (ValueError, KeyError):
                raise OmnistereoError(f"{setting}: {value!r}; expected {kind.__name__}") from None
        return replace(self, **changes)

    def learning_rate_at(self, step: int) -> float:
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
    """Recipe of SweepNet.

    A micro-batch is some spheres of one frame with all their camera pairs.
    """

    network: ClassVar[str] = "sweepnet"

    batch_norm: bool = True  # the authors' released code has it, Table I has not
    wrap: bool = True  # no seam in any layer; Table I pads only the input
    # every other micro-batch, at random, at half of W, H and N: the network must fit any width
    halve: bool = False
    spheres_per_frame: int = 2  # twice as many where the panorama is halved
    min_positives: int = 32  # the paper discards spheres with fewer
    # fraction of micro-batches that may draw spheres with fewer as well: only negatives
    any_sphere: float = 0.2
    # per pair and sphere: the sky fills sphere 0, and neighbours are nearly the same
    max_positives: int = 1024
    # per positive, weighted to balance; the paper has 1. Negatives are many and cost nothing
    negatives: int = 4
    # per pair and sphere, however few positives: an empty sphere must not match
    min_negatives: int = 512


@dataclass(frozen=True, kw_only=True)
class VolumeNetRecipe(Recipe):
    """Recipe of VolumeNet.

    A micro-batch is some whole frames, of any rigs, on grids turned and scaled at random.
    """

    network: ClassVar[str] = "volumenet"
    worlds: str = "sunny streets things rooms"
    frames_per_step: int = 1
    batch_frames: int = 2  # frames in one pass of the U-net, whose batch norms see them all


@dataclass(frozen=True, kw_only=True)
class MCCNNRecipe(Recipe):
    """Recipe of MC-CNN. A micro-batch is rays of one frame, each with a match and a non-match.

    Distances are pixels between the views of one point in two cameras: a sphere is less.
    """

    network: ClassVar[str] = "mccnn"
    variant: Literal["fast", "accurate"] = "fast"
    rays_per_frame: int = 64  # the papers' batches of 128 and 256 pairs are 1 and 2 frames of these
    # matches are off by up to this, as estimates on integer spheres are (MC-CNN: 0.5 to 1)
    positive_px: float = 0.5
    negative_low_px: float = 1.5  # non-matches are off by at least this (MC-CNN: 1.5 to 4)
    # non-matches are off by at most this (MC-CNN: 6; the accurate variant 18)
    negative_high_px: float = 6.0
    margin: float = 0.2  # hinge loss of the fast variant: a match beats a non-match by this cosine

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.positive_px < self.negative_low_px < self.negative_high_px:
            found = f"{self.positive_px}, {self.negative_low_px}, {self.negative_high_px}"
            raise OmnistereoError(
                f"mccnn recipe: {found}; expected positive_px < negative_low_px < negative_high_px"
            )


# The optimiser of both papers.
PAPERS: dict[str, Any] = {"optimizer": "sgd", "learning_rate": 0.003, "schedule": "drop"}
PAPERS |= {"warmup": 0, "weight_decay": 0.0, "augment": False, "clip": 1e9}

# teaching: minutes on two cores, enough to see it learn. shipped: what made omnistereo_lib/weights.
# paper: the numbers of the papers, for a GPU and their data; steps = 14 epochs.
# 640 × 160 samples images of 400 × 384 as finely as the paper's 1200 × 300 samples those of 800 ×
# 768, and with 96 spheres one sphere is as many pixels as there. The 320 × 80 of the notebooks is
# the other half: there the receptive field is higher than the panorama, and a network trained only
# on that would learn where its upper and lower edges are.
_FINE: dict[str, Any] = {"width": 640, "height": 160, "num_spheres": 96}
_FEW = _FINE | {"halve": True, "spheres_per_frame": 1}
_PAPER: dict[str, Any] = PAPERS | {"width": 600, "height": 150, "num_spheres": 192}
RECIPES: dict[str, dict[str, Recipe]] = {
    "sweepnet": {
        "teaching": SweepNetRecipe(steps=150, warmup=30, validate_every=30, validation_groups=8),
        "shipped": SweepNetRecipe(**_FEW, steps=4000, validate_every=250),
        # With --init-weights of "shipped". Most frames are of the streets, which must not get
        # worse.
        "worlds": SweepNetRecipe(
            **_FEW,
            batch_norm=False,
            worlds="sunny sunny sunny streets rooms things",
            steps=500,
            learning_rate=2e-4,
            validation_groups=24,
        ),
        # 350 frames × 192 spheres × 14 epochs at 16 spheres a step; the paper does not state its
        # batch.
        "paper": SweepNetRecipe(
            steps=58800,
            validate_every=2000,
            frames_per_step=8,
            batch_norm=False,
            wrap=False,
            negatives=1,
            max_positives=90000,
            any_sphere=0.0,
            min_negatives=0,
            **_PAPER,
        ),
    },
    "volumenet": {
        # Ten minutes on two cores: ahead of ZNCC with SGM in the streets and among things, not yet
        # in rooms.
        "teaching": VolumeNetRecipe(
            worlds=ENDLESS, steps=560, warmup=40, validate_every=140, validation_groups=8
        ),
        "shipped": VolumeNetRecipe(steps=1200, warmup=60, validate_every=200),
        # The last of five rounds (1200, 700, 3000, 1200, 1200 steps), each with --init-weights of
        # the one before.
        "refined": VolumeNetRecipe(
            worlds="sunny streets things rooms rooms",
            steps=1200,
            learning_rate=1e-3,
            seed=2,
            warmup=60,
            validate_every=250,
            validation_groups=24,
        ),
        "gpu": VolumeNetRecipe(
            worlds="endless endless endless endless sunny streets rooms things",
            steps=20000,
            warmup=500,
            frames_per_step=2,
            validate_every=1000,
        ),
    },
    "mccnn": {
        "teaching": MCCNNRecipe(steps=400, warmup=50, validate_every=50),
        "shipped": MCCNNRecipe(**_FINE, steps=6000, validate_every=500),
        # 40 million pairs × 14 epochs at 256 a step.
        "paper": MCCNNRecipe(
            variant="accurate",
            negative_high_px=18.0,
            steps=2187500,
            validate_every=20000,
            **_PAPER,
        ),
    },
}
