"""Training of the learned costs: `recipes` (settings), `spheres` and `patches` (samples and losses), `loop`."""

from omnistereo_lib.train.card import export_weights
from omnistereo_lib.train.loop import train, write_comparison
from omnistereo_lib.train.recipes import RECIPES, VARIANTS, MCCNNRecipe, Recipe, SweepNetRecipe, VolumeNetRecipe

__all__ = [
    "RECIPES", "VARIANTS", "MCCNNRecipe", "Recipe", "SweepNetRecipe", "VolumeNetRecipe", "export_weights",
    "train", "write_comparison",
]  # fmt: skip
