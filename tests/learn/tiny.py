"""Recipes that take a second."""

from omnistereo_learn.recipes import MCCNNRecipe, SweepNetRecipe

TINY = {"width": 48, "height": 12, "num_spheres": 12}
TINY |= {"steps": 4, "validate_every": 2, "validation_groups": 2}
SWEEPNET = SweepNetRecipe(
    **TINY, warmup=2, min_positives=4, max_positives=60, any_sphere=0.0, min_negatives=0
)
MCCNN = MCCNNRecipe(**TINY | {"width": 96, "height": 24}, warmup=2, rays_per_frame=16)
