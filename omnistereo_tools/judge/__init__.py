"""How far a rig, its images and a depth can be trusted."""
