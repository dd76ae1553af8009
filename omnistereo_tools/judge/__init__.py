"""How far a rig, its images and a depth can be trusted, and how long it takes to find out."""
