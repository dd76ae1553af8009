"""A recording becomes one world: who has depth of many frames comes here for the path of the rig
and one surface.

`motion` (the rig's step from frame to frame), `fusion` (signed distances of all frames, and depth
read back from them), `refine` (which of the two a ray keeps), `surface` (the mesh).
"""
