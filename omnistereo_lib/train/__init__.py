"""Training of the learned costs: `recipes` what is done, `spheres` and `patches` on which samples, `loop` how."""

from omnistereo_lib.train.card import ship
from omnistereo_lib.train.loop import train, write_comparison
from omnistereo_lib.train.recipes import RECIPES, VARIANTS, MCCNNRecipe, Recipe, SweepNetRecipe

__all__ = ["RECIPES", "VARIANTS", "MCCNNRecipe", "Recipe", "SweepNetRecipe", "ship", "train", "write_comparison"]
