"""The streets: plan, houses, vehicles, trees, and where the rig drives."""
