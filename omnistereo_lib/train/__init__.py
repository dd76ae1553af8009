"""Training of the learned costs: `recipes` what is done, `spheres` and `patches` on which samples, `loop` how."""

from omnistereo_lib.train.card import ship
from omnistereo_lib.train.loop import train
from omnistereo_lib.train.recipes import RECIPES, MCCNNRecipe, Recipe, SweepNetRecipe

__all__ = ["RECIPES", "MCCNNRecipe", "Recipe", "SweepNetRecipe", "ship", "train"]
