"""Training of the learned costs: `recipes` (settings), `spheres` and `patches` (samples and
losses), `loop`.
"""

from omnistereo_learn.loop import train
from omnistereo_learn.recipes import RECIPES, MCCNNRecipe, Recipe, SweepNetRecipe, VolumeNetRecipe

__all__ = ["RECIPES", "MCCNNRecipe", "Recipe", "SweepNetRecipe", "VolumeNetRecipe", "train"]
